"""`mgsgraph fetch`: from ids of images to a folder with all that their adjustment needs."""

from pathlib import Path
from typing import TYPE_CHECKING

import click

if TYPE_CHECKING:
    from mgsgraph.fetch.folder import Planned

_PATH = click.Path(path_type=Path)


@click.command(short_help="Fetch images, kernels, laser profiles and terrain from the archives.")
@click.argument("images", nargs=-1, metavar="IMAGE...")
@click.option("--out", type=_PATH, help="Folder to fetch into; an earlier one is added to.")
@click.option(
    "--terrain", type=click.Choice(["4", "16", "128", "none"]), default="16", show_default=True,
    help="MOLA's grids, pixels per degree: 4 (4 MB), 16 (66 MB), 128 (260 MB for each tile).",
)  # fmt: skip
@click.option("--volume", "volumes", multiple=True, metavar="mgsc_NNNN", help="Where the images are; may be repeated.")
@click.option("--mirror", metavar="URL", help="All archives below one address: URL/images/, URL/kernels/ ...")
@click.option("--mirrors", type=_PATH, help="TOML file with addresses of single archives; also $MGSGRAPH_MIRRORS.")
@click.option("--dry-run", is_flag=True, help="List what would be fetched, with sizes; write nothing.")
@click.option("--update", is_flag=True, help="Ask the archives for everything anew, and take what has changed.")
@click.option("--verify", type=_PATH, metavar="FOLDER", help="Hold a folder against its fetch.lock; fetches nothing.")
def fetch(
    images: tuple[str, ...], out: Path | None, terrain: str, volumes: tuple[str, ...], mirror: str | None,
    mirrors: Path | None, dry_run: bool, update: bool, verify: Path | None,
) -> None:
    """Fetch all that the adjustment of MOC narrow-angle images needs, by their ids (E02/00665, e0200665), and write a
    case file.

    What has come is locked by size and SHA-256: the same command again brings only what is missing, and an interrupted
    download goes on where it was. Exit status: 0, 2 for bad input or an archive that can't give what is needed, 130
    interrupted.
    """
    if verify is not None:
        if images or out is not None or dry_run or update:
            raise click.UsageError("--verify takes a folder, and neither images nor --out, --dry-run or --update")
        _verify(verify)
        return
    if dry_run and update:
        raise click.UsageError("--dry-run tells what is not here, not what has changed: leave --update out")
    if out is None and not dry_run:
        raise click.UsageError("Missing option '--out'")
    from mgsgraph.cli.progress import byte_bar, passing_word
    from mgsgraph.fetch.archives import Archives
    from mgsgraph.fetch.folder import fetch_images, survey

    archives = Archives.chosen(mirror, mirrors)
    if out is None or dry_run:
        with byte_bar("looking up") as show:
            plan = survey(
                images, out or Path("fetched"), terrain=terrain, archives=archives, volumes=volumes, progress=show,
                say=passing_word,
            )
        _tell_plan(plan, terrain)
        return
    try:
        with byte_bar("fetching") as show:
            fetched = fetch_images(
                images, out, terrain=terrain, archives=archives, volumes=volumes, update=update, progress=show,
                say=passing_word,
            )
    except KeyboardInterrupt:
        click.echo("mgsgraph: interrupted; what has come is kept, the same command goes on", err=True)
        raise click.exceptions.Exit(130) from None
    for sentence in fetched.sentences():
        click.echo(f"- {sentence}")
    click.echo(f"The case is {fetched.case}")
    if commands := fetched.commands():
        click.echo("Next:")
        for command in commands:
            click.echo(f"  {command}")
    else:
        click.echo("Next: fetch an image that overlaps it, into the same folder")


def _verify(folder: Path) -> None:
    from mgsgraph.cli.progress import byte_bar
    from mgsgraph.fetch.lock import verify

    with byte_bar("verifying") as show:
        lock = verify(folder, show)
    click.echo(f"{len(lock.files)} files, {lock.size / 1e6:.1f} MB, all as locked")


def _tell_plan(plan: "tuple[Planned, ...]", terrain: str) -> None:
    for one in plan:
        each = "?" if one.size is None else f"{one.size / 1e6:.1f}"
        click.echo(f"{each:>9} MB  {one.path}  {'here' if one.here else one.url}")
    coming = [one for one in plan if not one.here]
    unknown = "" if all(one.size is not None for one in coming) else ", and what has no size"
    size = f"{sum(one.size or 0 for one in coming) / 1e6:.1f} MB{unknown}"
    click.echo(f"{len(coming)} files to fetch and their labels, {size}")
    if terrain == "128":
        click.echo("and tiles of 128 pixels per degree, 260 MB each: which ones shows when the kernels are there")

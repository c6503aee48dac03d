"""`mgsgraph add`: images come into a project, and everything that they touch is adjusted anew."""

from pathlib import Path
from typing import TYPE_CHECKING

import click

if TYPE_CHECKING:
    from mgsgraph.project.addition import Addition

_PATH = click.Path(path_type=Path)


@click.command(short_help="Add images to a project.")
@click.argument("project", type=_PATH)
@click.argument("images", nargs=-1, metavar="[NAME=]IMAGE...")
@click.option("--ties", type=_PATH, multiple=True, help="Control network with their measures; may be repeated.")
@click.option("--shots", type=_PATH, multiple=True, help="Laser shots: ISIS lidar (.json) or PEDR; may be repeated.")
@click.option("--impact", "table", type=_PATH, metavar="FILE", help="Write every point that moved to a CSV file.")
@click.option("--check", is_flag=True, help="Compare with batch over everything afterwards; see `mgsgraph solve`.")
@click.option("--dry-run", is_flag=True, help="Read everything and say what would be added; change nothing.")
@click.pass_context
def add(
    ctx: click.Context,
    project: Path,
    images: tuple[str, ...],
    ties: tuple[Path, ...],
    shots: tuple[Path, ...],
    table: Path | None,
    check: bool,
    dry_run: bool,
) -> None:
    """Add each IMAGE to PROJECT, with the measures of --ties and --shots, and adjust what it touches.

    IMAGE is support data (.json, .isd), a MOC label (.img, .lbl, .cub; with the project's kernels) or a case file
    (.toml), which brings everything that it names. NAME is what control networks call it.

    What is printed is the impact: which images and points moved, in metres and in their sigmas. --check ends with the
    closing check: batch over everything, the largest difference, and batch's result where the two are not the same.

    Exit status: 0 added, 1 added and not come to rest, 2 bad input (nothing has changed).
    """
    from mgsgraph.cli.stages import stage_bar
    from mgsgraph.cli.tell import tell
    from mgsgraph.errors import InputError
    from mgsgraph.project.addition import parse_image, read_addition
    from mgsgraph.project.changes import add as put
    from mgsgraph.project.changes import check as compare
    from mgsgraph.project.project import open_project
    from mgsgraph.reports.impact import require_writable

    if not (images or ties or shots):
        raise InputError("add", "no image, no --ties and no --shots", "at least one of them")
    if table is not None:
        require_writable(table, project)
    wanted = [parse_image(text) for text in images]
    closing = None
    with stage_bar(3 if check else 2) as stages, open_project(project, write=not dry_run) as opened:
        with stages.stage("reading"):
            addition = read_addition(opened.store, opened.settings, str(project), wanted, ties, shots)
        if not dry_run:
            with stages.stage("adjusting"):
                impact = put(opened, addition)
            if check and impact is not None:
                with stages.stage("closing check"):
                    closing = compare(opened)
    if dry_run:
        click.echo(f"{project}: would add {_words(addition)}; nothing was changed")
        _warn(addition)
        return
    click.echo(f"{project}: added {_words(addition)}")
    for one in addition.images:
        if len(one.files) == 1 and not any(one.known.image.name in (given.name, given.path.stem) for given in wanted):
            click.echo(f"- {one.files[0]} was taken for {one.known.image.name}, which the ties name; NAME=FILE says it")
    if impact is None:
        _warn(addition)
        click.echo(f"Nothing is adjusted yet; next: mgsgraph solve {project}")
        return
    tell(impact, closing, table)
    ctx.exit(0 if impact.converged else 1)


def _words(addition: "Addition") -> str:
    from mgsgraph.wording import many

    network = addition.network
    rays, ranges = (0, 0) if network is None else (network.rays.point.size, network.ranges.point.size)
    named = ", ".join(addition.names)
    images = many(len(addition.names), "image")
    return f"{images}{f' ({named})' if named else ''}, {rays} image measures, {ranges} laser ranges"


def _warn(addition: "Addition") -> None:
    if addition.unconnected:
        names = ", ".join(addition.unconnected)
        click.echo(f"- Unconnected: {names}. No point is shared with another image; tie points would join it.")

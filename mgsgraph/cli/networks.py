"""Verbs that pass networks and solutions on to other programs, and tie points to a person."""

from pathlib import Path
from typing import Any

import click

from mgsgraph.cli.options import PATH, print_sentences
from mgsgraph.export import Format, Target
from mgsgraph.files.networks.record import Duplicates

_FORMATS = click.Choice([one.value for one in Format])


@click.command()
@click.argument("files", type=PATH, nargs=-1, required=True, metavar="IN... [OUT]")
@click.option("--out", type=PATH, help="OUT; all files before it are IN then.")
@click.option("--from", "read_as", type=_FORMATS, help="Format of all IN; by their endings when absent.")
@click.option("--to", "write_as", type=_FORMATS, help="Format of OUT; by its ending when absent.")
@click.option("--case", type=PATH, help="A case file, for the names and sizes of its images and for the ellipsoid.")
@click.option(
    "--images", "sizes", multiple=True, metavar="NAME=LINESxSAMPLES",
    help="Size of an image, for .nvm; may be repeated."
)  # fmt: skip
@click.option(
    "--radii", type=float, nargs=2, metavar="EQUATORIAL POLAR",
    help="Ellipsoid of geodetic latitudes and heights (m), for .gcp and tables with height_m.",
)  # fmt: skip
@click.option("--target", default="", help="The body's name, for .pvl and .net where IN don't say it, as MARS.")
@click.option("--rename", multiple=True, metavar="OLD=NEW", help="Call an image otherwise in OUT; may be repeated.")
@click.option("--prefix", help="How the names of match files in IN begin, before the hyphen; empty for without.")
@click.option("--nvm-no-shift", is_flag=True, help="Places of .nvm count from the first pixel, not the image's middle.")
@click.option(
    "--duplicates", type=click.Choice([one.value for one in Duplicates]), default=Duplicates.REFUSE.value,
    help="Points of one id in several IN: refuse, or unite them; where they differ the first or the last file counts."
)  # fmt: skip
@click.option("--only", multiple=True, metavar="IMAGE", help="Image to keep, or a pattern as MGS/*; may be repeated.")
@click.option("--split", is_flag=True, help="A file for each connected part: OUT_1, OUT_2, ...")
@click.option("--replace", is_flag=True, help="Overwrite OUT, whatever it is.")
@click.option("--strict", is_flag=True, help="Write nothing (exit status 2) if OUT can't hold all that IN do.")
def convert(
    files: tuple[Path, ...], out: Path | None, duplicates: str, replace: bool, nvm_no_shift: bool, **given: Any
) -> None:
    """Read IN... as one network and write it to OUT (the last file, or --out), each in the format of its ending: .pvl
    and .net (ISIS), .csv, .parquet, .match and .txt (matches of the Ames Stereo Pipeline; OUT is then what the files'
    names begin with, and there is one for each pair of images), .gcp and .nvm.

    --only and --split, in this order, take parts of it.

    Says what was written and, one line each, what the format can't hold. Pixels are counted as each format counts them:
    see docs/exchange.md.

    Exit status: 0, or 2 for bad input, and with --strict for a format that can't hold all.
    """
    from mgsgraph.export.exchange import Lossy, Selection
    from mgsgraph.export.exchange import convert as make
    from mgsgraph.export.exchange_setting import setting_of

    if out is None and len(files) < 2:
        raise click.UsageError("one file alone: name what is written, last or by --out")
    inputs, output = (files[:-1], files[-1]) if out is None else (files, out)
    names = ("case", "sizes", "radii", "target", "rename", "prefix")
    setting = setting_of(**{name: given.pop(name) for name in names}, shifted=not nvm_no_shift)
    selection = Selection(Duplicates(duplicates), *map(given.pop, ("only", "split")))
    try:
        made = make(
            inputs, output, setting, selection, replace=replace or out is not None, anything=replace, **given
        )
    except Lossy as error:
        _print_lost(error.lost)
        raise
    for note in made.notes:
        click.echo(f"- {note}")
    for path in made.written:
        click.echo(f"Wrote {path}")
    _print_lost(made.lost)


def _print_lost(lost: tuple[str, ...]) -> None:
    for line in lost:
        click.echo(f"- Not held: {line}")


@click.command()
@click.argument("solution", type=PATH)
@click.option("--to", "target", type=click.Choice([one.value for one in Target]), required=True, help="Export target.")
@click.option("--out", type=PATH, required=True, help="Folder for the files; made anew.")
@click.option("--scaled", is_flag=True, help="Covariances times sigma0 squared, as jigsaw's; else for sigma0 = 1.")
@click.option("--case", type=PATH, help="The case: its images' files give names and more (csm, asp).")
@click.option(
    "--network", "networks", type=PATH, multiple=True,
    help="Network that the points were read from, where it isn't where it was (isis); may be repeated."
)  # fmt: skip
@click.option("--raster", is_flag=True, help="Sigmas of new points over the overlap as well, a GeoTIFF (gis).")
@click.option("--verify", is_flag=True, help="Read kernels back by SPICE alone, say how far they are off (spice).")
def export(
    solution: Path, target: str, out: Path, scaled: bool, case: Path | None, networks: tuple[Path, ...], raster: bool,
    verify: bool,
) -> None:  # fmt: skip
    """Write SOLUTION (results, or a project) for another program.

    spice: SPK, CK, their frames, clock and camera, and a meta-kernel. csm: image support data and model states of
    usgscsm. isis: control network with adjusted points, lidar data, jigsaw's tables. asp: matches, control points,
    cameras. gis: a GeoPackage, and with --raster a GeoTIFF.
    """
    from mgsgraph.export.solution_export import ExportSettings, export_solution
    from mgsgraph.project.reading import results_of

    support, files = None, dict[str, str]()
    if case is not None:
        from mgsgraph.case.case_file import decode, image_file

        images = decode(case).images
        support = {image.name: case.parent / image.isd for image in images if image.isd is not None}
        files = {image.name: Path(image.pixels or image_file(image)).name for image in images}
    results = results_of(solution)
    settings = ExportSettings(scaled, support, files, networks, raster, verify)
    done = export_solution(results.folder, target, out, settings)
    print_sentences(filter(None, (results.warning, done.sentence, *done.notes)))
    click.echo(f"The files are in {out}")


_PAGES = (".html", ".htm")
_NETWORKS = (".pvl", ".net", ".csv")


@click.command()
@click.argument("case", type=PATH)
@click.option("--out", type=PATH, required=True, help="Page (.html), or with --verdicts a network (.pvl, .net, .csv).")
@click.option("--ties", type=PATH, help="Network to review, in place of the case's own.")
@click.option("--worst", type=click.IntRange(1), help="How many points to show.  [default: 300]")
@click.option("--points", metavar="ID,ID,...", help="Points to show, in place of the worst.")
@click.option("--solution", type=PATH, help="Results of `mgsgraph adjust` with these points: show their residuals.")
@click.option("--verdicts", type=PATH, help="CSV that the page has saved: to act upon, or to begin a page with.")
def review(
    case: Path, out: Path, ties: Path | None, worst: int | None, points: str | None, solution: Path | None,
    verdicts: Path | None,
) -> None:  # fmt: skip
    """Show the images of CASE around its tie points, so that a person can accept or reject each of them.

    The page is one file that any browser shows; it saves verdicts as CSV. With --verdicts and a network as --out, the
    network is written with Ignore = True at rejected points, and nothing else changed. Nothing overwrites the network
    that was reviewed.
    """
    from mgsgraph.errors import InputError

    if out.suffix.lower() in _PAGES:
        if worst is not None and points is not None:
            raise click.UsageError("--worst and --points can't both be given")
        _write_page(case, out, ties, worst, points, solution, verdicts)
    elif out.suffix.lower() in _NETWORKS:
        if verdicts is None:
            raise click.UsageError(f"{out} is a network; it is written by --verdicts, a page has the ending .html")
        if given := [name for name, value in (("worst", worst), ("points", points), ("solution", solution)) if value]:
            raise click.UsageError(f"--{given[0]} is for a page, and {out} is a network")
        _write_network(case, out, ties, verdicts)
    else:
        raise InputError(str(out), f"the ending {out.suffix!r}", "a page (.html) or a network (.pvl, .net, .csv)")


def _write_page(
    case: Path, out: Path, ties: Path | None, worst: int | None, points: str | None, solution: Path | None,
    verdicts: Path | None,
) -> None:  # fmt: skip
    from mgsgraph.case.reading import read_case
    from mgsgraph.cli.progress import counting_bar
    from mgsgraph.results.archive import read_solution
    from mgsgraph.studio.match_review import WORST, require_page, review_case, write_review
    from mgsgraph.studio.verdicts import read_verdicts, reviewed_network

    require_page(out)
    if ties is None:
        reviewed_network(case)  # of several, none could be written without the rejected points
    earlier = None if verdicts is None else read_verdicts(verdicts)
    adjusted = None if solution is None else read_solution(solution)
    wanted = () if points is None else tuple(point.strip() for point in points.split(","))
    read = read_case(case, ties=ties)
    with counting_bar("comparing chips", "measure") as bar:
        made = review_case(read, adjusted, worst=worst or WORST, points=wanted, verdicts=earlier, progress=bar)
    write_review(made, out, earlier)
    click.echo(f"- {made.choice}.")
    click.echo(f"The page is {out}")


def _write_network(case: Path, out: Path, ties: Path | None, verdicts: Path) -> None:
    from mgsgraph.export.exchange_setting import case_setting
    from mgsgraph.files.networks.table import is_table
    from mgsgraph.studio.verdicts import read_verdicts, reviewed_network, write_kept

    network = reviewed_network(case) if ties is None else ties
    setting = case_setting(case) if is_table(network) else None
    ignored, total = write_kept(
        network, read_verdicts(verdicts), out, setting, lambda: tuple(case_setting(case).sizes)
    )
    click.echo(f"- {ignored} of {total} points of {network} are ignored now.")
    click.echo(f"The network is {out}")

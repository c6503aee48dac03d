"""Verbs that pass networks and solutions on to other programs."""

from contextlib import ExitStack
from pathlib import Path
from typing import Any

import click

from mgsgraph.cli.options import DETAILS, PATH, folder_for, items, print_brief, print_sentences
from mgsgraph.export import Format, Target
from mgsgraph.files.networks.record import Duplicates

_FILES = 5
"""Number of written files that are printed before the notes."""
_FORMATS = click.Choice([one.value for one in Format])


@click.command()
@click.argument("files", type=PATH, nargs=-1, required=True, metavar="IN... [OUT]")
@click.option("--out", type=PATH, help="OUT; all files before it are IN then.")
@click.option("--from", "read_as", type=_FORMATS, help="Format of all IN; by their endings when absent.")
@click.option("--to", "write_as", type=_FORMATS, help="Format of OUT; by its ending when absent.")
@click.option("--case", type=PATH, help="A case file, for the names and sizes of its images and for the ellipsoid.")
@click.option(
    "--size", "sizes", multiple=True, metavar="NAME=LINESxSAMPLES",
    help="Size of an image, for .nvm; may be repeated."
)  # fmt: skip
@click.option(
    "--radii", type=float, nargs=2, metavar="EQUATORIAL POLAR",
    help="Ellipsoid of geodetic latitudes and heights (m), for .gcp and tables with height_m.",
)  # fmt: skip
@click.option("--body", "target", default="", help="The body's name, for .pvl and .net where IN don't say it, as MARS.")
@click.option("--rename", multiple=True, metavar="OLD=NEW", help="Call an image otherwise in OUT; may be repeated.")
@click.option("--prefix", help="How the names of match files in IN begin, before the hyphen; empty for without.")
@click.option("--nvm-no-shift", is_flag=True, help="Places of .nvm count from the first pixel, not the image's middle.")
@click.option(
    "--duplicates", type=click.Choice([one.value for one in Duplicates]), default=Duplicates.REFUSE.value,
    help="Points of one id in several IN: refuse, or unite them; where they differ the first or the last file counts."
)  # fmt: skip
@click.option("--image", "only", multiple=True, metavar="IMAGE", help="Image to keep, or MGS/*; may be repeated.")
@click.option("--verdicts", type=PATH, metavar="CSV", help="Of `studio`, about IN: rejected points get Ignore = True.")
@click.option("--replace", is_flag=True, help="Overwrite OUT, whatever it is.")
@click.option("--strict", is_flag=True, help="Write nothing (exit status 2) if OUT can't hold all that IN do.")
@DETAILS
def convert(
    files: tuple[Path, ...], out: Path | None, duplicates: str, replace: bool, nvm_no_shift: bool,
    verdicts: Path | None, **options: Any,
) -> None:  # fmt: skip
    """Read IN... as one network and write it to OUT (the last file, or --out), each in the format of its ending: .pvl
    and .net (ISIS), .csv, .parquet, .match and .txt (matches of the Ames Stereo Pipeline; OUT is then what the files'
    names begin with, and there is one for each pair of images), .gcp and .nvm.

    --verdicts and --image, in this order, take parts of it.

    Says what was written and, one line each, what the format can't hold. Pixels are counted as each format counts them:
    see docs/exchange.md.

    Exit status: 0, or 2 for bad input, and with --strict for a format that can't hold all.
    """
    from mgsgraph.export.exchange import Lossy, Selection
    from mgsgraph.export.exchange import convert as make
    from mgsgraph.export.exchange_setting import setting_of
    from mgsgraph.export.verdicts import read_verdicts

    if out is None and len(files) < 2:
        raise click.UsageError("one file alone: name what is written, last or by --out")
    inputs, output = (files[:-1], files[-1]) if out is None else (files, out)
    names = ("case", "sizes", "radii", "target", "rename", "prefix")
    setting = setting_of(**{name: options.pop(name) for name in names}, shifted=not nvm_no_shift)
    of_points = None if verdicts is None else read_verdicts(verdicts)
    selection = Selection(Duplicates(duplicates), options.pop("only"), of_points)
    try:
        written = make(
            inputs, output, setting, selection, replace=replace or out is not None, anything=replace, **options
        )
    except Lossy as error:
        print_brief(*items(f"Not kept: {line}" for line in error.losses), more=0)
        raise
    messages = [f"Wrote {path}" for path in written.written]
    losses = [f"Not kept: {line}" for line in written.losses]
    print_brief(*messages[:_FILES], *items((*written.notes, *losses)), *messages[_FILES:], more=0)


@click.command()
@click.argument("solution", type=PATH, metavar="RESULT|PROJECT")
@click.option("--to", "names", required=True, metavar="TARGET,...", help=f"One or several of {', '.join(Target)}.")
@click.option(
    "--out", type=PATH, help="Folder for the files, of several targets one in it for each; made anew.  [default: "
    "NAME-TARGET]",
)  # fmt: skip
@click.option("--scaled", is_flag=True, help="Covariances times sigma0 squared, as jigsaw's; else for sigma0 = 1.")
@click.option("--case", type=PATH, help="The case: its images' files give names and more (csm, asp), or are the cubes.")
@click.option(
    "--ties", "networks", type=PATH, multiple=True, metavar="NETWORK",
    help="Network that the points were read from, where it isn't where it was (isis); may be repeated."
)  # fmt: skip
@click.option("--raster", is_flag=True, help="Sigmas of new points over the overlap as well, a GeoTIFF (gis).")
@click.option("--verify", is_flag=True, help="Read kernels back by SPICE alone, say how far they are off (spice).")
@click.option("--update", is_flag=True, help="Replace the cubes, too, once their copies are read back (cubes).")
def export(
    solution: Path, names: str, out: Path | None, scaled: bool, case: Path | None, networks: tuple[Path, ...],
    raster: bool, verify: bool, update: bool,
) -> None:  # fmt: skip
    """Write RESULT (of `mgsgraph adjust`) or PROJECT for other programs.

    spice: SPK, CK, their frames, clock and camera, and a meta-kernel. csm: image support data and model states of
    usgscsm. isis: control network with adjusted points, lidar data, jigsaw's tables. asp: matches, control points,
    cameras. gis: a GeoPackage, and with --raster a GeoTIFF. cubes: copies of ISIS cubes with adjusted tables.
    """
    from mgsgraph.export.solution_export import (
        ExportSettings,
        exporting,
        require_supported,
        settings_for,
        target_of,
    )
    from mgsgraph.project.reading import results_of

    targets = [target_of(name.strip()) for name in names.split(",")]
    support, files = None, dict[str, str]()
    if case is not None:
        from mgsgraph.case.case_file import decode, image_file

        images = decode(case).images
        support = {image.name: case.parent / image.isd for image in images if image.isd is not None}
        files = {image.name: Path(image.pixels or image_file(image)).name for image in images}
    results = results_of(solution)
    of_cubes = case or (results.case if Target.CUBES in targets else None)
    settings = ExportSettings(scaled, support, files, networks, raster, verify, of_cubes, update)
    require_supported(targets, settings)
    print_sentences(results.warning)
    several = out is not None and len(set(targets)) > 1
    folders = {target: out / target if out and several else folder_for(out, solution, target) for target in targets}
    with ExitStack() as stack:
        exports = [
            stack.enter_context(exporting(results.folder, target, folder, settings_for(target, settings)))
            for target, folder in folders.items()
        ]
    for exported in exports:
        print_sentences(exported.sentence, *exported.notes)
        click.echo(f"The files are in {exported.folder}")

"""`mgsgraph convert`: networks from one program to another."""

from pathlib import Path

import click

_PATH = click.Path(path_type=Path)
_FORMATS = click.Choice(["pvl", "net", "csv", "match", "match-text", "gcp", "nvm"])


@click.command(short_help="Convert control networks and tie points: ISIS, Ames Stereo Pipeline, tables.")
@click.argument("inputs", type=_PATH, nargs=-1, required=True, metavar="IN...")
@click.argument("output", type=_PATH, metavar="OUT")
@click.option("--from", "read_as", type=_FORMATS, help="Format of all IN; by their endings when absent.")
@click.option("--to", "write_as", type=_FORMATS, help="Format of OUT; by its ending when absent.")
@click.option("--case", type=_PATH, help="A case file, for the names and sizes of its images and for the ellipsoid.")
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
@click.option("--replace", is_flag=True, help="Overwrite OUT, though of the format of one of IN.")
@click.option("--strict", is_flag=True, help="Write nothing (exit status 2) if OUT can't hold all that IN do.")
def convert(
    inputs: tuple[Path, ...],
    output: Path,
    read_as: str | None,
    write_as: str | None,
    case: Path | None,
    sizes: tuple[str, ...],
    radii: tuple[float, float] | None,
    target: str,
    rename: tuple[str, ...],
    prefix: str | None,
    nvm_no_shift: bool,
    replace: bool,
    strict: bool,
) -> None:
    """Read IN... as one network and write it to OUT, each in the format of its ending: .pvl and .net (ISIS), .csv,
    .match and .txt (matches of the Ames Stereo Pipeline; OUT is then what the files' names begin with, and there is one
    for each pair of images), .gcp and .nvm.

    Says what was written and, one line each, what the format can't hold. Pixels are counted as each format counts them:
    see docs/exchange.md.

    Exit status: 0, or 2 for bad input, and with --strict for a format that can't hold all.
    """
    from mgsgraph.export.exchange import Lossy
    from mgsgraph.export.exchange import convert as make
    from mgsgraph.export.exchange_setting import setting_of

    setting = setting_of(case, sizes, radii, target, rename, prefix, not nvm_no_shift)
    try:
        made = make(
            inputs, output, setting, read_as=read_as, write_as=write_as, strict=strict, replace=replace
        )
    except Lossy as error:
        _tell_lost(error.lost)
        raise
    for note in made.notes:
        click.echo(f"- {note}")
    for path in made.written:
        click.echo(f"Wrote {path}")
    _tell_lost(made.lost)


def _tell_lost(lost: tuple[str, ...]) -> None:
    for line in lost:
        click.echo(f"- Not held: {line}")

"""The verb that finds laser shots over images."""

from pathlib import Path

import click

from mgsgraph.cli.options import PATH, print_sentences


@click.command()
@click.argument("files", type=PATH, nargs=-1, required=True, metavar="FILES...")
@click.option("--case", type=PATH, required=True, metavar="CASE|RESULT", help="Whose images; a project's, too.")
@click.option("--image", "names", multiple=True, metavar="NAME",
    help="One image alone, by its name or a part of it that no other has; may be repeated.")
@click.option(
    "--dates", type=(str, str), metavar="FROM TO", help="UTC, as 2010-05-10 or 2010-05-10T06:30; both days included."
)
@click.option(
    "--quality", type=click.Choice(["ground", "all"]), default="ground", show_default=True,
    help="Returns from the ground, or those too that the archive marks as noise or clouds.",
)  # fmt: skip
@click.option("--off-nadir", type=float, metavar="DEG", help="No shots farther off nadir, nor where it is not known.")
@click.option("--margin", type=click.FloatRange(0.0), default=0.0, help="Pixels a shot may lie beside an image.")
@click.option("--along", is_flag=True, help="Shots alone that were fired while an image was taken in which they fall.")
@click.option("--version", metavar="LETTER", help="Of a PEDR product, where its name doesn't say.")
@click.option("--out", type=PATH, metavar="CSV", help="File for the selection, which a case takes as [[shots]] file.")
def shots(
    files: tuple[Path, ...], case: Path, names: tuple[str, ...], dates: tuple[str, str] | None, quality: str,
    off_nadir: float | None, margin: float, along: bool, version: str | None, out: Path | None,
) -> None:
    """Find the laser shots of FILES that fall in images, profile by profile, and those taken along with an image.

    FILES are of one altimeter: MOLA PEDR, LOLA RDR, MLA RDR, Kaguya LALT, or earlier selections. Footprints are
    projected with the nominal orientation of CASE, or the adjusted one of RESULT: an image whose orientation is 300 m
    off finds its shots 300 m off.

    Exit status: 0, with shots found or none; 2 bad input, and nothing is written.
    """
    from mgsgraph.files.writing import fresh_file, require_free
    from mgsgraph.project.oriented import oriented_images
    from mgsgraph.project.shot_search import ShotChoice, search_shots
    from mgsgraph.results.crossings import SELECTION, crossing_sentences, crossings_table, selection_table

    if out is not None:
        require_free(out, SELECTION)
    choice = ShotChoice(dates, quality == "ground", off_nadir, margin, along, version)
    seen = oriented_images(case, names)
    over = search_shots(files, seen, choice)
    found = over.crossings()
    for line in crossings_table(found).text(units=True) if found else ():
        click.echo(line)
    print_sentences([*([seen.warning] if seen.warning else []), *crossing_sentences(over, found)])
    if out is not None and not over.chosen.size:
        click.echo("Nothing is written: there is no shot to be written.")
    elif out is not None:
        with fresh_file(out, over=SELECTION) as aside:
            selection_table(over).write_csv(aside)
        click.echo(f"The selection is in {out}")

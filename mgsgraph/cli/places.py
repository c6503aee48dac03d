"""Verbs between ground and image: coordinates, and footprints of laser shots."""

import sys
from pathlib import Path
from typing import TYPE_CHECKING

import click

from mgsgraph.cli.options import (
    CASE,
    DETAILS,
    NO_FIGURES,
    PATH,
    TIES,
    folder_for,
    print_brief,
    print_ended,
    print_sentences,
)

if TYPE_CHECKING:
    from mgsgraph.files.place_table import Sort
    from mgsgraph.project.reading import ShotChoice


@click.command()
@click.argument("source", type=PATH, metavar="CASE|RESULT|PROJECT")
@click.argument("image")
@click.option("--points", type=PATH, metavar="CSV", help="Coordinates to convert; see below for its columns.")
@click.option("--into", type=click.Choice(["image", "ground"]), help="Where to, of a CSV with columns of both.")
@click.option(
    "--pixel", "pixels", type=(float, float), multiple=True, metavar="LINE SAMPLE",
    help="A pixel to project onto the ground; may be repeated. The first pixel's centre is at 0.5 (--isis: 1).",
)  # fmt: skip
@click.option(
    "--ground", "places", type=(float, float), multiple=True, metavar="LONGITUDE LATITUDE",
    help="A ground point to project into the image, planetocentric degrees, east; may be repeated.",
)  # fmt: skip
@click.option("--isis", is_flag=True, help="Count lines and samples from 1, at the first pixel's centre.")
@click.option("--height", type=float, metavar="M", help="Of the ground above the ellipsoid.")
@click.option("--radius", type=float, metavar="M", help="Of the ground from the body's centre.")
@click.option("--terrain", type=PATH, metavar="FILE", help="Terrain model; that of CASE or RESULT when absent.")
@click.option("--reference-radius", type=float, metavar="M", help="Above which a GeoTIFF's heights are.")
@click.option("--ellipsoid", is_flag=True, help="The ellipsoid, also where CASE or RESULT has a terrain model.")
@click.option("--out", type=PATH, help="CSV file for the result, over an earlier one; the screen when absent.")
def locate(
    source: Path, image: str, points: Path | None, into: "Sort | None", pixels: tuple[tuple[float, float], ...],
    places: tuple[tuple[float, float], ...], isis: bool, height: float | None, radius: float | None,
    terrain: Path | None, reference_radius: float | None, ellipsoid: bool, out: Path | None,
) -> None:
    """Project ground points into IMAGE, or pixels of IMAGE onto the ground: the terrain model of CASE or RESULT if it
    has one, else the height of RESULT's adjusted points about each place; `height_from` says which. The orientation is
    the adjusted one of RESULT or PROJECT, the nominal one of CASE; of the former there are sigmas, with that of the
    height, and numbers have two digits of theirs. IMAGE may be a part of a name that no other image has.

    Columns of the CSV: isis_line and isis_sample (the first pixel's centre is (1, 1)) or line and sample (it is (0.5,
    0.5)), perhaps with height_m or radius_m of their ground; or x_m, y_m, z_m; longitude_deg, latitude_deg, radius_m;
    longitude_deg, geodetic_latitude_deg, height_m; longitude_deg, latitude_deg. The result has all columns of the CSV,
    and places that IMAGE doesn't show are marked in its column `state`, not left out. Where there is a terrain model,
    its relief may hide ground places, too, that have a height of their own; those beneath it are taken to lie on it.

    Exit status: 0, wherever the places are; 2 bad input, or neither a height nor anything to take it from.
    """
    import numpy as np

    from mgsgraph.errors import InputError
    from mgsgraph.files.place_table import PlaceTable, read_places
    from mgsgraph.files.writing import fresh_file, require_free
    from mgsgraph.project.reading import open_view
    from mgsgraph.results.places import PLACES, Surface, places_text, project_places

    if sum(map(bool, (points, pixels, places))) != 1:
        raise click.UsageError("one of --points CSV, --pixel LINE SAMPLE, --ground LONGITUDE LATITUDE")
    if sum((height is not None, radius is not None, terrain is not None, ellipsoid)) > 1:
        raise click.UsageError("one of --height, --radius, --terrain and --ellipsoid")
    if reference_radius is not None and terrain is None:
        raise click.UsageError("--reference-radius is of --terrain FILE")
    if into is not None and points is None:
        raise click.UsageError("--into is of --points CSV")
    if out is not None:
        require_free(out, PLACES)
    surface = terrain if terrain is not None else not (ellipsoid or height is not None or radius is not None)
    view, grid, warning = open_view(source, image, surface, reference_radius)
    if points is not None:
        inputs = read_places(points, view.image.body, into and ("ground" if into == "image" else "image"))
        if isis and inputs.sort == "image" and not inputs.isis:
            raise InputError(
                str(points), "the columns line and sample, which count from 0.5, beside --isis", "one count",
                "leave --isis out, or name them isis_line and isis_sample",
            )  # fmt: skip
    else:
        inputs = PlaceTable.of_pixels(np.array(pixels), isis) if pixels else PlaceTable.of_surface(np.array(places))
    ground = Surface(grid, radius, 0.0 if ellipsoid else height)
    table, sentence = project_places(view, inputs, ground, isis or bool(inputs.isis))
    if warning:
        click.echo(f"- {warning}", err=True)
    if out is not None:
        with fresh_file(out, over=PLACES) as path:
            table.write_csv(path)
        click.echo(f"- {sentence}")
        click.echo(f"The places are in {out}")
    elif points is not None:
        table.write_csv(sys.stdout)
        click.echo(f"- {sentence}", err=True)
    else:
        click.echo("\n".join(places_text(table)))


@click.command()
@click.argument("source", type=PATH, metavar="CASE|RESULT|PROJECT")
@click.argument("files", type=PATH, nargs=-1, metavar="[FILES...]")
@CASE
@click.option("--image", "names", multiple=True, metavar="IMAGE", help="Of FILES: this image alone; may be repeated.")
@click.option(
    "--dates", type=(str, str), metavar="FROM TO",
    help="Of FILES: UTC, as 2010-05-10 or 2010-05-10T06:30; both days included.",
)  # fmt: skip
@click.option(
    "--quality", type=click.Choice(["ground", "all"]), default="ground", show_default=True,
    help="Of FILES: returns from the ground, or those too that the archive marks as noise or clouds.",
)  # fmt: skip
@click.option(
    "--off-nadir", type=float, metavar="DEG", help="Of FILES: no shots farther off nadir, nor where it is not known."
)
@click.option("--margin", type=click.FloatRange(0.0), default=0.0, help="Of FILES: pixels that they may lie beside.")
@click.option("--along", is_flag=True, help="Of FILES: only shots fired while an image was taken in which they fall.")
@click.option("--version", metavar="LETTER", help="Of a PEDR product, where its name doesn't say.")
@click.option(
    "--out", type=PATH,
    help="Folder for the results; made anew.  [default: NAME-footprints] With FILES: CSV file for the selection, which "
    "a case takes as [[shots]] file; none when absent.",
)  # fmt: skip
@TIES
@NO_FIGURES
@DETAILS
def footprints(
    source: Path, files: tuple[Path, ...], of_case: Path | None, names: tuple[str, ...], dates: tuple[str, str] | None,
    quality: str, off_nadir: float | None, margin: float, along: bool, version: str | None, out: Path | None,
    ties: Path | None, no_figures: bool,
) -> None:  # fmt: skip
    """Project the footprints of a case's laser profiles into its images, and compare the images at them; or, with
    FILES, find the laser shots of FILES that fall in the images.

    The orientation is the nominal one of CASE, or the adjusted one of RESULT or PROJECT: an image whose orientation is
    300 m off finds its shots 300 m off.

    Without FILES, OUT holds registration.json, registration.csv (each shot in each image), discrepancy.csv (by how much
    two images contradict each other about each footprint) and figures with numbered footprints.

    FILES are of one altimeter: MOLA PEDR, LOLA RDR, MLA RDR, Kaguya LALT, or earlier selections. Shots are listed
    profile by profile, with those taken along with an image.

    Exit status: 0, with shots found or none; 2 bad input, and nothing is written.
    """
    from mgsgraph.project.reading import ShotChoice

    choice = ShotChoice(dates, quality == "ground", off_nadir, margin, along, version)
    if files and (of_case, ties, no_figures) != (None, None, False):
        raise click.UsageError("--case, --ties and --no-figures go without FILES of laser shots")
    if files:
        _find_shots(source, files, names, choice, out)
    elif names or choice != ShotChoice():
        raise click.UsageError("--image, --dates, --quality, --off-nadir, --margin, --along, --version go with FILES")
    else:
        _register(source, of_case, folder_for(out, source, "footprints"), ties, not no_figures)


def _register(source: Path, case: Path | None, out: Path, ties: Path | None, figures: bool) -> None:
    """Register the laser profiles of a case by projection; write and print the results."""
    from mgsgraph.case.reading import read_case
    from mgsgraph.cli.progress import stage
    from mgsgraph.files.output.folders import REGISTRATION, require_replaceable
    from mgsgraph.project.reading import case_with_results
    from mgsgraph.registration.case import register_case
    from mgsgraph.results.archive import read_solution
    from mgsgraph.results.registration import registration_section, write_registration

    require_replaceable(out, REGISTRATION)
    source_files = case_with_results(source, case)
    adjusted = None if source_files.folder is None else read_solution(source_files.folder)
    with stage("projecting shots"):
        registration = register_case(read_case(source_files.case, ties=ties or source_files.ties), adjusted)
        write_registration(registration, out, figures=figures)
    print_brief(registration_section(registration).text(None))
    print_ended(f"Results are in {out}")


def _find_shots(
    source: Path, files: tuple[Path, ...], names: tuple[str, ...], choice: "ShotChoice", out: Path | None
) -> None:
    """Find the shots of files in the images; print and write them."""
    from mgsgraph.files.writing import fresh_file, require_free
    from mgsgraph.network.footprints import crossings
    from mgsgraph.project.reading import oriented_images, search_shots
    from mgsgraph.results.places import SELECTION, crossings_section, selection_table

    if out is not None:
        require_free(out, SELECTION)
    oriented = oriented_images(source, names)
    registration = search_shots(files, oriented, choice)
    print_sentences(oriented.warning)
    print_brief(crossings_section(registration, crossings(registration)).text(None), more=2)
    if out is not None and not registration.chosen.size:
        click.echo("Nothing is written: there is no shot to be written.")
    elif out is not None:
        with fresh_file(out, over=SELECTION) as temporary:
            selection_table(registration).write_csv(temporary)
        click.echo(f"The selection is in {out}")

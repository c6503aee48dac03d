"""The verb that projects: ground places into an image, image places onto the ground."""

import sys
from pathlib import Path
from typing import TYPE_CHECKING

import click

from mgsgraph.cli.options import PATH

if TYPE_CHECKING:
    from mgsgraph.files.place_table import Sort


@click.command()
@click.argument("source", type=PATH, metavar="CASE|RESULT|PROJECT")
@click.argument("image")
@click.option("--points", type=PATH, metavar="CSV", help="Places to project; see below for its columns.")
@click.option("--into", type=click.Choice(["image", "ground"]), help="Where to, of a CSV with places of both sorts.")
@click.option(
    "--pixel", "pixels", type=(float, float), multiple=True, metavar="LINE SAMPLE",
    help="An image place to project onto the ground; may be repeated. The first pixel's centre is at 0.5 (--isis: 1).",
)  # fmt: skip
@click.option(
    "--place", "places", type=(float, float), multiple=True, metavar="LONGITUDE LATITUDE",
    help="A ground place to project into the image, planetocentric degrees, east; may be repeated.",
)  # fmt: skip
@click.option("--isis", is_flag=True, help="Count lines and samples from 1, at the first pixel's centre.")
@click.option("--height", type=float, metavar="M", help="Of the ground above the ellipsoid.  [default: 0]")
@click.option("--radius", type=float, metavar="M", help="Of the ground from the body's centre.")
@click.option("--terrain", type=PATH, metavar="FILE", help="Terrain model; that of CASE or RESULT when absent.")
@click.option("--reference-radius", type=float, metavar="M", help="Above which a GeoTIFF's heights are.")
@click.option("--ellipsoid", is_flag=True, help="The ellipsoid, also where CASE or RESULT has a terrain model.")
@click.option("--out", type=PATH, help="CSV file for the result, over an earlier one; the screen when absent.")
def project(
    source: Path, image: str, points: Path | None, into: "Sort | None", pixels: tuple[tuple[float, float], ...],
    places: tuple[tuple[float, float], ...], isis: bool, height: float | None, radius: float | None,
    terrain: Path | None, reference_radius: float | None, ellipsoid: bool, out: Path | None,
) -> None:
    """Project ground places into IMAGE, or places in IMAGE onto the ground: the terrain model of CASE or RESULT if it
    has one, a sphere or the ellipsoid else. The orientation is the adjusted one of RESULT (with sigmas, from its
    covariance) or PROJECT, the nominal one of CASE. IMAGE may be a part of a name that no other image has.

    Columns of the CSV: isis_line and isis_sample (the first pixel's centre is (1, 1)) or line and sample (it is (0.5,
    0.5)), perhaps with height_m or radius_m of their ground; or x_m, y_m, z_m; longitude_deg, latitude_deg, radius_m;
    longitude_deg, geodetic_latitude_deg, height_m; longitude_deg, latitude_deg. The result has all columns of the CSV,
    and places that IMAGE doesn't show are marked in its column `state`, not left out. Where there is a terrain model,
    its relief may hide ground places, too, that have a height of their own; those beneath it are taken to lie on it.

    Exit status: 0, wherever the places are; 2 bad input.
    """
    import numpy as np

    from mgsgraph.errors import InputError
    from mgsgraph.files.place_table import PlaceTable, read_places
    from mgsgraph.files.writing import fresh_file, require_free
    from mgsgraph.project.views import open_view
    from mgsgraph.results.places import PLACES, Surface, places_text, project_places

    if sum(map(bool, (points, pixels, places))) != 1:
        raise click.UsageError("one of --points CSV, --pixel LINE SAMPLE, --place LONGITUDE LATITUDE")
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
        given = read_places(points, view.image.body, into and ("ground" if into == "image" else "image"))
        if isis and given.sort == "image" and not given.isis:
            raise InputError(
                str(points), "the columns line and sample, which count from 0.5, beside --isis", "one count",
                "leave --isis out, or name them isis_line and isis_sample",
            )  # fmt: skip
    else:
        given = PlaceTable.of_pixels(np.array(pixels), isis) if pixels else PlaceTable.of_surface(np.array(places))
    table, said = project_places(view, given, Surface(grid, radius, height or 0.0), isis or bool(given.isis))
    if warning:
        click.echo(f"- {warning}", err=True)
    if out is not None:
        with fresh_file(out, over=PLACES) as path:
            table.write_csv(path)
        click.echo(f"- {said}")
        click.echo(f"The places are in {out}")
    elif points is not None:
        table.write_csv(sys.stdout)
        click.echo(f"- {said}", err=True)
    else:
        click.echo("\n".join(places_text(table)))

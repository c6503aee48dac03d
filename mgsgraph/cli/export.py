"""`mgsgraph export`: a solution for other programs."""

from pathlib import Path

import click

_PATH = click.Path(path_type=Path)


@click.command(short_help="Write a solution for SPICE, CSM, ISIS, ASP or GIS.")
@click.argument("solution", type=_PATH)
@click.option(
    "--to", "target", type=click.Choice(["spice", "csm", "isis", "asp", "gis"]), required=True, help="For whom."
)
@click.option("--out", type=_PATH, required=True, help="Folder for the files; made anew.")
@click.option("--scaled", is_flag=True, help="Covariances times sigma0 squared, as jigsaw's; else for sigma0 = 1.")
@click.option("--case", type=_PATH, help="The case, for what its image support data say besides geometry (csm, asp).")
@click.option("--raster", is_flag=True, help="Sigmas of new points over the overlap as well, a GeoTIFF (gis).")
def export(solution: Path, target: str, out: Path, scaled: bool, case: Path | None, raster: bool) -> None:
    """Write SOLUTION (results, or a project) for another program, read the files back and say how far they are off.

    spice: SPK, CK, their frames, clock and camera, and a meta-kernel. csm: image support data and model states of
    usgscsm. isis: control network with adjusted points, lidar data, jigsaw's tables. asp: matches, control points,
    cameras. gis: a GeoPackage, and with --raster a GeoTIFF.
    """
    from mgsgraph.export.export import ExportSettings, export_solution
    from mgsgraph.project.reading import results_of

    support = None
    if case is not None:
        from mgsgraph.case.schema import decode
        from mgsgraph.errors import InputError

        support = {image.name: case.parent / image.isd for image in decode(case).images if image.isd is not None}
        if not support:
            raise InputError(str(case), "no image with support data (isd)", "some to take over", "leave --case out")
    results = results_of(solution)
    done = export_solution(results.folder, target, out, ExportSettings(scaled, support, raster))
    for sentence in filter(None, (results.warning, done.statement)):
        click.echo(f"- {sentence}")
    click.echo(f"The files are in {out}")

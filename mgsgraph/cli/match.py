"""`mgsgraph match`: tie points from the images themselves."""

from pathlib import Path
from typing import TYPE_CHECKING

import click

if TYPE_CHECKING:
    from mgsgraph.matching.settings import MatchSettings

_PATH = click.Path(path_type=Path)


@click.command(short_help="Find tie points in the images.")
@click.argument("case", type=_PATH)
@click.option("--out", type=_PATH, help="Folder for the networks, tables and figure; made anew. A project has its own.")
@click.option(
    "--method", type=click.Choice(["sift", "grid"]), default="sift", show_default=True,
    help="At distinct features, or at the nodes of a regular grid.",
)  # fmt: skip
@click.option("--step", type=float, metavar="M", help="Pixel of the common ground grid; as the coarsest image's.")
@click.option("--spacing", type=float, metavar="M", help="Between nodes of the regular grid.")
@click.option(
    "--search", type=float, metavar="M",
    help="By how much the nominal orientations may contradict each other on the ground; three a-priori sigmas.",
)  # fmt: skip
@click.option("--height", type=float, metavar="M", help="Of the ground above the ellipsoid, without a terrain model.")
@click.option("--height-sigma", type=float, metavar="M", help="By how much the ground may be higher or lower.")
@click.option("--cells", type=int, default=250, show_default=True, help="Into which an overlap is divided, about.")
@click.option("--per-cell", type=int, default=2, show_default=True, help="Matches kept in each.")
@click.option("--workers", type=click.IntRange(1), help="Tiles at a time; one per processor when absent.")
@click.option("--no-figures", is_flag=True, help="Write networks and tables only.")
def match(
    case: Path, out: Path | None, method: str, step: float | None, spacing: float | None, search: float | None,
    height: float | None, height_sigma: float | None, cells: int, per_cell: int, workers: int | None, no_figures: bool,
) -> None:
    """Find tie points in the overlapping images of CASE, whose own ties are not looked at.

    CASE may also be a project whose images wait for tie points: they go into it, with all that its case names besides.

    Images are resampled to one ground grid on the terrain, features matched where orientation and heights say, and
    every match measured by least squares in the images themselves, with its covariance. Use the result with
    `mgsgraph adjust CASE --ties OUT/network.pvl`. An interrupted run goes on where it was.
    """
    from mgsgraph.errors import InputError
    from mgsgraph.matching.settings import MatchSettings, method_of
    from mgsgraph.project.changes import take_ties, waiting_case
    from mgsgraph.project.connection import FILE
    from mgsgraph.project.project import open_project

    settings = MatchSettings(
        method=method_of(method), step=step, spacing=spacing, search=search, cells=cells, per_cell=per_cell
    )
    project: Path | None = None
    if (case / FILE).is_file():
        if out is not None:
            raise click.UsageError("--out is for a case: a project keeps its tie points itself")
        with open_project(project := case) as opened:
            case, out = waiting_case(opened), opened.matches
    if out is None:
        if not case.is_file():
            raise InputError(str(case), "neither a case file nor a project", "one of the two", "check the path")
        raise click.UsageError("Missing option '--out'")
    _match(case, out, settings, height, height_sigma, workers, not no_figures)
    if project is not None:
        with open_project(project, write=True) as opened:
            words = take_ties(opened, out / "network.pvl")
        click.echo(f"{project}: {words}; nothing is adjusted yet")
        click.echo(f"Next: mgsgraph solve {project}")


def _match(
    case: Path, out: Path, settings: "MatchSettings", height: float | None, height_sigma: float | None,
    workers: int | None, figures: bool,
) -> None:
    """Match the images of a case, write what was found, and say it."""
    from mgsgraph.case.scene import read_scene
    from mgsgraph.cli.progress import counting_bars
    from mgsgraph.matching.files import match_into, match_statements
    from mgsgraph.output.folders import MATCH, require_replaceable

    require_replaceable(out, MATCH)
    name, scene = read_scene(case, height, height_sigma)
    try:
        with counting_bars() as show:
            matches = match_into(name, scene, out, settings, workers, figures, show)
    except KeyboardInterrupt:
        click.echo("mgsgraph: interrupted; tiles that are done are kept, the same command goes on", err=True)
        raise click.exceptions.Exit(130) from None
    for sentence in match_statements(matches, scene):
        click.echo(f"- {sentence}")
    click.echo(f"The network is {out / 'network.pvl'}")

"""`mgsgraph analyze`: questions to the covariance of an adjustment."""

from pathlib import Path

import click

_PATH = click.Path(path_type=Path)
_SUMMARY = 10
"""Rows of the table by suspicion when nothing in particular is asked."""
_WEAK = 5


@click.command(short_help="Ask the covariance of an adjustment.")
@click.argument("adjusted", type=_PATH, metavar="SOLUTION_OR_PROJECT")
@click.option("--point", "points", multiple=True, metavar="NAME", help="Sigmas and error ellipsoid of a ground point.")
@click.option(
    "--pair", "pairs", multiple=True, type=(str, str), metavar="NAME NAME",
    help="Two ground points: is their height difference real?",
)  # fmt: skip
@click.option(
    "--pose", "poses", multiple=True, type=(str, float), metavar="IMAGE LINE", help="Orientation of an image at a line."
)
@click.option(
    "--poses", "pose_pairs", multiple=True, type=(str, float, str, float), metavar="IMAGE LINE IMAGE LINE",
    help="One image's orientation against another's.",
)  # fmt: skip
@click.option(
    "--projection", "projections", multiple=True, type=(str, str), metavar="NAME IMAGE",
    help="Where a ground point falls in an image.",
)  # fmt: skip
@click.option(
    "--pixel", "pixels", multiple=True, type=(str, float, float), metavar="IMAGE LINE SAMPLE",
    help="Measures of a new point, two or more: its place and sigmas. The first pixel's centre is at 0.5 (ISIS: 1).",
)  # fmt: skip
@click.option("--correlations", is_flag=True, help="Correlations between everything that was asked about.")
@click.option("--probability", type=float, help="Of error ellipsoids (--point, --pixel); 0.95 when absent.")
@click.option("--curve", "curves", multiple=True, metavar="IMAGE", help="Sigmas along an image's lines.")
@click.option("--raster", is_flag=True, help="Sigmas of new points over the images' overlap, a GeoTIFF in --out.")
@click.option("--image", "images", multiple=True, metavar="IMAGE", help="Images of the raster, two or more; else all.")
@click.option("--cell-m", type=float, help="Side of the raster's cells.")
@click.option("--sigma-px", type=float, help="Of the measures of new points (--pixel, --raster); 1 when absent.")
@click.option("--components", is_flag=True, help="Are the sigmas honest? Global test, variance components, residuals.")
@click.option("--iterate", is_flag=True, help="Variance components until they come to rest: adjusts again and again.")
@click.option(
    "--reliability", type=click.IntRange(1), metavar="N", help="Redundancy and tests of all measures, N worst shown."
)
@click.option("--snoop", is_flag=True, help="Adjust again without what data snooping finds.")
@click.option("--alpha", type=float, help="Baarda's level, share of false alarms; 0.001 when absent.")
@click.option("--power", type=float, help="Share of minimal detectable blunders that are found; 0.8 when absent.")
@click.option("--weak", type=click.IntRange(1), metavar="N", help="N directions of which least was learnt, in words.")
@click.option("--out", type=_PATH, help="Folder for analysis.json, tables and figures; made anew.")
@click.option("--no-figures", is_flag=True, help="Write tables only.")
def analyze(
    adjusted: Path,
    points: tuple[str, ...],
    pairs: tuple[tuple[str, str], ...],
    poses: tuple[tuple[str, float], ...],
    pose_pairs: tuple[tuple[str, float, str, float], ...],
    projections: tuple[tuple[str, str], ...],
    pixels: tuple[tuple[str, float, float], ...],
    correlations: bool,
    probability: float | None,
    curves: tuple[str, ...],
    raster: bool,
    images: tuple[str, ...],
    cell_m: float | None,
    sigma_px: float | None,
    components: bool,
    iterate: bool,
    reliability: int | None,
    snoop: bool,
    alpha: float | None,
    power: float | None,
    weak: int | None,
    out: Path | None,
    no_figures: bool,
) -> None:
    """Ask the covariance of SOLUTION_OR_PROJECT (results of `mgsgraph adjust`, or a project).

    Without a question: the global test, variance components, the most suspicious measures, and what is weak. Sigmas
    are for sigma0 = 1, as the a-priori sigmas imply. Nothing of what is asked is changed.

    Exit status: 0, also where tests fail; 2 bad input.
    """
    from mgsgraph.analysis.measures import Levels
    from mgsgraph.analysis.posterior import Pixel
    from mgsgraph.output.folders import ANALYSIS, require_replaceable
    from mgsgraph.project.reading import read_posterior
    from mgsgraph.reports.analysis import Wanted, analysed, require_used, write_analysis
    from mgsgraph.reports.answers import Questions

    if out is not None:
        require_replaceable(out, ANALYSIS)
    nothing = not (points or pairs or poses or pose_pairs or projections or pixels or curves or raster or components
                   or iterate or reliability or snoop or weak)  # fmt: skip
    tested = nothing or bool(reliability) or snoop
    require_used("--image, --cell-m", bool(images) or cell_m is not None, raster, "--raster")
    require_used("--raster", raster, out is not None, "--out FOLDER, for the GeoTIFF")
    require_used("--correlations", correlations, bool(points or pairs or poses or pose_pairs or projections or pixels),
                 "question (--point, --pose, ...)")  # fmt: skip
    require_used("--probability", probability is not None, bool(points or pixels), "--point or --pixel")
    require_used("--sigma-px", sigma_px is not None, bool(pixels) or raster, "--pixel or --raster")
    require_used("--alpha, --power", alpha is not None or power is not None, tested, "--reliability or --snoop")
    require_used("--no-figures", no_figures, out is not None, "--out FOLDER")
    sigma = 1.0 if sigma_px is None else sigma_px
    questions = Questions(
        points, pairs, poses, pose_pairs, projections, tuple(Pixel(*pixel, sigma) for pixel in pixels),
        correlations, 0.95 if probability is None else probability,
    )  # fmt: skip
    wanted = Wanted(
        questions, curves, images if raster else None, cell_m, sigma, components or iterate or nothing, iterate,
        reliability or (_SUMMARY if nothing else 0), snoop, weak or (_WEAK if nothing else 0),
        Levels(0.001 if alpha is None else alpha, 0.8 if power is None else power),
    )  # fmt: skip
    name, posterior, warning = read_posterior(adjusted)
    if warning:
        click.echo(f"- {warning}")
    if out is None:
        for section in analysed(posterior, wanted, name):
            click.echo(section.text)
        return
    sections = list(analysed(posterior, wanted, name))
    write_analysis(name, sections, out, figures=not no_figures)  # before anything is said: a reader may go away
    for section in sections:
        click.echo(section.text)
    click.echo(f"The analysis is in {out}")

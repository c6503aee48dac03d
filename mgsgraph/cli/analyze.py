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
    help="Measures of a new point, two or more: its place and sigmas.",
)  # fmt: skip
@click.option("--correlations", is_flag=True, help="Correlations between everything that was asked about.")
@click.option(
    "--probability", type=click.FloatRange(0.0, 1.0, min_open=True, max_open=True), default=0.95, show_default=True,
    help="Of error ellipsoids.",
)  # fmt: skip
@click.option("--curve", "curves", multiple=True, metavar="IMAGE", help="Sigmas along an image's lines.")
@click.option("--raster", is_flag=True, help="Sigmas of new points over the images' overlap, a GeoTIFF in --out.")
@click.option("--image", "images", multiple=True, metavar="IMAGE", help="Images of the raster, two or more; else all.")
@click.option("--cell-m", type=click.FloatRange(0.0, min_open=True), help="Side of the raster's cells.")
@click.option(
    "--sigma-px", type=click.FloatRange(0.0, min_open=True), default=1.0, show_default=True,
    help="Of the measures of new points (--pixel, --raster).",
)  # fmt: skip
@click.option("--components", is_flag=True, help="Are the sigmas honest? Global test, variance components, residuals.")
@click.option("--iterate", is_flag=True, help="Variance components until they come to rest: adjusts again and again.")
@click.option(
    "--reliability", type=click.IntRange(1), metavar="N", help="Redundancy and tests of all measures, N worst shown."
)
@click.option("--snoop", is_flag=True, help="Adjust again without what data snooping finds.")
@click.option("--alpha", type=float, default=0.001, show_default=True, help="Baarda's level: share of false alarms.")
@click.option("--power", type=float, default=0.8, show_default=True, help="Share of blunders that are found.")
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
    probability: float,
    curves: tuple[str, ...],
    raster: bool,
    images: tuple[str, ...],
    cell_m: float | None,
    sigma_px: float,
    components: bool,
    iterate: bool,
    reliability: int | None,
    snoop: bool,
    alpha: float,
    power: float,
    weak: int | None,
    out: Path | None,
    no_figures: bool,
) -> None:
    """Ask the covariance of SOLUTION_OR_PROJECT (results of `mgsgraph adjust`, or a project).

    Without a question: the global test, variance components, the most suspicious measures, and what is weak. Sigmas
    are for sigma0 = 1, as the a-priori sigmas imply. Nothing of what is asked is changed.

    Exit status: 0, also where tests fail; 2 bad input.
    """
    from dataclasses import replace

    from mgsgraph.adjustment.analysis.levels import Levels
    from mgsgraph.adjustment.analysis.posterior import Pixel
    from mgsgraph.errors import InputError
    from mgsgraph.products.analysis import Wanted, analysed, write_analysis
    from mgsgraph.products.answers import Questions
    from mgsgraph.products.atomic import ANALYSIS, require_replaceable
    from mgsgraph.project.standing import read_posterior

    if out is not None:
        require_replaceable(out, ANALYSIS)
    if (images or cell_m is not None) and not raster:
        raise InputError("--image, --cell-m", "no --raster", "both", "add --raster")
    if raster and out is None:
        raise InputError("--raster", "no folder for the GeoTIFF", "--out FOLDER")
    questions = Questions(
        points, pairs, poses, pose_pairs, projections, tuple(Pixel(*pixel, sigma_px) for pixel in pixels),
        correlations, probability,
    )  # fmt: skip
    if correlations and not questions:
        raise InputError("--correlations", "nothing to correlate", "points, poses or places that are asked about")
    wanted = Wanted(
        questions, curves, images if raster else None, cell_m, sigma_px, components, iterate, reliability or 0, snoop,
        weak or 0, Levels(alpha, power),
    )  # fmt: skip
    if wanted.nothing:
        wanted = replace(wanted, honesty=True, suspects=_SUMMARY, weak=_WEAK)
    name, posterior, warning = read_posterior(adjusted)
    if warning:
        click.echo(f"- {warning}")
    sections = []
    for section in analysed(posterior, wanted, name):
        click.echo(section.text)
        sections.append(section)
    if out is not None:
        write_analysis(name, sections, out, figures=not no_figures)
        click.echo(f"The analysis is in {out}")

"""An adjustment in at most fifteen lines: the verdict, sigmas of the points, the fit, and what was not tested."""

import math
from collections.abc import Iterator

import numpy as np

from mgsgraph.adjustment.solution import Solution
from mgsgraph.analysis.geometry_checks import convergence
from mgsgraph.analysis.statistics import local_sigmas, range_statistics, ray_statistics
from mgsgraph.analysis.verdict import verdict
from mgsgraph.geometry.records import Array, Index
from mgsgraph.network import Network, PointClass
from mgsgraph.results.ground import laser_section, left_out
from mgsgraph.results.verdict import headline, linearity_section, reason_sentences, tested_sentences
from mgsgraph.text import length, many, root_mean_square, two
from mgsgraph.units import DEG, KM

_FLAT = 5.0 * DEG
"""Convergence of rays below which heights are poorly known."""
_UNKNOWN = 1.0 * KM
"""Median sigma of heights from which on no height is known: a body's relief is hardly larger."""
_WORST = 1
"""Possible errors of each sort that are named; --details names all."""
_CAUTIOUS, _MANY = 0.5, 20
"""sigma0 below which, and degrees of freedom from which on, stated sigmas are too large."""
_MOST_POINTS = 20_000
"""Points whose rays are intersected anew."""


def summary(solution: Solution) -> list[str]:
    """Lines for the terminal."""
    found = verdict(solution)
    said = [*reason_sentences(found.reasons), *_points(solution), *_figures(solution), *left_out(solution)]
    if solution.linearity is not None and not solution.linearity.linear:
        said += linearity_section(solution.linearity).sentences
    if solution.minima is not None and solution.minima.several:
        said.append(f"{len(solution.minima.each)} minima were found: sigmas are those of their mixture.")
    said += laser_section(solution, brief=True).sentences
    said += tested_sentences(found, solution, _WORST)
    return [f"{headline(solution)} ({many(solution.iterations, 'iteration')})", *(f"- {one}" for one in said)]


def _figures(solution: Solution) -> Iterator[str]:
    """Cost and sigma0; how many observations, and how they fit."""
    network, fit = solution.network, solution.fit
    sigma0 = f"sigma0 {fit.sigma0:.3g}" if math.isfinite(fit.sigma0) else "no sigma0"
    small = fit.sigma0 < _CAUTIOUS and fit.degrees_of_freedom > _MANY
    remark = f"; residuals are {two(1.0 / fit.sigma0)} times smaller than stated" if small else ""
    yield (
        f"Fit: {sigma0} ({many(fit.degrees_of_freedom, 'degree')} of freedom), cost {solution.cost_initial:.3g} -> "
        f"{solution.cost_final:.3g}{remark}."
    )
    rays, ranges = ray_statistics(solution), range_statistics(solution)
    line, sample = root_mean_square(rays.rms_of_images, 0).tolist()
    said = f"Residuals (rms): {two(line)} px in line, {two(sample)} px in sample ("
    said += f"{network.rays.point.size} image points, {many(len(network.images), 'image')})"
    if ranges.count:
        said += f"; ranges {two(ranges.rms_before)} -> {two(ranges.rms)} m ({ranges.count})"
    yield f"{said}."


def _points(solution: Solution) -> Iterator[str]:
    """Median sigmas of each class of points, horizontal and vertical, and how far it moved."""
    for one, mine in solution.network.of_class():
        there = mine[solution.determined[mine]]
        if not there.size:
            continue
        sigmas = np.median(local_sigmas(solution.covariances[there], solution.places[there]), axis=0)
        moved = float(np.median(np.linalg.norm(solution.places[there] - solution.places_before[there], axis=1)))
        level = float(np.hypot(*sigmas[:2]))
        said = f"{one.name.capitalize()} points ({there.size}): median sigma {length(level)} horizontal, "
        said += f"{length(float(sigmas[2]))} vertical; median move {length(moved)}."
        yield said + (_geometry(solution.network, there, float(sigmas[2])) if one is PointClass.TIE else "")


def _geometry(network: Network, ties: Index, height_sigma: float) -> str:
    """What convergence means for the heights of tie points, where it is small."""
    chosen = ties if ties.size <= _MOST_POINTS else ties[:: -(-ties.size // _MOST_POINTS)]
    angles: Array = convergence(network, chosen)
    if not angles.size or float(np.median(angles)) >= _FLAT:
        return ""
    span = f"rays converge by {two(angles.min() / DEG)} to {two(angles.max() / DEG)} deg"
    return f" Heights are {'undetermined' if height_sigma > _UNKNOWN else 'poorly determined'}: {span}."

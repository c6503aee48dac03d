"""An adjustment in at most fifteen lines: the verdict, sigmas of the points, the fit, and what was not tested."""

import math
from collections.abc import Iterator

import numpy as np

from mgsgraph.adjustment.solution import Solution
from mgsgraph.analysis.geometry_checks import convergence
from mgsgraph.analysis.statistics import local_sigmas, range_statistics, ray_statistics
from mgsgraph.analysis.verdict import State, verdict
from mgsgraph.files.networks.tie_points import PointKind
from mgsgraph.geometry.plausibility import resection_remedy
from mgsgraph.geometry.records import Array, Index
from mgsgraph.network import Network, PointClass
from mgsgraph.results.ground import checkpoint_sections, laser_section, omission_sentences
from mgsgraph.results.verdict import headline, linearity_section, reason_sentences, tested_sentences
from mgsgraph.text import length, many, root_mean_square, two
from mgsgraph.units import DEG, KM

_WEAK_CONVERGENCE = 5.0 * DEG
"""Convergence of rays below which heights are poorly known."""
_UNDETERMINED = 1.0 * KM
"""Median sigma of heights from which on no height is known: a body's relief is hardly larger."""
_NAMED_ERRORS = 1
"""Possible errors of each sort that are named; --details names all."""
_SMALL_SIGMA0, _MUCH_FREEDOM = 0.5, 20
"""sigma0 below which, and degrees of freedom from which on, stated sigmas are too large."""
_MOST_POINTS = 20_000
"""Tie points at most whose convergence is computed."""


def summary(solution: Solution) -> list[str]:
    """Lines for the terminal."""
    assessment = verdict(solution)
    start = resection_remedy(solution.network.images) if assessment.state is not State.VALID else ""
    sentences = [*([f"Not valid: {start}."] if start else []), *reason_sentences(assessment.reasons),
                 *_point_sentences(solution), *_fit_sentences(solution),
                 *(sentence for section in checkpoint_sections(solution) for sentence in section.sentences[:1]),
                 *omission_sentences(solution)]
    if solution.linearity is not None and not solution.linearity.linear:
        sentences += linearity_section(solution.linearity).sentences
    if solution.minima is not None and solution.minima.several:
        sentences.append(f"{len(solution.minima.each)} minima were found: sigmas are those of their mixture.")
    sentences += laser_section(solution, brief=True).sentences
    sentences += tested_sentences(assessment, solution, _NAMED_ERRORS)
    return [f"{headline(solution)} ({many(solution.iterations, 'iteration')})",
            *(f"- {sentence}" for sentence in sentences)]


def _fit_sentences(solution: Solution) -> Iterator[str]:
    """Cost and sigma0; how many observations, and how they fit."""
    network, fit = solution.network, solution.fit
    sigma0 = f"sigma0 {fit.sigma0:.3g}" if math.isfinite(fit.sigma0) else "no sigma0"
    overstated = fit.sigma0 < _SMALL_SIGMA0 and fit.degrees_of_freedom > _MUCH_FREEDOM
    remark = f"; residuals are {two(1.0 / fit.sigma0)} times smaller than stated" if overstated else ""
    yield (
        f"Fit: {sigma0} ({many(fit.degrees_of_freedom, 'degree')} of freedom), cost {solution.cost_initial:.3g} -> "
        f"{solution.cost_final:.3g}{remark}."
    )
    rays, ranges = ray_statistics(solution), range_statistics(solution)
    line, sample = root_mean_square(rays.rms_of_images, 0).tolist()
    residuals = f"Residuals (rms): {two(line)} px in line, {two(sample)} px in sample ("
    residuals += f"{rays.count.sum()} image points, {many(len(network.images), 'image')})"
    if ranges.count:
        residuals += f"; ranges {two(ranges.rms_before)} -> {two(ranges.rms)} m ({ranges.used})"
    yield f"{residuals}."


def _point_sentences(solution: Solution) -> Iterator[str]:
    """Median sigmas of each class of points, horizontal and vertical, and how far it moved."""
    for point_class, indices in points_in_words(solution.network):
        known = indices[solution.determined[indices]]
        if not known.size:
            continue
        sigmas = np.median(local_sigmas(solution.covariances[known], solution.places[known]), axis=0)
        movement = float(np.median(np.linalg.norm(solution.places[known] - solution.places_before[known], axis=1)))
        horizontal = float(np.hypot(*sigmas[:2]))
        sentence = f"{point_class.name.capitalize()} points ({known.size}): median sigma {length(horizontal)}"
        sentence += f" horizontal, {length(float(sigmas[2]))} vertical; median move {length(movement)}."
        yield sentence + (_convergence_remark(solution.network, known, float(sigmas[2]))
                          if point_class is PointClass.TIE else "")


def points_in_words(network: Network) -> Iterator[tuple[PointClass, Index]]:
    """What points are called in sentences, each with the indices of its points: those of a network of ties that are
    Constrained or Fixed are control points, and checkpoints are none of them.
    """
    known = (network.points.classes == PointClass.TIE) & (network.points.kinds != PointKind.FREE)
    classes = np.where(known, PointClass.CONTROL, network.points.classes)
    classes[network.points.checkpoints] = -1
    yield from ((each, np.flatnonzero(classes == each)) for each in PointClass if np.any(classes == each))


def _convergence_remark(network: Network, ties: Index, height_sigma: float) -> str:
    """What convergence means for the heights of tie points, where it is small."""
    sampled = ties if ties.size <= _MOST_POINTS else ties[:: -(-ties.size // _MOST_POINTS)]
    angles: Array = convergence(network, sampled)
    if not angles.size or float(np.median(angles)) >= _WEAK_CONVERGENCE:
        return ""
    span = f"rays converge by {two(angles.min() / DEG)} to {two(angles.max() / DEG)} deg"
    return f" Heights are {'undetermined' if height_sigma > _UNDETERMINED else 'poorly determined'}: {span}."

"""How a solution compares with the truth of a simulation, in words: the errors before and after, and their NEES."""

import numpy as np

from mgsgraph.adjustment.solution import Solution
from mgsgraph.geometry.records import Array
from mgsgraph.network import PointClass
from mgsgraph.simulation.pair import SimulatedPair


def nees(errors: Array, covariances: Array) -> Array:
    """Normalised estimation error squared e' C^-1 e of errors (n, d) with covariances (n, d, d); expectation d."""
    return np.asarray(np.einsum("ni,ni->n", errors, np.linalg.solve(covariances, errors[:, :, None])[:, :, 0]))


def against_truth(solution: Solution, pair: SimulatedPair) -> list[str]:
    """Sentences with the true errors of points and orientation before and after the adjustment."""
    truth = dict(zip(pair.ties.ids, pair.true_ties, strict=True)) | dict(
        zip(pair.laser.ids, pair.true_footprints, strict=True)
    )
    true_places = np.array([truth[name] for name in solution.network.points.ids])
    sentences = []
    for point_class in (PointClass.TIE, PointClass.LASER):
        members = solution.members(point_class)
        if members.size == 0:
            continue
        after, before = (places[members] - true_places[members] for places in (solution.places, solution.places_before))
        mean = nees(after, solution.covariances[members]).mean() / 3.0
        sentences.append(
            f"Truth, {point_class.name.lower()} points: error {rms_length(before):.1f} m rms before, "
            f"{rms_length(after):.1f} m after; "
            f"mean NEES per degree of freedom {mean:.2f} (1 if the stated sigmas are honest; "
            "all points share one orientation, so one draw scatters)."
        )
    errors = np.concatenate(
        [
            (estimate - true.coefficients).ravel()
            for estimate, true in zip(solution.coefficients, pair.true_corrections, strict=True)
        ]
    )
    whitened = nees(errors[None], solution.joint_covariance.of(range(len(solution.coefficients)))[None])[0]
    sentences.append(
        f"Truth, orientation: NEES {whitened:.1f} for {errors.size} coefficients (expected {errors.size})."
    )
    return sentences


def rms_length(errors: Array) -> float:
    """Root mean square length, m."""
    return float(np.sqrt(np.mean(np.einsum("ni,ni->n", errors, errors))))

"""By how much the orientations of two pictures contradict each other at their matches, and which matches do not fit.

Both rays of a match meet the ground, at two positions of the chart. What lies between them (the displacement) has two
parts. Across the plane of the rays it is the coplanarity residual: height has no share in it, orientation alone. Along
it, it is height times the difference of the rays' height parallaxes, besides. A correction of the second picture's
orientation, a polynomial of low degree with its prior, is fitted to both, the second with the sigma of the height. That
is the freedom which the true orientation has; a homography would be another one, which no pushbroom image has.
"""

from dataclasses import dataclass

import numpy as np

from mgsgraph.geometry.orientation import OrientationCorrection
from mgsgraph.geometry.records import Array, Index, Mask
from mgsgraph.matching.scene import Ground, Picture

SAMPLE = 5
"""Matches of a trial: ten equations, and the prior."""
_TRIALS = 400
_UNKNOWN_ANGLE = 1e-2
"""rad, unit of a rotation of which nothing is known beforehand."""
_MAD = 1.4826
"""Standard deviation of normal errors over their median absolute deviation."""
_ROUNDS = 8
"""Least-squares fits, each to what fits the last one."""


@dataclass(frozen=True, slots=True, eq=False)
class Displacements:
    """Two pictures at n matches: how far apart their rays meet the ground, and what an orientation would do to it."""

    apart: Array
    """(n, 2) m, second minus first, across and along the direction of a displacement by height."""
    design: Array
    """(n, 2, 6 d) m per sigma of a coefficient of the second picture's correction."""
    parallax: Array
    """(n,) m of displacement along, per m of height."""

    def residuals(self, coefficients: Array) -> Array:
        """(n, 2) m that remain after a correction in units of its sigmas."""
        return np.asarray(self.apart + self.design @ coefficients)

    def of(self, some: Mask | Index) -> "Displacements":
        """The displacements of some of the matches (a mask or indices)."""
        return Displacements(self.apart[some], self.design[some], self.parallax[some])


def sigmas_between(first: Picture, second: Picture, degree: int) -> Array:
    """(degree + 1, 6) m and rad, a-priori sigmas of the orientation of one picture relative to the other's."""
    both = [picture.prior.sigmas for picture in (first, second)]
    rows = [[sigmas[k] if k < len(sigmas) else 1e-3 * sigmas[-1] for k in range(degree + 1)] for sigmas in both]
    return np.asarray(np.hypot(*np.array(rows)))


def units_between(first: Picture, second: Picture, degree: int, unknown: float) -> Array:
    """(degree + 1, 6) m and rad, the same as units of a correction: `unknown` m and a hundredth of a rad where the
    sigmas are infinite.
    """
    sigmas = sigmas_between(first, second, degree)
    return np.where(np.isfinite(sigmas), sigmas, [[unknown] * 3 + [_UNKNOWN_ANGLE] * 3])


def robust_sigma(values: Array) -> float:
    """Standard deviation of normal errors with the same median absolute deviation; zero of no values."""
    return _MAD * float(np.median(np.abs(values - np.median(values)))) if values.size else 0.0


def displacements(
    first: Picture, second: Picture, pixels: tuple[Array, Array], ground: Ground, sigmas: Array
) -> Displacements:
    """Displacements at n matches.

    `pixels` are lines and samples (n, 2) in each picture, `sigmas` (d, 6) the units of the coefficients, m and rad.
    """
    base = second.on_chart(ground, pixels[1])
    frame, size = _frame(first, second, pixels, ground)
    apart = np.einsum("nij,nj->ni", frame, base - first.on_chart(ground, pixels[0]))
    columns = []
    for power, row in enumerate(sigmas):
        for component, sigma in enumerate(row):
            step = np.zeros_like(sigmas)
            step[power, component] = 1e-2 * sigma
            moved = second.on_chart(ground, pixels[1], increased(second.correction, step))
            columns.append(np.einsum("nij,nj->ni", frame, moved - base) / 1e-2)
    return Displacements(apart, np.stack(columns, axis=2), size)


def apart(first: Picture, second: Picture, pixels: tuple[Array, Array], ground: Ground) -> Array:
    """(n, 2) m, displacements alone: second minus first, across and along the direction of a displacement by height."""
    away = second.on_chart(ground, pixels[1]) - first.on_chart(ground, pixels[0])
    return np.asarray(np.einsum("nij,nj->ni", _frame(first, second, pixels, ground)[0], away))


def _frame(first: Picture, second: Picture, pixels: tuple[Array, Array], ground: Ground) -> tuple[Array, Array]:
    """(n, 2, 2) directions across and along a displacement by height on the chart, and (n,) its m per m."""
    parallaxes = second.height_parallax(ground, pixels[1]) - first.height_parallax(ground, pixels[0])
    size = np.linalg.norm(parallaxes, axis=1)
    along = np.where(size[:, None] > 1e-9, parallaxes / np.maximum(size, 1e-9)[:, None], [0.0, 1.0])
    return np.stack([np.column_stack([-along[:, 1], along[:, 0]]), along], axis=1), size


def increased(correction: OrientationCorrection | None, step: Array) -> OrientationCorrection:
    """A correction plus coefficients (d, 6) in m and rad: rotations are small, so they add."""
    before = np.zeros((0, 6)) if correction is None else correction.coefficients
    total = np.zeros((max(len(before), len(step)), 6))
    total[: len(before)] += before
    total[: len(step)] += step
    return OrientationCorrection(total)


def consensus(
    found: Displacements, tolerance: float, height_sigma: float, rng: np.random.Generator
) -> tuple[Array, Mask]:
    """The correction that most of n matches agree on (Fischler & Bolles 1981), in units of its sigmas (6 d,), and
    whether each match fits it (n,).

    `tolerance` (m) is the sigma of a match's displacement but for height, `height_sigma` (m) that of the ground; within
    three sigmas a match fits. `rng` draws the trials.
    """
    n = len(found.apart)
    sigmas = np.column_stack([np.full(n, tolerance), np.hypot(tolerance, height_sigma * found.parallax)])
    best, most = np.zeros(found.design.shape[2]), _fits(found, np.zeros(found.design.shape[2]), sigmas)
    for _ in range(_TRIALS if n > SAMPLE else 0):
        some = rng.choice(n, SAMPLE, replace=False)
        trial = _solved(found.of(some), sigmas[some])
        fits = _fits(found, trial, sigmas)
        if np.count_nonzero(fits) > np.count_nonzero(most):
            best, most = trial, fits
    for _ in range(_ROUNDS):
        best = _solved(found.of(most), sigmas[most])
        again = _fits(found, best, sigmas)
        if np.array_equal(again, most):
            break
        most = again
    return best, most


def _fits(found: Displacements, coefficients: Array, sigmas: Array) -> Mask:
    return np.asarray(np.all(np.abs(found.residuals(coefficients)) <= 3.0 * sigmas, axis=1))


def _solved(found: Displacements, sigmas: Array) -> Array:
    """Least squares with the prior: unit sigmas about zero."""
    unknowns = found.design.shape[2]
    rows = (found.design / sigmas[:, :, None]).reshape(-1, unknowns)
    right = (-found.apart / sigmas).reshape(-1)
    full = np.concatenate([rows, np.eye(unknowns)])
    return np.asarray(np.linalg.lstsq(full, np.concatenate([right, np.zeros(unknowns)]), rcond=None)[0])

"""The closing check: how far an incremental adjustment lies from batch, in sigmas."""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from mgsgraph.adjustment.solution import Solution
from mgsgraph.geometry.orientation import Angles
from mgsgraph.geometry.records import Array
from mgsgraph.incremental.motion import ground_motion, image_motion
from mgsgraph.incremental.state import Shared
from mgsgraph.network.parts import KnownImage, Unknown, unknowns
from mgsgraph.notebook import card

CLOSE = 1e-2
"""Sigmas within which incremental and batch results count as the same."""
EXACT = 1e-4
"""Sigmas beyond which the closing check takes over what batch has found."""


@dataclass(frozen=True, slots=True, eq=False)
class Closing:
    """Largest differences between the incremental result and batch, in sigmas of batch."""

    unknown: Unknown
    """The one that lies farthest off."""
    orientation: float
    """Largest difference of a coefficient or shift, in its sigma."""
    point: str
    """The point that lies farthest off."""
    points: float
    """Largest difference of a coordinate, in its sigma."""
    adopted: bool
    """Whether batch's result is to be taken over: it converged, and something is farther off than `EXACT`."""
    converged: bool
    """Whether batch converged; else the comparison says nothing."""

    @property
    def worst(self) -> float:
        """Largest difference of all, in sigmas; infinite where one of the two has a place and the other has none."""
        return max(self.orientation, self.points)

    @property
    def close(self) -> bool:
        """Whether all lay within `CLOSE`."""
        return self.worst <= CLOSE

    def _repr_html_(self) -> str:
        """For notebooks."""
        return card("Closing check", [self.sentence()])

    def sentence(self) -> str:
        """What was found."""
        if not self.converged:
            return "Closing check against batch: batch did not converge; the incremental result was kept."
        verdict = "the same" if self.close else f"farther apart than {CLOSE:g} sigmas"
        kept = "batch's result was taken over" if self.adopted else "the incremental result was kept"
        return (
            f"Closing check against batch: {verdict}; largest difference {self.orientation:.2g} sigmas for the "
            f"{self.unknown}, {self.points:.2g} sigmas for point {self.point}; {kept}."
        )


def closing(solution: Solution, values: Mapping[Unknown, Array], places: Array) -> Closing:
    """Compare values of the unknowns and places (n, 3) of the points with a batch solution of the same network."""
    worst, which = 0.0, next(iter(values), Unknown("image", "-"))
    for unknown, batch in shared_of(solution).items():
        off = float(np.max(np.abs(values[unknown] - batch.value) / batch.sigmas))
        if off > worst:
            worst, which = off, unknown
    k, off = _farthest(solution, places)
    converged = solution.converged
    adopted = converged and max(worst, off) > EXACT
    return Closing(which, worst, solution.network.points.ids[k], off, adopted, converged)


def _farthest(solution: Solution, places: Array) -> tuple[int, float]:
    """The point that lies farthest off, and its largest difference of a coordinate in its sigma."""
    known = np.isfinite(places[:, 0])
    with np.errstate(invalid="ignore", divide="ignore"):
        off = np.max(np.abs(places - solution.places) / solution.sigmas, axis=1)
    off[~known & ~solution.determined] = 0.0
    off[known != solution.determined] = np.inf
    off[known & solution.determined & np.isnan(off)] = 0.0  # a fixed point has no sigma, and stays where it is
    k = int(np.argmax(off))
    return k, float(off[k])


def shared_image(known: KnownImage, angles: Angles) -> Shared:
    """The orientation of an image as it is before anything is observed in it."""
    prior = known.prior.sigmas.ravel()
    return Shared(prior, image_motion(known), ground_motion(known, angles), np.zeros(prior.size), np.diag(prior**2))


def shared_shift(sigma: float, motion: float) -> Shared:
    """A horizontal shift, eastward and northward, of a-priori `sigma` in m; `motion` is pixels per m."""
    return Shared(np.full(2, sigma), np.full(2, motion), np.zeros((3, 2)), np.zeros(2), np.eye(2) * sigma**2)


def shared_of(solution: Solution) -> dict[Unknown, Shared]:
    """The adjusted unknowns of a batch solution."""
    network, found = solution.network, dict[Unknown, Shared]()
    names, count = unknowns(network), len(network.images)
    for j, (image, prior) in enumerate(zip(network.images, network.priors, strict=True)):
        if not network.held[j]:
            one = shared_image(KnownImage(image, prior), solution.settings.angles)
            value, covariance = solution.coefficients[j].ravel(), solution.image_covariance(j)
            found[names[j]] = replace(one, value=value, covariance=covariance)
    motion = max((float(one.motion[0]) for one in found.values()), default=1.0)
    for p, name in enumerate(network.shift_names):
        one = shared_shift(network.shift_sigma(name), motion)
        found[names[count + p]] = replace(one, value=solution.shifts[p], covariance=solution.shift_covariance(p))
    return found

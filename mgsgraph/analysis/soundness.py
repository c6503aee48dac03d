"""Whether an adjustment that came to rest is a result: what it left out, and whether its sigma0 and its orientations
can be.

An optimiser comes to rest on whatever is left to it. Robust estimates and rejection hold while more than half of the
observations of a kind are good, and no estimate can hold beyond (breakdown point; Rousseeuw & Leroy 1987, section 1.2):
where most are left out, those that are left may as well be the wrong ones. And among many measures one wrong image
hardly shows in sigma0: least squares turns it by hundreds of a-priori sigmas, and bends its neighbours.
"""

from enum import StrEnum
from typing import NamedTuple

import numpy as np

from mgsgraph.adjustment.fit import ABSURD, Strained
from mgsgraph.adjustment.solution import Solution
from mgsgraph.analysis.statistics import ray_statistics, rejected_points
from mgsgraph.network import PointClass

MOST = 0.5
"""Share of a kind of observations beyond which what is left of it proves nothing."""
MANY = 0.2
"""Share from which on it is worth a warning: blunders are single ones, so many have a cause in common."""
_FEWEST = 3
"""Fewer observations of a kind are not judged by their share, unless all are lost."""


class Kind(StrEnum):
    """What may be left out."""

    TIES = "tie points"
    LASER = "laser points"
    CONTROL = "control points"
    POSTS = "posts of the terrain model"
    RANGES = "laser ranges"
    SHOTS = "heights above stereo surfaces"
    IMAGE = "image measures"


_OF_CLASS = {
    PointClass.TIE: Kind.TIES, PointClass.LASER: Kind.LASER, PointClass.CONTROL: Kind.CONTROL,
    PointClass.POST: Kind.POSTS,
}  # fmt: skip


class Loss(NamedTuple):
    """Observations of one kind that did not take part."""

    kind: Kind
    """Of what kind."""
    image: str
    """Name of their image, of image measures; else empty."""
    lost: int
    """How many did not take part."""
    total: int
    """Of so many."""

    @property
    def share(self) -> float:
        """Share that is lost."""
        return self.lost / self.total

    @property
    def fatal(self) -> bool:
        """Whether what is left proves nothing."""
        return self.lost == self.total or (self.total >= _FEWEST and self.share > MOST)

    @property
    def large(self) -> bool:
        """Whether it is worth a warning."""
        return self.total >= _FEWEST and self.share > MANY


class Soundness(NamedTuple):
    """What speaks against a solution."""

    losses: tuple[Loss, ...]
    """Kinds of observations of which many are lost, the most first."""
    sigma0: float
    """A-posteriori standard deviation of unit weight; NaN without redundancy."""
    impossible: tuple[Strained, ...]
    """Orientations that no stated sigma allows, the farthest first."""

    @property
    def absurd(self) -> bool:
        """Whether sigma0 can't come from sigmas that are merely too small."""
        return self.sigma0 > ABSURD

    @property
    def fatal(self) -> tuple[Loss, ...]:
        """Losses that leave no result."""
        return tuple(one for one in self.losses if one.fatal)

    @property
    def sound(self) -> bool:
        """Whether nothing forbids to take the solution for a result."""
        return not (self.absurd or self.fatal or self.impossible)


def soundness(solution: Solution) -> Soundness:
    """What a solution left out, and whether its sigma0 and its orientations can be."""
    network, rays = solution.network, ray_statistics(solution)
    lost, found = rejected_points(solution), list[Loss]()
    for one, kind in _OF_CLASS.items():
        mine = network.points.classes == one
        found.append(Loss(kind, "", int(np.count_nonzero(lost & mine)), int(np.count_nonzero(mine))))
    ranges = solution.ranges_used
    found.append(Loss(Kind.RANGES, "", int(np.count_nonzero(~ranges)), ranges.size))
    if network.stereo is not None:
        on = network.stereo.surface >= 0
        found.append(Loss(Kind.SHOTS, "", int(np.count_nonzero(on & ~solution.stereo_used)), int(np.count_nonzero(on))))
    for j, (total, used) in enumerate(zip(rays.total.tolist(), rays.count.sum(axis=1).tolist(), strict=True)):
        found.append(Loss(Kind.IMAGE, network.images[j].name, total - used, total))
    worth = [one for one in found if one.total and (one.fatal or one.large)]
    impossible = tuple(one for one in solution.strained if one.impossible)
    return Soundness(tuple(sorted(worth, key=lambda one: -one.share)), solution.sigma0, impossible)


def is_result(solution: Solution) -> bool:
    """Whether a solution may be taken for a result: it came to rest, on observations that prove something."""
    return solution.converged and soundness(solution).sound

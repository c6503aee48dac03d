"""Whether what was matched between two pictures is one ground: four signs, none of which decides alone.

False matches stand every check of single matches: among thousands of windows some are alike, the way back ends where it
began, and a correction with eighteen coefficients makes the rays of a dozen meet. Together they betray themselves:
few of the surest features end as a match, few agreed on an orientation, they lie in few cells, and their rays miss each
other by far more than their sigmas say, from one match to the next. Good pairs show one of these signs: noise costs
matches, jitter of the spacecraft moves rays. So two signs refuse a pair, and one is said. The limits lie between what
good and false pairs have shown (docs/matching.md); `chance_agreements` is theory.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from mgsgraph.geometry.records import Array, Mask
from mgsgraph.matching.checks import cell_numbers
from mgsgraph.matching.coarse import Agreement
from mgsgraph.matching.measuring import Measured
from mgsgraph.matching.pairs import Pair, by_pair
from mgsgraph.matching.relative import robust_sigma
from mgsgraph.matching.scene import Scene
from mgsgraph.text import listed

_AGREED = 0.3
"""Share of the coarse matches below which too few agree on an orientation."""
_YIELD = 0.1
"""Share of the features tried below which too few are found again both ways."""
_FILLED = 0.02
"""Share of the cells of common ground below which too few have a match."""
_SCATTER = 2.5
"""Times the stated sigma by which rays may miss each other from one match to the next."""
_BESIDE = 4
"""Matches before and after one, by line, against whose median it is held: jitter is common to them."""
_ENOUGH = 4
"""Matches from which on they scatter."""


class PairSigns(NamedTuple):
    """What speaks for or against the matches of two pictures."""

    first: str
    """Name of the reference picture."""
    other: str
    """Name of the other one."""
    agreed: float
    """Share of the coarse matches that agreed; NaN of a pair that was brought together by way of others."""
    found: float
    """Share of the features tried that were found again both ways."""
    filled: float
    """Share of the cells of common ground that have a match."""
    scatter: float
    """Coplanarity residuals from one match to the next over their stated sigma; NaN of few matches."""

    @property
    def signs(self) -> tuple[str, ...]:
        """Those that speak against it, in words with figures."""
        return tuple(
            words
            for bad, words in (
                (self.agreed < _AGREED, f"{self.agreed:.0%} of the coarse matches agree"),
                (self.found < _YIELD, f"{self.found:.1%} of the surest features are found again both ways"),
                (self.filled < _FILLED, f"{self.filled:.1%} of the cells of common ground have a match"),
                (self.scatter > _SCATTER, f"their rays miss each other by {self.scatter:.1f} times the stated sigma"),
            )
            if bad
        )

    @property
    def refused(self) -> bool:
        """Whether these are no matches of one ground."""
        return len(self.signs) > 1

    @property
    def words(self) -> str:
        """The signs against it, in a sentence without its end."""
        return f"{self.first} and {self.other}: {listed(list(self.signs))}"


def pair_signs(
    scene: Scene, agreements: Sequence[Agreement], pairs: Sequence[Pair], cell: float, tried: Measured, returned: Mask,
    kept: Measured, misfit: Array,
) -> list[PairSigns]:  # fmt: skip
    """Signs of each pair of pictures with matches.

    `cell` is the side of the cells in m; `returned` (k,) says which of the measures tried stood all checks of single
    matches, `misfit` (m,) is the coplanarity residual of those kept, m on the ground.
    """
    agreed = {frozenset(one[:2]): one.agreed / max(one.candidates, 1) for one in agreements}
    cells = {frozenset(pair[:2]): pair.area / cell**2 for pair in pairs}
    rows, found = {pair[:2]: pair[2] for pair in by_pair(tried.first, tried.other)}, list[PairSigns]()
    for first, other, mine in by_pair(kept.first, kept.other):
        both, some = frozenset((first, other)), kept.some(mine)
        one, second = (scene.pictures[j].image.name for j in (first, other))
        plane = scene.pictures[first].on_chart(scene.ground, some.anchors)
        filled = np.unique(cell_numbers(plane, cell)).size / max(cells.get(both, 1.0), 1.0)
        share = float(np.mean(returned[rows[first, other]]))
        stated = float(np.median(some.sigmas)) * float(scene.pixel_sizes[other])
        scatter = robust_sigma(_from_neighbours(some.anchors[:, 0], misfit[mine])) / stated
        scatter = scatter if mine.size >= _ENOUGH else math.nan
        found.append(PairSigns(one, second, agreed.get(both, math.nan), share, min(filled, 1.0), scatter))
    return found


def _from_neighbours(lines: Array, values: Array) -> Array:
    """(n,) values less the median of those of the matches before and after by line; as they are where there are few."""
    size = 2 * _BESIDE + 1
    if values.size <= size:
        return values
    order = np.argsort(lines, kind="stable")
    windows = np.lib.stride_tricks.sliding_window_view(np.pad(values[order], _BESIDE, mode="reflect"), size)
    return np.asarray(values[order] - np.median(np.delete(windows, _BESIDE, axis=1), axis=1))

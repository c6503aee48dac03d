"""What matching gives: tie points with a covariance for every match, and the count of what was lost on the way."""

import zlib
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from mgsgraph.files.tie_points import PointKind, TiePoints
from mgsgraph.geometry.records import Array, Index, Mask, assign, frozen
from mgsgraph.matching.coarse import Agreement
from mgsgraph.matching.measuring import Measured
from mgsgraph.names import Names, RepeatedNames
from mgsgraph.record import Record

SOURCE = "matches"
"""What messages call them."""


class Losses(NamedTuple):
    """Matches after each step."""

    linked: int
    """Pairs of features that chose each other."""
    tried: int
    """Of these, the surest in each cell."""
    measured: int
    """Places by least-squares matching that converged."""
    alike: int
    """Of these, with enough correlation and a small enough sigma."""
    returned: int
    """Of these, whose way back ended where it began."""
    coplanar: int
    """Of these, whose rays meet."""
    steady: int
    """Of these, with heights like their neighbours'."""
    kept: int
    """Of these, the best of each cell."""


@dataclass(frozen=True, slots=True, eq=False)
class Matches(Record):
    """Tie points from images.

    Examples
    --------
    >>> print(matches)
    Matches(58 points in 24 of 24 cells)
    >>> float(np.median(matches.ties.measure_sigmas[~matches.reference]).round(2))
    0.05
    """

    ties: TiePoints
    """Free points; of each, the first measure is the reference, a pixel's centre. Sigmas: half of each match's variance
    is the reference's, half the other's, since both pictures' noise is in it (so measures are independent)."""
    covariances: Array
    """(k, 2, 2) pixels^2, of each measure given its point's reference (zero for the reference itself)."""
    correlation: Array
    """(k,) of the two windows; NaN for a reference."""
    misfit: Array
    """(k,) m on the ground, coplanarity residual with the reference under the orientation's freedom; NaN for a
    reference."""
    agreements: tuple[Agreement, ...]
    """How the pictures joined."""
    refused: tuple[str, ...]
    """Why pairs that share ground by their nominal orientations were not brought together."""
    losses: Losses
    """What was lost on the way."""
    step: float
    """m, pixel of the ground grid."""
    cell: float
    """m, side of a cell."""
    cells: tuple[int, int]
    """Cells of shared ground with a match, and all of them."""
    cautions: tuple[str, ...] = ()
    """What speaks against pictures or pairs without refusing them, in sentences."""

    def __post_init__(self) -> None:
        k = len(self.ties.measure_image)
        assign(self, covariances=frozen(self.covariances, f"{SOURCE}, covariances", (k, 2, 2)))

    @property
    def reference(self) -> Mask:
        """(k,) which measures are their point's reference."""
        return np.asarray(np.isnan(self.correlation))

    def __repr__(self) -> str:
        filled, whole = self.cells
        return f"Matches({len(self.ties.ids)} points in {filled} of {whole} cells)"


def _ids(names: tuple[str, ...], pixels: Array, count: int) -> Names:
    """Names of points that those of another run, which may stand in the same case, don't have."""
    run = zlib.crc32("\n".join(names).encode() + pixels.tobytes())
    return Names.of(f"M{run:08x}_{i + 1:06d}" for i in range(count))


def matches_of(
    found: Measured, misfit: Array, names: tuple[str, ...], order: Index
) -> tuple[TiePoints, Array, Array, Array]:
    """Tie points, covariances, correlations and misfits of finished measures, which are sorted by track.

    `misfit` (k,) is in m, `names` are those of the pictures; `order` (n,) has the tracks, by their positions among the
    distinct ones, in the order in which points are numbered.
    """
    tracks, begin, inverse = np.unique(found.track, return_index=True, return_inverse=True)
    rank = np.empty(tracks.size, dtype=np.int64)
    rank[order] = np.arange(tracks.size)
    back = np.linalg.inv(found.affine)
    shared = 0.5 * back @ found.covariances @ np.swapaxes(back, 1, 2)
    count = np.bincount(inverse, minlength=tracks.size)
    of_anchor = np.zeros((tracks.size, 2, 2))
    np.add.at(of_anchor, inverse, shared)
    of_anchor /= count[:, None, None]
    point = np.concatenate([rank, rank[inverse]])
    pixels = np.concatenate([found.anchors[begin], found.pixels])
    picture = np.concatenate([found.first[begin], found.other])
    variances = np.concatenate([of_anchor, 0.5 * found.covariances])
    first = np.concatenate([np.zeros(tracks.size, dtype=np.int64), np.ones(inverse.size, dtype=np.int64)])
    rows = np.lexsort([picture, first, point])
    nothing = np.full(tracks.size, np.nan)
    n = tracks.size
    ties = TiePoints(
        source=SOURCE,
        ids=_ids(names, pixels[rows], n),
        kinds=np.full(n, PointKind.FREE, dtype=np.int64),
        places=np.full((n, 3), np.nan),
        covariances=np.zeros((n, 3, 3)),
        measure_point=point[rows],
        measure_image=RepeatedNames(tuple(names), picture[rows]),
        measures=pixels[rows],
        measure_sigmas=np.sqrt(np.diagonal(variances, axis1=1, axis2=2))[rows],
    )
    covariances = np.concatenate([np.zeros((n, 2, 2)), found.covariances])[rows]
    correlation = np.concatenate([nothing, found.correlation])[rows]
    return ties, covariances, correlation, np.concatenate([nothing, misfit])[rows]

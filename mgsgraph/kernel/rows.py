"""The rows of the adjustment as plain arrays: everything about an observation that doesn't change between iterations.

What a point sees is a list of *observations*: image rays, ranges, its a-priori position, the terrain under it. Points
with the same list share a *pattern* and lie side by side in *pieces* of at most `PIECE` points; a piece's numbers are
stored observation by observation and component by component, contiguous over its points, so that the kernel reads them
as SIMD vectors. `mgsgraph.adjustment.graph` fills the arrays from a network; the kernels take the tuples as they stand.
"""

from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Index = NDArray[np.int64]
Small = NDArray[np.int8]

FREE, PRIOR, FIXED, OUT = 0, 1, 2, 3
"""What a point is: unknown; unknown with an a-priori position; known; not determined and left out."""

IMAGE, RANGE, GROUND, SURFACE, STEREO = 0, 1, 2, 3, 4
"""What an observation is: an image ray, a laser range, the a-priori position, the height above the terrain model, the
height above a surface that two images show."""

PREDICTED, MEASURED = 0, 1
"""Line at which the pose is taken: the predicted one (strict form), or the measured one (the papers' form)."""

CAMERA, OPK_PAPER, OPK_PEER = 0, 1, 2
"""Rotation corrections: a rotation vector about the camera axes, or additions to omega, phi, kappa."""

NO_LOSS, HUBER, CAUCHY, TUKEY = 0, 1, 2, 3
"""Robust loss on the norm of an image row pair, on each range and on each height above a stereo surface."""

GOOD, BEHIND, WEAK = 0, 1, 2
"""Status of a point after its inner solve: solved, behind a camera, not determined by its rows."""

PIECE = 2048
"""Most points of a piece: what a thread takes at a time, and what a cluster's worker may get."""


class Rows(NamedTuple):
    """n points, m pieces, q patterns, s observations of patterns, e entries: unknowns that an observation has."""

    kind: Small
    """(n,) FREE, PRIOR, FIXED or OUT."""
    start: Array
    """(n, 3) m: a-priori position, coordinates of a fixed point, or where the inner solve begins."""
    data: Array
    """Constants of all observations, in the order in which `tile.load_observation` takes them."""
    weight: Array
    """(2, t) 1/sigma per line and per sample (an image ray), 1/m in the first row (range, surface, stereo); 0 leaves
    it out."""
    piece: Index
    """(m, 5) pattern, first point, number of points, where its constants begin in `data`, and its observations among
    all t of them (observation by observation, contiguous over its points).
    """
    pattern_observation: Index
    """(q + 1,) first observation of each pattern."""
    pattern_group: Index
    """(q,) group: set of unknowns."""
    pattern_fixed: Index
    """(q,) 1 where the points are known."""
    pattern_shape: Index
    """(q,) shape: observations of the same kinds and sizes, whatever unknowns they depend on (`shapes`)."""
    observation_kind: Index
    """(s,) IMAGE, RANGE, GROUND, SURFACE or STEREO."""
    observation_width: Index
    """(s,) components of its state: 6 (9 with detector x, y and focal length) of an image, 3 (4 with the bias) of a
    range, 3 of a ground prior or a surface row, 1 of a stereo row."""
    observation_terms: Index
    """(s,) number of basis terms, each of six columns."""
    observation_shared: Index
    """(s,) number of single columns, each with a direction in the observation's state."""
    observation_entry: Index
    """(s,) first of its entries: terms, then single columns."""
    observation_focal: Array
    """(s,) m, nominal focal length."""
    observation_slope: Array
    """(s, 2) m per sample, slope of a detector line where the model takes it as it is (not as the scale of frozen
    image motion); NaN where each ray stores its own."""
    observation_rate: Array
    """(s,) du/dline where the basis is a polynomial 1, u, u^2, .. of the line, of which u alone is stored; else 0."""
    observation_numbers: Index
    """(s,) numbers per point in `data` (`numbers_stored`)."""
    entry_column: Index
    """(e,) column of the orientation vector: the first of six, or the single one."""
    entry_member: Index
    """(e,) index of its variable among those of the group."""
    entry_inside: Index
    """(e,) the same column within that variable."""
    terrain: Array
    """(rows, columns) m, coefficients of the terrain model's spline; (0, 0) without a model."""
    terrain_frame: Array
    """(4,) first longitude and latitude, and their steps (rad)."""


def shapes(first: Index, fixed: Index, *tables: Index) -> Index:
    """(q,) shape of each pattern, from 0 on: the same for patterns whose observations are alike.

    `first` (q + 1,) is each pattern's first observation, `fixed` (q,) as in `Rows`, and the tables (s,) are what
    observations have to share: kind, width, numbers of terms and single columns.
    """
    _, shape = np.unique(np.stack(tables), axis=1, return_inverse=True)
    count = np.diff(first)
    table = np.full((count.size, 1 + int(count.max(initial=0))), -1, dtype=np.int64)
    table[:, 0] = fixed
    row = np.repeat(np.arange(count.size), count)
    table[row, 1 + np.arange(row.size) - np.repeat(first[:-1], count)] = shape.reshape(-1)
    return np.asarray(np.unique(table, axis=0, return_inverse=True)[1].reshape(-1), dtype=np.int64)


class Model(NamedTuple):
    """Which of its forms the measurement model takes."""

    line: int
    """PREDICTED or MEASURED."""
    angles: int
    """CAMERA, OPK_PAPER or OPK_PEER."""
    loss: int
    """NO_LOSS, HUBER, CAUCHY or TUKEY."""
    width: float
    """Loss width in sigmas."""


class Groups(NamedTuple):
    """Sets of unknowns that the points of some patterns share; g groups, b members of them together."""

    member_first: Index
    """(g + 1,) first member of each group."""
    member_variable: Index
    """(b,) variable, ascending within a group."""
    member_width: Index
    """(b,) its columns."""
    pair_first: Index
    """(g + 1,) index of the group's table of pairs (members x members) in `NormalBlocks.pair`."""


class NormalBlocks(NamedTuple):
    """Layout of reduced normal equations: dense blocks of variable pairs in one flat array, and a flat gradient."""

    pair: Index
    """For each group its members x members table of first indices; used for first member <= second member."""
    right: Index
    """(b,) index of each member's gradient."""
    size: int
    """Length of the flat array of blocks."""
    columns: int
    """Length of the gradient."""


def numbers_stored(
    model: Model, kind: Index, width: Index, terms: Index, shared: Index, polynomial: NDArray[np.bool_], slope: Array
) -> Index:
    """Numbers per point that observations (s,) store in `Rows.data`, in the order of `tile.load_observation`.

    The observation's constants, then the line u of a polynomial, or basis values and (where the pose is that of the
    predicted line) rates, then directions. `slope` is as of `Rows`.
    """
    predicted = model.line == PREDICTED
    of_ray = 3 + (4 if model.angles == CAMERA else 3) + 2 + (7 if predicted else 0 if model.angles == OPK_PEER else 4)
    constants = np.array([of_ray, 3 + 3 + 1, 3 + 6, 0, 3 + 3 + 1])[kind]
    constants += np.where((kind == IMAGE) & takes_slope(model) & np.isnan(slope[:, 0]), 2, 0)
    of_basis = terms * np.where((kind == IMAGE) & predicted, 2, 1)
    return np.asarray(constants + np.where(polynomial, np.minimum(terms, 1), of_basis) + width * shared)


def takes_slope(model: Model) -> bool:
    """Whether rows take the slope of the detector line: about the predicted line, and as the peer's pixels."""
    return model.line == PREDICTED or model.angles == OPK_PEER


def of_points(rows: Rows, piece: int, inside: Index) -> Rows:
    """Rows of some points of one piece, by their indices in it; tables of patterns, observations and entries stay
    whole.
    """
    pattern, first, count, number, observation = rows.piece[piece].tolist()
    ends = [rows.data.size, rows.weight.shape[1]]
    last = ends if piece + 1 == len(rows.piece) else rows.piece[piece + 1, 3:].tolist()
    return rows._replace(
        kind=rows.kind[first + inside],
        start=rows.start[first + inside],
        data=rows.data[number : last[0]].reshape(-1, count)[:, inside].ravel(),
        weight=rows.weight[:, observation : last[1]].reshape(2, -1, count)[:, :, inside].reshape(2, -1),
        piece=np.array([[pattern, 0, inside.size, 0, 0]]),
    )


def neighboring_pieces(begins: Index, most: int) -> list[tuple[int, int]]:
    """First piece, and the one after the last, of neighbors that hold about `most` elements together; those of each
    piece begin at `begins` (m + 1,).
    """
    edges = np.unique(np.searchsorted(begins, [*range(0, begins[-1], most), begins[-1]])).tolist()
    return list(pairwise(edges))


def partition(rows: Rows, first_piece: int, last_piece: int) -> Rows:
    """Rows of the points of some neighbouring pieces, first_piece .. last_piece - 1, by themselves.

    Reduced systems of partitions that together hold all pieces add up to the whole's: tables of patterns, observations,
    entries and the terrain model stay as they are, so that variables, groups and columns keep their indices.
    """
    ends = np.array([0, rows.kind.size, 0, rows.data.size, rows.weight.shape[1]])
    edges = np.vstack([rows.piece, ends])
    (_, *first), (_, *last) = edges[[first_piece, last_piece]].tolist()
    points, numbers, observations = (slice(first[k], last[k]) for k in (0, 2, 3))
    return rows._replace(
        kind=rows.kind[points],
        start=rows.start[points],
        data=rows.data[numbers],
        weight=np.ascontiguousarray(rows.weight[:, observations]),
        piece=rows.piece[first_piece:last_piece] - np.array([0, first[0], 0, *first[2:]]),
    )

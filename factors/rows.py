"""The rows of the adjustment as plain arrays: everything about an observation that doesn't change between iterations.

Sorted by point; `mgsgraph.adjustment.graph` fills them from a network. The kernels take the tuple as it stands.
"""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Index = NDArray[np.int64]

FREE, PRIOR, FIXED, OUT = 0, 1, 2, 3
"""What a point is: unknown; unknown with an a-priori place; known; not determined and left out."""

PREDICTED, MEASURED = 0, 1
"""Line at which the pose is taken: the predicted one (strict form), or the measured one (the papers' form)."""

CAMERA, OPK_PAPER, OPK_PEER = 0, 1, 2
"""Rotation corrections: a rotation vector about the camera axes, or additions to omega, phi, kappa."""

NO_LOSS, HUBER, CAUCHY, TUKEY = 0, 1, 2, 3
"""Robust loss on the norm of an image row pair and on each range."""


class Rows(NamedTuple):
    """Points, image rows and range rows; n points, k rays, r ranges, m (orientation column, basis value) pairs."""

    point_kind: Index
    """(n,) FREE, PRIOR, FIXED or OUT."""
    point_start: Array
    """(n, 3) m: a-priori place, place of a fixed point, or where the inner solve begins."""
    point_root: Array
    """(n, 3, 3) 1/m: upper triangular square root U of the prior information, |U (P - P0)|^2; zero when FREE."""
    shift_first: Index
    """(n + 1,) shared unknowns that move point i's a-priori place (its profile's horizontal shift)."""
    shift_column: Index
    """(s,) column of the orientation vector."""
    shift_local: Index
    """(s,) the same within the point's group."""
    shift_direction: Array
    """(s, 3) unit vector, body-fixed, along which the a-priori place moves per metre of the unknown."""
    surface_weight: Array
    """(n,) 1/m: weight of the point's height above the terrain; 0 where it has no such row."""
    surface_column: Index
    """(n,) first of the two columns of the terrain model's shift; -1 where the point doesn't feel it."""
    surface_local: Index
    """(n,) the same within the point's group."""
    surface_direction: Array
    """(n, 2, 3) unit vectors eastward and northward, along which that shift moves the model; (0, 2, 3) without."""
    terrain: Array
    """(rows, columns) m, radii of the terrain model's posts; (0, 0) without one."""
    terrain_frame: Array
    """(4,) first longitude and latitude, and their steps (rad)."""
    terrain_cell: Index
    """(n, 3) row, left and right column of the four posts that span each point's patch; row -1 for no row. Held during
    one optimisation, so that the cost is smooth, and renewed between optimisations until they stay."""
    ray_first: Index
    """(n + 1,) rays of point i are ray_first[i] .. ray_first[i + 1]."""
    centre: Array
    """(k, 2, 3) nominal perspective centre, m body-fixed, and its rate in m/line, at the measured line."""
    matrix: Array
    """(k, 3, 3) nominal body-fixed to camera rotation at the measured line."""
    turning: Array
    """(k, 3) rad/line, nominal angular velocity in camera axes."""
    angles: Array
    """(k, 2, 3) nominal omega, phi, kappa in rad and their rates per line; (0, 2, 3) unless angles are used."""
    detector: Array
    """(k, 2, 2) undistorted focal-plane place (x0, y0) of the measured sample, m, and its slope, m/sample."""
    focal: Array
    """(k,) m."""
    to_pixels: Array
    """(k, 2, 2) focal-plane m to (lines, samples), frozen from the nominal; used by the measured-line form alone."""
    weight: Array
    """(k, 2) 1/sigma per line and per sample; 0 for a row that is left out."""
    pair_first: Index
    """(k + 1,) pairs of ray k."""
    pair_column: Index
    """(m,) first of six columns of the orientation vector."""
    pair_local: Index
    """(m,) the same within the point's group of orientation variables."""
    pair_value: Array
    """(m, 2) basis value B(u) and its rate per line."""
    range_first: Index
    """(n + 1,) ranges of point i."""
    range_centre: Array
    """(r, 3) m, nominal place of the instrument at the shot's time."""
    range_value: Array
    """(r,) m."""
    range_weight: Array
    """(r,) 1/m; 0 for a row that is left out."""
    range_pair_first: Index
    """(r + 1,) pairs of range r."""
    range_pair_column: Index
    """(q,) first of six columns, of which a range uses the first three."""
    range_pair_local: Index
    """(q,) the same within the group."""
    range_pair_value: Array
    """(q,) basis value at the shot's time."""


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
    """Points seen by the same orientation variables, contiguous in `Rows`; g groups, c chunks of work."""

    dimension: Index
    """(g,) columns of the group's variables together."""
    offset: Index
    """(g + 1,) where the group's dimension x dimension block begins in a flat array of them all."""
    chunk: Index
    """(c, 3) group, first point, last point + 1."""


def replaced(rows: Rows, **arrays: Any) -> Rows:
    """The same rows with some arrays exchanged (weights of a blunder pass, say)."""
    return rows._replace(**arrays)

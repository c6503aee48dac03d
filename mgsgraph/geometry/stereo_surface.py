"""The ground surface of two images, averaged over a footprint, and heights of points above it.

Dense matches say where a pixel x = (line, sample) of the first image lies in the second: y = D(x). Averaged over what a
laser spot (or a cell of a terrain model) covers, D is a smooth function that no orientation changes. A point P, which
is x1(P) in the first image and x2(P) in the second, lies on that surface when its height parallax is none:

    F(P) = e' (x2(P) - D(x1(P))),    h = F / |grad F|       m, along the surface's normal grad F / |grad F|,

where e is the direction in which the second image moves when the ground comes towards the first camera (along the
epipolar line). The orientation corrections move x1 and x2, and the surface with them. F is continuous, whatever P and
the orientation are: nothing is associated with anything.

D is made of local planes: at each node the matches' least-squares plane with Gaussian weights, whose width is that of
the footprint; between nodes it is a cubic spline.

Stereo surfaces as files hold them: whole, in a fifth of their bytes.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from mgsgraph.compiled import in_threads, shares
from mgsgraph.errors import InputError
from mgsgraph.geometry.body import east_north
from mgsgraph.geometry.image import PushbroomImage
from mgsgraph.geometry.orientation import OrientationCorrection
from mgsgraph.geometry.records import Array, Mask, assign, frozen
from mgsgraph.geometry.rotation import unit_vectors
from mgsgraph.record import Record

_NODES_PER_WIDTH = 2.0
"""Nodes per standard deviation of the footprint: the spline between them is exact to 1e-3 of what the average lost."""
_FINER = 2
"""Nodes of a search per node of the surface: linear between them, heights are exact to 1/128 of what the ground bends
within a standard deviation of the footprint."""
_REACH = 4.0
"""Standard deviations up to which matches count."""
LEAST_SHARE = 0.5
"""Of the usual weight of matches about a node, below which it has no average: a hole, or the edge."""
RESOLUTION = 2.0**-16
"""pixels, of which places are whole multiples: a thousandth of what matches are good to. So files hold them whole."""
_OUTLIER = 4.0
"""Standard deviations from the average, by the mean distance of the matches about, beyond which one is left out of it.
"""
_WORTHWHILE = 5000
"""Points for which a thread of their own saves more than it costs."""
_OF_NORMAL = 1.2533
"""Standard deviation of a normal distribution in its mean distance."""


@dataclass(frozen=True, eq=False)
class StereoSurface(Record):
    """Averaged disparity of two images at nodes of the first; r rows of nodes, c columns."""

    first: Array
    """(2,) line and sample of the first node."""
    step: Array
    """(2,) lines between rows, samples between columns."""
    places: Array
    """(r, c, 2) line and sample in the second image of what is at each node."""
    covered: Mask
    """(r, c) where there were matches enough; elsewhere `places` are a smooth continuation."""
    sigmas: Array
    """(r, c) pixels along the disparity, of the average by matching."""
    roughness: Array
    """(r, c) pixels along the disparity, rms of the ground's height within the footprint about its plane."""

    def __post_init__(self) -> None:
        shape = np.shape(self.covered)
        where = "stereo surface"
        assign(
            self,
            first=frozen(self.first, f"{where}, first node", (2,)),
            step=frozen(self.step, f"{where}, step", (2,)),
            places=frozen(self.places, f"{where}, places", (*shape, 2)),
            sigmas=frozen(self.sigmas, f"{where}, sigmas", shape),
            roughness=frozen(self.roughness, f"{where}, roughness", shape),
        )

    @cached_property
    def _splines(self) -> tuple[Any, Any]:
        """Cubic splines of line and sample in the second image, over rows and columns of nodes."""
        from scipy.interpolate import RectBivariateSpline

        rows, columns = (np.arange(size, dtype=np.float64) for size in self.covered.shape)
        line, sample = (RectBivariateSpline(rows, columns, self.places[:, :, k]) for k in range(2))
        return line, sample

    @cached_property
    def fine(self) -> tuple[int, Array]:
        """How much denser the nodes are, and (2, rows, columns) line and sample in the second image there; between them
        the surface is nearly linear: for searches.
        """
        rows, columns = (np.linspace(0.0, size - 1.0, (size - 1) * _FINER + 1) for size in self.covered.shape)
        return _FINER, np.stack([spline(rows, columns) for spline in self._splines])

    def disparity(self, places: Array) -> tuple[Array, Array]:
        """Line and sample (n, 2) in the second image of places (n, 2) in the first, beyond the nodes the last; and
        (n, 2, 2) derivatives by the places.
        """
        at = ((places - self.first) / self.step).T
        values = [spline.ev(*at) for spline in self._splines]
        slopes = [[spline.ev(*at, dx=1 - k, dy=k) for k in range(2)] for spline in self._splines]
        return np.stack(values, axis=1), np.transpose(slopes, (2, 0, 1)) / self.step

    def at_nodes(self, places: Array) -> tuple[Mask, Array, Array]:
        """Of places (n, 2) in the first image: whether all nodes around are covered; sigma and roughness (n,) in
        pixels, of the nearest node.
        """
        spot = (places - self.first) / self.step
        shape = np.array(self.covered.shape)
        inside = np.all((spot >= 0.0) & (spot <= shape - 1.0), axis=1)
        low = np.clip(np.nan_to_num(np.floor(spot)), 0, shape - 2).astype(np.int64)
        around = np.all([self.covered[low[:, 0] + i, low[:, 1] + j] for i in (0, 1) for j in (0, 1)], axis=0)
        near = tuple(np.clip(np.nan_to_num(np.rint(spot)), 0, shape - 1).astype(np.int64).T)
        return inside & around, self.sigmas[near], self.roughness[near]


def averaged_surface(
    anchors: Array,
    places: Array,
    variances: Array,
    ground_pixel: Array,
    width: float,
    window: float,
    least_share: float = LEAST_SHARE,
) -> StereoSurface:
    """Average dense matches over a footprint.

    Parameters
    ----------
    anchors, places : (n, 2)
        Line and sample of each match in the first and in the second image.
    variances : (n,)
        pixels^2, of each along the disparity.
    ground_pixel : (2,)
        m on the ground of a line and of a sample of the first image.
    width : float
        m, standard deviation of the Gaussian footprint: a quarter of its diameter.
    window : float
        m, width of the matching window: matches nearer to one another are not independent.
    least_share : float
        Of the usual weight of matches about a node, below which it is not covered.

    Raises
    ------
    InputError
        When the matches cover no footprint.
    """
    step = width / _NODES_PER_WIDTH / ground_pixel
    first = anchors.min(axis=0) - _REACH * width / ground_pixel
    shape = tuple((np.ceil((anchors.max(axis=0) - first) / step + _REACH * _NODES_PER_WIDTH) + 1).astype(int))
    spots = (anchors - first) / step
    trend = _Trend(anchors, places)
    left = places - trend.at(anchors)
    selected = np.ones(len(anchors), dtype=bool)
    for _ in range(2):
        planes = _local_planes(spots[selected], left[selected], variances[selected], shape, least_share)
        if not np.any(planes.covered):
            raise InputError(
                "stereo surface", f"{len(anchors)} dense matches, nowhere enough for a footprint of {4 * width:.0f} m",
                "images that overlap and match", "take a smaller spacing of the matches",
            )  # fmt: skip
        selected = _inliers(spots, left, _continued(planes.values, planes.covered))
    rows, columns = np.meshgrid(*(np.arange(size) for size in shape), indexing="ij")
    nodes = first + np.stack([rows, columns], axis=2).reshape(-1, 2) * step
    whole = trend.at(nodes).reshape(*shape, 2) + _continued(planes.values, planes.covered)
    places = RESOLUTION * np.rint(whole / RESOLUTION)
    independent = max(1.0, 4.0 * np.pi * width**2 / window**2)  # windows that the Gaussian's equivalent area holds
    sigmas = np.sqrt(planes.variance / independent)
    rounded = [coarse(np.where(planes.covered, values, 0.0)) for values in (sigmas, planes.roughness)]
    return StereoSurface(first, step, places, planes.covered, *rounded)


def coarse(values: Array) -> Array:
    """Values rounded to eleven bits, which is enough of a sigma."""
    return values.astype(np.float16).astype(np.float64)


class _Trend:
    """A polynomial of second order through the disparities, so that the rest is small."""

    def __init__(self, anchors: Array, places: Array) -> None:
        self._middle, self._half = anchors.mean(axis=0), np.maximum(np.ptp(anchors, axis=0) / 2.0, 1.0)
        self._coefficients = np.linalg.lstsq(self._terms(anchors), places, rcond=None)[0]

    def _terms(self, places: Array) -> Array:
        u, v = ((places - self._middle) / self._half).T
        return np.stack([np.ones_like(u), u, v, u * u, u * v, v * v], axis=1)

    def at(self, places: Array) -> Array:
        return np.asarray(self._terms(places) @ self._coefficients)


class _Planes(NamedTuple):
    """Least-squares planes about nodes; r rows, c columns."""

    values: Array
    """(r, c, 2) at the node; zero where it is not covered."""
    covered: Mask
    """(r, c)"""
    variance: Array
    """(r, c) mean variance of the matches."""
    roughness: Array
    """(r, c) rms of the values about the plane, along the larger of both."""


def _moments(spots: Array, shape: tuple[int, ...]) -> Callable[[Array], Array]:
    """Gaussian sums about nodes, as a function of the weights (n,) of matches at `spots` (n, 2) counted in nodes."""
    from scipy.ndimage import gaussian_filter

    low = np.floor(spots).astype(np.int64)
    part = spots - low
    number = np.stack([(low[:, 0] + i) * shape[1] + low[:, 1] + j for i in (0, 1) for j in (0, 1)])
    share = np.stack([np.abs(1 - i - part[:, 0]) * np.abs(1 - j - part[:, 1]) for i in (0, 1) for j in (0, 1)])

    def moment(weights: Array) -> Array:
        gathered = np.bincount(number.ravel(), (share * weights).ravel(), shape[0] * shape[1]).reshape(shape)
        return np.asarray(gaussian_filter(gathered, _NODES_PER_WIDTH, mode="constant", truncate=_REACH))

    return moment


def _inliers(spots: Array, values: Array, averages: Array) -> Mask:
    """(n,) matches at `spots` (n, 2) counted in nodes whose values (n, 2) are no farther from the averages (r, c, 2) at
    nodes than those about them: on a canyon's edge all are far.
    """
    from scipy.ndimage import map_coordinates

    moment, inliers = _moments(spots, averages.shape[:2]), np.ones(len(spots), dtype=bool)
    counts = np.maximum(moment(np.ones(len(spots))), 1e-12)
    for k in range(2):
        off = np.abs(values[:, k] - map_coordinates(averages[:, :, k], spots.T, order=1))
        usual = _OF_NORMAL * map_coordinates(moment(off) / counts, spots.T, order=1)
        inliers &= off <= _OUTLIER * usual + 1e-12
    return inliers


def _local_planes(
    spots: Array, values: Array, variances: Array, shape: tuple[int, ...], least_share: float
) -> _Planes:
    """Planes with Gaussian weights about nodes: moments of the matches, gathered at nodes and smoothed.

    `spots` (n, 2) are places counted in nodes; `values` (n, 2).
    """
    moment = _moments(spots, shape)
    r, c = np.meshgrid(*(np.arange(size, dtype=np.float64) for size in shape), indexing="ij")
    y, x = spots.T
    ones = np.ones(len(spots))
    sums = [moment(weights) for weights in (ones, y, x, y * y, y * x, x * x)]
    s, sy, sx = sums[0], sums[1] - r * sums[0], sums[2] - c * sums[0]
    syy = sums[3] - 2.0 * r * sums[1] + r * r * sums[0]
    syx = sums[4] - r * sums[2] - c * sums[1] + r * c * sums[0]
    sxx = sums[5] - 2.0 * c * sums[2] + c * c * sums[0]
    usual = np.median(s[s > 0.1 * s.max()])
    normal = np.stack([np.stack(row, axis=2) for row in ((s, sy, sx), (sy, syy, syx), (sx, syx, sxx))], axis=2)
    spread = np.linalg.det(normal) > 1e-3 * np.prod(np.diagonal(normal, axis1=2, axis2=3), axis=2)
    covered = (s > least_share * usual) & spread
    normal = np.where(covered[:, :, None, None], normal, np.eye(3))
    fitted, scatter = np.zeros((*shape, 2)), np.zeros((*shape, 2))
    for k in range(2):
        f = values[:, k]
        t = [moment(weights) for weights in (f, y * f, x * f)]
        right = np.stack([t[0], t[1] - r * t[0], t[2] - c * t[0]], axis=2)
        plane = np.linalg.solve(normal, right[:, :, :, None])[:, :, :, 0]
        squares = moment(f * f) - np.einsum("rcp,rcp->rc", plane, right)
        scatter[:, :, k] = np.sqrt(np.maximum(squares, 0.0) / np.maximum(s, 1e-12))
        fitted[:, :, k] = np.where(covered, plane[:, :, 0], 0.0)
    return _Planes(fitted, covered, moment(variances) / np.maximum(s, 1e-12), scatter.max(axis=2))


def _continued(values: Array, covered: Mask) -> Array:
    """Values (r, c, 2) of nodes that are not covered are averages of what is near, however far that is."""
    from scipy.ndimage import gaussian_filter

    result, filled = np.where(covered[:, :, None], values, 0.0), covered.copy()
    width = _NODES_PER_WIDTH
    while not filled.all() and width < 2.0 * max(covered.shape):
        weight = gaussian_filter(filled.astype(np.float64), width, mode="constant")
        new = ~filled & (weight > 1e-3)
        for k in range(2):
            near = gaussian_filter(np.where(filled, result[:, :, k], 0.0), width, mode="constant")
            result[new, k] = near[new] / weight[new]
        filled, width = filled | new, 2.0 * width
    return result


class SurfaceHeights(NamedTuple):
    """Heights of n points above a stereo surface, with their derivatives."""

    heights: Array
    """(n,) m, along the normal; NaN for a point that one of the images doesn't see."""
    normals: Array
    """(n, 3) unit, body-fixed, upward: derivative by the point."""
    by_pose: Array
    """(n, 2, 9) derivative by the correction of the first and the second image's position (m per m), rotation (m per
    rad), and detector x and y and focal length (m per m) at their places."""
    lines: Array
    """(n, 2) lines of the two images in which the points are."""
    samples: Array
    """(n, 2) their samples."""
    covered: Mask
    """(n,) whether the surface is known there."""
    sigmas: Array
    """(n,) m along the normal, by matching."""
    roughness: Array
    """(n,) m along the normal, rms of the ground within the footprint about its plane."""
    parallax: Array
    """(n,) pixels across the epipolar line: what the orientation leaves, no height."""


def heights_above(
    surface: StereoSurface,
    first: PushbroomImage,
    second: PushbroomImage,
    points: Array,
    corrections: tuple[OrientationCorrection, OrientationCorrection],
    level: Mask | None = None,
    start: Array | None = None,
) -> SurfaceHeights:
    """Heights of points (n, 3), m, above a surface, by the corrections of the two images; those of points that are
    `level` (n,) along the vertical, with the derivatives that level ground would have. `start` (n, 2) are lines near
    which they are seen.
    """

    def part(rows: slice) -> SurfaceHeights:
        flat, begin = None if level is None else level[rows], None if start is None else start[rows]
        return _heights_above(surface, (first, second), points[rows], corrections, flat, begin)

    return SurfaceHeights(*map(np.concatenate, zip(*in_threads(part, shares(len(points), _WORTHWHILE)), strict=True)))


def _heights_above(
    surface: StereoSurface,
    images: tuple[PushbroomImage, PushbroomImage],
    points: Array,
    corrections: tuple[OrientationCorrection, OrientationCorrection],
    level: Mask | None,
    start: Array | None,
) -> SurfaceHeights:
    """`heights_above` for some points."""
    (first, second), guesses = images, (None, None) if start is None else start.T
    (places, by_point), (other_places, other_by_point) = (
        image.ground_to_image(points, *arguments)
        for image, *arguments in zip(images, corrections, guesses, strict=True)
    )
    visible = np.isfinite(places[:, 0]) & np.isfinite(other_places[:, 0])
    usable = np.where(visible[:, None], places, surface.first)
    disparity, slopes = surface.disparity(usable)
    if level is not None:
        slopes[level] = _level_slopes(points[level], by_point[level], other_by_point[level])
    towards = -first.sightlines(usable[:, 0], usable[:, 1], corrections[0])[1]
    epipolar = unit_vectors(np.einsum("nij,nj->ni", other_by_point, towards))
    back = -np.einsum("ni,nij->nj", epipolar, slopes)
    gradient = np.einsum("ni,nij->nj", epipolar, other_by_point) + np.einsum("ni,nij->nj", back, by_point)
    size = np.linalg.norm(gradient, axis=1, keepdims=True)
    off = other_places - disparity
    of_first = np.einsum("ni,nij->nj", back, first.by_correction(points, places, corrections[0]))
    of_second = np.einsum("ni,nij->nj", epipolar, second.by_correction(points, other_places, corrections[1]))
    covered, sigmas, roughness = surface.at_nodes(places)
    return SurfaceHeights(
        np.einsum("ni,ni->n", epipolar, off) / size[:, 0],
        gradient / size,
        np.stack([of_first, of_second], axis=1) / size[:, :, None],
        np.stack([places[:, 0], other_places[:, 0]], axis=1),
        np.stack([places[:, 1], other_places[:, 1]], axis=1),
        covered & visible,
        sigmas / size[:, 0],
        roughness / size[:, 0],
        epipolar[:, 0] * off[:, 1] - epipolar[:, 1] * off[:, 0],
    )


def _level_slopes(points: Array, by_point: Array, other_by_point: Array) -> Array:
    """(n, 2, 2) derivative of the disparity by the position in the first image, of level ground at points (n, 3)."""
    ways = east_north(points).mT
    first, second = ((part @ ways).mT for part in (by_point, other_by_point))
    return np.swapaxes(np.linalg.solve(first, second), 1, 2)


# --- as files hold them

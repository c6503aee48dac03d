"""Statistics of an adjustment in two steps: sigmas of points and orientation, and heights above the terrain, at
each stage; by strip and for all. SI units, NaN for nothing.

Heights are compared like with like: at every stage of the places where the rays alone put the points, with the
orientation of the stage. (In step 2 each point has a height row of its own, which pulls it to the terrain; with that
the heights would be smaller, whatever the orientation.)

Tables, words and figures all take their numbers here, so that they can't contradict each other.

Heights above a terrain model by cell of a map.
"""

from dataclasses import dataclass

import numpy as np

from mgsgraph.adjustment.frames import FLIGHT_NAMES
from mgsgraph.adjustment.two_steps import TwoSteps, heights_above, orientation_values
from mgsgraph.analysis.statistics import flight_axes_at, mean_and_rms, pose_sigmas, sigmas_along
from mgsgraph.files.networks.tie_points import PointKind
from mgsgraph.geometry.body import in_turn, planetocentric
from mgsgraph.geometry.orientation import OrientationCorrection
from mgsgraph.geometry.records import Array, Index, Mask
from mgsgraph.network import Network, PointClass
from mgsgraph.units import DEG

STAGES = ("before", "step_1", "step_2")
"""Nominal orientation and a-priori sigmas; adjusted without terrain; adjusted with it."""
POINT_AXES = ("X", "Y", "Z")
"""Flight direction, across track to the left, height."""
POSE_AXES = FLIGHT_NAMES
"""Components of `GroupStatistics.poses`: m, then rad."""
_LINES = 31
"""Lines of an image at which its orientation is looked at, as the papers do."""


@dataclass(frozen=True, slots=True, eq=False)
class HeightStatistics:
    """Heights of points above the terrain model."""

    count: int
    """Points whose height row took part in step 2."""
    rms: Array
    """(stages,) m, by rays alone."""
    mean: Array
    """(stages,) m, mean height by rays alone."""

    @property
    def factors(self) -> Array:
        """(stages,) reduction factor: rms of the stage `before` over that of each stage."""
        return ratio(self.rms[0], self.rms)


@dataclass(frozen=True, slots=True, eq=False)
class GroupStatistics:
    """Of one strip, one image in no strip, or all."""

    name: str
    """Name of the strip or image, or "all"."""
    points: int
    """Tie points that have a place after both steps."""
    mean: Array
    """(stages, 3) m, mean sigma of these along X (flight), Y (across), Z (height); for sigma0 = 1."""
    median: Array
    """(stages, 3) m, median of the same."""
    poses: Array
    """(stages, 6) m and rad, mean sigma of the orientation over evenly spaced lines, as POSE_AXES: of the image, of a
    strip's middle image alone, or the mean of these over all groups."""
    heights: HeightStatistics
    """Of tie points over the terrain model."""

    @property
    def point_factors(self) -> Array:
        """(stages, 3) reduction factor: mean sigma of the stage `before` over that of each stage."""
        return ratio(self.mean[0], self.mean)


@dataclass(frozen=True, slots=True, eq=False)
class TwoStepStatistics:
    """Statistics of an adjustment in two steps."""

    steps: TwoSteps
    """The adjustment."""
    whole: GroupStatistics
    """All strips together; each point counts once, in the axes of the first strip that sees it."""
    groups: tuple[GroupStatistics, ...]
    """Strips, then images in none; a point that two of them see counts in both."""
    points: Index
    """(m,) points of `heights`."""
    heights: Array
    """(stages, m) m above the terrain model, by rays alone; the model is where it is given, in step 2 where that puts
    it."""
    used: Mask
    """(m,) whose row took part in step 2; the others were judged to be off."""
    without_row: int
    """Tie points without a height row: beside the model, or of whose four posts some are missing."""
    left_out: int
    """Tie points with a height row that lie there at some stage, or have no place: left out of `heights`."""


def ratio(before: Array, after: Array) -> Array:
    """Quotient of before and after; NaN where that is not defined."""
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(np.where(np.asarray(after) > 0.0, before / np.asarray(after), np.nan))


def two_step_statistics(steps: TwoSteps) -> TwoStepStatistics:
    """Statistics of both steps.

    A-priori sigmas of points are those of forward intersection (`adjustment.two_steps.RaysAlone`), of the rays that
    step 1 left in.
    """
    network = steps.network
    before, covariances = steps.rays_alone.nominal()
    ties = _ties(steps)
    heights = _heights(steps, before)
    assert network.surface is not None
    of_ties, with_row = network.points.classes == PointClass.TIE, np.isfinite(network.surface.sigmas)
    complete = np.all(np.isfinite(heights), axis=0) & of_ties & with_row
    used = complete & ~steps.off
    groups = []
    first = np.full(len(network.points), -1, dtype=np.int64)
    for name, images in owners(network):
        rays = _first_rays(steps, images)
        mine = network.rays.point[rays]
        fresh = first[mine] < 0
        first[mine[fresh]] = rays[fresh]
        heights_of = _height_statistics(heights, mine[used[mine]])
        poses = _poses(steps, int(images[images.size // 2]))
        sigmas = _sigmas(steps, covariances, rays[ties[mine]])
        groups.append(_group(name, sigmas, poses, heights_of))
    rays = first[ties & (first >= 0)]
    everything = _group(
        "all",
        _sigmas(steps, covariances, rays),
        np.mean([group.poses for group in groups], axis=0),
        _height_statistics(heights, np.flatnonzero(used & (first >= 0))),
    )
    points = np.flatnonzero(complete)
    without_row, left_out = (int(np.count_nonzero(of_ties & one)) for one in (~with_row, with_row & ~complete))
    of_points = points, heights[:, points], used[points]
    return TwoStepStatistics(steps, everything, tuple(groups), *of_points, without_row, left_out)


def owners(network: Network) -> list[tuple[str, Index]]:
    """Strips with their images; then every other image that is adjusted, or all where none is."""
    strips = [(strip.name, strip.images) for strip in network.passes]
    alone = np.flatnonzero(network.with_polynomial)
    if not strips and not alone.size:
        alone = np.arange(len(network.images))
    return strips + [(network.images[j].name, np.array([j])) for j in alone.tolist()]


def _ties(steps: TwoSteps) -> Mask:
    """(n,) tie points with an adjusted place after both steps."""
    points = steps.network.points
    mine = (points.classes == PointClass.TIE) & (points.kinds != PointKind.FIXED)
    return np.asarray(mine & steps.free.determined & steps.fitted.determined)


def _first_rays(steps: TwoSteps, images: Index) -> Index:
    """The first ray that took part of each point that some images see."""
    rays = steps.network.rays
    mine = np.flatnonzero(np.isin(rays.image, images) & steps.free.rays_used)
    _, first = np.unique(rays.point[mine], return_index=True)
    return mine[first]


def _sigmas(steps: TwoSteps, before: Array, rays: Index) -> Array:
    """(stages, n, 3) m of the points of some rays, each in the flight of its ray's image."""
    network = steps.network
    points, image = network.rays.point[rays], network.rays.image[rays]
    velocities = np.empty((rays.size, 3))
    for j in np.unique(image).tolist():
        mine = image == j
        velocities[mine] = network.images[j].pose(network.rays.places[rays[mine], 0]).velocity
    axes = flight_axes_at(steps.fitted.places[points], velocities)
    covariances = (before, steps.free.covariances, steps.fitted.covariances)
    return np.stack([sigmas_along(axes, one[points]) for one in covariances])


def _poses(steps: TwoSteps, image: int) -> Array:
    """(stages, 6) m and rad, mean over the lines of an image."""
    lines = np.linspace(0.0, float(steps.network.images[image].lines), _LINES)
    result = np.full((len(STAGES), 6), np.nan)
    for k, solution in enumerate((steps.free, steps.fitted), start=1):
        correction, joint = solution.correction(image), solution.joint_covariance
        result[k] = pose_sigmas(solution.network, image, correction, joint, lines).mean(axis=0)
    prior = steps.rays_alone.joint
    if prior is not None:
        adjusted = steps.free.correction(image)
        nominal = OrientationCorrection(np.zeros_like(adjusted.coefficients), adjusted.angles, adjusted.nodes)
        result[0] = pose_sigmas(steps.free.network, image, nominal, prior, lines).mean(axis=0)
    return result


def _heights(steps: TwoSteps, before: Array) -> Array:
    """(stages, n) m above the terrain model."""
    places, _ = steps.rays_alone.at(orientation_values(steps.network, steps.fitted))
    stages = [(before, None), (steps.free.places, None), (places, steps.fitted)]
    return np.stack([heights_above(steps.network, *stage)[0] for stage in stages])


def _height_statistics(heights: Array, points: Index) -> HeightStatistics:
    mean, rms = mean_and_rms(heights[:, points].T)
    return HeightStatistics(points.size, rms, mean)


def _group(name: str, sigmas: Array, poses: Array, heights: HeightStatistics) -> GroupStatistics:
    count = sigmas.shape[1]
    nothing = np.full((len(STAGES), 3), np.nan)
    mean = sigmas.mean(axis=1) if count else nothing
    median = np.median(sigmas, axis=1) if count else nothing
    return GroupStatistics(name, count, mean, median, poses, heights)


_ENOUGH = 6.0
"""Points that cells which have any should hold on the average: the rms of so few is known to a third."""
_MOST = 60
"""Cells along the longer side of a map."""
_LEAST = 1e-4 * DEG
"""Height of a cell."""


@dataclass(frozen=True, slots=True, eq=False)
class HeightCells:
    """Count, root mean square and mean of heights by cell; rows go north, columns go east."""

    west: float
    """rad, east longitude of the western edge, of any turn."""
    south: float
    """rad, planetocentric latitude of the southern edge."""
    steps: tuple[float, float]
    """rad, width and height of a cell."""
    count: Index
    """(rows, columns) points."""
    rms: Array
    """(stages, rows, columns) m; NaN for a cell without points."""
    mean: Array
    """(stages, rows, columns) m; NaN for a cell without points."""

    @property
    def extent(self) -> tuple[float, float, float, float]:
        """deg, west, east, south and north."""
        rows, columns = self.count.shape
        return (
            self.west / DEG,
            (self.west + columns * self.steps[0]) / DEG,
            self.south / DEG,
            (self.south + rows * self.steps[1]) / DEG,
        )

    @property
    def total(self) -> Array:
        """(stages,) m, root mean square over all points."""
        squares = np.nansum(self.rms**2 * self.count, axis=(1, 2))
        return np.asarray(np.sqrt(squares / max(int(self.count.sum()), 1)))


def height_cells(places: Array, heights: Array, step: float | None = None) -> HeightCells:
    """Sort heights into cells.

    Parameters
    ----------
    places : (n, 3)
        m, body-fixed: where each point lies at all stages, so that a cell always has the same points. At least one.
    heights : (stages, n)
        m.
    step : float, optional
        rad, height of a cell, whose width is about the same on the ground; one that leaves some points in a cell
        when absent.
    """
    east, north = turned(places)
    ratio = max(round(1.0 / max(float(np.cos(np.median(north))), 0.05)), 1)
    if step is None:
        sides = np.array([np.ptp(east) / ratio, np.ptp(north)])
        step = max(float(np.sqrt(sides.prod() * _ENOUGH / east.size)), float(sides.max()) / _MOST, _LEAST)
    steps = (step * ratio, step)
    west, column, columns = _sorted(east, steps[0])
    south, row, rows = _sorted(north, steps[1])
    cell = row * columns + column
    count = np.bincount(cell, minlength=rows * columns)
    with np.errstate(invalid="ignore"):
        means, squares = (
            np.stack([np.bincount(cell, values, rows * columns) for values in stack]) / count
            for stack in (heights, heights**2)
        )
    shape = len(heights), rows, columns
    return HeightCells(
        west, south, steps, count.reshape(rows, columns), np.sqrt(squares).reshape(shape), means.reshape(shape)
    )


def turned(places: Array, middle: float | None = None) -> tuple[Array, Array]:
    """Longitudes (n,), in the turn of their mean direction or of a `middle`, and latitudes (n,), rad, of places (n, 3)
    in m, body-fixed.
    """
    longitudes, latitudes, _ = planetocentric(places).T
    if middle is None:
        middle = float(np.arctan2(np.sin(longitudes).mean(), np.cos(longitudes).mean())) % (2.0 * np.pi)
    return in_turn(longitudes, middle), latitudes


def _sorted(values: Array, step: float) -> tuple[float, Index, int]:
    """First edge, cell of each value, and number of cells; edges are multiples of the step."""
    low = int(np.floor(values.min() / step + 1e-9))
    index = np.maximum(np.floor(values / step + 1e-9).astype(np.int64) - low, 0)
    return low * step, index, int(index.max()) + 1

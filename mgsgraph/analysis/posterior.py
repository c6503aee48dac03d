"""The posterior: points, poses at any line, pairs, projections, new intersections, and their covariances.

posterior = mgsgraph.Posterior.of(solution)
posterior.point("T17").ellipsoid(0.95)
posterior.difference("T17", "T42")
posterior.pose("M07/02345", line=512.0)

The posterior of some points alone: their rows, and the covariance, known already, of the unknowns they share;
and the covariances of one point with all others of a network.
"""

from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from mgsgraph.adjustment.covariances import Linearised, PointRows, point_rows
from mgsgraph.adjustment.graph import Layout
from mgsgraph.adjustment.marginals import JointCovariance, dense_covariance
from mgsgraph.adjustment.settings import SolverSettings
from mgsgraph.adjustment.solution import Solution
from mgsgraph.analysis.estimates import (
    Difference,
    Estimate,
    PixelEstimate,
    PoseEstimate,
    PositionEstimate,
    Quantity,
    covariance,
    joined,
)
from mgsgraph.analysis.likelihood import Likelihood
from mgsgraph.analysis.linearised import at_solution, at_values
from mgsgraph.errors import InputError, require
from mgsgraph.geometry import rotation
from mgsgraph.geometry.image import PushbroomImage
from mgsgraph.geometry.orientation import COMPONENTS, OrientationCorrection
from mgsgraph.geometry.records import Array, Index, Mask, joined_rows
from mgsgraph.kernel.rows import FIXED, GOOD, OUT
from mgsgraph.kernel.sweep import COSTS, point_covariances, reduce
from mgsgraph.names import numbered
from mgsgraph.network import ImageRays, Network
from mgsgraph.network.corrections import adjusted_image, designs, whole_correction
from mgsgraph.network.parts import ByUnknown, Unknown, select_points, unknowns
from mgsgraph.record import Record

_AXES = COMPONENTS[:3]
_CONTRADICTION = 10.0
"""Sigmas by which new rays may miss each other: beyond, they are of two places."""
_POSE_UNITS = ("m", "m", "m", "rad", "rad", "rad")


@dataclass(frozen=True, slots=True)
class Pixel(Record):
    """An image point, measured or to be measured.

    Examples
    --------
    >>> pixels = [mgsgraph.Pixel("SIM/A", 2500.0, 512.0, 0.5), mgsgraph.Pixel("SIM/B", 2488.0, 502.0, 0.5)]
    >>> print(posterior.intersection(pixels, "rim"))
    PositionEstimate('rim', sigma east 6.27 m, north 6.83 m, up 19.5 m)
    """

    image: str
    """Name of the image."""
    line: float
    """Line coordinate."""
    sample: float
    """Sample coordinate."""
    sigma: float = 1.0
    """px, of line and sample."""


class Posterior(Record):
    """Estimates and covariances of an adjustment, computed when asked for.

    All covariances are for sigma0 = 1, as the a-priori sigmas imply.

    Parameters
    ----------
    linearised : Linearised
        The network where it was solved (`Posterior.of` makes it from a solution).

    Examples
    --------
    >>> posterior = mgsgraph.Posterior.of(solution)
    >>> print(posterior.point("TIE00001"))
    PositionEstimate('TIE00001', sigma east 6.73 m, north 7.39 m, up 21.5 m)
    >>> print(posterior.difference("TIE00001", "TIE00002").sentence)
    TIE00002 lies 60.4 m below TIE00001, sigma 16.3 m (31.3 m if their errors were independent): 3.7 sigma, the
    difference is real (chance 0.00021)
    >>> posterior.joint([posterior.of_point("TIE00001"), posterior.of_pose("SIM/A", 512.0)]).correlation.shape
    (9, 9)
    """

    def __init__(self, linearised: Linearised) -> None:
        self.linearised = linearised
        self.network = linearised.network

    def __repr__(self) -> str:
        return f"Posterior({self.network!r})"

    @classmethod
    def of(cls, solution: Solution) -> "Posterior":
        """The posterior of a solution."""
        return cls(at_solution(solution))

    # --- answers

    # points and images are asked for by their names or their numbers in the network; InputError where there is none

    def point(self, name: str | int) -> PositionEstimate:
        """Place and covariance of an adjusted ground point."""
        quantity = self.of_point(name)
        return PositionEstimate(self._point_name(name), quantity.values, self.covariance([quantity]))

    def difference(self, first: str | int, second: str | int) -> Difference:
        """From the first point to the second: vector, height difference and distance, with what they share left out."""
        first, second = self._point_name(first), self._point_name(second)
        require(first != second, f"points {first}, {second}", "the same point twice", "two points")
        points = [self.of_point(first), self.of_point(second)]
        return Difference(first, second, points[0].values, points[1].values, self.covariance(points))

    def pose(self, image: str | int, line: float) -> PoseEstimate:
        """Exterior orientation of an image at a line."""
        return self.poses(image, np.array([line]))[0]

    def poses(self, image: str | int, lines: Array) -> list[PoseEstimate]:
        """Exterior orientation of an image at several lines (n,)."""
        j = self.network.image_number(image)
        picture, correction = self.network.images[j], self.correction(j)
        pose = picture.pose(lines, correction)
        covariances = [covariance(quantity, self.linearised.joint) for quantity in self._of_poses(j, lines)]
        return [
            PoseEstimate(picture.name, float(line), pose.position[k], pose.velocity[k], pose.matrix[k], covariances[k])
            for k, line in enumerate(lines)
        ]

    def projection(self, point: str | int, image: str | int) -> PixelEstimate:
        """Where an adjusted point falls in an image, measured there or not: line and sample with their covariance."""
        quantity = self.of_projection(point, image)
        names = self._point_name(point), self.network.images[self.network.image_number(image)].name
        return PixelEstimate(*names, quantity.values, self.covariance([quantity]))

    def intersection(self, pixels: Sequence[Pixel], name: str = "intersection") -> PositionEstimate:
        """Ground place of new measures, with their own noise and that of the orientation; two rays or more."""
        rows, place = self._crossing(pixels, name)
        quantity = self._of_crossing(rows, place, name)
        misfit = self._misfit(rows, name)
        return PositionEstimate(name, quantity.values, self.covariance([quantity]), misfit)

    def joint(self, quantities: Sequence[Quantity]) -> Estimate:
        """Several quantities with their joint covariance and correlations."""
        stacked = joined(quantities)
        return Estimate(stacked.names, stacked.units, stacked.values, covariance(stacked, self.linearised.joint))

    def covariance(self, quantities: Sequence[Quantity]) -> Array:
        """(m, m) joint covariance of several quantities, one after another."""
        return covariance(joined(quantities), self.linearised.joint)

    # --- quantities

    def of_point(self, name: str | int) -> Quantity:
        """X, Y, Z of an adjusted ground point."""
        i = self.network.point_number(name)
        name = self.network.points.ids[i]
        place = self.linearised.layout_index(i)
        names = tuple(f"{axis} of point {name}" for axis in _AXES)
        values = self.linearised.points[place]
        if self.linearised.rows.kind[place] == FIXED:
            return Quantity(names, ("m",) * 3, values, {}, {})
        return self._of_point(names, values, self.linearised.rows_of(i), ("point", i))

    def of_pose(self, image: str | int, line: float) -> Quantity:
        """Position along the body-fixed axes (m), and rotation about the camera's axes (rad), of an image at a line."""
        return self._of_poses(self.network.image_number(image), np.array([line]))[0]

    def of_projection(self, point: str | int, image: str | int) -> Quantity:
        """Line and sample of an adjusted point in an image."""
        j, ground = self.network.image_number(image), self.of_point(point)
        point, image = self._point_name(point), self.network.images[j].name
        place, _ = self.image(j).ground_to_image(ground.values[None], self.correction(j))
        if not np.all(np.isfinite(place)):
            raise InputError(f"point {point}", f"image {image} does not see it", "a point in the image's field of view")
        line, sample = place[0].tolist()
        self._require_inside(j, line, sample, f"point {point}")
        lone = ImageRays(np.zeros(1, dtype=np.int64), np.array([j]), place, np.ones((1, 2)))
        layout = self.linearised.asked(ground.values[None], lone, held=True)
        rows = point_rows(layout, layout.rows, self.linearised.orientation, ground.values[None])
        names = (f"line of point {point} in image {image}", f"sample of point {point} in image {image}")
        moved = ground.through(names, ("px", "px"), place[0], -rows.by_point[0])
        by_shared = dict(moved.by_shared)
        for variable, block in self._by_variable(rows.variables, -rows.by_shared[0]).items():
            by_shared[variable] = by_shared[variable] + block if variable in by_shared else block
        return replace(moved, by_shared=by_shared)

    def of_intersection(self, pixels: Sequence[Pixel]) -> Quantity:
        """X, Y, Z of the place where the rays of new measures meet."""
        return self._of_crossing(*self._crossing(pixels, "intersection"), "intersection")

    def intersections(self, rays: ImageRays) -> tuple[Array, Array]:
        """Positions (m, 3) in m and covariances (m, 3, 3) in m^2 of many new points; NaN where their rays don't meet.

        Parameters
        ----------
        rays : ImageRays
            Measures of points 0 .. m - 1, with the sigmas they would have.
        """
        count = int(rays.point.max(initial=-1)) + 1
        layout = self.linearised.asked(np.full((count, 3), np.nan), rays, held=False)
        places, good = self._meet(layout)
        groups, target, orientation = layout.groups, layout.blocks.target, self.linearised.orientation
        pairs = self.linearised.pair_blocks(layout)
        covariances = point_covariances(layout.rows, groups, target, layout.model, orientation, pairs, places)
        covariances[~good], places[~good] = np.nan, np.nan
        return layout.network_order(places), layout.network_order(covariances)

    @cached_property
    def likelihood(self) -> Likelihood:
        """Likelihood ratios and profiles of the shared unknowns, where linear error propagation fails."""
        return Likelihood(self.linearised)

    # --- what they are made of

    def image(self, image: str | int) -> PushbroomImage:
        """One image with its adjusted focal length; its trajectory is the nominal one (`correction`)."""
        return adjusted_image(self.network, self.network.image_number(image), self.linearised.values)

    def correction(self, image: str | int) -> OrientationCorrection:
        """Whole orientation correction of an image: its own, and what shared unknowns do to it."""
        angles = self.linearised.settings.angles
        return whole_correction(self.network, self.network.image_number(image), self.linearised.values, angles)

    def _point_name(self, point: str | int) -> str:
        return self.network.points.ids[self.network.point_number(point)]

    def _require_inside(self, image: int, line: float, sample: float, where: str) -> None:
        """Raise InputError unless a place lies in an image: beyond its edges orientation is known to nobody."""
        picture = self.network.images[image]
        if not (0.0 <= line <= picture.lines and 0.0 <= sample <= picture.samples):
            raise InputError(
                f"{where}, image {picture.name}", f"line {line:g}, sample {sample:g}",
                f"a place in the image of {picture.lines} lines and {picture.samples} samples",
            )  # fmt: skip

    def _crossing(self, pixels: Sequence[Pixel], name: str) -> tuple[PointRows, Array]:
        """Rows of new measures of one place, and where their rays meet (3,) m."""
        images = np.array([self.network.image_number(pixel.image) for pixel in pixels], dtype=np.int64)
        if images.size < 2:
            raise InputError(name, f"{images.size} measures", "two or more, of images that look from different sides")
        places = np.array([[pixel.line, pixel.sample] for pixel in pixels])
        for j, (line, sample), pixel in zip(images.tolist(), places.tolist(), pixels, strict=True):
            self._require_inside(j, line, sample, name)
            if not (np.isfinite(pixel.sigma) and pixel.sigma > 0.0):
                raise InputError(f"{name}, image {pixel.image}", f"sigma {pixel.sigma} px", "a positive number")
        sigmas = np.array([[pixel.sigma] * 2 for pixel in pixels])
        rays = ImageRays(np.zeros(images.size, dtype=np.int64), images, places, sigmas)
        layout = self.linearised.asked(np.full((1, 3), np.nan), rays, held=False)
        place, good = self._meet(layout)
        require(good[0], name, "rays that don't meet before their cameras", "measures of the same place")
        return point_rows(layout, layout.rows, self.linearised.orientation, place), place[0]

    def _of_crossing(self, rows: PointRows, place: Array, name: str) -> Quantity:
        return self._of_point(tuple(f"{axis} of {name}" for axis in _AXES), place, rows, object())

    def _misfit(self, rows: PointRows, name: str) -> float:
        """By how many sigmas new rays miss each other, their own noise and that of the orientation in mind.

        Raises InputError where they can't be of one place.
        """
        through_point = rows.following()[0][0]
        rest = np.eye(rows.row.size) - through_point @ through_point.T
        through = rows.by_shared[0]
        spread = np.eye(rows.row.size) + through @ self.linearised.joint.of(rows.variables) @ through.T
        weights = np.linalg.pinv(rest @ spread @ rest, rcond=1e-9, hermitian=True)
        square = float(rows.residuals[0] @ weights @ rows.residuals[0]) / max(rows.row.size - 3, 1)
        if square > _CONTRADICTION**2:
            found = f"rays that miss each other by {np.sqrt(square):.3g} sigmas"
            raise InputError(name, found, "measures of the same place", "check lines, samples and images")
        return float(np.sqrt(square))

    def _of_poses(self, image: int, lines: Array) -> list[Quantity]:
        for line in lines.tolist():
            self._require_inside(image, line, 0.0, "pose")
        picture, correction = self.network.images[image], self.correction(image)
        moments, nominal = picture.moments(lines), picture.pose(lines)
        pose = correction.apply(nominal, moments)
        turn = np.tile(np.eye(6), (lines.size, 1, 1))
        turn[:, 3:, 3:] = correction.axes(nominal, moments)
        turned = -rotation.logarithm(pose.matrix @ nominal.matrix.mT)
        first, quantities = self.linearised.layout.variables.first, []
        follows = designs(self.network, image, correction.angles, lines)
        for k, (line, partials) in enumerate(zip(lines, follows, strict=True)):
            names = tuple(f"{name} of image {picture.name} at line {line:g}" for name in COMPONENTS)
            values = np.concatenate([pose.position[k], turned[k]])
            by_shared = {v: turn[k] @ block for v, block in partials.items() if first[v] >= 0}
            quantities.append(Quantity(names, _POSE_UNITS, values, by_shared, {}))
        return quantities

    def _of_point(self, names: tuple[str, ...], values: Array, rows: PointRows, key: Hashable) -> Quantity:
        """A place whose noise, apart from what it shares, has the key `key`."""
        by_shared, noise = rows.eliminated()
        return Quantity(names, ("m",) * 3, values, self._by_variable(rows.variables, by_shared[0]), {key: noise[0]})

    def _by_variable(self, variables: Sequence[int], columns: Array) -> dict[int, Array]:
        """Columns (m, c) of variables, one after another, split by variable; none where all images are held."""
        if not variables:
            return {}
        width = self.linearised.layout.variables.width[list(variables)]
        return dict(zip(variables, np.split(columns, np.cumsum(width)[:-1], axis=1), strict=True))

    def _meet(self, layout: Layout) -> tuple[Array, Mask]:
        """Positions (m, 3), layout order, at which new rays meet, and which of them do."""
        target, orientation = layout.blocks.target, self.linearised.orientation
        reduction = reduce(layout.rows, layout.groups, target, layout.model, orientation, COSTS)
        return reduction.points, (reduction.states == GOOD) & (layout.rows.kind != OUT)


def is_self_contained(network: Network) -> bool:
    """Whether some of its points, with the covariance of their unknowns, say of themselves what the whole says: not
    where rows of other points reach them (passes, stereo surfaces, crossovers, a raised terrain model, errors in
    common) or tests need the estimator's own covariance (considered unknowns).
    """
    raised = network.surface is not None and network.surface.raised
    profiles = any(shared.kind.of_profile for shared in network.shared)
    return not (network.passes or network.stereo is not None or network.crossovers is not None or network.considered
                or network.common or raised or profiles)  # fmt: skip


def posterior_of(
    network: Network, settings: SolverSettings, values: ByUnknown, places: Array,
    joint: Callable[[Sequence[Unknown]], Array],
) -> Posterior:  # fmt: skip
    """The posterior of a part of what was adjusted.

    Parameters
    ----------
    network : Network
        That part; `is_self_contained`.
    values : mapping
        (d,) m and rad, of its adjusted unknowns, and of any others.
    places : (n, 3)
        m, where its points are, all but; NaN for those that nothing determines.
    joint : function
        Gives the joint covariance (d, d) of some adjusted unknowns, m and rad, for sigma0 = 1.
    """
    names = unknowns(network)

    def joint_of(layout: Layout) -> JointCovariance:
        wanted = [names[v] for v in layout.variables.adjusted()]
        matrix = joint(wanted) if wanted else np.zeros((0, 0))
        return dense_covariance(layout.variables.first, layout.variables.width, matrix)

    each = [values.get(unknown, np.zeros(0)) for unknown in names]
    return Posterior(at_values(network, settings, each, places, near=True, joint_of=joint_of))


def posterior_of_points(solution: Solution, points: Index) -> Posterior | None:
    """The posterior of some points (m,) of a solution; None where these do not stand alone, or it is a mean over
    several minima.
    """
    network = solution.network.with_rejected(solution.rays_rejected, solution.ranges_rejected, solution.stereo_rejected)
    if not is_self_contained(network) or (solution.minima is not None and solution.minima.several):
        return None
    number = numbered(unknowns(network))
    values = dict(zip(number, solution.values, strict=True))
    joint = solution.joint_covariance
    return posterior_of(
        select_points(network, points), solution.settings, values, solution.places[points],
        lambda wanted: joint.of([number[unknown] for unknown in wanted]),
    )  # fmt: skip


def cross_covariances(at: Linearised, point: int) -> Array:
    """Covariances of a point with every point of a network through the unknowns that they share, for sigma0 = 1.

    With x the shared unknowns and S their covariance, point i is p_i = K_i x + N_i e_i, its noise e_i its own
    (`PointRows.eliminated`): cov(p_0, p_i) = K_0 S K_i', and K_0 S K_0' + N_0 N_0' of the point itself.

    Parameters
    ----------
    at : Linearised
    point : int
        Number of the point in the network.

    Returns
    -------
    (n, 3, 3) array
        m^2, network order; zero for fixed points, NaN for those that nothing determines.

    Raises
    ------
    InputError
        Where nothing determines the point.
    """
    place = at.layout_index(point)
    covariances = np.full((at.points.shape[0], 3, 3), np.nan)
    of_point = at.rows_of(point)
    if of_point.known:
        covariances[at.rows.kind != OUT] = 0.0
        return at.layout.network_order(covariances)
    carried, noise = of_point.eliminated()
    joint = dict[tuple[int, ...], Array]()
    for piece, (_, first, count, *_) in enumerate(at.rows.piece.tolist()):
        inside = np.flatnonzero(at.rows.kind[first : first + count] != OUT)
        if not inside.size:
            continue
        rows = at.rows_inside(piece, inside)
        members = first + inside
        if rows.known:
            covariances[members] = 0.0
            continue
        if rows.variables not in joint:
            variables_of_both = list(dict.fromkeys([*of_point.variables, *rows.variables]))
            columns = at.layout.variables.width[variables_of_both]
            begin = dict(zip(variables_of_both, np.cumsum(columns) - columns, strict=True))
            parts = [
                joined_rows(begin[v] + np.arange(at.layout.variables.width[v]) for v in variables)
                for variables in (of_point.variables, rows.variables)
            ]
            joint[rows.variables] = carried[0] @ at.joint.of(variables_of_both)[np.ix_(*parts)]
        carried_by_others, _ = rows.eliminated()
        covariances[members] = np.einsum("ac,nbc->nab", joint[rows.variables], carried_by_others)
    covariances[place] += noise[0] @ noise[0].T
    covariances[at.rows.kind == FIXED] = 0.0
    return at.layout.network_order(covariances)

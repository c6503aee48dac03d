"""What users have decided about points: measured, moved, rejected, accepted, held, released, removed.

A decision is a record of its own, keyed by the names of a point and an image; its change says who made it, when and
why. It holds for whatever comes in later: when a network is given again, or an image comes back, a removed point stays
out, a rejected measurement too, and a measurement by hand keeps its image coordinates. `project undo` takes it back.
"""

from collections.abc import Collection, Iterable, Mapping
from dataclasses import replace
from typing import Literal

import msgspec
import numpy as np

from mgsgraph.files.networks.tie_points import PointKind
from mgsgraph.geometry.records import Array
from mgsgraph.names import Names
from mgsgraph.network import GroundPoints, ImageRays, Network, PointClass, Ranges
from mgsgraph.network.parts import KnownImage, image_columns, select_points

DecisionKind = Literal["measure", "move", "reject", "accept", "hold", "release", "remove"]


class Measure(msgspec.Struct, frozen=True):
    """A measurement of a point in an image."""

    image: str
    line: float
    """px, the first pixel's centre at 0.5."""
    sample: float
    """px."""
    sigma_line: float
    """px."""
    sigma_sample: float
    """px."""
    back_projected: bool = False
    """Whether it was computed with the nominal orientation instead of measured."""
    rejected: bool = False
    """Whether the last batch adjustment rejected it as a blunder."""


class PointState(msgspec.Struct, frozen=True):
    """A point's a-priori values and image measurements."""

    class_: int
    """PointClass."""
    kind: int
    """PointKind."""
    place: tuple[float, float, float] | None
    """m, body-fixed, a-priori; None where unknown."""
    covariance: tuple[float, ...]
    """(9) m^2 of it, row by row."""
    measures: tuple[Measure, ...] = ()
    """Image measurements that adjustments use."""
    set_aside: tuple[Measure, ...] = ()
    """Image measurements that a user has rejected."""
    surface_sigma: float | None = None
    """m, sigma of its height above the terrain model; None for a point that does not lie on one."""

    def of(self, image: str) -> Measure | None:
        """The used measurement in an image; None where there is none."""
        return next((measurement for measurement in self.measures if measurement.image == image), None)

    @property
    def bare(self) -> "PointState":
        """The point without its measurements."""
        return msgspec.structs.replace(self, measures=(), set_aside=())


FREE_TIE = PointState(int(PointClass.TIE), int(PointKind.FREE), None, (0.0,) * 9)
"""A tie point without a-priori coordinates."""


class Decision(msgspec.Struct, frozen=True):
    """One decision of a user about a point, or about its measurement in an image."""

    change: int
    """Number of its change in the history."""
    at: str
    """UTC, ISO 8601."""
    who: str
    """Account of the user."""
    why: str
    """Reason, where one was given."""
    kind: DecisionKind
    point: str
    image: str
    """Empty for one about the point itself."""
    measure: Measure | None
    """The measurement: new, moved, or rejected."""
    state: PointState | None
    """The point without its measurements; None for a removed one."""


class PointDecisions:
    """What stands of the decisions about one point."""

    def __init__(self, removed: bool = False) -> None:
        self.removed = removed
        self.measured, self.rejected = dict[str, Measure](), dict[str, Measure]()
        self.prior: PointState | None = None
        """A-priori values of a point that was held or released."""
        self.state = FREE_TIE
        """The point as the last decision left it."""

    def take(self, decision: Decision) -> None:
        """Take one more, the latest."""
        image, measure = decision.image, decision.measure
        self.removed, self.state = False, decision.state or self.state
        if decision.kind in ("hold", "release"):
            self.prior = decision.state
        elif decision.kind == "reject" and measure is not None:
            self.rejected[image] = measure
        elif measure is not None:
            self.rejected.pop(image, None)
            if decision.kind in ("measure", "move"):
                self.measured[image] = measure


Decisions = Mapping[str, PointDecisions]
"""What stands, by the name of the point."""


def combined(decisions: Iterable[Decision]) -> Decisions:
    """What stands after some decisions, the latest last."""
    points = dict[str, PointDecisions]()
    for decision in decisions:
        if decision.kind == "remove":
            points[decision.point] = PointDecisions(removed=True)
        else:
            points.setdefault(decision.point, PointDecisions()).take(decision)
    return points


def decided(network: Network, decisions: Decisions) -> Network | None:
    """A network as it comes from files, changed by what stands of the decisions about its points: removed tie and
    control points and rejected measurements go, others take the user's coordinates; None where nothing is left.
    """
    ids, rays, names = network.points.ids, network.rays, network.image_names
    numbers = ids.find(list(decisions)).tolist()
    about = {number: of for number, of in zip(numbers, decisions.values(), strict=True) if number >= 0}
    if not about:
        return network
    places, sigmas, used = rays.places.copy(), rays.sigmas.copy(), np.ones(rays.point.size, dtype=bool)
    for k in np.flatnonzero(np.isin(rays.point, list(about))).tolist():
        of, image = about[int(rays.point[k])], names[int(rays.image[k])]
        used[k] = image not in of.rejected
        if (measure := of.measured.get(image)) is not None:
            places[k], sigmas[k] = (measure.line, measure.sample), (measure.sigma_line, measure.sigma_sample)
    network = replace(_with_priors(network, about), rays=replace(rays, places=places, sigmas=sigmas).chosen(used))
    measured = np.zeros(len(ids), dtype=bool)
    measured[network.rays.point] = measured[network.ranges.point] = True
    removed = [number for number, of in about.items() if of.removed]
    measured[removed] &= ~np.isin(network.points.classes[removed], (PointClass.TIE, PointClass.CONTROL))
    return select_points(network, np.flatnonzero(measured)) if np.any(measured) else None


def _with_priors(network: Network, about: Mapping[int, PointDecisions]) -> Network:
    """With the a-priori values of points that users have held or released."""
    points, surface = network.points, network.surface
    held = {number: of.prior for number, of in about.items() if of.prior is not None}
    if not held:
        return network
    classes, kinds, places = points.classes.copy(), points.kinds.copy(), points.places.copy()
    covariances = points.covariances.copy()
    for number, prior in held.items():
        classes[number], kinds[number], places[number], covariances[number] = point_columns(prior)
    if surface is not None:
        sigmas = surface.sigmas.copy()
        sigmas[[number for number, prior in held.items() if prior.class_ == PointClass.CONTROL]] = np.inf
        surface = replace(surface, sigmas=sigmas)
    return replace(network, points=GroundPoints(points.ids, classes, kinds, places, covariances), surface=surface)


def point_columns(state: PointState) -> tuple[int, int, Array, Array]:
    """Class, kind, place (3,) in m and covariance (3, 3) in m^2 of a point."""
    place = np.full(3, np.nan) if state.place is None else np.array(state.place, dtype=np.float64)
    return state.class_, state.kind, place, np.array(state.covariance, dtype=np.float64).reshape(3, 3)


def ground_point(point: str, state: PointState) -> GroundPoints:
    """A point by itself."""
    class_, kind, place, covariance = point_columns(state)
    return GroundPoints(Names.of([point]), np.array([class_]), np.array([kind]), place[None], covariance[None])


def network_of_rays(point: str, state: PointState, images: Mapping[str, KnownImage]) -> Network:
    """A point with its image measurements, and nothing else."""
    known, measures = [images[one.image] for one in state.measures], state.measures
    rays = ImageRays(
        np.zeros(len(known), dtype=np.int64), np.arange(len(known)),
        np.array([(one.line, one.sample) for one in measures]),
        np.array([(one.sigma_line, one.sigma_sample) for one in measures]),
        np.array([one.back_projected for one in measures]), np.array([one.rejected for one in measures]),
    )  # fmt: skip
    return Network(*image_columns(known), ground_point(point, state), rays, Ranges.none())


def measured_by_users(
    decisions: Decisions, new: Collection[str], images: Mapping[str, KnownImage], networks: Iterable[Network]
) -> list[Network]:
    """Measurements by users in images that come (back) into a project, without those that networks bring with them."""
    given = set[tuple[str, str]]()
    for network in networks:
        points, names = network.points.ids, network.image_names
        decided_rows = np.flatnonzero(np.isin(network.rays.point, points.find(list(decisions))))
        rows = zip(network.rays.point[decided_rows].tolist(), network.rays.image[decided_rows].tolist(), strict=True)
        given |= {(points[i], names[j]) for i, j in rows}
    returning = list[Network]()
    for point, of in decisions.items():
        measures = tuple(
            measure for image, measure in of.measured.items()
            if image in new and image not in of.rejected and (point, image) not in given
        )  # fmt: skip
        if measures:
            state = msgspec.structs.replace(of.prior or of.state, measures=measures)
            returning.append(network_of_rays(point, state, images))
    return returning

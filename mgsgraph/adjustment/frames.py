"""Orientation coefficients in the terms of a flight: along, across and radial; roll, pitch and yaw.

Position: radial is upward from the body's centre, along is the level part of the (body-fixed) flight direction, across
is to the left, where the orbit's normal points. Rotation: yaw is about the optical axis, out of the lens, roll about
the direction of flight as the camera sees it, pitch about the third axis, to the right for a camera that looks down;
so a positive pitch lifts the view forward, and a positive roll to the left, whichever way the detector is built in.
All are taken at mid-image.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from mgsgraph.adjustment.graph import Layout
from mgsgraph.geometry.body import intersect_ellipsoid
from mgsgraph.geometry.image import PushbroomImage
from mgsgraph.geometry.orientation import COMPONENTS, Angles, OrientationCorrection
from mgsgraph.geometry.records import Array
from mgsgraph.geometry.rotation import skew, unit_vectors
from mgsgraph.units import DEG

FLIGHT = ("along-track position", "across-track position", "radial position", "roll", "pitch", "yaw")
"""The six axes of an image."""
FLIGHT_NAMES = ("along", "across", "radial", "roll", "pitch", "yaw")
"""The same in a word each, for tables and figures."""
BODY = ("position X", "position Y", "position Z", *FLIGHT[3:])
"""The same of an image so long that its flight changes direction."""
_LONG = 10.0 * DEG
"""Arc from mid-image to either end from which an image is that long."""
_ORDERS = ("constant", "linear", "quadratic", "cubic")
_TURNING = {"s": 1e-3, "": 1e-2}
"""rad, what a unit of an unknown without length counts for: per second of time bias about what a camera turns that
looks down all along a low orbit; of a line rate half the angle along a long image.
"""
_LEVEL = 1e-9
"""Sine below which a direction counts as parallel to another."""


@dataclass(frozen=True, slots=True, eq=False)
class FlightFrame:
    """Conversion of the six components of an image's coefficient to its six axes, at mid-image."""

    axes: tuple[str, ...]
    """Names of the six axes."""
    turn: Array
    """(6, 6) m and rad: amounts along the axes = turn @ components."""
    ground: Array
    """(2, 6) m along and across the flight on the ground, per m and rad of the axes; NaN where no pairing makes sense:
    where the optical axis misses the body, or the image is too long."""
    reach: Array
    """(6,) m per m and rad: what positions move, what roll and pitch move at the distance of the ground, and what yaw
    moves there at the end of the detector."""

    def orthogonal(self, sigmas: Array) -> Array:
        """(6, 6) orthogonal: shares in units of the axes' own sigmas from components in units of `sigmas` (6,).

        For sigmas alike in X, Y, Z, and in the three rotations, the turn itself; else the orthogonal matrix nearest to
        the turn in those units, so that shares still sum up to one.
        """
        scaled = self.turn * sigmas
        first, _, second = np.linalg.svd(unit_vectors(scaled))
        return np.asarray(first @ second)


def flight_frame(image: PushbroomImage, angles: Angles = "camera") -> FlightFrame:
    """Axes of one image from its nominal orientation."""
    line, sample = image.middle
    pose, long = image.pose(line), _is_long(image)
    level, about, turn = axes_of_flight(image, angles)
    matrix = pose.matrix[0]
    if long:
        turn[:3, :3] = np.eye(3)
    origin, look = image.sightlines(line, sample)
    place, by_origin, by_look = (part[0] for part in intersect_ellipsoid(origin, look, image.body))
    distance = float(np.linalg.norm(place - origin[0]))
    moved = np.concatenate([by_origin @ turn[:3, :3].T, by_look @ -skew(look[0]) @ matrix.T @ about.T], axis=1)
    if not np.isfinite(distance):  # beyond the limb: about the distance of the ground below
        distance = float(np.linalg.norm(pose.position[0])) - image.body.polar
    end = image.sightlines(line, np.zeros(1))[1]
    width = distance * float(np.linalg.norm(end - look) / np.linalg.norm(look))
    return FlightFrame(
        BODY if long else FLIGHT,
        turn,
        np.full((2, 6), np.nan) if long else level[:2] @ moved,
        np.array([1.0, 1.0, 1.0, distance, distance, width]),
    )


def axes_of_flight(image: PushbroomImage, angles: Angles = "camera") -> tuple[Array, Array, Array]:
    """Level axes (3, 3) of the flight at mid-image, axes (3, 3) of roll, pitch and yaw in the camera's frame, and how
    six components of a coefficient become amounts along them (6, 6).
    """
    line, _ = image.middle
    pose = image.pose(line)
    level = flight_axes(pose.position[0], pose.velocity[0])
    about, turn = camera_axes(pose.matrix[0] @ level[0]), np.zeros((6, 6))
    turn[:3, :3] = level
    turn[3:, 3:] = about @ OrientationCorrection(np.zeros((1, 6)), angles).axes(pose, image.moments(line))[0]
    return level, about, turn


def flight_axes(position: Array, velocity: Array) -> Array:
    """(3, 3) rows: unit vectors along, across (left) and radial (up), body-fixed."""
    up = position / np.linalg.norm(position)
    along = velocity - up * (up @ velocity)
    if np.linalg.norm(along) <= _LEVEL * np.linalg.norm(velocity):  # a camera that stands still: any level direction
        along = np.cross(np.eye(3)[np.argmin(np.abs(up))], up)
    along = along / np.linalg.norm(along)
    return np.stack([along, np.cross(up, along), up])


def camera_axes(forward: Array) -> Array:
    """(3, 3) rows: axes of roll, pitch and yaw in the camera's frame, from the flight's direction (3,) in it."""
    roll = np.array([forward[0], forward[1], 0.0])
    size = float(np.linalg.norm(roll))
    roll = roll / size if size > _LEVEL else np.array([1.0, 0.0, 0.0])  # a camera that looks along its flight
    yaw = np.array([0.0, 0.0, 1.0])
    return np.stack([roll, np.cross(yaw, roll), yaw])


def _is_long(image: PushbroomImage) -> bool:
    positions = image.pose(np.linspace(0.0, float(image.lines), 9)).position
    units = unit_vectors(positions)
    return bool(np.min(units @ units[4]) < np.cos(_LONG))


@dataclass(frozen=True, slots=True)
class Axis:
    """One column of the orientation in the terms of the flight."""

    variable: int
    """Which shared unknown: images in order, then shifts."""
    owner: str
    """Image, profile or unknown whose it is, as "image NAME"."""
    name: str
    """Axis, or what the unknown is."""
    order: int
    """Of the polynomial; 0 for what is none."""
    unit: str
    """m or rad; s of a shared bias of time."""
    polynomial: bool = True
    """Whether there are other orders beside it."""

    def __str__(self) -> str:
        if not self.polynomial:
            return self.name
        return f"{_ORDERS[self.order] if self.order < len(_ORDERS) else f'u^{self.order}'} {self.name}"


class Frames:
    """All columns of a layout in the terms of its images' flights; frames are made on demand."""

    def __init__(self, layout: Layout) -> None:
        self.layout = layout
        self._frames: dict[int, FlightFrame] = {}

    def of(self, image: int) -> FlightFrame:
        """Frame of one image."""
        if image not in self._frames:
            self._frames[image] = flight_frame(self.layout.network.images[image], self.layout.angles)
        return self._frames[image]

    def turned(self, directions: Array) -> Array:
        """(columns, k) orthogonal turn of directions, in units of the scales, from components to axes."""
        result = directions.copy()
        for image, rows, scales in self._blocks():
            result[rows] = self.of(image).orthogonal(scales) @ directions[rows]
        return result

    def amounts(self, directions: Array) -> Array:
        """(columns, k) m and rad, amounts along the axes of directions in units of the scales."""
        result = directions * self.layout.scales[:, None]
        for image, rows, scales in self._blocks():
            result[rows] = self.of(image).turn @ (directions[rows] * scales[:, None])
        return result

    def along(self, column: int) -> Array:
        """(columns,) per m and rad of the components, amount along the axis of a column."""
        result = np.zeros(self.layout.columns)
        result[column] = 1.0
        for image, rows, _ in self._blocks():
            if rows.start <= column < rows.stop:
                result[rows] = self.of(image).turn[column - rows.start]
        return result

    def moved(self, columns: slice, directions: Array) -> Array:
        """(c, k) m, what directions (c, k) on the columns of whole variables move, axis by axis.

        Directions are in units of the scales; what images share counts as in its first one.
        """
        result = directions * self.layout.scales[columns][:, None]
        for image, rows, _ in self._blocks():
            if columns.start <= rows.start < columns.stop:
                inside = slice(rows.start - columns.start, rows.stop - columns.start)
                result[inside] = self.of(image).reach[:, None] * (self.of(image).turn @ result[inside])
        network = self.layout.network
        for p, terms in enumerate(network.shift_terms):
            rows = self.layout.columns_of(len(network.images) + p)
            if columns.start <= rows.start < columns.stop:  # a tilt counts where the ground is as far as from a camera
                reach = np.array([1.0 if term.unit == "m" else self.of(0).reach[4] for term in terms])
                result[rows.start - columns.start : rows.stop - columns.start] *= reach[:, None]
        for pass_, after in zip(network.passes, network.first_of_passes[1:].tolist(), strict=True):
            if pass_.prior.trend_sigmas.size:  # by itself a trend moves nothing: its nodes do
                rows = self.layout.columns_of(after - 1)
                if columns.start <= rows.start < columns.stop:
                    result[rows.start - columns.start : rows.stop - columns.start] = 0.0
        for k, shared in enumerate(self.layout.network.shared):
            rows = self.layout.columns_of(network.first_shared + k)
            if columns.start <= rows.start < columns.stop and shared.kind.unit != "m":
                distance = self.of(int(shared.images[0])).reach[4]
                turning = _TURNING.get(shared.kind.unit, 1.0)
                result[rows.start - columns.start : rows.stop - columns.start] *= distance * turning
        return result

    @cached_property
    def axes(self) -> list[Axis]:
        """Name of each column."""
        names = []
        for variable in self.layout.variables.adjusted():
            width = int(self.layout.variables.width[variable])
            names += [self._axis(variable, inside) for inside in range(width)]
        return names

    def _blocks(self) -> Iterator[tuple[int, slice, Array]]:
        """Image, columns and their scales, of each coefficient of each image that is adjusted."""
        scales = self.layout.scales
        for image in self.layout.variables.adjusted():
            columns = self.layout.columns_of(image)
            if image < self.layout.variables.images:
                for first in range(columns.start, columns.stop, 6):
                    yield image, slice(first, first + 6), scales[first : first + 6]
        for pass_, first in self.layout.network.numbered_passes:
            for variable in range(first, first + len(pass_.nodes)):
                columns = self.layout.columns_of(variable)
                yield int(pass_.images[0]), columns, scales[columns]

    def _axis(self, variable: int, inside: int) -> Axis:
        network, images = self.layout.network, self.layout.variables.images
        if variable < images:
            order, component = divmod(inside, 6)
            owner = f"image {network.images[variable].name}"
            return Axis(variable, owner, self.of(variable).axes[component], order, "m" if component < 3 else "rad")
        shift = variable - images
        if shift < len(network.shift_names):
            term = network.shift_terms[shift][inside]
            return Axis(variable, network.shift_names[shift], term.name, 0, term.unit, False)
        if variable >= network.first_of_passes[-1]:
            return Axis(variable, "errors in common", "factor", 0, "", False)
        if variable >= network.first_of_passes[0]:
            return self._of_pass(variable, inside)
        shared = network.shared[shift - len(network.shift_names)]
        name = " ".join([*([shared.kind] if shared.kind not in shared.name else []), shared.kind.components[inside]])
        return Axis(variable, f"shared unknown {shared.name}", name.strip() or "value", 0, shared.kind.unit, False)

    def _of_pass(self, variable: int, inside: int) -> Axis:
        """Axis of a column of a pass's node, whose axes are those of its first image, or of its trend."""
        pass_, unknown = self.layout.network.of_passes(variable)
        what, component = pass_.part(unknown, inside)
        is_node = unknown < len(pass_.nodes)
        name = self.of(int(pass_.images[0])).axes[component] if is_node else f"{what} of {COMPONENTS[component]}"
        owner = f"{what} of pass {pass_.name}" if is_node else f"pass {pass_.name}"
        return Axis(variable, owner, name, 0, "m" if component < 3 else "rad", False)

"""Images of one pass: found from their times and nominal orientations, whether they can share a trajectory's
correction, and which of them stands for it.

Passes and shared unknowns by the names of their images: what they are outlives the networks that a bundle, an
addition or everything together make, in which images have numbers.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields, is_dataclass, replace
from typing import Any

import numpy as np

from mgsgraph.errors import InputError
from mgsgraph.geometry import rotation
from mgsgraph.geometry.body import target_name
from mgsgraph.geometry.image import PushbroomImage
from mgsgraph.geometry.orientation import OrientationImages, Sine
from mgsgraph.geometry.records import Array, Index, by_value
from mgsgraph.geometry.rotation import unit_vectors
from mgsgraph.geometry.trajectory import Pose
from mgsgraph.names import numbered
from mgsgraph.network.network import Network
from mgsgraph.network.passes import Pass, PassPrior
from mgsgraph.network.shared import SharedKind, SharedUnknown
from mgsgraph.units import KM

LONGEST_PAUSE = 1800.0
"""s between the images of a pass: a quarter of the shortest revolution about Mars and Moon, and so another pass."""
_APART = 1e3
"""m by which nominal positions at one time may differ: trajectories from other kernels do, another spacecraft's more.
"""
_OTHER_CLOCK = 100.0
"""m by which they may differ along the flight, on one path: what predicted orbits lack, 0.03 to 0.06 s of its way."""
_ON_ONE_PATH = 0.03
"""Share of a difference along the flight by which places of one path at two times may differ otherwise."""
_TURNED = 1e-2
"""rad by which nominal attitudes of cameras with the same axes may differ at one time: a correction about the axes of
the one is one about those of the other to 1 %."""
_LOOSE = 1e-3
"""rad by which a mounting may change during the time that two images have in common."""
_MOMENTS = 9
"""Within that time, at which nominal attitudes are compared."""


def seconds(image: PushbroomImage) -> tuple[float, float]:
    """First and last time of an image's lines, s TDB past J2000."""
    start, stop = image.span
    return float(start), float(stop)


def spans(images: Iterable[PushbroomImage]) -> Array:
    """(n, 2) the same of several images."""
    return np.array([image.span for image in images])


def sine_over(images: Sequence[PushbroomImage], frequency: float) -> Sine:
    """A vibration of a frequency in Hz over the time of some images."""
    times = spans(images)
    start, stop = float(times.min()), float(times.max())
    return Sine(frequency, 0.5 * (start + stop), 0.5 * (stop - start))


def straightest(images: Sequence[PushbroomImage]) -> int:
    """The image that looks nearest along the optical axis, of equal ones the first: HRSC's nadir line."""
    off = []
    for image in images:
        place, _ = image.interior.focal_plane(image.middle[1])
        off.append(round(float(np.linalg.norm(place)) / image.interior.focal_length, 6))
    return int(np.argmin(off))


def nominal_poses(images: Sequence[PushbroomImage], times: Array, axes: Array | None = None) -> Pose:
    """Nominal poses of a pass at times (n,) in s TDB past J2000, rates per second: each by an image whose lines cover
    it, or come nearest; for images may have tables of their own, which end with their lines. Attitudes are those of the
    pass's axes; `axes` (m, 3, 3) is how each camera is mounted against them (`network.passes.Pass`).
    """
    edges = spans(images)
    beyond = np.maximum(edges[:, :1] - times, times - edges[:, 1:])
    owner = np.maximum(beyond, 0.0).argmin(axis=0)
    parts = [np.empty((times.size, *shape)) for shape in ((3,), (3,), (3, 3), (3,))]
    for j, chosen in by_value(owner):
        trajectory = images[j].trajectory
        pose = trajectory.pose(np.clip(times[chosen] - trajectory.epoch, *trajectory.coverage))
        pose = pose.in_axes(None if axes is None else axes[j])
        for values, part in zip(parts, (pose.position, pose.velocity, pose.matrix, pose.angular_rate), strict=True):
            values[chosen] = part
    return Pose(*parts)


def mountings(images: Sequence[PushbroomImage], where: str, one_camera: bool = False) -> Array | None:
    """How the cameras of a pass are mounted, by their nominal attitudes at times that they have in common.

    Parameters
    ----------
    images : sequence of PushbroomImage
        Of one pass.
    where : str
        What to name in errors.
    one_camera : bool
        Whether they are known to be lines of one camera: images without a common time then have the same axes.

    Returns
    -------
    (m, 3, 3) or None
        Rotations from the axes of the first image's camera to those of each camera; None where all have the same.

    Raises
    ------
    InputError
        For images that don't follow upon each other; for cameras that at one time are at different places, or whose
        attitudes against each other change; for a camera that none of the others has a time in common with.
    """
    _require_close_in_time(images, where)
    meetings = [(first, second, _mounted(images[first], images[second], times, where))
                for first, second, times in _meetings(images)]  # fmt: skip
    axes: dict[int, Array] = {0: np.eye(3)}
    while len(axes) < len(images):
        first, second, turn = next(_links(images, meetings, axes, one_camera), (-1, -1, np.eye(3)))
        if first < 0:
            alone = next(j for j in range(len(images)) if j not in axes)
            raise InputError(
                where, f"image {images[alone].name} of a camera of its own, which shares no time with the others",
                "images whose lines overlap in time: their attitudes say how the cameras are mounted",
                "make them two passes",
            )  # fmt: skip
        axes[second] = turn @ axes[first]
    for first, second, turn in meetings:
        off = _angle(turn @ axes[first] @ axes[second].T)
        if off > _LOOSE:
            raise InputError(
                where, f"mountings of {images[first].name} and {images[second].name} that contradict by {off:.4f} rad "
                "when they are followed over other images", f"at most {_LOOSE} rad", "take one of them out",
            )  # fmt: skip
    rotations = np.array([axes[j] for j in range(len(images))])
    return rotations if max(_angle(matrix) for matrix in rotations) > _TURNED else None


def _links(
    images: Sequence[PushbroomImage],
    meetings: Sequence[tuple[int, int, Array]],
    axes: Mapping[int, Array],
    one_camera: bool,
) -> Iterator[tuple[int, int, Array]]:
    """Images whose mounting is known, others whose is not, and the rotation from the one's camera to the other's: of
    those that meet in time, then of one camera at several times.
    """
    for first, second, turn in meetings:
        if first in axes and second not in axes:
            yield first, second, turn
        if second in axes and first not in axes:
            yield second, first, turn.T
    for second in [j for j in range(len(images)) if j not in axes]:
        likely = [first for first in axes if one_camera or same_camera(images[first], images[second])]
        if likely:  # of cameras of the same type, the one with the same attitude to the flight
            against = [_angle(_against_flight(images[second]) @ _against_flight(images[first]).T) for first in likely]
            yield likely[int(np.argmin(np.round(against, 3)))], second, np.eye(3)


def same_camera(first: PushbroomImage, second: PushbroomImage) -> bool:
    """Whether two images have the same lens and the same detector line, so far as their interiors say."""
    a, b = first.interior, second.interior
    return a.focal_length == b.focal_length and np.array_equal(a.to_pixel, b.to_pixel)


def _against_flight(image: PushbroomImage) -> Array:
    """(3, 3) from the axes of the flight (velocity, orbit's normal, outward) to the camera's, amid an image."""
    times = np.array([np.mean(seconds(image)) - image.trajectory.epoch])
    pose = image.trajectory.pose(times)
    outward, normal = pose.position[0], np.cross(pose.position[0], pose.velocity[0])
    axes = np.stack([np.cross(normal, outward), normal, outward])
    return np.asarray(pose.matrix[0] @ unit_vectors(axes).T)


def _require_close_in_time(images: Sequence[PushbroomImage], where: str) -> None:
    """Raise InputError, naming `where`, unless images of one body follow upon each other."""
    for image in images:
        if image.body != images[0].body:
            bodies = [f"{target_name(item.body)} ({item.body.equatorial / KM:.1f} km)" for item in (images[0], image)]
            found = f"images {images[0].name} of {bodies[0]} and {image.name} of {bodies[1]}"
            raise InputError(where, found, "images of one body", "make them two passes")
    order = sorted(images, key=lambda image: seconds(image)[0])
    last = order[0]
    for image in order[1:]:
        pause = seconds(image)[0] - seconds(last)[1]
        if pause > LONGEST_PAUSE:
            raise InputError(
                where, f"images {last.name} and {image.name}, {pause / 60.0:.0f} minutes apart",
                f"images of one pass, at most {LONGEST_PAUSE / 60.0:.0f} minutes apart", "make them two passes",
            )  # fmt: skip
        last = max(last, image, key=lambda item: seconds(item)[1])


def _meetings(images: Sequence[PushbroomImage]) -> Iterator[tuple[int, int, Array]]:
    """Images that have a time in common, one < other, and moments of it, s TDB past J2000."""
    edges = spans(images)
    for first in range(len(images)):
        starts, stops = np.maximum(edges[first, 0], edges[:, 0]), np.minimum(edges[first, 1], edges[:, 1])
        for second in (np.flatnonzero(stops[first + 1 :] > starts[first + 1 :]) + first + 1).tolist():
            yield first, second, np.linspace(starts[second], stops[second], _MOMENTS)


def _mounted(first_image: PushbroomImage, second_image: PushbroomImage, times: Array, where: str) -> Array:
    """(3, 3) from the axes of one camera to those of the other, by their nominal attitudes at some times."""
    first, second = (image.trajectory.pose(times - image.trajectory.epoch) for image in (first_image, second_image))
    distance = float(np.linalg.norm(first.position - second.position, axis=1).max())
    pair = f"images {first_image.name} and {second_image.name}"
    if (clocks := clocks_apart(first, second)) and distance > _OTHER_CLOCK:
        raise InputError(
            where, f"{pair}, whose clocks are {abs(clocks):.2f} s apart: at one time they are {distance:.0f} m apart "
            "along the flight, on one path", "line times and tables by one clock",
            "read both the same way (the same kernels, the same kind of support data), or make them two passes",
        )  # fmt: skip
    if distance > _APART:
        raise InputError(
            where, f"{pair}, whose cameras at one time are {distance:.0f} m apart",
            "images of one spacecraft", "make them two passes",
        )  # fmt: skip
    turns = second.matrix @ first.matrix.mT
    middle = turns[times.size // 2]
    changes = max(_angle(turn @ middle.T) for turn in turns)
    if changes > _LOOSE and _angle(middle) > _TURNED:
        raise InputError(
            where, f"{pair}, whose cameras turn against each other by {changes:.4f} rad in their common time",
            f"cameras mounted on one spacecraft, at most {_LOOSE} rad", "make them two passes",
        )  # fmt: skip
    return middle if _angle(middle) > _TURNED else np.eye(3)


def clocks_apart(first: Pose, second: Pose) -> float:
    """S by which the second of two places on one path is ahead, of poses (n,) at the same times, rates per second; 0
    where they differ across the flight, too: they are not on one path then.
    """
    away = second.position - first.position
    late = float(np.sum(away * first.velocity) / np.sum(first.velocity**2))
    size = np.linalg.norm(away, axis=1).max()
    rest = np.linalg.norm(away - late * first.velocity, axis=1).max()
    return late if rest < _ON_ONE_PATH * size else 0.0


def _angle(turn: Array) -> float:
    """Rad by which a rotation (3, 3) turns."""
    return float(np.linalg.norm(rotation.logarithm(turn[None])[0]))


_SAME_PLANE = 0.02
"""rad by which the planes of an orbit may differ between two images: spacecraft about one body fly in other planes, or
over other ground; that of one precesses by less in a revolution."""


def found_passes(images: Sequence[PushbroomImage]) -> list[list[int]]:
    """Images of each pass, by their numbers, in the order of time.

    Two images are of one pass if they show the same body, and either have a time in common at which they are at the
    same place, mounted against each other without change (`mountings`), or are of one camera, at most `LONGEST_PAUSE`
    apart and flown in the same plane. All that are connected so are a pass; an unconnected image is its own.
    """
    order = sorted(range(len(images)), key=lambda j: seconds(images[j]))
    passes = list[list[int]]()
    for j in order:
        connected = [members for members in passes if any(_connected(images[k], images[j]) for k in members)]
        joined = sorted([*(k for members in connected for k in members), j], key=order.index)
        if not _mountable([images[k] for k in joined]):
            joined, connected = [j], []
        passes = [*(members for members in passes if members not in connected), joined]
    return sorted(passes, key=lambda members: order.index(members[0]))


def _connected(first: PushbroomImage, second: PushbroomImage) -> bool:
    """Whether two images are connected, as `found_passes` has it."""
    if first.body != second.body:
        return False
    (start, stop), (its_start, its_stop) = seconds(first), seconds(second)
    if min(stop, its_stop) > max(start, its_start):
        return _mountable([first, second])
    pause = max(start, its_start) - min(stop, its_stop)
    return pause <= LONGEST_PAUSE and same_camera(first, second) and _same_plane(first, second)


def _mountable(images: Sequence[PushbroomImage]) -> bool:
    try:
        mountings(images, "")
    except InputError:
        return False
    return True


def _same_plane(first: PushbroomImage, second: PushbroomImage) -> bool:
    """Whether two images were flown in one plane of inertial space; True where nobody knows how the body turns."""
    normals = []
    for image in (first, second):
        time, spin = np.mean(seconds(image)), image.trajectory.spin
        if spin is None:
            return True
        pose = image.trajectory.pose(np.array([time - image.trajectory.epoch]))
        normal = np.cross(pose.position[0], pose.velocity[0] + np.cross(spin, pose.position[0]))
        since = time - np.mean(seconds(first))
        normals.append(rotation.exponential(spin * since) @ normal / np.linalg.norm(normal))
    return bool(np.arccos(np.clip(normals[0] @ normals[1], -1.0, 1.0)) < _SAME_PLANE)


def mounting_angles(axes: Array) -> Array:
    """(m, 3) rad: rotation vectors, about x, y, z, by which each camera is turned against the axes of its pass."""
    return rotation.logarithm(axes.mT)


@dataclass(frozen=True, slots=True, eq=False)
class NamedPass:
    """A pass by the names of its images."""

    name: str
    """What to call it."""
    images: tuple[str, ...]
    """(m,) names of its images."""
    nodes: OrientationImages
    """Times of the orientation images, and the basis between them."""
    prior: PassPrior
    """What is known of them."""
    axes: Array | None = None
    """(m, 3, 3) how each camera is mounted (`network.passes.Pass`)."""
    whole: bool = True
    """Whether its nodes reach over all lines of its images (`network.passes.Pass`)."""

    def of(self, names: Iterable[str]) -> "NamedPass | None":
        """The same with some images alone, in the order that it has; None without any."""
        wanted = set(names)
        chosen = [k for k, name in enumerate(self.images) if name in wanted]
        if len(chosen) == len(self.images):
            return self
        axes = None if self.axes is None else self.axes[chosen]
        return replace(self, images=tuple(self.images[k] for k in chosen), axes=axes) if chosen else None

    def with_images(self, added: "NamedPass") -> "NamedPass":
        """The same with those images of another one that it has not."""
        more = [k for k, name in enumerate(added.images) if name not in self.images]
        if not more:
            return self
        axes = None
        if self.axes is not None or added.axes is not None:
            axes = np.concatenate([_axes(self), _axes(added)[more]])
        return replace(self, images=(*self.images, *(added.images[k] for k in more)), axes=axes)

    def numbered(self, number: Mapping[str, int]) -> Pass:
        """In a network in which its images have these numbers."""
        images = np.array([number[name] for name in self.images])
        return Pass(self.name, images, self.nodes, self.prior, self.axes, self.whole)


@dataclass(frozen=True, slots=True, eq=False)
class NamedShared:
    """A shared unknown by the names of its images."""

    name: str
    """What to call it."""
    kind: SharedKind
    """What it is."""
    images: tuple[str, ...]
    """Names of the images that share it."""
    sigmas: Array
    """(kind.width,) a-priori, in the kind's unit."""
    considered: bool = False
    """Whether it is held at zero, while its a-priori covariance is carried."""
    sine: Sine | None = None
    """Of a vibration."""

    def of(self, names: Iterable[str]) -> "NamedShared | None":
        """The same with some images alone; None without any."""
        wanted = set(names)
        chosen = tuple(name for name in self.images if name in wanted)
        return replace(self, images=chosen) if chosen else None


@dataclass(frozen=True, slots=True, eq=False)
class Definitions:
    """All passes and shared unknowns, by name."""

    passes: Mapping[str, NamedPass] = field(default_factory=dict)
    """Images on one trajectory."""
    shared: Mapping[str, NamedShared] = field(default_factory=dict)
    """Unknowns that several images share."""

    def __bool__(self) -> bool:
        return bool(self.passes or self.shared)

    def of(self, names: Iterable[str]) -> "Definitions":
        """What of it concerns some images."""
        wanted = set(names)
        passes = {name: part for name, pass_ in self.passes.items() if (part := pass_.of(wanted)) is not None}
        shared = {name: few for name, all_of in self.shared.items() if (few := all_of.of(wanted)) is not None}
        return Definitions(passes, shared)

    def of_image(self, name: str) -> NamedPass | None:
        """The pass of an image; None for one on its own."""
        return next((pass_ for pass_ in self.passes.values() if name in pass_.images), None)


def definitions(network: Network) -> Definitions:
    """Of a network."""
    names = network.image_names

    def named(images: Index) -> tuple[str, ...]:
        return tuple(names[j] for j in images.tolist())

    passes = {
        pass_.name: NamedPass(pass_.name, named(pass_.images), pass_.nodes, pass_.prior, pass_.axes, pass_.whole)
        for pass_ in network.passes
    }
    shared = {
        item.name: NamedShared(
            item.name, item.kind, named(item.images), item.sigmas, item.name in network.considered, item.sine
        )
        for item in network.shared
    }
    return Definitions(passes, shared)


def with_definitions(network: Network, named: Definitions) -> Network:
    """A network with these passes and shared unknowns in the place of its own, as far as its images have them."""
    if not (named or network.passes or network.shared):
        return network
    number = numbered(network.image_names)
    present = named.of(number)
    considered = [name for name in network.considered if name in network.shift_names]
    considered += [item.name for item in present.shared.values() if item.considered]
    return replace(
        network,
        passes=tuple(pass_.numbered(number) for pass_ in present.passes.values()),
        shared=tuple(
            SharedUnknown(
                item.name, item.kind, np.array([number[name] for name in item.images]), item.sigmas, sine=item.sine
            )
            for item in present.shared.values()
        ),
        considered=tuple(considered),
    )


def united(parts: Sequence[Definitions]) -> Definitions:
    """Several as one: what has the same name is the same, and has the images of all.

    Raises InputError where parts contradict each other: other nodes, priors, kinds or sigmas, an image of two passes.
    """
    passes, shared, owner = dict[str, NamedPass](), dict[str, NamedShared](), dict[str, str]()
    for part in parts:
        pairs: list[tuple[dict[str, Any], Mapping[str, Any]]] = [(passes, part.passes), (shared, part.shared)]
        for merged, of_part in pairs:
            merged |= {name: _united(merged[name], item) if name in merged else item for name, item in of_part.items()}
    for name, pass_ in passes.items():
        for image in pass_.images:
            if owner.setdefault(image, name) != name:
                raise InputError(f"image {image}", f"of the passes {owner[image]} and {name}", "one pass")
    return Definitions(passes, shared)


def _united(first: Any, second: Any) -> Any:
    """A pass, or a shared unknown, of two parts."""
    where = f"{'pass' if isinstance(first, NamedPass) else 'shared unknown'} {first.name!r}"
    for part in fields(first):
        of_parts = getattr(first, part.name), getattr(second, part.name)
        if part.name not in ("images", "axes", "whole") and not same_values(*of_parts):
            values = "" if is_dataclass(of_parts[0]) else f" ({of_parts[1]}, {of_parts[0]} before)"
            found = f"{part.name} in one part other than in another{values}"
            raise InputError(where, found, "the same", "give it another name, or state both the same")
    if isinstance(first, NamedPass):
        return replace(first.with_images(second), whole=first.whole and second.whole)
    return replace(first, images=tuple(dict.fromkeys([*first.images, *second.images])))


def joining(
    defined: Definitions, image: str, of_pass: str = "", shares: Sequence[str] = (), where: str = "image"
) -> Definitions:
    """Definitions by which an image joins a pass that is known, and shared unknowns; its attitude says how its
    camera is mounted.

    Raises InputError, naming `where`, for an unknown name.
    """
    wanted = [("pass", of_pass, list(defined.passes))] if of_pass else []
    for what, name, names in [*wanted, *(("shared unknown", share, list(defined.shared)) for share in shares)]:
        if name not in names:
            known = ", ".join(names[:4]) or "there is none"
            raise InputError(where, f"no {what} {name!r}", f"a known name ({known})", "define it in a case file")
    passes = [replace(defined.passes[of_pass], images=(image,), axes=None)] if of_pass else []
    shared = [replace(defined.shared[name], images=(image,)) for name in shares]
    return Definitions({entry.name: entry for entry in passes}, {entry.name: entry for entry in shared})


def _axes(pass_: NamedPass) -> Array:
    """(m, 3, 3)"""
    return np.broadcast_to(np.eye(3), (len(pass_.images), 3, 3)) if pass_.axes is None else pass_.axes


def same_values(first: Any, second: Any) -> bool:
    """Whether two records, arrays or plain values are equal."""
    if first is second:
        return True
    if type(first) is not type(second):
        return False
    if isinstance(first, np.ndarray):
        return np.array_equal(first, second)
    if is_dataclass(first):
        return all(same_values(getattr(first, part.name), getattr(second, part.name)) for part in fields(first))
    if isinstance(first, tuple):
        return len(first) == len(second) and all(map(same_values, first, second))
    return bool(first == second)

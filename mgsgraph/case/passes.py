"""[[passes]] of a case file: images on one trajectory, adjusted through its corrections in time; and which images make
which of them.

[[mountings]] of a case file: how a camera, or the laser, stands against the trajectory that carries it: turned by
boresight angles, and away by a lever arm; stated, or unknown beside what is stated.
"""

from collections.abc import Callable, Collection, Sequence
from dataclasses import replace
from itertools import pairwise
from typing import Literal

import msgspec
import numpy as np

from mgsgraph.case.motion import (
    SPACING,
    AttitudeInput,
    Motion,
    NodePriorInput,
    NodesInput,
    PositionInput,
    ProcessInput,
    Sigmas,
    VibrationInput,
    negligible_departures,
    polynomial_sigmas,
    processes,
    three,
    trend_sigmas,
)
from mgsgraph.errors import InputError, errors_from, require
from mgsgraph.geometry import rotation
from mgsgraph.geometry.image import PushbroomImage
from mgsgraph.geometry.orientation import OrientationImages, OrientationPrior, evenly_spaced
from mgsgraph.geometry.records import Array, Index
from mgsgraph.geometry.trajectory import AttitudeTable, FixedTrajectory, PositionTable, Trajectory, utc_of_tdb
from mgsgraph.names import grouped, numbered
from mgsgraph.network import (
    Network,
    NodePrior,
    Pass,
    PassPrior,
    PolynomialPrior,
    Process,
    ProcessPrior,
    SharedKind,
    SharedUnknown,
)
from mgsgraph.network.joining import found_passes, mountings, seconds, sine_over, spans
from mgsgraph.units import DEG, MRAD

_CORRELATION_TIMES = 2.0
"""Between nodes, at most: after them 14 % of a departure is left, and nodes are all but white noise."""


class PassInput(msgspec.Struct, forbid_unknown_fields=True, frozen=True):
    """Images on one trajectory: of one spacecraft, at overlapping or neighbouring times (half an hour apart at most).

    Without `images` those that no other table names are sorted into passes: by time, place and plane of the orbit.
    """

    name: str = ""
    """What to call it in reports; date and time (UTC) of its first line when absent, and behind it for several."""
    images: tuple[str, ...] | None = None
    """Names of its images; when absent, all that no other pass names, each with those of its own pass; with a `prior`
    all are of one."""
    nodes: NodesInput | None = None
    """Its orientation images; for polynomials four over the pass, and nothing to say. Of processes one every half
    correlation time when absent."""
    position: PositionInput = PositionInput()
    """A-priori errors of its positions."""
    attitude: AttitudeInput = AttitudeInput()
    """A-priori errors of its attitude."""
    vibrations: tuple[VibrationInput, ...] | Literal["estimated"] = ()
    """Vibrations of its attitude, of known frequencies; "estimated": those that rays show are found."""
    prior: NodePriorInput | None = None
    """In place of `position` and `attitude`, of images of one camera (HRSC): bias, drift and departures of both."""

    @property
    def sorted_by_time(self) -> bool:
        """Whether its images may be of several passes, into which they are sorted."""
        return self.images is None and self.prior is None

    @property
    def polynomial(self) -> bool:
        """Whether both position and attitude are polynomials of time."""
        return self.prior is None and self.position.model == self.attitude.model == "polynomial"

    def nodes_of(self, pictures: Sequence[PushbroomImage], where: str) -> OrientationImages:
        """Nodes of a pass of these images; `where` names this table."""
        if self.prior is not None:
            if self.position != PositionInput() or self.attitude != AttitudeInput():
                raise InputError(where, "prior beside position or attitude", "one of them")
            with errors_from(f"{where}.nodes"):
                return (self.nodes or NodesInput()).images(pictures, f"{where}.nodes")
        if not self.polynomial:
            stated = self.nodes or NodesInput(spacing_s=min(self._spacing(), _longest(pictures)))
            nodes = stated.images(pictures, f"{where}.nodes")
            self._require_close(nodes, where)
            return nodes
        if self.nodes is not None:
            found = "nodes beside polynomials, which four nodes over the pass carry"
            raise InputError(where, found, "nodes with a process", "take one of the two out")
        edges, epoch = spans(pictures), pictures[0].trajectory.epoch
        start, stop = float(edges[:, 0].min()) - epoch, float(edges[:, 1].max()) - epoch
        return evenly_spaced("lagrange", epoch, (start, stop), stop - start)

    @property
    def _processes(self) -> list[Motion | ProcessInput]:
        return [process for motion in (self.position, self.attitude) for process in (motion, *motion.plus)]

    def _spacing(self) -> float:
        """S between nodes that describe the fastest process: half its correlation time."""
        times = [process.correlation_time_s / 2.0 for process in self._processes if process.correlation_time_s]
        return min(times, default=SPACING)

    def _require_close(self, nodes: OrientationImages, where: str) -> None:
        """Raise InputError for nodes so far apart that they would stand for a slower process than the stated one."""
        limits = [
            (time * _CORRELATION_TIMES, f"{process.model} of correlation time {time:g} s")
            for process in self._processes
            if (time := process.correlation_time_s)
        ]
        spacing = float(np.diff(nodes.times).max())
        for most, what in sorted(limits)[:1]:
            if spacing > most * (1.0 + 1e-9):
                found = f"nodes {spacing:.4g} s apart for {what}"
                remedy = f"spacing_s = {self._spacing():.3g}, or leave the nodes out"
                raise InputError(f"{where}.nodes", found, f"at most {most:.4g} s", remedy)

    def prior_of(self, where: str, default: OrientationPrior) -> PassPrior:
        """Prior of the nodes; `default` is that of [orientation], `where` names this table."""
        if self.prior is not None:
            return self.prior.prior(f"{where}.prior")
        places = f"{where}.position", f"{where}.attitude"
        if self.polynomial:
            return PolynomialPrior(
                polynomial_sigmas(self.position, default.sigmas[:, :3], places[0]),
                polynomial_sigmas(self.attitude, default.sigmas[:, 3:], places[1]),
            )
        parts, trends = list[tuple[Process, ...]](), list[tuple[Array, Array]]()
        tables: tuple[Motion, Motion] = (self.position, self.attitude)
        for motion, columns, place in zip(tables, (slice(3), slice(3, 6)), places, strict=True):
            trends.append(trend_sigmas(motion, default.sigmas[:, columns], place))
            line = motion.model == "polynomial"
            parts.append(negligible_departures(trends[-1][0]) if line else processes(motion, place))
        bias, drift = (np.concatenate(both) for both in zip(*trends, strict=True))
        with errors_from(where):
            return ProcessPrior(parts[0], parts[1], bias, drift)

    def image_prior(self, where: str, default: OrientationPrior) -> OrientationPrior:
        """Approximate prior of one of its images by itself: the constant and the linear part."""
        prior = self.prior_of(where, default)
        if isinstance(prior, PolynomialPrior):
            return OrientationPrior(prior.coefficient_sigmas)
        if isinstance(prior, NodePrior):
            return OrientationPrior(np.stack([np.hypot(prior.sigmas, prior.bias), np.maximum(prior.drift, 1e-9)]))
        assert isinstance(prior, ProcessPrior)
        return OrientationPrior(np.stack([prior.node_sigmas(np.zeros(1))[0], np.maximum(prior.drift, 1e-9)]))


def _longest(pictures: Sequence[PushbroomImage]) -> float:
    """S from the first line of some images to the last one."""
    edges = spans(pictures)
    return float(edges[:, 1].max() - edges[:, 0].min())


def require_image(name: str, names: Collection[str], where: str) -> None:
    """Raise InputError unless an image of the case is called so."""
    if name not in names:
        some_names = ", ".join(list(names)[:4])
        raise InputError(where, f"the image {name!r}", f"some of the case's images ({some_names})")


def members(entries: Sequence[PassInput], names: Sequence[str], path: str) -> list[list[int]]:
    """Images of each pass, ascending, by the names of all; each image is of one at most."""
    index, owner = numbered(names), dict[int, int]()
    for k, entry in enumerate(entries):
        where = f"{path}, passes[{k}], images"
        if entry.images is not None and not entry.images:
            raise InputError(where, "an empty list", "names of images", "leave it out to take all that are left")
        for name in entry.images or ():
            require_image(name, index, where)
            if index[name] in owner:
                at = owner[index[name]]
                called = f"pass {entries[at].name!r}" if entries[at].name else f"passes[{at}]"
                raise InputError(where, f"{name!r}, which {called} has already", "each image once")
            owner[index[name]] = k
    for k in [k for k, entry in enumerate(entries) if entry.images is None][:1]:
        if sum(entry.images is None for entry in entries) > 1:
            raise InputError(f"{path}, passes", "several without images", "names: one alone may take those left over")
        left = [j for j in range(len(names)) if j not in owner]
        require(left, f"{path}, passes[{k}]", "no image that no other table names", "images = [...]")
        owner |= dict.fromkeys(left, k)
    return [sorted(j for j, at in owner.items() if at == k) for k in range(len(entries))]


def passes_of(
    entries: Sequence[PassInput],
    of_entries: Sequence[Sequence[int]],
    images: Sequence[PushbroomImage],
    default: Callable[[str], OrientationPrior],
    path: str,
) -> tuple[Pass, ...]:
    """The passes of a network.

    Parameters
    ----------
    entries : sequence
        Tables of passes.
    of_entries : sequence
        Images of each, as `members` gives them.
    images : sequence of PushbroomImage
        All of the network.
    default : callable
        That of [orientation] for a mission, for passes that say none.
    path : str
        Case file, for errors.
    """
    passes = list[Pass]()
    for number, (entry, of_pass) in enumerate(zip(entries, of_entries, strict=True)):
        where, pictures = f"{path}, passes[{number}]", [images[j] for j in of_pass]
        groups = found_passes(pictures) if entry.sorted_by_time else [list(range(len(of_pass)))]
        for group in groups:
            of_group = [pictures[k] for k in group]
            name = entry.name if entry.name and len(groups) == 1 else f"{entry.name} {pass_name(of_group)}".strip()
            usual = default(of_group[0].mission)
            passes.append(_pass(entry, name, np.array(of_pass)[group], of_group, usual, where, path))
    return tuple(passes)


def rig_notes(images: Sequence[PushbroomImage], of_passes: Sequence[Sequence[int]]) -> list[str]:
    """A sentence where images without a pass were taken at one time from one trajectory; large blocks are skipped."""
    unassigned = sorted(set(range(len(images))).difference(*of_passes), key=lambda j: seconds(images[j]))
    for early, late in pairwise(images[j] for j in unassigned[:_MOST_COMPARED]):
        if seconds(late)[0] < seconds(early)[1] and len(found_passes([early, late])) == 1:
            return [
                f"{early.name} and {late.name} were taken at one time from one trajectory: [[passes]] adjusts it once, "
                "[[mountings]] the angles between their cameras (docs/passes.md)"
            ]
    return []


def vibration_unknowns(
    entries: Sequence[PassInput], of_entries: Sequence[Sequence[int]], network: Network, path: str
) -> tuple[SharedUnknown, ...]:
    """Stated vibrations of passes; arguments as of `mounting_unknowns`."""
    unknowns = list[SharedUnknown]()
    for number, (entry, of_pass) in enumerate(zip(entries, of_entries, strict=True)):
        for k, vibration in enumerate(() if entry.vibrations == "estimated" else entry.vibrations):
            where = f"{path}, passes[{number}].vibrations[{k}]"
            assert isinstance(vibration, VibrationInput)
            sigmas = three(vibration.sigma_mrad, f"{where}, sigma_mrad") * MRAD
            for owner in sorted({int(network.pass_of[j]) for j in of_pass}):
                of = network.passes[owner]
                with errors_from(where):
                    sine = sine_over([network.images[j] for j in of.images.tolist()], vibration.frequency_hz)
                    name = f"vibration of {vibration.frequency_hz:g} Hz, {of.name}"
                    unknowns.append(SharedUnknown.of_vibration(name, of.images, sine, sigmas, vibration.drift))
    return tuple(unknowns)


def pass_name(images: Sequence[PushbroomImage]) -> str:
    """UTC of the first line of a pass, as 2009-07-13T02:03:04."""
    return utc_of_tdb(min(seconds(image)[0] for image in images)).strftime("%Y-%m-%dT%H:%M:%S")


def _pass(
    entry: PassInput, name: str, indices: Index, pictures: list[PushbroomImage], default: OrientationPrior, where: str,
    path: str,
) -> Pass:  # fmt: skip
    axes = mountings(pictures, where, one_camera=entry.prior is not None)
    with errors_from(where, path):
        return Pass(name, indices, entry.nodes_of(pictures, where), entry.prior_of(where, default), axes)


_MOST_COMPARED = 1000
"""Images, in the order of time, among which two of one moment are sought."""
_LOOSE = 1e-3
"""rad by which the tables of two images of one camera may have it mounted otherwise in one pass."""


class MountingInput(msgspec.Struct, forbid_unknown_fields=True, frozen=True):
    """How one camera, or the laser, stands against its trajectory: stated angles and arms are applied to the nominal
    orientation; those with a sigma are unknowns beside what is stated.
    """

    camera: tuple[str, ...] = ()
    """Names of the images of one camera."""
    instrument: str = ""
    """Instead of their names: what their labels or cubes call it (`InstrumentId`, as NACR)."""
    laser: tuple[str, ...] = ()
    """Instead of a camera, the laser: names of images along which its ranges are measured."""
    name: str = ""
    """What to call it in reports; the instrument, or the first image, when absent."""
    sharing: Literal["fixed", "campaign", "pass"] = "campaign"
    """Who shares an unknown: all these images, those of each pass (an image without: by itself); fixed: none, and what
    is stated holds."""
    boresight_mrad: tuple[float, ...] = ()
    """Rotation of the camera about its own axes x, y, z, applied to its nominal attitude; not of the laser."""
    lever_arm_m: tuple[float, ...] = ()
    """Where the camera is, along its own axes x, y, z, from where its tables have it; not of the laser, nor of images
    that carry laser ranges."""
    boresight_sigma_mrad: Sigmas | None = None
    """A-priori sigma of that rotation: one for x, y and z, or three numbers; absent: known."""
    lever_arm_sigma_m: Sigmas | None = None
    """A-priori sigma of that arm: one for x, y and z, or three numbers; absent: known."""

    @property
    def stated(self) -> bool:
        """Whether it changes the nominal orientation."""
        return bool(self.boresight_mrad or self.lever_arm_m)

    def called(self) -> str:
        """What reports call it."""
        return self.name or self.instrument or next(iter(self.camera or self.laser))

    def check(self, where: str) -> None:
        """Raise InputError for keys that contradict each other; `where` names the table."""
        given = [key for key in ("camera", "instrument", "laser") if getattr(self, key)]
        require(len(given) == 1, where, " and ".join(given) or "no camera", "one of camera, instrument and laser")
        unknown = self.boresight_sigma_mrad is not None or self.lever_arm_sigma_m is not None
        if self.sharing == "fixed" and unknown:
            raise InputError(where, 'sigmas of a mounting with sharing = "fixed"', "none", '"campaign" or "pass"')
        if self.sharing == "fixed" and not self.stated:
            raise InputError(where, "a fixed mounting without angles and arms", "boresight_mrad or lever_arm_m")
        if self.sharing != "fixed" and not unknown:
            expected = "boresight_sigma_mrad or lever_arm_sigma_m"
            raise InputError(where, "an unknown mounting without a sigma", expected, 'or sharing = "fixed"')
        if self.laser and self.stated:
            raise InputError(where, "stated angles or arms of the laser", "those of a camera", "take them out")
        # half a turn, and what no spacecraft reaches
        for key, most in (("boresight_mrad", 1e3 * np.pi), ("lever_arm_m", 1e4)):
            values = getattr(self, key)
            if values and (len(values) != 3 or not np.all(np.abs(values) <= most)):
                expected = f"three numbers up to {most:g}, of the axes x, y, z"
                raise InputError(f"{where}, {key}", f"{list(values)}", expected)


def mounted_images(
    entries: Sequence[MountingInput], instruments: Sequence[str], images: Sequence[PushbroomImage], path: str
) -> tuple[PushbroomImage, ...]:
    """Images whose nominal orientation has the mountings that are stated.

    Parameters
    ----------
    entries : sequence of MountingInput
    instruments : sequence of str
        What the file of each image calls its instrument; empty where it does not say.
    images : sequence of PushbroomImage
    path : str
        Case file, for errors.

    Raises
    ------
    InputError
        An image in two mountings, or unknown; a nominal orientation as polynomials, which can't be moved.
    """
    moved, names = list(images), [image.name for image in images]
    for k, of_mounting in enumerate(mounted(entries, instruments, names, path)):
        if entries[k].stated:
            for j in of_mounting:
                moved[j] = _moved(moved[j], entries[k], f"{path}, mountings[{k}]")
    return tuple(moved)


def mounted(
    entries: Sequence[MountingInput], instruments: Sequence[str], names: Sequence[str], path: str
) -> list[list[int]]:
    """Images of each mounting, ascending; of cameras, each image is of one at most."""
    owner, groups = dict[tuple[bool, int], int](), list[list[int]]()
    for k, entry in enumerate(entries):
        where = f"{path}, mountings[{k}]"
        entry.check(where)
        instrument = entry.instrument.upper()
        of_instrument = tuple(name for name, of in zip(names, instruments, strict=True) if of == instrument)
        members = entry.camera or entry.laser or of_instrument
        present = ", ".join(sorted({kind for kind in instruments if kind})) or "none: ISDs and states don't say"
        require(members, f"{where}, instrument", f"{entry.instrument!r}, of no image", f"one of those ({present})")
        for name in members:
            require_image(name, names, where)
            at = bool(entry.laser), list(names).index(name)
            if at in owner:
                other = f"mountings[{owner[at]}]" if owner[at] != k else "it"
                raise InputError(where, f"{name!r}, which {other} has already", "one mounting for each camera")
            owner[at] = k
        groups.append(sorted(list(names).index(name) for name in members))
    return groups


def _moved(image: PushbroomImage, entry: MountingInput, where: str) -> PushbroomImage:
    """The image with its camera turned and moved as a mounting states it."""
    turn = rotation.exponential(np.array(entry.boresight_mrad or np.zeros(3)) * MRAD).T
    arm, path = np.array(entry.lever_arm_m or np.zeros(3)), image.trajectory
    if not isinstance(path, Trajectory | FixedTrajectory):
        found = f"image {image.name}, whose nominal orientation is polynomials"
        raise InputError(where, found, "nominal = 'trajectory'", "take angles and arms out, and give sigmas")
    camera = replace(path.camera, constant=turn @ path.camera.constant)
    position = _beside(path.position, camera, arm) if np.any(arm) else path.position
    return replace(image, trajectory=replace(path, camera=camera, position=position))


def _beside(position: PositionTable, camera: AttitudeTable, arm: Array) -> PositionTable:
    """Positions of a table moved by an arm (3,) in m along the camera's axes."""
    times = np.unique(np.concatenate([position.times, camera.times]))
    times = times[(times >= position.times[0]) & (times <= position.times[-1])]
    places, velocities = position.at(times)
    matrix, rate = camera.at(np.clip(times, *camera.times[[0, -1]]))
    to_table = matrix.mT
    moving = to_table @ np.cross(rate, arm)[:, :, None]
    return PositionTable(times, places + to_table @ arm, velocities + moving[:, :, 0])


def mounting_unknowns(
    entries: Sequence[MountingInput], of_entries: Sequence[Sequence[int]], network: Network, path: str
) -> tuple[SharedUnknown, ...]:
    """Unknowns of mountings: one for all images of a camera, or one for each pass.

    Parameters
    ----------
    entries : sequence of MountingInput
    of_entries : sequence
        Images of each (`mounted`).
    network : Network
        With its passes.
    path : str
        Case file, for errors.

    Raises
    ------
    InputError
        For images of one camera that their tables have mounted otherwise in a pass; for a stated lever arm of an image
        that carries laser ranges.
    """
    unknowns = list[SharedUnknown]()
    for k, (entry, of_mounting) in enumerate(zip(entries, of_entries, strict=True)):
        where = f"{path}, mountings[{k}]"
        if not entry.laser:
            _require_one_camera(network, of_mounting, where)
        if any(entry.lever_arm_m):
            _require_no_ranges(network, of_mounting, where)
        if entry.sharing == "fixed":
            continue
        for after, images in _sharing(entry, of_mounting, network):
            turned, moved = _KINDS[bool(entry.laser)]
            for kind, key, unit, word in (
                (turned, "boresight_sigma_mrad", MRAD, "boresight"), (moved, "lever_arm_sigma_m", 1.0, "lever arm")
            ):  # fmt: skip
                if (value := getattr(entry, key)) is not None:
                    sigmas = three(value, f"{where}, {key}") * unit
                    called = entry.called().removeprefix(f"{word} of ")
                    name = f"{word} of {called}{after}"
                    with errors_from(where):
                        unknowns.append(SharedUnknown(name, kind, np.array(images), sigmas))
    return tuple(unknowns)


def _require_no_ranges(network: Network, of_mounting: Sequence[int], where: str) -> None:
    """Raise InputError for an arm of an image that carries ranges: the laser begins where its trajectory is, which the
    arm has moved for the camera.
    """
    for j in np.intersect1d(network.ranges.image, of_mounting)[:1].tolist():
        found = f"a stated arm of image {network.images[j].name}, whose trajectory is the origin of laser ranges"
        remedy = "lever_arm_sigma_m instead, which leaves ranges as they are, or a correction of its tables"
        raise InputError(f"{where}, lever_arm_m", found, "images without ranges", remedy)


_KINDS = {
    False: (SharedKind.CAMERA_BORESIGHT, SharedKind.CAMERA_LEVER_ARM),
    True: (SharedKind.ALTIMETER_BORESIGHT, SharedKind.ALTIMETER_LEVER_ARM),
}


def _sharing(entry: MountingInput, of_mounting: Sequence[int], network: Network) -> list[tuple[str, list[int]]]:
    """What to add to an unknown's name, and the images that share it."""
    if entry.sharing == "campaign":
        return [("", list(of_mounting))]
    owners = [(int(network.pass_of[j]), j) for j in of_mounting]
    groups = grouped((network.passes[k].name if k >= 0 else network.images[j].name, j) for k, j in owners)
    return [(f", {name}", images) for name, images in groups.items()]


def _require_one_camera(network: Network, of_mounting: Sequence[int], where: str) -> None:
    """Raise InputError where images of one camera have different mountings in one pass."""
    for owner in {int(network.pass_of[j]) for j in of_mounting} - {-1}:
        of_pass = [j for j in of_mounting if int(network.pass_of[j]) == owner]
        first = network.axes_of(of_pass[0])
        for j in of_pass[1:] if first is not None else ():
            axes = network.axes_of(j)
            assert axes is not None
            assert first is not None
            angle = float(np.linalg.norm(rotation.logarithm((axes @ first.T)[None])))
            if angle > _LOOSE:
                names = f"images {network.images[of_pass[0]].name} and {network.images[j].name}"
                found = f"{names} of one camera, mounted {angle / DEG:.3g} deg apart in {network.passes[owner].name}"
                raise InputError(where, found, "one mounting for each camera", "give each camera its own table")

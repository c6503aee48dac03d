"""[[mountings]] of a case file: how a camera, or the laser, stands against the trajectory that carries it: turned by
boresight angles, and away by a lever arm; stated, or unknown beside what is stated.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import Literal

import msgspec
import numpy as np

from mgsgraph.case.motion import Sigmas, three
from mgsgraph.errors import InputError, errors_from
from mgsgraph.geometry import rotation
from mgsgraph.geometry.image import PushbroomImage
from mgsgraph.geometry.records import Array
from mgsgraph.geometry.trajectory import AttitudeTable, FixedTrajectory, PositionTable, Trajectory
from mgsgraph.network import Network, SharedKind, SharedUnknown
from mgsgraph.units import DEG, MRAD

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
    """A-priori sigma of that rotation about x, y, z alike, or three numbers; absent: known."""
    lever_arm_sigma_m: Sigmas | None = None
    """A-priori sigma of that arm along x, y, z alike, or three numbers; absent: known."""

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
        if len(given) != 1:
            raise InputError(where, " and ".join(given) or "no camera", "one of camera, instrument and laser")
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
    found, names = list(images), [image.name for image in images]
    for k, mine in enumerate(mounted(entries, instruments, names, path)):
        if entries[k].stated:
            for j in mine:
                found[j] = _moved(found[j], entries[k], f"{path}, mountings[{k}]")
    return tuple(found)


def mounted(
    entries: Sequence[MountingInput], instruments: Sequence[str], names: Sequence[str], path: str
) -> list[list[int]]:
    """Images of each mounting, ascending; of cameras, each image is of one at most."""
    owner, found = dict[tuple[bool, int], int](), list[list[int]]()
    for k, entry in enumerate(entries):
        where = f"{path}, mountings[{k}]"
        entry.check(where)
        instrument = entry.instrument.upper()
        alike = tuple(name for name, of in zip(names, instruments, strict=True) if of == instrument)
        wanted = entry.camera or entry.laser or alike
        if not wanted:
            there = ", ".join(sorted({one for one in instruments if one})) or "none: ISDs and states don't say"
            raise InputError(f"{where}, instrument", f"{entry.instrument!r}, of no image", f"one of those ({there})")
        for name in wanted:
            if name not in names:
                known = ", ".join(list(names)[:4])
                raise InputError(where, f"the image {name!r}", f"some of the case's images ({known})")
            at = bool(entry.laser), list(names).index(name)
            if at in owner:
                other = f"mountings[{owner[at]}]" if owner[at] != k else "it"
                raise InputError(where, f"{name!r}, which {other} has already", "one mounting for each camera")
            owner[at] = k
        found.append(sorted(list(names).index(name) for name in wanted))
    return found


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
    """Positions that are away from those of a table by an arm (3,) in m along the camera's axes."""
    times = np.unique(np.concatenate([position.times, camera.times]))
    times = times[(times >= position.times[0]) & (times <= position.times[-1])]
    places, velocities = position.at(times)
    matrix, rate = camera.at(np.clip(times, *camera.times[[0, -1]]))
    to_table = np.swapaxes(matrix, 1, 2)
    moving = to_table @ np.cross(rate, arm)[:, :, None]
    return PositionTable(times, places + to_table @ arm, velocities + moving[:, :, 0])


def mounting_unknowns(
    entries: Sequence[MountingInput], of_entries: Sequence[Sequence[int]], network: Network, path: str
) -> tuple[SharedUnknown, ...]:
    """What is unknown of mountings: of all images of a camera, or of those of each pass.

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
    found = list[SharedUnknown]()
    for k, (entry, mine) in enumerate(zip(entries, of_entries, strict=True)):
        where = f"{path}, mountings[{k}]"
        if not entry.laser:
            _require_one_camera(network, mine, where)
        if any(entry.lever_arm_m):
            _require_no_ranges(network, mine, where)
        if entry.sharing == "fixed":
            continue
        for after, images in _sharing(entry, mine, network):
            turned, moved = _KINDS[bool(entry.laser)]
            for kind, key, unit, word in (
                (turned, "boresight_sigma_mrad", MRAD, "boresight"), (moved, "lever_arm_sigma_m", 1.0, "lever arm")
            ):  # fmt: skip
                if (value := getattr(entry, key)) is not None:
                    sigmas = three(value, f"{where}, {key}") * unit
                    called = entry.called().removeprefix(f"{word} of ")
                    name = f"{word} of {called}{after}"
                    with errors_from(where):
                        found.append(SharedUnknown(name, kind, np.array(images), sigmas))
    return tuple(found)


def _require_no_ranges(network: Network, mine: Sequence[int], where: str) -> None:
    """Raise InputError for an arm of an image that carries ranges: the laser begins where its trajectory is, which the
    arm has moved for the camera.
    """
    for j in np.intersect1d(network.ranges.image, mine)[:1].tolist():
        found = f"a stated arm of image {network.images[j].name}, whose trajectory is the origin of laser ranges"
        remedy = "lever_arm_sigma_m instead, which leaves ranges as they are, or a correction of its tables"
        raise InputError(f"{where}, lever_arm_m", found, "images without ranges", remedy)


_KINDS = {
    False: (SharedKind.CAMERA_BORESIGHT, SharedKind.CAMERA_LEVER_ARM),
    True: (SharedKind.ALTIMETER_BORESIGHT, SharedKind.ALTIMETER_LEVER_ARM),
}


def _sharing(entry: MountingInput, mine: Sequence[int], network: Network) -> list[tuple[str, list[int]]]:
    """What to add to an unknown's name, and the images that share it."""
    if entry.sharing == "campaign":
        return [("", list(mine))]
    groups = dict[str, list[int]]()
    for j in mine:
        owner = int(network.pass_of[j])
        groups.setdefault(network.passes[owner].name if owner >= 0 else network.images[j].name, []).append(j)
    return [(f", {name}", images) for name, images in groups.items()]


def _require_one_camera(network: Network, mine: Sequence[int], where: str) -> None:
    """Raise InputError where tables have images of one camera mounted otherwise in one pass."""
    for owner in {int(network.pass_of[j]) for j in mine} - {-1}:
        of_pass = [j for j in mine if int(network.pass_of[j]) == owner]
        first = network.axes_of(of_pass[0])
        for j in of_pass[1:] if first is not None else ():
            axes = network.axes_of(j)
            assert axes is not None
            assert first is not None
            apart = float(np.linalg.norm(rotation.logarithm((axes @ first.T)[None])))
            if apart > _LOOSE:
                names = f"images {network.images[of_pass[0]].name} and {network.images[j].name}"
                found = f"{names} of one camera, mounted {apart / DEG:.3g} deg apart in {network.passes[owner].name}"
                raise InputError(where, found, "images of one camera, mounted alike", "give each camera its own table")

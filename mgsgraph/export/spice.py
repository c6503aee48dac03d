"""Adjusted trajectories as SPICE kernels: SPK of type 13, CK of type 3, and the text kernels that make them readable.

Positions and attitudes are given against the body-fixed frame of the adjustment, which is what a solution knows
exactly: polynomials in place of a trajectory say nothing of the body's rotation, and image support data bring a table
of their own. So places on the ground and in the images don't depend on the PCK that a user has. Asked for J2000 (as
ISIS and ALE do), SPICE turns them by body.bc, the rotation that was adjusted with, or, where a solution has none, by
the body's IAU frame and the PCK that is loaded.

ISIS follows frames down to J2000 whatever they refer to (SpiceRotation::FrameTrace, SpiceRotation.cpp, DOI-USGS/ISIS3).
"""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import chdir, contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from shutil import copyfile
from textwrap import wrap

import numpy as np
import spiceypy
from spiceypy.utils.exceptions import NotFoundError

from mgsgraph.adjustment.solution import Solution
from mgsgraph.analysis.statistics import orientation_statistics
from mgsgraph.errors import InputError, require
from mgsgraph.export.spice_nodes import (
    TOLERANCE,
    AdjustedNodes,
    Paths,
    Reprojection,
    adjusted_nodes,
    images_of,
    reprojection,
    united_paths,
)
from mgsgraph.export.spice_texts import (
    CLOCK,
    META_KERNEL,
    NAMES,
    Body,
    Carrier,
    clock_text,
    constants_text,
    frames_text,
    instruments_text,
    list_text,
)
from mgsgraph.files.labels.kernels import loaded, spice_words
from mgsgraph.files.output.folders import PROGRAM
from mgsgraph.geometry import rotation
from mgsgraph.geometry.body import target_name
from mgsgraph.geometry.plausibility import resection_remedy
from mgsgraph.geometry.records import Array
from mgsgraph.geometry.trajectory import Trajectory
from mgsgraph.record import Record
from mgsgraph.text import two
from mgsgraph.units import ARCSEC, KM

_DEGREE = 3
"""Of the Hermite interpolation: between two nodes, as `PositionTable`."""
_MARGIN, _FEWEST = 0.01, 10.0
"""Share of an image's lines, and lines, that kernels cover before its first and after its last line."""
_BEFORE = 86_400.0
"""s, from the clock's zero to the first image."""
_WIDTH = 110
"""Characters of a comment's line; text kernels have 132."""
_SEGMENT = 40
"""Characters of a segment's name."""
_REMEDY = "free some space, or choose another --out, where you may write"


@dataclass(frozen=True, slots=True)
class NaifIds(Record):
    """The mission's ids for one image; its camera's frame then has attitude of its own, not a mount's.

    Examples
    --------
    >>> mgsgraph.NaifIds(spacecraft=-85, camera=-85600).camera
    -85600
    """

    spacecraft: int
    """Such as -94."""
    camera: int
    """Such as -94031."""


@dataclass(frozen=True, slots=True)
class MissionClock:
    """The clock that attitudes are tagged with."""

    spacecraft: int
    """Its NAIF id, such as -94."""
    kernels: tuple[Path, ...]
    """SCLK, and the LSK that it needs; copied."""


@dataclass(frozen=True, slots=True)
class SpiceNaming(Record):
    """Ids of the mission, which a solution lacks. They are optional: without them every image has ids of its own.

    Examples
    --------
    >>> naming = mgsgraph.SpiceNaming(images={"SIM/A": mgsgraph.NaifIds(-94, -94031)})
    >>> naming.images["SIM/A"].spacecraft
    -94
    """

    images: Mapping[str, NaifIds] = field(default_factory=dict)
    """By image; those of the same ids must not overlap in time."""
    body: str | None = None
    """As SPICE calls it; by its radius when absent."""
    body_frame: str | None = None
    """Frame of the user's PCK that the adjusted coordinates are in, such as MOON_ME, in place of body.bc."""
    clock: MissionClock | None = None
    """One is made when absent."""


def write_spice(solution: Solution, folder: Path, naming: SpiceNaming | None = None, origin: str = "") -> list[Path]:
    """Write the adjusted trajectory of every pass and image, and a meta-kernel.

    Images of a pass are of one spacecraft, whose SPK has one path, and each of a camera whose frame has a CK of its
    own, with its mounting as adjusted.

    Parameters
    ----------
    solution : Solution
        Whose images' nominal trajectories have the mission's time biases in them already.
    folder : Path
        Exists; files of these names are replaced.
    naming : SpiceNaming, optional
        The mission's ids and clock.
    origin : str
        Who made them from what, for the comments.

    Returns
    -------
    list of Path
        The meta-kernel, then the kernels in the order of loading.

    Raises
    ------
    InputError
        When a name, a distortion, a body or ids can't be held, or SPICE can't write.

    Examples
    --------
    >>> from pathlib import Path
    >>> naming = mgsgraph.SpiceNaming(images={"SIM/A": mgsgraph.NaifIds(-94, -94031)})
    >>> mgsgraph.write_spice(solution, Path("."), naming)[0].suffix
    '.tm'
    """
    export = _exported(solution, naming or SpiceNaming(), origin)
    clocks, texts = _texts(folder, export)
    with loaded([folder / name for name in (*clocks, NAMES[1])]), chdir(folder):  # SPICE holds names of 255 characters
        _write_positions(NAMES[5], export)
        _write_attitudes(NAMES[6], export)
        if export.body.relative is None:
            _write_rotation(NAMES[4], export)
    angular_rate = NAMES[4:5] if export.body.relative is None else ()
    kernels = [*clocks, *texts, *angular_rate, *NAMES[5:]]
    (folder / META_KERNEL).write_text(list_text(kernels, export.comments), encoding="ascii", newline="\n")
    return [folder / name for name in (META_KERNEL, *kernels)]


@dataclass(frozen=True, slots=True, eq=False)
class _Export:
    """Data of all files."""

    body: Body
    paths: Paths
    """Ids of each image, and the path of each spacecraft."""
    nodes: Sequence[AdjustedNodes]
    """Of each."""
    clock: int
    """Id of the clock."""
    clock_kernels: tuple[Path, ...]
    """The mission's; empty where one is made."""
    named: bool
    """Whether ids are the mission's."""
    comments: Sequence[str]

    @property
    def carriers(self) -> Sequence[Carrier]:
        """One for each image."""
        return self.paths.carriers

    @property
    def segments(self) -> Iterator[tuple[Carrier, AdjustedNodes, Array, str]]:
        """Each image with its nodes, their times (s TDB past J2000), and what its segments are called."""
        for carrier, nodes in zip(self.carriers, self.nodes, strict=True):
            yield carrier, nodes, nodes.times + nodes.epoch, carrier.image.name[:_SEGMENT]


def _exported(solution: Solution, naming: SpiceNaming, origin: str) -> _Export:
    for name in naming.images.keys() - set(solution.network.image_names):
        raise InputError(f"NAIF ids of {name}", "no image of the solution", "one that was adjusted")
    body = _body(solution, naming)
    network, carriers = solution.network, _carriers(solution, naming, reprojection(solution))
    nodes = [
        adjusted_nodes(carrier.image, solution.correction(j), (carrier.covered[0] - 1.0, carrier.covered[1] + 1.0))
        for j, carrier in enumerate(carriers)
    ]  # a line more than stated: times are rounded
    paths = united_paths(carriers, nodes, network.pass_of.tolist(), naming.images)
    clock = naming.clock or MissionClock(CLOCK, ())
    comments = _comments(solution, body, paths, nodes, origin)
    return _Export(body, paths, nodes, clock.spacecraft, clock.kernels, bool(naming.images), comments)


def _body(solution: Solution, naming: SpiceNaming) -> Body:
    ellipsoid = solution.network.body
    name = naming.body or target_name(ellipsoid)
    try:
        code = int(spiceypy.bodn2c(name))
    except NotFoundError:
        found = f"one that SPICE doesn't know ({name}, of an equatorial radius of {ellipsoid.equatorial:.10g} m)"
        raise InputError("body", found, "a body with a NAIF id", "say its name") from None
    angular_rate = all(isinstance(image.trajectory, Trajectory) for image in solution.network.images)
    relative = naming.body_frame or (None if angular_rate else f"IAU_{name.upper()}")
    return Body(name, code, (ellipsoid.equatorial, ellipsoid.equatorial, ellipsoid.polar), relative)


def _carriers(solution: Solution, naming: SpiceNaming, measured: Reprojection) -> list[Carrier]:
    """Every image, with ids of its own where the mission's aren't given."""
    measures, carriers = images_of(measured), []
    for j in range(len(solution.network.images)):
        image, own = solution.image(j), CLOCK - 1 - j
        seen_at = measured.places[measures[image.name], 0] if image.name in measures else np.array([0.0])
        margin = max(_FEWEST, _MARGIN * image.lines)
        first, last = min(0.0, float(seen_at.min())) - margin, max(float(image.lines), float(seen_at.max())) + margin
        ids = naming.images.get(image.name, NaifIds(own, 1000 * own))
        carriers.append(Carrier(ids.spacecraft, ids.camera, 1000 * own, image, (first, last)))
    return carriers


def _comments(solution: Solution, body: Body, paths: Paths, nodes: Sequence[AdjustedNodes], origin: str) -> list[str]:
    """Origin of the files, and facts about all of them; printable ASCII."""
    versions = ", ".join(f"{name} {version}" for name, version in solution.versions.items())
    lines = [
        f"Orientation adjusted by {PROGRAM} ({versions}).",
        *([origin] if origin else []),
        f"Solution {solution.name!r}: {solution.ending}, sigma0 {solution.sigma0:.6g}, "
        f"{solution.fit.degrees_of_freedom} degrees of freedom.",
        f"Frame {body.frame}: body-fixed, as adjusted. Positions are geometric (no light time, no aberration).",
        "Time biases of the mission's kernels are in positions and attitudes already and must NOT be added again.",
        "Camera +Z is out of the lens; camera constants: adjusted.ti.",
        "Sigmas: means over the image, for sigma0 = 1, along body-fixed axes and about the camera's axes x, y, z.",
        *_words_of_passes(solution, paths),
        "",
    ]
    for j, (carrier, part) in enumerate(zip(paths.carriers, nodes, strict=True)):
        start, stop = part.epoch + part.times[[0, -1]]
        sigmas, image = orientation_statistics(solution, j).mean_sigma, carrier.image
        biased = image.mission == "MGS" and not resection_remedy([image])  # without kernels there is no bias of theirs
        position, pointing = (" ".join(map(two, each)) for each in (sigmas[:3].tolist(), sigmas[6:] / ARCSEC))
        lines += [
            f"Image {image.name}: spacecraft {carrier.spacecraft}, camera {carrier.camera} ({carrier.frame}),",
            f"  lines {carrier.covered[0]:.1f} .. {carrier.covered[1]:.1f} of 0 .. {image.lines}, "
            f"{start:.6f} .. {stop:.6f} s TDB past J2000,",
            f"  {part.times.size} nodes; interpolation between them is off by {part.error:.1e} px at most "
            f"(limit {TOLERANCE:g} px).",
            f"  Sigmas of position {position} m, of pointing {pointing} arcsec.",
            *["  MOC's attitude bias is in this attitude, once (-1.15 s unless the case states another)."] * biased,
        ]
    plain = [line if line.isascii() and line.isprintable() else ascii(line)[1:-1] for line in lines]
    return [part for line in plain for part in (wrap(line, _WIDTH, subsequent_indent="  ") or [""])]


def _words_of_passes(solution: Solution, paths: Paths) -> list[str]:
    """Which spacecraft each pass is, and why an image of it is another."""
    sentences, images = [], solution.network.images
    for pass_ in solution.network.passes:
        names = [images[j].name for j in pass_.images.tolist() if images[j].name not in paths.departures]
        code = next(carrier.spacecraft for carrier in paths.carriers if carrier.image.name in names)
        sentences.append(f"Pass {pass_.name!r}: one trajectory, spacecraft {code}, of the images {', '.join(names)}.")
    for name, off in paths.departures.items():
        sentences.append(f"Image {name}: a spacecraft of its own, {off:.3g} m off the trajectory of its pass.")
    return sentences


def _texts(folder: Path, export: _Export) -> tuple[list[str], tuple[str, ...]]:
    """Write the text kernels: names of the clock's, and of the others, in the order of loading."""
    texts = {
        NAMES[1]: frames_text(export.body, export.carriers, export.clock),
        NAMES[2]: instruments_text(export.body, export.carriers, export.named),
        NAMES[3]: constants_text(export.body),
    }
    if export.clock_kernels:
        clocks = [path.name for path in export.clock_kernels]
        for path in export.clock_kernels:
            require(path.is_file(), str(path), "no such file", "the mission's SCLK or LSK")
            copyfile(path, folder / path.name)
    else:
        clocks = [NAMES[0]]
        first = min(part.epoch + float(part.times[0]) for part in export.nodes)
        texts = {NAMES[0]: clock_text(float(np.floor(first - _BEFORE)))} | texts
    for name, text in texts.items():
        (folder / name).write_text(text, encoding="ascii", newline="\n")
    return clocks, NAMES[1:4]


@contextmanager
def _opened(name: str, export: _Export) -> Iterator[int]:
    """Handle of a new SPK (.bsp) or CK (.bc) with its comments."""
    Path(name).unlink(missing_ok=True)
    positions = name.endswith(".bsp")
    room = sum(len(line) + 1 for line in export.comments)  # made later, SPICE leaves in it what was in memory
    with spice_words(name, _REMEDY):
        handle = (spiceypy.spkopn if positions else spiceypy.ckopn)(name, f"ADJUSTED BY {PROGRAM.upper()}", room)
        try:
            spiceypy.dafac(handle, [line or " " for line in export.comments])
            yield handle
        except BaseException:
            spiceypy.dafcls(handle)
            raise
        (spiceypy.spkcls if positions else spiceypy.ckcls)(handle)


def _write_positions(name: str, export: _Export) -> None:
    with _opened(name, export) as handle:
        for spacecraft, path in export.paths.of_spacecraft.items():
            for image, first, last in path:
                nodes, name = export.nodes[image], export.carriers[image].image.name[:_SEGMENT]
                times = nodes.times + nodes.epoch
                used = slice(max(int(np.searchsorted(times, first, side="right")) - 1, 0), None)
                states = np.hstack([nodes.positions, nodes.velocities])[used] / KM
                spiceypy.spkw13(
                    handle, spacecraft, export.body.code, export.body.frame, first, last, name, _DEGREE,
                    states.shape[0], states, times[used],
                )  # fmt: skip


def _write_attitudes(name: str, export: _Export) -> None:
    with _opened(name, export) as file:
        for carrier, nodes, times, title in export.segments:
            matrices = nodes.matrices
            _add_attitudes(file, carrier.camera, export, export.body.frame, title, times, matrices, nodes.angular_rate)


def _write_rotation(name: str, export: _Export) -> None:
    """How the body turned over each image, at the nodes of its own table: J2000 to the body-fixed frame."""
    with _opened(name, export) as handle:
        for carrier, nodes, times, segment in export.segments:
            assert isinstance(carrier.image.trajectory, Trajectory)
            table, (first, last) = carrier.image.trajectory.body, nodes.times[[0, -1]]
            inner = table.times[(table.times > first) & (table.times < last)] + nodes.epoch
            places = np.unique(np.concatenate([times[[0, -1]], inner]))
            matrices, angular_rate = table.at(places - nodes.epoch)
            inertial = np.einsum("nji,nj->ni", matrices, angular_rate)
            _add_attitudes(handle, export.body.rotation_id, export, "J2000", segment, places, matrices, inertial)


def _add_attitudes(
    handle: int, code: int, export: _Export, reference: str, segment: str, times: Array, matrices: Array, rates: Array
) -> None:
    """One CK segment; rates (n, 3) rad/s in axes of the reference frame."""
    with spice_words(f"clock {export.clock}", "give the SCLK (and LSK) of this clock, at the images' times"):
        ticks = np.array([spiceypy.sce2c(export.clock, float(time)) for time in times])
    quaternions = rotation.from_matrix(matrices)
    spiceypy.ckw03(
        handle, ticks[0], ticks[-1], code, reference, True, segment, ticks.size, ticks, quaternions,
        np.ascontiguousarray(rates), 1, ticks[:1],
    )  # fmt: skip

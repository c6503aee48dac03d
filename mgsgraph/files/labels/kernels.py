"""SPICE kernels to records: a kernel pool for the length of one reading, and trajectories sampled from it.

SPICE keeps one pool for the whole process: nothing here may run in two threads at once. Kilometres become metres on the
line of the call.

What SPICE kernels hold: files that a meta-kernel names, covered intervals, records of a CK; and what SPICE says.
"""

import re
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np
import spiceypy
from spiceypy.utils.exceptions import NotFoundError, SpiceyError

from mgsgraph.errors import InputError, require
from mgsgraph.files.labels.kernel_files import require_summaries, require_uncut, require_whole
from mgsgraph.files.opening import LARGEST_TEXT, finite_number, read_bytes
from mgsgraph.geometry import rotation
from mgsgraph.geometry.body import Ellipsoid, require_possible
from mgsgraph.geometry.records import Array
from mgsgraph.geometry.trajectory import AttitudeTable, PositionTable, Trajectory, tdb_of_utc
from mgsgraph.units import KM

_CK_CLASS, _DEEPEST = 3, 5
"""SPICE's class of frames that a CK orients, and how many of them one on another are followed."""
_SHOWN = 4
"""Covered intervals that a message lists."""


@contextmanager
def spice_words(where: str, remedy: str = "") -> Iterator[None]:
    """Turn an error of SPICE inside into an InputError of one line."""
    try:
        yield
    except SpiceyError as error:
        message = " ".join(str(getattr(error, "long", "") or error).split())
        short = getattr(error, "short", "")
        raise InputError(where, f"SPICE says: {message} {short}".rstrip(), remedy=remedy) from None


# --- files


def members(path: Path, home: Path = Path()) -> list[Path]:
    """The file itself, or the files that a meta-kernel names, from a folder or beside it; all must be kernels."""
    if b"KERNELS_TO_LOAD" not in _text_of(path):
        return [path]
    with spice_words(str(path)):
        spiceypy.ldpool(str(path))  # its variables only: SPICE itself would stop at the first file it doesn't find
    names = _strings("KERNELS_TO_LOAD")
    symbols = dict(zip(_strings("PATH_SYMBOLS"), _strings("PATH_VALUES"), strict=False))
    for variable in ("KERNELS_TO_LOAD", "PATH_SYMBOLS", "PATH_VALUES"):
        spiceypy.dvpool(variable)
    files = dict[Path, Path]()
    for name in reversed(names):
        full = name
        for symbol in sorted(symbols, key=len, reverse=True):
            full = full.replace(f"${symbol}", symbols[symbol])
        places = [place for place in (home / full, path.parent / full) if place.is_file()]
        if not places:
            raise InputError(
                str(path), f"the kernel {name!r} that it names is not there",
                f"it as {(home / full).absolute()} or beside the meta-kernel",
                "fetch it, or fix PATH_VALUES or KERNELS_TO_LOAD",
            )
        real = places[0].resolve()  # one that is named again is loaded once, at its last place
        if real not in files and b"KERNELS_TO_LOAD" in _text_of(real):
            raise InputError(str(path), f"the meta-kernel {name!r} among its kernels", "no other meta-kernel in one")
        files.setdefault(real, places[0])
    return [*files.values()][::-1]


def _strings(variable: str) -> list[str]:
    """Texts of a pool variable, those joined that '+' carries over; empty when there is no such variable."""
    try:
        parts = spiceypy.gcpool(variable, 0, spiceypy.dtpool(variable)[0], 1024)
    except NotFoundError:
        return []
    return "\n".join(part.rstrip() for part in parts).replace("+\n", "").removesuffix("+").split("\n")


def _text_of(path: Path) -> bytes:
    """What a text kernel says; nothing of a binary one. InputError unless it is one of both: SPICE takes any file for a
    text kernel.
    """
    require_whole(path)
    with spice_words(str(path)):
        kind, _ = spiceypy.getfat(str(path))
    require(kind != "XFR", str(path), "a transfer file", "a binary kernel", "convert it with NAIF's tobin")
    if kind in ("DAF", "DAS"):
        return b""
    text = read_bytes(path, LARGEST_TEXT)
    require(b"\\begindata" in text, str(path), "no SPICE kernel", "a binary kernel, or a text kernel with \\begindata")
    require_uncut(path, text)
    return text


# --- what kernels cover


class Cover(NamedTuple):
    """What kernels cover."""

    what: str
    """Of what, for messages."""
    intervals: list[tuple[float, float]]
    """s TDB past J2000, increasing."""
    ids: list[int]
    """NAIF ids that the kernels hold."""
    kind: str
    """SPK or CK."""


def _files(kind: str) -> list[str]:
    return [spiceypy.kdata(k, kind, 1024)[0] for k in range(spiceypy.ktotal(kind))]


def spk_cover(spacecraft: int) -> Cover:
    """When the loaded SPK know where a spacecraft is."""
    window, ids = spiceypy.cell_double(200_000), set[int]()
    with spice_words(f"coverage of {spacecraft}"):
        for file in _files("SPK"):
            ids |= set(spiceypy.spkobj(file))
            spiceypy.spkcov(file, spacecraft, window)
    return Cover(f"positions of {spacecraft}", _intervals(window), sorted(ids), "SPK")


def ck_cover(frame_id: int) -> Cover:
    """When the loaded CK know how a spacecraft's structure stands."""
    window, ids = spiceypy.cell_double(200_000), set[int]()
    with spice_words(f"coverage of {frame_id}", "load the SCLK kernel and a leapseconds kernel"):
        for file in _files("CK"):
            ids |= set(spiceypy.ckobj(file))
            spiceypy.ckcov(file, frame_id, False, "INTERVAL", 0.0, "TDB", window)
    return Cover(f"attitude of {frame_id}", _intervals(window), sorted(ids), "CK")


def _intervals(window: Any) -> list[tuple[float, float]]:
    return [spiceypy.wnfetd(window, k) for k in range(spiceypy.wncard(window))]


def covered_interval(cover: Cover, start: float, stop: float) -> tuple[float, float]:
    """The interval that holds start .. stop; InputError with all that are covered when none does."""
    for first, last in cover.intervals:
        if first <= start and stop <= last:
            return first, last
    missing = f"nothing for all of {_span(start, stop)}"
    if cover.intervals:
        nearest = sorted(cover.intervals, key=lambda interval: max(interval[0] - start, stop - interval[1]))[:_SHOWN]
        more = f" and {len(cover.intervals) - _SHOWN} more" if len(cover.intervals) > _SHOWN else ""
        expected = "a time within " + ", ".join(_span(*interval) for interval in sorted(nearest)) + more
    elif cover.ids:
        expected = f"an id out of those in the kernels: {', '.join(map(str, cover.ids))}"
    else:
        expected = f"at least one {cover.kind}"
    raise InputError(cover.what, missing, expected, f"load the {cover.kind} of this time")


def _span(start: float, stop: float) -> str:
    """An interval in ET and, where a leapseconds kernel is loaded, in UTC."""
    span = f"ET {start:.3f} .. {stop:.3f} s"
    try:
        return f"{spiceypy.et2utc(start, 'ISOC', 3)} .. {spiceypy.et2utc(stop, 'ISOC', 3)} UTC ({span})"
    except SpiceyError:
        return span


def ck_frames(frame_id: int) -> list[int]:
    """The frame, and those that the loaded CK have it relative to, each a CK's own, down to one that is not."""
    frames = [frame_id]
    while len(frames) < _DEEPEST:
        references = {int(codes[1]) for _, _, codes in _segments() if codes[0] == frames[-1]}
        below = {spiceypy.frinfo(reference)[1:] for reference in references}
        turned = sorted(class_id for kind, class_id in below if kind == _CK_CLASS and class_id not in frames)
        if not turned:
            break
        frames.append(turned[0])
    return frames


def _segments() -> Iterator[tuple[int, Array, tuple[int, ...]]]:
    """Handle, summary and integers (frame, reference, type ...) of each segment of the loaded CK."""
    for file in _files("CK"):
        handle = spiceypy.dafopr(file)
        try:
            spiceypy.dafbfs(handle)
            while spiceypy.daffna():
                summary = spiceypy.dafgs(5)
                yield handle, summary, tuple(int(number) for number in spiceypy.dafus(summary, 2, 6)[1])
        finally:
            spiceypy.dafcls(handle)


def ck_records(frame_id: int, spacecraft: int, start: float, stop: float) -> Array:
    """Times (n,) in s TDB past J2000 of the records of type 3 segments between start and stop."""
    times: list[float] = []
    ticks = [spiceypy.sce2c(spacecraft, time) for time in (start, stop)]
    for handle, summary, (frame, _, kind, *_) in _segments():
        if frame == frame_id and kind == 3:
            times += _type_3_records(handle, summary, *ticks)
    return np.unique([spiceypy.sct2e(spacecraft, tick) for tick in times])


def _type_3_records(handle: int, summary: Array, start: float, stop: float) -> list[float]:
    """Encoded clock of the records of one segment that lie between two."""
    count = int(spiceypy.cknr03(handle, summary))

    def clock(k: int) -> float:
        return float(spiceypy.ckgr03(handle, summary, k + 1)[0])

    low, high = 0, count
    while low < high:  # the first record after start
        middle = (low + high) // 2
        low, high = (middle + 1, high) if clock(middle) <= start else (low, middle)
    times = []
    while low < count and (time := clock(low)) < stop:
        times.append(time)
        low += 1
    return times


# --- the pool

Constants = Literal["iak", "ik"]
"""Whose camera constants: the ISIS addendum's or the instrument kernel's."""
Correction = Literal["NONE", "LT", "LT+S"]
"""Aberration correction of positions, the body being the observer (as in ISIS and ALE tables of MGS)."""

INTERVAL = 0.5
"""s between nodes. On M04/02852 positions are then within 2e-9 m, attitude within 3e-6 arcsec of SPICE."""
MARGIN = 2.0
"""s before the first and after the last line that a table holds where the kernels do."""

_CK_TOLERANCE = 1e-4
"""ticks (0.4 microseconds of MGS): rounding of a time at the very end of a segment, no more."""
_LEAP = 0.5
"""s."""
_FIXED = 4
"""SPICE's class of frames that are fixed to another."""
_LARGEST = 1e100
"""Larger ones measure nothing."""
_NEAR = 1e-4
"""s: a record of the CK this near to a node is that node."""


# --- the pool


@contextmanager
def loaded(kernels: Sequence[Path], home: Path = Path()) -> Iterator[None]:
    """A kernel pool that holds these kernels and no others, and afterwards again the files that it held before.

    Parameters
    ----------
    kernels : sequence of Path
        In the order of loading: where two define the same, the later wins.
    home : Path
        From which files that a meta-kernel names are looked for, and then beside the meta-kernel; as SPICE does, the
        working directory.

    Raises
    ------
    InputError
        A file that is missing, no kernel, or a transfer file; a meta-kernel that names a missing file; or a kernel of
        the caller's own that could not be loaded again afterwards (nothing has been changed then).
    """
    entries = (spiceypy.kdata(k, "ALL", 1024, 32, 1024) for k in range(spiceypy.ktotal("ALL")))
    before = [name for name, _, source, _ in entries if not source]  # others come by their meta-kernel
    for name in before:
        if not Path(name).is_file():
            raise InputError(
                name, "a kernel that is loaded has gone from its place", "it there, to be loaded again afterwards",
                "unload it (spiceypy.unload) first",
            )
    try:
        spiceypy.kclear()
        with spice_words(", ".join(map(str, kernels)), "one of these kernels contradicts the others, or itself"):
            for path in kernels:
                for file in members(Path(path), home):
                    require_summaries(file)
                    with spice_words(str(file)):
                        spiceypy.furnsh(str(file))
            yield
    finally:
        spiceypy.kclear()
        for name in before:
            spiceypy.furnsh(name)


# --- constants


def pool_numbers(
    name: str, count: int, remedy: str = "load the kernel that defines it", more: bool = False
) -> Array:
    """Numbers (count,) of a pool variable; InputError when it is missing, a text, or of another length (the first ones,
    and it may be longer, when `more`).
    """
    try:
        size, kind = spiceypy.dtpool(name)
    except NotFoundError:
        raise InputError("kernels", f"no {name}", f"{name} = {count} number(s)", remedy) from None
    if kind != "N" or size < count or (size > count and not more):
        raise InputError(f"kernels, {name}", f"{size} {'texts' if kind == 'C' else 'numbers'}", f"{count} number(s)")
    values = np.asarray(spiceypy.gdpool(name, 0, count), dtype=np.float64)
    if not (np.abs(values) < _LARGEST).all():
        raise InputError(f"kernels, {name}", f"the numbers {values.tolist()}", f"{count} finite number(s)", remedy)
    return values


def clock_time(spacecraft: int, count: str) -> float:
    """Time in s TDB past J2000 of a spacecraft clock count such as ``619971158:28``, or of ticks."""
    remedy, fields = f"load the SCLK kernel of {spacecraft} and a leapseconds kernel", f"SCLK01_N_FIELDS_{-spacecraft}"
    with spice_words(f"spacecraft clock count {count}", remedy):
        if spiceypy.expool(fields) and pool_numbers(fields, 1)[0] == 1.0:  # ticks, of which Kaguya has fractions
            return float(spiceypy.sct2e(spacecraft, finite_number(count)))
        return float(spiceypy.scs2e(spacecraft, count))


def utc_time(text: str, where: str) -> float:
    """Time in s TDB past J2000 of one in UTC, by the leap seconds that are loaded; `where` names it in errors."""
    plain = text.strip().removesuffix("Z")
    with spice_words(where, "write 2008-02-08T12:08:53.843; load a leapseconds kernel"):
        time = float(spiceypy.str2et(plain))
    own = float(tdb_of_utc([plain], where)[0]) if re.match(r"\d{4}-", plain) else time
    if abs(time - own) > _LEAP:
        remedy = "load a leapseconds kernel that is not older than the image"
        raise InputError(where, f"{own - time:+.0f} s of leap seconds that the kernel lacks", "all up to then", remedy)
    return time


def fixed_rotation(from_frame: int, to_frame: int, time: float = 0.0) -> Array:
    """Constant rotation (3, 3) from one frame to another that is fixed to it; InputError when it is not.

    `time` (s TDB past J2000) has no say in it, but SPICE asks the spacecraft's clock: let it be one that this knows.
    """
    with spice_words(f"frames {from_frame} and {to_frame}", "load the instrument or frames kernel"):
        names = [spiceypy.frmnam(frame) for frame in (from_frame, to_frame)]
        for frame, name in zip((from_frame, to_frame), names, strict=True):
            require(name, "kernels", f"no frame {frame}", remedy="load the instrument or frames kernel")
        return np.asarray(spiceypy.pxform(names[0], names[1], time), dtype=np.float64)


def ck_frame(frame: int) -> int:
    """Class id of the frame that CK orient, to which a frame is fixed; its own where they orient it (as new ones do
    LROC's cameras, which older frames kernels have fixed to the spacecraft).
    """
    with spice_words(f"frame {frame}", "load the instrument or frames kernel"):
        try:
            _, kind, class_id = spiceypy.frinfo(frame)
            while kind == _FIXED:
                _, kind, class_id = spiceypy.frinfo(spiceypy.tkfram(class_id)[1])
        except NotFoundError:
            raise InputError("kernels", f"no frame {frame}", remedy="load the instrument or frames kernel") from None
    return int(class_id)


def ellipsoid(body: str | int) -> Ellipsoid:
    """Ellipsoid of revolution of a body, as the PCK has it."""
    a, b, c = pool_numbers(f"BODY{body_code(body)}_RADII", 3) * KM
    if abs(a - b) > 1e-9 * a:
        raise InputError(f"kernels, radii of {body}", f"{a} and {b} m on the equator", "a body of revolution")
    shape = Ellipsoid(float(a), float(c))
    require_possible(shape, str(body), f"kernels, radii of {body}")
    return shape


def body_code(body: str | int) -> int:
    """NAIF id of a body; InputError for a name that SPICE doesn't know."""
    try:
        return int(spiceypy.bods2c(str(body)))
    except NotFoundError:
        raise InputError("body", f"{body!r}", "a name or number that SPICE knows, such as MARS") from None


# --- the trajectory


def sample_trajectory(
    spacecraft: int,
    body: str | int,
    frame_id: int,
    camera_constant: Array,
    start: float,
    stop: float,
    interval: float = INTERVAL,
    *,
    attitude_bias: float,
    position_bias: float = 0.0,
    aberration: Correction = "NONE",
    margin: float = MARGIN,
) -> Trajectory:
    """Trajectory of a camera out of the kernels that are loaded.

    The tables hold `start`, the middle (which is their epoch) and `stop` as nodes, so that they are SPICE's own values
    there, and go on by `margin` on both sides as far as the kernels do. Attitude has nodes at the CK's own records,
    too: between these it turns uniformly in SPICE as it does here.

    Parameters
    ----------
    spacecraft : int
        NAIF id (MGS -94), also that of its clock.
    body : str or int
        In whose fixed frame, the one that the kernels associate with it, the camera moves.
    frame_id : int
        CK class id of the spacecraft's structure (MGS -94000), or of a camera whose CK is relative to that (LROC).
    camera_constant : (3, 3)
        structure to camera frame.
    start, stop : float
        s TDB past J2000, edges of the first and the last line.
    interval : float
        s between nodes, at most.
    attitude_bias : float
        s; attitude(t) := CK(t + bias). The archive's CK of MGS carry time tags that NAIF calls 1.14 s later than they
        should be (file comments: filter latency on board, found by the MOLA team), and segments named 'Partly
        corrected data'. ISIS and ALE look them up at t - 1.15 s, so -1.15 is ISIS's way. Taken literally, tags that
        are late would want +1.14 in data not corrected at all: how much the archive holds already is not documented.
    position_bias : float
        s; position(t) := SPK(t + bias).
    aberration : "NONE", "LT" or "LT+S"
        positions are geometric by default; cameras and ranges need that.

    Raises
    ------
    InputError
        When the kernels do not cover the time (with the intervals they cover), or know other spacecraft only.
    """
    if not (np.isfinite([start, stop]).all() and start < stop and interval > 0.0 and margin >= 0.0):
        raise InputError("trajectory", f"{start} .. {stop} s every {interval} s", "start < stop, a positive interval")
    code = body_code(body)
    place = covered_interval(spk_cover(spacecraft), start + position_bias, stop + position_bias)
    frames = ck_frames(frame_id)
    turned = [covered_interval(ck_cover(frame), start + attitude_bias, stop + attitude_bias) for frame in frames]
    first = max(start - margin, place[0] - position_bias, *(begin - attitude_bias for begin, _ in turned))
    last = min(stop + margin, place[1] - position_bias, *(end - attitude_bias for _, end in turned))
    times, middle = _nodes(start, stop, first, last, interval)
    records = np.unique(np.concatenate([
        ck_records(frame, spacecraft, first + attitude_bias, last + attitude_bias) for frame in frames
    ])) - attitude_bias
    gaps = np.abs(times[np.clip(np.searchsorted(times, records) - np.array([[1], [0]]), 0, times.size - 1)] - records)
    camera_times = np.union1d(times, records[gaps.min(axis=0) > _NEAR])
    return Trajectory(
        epoch=middle,
        position=_positions(spacecraft, code, times, position_bias, aberration, middle),
        camera=_attitude(frame_id, spacecraft, camera_times, attitude_bias, camera_constant, middle),
        body=_body_rotation(code, times, middle),
    )


def _nodes(start: float, stop: float, first: float, last: float, interval: float) -> tuple[Array, float]:
    """Times of nodes from `first` to `last`, `start`, `stop` and the middle among them; and that middle."""
    count = 2 * max(1, int(np.ceil(0.5 * (stop - start) / interval)))
    inner = np.linspace(start, stop, count + 1)
    outer = [
        inner[0] - np.linspace(0.0, 1.0, 1 + int(np.ceil((start - first) / interval)))[1:] * (start - first),
        inner[-1] + np.linspace(0.0, 1.0, 1 + int(np.ceil((last - stop) / interval)))[1:] * (last - stop),
    ]
    return np.unique(np.clip(np.concatenate([inner, *outer]), first, last)), float(inner[count // 2])


def _positions(
    spacecraft: int, body: int, times: Array, bias: float, aberration: Correction, epoch: float
) -> PositionTable:
    remedy = f"load SPK that join {spacecraft} and {body} at this time"
    with spice_words(f"positions of {spacecraft} about {body}", remedy):
        states, _ = spiceypy.spkezr(str(spacecraft), times + bias, "J2000", aberration, str(body))
    states = np.asarray(states) * KM
    return PositionTable(times - epoch, states[:, :3], states[:, 3:])


def _attitude(
    frame_id: int, spacecraft: int, times: Array, bias: float, constant: Array, epoch: float
) -> AttitudeTable:
    matrices = np.empty((times.size, 3, 3))
    with spice_words(f"attitude of {frame_id}", "load a CK (and SCLK) that covers this time"):
        for k, time in enumerate(times):
            matrices[k], _ = spiceypy.ckgp(frame_id, spiceypy.sce2c(spacecraft, time + bias), _CK_TOLERANCE, "J2000")
    return AttitudeTable(times - epoch, rotation.continuous(rotation.from_matrix(matrices)), constant)


def body_frame(body: int) -> str:
    """Name of the fixed frame that the kernels associate with a body, as ISIS takes it."""
    with spice_words(f"the frame of {body}", "load a frames kernel that has one"):
        return str(spiceypy.cidfrm(body)[1])


def _body_rotation(body: int, times: Array, epoch: float) -> AttitudeTable:
    frame = body_frame(body)
    with spice_words(f"rotation of {body} by {frame}", "load the PCK (for MOON_ME: text, binary, and its frames)"):
        matrices = np.stack([spiceypy.pxform("J2000", frame, time) for time in times])
    return AttitudeTable(times - epoch, rotation.continuous(rotation.from_matrix(matrices)), np.eye(3))

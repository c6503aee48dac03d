"""Laser shots of altimeters' binary records, MOLA PEDR and LOLA RDR, to AltimeterShots.

MOLA Precision Experiment Data Records (PEDR). A frame of 776 bytes holds 20 shots of two seconds, big-endian; what is
kept once per frame is interpolated to the shots with x = (k - 10.5) / 20, k = 1 .. 20, as the archive's own program
PEDR2TAB (2.71828) does it:

* time: frame's midpoint + (k - 10.5) x 0.01 s x 100 MHz / clock;
* place: midpoint + x delta + parallax (radius of the shot - radius of the midpoint), the radii before the next step;
* radius: shot's radius - crossover correction - x (correction - correction of the frame before).

The archived range correction is handed on and NOT applied: the archive doesn't say whether the range holds it already.
Centimetres and millionths of degrees end here.

LOLA Reduced Data Records (RDR) of the Lunar Reconnaissance Orbiter. One record of 256 bytes, little-endian, per shot of
the laser, with five spots on the ground; one file per orbit. Bytes, units and flags: LOLARDR.FMT and the Software
Interface Specification of LRO-L-LOLA-3-RDR-V1.0 (Neumann, 2016). The coordinates are planetocentric in the Moon's
mean-Earth, polar-axis frame.
"""

import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mgsgraph.errors import InputError, require
from mgsgraph.files.altimetry.shot_values import crossings, known_ranges, positions, require_records, shots_with
from mgsgraph.files.opening import read_bytes
from mgsgraph.files.pvl import Block, flat_label
from mgsgraph.geometry.altimetry import LOLA, AltimeterShots
from mgsgraph.geometry.body import from_planetocentric
from mgsgraph.geometry.records import Array, Index, Mask, read_only
from mgsgraph.geometry.trajectory import tdb_of_tt
from mgsgraph.units import DEG

SHOTS = 20
"""Shots in a frame."""
_FRAMES = 1 << 14
"""Frames whose shots are made at a time."""
HEADER_RECORDS = 10
"""Records of the label before the first frame."""
IAU2000_VERSION = "L"
"""Product version from which on the archive is in the IAU2000 frame; earlier ones are IAU1991 (PDS pedr.html)."""
_PULSE = 1e-10
"""s, of the echo's widths."""
_CM = 1e-2
_MICRODEG = 1e-6 * DEG
_DAY, _CENTURY = 86400.0, 36525.0 * 86400.0
_LEAST, _LARGEST = 3.3e6, 3.5e6
"""m, between which any radius on Mars lies."""
_CLOCK, _CLOCK_TOLERANCE = 1e8, 0.01
"""Hz of the altimeter's clock, and the part by which it may run otherwise; it drifted by 4e-5."""
_FIRST_CROSSOVERS = 7.125
"""Software version from which on the frames hold crossover corrections (PEDR2TAB)."""

_FIELDS: tuple[tuple[str, str, int, int], ...] = (
    # name, type, count, byte (from 0); where no unit is said: cm, or 1e-6 deg
    ("seconds", "i4", 1, 0),  # of the midpoint, whole s TDB past J2000
    ("microseconds", "i4", 1, 4),
    ("orbit", "u4", 1, 8),
    ("spacecraft_latitude", "i4", 1, 12),
    ("spacecraft_longitude", "i4", 1, 16),
    ("spacecraft_radius", "u4", 1, 20),
    ("midpoint_range", "i4", 1, 24),
    ("shot_radius", "u4", SHOTS, 48),
    ("midpoint_radius", "u4", 1, 128),
    ("received_energy", "i2", SHOTS, 144),
    ("reflectivity", "u2", SHOTS, 184),
    ("channel", "u1", SHOTS, 224),
    ("pulse_width", "i2", SHOTS, 244),  # 0.1 ns
    ("sigma_optical", "i2", SHOTS, 284),  # 0.1 ns
    ("parallax_latitude", "i4", 1, 324),  # 1e-9 deg per m
    ("parallax_longitude", "i4", 1, 328),
    ("crossover", "i4", 1, 332),
    ("latitude", "i4", 1, 336),
    ("longitude", "i4", 1, 340),
    ("laser_energy", "i2", SHOTS, 344),  # 0.01 mJ
    ("shot_class", "i2", SHOTS, 384),  # 1 ground, 0 noise or cloud
    ("background", "i4", 8, 424),
    ("gate_delay", "i4", 1, 456),
    ("gate_width", "i4", 1, 460),
    ("frame_index", "i2", 1, 490),  # 1 .. 7 in the packet
    ("packet", "u2", 1, 494),  # the low 14 bits
    ("orbit_model", "i2", 1, 536),
    ("local_time", "i2", 1, 540),  # 1e-4 rad
    ("emission", "i2", 1, 546),  # 1e-4 rad
    ("time", "f8", 1, 552),  # of the midpoint, s TDB past J2000, again
    ("raw_energy", "u1", SHOTS, 560),
    ("raw_width", "u1", SHOTS, 580),
    ("d_spacecraft_latitude", "i4", 1, 600),  # over the frame, as all d_...
    ("d_spacecraft_longitude", "i4", 1, 604),
    ("d_spacecraft_radius", "i4", 1, 608),
    ("areoid_radius", "u4", 1, 612),
    ("off_nadir", "i4", 1, 616),
    ("d_areoid_radius", "i4", 1, 640),
    ("clock", "i4", 1, 644),  # Hz
    ("range", "i4", SHOTS, 648),  # 0 for none
    ("range_correction", "i2", SHOTS, 728),
    ("d_latitude", "i4", 1, 768),
    ("d_longitude", "i4", 1, 772),
)

FRAME: np.dtype[np.void] = np.dtype({
    "names": [name for name, *_ in _FIELDS],
    "formats": [f">{kind}" if count == 1 else (f">{kind}", (count,)) for _, kind, count, _ in _FIELDS],
    "offsets": [offset for *_, offset in _FIELDS],
    "itemsize": 776,
})
"""One frame as it lies in the file."""


def read_pedr(path: Path, clock_bias: float = 0.0, version: str | None = None) -> AltimeterShots:
    """Read a PEDR file, with its label or without.

    Parameters
    ----------
    path : Path
        Binary file, AP<orbit><version>.B.
    clock_bias : float
        s, added to the times of the shots (the footprints stay where the archive has them).
    version : str, optional
        Product version, a letter; from the file's name or label when absent. Shots of versions before L are turned
        from the IAU1991 to the IAU2000 frame.

    Returns
    -------
    AltimeterShots
        All shots with a radius, ground or not, in the file's order; a shot's name is orbit, frame in the file (from 1)
        and shot (1 .. 20).

    Raises
    ------
    InputError
        Where the file is missing, ends within a frame or before as many as its label counts, has no frame or records
        of another length, where a frame's clock, times, places or radii can't be, or where the version is not to be
        found.
    """
    return pedr_shots(read_bytes(path), path, clock_bias, version)


def pedr_shots(content: bytes, path: Path, clock_bias: float = 0.0, version: str | None = None) -> AltimeterShots:
    """As `read_pedr`, of the content of a file."""
    label = _label(content, path)
    frames = _frames(content, label, path)
    letter = pedr_version(path, label, version)
    shots = _shots(frames, label, clock_bias, path)
    return in_iau2000(shots) if letter < IAU2000_VERSION else shots


def pedr_version(path: Path, label: Block | None, version: str | None) -> str:
    """The version letter that the caller, the file's name or its label gives; InputError without one up to L."""
    names = [path.name] + ([label.text(key) for key in ("PRODUCT_ID", "FILE_NAME") if key in label] if label else [])
    letters = [hit[1] for name in names if (hit := re.fullmatch(r"ap\d{5}([a-z])\.\w+", name.strip(), re.IGNORECASE))]
    letter = (version if version is not None else (letters or [""])[0]).upper()
    if not re.fullmatch("[A-L]", letter):
        raise InputError(
            str(path), f"the product version {letter!r}" if letter else "no product version in its name or label",
            "a letter up to L, as in AP18933L.B: it says in which frame the coordinates are",
            "say which one it is: version = \"L\" for the final archive, which ODE serves, too",
        )
    return letter


def in_iau2000(shots: AltimeterShots) -> AltimeterShots:
    """Shots with IAU1991 coordinates, turned to IAU2000 exactly: x2000 = B2000(t) B1991(t)' x1991 at each shot's time.

    Elements: IAU/IAG reports of 1991 and 2000 (the latter as in pck00009.tpc); 0.2375 deg in longitude, 14 km.
    """
    days, centuries = shots.times / _DAY, shots.times / _CENTURY
    old = (317.681 - 0.108 * centuries, 52.886 - 0.061 * centuries, 176.868 + 350.8919830 * days)
    new = (317.68143 - 0.1061 * centuries, 52.88650 - 0.0609 * centuries, 176.630 + 350.89198226 * days)

    def turned(points: Array) -> Array:
        """B = R3(W) R1(90 - d0) R3(90 + a0), applied factor by factor: a day has 864,000 shots."""
        inertial = _about_z(_about_x(_about_z(points, -old[2]), old[1] - 90.0), -old[0] - 90.0)
        return _about_z(_about_x(_about_z(inertial, new[0] + 90.0), 90.0 - new[1]), new[2])

    return shots.moved(turned(shots.footprints), turned(shots.spacecraft))


def _about_z(points: Array, degrees: Array) -> Array:
    """Components of points (n, 3) in axes turned by angles (n,) about Z: the passive R3."""
    (x, y, z), sine, cosine = points.T, np.sin(degrees * DEG), np.cos(degrees * DEG)
    return np.column_stack([cosine * x + sine * y, cosine * y - sine * x, z])


def _about_x(points: Array, degrees: Array) -> Array:
    """Components of points (n, 3) in axes turned by angles (n,) about X: the passive R1."""
    return np.roll(_about_z(np.roll(points, -1, axis=1), degrees), 1, axis=1)


def _label(content: bytes, path: Path) -> Block | None:
    """The label before the frames, if there is one: a frame begins with seconds, whose first byte is no letter."""
    start = content[:8]
    if len(start) < 8 or not all(32 <= byte < 127 or byte in (9, 10, 13) for byte in start):
        return None
    return flat_label(content[: HEADER_RECORDS * FRAME.itemsize].decode("ascii", "replace"), f"{path}, label")


def _frames(content: bytes, label: Block | None, path: Path) -> NDArray[np.void]:
    size, header = FRAME.itemsize, 0
    if label is not None:
        length = label.count("RECORD_BYTES") if "RECORD_BYTES" in label else size
        require(length == size, label.where("RECORD_BYTES"), f"{length}", f"{size}", "is this a PEDR file?")
        header = size * (label.count("LABEL_RECORDS") if "LABEL_RECORDS" in label else HEADER_RECORDS)
    body = len(content) - header
    require(body >= 0, str(path), f"{len(content)} bytes", f"a label of {header} bytes and frames", "fetch it again")
    require(
        body % size == 0, str(path), f"{body} bytes of frames: {body // size} frames and {body % size} bytes more",
        f"frames of {size} bytes", "the file is cut short or its records have another length: fetch it again",
    )  # fmt: skip
    require(body != 0, str(path), "no frames", f"frames of {size} bytes after the label", "fetch it again")
    if label is not None:
        require_records(label, len(content) // size, header // size)
    frames = np.frombuffer(content, FRAME, offset=header)
    _require_sound(frames, path)
    return frames


def _require_sound(frames: NDArray[np.void], path: Path) -> None:
    """Values that show another record length or byte order before they show as footprints in the wrong place."""
    radii = frames["shot_radius"] * _CM
    used, second_times = np.any(radii > 0.0, axis=1), frames["time"]
    whole = frames["seconds"] + 1e-6 * frames["microseconds"]
    places = [
        (f", {what}", frames[field] * 1e-6, -most, most, "degrees")
        for name, most in (("latitude", 90.0), ("longitude", 360.0))
        for field, what in ((name, name), (f"spacecraft_{name}", f"spacecraft's {name}"))
    ]
    for what, values, least, most, unit in (
        (", radius", np.where(radii > 0.0, radii, _LEAST).min(axis=1), _LEAST, _LARGEST, "m"),
        (", radius", np.where(used, radii.max(axis=1), _LEAST), _LEAST, _LARGEST, "m"),
        (", difference of its two times", np.where(second_times != 0.0, whole - second_times, 0.0), -1e-3, 1e-3, "s"),
        (", clock", frames["clock"], _CLOCK * (1.0 - _CLOCK_TOLERANCE), _CLOCK * (1.0 + _CLOCK_TOLERANCE), "Hz"),
        *places,
    ):
        checked = used | (unit == "s")
        for i in np.flatnonzero(checked & ~((values >= least) & (values <= most)))[:1]:
            raise InputError(
                f"{path}, frame {i + 1}{what}", f"{values[i]:.9g} {unit}", f"{least:.9g} .. {most:.9g}",
                "the records have another length or byte order, or are damaged: fetch the file again",
            )


def _crossover(frames: NDArray[np.void]) -> tuple[Array, Array]:
    """Crossover corrections of the frames and how they change over a frame, m; both (n, 1).

    The first frame takes its change from the second one, as PEDR2TAB does.
    """
    value = frames["crossover"] * _CM
    change = np.diff(value, prepend=value[:1])
    if value.size > 1:
        change[0] = change[1]
    return value[:, None], change[:, None]


def _shots(frames: NDArray[np.void], label: Block | None, clock_bias: float, path: Path) -> AltimeterShots:
    """Shots with a radius, read from some frames at a time: an archive's file is many times larger in float64."""
    software, corrections = _software(label), _crossover(frames)
    parts = [
        _columns(frames[k : k + _FRAMES], k, software, [column[k : k + _FRAMES] for column in corrections], clock_bias)
        for k in range(0, frames.size, _FRAMES)
    ]
    if not any(part["times"].size for part in parts):
        raise InputError(str(path), f"{frames.size} frames without a single shot", "shots with a radius")
    names = tuple(parts[0])
    fields: dict[str, Any] = {name: read_only(np.concatenate([part.pop(name) for part in parts])) for name in names}
    return AltimeterShots(source=str(path), **fields)


def _columns(
    frames: NDArray[np.void], before: int, software: float | None, crossover: Sequence[Array], clock_bias: float
) -> dict[str, NDArray[Any]]:
    """Fields of AltimeterShots; `before` is the number of frames before these in their file."""
    x = (np.arange(1, SHOTS + 1) - 0.5 * (SHOTS + 1)) / SHOTS

    def field(name: str, scale: float = 1.0) -> Array:
        return np.asarray(frames[name][:, None] * scale)

    def across(name: str, scale: float) -> Array:
        return field(name, scale) + x * field(f"d_{name}", scale)

    raw = frames["shot_radius"] * _CM
    lift = raw - field("midpoint_radius", _CM)
    corrected = raw
    if software is None or software >= _FIRST_CROSSOVERS:
        value, change = crossover
        corrected = raw - value - x * change
    else:  # parallax came with the orbits of gravity model 2, in old software of model 3 (PEDR2TAB)
        lift = np.where(field("orbit_model") >= (3 if software <= 7.0 else 2), lift, 0.0)
    longitude = across("longitude", _MICRODEG) + field("parallax_longitude", 1e-3 * _MICRODEG) * lift
    latitude = across("latitude", _MICRODEG) + field("parallax_latitude", 1e-3 * _MICRODEG) * lift
    spacecraft = [across(f"spacecraft_{name}", _MICRODEG) for name in ("longitude", "latitude")]
    tick = 1e7 / np.where(frames["clock"] > 0, frames["clock"], np.nan)[:, None]  # s, a tenth by the altimeter's clock
    times = field("seconds") + field("microseconds", 1e-6) + x * SHOTS * tick + clock_bias
    has_radius = (raw > 0.0).ravel()

    def flat(values: Array) -> Array:
        return np.broadcast_to(values, raw.shape).ravel()[has_radius]

    def placed(values: Array) -> Array:
        return from_planetocentric(values).reshape(-1, 3)[has_radius]

    def whole(values: NDArray[np.integer]) -> Index:
        return np.broadcast_to(values, raw.shape).ravel()[has_radius].astype(np.int64)

    ground = frames["shot_class"] == 1
    ranges, pulses = frames["range"] * _CM, frames["sigma_optical"] * _PULSE
    return {
        "orbits": whole(frames["orbit"][:, None]),
        "frames": whole(np.arange(before + 1, before + frames.size + 1)[:, None]),
        "shots": whole(np.arange(1, SHOTS + 1)[None, :]),
        "times": flat(times),
        "footprints": placed(np.stack([longitude, latitude, corrected], axis=-1)),
        "areoid_radii": flat(across("areoid_radius", _CM)),
        "ranges": flat(known_ranges(ranges, ground)),
        "range_corrections": flat(frames["range_correction"] * _CM),
        "spacecraft": placed(np.stack([*spacecraft, across("spacecraft_radius", _CM)], axis=-1)),
        "off_nadir": flat(field("off_nadir", _MICRODEG)),
        "ground": ground.ravel()[has_radius],
        "channels": whole(frames["channel"]),
        "clocks": flat(field("clock")),
        "pulses": flat(np.where(pulses > 0.0, pulses, np.nan)),
    }


def _software(label: Block | None) -> float | None:
    """Version of the software that wrote the file; None where the label doesn't say, and it is taken for a late one."""
    text = label.text("SOFTWARE_NAME") if label is not None and "SOFTWARE_NAME" in label else ""
    numbers = re.findall(r"\d+\.\d+", text)
    return float(numbers[-1]) if numbers else None


SPOTS = 5
"""Spots of a shot."""
INVALID = 0xFF
"""Bits of a spot's flag, all of which are zero for a return from the ground."""
_SPOT = np.dtype([
    ("longitude", "<i4"),  # 1e-7 deg, east
    ("latitude", "<i4"),  # 1e-7 deg
    ("radius", "<i4"),  # mm; -1 for none
    ("range", "<u4"),  # mm, one-way
    ("pulse_width", "<i4"),  # ps
    ("energy", "<u4"),  # zJ
    ("noise", "<u4"),  # counts
    ("threshold", "<u4"),
    ("gain", "<u4"),
    ("flag", "<u4"),
])
RECORD: np.dtype[np.void] = np.dtype([
    ("met_seconds", "<i4"),  # mission elapsed time
    ("met_fraction", "<u4"),  # 2^-32 s
    ("seconds", "<u4"),  # terrestrial time past J2000, at which the laser fired
    ("fraction", "<u4"),  # 2^-32 s
    ("laser_energy", "<i4"),  # nJ
    ("transmit_width", "<i4"),  # ps
    ("spacecraft_longitude", "<i4"),  # 1e-7 deg
    ("spacecraft_latitude", "<i4"),
    ("spacecraft_radius", "<u4"),  # mm
    ("selenoid_radius", "<u4"),  # mm, of the geoid under the spacecraft
    ("spots", _SPOT, (SPOTS,)),
    ("off_nadir", "<u2"),  # 5e-5 rad, as are the next three
    ("emission", "<u2"),
    ("incidence", "<u2"),
    ("phase", "<u2"),
    ("earth_range", "<u4"),
    ("earth_pulse_width", "<u2"),
    ("earth_energy", "<u2"),
])
"""One record as it lies in the file."""
_SELENOID = (1.72e9, 1.755e9)
"""mm, between which the radius of the geoid lies."""
_YEARS = (2.8e8, 1.6e9)
"""s past J2000: LRO's mission begins in 2009, and doesn't last until 2050."""
_NO_RADIUS = -1
_NONE = 2**32 - 1
"""Of an unsigned number that is not known."""
_MM, _ANGLE, _OFF_NADIR = 1e-3, 1e-7, 5e-5
"""m, degrees and rad of the records' units."""


def is_lola_rdr(content: bytes) -> bool:
    """Whether a file's records are those of LOLA: the radius of the Moon's geoid is where the format has it."""
    whole = len(content) // RECORD.itemsize * RECORD.itemsize
    radii = np.frombuffer(content[:whole], RECORD)["selenoid_radius"]
    stated = radii[radii != _NONE][:64]
    return bool(stated.size and np.all((stated > _SELENOID[0]) & (stated < _SELENOID[1])))


def lola_shots(content: bytes, path: Path, clock_bias: float = 0.0) -> AltimeterShots:
    """Spots with a radius, record by record; a spot's name is its crossing, record (from 1) and number (1 .. 5).

    InputError where the file ends within a record, has no such spot, or where the time of a return from the ground
    can't be.
    """
    whole, rest = divmod(len(content), RECORD.itemsize)
    require(
        not rest, str(path), f"{whole} records and {rest} bytes more", f"records of {RECORD.itemsize} bytes",
        "the file is cut short: fetch it again",
    )  # fmt: skip
    records = np.frombuffer(content, RECORD)
    ground = (records["spots"]["radius"] != _NO_RADIUS) & (records["spots"]["flag"] & INVALID == 0)
    outside = (records["seconds"] < _YEARS[0]) | (records["seconds"] > _YEARS[1])
    for k in np.flatnonzero(outside & ground.any(axis=1))[:1]:
        found = f"a time of {records['seconds'][k]} s past J2000"
        raise InputError(f"{path}, record {k + 1}", found, f"{_YEARS[0]:.0f} .. {_YEARS[1]:.0f} s")
    chosen = np.flatnonzero((records["spots"]["radius"] != _NO_RADIUS) & ~outside[:, None])
    if not chosen.size:
        found = f"{ground.size} shots, none of which reached the ground"
        raise InputError(str(path), found, "ground returns")
    return _lola_spots(records, chosen, ground.ravel()[chosen], path, clock_bias)


def _lola_spots(
    records: NDArray[np.void], chosen: Index, ground: Mask, path: Path, clock_bias: float
) -> AltimeterShots:
    """The spots whose numbers, record by record, are `chosen`."""
    spots, owners = records["spots"].ravel()[chosen], records[chosen // SPOTS]
    record, spot = chosen // SPOTS + 1, chosen % SPOTS + 1
    times = tdb_of_tt(owners["seconds"] + owners["fraction"] * 2.0**-32)
    def known(values: NDArray[np.unsignedinteger]) -> Array:
        return np.where((values != _NONE) & (values > 0), values * _MM, np.nan)

    return shots_with(
        str(path), LOLA, times + clock_bias, positions(
            np.column_stack([spots["longitude"], spots["latitude"]]) * _ANGLE, spots["radius"] * _MM,
            lambda k: f"{path}, record {record[k]}, spot {spot[k]}",
        ),
        orbits=crossings(times, str(path)), frames=record, shots=spot, areoid_radii=known(owners["selenoid_radius"]),
        ranges=known(spots["range"]), off_nadir=owners["off_nadir"] * _OFF_NADIR, ground=ground,
        spacecraft=from_planetocentric(np.column_stack([
            owners["spacecraft_longitude"] * _ANGLE * DEG, owners["spacecraft_latitude"] * _ANGLE * DEG,
            known(owners["spacecraft_radius"]),
        ])),
    )  # fmt: skip

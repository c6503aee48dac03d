"""MOLA's files: laser shots as a Precision Experiment Data Record (PEDR), grids as gridded records (MEGDR).

A PEDR is a label of ten records, then frames. A frame keeps 20 shots' ranges and radii one by one, but their longitudes
and latitudes as a midpoint, a change over the frame and the parallax: how far a footprint moves with the shot's radius,
which follows from the line of sight. So what is read back differs from what was given:

* ranges and radii by the rounding to 1 cm;
* longitudes and latitudes by the rounding to 1e-6 deg (3 cm, in each of midpoint and change) and by whatever in them
  isn't linear over the two seconds of a frame: the track's curvature, below 1 m; noise of single footprints is lost;
* areoid radii and the spacecraft's position likewise (the orbit's curvature over a frame: below 1 m);
* times by half a microsecond, and by the clock's rounding to 1 Hz (1e-8 s).

Fields about the instrument that no reader takes are zero. `write_pedr` returns the shots as written.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mgsgraph.errors import InputError, require
from mgsgraph.files.altimetry.binary import FRAME, HEADER_RECORDS, SHOTS, read_pedr
from mgsgraph.files.writing import writing_to
from mgsgraph.geometry.altimetry import AltimeterShots
from mgsgraph.geometry.body import in_turn, planetocentric
from mgsgraph.geometry.records import Array, Index, Mask, assign, frozen
from mgsgraph.record import Record
from mgsgraph.simulation.sites import template
from mgsgraph.units import DEG, SPEED_OF_LIGHT

WRITABLE = "a folder that may be written"
"""What is expected where a file of a simulation can't be written."""
_CM, _MICRODEG = 1e-2, 1e-6 * DEG
_TICK = 0.1
"""s between shots."""
_FRACTION = (np.arange(1, SHOTS + 1) - 0.5 * (SHOTS + 1)) / SHOTS
"""Time of each shot in units of the frame's length, from its midpoint."""
_PACKET = 7
"""Frames in a packet."""
_LEVEL_PULSE = 8.0
"""ns, standard deviation of a pulse from level ground."""
_LIGHT = SPEED_OF_LIGHT * 1e-9
"""m/ns."""


@dataclass(frozen=True, slots=True, eq=False)
class PedrFrames(Record):
    """Shots at 10 Hz without a gap; every 20 become a frame, the last one is filled up with missing shots."""

    orbit: int
    """Number of the orbit."""
    times: Array
    """(n,) s TDB past J2000, of the shots."""
    footprints: Array
    """(n, 3) m, body-fixed (IAU2000), after crossover correction."""
    ranges: Array
    """(n,) m, one-way; zero for a shot without return."""
    areoid_radii: Array
    """(n,) m, of the areoid at the footprints."""
    spacecraft: Array
    """(n, 3) m, body-fixed."""
    off_nadir: Array
    """(n,) rad, angle of the line of sight from nadir."""
    ground: Mask
    """(n,) whether the shot came back from the ground, not from a cloud or noise."""
    spread: Array
    """(n,) m, standard deviation of the ranges within each shot's spot, which widens the pulse."""
    crossovers: Array | None = None
    """(frames,) m, crossover correction of each frame, to cm: the archived radius is so much larger than the corrected
    one. When absent, 0.30 m and 1 cm more in each frame, so that readers have something to take off."""

    def __post_init__(self) -> None:
        late = np.abs(self.times - self.times[0] - _TICK * np.arange(self.times.size))
        if late.max() > 1e-5:
            k = int(np.argmax(late > 1e-5))
            raise InputError("PEDR frames, times", f"shot {k} is {late[k]:.6f} s off", "10 shots a second with no gap")
        frames = -(-self.times.size // SHOTS)
        crossovers: ArrayLike = 0.30 + 0.01 * np.arange(frames) if self.crossovers is None else self.crossovers
        assign(self, crossovers=frozen(crossovers, "PEDR frames, crossovers", (frames,)))


def write_pedr(path: Path, frames: PedrFrames, product_label: Mapping[str, str] | None = None) -> AltimeterShots:
    """Write a PEDR file of version L (IAU2000); the same arguments give the same bytes.

    Parameters
    ----------
    path : Path
        File that is written, or replaced: ``ap<orbit><version>.b``, as ap18933l.b.
    frames : PedrFrames
        The shots.
    product_label : mapping, optional
        Further keywords of the label with their values as they stand there, such as ``{"START_TIME": "2001-03-08"}``.

    Returns
    -------
    AltimeterShots
        The shots as written: what reading the file gives.

    Raises
    ------
    InputError
        If a value doesn't fit its field, the label its ten records, or the file can't be written.
    """
    records = _records(frames)
    label = _label(path, frames, records.size, product_label or {})
    with writing_to(path, WRITABLE):
        path.write_bytes(label + records.tobytes())
    return read_pedr(path)


def _label(path: Path, frames: PedrFrames, count: int, more: Mapping[str, str]) -> bytes:
    """Label of the first ten records. PEDR2TAB looks for the software's version in its first record, 25 characters
    after the keyword's first: 7.125 or more means that there are crossover corrections.
    """
    text = template("pedr.lbl").format(
        records=count + HEADER_RECORDS, bytes=FRAME.itemsize, label_records=HEADER_RECORDS, name=path.name.upper(),
        table=HEADER_RECORDS + 1, orbit=frames.orbit, rows=count,
        more="".join(f"{key} = {value}\n" for key, value in more.items()),
    ).replace("\n", "\r\n")  # fmt: skip
    size = HEADER_RECORDS * FRAME.itemsize
    require(text.isascii() and len(text) <= size, f"{path}, label", f"{len(text)} characters", f"at most {size}, ASCII")
    return text.encode("ascii").ljust(size)


def _records(frames: PedrFrames) -> NDArray[np.void]:
    """Frames as they lie in the file."""
    footprints, spacecraft = (
        [_by_frame(column) for column in (np.unwrap(longitude), latitude, radius)]
        for longitude, latitude, radius in (planetocentric(xyz).T for xyz in (frames.footprints, frames.spacecraft))
    )
    present = _by_frame(np.ones(frames.times.size)) > 0.0
    count = np.sum(present, axis=1)
    records = np.zeros(present.shape[0], FRAME)
    records["orbit"], records["channel"], records["orbit_model"] = frames.orbit, 1, 7  # from 3 on with parallax
    records["frame_index"] = np.arange(records.size) % _PACKET + 1
    records["shot_class"] = _by_frame(frames.ground.astype(np.float64))
    _set_times(records, frames.times)

    assert frames.crossovers is not None
    crossover = np.rint(frames.crossovers / _CM)
    change = np.diff(crossover, prepend=crossover[:1])
    change[:1] = change[1:2] if change.size > 1 else 0.0  # as PEDR2TAB: the first frame takes the second one's
    records["crossover"] = _whole(crossover, "crossover")
    raw = np.where(present, footprints[2] / _CM + crossover[:, None] + _FRACTION * change[:, None], 0.0)
    records["shot_radius"] = _whole(raw, "shot_radius")
    records["midpoint_radius"] = _whole(raw.sum(axis=1) / count, "midpoint_radius")
    lift = (records["shot_radius"].astype(np.float64) - records["midpoint_radius"][:, None]) * _CM

    parallax = np.rint(_parallax(frames, count) / (1e-3 * _MICRODEG))
    for k, (name, values) in enumerate((("longitude", footprints[0]), ("latitude", footprints[1]))):
        records[f"parallax_{name}"] = parallax[:, k]
        straight = values - parallax[:, k, None] * (1e-3 * _MICRODEG) * lift
        _set_line(records, name, straight, present, _MICRODEG)
    for name, values, unit in (
        ("spacecraft_longitude", spacecraft[0], _MICRODEG),
        ("spacecraft_latitude", spacecraft[1], _MICRODEG),
        ("spacecraft_radius", spacecraft[2], _CM),
        ("areoid_radius", _by_frame(frames.areoid_radii), _CM),
    ):
        _set_line(records, name, values, present, unit)

    records["range"] = _whole(_by_frame(frames.ranges) / _CM, "range")
    pulse = np.hypot(_LEVEL_PULSE, 2.0 * _by_frame(frames.spread) / _LIGHT)
    records["sigma_optical"] = _whole(10.0 * pulse, "sigma_optical")
    off_nadir = _by_frame(frames.off_nadir).sum(axis=1) / count
    records["off_nadir"] = _whole(off_nadir / _MICRODEG, "off_nadir")
    return records


def _by_frame(values: ArrayLike) -> Array:
    """(frames, 20) of values (n,), zero where the last frame has no shots."""
    given = np.asarray(values, dtype=np.float64)
    padded = np.zeros(-(-given.size // SHOTS) * SHOTS)
    padded[: given.size] = given
    return padded.reshape(-1, SHOTS)


def _set_times(records: NDArray[np.void], times: Array) -> None:
    """Midpoints to the microsecond, twice, and the clock that makes the ticks between shots."""
    tick = float(times[-1] - times[0]) / (times.size - 1) if times.size > 1 else _TICK
    middle = times[0] + tick * (SHOTS * np.arange(records.size) + 0.5 * (SHOTS - 1))
    seconds = np.floor(middle)
    microseconds = np.rint((middle - seconds) * 1e6)
    seconds, microseconds = seconds + microseconds // 1e6, microseconds % 1e6
    records["seconds"], records["microseconds"] = seconds, microseconds
    records["time"] = seconds + 1e-6 * microseconds
    records["clock"] = round(1e7 / tick)


def _parallax(frames: PedrFrames, count: Index) -> Array:
    """How longitude and latitude of a footprint move with its radius along the line of sight: (frames, 2) in rad/m, at
    the middle shot of each frame.
    """
    middle = SHOTS * np.arange(count.size) + (count - 1) // 2
    foot = frames.footprints[middle]
    look = frames.spacecraft[middle] - foot
    step = 100.0 * look / np.linalg.norm(look, axis=1, keepdims=True)
    above, below = planetocentric(foot + step), planetocentric(foot - step)
    turned = in_turn(above[:, :2] - below[:, :2])
    return np.asarray(turned / (above[:, 2:] - below[:, 2:]))


def _set_line(records: NDArray[np.void], name: str, values: Array, present: Mask, unit: float) -> None:
    """Midpoint and change over the frame of the straight line nearest to values (frames, 20)."""
    design = np.stack([np.ones_like(values), np.broadcast_to(_FRACTION, values.shape)], axis=-1) * present[:, :, None]
    reference = values[:, :1]  # the shots' common part first: a radius would cost the change its digits
    away = np.where(present, values - reference, 0.0)
    middle, change = np.einsum("fpk,fk->pf", np.linalg.pinv(design), away)
    middle = (middle + reference[:, 0]) / unit
    if name.endswith("longitude"):
        middle = np.remainder(middle, 360e6)
    records[name], records[f"d_{name}"] = _whole(middle, name), _whole(change / unit, f"d_{name}")


def _whole(values: Array, name: str) -> Index:
    """Whole numbers nearest to values in the file's unit, which must fit the field."""
    whole = np.rint(values).astype(np.int64)
    limits = np.iinfo(FRAME[name].base)
    for value in (whole.min(), whole.max()):
        if not limits.min <= value <= limits.max:
            raise InputError(f"PEDR frames, {name}", f"{value} in the file's unit", f"{limits.min} .. {limits.max}")
    return whole


# --- MEGDR


@dataclass(frozen=True, slots=True)
class MegdrLayout:
    """Positions of a grid's posts, and the offset subtracted from them."""

    shape: tuple[int, ...]
    """rows southward, columns eastward."""
    first_longitude: float
    """rad, east, of the first post."""
    first_latitude: float
    """rad, planetocentric."""
    step: float
    """rad, between posts in both directions."""
    offset: float
    """m, taken off before the posts are stored."""


def write_megdr(folder: Path, name: str, layout: MegdrLayout, posts: Iterable[Array]) -> None:
    """Write ``name.img`` and ``name.lbl`` to a folder that exists, or replace them: ``megr...`` for radii of the
    planet, ``megt...`` for topography, ``megc...`` for shots in each cell. `posts` (m, or numbers) are the grid's rows
    from the north, some at a time.
    """
    with (folder / f"{name}.img").open("wb") as file:
        for rows in posts:
            file.write(np.rint(rows - layout.offset).astype(">i2").tobytes())
    (folder / f"{name}.lbl").write_text(_megdr_label(name, layout), encoding="ascii", newline="\r\n")


def _megdr_label(name: str, layout: MegdrLayout) -> str:
    """LINE = LPO - RES (LAT - CLAT), SAMPLE = SPO + RES (LON - CLON) (dsmap.cat)."""
    rows, columns = layout.shape
    resolution = round(DEG / layout.step)
    return template("megdr.lbl").format(
        record=2 * columns, rows=rows, columns=columns, name=name.upper(), offset=layout.offset,
        resolution=resolution, line_offset=1.0 + layout.first_latitude / layout.step,
        sample_offset=1.0 - (layout.first_longitude / DEG - 180.0) * resolution,
    )  # fmt: skip

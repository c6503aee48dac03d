"""SPICE kernels of a simulated site: the same kinds, ids and keywords as the archive's, with a made-up trajectory.

Binary kernels are written by CSPICE, text kernels here. The CK keeps the archive's time tags: what is meant for the
time t is stored at t - 1.15 s (`sites.ARCHIVE_ATTITUDE_BIAS`). Nothing in the files depends on date or place.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path

import numpy as np
import spiceypy

from mgsgraph.geometry.records import Array
from mgsgraph.geometry.trajectory import Trajectory
from mgsgraph.simulation.camera import BORESIGHT_SAMPLE, FOCAL_LENGTH_MM, PITCH_MM
from mgsgraph.simulation.orbit import MARS, MERIDIAN, MOUNT_ANGLES, POLE_DEC, POLE_RA, mars_about_sun
from mgsgraph.simulation.sites import ARCHIVE_ATTITUDE_BIAS, template
from mgsgraph.units import KM

SPACECRAFT, STRUCTURE, CAMERA, MARS_ID, MARS_SYSTEM, SUN, ORIGIN = -94, -94000, -94031, 499, 4, 10, 0
"""NAIF ids: MGS, its structure (CK), MOC-NA, Mars, its barycentre, the Sun, the solar system's barycentre."""

_DEGREE = 7
"""Of the Hermite interpolation (SPK type 13)."""
_POSITION_STEP = 5
"""Every fifth record of the trajectory goes into the SPK: CSPICE interpolates to 1e-6 m between them."""
_DAY = 86400.0
_TICKS = 256
"""Ticks of the clock per second."""
_PARTITION = (136_111_334_400.0, 1_099_511_627_775.0)
"""Ticks at which the clock's partition begins and ends; as in the archive, so that counts look like MGS's."""
_CLOCK_ZERO, _CLOCK_RATE = -99_510_250.0, 0.99999986
"""s TDT past J2000 when the partition begins, and s per second of the clock: this clock's own."""
_TDT_TO_TAI, _LEAP_SECONDS = 32.184, 32
"""s, TDT - TAI; s, TAI - UTC in 2001."""
_K, _EB, _M0, _M1 = 1.657e-3, 1.671e-2, 6.239996, 1.99096871e-7
"""TDB - TDT = K sin(E), E = M + EB sin(M), M = M0 + M1 t (SPICE leap seconds kernel)."""


CAMERA_FRAME_TEXT = template("moc_frame.ti").format(angles=" ".join(repr(angle) for angle in MOUNT_ANGLES))
"""The camera's frame, as instrument kernels have it."""


@dataclass(frozen=True, slots=True, eq=False)
class KernelSegment:
    """One image's share of the SPK and the CK."""

    name: str
    """Of the image; goes into the segment identifiers."""
    phase: str
    """Kernels are named after it; segments of one phase share an SPK and a CK."""
    trajectory: Trajectory
    """What they are to say: nominal, archive's time tags undone."""


def ephemeris_time(utc: str) -> float:
    """Seconds TDB past J2000 of a UTC time (ISO) of the year 2001, as SPICE's `utc2et` gives."""
    since = datetime.fromisoformat(utc) - datetime(2000, 1, 1, 12)
    return _tdb(since.total_seconds() + _LEAP_SECONDS + _TDT_TO_TAI)


def clock_count(time: float) -> tuple[str, float]:
    """Spacecraft clock count nearest to a time (s TDB past J2000), as labels write it, and the time it stands for."""
    tdt = time
    for _ in range(3):
        tdt = time - (_tdb(tdt) - tdt)
    ticks = round((tdt - _CLOCK_ZERO) / _CLOCK_RATE * _TICKS)
    count, fraction = divmod(int(_PARTITION[0]) + ticks, _TICKS)
    return f"{count}:{fraction}", _tdb(_CLOCK_ZERO + ticks / _TICKS * _CLOCK_RATE)


def write_kernels(segments: Sequence[KernelSegment], folder: Path) -> tuple[str, ...]:
    """Write all kernels that the images need to a folder that exists; existing files of these names are replaced. No
    two segments of one phase are at the same time.

    Returns the file names in the order in which they are to be loaded. `mgs.tm` lists them too, for use in that folder.
    """
    texts = {
        "mgs.tls": template("mgs.tls"),
        "mgs.tsc": template("mgs.tsc").format(
            ticks=_TICKS, begin=_PARTITION[0], end=_PARTITION[1], zero=_CLOCK_ZERO, rate=_CLOCK_RATE
        ),
        "mars.tpc": template("mars.tpc").format(
            ascension=POLE_RA, declination=POLE_DEC, meridian=MERIDIAN, equatorial=MARS.equatorial / KM,
            polar=MARS.polar / KM,
        ),
        "mgs.tf": template("mgs.tf"),
        "moc.ti": addendum_text(),
    }  # fmt: skip
    for name, text in texts.items():
        (folder / name).write_text(text, encoding="ascii", newline="\n")
    names = [*texts, "mars.bsp"]
    epochs = [segment.trajectory.epoch for segment in segments]
    _write_planet(folder / "mars.bsp", min(epochs), max(epochs))
    with spiceypy.KernelPool([str(folder / "mgs.tls"), str(folder / "mgs.tsc")]):
        for phase in dict.fromkeys(segment.phase for segment in segments):
            members = sorted((s for s in segments if s.phase == phase), key=lambda s: s.trajectory.epoch)
            _write_positions(folder / f"mgs_{phase}.bsp", members)
            _write_attitudes(folder / f"mgs_sc_{phase}.bc", members)
            names += [f"mgs_{phase}.bsp", f"mgs_sc_{phase}.bc"]
    listed = template("mgs.tm").format(listed="\n".join(f"  '{name}'" for name in names))
    (folder / "mgs.tm").write_text(listed, encoding="ascii", newline="\n")
    return tuple(names)


def _tdb(tdt: float) -> float:
    """TDB of TDT, both in s past J2000 (SPICE `unitim`)."""
    mean = _M0 + _M1 * tdt
    return float(tdt + _K * np.sin(mean + _EB * np.sin(mean)))


def _write_planet(path: Path, first: float, last: float) -> None:
    """Mars about the Sun, the Sun at rest at the barycentre: enough for aberration and for the light."""
    times = np.arange(np.floor(first / _DAY) - 2.0, np.ceil(last / _DAY) + 2.5, 0.5) * _DAY
    position, velocity = mars_about_sun(times)
    rest = np.zeros((times.size, 6))
    path.unlink(missing_ok=True)
    handle = spiceypy.spkopn(str(path), "SIMULATED MARS AND SUN", 0)
    moving = np.hstack([position, velocity]) / KM
    bodies = ((SUN, ORIGIN, rest), (MARS_SYSTEM, SUN, moving), (MARS_ID, MARS_SYSTEM, rest))
    for body, centre, states in bodies:
        _add_states(handle, body, centre, "SIMULATED", times, states)
    spiceypy.spkcls(handle)


def _write_positions(path: Path, segments: Sequence[KernelSegment]) -> None:
    path.unlink(missing_ok=True)
    handle = spiceypy.spkopn(str(path), "SIMULATED MGS SPK", 0)
    for segment in segments:
        table = segment.trajectory.position
        chosen = np.unique([*range(0, table.times.size, _POSITION_STEP), table.times.size - 1])
        states = np.hstack([table.positions, table.velocities])[chosen] / KM
        times = segment.trajectory.epoch + table.times[chosen]
        _add_states(handle, SPACECRAFT, MARS_ID, f"SIMULATED {segment.name}", times, states)
    spiceypy.spkcls(handle)


def _add_states(handle: int, body: int, centre: int, name: str, times: Array, states: Array) -> None:
    """One SPK segment; states (n, 6) in km and km/s."""
    first, last = float(times[0]), float(times[-1])
    spiceypy.spkw13(handle, body, centre, "J2000", first, last, name, _DEGREE, times.size, states, times)


def _write_attitudes(path: Path, segments: Sequence[KernelSegment]) -> None:
    """CK of type 3 with angular velocities; needs the clock and leap seconds in the pool."""
    path.unlink(missing_ok=True)
    handle = spiceypy.ckopn(str(path), "SIMULATED MGS CK", 0)
    for segment in segments:
        table = segment.trajectory.camera
        tags = segment.trajectory.epoch + table.times + ARCHIVE_ATTITUDE_BIAS
        ticks = np.array([spiceypy.sce2c(SPACECRAFT, float(tag)) for tag in tags])
        spiceypy.ckw03(
            handle, ticks[0], ticks[-1], STRUCTURE, "J2000", True, f"SIMULATED {segment.name}", ticks.size,
            ticks, table.quaternions.copy(), _angular_velocities(segment.trajectory), 1, ticks[:1],
        )
    spiceypy.ckcls(handle)


def _angular_velocities(trajectory: Trajectory) -> Array:
    """(n, 3) rad/s, inertial, of the spacecraft at the records: the mean of the turns before and after."""
    times = trajectory.camera.times
    matrices, angular_rate = trajectory.camera.at(0.5 * (times[1:] + times[:-1]))
    inertial = np.einsum("nji,nj->ni", matrices, angular_rate)
    return np.asarray(0.5 * (np.vstack([inertial[:1], inertial]) + np.vstack([inertial, inertial[-1:]])))


def addendum_text() -> str:
    """The camera in the words of ISIS's addendum (mocAddendum004.ti): millimetres."""
    return template("moc.ti").format(
        bias=ARCHIVE_ATTITUDE_BIAS, focal_length=FOCAL_LENGTH_MM, pitch=PITCH_MM, scale=1.0 / PITCH_MM,
        boresight=BORESIGHT_SAMPLE, frame=CAMERA_FRAME_TEXT,
    )  # fmt: skip

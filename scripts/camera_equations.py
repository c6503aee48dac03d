"""An image by the equations of ISIS's camera models over SPICE's own answers, and its support data in ALE's layout.

SPICE and NumPy alone: nothing of mgsgraph stands in this file. Time of the line, pose at that time, place in the focal
plane, look vector, ellipsoid; tables sampled at the edges of lines.
"""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import spiceypy as spice

LIGHT = 299792.458
"""km/s."""
Vector = np.ndarray
Undistort = Callable[[float, float], tuple[float, float]]


@dataclass(frozen=True)
class Optics:
    """A camera by ISIS's conventions: mm, the centre of the detector's first pixel is 1."""

    focal: float
    lines: Vector
    """ITRANSL."""
    samples: Vector
    """ITRANSS."""
    origin: tuple[float, float]
    """Line, sample."""
    undistort: Undistort = lambda x, y: (x, y)
    model: dict[str, Any] = field(default_factory=dict)
    """The same distortion as support data have it."""
    first: float = 1.0
    summing: float = 1.0
    offset: float = 0.0
    """Detector lines."""

    def look(self, sample: float) -> Vector:
        """ISIS CameraDetectorMap, CameraFocalPlaneMap, and then the distortion; the first sample's centre is 0.5."""
        pixel = (sample - 0.5) * self.summing + self.first + 0.5 * (self.summing - 1.0)
        place = np.array([self.offset - self.origin[0] - self.lines[0], pixel - self.origin[1] - self.samples[0]])
        x, y = np.linalg.solve(np.stack([self.lines[1:], self.samples[1:]]), place)
        return np.array([*self.undistort(x, y), self.focal])


class Variant(NamedTuple):
    """Support data as another program writes them."""

    name: str
    keywords: dict[str, Any]
    """naif_keywords that differ."""
    edit: Callable[[dict[str, Any]], None] = lambda isd: None
    """The known difference."""
    why: str = ""


@dataclass(frozen=True)
class Scene:
    """An image: its optics, lines, frames and bodies."""

    camera: str
    name: str
    optics: Optics
    size: tuple[int, int]
    """Lines, samples."""
    rates: Sequence[tuple[float, float, float]]
    """Lines read before, s TDB past J2000, s per line."""
    spacecraft: str
    code: int
    """The instrument's."""
    frames: tuple[str, str]
    """The frame of the C-kernels, and the camera's."""
    body: str
    fixed: str
    platform: str = ""
    sensor: str = ""
    bias: float = 0.0
    """s, of the time at which the attitude is looked up."""
    label: Path | None = None
    kernels: Sequence[Path] = ()
    line_times: Path | None = None
    why: str = ""
    margin: float = 0.0
    """s by which the tables of support data begin earlier and end later."""
    variants: Sequence["Variant"] = ()

    def time(self, line: float) -> float:
        """s TDB past J2000 at which a line's top edge is read."""
        first, start, period = [rate for rate in self.rates if rate[0] <= line][-1]
        return start + (line - first) * period

    def turn(self, time: float, frame: str) -> Vector:
        """J2000 to a frame of the camera."""
        return np.array(spice.pxform("J2000", frame, time + self.bias))

    def state(self, time: float) -> Vector:
        """km, km/s, geometric, J2000, about the body's centre."""
        return np.array(spice.spkezr(self.spacecraft, time, "J2000", "NONE", self.body)[0])

    def body_turn(self, time: float) -> Vector:
        """J2000 to the body's axes."""
        return np.array(spice.pxform("J2000", self.fixed, time))

    def sun(self, time: float) -> Vector:
        """km, km/s, of the Sun about the body, as ALE has it."""
        return np.array(spice.spkezr("SUN", time, "J2000", "LT+S", self.body)[0])

    def radii(self) -> Vector:
        """km."""
        return pool(f"BODY{spice.bods2c(self.body)}_RADII")

    def ground(self, line: float, sample: float) -> Vector:
        """m, body-fixed, by the equations."""
        time = self.time(line)
        turn = self.body_turn(time)
        place, ray = turn @ self.state(time)[:3], turn @ self.turn(time, self.frames[1]).T @ self.optics.look(sample)
        return np.array(spice.surfpt(place, ray, *self.radii())) * 1e3

    def rotation(self, times: Vector, frame: str, bias: float = 0.0) -> dict[str, Any]:
        """A table of quaternions and angular velocities, as ALE has it."""
        turns = [spice.xf2rav(spice.sxform("J2000", frame, time + bias)) for time in times]
        return {
            "reference_frame": 1, "ephemeris_times": times.tolist(),
            "quaternions": [spice.m2q(turn).tolist() for turn, _ in turns],
            "angular_velocities": [np.asarray(rate).tolist() for _, rate in turns],
        }  # fmt: skip

    def pointing(self, times: Vector) -> dict[str, Any]:
        """The camera's table."""
        mount = spice.pxform(*self.frames, self.rates[0][1])
        table = self.rotation(times, self.frames[0], self.bias) | {"constant_rotation": mount.ravel().tolist()}
        return table | {"time_dependent_frames": [spice.namfrm(self.frames[0]), 1],
                       "constant_frames": [spice.namfrm(frame) for frame in self.frames[::-1]]}  # fmt: skip

    def spinning(self, times: Vector) -> dict[str, Any]:
        """The body's table."""
        return self.rotation(times, self.fixed)

    def places(self, times: Vector, keywords: dict[str, Any]) -> Vector:
        """States (n, 6), corrected for aberration as keywords ask and as ALE does (base/data_naif.py)."""
        words = {key.split("_", 1)[1]: value for key, value in keywords.items() if key.startswith(f"INS{self.code}_")}
        swapped = str(words.get("SWAP_OBSERVER_TARGET", "FALSE")).upper() == "TRUE"
        if words.get("LIGHTTIME_CORRECTION", "LT+S") == "NONE":
            return np.array([self.state(time) for time in times])
        target, observer = (self.body, self.spacecraft) if swapped else (self.spacecraft, self.body)
        if str(words.get("LT_SURFACE_CORRECT", "FALSE")).upper() == "TRUE":
            saved = 0.5 * (self.radii()[0] + self.radii()[2]) / LIGHT
            late = [time - spice.spkezr(target, time, "J2000", "LT+S", observer)[1] + saved for time in times]
            pairs = zip(late, times, strict=True)
            states = [barycentric(target, emitted) - barycentric(observer, received) for emitted, received in pairs]
        else:
            states = [spice.spkezr(target, time, "J2000", "LT+S", observer)[0] for time in times]
        return np.array(states) * (-1.0 if swapped else 1.0)

    def support_data(self, variant: Variant) -> dict[str, Any]:
        """In ALE's layout: a node for each edge of a line."""
        (lines, samples), optics = self.size, self.optics
        start, stop = self.time(0.0), self.time(lines)
        middle, period = 0.5 * (start + stop), (stop - start) / lines
        beyond = np.ceil(self.margin / period)
        times = start + period * np.arange(-beyond, lines + 1 + beyond)
        keywords = pool_of(f"INS{self.code}_*") | pool_of(f"BODY{spice.bods2c(self.body)}_*") | variant.keywords
        states, radii = self.places(times, keywords), self.radii()
        sun = self.sun(middle)
        isd = {
            "name_model": "USGS_ASTRO_LINE_SCANNER_SENSOR_MODEL", "name_platform": self.platform,
            "name_sensor": self.sensor, "image_lines": lines, "image_samples": samples, "naif_keywords": keywords,
            "starting_ephemeris_time": start, "center_ephemeris_time": middle,
            "line_scan_rate": [[line + 0.5, time - middle, period] for line, time, period in self.rates],
            "radii": {"semimajor": radii[0], "semiminor": radii[2], "unit": "km"},
            "detector_sample_summing": optics.summing, "detector_line_summing": 1.0,
            "focal_length_model": {"focal_length": optics.focal},
            "detector_center": {"line": optics.origin[0], "sample": optics.origin[1] - 0.5},
            "starting_detector_line": optics.offset, "starting_detector_sample": optics.first - 1.0,
            "focal2pixel_lines": optics.lines.tolist(), "focal2pixel_samples": optics.samples.tolist(),
            "optical_distortion": optics.model, "body_rotation": self.spinning(times),
            "instrument_pointing": self.pointing(times),
            "instrument_position": {
                "reference_frame": 1, "ephemeris_times": times.tolist(), "unit": "km",
                "positions": states[:, :3].tolist(), "velocities": states[:, 3:].tolist(),
            },
            "sun_position": {
                "reference_frame": 1, "ephemeris_times": [middle], "unit": "km", "positions": [sun[:3].tolist()],
                "velocities": [sun[3:].tolist()],
            },
        }  # fmt: skip
        variant.edit(isd)
        return isd



def barycentric(name: str, time: float) -> Vector:
    """km, km/s, J2000."""
    return np.array(spice.spkezr(name, time, "J2000", "NONE", "SSB")[0])


def pool(name: str) -> Vector:
    """Numbers of a pool variable."""
    return np.array(spice.gdpool(name, 0, 40))


def pool_of(pattern: str) -> dict[str, Any]:
    """Variables of the pool as ALE copies them: one number or word as it is, several as a list."""
    variables = dict[str, Any]()
    try:
        names = spice.gnpool(pattern, 0, 400)
    except spice.exceptions.NotFoundError:
        return variables
    for name in names:
        _, kind = spice.dtpool(name)
        values = list(spice.gcpool(name, 0, 40)) if kind == "C" else pool(name).tolist()
        variables[name] = values[0] if len(values) == 1 else values
    return variables


@contextmanager
def furnished(files: Sequence[Path]) -> Iterator[None]:
    """SPICE with these kernels alone."""
    spice.kclear()
    try:
        for file in files:
            spice.furnsh(str(file))
        yield
    finally:
        spice.kclear()

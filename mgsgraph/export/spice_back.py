"""Reads exported kernels by SPICE alone, and computes the image coordinates of the points.

Nothing is taken from the writer or from our geometry. The line is found by the secant method on what the instrument
kernel says of detector, optics and line times (its comments have the formulas).
"""

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import spiceypy
from spiceypy.utils.exceptions import NotFoundError

from mgsgraph.errors import require
from mgsgraph.export.spice_nodes import Reprojection, images_of
from mgsgraph.files.labels.kernels import loaded, spice_words

Numbers = np.ndarray[Any, np.dtype[np.float64]]

_META_KERNEL = "adjusted.tm"
_NUDGE = 1e-5
"""mm."""
_STEPS = 30
_CONVERGED = 1e-5
"""lines, at which the secant method ends: attitudes are looked up to 3e-6 of LROC-NAC's, as exact as a time is."""
_SEEN = 1e-3
"""px: nearer than this to the detector a point is seen there, not lost at an end of the lines covered."""


def spice_differences(folder: Path, expected: Reprojection) -> Numbers:
    """Distances of the points' image coordinates by the kernels from those of the solution.

    Parameters
    ----------
    folder : Path
        With the meta-kernel adjusted.tm.
    expected : Reprojection
        Points and where the solution sees them.

    Returns
    -------
    differences : (k,)
        px; infinite where the kernels don't show the point within the lines that they cover.

    Raises
    ------
    InputError
        When there is no meta-kernel, SPICE refuses a file, or an image has no camera constants.
    """
    meta, differences = folder / _META_KERNEL, np.full(len(expected.image), np.inf)
    with loaded([meta], folder), spice_words(str(meta)):
        cameras = _cameras()
        for name, of_image in images_of(expected).items():
            require(name in cameras, str(meta), f"no camera constants of the image {name}", "those of every image")
            with np.errstate(all="ignore"):  # far outside the image the polynomials of the optics overflow
                place = _seen(cameras[name], expected.points[of_image])
            differences[of_image] = np.linalg.norm(place - expected.places[of_image], axis=1)
    return np.where(np.isnan(differences), np.inf, differences)


def _variable(name: str) -> list[Any]:
    count, kind = spiceypy.dtpool(name)
    return list(spiceypy.gcpool(name, 0, count, 256) if kind == "C" else spiceypy.gdpool(name, 0, count))


class _Camera(NamedTuple):
    """Constants of one image from the instrument kernel."""

    spacecraft: int
    frame: int
    clock: int
    body: int
    body_frame: str
    focal_length: float
    to_line: Numbers
    to_sample: Numbers
    centre: Numbers
    first: Numbers
    summing: float
    distortion: str
    coefficients: list[float]
    radial: list[float]
    point: list[float]
    covered: tuple[float, float]
    lines: int
    times: Numbers


def _cameras() -> dict[str, _Camera]:
    cameras = {}
    for number in _variable("MGSGRAPH_INSTRUMENTS"):
        keys = {key: _variable(f"INS{int(number)}_{key}") for key in (
            "IMAGE", "IMAGE_LINES", "SPACECRAFT", "FRAME_ID", "BODY", "BODY_FRAME", "FOCAL_LENGTH", "ITRANSL",
            "ITRANSS", "DETECTOR_CENTRE", "DETECTOR_FIRST", "SAMPLE_SUMMING", "DISTORTION", "OD_K", "LINES_COVERED",
            "LINE_TIMES",
        )}  # fmt: skip
        frame = int(keys["FRAME_ID"][0])
        cameras[keys["IMAGE"][0]] = _Camera(
            int(keys["SPACECRAFT"][0]), frame, int(_variable(f"CK_{frame}_SCLK")[0]), int(keys["BODY"][0]),
            keys["BODY_FRAME"][0], keys["FOCAL_LENGTH"][0], np.array(keys["ITRANSL"]), np.array(keys["ITRANSS"]),
            np.array(keys["DETECTOR_CENTRE"]), np.array(keys["DETECTOR_FIRST"]), keys["SAMPLE_SUMMING"][0],
            keys["DISTORTION"][0], keys["OD_K"], *_added(int(number)),
            (keys["LINES_COVERED"][0], keys["LINES_COVERED"][1]), int(keys["IMAGE_LINES"][0]),
            np.array(keys["LINE_TIMES"]).reshape(-1, 3),
        )  # fmt: skip
    return cameras


def _added(number: int) -> tuple[list[float], list[float]]:
    """Radial coefficients and principal point that an adjustment found; zeros where there are none."""
    if not spiceypy.expool(f"INS{number}_OD_POINT"):
        return [0.0] * 3, [0.0] * 2
    return _variable(f"INS{number}_OD_RADIAL"), _variable(f"INS{number}_OD_POINT")


def _seen(camera: _Camera, points: Numbers) -> Numbers:
    """Places (k, 2), line and sample, of points (k, 3) in m; NaN where the secant method finds none."""
    before = np.full(points.shape[0], 0.5 * camera.lines)
    off_before, _ = _off_line(camera, points, before)
    lines = before + 1.0
    samples = np.full(points.shape[0], np.nan)
    for _ in range(_STEPS):
        off, samples = _off_line(camera, points, lines)
        step = -off * (lines - before) / (off - off_before)
        step = np.where((off == 0.0) | (np.abs(lines - before) <= _CONVERGED) | np.isnan(step), 0.0, step)
        before, off_before = lines, off
        lines = np.clip(lines + step, *camera.covered)
        if not np.any(np.abs(lines - before) > _CONVERGED):
            break
    converged = (np.abs(lines - before) <= _CONVERGED) & (np.abs(off_before) < _SEEN)
    return np.where(converged[:, None], np.column_stack([lines, samples]), np.nan)


def _off_line(camera: _Camera, points: Numbers, lines: Numbers) -> tuple[Numbers, Numbers]:
    """How far (k,) the image of each point is from the detector's line, px, at the time of a line; and its sample."""
    k = np.clip(np.searchsorted(camera.times[:, 0], lines, side="right") - 1, 0, None)
    since = (lines - camera.times[k, 0]) * camera.times[k, 2]
    times = camera.times[k, 1] + since
    # ephemeris time resolves 6e-8 s, 2e-4 lines of LROC-NAC: what was rounded away follows by the kernels' rates
    rest = (camera.times[k, 1] - times) + since
    ray = np.empty_like(points)
    for i, time in enumerate(times):
        ticks = spiceypy.sce2c(camera.clock, time)
        try:
            matrix, angular_rate, _ = spiceypy.ckgpav(camera.frame, ticks, 0, camera.body_frame)
        except NotFoundError:
            ray[i] = np.nan
            continue
        state, _ = spiceypy.spkgeo(camera.spacecraft, time, camera.body_frame, camera.body)
        arm = points[i] / 1e3 - state[:3]
        ray[i] = matrix @ (arm - rest[i] * (state[3:] + np.cross(angular_rate, arm)))
    ray[ray[:, 2] <= 0.0] = np.nan  # behind the camera
    x, y = _distorted(camera, camera.focal_length * ray[:, :2].T / ray[:, 2])
    line = camera.centre[0] + camera.to_line[0] + camera.to_line[1] * x + camera.to_line[2] * y
    sample = camera.centre[1] + camera.to_sample[0] + camera.to_sample[1] * x + camera.to_sample[2] * y
    return line - camera.first[0], (sample - camera.first[1]) / camera.summing


def _distorted(camera: _Camera, ideal: Numbers) -> Numbers:
    """Measured focal-plane places (2, k) of ideal ones, mm, by Newton's method on the kernel's formula of the opposite,
    with slopes by differences.
    """
    forms = {
        "NONE": _none, "LROC_NAC": _lroc, "RADIAL": _radial, "KAGUYA_TC": _kaguya_tc, "KAGUYA_MI": _kaguya_mi,
        "MOC_WIDE": _moc_wide, "THEMIS_IR": _themis,
    }  # fmt: skip
    require(camera.distortion in forms, "instrument kernel, DISTORTION", repr(camera.distortion), ", ".join(forms))
    model, place = forms[camera.distortion], ideal.copy()
    c1, c2, c3 = camera.radial

    def ideally(at: Numbers) -> Numbers:
        plane = model(at, camera.coefficients)
        square = (plane**2).sum(axis=0)
        whole = 1.0 + c1 * square + c2 * square**2 + c3 * square**3
        return np.asarray(plane * whole - np.array(camera.point)[:, None])

    for _ in range(_STEPS):
        computed = ideally(place)
        (a, c), (b, d) = ((ideally(place + _NUDGE * axis[:, None]) - computed) / _NUDGE for axis in np.eye(2))
        x, y = ideal - computed
        place = place + np.array([d * x - b * y, a * y - c * x]) / (a * d - b * c)
    return place


def _none(place: Numbers, _: list[float]) -> Numbers:
    return place


def _lroc(place: Numbers, k: list[float]) -> Numbers:
    x, y = place
    return np.array([x, y / (1.0 + k[0] * y**2)])


def _radial(place: Numbers, k: list[float]) -> Numbers:
    square = (place**2).sum(axis=0)
    return np.asarray(place * (1.0 - k[0] - square * (k[1] + square * k[2])))


def _kaguya_tc(place: Numbers, k: list[float]) -> Numbers:
    return place + _cubics(np.hypot(*place), k)


def _kaguya_mi(place: Numbers, k: list[float]) -> Numbers:
    return place + _cubics(place[1], k)


def _cubics(of: Numbers, k: list[float]) -> Numbers:
    powers = of ** np.arange(4.0)[:, None]
    return np.array([k[:4] @ powers, k[4:] @ powers])


def _moc_wide(place: Numbers, k: list[float]) -> Numbers:
    *odd, scale, focal_length = k
    x, y = place[0], place[1] / scale
    tangent = np.hypot(x, y) / focal_length
    angle = np.arctan(tangent)
    ideal = sum(c * angle ** (2 * n + 1) for n, c in enumerate(odd))
    stretch = np.divide(np.tan(ideal), tangent, out=np.full_like(tangent, odd[0]), where=tangent > 0.0)
    return np.asarray(np.array([x, y]) * stretch)


def _themis(place: Numbers, k: list[float]) -> Numbers:
    magnified, a1, a2 = k
    y = place[1] if a2 == 0.0 else (np.sqrt((1.0 + a1) ** 2 + 4.0 * a2 * place[1]) - 1.0 - a1) / (2.0 * a2)
    return np.array([place[0] / magnified, y if a2 else y / (1.0 + a1)])

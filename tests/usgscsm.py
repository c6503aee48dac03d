"""Support data and model states as usgscsm takes them, and points projected as it does.

Nothing here is shared with the writer or with `geometry`: every step is the one that usgscsm publishes, vectorised
over points. Source files and functions are named beside the steps (repository DOI-USGS/usgscsm and, for support data,
DOI-USGS/ale).
"""

import json
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mgsgraph.export.spice_nodes import Reprojection, images_of
from mgsgraph.geometry.image import PushbroomImage

Numbers = NDArray[np.float64]
State = dict[str, Any]

_PRECISION = 1e-7
"""Detector lines to which the line is sought; usgscsm's callers choose it, 1e-3 by default."""
_STEPS = 15
_ORDER = 8
_FEWEST_NODES = 25
_STATES = ".adjusted_state.json"


def csm_differences(folder: Path, wanted: Reprojection) -> Numbers:
    """Distances (k,) in pixels between where a solution sees its points and where files do, of support data and model
    states the larger ones; of states alone where there are no support data.
    """
    of_states = state_differences(folder, wanted)
    return np.maximum(of_states, isd_differences(folder, wanted)) if _support_data(folder) else of_states


def isd_differences(folder: Path, wanted: Reprojection) -> Numbers:
    """Distances (k,) in pixels by the support data ``*.json`` in a folder; infinite where a projection fails."""
    contents = map(read_content, _support_data(folder))
    return _differences({one["image_identifier"]: state_of_support_data(one) for one in contents}, wanted)


def state_differences(folder: Path, wanted: Reprojection) -> Numbers:
    """Distances (k,) in pixels by the model states in a folder; infinite where a projection fails."""
    contents = map(read_content, folder.glob(f"*{_STATES}"))
    return _differences({one["m_imageIdentifier"]: one for one in contents}, wanted)


def _support_data(folder: Path) -> list[Path]:
    """Those that lie beside a state of their name: other JSON may be there."""
    return [path for path in folder.glob("*.json") if path.with_name(f"{path.stem}{_STATES}").exists()]


def _differences(states: dict[str, State], wanted: Reprojection) -> Numbers:
    off = np.full(len(wanted.image), np.inf)
    for name, mine in images_of(wanted).items():
        off[mine] = np.linalg.norm(ground_to_image(states[name], wanted.points[mine]) - wanted.places[mine], axis=1)
    return np.where(np.isfinite(off), off, np.inf)


def read_content(path: Path) -> State:
    """What is between the first and the last brace (Utilities.cpp, stateAsJson)."""
    text = path.read_text(encoding="utf-8")
    return dict(json.loads(text[text.index("{") : text.rindex("}") + 1]))


# --- UsgsAstroLsSensorModel.cpp


def largest_difference(image: PushbroomImage, state: State) -> float:
    """Pixels between 25 places and where usgscsm sees their ground points."""
    lines, samples = np.meshgrid(np.linspace(0.5, image.lines - 0.5, 5), np.linspace(0.5, image.samples - 0.5, 5))
    places = np.column_stack([lines.ravel(), samples.ravel()])
    ground, _ = image.image_to_ground(*places.T)
    return float(np.abs(ground_to_image(state, ground) - places).max())


def ground_to_image(state: State, points: Numbers) -> Numbers:
    """Lines and samples (n, 2) from 0 at the first pixel's corner, of points (n, 3) in m (groundToImage)."""
    start = np.full(points.shape[0], 0.5 * state["m_nLines"])
    before, after = np.zeros_like(start), np.full_like(start, 0.1)
    error_before, error_after = (_detector(state, start + t, points)[0] for t in (before, after))
    for _ in range(_STEPS):
        going = (np.abs(error_after) > _PRECISION) & (error_after != error_before)
        if not going.any():
            break
        slope = np.where(going, error_after - error_before, 1.0)
        step = after - np.where(going, error_after * (after - before) / slope, 0.0)
        before, error_before = np.where(going, after, before), np.where(going, error_after, error_before)
        after = step
        error_after = np.where(going, _detector(state, start + after, points)[0], error_after)
    line = start + after
    rest, sample = _detector(state, line, points)
    return np.column_stack([line + rest, sample])


def _detector(state: State, lines: Numbers, points: Numbers) -> tuple[Numbers, Numbers]:
    """How far in lines a point's image is from the detector at the times of lines (n,) (calcDetectorLineErr), and its
    sample.
    """
    x, y = distort(state, *_view(state, _image_time(state, lines), points))
    line = _affine(state["m_iTransL"], x, y) + state["m_detectorLineOrigin"] - state["m_startingDetectorLine"]
    sample = _affine(state["m_iTransS"], x, y) + state["m_detectorSampleOrigin"] - state["m_startingDetectorSample"]
    return line / state["m_detectorLineSumming"], sample / state["m_detectorSampleSumming"]


def _affine(coefficients: list[float], x: Numbers, y: Numbers) -> Numbers:
    return coefficients[0] + coefficients[1] * x + coefficients[2] * y


def _image_time(state: State, lines: Numbers) -> Numbers:
    """Seconds past the centre time (getImageTime); half a line more is the middle of its exposure."""
    first = np.asarray(state["m_intTimeLines"], dtype=np.float64)
    k = np.maximum(np.searchsorted(first, lines, side="right") - 1, 0)
    starts, periods = np.asarray(state["m_intTimeStartTimes"]), np.asarray(state["m_intTimes"])
    return np.asarray(starts[k] + periods[k] * (lines - first[k] + 0.5))


def _view(state: State, times: Numbers, points: Numbers) -> tuple[Numbers, Numbers]:
    """Ideal focal-plane places in mm (computeDetectorView; all parameters of the adjustment have to be zero)."""
    if any(state["m_currentParameterValue"]):
        raise ValueError("m_currentParameterValue is not zero")
    highest = _ORDER if state["m_platformFlag"] else 4
    place = lagrange(state["m_positions"], 3, state["m_t0Ephem"], state["m_dtEphem"], times, highest)
    of_attitude = 4 if state["m_numQuaternions"] < 6 else highest
    q = lagrange(state["m_quaternions"], 4, state["m_t0Quat"], state["m_dtQuat"], times, of_attitude)
    look = np.einsum("nji,nj->ni", _matrices(q[:, [3, 0, 1, 2]]), points - place)
    scale = state["m_focalLength"] / look[:, 2]
    return look[:, 0] * scale, look[:, 1] * scale


def distort(state: State, x: Numbers, y: Numbers) -> tuple[Numbers, Numbers]:
    """Measured focal-plane places of ideal ones (Distortion.cpp, applyDistortion); mm."""
    kind, said = state["m_distortionType"], state["m_opticalDistCoeffs"]
    if kind in _APPLIED:
        return _APPLIED[kind](said, x, y, state["m_focalLength"])
    raise ValueError(f"distortion {kind}, which is not read back")


# --- Distortion.cpp, applyDistortion: the cases of its switch


def _radial(said: list[float], x: Numbers, y: Numbers, _: float) -> tuple[Numbers, Numbers]:
    radius = np.hypot(x, y)
    share = said[0] + radius**2 * (said[1] + radius**2 * said[2])
    bent = radius * (1.0 + share)
    for _again in range(20):
        share = said[0] + bent**2 * (said[1] + bent**2 * said[2])
        bent = radius + share * bent
    return x / (1.0 - share), y / (1.0 - share)


def _transverse(said: list[float], x: Numbers, y: Numbers, _: float) -> tuple[Numbers, Numbers]:
    terms = np.array([np.ones_like(x), x, y, x * x, x * y, y * y, x**3, x * x * y, x * y * y, y**3])
    first, last = np.array([said[:10], said[10:]]) @ terms
    return first, last


def _kaguya(said: list[float], x: Numbers, y: Numbers, _: float) -> tuple[Numbers, Numbers]:
    xt, yt = x - said[0], y - said[5]
    for _again in range(50):
        r = np.hypot(xt, yt)
        xt, yt = (
            ideal - own[0] - (own[1] + own[2] * r + own[3] * r**2 + own[4] * r**3)
            for ideal, own in ((x, said[:5]), (y, said[5:]))
        )
    return xt, yt


def _dawn(said: list[float], x: Numbers, y: Numbers, _: float) -> tuple[Numbers, Numbers]:
    share = 1.0 + said[0] * (x * x + y * y)
    return x * share, y * share


def _lroc(said: list[float], x: Numbers, y: Numbers, _: float) -> tuple[Numbers, Numbers]:
    bent = y
    for _again in range(50):
        bent = np.where(np.abs(y) > 40.0, y, y * (1.0 + said[0] * bent**2))
    return x, bent


def _cahvor(said: list[float], x: Numbers, y: Numbers, focal: float) -> tuple[Numbers, Numbers]:
    moved = _radial(said, x - said[3], y - said[4], focal)
    return moved[0] + said[3], moved[1] + said[4]


def _radtan(said: list[float], x: Numbers, y: Numbers, focal: float) -> tuple[Numbers, Numbers]:
    (k1, k2, p1, p2, k3), u, v = said, x / focal, y / focal
    r2 = u * u + v * v
    share = 1.0 + k1 * r2 + k2 * r2**2 + k3 * r2**3
    return (
        focal * (u * share + 2.0 * p1 * u * v + p2 * (r2 + 2.0 * u * u)),
        focal * (v * share + p1 * (r2 + 2.0 * v * v) + 2.0 * p2 * u * v),
    )


def _shadowcam(said: list[float], x: Numbers, y: Numbers, _: float) -> tuple[Numbers, Numbers]:
    bent = y
    for _again in range(50):
        bent = y / (1.0 + said[0] * bent**2)
    return x, bent


_APPLIED = {0: _radial, 1: _transverse, 2: _kaguya, 3: _dawn, 4: _lroc, 5: _cahvor, 7: _radtan, 8: _shadowcam}
"""By DistortionType (include/usgscsm/Distortion.h)."""
_NAMED = {
    "radial": 0, "transverse": 1, "kaguyalism": 2, "dawnfc": 3, "lrolrocnac": 4, "cahvor": 5, "radtan": 7,
    "kplo_shadowcam": 8,
}  # fmt: skip
"""Types by the names in support data (ALE, src/Util.cpp, getDistortionModel)."""


# --- Utilities.cpp


def lagrange(values: list[float], width: int, first: float, step: float, times: Numbers, highest: int) -> Numbers:
    """Values (n, width) at times (n,) by the polynomials through the nearest even nodes (lagrangeInterp): of eight, or
    near the ends of six, four, two.
    """
    nodes = np.asarray(values, dtype=np.float64).reshape(-1, width)
    where = (times - first) / step
    index = np.clip(np.nan_to_num(np.trunc(where)), 0, len(nodes) - 2).astype(int)
    beside = np.minimum(index, len(nodes) - 2 - index)
    orders = np.minimum(2 * np.minimum(beside, 3) + 2, highest)
    result = np.empty((times.size, width))
    for order in np.unique(orders).tolist():
        mine = np.flatnonzero(orders == order)
        offsets = np.arange(order) - (order // 2 - 1)
        since = (where - index)[mine]
        weights = np.ones((mine.size, order))
        for i, here in enumerate(offsets):
            for other in offsets[offsets != here]:
                weights[:, i] *= (since - other) / (here - other)
        result[mine] = np.einsum("nk,nkc->nc", weights, nodes[index[mine, None] + offsets])
    return result


def _matrices(quaternions: Numbers) -> Numbers:
    """Rotation matrices (n, 3, 3) of quaternions (n, 4), scalar first, of any length
    (calculateRotationMatrixFromQuaternions).
    """
    w, x, y, z = (quaternions / np.linalg.norm(quaternions, axis=1)[:, None]).T
    return np.moveaxis(np.array([
        [w * w + x * x - y * y - z * z, 2.0 * (x * y - z * w), 2.0 * (x * z + y * w)],
        [2.0 * (x * y + z * w), w * w - x * x + y * y - z * z, 2.0 * (y * z - x * w)],
        [2.0 * (x * z - y * w), 2.0 * (y * z + x * w), w * w - x * x - y * y + z * z],
    ]), 2, 0)  # fmt: skip


# --- UsgsAstroLsSensorModel.cpp, constructStateFromIsd, and what it calls of ALE


def state_of_support_data(isd: dict[str, Any]) -> State:
    """The keys of a state that groundToImage needs, from support data."""
    centre = isd["center_ephemeris_time"]
    rates = np.array(isd["line_scan_rate"])
    ((kind, said),) = isd["optical_distortion"].items()
    said = [said["coefficients"]] if "coefficients" in said else [
        [said[f"boresight_{axis}"], *said[axis]] if kind == "kaguyalism" else said[axis] for axis in ("x", "y")
    ]  # fmt: skip
    return {
        "m_nLines": isd["image_lines"], "m_platformFlag": 1, "m_currentParameterValue": [0.0] * 16,
        "m_intTimeLines": rates[:, 0], "m_intTimeStartTimes": rates[:, 1], "m_intTimes": rates[:, 2],
        "m_focalLength": isd["focal_length_model"]["focal_length"],
        "m_distortionType": _NAMED[kind], "m_opticalDistCoeffs": np.hstack(said).tolist(),
        "m_iTransL": isd["focal2pixel_lines"], "m_iTransS": isd["focal2pixel_samples"],
        "m_detectorLineOrigin": isd["detector_center"]["line"],
        "m_detectorSampleOrigin": isd["detector_center"]["sample"],
        "m_startingDetectorLine": isd["starting_detector_line"],
        "m_startingDetectorSample": isd["starting_detector_sample"],
        "m_detectorLineSumming": isd["detector_line_summing"],
        "m_detectorSampleSumming": isd["detector_sample_summing"],
        **_positions(isd["instrument_position"], isd["body_rotation"], centre),
        **_quaternions(isd["instrument_pointing"], isd["body_rotation"], centre),
    }  # fmt: skip


def _positions(table: dict[str, Any], body: dict[str, Any], centre: float) -> State:
    """Body-fixed positions in m at even times: at least 25, by Hermite's cubic (ALE States.cpp, getState)."""
    given = np.array(table["ephemeris_times"])
    count = max(given.size, _FEWEST_NODES)
    step = (given[-1] - given[0]) / (count - 1)
    times = given[0] + step * np.arange(count)
    places, motions = np.array(table["positions"]), np.array(table["velocities"])
    k = np.clip(np.searchsorted(given, times, side="right") - 1, 0, given.size - 2)
    span = given[k + 1] - given[k]
    t, span = ((times - given[k]) / span)[:, None], span[:, None]
    place = (2 * t**3 - 3 * t**2 + 1) * places[k] + (t**3 - 2 * t**2 + t) * span * motions[k]
    place += (-2 * t**3 + 3 * t**2) * places[k + 1] + (t**3 - t**2) * span * motions[k + 1]
    fixed = np.einsum("nij,nj->ni", _matrices(_attitude(body, times)), place)
    return {"m_positions": (1e3 * fixed).ravel(), "m_t0Ephem": given[0] - centre, "m_dtEphem": step}


def _quaternions(table: dict[str, Any], body: dict[str, Any], centre: float) -> State:
    """Sensor to body-fixed at even times, as many as both tables have together (ALE Orientations.cpp, operator*=)."""
    merged = np.union1d(table["ephemeris_times"], body["ephemeris_times"])
    step = (merged[-1] - merged[0]) / (merged.size - 1)
    at_merged = _product(_attitude(body, merged), _inverse(_attitude(table, merged)))
    even = great_arc(merged, at_merged, merged[0] + step * np.arange(merged.size))
    return {
        "m_quaternions": even[:, [1, 2, 3, 0]].ravel(), "m_numQuaternions": even.size,
        "m_t0Quat": merged[0] - centre, "m_dtQuat": step,
    }  # fmt: skip


def _attitude(table: dict[str, Any], times: Numbers) -> Numbers:
    """Quaternions (n, 4), scalar first, inertial to the table's whole frame (ALE Orientations.cpp, interpolate)."""
    turned = great_arc(np.array(table["ephemeris_times"]), np.array(table["quaternions"]), times)
    constant = np.array(table.get("constant_rotation", np.eye(3))).reshape(3, 3)
    return _product(_quaternion(constant), turned)


def great_arc(given: Numbers, quaternions: Numbers, times: Numbers) -> Numbers:
    """On the great arc between two quaternions (ALE Rotation.cpp, interpolate with SLERP)."""
    k = np.clip(np.searchsorted(given, times, side="right") - 1, 0, given.size - 2)
    t = ((times - given[k]) / (given[k + 1] - given[k]))[:, None]
    cosine = np.einsum("ni,ni->n", quaternions[k], quaternions[k + 1])[:, None]
    angle = np.arctan2(np.sqrt(np.maximum(1.0 - cosine**2, 0.0)), np.abs(cosine))
    flat = angle < 1e-6
    sine = np.where(flat, 1.0, np.sin(angle))
    first = np.where(flat, 1.0 - t, np.sin((1.0 - t) * angle) / sine)
    last = np.where(flat, t, np.sin(t * angle) / sine) * np.where(cosine < 0.0, -1.0, 1.0)
    return np.asarray(first * quaternions[k] + last * quaternions[k + 1])


def _product(left: Numbers, right: Numbers) -> Numbers:
    """Hamilton's product of quaternions (..., 4), scalar first."""
    a, b, c, d = np.moveaxis(left, -1, 0)
    e, f, g, h = np.moveaxis(right, -1, 0)
    return np.stack([
        a * e - b * f - c * g - d * h, a * f + b * e + c * h - d * g,
        a * g - b * h + c * e + d * f, a * h + b * g - c * f + d * e,
    ], axis=-1)  # fmt: skip


def _inverse(quaternions: Numbers) -> Numbers:
    return np.asarray(quaternions * np.array([1.0, -1.0, -1.0, -1.0]))


def _quaternion(matrix: Numbers) -> Numbers:
    """(4,) of a rotation matrix (3, 3): the eigenvector of the largest eigenvalue (Bar-Itzhack 2000)."""
    odd = [matrix[2, 1] - matrix[1, 2], matrix[0, 2] - matrix[2, 0], matrix[1, 0] - matrix[0, 1]]
    key = np.zeros((4, 4))
    key[0, 0], key[0, 1:], key[1:, 0] = np.trace(matrix), odd, odd
    key[1:, 1:] = matrix + matrix.T - np.trace(matrix) * np.eye(3)
    return np.asarray(np.linalg.eigh(key)[1][:, -1])


HEAD = "USGS_ASTRO_LINE_SCANNER_SENSOR_MODEL"
NODES = 40


def state(**changes: Any) -> dict[str, Any]:
    """400 km above a sphere of 3,400 km, 3.4 km/s along the equator, swaying; the line period changes, with a pause."""
    times = 0.25 * np.arange(NODES) - 5.0
    angle = 3400.0 / 3.8e6 * times + 1e-5 * np.sin(2.0 * times)
    positions = 3.8e6 * np.stack([np.cos(angle), np.sin(angle), 0.0 * angle], axis=1)
    # camera z down, x along the flight, swaying about it; scalar last, camera to body
    half = 0.5 * (angle + np.pi) + 1e-4 * np.sin(3.0 * times)
    turn = np.stack([0.0 * half, 0.0 * half, np.sin(half), np.cos(half)], axis=1)  # about the body's z
    onto = np.array([0.5, 0.5, 0.5, 0.5])  # z to x, x to y, y to z
    return {
        "m_modelName": HEAD, "m_imageIdentifier": "A/1", "m_nLines": 2000, "m_nSamples": 500, "m_platformFlag": 1,
        "m_zDirection": 1.0, "m_focalLength": 3500.0, "m_distortionType": 0, "m_opticalDistCoeffs": [1e-4, 1e-6, 0.0],
        "m_iTransS": [0.0, 0.0, 80.0], "m_iTransL": [0.5, 80.0, 0.0], "m_detectorSampleOrigin": 250.0,
        "m_detectorLineOrigin": 0.0, "m_detectorSampleSumming": 2.0, "m_detectorLineSumming": 2.0,
        "m_startingDetectorSample": -7.0, "m_startingDetectorLine": 0.0, "m_centerEphemerisTime": 1e8,
        "m_intTimeLines": [0.0, 1200.0], "m_intTimeStartTimes": [-1.0, 0.21], "m_intTimes": [1e-3, 1.1e-3],
        "m_t0Ephem": -5.0, "m_dtEphem": 0.25, "m_numPositions": 3 * NODES, "m_positions": positions.ravel().tolist(),
        "m_t0Quat": -5.0, "m_dtQuat": 0.25, "m_numQuaternions": 4 * NODES,
        "m_quaternions": product(turn, onto).ravel().tolist(),
        "m_majorAxis": 3.4e6, "m_minorAxis": 3.4e6, "m_currentParameterValue": [0.0] * 16,
    } | changes  # fmt: skip


def product(left: np.ndarray, right: np.ndarray) -> np.ndarray:
    """Hamilton's product of quaternions (n, 4) and (4,), scalar last."""
    a, w = left[:, :3], left[:, 3:]
    return np.hstack([w * right[:3] + right[3] * a + np.cross(a, right[:3]), w * right[3] - a @ right[:3, None]])

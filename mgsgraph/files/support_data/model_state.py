"""Line-scanner model states of usgscsm, as Ames Stereo Pipeline's bundle_adjust and jitter_solve write them.

``*.adjusted_state.json``: the model's name, then JSON. Keys: usgscsm src/UsgsAstroLsSensorModel.cpp
(replaceModelState); line times: getImageTime, whose lines count from 0 at the first one's edge and have half a line
added; positions and attitudes are body-fixed at even times, between which Lagrange's polynomials through the nearest
eight of them hold (src/Utilities.cpp, lagrangeInterp; of four where m_platformFlag is 0, of six, four, two near the
ends). Ours are cubic and great arcs, and samples are added where these would differ.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any, TypeVar

import msgspec
import numpy as np

from mgsgraph.errors import InputError, errors_from, require
from mgsgraph.files.cameras.other_sensors import model_words
from mgsgraph.files.decoding import Count, Number, Positive, validated
from mgsgraph.files.labels.aberration import spacecraft_named
from mgsgraph.files.opening import head_of, read_json
from mgsgraph.files.support_data.isd_layout import MODEL, distortion_of_state
from mgsgraph.geometry import rotation
from mgsgraph.geometry.body import Ellipsoid, require_possible
from mgsgraph.geometry.camera import InteriorOrientation
from mgsgraph.geometry.image import LineTiming, PushbroomImage
from mgsgraph.geometry.plausibility import require_near_sun
from mgsgraph.geometry.records import Array, Index, by_value
from mgsgraph.geometry.rotation import unit_vectors
from mgsgraph.geometry.trajectory import AttitudeTable, FixedTrajectory, PositionTable
from mgsgraph.units import MM

_HIGHEST, _HIGHEST_OF_PLATFORM_0 = 8, 4
_HEADING = 80
"""bytes in which a model's name ends."""
MODELS = "USGS_ASTRO_"
"""How the names of usgscsm's models begin."""
_HALVINGS = 16
"""Of the time between two samples, at the most."""
_MOST = 200_000
"""Samples; those of a WorldView image that jitter_solve has bent are 180,000."""
_NORMS = 0.5, 2.0
"""Of quaternions."""
_TOLERANCE = 2e-4
"""Pixels by which positions, and attitudes, may be off between samples."""
_SAME_SPEED, _SAME_SIZE, _SAME_HEIGHT, _SAME_RATIO, _NEAR = 0.05, 0.025, 0.1, 1.5, 20e3
"""Shares of speeds and sizes, and m, by which a state's own summaries may be off: heights of the ground are not known.
"""
_PIXELS = 0.24
"""By which its reference point may be: those of real ones are by 0.2."""
_BETWEEN = np.array([0.25, 0.5, 0.75])
_STEP = 1e-3
"""Of a sample's distance, of the difference that gives velocities."""
_CORNER = 1e-6
"""Of a sample's distance, within which a path may turn sharply at a sample."""
_Vector = tuple[Number, Number, Number]
Table = TypeVar("Table", PositionTable, AttitudeTable)
_Numbers = Annotated[list[Number], msgspec.Meta(min_length=1)]


class _State(msgspec.Struct, kw_only=True):
    m_modelName: str
    m_nLines: Count
    m_nSamples: Count
    m_platformFlag: int = 1
    m_platformName: str = ""
    m_platformIdentifier: str = ""
    m_zDirection: Number = 1.0
    m_focalLength: Positive
    m_distortionType: int
    m_opticalDistCoeffs: list[Number]
    m_iTransS: _Vector
    m_iTransL: _Vector
    m_detectorSampleOrigin: Number
    m_detectorLineOrigin: Number
    m_detectorSampleSumming: Positive
    m_startingDetectorSample: Number
    m_startingDetectorLine: Number
    m_centerEphemerisTime: Number
    m_intTimeLines: _Numbers
    m_intTimeStartTimes: _Numbers
    m_intTimes: _Numbers
    m_t0Ephem: Number
    m_dtEphem: Positive
    m_positions: _Numbers
    m_t0Quat: Number
    m_dtQuat: Positive
    m_quaternions: _Numbers
    m_majorAxis: Positive
    m_minorAxis: Positive
    m_currentParameterValue: list[Number] = []
    m_numPositions: int | None = None
    m_numQuaternions: int | None = None
    m_velocities: list[Number] = []
    m_flyingHeight: Number = 0.0
    m_gsd: Number = 0.0
    m_referencePointXyz: list[Number] = []
    m_halfSwath: Number = 0.0


def is_model_state(content: dict[str, Any]) -> bool:
    """Whether JSON is a model state."""
    return "m_modelName" in content


def read_state_json(path: Path) -> dict[str, Any]:
    """The JSON of a model state, behind the model's name; InputError where that is another than a line scanner's."""
    heading = head_of(path, _HEADING).split(b"\n", 1)[0].decode("latin-1").strip()
    if heading.startswith(MODELS) and heading != MODEL:
        raise InputError(str(path), model_words(heading), f"{MODEL} (a line scanner)")
    return read_json(path, heading=MODEL)


def read_model_state(path: Path, name: str) -> PushbroomImage:
    """Read a model state as an image.

    Parameters
    ----------
    path : Path
        ``*.adjusted_state.json``.
    name : str
        By which control networks call the image.

    Raises
    ------
    InputError
        Missing or malformed file, another model than a line scanner's, parameters of an adjustment that are not in the
        tables, or tables that are not dense enough for their own interpolation.
    """
    content, source = read_state_json(path), str(path)
    if (model := content.get("m_modelName", MODEL)) != MODEL:
        raise InputError(f"{source}, m_modelName", model_words(model), f"{MODEL} (a line scanner)")
    state = validated(content, _State, source)
    _require_plain(state, source)
    body = Ellipsoid(state.m_majorAxis, state.m_minorAxis)
    require_possible(body, "", f"{source}, m_majorAxis and m_minorAxis")
    with errors_from(source):
        interior, timing = _interior(state, source), _timing(state, source)
        trajectory = _trajectory(state, interior, timing, source)
        spacecraft = spacecraft_named(state.m_platformName or state.m_platformIdentifier)
        image = PushbroomImage(
            name=name, lines=state.m_nLines, samples=state.m_nSamples, interior=interior, timing=timing,
            trajectory=trajectory, body=body, mission=spacecraft.names[-1] if spacecraft else "",
        )  # fmt: skip
    return replace(image, remarks=tuple(_second_statements(state, image, source)))


def _second_statements(state: _State, image: PushbroomImage, source: str) -> Iterator[str]:
    """Remarks on second statements in a state, and InputError where it contradicts itself: numbers of values,
    velocities, height of flight, size of a pixel and the place of the middle on the ground.
    """
    for key, stated, values in (
        ("m_numPositions", state.m_numPositions, state.m_positions),
        ("m_numQuaternions", state.m_numQuaternions, state.m_quaternions),
    ):
        if stated not in (None, 0, len(values)):
            raise InputError(f"{source}, {key}", f"{stated}, and {len(values)} numbers", "as many", "write it again")
    places = np.array(state.m_positions).reshape(-1, 3)
    if len(state.m_velocities) == places.size and np.any(state.m_velocities):
        stated_speeds = np.array(state.m_velocities).reshape(-1, 3)
        moved = np.diff(places, axis=0) / state.m_dtEphem
        off = np.median(np.linalg.norm(moved - 0.5 * (stated_speeds[1:] + stated_speeds[:-1]), axis=1))
        speed = float(np.median(np.linalg.norm(moved, axis=1)))
        if off > _SAME_SPEED * speed:
            found = f"velocities that are off by {off:.4g} m/s (median)"
            raise InputError(f"{source}, m_velocities", found, f"those of m_positions and m_dtEphem, {speed:.6g} m/s")
    ground, slope = image.image_to_ground(*image.middle)
    if not np.all(np.isfinite(ground)):
        if np.any(state.m_referencePointXyz):
            where, expected = f"{source}, m_referencePointXyz", "one that sees it, where this point says"
            raise InputError(where, "a middle pixel that looks past the ellipsoid", expected, "fix the wrong keys")
        return
    height = float(np.linalg.norm(image.pose(image.middle[0]).position - ground))
    pixel = float(np.linalg.norm(slope.reshape(3, 2)[:, 1]))
    for key, by_state, computed, same in (
        ("m_flyingHeight", state.m_flyingHeight, height, _SAME_HEIGHT), ("m_gsd", state.m_gsd, pixel, _SAME_SIZE)
    ):
        if by_state > 0.0 and not 1.0 / _SAME_RATIO < by_state / computed < _SAME_RATIO:
            raise InputError(f"{source}, {key}", f"{by_state:.6g} m", f"about {computed:.6g} m, as the other keys say")
        if by_state > 0.0 and abs(by_state / computed - 1.0) > same:
            yield f"{key} is {by_state:.6g} m, and by the other keys {computed:.6g} m"
    if len(state.m_referencePointXyz) == 3 and np.any(state.m_referencePointXyz):
        away = float(np.linalg.norm(np.array(state.m_referencePointXyz) - ground[0]))
        where = f"{away:.6g} m from where the middle pixel's ray meets the ellipsoid"
        if away > _NEAR + abs(state.m_halfSwath):
            raise InputError(f"{source}, m_referencePointXyz", where, "near it", "fix the wrong keys")
        if away > _PIXELS * pixel:
            yield f"m_referencePointXyz is {where}"


def _require_plain(state: _State, source: str) -> None:
    """Refuse what usgscsm would compute besides its tables."""
    require(
        not any(state.m_currentParameterValue), f"{source}, m_currentParameterValue", "parameters that are not zero",
        "zeros", "apply them to positions and quaternions, as bundle_adjust and jitter_solve do",
    )  # fmt: skip
    if state.m_zDirection != 1.0:
        raise InputError(f"{source}, m_zDirection", f"{state.m_zDirection:g}", "1, as usgscsm itself makes states")


def _interior(state: _State, source: str) -> InteriorOrientation:
    to_pixel = np.array([state.m_iTransL, state.m_iTransS])
    to_pixel[:, 1:] /= MM
    focal_length = state.m_focalLength * MM
    return InteriorOrientation(
        focal_length=focal_length,
        to_pixel=to_pixel,
        centre=np.array([state.m_detectorLineOrigin, state.m_detectorSampleOrigin]),
        first=np.array([state.m_startingDetectorLine, state.m_startingDetectorSample]),
        sample_summing=state.m_detectorSampleSumming,
        distortion=distortion_of_state(state.m_distortionType, state.m_opticalDistCoeffs, focal_length, source),
    )


def _timing(state: _State, source: str) -> LineTiming:
    columns = (state.m_intTimeLines, state.m_intTimeStartTimes, state.m_intTimes)
    if len({len(column) for column in columns}) > 1:
        found = " and ".join(str(len(column)) for column in columns)
        raise InputError(f"{source}, m_intTimeLines, m_intTimeStartTimes, m_intTimes", found, "as many of each")
    lines, starts, periods = (np.array(column) for column in columns)
    return LineTiming(lines, starts + 0.5 * periods, periods)


# --- the tables


def _trajectory(state: _State, interior: InteriorOrientation, timing: LineTiming, source: str) -> FixedTrajectory:
    highest = _HIGHEST if state.m_platformFlag else _HIGHEST_OF_PLATFORM_0
    places = _EvenTable(
        _table(state.m_positions, 3, f"{source}, m_positions"), state.m_t0Ephem, state.m_dtEphem, highest
    )
    turns = _EvenTable(
        _table(state.m_quaternions, 4, f"{source}, m_quaternions"), state.m_t0Quat, state.m_dtQuat, highest
    )
    _require_samples(places.nodes, turns.nodes, source)
    edges, _ = timing.at(np.array([0.0, float(state.m_nLines)]))
    _, slope = interior.focal_plane(np.array([0.5 * state.m_nSamples]))
    angle = float(np.linalg.norm(slope[0])) / interior.focal_length
    flight = np.linalg.norm(places.nodes, axis=1).min() - min(state.m_majorAxis, state.m_minorAxis)

    def misplaced(table: PositionTable, times: Array) -> Array:
        off = np.linalg.norm(table.at(times)[0] - places.at(times), axis=1)
        return np.asarray(off / (angle * max(float(flight), 1.0)))

    def misturned(table: AttitudeTable, times: Array) -> Array:
        off = table.at(times)[0] - rotation.to_matrix(_to_camera(turns.at(times)))
        return np.asarray(np.linalg.norm(off, axis=(1, 2)) / angle)

    return FixedTrajectory(
        state.m_centerEphemerisTime,
        _dense(places, _placed, misplaced, edges, f"{source}, m_positions"),
        _dense(turns, _turned, misturned, edges, f"{source}, m_quaternions"),
    )


def _require_samples(places: Array, turns: Array, source: str) -> None:
    """Raise InputError for impossible positions, and quaternions far from unit length."""
    require_near_sun(places, f"{source}, m_positions")
    largest = np.abs(turns).max(axis=1)
    norms = np.linalg.norm(np.where(largest[:, None] < _NORMS[1], turns, 0.0), axis=1)
    for k in np.flatnonzero((norms < _NORMS[0]) | (norms > _NORMS[1]))[:1]:
        raise InputError(f"{source}, m_quaternions", f"{turns[k].tolist()} at [{k}]", "a unit quaternion")


@dataclass(frozen=True, slots=True, eq=False)
class _EvenTable:
    """Samples in even steps, and the polynomials between them."""

    nodes: Array
    """(n, k)"""
    first: float
    """s, time of the first."""
    step: float
    """s."""
    highest: int
    """Number of samples that a polynomial goes through, at the most."""

    def times(self, at: Array | Index) -> Array:
        """Times of places, in steps from the first sample."""
        return np.asarray(self.first + at * self.step, dtype=np.float64)

    def at(self, times: Array, moved: float = 0.0) -> Array:
        """Values (n, k) at times (n,); those `moved` by a part of a step along the very polynomials of these times."""
        where = (times - self.first) / self.step
        index = np.clip(np.trunc(where).astype(int), 0, len(self.nodes) - 2)
        beside = np.minimum(index, len(self.nodes) - 2 - index)
        orders = np.minimum(2 * np.minimum(beside, 3) + 2, self.highest)
        values = np.empty((times.size, self.nodes.shape[1]))
        for order, of_order in by_value(orders):
            offsets = np.arange(order) - (order // 2 - 1)
            distances = (where - index + moved)[of_order, None] - offsets
            factors = np.where(np.eye(order, dtype=bool), 1.0, distances[:, None, :])
            weights = np.prod(factors, axis=2) / np.prod(offsets[:, None] - offsets + np.eye(order), axis=1)
            values[of_order] = np.einsum("no,nok->nk", weights, self.nodes[index[of_order, None] + offsets])
        return values


def _placed(places: _EvenTable, times: Array) -> PositionTable:
    motion = (places.at(times, _STEP) - places.at(times, -_STEP)) / (2.0 * _STEP * places.step)
    return PositionTable(times, places.at(times), motion)


def _turned(turns: _EvenTable, times: Array) -> AttitudeTable:
    return AttitudeTable(times, _to_camera(turns.at(times)), np.eye(3))


def _dense(
    samples: _EvenTable, make: Callable[[_EvenTable, Array], Table], off: Callable[[Table, Array], Array],
    edges: Array, where: str,
) -> Table:  # fmt: skip
    """A table at the samples, and at as many times between them as its own interpolation needs to be near enough to
    usgscsm's while the image is taken, between its edges (2,). It begins just before and after each sample, for a path
    may turn sharply there.
    """
    times = samples.times(np.arange(len(samples.nodes) - 1)[:, None] + [_CORNER, 1.0 - _CORNER]).ravel()
    pixels = np.zeros(0)
    for _ in range(_HALVINGS):
        table = make(samples, times)
        inside = np.flatnonzero((times[1:] > edges[0]) & (times[:-1] < edges[1]))
        between = times[inside, None] + np.diff(times)[inside, None] * _BETWEEN
        pixels = off(table, between.ravel()).reshape(-1, _BETWEEN.size).max(axis=1, initial=0.0)
        poor = inside[~(pixels <= _TOLERANCE)]
        if not poor.size:
            return table
        times = np.sort(np.concatenate([times, 0.5 * (times[poor] + times[poor + 1])]))
        if times.size > _MOST:
            break
    found = f"{pixels.max():.2g} pixels lost by interpolation, as dense as samples may be"
    raise InputError(where, found, f"a path smooth enough to lose less than {_TOLERANCE:g}")


def _table(values: list[float], width: int, where: str) -> Array:
    if len(values) % width or len(values) < 2 * width:
        raise InputError(where, f"{len(values)} numbers", f"{width} for each of two samples or more")
    return np.array(values).reshape(-1, width)


def _to_camera(quaternions: Array) -> Array:
    """Unit quaternions (n, 4), scalar first, body-fixed to camera axes, of ones the other way, scalar last."""
    turned = quaternions[:, [3, 0, 1, 2]] * [1.0, -1.0, -1.0, -1.0]
    return unit_vectors(turned)

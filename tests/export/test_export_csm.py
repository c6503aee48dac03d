"""Support data and model states say what the solution says, by usgscsm's steps and by our reader."""

import json
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from networks import network, pair
from outside import refuses
from pass_files import block
from usgscsm import csm_differences, ground_to_image, isd_differences, state_differences

from mgsgraph.adjustment.adjust import adjust_network
from mgsgraph.adjustment.settings import SolverSettings
from mgsgraph.adjustment.solution import Solution, orientation_profile
from mgsgraph.case.reading import adjust, read_case
from mgsgraph.errors import InputError
from mgsgraph.export.csm import STATE, write_csm
from mgsgraph.export.spice_nodes import Reprojection, reprojection
from mgsgraph.files.support_data.isd import read_isd
from mgsgraph.files.support_data.model_state import read_model_state
from mgsgraph.geometry import rotation
from mgsgraph.geometry.body import geodetic
from mgsgraph.geometry.camera import RadialDistortion
from mgsgraph.geometry.image import LineTiming, PushbroomImage, fit_polynomials
from mgsgraph.geometry.records import Array
from mgsgraph.geometry.trajectory import AttitudeTable, Trajectory
from mgsgraph.simulation.case_files import json_text, support_data

LRO = Path(__file__).resolve().parents[2] / "scripts" / "cases" / "lro_nac_lola.toml"
DOUBLES = (
    "m_startingEphemerisTime", "m_centerEphemerisTime", "m_detectorSampleSumming", "m_detectorLineSumming",
    "m_startingDetectorSample", "m_startingDetectorLine", "m_focalLength", "m_zDirection", "m_detectorSampleOrigin",
    "m_detectorLineOrigin", "m_majorAxis", "m_minorAxis", "m_minElevation", "m_maxElevation", "m_dtEphem", "m_t0Ephem",
    "m_dtQuat", "m_t0Quat", "m_gsd", "m_flyingHeight", "m_halfSwath", "m_halfTime",
)  # fmt: skip
INTEGERS = (
    "m_nLines", "m_nSamples", "m_platformFlag", "m_ikCode", "m_distortionType", "m_numPositions", "m_numQuaternions",
)  # fmt: skip
TEXTS = (
    "m_modelName", "m_imageIdentifier", "m_sensorName", "m_platformName", "m_platformIdentifier", "m_sensorIdentifier",
    "m_logFile", "m_mgsgraph",
)  # fmt: skip
LISTS = {
    "m_intTimeLines": None, "m_intTimeStartTimes": None, "m_intTimes": None, "m_opticalDistCoeffs": None,
    "m_iTransS": 3, "m_iTransL": 3, "m_positions": None, "m_velocities": None, "m_quaternions": None,
    "m_currentParameterValue": 16, "m_referencePointXyz": 3, "m_sunPosition": 3, "m_sunVelocity": 3,
    "m_covariance": 256,
}  # fmt: skip
"""What populateModel asks for, by the type under which it does."""


def adjusted(change: Callable[[PushbroomImage], PushbroomImage] = lambda image: image) -> Solution:
    net = network(pair())
    return adjust_network(replace(net, images=tuple(change(image) for image in net.images)), SolverSettings())


@dataclass(frozen=True)
class Written:
    """A solution and its files."""

    solution: Solution
    folder: Path
    wanted: Reprojection


def written(solution: Solution, folder: Path) -> Written:
    write_csm(solution, folder)
    return Written(solution, folder, reprojection(solution))


@pytest.fixture(scope="module")
def tables(tmp_path_factory: pytest.TempPathFactory) -> Written:
    return written(adjusted(), tmp_path_factory.mktemp("tables"))


@pytest.fixture(scope="module")
def polynomials(tmp_path_factory: pytest.TempPathFactory) -> Written:
    return written(adjusted(lambda image: fit_polynomials(image)), tmp_path_factory.mktemp("polynomials"))


@pytest.fixture(params=["tables", "polynomials"])
def export(request: pytest.FixtureRequest) -> Written:
    found = request.getfixturevalue(request.param)
    assert isinstance(found, Written)
    return found


def support_data_in(folder: Path) -> Iterator[Path]:
    return (path for path in sorted(folder.glob("*.json")) if not path.name.endswith(STATE))


def state_of(export: Written, image: int = 0) -> dict[str, Any]:
    path = sorted(export.folder.glob("*_state.json"))[image]
    head, text = path.read_text().split("\n", 1)
    assert head == "USGS_ASTRO_LINE_SCANNER_SENSOR_MODEL"
    return dict(json.loads(text))


def orbit() -> dict[str, Any]:
    """usgscsm, tests/data/orbitalLineScan.json at 4ae52c5: 50 km above a sphere of 1000 km, 1.05 km/s."""
    along = 0.1 * np.arange(16) / 1050.0
    half, nothing = np.pi / 4.0 - 0.5 * along, np.zeros(16)
    return {
        "m_nLines": 16, "m_platformFlag": 1, "m_currentParameterValue": [0.0] * 16,
        "m_intTimeLines": [0.5], "m_intTimeStartTimes": [-0.85], "m_intTimes": [0.1],
        "m_focalLength": 50.0, "m_distortionType": 0, "m_opticalDistCoeffs": [0.0] * 3,
        "m_iTransL": [0.0, -10.0, 0.0], "m_iTransS": [0.0, 0.0, 10.0],
        "m_detectorLineOrigin": 0.5, "m_detectorSampleOrigin": 8.0,
        "m_startingDetectorLine": 1, "m_startingDetectorSample": 0,
        "m_detectorLineSumming": 1, "m_detectorSampleSumming": 1,
        "m_t0Ephem": -0.8, "m_dtEphem": 0.1, "m_t0Quat": -0.8, "m_dtQuat": 0.1, "m_numQuaternions": 64,
        "m_positions": (1.05e6 * np.column_stack([np.cos(along), nothing, -np.sin(along)])).ravel().tolist(),
        "m_quaternions": np.column_stack([nothing, -np.sin(half), nothing, np.cos(half)]).ravel().tolist(),
    }  # fmt: skip


# --- the reader-back


def test_reader_back_agrees_with_the_tests_of_usgscsm() -> None:
    """tests/LineScanCameraTests.cpp at the same commit, OrbitalLineScanSensorModel, Center."""
    centre = np.array([[999999.67040488799, 0.0, -811.90523782723039]])
    assert ground_to_image(orbit(), centre) == pytest.approx(np.array([[8.5, 8.0]]), abs=2e-5)


# --- the round trip


def test_every_measure_comes_back(export: Written) -> None:
    assert len(export.wanted.image) > 20
    assert isd_differences(export.folder, export.wanted).max() < 1e-3
    assert state_differences(export.folder, export.wanted).max() < 1e-3


def test_other_optics_and_lines_that_run_the_other_way_come_back(tmp_path: Path) -> None:
    def odd(image: PushbroomImage) -> PushbroomImage:
        to_pixel = image.interior.to_pixel * np.array([[1.0], [-1.0]])
        interior = replace(
            image.interior, to_pixel=to_pixel, first=np.array([0.3, 17.0]), distortion=RadialDistortion(1e-4, 0.3, 4.0)
        )
        return replace(image, interior=interior)

    solution = adjusted()
    images = tuple(odd(image) for image in solution.network.images)
    solution = replace(solution, network=replace(solution.network, images=images))
    export = written(solution, tmp_path)
    assert len(export.wanted.image) > 20
    assert csm_differences(tmp_path, export.wanted).max() < 1e-3


# above two seconds: a real pair is adjusted, written and read by usgscsm's equations
def test_real_images_come_back_with_what_their_own_support_data_say(shared_data: Path, tmp_path: Path) -> None:
    solution = adjust(read_case(LRO))
    paths = [shared_data / "lro_nac_lola" / f"lidarObservationImage{k}.isd" for k in (1, 2)]
    names = solution.network.image_names
    files = write_csm(solution, tmp_path, dict(zip(names, paths, strict=True)))
    wanted = reprojection(solution)
    assert csm_differences(tmp_path, wanted).max() < 1e-3
    before, after = json.loads(paths[0].read_text()), json.loads(files[0].read_text())
    for key in ("name_platform", "name_sensor", "sun_position", "naif_keywords", "line_scan_rate", "detector_center"):
        assert after[key] == before[key], key
    assert after["body_rotation"]["time_dependent_frames"] == [31001, 1]
    assert after["center_ephemeris_time"] == before["center_ephemeris_time"]
    # J2000: the refined camera is where the nominal one was but for the corrections
    nominal = np.array(before["instrument_position"]["positions"])
    place = np.array([np.interp(before["instrument_position"]["ephemeris_times"][3],
                                after["instrument_position"]["ephemeris_times"], axis)
                      for axis in np.transpose(after["instrument_position"]["positions"])])  # fmt: skip
    assert np.linalg.norm(place - nominal[3]) < 0.1
    for table in ("body_rotation", "instrument_pointing"):
        early = np.array(before[table]["angular_velocities"]).mean(axis=0)
        assert np.array(after[table]["angular_velocities"]).mean(axis=0) == pytest.approx(early, rel=2e-2)


def test_orientation_images_and_changing_line_rates_come_back(tmp_path: Path) -> None:
    solution = adjust_network(block().network, SolverSettings())
    assert solution.correction(0).nodes is not None
    assert solution.network.images[0].timing.first_lines.size == 3
    write_csm(solution, tmp_path, support=False)
    assert [path.name for path in tmp_path.glob("*.json") if not path.name.endswith(STATE)] == []
    assert csm_differences(tmp_path, reprojection(solution)).max() < 2e-3


def test_lines_right_after_a_change_are_held_by_states(tables: Written, tmp_path: Path) -> None:
    """usgscsm takes the segment before for half a line more, when it reads support data."""
    change = 400.0

    def two_rates(image: PushbroomImage) -> PushbroomImage:
        (start,), (period,) = image.timing.start_times, image.timing.periods
        starts = np.array([start, start + change * period])
        timing = LineTiming(np.array([0.0, change]), starts, np.array([period, 0.9 * period]))
        return replace(image, timing=timing)

    images = tuple(two_rates(image) for image in tables.solution.network.images)
    solution = replace(tables.solution, network=replace(tables.solution.network, images=images))
    refuses(r"line_scan_rate: 2 segments; after .* line 400\.5 .* model states", write_csm, solution, tmp_path)
    assert not list(tmp_path.iterdir())
    write_csm(solution, tmp_path, support=False)
    image, correction = solution.image(0), solution.correction(0)
    lines = change + np.array([-0.4, -0.1, 0.0, 0.1, 0.4, 0.6])
    places = np.column_stack([lines, np.full(6, 20.0)])
    points, _ = image.image_to_ground(lines, places[:, 1], 0.0, correction)
    wanted = Reprojection((image.name,) * 6, points, places, np.zeros(6))
    assert state_differences(tmp_path, wanted).max() < 1e-3


# --- what is in the files


def test_our_readers_get_the_adjusted_geometry(export: Written) -> None:
    for j, image in enumerate(export.solution.network.images):
        path, correction = export.folder / f"{image.name.replace('/', '_')}.json", export.solution.correction(j)
        assert json.loads(path.read_text())["image_identifier"] == image.name
        adjusted_one = export.solution.image(j)
        places = np.stack(np.meshgrid(np.linspace(0.0, image.lines, 21), np.linspace(0.0, image.samples, 5)), axis=-1)
        lines, samples = places.reshape(-1, 2).T
        ground, _ = adjusted_one.image_to_ground(lines, samples, 0.0, correction)
        back = read_isd(path, image.name)
        for read in (back, read_model_state(path.with_name(path.stem + STATE), image.name)):
            seen, _ = read.ground_to_image(ground, start=lines)
            assert np.abs(seen - np.column_stack([lines, samples])).max() < 1e-3
        mine, theirs = adjusted_one.pose(lines, correction), back.pose(lines)
        assert theirs.velocity == pytest.approx(mine.velocity, rel=1e-6, abs=1e-6)
        assert back.trajectory.spin == pytest.approx(image.trajectory.spin, abs=1e-10)


def test_states_have_every_key_in_the_type_that_is_asked_for(tables: Written) -> None:
    state = state_of(tables)
    assert set(state) == {*DOUBLES, *INTEGERS, *TEXTS, *LISTS, "m_parameterType"}
    assert [key for key in DOUBLES if type(state[key]) is not float] == []
    assert [key for key in INTEGERS if type(state[key]) is not int] == []
    assert [key for key in TEXTS if not isinstance(state[key], str)] == []
    assert state["m_parameterType"] == [2] * 16
    for key, size in LISTS.items():
        assert all(type(value) is float for value in state[key]), key
        assert size in (None, len(state[key])), key
    assert state["m_numPositions"] == len(state["m_positions"]) == len(state["m_velocities"])
    assert state["m_numQuaternions"] == len(state["m_quaternions"])


def test_angular_velocities_are_those_of_the_attitudes_about_inertial_axes(export: Written) -> None:
    """As SPICE and ALE have them: C(t + dt) = C(t) Exp(-w dt)."""
    isd = json.loads(next(support_data_in(export.folder)).read_text())
    for table in (isd["body_rotation"], isd["instrument_pointing"]):
        matrices, times = rotation.to_matrix(np.array(table["quaternions"])), np.array(table["ephemeris_times"])
        turned = rotation.logarithm(matrices[:-1].mT @ matrices[1:]) / np.diff(times)[:, None]
        stated = np.array(table["angular_velocities"])
        assert -turned == pytest.approx(0.5 * (stated[1:] + stated[:-1]), rel=1e-3, abs=1e-8)


def test_a_body_that_wobbles_comes_back(tables: Written, tmp_path: Path) -> None:
    def wobbling(image: PushbroomImage) -> PushbroomImage:
        assert isinstance(image.trajectory, Trajectory)
        times = np.linspace(*image.trajectory.coverage, 2001)
        wobble = 1e-5 * np.column_stack([np.sin(times), np.cos(times), np.sin(2.0 * times)])
        matrices = rotation.exponential(wobble) @ image.trajectory.body.at(times)[0]
        body = AttitudeTable(times, rotation.from_matrix(matrices), np.eye(3))
        return replace(image, trajectory=replace(image.trajectory, body=body))

    images = tuple(wobbling(image) for image in tables.solution.network.images)
    export = written(replace(tables.solution, network=replace(tables.solution.network, images=images)), tmp_path)
    assert len(export.wanted.image) > 20
    isd = json.loads(next(support_data_in(tmp_path)).read_text())
    assert len(isd["body_rotation"]["ephemeris_times"]) > 2
    assert csm_differences(tmp_path, export.wanted).max() < 1e-3


def test_scales_are_those_of_the_middle(tables: Written) -> None:
    state, image = state_of(tables), tables.solution.network.images[0]
    point = np.array(state["m_referencePointXyz"])
    assert ground_to_image(state, point[None])[0] == pytest.approx([image.lines / 2, image.samples / 2], abs=1e-3)
    camera = image.pose(np.array([image.lines / 2])).position[0]
    assert state["m_flyingHeight"] == pytest.approx(np.linalg.norm(camera - point), rel=1e-3)
    assert state["m_halfSwath"] == state["m_gsd"] * image.samples / 2
    assert state["m_halfTime"] == pytest.approx(image.lines * image.timing.periods[0] / 2)


def test_velocities_are_those_of_the_positions(export: Written) -> None:
    state = state_of(export)
    places, motions = (np.reshape(state[key], (-1, 3)) for key in ("m_positions", "m_velocities"))
    slope = (places[2:] - places[:-2]) / (2.0 * state["m_dtEphem"])
    assert motions[1:-1] == pytest.approx(slope, rel=1e-4, abs=1e-3)


def test_covariance_is_the_adjustments(tables: Written) -> None:
    """Of attitudes all of it, of positions but for a little of their quadratic terms."""
    state = state_of(tables)
    covariance = np.reshape(state["m_covariance"], (16, 16))
    assert np.linalg.eigvalsh(covariance).min() > -1e-9 * covariance.max()
    assert not covariance[15].any()
    profile = orientation_profile(tables.solution, 0)
    since = (profile.times - state["m_centerEphemerisTime"] - state["m_t0Quat"]) / state["m_halfTime"]
    per_metre = 1.0 / np.array([state["m_flyingHeight"], state["m_flyingHeight"], state["m_halfSwath"]])
    places = (profile.times - state["m_centerEphemerisTime"] - state["m_t0Ephem"]) / state["m_halfTime"]
    up = profile.position_after / np.linalg.norm(profile.position_after, axis=1)[:, None]
    aside = np.cross(up, np.gradient(profile.position_after, axis=0))
    aside /= np.linalg.norm(aside, axis=1)[:, None]
    axes = np.stack([np.cross(aside, up), aside, up], axis=2)  # in-track, cross-track, radial
    for k in range(since.size):
        design = np.hstack([np.diag(per_metre) * since[k] ** power for power in range(3)])
        sigma = np.sqrt(np.diagonal(design @ covariance[6:15, 6:15] @ design.T))
        assert sigma == pytest.approx(profile.rotation_sigma[k], rel=1e-3)
        design = np.hstack([np.eye(3), places[k] * np.eye(3)])
        sigma = np.sqrt(np.diagonal(axes[k] @ design @ covariance[:6, :6] @ design.T @ axes[k].T))
        assert sigma == pytest.approx(profile.position_sigma[k], rel=0.02)


def test_the_sun_is_taken_over_and_brought_to_body_axes(tables: Written, tmp_path: Path) -> None:
    solution = tables.solution
    image = solution.network.images[0]
    path = tmp_path / "original.isd"
    path.write_text(json_text(support_data(image)))
    out = tmp_path / "out"
    out.mkdir()
    isd_path, state_path = write_csm(solution, out, {image.name: path})[:2]
    isd, state = json.loads(isd_path.read_text()), json.loads(state_path.read_text().split("\n", 1)[1])
    assert isd["name_platform"] == state["m_platformName"] == "MARS GLOBAL SURVEYOR"
    assert read_isd(isd_path, "x").mission == read_model_state(state_path, "x").mission == "MGS"
    assert isd["naif_keywords"] == {"BODY_CODE": 499, "INS-94031_LIGHTTIME_CORRECTION": "NONE"}
    sun = 1e3 * np.array(isd["sun_position"]["positions"]).mean(axis=0)
    motion = 1e3 * np.array(isd["sun_position"]["velocities"][0])
    since = isd["center_ephemeris_time"] - image.trajectory.epoch + np.array([-1.0, 0.0, 1.0])
    matrices, _ = image.trajectory.body.at(since)  # type: ignore[attr-defined]
    before, now, after = (matrices[k] @ (sun + (k - 1) * motion) for k in range(3))
    assert state["m_sunPosition"] == pytest.approx(now, rel=1e-6)
    assert state["m_sunVelocity"] == pytest.approx((after - before) / 2.0, rel=1e-5)
    assert not any(state_of(tables)["m_sunPosition"])


def test_apparent_positions_are_called_geometric_afterwards(tables: Written, tmp_path: Path) -> None:
    image = tables.solution.network.images[0]
    said = support_data(image)
    said["naif_keywords"] = {"INS-1_LIGHTTIME_CORRECTION": "LT+S", "INS-1_FOCAL_LENGTH": 1.0, "INS-1_OD_K": [0.0]}
    (tmp_path / "original.isd").write_text(json_text(said))
    path = write_csm(tables.solution, tmp_path, {image.name: tmp_path / "original.isd"})[0]
    focal_length = pytest.approx(image.interior.focal_length * 1e3)
    assert json.loads(path.read_text())["naif_keywords"] == {
        "INS-1_LIGHTTIME_CORRECTION": "NONE", "INS-1_FOCAL_LENGTH": focal_length, "INS-1_OD_K": [0.0],
    }  # fmt: skip
    assert isd_differences(tmp_path, tables.wanted).max() < 1e-3


def test_polynomials_take_the_bodys_rotation_from_support_data(polynomials: Written, tmp_path: Path) -> None:
    """Without them the inertial axes are the body's own in the image's middle."""
    image, nominal = polynomials.solution.network.images[0], pair().images[0]
    (tmp_path / "original.isd").write_text(json_text(support_data(nominal)))
    path = write_csm(polynomials.solution, tmp_path, {image.name: tmp_path / "original.isd"})[0]
    apart = []
    for file in (path, polynomials.folder / path.name):
        back = read_isd(file, image.name).trajectory
        middle, _ = back.body.at(np.zeros(1))  # type: ignore[attr-defined]
        true, _ = nominal.trajectory.body.at(np.array([back.epoch - nominal.trajectory.epoch]))  # type: ignore[attr-defined]
        apart.append((np.abs(middle - true).max(), np.abs(middle - np.eye(3)).max()))
    assert apart[0][0] < 1e-9 < apart[0][1]
    assert apart[1][1] < 1e-9
    assert csm_differences(tmp_path, of_image(polynomials.wanted, image.name)).max() < 1e-3


def of_image(wanted: Reprojection, name: str) -> Reprojection:
    """Those of one image."""
    mine = np.flatnonzero(np.array(wanted.image) == name)
    return Reprojection((name,) * mine.size, wanted.points[mine], wanted.places[mine], wanted.times[mine])


def test_bytes_are_the_same_again(tables: Written, tmp_path: Path) -> None:
    for path in write_csm(tables.solution, tmp_path):
        assert path.read_bytes() == (tables.folder / path.name).read_bytes()


# --- what can't be held


class Undistorted:
    """Optics that nobody else knows."""

    def undistort(self, place: Array) -> tuple[Array, Array]:
        return place, np.broadcast_to(np.eye(2), (place.shape[0], 2, 2))


def test_what_the_format_lacks_is_refused_by_its_field(tables: Written, tmp_path: Path) -> None:
    def changed(**fields: Any) -> Solution:
        net = tables.solution.network
        images = tuple(replace(image, interior=replace(image.interior, **fields)) for image in net.images)
        return replace(tables.solution, network=replace(net, images=images))

    for solution, field in (
        (changed(distortion=Undistorted()), "optical_distortion: the model Undistorted"),
        (changed(sample_summing=1.5), r"detector_sample_summing: 1\.5"),
    ):
        refuses(field, write_csm, solution, tmp_path)
    net = tables.solution.network
    images = tuple(replace(image, name=name) for image, name in zip(net.images, ("a/b", "A:b"), strict=True))
    with pytest.raises(InputError, match="names that differ as file names"):
        write_csm(replace(tables.solution, network=replace(net, images=images)), tmp_path)
    assert not list(tmp_path.iterdir())


def test_support_data_of_another_image_are_refused(tables: Written, tmp_path: Path) -> None:
    image = tables.solution.network.images[0]
    path = tmp_path / "other.isd"
    path.write_text(json_text(support_data(image) | {"image_lines": image.lines + 1}))
    refuses("those of image", write_csm, tables.solution, tmp_path, {image.name: path})


def test_reference_heights_are_those_of_the_points(tmp_path: Path) -> None:
    solution = adjust_network(network(pair()), SolverSettings(), "pair")
    write_csm(solution, tmp_path)
    heights = geodetic(solution.places, solution.network.body)[:, 2]
    for path in support_data_in(tmp_path):
        said = json.loads(path.read_text())["reference_height"]
        assert said["minheight"] <= heights.min() - 100.0 < said["minheight"] + 1.0
        assert said["maxheight"] >= heights.max() + 100.0 > said["maxheight"] - 1.0

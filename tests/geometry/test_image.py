"""Image to ground and back, with derivatives, for simulated and real cameras."""

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from outside import refuses
from strategies import along

from mgsgraph.errors import EphemerisGap
from mgsgraph.files.support_data.isd import read_isd
from mgsgraph.geometry.image import LineTiming, PushbroomImage
from mgsgraph.geometry.orientation import Angles, OrientationCorrection
from mgsgraph.geometry.trajectory import AttitudeTable, PositionTable, Trajectory
from mgsgraph.simulation.orbit import MARS
from mgsgraph.simulation.pair import simulate_pair

PIXEL = 1e-6
"""pixels: what a round trip may lose."""
SIMULATED = simulate_pair().images
CORRECTION = np.array([[300.0, -200.0, 100.0, 0.003, -0.002, 0.02], [30.0, 20.0, -10.0, 2e-4, 3e-4, -1e-4],
                       [3.0, -2.0, 1.0, 3e-5, -2e-5, 1e-5]])  # fmt: skip
"""m and rad, ten times what is expected of MGS."""


@pytest.fixture(scope="module", params=["SIM/A", "SIM/B", "LRO 1", "LRO 2", "two line rates"])
def image(request: pytest.FixtureRequest) -> PushbroomImage:
    name = str(request.param)
    if name.startswith("LRO"):
        folder: Path = request.getfixturevalue("shared_data") / "lro_nac_lola"
        return read_isd(folder / f"lidarObservationImage{name[-1]}.isd", name)
    if name.startswith("SIM"):
        return SIMULATED[name == "SIM/B"]
    return two_rates(SIMULATED[1])


def two_rates(image: PushbroomImage) -> PushbroomImage:
    """The image with its second half taken at twice the line period (from the start 1.8 s before), as HRSC does."""
    period, half = float(image.timing.periods[0]), 0.5 * image.lines
    starts = np.array([-1.2 * half * period, -0.2 * half * period])
    timing = LineTiming(np.array([0.0, half]), starts, period * np.array([1.0, 1.2]))
    return replace(image, timing=timing)


def grid(image: PushbroomImage) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Lines, samples and heights (m) over the image and its edges."""
    axes = np.linspace(0, image.lines, 13), np.linspace(0, image.samples, 7), np.linspace(-5e3, 1e4, 4)
    line, sample, height = (axis.ravel() for axis in np.meshgrid(*axes))
    return line, sample, height


# --- there and back


@pytest.mark.parametrize("angles", [None, "camera", "opk-paper", "opk-peer"])
def test_image_to_ground_to_image(image: PushbroomImage, angles: Angles | None) -> None:
    correction = None if angles is None else OrientationCorrection(CORRECTION, angles)
    line, sample, height = grid(image)
    points, _ = image.image_to_ground(line, sample, height, correction)
    places, _ = image.ground_to_image(points, correction)

    assert np.abs(places - np.column_stack([line, sample])).max() < PIXEL


def test_the_guess_and_the_company_do_not_matter(image: PushbroomImage) -> None:
    """A point's place is the same alone, among points far off, and from any first guess of the line."""
    line, sample, height = grid(image)
    points, _ = image.image_to_ground(line, sample, height)
    lost = np.concatenate([points, -points[:5], 2.0 * points[:5]])
    start = np.linspace(-0.4, 1.4, lost.shape[0]) * image.lines
    places, _ = image.ground_to_image(lost, start=start)

    assert np.abs(places[: line.size] - np.column_stack([line, sample])).max() < PIXEL
    for k in range(0, line.size, 29):
        alone, _ = image.ground_to_image(points[[k]], start=np.array([-0.49 * image.lines]))
        assert np.abs(alone[0] - [line[k], sample[k]]).max() < PIXEL


def test_an_overshooting_first_step_is_taken_back() -> None:
    """Along a strongly turning camera Newton's first step leaves the search range; alone, the point came out NaN."""
    base = SIMULATED[0]
    correction = OrientationCorrection(np.array([[0.0] * 6, [0.0] * 4 + [0.0115, 0.0], [0.0] * 4 + [0.012, 0.0]]))
    for line in np.linspace(0.0, base.lines, 41):
        points, _ = base.image_to_ground(np.array([line]), np.array([500.0]), 0.0, correction)
        alone, _ = base.ground_to_image(points, correction)
        crowd, _ = base.ground_to_image(np.concatenate([points, points]), correction, np.array([2500.0, 2400.0]))
        np.testing.assert_allclose(alone[0], crowd[0], atol=PIXEL)


# --- derivatives


@pytest.mark.parametrize("angles", [None, "camera", "opk-peer"])
def test_derivatives_of_rays(image: PushbroomImage, angles: Angles | None) -> None:
    correction = None if angles is None else OrientationCorrection(CORRECTION, angles)
    line, sample = image.lines * np.array([0.11, 0.63, 0.93]), image.samples * np.array([0.2, 0.7, 0.9])
    line = away_from_knots(image, line)
    _, _, d_origins, d_directions = image.rays(line, sample, correction)

    for column, move in enumerate(np.eye(2)):
        step = 2.0
        for which, found in ((0, d_origins), (1, d_directions)):
            want = along(lambda s, m=move, w=which: image.rays(line + s * m[0], sample + s * m[1], correction)[w], step)
            # rays have metres of focal length, origins metres on the body
            np.testing.assert_allclose(found[:, :, column], want, rtol=0, atol=1e-8 if which == 0 else 1e-13)


@pytest.mark.parametrize("correction", [None, OrientationCorrection(CORRECTION)])
def test_sightlines_are_the_rays(image: PushbroomImage, correction: OrientationCorrection | None) -> None:
    places = image.lines * np.array([0.11, 0.63, 0.93]), image.samples * np.array([0.2, 0.7, 0.9])
    for found, want in zip(image.sightlines(*places, correction), image.rays(*places, correction)[:2], strict=True):
        np.testing.assert_array_equal(found, want)


def away_from_knots(image: PushbroomImage, lines: np.ndarray) -> np.ndarray:
    """Lines moved so that tables and timing do not bend within ten lines: there, differences see both sides."""
    knots = [image.timing.lines(table.times) for table in (image.trajectory.camera, image.trajectory.position)]
    bends = np.concatenate([*knots, image.timing.first_lines[1:]])
    while np.any(near := np.abs(lines[:, None] - bends).min(axis=1) < 10.0):
        lines = lines + 7.0 * near
    return lines


def test_derivatives_of_ground_points(image: PushbroomImage) -> None:
    line = away_from_knots(image, image.lines * np.array([0.11, 0.63, 0.93]))
    sample, height = image.samples * np.array([0.2, 0.7, 0.9]), np.array([-5e3, 0.0, 1e4])
    _, jacobian = image.image_to_ground(line, sample, height)

    for column, move in enumerate(np.eye(2)):
        want = along(lambda s, m=move: image.image_to_ground(line + s * m[0], sample + s * m[1], height)[0], 2.0)
        np.testing.assert_allclose(jacobian[:, :, column], want, rtol=0, atol=1e-7)


@pytest.mark.parametrize("angles", ["camera", "opk-paper", "opk-peer"])
def test_derivatives_of_image_places(image: PushbroomImage, angles: Angles | None) -> None:
    correction = None if angles is None else OrientationCorrection(CORRECTION, angles)
    line = away_from_knots(image, image.lines * np.array([0.11, 0.63, 0.93]))
    points, _ = image.image_to_ground(line, image.samples * np.array([0.2, 0.7, 0.9]), 1e3, correction)
    _, jacobian = image.ground_to_image(points, correction)

    for column, move in enumerate(np.eye(3)):
        want = along(lambda s, m=move: image.ground_to_image(points + s * m, correction)[0], 1.0)
        np.testing.assert_allclose(jacobian[:, :, column], want, rtol=0, atol=1e-7)


# --- what an image does not see


def test_points_behind_and_far_off_are_nan(image: PushbroomImage) -> None:
    middle = np.array([0.5 * image.lines])
    origin, direction, _, _ = image.rays(middle, np.array([0.5 * image.samples]))
    ahead, _ = image.image_to_ground(middle, np.array([0.5 * image.samples]))
    velocity = image.pose(middle).velocity
    points = np.concatenate([
        origin - 1e5 * direction,  # above the camera
        origin,  # in its perspective centre
        -ahead,  # the other side of the body is ahead, but many images away
        ahead + 1.3 * image.lines * velocity,  # beyond half an image before the first and after the last line
        ahead - 1.3 * image.lines * velocity,
        ahead + 3.0 * image.samples * image.image_to_ground(middle, np.zeros(1))[1][:, :, 1],  # far aside
        np.full((1, 3), np.nan),
        ahead,
    ])  # fmt: skip
    places, jacobian = image.ground_to_image(points)

    assert np.all(np.isnan(places[:2]))
    assert np.all(np.isnan(jacobian[:2]))
    assert np.all(np.isnan(places[3:7]))
    np.testing.assert_allclose(places[7], [middle[0], 0.5 * image.samples], atol=PIXEL)


def test_places_outside_the_image_are_given_up_to_half_its_length() -> None:
    """And up to twice its width."""
    image = SIMULATED[0]
    line, sample = np.array([-0.4, 1.4]) * image.lines, np.array([-2000.0, 3000.0])
    points, _ = image.image_to_ground(line, sample)

    np.testing.assert_allclose(image.ground_to_image(points)[0], np.column_stack([line, sample]), atol=PIXEL)


def test_rays_that_miss_the_body_are_nan() -> None:
    aside = OrientationCorrection(np.array([[0.0] * 3 + [1.4, 0.0, 0.0]]))
    points, jacobian = SIMULATED[0].image_to_ground(np.array([100.0, 200.0]), np.array([10.0, 500.0]), 0.0, aside)

    assert np.all(np.isnan(points))
    assert np.all(np.isnan(jacobian))


def test_a_camera_that_stands_still_sees_no_line() -> None:
    """Neither a traceback nor a place: nothing says on which line a point lies."""
    times, still = np.array([-10.0, 10.0]), np.zeros((2, 3))
    identity = np.tile([1.0, 0.0, 0.0, 0.0], (2, 1))
    trajectory = Trajectory(
        0.0, PositionTable(times, np.tile([0.0, 0.0, -4e6], (2, 1)), still), AttitudeTable(times, identity, np.eye(3)),
        AttitudeTable(times, identity, np.eye(3)),
    )  # fmt: skip
    image = replace(SIMULATED[0], trajectory=trajectory)
    places, jacobian = image.ground_to_image(np.array([[100.0, 100.0, -3.4e6], [0.0, 0.0, -3.4e6]]))

    assert np.all(np.isnan(places))
    assert np.all(np.isnan(jacobian))


# --- line timing

TWO = LineTiming(np.array([0.0, 100.0, 250.0]), np.array([-1.0, -0.8, 0.1]), np.array([0.002, 0.005, 0.001]))
"""The first two segments follow each other at once; after the second, 0.15 s pause."""


@given(st.floats(-50.0, 400.0))
def test_lines_of_times_of_lines(line: float) -> None:
    times, periods = TWO.at(np.array([line]))

    assert TWO.lines(times)[0] == pytest.approx(line, abs=1e-9)
    assert periods[0] == (0.002 if line < 100.0 else 0.005 if line < 250.0 else 0.001)


def test_segments_begin_on_their_line_and_time() -> None:
    times, periods = TWO.at(np.array([-1.0, 0.0, 99.5, 100.0, 249.0, 250.0, 251.0]))

    np.testing.assert_allclose(times, [-1.002, -1.0, -0.801, -0.8, -0.055, 0.1, 0.101], atol=1e-15)
    np.testing.assert_array_equal(periods, [0.002, 0.002, 0.002, 0.005, 0.005, 0.001, 0.001])


def test_a_time_in_a_pause_belongs_to_the_line_after_it() -> None:
    np.testing.assert_array_equal(TWO.lines(np.array([-0.04, 0.0, 0.09, 0.1])), 250.0)


@pytest.mark.parametrize(
    ("lines", "starts", "periods", "said"),
    [
        ([0.0], [0.0], [0.0], r"0\.0 s per line; expected positive periods"),
        ([0.0, 5.0], [1.0, 0.0], [1.0, 1.0], "times that go back"),
        ([0.0, 5.0], [0.0, 3.5], [1.0, 1.0], r"segment from line 0\.0: it ends 1\.500000 s after the next begins"),
    ],
)  # fmt: skip
def test_timings_that_can_not_be(lines: list[float], starts: list[float], periods: list[float], said: str) -> None:
    refuses(said, LineTiming, np.array(lines), np.array(starts), np.array(periods))


# --- records


def test_an_image_must_lie_in_its_tables() -> None:
    with pytest.raises(EphemerisGap, match=r"image SIM/A, first or last line: time"):
        replace(SIMULATED[0], lines=8000)


@given(st.floats(0.0, 5000.0))
def test_normalised_lines(line: float) -> None:
    image = SimpleNamespace(lines=5000)
    assert PushbroomImage.normalised(image, np.array([line]))[0] == pytest.approx(line / 2500.0 - 1.0)  # type: ignore[arg-type]
    assert SIMULATED[0].normalised_rate == 2.0 / 5000.0


def test_rates_are_per_line() -> None:
    """Ground speed of a nadir image times its line period: 3.05 m/ms x 1.446 ms."""
    _, jacobian = SIMULATED[0].image_to_ground(np.array([2500.0]), np.array([512.0]))

    assert np.linalg.norm(jacobian[0, :, 0]) == pytest.approx(3.05 * 1.446, rel=0.01)
    assert SIMULATED[0].body == MARS

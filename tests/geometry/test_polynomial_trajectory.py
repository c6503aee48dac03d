"""Orientation in polynomials: exact where the trajectory is one, rates by differences, misfit said in all units."""

from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mgs import kernels
from strategies import along

from mgsgraph.errors import EphemerisGap, InputError
from mgsgraph.files.labels.labelled_image import read_labelled_image
from mgsgraph.geometry import rotation
from mgsgraph.geometry.image import PolynomialTrajectory, PushbroomImage, fit_attitude, fit_polynomials
from mgsgraph.geometry.trajectory import AttitudeTable
from mgsgraph.simulation.pair import simulate_pair

ARCSEC = np.pi / 180.0 / 3600.0


def misfit(image: PushbroomImage, exchanged: PushbroomImage, count: int = 301) -> tuple[float, float, float]:
    """Largest differences over lines of an image: of positions in m, of attitudes in rad, and in pixels."""
    lines = np.linspace(0.0, image.lines, count)
    before, after = image.pose(lines), exchanged.pose(lines)
    turn = rotation.logarithm(after.matrix @ np.swapaxes(before.matrix, 1, 2))
    samples = np.full(count, 0.5 * image.samples)
    seen, _ = exchanged.ground_to_image(image.image_to_ground(lines, samples)[0], start=lines)
    moved = np.nan_to_num(seen - np.column_stack([lines, samples]))
    differences = after.position - before.position, turn, moved
    return tuple(float(np.abs(one).max()) for one in differences)  # type: ignore[return-value]


def trajectory(seed: int = 0, order: int = 2, kappa: float = 0.5) -> PolynomialTrajectory:
    """Orbit-like: 4e6 m away, 3 km/s, turning by up to a milliradian per second."""
    rng = np.random.default_rng(seed)
    position = np.zeros((order + 1, 3))
    position[0] = [3.77e6, 0.0, 2e5]
    position[1:] = rng.normal(0.0, 1.0, (order, 3)) * (1e4 * 1e-3 ** np.arange(order))[:, None]
    angles = np.zeros((order + 1, 3))
    angles[0] = [0.2, -1.4, kappa]
    angles[1:] = rng.normal(0.0, 1e-2, (order, 3)) * (0.1 ** np.arange(order))[:, None]
    return PolynomialTrajectory(-11224000.0, -4.0, 5.0, position, angles)


@settings(deadline=None)
@given(seed=st.integers(0, 1000), order=st.integers(1, 4), time=st.floats(-5.0, 6.0))
def test_rates_are_those_of_differences(seed: int, order: int, time: float) -> None:
    got = trajectory(seed, order)
    pose = got.pose(np.array([time]))
    velocity = along(lambda dt: got.pose(np.array([time + dt])).position[0], 0.01)
    np.testing.assert_allclose(pose.velocity[0], velocity, rtol=0, atol=1e-4)
    # dM = -[turning]x M
    slope = along(lambda dt: got.pose(np.array([time + dt])).matrix[0], 0.01)
    np.testing.assert_allclose(slope, -rotation.skew(pose.angular_rate[0]) @ pose.matrix[0], rtol=0, atol=1e-11)


@pytest.mark.parametrize("kappa", [0.5, np.pi - 1e-4])
@pytest.mark.parametrize("order", [1, 3])
def test_a_fit_of_its_own_order_changes_nothing(order: int, kappa: float) -> None:
    """Also where kappa goes through pi during the image."""
    true = trajectory(3, order, kappa)
    image = replace(simulate_pair().images[0], trajectory=true)
    exchanged = fit_polynomials(image, order)
    lines = np.linspace(0.0, image.lines, 7)
    want, got = image.pose(lines), exchanged.pose(lines)
    np.testing.assert_allclose(got.position, want.position, rtol=0, atol=1e-6)
    np.testing.assert_allclose(got.matrix, want.matrix, rtol=0, atol=1e-12)
    position, turn, _ = misfit(image, exchanged)
    assert turn < 1e-11
    assert position < 1e-6


def test_the_fit_gets_better_with_the_order() -> None:
    image = simulate_pair().images[0]
    misfits = [misfit(image, fit_polynomials(image, order)) for order in (0, 1, 2, 3)]
    for worse, better in pairwise(misfits):
        assert better[0] <= worse[0]
        assert better[1] <= worse[1] + 1e-15
    assert misfits[2][0] < 0.02
    assert misfits[2][2] < 0.02


def test_the_real_image(shared_data: Path) -> None:
    """M04/02852: a second order follows the CK's records every 4 s to about an arc second, a fifth of a pixel."""
    folder = shared_data / "mgs_moc_m0402852"
    image = read_labelled_image(folder / "m0402852_isis.lbl", kernels(shared_data))
    exchanged = fit_polynomials(image)
    position, turn, pixels = misfit(image, exchanged)
    assert position < 0.01
    assert turn < 2.0 * ARCSEC
    assert pixels < 0.3
    assert exchanged.trajectory.coverage == pytest.approx((-2.9620224, 2.9620224), abs=1e-7)


@pytest.mark.parametrize("turn", [0.5, np.pi - 1e-4])
def test_polynomials_of_the_attitude_are_those_of_its_records(turn: float) -> None:
    """Exact where the three angles are polynomials of the order, also through half a turn; positions stay, and so does
    the mount on the sampled frame.
    """
    image = simulate_pair().images[0]
    table, polynomial = image.trajectory.camera, np.polynomial.polynomial.polyval  # type: ignore[attr-defined]
    coefficients = np.array([[2.1, 1.8, turn], [-0.01, 0.02, 1e-3], [2e-4, 1e-4, 3e-4]])
    times = np.linspace(table.times[0], table.times[-1], 2001)
    middle, half = 0.5 * (times[0] + times[-1]), 0.5 * (times[-1] - times[0])
    quaternions = rotation.from_matrix(rotation.from_angles_313(polynomial((times - middle) / half, coefficients).T))
    mount = rotation.exponential(np.array([0.3, -0.2, 0.1]))
    planted = replace(image.trajectory, camera=AttitudeTable(times, rotation.continuous(quaternions), mount))
    exact = replace(image, trajectory=planted)
    exchanged = fit_attitude(exact, 2)
    at = np.linspace(0.0, image.lines, 9)
    seconds, pose = image.timing.at(at)[0], exchanged.pose(at)
    want = mount @ rotation.from_angles_313(polynomial((seconds - middle) / half, coefficients).T)
    np.testing.assert_allclose(pose.matrix @ planted.body.at(seconds)[0], want, rtol=0, atol=1e-9)
    np.testing.assert_array_equal(pose.position, image.pose(at).position)
    assert misfit(exact, exchanged)[1] < 1e-9
    assert misfit(exact, fit_attitude(exact, 1))[1] > 1e-5


def test_an_attitude_needs_records() -> None:
    image = simulate_pair().images[0]
    few = image.trajectory.camera.times.size  # type: ignore[attr-defined]
    with pytest.raises(InputError, match=f"order {few} through {few} records"):
        fit_attitude(image, few)
    with pytest.raises(InputError, match="polynomials already"):
        fit_attitude(fit_polynomials(image))


def test_times_outside_are_refused() -> None:
    got = trajectory()
    got.require(np.array([-4.0, 0.0, 5.0]), "image")
    got.require(np.array([5.4]), "image", slack=0.5)
    for time in (5.6, -4.6, np.nan):
        with pytest.raises(EphemerisGap, match="image X: time") as caught:
            got.require(np.array([0.0, time]), "image X", slack=0.5)
        assert (caught.value.start, caught.value.stop) == (-11224004.0, -11223995.0)


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"start": 5.0}, "start before stop"),
        ({"position": np.zeros((0, 3))}, "no coefficients"),
        ({"angles": np.zeros((3, 2))}, "angles: an array of shape"),
    ],
)
def test_broken_records_are_refused(changes: dict[str, object], said: str) -> None:
    with pytest.raises(InputError, match=said):
        replace(trajectory(), **changes)  # type: ignore[arg-type]


@pytest.mark.parametrize(("order", "samples"), [(-1, 31), (5, 5)])
def test_too_few_samples_are_refused(order: int, samples: int) -> None:
    with pytest.raises(InputError, match="expected more samples"):
        fit_polynomials(simulate_pair().images[0], order, samples)

"""Trajectories: exact at the tables, rates against differences, and against SPICE at real MGS and LRO kernels; in
polynomials exact where the trajectory is one, misfit said in all units.
"""

import json
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import spiceypy
from hypothesis import given, settings
from hypothesis import strategies as st
from mgs import kernels
from outside import refuses
from strategies import along, directions, rotation_vectors

from mgsgraph.errors import EphemerisGap
from mgsgraph.files.labels.labelled_image import read_labelled_image
from mgsgraph.files.support_data.isd import read_isd
from mgsgraph.geometry import rotation
from mgsgraph.geometry.image import PolynomialTrajectory, PushbroomImage, fit_attitude, fit_polynomials
from mgsgraph.geometry.trajectory import AttitudeTable, Pose, PositionTable, Trajectory
from mgsgraph.simulation.pair import simulate_pair
from mgsgraph.units import ARCSEC, KM, MM

NODES = np.array([-3.0, -2.2, -0.5, 0.4, 2.0, 3.1])
"""s, unevenly spaced."""

IDENTITY = np.tile([1.0, 0.0, 0.0, 0.0], (NODES.size, 1))


# --- position tables

cubics = st.lists(st.floats(-10.0, 10.0), min_size=12, max_size=12).map(lambda c: np.reshape(c, (4, 3)))


@given(cubics, st.lists(st.floats(-3.5, 3.6), min_size=1, max_size=5))
def test_hermite_reproduces_cubics(cubic: np.ndarray, times: list[float]) -> None:
    """Inside the intervals and beyond the ends alike, velocities too."""
    scale = np.array([3.8e6, 3.4e3, 1.0, 1e-3])[:, None]

    def at(t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        c = cubic * scale
        return t[:, None] ** np.arange(4) @ c, t[:, None] ** np.arange(3) @ (c[1:] * np.arange(1, 4)[:, None])

    position, velocity = PositionTable(NODES, *at(NODES)).at(np.array(times))
    want = at(np.array(times))
    np.testing.assert_allclose(position, want[0], rtol=0, atol=1e-6)
    np.testing.assert_allclose(velocity, want[1], rtol=0, atol=1e-6)


# --- attitude tables


@given(rotation_vectors(), directions, st.floats(-0.5, 0.5), st.floats(-3.2, 3.3), rotation_vectors())
def test_uniform_turning_is_exact(
    start: np.ndarray, axis: np.ndarray, rate: float, time: float, mount: np.ndarray
) -> None:
    """C(t) = Exp(-w t) C(0): a frame that turns with +w about its own axes."""
    angular_rate, constant = axis * rate, rotation.exponential(mount)
    nodes = rotation.exponential(-NODES[:, None] * angular_rate) @ rotation.exponential(start)
    table = AttitudeTable(NODES, rotation.from_matrix(nodes), constant)
    matrix, found = table.at(np.array([time]))

    np.testing.assert_allclose(
        matrix[0], constant @ rotation.exponential(-time * angular_rate) @ rotation.exponential(start), atol=1e-14
    )
    np.testing.assert_allclose(found[0], constant @ angular_rate, atol=1e-14)


@given(st.lists(rotation_vectors(), min_size=6, max_size=6), st.lists(st.booleans(), min_size=6, max_size=6))
def test_quaternions_may_change_sign(vectors: list[np.ndarray], flips: list[bool]) -> None:
    matrices = rotation.exponential(np.array(vectors))
    quaternions = rotation.from_matrix(matrices) * np.where(flips, -1.0, 1.0)[:, None]
    table = AttitudeTable(NODES, quaternions, np.eye(3))

    np.testing.assert_allclose(table.at(NODES)[0], matrices, atol=1e-14)


# --- both together


def assert_rates(trajectory: Trajectory, time: float) -> None:
    """Velocity and turning against differences of position and matrix within one interval of the tables."""
    def pose(t: float) -> Pose:
        return trajectory.pose(np.array([time + t]))

    now = pose(0.0)
    np.testing.assert_allclose(now.velocity[0], along(lambda t: pose(t).position[0], 0.01), atol=1e-5)
    turned = along(lambda t: pose(t).matrix[0], 0.01)
    np.testing.assert_allclose(-rotation.skew(now.angular_rate[0]) @ now.matrix[0], turned, atol=1e-11)


@given(st.floats(-0.4, -0.1), rotation_vectors(3.0), rotation_vectors(3.0), rotation_vectors(0.01))
def test_rates_against_differences(time: float, camera: np.ndarray, body: np.ndarray, turn: np.ndarray) -> None:
    """Everything turns: camera and body tables, behind constant rotations."""
    rng = np.random.default_rng(7)
    times = np.array([-0.5, 0.0, 0.5])
    position = PositionTable(times, 3.8e6 + 1e3 * rng.normal(size=(3, 3)), 3e3 * rng.normal(size=(3, 3)))
    steps = times[:, None]
    to_camera = rotation.from_matrix(rotation.exponential(steps * turn) @ rotation.exponential(camera))
    to_body = rotation.from_matrix(rotation.exponential(steps * turn[::-1]) @ rotation.exponential(body))
    trajectory = Trajectory(
        0.0, position, AttitudeTable(times, to_camera, rotation.exponential(body)),
        AttitudeTable(times, to_body, rotation.exponential(camera)),
    )  # fmt: skip
    assert_rates(trajectory, time)


def test_rates_of_the_simulated_and_the_real_images(shared_data: Path) -> None:
    paths = [shared_data / f"lro_nac_lola/lidarObservationImage{k}.isd" for k in (1, 2)]
    for image in (*simulate_pair().images, *(read_isd(path, path.stem) for path in paths)):
        for node in image.trajectory.camera.times[1:-2:5]:
            assert_rates(image.trajectory, node + 0.03)


def test_rates_are_scaled_to_lines() -> None:
    pose = simulate_pair().images[0].trajectory.pose(np.array([0.0, 0.1]))
    scaled = pose.scaled(np.array([0.001, 0.002]))

    np.testing.assert_allclose(scaled.velocity, pose.velocity * [[0.001], [0.002]])
    np.testing.assert_allclose(scaled.angular_rate, pose.angular_rate * [[0.001], [0.002]])
    np.testing.assert_array_equal(scaled.position, pose.position)
    np.testing.assert_array_equal(scaled.matrix, pose.matrix)


# --- the real LRO tables


@pytest.mark.parametrize("number", [1, 2])
def test_nodes_of_the_lro_tables(shared_data: Path, number: int) -> None:
    """Position and attitude at the files' own times, by the files' own quaternions and NAIF q2m, m and rad."""
    path = shared_data / f"lro_nac_lola/lidarObservationImage{number}.isd"
    isd, trajectory = json.loads(path.read_text()), read_isd(path, "LRO").trajectory
    body, pointing, place = isd["body_rotation"], isd["instrument_pointing"], isd["instrument_position"]
    to_me = np.reshape(body["constant_rotation"], (3, 3))

    ends = np.array(body["ephemeris_times"]) - trajectory.epoch
    pose = trajectory.pose(ends)
    for k, row in ((0, 0), (-1, -1)):
        to_body = to_me @ spiceypy.q2m(body["quaternions"][k])
        np.testing.assert_allclose(pose.position[k], to_body @ place["positions"][row] * KM, atol=1e-9)
        camera = spiceypy.q2m(pointing["quaternions"][row])
        np.testing.assert_allclose(pose.matrix[k], camera @ to_body.T, atol=1e-14)
        spin = to_me @ spiceypy.q2m(body["quaternions"][k]) @ body["angular_velocities"][k]
        found = trajectory.body.at(ends[[k]])[1][0]
        np.testing.assert_allclose(found, spin, atol=2e-3 * np.linalg.norm(spin))

    times = np.array(pointing["ephemeris_times"]) - trajectory.epoch
    want = np.array([spiceypy.q2m(quaternion) for quaternion in pointing["quaternions"]])
    np.testing.assert_allclose(trajectory.camera.at(times)[0], want, atol=1e-14)
    times = np.array(place["ephemeris_times"]) - trajectory.epoch
    position, velocity = trajectory.position.at(times)
    np.testing.assert_allclose(position, np.array(place["positions"]) * KM, atol=1e-9)
    np.testing.assert_allclose(velocity, np.array(place["velocities"]) * KM, atol=1e-9)


# --- MGS kernels against SPICE

_KERNELS = (
    "naif0012.tls", "MGS_SCLKSCET.00061.tsc", "pck00009.tpc", "moc20.ti", "m0402852.ale_1.bsp",
    "mgs_sc_map2_1_sliced_-94000.bc",
)  # fmt: skip

_MGS, _BUS = -94, -94000


@pytest.fixture
def mgs(shared_data: Path) -> Iterator[float]:
    """ET of MOC-NA image M04/02852, with the kernels around it loaded; the pool is left as found."""
    with spiceypy.KernelPool([str(shared_data / "mgs_moc_m0402852" / name) for name in _KERNELS]):
        yield spiceypy.utc2et("1999-08-24T14:12:13.6")


def mgs_states(times: np.ndarray) -> np.ndarray:
    return KM * np.array([spiceypy.spkezr("MGS", t, "J2000", "NONE", "MARS")[0] for t in times])


def mgs_attitude(times: np.ndarray) -> np.ndarray:
    return np.array([spiceypy.ckgp(_BUS, spiceypy.sce2c(_MGS, t), 0.0, "J2000")[0] for t in times])


def mars_rotation(times: np.ndarray) -> np.ndarray:
    return np.array([spiceypy.pxform("J2000", "IAU_MARS", t) for t in times])


def turned(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """rad, (n,), between two stacks of matrices."""
    return np.asarray(np.linalg.norm(rotation.logarithm(first @ second.mT), axis=-1))


@pytest.mark.parametrize("step", [0.1, 1.0])
def test_interpolated_mgs_positions_and_body_rotation_are_those_of_spice(mgs: float, step: float) -> None:
    times = np.arange(-10.0, 10.0 + 0.5 * step, step)
    asked = times[:-1] + 0.4 * step
    states, want = mgs_states(mgs + times), mgs_states(mgs + asked)
    position, velocity = PositionTable(times, states[:, :3], states[:, 3:]).at(asked)

    assert np.abs(position - want[:, :3]).max() < 0.01 * MM
    assert np.abs(velocity - want[:, 3:]).max() < 0.1 * MM
    table = AttitudeTable(times, rotation.from_matrix(mars_rotation(mgs + times)), np.eye(3))
    matrix, angular_rate = table.at(asked)
    assert turned(matrix, mars_rotation(mgs + asked)).max() < 1e-5 * ARCSEC
    spin = np.array([-spiceypy.xf2rav(spiceypy.sxform("IAU_MARS", "J2000", mgs + t))[1] for t in asked])
    np.testing.assert_allclose(angular_rate, spin, rtol=0, atol=1e-11)


def ck_nodes(path: str, start: float, stop: float) -> tuple[np.ndarray, np.ndarray]:
    """ET and quaternions of the records of a type 3 CK (NAIF ckgr03) between two times."""
    handle = spiceypy.dafopr(path)
    try:
        spiceypy.dafbfs(handle)
        assert spiceypy.daffna()
        segment = spiceypy.dafgs(5)
        records = np.array([spiceypy.ckgr03(handle, segment, k + 1) for k in range(spiceypy.cknr03(handle, segment))])
    finally:
        spiceypy.dafcls(handle)
    times = np.array([spiceypy.sct2e(_MGS, ticks) for ticks in records[:, 0]])
    inside = (times > start) & (times < stop)
    return times[inside], records[inside, 1:5]


def test_attitude_between_the_records_of_a_real_ck_is_that_of_spice(mgs: float, shared_data: Path) -> None:
    """The CK's own records as table, 60 s of them: the same interpolation, to a hundredth of a second of arc."""
    path = str(shared_data / "mgs_moc_m0402852" / _KERNELS[-1])
    times, quaternions = ck_nodes(path, mgs - 30.0, mgs + 30.0)
    assert times.size > 8
    table = AttitudeTable(times - mgs, quaternions, np.eye(3))

    for share in (0.0, 0.1, 0.5, 0.77):
        asked = times[:-1] + share * np.diff(times)
        matrix, angular_rate = table.at(asked - mgs)
        assert turned(matrix, mgs_attitude(asked)).max() < 0.001 * ARCSEC
    _, spin, _ = spiceypy.ckgpav(_BUS, spiceypy.sce2c(_MGS, asked[3]), 0.0, "J2000")
    assert np.linalg.norm(matrix[3].T @ angular_rate[3] - spin) < 0.01 * np.linalg.norm(spin)


# --- refusals


def trajectory_of(**times: np.ndarray) -> Trajectory:
    position, camera, body = (times.get(name, NODES) for name in ("position", "camera", "body"))
    return Trajectory(
        1e8, PositionTable(position, np.zeros((6, 3)), np.zeros((6, 3))),
        AttitudeTable(camera, IDENTITY, np.eye(3)), AttitudeTable(body, IDENTITY, np.eye(3)),
    )  # fmt: skip


def test_coverage_is_what_all_tables_share() -> None:
    assert trajectory_of(camera=NODES + 1.0, body=NODES - 0.5).coverage == (-2.0, 2.6)


def test_a_gap_carries_the_interval() -> None:
    trajectory = trajectory_of(camera=NODES + 1.0)
    trajectory.require(np.array([-2.0, 3.1]), "image A")
    trajectory.require(np.array([-2.4, 3.5]), "image A", slack=0.5)

    for time in (-2.001, 3.2):
        with pytest.raises(EphemerisGap, match=r"image A: time .* outside the tables; expected a time in") as caught:
            trajectory.require(np.array([0.0, time]), "image A")
        gap = caught.value
        assert (gap.time, gap.start, gap.stop) == (1e8 + time, 1e8 - 2.0, 1e8 + 3.1)


def test_tables_that_share_no_time_are_refused() -> None:
    refuses(r"one table begins 3\.900000 s after another has ended", trajectory_of, body=NODES + 10.0)


@pytest.mark.parametrize(
    ("times", "said"),
    [
        ([0.0], "1 samples; expected at least 2"), ([0.0, 1.0, 1.0], "in this order; expected increasing times"),
    ],
)  # fmt: skip
def test_times_increase(times: list[float], said: str) -> None:
    n = len(times)
    refuses(said, PositionTable, np.array(times), np.zeros((n, 3)), np.zeros((n, 3)))
    refuses(said, AttitudeTable, np.array(times), IDENTITY[:n], np.eye(3))


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"quaternions": IDENTITY * 1.001}, r"norm 1\.001000000 at \[0\]; expected unit quaternions"),
        ({"constant": np.diag([1.0, 1.0, -1.0])}, "no rotation"),
    ],
)
def test_attitude_tables_hold_rotations(change: dict[str, np.ndarray], said: str) -> None:
    fields = {"times": NODES, "quaternions": IDENTITY, "constant": np.eye(3)} | change
    refuses(said, AttitudeTable, **fields)


# --- polynomials


def misfit(image: PushbroomImage, exchanged: PushbroomImage, count: int = 301) -> tuple[float, float, float]:
    """Largest differences over lines of an image: of positions in m, of attitudes in rad, and in pixels."""
    lines = np.linspace(0.0, image.lines, count)
    before, after = image.pose(lines), exchanged.pose(lines)
    turn = rotation.logarithm(after.matrix @ before.matrix.mT)
    samples = np.full(count, 0.5 * image.samples)
    seen, _ = exchanged.ground_to_image(image.image_to_ground(lines, samples)[0], start=lines)
    moved = np.nan_to_num(seen - np.column_stack([lines, samples]))
    differences = after.position - before.position, turn, moved
    return tuple(float(np.abs(one).max()) for one in differences)  # type: ignore[return-value]


def polynomials(seed: int = 0, order: int = 2, kappa: float = 0.5) -> PolynomialTrajectory:
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
    got = polynomials(seed, order)
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
    true = polynomials(3, order, kappa)
    image = replace(simulate_pair().images[0], trajectory=true)
    exchanged = fit_polynomials(image, order)
    lines = np.linspace(0.0, image.lines, 7)
    want, got = image.pose(lines), exchanged.pose(lines)
    np.testing.assert_allclose(got.position, want.position, rtol=0, atol=1e-6)
    np.testing.assert_allclose(got.matrix, want.matrix, rtol=0, atol=1e-12)
    position, turn, _ = misfit(image, exchanged)
    assert turn < 1e-11
    assert position < 1e-6


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


def test_times_outside_are_refused() -> None:
    got = polynomials()
    got.require(np.array([-4.0, 0.0, 5.0]), "image")
    got.require(np.array([5.4]), "image", slack=0.5)
    for time in (5.6, -4.6, np.nan):
        with pytest.raises(EphemerisGap, match="image X: time") as caught:
            got.require(np.array([0.0, time]), "image X", slack=0.5)
        assert (caught.value.start, caught.value.stop) == (-11224004.0, -11223995.0)


@pytest.mark.parametrize(("order", "samples"), [(-1, 31), (5, 5)])
def test_too_few_samples_are_refused(order: int, samples: int) -> None:
    refuses("expected more samples", fit_polynomials, simulate_pair().images[0], order, samples)

"""Unknowns that images share: what they do, against instruments that truly are so; what is known of them after; and
what they do to the covariance of others where they are considered.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
from explicit_form import by_gtsam
from networks import network, pair, with_shift_and_surface, with_tilting_surface
from outside import refuses
from sharing import camera_clock, drawn, shared, with_all_kinds

from mgsgraph.adjustment.adjust import adjust_network
from mgsgraph.adjustment.incremental.incremental import IncrementalAdjustment
from mgsgraph.adjustment.settings import Angles, Line, SolverSettings
from mgsgraph.adjustment.solution import Solution, orientation_profile
from mgsgraph.analysis.reliability import reliability
from mgsgraph.geometry.body import east_north
from mgsgraph.geometry.image import PolynomialTrajectory, PushbroomImage, fit_polynomials
from mgsgraph.geometry.records import Array
from mgsgraph.geometry.trajectory import PositionTable
from mgsgraph.network import TERRAIN, Network, PointClass, ProfileShifts, SharedKind
from mgsgraph.network.parts import bundles, joined, select_points
from mgsgraph.network.shared import ground_shift, image_effect
from mgsgraph.simulation.camera import InstrumentErrors, as_taken
from mgsgraph.simulation.observations import NoiseSettings
from mgsgraph.simulation.pair import PairSettings, simulate_pair
from mgsgraph.simulation.site import bridge_image
from mgsgraph.units import DEG

SHARP = NoiseSettings(tie=1e-3, shot_image=1e-3, range=1e-3, ground=1e-2, position=1e-6, angle=1e-12)
"""Observations that leave no doubt, of images whose orientation is known."""


@cache
def everything(
    angles: Angles = "camera", line: Line = "predicted", held: tuple[bool, bool] = (False, False)
) -> Solution:
    """All kinds at once, a shifted profile and a terrain model beside them."""
    net = with_all_kinds(with_shift_and_surface(network(pair(), held=held)))
    return adjust_network(net, SolverSettings(angles=angles, line=line))


# --- the two forms


@pytest.mark.parametrize(
    ("angles", "line", "held"),
    [("camera", "predicted", (False, False)), ("opk-paper", "measured", (False, False)),
     ("camera", "predicted", (True, False)), ("camera", "predicted", (True, True))],
)  # fmt: skip
def test_bundle_is_explicit(angles: Angles, line: Line, held: tuple[bool, bool]) -> None:
    """Covariances to 1e-5 of the variances: the kernel takes what shared unknowns do for constant about a ray."""
    one = everything(angles, line, held)
    other = by_gtsam(one)
    assert one.converged
    assert one.cost_final == pytest.approx(other.cost_final, rel=1e-9)
    first, second = one.joint_covariance.dense(), other.joint_covariance.dense()
    sigmas = np.sqrt(np.diag(second))
    np.testing.assert_allclose(first / np.outer(sigmas, sigmas), second / np.outer(sigmas, sigmas), atol=1e-5)
    np.testing.assert_allclose(one.covariances, other.covariances, rtol=1e-5, atol=1e-6)
    for value, again, prior in zip(one.shared, other.shared, one.network.shared, strict=True):
        np.testing.assert_allclose(value, again, atol=1e-5 * prior.sigmas.min())
    np.testing.assert_allclose(one.shifts, other.shifts, atol=2e-3)  # of 100 m
    assert one.fit.unknowns == one.joint_covariance.columns + 3 * 18
    assert one.fit.squares == pytest.approx(2.0 * one.cost_final, rel=1e-6)


# --- what they do


@pytest.mark.parametrize(
    ("angles", "held"), [("camera", (False, False)), ("opk-paper", (False, True)), ("opk-peer", (False, False))]
)
def test_reprojected_points_leave_the_solutions_residuals(angles: Angles, held: tuple[bool, bool]) -> None:
    """To 1e-4 pixels, and 3e-5 of a residual: the kernel carries the pose in a straight line to the predicted line."""
    solution = everything(angles, "predicted", held)
    rays = solution.network.rays
    for j in range(2):
        mine = rays.image == j
        places, _ = solution.image(j).ground_to_image(
            solution.places[rays.point[mine]], solution.correction(j), rays.places[mine, 0]
        )
        np.testing.assert_allclose(rays.places[mine] - places, solution.residuals[mine], rtol=3e-5, atol=1e-4)


ARM = np.array([3.0, -5.0, 8.0])
"""m along the camera's axes."""


def drifting(net: Network) -> Network:
    """Shots given ever farther off, by 20 m west and 30 m south at the end, and as much the other way at the beginning;
    the images see where they truly are.
    """
    laser = np.flatnonzero(net.points.classes == PointClass.LASER)
    times = net.ranges.times[np.argsort(net.ranges.point)]
    along = 2.0 * (times - times.min()) / np.ptp(times) - 1.0
    places = net.points.places.copy()
    places[laser] -= along[:, None] * np.einsum("k,nkj->nj", [20.0, 30.0], east_north(places[laser]))
    shifts = ProfileShifts(("profile",), np.where(net.points.classes == PointClass.LASER, 0, -1), np.array([100.0]))
    return replace(net, points=replace(net.points, places=places), shifts=shifts)


def moved(net: Network, ways: Callable[[PushbroomImage, PositionTable], Array]) -> Network:
    """Images whose tables have positions as far off (n, 3) m as a function says, the other way."""
    images = []
    for image in net.images:
        table = image.trajectory.position  # type: ignore[attr-defined]
        nearer = replace(table, positions=table.positions - ways(image, table))
        images.append(replace(image, trajectory=replace(image.trajectory, position=nearer)))
    return replace(net, images=tuple(images))


def along_the_orbit(_: PushbroomImage, table: PositionTable) -> Array:
    """Ten metres up, twenty along and thirty to the left."""
    normal = np.cross(table.positions, table.velocities)
    axes = np.stack([table.positions, np.cross(normal, table.positions), normal])
    axes /= np.linalg.norm(axes, axis=2, keepdims=True)
    return np.einsum("k,knj->nj", [10.0, 20.0, 30.0], axes)


def along_the_camera(image: PushbroomImage, table: PositionTable) -> Array:
    matrices = image.trajectory.camera.at(table.times)[0]  # type: ignore[attr-defined]
    return np.einsum("a,nac->nc", ARM, matrices)


def camera_elsewhere(net: Network) -> Network:
    """At a lever arm from where its tables have it; footprints, without ranges, are where they are."""
    return replace(moved(net, along_the_camera), ranges=net.ranges.chosen(np.zeros(0, dtype=np.int64)))


def laser_elsewhere(net: Network) -> Network:
    """Its ranges begin at a lever arm from the trajectory, and footprints are given as far on the other side."""
    owner = net.images[0]
    assert not net.ranges.image.any()
    pose = owner.trajectory.pose(net.ranges.times - owner.trajectory.epoch)
    arm = np.einsum("a,nac->nc", ARM, pose.matrix)
    places, away = net.points.places.copy(), net.points.places[net.ranges.point] - pose.position
    longer = np.linalg.norm(away - arm, axis=1) - np.linalg.norm(away, axis=1)
    places[net.ranges.point] -= arm
    ranges = replace(net.ranges, values=net.ranges.values + longer)
    return replace(net, ranges=ranges, points=replace(net.points, places=places))


def slower(net: Network) -> Network:
    """Lines take a ten-thousandth longer, about the middle of each image, than its label says."""
    images = []
    for image in net.images:
        (middle,), (period,) = image.timing.at(np.array([0.5 * image.lines]))
        shorter = np.array([period / (1.0 + 1e-4)])
        timing = replace(image.timing, start_times=middle - 0.5 * image.lines * shorter, periods=shorter)
        images.append(replace(image, timing=timing))
    return replace(net, images=tuple(images))


CASES: list[tuple[SharedKind, Any, Sequence[float]]] = [
    (SharedKind.ATTITUDE_TIME, {"attitude_time": 0.04}, [0.04]),
    (SharedKind.POSITION_TIME, {"position_time": 0.01}, [0.01]),
    (SharedKind.CAMERA_BORESIGHT, {"camera_boresight": np.array([1e-5, -2e-5, 3e-5])}, [1e-5, -2e-5, 3e-5]),
    (SharedKind.ALTIMETER_BORESIGHT, {"altimeter_boresight": np.array([1e-4, -2e-4, 0.0])}, [1e-4, -2e-4, 0.0]),
    (SharedKind.RANGE_BIAS, {"range_bias": 7.0}, [7.0]),
    (SharedKind.FOCAL_LENGTH, {"focal_length": 0.01}, [0.01]),
    (SharedKind.PROFILE_DRIFT, drifting, [20.0, 30.0]),
    (SharedKind.ORBIT_POSITION, lambda net: moved(net, along_the_orbit), [10.0, 20.0, 30.0]),
    (SharedKind.CAMERA_LEVER_ARM, camera_elsewhere, ARM),
    (SharedKind.ALTIMETER_LEVER_ARM, laser_elsewhere, ARM),
    (SharedKind.LINE_RATE, slower, [1e-4]),
]


@pytest.mark.parametrize(("kind", "truly", "planted"), CASES, ids=[str(case[0]) for case in CASES])
def test_an_instrument_that_truly_is_so_is_found(kind: SharedKind, truly: Any, planted: Sequence[float]) -> None:
    """Tables read later, frames turned, rays of another focal length, orbits and cameras elsewhere: found within a ten-
    thousandth and what the noise leaves open, which is little; and no residual is left.
    """
    errors = InstrumentErrors() if callable(truly) else InstrumentErrors(**truly)
    net = network(simulate_pair(PairSettings(ties=30, shots=10, noise=SHARP), 2, errors), held=(True, True))
    net = truly(net) if callable(truly) else net
    largest = float(np.abs(planted).max())
    wanted = shared(kind, [0] if kind.of_laser else [0, 1], 100.0 * largest)
    angles: Angles = "opk-paper" if kind in (SharedKind.CAMERA_BORESIGHT, SharedKind.ATTITUDE_TIME) else "camera"
    solution = adjust_network(replace(net, shared=(wanted,)), SolverSettings(angles=angles))
    found, sigmas = solution.shared[0], np.sqrt(np.diag(solution.shared_covariance(0)))
    assert np.all(np.abs(found - planted) < 4.0 * sigmas + 1e-4 * largest)
    certain = sigmas < 0.03 * largest  # turning a beam about itself moves nothing
    assert np.count_nonzero(certain) >= min(kind.width, 2)
    assert np.abs(solution.residuals).max() < 0.02
    assert np.abs(solution.range_residuals).max(initial=0.0) < 0.05
    assert solution.cost_initial > 10.0 * solution.cost_final


def test_the_ground_moves_as_an_instrument_that_truly_is_so_moves_it() -> None:
    """327 m per second: where a camera with a late clock looks, level with the ellipsoid."""
    simulated, step = pair(), 1e-3
    for kind, errors in (
        (SharedKind.ATTITUDE_TIME, InstrumentErrors(attitude_time=step)),
        (SharedKind.POSITION_TIME, InstrumentErrors(position_time=step)),
    ):
        for image in simulated.images:
            middle = np.array([0.5 * image.lines]), np.array([0.5 * image.samples])
            before, after = (one.image_to_ground(*middle)[0][0] for one in (image, as_taken(image, errors)))
            np.testing.assert_allclose(ground_shift(image, kind)[0], (after - before) / step, rtol=1e-3, atol=0.5)
    nadir, held = (np.linalg.norm(ground_shift(image, SharedKind.ATTITUDE_TIME)) for image in simulated.images)
    assert 320.0 < nadir < 345.0
    assert held < 1.0


def test_the_body_turns_as_its_prime_meridian_says() -> None:
    """Mars: 350.89198226 degrees a day (IAU 2009), also where polynomials stand for the tables."""
    image = pair().images[0]
    polynomial = fit_polynomials(image)
    for trajectory in (image.trajectory, polynomial.trajectory):
        assert trajectory.spin is not None
        np.testing.assert_allclose(trajectory.spin, [0.0, 0.0, 350.89198226 * DEG / 86400.0], atol=1e-12)


# --- what is known of them


def test_sigmas_of_an_attitude_time_bias_are_honest() -> None:
    """Half a second of a nadir image against a held one, both loosely known, in ten draws."""
    found = [adjust_network(camera_clock(network(drawn(seed))), SolverSettings()) for seed in range(10)]
    errors = np.array([one.shared[0][0] - 0.5 for one in found])
    sigmas = np.array([float(np.sqrt(one.shared_covariance(0)[0, 0])) for one in found])
    assert np.all(sigmas < 0.6)  # of a second beforehand
    assert 2.16 < np.sum((errors / sigmas) ** 2) < 25.2  # chi-square with 10 degrees of freedom, 99%


def test_sigmas_of_whole_corrections() -> None:
    """The law of error propagation with derivatives by differences, from the dense covariance."""
    solution = everything()
    dense, net = solution.joint_covariance.dense(), solution.network
    sizes = [c.size for c in solution.coefficients] + [2] * len(net.shift_names) + [v.size for v in solution.shared]
    edges = np.cumsum([0, *sizes])

    def moved(column: int) -> Solution:
        vector = np.zeros(edges[-1])
        vector[column] = 1.0
        parts = np.split(vector, edges[1:-1])
        own = tuple(c + p.reshape(c.shape) for c, p in zip(solution.coefficients, parts, strict=False))
        felt = tuple(v + p for v, p in zip(solution.shared, parts[-len(solution.shared) :], strict=True))
        return replace(solution, coefficients=own, shared=felt)

    each = [np.concatenate([m.correction(j).coefficients.ravel() for j in (0, 1)])
            for m in (moved(column) for column in range(edges[-1]))]  # fmt: skip
    nominal = np.concatenate([solution.correction(j).coefficients.ravel() for j in (0, 1)])
    jacobian = np.array(each).T - nominal[:, None]
    expected = jacobian @ dense @ jacobian.T
    scale = np.sqrt(np.outer(np.diag(expected), np.diag(expected))) + 1e-300
    np.testing.assert_allclose(solution.correction_covariance(0, 1) / scale, expected / scale, atol=1e-6)
    first = solution.correction(0).coefficients.size
    at_middle = np.sqrt(np.diag(expected)[first : first + 3])  # constant terms are those of the middle line, u = 0
    np.testing.assert_allclose(orientation_profile(solution, 1, 3).position_sigma[1], at_middle, rtol=1e-6)


def test_a_profile_of_a_held_image_moves_with_its_boresight() -> None:
    solution = everything(held=(True, True))
    profile = orientation_profile(solution, 0, 5)
    assert np.all(profile.rotation_sigma > 0.0)
    expected = sum(
        image_effect(solution.network.images[0], one.kind, "camera")[:, 0, 3:].T @ value
        for one, value in zip(solution.network.shared, solution.shared, strict=True)
        if one.kind.moves_pose and one.sine is None
    )
    np.testing.assert_allclose(profile.rotation[2], expected + solution.shared[-1][::4], atol=1e-9)  # cosines


# --- what is refused


def adjusted_with(net: Network, kind: SharedKind) -> Solution:
    """An adjustment for what nothing of the second image feels."""
    return adjust_network(replace(net, shared=(shared(kind, [1]),)), SolverSettings())


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        (lambda net: adjusted_with(net, SharedKind.RANGE_BIAS), "no range of its images"),
        (lambda net: adjusted_with(net, SharedKind.ALTIMETER_BORESIGHT), "footprint with a range"),
        (lambda net: replace(net, shared=(shared(SharedKind.FOCAL_LENGTH, [2]),)), "image 2; expected 0 .. 1"),
        (lambda net: replace(net, shared=(shared(SharedKind.FOCAL_LENGTH, [0]),) * 2), "'focal length' twice"),
        (lambda net: shared(SharedKind.FOCAL_LENGTH, [0, 0]), "each once"),
        (lambda net: shared(SharedKind.FOCAL_LENGTH, [0], -1.0), "positive sigmas"),
        (lambda net: replace(shared(SharedKind.CAMERA_BORESIGHT, [0]), sigmas=np.ones(1)), "expected shape \\(3\\)"),
        (lambda net: bundles(with_all_kinds(net)), "adjusted image by image"),
        (lambda net: joined([with_all_kinds(net)]), "adjust such a case as a whole"),
        (lambda net: IncrementalAdjustment().add(with_all_kinds(net)), "adjusted image by image"),
    ],
)  # fmt: skip
def test_one_clear_line(changed: object, message: str) -> None:
    assert callable(changed)
    refuses(message, changed, network(pair()))


def test_a_time_bias_needs_to_know_how_the_body_turns() -> None:
    net = network(pair())
    polynomial = fit_polynomials(net.images[0])
    assert isinstance(polynomial.trajectory, PolynomialTrajectory)
    silent = replace(polynomial, trajectory=replace(polynomial.trajectory, spin=None))
    still: Network = replace(net, images=(silent, net.images[1]))
    adjust_network(replace(still, shared=(shared(SharedKind.CAMERA_BORESIGHT, [0, 1]),)), SolverSettings())
    refuses("how fast the body turns", adjust_network, camera_clock(still), SolverSettings())


def test_no_polynomial_describes_the_velocity_of_eight_revolutions() -> None:
    refuses("no polynomial of degree 5", image_effect, bridge_image(), SharedKind.POSITION_TIME, "camera")


# --- considered ones: held at zero, their a-priori covariance carried into all else (Schmidt 1966)


SHIFT = 60.0
"""m, a-priori sigma of the profile's shift."""
EXACT = SolverSettings(cost_tolerance=1e-15, step_tolerance=1e-9)


@cache
def with_profile() -> Network:
    """The pair with a laser profile of unknown shift."""
    return replace(with_shift_and_surface(network(pair()), SHIFT), surface=None)


def estimates(solution: Solution) -> Array:
    """All that is estimated of the orientation and of the points, m and rad."""
    return np.concatenate([*(one.ravel() for one in solution.coefficients), solution.places.ravel()])


def displaced(net: Network, shift: Array) -> Network:
    """The network without an unknown shift, its footprints elsewhere by (2,) m east and north."""
    laser = net.points.classes == PointClass.LASER
    moved = np.einsum("k,nkj->nj", shift, east_north(net.points.places[laser]))
    places = net.points.places.copy()
    places[laser] += moved
    return replace(net, shifts=None, points=replace(net.points, places=places))


def test_the_covariance_is_that_of_estimates_that_a_shift_displaces() -> None:
    """cov = cov without the unknown + S C S', S by adjusting data that truly are displaced, which shares no line of
    code with the covariance.
    """
    net = with_profile()
    found = adjust_network(replace(net, considered=("profile",)), EXACT)
    plain = adjust_network(displaced(net, np.zeros(2)), EXACT)
    assert estimates(found) == pytest.approx(estimates(plain), abs=1e-4)
    assert np.abs(found.shifts).max() < 1e-4
    step = 20.0
    slopes = np.stack([
        (estimates(adjust_network(displaced(net, step * way), EXACT))
         - estimates(adjust_network(displaced(net, -step * way), EXACT))) / (2.0 * step)
        for way in np.eye(2)
    ])  # fmt: skip
    columns, n = found.joint_covariance.columns - 2, len(net.points)
    of_points = slopes[:, columns:].reshape(2, n, 3)
    added = SHIFT**2 * np.einsum("kni,knj->nij", of_points, of_points)
    size = np.sqrt(np.trace(added, axis1=1, axis2=2))[:, None, None]
    assert size.max() > 10.0
    np.testing.assert_allclose((found.covariances - plain.covariances) / size**2, added / size**2, atol=2e-3)
    images = range(len(net.images))
    more = found.joint_covariance.of(images) - plain.joint_covariance.of(images)
    expected = SHIFT**2 * slopes[:, :columns].T @ slopes[:, :columns]
    units = np.sqrt(np.diagonal(plain.joint_covariance.of(images)))
    np.testing.assert_allclose(more / units / units[:, None], expected / units / units[:, None], atol=2e-3)
    assert found.shift_covariance(0) == pytest.approx(SHIFT**2 * np.eye(2), rel=1e-6, abs=1e-3)


def test_redundancy_is_the_estimators() -> None:
    """What is carried of an unknown doesn't change which blunders show: as where the shift is known."""
    net = with_profile()
    found = reliability(adjust_network(replace(net, considered=("profile",)), EXACT)).measures
    plain = reliability(adjust_network(displaced(net, np.zeros(2)), EXACT)).measures
    assert found.redundancy.min() > -1e-6
    assert found.redundancy.size == plain.redundancy.size + 2  # the shift's priors, which nothing controls
    assert sorted(found.redundancy)[2:] == pytest.approx(sorted(plain.redundancy), abs=1e-5)
    assert found.redundancy.sum() == pytest.approx(plain.redundancy.sum(), abs=1e-4)


@pytest.mark.parametrize("considered", [("profile",), (TERRAIN,), ("profile", TERRAIN, "camera boresight")])
def test_both_forms_agree(considered: tuple[str, ...]) -> None:
    """The bundle form and GTSAM's own marginals; a terrain model's height and tilts are estimated beside its shift."""
    net = with_tilting_surface(network(pair()))
    boresight = shared(SharedKind.CAMERA_BORESIGHT, [0, 1])
    net = replace(net, shared=(boresight,), considered=considered)
    bundle = adjust_network(net, EXACT)
    explicit = by_gtsam(bundle)
    assert bundle.cost_final == pytest.approx(explicit.cost_final, rel=1e-9)
    sigmas = bundle.joint_covariance.sigmas
    dense = [one.joint_covariance.dense() / sigmas / sigmas[:, None] for one in (bundle, explicit)]
    np.testing.assert_allclose(dense[0], dense[1], atol=1e-6)
    np.testing.assert_allclose(bundle.sigmas, explicit.sigmas, rtol=1e-6)
    last = len(net.shift_names) - 1
    before = SHIFT if considered == ("profile",) else 150.0
    spread = bundle.shift_spread(0 if considered == ("profile",) else last)[:2, :2]
    assert spread == pytest.approx(before**2 * np.eye(2), rel=1e-6, abs=1e-2)


def test_parts_of_a_network_keep_what_they_consider() -> None:
    net = replace(with_shift_and_surface(network(pair()), SHIFT), considered=("profile", TERRAIN))
    ties, shots = (np.flatnonzero(net.points.classes == kind) for kind in (PointClass.TIE, PointClass.LASER))
    parts = select_points(net, ties), select_points(net, shots)
    assert [one.considered for one in parts] == [(TERRAIN,), ("profile",)]
    assert set(joined(parts).considered) == {"profile", TERRAIN}
    refuses("profile", joined, [select_points(net, shots[:2]), select_points(replace(net, considered=()), shots[2:])])


def test_names_of_no_unknowns_are_refused() -> None:
    refuses("profile", replace, with_profile(), considered=("nothing",))
    refuses("considered", replace, with_profile(), considered=("profile", "profile"))
    tilting = with_tilting_surface(network(pair()))
    assert tilting.surface is not None
    refuses("horizontal", replace, tilting, surface=replace(tilting.surface, shift_sigma=0.0), considered=(TERRAIN,))

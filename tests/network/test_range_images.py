"""Laser shots and images: the trajectory of a pass carries them, between its images, too; where they are in images,
against the truth of a simulated pair, and what the discrepancy must show.
"""

from collections.abc import Callable
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from networks import pair
from outside import refuses
from rigs import PRIOR, TURN, mounted

from mgsgraph.adjustment.adjust import adjust_network
from mgsgraph.adjustment.settings import SolverSettings
from mgsgraph.case.assembly import Parts
from mgsgraph.case.schema import ShotsInput
from mgsgraph.errors import InputError
from mgsgraph.files.networks.tie_points import TiePoints
from mgsgraph.geometry.altimetry import AltimeterShots
from mgsgraph.geometry.image import LineTiming, PushbroomImage
from mgsgraph.geometry.orientation import OrientationCorrection, evenly_spaced
from mgsgraph.network import Network, Pass, PointClass, SharedKind
from mgsgraph.network.footprints import (
    Registration,
    crossings,
    discrepancy,
    footprints_in_images,
    misregistration,
)
from mgsgraph.network.joining import mountings
from mgsgraph.network.observations import Members, carriers, shots_carried
from mgsgraph.simulation.ground import sine_height
from mgsgraph.simulation.observations import NoiseSettings
from mgsgraph.simulation.pair import SimulatedPair

SHOTS = 40


def part(image: PushbroomImage, name: str, first: int, lines: int) -> PushbroomImage:
    """Some lines of an image as an image of its own, with the whole trajectory."""
    start, period = image.timing.at(np.array([float(first)]))
    return replace(image, name=name, lines=lines, timing=LineTiming(np.zeros(1), start, period))


@cache
def images() -> tuple[PushbroomImage, ...]:
    """L and R together, after a pause L again, of one pass; and an image of another."""
    whole, other = pair(ties=20, shots=8).images
    left = part(whole, "L1", 0, 2000)
    return left, mounted(left, "R1", TURN), part(whole, "L2", 3000, 2000), other


@cache
def shots() -> AltimeterShots:
    """Along the axis of L from its first to its last line, true places and ranges, 200 m nearer than nominal."""
    whole, correction = pair(ties=20, shots=8).images[0], pair(ties=20, shots=8).true_corrections[0]
    lines = np.linspace(1.0, 4999.0, SHOTS)
    points, _ = whole.image_to_ground(lines, np.full(SHOTS, 500.0), 0.0, correction)
    unknown, numbers = np.full(SHOTS, np.nan), np.arange(1, SHOTS + 1)
    return AltimeterShots(
        "profile.tab", np.full(SHOTS, 1), numbers, np.ones(SHOTS, dtype=int),
        whole.timing.at(lines)[0] + whole.trajectory.epoch, points, unknown,
        np.linalg.norm(points - whole.pose(lines, correction).position, axis=1), unknown, np.full((SHOTS, 3), np.nan),
        unknown, np.ones(SHOTS, dtype=bool), np.zeros(SHOTS, dtype=int), unknown, unknown,
    )  # fmt: skip


def found() -> Registration:
    return footprints_in_images(images(), shots())


def members() -> Members:
    return Members((0, 1, 2), mountings(images()[:3], "rig"))


def test_the_trajectory_of_a_pass_carries_shots_between_its_images() -> None:
    everything = np.ones(SHOTS, dtype=bool)
    owners = carriers(found(), everything, [members()], "")
    assert np.all(np.isin(owners, [0, 2]))  # one camera: not R
    between = ~np.any(found().simultaneous, axis=0)
    assert between.sum() > 5
    assert np.all(owners[found().simultaneous[0]] == 0)
    assert np.all(owners[found().simultaneous[2]] == 2)
    taken = shots_carried(found(), owners, [members()])
    assert np.all(taken[between])
    assert np.all(taken == (between | np.any(found().inside[:3], axis=0)))


def test_images_of_several_trajectories_are_refused() -> None:
    everything = np.ones(SHOTS, dtype=bool)
    with pytest.raises(InputError, match="shots simultaneous with L1 and R1 and L2; expected images of one pass"):
        carriers(found(), everything, [], "name it")
    refuses("images of one pass", carriers, found(), everything, [Members((0, 1))], "")


def test_an_image_on_its_own_carries_its_own_shots_alone() -> None:
    alone = footprints_in_images([images()[i] for i in (0, 3)], shots())
    owners = carriers(alone, np.ones(SHOTS, dtype=bool), [], "")
    assert np.array_equal(owners, np.where(alone.simultaneous[0], 0, -1))
    assert np.array_equal(shots_carried(alone, owners, []), alone.inside[0] & alone.simultaneous[0])


def network() -> Network:
    """The shots on the pass, with sigmas as of a case."""
    parts = Parts(images())
    parts.passes = [members()]
    parts.add_shots(shots(), ShotsInput("profile.tab", beam_sigma_mrad=0.1, image_rows="back-projected"), frozenset())
    first = images()[0]
    epoch, (start, stop) = first.trajectory.epoch, pair(ties=20, shots=8).images[0].timing.at(np.array([0.0, 5e3]))[0]
    net = parts.network((pair().settings.noise.prior,) * 4, np.zeros(4, dtype=bool))
    one = Pass("pass", np.arange(3), evenly_spaced("lagrange", epoch, (start, stop), 1.0), PRIOR, members().axes)
    return replace(net, passes=(one,), shared=tuple(parts.shared))


def test_ranges_between_images_feel_the_orientation_images() -> None:
    net = network()
    (beam,) = net.shared
    assert beam.kind is SharedKind.ALTIMETER_BORESIGHT
    assert beam.images.tolist() == [0, 2]
    solution = adjust_network(net, SolverSettings())
    between = np.flatnonzero(~np.any(found().simultaneous, axis=0))
    times = shots().times[between]
    rows = [net.points.ids.index(f"profile:{shots().ids[k]}") for k in between.tolist()]
    mine = [int(np.flatnonzero(net.ranges.point == row)[0]) for row in rows]
    nodes, trajectory = net.passes[0].nodes, images()[0].trajectory
    basis, _ = nodes.dense(times - nodes.epoch, nodes.epoch)
    camera = trajectory.pose(times - trajectory.epoch).position + (basis @ solution.nodes[0])[:, :3]
    ranges = np.linalg.norm(solution.places[rows] - camera, axis=1)
    np.testing.assert_allclose(solution.range_residuals[mine], shots().ranges[between] - ranges, atol=1e-3)
    moved = (basis @ solution.nodes[0])[:, :3]
    assert np.linalg.norm(moved, axis=1).min() > 1.0
    before = np.abs(solution.range_residuals_before[mine]).min()
    assert np.abs(solution.range_residuals[mine]).max() < 0.3 * before
    assert np.all(net.points.classes == PointClass.LASER)


# --- where shots are in images, and what tie points say of it

SHIFT = 6e-4
"""rad of pitch: 228 m along the flight from 380 km."""


def made_pair(tie: float = 1.0) -> SimulatedPair:
    return pair(ties=150, shots=40, seed=5, noise=NoiseSettings(tie=tie))


@cache
def true_shots() -> AltimeterShots:
    """The pair's true footprints as shots of the first image's orbit."""
    drawn = made_pair()
    n = drawn.true_footprints.shape[0]
    nan = np.full(n, np.nan)
    return AltimeterShots(
        source="simulated", orbits=np.full(n, 18933), frames=np.arange(1, n + 1), shots=np.ones(n),
        times=drawn.laser.times, footprints=drawn.true_footprints, areoid_radii=nan, ranges=drawn.laser.ranges,
        range_corrections=nan, spacecraft=np.full((n, 3), np.nan), off_nadir=nan, ground=np.ones(n, dtype=bool),
        channels=np.ones(n), clocks=nan, pulses=nan,
    )


def true_places(drawn: SimulatedPair, image: int) -> np.ndarray:
    return drawn.images[image].ground_to_image(drawn.true_footprints, drawn.true_corrections[image])[0]


def pitched(correction: OrientationCorrection, pitch: float) -> OrientationCorrection:
    """The correction with one more turn about the camera's y axis, which lies across the flight."""
    coefficients = np.array(correction.coefficients)
    coefficients[0, 4] += pitch
    return replace(correction, coefficients=coefficients)


def test_every_footprint_in_every_image() -> None:
    drawn = made_pair()
    found = footprints_in_images(drawn.images, true_shots(), drawn.true_corrections)
    for j in range(2):
        np.testing.assert_allclose(found.places[j], true_places(drawn, j), rtol=0, atol=1e-6)
    assert found.inside.all()
    assert found.simultaneous.tolist() == [[True] * 40, [False] * 40]
    first, second = crossings(found)
    assert (first.simultaneous, first.inside, first.profile) == (40, 40, "18933")
    assert (second.simultaneous, second.inside) == (0, 40)


def test_profiles_are_told_apart_and_the_far_side_is_hidden() -> None:
    drawn, own = made_pair(), true_shots()
    half = np.arange(40) < 20
    mixed = replace(
        own, orbits=np.where(half, 18933, 20001), times=np.where(half, own.times, own.times + 1e6),
        footprints=np.where((np.arange(40) < 5)[:, None], -own.footprints, own.footprints),
    )
    found = footprints_in_images(drawn.images[:1], mixed)

    assert not found.inside[0, :5].any()
    assert np.isnan(found.places[0, :5]).all()
    profiles = [(one.profile, one.simultaneous, one.inside, one.shots) for one in crossings(found)]
    assert profiles == [("18933", 20, 15, 20), ("20001", 0, 20, 20)]


def test_an_image_that_sees_the_limb_doesnt_see_through_the_body() -> None:
    drawn, own = made_pair(), true_shots()
    image = drawn.images[0]
    wide = replace(image, interior=replace(image.interior, focal_length=0.005))
    far = replace(own, footprints=np.concatenate([-own.footprints[:20], own.footprints[20:]]))

    assert footprints_in_images([wide], far).inside[0].tolist() == [False] * 20 + [True] * 20


def test_misregistration_against_truth_along_the_flight() -> None:
    drawn = made_pair()
    wrong = pitched(drawn.true_corrections[0], SHIFT)
    found = misregistration(drawn.images[0], true_shots(), true_places(drawn, 0), wrong)
    right = misregistration(drawn.images[0], true_shots(), true_places(drawn, 0), drawn.true_corrections[0])

    np.testing.assert_allclose(np.abs(found.metres[:, 0]), 228.0, rtol=0.02)
    # a turn moves the place along the inertial flight; over the turning body the ground track runs 4.5 deg off it
    assert np.abs(found.metres[:, 1]).max() < 228.0 * np.tan(np.radians(5.0))
    scale = found.metres[0, 0] / found.pixels[0, 0]
    np.testing.assert_allclose(found.pixels[:, 0] * scale, found.metres[:, 0], rtol=0.02)
    np.testing.assert_allclose(found.spacings, found.metres / true_shots().spacing, equal_nan=True)
    np.testing.assert_allclose(right.pixels, 0.0, atol=1e-6)


def test_metres_are_those_between_the_ground_points() -> None:
    """A footprint moved by known metres along the flight and to the right moves its place by as much."""
    drawn, own = made_pair(), true_shots()
    image, correction = drawn.images[0], drawn.true_corrections[0]
    places = true_places(drawn, 0)
    up = own.footprints / np.linalg.norm(own.footprints, axis=1, keepdims=True)
    flight = image.pose(places[:, 0], correction).velocity
    flight -= np.einsum("ni,ni->n", flight, up)[:, None] * up
    flight /= np.linalg.norm(flight, axis=1, keepdims=True)
    moved = own.footprints + 30.0 * flight + 20.0 * np.cross(flight, up)
    found = misregistration(image, own, places, correction, moved)

    np.testing.assert_allclose(found.metres, np.broadcast_to([30.0, 20.0], (40, 2)), rtol=0, atol=0.1)


def expected_discrepancy(drawn: SimulatedPair, corrections: tuple[OrientationCorrection, ...]) -> np.ndarray:
    """What the ties must tell: misplacement in the second image minus that of the first, carried over the true ground.

    The place of the footprint's projection into the first image shows other ground, at the terrain's height there.
    """
    first, second = drawn.images
    in_first, _ = first.ground_to_image(drawn.true_footprints, corrections[0])
    in_second, _ = second.ground_to_image(drawn.true_footprints, corrections[1])
    height = np.zeros(in_first.shape[0])
    for _ in range(8):
        shown, _ = first.image_to_ground(in_first[:, 0], in_first[:, 1], height, drawn.true_corrections[0])
        height = sine_height(shown, drawn.settings.relief)
    homologous, _ = second.ground_to_image(shown, drawn.true_corrections[1])
    return in_second - homologous


CASES: dict[str, Callable[[SimulatedPair], tuple[OrientationCorrection, ...]]] = {
    "nominal": lambda drawn: tuple(OrientationCorrection(np.zeros((3, 6))) for _ in drawn.images),
    "pitch": lambda drawn: (pitched(drawn.true_corrections[0], SHIFT), drawn.true_corrections[1]),
    "pitch of the second": lambda drawn: (drawn.true_corrections[0], pitched(drawn.true_corrections[1], -SHIFT)),
    "true": lambda drawn: drawn.true_corrections,
}


@pytest.mark.parametrize("case", CASES)
def test_discrepancy_is_what_homologous_places_tell(case: str) -> None:
    drawn = made_pair()
    corrections = CASES[case](drawn)
    found = discrepancy((drawn.images[0], drawn.images[1]), true_shots(), drawn.ties, corrections)
    error = found.pixels - expected_discrepancy(drawn, corrections)[found.shots]
    ratio = error / found.pixel_sigmas
    assert found.shots.size == 40
    assert np.abs(ratio).max() < 3.5
    assert np.all(np.sqrt(np.mean(ratio**2, axis=0)) > 0.4)  # the sigmas are no safe lies, either
    assert np.sqrt(np.mean(error[:, 0] ** 2)) < 0.5
    along = {"pitch": 228.0, "pitch of the second": 244.0, "true": 0.0}  # the second looks from 407 km
    if case in along:
        np.testing.assert_allclose(found.metres[:, 0].mean(), along[case], rtol=0, atol=4.0)


def test_a_profile_moved_over_the_ground_is_no_discrepancy() -> None:
    """The ties don't know where the footprints should be: a common horizontal error of 80 m doesn't show."""
    drawn, own = made_pair(), true_shots()
    corrections = (drawn.true_corrections[0], drawn.true_corrections[1])
    images = (drawn.images[0], drawn.images[1])
    up = own.footprints / np.linalg.norm(own.footprints, axis=1, keepdims=True)
    east = np.cross([0.0, 0.0, 1.0], up)
    moved = own.footprints + 80.0 * east / np.linalg.norm(east, axis=1, keepdims=True)
    places, _ = images[0].ground_to_image(moved, corrections[0])
    height = np.zeros(40)
    for _ in range(8):
        moved, _ = images[0].image_to_ground(places[:, 0], places[:, 1], height, corrections[0])
        height = sine_height(moved, drawn.settings.relief)
    found = discrepancy(images, own, drawn.ties, corrections, moved)

    assert np.linalg.norm(moved - own.footprints, axis=1).min() > 75.0
    assert np.abs(found.pixels / found.pixel_sigmas).max() < 3.5
    assert np.abs(found.metres[:, 0]).max() < 10.0


def test_too_few_ties_and_too_few_for_a_sigma() -> None:
    drawn = made_pair()
    images = (drawn.images[0], drawn.images[1])

    def first(count: int) -> TiePoints:
        kept = drawn.ties.measure_point < count
        return replace(
            drawn.ties, measure_point=drawn.ties.measure_point[kept], measures=drawn.ties.measures[kept],
            measure_image=drawn.ties.measure_image[: 2 * count], measure_sigmas=drawn.ties.measure_sigmas[kept],
        )

    refuses("2 common tie points", discrepancy, images, true_shots(), first(2))
    found = discrepancy(images, true_shots(), first(3))
    assert np.all(np.isfinite(found.pixels))
    assert np.all(np.isnan(found.pixel_sigmas))

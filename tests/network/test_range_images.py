"""Laser shots along the images of a pass: its trajectory carries them, between its images, too."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from networks import pair
from rigs import PRIOR, TURN, mounted

from mgsgraph.adjustment.adjust import adjust_network
from mgsgraph.adjustment.settings import SolverSettings
from mgsgraph.case.assembly import Parts
from mgsgraph.case.schema import ShotsInput
from mgsgraph.errors import InputError
from mgsgraph.geometry.altimetry import AltimeterShots
from mgsgraph.geometry.image import LineTiming, PushbroomImage
from mgsgraph.geometry.orientation import evenly_spaced
from mgsgraph.network import Network, Pass, PointClass, SharedKind
from mgsgraph.network.footprints import Registration, footprints_in_images
from mgsgraph.network.joining import mountings
from mgsgraph.network.observations import Members, carriers, shots_carried

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
    with pytest.raises(InputError, match="images of one pass"):
        carriers(found(), everything, [Members((0, 1))], "")


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

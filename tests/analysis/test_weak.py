"""What is weak and what is undetermined: found, counted and named as photogrammetry has it."""

import re
from dataclasses import replace

import numpy as np
import pytest
from increments import network_of, strip
from networks import network, pair

from mgsgraph.adjustment.adjust import adjust_network, predict
from mgsgraph.adjustment.datum import datum_transformations, defects, scaled_normal, simple_basis
from mgsgraph.adjustment.frames import Frames, flight_frame
from mgsgraph.adjustment.graph import BundleGraph, Layout, lay_out
from mgsgraph.adjustment.rounds import all_rows
from mgsgraph.adjustment.settings import SolverSettings
from mgsgraph.adjustment.solution import Solution
from mgsgraph.analysis.weak import WeakDirection, spectrum, weak_directions, weakest
from mgsgraph.errors import WeakNetwork
from mgsgraph.files.networks.tie_points import PointKind
from mgsgraph.geometry.orientation import OrientationCorrection, OrientationPrior
from mgsgraph.network import GroundPoints, Network

ALL = slice(None)


def with_fixed(net: Network, places: np.ndarray, chosen: slice | list[int] = ALL) -> Network:
    """The same with some points known."""
    kinds, covariances, all_places = net.points.kinds.copy(), net.points.covariances.copy(), net.points.places.copy()
    kinds[chosen], covariances[chosen], all_places[chosen] = PointKind.FIXED, 0.0, places[chosen]
    return replace(net, points=GroundPoints(net.points.ids, net.points.classes, kinds, all_places, covariances))


def unknown(net: Network, degree: int = 2) -> Network:
    """Nothing known of any image beforehand."""
    return replace(net, priors=(OrientationPrior(np.full((degree + 1, 6), np.inf)),) * len(net.images))


def normal_of(net: Network) -> tuple[Layout, np.ndarray]:
    layout = lay_out(net, SolverSettings())
    graph = BundleGraph(layout, all_rows(net).rows(layout))
    return layout, scaled_normal(layout, graph.reduction(np.zeros(layout.columns)))


def refused(net: Network) -> WeakNetwork:
    with pytest.raises(WeakNetwork) as caught:
        predict(net, SolverSettings())
    assert "\n" not in str(caught.value)
    return caught.value


def on_strip(images: int = 8) -> tuple[Layout, Solution]:
    net = network_of(strip(images), range(images))
    return lay_out(net, SolverSettings()), adjust_network(net, SolverSettings())


# --- frames


@pytest.mark.parametrize("angles", ["camera", "opk-paper", "opk-peer"])
@pytest.mark.parametrize("which", [0, 1])
def test_axes_move_the_ground_as_their_names_say(which: int, angles: str) -> None:
    """Against the image's own projection, corrected by a small amount of each axis."""
    image = pair().images[which]
    frame, middle = flight_frame(image, angles), np.array([0.5 * image.lines])
    sample = np.array([0.5 * image.samples])
    _, per_place = image.image_to_ground(middle, sample)
    along = per_place[0, :, 0] / np.linalg.norm(per_place[0, :, 0])
    for k, small in enumerate(np.repeat([1.0, 1e-6], 3)):
        components = np.linalg.solve(frame.turn, small * np.eye(6)[k])
        ends = [
            image.image_to_ground(middle, sample, 0.0, OrientationCorrection(sign * components[None], angles))[0][0]
            for sign in (-0.5, 0.5)
        ]
        moved = (ends[1] - ends[0]) / small
        pose = image.pose(middle)
        up = pose.position[0] / np.linalg.norm(pose.position[0])
        forward = pose.velocity[0] - up * (up @ pose.velocity[0])
        forward /= np.linalg.norm(forward)
        expected = np.array([forward @ moved, np.cross(up, forward) @ moved])
        np.testing.assert_allclose(frame.ground[:, k], expected, atol=1e-3 * np.abs(expected).max() + 1e-3)
        if frame.axes[k] in ("along-track position", "pitch"):  # forward both, as the image's lines go
            assert along @ moved > 0.95 * np.linalg.norm(moved)
            assert np.linalg.norm(moved) == pytest.approx(frame.reach[k], rel=0.25)
        if frame.axes[k] in ("across-track position", "roll"):
            assert abs(along @ moved) < 0.1 * np.linalg.norm(moved)
    assert abs(frame.ground[1, 0]) < 0.1
    assert frame.ground[1, 3] > 0.9 * frame.reach[3]  # a positive roll, right wing down, looks to the left


def test_shares_sum_to_one_whatever_the_sigmas() -> None:
    net = network(pair())
    sigmas = net.priors[0].sigmas * np.random.default_rng(1).uniform(0.2, 5.0, (3, 6))
    frames = Frames(lay_out(replace(net, priors=(OrientationPrior(sigmas), net.priors[1])), SolverSettings()))
    directions = np.linalg.qr(np.random.default_rng(2).normal(size=(36, 36)))[0]
    turned = frames.turned(directions)
    np.testing.assert_allclose(turned.T @ turned, np.eye(36), atol=1e-12)
    amounts = frames.amounts(directions)
    before = directions * frames.layout.scales[:, None]
    for first in range(0, 36, 3):  # a turn, so that lengths stay
        one, other = (np.linalg.norm(part[first : first + 3], axis=0) for part in (amounts, before))
        np.testing.assert_allclose(one, other, rtol=1e-9)


# --- what is weak


def test_position_against_pointing_is_named_where_nothing_else_is_weak() -> None:
    """All points known, one image held: a narrow camera can't tell a step forward from a look forward."""
    drawn = pair(ties=60)
    places = np.concatenate([drawn.true_ties, drawn.true_footprints])
    net = with_fixed(network(drawn, (False, True)), places)
    net = replace(net, priors=(OrientationPrior(net.priors[0].sigmas[:1]), net.priors[1]))
    solution = adjust_network(net, SolverSettings())
    found = weak_directions(solution, 6)
    assert [direction.ratio > 0.5 for direction in found[:2]] == [True, True]
    names = {direction.sentence.split(" of image")[0] for direction in found[:2]}
    assert names == {"constant along-track position against pitch", "constant across-track position against roll"}
    frame = flight_frame(net.images[0])
    for direction in found[:2]:
        assert all(part.axis.owner == "image SIM/A" for part in direction.parts)
        moved = np.zeros(2)
        for part in direction.parts:
            moved += part.amount * frame.ground[:, frame.axes.index(part.axis.name)]
        assert np.linalg.norm(moved) < 0.05 * direction.sigma
        assert direction.unit == "m"
        main = next(part for part in direction.parts if part.axis.unit == "m")
        assert direction.sigma == pytest.approx(abs(main.amount) * direction.ratio)
    assert found[-1].ratio < 0.1  # what moves the image on the ground is well known


def test_ratio_is_the_sigma_of_the_direction() -> None:
    layout, solution = on_strip(4)
    covariance = solution.joint_covariance.dense() / layout.scales / layout.scales[:, None]
    for direction in weakest(layout, solution.joint_covariance, 10):
        variance = direction.direction @ covariance @ direction.direction
        assert direction.ratio == pytest.approx(np.sqrt(variance), rel=1e-9)
        assert np.linalg.norm(direction.direction) == pytest.approx(1.0)
        assert 0.9 < sum(part.share for part in direction.parts) < 1.0 + 1e-9
        assert re.search(r": one sigma is [\d.e-]+ (m|arcsec)", direction.sentence)


def test_weakest_comes_first_and_equals_are_as_weak_to_one_percent() -> None:
    layout, solution = on_strip(4)
    values, vectors = spectrum(solution.joint_covariance, layout.scales, 5)
    covariance = solution.joint_covariance.dense() / layout.scales / layout.scales[:, None]
    np.testing.assert_allclose(values, np.linalg.eigvalsh(covariance)[::-1], rtol=1e-9, atol=1e-14)
    np.testing.assert_allclose(covariance @ vectors, vectors * values, atol=1e-9)
    assert values.max() < 1.0 + 1e-9
    found = weakest(layout, solution.joint_covariance, layout.columns)
    together = np.stack([direction.direction for direction in found], axis=1)
    ratios = np.array([direction.ratio for direction in found])
    sigmas = np.sqrt(values[: ratios.size])
    assert np.all(np.abs(ratios / sigmas - 1.0) < 0.011)
    np.testing.assert_allclose(together.T @ together, np.eye(ratios.size), atol=1e-9)
    assert sum(1.0 / direction.equals for direction in found) == pytest.approx(len({*map(round_run, found)}), abs=1e-6)


def round_run(direction: WeakDirection) -> tuple[int, int]:
    return direction.equals, round(np.log(direction.ratio) / 0.02)


def test_lanczos_finds_the_same_eigenvalues() -> None:
    layout, solution = on_strip(12)
    scales = layout.scales * np.random.default_rng(6).uniform(0.2, 5.0, layout.columns)  # lest all of them be equal
    values, _ = spectrum(solution.joint_covariance, scales, 6)
    few, directions = spectrum(solution.joint_covariance, scales, 6, dense=0)
    assert values.size == 216
    assert values[0] > 1.5 * values[5]
    np.testing.assert_allclose(few, values[:6], rtol=1e-3)
    covariance = solution.joint_covariance.dense() / scales / scales[:, None]
    np.testing.assert_allclose(np.sum(directions * (covariance @ directions), axis=0), few, rtol=1e-3)
    assert np.linalg.norm(covariance @ directions - directions * few, axis=0).max() < 0.02


@pytest.mark.parametrize("loose", [0, 1])
def test_the_one_image_that_is_loose_is_named(loose: int) -> None:
    net = network(pair(ties=40))
    tight = OrientationPrior(net.priors[0].sigmas * 1e-3)
    priors = tuple(net.priors[0] if j == loose else tight for j in range(2))
    first = weak_directions(adjust_network(replace(net, priors=priors), SolverSettings()), 1)[0]
    assert "against" in first.sentence
    assert f"image SIM/{'AB'[loose]}" in first.sentence
    assert f"image SIM/{'BA'[loose]}" not in first.sentence


def test_simple_basis_finds_the_parts_of_a_mixture() -> None:
    rng = np.random.default_rng(3)
    parts = np.zeros((20, 4))
    for k in range(4):
        parts[5 * k : 5 * k + 2, k] = [0.8, -0.6]
    mixed = parts @ np.linalg.qr(rng.normal(size=(4, 4)))[0]
    back = mixed @ simple_basis(mixed)
    np.testing.assert_allclose(np.sort(np.abs(parts.T @ back).ravel()), [0.0] * 12 + [1.0] * 4, atol=1e-6)


# --- what is undetermined


def test_ties_alone_leave_seven_transformations_of_the_whole_network() -> None:
    error = refused(unknown(network(pair(ties=60), laser=False)))
    assert error.of_datum == 7
    assert "translation along X, Y and Z, rotation about X, Y and Z, and scale of the whole network" in str(error)
    assert "give a control point" in str(error)
    assert error.count > 7  # a narrow pair leaves more


def test_datum_transformations_change_no_residual() -> None:
    """Small ones of each kind, with the points moving along: the cost of ties stays as it is."""
    layout, normal = normal_of(unknown(network(pair(ties=60), laser=False)))
    moves = datum_transformations(layout)
    np.testing.assert_allclose(np.linalg.norm(moves, axis=0), 1.0)
    felt = np.einsum("ck,cd,dk->k", moves, normal, moves) / np.linalg.eigvalsh(normal)[-1]
    assert np.abs(felt).max() < 1e-14
    wrong = moves.copy()
    wrong[3:6] *= -1.0  # the first image turned the other way
    assert np.einsum("ck,cd,dk->k", wrong, normal, wrong).max() > 1e-6 * np.linalg.eigvalsh(normal)[-1]


@pytest.mark.parametrize(("chosen", "left"), [([0], 4), ([0, 7], 1), ([0, 7, 20], 0)])
def test_each_control_point_takes_its_share_of_the_datum(chosen: list[int], left: int) -> None:
    """About one fixed point three rotations and scale are free; about two, the rotation on their axis; then none."""
    drawn = pair(ties=60)
    net = with_fixed(network(drawn, laser=False), drawn.true_ties, chosen)
    error = refused(unknown(net))
    assert error.of_datum == left
    if left == 4:
        assert "rotation about X, Y and Z, and scale of the whole network" in str(error)
        assert "translation" not in str(error)
    if left == 1:
        told = re.search(r"rotation about \((.+?)\) of the whole network", str(error))
        assert told is not None
        line = drawn.true_ties[chosen[1]] - drawn.true_ties[chosen[0]]
        axis = np.array([float(part) for part in told[1].split(",")])
        assert abs(axis @ line) / np.linalg.norm(line) > 0.999
    if left == 0:
        assert "nothing determines" in str(error)
        assert "image SIM/" in str(error)


@pytest.mark.parametrize(("angles", "known"), [("camera", 7), ("opk-peer", 7), ("opk-paper", 6)])
def test_the_datum_is_found_in_whatever_angles(angles: str, known: int) -> None:
    """The papers' phi is near 90 degrees here, where a rotation takes more than polynomials of degree two."""
    net = unknown(network(pair(ties=60), laser=False))
    layout = lay_out(net, SolverSettings(angles=angles))
    graph = BundleGraph(layout, all_rows(net).rows(layout))
    found = defects(layout, scaled_normal(layout, graph.reduction(np.zeros(layout.columns))), 1e-13)
    assert found.of_datum == known


def test_a_held_image_holds_the_datum_and_the_other_is_named() -> None:
    error = refused(unknown(network(pair(ties=60), (True, False), laser=False)))
    assert error.of_datum == 0
    assert "image SIM/B" in str(error)
    assert "image SIM/A" not in str(error)
    assert "finite a-priori sigma" in str(error)


def test_laser_ranges_hold_the_datum() -> None:
    net = network(pair(ties=60, shots=12))
    sigmas = net.priors[0].sigmas.copy()
    sigmas[0, 0] = np.inf
    prediction = predict(replace(net, priors=(OrientationPrior(sigmas),) * 2), SolverSettings())
    assert np.all(np.isfinite(prediction.covariances))

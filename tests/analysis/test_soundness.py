"""What came to rest on too little is no result, whatever the optimiser says."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from networks import network, pair
from sharing import shared

from mgsgraph.adjustment.adjust import adjust_network
from mgsgraph.adjustment.fit import ABSURD, IMPOSSIBLE
from mgsgraph.adjustment.settings import SolverSettings
from mgsgraph.adjustment.solution import Solution
from mgsgraph.analysis.soundness import MOST, Kind, is_result, soundness
from mgsgraph.case.reading import Case
from mgsgraph.errors import InputError
from mgsgraph.geometry import rotation
from mgsgraph.network import Network, PointClass, SharedKind
from mgsgraph.results.inventory import inventory
from mgsgraph.results.results import solution_json, statements, summary_table
from mgsgraph.results.soundness import soundness_section, state_of


@pytest.fixture(scope="module")
def good() -> Solution:
    return adjust_network(network(pair(ties=20, shots=10)), SolverSettings(starts=0))


def parallel(only_ties: bool = False) -> Network:
    """Ties whose two rays are the same ray, in an image and its twin; laser shots hold the datum."""
    net = network(pair(ties=12, shots=30))
    first, places = net.images[0], net.rays.places.copy()
    ties = net.points.classes[net.rays.point] == PointClass.TIE
    for k in np.flatnonzero(ties & (net.rays.image == 1)).tolist():
        (twin,) = np.flatnonzero((net.rays.point == net.rays.point[k]) & (net.rays.image == 0))
        places[k] = places[twin]
    rays = replace(net.rays, places=places).chosen(ties if only_ties else ties | (net.rays.image == 0))
    priors = (net.priors[0],) * 2
    return replace(net, images=(first, replace(first, name="twin")), priors=priors, rays=rays)


def test_a_good_solution_is_a_result(good: Solution) -> None:
    assert is_result(good)
    assert not soundness(good).losses
    assert not soundness_section(good).sentences
    assert state_of(good) == "converged"
    assert solution_json(good)["soundness"]["sound"] is True
    assert not is_result(replace(good, converged=False))


def test_no_tie_left_is_refused() -> None:
    """It came to rest on the laser alone, and was called converged with all its ties left out."""
    with pytest.raises(InputError, match=r"none of 12 tie points is left \(0 rejected, 12 not determined"):
        adjust_network(parallel(), SolverSettings(starts=0))


def test_parallel_rays_are_said_in_one_line_without_warnings() -> None:
    """Warnings are errors here; `nan` is no figure."""
    said = inventory(Case("x", Path("x"), parallel(), SolverSettings()))
    assert "nan" not in said
    assert said.count("points have parallel rays, and stay out") == 1


def lost(solution: Solution, kind: Kind, share: float) -> Solution:
    """The solution with a share of one kind left out."""
    net = solution.network
    if kind is Kind.RANGES:
        return replace(solution, ranges_used=np.arange(net.ranges.point.size) >= share * net.ranges.point.size)
    if kind is Kind.IMAGE:
        mine = np.flatnonzero(net.rays.image == 1)
        used = solution.rays_used.copy()
        used[mine[: round(share * mine.size)]] = False
        return replace(solution, rays_used=used)
    mine = np.flatnonzero(net.points.classes == (PointClass.TIE if kind is Kind.TIES else PointClass.LASER))
    determined = solution.determined.copy()
    determined[mine[: round(share * mine.size)]] = False
    return replace(solution, determined=determined)


@pytest.mark.parametrize(
    ("kind", "share", "fatal"),
    [(Kind.TIES, 0.6, True), (Kind.LASER, 0.3, False), (Kind.RANGES, 1.0, True), (Kind.IMAGE, 0.6, True),
     (Kind.IMAGE, 0.3, False)],
)  # fmt: skip
def test_what_is_left_out_is_said(good: Solution, kind: Kind, share: float, fatal: bool) -> None:
    found = lost(good, kind, share)
    losses = [one for one in soundness(found).losses if one.kind is kind]
    assert losses
    assert losses[0].share == pytest.approx(share, abs=0.1)
    assert losses[0].fatal is fatal is (losses[0].share > MOST)
    assert is_result(found) is not fatal
    assert any(str(kind) in sentence and "did not take part" in sentence for sentence in statements(found)) is fatal
    record = solution_json(found)["soundness"]
    assert record["sound"] is not fatal
    assert {"kind": str(kind), "of": losses[0].total, "count": losses[0].lost, "fatal": fatal}.items() <= next(
        one for one in record["left_out"] if one["kind"] == kind
    ).items()
    assert ("NO RESULT" in summary_table(found)) is fatal
    if kind is Kind.IMAGE:
        assert losses[0].image == good.network.images[1].name


def moved(solution: Solution, sigmas: float) -> Solution:
    """The solution with sigmas by which an orientation has moved by so many at the most."""
    (worst, *_) = replace(solution, network=tightened(solution.network, 1e-3)).strained
    return replace(solution, network=tightened(solution.network, 1e-3 * worst.most / sigmas))


def tightened(net: Network, factor: float) -> Network:
    return replace(net, priors=tuple(replace(prior, sigmas=factor * prior.sigmas) for prior in net.priors))


def test_orientations_that_no_sigma_allows(good: Solution) -> None:
    near, far = moved(good, 0.99 * IMPOSSIBLE), moved(good, 1.01 * IMPOSSIBLE)
    assert near.strained
    assert is_result(near)
    assert not soundness_section(near).sentences
    assert not is_result(far)
    (one,) = soundness(far).impossible
    (sentence,) = soundness_section(far).sentences
    name = far.network.images[one.image].name
    assert name in sentence
    record = solution_json(far)["soundness"]
    assert record["sound"] is False
    assert record["orientations_impossible"] == [{"image": name, "sigmas": pytest.approx(1.01 * IMPOSSIBLE)}]
    assert "NO RESULT" in state_of(far)
    held = replace(far.network, held=np.ones(len(far.network.images), dtype=bool))
    assert is_result(replace(far, network=held))


def test_what_a_shared_boresight_does_is_measured_by_its_own_sigma() -> None:
    """Both images look elsewhere by 0.01 rad, hundreds of their own sigmas: the camera's, which is little known."""
    net, turn = network(pair(ties=20, shots=10)), rotation.exponential(np.array([[0.01, 0.0, 0.0]]))[0]
    images = []
    for image in net.images:
        camera = image.trajectory.camera  # type: ignore[attr-defined]
        turned = replace(camera, constant=turn @ camera.constant)
        images.append(replace(image, trajectory=replace(image.trajectory, camera=turned)))  # type: ignore[type-var]
    net = replace(net, images=tuple(images), shared=(shared(SharedKind.CAMERA_BORESIGHT, [0, 1], 0.1),))
    solution = adjust_network(net, SolverSettings(starts=0))
    assert np.linalg.norm(solution.shared[0]) > IMPOSSIBLE * net.priors[0].sigmas[0, 3:].max()
    assert is_result(solution)
    assert not solution.strained


def test_a_sigma0_that_no_sigma_makes(good: Solution) -> None:
    freedom = good.fit.degrees_of_freedom
    wild = replace(good, fit=replace(good.fit, squares=1.01 * ABSURD**2 * freedom))
    assert not is_result(wild)
    assert len(soundness_section(wild).sentences) == 1
    assert is_result(replace(good, fit=replace(good.fit, squares=0.99 * ABSURD**2 * freedom)))

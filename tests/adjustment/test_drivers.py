"""What drives an adjustment that does not converge: planted images and points must be named, healthy ones not."""

from collections.abc import Callable
from dataclasses import replace
from functools import cache, partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import pytest
from once import once

from mgsgraph.adjustment.adjust import adjust_network
from mgsgraph.adjustment.drivers import Drivers, Kind, driver_sentences, drivers_of, flagged_by_share
from mgsgraph.adjustment.fit import ABSURD, fit, residuals, squares_of
from mgsgraph.adjustment.graph import BundleGraph, lay_out
from mgsgraph.adjustment.settings import SolverSettings
from mgsgraph.adjustment.solution import Solution
from mgsgraph.analysis.verdict import Cause, State, is_valid, verdict
from mgsgraph.case.reading import read_case
from mgsgraph.errors import SolverError
from mgsgraph.geometry import rotation
from mgsgraph.kernel.rows import CAUCHY, HUBER, NO_LOSS, TUKEY
from mgsgraph.network import Network
from mgsgraph.simulation.archive import archive_settings
from mgsgraph.simulation.archive import lay_out as lay_out_archive
from mgsgraph.simulation.archive_files import write_archive

Planted = tuple[Network, list[str], list[str]]
"""Network, and names of the images, or ids of the points, that are wrong in it."""
PLAIN = SolverSettings(starts=0)


@once
def block(seed: int) -> Network:
    """A block of 16 images, healthy."""
    with TemporaryDirectory() as folder:
        archive = lay_out_archive(archive_settings("kaguya", 16, 800), seed)
        return read_case(write_archive(archive, Path(folder))).network


def _one(net: Network, rng: np.random.Generator) -> int:
    return int(rng.integers(len(net.images)))


def turned(net: Network, rng: np.random.Generator, angle: float = 0.8) -> Planted:
    """One image looks elsewhere, by 0.8 rad: 8,000 sigmas."""
    j, axis = _one(net, rng), rng.normal(size=3)
    turn = rotation.exponential(angle * axis[None] / np.linalg.norm(axis))[0]
    images = list(net.images)
    trajectory: Any = images[j].trajectory
    camera = replace(trajectory.camera, constant=turn @ trajectory.camera.constant)
    images[j] = replace(images[j], trajectory=replace(trajectory, camera=camera))
    return replace(net, images=tuple(images)), [images[j].name], []


def shifted(net: Network, rng: np.random.Generator, pixels: float = 500.0) -> Planted:
    """All measures of one image are off alike, as those of another one: sigma0 hardly shows it."""
    j, places = _one(net, rng), net.rays.places.copy()
    places[net.rays.image == j] += [pixels, 0.6 * pixels]
    return replace(net, rays=replace(net.rays, places=places)), [net.images[j].name], []


def interchanged(net: Network, rng: np.random.Generator) -> Planted:
    """Lines and samples of one image are interchanged."""
    j, places = _one(net, rng), net.rays.places.copy()
    places[net.rays.image == j] = places[net.rays.image == j][:, ::-1]
    return replace(net, rays=replace(net.rays, places=places)), [net.images[j].name], []


def mismatched(net: Network, rng: np.random.Generator, count: int = 12) -> Planted:
    """So many points have one measure anywhere in its image."""
    points, places = rng.choice(np.flatnonzero(net.ray_counts > 2), count, replace=False), net.rays.places.copy()
    for i in points.tolist():
        k = int(rng.choice(np.flatnonzero(net.rays.point == i)))
        image = net.images[net.rays.image[k]]
        places[k] = rng.uniform(0.0, [image.lines, image.samples])
    return replace(net, rays=replace(net.rays, places=places)), [], [net.points.ids[i] for i in points.tolist()]


def _named(found: Drivers, net: Network) -> list[str]:
    """The first three names of what is said first; the image with the largest share where nothing stands out."""
    one = (*found.flagged, *found.contributions)[0]
    names = net.image_names if one.kind == Kind.IMAGE else net.points.ids
    return [names[i] for i in one.members[: min(3, one.flagged or 1)].tolist()]


PLANTS = [turned, shifted, interchanged, mismatched]


@cache
def planted(
    plant: Callable[..., Planted], seed: int, iterations: int = PLAIN.max_iterations
) -> tuple[Planted, Solution]:
    """What is planted in the block, and its adjustment."""
    made = plant(block(seed), np.random.default_rng(seed))
    return made, adjust_network(made[0], replace(PLAIN, max_iterations=iterations))


# above two seconds: an adjustment that goes nowhere takes hundreds of steps
@pytest.mark.parametrize("plant", PLANTS, ids=lambda one: one.__name__)
@pytest.mark.parametrize(("seed", "iterations"), [(1, PLAIN.max_iterations), (2, 3)])
def test_what_is_planted_is_named(plant: Callable[..., Planted], seed: int, iterations: int) -> None:
    (net, images, points), solution = planted(plant, seed, iterations)
    assert (solution.drivers is None) == is_valid(solution)
    assert solution.drivers is not None or plant is mismatched  # else this would prove nothing
    if solution.drivers is not None:
        assert set(_named(solution.drivers, net)) & {*images, *points}
        assert any(name in " ".join(driver_sentences(solution.drivers, net)) for name in (*images, *points))


@pytest.mark.parametrize("plant", [shifted, partial(turned, angle=0.05)])
def test_a_wrong_image_that_hides_in_sigma0_is_no_result(plant: Callable[..., Planted]) -> None:
    (net, (name,), _), solution = planted(plant, 1)
    assert solution.converged
    assert solution.sigma0 < ABSURD
    assert not is_valid(solution)
    assert next(one.what for one in verdict(solution).of(Cause.ORIENTATION) if one.state is State.INVALID) == name
    assert solution.drivers is not None
    assert _named(solution.drivers, net)[0] == name


# above two seconds: Tukey begins with other losses
@pytest.mark.parametrize("seed", [1, 2])
@pytest.mark.parametrize("settings", [PLAIN, replace(PLAIN, max_iterations=1), replace(PLAIN, loss="tukey")],
                         ids=["plain", "one iteration", "tukey"])  # fmt: skip
def test_nobody_is_accused_of_good_data(settings: SolverSettings, seed: int) -> None:
    solution = adjust_network(block(seed), settings)
    assert solution.converged == (solution.drivers is None)
    if solution.drivers is not None:
        assert not solution.drivers.flagged
        assert len(driver_sentences(solution.drivers, solution.network)) == 1


def test_shares_add_up_to_the_cost() -> None:
    """Images' shares and points' shares: every measure belongs to one image and to one point; priors to images."""
    net = mismatched(block(1), np.random.default_rng(1))[0]
    layout = lay_out(net, PLAIN)
    graph = BundleGraph(layout)
    reduction = graph.reduction(0.3 * np.random.default_rng(4).standard_normal(layout.columns) * layout.scales)
    found = drivers_of(graph, reduction)
    assert found.cost == pytest.approx(graph.cost(reduction), rel=1e-9)
    images = next(one for one in found.contributions if one.kind == Kind.IMAGE)
    assert images.members.size == len(net.images)
    assert images.shares.sum() == pytest.approx(1.0, abs=1e-12)


@pytest.mark.parametrize(("loss", "code"), [("none", NO_LOSS), ("huber", HUBER), ("cauchy", CAUCHY), ("tukey", TUKEY)])
def test_measures_have_the_kernels_cost(loss: str, code: int) -> None:
    layout = lay_out(block(1), SolverSettings(loss=loss))  # type: ignore[arg-type]
    graph, at = BundleGraph(layout), np.zeros(layout.columns)
    reduction = graph.reduction(at)
    found = residuals(layout, at, reduction.points)
    every = squares_of(layout, layout.rows, at, reduction.points, found)
    assert layout.model.loss == code
    costs = sum(one.costs(layout.model).sum() for one in every.values())
    assert costs == pytest.approx(reduction.cost, rel=1e-6)
    observations = fit(layout, layout.rows, at, reduction.points, found).observations
    assert observations == 2 * every["rays"].point.size + layout.prior.rows


def test_points_without_a_place_are_named_in_the_error() -> None:
    """An optimisation that can't begin says which points stand in its way."""
    net = block(1)
    layout = lay_out(net, PLAIN)
    wild = np.zeros(layout.columns)
    wild[layout.columns_of(3)][3:5] = 2.5  # rad: image 3 looks up
    with pytest.raises(SolverError) as error:
        adjust_network(net, PLAIN, begin=layout.variables.split(wild))
    assert net.images[3].name in str(error.value)
    assert "\n" not in str(error.value)


def test_a_median_is_not_moved_by_those_that_stand_out() -> None:
    values, measures = np.ones(50), np.full(50, 100)
    values *= 100.0
    assert not np.any(flagged_by_share(values, measures, 4.0))
    values[[3, 7]] *= 50.0
    assert np.flatnonzero(flagged_by_share(values, measures, 4.0)).tolist() == [3, 7]
    measures[3] = 0  # of nobody's measures nothing is said
    assert np.flatnonzero(flagged_by_share(values, measures, 4.0)).tolist() == [7]

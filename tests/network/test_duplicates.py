"""Observations given twice are found, exactly those, however they are rounded, moved and mixed; others are not."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import networks
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from sites import plain_site

import mgsgraph
from mgsgraph.files.networks.tie_points import PointKind
from mgsgraph.geometry.body import from_planetocentric, planetocentric
from mgsgraph.geometry.records import Array, Index
from mgsgraph.network import GroundPoints, ImageRays, Network, PointClass, Ranges
from mgsgraph.network.duplicates import DuplicateKind, duplicates, joined_pairs, measured_twice
from mgsgraph.results.inventory import inventory
from mgsgraph.simulation.files import write_site
from mgsgraph.units import DEG

CASES = Path(__file__).resolve().parents[2] / "scripts" / "cases"
PAIR = networks.network(networks.pair(ties=30, shots=15))
MARS = 3_396_190.0

Move = Callable[[Array], Array]
seeds = st.integers(0, 2**32 - 1)


def rounded(decimals: int) -> Move:
    """Places (n, 3) as a file has them with so many decimals of a degree, and of a metre."""

    def move(places: Array) -> Array:
        angles, radii = np.round(planetocentric(places)[:, :2] / DEG, decimals), planetocentric(places)[:, 2:]
        return from_planetocentric(np.hstack([angles * DEG, np.round(radii, 2)]))

    return move


def given_again(
    net: Network, points: Index, pixels: Move = lambda one: one, places: Move = lambda one: one,
    times: float = 0.0, ranges: Move = lambda one: one,
) -> Network:  # fmt: skip
    """A network with some points once more under another name, their values changed."""
    old, n = net.points, len(net.points)
    number = np.full(n, -1)
    number[points] = n + np.arange(points.size)
    rays, shots = (net.rays.chosen(number[net.rays.point] >= 0), net.ranges.chosen(number[net.ranges.point] >= 0))
    more = GroundPoints(
        [f"{old.ids[i]}again" for i in points.tolist()], old.classes[points], old.kinds[points],
        places(old.places[points]), old.covariances[points],
    )  # fmt: skip
    both = GroundPoints(*(
        np.concatenate([getattr(one, name) for one in (old, more)]) if name != "ids" else [*old.ids, *more.ids]
        for name in GroundPoints.__slots__
    ))  # fmt: skip
    return replace(
        net, points=both,
        rays=ImageRays(*(np.concatenate(two) for two in (
            (net.rays.point, number[rays.point]), (net.rays.image, rays.image),
            (net.rays.places, pixels(rays.places)), (net.rays.sigmas, rays.sigmas),
        ))),
        ranges=Ranges(*(np.concatenate(two) for two in (
            (net.ranges.point, number[shots.point]), (net.ranges.image, shots.image),
            (net.ranges.times, shots.times + times), (net.ranges.values, ranges(shots.values)),
            (net.ranges.sigmas, shots.sigmas),
        ))),
    )  # fmt: skip


def mixed(net: Network, rng: np.random.Generator) -> Network:
    """The same with its points and rays in another order."""
    place, old = rng.permutation(len(net.points)), net.points
    order, rays, shots = np.argsort(place), rng.permutation(net.rays.point.size), rng.permutation(net.ranges.point.size)
    points = GroundPoints(
        old.ids[order], old.classes[order], old.kinds[order], old.places[order], old.covariances[order]
    )
    return replace(
        net, points=points, rays=replace(net.rays, point=place[net.rays.point]).chosen(rays),
        ranges=replace(net.ranges, point=place[net.ranges.point]).chosen(shots),
    )  # fmt: skip


def named(net: Network) -> dict[DuplicateKind, set[frozenset[str]]]:
    """Pairs of names, of each kind."""
    ids = net.points.ids.tolist()
    return {
        one.kind: {frozenset((ids[i], ids[k])) for i, k in zip(one.first, one.again, strict=True)}
        for one in duplicates(net)
    }


def of_class(net: Network, wanted: PointClass) -> Index:
    return np.flatnonzero(net.points.classes == wanted)


def without_ranges(net: Network) -> Network:
    return replace(net, ranges=net.ranges.chosen(np.zeros(0, dtype=int)))


def pairs_of(net: Network, points: Index) -> set[frozenset[str]]:
    return {frozenset((name, f"{name}again")) for name in net.points.ids[points]}


# --- found: any subset, rounded, in any order


@given(seeds, st.booleans())
def test_whatever_is_given_again_is_found_and_nothing_else(seed: int, ranged: bool) -> None:
    rng = np.random.default_rng(seed)
    net = PAIR if ranged else without_ranges(PAIR)
    chosen = np.flatnonzero(rng.random(len(net.points)) < rng.random())
    again = given_again(net, chosen, lambda px: np.round(px, 2), rounded(5), 2e-4, lambda one: np.round(one, 1))
    expected = {
        kind: pairs_of(net, mine)
        for kind, wanted in ((DuplicateKind.TIE, PointClass.TIE), (DuplicateKind.SHOT, PointClass.LASER))
        if (mine := np.intersect1d(chosen, of_class(net, wanted))).size
    }
    assert named(mixed(again, rng)) == expected


@given(st.lists(st.sampled_from((2, 3)), min_size=1, max_size=20), seeds)
def test_how_often_it_is_given_does_not_matter(sizes: list[int], seed: int) -> None:
    """The first is that with the smallest number; each other one is superfluous, once."""
    number = np.random.default_rng(seed).permutation(sum(sizes))
    groups = np.split(number, np.cumsum(sizes)[:-1])
    pairs = np.concatenate([np.column_stack([one[:-1], one[1:]]) for one in groups])
    first, again = joined_pairs(pairs)
    assert dict(zip(again.tolist(), first.tolist(), strict=True)) == {
        k: one.min() for one in groups for k in one.tolist() if k != one.min()
    }


def test_every_shot_three_times() -> None:
    laser = of_class(PAIR, PointClass.LASER)
    twice = given_again(PAIR, laser)
    thrice = given_again(twice, laser + len(PAIR.points) - laser[0])
    (found,) = duplicates(thrice)
    assert (found.kind, found.count, found.total) == (DuplicateKind.SHOT, 2 * laser.size, 3 * laser.size)
    np.testing.assert_array_equal(np.unique(found.first), laser)
    assert found.names[0] == (PAIR.points.ids[int(laser[0])], thrice.points.ids[int(found.again[0])])


def test_a_second_processing_of_the_same_shots() -> None:
    """Time and range say that they are the same, where places are some metres off."""
    laser = of_class(PAIR, PointClass.LASER)
    moved = {"places": lambda one: one + 20.0}
    assert named(given_again(PAIR, laser, **moved)) == {DuplicateKind.SHOT: pairs_of(PAIR, laser)}
    assert named(given_again(without_ranges(PAIR), laser, **moved)) == {}


def test_a_few_shots() -> None:
    laser = of_class(PAIR, PointClass.LASER)
    one, first = mgsgraph.select_points(PAIR, laser[:1]), np.array([0])
    assert named(given_again(one, first, places=rounded(5))) == {DuplicateKind.SHOT: pairs_of(one, first)}
    assert named(mgsgraph.select_points(PAIR, laser[:2])) == {}


def test_what_is_new_alone() -> None:
    tie, n = of_class(PAIR, PointClass.TIE), len(PAIR.points)
    twice = given_again(given_again(PAIR, tie[:3]), tie[3:5])
    (found,) = duplicates(twice, n + 3)
    np.testing.assert_array_equal(found.again, [n + 3, n + 4])


def test_a_tie_that_is_control_too_and_control_twice() -> None:
    tie = of_class(PAIR, PointClass.TIE)
    net = given_again(PAIR, tie[:6], places=lambda one: np.full_like(one, MARS) + 1e4 * np.arange(6)[:, None])
    mine = np.arange(len(PAIR.points), len(net.points))
    classes, kinds = net.points.classes.copy(), net.points.kinds.copy()
    classes[mine], kinds[mine] = PointClass.CONTROL, PointKind.FIXED
    net = replace(net, points=replace(net.points, classes=classes, kinds=kinds))
    assert named(net) == {DuplicateKind.TIE: pairs_of(PAIR, tie[:6])}
    elsewhere = {"pixels": lambda one: one + 1.0}
    for places, count in ((rounded(5), 6), (lambda one: one + 1.0, 0)):
        found = {one.kind: one.count for one in duplicates(given_again(net, mine, places=places, **elsewhere))}
        assert found.get(DuplicateKind.CONTROL, 0) == count


def test_an_image_under_two_names() -> None:
    """Files are refused for it; a network of the user's own is not."""
    again = replace(PAIR.images[1], name="again")
    net = replace(PAIR, images=(*PAIR.images, again), priors=(*PAIR.priors, PAIR.priors[1]), held=[False] * 3)
    (found,) = duplicates(net)
    assert (found.kind, found.names, found.total) == (DuplicateKind.IMAGE, (("SIM/B", "again"),), 3)


# --- not found: what is only near


@pytest.mark.parametrize("step", [0.05, 0.5])
def test_ties_beside_each_other(step: float) -> None:
    every = np.arange(len(PAIR.points))
    net = without_ranges(PAIR)
    assert named(given_again(net, of_class(net, PointClass.TIE), lambda px: px + np.array([0.0, step]))) == {}
    assert named(given_again(net, every, lambda px: px + np.array([step, 0.0]), lambda one: one + 10.0)) == {}


def test_one_pixel_in_common_is_none_unless_there_is_no_other() -> None:
    """Ties of images 0, 1 and of 0, 2 that begin at the same pixel of image 0; then one that has this pixel alone."""
    point, image = np.array([0, 0, 1, 1]), np.array([0, 1, 0, 2])
    places = np.array([[7.5, 8.5], [3.5, 4.5], [7.5, 8.5], [3.5, 4.5]])
    assert measured_twice(point, image, places).tolist() == []
    assert measured_twice(point[:3], image[:3], places[:3]).tolist() == [[0, 1]]
    assert measured_twice(point[:0], image[:0], places[:0]).shape == (0, 2)
    assert measured_twice(np.zeros(4, dtype=int), np.array([0, 0, 1, 1]), np.ones((4, 2))).tolist() == []  # itself


@given(seeds)
def test_ties_of_a_grid(seed: int) -> None:
    """Whole pixels, as dense as they can be: neighbors are others, even along one line."""
    rng = np.random.default_rng(seed)
    grid = np.stack(np.meshgrid(np.arange(40.0), np.arange(30.0)), axis=-1).reshape(-1, 2)
    n = len(grid)
    again = np.flatnonzero(rng.random(n) < 0.1)
    one = np.concatenate([np.arange(n), n + np.arange(again.size)])
    places = np.concatenate([grid, grid[again] + rng.uniform(-0.02, 0.02, (again.size, 2))])
    found = measured_twice(np.tile(one, 2), np.repeat([0, 1], one.size), np.concatenate([places, places + 0.25]))
    np.testing.assert_array_equal(found[np.argsort(found[:, 1])], np.column_stack([again, n + np.arange(again.size)]))


@pytest.mark.parametrize("ranged", [True, False])
def test_spots_of_lola(ranged: bool) -> None:
    """Five at one time, 25 m apart, with the same range: the ground is level."""
    cross = 25.0 * np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0], [-1.0, 0.0], [0.0, -1.0]])
    shot = np.repeat(np.arange(40), 5)
    places = np.column_stack([np.full(200, MARS), np.tile(cross, (40, 1)) + 57.0 * np.column_stack([shot, 0 * shot])])
    image = PAIR.images[0]
    times = image.trajectory.epoch + float(image.timing.at(np.array([100.0]))[0][0]) + 0.0357 * shot
    points = GroundPoints(
        [f"S{i}" for i in range(200)], np.full(200, PointClass.LASER), np.full(200, PointKind.FIXED), places,
        np.zeros((200, 3, 3)),
    )  # fmt: skip
    net = replace(
        PAIR, points=points, rays=PAIR.rays.chosen(np.zeros(0, dtype=int)),
        ranges=Ranges(np.arange(200), np.zeros(200, dtype=int), times, np.full(200, 4e5), np.ones(200)),
    )  # fmt: skip
    net = net if ranged else without_ranges(net)
    assert named(net) == {}
    mine = np.arange(0, 200, 3)
    assert named(given_again(net, mine, places=lambda one: one + 0.1)) == {DuplicateKind.SHOT: pairs_of(net, mine)}


def test_another_shot_at_the_same_place_is_another() -> None:
    """A track that crosses, or repeats, an earlier one; a range that contradicts."""
    laser = of_class(PAIR, PointClass.LASER)
    assert named(given_again(PAIR, laser, times=0.02)) == {}
    assert named(given_again(PAIR, laser, ranges=lambda one: one + 1.0)) == {}


def test_places_that_are_near_by_chance() -> None:
    """So many shots that a few of them lie within a hundredth of their distance; one that is there twice counts."""
    rng, n = np.random.default_rng(4), 100_000
    places = np.column_stack([np.full(n, MARS), rng.uniform(0.0, 25.0 * np.sqrt(n), (n, 2))])
    places[-1] = places[0]
    points = GroundPoints(
        [f"S{i}" for i in range(n)], np.full(n, PointClass.LASER), np.full(n, PointKind.FIXED), places,
        np.zeros((n, 3, 3)),
    )  # fmt: skip
    net = replace(without_ranges(PAIR), points=points, rays=PAIR.rays.chosen(np.zeros(0, dtype=int)))
    assert named(net) == {DuplicateKind.SHOT: {frozenset(("S0", f"S{n - 1}"))}}


# --- cases


@pytest.mark.parametrize("name", ["lro_nac_lola", "moc_wa_three", "moc_wa_three_mola", "hadley_rig", "jigsaw_nac"])
def test_real_cases_have_nothing_twice(name: str, shared_data: Path) -> None:
    assert duplicates(mgsgraph.read_case(CASES / f"{name}.toml").network) == ()


def test_a_simulated_site_has_nothing_twice(tmp_path: Path) -> None:
    write_site(plain_site(), tmp_path)
    net = mgsgraph.read_case(tmp_path / "case.toml").network
    assert len(net.points) > 100
    assert duplicates(net) == ()


def test_lola_shots_given_twice_are_counted(shared_data: Path) -> None:
    """Field case 17."""
    case = mgsgraph.read_case(CASES / "lro_nac_lola.toml")
    laser = of_class(case.network, PointClass.LASER)
    for count in (35, laser.size):
        twice = given_again(case.network, laser[:count], places=rounded(5))
        (found,) = duplicates(twice)
        assert (found.kind, found.count, found.total) == (DuplicateKind.SHOT, count, laser.size + count)
        assert found.sentence in inventory(replace(case, network=twice))

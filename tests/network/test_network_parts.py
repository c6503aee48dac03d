"""Networks taken apart and put together: nothing is lost, every point is with its like; of measures, and of posts of
terrain models.
"""

from collections.abc import Iterable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from networks import network, pair, terrain, with_shift_and_surface
from odd_networks import random_network
from outside import refuses
from stereo_pair import stereo_network

from mgsgraph.errors import InputError
from mgsgraph.files.networks.tie_points import PointKind
from mgsgraph.geometry.body import planetocentric
from mgsgraph.geometry.records import Array
from mgsgraph.geometry.terrain import Gaps, TerrainGrid
from mgsgraph.network import GroundPoints, Network, PointClass, Ranges, SharedKind, Surface
from mgsgraph.network.observations import TerrainModel, build_network, posts_of, with_posts
from mgsgraph.network.parts import (
    KnownImage,
    Unknown,
    bundles,
    joined,
    known_images,
    select_points,
    unknowns,
    with_images,
    without_images,
)
from mgsgraph.units import DEG

SEEDS = st.integers(0, 10_000)
ANY = settings(max_examples=12, deadline=None, derandomize=True)


def measured_once(net: Network) -> Network:
    """The same with one ray of each point in each image, as files have it, some of them marked."""
    _, kept = np.unique(net.rays.point * len(net.images) + net.rays.image, return_index=True)
    rng = np.random.default_rng(kept.size)
    marks = {name: rng.random(kept.size) < 0.2 for name in ("back_projected", "rejected")}
    ranges = replace(net.ranges, rejected=rng.random(net.ranges.point.size) < 0.2)
    return replace(net, rays=replace(net.rays.chosen(kept), **marks), ranges=ranges)


def rows(net: Network, points: Iterable[int] | None = None) -> dict[str, Any]:
    """All that a network says of its points (or of some that have rows), by names instead of numbers."""
    names, ids = net.image_names, net.points.ids
    seen = set(net.rays.point.tolist()) | set(net.ranges.point.tolist())
    seen |= set() if net.stereo is None else set(np.flatnonzero(net.stereo.surface >= 0).tolist())
    some = seen if points is None else seen & set(points)
    rays, ranges, own, sigmas = net.rays, net.ranges, net.points, {}
    marks = [np.zeros(net.rays.point.size) if m is None else m for m in (rays.back_projected, rays.rejected)]
    out = np.zeros(ranges.point.size) if ranges.rejected is None else ranges.rejected
    found: dict[str, Any] = {
        "rays": sorted(
            (ids[i], names[j], *rays.places[k], *rays.sigmas[k], *(bool(m[k]) for m in marks))
            for k, (i, j) in enumerate(zip(rays.point.tolist(), rays.image.tolist(), strict=True)) if i in some
        ),
        "ranges": sorted(
            (ids[i], names[j], ranges.times[k], ranges.values[k], ranges.sigmas[k], bool(out[k]))
            for k, (i, j) in enumerate(zip(ranges.point.tolist(), ranges.image.tolist(), strict=True)) if i in some
        ),
        "points": {
            ids[i]: (own.classes[i], own.kinds[i], own.places[i].tobytes(), own.covariances[i].tobytes()) for i in some
        },
    }  # fmt: skip
    if net.shifts is not None:
        sigmas = dict(zip(net.shifts.names, net.shifts.sigmas.tolist(), strict=True))
        profile = {ids[i]: net.shifts.names[net.shifts.profile[i]] for i in some if net.shifts.profile[i] >= 0}
        found["shifts"] = {name: (of, sigmas[of]) for name, of in profile.items()}
    if net.surface is not None:
        on = {ids[i]: float(net.surface.sigmas[i]) for i in some if np.isfinite(net.surface.sigmas[i])}
        found["surface"] = (on, net.surface.shift_sigma, id(net.surface.grid)) if on else None
    if net.stereo is not None:
        control, names = net.stereo, net.image_names
        found["stereo"] = {
            ids[i]: (id(control.surfaces[s]), [names[j] for j in control.images[s]], control.sigmas[i],
                     bool(control.rejected is not None and control.rejected[i]))
            for i in some for s in control.surface[[i]].tolist() if s >= 0
        }  # fmt: skip
    return {key: value for key, value in found.items() if value}


def images(net: Network) -> dict[str, tuple[bytes, bool]]:
    """What is known of each image."""
    known = zip(net.images, net.priors, net.held.tolist(), strict=True)
    return {image.name: (prior.sigmas.tobytes(), held) for image, prior, held in known}


def felt(net: Network, i: int) -> set[Unknown]:
    """The adjusted unknowns on which the rows of a point depend."""
    of = {*net.rays.image[net.rays.point == i].tolist(), *net.ranges.image[net.ranges.point == i].tolist()}
    found = {Unknown("image", net.images[j].name) for j in of if not net.held[j]}
    if net.shifts is not None and net.shifts.profile[i] >= 0:
        found.add(Unknown("shift", net.shifts.names[net.shifts.profile[i]]))
    if net.surface is not None and net.terrain_moves and np.isfinite(net.surface.sigmas[i]):
        found.add(Unknown("shift", "terrain model"))
    return found


# --- bundles


@ANY
@given(SEEDS)
def test_bundles_joined_are_the_network(seed: int) -> None:
    net = measured_once(random_network(seed))
    again = joined(list(bundles(net).values()))
    assert rows(again) == rows(net)
    seen = {net.images[j].name for j in (*net.rays.image.tolist(), *net.ranges.image.tolist())}
    assert images(again) == {name: known for name, known in images(net).items() if name in seen}
    assert set(again.points.ids) == set(rows(net)["points"])


@ANY
@given(SEEDS)
def test_points_of_a_bundle_feel_exactly_its_members(seed: int) -> None:
    net = random_network(seed)
    whole = {name: felt(net, i) for i, name in enumerate(net.points.ids)}
    held = {Unknown("image", image.name) for image, one in zip(net.images, net.held, strict=True) if one}
    names = list[str]()
    for members, one in bundles(net).items():
        assert list(members) == sorted(set(members))
        assert not held & set(members)
        assert all(whole[name] == set(members) for name in one.points.ids)
        assert {u for u in unknowns(one) if u not in held} == set(members)
        names += one.points.ids
    assert len(names) == len(set(names))


@ANY
@given(SEEDS, st.randoms(use_true_random=False))
def test_joining_heeds_no_order(seed: int, shuffled: Any) -> None:
    parts = list(bundles(measured_once(random_network(seed))).values())
    before = rows(joined(parts))
    shuffled.shuffle(parts)
    assert rows(joined(parts)) == before
    half = len(parts) // 2
    if half:
        assert rows(joined([joined(parts[:half]), joined(parts[half:])])) == before


def test_shots_on_stereo_surfaces_keep_them() -> None:
    """Both images that show the surface are members, for shots that no range ties, too; without one it is gone."""
    net = stereo_network(pair(), displaced=False)
    assert net.stereo is not None
    net = replace(net, stereo=replace(net.stereo, rejected=np.arange(18) == 14))
    bare = replace(net, ranges=net.ranges.chosen(net.ranges.point != 13))
    for one in (net, bare):
        parts = bundles(one)
        assert rows(joined(list(parts.values()))) == rows(one)
        shots = next(members for members, one in parts.items() if "SHOT00002" in one.points.ids)
        assert shots == (*(Unknown("image", image.name) for image in net.images), Unknown("shift", "profile"))
    assert rows(with_images(select_points(net, np.array([14, 15])), known_images(net)[::-1])) == rows(net, [14, 15])
    left = without_images(net, {net.images[1].name})
    assert left is not None
    assert left.stereo is None
    assert len(left.points) == 18


def test_points_that_only_held_images_see_have_a_bundle_without_members() -> None:
    net = network(pair(), (True, True))
    assert list(bundles(net)) == [()]
    assert rows(bundles(net)[()]) == rows(net)


# --- parts


@ANY
@given(SEEDS, st.data())
def test_part_has_the_rows_of_its_points(seed: int, data: st.DataObject) -> None:
    net = measured_once(random_network(seed))
    seen = sorted({*net.rays.point.tolist(), *net.ranges.point.tolist()})
    chosen = np.array(data.draw(st.lists(st.sampled_from(seen), min_size=1, unique=True)))
    mine = select_points(net, chosen)
    assert mine.points.ids == tuple(net.points.ids[i] for i in chosen)
    assert rows(mine) == rows(net, chosen.tolist())
    of = {name for _, name, *_ in (*rows(mine).get("rays", []), *rows(mine).get("ranges", []))}
    assert list(images(mine)) == [image.name for image in net.images if image.name in of]
    assert images(mine).items() <= images(net).items()
    assert rows(select_points(mine, np.arange(chosen.size))) == rows(mine)


@ANY
@given(SEEDS, st.data())
def test_without_images_keeps_what_the_others_see(seed: int, data: st.DataObject) -> None:
    net = measured_once(random_network(seed))
    names = net.image_names
    gone = set(data.draw(st.lists(st.sampled_from(names), unique=True)))
    left, before = without_images(net, gone), rows(net)
    rest = {key: [row for row in before.get(key, []) if row[1] not in gone] for key in ("rays", "ranges")}
    names_left = {row[0] for key in rest for row in rest[key]}
    if not names_left:
        assert left is None
        return
    assert left is not None
    after = rows(left)
    assert {key: after.get(key, []) for key in rest} == rest
    assert set(left.points.ids) == names_left
    for key in ("points", "shifts"):
        assert after.get(key, {}) == {n: one for n, one in before.get(key, {}).items() if n in names_left}
    assert not gone & set(images(left))


@ANY
@given(SEEDS, st.randoms(use_true_random=False))
def test_with_images_in_any_order_and_number(seed: int, shuffled: Any) -> None:
    """Images that no measure names are welcome; what is known of the others is what is given."""
    net = random_network(seed)
    known = [KnownImage(image, net.priors[0], not held) for image, held in zip(net.images, net.held, strict=True)]
    more = [*known, KnownImage(replace(net.images[0], name="unseen"), net.priors[-1])]
    shuffled.shuffle(more)
    found = with_images(net, more)
    assert rows(found) == rows(net)
    assert [image.name for image in found.images] == [one.image.name for one in more]
    assert found.held.tolist() == [one.held for one in more]
    assert all(mine is one.prior for mine, one in zip(found.priors, more, strict=True))


# --- joining


def half(net: Network, image: int) -> Network:
    """What one image of the pair sees."""
    found = without_images(net, {net.images[1 - image].name})
    assert found is not None
    return found


def with_points(net: Network, **change: Any) -> Network:
    own = net.points
    fields = {name: getattr(own, name) for name in ("ids", "classes", "kinds", "places", "covariances")}
    return replace(net, points=GroundPoints(**fields | change))


@pytest.mark.parametrize("order", [(0, 1, 2), (2, 1, 0)])
def test_a_point_is_what_its_best_known_part_says(order: tuple[int, ...]) -> None:
    net = network(pair())
    n, places = len(net.points), np.concatenate([pair().true_ties, pair().true_footprints])
    free = with_points(half(net, 0), kinds=np.zeros(n), covariances=np.zeros((n, 3, 3)), places=places + 300.0)
    covariances = np.broadcast_to(np.eye(3), (n, 3, 3))
    third = replace(half(net, 1), images=(replace(net.images[1], name="third"),))
    constrained = with_points(
        half(net, 1), kinds=np.full(n, PointKind.CONSTRAINED), covariances=covariances, places=places + 5.0
    )
    fixed = with_points(third, kinds=np.full(n, PointKind.FIXED), covariances=np.zeros((n, 3, 3)), places=places)
    parts = (free, constrained, fixed)
    best = joined([parts[k] for k in order])
    of = {name: k for k, name in enumerate(best.points.ids)}
    where = [of[name] for name in fixed.points.ids]
    assert np.all(best.points.kinds == PointKind.FIXED)
    np.testing.assert_array_equal(best.points.places[where], places)
    assert not np.any(best.points.covariances)
    second = joined([parts[k] for k in order if k < 2])
    where = [second.points.ids.index(name) for name in constrained.points.ids]
    assert np.all(second.points.kinds == PointKind.CONSTRAINED)
    np.testing.assert_array_equal(second.points.places[where], places + 5.0)
    np.testing.assert_array_equal(second.points.covariances[where], covariances)


def test_equal_places_contradict_nothing() -> None:
    net = network(pair())
    assert rows(joined([half(net, 0), half(net, 1)])) == rows(net)


def test_first_guesses_of_free_points_contradict_nothing() -> None:
    net = network(pair())
    moved = np.where((net.points.kinds == PointKind.FREE)[:, None], net.points.places + 1e3, net.points.places)
    assert len(joined([half(net, 0), with_points(half(net, 1), places=moved)]).points) == len(net.points)


@pytest.mark.parametrize("change", ["grid", "shift"])
def test_two_terrain_models_are_refused(change: str) -> None:
    net = with_shift_and_surface(network(pair()))
    one, two = half(net, 0), half(net, 1)
    assert two.surface is not None
    sigmas = two.surface.sigmas
    other = Surface(terrain(net), sigmas, 150.0) if change == "grid" else Surface(two.surface.grid, sigmas, 10.0)
    refuses("another terrain model", joined, [one, replace(two, surface=other)])


# --- observations


def test_observations_become_the_network_that_a_case_makes() -> None:
    """Against the network that the tests' own module puts together row by row."""
    drawn, noise = pair(), pair().settings.noise
    images_by_name = {image.name: KnownImage(image, noise.prior) for image in drawn.images}
    found = build_network(images_by_name, [drawn.ties, drawn.laser], noise.tie, noise.shot_image)
    assert found is not None
    assert rows(found) == rows(network(drawn))


def test_no_measures_are_no_network() -> None:
    drawn = pair()
    none = replace(
        drawn.ties, measure_point=np.zeros(0, dtype=int), measure_image=(), measures=np.zeros((0, 2)),
        measure_sigmas=np.zeros((0, 2)),
    )  # fmt: skip
    assert build_network({}, [none]) is None
    assert build_network({}, []) is None


def test_stated_sigmas_count_and_absent_ones_are_the_default() -> None:
    drawn = pair()
    known = {image.name: KnownImage(image, drawn.settings.noise.prior) for image in drawn.images}
    sigmas = np.full_like(drawn.ties.measures, np.nan)
    sigmas[0] = 0.25
    found = build_network(known, [replace(drawn.ties, measure_sigmas=sigmas)], tie_sigma=3.0)
    assert found is not None
    assert found.rays.sigmas[0].tolist() == [0.25, 0.25]
    assert np.all(found.rays.sigmas[1:] == 3.0)
    assert isinstance(found.ranges, Ranges)
    assert found.ranges.point.size == 0


# --- posts of terrain models as points: means of cells, their places, sigmas and unknowns

RADIUS = 3_390_000.0
STEP = DEG / 128.0
SIDE = RADIUS * STEP


def model(radii: Array, latitude: float = 0.0, **more: object) -> TerrainModel:
    """Posts from a latitude southward; 10 m each."""
    sigmas = {"vertical_sigma": 10.0, "planimetric_sigma": 200.0}
    return TerrainModel("dtm", TerrainGrid("dtm.tif", radii, 0.3, latitude, STEP, STEP, **sigmas).lattice(), **more)  # type: ignore[arg-type]


def plane(rows: int, columns: int) -> Array:
    """A radius that grows by 3 m a row and 2 m a column."""
    row, column = np.indices((rows, columns), dtype=np.float64)
    return RADIUS + 3.0 * row + 2.0 * column


def test_posts_are_where_the_grid_has_them() -> None:
    posts = posts_of(model(plane(4, 5)), 0.0)
    assert len(set(posts.ids)) == len(posts.ids) == 20
    assert posts.ids[6] == "dtm:2:2"
    assert np.linalg.norm(posts.points, axis=1) == pytest.approx(plane(4, 5).ravel(), abs=1e-6)
    longitude, latitude, _ = planetocentric(posts.points).T
    assert (longitude - 0.3) / STEP == pytest.approx(np.tile(np.arange(5.0), 4), abs=1e-6)
    assert latitude / STEP == pytest.approx(-np.repeat(np.arange(4.0), 5), abs=1e-6)
    assert posts.sigmas == pytest.approx(np.full(20, 10.0))
    assert posts.footprint == pytest.approx(4.0 / np.sqrt(12.0) * SIDE, rel=1e-3)  # the second moment of a square


@pytest.mark.parametrize("holes", [0, 5])
def test_means_of_cells_lie_on_a_plane_wherever_posts_are_missing(holes: int) -> None:
    """A mean height belongs to the mean place of its posts; its sigma is theirs by the root of their number."""
    radii = plane(12, 15)
    chosen = np.random.default_rng(holes).choice(radii.size, holes, replace=False)
    radii.ravel()[chosen] = np.nan
    posts = posts_of(model(radii), 3.0 * SIDE)
    longitude, latitude, radius = planetocentric(posts.points).T
    assert radius == pytest.approx(RADIUS - 3.0 * latitude / STEP + 2.0 * (longitude - 0.3) / STEP, abs=1e-4)
    assert len(posts.ids) == 20
    assert np.sum(100.0 / posts.sigmas**2) == pytest.approx(180 - holes)
    assert posts.footprint == pytest.approx(3.0 * 4.0 / np.sqrt(12.0) * SIDE, rel=1e-3)


def test_cells_are_about_as_wide_as_high_near_the_pole() -> None:
    """At 60 degrees a column is half as wide as a row is high."""
    posts = posts_of(model(plane(4, 8), 60.0 * DEG), 0.0)
    assert len(posts.ids) == 16
    assert posts.footprint == pytest.approx(4.0 / np.sqrt(12.0) * SIDE, rel=0.01)


def test_a_cell_of_few_posts_is_none() -> None:
    radii = plane(4, 4)
    radii[:2, 1:3] = np.nan
    posts = posts_of(model(radii), 2.0 * SIDE)
    assert [name[4:] for name in posts.ids] == ["3:1", "3:3"]
    assert posts.sigmas == pytest.approx(np.full(2, 5.0))


@pytest.mark.parametrize("side", [1.0, 2.0])
def test_cells_in_one_gap_are_worth_no_more_than_its_error(side: float) -> None:
    """Sixteen posts between two tracks that are off by 7 m nearly as one, however they are averaged."""
    between = np.zeros((4, 12))
    between[:, 4:8] = 7.0
    lattice = replace(model(plane(4, 12)).lattice, gaps=Gaps(between, np.full((4, 12), 6.0 * SIDE)))
    posts = posts_of(TerrainModel("dtm", lattice), side * SIDE)
    within = posts.sigmas > 11.0 / side
    assert np.count_nonzero(within) == 16 / side**2
    together = 1.0 / np.sum(posts.sigmas[within] ** -2.0)
    assert together == pytest.approx(0.8 * 7.0**2 + 10.0**2 / 16.0, rel=0.05)
    assert posts.sigmas[~within] == pytest.approx(np.full(32 // int(side**2), 10.0 / side))


def test_what_is_not_known_is_said() -> None:
    with pytest.raises(InputError, match="no sigma of its heights"):
        posts_of(TerrainModel("dtm", replace(model(plane(4, 4)).lattice, vertical_sigma=None)), 0.0)
    with pytest.raises(InputError, match="no sigma of its horizontal place"):
        TerrainModel("dtm", replace(model(plane(4, 4)).lattice, planimetric_sigma=None))


def test_models_become_profiles_of_their_own() -> None:
    """Two of them, one of unknown height; what was there stays what it was."""
    net = with_shift_and_surface(network(pair()))
    assert net.shifts is not None
    first, second = model(plane(4, 5), height_sigma=3.0), replace(model(plane(3, 3)), name="other")
    found = with_posts(net, [(one, posts_of(one, 0.0)) for one in (first, second)])
    assert found.shifts is not None
    n = len(net.points)
    assert found.points.ids[:n] == net.points.ids
    assert found.shifts.names == (*net.shifts.names, "dtm", "other")
    assert found.shifts.sigmas[-2:].tolist() == [200.0, 200.0]
    assert np.bincount(found.shifts.profile[n:]).tolist()[-2:] == [20, 9]
    assert set(found.points.classes[n:].tolist()) == {PointClass.POST}
    assert set(found.points.kinds[n:].tolist()) == {PointKind.CONSTRAINED}
    (height,) = (one for one in found.shared if one.kind is SharedKind.PROFILE_HEIGHT)
    assert (height.profile, height.sigmas[0]) == ("dtm", 3.0)
    up = found.points.places[n:] / np.linalg.norm(found.points.places[n:], axis=1, keepdims=True)
    variances = np.einsum("ni,nij,nj->n", up, found.points.covariances[n:], up)
    assert variances == pytest.approx(np.full(29, 100.0))
    assert found.surface is not None
    assert not np.any(np.isfinite(found.surface.sigmas[n:]))
    assert found.classes[-1] is PointClass.POST
    assert PointClass.POST not in net.classes

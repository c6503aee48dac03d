"""After every change the incremental result is batch's, however the images came and went; what is refused, in one clear
line, leaves it as it stood.
"""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from increments import (
    NOISE,
    Places,
    State,
    by_image,
    distances,
    fan,
    grown,
    largest_difference,
    network_of,
    own_measures,
    places_of,
    slope,
    state_of,
    strip,
    take,
    take_alone,
)
from outside import refuses

from mgsgraph.adjustment.adjust import adjust_network
from mgsgraph.adjustment.incremental.impact import EXACT
from mgsgraph.adjustment.incremental.incremental import IncrementalAdjustment
from mgsgraph.adjustment.incremental.state import Bundle, InMemory
from mgsgraph.adjustment.settings import SolverSettings
from mgsgraph.errors import InputError, PointBehindCamera
from mgsgraph.files.networks.tie_points import PointKind, TiePoints
from mgsgraph.geometry.altimetry import LaserProfile
from mgsgraph.geometry.orientation import OrientationPrior
from mgsgraph.network import TERRAIN, Network, PointClass, ProfileShifts, Surface
from mgsgraph.network.parts import KnownImage, Members, Unknown

FAN = 5
ONE_START = SolverSettings(starts=0)
"""Where a terrain model of one slope may shift: there is one minimum."""


def by_batch(adjustment: IncrementalAdjustment) -> Any:
    """Batch over everything that an incremental adjustment holds."""
    return adjust_network(adjustment.network, adjustment.settings)


# --- a strip that grows


def test_every_addition_gives_what_batch_gives() -> None:
    """Eight images of 15 ties, and the end of the path after the check against batch."""
    made, adjustment = strip(8, 15, 5), IncrementalAdjustment()
    for k in range(8):
        impact = take(adjustment, made, k)
        assert impact.converged
        found = distances(adjustment, by_batch(adjustment))
        assert found.within(), f"after image {k}: {found}"
    before = distances(adjustment, by_batch(adjustment))
    check, solution = adjustment.verify()
    assert check.close
    assert check.worst == pytest.approx(max(before.unknowns, before.points), rel=1e-3)
    assert check.adopted == (check.worst > EXACT)
    assert distances(adjustment, solution).within(EXACT)
    assert adjustment.verify()[0].worst < EXACT


@pytest.mark.parametrize("images", [2, 3])
def test_a_solution_of_other_images_is_adopted_with_its_images(images: int) -> None:
    """Of fewer images, and of images of which one is held now."""
    made = fan()
    adjustment, net = grown(made, 3), grown(made, images).network
    solution = adjust_network(replace(net, held=np.arange(images) == 0), SolverSettings())
    adjustment.adopt(solution)
    assert adjustment.images == net.image_names
    assert distances(adjustment, solution).within(EXACT)
    assert adjustment.store.image("FAN/0").held


# --- in any order, there and back


# above two seconds: five orders of up to ten changes, each with its batch
@settings(max_examples=5, deadline=None, derandomize=True)
@given(st.permutations(range(FAN)), st.lists(st.integers(0, FAN - 1), max_size=5))
def test_any_order_of_additions_and_removals_ends_at_batch_of_what_is_left(first: list[int], then: list[int]) -> None:
    """Batch over a network that no increment had a hand in; each image brings its own measures only."""
    made, adjustment = fan(FAN), IncrementalAdjustment()
    names, there = [image.name for image in made.images], set[int]()
    for k in (*first, *then):
        if k in there:
            adjustment.remove(names[k])
        else:
            take_alone(adjustment, made, k)
        there ^= {k}
    assert set(adjustment.images) == {names[k] for k in there}
    if there:
        found = distances(adjustment, adjust_network(network_of(made, sorted(there)), SolverSettings()))
        assert found.within(), found


def test_an_image_may_take_another_ones_place() -> None:
    """Removed, and added again with other sigmas under the same name."""
    made = fan(3)
    adjustment = grown(made, 3)
    adjustment.remove("FAN/1")
    prior = replace(NOISE, position=5.0).prior
    adjustment.add(KnownImage(made.images[1], prior), own_measures(made, "FAN/1"), shot_sigma=NOISE.shot_image)
    batch = by_batch(adjustment)
    assert distances(adjustment, batch).within()
    j = batch.network.image_names.index("FAN/1")
    assert np.array_equal(batch.network.priors[j].sigmas, prior.sigmas)


# --- images that hang by nothing


def test_an_unconnected_image_is_named_and_connected_later() -> None:
    made, adjustment = fan(4), IncrementalAdjustment()
    for k in range(3):
        take_alone(adjustment, made, k)
    before = state_of(adjustment), places_of(adjustment)
    name = made.images[3].name
    impact = adjustment.add(made.images[3], prior=NOISE.prior)
    assert impact.unconnected == (name,)
    assert name in impact.sentences[0]
    assert "Unconnected" in impact.sentences[0]
    assert impact.neighbours == {}
    assert not np.any(adjustment.correction(name).coefficients)
    np.testing.assert_allclose(adjustment.covariance(name), np.diag(NOISE.prior.sigmas.ravel() ** 2), rtol=1e-9)
    del (after := state_of(adjustment))[name]
    assert all(np.array_equal(after[n][0], before[0][n][0]) for n in before[0])
    joined = adjustment.add([], own_measures(made, name), shot_sigma=NOISE.shot_image)
    assert name in joined.images.names
    assert joined.unconnected == ()
    assert distances(adjustment, by_batch(adjustment)).within()
    assert distances(adjustment, adjust_network(network_of(made, range(4)), SolverSettings())).within()


# --- every kind of row and loss


def rich(held: tuple[int, ...] = ()) -> Network:
    """The fan with a shift of each laser profile, its ties on a terrain model that may shift."""
    net = network_of(fan(FAN, known=held), range(FAN))
    laser = net.points.classes == PointClass.LASER
    of = [name.split("-")[0] if one else "" for name, one in zip(net.points.ids, laser, strict=True)]
    names = tuple(sorted(set(of) - {""}))
    shifts = ProfileShifts(names, np.array([names.index(n) if n else -1 for n in of]), np.full(len(names), 60.0))
    surface = Surface(slope(net), np.where(laser, np.inf, 250.0), 5000.0)
    return replace(net, shifts=shifts, surface=surface, held=np.isin(np.arange(FAN), held))


@pytest.mark.parametrize(
    ("choices", "held"),
    [
        ({}, (1,)),
        ({"loss": "cauchy"}, (0, 3)),
        ({"angles": "opk-peer", "line": "measured", "loss": "huber"}, ()),
    ],
)
def test_shifts_terrain_losses_and_held_images(choices: dict[str, Any], held: tuple[int, ...]) -> None:
    net = rich(held)
    adjustment = IncrementalAdjustment(replace(ONE_START, **choices))
    for k in (3, 0, 4, 1, 2):
        adjustment.add(by_image(net)[k])
    batch = adjust_network(net, adjustment.settings)
    assert len(batch.network.shift_names) == 4
    assert distances(adjustment, batch).within(), distances(adjustment, batch)
    adjustment.remove("FAN/4")
    found = distances(adjustment, by_batch(adjustment))
    assert found.within(), found


def test_considered_shifts_are_carried_as_by_batch() -> None:
    """Of a profile and the terrain model; an image that knows nothing of them has it from its neighbours."""
    net = rich((1,))
    assert net.surface is not None
    net = replace(net, surface=replace(net.surface, shift_sigma=150.0), considered=(net.shift_names[0], TERRAIN))
    adjustment = IncrementalAdjustment(ONE_START)
    for k in (3, 0, 4, 1, 2):
        adjustment.add(by_image(net)[k])
    assert adjustment.network.considered == net.considered
    batch, plain = (adjust_network(one, adjustment.settings) for one in (net, replace(net, considered=())))
    found = distances(adjustment, batch)
    assert found.within(), found
    assert np.max(batch.sigmas / plain.sigmas) > 2.0
    assert distances(IncrementalAdjustment.of(batch), batch).within(EXACT)
    adjustment.remove("FAN/4")
    assert distances(adjustment, by_batch(adjustment)).within()
    assert adjustment.verify()[0].close


def test_images_that_are_all_held_leave_intersection() -> None:
    """And the shifts; there is no orientation to adjust."""
    net = rich(tuple(range(FAN)))
    adjustment = IncrementalAdjustment(ONE_START)
    for one in by_image(net):
        adjustment.add(one)
    batch = adjust_network(net, adjustment.settings)
    assert set(adjustment.values) == {Unknown("shift", name) for name in net.shift_names}
    assert distances(adjustment, batch).within(), distances(adjustment, batch)


def test_the_terrain_s_shift_stays_while_points_without_a_place_lie_on_it() -> None:
    """Ties that only one image is left to see have no place, but belong to the bundle that feels the shift."""
    net = rich()
    adjustment = IncrementalAdjustment(ONE_START)
    for one in by_image(net)[:2]:
        adjustment.add(one)
    assert Unknown("shift", "terrain model") in adjustment.values
    impact = adjustment.remove("FAN/0")
    assert impact.undetermined
    assert distances(adjustment, by_batch(adjustment)).within()
    adjustment.add(by_image(net)[4])
    adjustment.remove("FAN/4")  # which has nothing to do with the other one's points
    assert Unknown("shift", "terrain model") in adjustment.values
    adjustment.add(by_image(net)[0])
    assert distances(adjustment, by_batch(adjustment)).within()


def test_a_shift_goes_with_the_last_points_that_feel_it() -> None:
    net = rich()
    adjustment = IncrementalAdjustment(ONE_START)
    for one in by_image(net):
        adjustment.add(one)
    for left in (4, 3, 2, 1):
        adjustment.remove(f"FAN/{left}")
        shifts = {unknown.name for unknown in adjustment.values if unknown.kind == "shift"}
        assert shifts == set(adjustment.network.shift_names)
    assert len(shifts) < len(net.shift_names)


# --- what is there already


def test_what_is_known_of_an_image_stays_when_observations_of_it_come() -> None:
    """A network names images that are there: they are not new, and not held because it says so."""
    net = rich()
    first, second = by_image(net)[:2]
    adjustment = IncrementalAdjustment(ONE_START)
    adjustment.add(first)
    both = replace(
        second, images=(*first.images, *second.images), priors=(replace(NOISE, position=1.0).prior, *second.priors),
        held=np.array([True, False]), rays=replace(second.rays, image=second.rays.image + 1),
        ranges=replace(second.ranges, image=second.ranges.image + 1),
    )  # fmt: skip
    adjustment.add(both)
    other = IncrementalAdjustment(ONE_START)
    for one in (first, second):
        other.add(one)
    assert largest_difference(adjustment, (state_of(other), places_of(other))) < 1e-6
    assert distances(adjustment, by_batch(adjustment)).within()


class Shut(InMemory):
    """A store whose points can be locked away."""

    shut = False

    def bundle(self, members: Members) -> Bundle:
        """A bundle, unless shut."""
        assert not self.shut, "points were asked for"
        return super().bundle(members)


def test_it_is_rebuilt_from_reduced_systems_alone() -> None:
    store = Shut()
    before = IncrementalAdjustment(store=store)
    for k in range(6):
        take(before, strip(), k)
    store.shut = True
    after = IncrementalAdjustment(before.settings, store)
    assert after.images == before.images
    was, now = state_of(before), state_of(after)
    for name, (value, covariance) in was.items():
        sigmas = np.sqrt(np.diag(covariance))
        assert np.max(np.abs(now[name][0] - value) / sigmas) < 1e-9
        assert np.max(np.abs(now[name][1] - covariance) / np.outer(sigmas, sigmas)) < 1e-9
    store.shut = False
    take(after, strip(7), 6)
    assert distances(after, by_batch(after)).within()


# --- what a reviewer found


def test_points_that_batch_could_not_place_are_no_blunders() -> None:
    """Nadir images alone: many rays are parallel. Images that converge come later, and make good points of them."""
    made = strip(4, 30, 5)
    few = IncrementalAdjustment()
    for k in (0, 2, 1):
        take_alone(few, made, k)
    solution = by_batch(few)
    assert 0 < np.count_nonzero(~solution.determined) < solution.determined.size
    again = IncrementalAdjustment.of(solution)
    rejected = [again.store.bundle(members).network.rays.rejected for members in again.store.members()]
    assert not any(np.any(marks) for marks in rejected)
    take_alone(again, made, 3)
    assert distances(again, by_batch(again)).within()


def test_blunders_of_batch_stay_out_until_batch_looks_again() -> None:
    made = fan()
    net = grown(made, 4).network
    places = net.rays.places.copy()
    wrong = int(np.flatnonzero(net.points.classes[net.rays.point] == 0)[3])
    places[wrong] += 60.0
    solution = adjust_network(replace(net, rays=replace(net.rays, places=places)), SolverSettings(reject=6.0))
    assert solution.rays_rejected is not None
    assert solution.rays_rejected[wrong]
    adjustment = IncrementalAdjustment.of(solution)
    marks = sum(int(adjustment.store.bundle(m).network.rays.rejected.sum()) for m in adjustment.store.members())
    assert marks == np.count_nonzero(solution.rays_rejected)
    assert distances(adjustment, solution).within()


def test_batch_that_does_not_converge_is_not_taken_over() -> None:
    adjustment = grown(fan(), 3)
    before = dict(adjustment.values)
    adjustment.settings = replace(adjustment.settings, max_iterations=1)
    check, solution = adjustment.verify()
    assert not solution.converged
    assert not check.adopted
    assert "did not converge" in check.sentence
    assert all(np.array_equal(before[unknown], value) for unknown, value in adjustment.values.items())


# --- what is refused

MADE = fan()
NEW = MADE.images[3]
MEASURES = own_measures(MADE, NEW.name)


def ties() -> TiePoints:
    """What the new image sees of tie points."""
    found = MEASURES[0]
    assert isinstance(found, TiePoints)
    return found


def shots(k: int = 0) -> LaserProfile:
    """What it sees of a laser profile."""
    found = MEASURES[1 + k]
    assert isinstance(found, LaserProfile)
    return found


def renamed(observations: TiePoints, image: str) -> TiePoints:
    return replace(observations, measure_image=(image,) * len(observations.measure_image))


def doubled(profile: LaserProfile) -> LaserProfile:
    """Its footprints far above the spacecraft, under new names."""
    return replace(profile, ids=tuple(f"up {name}" for name in profile.ids), footprints=2.0 * profile.footprints)


def known(where: TiePoints, kind: PointKind) -> TiePoints:
    """The same points with their true places as a-priori ones."""
    n, spread = len(where.ids), np.eye(3) if kind == PointKind.CONSTRAINED else np.zeros((3, 3))
    places = np.array([MADE.true_ties[MADE.ties.ids.index(name)] for name in where.ids])
    return replace(where, kinds=np.full(n, kind), places=places, covariances=np.broadcast_to(spread, (n, 3, 3)))


def moved(profile: LaserProfile) -> LaserProfile:
    return replace(profile, footprints=profile.footprints + 30.0)


def endless() -> KnownImage:
    sigmas = NOISE.prior.sigmas.copy()
    sigmas[0, 0] = np.inf
    return KnownImage(NEW, OrientationPrior(sigmas))


Attempt = Callable[[IncrementalAdjustment], Any]
REFUSED: dict[str, tuple[Attempt, str]] = {
    "image twice": (lambda a: a.add(MADE.images[0], own_measures(MADE, "FAN/0")), r"image FAN/0: in the adjustment"),
    "unknown image in ties": (lambda a: a.add(NEW, renamed(ties(), "nowhere")), r"measures in the image 'nowhere'"),
    "measured before": (lambda a: a.add([], own_measures(MADE, "FAN/1")), r"image FAN/1: measured there before"),
    "outside": (lambda a: a.add(NEW, replace(ties(), measures=ties().measures + 5e4)), r"a place inside 5000 lines"),
    "another place": (lambda a: a.add(NEW, moved(shots())), r"two a-priori places, 52 m apart"),
    "another class": (
        lambda a: a.add(NEW, replace(ties(), ids=(shots().ids[0], *ties().ids[1:]))),
        rf"point {shots().ids[0]}: of two classes",
    ),
    "behind": (lambda a: a.add(NEW, [ties(), doubled(shots())]), r"point up S000.*lies behind the camera"),
    "no prior": (lambda a: a.add(endless(), MEASURES), r"image FAN/3: a coefficient without an a-priori sigma"),
    "remove unknown": (lambda a: a.remove("FAN/0", "nowhere"), r"image nowhere: no such image"),
    "covariance": (lambda a: a.covariance("FAN/0", "nowhere"), r"image nowhere: no such image"),
    "point": (lambda a: a.points(["nowhere"]), r"point nowhere: no such point"),
}


@pytest.fixture(scope="module")
def three() -> tuple[IncrementalAdjustment, tuple[State, Places]]:
    """Three images, and how they stand."""
    adjustment = grown(MADE, 3)
    return adjustment, (state_of(adjustment), places_of(adjustment))


@pytest.mark.parametrize("what", REFUSED)
def test_it_is_refused_and_nothing_has_changed(
    what: str, three: tuple[IncrementalAdjustment, tuple[State, Places]]
) -> None:
    """Values, covariances, points, images and bundles."""
    (attempt, says), (adjustment, before) = REFUSED[what], three
    bundles = stored(adjustment)
    with pytest.raises(InputError, match=says) as caught:
        attempt(adjustment)
    assert "\n" not in str(caught.value)
    assert isinstance(caught.value, PointBehindCamera) == (what == "behind")
    assert adjustment.images == ["FAN/0", "FAN/1", "FAN/2"]
    assert stored(adjustment) == bundles
    assert largest_difference(adjustment, before) < 1e-7


def stored(adjustment: IncrementalAdjustment) -> set[tuple[str, ...]]:
    """Which points lie together in the store."""
    return {tuple(adjustment.store.bundle(members).network.points.ids) for members in adjustment.store.members()}


def test_values_that_moved_unnoticed_are_back_as_well() -> None:
    """A tie of little weight moves the strip's far end by less than is recorded; after a failure the tree is grown
    anew, and says what it said before.
    """
    made = strip()
    adjustment = grown(made, 6)
    recorded, ties = adjustment.store.shared(), made.ties
    names = [made.images[k].name for k in (4, 5)]
    seen = {(p, n): k for k, (p, n) in enumerate(zip(ties.measure_point.tolist(), ties.measure_image, strict=True))}
    rows = next([seen[p, n] for n in names] for p in range(len(ties.ids)) if all((p, n) in seen for n in names))
    light = replace(
        ties, ids=("light",), kinds=ties.kinds[:1], places=ties.places[:1], covariances=ties.covariances[:1],
        measure_point=np.zeros(2, dtype=int), measure_image=tuple(names), measures=ties.measures[rows] + [[0.0], [9.0]],
        measure_sigmas=np.full((2, 2), 100.0),
    )  # fmt: skip
    adjustment.add([], light)
    before = state_of(adjustment), places_of(adjustment)
    first = Unknown("image", made.images[0].name)
    assert adjustment.store.shared()[first] is recorded[first]
    assert np.any(adjustment.values[first] != recorded[first].value)
    with pytest.raises(PointBehindCamera):
        adjustment.add(NEW, doubled(shots()), NOISE.prior)
    assert largest_difference(adjustment, before) < 1e-7


def test_a_store_that_fails_leaves_the_engine_as_it_was() -> None:
    """The disk is full: what the store has not taken, nobody may believe."""

    class Full(InMemory):
        full = False

        def add_image(self, known: KnownImage) -> None:
            if self.full:
                raise OSError("no space left")
            super().add_image(known)

    store = Full()
    adjustment = IncrementalAdjustment(store=store)
    for k in range(3):
        take(adjustment, MADE, k)
    before, store.full = (state_of(adjustment), places_of(adjustment)), True
    with pytest.raises(OSError, match="no space"):
        take(adjustment, MADE, 3)
    assert largest_difference(adjustment, before) < 1e-7
    store.full = False
    take(adjustment, MADE, 3)
    assert distances(adjustment, by_batch(adjustment)).within()


def test_held_images_have_no_covariance() -> None:
    adjustment = IncrementalAdjustment()
    adjustment.add(KnownImage(MADE.images[0], NOISE.prior, held=True), own_measures(MADE, "FAN/0"))
    assert not np.any(adjustment.correction("FAN/0").coefficients)
    refuses("FAN/0: held", adjustment.covariance, "FAN/0")


@pytest.mark.parametrize("kind", [PointKind.CONSTRAINED, PointKind.FIXED])
def test_a_point_may_become_known(kind: PointKind) -> None:
    """Free so far, then a later image's file says where it is."""
    adjustment = grown(MADE, 3)
    adjustment.add(NEW, known(ties(), kind))
    batch = by_batch(adjustment)
    points = [batch.network.points.ids.index(name) for name in ties().ids]
    assert np.all(batch.network.points.kinds[points] == kind)
    assert np.all(batch.network.points.classes[points] == PointClass.TIE)
    assert distances(adjustment, batch).within()

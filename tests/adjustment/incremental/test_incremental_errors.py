"""What an incremental adjustment refuses, in one clear line, and that it stands afterwards as it did before."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from increments import (
    NOISE,
    Places,
    State,
    apart,
    distances,
    fan,
    grown,
    own_measures,
    places_of,
    state_of,
    strip,
    take,
)

from mgsgraph.adjustment.adjust import adjust_network
from mgsgraph.adjustment.incremental.incremental import IncrementalAdjustment
from mgsgraph.adjustment.incremental.state import InMemory
from mgsgraph.errors import InputError, PointBehindCamera
from mgsgraph.files.networks.tie_points import PointKind, TiePoints
from mgsgraph.geometry.altimetry import LaserProfile
from mgsgraph.geometry.orientation import OrientationPrior
from mgsgraph.network import PointClass
from mgsgraph.network.parts import KnownImage, Unknown

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
    assert apart(adjustment, before) < 1e-7


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
    assert apart(adjustment, before) < 1e-7


def test_a_store_that_fails_leaves_the_engine_as_it_was() -> None:
    """The disk is full: what the store has not taken, nobody may believe."""

    class Full(InMemory):
        full = False

        def put_image(self, known: KnownImage) -> None:
            if self.full:
                raise OSError("no space left")
            super().put_image(known)

    store = Full()
    adjustment = IncrementalAdjustment(store=store)
    for k in range(3):
        take(adjustment, MADE, k)
    before, store.full = (state_of(adjustment), places_of(adjustment)), True
    with pytest.raises(OSError, match="no space"):
        take(adjustment, MADE, 3)
    assert apart(adjustment, before) < 1e-7
    store.full = False
    take(adjustment, MADE, 3)
    assert distances(adjustment, adjust_network(adjustment.network, adjustment.settings)).within()


def test_held_images_have_no_covariance() -> None:
    adjustment = IncrementalAdjustment()
    adjustment.add(KnownImage(MADE.images[0], NOISE.prior, held=True), own_measures(MADE, "FAN/0"))
    assert not np.any(adjustment.correction("FAN/0").coefficients)
    with pytest.raises(InputError, match="FAN/0: held"):
        adjustment.covariance("FAN/0")


@pytest.mark.parametrize("kind", [PointKind.CONSTRAINED, PointKind.FIXED])
def test_a_point_may_become_known(kind: PointKind) -> None:
    """Free so far, then a later image's file says where it is."""
    adjustment = grown(MADE, 3)
    adjustment.add(NEW, known(ties(), kind))
    batch = adjust_network(adjustment.network, adjustment.settings)
    points: Sequence[int] = [batch.network.points.ids.index(name) for name in ties().ids]
    assert np.all(batch.network.points.kinds[points] == kind)
    assert np.all(batch.network.points.classes[points] == PointClass.TIE)
    assert distances(adjustment, batch).within()

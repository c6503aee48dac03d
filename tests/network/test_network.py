"""The network: what it refuses, and what it knows of its own connections."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mgsgraph.errors import EphemerisGap, InputError
from mgsgraph.files.networks.tie_points import PointKind
from mgsgraph.geometry.body import Ellipsoid
from mgsgraph.geometry.orientation import OrientationPrior
from mgsgraph.network import GroundPoints, ImageRays, Network, PointClass, ProfileShifts, Ranges, Surface
from mgsgraph.network.connectivity import _common_by_class, groups
from mgsgraph.simulation.pair import simulate_pair

PAIR = simulate_pair()
PRIOR = PAIR.settings.noise.prior
NO_RANGES = Ranges(
    np.zeros(0, dtype=int), np.zeros(0, dtype=int), np.zeros(0), np.zeros(0), np.zeros(0)
)


def points(of: list[PointKind] | None = None, **change: Any) -> GroundPoints:
    """Points of the given kinds; three free ones by default."""
    kinds = of or [PointKind.FREE] * 3
    fields: dict[str, Any] = {
        "ids": tuple(f"P{i}" for i in range(len(kinds))),
        "classes": [PointClass.TIE] * len(kinds),
        "kinds": kinds,
        "places": [[3.39e6, 0.0, 100.0 * i] if kind else [np.nan] * 3 for i, kind in enumerate(kinds)],
        "covariances": [100.0 * np.eye(3) if kind == PointKind.CONSTRAINED else np.zeros((3, 3)) for kind in kinds],
    }
    return GroundPoints(**fields | change)


def rays(pairs: list[tuple[int, int]]) -> ImageRays:
    point, image = np.array(pairs, dtype=int).reshape(-1, 2).T
    return ImageRays(point, image, np.full((len(pairs), 2), 50.5), np.ones((len(pairs), 2)))


def network(pairs: list[tuple[int, int]], among: int = 2, **change: Any) -> Network:
    """Points P0, P1, ... seen in images by (point, image) pairs."""
    count = max((point for point, _ in pairs), default=-1) + 1
    fields: dict[str, Any] = {
        "images": tuple(replace(PAIR.images[j % 2], name=f"I{j}") for j in range(among)),
        "priors": (PRIOR,) * among,
        "held": [False] * among,
        "points": points([PointKind.FREE] * max(count, 1)),
        "rays": rays(pairs),
        "ranges": NO_RANGES,
    }
    return Network(**fields | change)


STEREO = [(0, 0), (0, 1), (1, 0), (1, 1), (2, 0)]


def test_what_is_given_is_copied_and_can_not_be_written() -> None:
    net = network(
        STEREO, points=points([PointKind.CONSTRAINED] * 3), shifts=ProfileShifts(("A",), np.zeros(3, int), np.ones(1)),
        surface=Surface(GRID, np.full(3, np.inf)),
    )  # fmt: skip
    assert net.shifts is not None
    assert net.surface is not None
    arrays = (net.shifts.profile, net.shifts.sigmas, net.surface.sigmas, net.rays.back_projected,
              net.held, net.rays.point, net.rays.image, net.rays.places, net.rays.sigmas, net.ranges.times,
              net.points.kinds, net.points.classes, net.points.places, net.points.covariances)  # fmt: skip

    assert not any(array.flags.writeable for array in arrays)


def test_it_says_what_it_is() -> None:
    classes = [PointClass.TIE, PointClass.LASER, PointClass.TIE]
    net = network(STEREO, points=points([PointKind.FREE, PointKind.CONSTRAINED, PointKind.FREE], classes=classes))

    assert repr(net) == "Network(2 images, 3 points (2 tie, 1 laser), 5 rays, 0 ranges)"
    assert [(kind.name, members.tolist()) for kind, members in net.of_class()] == [("TIE", [0, 2]), ("LASER", [1])]
    assert len(net.points) == 3


# --- connections


def test_counts_and_undetermined_points() -> None:
    """One ray does not place a free point; a point that is known needs none."""
    net = network([*STEREO, (4, 1)], points=points([PointKind.FREE] * 3 + [PointKind.FIXED, PointKind.CONSTRAINED]))
    np.testing.assert_array_equal(net.ray_counts, [2, 2, 1, 0, 1])
    np.testing.assert_array_equal(net.undetermined, [False, False, True, False, False])


def common_points(net: Network) -> np.ndarray:
    """(images, images) number of points seen by both; on the diagonal, seen by the image."""
    pairs, shared = _common_by_class(net, None)
    common = np.zeros((len(net.images),) * 2, dtype=int)
    common[tuple(pairs.T)] = shared.sum(axis=1)
    return common + np.triu(common, 1).T


def islands(net: Network) -> list[list[int]]:
    return [list(group) for group in groups(len(net.images), np.argwhere(np.triu(common_points(net), 1)))]


def test_islands() -> None:
    """Images 0-2-4 are connected in a chain, 1-3 in a pair, 5 is alone."""
    net = network([(0, 0), (0, 2), (1, 2), (1, 4), (2, 1), (2, 3), (3, 5)], among=6)

    assert islands(net) == [[0, 2, 4], [1, 3], [5]]
    common = common_points(net)
    np.testing.assert_array_equal(np.diag(common), [1, 1, 2, 1, 1, 1])
    assert (common[0, 2], common[2, 4], common[0, 4], common[1, 3]) == (1, 1, 0, 1)


incidences = st.integers(1, 5).flatmap(
    lambda images: st.tuples(
        st.just(images), st.lists(st.tuples(st.integers(0, 6), st.integers(0, images - 1)), max_size=25)
    )
)


@given(incidences)
def test_common_points_and_islands_are_those_of_the_table(drawn: tuple[int, list[tuple[int, int]]]) -> None:
    """Against the plain table of points by images, and its transitive closure."""
    images, pairs = drawn
    pairs = pairs + [(7, j) for j in range(images) if all(image != j for _, image in pairs)]
    pairs = [(0, pairs[0][1]), *pairs]
    net = network(pairs, among=images)
    table = np.zeros((8, images), dtype=int)
    for point, image in pairs:
        table[point, image] = 1
    np.testing.assert_array_equal(common_points(net), table.T @ table)

    reach = np.linalg.matrix_power((table.T @ table > 0).astype(int), images) > 0
    assert {frozenset(group) for group in islands(net)} == {frozenset(np.flatnonzero(row).tolist()) for row in reach}
    sizes = [len(group) for group in islands(net)]
    assert sizes == sorted(sizes, reverse=True)


# --- refusals

OTHER_BODY = replace(PAIR.images[1], name="I1", body=Ellipsoid(1_737_400.0, 1_737_400.0))
ALONE = replace(PAIR.images[0], name="I0")
START, STOP = (PAIR.images[0].trajectory.epoch + t for t in PAIR.images[0].trajectory.coverage)


GRID: Any = None
"""No terrain model is needed to refuse sigmas."""


def one_range(**change: Any) -> Ranges:
    fields: dict[str, Any] = {"point": [0], "image": [0], "times": [START + 1.0], "values": [4e5], "sigmas": [1.0]}
    return Ranges(**fields | change)


REFUSALS: dict[str, tuple[dict[str, Any], str]] = {
    "no images": ({"images": (), "priors": (), "held": []}, "network: no images; expected at least one"),
    "same name": ({"images": (ALONE, ALONE)}, "images: the id 'I0' twice"),
    "short priors": ({"priors": (PRIOR,)}, "network: 1 orientation priors; expected one for each of 2 images"),
    "short held": ({"held": [True]}, "network, held: shape (1,); expected one for each of 2"),
    "two bodies": ({"images": (ALONE, OTHER_BODY)}, "images of different bodies; expected one body; check the radii"),
    "no such point": ({"points": points([PointKind.FREE] * 2)}, "rays, points: index 0 .. 2; expected 0 .. 1"),
    "no such image": ({"rays": rays([(0, 0), (0, 2)])}, "rays, images: index 0 .. 2; expected 0 .. 1"),
    "short images": ({"rays": replace(rays(STEREO), image=np.zeros(4, int))}, "rays, images: 4 indices; expected 5"),
    "short places": ({"rays": replace(rays(STEREO), places=np.ones((4, 2)))}, "rays, places: an array of shape (4, 2)"),
    "lost place": ({"rays": replace(rays(STEREO), places=np.full((5, 2), np.nan))}, "rays, places: nan at [0, 0]"),
    "zero sigma": ({"rays": replace(rays(STEREO), sigmas=np.zeros((5, 2)))}, "image sigmas: 0.0; expected positive"),
    "unknown sigma": ({"rays": replace(rays(STEREO), sigmas=np.full((5, 2), np.nan))}, "image sigmas: nan"),
    "negative range sigma": ({"ranges": one_range(sigmas=[-1.0])}, "range sigmas: -1.0; expected positive sigmas"),
    "range to nothing": ({"ranges": one_range(point=[3])}, "ranges, points: index 3 .. 3; expected 0 .. 2"),
    "range from nowhere": ({"ranges": one_range(image=[2])}, "ranges, images: index 2 .. 2; expected 0 .. 1"),
    "timeless range": ({"ranges": one_range(times=[np.nan])}, "ranges, times: nan at [0]"),
    "short marks": ({"rays": replace(rays(STEREO), back_projected=[True])}, "marks of back-projection: shape (1,)"),
    "no such profile": ({"shifts": ProfileShifts(("A",), [0, 1, -1], [9.0])}, "profile shifts, profiles: index 0 .. 2"),
    "short profiles": ({"shifts": ProfileShifts(("A",), [0, -1], [9.0])}, "profile shifts, profiles: 2 indices"),
    "short shift sigmas": ({"shifts": ProfileShifts(("A",), [-1] * 3, [])}, "shifts, sigmas: an array of shape (0,)"),
    "zero shift sigma": ({"shifts": ProfileShifts(("A",), [-1] * 3, [0.0])}, "profile shifts, sigmas: 0.0 m"),
    "free but shifted": ({"shifts": ProfileShifts(("A",), [-1, 0, -1], [9.0])}, "ground point P1: a profile's shift"),
    "short surface": ({"surface": Surface(GRID, [1.0])}, "surface, sigmas: shape (1,); expected 3 positive numbers"),
    "zero surface": ({"surface": Surface(GRID, [1.0, np.inf, 0.0])}, "surface, sigmas: shape (3,)"),
    "unknown surface": ({"surface": Surface(GRID, [1.0, np.inf, np.nan])}, "surface, sigmas"),
    "lost range": ({"ranges": one_range(values=[np.inf])}, "ranges, values: inf at [0]"),
}


@pytest.mark.parametrize("fault", REFUSALS)
def test_networks_that_can_not_be(fault: str) -> None:
    change, said = REFUSALS[fault]
    with pytest.raises(InputError) as caught:
        network(STEREO, **change)
    assert said in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_shot_outside_the_tables_is_named_the_worst_first() -> None:
    times = [START + 1.0, STOP + 2.0, START - 0.5]
    ranges = Ranges(np.arange(3), np.zeros(3, dtype=int), np.array(times), np.full(3, 4e5), np.ones(3))
    with pytest.raises(EphemerisGap, match=r"laser shot P1, image I0: time") as caught:
        network(STEREO, ranges=ranges)
    assert caught.value.time == pytest.approx(STOP + 2.0, abs=1e-6)
    network(STEREO, ranges=replace(ranges, times=np.array([START + 1.0, STOP, START])))


POINT_REFUSALS: dict[str, tuple[dict[str, Any], str]] = {
    "same id": ({"ids": ("P0", "P1", "P1")}, "ground points: the id 'P1' twice"),
    "no such kind": ({"kinds": [0, 1, 3]}, "ground points, kinds: index 0 .. 3; expected 0 .. 2"),
    "no such class": ({"classes": [0, 1, -1]}, "ground points, classes: index -1 .. 1"),
    "short kinds": ({"kinds": [0, 1]}, "ground points, kinds: 2 indices; expected 3"),
    "short places": ({"places": np.zeros((2, 3))}, "ground points, places: an array of shape (2, 3)"),
    "flat places": ({"places": np.zeros(3)}, "ground points, places: an array of shape (3,)"),
    "infinite place": ({"places": [[np.inf, 0.0, 0.0]] * 3}, "ground point P0: an infinite place"),
    "unknown fixed": ({"kinds": [0, 0, 2]}, "ground point P2: no a-priori place"),
    "unknown constrained": ({"kinds": [0, 1, 0]}, "ground point P1: no a-priori place"),
    "loose constrained": (
        {"kinds": [0, 1, 0], "places": np.ones((3, 3))},
        "point P1: an a-priori covariance that is not positive definite",
    ),
    "short covariances": ({"covariances": np.zeros((2, 3, 3))}, "covariances: an array of shape (2, 3, 3)"),
}  # fmt: skip


@pytest.mark.parametrize("fault", POINT_REFUSALS)
def test_ground_points_that_can_not_be(fault: str) -> None:
    change, said = POINT_REFUSALS[fault]
    with pytest.raises(InputError) as caught:
        points(**change)
    assert said in str(caught.value)


def test_priors_of_different_degrees_go_together() -> None:
    assert network(STEREO, priors=(PRIOR, OrientationPrior(np.ones((1, 6))))).priors[1].degree == 0

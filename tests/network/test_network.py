"""The network: what it refuses; and how its images are connected, against plain graph searches."""

from dataclasses import replace
from typing import Any

import networks
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from outside import refuses

from mgsgraph.errors import EphemerisGap, InputError
from mgsgraph.files.networks.tie_points import PointKind
from mgsgraph.geometry.body import Ellipsoid, from_planetocentric, geodetic
from mgsgraph.geometry.footprint import Footprint
from mgsgraph.geometry.orientation import OrientationPrior
from mgsgraph.network import GroundPoints, ImageRays, Network, PointClass, ProfileShifts, Ranges, Surface
from mgsgraph.network.connectivity import Connectivity, connectivity, network_footprints
from mgsgraph.simulation.orbit import MARS
from mgsgraph.units import DEG

PAIR = networks.pair()
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
    "short places": ({"rays": replace(rays(STEREO), places=np.ones((4, 2)))}, "rays, places: an array of shape (4, 2)"),
    "lost place": ({"rays": replace(rays(STEREO), places=np.full((5, 2), np.nan))}, "rays, places: nan at [0, 0]"),
    "unknown sigma": ({"rays": replace(rays(STEREO), sigmas=np.full((5, 2), np.nan))}, "image sigmas: nan"),
    "range from nowhere": ({"ranges": one_range(image=[2])}, "ranges, images: index 2 .. 2; expected 0 .. 1"),
    "zero sigma": ({"rays": replace(rays(STEREO), sigmas=np.zeros((5, 2)))}, "image sigmas: 0.0; expected positive"),
    "timeless range": ({"ranges": one_range(times=[np.nan])}, "ranges, times: nan at [0]"),
    "no such profile": ({"shifts": ProfileShifts(("A",), [0, 1, -1], [9.0])}, "profile shifts, profiles: index 0 .. 2"),
    "free but shifted": ({"shifts": ProfileShifts(("A",), [-1, 0, -1], [9.0])}, "ground point P1: a profile's shift"),
    "short surface": ({"surface": Surface(GRID, [1.0])}, "surface, sigmas: shape (1,); expected 3 positive numbers"),
    "unknown surface": ({"surface": Surface(GRID, [1.0, np.inf, np.nan])}, "surface, sigmas"),
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
    "infinite place": ({"places": [[np.inf, 0.0, 0.0]] * 3}, "ground point P0: an infinite place"),
    "unknown fixed": ({"kinds": [0, 0, 2]}, "ground point P2: no a-priori place"),
    "unknown constrained": ({"kinds": [0, 1, 0]}, "ground point P1: no a-priori place"),
    "loose constrained": (
        {"kinds": [0, 1, 0], "places": np.ones((3, 3))},
        "point P1: an a-priori covariance that is not positive definite",
    ),
}  # fmt: skip


@pytest.mark.parametrize("fault", POINT_REFUSALS)
def test_ground_points_that_can_not_be(fault: str) -> None:
    change, said = POINT_REFUSALS[fault]
    with pytest.raises(InputError) as caught:
        points(**change)
    assert said in str(caught.value)


def test_priors_of_different_degrees_go_together() -> None:
    assert network(STEREO, priors=(PRIOR, OrientationPrior(np.ones((1, 6))))).priors[1].degree == 0


# --- how images are connected

Links = list[tuple[int, int, int]]
"""Pairs of images with their number of common points."""


def box(name: str, west: float, size: float = 1.0) -> Footprint:
    """A square of degrees on the equator."""
    corners = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0], [0.0, 0.0]]) * size * DEG
    corners[:, 0] += west * DEG
    return Footprint(name, from_planetocentric(np.column_stack([corners, np.full(5, MARS.equatorial)])), MARS)


def block(images: int, links: Links, west: list[float] | None = None, classes: list[int] | None = None) -> Connectivity:
    """Images in a row of footprints, by default all in one place, with points of their own besides."""
    return connectivity(linked(images, links, classes), footprints(images, west or [0.0] * images))


def footprints(images: int, west: list[float]) -> list[Footprint]:
    return [box(f"I{j}", west[j]) for j in range(images)]


def linked(images: int, links: Links, classes: list[int] | None = None) -> Network:
    """Each image sees a point of its own; the links' points are seen by two."""
    rows = [(j,) for j in range(images)] + [(i, j) for i, j, count in links for _ in range(count)]
    pairs = [(k, image) for k, row in enumerate(rows) for image in row]
    return network(pairs, images, points=points([PointKind.FREE] * len(rows), classes=classes or [0] * len(rows)))


graphs = st.integers(1, 7).flatmap(
    lambda m: st.tuples(
        st.just(m),
        st.dictionaries(
            st.tuples(st.integers(0, m - 1), st.integers(0, m - 1)).filter(lambda pair: pair[0] < pair[1]),
            st.integers(1, 6), max_size=12,
        ) if m > 1 else st.just({}),
    )
)  # fmt: skip


def parts(images: set[int], joined: set[tuple[int, int]]) -> list[frozenset[int]]:
    """Groups by merging sets, the plain way."""
    found = [frozenset({j}) for j in images]
    for i, j in joined:
        if i in images and j in images:
            mine = {group for group in found if i in group or j in group}
            found = [group for group in found if group not in mine] + [frozenset().union(*mine)]
    return found


@given(graphs)
def test_bridges_and_islands_are_those_of_trying_it(drawn: tuple[int, dict[tuple[int, int], int]]) -> None:
    """Take each link out and see whether more parts are left."""
    m, counts = drawn
    found = block(m, [(i, j, count) for (i, j), count in counts.items()])
    everyone, joined = set(range(m)), set(counts)
    whole = parts(everyone, joined)

    assert {frozenset(island) for island in found.islands} == set(whole)
    assert [len(island) for island in found.islands] == sorted(map(len, whole), reverse=True)
    bridges = {pair for pair in joined if len(parts(everyone, joined - {pair})) > len(whole)}
    assert {tuple(pair) for pair in found.pairs[found.bridges].tolist()} == bridges
    assert {j for island in whole if len(island) == 1 for j in island} == set(found.unconnected.tolist())
    for row in np.flatnonzero(found.bridges).tolist():
        lost = frozenset(found.cut_off(row))
        assert lost in parts(everyone, joined - {tuple(found.pairs[row].tolist())})
        assert 2 * len(lost) <= next(len(island) for island in whole if lost < island)


@given(graphs)
def test_the_spine_holds_parts_together_as_well_as_all_links(drawn: tuple[int, dict[tuple[int, int], int]]) -> None:
    """With the links of at least so many points alone, the spine joins what all of them join: no joint is weaker."""
    m, counts = drawn
    found = block(m, [(i, j, count) for (i, j), count in counts.items()])
    spine = {tuple(found.pairs[row].tolist()): int(found.points[row]) for row in found.spine}
    assert list(spine.values()) == sorted(spine.values())
    assert len(spine) == m - len(found.islands)
    for least in range(1, 8):
        strong = {pair for pair, count in counts.items() if count >= least}
        kept = {pair for pair, count in spine.items() if count >= least}
        assert set(parts(set(range(m)), kept)) == set(parts(set(range(m)), strong))


def test_classes_are_counted_apart() -> None:
    """Two tie points, one laser point and one control point in common; the images' own points don't count."""
    classes = [0, 0, PointClass.TIE, PointClass.TIE, PointClass.LASER, PointClass.CONTROL]
    found = block(2, [(0, 1, 4)], classes=classes)
    assert found.common.tolist() == [[2, 1, 1, 0]]
    assert found.points.tolist() == [4]
    assert found.seen.tolist() == [5, 5]


def test_rejected_rays_do_not_join() -> None:
    net = linked(3, [(0, 1, 2), (1, 2, 1)])
    used = ~((net.rays.point == 5) & (net.rays.image == 2))  # the one point that joins images 1 and 2
    found = connectivity(net, footprints(3, [0.0] * 3), used)
    assert found.islands == ((0, 1), (2,))
    assert found.seen.tolist() == [3, 4, 1]
    assert found.unconnected.tolist() == [2]
    assert len(found.untied) == 2


def test_hints_where_points_and_footprints_disagree() -> None:
    """I0 and I1 overlap by half and share points; I1 and I2 overlap and share none; I0 and I3 share but lie apart."""
    found = block(4, [(0, 1, 3), (0, 3, 2)], west=[0.0, 0.5, 1.4, 3.0])
    rows = {tuple(pair): row for row, pair in enumerate(found.pairs.tolist())}
    assert set(rows) == {(0, 1), (0, 3), (1, 2)}
    assert found.shares[rows[0, 1]] == pytest.approx(0.5, rel=1e-3)
    assert found.untied.tolist() == [rows[1, 2]]
    assert found.disjoint.tolist() == [rows[0, 3]]
    assert found.gaps[rows[0, 3]] == pytest.approx(2.0 * DEG * MARS.equatorial, rel=5e-3)
    assert found.gaps[rows[0, 1]] == 0.0
    assert found.names == ("I0", "I1", "I2", "I3")
    assert "2 islands" in repr(found)


def test_footprints_of_other_images_are_refused() -> None:
    refuses("one of each image", connectivity, linked(2, [(0, 1, 1)]), [box("I0", 0.0), box("J", 0.0)])


def test_a_chain_of_five_hundred() -> None:
    """Deep, and every link a bridge: no recursion."""
    found = block(500, [(j, j + 1, 2) for j in range(499)], west=[0.5 * j for j in range(500)])
    assert np.count_nonzero(found.bridges) == 499
    middle = next(row for row in found.links.tolist() if found.pairs[row].tolist() == [249, 250])
    assert len(found.cut_off(middle)) == 250


def test_footprints_lie_at_the_height_of_the_points() -> None:
    """Their outlines are the images' edges, seen at the middle height of the points that each image measures."""
    net = networks.network(PAIR)
    places = np.concatenate([PAIR.true_ties, PAIR.true_footprints])
    for j, one in enumerate(network_footprints(net, places, lambda j: PAIR.true_corrections[j])):
        image = PAIR.images[j]
        edge, _ = image.ground_to_image(one.outline, PAIR.true_corrections[j])
        assert np.minimum(np.abs(edge), np.abs(edge - [image.lines, image.samples])).min(axis=1).max() < 1e-4
        want = np.median(geodetic(places[net.rays.point[net.rays.image == j]], MARS)[:, 2])
        assert geodetic(one.outline, MARS)[:, 2] == pytest.approx(want, abs=0.5)
    for one in network_footprints(net, np.full_like(places, np.nan)):
        assert geodetic(one.outline, MARS)[:, 2] == pytest.approx(0.0, abs=1e-6)

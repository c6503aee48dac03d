"""How images are connected: against plain graph searches, and overlaps against points."""

from dataclasses import replace

import networks
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mgsgraph.errors import InputError
from mgsgraph.files.networks.tie_points import PointKind
from mgsgraph.geometry.body import from_planetocentric, geodetic
from mgsgraph.geometry.footprint import Footprint
from mgsgraph.network import GroundPoints, ImageRays, Network, PointClass, Ranges
from mgsgraph.network.connectivity import Connectivity, connectivity, network_footprints
from mgsgraph.simulation.orbit import MARS
from mgsgraph.units import DEG

PAIR = networks.pair()
NO_RANGES = Ranges(np.zeros(0, dtype=int), np.zeros(0, dtype=int), np.zeros(0), np.zeros(0), np.zeros(0))

Links = list[tuple[int, int, int]]
"""Pairs of images with their number of common points."""


def box(name: str, west: float, size: float = 1.0) -> Footprint:
    """A square of degrees on the equator."""
    corners = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0], [0.0, 0.0]]) * size * DEG
    corners[:, 0] += west * DEG
    return Footprint(name, from_planetocentric(np.column_stack([corners, np.full(5, MARS.equatorial)])), MARS)


def block(images: int, links: Links, west: list[float] | None = None, classes: list[int] | None = None) -> Connectivity:
    """Images in a row of footprints, by default all in one place, with points of their own besides."""
    found = network(images, links, classes)
    return connectivity(found, footprints(images, west or [0.0] * images))


def footprints(images: int, west: list[float]) -> list[Footprint]:
    return [box(f"I{j}", west[j]) for j in range(images)]


def network(images: int, links: Links, classes: list[int] | None = None) -> Network:
    rows = [(j,) for j in range(images)] + [(i, j) for i, j, count in links for _ in range(count)]
    pairs = [(k, image) for k, row in enumerate(rows) for image in row]
    n = len(rows)
    kinds = [PointKind.FREE] * n
    points = GroundPoints(
        tuple(f"P{k}" for k in range(n)), np.array(classes or [0] * n), np.array(kinds), np.full((n, 3), np.nan),
        np.zeros((n, 3, 3)),
    )
    point, image = np.array(pairs).T
    rays = ImageRays(point, image, np.full((len(pairs), 2), 50.5), np.ones((len(pairs), 2)))
    pictures = tuple(replace(PAIR.images[j % 2], name=f"I{j}") for j in range(images))
    prior = PAIR.settings.noise.prior
    return Network(pictures, (prior,) * images, np.zeros(images, dtype=bool), points, rays, NO_RANGES)


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
    net = network(3, [(0, 1, 2), (1, 2, 1)])
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
    assert found.apart.tolist() == [rows[0, 3]]
    assert found.gaps[rows[0, 3]] == pytest.approx(2.0 * DEG * MARS.equatorial, rel=5e-3)
    assert found.gaps[rows[0, 1]] == 0.0
    assert found.names == ("I0", "I1", "I2", "I3")
    assert "2 islands" in repr(found)


def test_one_image_alone() -> None:
    found = block(1, [])
    assert found.pairs.shape == (0, 2)
    assert found.islands == ((0,),)
    assert found.spine.size == 0


def test_footprints_of_other_images_are_refused() -> None:
    with pytest.raises(InputError, match="one of each image"):
        connectivity(network(2, [(0, 1, 1)]), [box("I0", 0.0), box("J", 0.0)])


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

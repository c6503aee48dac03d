"""Control networks united, split and thinned: nothing lost or made up, contradictions counted, connections kept."""

from collections import Counter
from itertools import combinations
from pathlib import Path

import numpy as np
import pytest
from control_networks import IMAGES, free_networks
from hypothesis import given, settings
from hypothesis import strategies as st
from msgspec import structs

from mgsgraph.errors import InputError
from mgsgraph.export.exchange import connected_parts
from mgsgraph.files.networks.binary import read_network
from mgsgraph.files.networks.editing import in_images, thinned, united, used_images, with_measures
from mgsgraph.files.networks.record import (
    ControlMeasure,
    ControlNetwork,
    ControlPoint,
    Duplicates,
    MeasureType,
    PointType,
)

PLACES = st.floats(1.0, 5000.0)
NETWORKS = free_networks(PLACES, least=1)


def measure(image: str, line: float = 1.0, sample: float = 1.0, **more: object) -> ControlMeasure:
    return structs.replace(ControlMeasure(image, MeasureType.MANUAL, sample, line), **more)


def point(name: str, *measures: ControlMeasure, **more: object) -> ControlPoint:
    return structs.replace(ControlPoint(name, PointType.FREE, measures), **more)


def of(*points: ControlPoint, source: str = "a.net") -> ControlNetwork:
    return ControlNetwork("n", "Mars", points, source=source)


def split_by_measure(network: ControlNetwork, chosen: st.DataObject) -> tuple[ControlNetwork, ControlNetwork]:
    """Each measure in one of two files; a point in both where it has measures in both."""
    first, second = list[ControlPoint](), list[ControlPoint]()
    for one in network.points:
        mine = chosen.draw(st.sets(st.integers(0, len(one.measures) - 1)))
        for points, which in ((first, mine), (second, set(range(len(one.measures))) - mine)):
            if which:
                points.append(with_measures(one, sorted(which)))
    return of(*first, source="a.net"), of(*second, source="b.net")


# ---- united --------------------------------------------------------------------------------------------------------


@settings(max_examples=30)
@given(drawn=NETWORKS, chosen=st.data(), rule=st.sampled_from([Duplicates.FIRST, Duplicates.LAST]))
def test_what_was_taken_apart_is_put_together(drawn: ControlNetwork, chosen: st.DataObject, rule: Duplicates) -> None:
    points, _ = united(split_by_measure(drawn, chosen), rule)

    assert {one.id: frozenset(one.measures) for one in points} == {
        one.id: frozenset(one.measures) for one in drawn.points
    }


def test_of_two_files_one_counts() -> None:
    place = (1.0, 2.0, 3.0)
    early = point("p", measure("A"), measure("B", 5.0), measure("D", 9.0, edit_lock=True), reference=1)
    late = point("p", measure("C"), measure("B", 7.5), measure("D", 8.0), reference=0, type=PointType.FIXED,
                 apriori=place)  # fmt: skip
    networks = of(early), of(late, point("q"), source="b.net")

    with pytest.raises(InputError, match=r"b\.net, point p: an id that a\.net has, too"):
        united(networks)
    (first, q), said = united(networks, Duplicates.FIRST)
    assert q.id == "q"
    assert [(one.serial_number, one.line) for one in first.measures] == [("A", 1.0), ("B", 5.0), ("D", 9.0), ("C", 1.0)]
    assert (first.type, first.apriori, first.reference) == (PointType.FIXED, place, 1)  # which contradicts nothing
    assert "1 point" in said[0]
    assert "1 more measure" in said[0]
    assert "2 measures, 2 of them elsewhere (up to 2.5 px); the first" in said[1]
    assert len(said) == 2
    (last, _), said = united(networks, Duplicates.LAST)
    assert [(one.serial_number, one.line) for one in last.measures] == [("A", 1.0), ("B", 7.5), ("D", 9.0), ("C", 1.0)]
    assert (last.type, last.reference) == (PointType.FIXED, 3)
    assert said[-1].startswith("Locked")
    locked = structs.replace(early, edit_lock=True)
    for rule in (Duplicates.FIRST, Duplicates.LAST):
        (kept, _), said = united([of(locked), networks[1]], rule)
        assert kept == locked
        assert said[-1].endswith(": 1 points and measures")


def test_known_places_that_differ_are_counted() -> None:
    one, other = (point("p", type=PointType.FIXED, apriori=(x, 2.0, 3.0)) for x in (1.0, 9.0))
    for rule, x in ((Duplicates.FIRST, 1.0), (Duplicates.LAST, 9.0)):
        (found,), said = united([of(one), of(other, source="b.net")], rule)
        assert found.apriori == (x, 2.0, 3.0)
        assert "1 point" in said[1]


# ---- split ---------------------------------------------------------------------------------------------------------


def test_images_by_name_and_pattern() -> None:
    network = of(
        point("p", measure("MGS/1"), measure("MGS/2"), measure("MRO/1"), reference=2),
        point("q", measure("MGS/1"), measure("MRO/1")),
        point("r", measure("MGS/2"), measure("MRO/1"), type=PointType.FIXED),
        point("s", measure("MGS/1")),
    )
    chosen, said = in_images(network, ["MGS/*"])

    assert [(one.id, len(one.measures), one.reference) for one in chosen.points] == [
        ("p", 2, None), ("r", 1, None), ("s", 1, None),
    ]  # fmt: skip
    assert "3 measures in 1 other image, and 1 point" in said[0]
    assert in_images(network, ["M*"]) == (network, [])
    with pytest.raises(InputError, match=r"a\.net: no image 'MEX'; expected MGS/1, MGS/2, MRO/1"):
        in_images(network, ["MGS/1", "MEX"])
    with pytest.raises(InputError, match="no point in the images"):
        in_images(of(*network.points[1:2]), ["MRO/1"])


@settings(max_examples=30)
@given(drawn=NETWORKS)
def test_parts_hang_together_and_are_all(drawn: ControlNetwork) -> None:
    parts = connected_parts(drawn)

    assert sorted(one.id for part in parts for one in part.points) == sorted(one.id for one in drawn.points)
    for part, other in combinations(parts, 2):
        assert not {name for one in part.points for name in used_images(one)}.intersection(
            name for one in other.points for name in used_images(one)
        )
    for part in parts:
        reached = set(used_images(part.points[0]))
        for _ in IMAGES:
            for one in part.points:
                reached |= set(used_images(one)) if reached.intersection(used_images(one)) else set()
        assert reached == {name for one in part.points for name in used_images(one)}
    assert [len(part.points) for part in parts] == sorted((len(part.points) for part in parts), reverse=True)


def test_what_is_ignored_connects_nothing() -> None:
    network = of(
        point("p", measure("A"), measure("B")), point("q", measure("C"), measure("D")), point("r"),
        point("s", measure("B"), measure("C", ignore=True)), point("t", measure("C"), measure("A"), ignore=True),
    )  # fmt: skip
    assert [[one.id for one in part.points] for part in connected_parts(network)] == [["p", "s", "r"], ["q", "t"]]


# ---- thinned -------------------------------------------------------------------------------------------------------


def block(points: int = 600, images: int = 6, seed: int = 3) -> ControlNetwork:
    """A strip of images, each of which overlaps the next by half; measures are better in every third point."""
    rng = np.random.default_rng(seed)
    made = []
    for i, (along, across) in enumerate(rng.uniform(0.0, 1.0, (points, 2)) * [images + 1, 1.0]):
        seen = [j for j in range(images) if j <= along < j + 2]
        log = ((2, 0.9 if i % 3 == 0 else 0.6),)
        made.append(point(f"p{i}", *(measure(f"I{j}", 1.0 + 5000.0 * (along - j), 1.0 + 2000.0 * across, log=log)
                                     for j in seen)))  # fmt: skip
    return of(*made)


def links(network: ControlNetwork) -> Counter[tuple[str, str]]:
    return Counter(pair for one in network.points for pair in combinations(sorted(used_images(one)), 2))


@pytest.mark.parametrize("cells", [1, 12, 40])
def test_points_are_spread_and_images_stay_connected(cells: int) -> None:
    network, sizes = block(), {f"I{j}": (10_000, 2000) for j in range(6)}
    thin, said = thinned(network, cells, sizes)
    before, after = links(network), links(thin)

    assert set(thin.points) <= set(network.points)
    assert all(after[pair] >= min(4, before[pair]) for pair in before)
    counts = Counter(name for one in thin.points for name in used_images(one))
    assert all(min(cells, 4) <= counts[f"I{j}"] <= 2 * cells + 8 for j in range(6))
    assert f"{len(thin.points)} of 600 points" in said[0]
    assert thinned(thin, cells, sizes)[0] == thin  # nothing more to be taken
    if cells > 1:  # every quarter of an image that has points keeps some
        for j in range(1, 5):  # the first and the last have no partner at their ends
            lines = [one.line or 0.0 for p in thin.points for one in p.measures if one.serial_number == f"I{j}"]
            assert np.histogram(lines, 4, (0.0, 10_000.0))[0].min() > 0
        good = [one.measures[0].log[0][1] > 0.8 for one in thin.points]
        assert np.mean(good) > 0.5  # a third of all are good


def test_what_always_stays_and_what_never() -> None:
    """One cell, in which the point of the smallest sigmas is the best; the rejected one is the worst."""
    pair = (measure("A", 5.0), measure("B", 5.0))
    fine = tuple(structs.replace(one, line_sigma=0.1, sample_sigma=0.1) for one in pair)
    network = of(
        point("rejected", *fine, jigsaw_rejected=True), *(point(f"p{i}", *pair) for i in range(9)),
        point("best", *fine), point("fixed", pair[0], type=PointType.FIXED), point("locked", *pair, edit_lock=True),
        point("single", pair[0]), point("ignored", *pair, ignore=True),
    )  # fmt: skip
    thin, said = thinned(network, 1)

    assert {"best", "fixed", "locked"} < {one.id for one in thin.points}
    assert not {"rejected", "single", "ignored"} & {one.id for one in thin.points}
    assert len(thin.points) == 6  # four connect A and B
    assert "2 points" in said[-1]
    for cells, points, found in ((0, network.points, "0 cells"), (3, (point("p", pair[0]),), "no point in two images")):
        with pytest.raises(InputError, match=found):
            thinned(of(*points), cells)


def test_sizes_divide_images_where_they_are_known() -> None:
    """All measures in a corner: one cell of the whole image, many of the part that they fill."""
    network = of(*(point(f"p{i}", measure("A", 1.0 + i, 1.0), measure("B", 1.0 + i, 1.0)) for i in range(64)))

    assert len(thinned(network, 16)[0].points) >= 16
    assert len(thinned(network, 16, {"A": (5000, 5000), "B": (5000, 5000)})[0].points) == 4


@pytest.mark.parametrize("name", ["lro_nac_lola/network.pvl", "mgs_moc_wa_three/controlnetwork.net",
                                  "lro_nac_hadley/observationPair.net"])  # fmt: skip
def test_real_networks_thinned_and_split(shared_data: Path, name: str) -> None:
    network = read_network(shared_data / name)
    thin, _ = thinned(network, 8)

    assert 4 <= len(thin.points) < len(network.points)
    assert set(links(thin)) == set(links(network))
    assert len(connected_parts(network)) == 1

"""Control networks united and split: nothing lost or made up, contradictions counted."""

from itertools import combinations
from pathlib import Path

import pytest
from control_networks import IMAGES, free_networks
from hypothesis import given, settings
from hypothesis import strategies as st
from msgspec import structs

from mgsgraph.errors import InputError
from mgsgraph.export.exchange import connected_parts
from mgsgraph.files.networks.binary import read_network
from mgsgraph.files.networks.editing import in_images, united, used_images, with_measures
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


@pytest.mark.parametrize("name", ["lro_nac_lola/network.pvl", "mgs_moc_wa_three/controlnetwork.net",
                                  "lro_nac_hadley/observationPair.net"])  # fmt: skip
def test_real_networks_are_of_one_part(shared_data: Path, name: str) -> None:
    assert len(connected_parts(read_network(shared_data / name))) == 1

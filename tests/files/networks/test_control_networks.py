"""What control networks mean to an adjustment; united: nothing lost or made up."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from control_networks import free_networks
from hypothesis import given, settings
from hypothesis import strategies as st
from msgspec import structs
from outside import refuses

from mgsgraph.files.networks.binary import read_control_network, write_binary_network
from mgsgraph.files.networks.editing import in_images, united, with_measures
from mgsgraph.files.networks.pvl import write_pvl_network
from mgsgraph.files.networks.record import (
    ControlMeasure,
    ControlNetwork,
    ControlPoint,
    Duplicates,
    MeasureType,
    PointType,
)
from mgsgraph.files.networks.tie_points import PointKind, TiePoints, control_network, tie_points
from mgsgraph.geometry.body import Ellipsoid

# --- united, split


NETWORKS = free_networks(st.floats(1.0, 5000.0), least=1)


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

    refuses(r"b\.net, point p: an id that a\.net has, too", united, networks)
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
    refuses(r"a\.net: image MEX: no such image among 3; .* MGS/1, MGS/2, MRO/1", in_images, network, ["MGS/1", "MEX"])
    refuses("no point in the images", in_images, of(*network.points[1:2]), ["MRO/1"])


# --- tie points of an adjustment, one rule for text, binary form and records


def some_ties(seed: int) -> TiePoints:
    """Points of all kinds, their measures in no order, on a grid of 1/64 px."""
    rng = np.random.default_rng(seed)
    points, images = 7, 4
    kinds = rng.permutation([0, 0, 0, 1, 1, 2, 2])
    places = rng.normal(0.0, 3e6, (points, 3))
    places[(kinds == PointKind.FREE) & (rng.random(points) < 0.5)] = np.nan
    factors = rng.normal(size=(points, 3, 3))
    covariances = (factors @ factors.transpose(0, 2, 1) + np.eye(3)) * (kinds == PointKind.CONSTRAINED)[:, None, None]
    seen = rng.permutation([(i, j) for i in range(1, points) for j in range(images) if rng.random() < 0.7])
    sigmas = rng.uniform(0.1, 2.0, (len(seen), 2))
    sigmas[rng.random(sigmas.shape) < 0.3] = np.nan
    return TiePoints(
        source="drawn",
        ids=tuple(f"p{i}" for i in range(points)),
        kinds=kinds,
        places=places,
        covariances=(covariances + covariances.transpose(0, 2, 1)) / 2.0,
        measure_point=seen[:, 0],
        measure_image=tuple(f"I/{j}" for j in seen[:, 1]),
        measures=rng.integers(32, 64 * 10_000, (len(seen), 2)) / 64.0,
        measure_sigmas=sigmas,
    )


@pytest.mark.parametrize("write", [write_pvl_network, write_binary_network])
def test_tie_points_survive(tmp_path: Path, write: Any) -> None:
    ties = some_ties(0)
    write(control_network(ties, "drawn", "MARS", "of a test"), tmp_path / "a.net")
    back = read_control_network(tmp_path / "a.net")

    order = np.argsort(ties.measure_point, kind="stable")
    assert back.ids == ties.ids
    assert back.measure_image == tuple(ties.measure_image[k] for k in order)
    for name in ("kinds", "places", "covariances", "measure_point", "measures", "measure_sigmas"):
        wanted = getattr(ties, name)
        np.testing.assert_array_equal(getattr(back, name), wanted[order] if name.startswith("measure") else wanted)


def test_pixels_are_counted_from_one_and_the_first_measure_refers() -> None:
    ties = some_ties(3)
    network = control_network(ties, "drawn", "MARS", created="2026-11-22T08:00:00", measure_type=MeasureType.MANUAL)

    k = int(np.flatnonzero(ties.measure_point == 1)[0])
    point = network.points[1]
    assert (point.measures[0].line, point.measures[0].sample) == tuple(ties.measures[k] + 0.5)
    assert point.measures[0].serial_number == ties.measure_image[k]
    assert point.measures[0].type == MeasureType.MANUAL
    assert [one.reference for one in network.points] == [None] + [0] * 6  # nobody measured the first
    assert network.created == network.last_modified == "2026-11-22T08:00:00"
    assert {one.type for one in network.points} == set(PointType)


def test_what_is_ignored_is_left_out() -> None:
    """Of point b, fixed without a place, it would be a fault."""
    seen = (measure("A", 1.0, 2.0), measure("A", ignore=True, line=None))
    first = point("a", *seen, adjusted=(1.0, 2.0, 3.0), jigsaw_rejected=True)

    ties = tie_points(of(point("b", type=PointType.FIXED, ignore=True), first))

    assert ties.ids == ("a",)
    np.testing.assert_array_equal(ties.measures, [[0.5, 1.5]])
    np.testing.assert_array_equal(ties.places, [[1.0, 2.0, 3.0]])


MARS, PHOBOS, MOON = Ellipsoid(3396.19e3, 3376.2e3), Ellipsoid(13.0e3, 9.1e3), 1737.4e3


def on_mars(
    target: str = "", radii: tuple[float, ...] = (), *, scale: float = 1.0, wild: float = 1.0, **more: object
) -> ControlNetwork:
    """Three points on Mars, scaled; the last one once more."""
    places = [(3396e3 * scale * far, 1e3 * scale * k, 0.0) for k, far in enumerate((1.0, 1.0, wild))]
    points = tuple(point(f"p{k}", measure("A"), apriori=place, **more) for k, place in enumerate(places))
    return ControlNetwork("n", target, points, target_radii=radii)


@pytest.mark.parametrize("write", [write_pvl_network, write_binary_network])
@pytest.mark.parametrize(
    ("given", "said"),
    [
        (on_mars("Moon"), "TargetName: the target body Moon; expected MARS"),
        (on_mars("", (MOON, MOON, MOON)), "TargetRadii: 1737400 m; expected 3396190 m"),
        (on_mars("Mars", scale=1e-3), "radii of points of 3.396 km .*kilometres stand where"),
        (on_mars("Mars", type=PointType.FIXED, wild=0.8), "point p2: 2.7168e[+]06 m from the body's centre"),
    ],
)
def test_a_network_of_another_body(tmp_path: Path, write: Any, given: ControlNetwork, said: str) -> None:
    """Whatever says so: its name, its radii, or where its points lie, known ones each."""
    path = tmp_path / "network"
    write(given, path)
    assert len(read_control_network(path).ids) == 3
    refuses(said, read_control_network, path, MARS)


def test_networks_of_this_body(tmp_path: Path) -> None:
    """A first guess may be wild; of a body of unknown size any other name may be its own."""
    path = tmp_path / "network.net"
    for made, body in (
        (on_mars(" mars ", (3396190.0, 3396190.0, 3376200.0)), MARS), (on_mars(wild=2.0), MARS),
        (on_mars("Deimos", scale=11.0 / 3396.0), PHOBOS),
    ):  # fmt: skip
        write_binary_network(made, path)
        assert len(read_control_network(path, body).ids) == 3

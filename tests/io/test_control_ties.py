"""What a network means to an adjustment, and back: one rule for text, binary form and records."""

from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest
from isis_networks import labelled, wire

from mgsgraph.errors import InputError
from mgsgraph.io.control.binary import write_binary_network
from mgsgraph.io.control.network_file import read_control_network, read_network
from mgsgraph.io.control.pvl_writing import write_pvl_network
from mgsgraph.io.control.record import ControlMeasure, ControlNetwork, ControlPoint, MeasureType, PointType
from mgsgraph.io.control.ties import control_network, tie_points
from mgsgraph.ties import PointKind, TiePoints

FIELDS = ("kinds", "places", "covariances", "measure_point", "measures", "measure_sigmas")


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


@pytest.mark.parametrize("seed", range(10))
@pytest.mark.parametrize("write", [write_pvl_network, write_binary_network])
def test_tie_points_survive(tmp_path: Path, seed: int, write: Any) -> None:
    ties = some_ties(seed)
    write(control_network(ties, "drawn", "MARS", "of a test"), tmp_path / "a.net")
    back = read_control_network(tmp_path / "a.net")

    order = np.argsort(ties.measure_point, kind="stable")
    assert back.ids == ties.ids
    assert back.measure_image == tuple(ties.measure_image[k] for k in order)
    for name in FIELDS:
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


def test_both_forms_mean_the_same(shared_data: Path, tmp_path: Path) -> None:
    path = shared_data / "lro_nac_lola" / "network.pvl"
    write_binary_network(read_network(path), tmp_path / "a.net")
    text, binary = read_control_network(path), read_control_network(tmp_path / "a.net")

    assert (text.ids, text.measure_image) == (binary.ids, binary.measure_image)
    for name in FIELDS:
        np.testing.assert_array_equal(getattr(text, name), getattr(binary, name))


def test_what_is_ignored_is_left_out() -> None:
    seen = ControlMeasure(serial_number="A", type=MeasureType.MANUAL, line=1.0, sample=2.0)
    twice = (seen, msgspec.structs.replace(seen, ignore=True, line=None))
    first = ControlPoint(id="a", type=PointType.FREE, measures=twice, adjusted=(1.0, 2.0, 3.0), jigsaw_rejected=True)
    ignored = ControlPoint(id="b", type=PointType.FIXED, ignore=True)  # a fault, if it were not
    network = ControlNetwork(network_id="n", target_name="Mars", points=(ignored, first))

    ties = tie_points(network)

    assert ties.ids == ("a",)
    np.testing.assert_array_equal(ties.measures, [[0.5, 1.5]])
    np.testing.assert_array_equal(ties.places, [[1.0, 2.0, 3.0]])


def binary(
    *fields: tuple[int, Any], measure: tuple[tuple[int, Any], ...] = ((4, 1.0), (3, 1.0)), times: int = 1
) -> bytes:
    """A point p2, its fields and a measure's, behind a point p1."""
    seen = (25, wire((1, b"A"), (2, 1), *measure))
    messages = wire((1, b"p1"), (2, 2)), wire((1, b"p2"), *fields, *[seen] * times)
    points = b"".join(len(message).to_bytes(4, "little") + message for message in messages)
    return labelled(5, wire((1, b"n"), (2, b"Mars")), points)


FAULTS = {
    "fixed without place": (binary((2, 4)), "point 2 (p2): fixed without an a-priori place"),
    "no covariance": (binary((2, 3), (16, 1.0), (17, 1.0), (18, 1.0)), "point 2 (p2): constrained without Apriori"),
    "no line": (binary((2, 2), measure=((3, 1.0),)), "point 2 (p2), image A: no Line"),
    "no sample": (binary((2, 2), measure=((4, 1.0),)), "point 2 (p2), image A: no Sample"),
    "sigma": (binary((2, 2), measure=((3, 1.0), (4, 1.0), (16, 0.0))), "point 2 (p2), image A, LineSigma: 0 px"),
    "image twice": (binary((2, 2), times=2), "point 2 (p2), image A: a second measure in this image"),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_a_fault_in_a_binary_network_names_the_point(tmp_path: Path, fault: str) -> None:
    data, said = FAULTS[fault]
    path = tmp_path / "a.net"
    path.write_bytes(data)
    read_network(path)  # for exchange it is good enough

    with pytest.raises(InputError) as caught:
        read_control_network(path)
    assert str(caught.value).startswith(f"{path}, {said}")

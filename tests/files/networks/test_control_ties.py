"""What a network means to an adjustment, and back: one rule for text, binary form and records."""

from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest
from isis_networks import labelled, wire

from mgsgraph.errors import InputError
from mgsgraph.files.networks.binary import read_control_network, read_network, write_binary_network
from mgsgraph.files.networks.pvl import write_pvl_network
from mgsgraph.files.networks.record import ControlMeasure, ControlNetwork, ControlPoint, MeasureType, PointType
from mgsgraph.files.networks.tie_points import PointKind, TiePoints, control_network, tie_points
from mgsgraph.geometry.body import Ellipsoid

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
    assert str(caught.value).startswith(f"{path}, byte {data.index(b'p2') - 2}, {said}")


MARS, PHOBOS, MOON = Ellipsoid(3396.19e3, 3376.2e3), Ellipsoid(13.0e3, 9.1e3), 1737.4e3


def network(target: str = "", radii: tuple[float, ...] = (), *, kind: PointType = PointType.FREE,
            scale: float = 1.0, wild: float = 1.0) -> ControlNetwork:  # fmt: skip
    """Three points on Mars, scaled; the last one once more."""
    points = tuple(
        ControlPoint(
            f"p{k}", kind, (ControlMeasure("A", MeasureType.MANUAL, 1.0, 1.0),),
            apriori=(3396e3 * scale * (wild if k == 2 else 1.0), 1e3 * scale * k, 0.0),
            apriori_covariance=(1.0, 0.0, 0.0, 1.0, 0.0, 1.0) if kind == PointType.CONSTRAINED else (),
        )
        for k in range(3)
    )  # fmt: skip
    return ControlNetwork("n", target, points, target_radii=radii)


@pytest.mark.parametrize("write", [write_pvl_network, write_binary_network])
@pytest.mark.parametrize(
    ("given", "body", "said"),
    [
        (network("Moon"), MARS, "TargetName: the target body Moon; expected MARS"),
        (network("Mars", scale=PHOBOS.equatorial / 3396e3), PHOBOS, "TargetName: the target body Mars"),
        (network("", (MOON, MOON, MOON)), MARS, "TargetRadii: 1737400 m; expected 3396190 m"),
        (network("", (3396190.0, 3396190.0, 1e4)), MARS, "TargetRadii: 10000 m"),
        (network("Mars", scale=MOON / 3396e3), MARS, "radii of points of 1,737"),
        (network("Mars", scale=1e-3), MARS, "radii of points of 3.396 km .*kilometres stand where"),
        (network("Mars", kind=PointType.FIXED, wild=0.8), MARS, "point p2: 2.7168e[+]06 m from the body's centre"),
        (network("Mars", kind=PointType.CONSTRAINED, wild=1.3), MARS, "point p2: 4.4148e[+]06 m from"),
    ],
)
def test_a_network_of_another_body(
    tmp_path: Path, write: Any, given: ControlNetwork, body: Ellipsoid, said: str
) -> None:
    """Whatever says so: its name, its radii, or where its points lie, known ones each."""
    path = tmp_path / "network"
    write(given, path)
    assert len(read_control_network(path).ids) == 3
    with pytest.raises(InputError, match=said):
        read_control_network(path, body)


def test_networks_of_this_body(tmp_path: Path) -> None:
    """A first guess may be wild; of a body of unknown size any other name may be its own."""
    path = tmp_path / "network.net"
    for given, body in (
        (network(" mars ", (3396190.0, 3396190.0, 3376200.0)), MARS), (network(wild=2.0), MARS),
        (network("Phobos", scale=11.0 / 3396.0), PHOBOS), (network("Deimos", scale=11.0 / 3396.0), PHOBOS),
    ):  # fmt: skip
        write_binary_network(given, path)
        assert len(read_control_network(path, body).ids) == 3


@pytest.mark.parametrize("write", [write_pvl_network, write_binary_network])
@pytest.mark.parametrize("part", ["p0", "A"])
@pytest.mark.parametrize("name", ["\x1b[2Jx", "a\u202eb", "x" * 100_000])
def test_names_that_no_terminal_should_be_given(tmp_path: Path, write: Any, part: str, name: str) -> None:
    path = tmp_path / "network"
    write(network(), path)
    data = path.read_bytes()
    if write is write_binary_network:
        point = network().points[0]
        measures = (msgspec.structs.replace(point.measures[0], serial_number=name),)
        point = msgspec.structs.replace(point, **({"id": name} if part == "p0" else {"measures": measures}))
        write(msgspec.structs.replace(network(), points=(point,)), path)
    else:
        path.write_bytes(data.replace(f"= {part}\n".encode(), f'= "{name}"\n'.encode()))
    with pytest.raises(InputError, match=r"an id|an image's name") as caught:
        read_network(path)
    assert str(caught.value).isprintable()
    assert len(str(caught.value)) < 1500

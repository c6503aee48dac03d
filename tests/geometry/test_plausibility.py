"""What geometry and records refuse: each planted fault by name, one image under two names, fields of the wrong kind;
and what they accept.
"""

import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from networks import network
from outside import refuses

from mgsgraph.adjustment.graph.layout import lay_out
from mgsgraph.adjustment.settings import SolverSettings
from mgsgraph.errors import InputError
from mgsgraph.files.networks.tie_points import require_places
from mgsgraph.geometry.altimetry import require_on_body
from mgsgraph.geometry.body import Ellipsoid, body_name, require_possible, target_name
from mgsgraph.geometry.image import LineTiming, PushbroomImage
from mgsgraph.geometry.plausibility import duplicate_images, require_distinct, require_on_ground, require_plausible
from mgsgraph.geometry.records import (
    chosen_rows,
    concatenated,
    frozen,
    frozen_index,
    repeated,
    require_covariances,
    require_names,
)
from mgsgraph.geometry.trajectory import PositionTable, Trajectory
from mgsgraph.simulation.pair import PairSettings, simulate_pair

IMAGES = simulate_pair(PairSettings(ties=5, shots=2), seed=1).images


def with_tables(image: PushbroomImage, places: float = 1.0, velocities: float = 1.0) -> PushbroomImage:
    trajectory = image.trajectory
    assert isinstance(trajectory, Trajectory)
    table = trajectory.position
    table = replace(table, positions=places * table.positions, velocities=velocities * table.velocities)
    return replace(image, trajectory=replace(trajectory, position=table))


def looking_away(image: PushbroomImage) -> PushbroomImage:
    trajectory = image.trajectory
    assert isinstance(trajectory, Trajectory)
    behind = replace(trajectory.camera, constant=np.diag([1.0, -1.0, -1.0]) @ trajectory.camera.constant)
    return replace(image, trajectory=replace(trajectory, camera=behind))


FAULTS: dict[str, tuple[Callable[[PushbroomImage], PushbroomImage], str]] = {
    "metres for kilometres": (lambda image: with_tables(image, 1e3, 1e3), "km from the body's centre"),
    "velocities of another unit": (lambda image: with_tables(image, 1.0, 1e-3), "velocities of"),
    "velocities of another sign": (lambda image: with_tables(image, 1.0, -1.0), "velocities of"),
    "axes of the body": (lambda image: replace(image, body=Ellipsoid(3.3762e6, 3.39619e6)), "check the order"),
    "small radii": (lambda image: replace(image, body=Ellipsoid(3396.19, 3376.2)), "from the body's"),
    "a body that isn't": (lambda image: replace(image, body=Ellipsoid(3.3e6, 3.28e6)), "that there is"),
    "flattening": (lambda image: replace(image, body=Ellipsoid(3.39619e6, 3.2762e6)), "those of MARS"),
    "attitude": (looking_away, "a middle that looks past the body"),
}


@pytest.mark.parametrize("image", IMAGES, ids=lambda image: image.name)
def test_images_that_can_be(image: PushbroomImage) -> None:
    require_plausible(image, "image")


@pytest.mark.parametrize("fault", FAULTS)
def test_images_that_cant_be(fault: str) -> None:
    change, said = FAULTS[fault]
    with pytest.raises(InputError) as caught:
        require_plausible(change(IMAGES[0]), "a.isd")
    assert str(caught.value).startswith("a.isd: ")
    assert said in str(caught.value)


@pytest.mark.parametrize("radius", [10e3, 500e3, 950e3])
def test_small_bodies_are_told_by_where_rays_meet(radius: float) -> None:
    """Nothing says how large a small body may be, but for the ties: they would hang 2,400 km above its ground."""
    drawn = network(simulate_pair(PairSettings(ties=30, shots=2), seed=1), laser=False)
    small = tuple(replace(image, body=Ellipsoid(radius, radius)) for image in drawn.images)
    lay_out(drawn, SolverSettings())
    refuses("rays that meet", lay_out, replace(drawn, images=small), SolverSettings())


@pytest.mark.parametrize(("share", "angle", "count"), [(0.09, 0.2, 20), (0.5, 0.04, 20), (0.5, 0.2, 4)])
def test_points_may_be_high_or_doubtful_or_few(share: float, angle: float, count: int) -> None:
    up = np.tile([3.396e6 * (1.0 + share), 0.0, 0.0], (count, 1))
    require_on_ground(up, np.full(count, angle), Ellipsoid(3.396e6, 3.376e6), "ties")


@pytest.mark.parametrize("radii", [(285.0, 229.0, 215.0), (13.0, 9.1, 9.5)], ids=["Vesta", "Phobos"])
def test_poles_of_flat_bodies_are_on_them(radii: tuple[float, float, float]) -> None:
    """By images, by a laser and by control points: the ellipsoid's pole, and where the ground is (HRSC sees Phobos)."""
    body = Ellipsoid(1e3 * radii[0], 1e3 * radii[1])
    pole = np.tile([0.0, 0.0, -1e3 * radii[2]], (20, 1))
    require_on_ground(pole, np.full(20, 0.2), body, "ties")
    require_on_body(pole, body, "laser")
    require_places(pole, body, "network")
    for factor in (0.45, 2.2):
        refuses("rays that meet", require_on_ground, factor * pole, np.full(20, 0.2), body, "ties")


def test_the_largest_bodies_are_those_of_the_planetary_constants(shared_data: Path) -> None:
    """pck00011.tpc names no other body beyond 1,000 km but the Sun, and the same radii."""
    text = (shared_data / "kernels" / "pck00011.tpc").read_text()
    data = "".join(part.split("\\begintext")[0] for part in text.split("\\begindata")[1:])
    said = {int(code): [float(one) for one in radii.split()]
            for code, radii in re.findall(r"BODY(\d+)_RADII\s*=\s*\(([^)]*)\)", data)}  # fmt: skip
    large = {code: radii for code, radii in said.items() if radii[0] > 1000.0 and code != 10}
    assert len(large) == 16
    for code, (a, _, c) in large.items():
        name = body_name(code)
        assert target_name(Ellipsoid(1e3 * a, 1e3 * c)) == name
        require_possible(Ellipsoid(1e3 * a, 1e3 * c), name, "radii")
        with pytest.raises(InputError):
            require_possible(Ellipsoid(1.02e3 * a, 1.02e3 * c), name, "radii")


def test_one_position_that_is_off_is_named() -> None:
    """A bit that was flipped in one of many."""
    trajectory = IMAGES[0].trajectory
    assert isinstance(trajectory, Trajectory)
    table = trajectory.position
    places = table.positions.copy()
    places[table.times.size // 2] *= 1.001
    bent = replace(trajectory, position=replace(table, positions=places))
    refuses("velocities of", require_plausible, replace(IMAGES[0], trajectory=bent), "a.cub")


# --- one image under two names


FIRST, SECOND = simulate_pair().images


def later(image: PushbroomImage, lines: float) -> PushbroomImage:
    timing = image.timing
    starts = timing.start_times + lines * timing.periods
    return replace(image, timing=LineTiming(timing.first_lines, starts, timing.periods))


def aside(image: PushbroomImage, metres: float) -> PushbroomImage:
    """The image from a trajectory so many metres beside its own."""
    assert isinstance(image.trajectory, Trajectory)
    table = image.trajectory.position
    places = table.positions + metres * np.cross(table.positions[0], table.velocities[0]) / np.linalg.norm(
        np.cross(table.positions[0], table.velocities[0])
    )
    moved = PositionTable(table.times, places, table.velocities)
    return replace(image, trajectory=replace(image.trajectory, position=moved))


def test_twins_are_found_whatever_they_are_called() -> None:
    again = replace(FIRST, name="again")
    assert duplicate_images([FIRST, SECOND, again, later(FIRST, 0.01)]) == [(0, 2), (0, 3), (2, 3)]
    assert duplicate_images([FIRST, aside(FIRST, 0.1)]) == [(0, 1)]


def test_others_are_not() -> None:
    narrower = replace(FIRST, interior=replace(FIRST.interior, first=FIRST.interior.first + np.array([0.0, 500.0])))
    assert duplicate_images([FIRST, SECOND, later(FIRST, 1.5), narrower, aside(FIRST, 300.0)]) == []
    assert duplicate_images([FIRST, replace(FIRST, lines=FIRST.lines - 1)]) == []


def test_both_names_are_said() -> None:
    refuses("SIM/A and again", require_distinct, [FIRST, SECOND, replace(FIRST, name="again")], "here")


# --- records


def test_frozen_copies_and_can_not_be_written() -> None:
    given = np.arange(6).reshape(2, 3)
    array = frozen(given, "field", (None, 3))
    given[0, 0] = 99

    assert array.dtype == np.float64
    assert array[0, 0] == 0.0
    with pytest.raises(ValueError, match="read-only"):
        array[0, 0] = 1.0


@pytest.mark.parametrize(
    ("value", "shape", "said"),
    [
        (np.zeros(3), (None, 3), r"field: an array of shape \(3,\); expected shape \(n, 3\)"),
        ([[1.0, np.nan]], (None, 2), r"field: nan at \[0, 1\]; expected finite numbers"),
        (["x"], (1,), "field: no array of numbers"),
    ],
)
def test_frozen_refuses(value: object, shape: tuple[int | None, ...], said: str) -> None:
    with pytest.raises(InputError, match=said) as caught:
        frozen(value, "field", shape)  # type: ignore[arg-type]
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("value", "said"),
    [([0, 1, 3], r"index 0 \.\. 3; expected 0 \.\. 2"), ([0.5, 1.0, 2.0], "expected whole numbers")],
)  # fmt: skip
def test_what_is_no_index_is_refused(value: list[object], said: str) -> None:
    with pytest.raises(InputError, match=said):
        frozen_index(value, "index", 3, 3)  # type: ignore[arg-type]


def test_covariances_where_they_are_needed() -> None:
    lopsided = np.eye(3)
    lopsided[0, 1] = 1e-3
    faults = {"zero": np.zeros((3, 3)), "flat": np.diag([1.0, 1.0, 0.0]), "negative": -np.eye(3), "lopsided": lopsided}
    for fault in faults.values():
        stack = np.array([np.diag([1e-4, 1.0, 1e6]), fault])
        require_covariances(stack, np.array([True, False]), ("good", "bad"), "file")
        with pytest.raises(InputError, match="file, point bad: an a-priori covariance that is not positive definite"):
            require_covariances(stack, np.array([True, True]), ("good", "bad"), "file")
    require_covariances(np.zeros((0, 3, 3)), np.zeros(0, dtype=bool), (), "file")


@pytest.mark.parametrize("name", ["a\x1b[2Jb", "a" * 501])
def test_names_that_no_terminal_should_be_given(name: str) -> None:
    require_names(("é", "image 2", ""), "images")
    refuses("images", require_names, ("é", name), "images")
    refuses("images: the id 'é' twice", require_names, ("é", "b", "é"), "images")


@pytest.mark.parametrize("parts", [[2, 4], [0, 3, 0]])
def test_a_repeated_value_takes_the_memory_of_one(parts: list[int]) -> None:
    """Chosen, joined and kept by a record it is what the full array is."""
    blocks = [repeated(0.0, (n, 3, 3)) for n in parts]
    together, rows = concatenated(blocks), np.array([0, sum(parts) - 1, 0])
    mixed = concatenated([*blocks, np.ones((2, 3, 3))])
    assert together.shape == (sum(parts), 3, 3)
    assert frozen(together, "x", (None, 3, 3)) is together
    assert chosen_rows(together, rows).shape == (3, 3, 3)
    assert not any(chosen_rows(together, rows).strides)
    np.testing.assert_array_equal(mixed, np.concatenate([np.zeros((sum(parts), 3, 3)), np.ones((2, 3, 3))]))
    np.testing.assert_array_equal(chosen_rows(mixed, rows), mixed[rows])


def test_what_nobody_can_write_to_is_not_copied() -> None:
    given = np.arange(3.0)
    assert frozen(given, "x", (3,)) is not given
    given.flags.writeable = False
    assert frozen(given, "x", (3,)) is given
    assert frozen(given[1:], "x", (2,)).base is given
    owner = np.arange(3.0)
    view = owner.view()
    view.flags.writeable = False
    assert frozen(view, "x", (3,)).base is None  # the owner may still be written to

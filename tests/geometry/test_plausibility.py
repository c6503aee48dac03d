"""Geometry that can't be: each planted fault is refused by name, and true images are not."""

import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from networks import network

from mgsgraph.adjustment.graph.layout import lay_out
from mgsgraph.adjustment.settings import SolverSettings
from mgsgraph.errors import InputError
from mgsgraph.files.networks.tie_points import require_places
from mgsgraph.geometry.altimetry import require_on_body
from mgsgraph.geometry.body import Ellipsoid, body_name, require_possible, target_name
from mgsgraph.geometry.image import PushbroomImage
from mgsgraph.geometry.plausibility import require_on_ground, require_plausible
from mgsgraph.geometry.trajectory import Trajectory
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
    "kilometres for metres": (lambda image: with_tables(image, 1e-3, 1e-3), "km from the body's centre"),
    "velocities of another unit": (lambda image: with_tables(image, 1.0, 1e-3), "velocities of"),
    "velocities of another sign": (lambda image: with_tables(image, 1.0, -1.0), "velocities of"),
    "axes of the body": (lambda image: replace(image, body=Ellipsoid(3.3762e6, 3.39619e6)), "check the order"),
    "small radii": (lambda image: replace(image, body=Ellipsoid(3396.19, 3376.2)), "from the body's"),
    "large radii": (lambda image: replace(image, body=Ellipsoid(3.39619e9, 3.3762e9)), "that there is"),
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
    with pytest.raises(InputError, match="rays that meet"):
        lay_out(replace(drawn, images=small), SolverSettings())


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
        with pytest.raises(InputError, match="rays that meet"):
            require_on_ground(factor * pole, np.full(20, 0.2), body, "ties")


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
    with pytest.raises(InputError, match="velocities of"):
        require_plausible(replace(IMAGES[0], trajectory=bent), "a.cub")



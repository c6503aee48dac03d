"""Geometry that can't be: each planted fault is refused by name, and true images are not."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from mgsgraph.errors import InputError
from mgsgraph.geometry.body import Ellipsoid
from mgsgraph.geometry.image import PushbroomImage
from mgsgraph.geometry.plausibility import require_plausible
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
    "axes of the body": (lambda image: replace(image, body=Ellipsoid(3.3762e6, 3.39619e6)), "check their order"),
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

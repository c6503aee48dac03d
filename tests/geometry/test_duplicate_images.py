"""One image under two names, and images that only look like that."""

from dataclasses import replace

import numpy as np
import pytest

from mgsgraph.errors import InputError
from mgsgraph.geometry.image import LineTiming, PushbroomImage, require_distinct, twins
from mgsgraph.geometry.trajectory import PositionTable, Trajectory
from mgsgraph.simulation.pair import simulate_pair

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
    assert twins([FIRST, SECOND, again, later(FIRST, 0.01)]) == [(0, 2), (0, 3), (2, 3)]
    assert twins([FIRST, aside(FIRST, 0.1)]) == [(0, 1)]


def test_others_are_not() -> None:
    narrower = replace(FIRST, interior=replace(FIRST.interior, first=FIRST.interior.first + np.array([0.0, 500.0])))
    assert twins([FIRST, SECOND, later(FIRST, 1.5), narrower, aside(FIRST, 300.0)]) == []
    assert twins([FIRST, replace(FIRST, lines=FIRST.lines - 1)]) == []


def test_both_names_are_said() -> None:
    with pytest.raises(InputError, match="SIM/A and again"):
        require_distinct([FIRST, SECOND, replace(FIRST, name="again")], "here")

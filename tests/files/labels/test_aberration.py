"""Light time and stellar aberration undone, against SPICE at real MGS kernels (data/README.md, trap 1)."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
import spiceypy
from hypothesis import given
from hypothesis import strategies as st
from strategies import directions

from mgsgraph.files.labels.aberration import Aberration, aberrated, geometric, without_aberration
from mgsgraph.geometry.trajectory import PositionTable
from mgsgraph.units import KM, MM, SPEED_OF_LIGHT

_KERNELS = ("naif0012.tls", "pck00009.tpc", "m0402852.ale_1.bsp")
TIMES = {
    "3 nodes, as in ISIS cubes": np.array([-0.4, 0.0, 0.4]),
    "1 s": np.arange(-5.0, 5.5),
    "10 s": np.arange(-30.0, 31.0, 10.0),
}


@pytest.fixture
def et(shared_data: Path) -> Iterator[float]:
    """Middle of image M04/02852 with the MGS and planet ephemerides loaded, which hold Mars, the Sun and the SSB."""
    with spiceypy.KernelPool([str(shared_data / "mgs_moc_m0402852" / name) for name in _KERNELS]):
        yield spiceypy.utc2et("1999-08-24T14:12:13.6")


def states(target: str, times: np.ndarray, correction: str, observer: str) -> np.ndarray:
    """(n, 6) m and m/s, J2000."""
    return KM * np.array([spiceypy.spkezr(target, t, "J2000", correction, observer)[0] for t in times])


def apparent(et: float, times: np.ndarray, body_observes: bool) -> PositionTable:
    table = states("MGS", et + times, "LT+S", "MARS") if body_observes else -states("MARS", et + times, "LT+S", "MGS")
    return PositionTable(times, table[:, :3], table[:, 3:])


def lt_s(body_observes: bool, to_surface: bool = False) -> Aberration:
    return Aberration("LT+S", "body" if body_observes else "spacecraft", to_surface)


@pytest.mark.parametrize("body_observes", [True, False], ids=["body observes", "spacecraft observes"])
def test_light_time_to_the_surface_is_undone(et: float, body_observes: bool) -> None:
    """Tables as ISIS and ALE make them: both about the barycentre, the target's so long before as light takes."""
    craft, mars = ("MGS", "MARS") if body_observes else ("MARS", "MGS")
    radius, times = 3386195.0, TIMES["1 s"]
    light = [spiceypy.spkezr(craft, et + t, "J2000", "LT+S", mars)[1] - radius / SPEED_OF_LIGHT for t in times]
    seen = states(craft, et + times - light, "NONE", "SSB") - states(mars, et + times, "NONE", "SSB")
    table = seen if body_observes else -seen
    velocity = states("MARS", np.array([et]), "NONE", "SUN")[0, 3:]
    found = geometric(PositionTable(times, table[:, :3], table[:, 3:]), velocity, lt_s(body_observes, True), radius)

    true = states("MGS", et + times, "NONE", "MARS")[:, :3]
    assert np.linalg.norm(table[:, :3] - true, axis=1).min() > 20.0
    assert np.linalg.norm(found.positions - true, axis=1).max() < 0.1


@pytest.mark.parametrize("spacing", TIMES)
@pytest.mark.parametrize("body_observes", [True, False], ids=["body observes", "spacecraft observes"])
def test_apparent_tables_of_mgs_become_geometric(et: float, spacing: str, body_observes: bool) -> None:
    """145 m of apparent displacement fall to 0.3 m with the heliocentric velocity, to 2 mm with that about the SSB."""
    times = TIMES[spacing]
    table, true = apparent(et, times, body_observes), states("MGS", et + times, "NONE", "MARS")
    before = np.linalg.norm(table.positions - true[:, :3], axis=1)
    assert np.all((before > 140.0) & (before < 150.0))

    for origin, limit, rate_limit in (("SUN", 0.3, MM), ("SSB", 2 * MM, 0.1 * MM)):
        velocity = states("MARS", np.array([et]), "NONE", origin)[0, 3:]
        found = geometric(table, velocity, lt_s(body_observes))
        assert np.linalg.norm(found.positions - true[:, :3], axis=1).max() < limit
        assert np.linalg.norm(found.velocities - true[:, 3:], axis=1).max() < rate_limit
        np.testing.assert_array_equal(found.times, times)


speeds = st.builds(lambda axis, speed: axis * speed, directions, st.floats(0.0, 30e3))


@given(directions, speeds)
def test_aberration_is_that_of_spice(direction: np.ndarray, velocity: np.ndarray) -> None:
    """NAIF stelab, at speeds up to 30 km/s; to see a tenth of a millimetre at 4000 km."""
    found = aberrated(direction[None], velocity[None] / SPEED_OF_LIGHT)

    np.testing.assert_allclose(found[0], spiceypy.stelab(direction, velocity / KM), atol=1e-15)


@given(directions, speeds)
def test_aberration_is_undone(direction: np.ndarray, velocity: np.ndarray) -> None:
    seen = 4e6 * aberrated(direction[None], velocity[None] / SPEED_OF_LIGHT)

    np.testing.assert_allclose(without_aberration(seen, velocity)[0], 4e6 * direction, atol=1e-8)


@pytest.mark.parametrize("body_observes", [True, False])
def test_a_body_at_rest_still_has_a_light_time(body_observes: bool) -> None:
    """Seen from the body, the craft is 12.7 ms late along its path; the craft sees the body turned by its own motion.
    At rest both are the same 43 m.
    """
    times = np.linspace(-1.0, 1.0, 5)
    velocity = np.array([0.0, 3400.0, 0.0])
    place = np.array([3.8e6, 0.0, 0.0]) + times[:, None] * velocity
    found = geometric(PositionTable(times, place, np.tile(velocity, (5, 1))), np.zeros(3), lt_s(body_observes))

    moved = found.positions[2] - place[2]
    np.testing.assert_allclose(moved, [0.0, 3400.0 * 3.8e6 / SPEED_OF_LIGHT, 0.0], atol=1e-3)

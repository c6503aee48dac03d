"""Vibrations as unknowns of a pass: both forms, truth, what an image of two axes and of no pass does."""

from dataclasses import replace

import numpy as np
import pytest
from ctx_pair import PIXEL, CtxSettings, JitterSettings, SimulatedCtxPair, image_times, simulate_ctx_pair
from outside import refuses

from mgsgraph.adjustment.adjust import adjust_network
from mgsgraph.adjustment.factor_graph import factor_graph
from mgsgraph.adjustment.settings import SolverSettings
from mgsgraph.geometry.orientation import Sine
from mgsgraph.geometry.records import Array
from mgsgraph.network import Network, SharedUnknown

PLAIN = SolverSettings(starts=0)


def vibrating(net: Network, frequency: float, sigma: float = 1.0, drift: float = 0.0) -> Network:
    """With a vibration of each image, of a-priori sigmas in px."""
    found = []
    for k, image in enumerate(net.images):
        start, stop = image_times(image)
        sine = Sine(frequency, image.trajectory.epoch + 0.5 * (start + stop), 0.5 * (stop - start))
        name = f"vibration of {image.name}"
        found.append(SharedUnknown.of_vibration(name, np.array([k]), sine, np.full(3, sigma * PIXEL), drift))
    return replace(net, shared=tuple(found))


def planted(mine: SimulatedCtxPair) -> Array:
    """(24,) rad, the true values."""
    every = [[truth.phasors[1], truth.phasors[0], np.zeros(2)] for truth in mine.truth]
    return np.concatenate([np.array(every), np.zeros((2, 3, 2))], axis=2).ravel()


def test_both_forms_have_the_same_optimum_of_a_fast_vibration() -> None:
    """1 px at 3 Hz turns the camera by a twenty-eighth of a line per line more or less."""
    jitter = JitterSettings(pitch=1.0, roll=1.0, frequency=3.0)
    net = vibrating(simulate_ctx_pair(CtxSettings(ties=100, jitter=jitter), 5).network, 3.0, 2.0, 0.5)
    one = adjust_network(net, PLAIN)
    graph, values, keys = factor_graph(one)
    assert one.converged
    assert graph.error(values) == pytest.approx(one.cost_final, rel=1e-10)
    slope = graph.linearize(values).gradientAtZero()
    for k, each in enumerate(net.shared):
        assert np.abs(slope.at(keys.shared(each.name)) * np.sqrt(np.diag(one.shared_covariance(k)))).max() < 1e-3
    for j in range(2):
        mine = net.rays.image == j
        seen, _ = net.images[j].ground_to_image(
            one.places[net.rays.point[mine]], one.correction(j), net.rays.places[mine, 0]
        )
        np.testing.assert_allclose(net.rays.places[mine] - seen, one.residuals[mine], atol=1e-6)


def test_the_truth_is_found_as_well_as_said() -> None:
    """Chi-square of all 24 amounts, 99.9 %; what both images show, to a fiftieth of a pixel."""
    mine = simulate_ctx_pair(CtxSettings(ties=1200), 12)
    solution = adjust_network(vibrating(mine.network, 2.0), PLAIN)
    off = np.concatenate(solution.shared) - planted(mine)
    covariance = solution.joint_covariance.of([solution.shared_variable(k) for k in (0, 1)])
    assert off @ np.linalg.solve(covariance, off) < 51.2
    surest, ways = np.linalg.eigh(covariance / PIXEL**2)
    assert np.all(np.sqrt(surest[12:14]) < 0.02)  # beside twelve drifts that are held
    assert np.abs(ways[:, 12:14].T @ planted(mine) / PIXEL / np.sqrt(surest[12:14])).max() > 4.0


@pytest.mark.parametrize(
    ("frequencies", "said"),
    [((300.0,), "300 Hz, of lines 0.00"), ((4.0,), "and 30 rays in"), ((0.5, 0.55), "0.05 Hz from .*0.0626782 Hz")],
)
def test_what_neither_lines_nor_rays_resolve_is_refused(frequencies: tuple[float, ...], said: str) -> None:
    net = simulate_ctx_pair(CtxSettings(ties=30), 5).network
    shared = [one for frequency in frequencies for one in vibrating(net, frequency).shared]
    named = tuple(replace(one, name=f"{one.name} {k}") for k, one in enumerate(shared))
    refuses(said, adjust_network, replace(net, shared=named), PLAIN)


@pytest.mark.parametrize("frequency", [0.01, np.nan, np.inf, -2.0])
def test_what_is_slower_than_the_pass_is_refused(frequency: float) -> None:
    refuses("one cycle or more", Sine, frequency, 0.0, 8.0)

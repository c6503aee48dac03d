"""Vibrations found, with their frequencies and amplitudes, against planted ones; nothing where nothing is; and what a
prior makes is not stated.
"""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from ctx_pair import CONTROL, PIXEL, CtxSettings, JitterSettings, SimulatedCtxPair, simulate_ctx_pair

from mgsgraph.adjustment.adjust import adjust_network
from mgsgraph.adjustment.settings import SolverSettings
from mgsgraph.analysis import vibrations
from mgsgraph.analysis.vibrations import Amplitude, EstimatedVibrations, Line, amplitudes, estimated_vibrations
from mgsgraph.geometry.records import Array
from mgsgraph.network import Network
from mgsgraph.results.passes import shared_section

PLAIN = SolverSettings(starts=0)


def pair(jitter: JitterSettings, control: bool = True, seed: int = 25) -> SimulatedCtxPair:
    return simulate_ctx_pair(CtxSettings(ties=700, jitter=jitter, control=CONTROL if control else None), seed)


@cache
def shaken() -> tuple[SimulatedCtxPair, EstimatedVibrations]:
    """Half a pixel at 3.3 Hz."""
    mine = pair(JitterSettings(frequency=3.3))
    return mine, estimated_vibrations(mine.network, PLAIN)


def planted(mine: SimulatedCtxPair, one: Amplitude) -> float:
    """rad, of a combination of passes."""
    turn = {"x (roll)": 1, "y (pitch)": 0}[one.axis]
    amounts = [complex(*(mine.truth[name == "CTX/B"].phasors[turn] * [1.0, -1.0])) for name in one.names]
    return abs(amounts[0] - sum(complex(*w) * other for w, other in zip(one.weights, amounts[1:], strict=True)))


def test_frequency_and_amplitudes_are_found_within_their_sigmas() -> None:
    """In 24 unknowns of two passes; 4 sigmas. The cost is that of the noise."""
    mine, found = shaken()
    (line,) = found.lines
    assert found.converged
    assert abs(line.frequency - 3.3) < 4.0 * line.sigma < 0.05
    assert not line.drifts
    stated = [one for one in amplitudes(found.solution) if one.shown]
    assert {one.axis for one in stated} == {"x (roll)", "y (pitch)"}
    for one in stated:
        assert abs(one.value - planted(mine, one)) < 4.0 * one.sigma < 0.2 * PIXEL
    assert len({one.axis for one in stated if len(one.names) == 2}) == 2  # differences of both
    fit = found.solution.fit
    assert fit.squares / fit.degrees_of_freedom < 1.1
    assert len(shared_section(found.solution).sentences) == len(amplitudes(found.solution))


def test_nothing_is_found_where_nothing_vibrates() -> None:
    found = estimated_vibrations(pair(JitterSettings(pitch=0.0, roll=0.0)).network, PLAIN)
    assert not found.lines
    assert found.converged
    assert not found.network.shared


def with_line(frequency: float, drift: float = 0.3) -> Network:
    mine, _ = shaken()
    owners = vibrations._owners(mine.network, ())
    return vibrations.with_lines(mine.network, owners, [Line(frequency, 0.0, 0.5, drift)])


@pytest.mark.parametrize("off", [-0.008, 0.005])
def test_drifts_say_by_how_much_a_frequency_is_off(off: float) -> None:
    _, found = shaken()
    (line,) = found.lines
    at = vibrations._drifts(adjust_network(with_line(line.frequency + off), PLAIN), [0, 1])
    assert at.step == pytest.approx(-off, rel=0.15, abs=0.2 * line.sigma)
    assert at.sigma == pytest.approx(line.sigma, rel=0.3)


@pytest.mark.slow
def test_a_drift_is_chosen_where_the_likelihood_asks_for_it() -> None:
    """Rays of the first image moved by a wave that grows from nothing to 2 px."""
    mine = pair(JitterSettings(pitch=0.0, roll=0.0))
    rays, image = mine.network.rays, mine.network.images[0]
    places, own = np.array(rays.places), np.flatnonzero(rays.image == 0)
    times = image.timing.at(places[own, 0])[0]
    s = times / np.abs(times).max()
    places[own, 0] += (1.0 + s) * np.cos(2.0 * np.pi * 2.5 * times)
    found = estimated_vibrations(replace(mine.network, rays=replace(rays, places=places)), PLAIN)
    assert [one.drifts for one in found.lines] == [True]


def test_what_only_the_prior_knows_is_not_stated() -> None:
    """Without control roll makes heights; the pitch of both passes is their difference."""
    mine = pair(JitterSettings(), control=False, seed=26)
    found = estimated_vibrations(mine.network, PLAIN)
    by_axis = {one.axis: one for one in amplitudes(found.solution)}
    assert np.isnan(by_axis["x (roll)"].value)
    assert not by_axis["x (roll)"].shown
    pitch = by_axis["y (pitch)"]
    assert len(pitch.names) == 2
    assert abs(pitch.value - planted(mine, pitch)) < 4.0 * pitch.sigma
    assert np.hypot(*pitch.weights[0]) == pytest.approx(np.cos(np.deg2rad(22.0)), abs=0.03)  # farther, so larger pixels


@pytest.mark.parametrize("turn", [0.0, 0.7])
def test_the_surest_combination_is_taken(turn: float) -> None:
    """Known to 0.01 is x - w y of two passes whose amounts are known to 1."""
    w = 0.9 * np.exp(1j * turn)
    product = np.array([[w.real, w.imag], [-w.imag, w.real]])
    seen = np.hstack([np.eye(2), -product]) / 0.01
    joint = np.linalg.inv(seen.T @ seen + np.eye(4))
    _, found = shaken()
    solution, amounts = found.solution, np.array([0.5, 0.2]) * PIXEL
    shared = [np.zeros(12), np.zeros(12)]
    shared[0][:2], shared[1][:2] = product @ amounts + [0.3 * PIXEL, 0.0], amounts
    scaled: Array = joint * float(solution.network.shared[0].sigmas[0]) ** 2
    (one,) = vibrations._of_axis(replace(solution, shared=tuple(shared)), [0, 1], 0, scaled)
    assert complex(*one.weights[0]) == pytest.approx(w, rel=1e-3)
    assert one.value == pytest.approx(0.3 * PIXEL, rel=0.02)
    assert one.sigma == pytest.approx(0.01 * solution.network.shared[0].sigmas[0], rel=0.01)

"""Spectra of a strip's corrections: planted vibrations appear, none appear of noise more often than stated."""

import math
from dataclasses import fields, replace
from functools import cache
from typing import Any

import numpy as np
import pytest
from scipy.signal import lombscargle

from mgsgraph.adjustment.adjust import adjust_network
from mgsgraph.adjustment.settings import SolverSettings
from mgsgraph.adjustment.solution import Solution
from mgsgraph.analysis.flight import strip_turns
from mgsgraph.analysis.spacing.corrections import AXES, CorrectionSeries, correction_series
from mgsgraph.analysis.spacing.spectrum import Spectrum, spectra, spectrum
from mgsgraph.errors import InputError
from mgsgraph.geometry.orientation_images import Basis
from mgsgraph.geometry.records import Array
from mgsgraph.geometry.trajectory import Trajectory
from mgsgraph.simulation.hrsc_block import BlockSettings, TrajectoryErrors, simulate_hrsc_block
from mgsgraph.simulation.strip_truth import Axis, Jitter, correction_at
from mgsgraph.units import MGON

ROLL, PITCH = AXES.index("roll"), AXES.index("pitch")


def made(times: Array, values: Array, spread: Array | None = None, response: Array | None = None) -> CorrectionSeries:
    """A course with corrections in roll alone, whose errors have a covariance (k, k), and which it all shows."""
    k = times.size
    spread = np.eye(k) if spread is None else spread
    six = np.zeros((k, 6))
    six[:, ROLL] = values
    whole = np.kron(spread, np.eye(6))
    shown = np.kron(np.eye(k) if response is None else response, np.eye(6))
    return CorrectionSeries("strip", 0.0, times, six, whole, whole, shown, None, np.full(6, np.inf))


def uneven(k: int, rng: np.random.Generator) -> Array:
    return np.cumsum(rng.uniform(0.6, 1.4, k))


def red(times: Array) -> Array:
    """Covariance of noise that remembers itself, and more of it towards the end."""
    growing = 1.0 + times / times[-1]
    return np.exp(-np.abs(times[:, None] - times) / 3.0) * np.outer(growing, growing)


@pytest.mark.parametrize("frequency", [0.08, 0.21, 0.37])
def test_pure_wave_comes_back(frequency: float) -> None:
    """With bias, drift, uneven nodes and red noise as weights: to rounding, and nothing else is named."""
    times = uneven(60, np.random.default_rng(1))
    values = 40.0 + 3.0 * times + 25.0 * np.sin(2.0 * np.pi * frequency * times + 0.7)
    found = spectrum(made(times, values, red(times)), ROLL)
    (peak,) = found.peaks[:1]
    assert peak.frequency == pytest.approx(frequency, abs=0.01 / np.ptp(times))
    assert peak.amplitude == pytest.approx(25.0, rel=5e-3)
    assert peak.probability < 1e-9
    assert found.vibrations[0] is peak


def test_what_the_prior_swallows_is_given_back() -> None:
    """An adjustment that shows 40 % of true corrections: the amplitude is the true one all the same."""
    times = np.arange(50.0)
    true = 30.0 * np.cos(2.0 * np.pi * 0.2 * times)
    found = spectrum(made(times, 0.4 * true, 0.01 * np.eye(50), 0.4 * np.eye(50)), ROLL)
    assert found.peaks[0].amplitude == pytest.approx(30.0, rel=1e-2)


def test_same_as_lomb_and_scargle() -> None:
    """White noise, and values without bias and drift: SciPy's amplitudes, where drift and wave are told apart."""
    rng = np.random.default_rng(2)
    times = uneven(200, rng)
    values = rng.standard_normal(200)
    centred = times - times.mean()
    values -= np.polyval(np.polyfit(centred, values, 1), centred)
    found = spectrum(made(times, values), ROLL)
    high = np.flatnonzero(found.frequencies > 5.0 / np.ptp(times))[::8]
    other = lombscargle(times, values, 2.0 * np.pi * found.frequencies[high], normalize=False)
    assert np.sqrt(4.0 * other / 200.0) == pytest.approx(found.amplitudes[high], abs=0.1 * found.floor.mean())


def test_floor_and_level_of_white_noise() -> None:
    """A variance of 4 on n nodes: rms amplitude 2 sqrt(4 / n); the level is about that of so many tries."""
    times = np.arange(100.0)
    found = spectrum(made(times, np.random.default_rng(3).standard_normal(100), 4.0 * np.eye(100)), ROLL)
    inner = slice(20, -20)
    assert found.floor[inner] == pytest.approx(2.0 * math.sqrt(4.0 / 100), rel=0.03)
    limit = -2.0 * math.log(-math.expm1(math.log(0.99) / found.independent))
    assert found.level[inner] == pytest.approx(found.floor[inner] * math.sqrt(limit / 2.0), rel=0.03)
    assert 40.0 < found.independent < 200.0
    assert found.nyquist == 0.5


@pytest.mark.parametrize("rate", [0.01, 0.1])
def test_false_alarms_are_as_stated(rate: float) -> None:
    """Noise of the stated covariance, uneven and red: within what so many draws allow, three sigmas."""
    rng, draws = np.random.default_rng(4), 300
    times = uneven(24, rng)
    spread = red(times)
    root = np.linalg.cholesky(spread)
    alarms = sum(
        bool(spectrum(made(times, root @ rng.standard_normal(24), spread), ROLL, rate).peaks) for _ in range(draws)
    )
    assert abs(alarms - rate * draws) < 3.0 * math.sqrt(rate * (1.0 - rate) * draws) + 1.0


def test_two_waves_and_no_side_lobes() -> None:
    times = np.arange(80.0)
    values = 30.0 * np.sin(2.0 * np.pi * 0.11 * times) + 12.0 * np.cos(2.0 * np.pi * 0.31 * times)
    values += np.random.default_rng(5).standard_normal(80)
    found = spectrum(made(times, values), ROLL).vibrations
    assert [round(one.frequency, 2) for one in found] == [0.11, 0.31]
    assert [one.amplitude for one in found] == pytest.approx([30.0, 12.0], abs=4.0 * math.sqrt(2.0 / 80))


def test_too_few_nodes_and_odd_rates() -> None:
    times = np.arange(6.0)
    with pytest.raises(InputError, match="at least 8"):
        spectrum(made(times, np.zeros(6)), ROLL)
    with pytest.raises(InputError, match="false alarms"):
        spectrum(made(np.arange(20.0), np.zeros(20)), ROLL, 0.7)


# --- of an adjustment


@cache
def adjusted(basis: Basis = "lagrange", axis: Axis | None = None, seed: int = 1) -> Solution:
    """A strip of 100 s with nodes every 2.5 s; jitter of 3 mgon at 0.06 Hz about an axis."""
    jitter = None if axis is None else Jitter(3.0 * MGON, 0.06, axis)
    settings = BlockSettings(
        strips=1, length=200e3, points=1000, terrain=None, basis=basis, spacing=2.5, jitter=jitter,
        errors=TrajectoryErrors(attitude_wander=1.0 * MGON),
    )  # fmt: skip
    return adjust_network(simulate_hrsc_block(settings, seed).network, SolverSettings())


def by_axis(found: list[Spectrum]) -> dict[str, Spectrum]:
    return {one.axis: one for one in found}


@pytest.mark.parametrize("basis", ["lagrange", "spline"])
@pytest.mark.parametrize("axis", ["pitch", "roll"])
def test_planted_jitter_appears(basis: Basis, axis: Axis) -> None:
    one = correction_series(adjusted(basis, axis), 0)
    found = by_axis(spectra(one))
    (peak,) = found[axis].vibrations
    assert peak.frequency == pytest.approx(0.06, abs=0.25 / np.ptp(one.times))
    assert peak.amplitude == pytest.approx(3.0 * MGON, abs=4.0 * peak.sigma)
    assert peak.sigma < 0.3 * MGON
    assert peak.probability < 1e-9
    position = {"pitch": "along-track position", "roll": "across-track position"}[axis]
    assert not found[position].vibrations
    assert any(echo.echo_of == axis for echo in found[position].peaks)


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_none_without_jitter(seed: int) -> None:
    """The departures that the prior expects are there, and none of them is called a vibration."""
    found = spectra(correction_series(adjusted(seed=seed), 0))
    assert [one.axis for one in found] == list(AXES)
    assert not any(one.vibrations for one in found)


@pytest.mark.parametrize("basis", ["lagrange", "spline"])
def test_course_is_the_correction(basis: Basis) -> None:
    """At its times it has the size of the correction, and the sigmas of the joint covariance."""
    solution = adjusted(basis)
    one = correction_series(solution, 0)
    correction = solution.correction(2)
    at = correction_at(correction, one.times, one.epoch)
    for part in (slice(0, 3), slice(3, 6)):
        np.testing.assert_allclose(
            np.linalg.norm(one.values[:, part], axis=1), np.linalg.norm(at[:, part], axis=1), rtol=1e-4
        )
    # pitch is about the camera's x, roll about its y
    np.testing.assert_allclose(np.abs(one.values[:, PITCH]), np.abs(at[:, 3]), atol=0.03 * np.abs(at[:, 3:]).max())
    np.testing.assert_allclose(np.abs(one.values[:, ROLL]), np.abs(at[:, 4]), atol=0.03 * np.abs(at[:, 3:]).max())


def test_each_time_has_the_axes_of_an_image_that_covers_it() -> None:
    """Over 26 degrees of arc, of images that know the seconds of their own lines alone."""
    settings = BlockSettings(strips=1, length=1500e3, points=100, terrain=None, spacing=20.0)
    net = simulate_hrsc_block(settings, 1).network
    nodes = net.passes[0].nodes
    times = nodes.epoch + nodes.times
    spans = [one.timing.at(np.array([0.0, float(one.lines)]))[0] for one in net.images]
    short = [
        replace(one, trajectory=cut(one.trajectory, float(start) - 3.0, float(stop) + 3.0))
        for one, (start, stop) in zip(net.images, spans, strict=True)
    ]
    assert spans[0][1] + 50.0 < max(stop for _, stop in spans)  # the first one knows nothing of the end
    whole, found = (strip_turns(one, 0, times, "camera") for one in (net, replace(net, images=tuple(short))))
    # lines look from one spacecraft: axes differ by what tables leave at their ends
    np.testing.assert_allclose(found, whole, atol=1e-5)
    np.testing.assert_allclose(found @ np.swapaxes(found, 1, 2), np.broadcast_to(np.eye(6), found.shape), atol=1e-12)


def cut(trajectory: Trajectory, start: float, stop: float) -> Trajectory:
    """A trajectory of some of its time, s past its epoch."""
    def part(table: Any) -> Any:
        inside = (table.times >= start) & (table.times <= stop)
        return replace(table, **{
            field.name: value[inside] for field in fields(table)
            if isinstance(value := getattr(table, field.name), np.ndarray) and value.shape[:1] == inside.shape
        })  # fmt: skip

    tables = [field.name for field in fields(trajectory) if field.name != "epoch"]
    return replace(trajectory, **{name: part(getattr(trajectory, name)) for name in tables})


def test_noise_is_the_covariance_where_nothing_is_known_beforehand() -> None:
    """A prior ten times as wide tells less: noise and covariance come nearer, and more of the truth is shown."""
    gaps, shown = [], []
    for factor in (1.0, 10.0):
        errors = TrajectoryErrors(
            attitude_wander=factor * MGON, attitude=28.0 * factor * MGON, position_wander=0.1, correlation_time=0.0
        )
        settings = BlockSettings(strips=1, length=150e3, points=800, terrain=None, spacing=10.0, errors=errors)
        net = simulate_hrsc_block(settings, 1).network
        one = correction_series(adjust_network(net, SolverSettings()), 0)
        own, noise = one.axis(one.covariance, PITCH), one.axis(one.noise, PITCH)
        assert np.linalg.eigvalsh(own - noise).min() > -1e-6 * np.trace(own)
        assert np.linalg.eigvalsh(noise).min() > -1e-6 * np.trace(own)
        # without what all nodes have in common, which the datum leaves open
        apart = np.eye(own.shape[0]) - 1.0 / own.shape[0]
        gaps.append(np.trace(apart @ (own - noise) @ apart) / np.trace(apart @ own @ apart))
        shown.append(np.trace(apart @ one.axis(one.response, PITCH)) / (own.shape[0] - 1))
    assert 0.0 < gaps[1] < gaps[0] < 1.0
    assert shown[0] < shown[1] < 1.0 + 1e-6
    assert shown[1] > 0.9

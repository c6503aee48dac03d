"""Effects and vibrations in residuals, against Baarda's tests, changed measures, draws, and planted ones."""

import json
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from ctx_pair import (
    CONTROL,
    PIXEL,
    CtxSettings,
    JitterSettings,
    Look,
    SimulatedCtxPair,
    simulate_ctx_pair,
)
from networks import network, pair, with_shift_and_surface
from outside import refuses
from scipy.signal import lombscargle
from sites import plain_site

from mgsgraph.adjustment.adjust import adjust_network
from mgsgraph.adjustment.settings import SolverSettings
from mgsgraph.adjustment.solution import Solution
from mgsgraph.analysis import residual_spectrum
from mgsgraph.analysis.linearised import at_solution
from mgsgraph.analysis.measures import MeasureKind
from mgsgraph.analysis.posterior import Posterior
from mgsgraph.analysis.reliability import reliability
from mgsgraph.analysis.residual_rows import ResidualRows, quadratic_tail, residual_rows
from mgsgraph.analysis.residual_spectrum import (
    Residuals,
    Series,
    SeriesSpectrum,
    Wave,
    residual_series,
    residual_vibrations,
)
from mgsgraph.analysis.systematic import EffectKind
from mgsgraph.analysis.unexplained import unexplained
from mgsgraph.case.reading import Case, adjust, read_case
from mgsgraph.geometry.body import east_north
from mgsgraph.geometry.records import Array
from mgsgraph.kernel.rows import IMAGE, RANGE
from mgsgraph.network import Network
from mgsgraph.results.analysis import vibrations_section
from mgsgraph.simulation.files import write_site

PLAIN = SolverSettings(cost_tolerance=1e-14)
LRO = Path(__file__).resolve().parents[2] / "scripts" / "cases" / "lro_nac_lola.toml"


def rows_of(net: Network) -> ResidualRows:
    return residual_rows(at_solution(adjust_network(net, PLAIN)), np.arange(len(net.points)))


@cache
def net() -> Network:
    return with_shift_and_surface(network(pair()))


def test_an_effect_on_one_measure_is_tested_as_a_blunder_is() -> None:
    rows, found = rows_of(net()), reliability(adjust_network(net(), PLAIN)).measures
    for kind, measured in ((MeasureKind.RAY, IMAGE), (MeasureKind.RANGE, RANGE)):
        mine, table = rows.of_kind(measured), found.kind == kind
        keys = zip(found.row[table].tolist(), found.component[table].tolist(), strict=True)
        tests = dict(zip(keys, found.test[table].tolist(), strict=True))
        variance = np.diagonal(rows.variance(mine, np.eye(mine.size)))
        wanted = [tests[int(rows.measure[k]), int(rows.component[k])] for k in mine]
        assert np.allclose(rows.residuals[mine] / np.sqrt(variance), wanted, rtol=1e-5, atol=1e-5)
        assert np.allclose(variance, rows.redundancy[mine], atol=1e-9)


def test_what_an_effect_shows_is_what_an_adjustment_of_changed_measures_leaves() -> None:
    plain = network(pair())
    rays, rows = plain.rays, rows_of(plain)
    mine = rows.of_kind(IMAGE)
    step = 0.01 * np.random.default_rng(1).standard_normal(rays.places.shape)
    changed = rows_of(replace(plain, rays=replace(rays, places=rays.places + step)))
    effect = (step / rays.sigmas)[rows.measure[mine], rows.component[mine]]
    shown = rows.explained(mine, effect[:, None])[:, 0]
    assert proportional(changed.residuals - rows.residuals, shown)


def test_residuals_vary_by_what_a_considered_unknown_may_be_off() -> None:
    held = replace(net(), surface=None, considered=("profile",))
    rows, points = rows_of(held), held.points
    assert held.shifts is not None
    step = 0.01 * held.shifts.sigmas[0]
    of_profile = np.flatnonzero(held.shifts.profile >= 0)
    places = points.places.copy()
    places[of_profile] += step * east_north(places[of_profile])[:, 0]
    changed = rows_of(replace(held, points=replace(points, places=places)))
    there = rows.considered[:, 0] != 0.0
    assert proportional(100.0 * (changed.residuals - rows.residuals)[there], rows.considered[there, 0])


def proportional(found: Array, wanted: Array) -> bool:
    """Whether two vectors agree but for a hundredth, which is not linear."""
    return float(np.linalg.norm(found - wanted)) < 0.01 * float(np.linalg.norm(wanted))


def test_the_tail_of_a_quadratic_form_is_that_of_draws() -> None:
    rng = np.random.default_rng(3)
    weights = np.concatenate([rng.uniform(0.0, 2.0, 12), rng.uniform(-1.0, 0.0, 24)])
    draws = np.sort(rng.standard_normal((40_000, weights.size)) ** 2 @ weights)
    for share in (0.1, 0.01, 0.001):
        assert quadratic_tail(float(draws[-int(share * draws.size)]), weights) == pytest.approx(share, rel=0.25)


@pytest.fixture(scope="module")
def case(tmp_path_factory: pytest.TempPathFactory) -> Case:
    return read_case(write_site(plain_site(), tmp_path_factory.mktemp("site")))


def shaken(case: Case, period: float) -> Network:
    """With 1.5 px of jitter in the lines of the first image, of a period in s."""
    rays, image = case.network.rays, case.network.images[0]
    mine = rays.image == 0
    times, _ = image.timing.at(rays.places[mine, 0])
    places = rays.places.copy()
    places[mine, 0] += 1.5 * np.sin(2.0 * np.pi * times / period)
    return replace(case.network, rays=replace(rays, places=places))


# above two seconds: a whole site adjusted twice, and a search over all periods of jitter
def test_jitter_is_named_and_good_data_name_nothing(case: Case) -> None:
    clean = unexplained(adjust_network(case.network, case.settings))
    assert not clean.effects
    assert min(one.p_value for one in clean.others) > clean.level
    first = unexplained(adjust_network(shaken(case, 1.3), case.settings)).effects[0]
    assert first.kind is EffectKind.JITTER
    both = f"{first.where} (period {first.period:.2g} s)", *first.alternatives
    assert f"image {case.network.images[0].name} (period 1.3 s)" in both
    assert abs(first.amplitude - 1.5) < 4.0 * first.sigma
    assert "spacing_s" in first.term


def test_a_level_that_is_no_probability_is_refused() -> None:
    refuses("level", unexplained, adjust_network(net(), PLAIN), 1.0)


# --- vibrations in residuals


CALM = JitterSettings(pitch=0.0, roll=0.0)


@cache
def ctx(
    look: Look = "across", jitter: JitterSettings = CALM, control: bool = False, seed: int = 11
) -> tuple[SimulatedCtxPair, Solution]:
    settings = CtxSettings(look=look, ties=1200, jitter=jitter, control=CONTROL if control else None)
    mine = simulate_ctx_pair(settings, seed)
    return mine, adjust_network(mine.network, SolverSettings(starts=0))


def difference(mine: SimulatedCtxPair, turn: int) -> float:
    """px, true amplitude of the first image's vibration less the second's."""
    first, second = mine.truth
    return float(np.hypot(*(first.phasors[turn] - second.phasors[turn]))) / PIXEL


def uneven(count: int, rng: np.random.Generator) -> Array:
    """Times of 10 s, from the middle of the first and the last."""
    times = np.sort(rng.uniform(-5.0, 5.0, count))
    return np.asarray(times - 0.5 * (times[0] + times[-1]))


def white(count: int, rng: np.random.Generator, values: Array | None = None) -> tuple[SeriesSpectrum, Array]:
    """A search in noise of 0.1 px at uneven times over 10 s, half of which residuals show."""
    times, ones = uneven(count, rng), np.ones(count)
    one = Series(0, "made", "pitch", np.arange(count), times, ones, 0.5 * ones, 100.0 * ones)
    residuals = 0.1 * np.sqrt(0.5) * rng.standard_normal(count) if values is None else values
    return SeriesSpectrum(one), residuals


# --- properties


def test_spectrum_is_lomb_scargle_where_all_is_even() -> None:
    """Of noise of one size, and all of a move shown, with a mean, it is the generalised periodogram of Zechmeister."""
    rng = np.random.default_rng(5)
    count, ones = 500, np.ones(500)
    times = uneven(count, rng)
    search = SeriesSpectrum(Series(0, "made", "pitch", np.arange(count), times, ones, ones, ones))
    values = rng.standard_normal(count)
    fits = search.fits(values)
    high = fits.frequencies > 1.0  # where the polynomial beside it is no other than a mean
    theirs = lombscargle(times, values, 2.0 * np.pi * fits.frequencies[high], floating_mean=True)
    ours = (fits.tests * fits.floor)[high] / 2.0
    np.testing.assert_allclose(ours, theirs, rtol=0.1, atol=0.3)
    assert np.corrcoef(ours, theirs)[0, 1] > 0.995


def test_fast_sums_are_direct_ones() -> None:
    search, residuals = white(400, np.random.default_rng(2))
    fits, one = search.fits(residuals), search.series
    polynomials = np.vander(one.times / 5.0, 8)
    covariance, values = np.empty((fits.frequencies.size, 2, 2)), np.empty((fits.frequencies.size, 2))
    for k, frequency in enumerate(fits.frequencies.tolist()):
        waves = one.waves(np.array([frequency]))
        columns = np.concatenate([waves, polynomials], axis=1)
        covariance[k] = np.linalg.inv(columns.T @ ((one.weights * one.shares)[:, None] * columns))[:2, :2]
        values[k] = covariance[k] @ waves.T @ (one.weights * residuals)
    size = np.sqrt(np.trace(covariance, axis1=1, axis2=2))[:, None]
    assert np.abs((fits.values - values) / size).max() < 0.15
    np.testing.assert_allclose(fits.covariance, covariance, rtol=0.05, atol=0.03 * covariance.max())


# above two seconds on a busy machine: six hundred spectra, else 5 % could not be told from 6
def test_noise_alone_is_not_named_more_often_than_stated() -> None:
    """Of 600 spectra of noise, three times as large as stated, 5 % at most are below p = 0.05; and some are."""
    rng, chances = np.random.default_rng(8), []
    for _ in range(600):
        search, residuals = white(160, rng)
        chances.append(search.fits(3.0 * residuals).probability)
    assert 0.0 < np.mean(np.array(chances) < 0.05) < 0.06
    assert 0.15 < np.mean(np.array(chances) < 0.5) < 0.55


def test_amplitude_counts_what_the_points_took_up() -> None:
    """Residuals show half of the wave; the amplitude is that of the camera."""
    rng = np.random.default_rng(3)
    search, residuals = white(800, rng)
    wave = 0.3 * np.cos(2.0 * np.pi * 1.7 * search.series.times + 0.4)
    fits = search.fits(residuals + 0.5 * wave)
    best = int(np.argmax(fits.tests))
    sigma = np.sqrt(0.5 * search.fits(residuals).floor[best] * np.trace(fits.covariance[best]))
    assert fits.frequencies[best] == pytest.approx(1.7, abs=0.01)
    assert np.hypot(*fits.values[best]) == pytest.approx(0.3, abs=4.0 * sigma)
    assert sigma == pytest.approx(0.1 * np.sqrt(2.0 / (800 * 0.5)), rel=0.3)


def adjusted_again(of: Network, residuals: Residuals, one: Series, moved: Array) -> Solution:
    """With the lines of a series' rays moved by (k,) px."""
    places = np.array(of.rays.places)
    places[residuals.rows.measure[one.own], 0] += moved
    return adjust_network(replace(of, rays=replace(of.rays, places=places)), SolverSettings(starts=0))


def test_what_a_turn_shows_is_what_adjustment_leaves_of_it() -> None:
    """Rays of one image moved by hand, and adjusted again: residuals change as predicted."""
    pair, solution = ctx()
    residuals = residual_series(solution, 60)
    one = next(each for each in residuals.series if (each.image, each.turn) == (0, "pitch"))
    moved = 0.5 * np.cos(2.0 * np.pi * 3.0 * one.times)
    other = adjusted_again(pair.network, residuals, one, moved)
    mine = residuals.rows.of_kind(IMAGE)
    change = (other.residuals - solution.residuals)[residuals.rows.measure[mine], residuals.rows.component[mine]]
    shown = residuals.shown(one, moved)[mine]
    assert np.abs(shown).max() > 0.2
    assert np.sqrt(np.mean((change - shown) ** 2)) < 0.02
    share = moved @ change[np.searchsorted(mine, one.own)] / (moved @ moved)  # noise is the same in all rays
    assert residuals.share(one, np.array([3.0])) == pytest.approx(share, abs=0.03)


# --- planted


@pytest.mark.parametrize(("look", "turn", "blind"), [("across", "pitch", "roll"), ("along", "roll", "pitch")])
def test_what_ties_can_see_is_named_and_what_not_is_said(look: Look, turn: str, blind: str) -> None:
    mine, solution = ctx(look, JitterSettings())
    found = residual_vibrations(solution)
    (one,) = found.vibrations
    assert one.turn == turn
    assert one.frequency == pytest.approx(2.0, abs=0.015)
    true = difference(mine, 0 if turn == "pitch" else 1)
    assert one.amplitude == pytest.approx(true, abs=4.0 * one.sigma + 0.05 * true)
    other = {"CTX/A": "CTX/B", "CTX/B": "CTX/A"}[one.image]
    assert f"{other} ({turn})" in one.alternatives
    assert f"{blind} of CTX/A, {blind} of CTX/B" in found.sentences[-1]
    assert f"{one.frequency:.4f} +-" in found.sentences[0]
    # a project has no record of its solution, and says the same
    assert residual_vibrations(at_solution(solution)).sentences == found.sentences


def test_the_cost_drops_by_what_a_vibration_is_confirmed_with() -> None:
    """Rays are moved back by the vibration named, and adjusted again."""
    mine, solution = ctx("across", JitterSettings())
    (named,) = residual_vibrations(solution).vibrations
    residuals = residual_series(solution, 60)
    one = next(each for each in residuals.series if (each.name, each.turn) == (named.image, named.turn))
    wave = residuals.wave(one, np.array([named.frequency]), residuals.values)
    assert float(np.hypot(*wave.values)) == pytest.approx(named.amplitude)
    moved = one.waves(np.array([named.frequency])) @ wave.values
    other = adjusted_again(mine.network, residuals, one, -moved)
    assert 2.0 * (solution.cost_final - other.cost_final) == pytest.approx(wave.drop, rel=0.02)


@pytest.mark.parametrize("share", [-1.0, 0.1])
def test_what_is_taken_out_again_and_again_is_named_once(share: float, monkeypatch: pytest.MonkeyPatch) -> None:
    """Were a vibration to grow by being taken out, or to stay, the search of its series ends."""
    fitted = Residuals.wave

    def wrong(self: Residuals, one: Series, frequencies: Array, residuals: Array) -> Wave:
        wave = fitted(self, one, frequencies, residuals)
        return replace(wave, shown=share * wave.shown)

    monkeypatch.setattr(Residuals, "wave", wrong)
    found = residual_vibrations(ctx("across", JitterSettings())[1])
    named = [(one.image, one.turn) for one in found.vibrations]
    assert 0 < len(named) == len(set(named))


def test_a_pair_is_not_searched_along_its_epipolar_line(shared_data: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """LOLA's rays, of 30 px, show a roll to one part in six thousand: all mean shares of rays are above a tenth."""
    assert shared_data.is_dir()
    solution = adjust(read_case(LRO))
    section = vibrations_section(Posterior.of(solution), "LRO")
    assert not section.numbers["vibrations"]
    limits = {(one["turn"], one["named_from_px"] is None) for one in section.numbers["spectra"]}
    assert limits == {("pitch", False), ("roll", True), ("yaw", False)}
    json.dumps(section.numbers, allow_nan=False)
    monkeypatch.setattr(residual_spectrum, "BLIND", 0.0)
    searched = residual_vibrations(solution)
    assert all(one.amplitude < 5.0 for one in searched.vibrations)
    assert len(searched.vibrations) < 2


@pytest.mark.parametrize("amplitude", [0.0, 0.5])
def test_residuals_without_noise_have_finite_spectra(amplitude: float, monkeypatch: pytest.MonkeyPatch) -> None:
    residuals = residual_series(ctx()[1], 60)
    one = residuals.series[0]
    moved = amplitude * one.waves(np.array([3.0]))[:, 0]
    clean = replace(residuals, values=residuals.shown(one, moved))
    monkeypatch.setattr(residual_spectrum, "residual_series", lambda *_: clean)
    section = vibrations_section(Posterior.of(ctx()[1]), "clean")
    json.dumps(section.numbers, allow_nan=False)
    found = section.numbers["vibrations"]
    assert (len(found) > 0) == (amplitude > 0.0)
    assert not found or found[0]["amplitude_px"] == pytest.approx(amplitude, rel=0.01)


def test_control_shows_what_ties_cannot() -> None:
    mine, solution = ctx("across", JitterSettings(pitch=0.0), control=True)
    found = residual_vibrations(solution)
    (one,) = found.vibrations
    assert one.turn == "roll"
    assert one.frequency == pytest.approx(2.0, abs=0.02)
    assert one.amplitude == pytest.approx(difference(mine, 1), abs=4.0 * one.sigma + 0.1)
    assert not any("Not seen" in said for said in found.sentences)


def test_what_is_named_is_confirmed() -> None:
    """Noise that at 20 % counts by the spectrum is not named where the floor that it leaves says more."""
    found = residual_vibrations(ctx(seed=14)[1], 0.2).vibrations
    assert all(one.probability <= 0.2 for one in found)


# above two seconds: two pairs of 1200 ties, adjusted and searched
@pytest.mark.parametrize("control", [False, True])
def test_calm_pairs_show_nothing(control: bool) -> None:
    for seed in (31, 32):
        assert not residual_vibrations(ctx(control=control, seed=seed)[1]).vibrations

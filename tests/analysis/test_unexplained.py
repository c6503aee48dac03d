"""Tests of the residuals, held against Baarda's, adjustments of changed measures, draws, and planted effects."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from networks import network, pair, with_shift_and_surface
from sites import plain_site

from mgsgraph.adjustment.adjust import adjust_network
from mgsgraph.adjustment.settings import SolverSettings
from mgsgraph.analysis.linearised import at_solution
from mgsgraph.analysis.measures import MeasureKind
from mgsgraph.analysis.reliability import reliability
from mgsgraph.analysis.residual_rows import ResidualRows, residual_rows, tail
from mgsgraph.analysis.systematic import EffectKind
from mgsgraph.analysis.unexplained import unexplained
from mgsgraph.case.reading import Case, read_case
from mgsgraph.errors import InputError
from mgsgraph.geometry.body import east_north
from mgsgraph.geometry.records import Array
from mgsgraph.kernel.rows import IMAGE, RANGE
from mgsgraph.network import Network
from mgsgraph.simulation.files import write_site

PLAIN = SolverSettings(cost_tolerance=1e-14)


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
    assert alike(changed.residuals - rows.residuals, shown)


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
    assert alike(100.0 * (changed.residuals - rows.residuals)[there], rows.considered[there, 0])


def alike(found: Array, wanted: Array) -> bool:
    """Whether two vectors agree but for a hundredth, which is not linear."""
    return float(np.linalg.norm(found - wanted)) < 0.01 * float(np.linalg.norm(wanted))


def test_the_tail_of_a_quadratic_form_is_that_of_draws() -> None:
    rng = np.random.default_rng(3)
    weights = np.concatenate([rng.uniform(0.0, 2.0, 12), rng.uniform(-1.0, 0.0, 24)])
    draws = np.sort(rng.standard_normal((40_000, weights.size)) ** 2 @ weights)
    for share in (0.1, 0.01, 0.001):
        assert tail(float(draws[-int(share * draws.size)]), weights) == pytest.approx(share, rel=0.25)


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
    with pytest.raises(InputError, match="level"):
        unexplained(adjust_network(net(), PLAIN), 1.0)

"""Likelihood ratios against adjustments that hold the same unknowns, and against the ellipsoid where all is linear."""

from dataclasses import replace
from functools import cache
from statistics import NormalDist

import numpy as np
import pytest
from networks import network, pair, with_shift_and_surface
from sharing import shared

from mgsgraph.adjustment.adjust import adjust_network
from mgsgraph.adjustment.settings import SolverSettings
from mgsgraph.adjustment.solution import Solution
from mgsgraph.analysis.likelihood import LEVELS, Likelihood, linearity_of
from mgsgraph.analysis.linearised import at_solution
from mgsgraph.analysis.posterior import Posterior
from mgsgraph.errors import InputError
from mgsgraph.network import Network, SharedKind

EXACT = SolverSettings(cost_tolerance=1e-15, step_tolerance=1e-9)


@cache
def net() -> Network:
    """The pair, its profile and terrain model of unknown shift, and a bias of its ranges."""
    found = with_shift_and_surface(network(pair()))
    return replace(found, shared=(shared(SharedKind.RANGE_BIAS, np.unique(found.ranges.image).tolist()),))


@cache
def solved() -> Solution:
    return adjust_network(net(), EXACT)


@cache
def likelihood() -> Likelihood:
    return Likelihood(at_solution(solved()))


def test_an_image_held_at_its_nominal_orientation() -> None:
    """Twice the cost of an adjustment that holds it, less that of one that doesn't; a shift and a bias held beside it
    cost more.
    """
    name, zeros = net().images[0].name, np.zeros_like(solved().coefficients[0])
    held = adjust_network(replace(net(), held=np.array([True, False])), EXACT)
    found = likelihood().ratio({name: zeros})
    assert found.degrees == zeros.size
    rise = held.cost_final - solved().cost_final
    assert found.squares == pytest.approx(2.0 * rise, abs=2e-4)  # lines are exact to 1e-5
    more = likelihood().ratio({name: zeros, "profile": np.zeros(2), "range bias": np.zeros(1)})
    assert more.degrees == zeros.size + 3
    assert more.squares > found.squares + 1e-3


def test_near_the_optimum_it_is_the_ellipsoids() -> None:
    """Of all unknowns, of some with the others free (whose marginal covariance counts), and of none."""
    solution, rng = solved(), np.random.default_rng(1)
    names = {image.name: (j, solution.coefficients[j]) for j, image in enumerate(net().images)}
    names |= {"profile": (2, solution.shifts[0]), "terrain model": (3, solution.shifts[1])}
    names["range bias"] = 4, solution.shared[0]
    for chosen in (list(names), list(names)[1:3], list(names)[4:]):
        covariance = solution.joint_covariance.of([names[name][0] for name in chosen])
        move = 0.1 * np.linalg.cholesky(covariance) @ rng.standard_normal(covariance.shape[0])
        parts = np.split(move, np.cumsum([names[name][1].size for name in chosen])[:-1])
        values = {name: names[name][1].ravel() + part for name, part in zip(chosen, parts, strict=True)}
        found = likelihood().ratio(values)
        assert found.squares == pytest.approx(move @ np.linalg.solve(covariance, move), rel=2e-2)
        assert 0.9 < found.p <= 1.0
    assert likelihood().ratio({}).squares == pytest.approx(0.0, abs=1e-9)


def test_profiles_are_the_ellipsoids_where_all_is_linear_and_end_where_the_ratio_says() -> None:
    (found,) = likelihood().profiles(net().images[1].name, "constant radial position")
    for level, (low, high) in zip(LEVELS, found.intervals, strict=True):
        wide = 2.0 * NormalDist().inv_cdf(0.5 + 0.5 * level) * found.sigma
        assert high - low == pytest.approx(wide, rel=0.02)
    assert found.ratio == pytest.approx(1.0, abs=0.02)
    (shift,) = likelihood().profiles("range bias")
    for level, ends in zip(LEVELS, shift.intervals, strict=True):
        for end in ends:
            square = likelihood().ratio({"range bias": np.array([end])}).squares
            assert np.sqrt(square) == pytest.approx(NormalDist().inv_cdf(0.5 + 0.5 * level), abs=2e-3)


def test_wide_priors_are_not_linear_and_narrow_ones_are() -> None:
    assert solved().linearity is not None
    assert solved().linearity.linear
    free = network(pair())
    priors = tuple(replace(prior, sigmas=100.0 * prior.sigmas) for prior in free.priors)
    wide = adjust_network(replace(free, priors=priors), SolverSettings())
    assert wide.linearity is not None
    assert not wide.linearity.linear
    assert wide.linearity.ratio > 2.0
    again = linearity_of(at_solution(wide))
    assert again is not None
    assert again.ratio == pytest.approx(wide.linearity.ratio, rel=1e-6)


def test_a_considered_unknown_is_held_in_the_draws_and_has_no_likelihood() -> None:
    found = adjust_network(replace(net(), considered=("profile",)), SolverSettings())
    assert found.linearity is not None
    assert found.linearity.linear
    with pytest.raises(InputError, match="'profile'"):
        _ = Posterior.of(found).likelihood


def test_robust_losses_and_held_networks_say_nothing() -> None:
    assert adjust_network(net(), SolverSettings(loss="huber")).linearity is None
    assert adjust_network(network(pair(), (True, True)), SolverSettings()).linearity is None


@pytest.mark.parametrize(
    ("values", "says"), [({"nobody": np.zeros(3)}, "nobody"), ({"profile": np.zeros(3)}, "3 values"),
                         ({"profile": np.array([np.nan, 0.0])}, "2 finite numbers")],
)  # fmt: skip
def test_what_nothing_is_known_of_is_refused(values: dict[str, np.ndarray], says: str) -> None:
    with pytest.raises(InputError, match=says):
        likelihood().ratio(values)

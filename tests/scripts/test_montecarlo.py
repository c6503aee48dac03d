"""The Monte-Carlo proof: its statistics against outside authorities, its questions against truth, faults that show."""

import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import binom

SCRIPTS = Path(__file__).resolve().parents[2] / "scripts"
if not SCRIPTS.is_dir():
    pytest.skip("the scripts are not beside the tests", allow_module_level=True)
sys.path.append(str(SCRIPTS))

import montecarlo as draw  # noqa: E402
import montecarlo_judge as judge  # noqa: E402
import study  # noqa: E402
from redraw import Draw, redraw  # noqa: E402

from mgsgraph.adjustment.adjust import adjust_network  # noqa: E402
from mgsgraph.analysis.posterior import Posterior  # noqa: E402
from mgsgraph.geometry.orientation import OrientationCorrection  # noqa: E402

DIMENSIONS = [(kind, len(components)) for kind, components in judge.KINDS.items()]


def synthetic(seeds: int, items: int = 10, scale: float = 1.0, case: str = "block") -> list[study.Draw]:
    """Errors that are standard normal, but for a scale; half of their variance is common to the seed's items."""
    found = []
    for seed in range(seeds):
        rng = np.random.default_rng([seed, 7])
        errors = {
            kind: scale * (rng.standard_normal((1, d)) + rng.standard_normal((items, d))) / np.sqrt(2.0)
            for kind, d in DIMENSIONS
        }
        squares = {kind: np.sum(error**2, axis=1) for kind, error in errors.items()}
        found.append({"case": case, "seed": seed, "converged": True, "squares": squares, "errors": errors})
    return found


def of_seed(case: str, seed: int) -> study.Draw:
    return {"case": case, "seed": seed} | draw.one_seed(case, seed)


def outside(draws: list[study.Draw]) -> list[str]:
    return [text for kind in judge.KINDS for text in judge.judged(draws[0]["case"], kind, draws).outside]


# --- statistics


@pytest.mark.parametrize("level", judge.LEVELS)
@pytest.mark.parametrize("seeds", [2, 20, 200])
def test_binomial_limits_are_the_narrowest_that_hold(seeds: int, level: float) -> None:
    trials = binom(seeds, level)
    low, high = judge.binomial_limits(seeds, level)
    assert trials.cdf(low - 1) <= 0.005 < trials.cdf(low)
    assert trials.sf(high) <= 0.005 < trials.sf(high - 1)


def strain(draws: list[study.Draw]) -> float:
    """Of the whole case, as a share of its limit."""
    kinds = [judge.judged(draws[0]["case"], kind, draws) for kind in judge.KINDS]
    return max(one.strain for one in kinds) / judge.breaking_strain(len(draws))


def test_an_honest_posterior_is_called_so() -> None:
    assert strain(synthetic(200)) < 1.0


@pytest.mark.parametrize(("scale", "words"), [(1.25, "too small"), (0.8, "too large")])
def test_wrong_sigmas_break_limits_in_the_right_direction(scale: float, words: str) -> None:
    found = outside(synthetic(200, scale=scale))
    assert len(found) > 20
    assert strain(synthetic(200, scale=scale)) > 1.0
    assert all(words in text for text in found if "biased" not in text)


def test_a_bias_is_told_by_its_component() -> None:
    draws = synthetic(200)
    for one in draws:
        one["errors"]["projection"][:, 1] += 0.5
    found = judge.judged("block", "projection", draws)
    assert found.outside == ["biased (sample)"]
    assert found.strain > judge.breaking_strain(200)


def test_few_seeds_that_are_all_inside_are_no_alarm() -> None:
    draws = synthetic(5, scale=0.5)
    assert all(one["squares"]["footprint"].max() < 11.0 for one in draws)
    found = judge.judged("block", "footprint", draws)
    assert abs(found.share[2] - 0.99) < found.band[2]


# --- questions


@pytest.fixture
def small_block(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    monkeypatch.setattr(draw, "BLOCK", replace(draw.BLOCK, images=3, ties=40, shots=12))
    draw.prepared.cache_clear()
    yield
    draw.prepared.cache_clear()


@pytest.mark.usefixtures("small_block")
def test_without_noise_the_answers_are_the_truth(monkeypatch: pytest.MonkeyPatch) -> None:
    """Each answer's error is then far below its sigma: truth and estimate speak of the same thing."""

    real = np.random.default_rng

    class Silent:
        def standard_normal(self, shape: int | tuple[int, ...] = ()) -> np.ndarray:
            return np.zeros(shape)

        def __getattr__(self, name: str) -> object:
            return getattr(real(1), name)

    draw.prepared("block")
    # the adjustment's own draws, of seed 0, are about its linearity
    monkeypatch.setattr(np.random, "default_rng", lambda seed: real(0) if seed == 0 else Silent())
    found = of_seed("block", 1)
    assert found["errors"].keys() == judge.KINDS.keys()
    for kind, errors in found["errors"].items():
        assert np.abs(errors).max() < 1e-3, kind


@pytest.mark.usefixtures("small_block")
def test_truth_that_equals_the_estimate_is_no_error_and_moved_truth_is() -> None:
    """Orientation corrections other than none: truth is the nominal orientation (+) the true ones."""
    network, settings = draw.prepared("block")
    solution = adjust_network(redraw(network, np.random.default_rng(0)).network, settings)
    corrections = tuple(solution.correction(j) for j in range(len(network.images)))
    fake = Draw(solution.network, corrections, solution.shifts, solution.places)
    posterior = Posterior.of(solution)
    found = draw.questions(posterior, fake, 1.0, np.random.default_rng(0))
    for kind in judge.KINDS.keys() - {"new place"}:  # which has noise of its own
        for error, covariance in found[kind]:
            assert np.all(np.abs(error) < 1e-4 * np.sqrt(np.diag(covariance))), kind
    moved = corrections[0].coefficients.copy()
    moved[0] += [3.0, 4.0, 12.0, 1e-5, 2e-5, 2e-5]
    other = replace(fake, corrections=(OrientationCorrection(moved), *corrections[1:]))
    positions, pointings = draw.poses(posterior, other)
    for k in range(draw.LINES):
        assert np.linalg.norm(positions[k][0]) == pytest.approx(13.0)
        assert np.linalg.norm(pointings[k][0]) == pytest.approx(3e-5, rel=1e-3)


@pytest.mark.usefixtures("small_block")
def test_the_same_seed_gives_the_same_and_others_differ() -> None:
    one, again, other = (of_seed("block", seed) for seed in (3, 3, 4))
    for kind in judge.KINDS:
        np.testing.assert_array_equal(one["squares"][kind], again["squares"][kind])
        assert one["squares"][kind] != other["squares"][kind]


@pytest.mark.slow
@pytest.mark.usefixtures("small_block")
def test_a_gross_fault_shows_in_few_seeds_and_honesty_does_not(monkeypatch: pytest.MonkeyPatch) -> None:
    """Sigmas of all measures told a third of what they are."""
    honest = [of_seed("block", seed) for seed in range(8)]
    monkeypatch.setitem(draw.CASES, "block, planted", replace(draw.CASES["block, planted"], stated=1.0 / 3.0))
    faulty = [of_seed("block, planted", seed) for seed in range(8)]
    assert strain(honest) < 1.0 < strain(faulty)
    told = outside(faulty)
    assert len(told) > 12
    assert all("too small" in text for text in told if "biased" not in text)


def test_priors_are_scaled_and_the_terrain_is_left_out() -> None:
    whole, half = (draw.prepared(name)[0] for name in ("eos", "eos, half priors"))
    assert whole.surface is None
    for one, other in zip(whole.priors, half.priors, strict=True):
        np.testing.assert_allclose(other.sigmas, 0.5 * one.sigmas)


def test_the_tables_name_every_kind_and_case() -> None:
    blocks = judge.judge([*synthetic(4), *synthetic(4, scale=2.0, case="block, planted")])
    assert [line.split(" | ")[0] for line in blocks["summary"][2:]] == ["| block", "| block, planted"]
    assert [line for line in blocks["cases"] if line.startswith("#")] == ["## Block", "## Block, planted"]
    assert all(f"| {kind} | {d} | 10 |" in "\n".join(blocks["cases"]) for kind, d in DIMENSIONS)

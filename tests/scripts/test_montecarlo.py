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

import montecarlo  # noqa: E402
import montecarlo_draw as draw  # noqa: E402
import montecarlo_judge as judge  # noqa: E402
import montecarlo_page  # noqa: E402
from redraw import Draw, redraw  # noqa: E402

from mgsgraph.adjustment.adjust import adjust_network  # noqa: E402
from mgsgraph.analysis.posterior import Posterior  # noqa: E402
from mgsgraph.errors import InputError  # noqa: E402
from mgsgraph.geometry.orientation import OrientationCorrection  # noqa: E402

DIMENSIONS = [(kind, len(components)) for kind, components in draw.KINDS.items()]


def synthetic(seeds: int, items: int = 10, scale: float = 1.0, case: str = "block") -> list[draw.Drawn]:
    """Errors that are standard normal, but for a scale; half of their variance is common to the seed's items."""
    found = []
    for seed in range(seeds):
        rng = np.random.default_rng([seed, 7])
        errors = {
            kind: scale * (rng.standard_normal((1, d)) + rng.standard_normal((items, d))) / np.sqrt(2.0)
            for kind, d in DIMENSIONS
        }
        squares = {kind: np.sum(error**2, axis=1) for kind, error in errors.items()}
        found.append(draw.Drawn(draw.Order(case, seed), True, squares, errors))
    return found


def outside(draws: list[draw.Drawn]) -> list[str]:
    return [text for kind in draw.KINDS for text in judge.judged(draws[0].order.case, kind, draws).outside]


# --- statistics


@pytest.mark.parametrize("level", judge.LEVELS)
@pytest.mark.parametrize("seeds", [2, 20, 200])
def test_binomial_limits_are_the_narrowest_that_hold(seeds: int, level: float) -> None:
    trials = binom(seeds, level)
    low, high = judge.binomial_limits(seeds, level)
    assert trials.cdf(low - 1) <= 0.005 < trials.cdf(low)
    assert trials.sf(high) <= 0.005 < trials.sf(high - 1)


def strain(draws: list[draw.Drawn]) -> float:
    """Of the whole case, as a share of its limit."""
    kinds = [judge.judged(draws[0].order.case, kind, draws) for kind in draw.KINDS]
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
        one.errors["projection"][:, 1] += 0.5
    found = judge.judged("block", "projection", draws)
    assert found.outside == ["biased (sample)"]
    assert found.strain > judge.breaking_strain(200)


def test_few_seeds_that_are_all_inside_are_no_alarm() -> None:
    draws = synthetic(5, scale=0.5)
    assert all(one.squares["footprint"].max() < 11.0 for one in draws)
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
    found = draw.one_seed(draw.Order("block", 1))
    assert found.errors.keys() == draw.KINDS.keys()
    for kind, errors in found.errors.items():
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
    for kind in draw.KINDS.keys() - {"new place"}:  # which has noise of its own
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
    one, again, other = (draw.one_seed(draw.Order("block", seed)) for seed in (3, 3, 4))
    for kind in draw.KINDS:
        np.testing.assert_array_equal(one.squares[kind], again.squares[kind])
        assert not np.array_equal(one.squares[kind], other.squares[kind])


@pytest.mark.slow
@pytest.mark.usefixtures("small_block")
def test_a_gross_fault_shows_in_few_seeds_and_honesty_does_not(monkeypatch: pytest.MonkeyPatch) -> None:
    """Sigmas of all measures told a third of what they are."""
    honest = [draw.one_seed(draw.Order("block", seed)) for seed in range(8)]
    monkeypatch.setitem(draw.CASES, "block, planted", replace(draw.CASES["block, planted"], stated=1.0 / 3.0))
    faulty = [draw.one_seed(draw.Order("block, planted", seed)) for seed in range(8)]
    assert strain(honest) < 1.0 < strain(faulty)
    told = outside(faulty)
    assert len(told) > 12
    assert all("too small" in text for text in told if "biased" not in text)


def test_priors_are_scaled_and_the_terrain_is_left_out() -> None:
    whole, half = (draw.prepared(name)[0] for name in ("eos", "eos, half priors"))
    assert whole.surface is None
    for one, other in zip(whole.priors, half.priors, strict=True):
        np.testing.assert_allclose(other.sigmas, 0.5 * one.sigmas)


def test_every_case_has_a_title_and_is_chosen_once() -> None:
    assert montecarlo_page.TITLES.keys() == draw.CASES.keys()
    assert sorted(montecarlo.CHOICES["three-sites"] + montecarlo.CHOICES["block"]) == sorted(draw.CASES)


# --- command


def few(monkeypatch: pytest.MonkeyPatch, drawing: bool = False) -> list[draw.Order]:
    """Draws that cost nothing; the orders that were asked for."""
    asked: list[draw.Order] = []
    ready = {case: {one.order.seed: one for one in synthetic(5, case=case)} for case in draw.CASES}

    def one_seed(order: draw.Order) -> draw.Drawn:
        asked.append(order)
        return ready[order.case][order.seed]

    monkeypatch.setattr(montecarlo, "one_seed", one_seed)
    if not drawing:
        monkeypatch.setattr(montecarlo, "figure", lambda drawn: None)
        monkeypatch.setattr(montecarlo, "write_figure", lambda figure, path: None)
    return asked


def test_the_command_writes_page_and_figure(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    few(monkeypatch, drawing=True)
    assert montecarlo.run(["--case", "both", "--seeds", "4", "--out", str(tmp_path)]) == 0
    text = (tmp_path / "montecarlo.md").read_text(encoding="utf-8")
    for case in draw.CASES:
        assert f"## {montecarlo_page.TITLES[case]}" in text
    assert all(f"| {kind} | {d} | 10 |" in text for kind, d in DIMENSIONS)
    assert (tmp_path / "montecarlo.png").read_bytes().startswith(b"\x89PNG")
    assert "Written to" in capsys.readouterr().out


def test_kept_seeds_are_not_done_again_and_give_the_same_page(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    asked = few(monkeypatch)
    keep = tmp_path / "keep.jsonl"
    common = ["--case", "block", "--out", str(tmp_path), "--keep", str(keep)]
    assert montecarlo.run([*common, "--seeds", "3"]) == 0
    page = (tmp_path / "montecarlo.md").read_text(encoding="utf-8")
    assert montecarlo.run([*common, "--seeds", "3"]) == 0
    assert (tmp_path / "montecarlo.md").read_text(encoding="utf-8") == page
    assert len(asked) == 6
    assert montecarlo.run([*common, "--seeds", "5"]) == 0
    assert [order.seed for order in asked[6:]] == [3, 4, 3, 4]
    monkeypatch.setattr(montecarlo, "POINTS", 99)
    assert montecarlo.run([*common, "--seeds", "3"]) == 0
    assert len(asked) == 16, "of another recipe"


def test_a_crash_s_cut_line_is_done_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    asked, keep = few(monkeypatch), tmp_path / "keep.jsonl"
    common = ["--case", "block", "--out", str(tmp_path), "--keep", str(keep), "--seeds", "2"]
    assert montecarlo.run(common) == 0
    keep.write_bytes(keep.read_bytes()[:-40])
    assert montecarlo.run(common) == 0
    assert len(asked) == 5
    assert montecarlo.run(common) == 0
    assert len(asked) == 5


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (["--seeds", "1"], "at least 2"),
        (["--case", "venus"], "venus"),
        (["--processes", "2", "--cluster", "local"], "not allowed with"),
        (["--cluster", "nowhere"], "no place for the work"),
        (["--keep", "{here}/readme"], "not a kept seed"),
        (["--out", "{here}/readme"], "can't be written"),
    ],
)
def test_bad_input_is_told_in_one_line(
    arguments: list[str], told: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "readme").write_text("no seed\n", encoding="utf-8")
    given = [text.format(here=tmp_path) for text in arguments]
    if "--out" not in given:
        given += ["--out", str(tmp_path)]
    try:
        code = montecarlo.run(given)
    except SystemExit as error:
        code = int(error.code or 0)
    assert code == 2
    said = capsys.readouterr().err.strip()
    assert told in said
    assert len(said.splitlines()) == 1


def test_a_seed_survives_being_kept() -> None:
    one = synthetic(1)[0]
    again = montecarlo.from_line(montecarlo.as_line(one) + "\n", "here")
    assert again is not None
    assert again.order == one.order
    for kind in draw.KINDS:
        np.testing.assert_allclose(again.squares[kind], one.squares[kind], atol=1e-5)
        np.testing.assert_allclose(again.errors[kind], one.errors[kind], atol=1e-5)
    with pytest.raises(InputError, match="not a kept seed"):
        montecarlo.from_line("{}\n", "here")

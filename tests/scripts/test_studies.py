"""Studies: their harness (draws that are kept, made parts of pages, bands), the Monte-Carlo proof against outside
authorities and planted faults, errors of sites and the NEES of drawn networks within their bands.
"""

import json
import re
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from scipy.linalg import block_diag
from scipy.stats import binom

from mgsgraph.adjustment.adjust import adjust_network
from mgsgraph.analysis.posterior import Posterior
from mgsgraph.geometry.orientation import OrientationCorrection
from mgsgraph.simulation.ground import (
    SITES,
    PeriodicSurface,
    SiteTerrain,
)
from mgsgraph.simulation.orbit import MARS
from mgsgraph.simulation.sites import SITE_NAMES

SCRIPTS = Path(__file__).resolve().parents[2] / "scripts"
if not SCRIPTS.is_dir():
    pytest.skip("the scripts are not beside the tests", allow_module_level=True)
sys.path.append(str(SCRIPTS))

import fair_draws  # noqa: E402
import montecarlo as draw  # noqa: E402
import montecarlo_judge as judge  # noqa: E402
import nees  # noqa: E402
import neighbors  # noqa: E402
import process_strengths  # noqa: E402
import study  # noqa: E402
import vibrations  # noqa: E402
from outside import refuses  # noqa: E402
from redraw import Draw, redraw  # noqa: E402
from study import chi_square_band, nees_band  # noqa: E402

STUDIES = ("eos", "eos, terrain", "gusev")
PAGE = "evidence_consistency.md#fair_draws"


class Asked:
    """A study whose draws cost nothing; the orders that were made."""

    def __init__(self) -> None:
        self.orders: list[tuple[str, int]] = []

    def one(self, case: str, seed: int) -> study.Draw:
        self.orders.append((case, seed))
        return {"value": seed + 0.5}

    def __call__(self, *given: str | Path) -> int:
        parser = study.seeds_of("A study.", STUDIES, 5, PAGE)
        return study.run(parser, self.one, lambda every: {"errors": [json.dumps(every)]}, [str(one) for one in given])


@pytest.fixture
def asked() -> Asked:
    return Asked()


def test_a_page_keeps_its_words_and_gets_new_tables(
    asked: Asked, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    page = tmp_path / "page.md"
    assert asked("--cases", "gusev", "--seeds", "2", "--first", "7", "--out", page) == 0
    assert asked.orders == [("gusev", 7), ("gusev", 8)]
    text, before = page.read_text(encoding="utf-8"), study.default(PAGE).read_text(encoding="utf-8")
    assert text.startswith(before.partition("<!-- made")[0])
    assert '"value": 7.5' in text
    assert "| kernels, X 0 |" not in text
    others = "<!-- made: nees by -->"  # the other studies of the page stay as they were
    assert text.partition(others)[2] == before.partition(others)[2] != ""
    assert '"value": 7.5' in capsys.readouterr().out
    refuses("no marks of the made part 'none'", study.filled, PAGE, {"none": []})


@pytest.mark.parametrize("page", sorted(study.DOCS.glob("*.md")), ids=lambda page: page.stem)
def test_marks_of_made_parts_come_in_pairs(page: Path) -> None:
    marks = re.findall(r"<!-- (?:made: (.+)|end) -->", page.read_text(encoding="utf-8"))
    assert not any(marks[1::2])
    parts = [tuple(mark.split()) for mark in marks[::2]]
    assert len(set(parts)) == len(parts)
    assert {study for study, _ in parts} == {study for study, name in parts if name == "by"}


def test_kept_draws_are_not_made_again(asked: Asked, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    keep = tmp_path / "keep.jsonl"
    common = ("--cases", "gusev", "--out", tmp_path / "a.md", "--keep", keep)
    assert asked(*common, "--seeds", "3") == 0
    page = (tmp_path / "a.md").read_text(encoding="utf-8")
    assert asked(*common, "--seeds", "3") == 0
    assert (tmp_path / "a.md").read_text(encoding="utf-8") == page
    assert len(asked.orders) == 3
    keep.write_bytes(keep.read_bytes()[:-20])  # a crash cuts the last line short
    assert asked(*common, "--seeds", "4") == 0
    assert asked.orders[3:] == [("gusev", 3), ("gusev", 4)]
    monkeypatch.setattr(study, "commit", lambda: "another")
    assert asked(*common, "--seeds", "3") == 0
    assert len(asked.orders) == 8


def test_bands_are_those_of_tables() -> None:
    low, high = study.chi_square_band(100)
    assert abs(100.0 * low - 67.328) < 0.001  # chi-square, 100 degrees: 0.005 and 0.995 quantiles
    assert abs(100.0 * high - 140.169) < 0.001
    assert abs(study.student(0.01, 9) - 3.250) < 0.001
    assert abs(study.student(0.01, 99) - 2.626) < 0.001
    assert study.nees_band([1.0] * 5, 20) == study.chi_square_band(100)
    values = np.random.default_rng(1).normal(1.0, 0.1, 10).tolist()
    half = 3.2498 * float(np.std(values, ddof=1)) / np.sqrt(10)
    assert study.nees_band(values) == pytest.approx((1.0 - half, 1.0 + half), rel=1e-4)


def test_items_that_err_alike_count_once() -> None:
    rng = np.random.default_rng(47)
    own = np.stack([one @ one.T for one in rng.standard_normal((6, 2, 2))])
    assert study.joint_degrees(block_diag(*own), 2) == pytest.approx(12.0)
    assert study.joint_degrees(np.tile(own[0], (6, 6)) + 1e-9 * np.eye(12), 2) == pytest.approx(2.0, rel=1e-6)
    # field/README.md: two profiles whose shifts are correlated by 0.97, 18 draws: 0.52 .. 1.69
    alike = np.kron([[1.0, 0.97], [0.97, 1.0]], np.eye(2))
    assert study.nees_band([1.0] * 18, study.joint_degrees(alike, 2)) == pytest.approx((0.52, 1.69), abs=0.02)
    # the scatter of the sum of normalised squares, drawn
    root = rng.standard_normal((12, 4))
    covariance = root @ root.T + block_diag(*own)
    errors = rng.multivariate_normal(np.zeros(12), covariance, 40_000).reshape(-1, 6, 2)
    blocks = covariance.reshape(6, 2, 6, 2)[np.arange(6), :, np.arange(6)]
    squares = np.einsum("nia,iab,nib->n", errors, np.linalg.inv(blocks), errors)
    assert 2.0 * 12.0**2 / squares.var() == pytest.approx(study.joint_degrees(covariance, 2), rel=0.05)


@pytest.mark.parametrize(
    ("of", "case"),
    [(neighbors, "gusev, model"), (process_strengths, "CTX pair, 1"), (vibrations, "1 px, 2 Hz, drift 3 px")],
)
def test_tables_are_made_of_draws(of: ModuleType, case: str) -> None:
    rng, draws = np.random.default_rng(3), list[study.Draw]()
    for seed in range(6):
        some = [1.0 + 0.1 * one for one in rng.standard_normal(4)]
        draws.append({
            "case": case, "seed": seed, "seconds": 1.0, "groups": 3, "values": dict.fromkeys(neighbors.FORMS, some),
            "ratios": some, "errors": some, "seen": [True] * 4, "below": [True] * 4, "nodes": some[:2],
            "points": some[2] if of is vibrations else some[:2], "pitch": some[0], "roll": some[1], "converged": True,
            "found": True, "false": 0, "amplitude": [[1.0, 0.1, some[3]]], "frequency": [some[0]],
        })  # fmt: skip
    printed = str(list(of.judge(draws).values()))
    cells = re.findall(r"\(([\d.]+) \.\. ([\d.]+)\)", printed)
    assert len(cells) >= 3
    assert all(float(low) < 1.0 < float(high) for low, high in cells)


def test_degrees_of_points_are_those_of_their_joint_covariance() -> None:
    network, settings = nees.prepared("isidis, no-terrain")
    solution = adjust_network(network, settings)
    points = np.flatnonzero(solution.determined)[::3]
    posterior = Posterior.of(solution)
    joint = posterior.covariance([posterior.of_point(i) for i in points.tolist()])
    found = study.degrees_of_points(solution, points)
    assert found == pytest.approx(study.joint_degrees(joint, 3), rel=1e-6)
    assert 3.0 < found < 0.9 * 3 * points.size


# --- the Monte-Carlo proof


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
@pytest.mark.parametrize("seeds", [2, 200])
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


# --- errors of sites have the sigmas that their cases state


SEEDS = range(301, 307)


def smooth(name: str) -> SiteTerrain:
    ground, flat = SITES[name], PeriodicSurface(1000.0, np.zeros((1, 1), dtype=np.float32))
    return SiteTerrain(name, 1, MARS, ground.longitude, ground.latitude, ground, np.zeros((0, 4)), flat, flat, flat)


@pytest.mark.parametrize("name", SITE_NAMES)
def test_every_kind_of_error_has_its_stated_sigma(name: str) -> None:
    """Coefficients of the same power of the line together."""
    together: dict[str, list[tuple[float, int]]] = {}
    for seed in SEEDS:
        for kind, one in fair_draws.one_draw(name, seed, smooth(name))["squares"].items():
            together.setdefault(f"power {kind[-1]}" if "kernels" in kind else kind, []).append(one)
    assert len(together) == 3 + 7
    for kind, parts in together.items():
        squares, count = map(sum, zip(*parts, strict=True))
        low, high = chi_square_band(count)
        assert low < squares / count < high, kind


def test_published_errors_are_not_drawn_from_them(monkeypatch: pytest.MonkeyPatch) -> None:
    """They have no quadratic terms."""
    monkeypatch.setattr(fair_draws, "OPTIONS", replace(fair_draws.OPTIONS, errors="published"))
    found = fair_draws.one_draw("gusev", 301, smooth("gusev"))["squares"]
    assert max(found[f"kernels, {axis} 2"][0] for axis in fair_draws.AXES) < 0.01


# --- the NEES of drawn networks


@pytest.mark.parametrize(
    ("case", "absent"),
    [
        ("isidis, no-terrain", ["passes"]),
        ("HRSC strip, passes", ["orientation", "shifts", "likelihood ratio", "laser"]),
        ("NAC pair, rig", ["orientation"]),
    ],
)
def test_normalized_errors_lie_in_their_bands(case: str, absent: list[str]) -> None:
    every = [nees.one_draw(case, seed) for seed in range(20)]  # 2 s: fewer draws have bands that hold anything
    assert all(draw["converged"] for draw in every)
    values = np.array([draw["values"] for draw in every])
    there = [k for k, name in enumerate(nees.COLUMNS) if name not in absent]
    assert [name for name, column in zip(nees.COLUMNS, values.T, strict=True) if np.isnan(column).all()] == absent
    for k in there:
        low, high = nees_band(values[:, k].tolist(), [draw["degrees"][k] for draw in every])
        assert low < np.mean(values[:, k]) < high
    means = values[:, there].mean(axis=0)
    assert means.min() > 0.5  # bands of points scale with what they judge
    assert means.max() < 1.8
    assert "**outside**" not in nees.row(case, every)

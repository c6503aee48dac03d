"""Ratios and limits: what a run is held to, and the committed baseline that it is held against.

A baseline holds ratios, counts and relative differences, never seconds: those belong to the machine.
"""

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from statistics import median
from typing import Any

from study import write_json

from mgsgraph.errors import InputError

BASELINE = Path(__file__).with_name("baseline.json")
OURS = "mgsgraph"
VARIANTS = {
    "plain": ("--cost", "auto", "--layout", "plain", "--radius", "1e4"),
    "analytic": ("--cost", "analytic", "--layout", "fused", "--radius", "1e16"),
    "custom": ("--solver", "custom_gn", "--cov", "schur"),
}
"""Ceres as one writes it first; Ceres at its best here (README of the peer); hand-written Gauss-Newton in C++, which
computes all point covariances as well."""
Runs = Mapping[str, Sequence[Mapping[str, Any]]]
"""Figures of each program, ours and the peer's variants, one of each repeat."""


@dataclass(frozen=True, slots=True)
class Ratio:
    """How many times longer the peer takes."""

    value: float
    """of the medians."""
    least: float
    """of the repeats, each with its own neighbours in time."""
    most: float
    """the same."""

    def __str__(self) -> str:
        return f"{self.value:.2f} ({self.least:.2f} .. {self.most:.2f})"


def middle(runs: Sequence[Mapping[str, Any]], key: str) -> float:
    """Median over the repeats; NaN where the figure isn't there."""
    values = [float(run[key]) for run in runs if key in run]
    return median(values) if values else math.nan


def ratio(runs: Runs, variant: str, key: str) -> Ratio | None:
    """Peer's seconds over ours; None where one of them has no such figure."""
    pairs = [
        (float(theirs[key]), float(ours[key]))
        for theirs, ours in zip(runs.get(variant, ()), runs[OURS], strict=False)
        if key in theirs and key in ours
    ]
    if not pairs or not all(ours > 0.0 for _, ours in pairs):
        return None
    single = [theirs / ours for theirs, ours in pairs]
    return Ratio(middle(runs[variant], key) / middle(runs[OURS], key), min(single), max(single))


def cost_difference(runs: Runs) -> float:
    """Largest relative difference of our final cost from one of the peer's; NaN without the peer."""
    peers = [middle(runs[variant], "cost_final") for variant in VARIANTS if runs.get(variant)]
    ours = middle(runs[OURS], "cost_final")
    return max((abs(ours - one) / one for one in peers), default=math.nan)


def metrics(size: str, runs: Runs) -> dict[str, float]:
    """Everything of one size that a baseline may hold a run to, by name."""
    found = {
        f"{size}: iterations": middle(runs[OURS], "iterations"),
        f"{size}: bytes per observation": middle(runs[OURS], "bytes_per_observation"),
        f"{size}: share that converged": sum(bool(run["converged"]) for run in runs[OURS]) / len(runs[OURS]),
    }
    solves = {variant: ratio(runs, variant, "seconds_solve") for variant in VARIANTS}
    found |= {f"{size}: solve, {variant} / {OURS}": one.value for variant, one in solves.items() if one}
    if any(solves.values()):
        found[f"{size}: solve, best / {OURS}"] = min(one.value for one in solves.values() if one)
        found[f"{size}: cost, relative difference"] = cost_difference(runs)
    if covariance := ratio(runs, "custom", "seconds_covariance"):
        found[f"{size}: covariance, custom / {OURS}"] = covariance.value
    return found


# --- the baseline


@dataclass(frozen=True, slots=True)
class Limit:
    """What one figure is held to."""

    direction: str
    """higher: higher is better; lower: lower is."""
    required: float | None = None
    """The issue's own demand; no tolerance."""
    value: float | None = None
    """What was reached when the baseline was made."""
    tolerance: float = 0.25
    """Share of `value` by which a figure may be worse: times scatter on shared machines."""

    def bound(self) -> float:
        """The worst that passes."""
        sign = 1.0 if self.direction == "lower" else -1.0
        reached = [] if self.value is None else [self.value * (1.0 + sign * self.tolerance)]
        bounds = reached + ([] if self.required is None else [self.required])
        return min(bounds) if self.direction == "lower" else max(bounds)

    def holds(self, figure: float) -> bool:
        """Whether a figure passes; NaN doesn't."""
        return figure <= self.bound() if self.direction == "lower" else figure >= self.bound()


def read_baseline(path: Path) -> dict[str, Limit]:
    """Limits by name of figure; InputError for a file that isn't a baseline."""
    try:
        lines = json.loads(path.read_text(encoding="utf-8"))["metrics"]
        limits = {str(name): Limit(**line) for name, line in lines.items()}
    except OSError as error:
        raise InputError(str(path), f"can't be read ({error.strerror or error})", "a baseline") from None
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise InputError(str(path), f"no baseline ({' '.join(str(error).split())[:100]})") from None
    for name, limit in limits.items():
        numbers = [one for one in (limit.required, limit.value, limit.tolerance) if one is not None]
        fine = all(isinstance(one, int | float) and math.isfinite(one) for one in numbers)
        if limit.direction not in ("higher", "lower") or not fine or len(numbers) < 2:
            expected = "a direction, higher or lower, and a finite number required or reached"
            raise InputError(f"{path}, {name}", f"{line_of(limit)}", expected)
    return limits


def line_of(limit: Limit) -> dict[str, Any]:
    """A limit as the file holds it."""
    whole = {"direction": limit.direction, "required": limit.required, "value": limit.value}
    return {key: one for key, one in whole.items() if one is not None} | {"tolerance": limit.tolerance}


def judged(limits: Mapping[str, Limit], found: Mapping[str, float], sizes: Sequence[str]) -> list[str]:
    """Sentences, one for each figure of these sizes that fails; InputError where one wasn't measured."""
    mine = {name: limit for name, limit in limits.items() if name.split(":")[0] in sizes}
    if not mine:
        raise InputError("gate", f"no line of the baseline for {', '.join(sizes)}", "a size that it holds")
    for name in [one for one in mine if one not in found][:1]:
        raise InputError(f"gate, {name}", "not measured", "the peer in the same run", "name it with --peer")
    return [
        f"FAILED {name}: {found[name]:.4g}, at {'most' if limit.direction == 'lower' else 'least'} {limit.bound():.4g}"
        for name, limit in mine.items()
        if not limit.holds(found[name])
    ]


def update_baseline(path: Path, found: Mapping[str, float]) -> None:
    """Put what was reached into the lines that the baseline has; do so deliberately, on a quiet machine."""
    limits = read_baseline(path)
    anew = {name: replace(limit, value=found.get(name, limit.value)) for name, limit in limits.items()}
    note = json.loads(path.read_text(encoding="utf-8")).get("note", "")
    write_json({"note": note, "metrics": {name: line_of(limit) for name, limit in anew.items()}}, path)

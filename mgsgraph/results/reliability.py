"""Reliability and data snooping as people and programs read them: the table by suspicion, and all measures as CSV."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from mgsgraph.analysis.reliability import Reliability
from mgsgraph.analysis.snooping import Snooping
from mgsgraph.analysis.suspects import Suspect
from mgsgraph.files.output.csv_json import picked
from mgsgraph.files.output.table import Column, Table
from mgsgraph.text import many, some
from mgsgraph.units import MRAD

_KINDS = ("image coordinate", "range", "a-priori place", "height", "stereo height", "prior", "crossover")
_MOST_ALIKE = 6
"""Measures of a group that are printed; analysis.json has all."""
_MOST_REMOVED = 30


def reliability_text(found: Reliability, worst: Sequence[Suspect]) -> str:
    """Lines for a person: counts, then the table by suspicion."""
    over = [one for one in worst if one.over]
    lines = [
        f"{len(found)} measures, redundancy {found.degrees_of_freedom:.1f}; tests by Baarda: alpha "
        f"{found.levels.alpha:g}, power {found.levels.power:g}, critical value {found.critical:.3g}, found at "
        f"{found.levels.shift:.3g} sigmas",
        f"{many(found.suspected.size, 'test')} over the critical value ({found.levels.alpha * len(found):.1f} of "
        f"{len(found)} good measures would be); nothing controls {many(found.uncontrolled.size, 'measure')}"
        + (f", e.g. {_named(found, found.uncontrolled)}" if found.uncontrolled.size else ""),
        f"By suspicion, what can't be told apart together ({many(len(over), 'group')} over; MDB: minimal detectable "
        "blunder, and how far one that goes unnoticed moves the point; r: redundancy number)",
        f"{'w':>8} {'residual':>11} {'MDB':>10} {'moves point':>11} {'r':>6}",
    ]
    for one in worst:
        lines += [_line(found, one, int(k), first=n == 0) for n, k in enumerate(one.measures[:_MOST_ALIKE])]
        if one.measures.size > _MOST_ALIKE:
            lines.append(f"{'':>8} ... and {one.measures.size - _MOST_ALIKE} more that can't be told apart from it")
    return "\n".join(lines)


def _named(found: Reliability, measures: np.ndarray) -> str:
    names = [found.name(int(k)) for k in measures[:4]]
    return some(names, int(measures.size))


def _line(found: Reliability, group: Suspect, k: int, first: bool) -> str:
    table, unit = found.measures, found.unit(k)
    scale, unit = (MRAD, "mrad") if unit == "rad" else (1.0, unit)
    residual = f"{table.residual[k] / scale:.3g} {unit}"
    detectable = f"{table.detectable[k] / scale:.3g} {unit}"
    effect = f"{table.effect[k]:.3g} m" if np.isfinite(table.effect[k]) else "-"
    return (
        f"{table.test[k]:8.2f} {residual:>11} {detectable:>10} {effect:>11} {table.redundancy[k]:6.3f} "
        f"{'' if first else '  = '}{found.name(k)}{' OVER' if group.over and first else ''}"
    )


def reliability_record(found: Reliability, worst: Sequence[Suspect]) -> dict[str, Any]:
    """Figures of the reliability and its worst measures, as analysis.json has them."""
    return {
        "alpha": found.levels.alpha, "power": found.levels.power, "critical": found.critical,
        "shift_sigmas": found.levels.shift, "measures": len(found), "redundancy": found.degrees_of_freedom,
        "over": int(found.suspected.size), "uncontrolled": int(found.uncontrolled.size),
        "suspects": [
            {"w": one.test, "over": one.over, "measures": [found.name(int(k)) for k in one.measures]} for one in worst
        ],
    }  # fmt: skip


def reliability_table(found: Reliability) -> Table:
    """One row per scalar measure, the largest test first; units in `unit`, effect in m."""
    table, order = found.measures, found.order(len(found))
    points = [*found.at.network.points.ids, ""]  # the last one is that of row -1
    images = [*(image.name for image in found.at.network.images), ""]

    def numbers(values: np.ndarray) -> np.ndarray:
        return np.where(np.isfinite(values), values, np.nan)[order]

    return Table("reliability", "Measures by suspicion", (
        Column("measure", found.names(order), meaning="its name"),
        Column("kind", picked(_KINDS, table.kind[order]), meaning=", ".join(_KINDS)),
        Column("point", picked(points, table.point[order]), meaning="that it is of"),
        Column("image", picked(images, table.image[order]), meaning="that it is of"),
        Column("unit", found.units(order), meaning="of residual, sigma and blunder"),
        Column("w", numbers(table.test), meaning="normalised residual"),
        Column("residual", numbers(table.residual), meaning="measured minus predicted, in `unit`"),
        Column("sigma", numbers(table.sigma), meaning="a priori, in `unit`"),
        Column("redundancy", numbers(table.redundancy), meaning="0 .. 1"),
        Column("minimal_detectable_blunder", numbers(table.detectable), meaning="found by the tests, in `unit`"),
        Column("effect", numbers(table.effect), "m", "of one that goes unnoticed, on the point"),
        Column("external", numbers(table.external), meaning="the most that it shifts any result, in sigmas of it"),
        Column("joint_test", numbers(table.joint), meaning="of the whole ray or a-priori place, chi-square"),
        Column("joint_dimensions", numbers(table.dimensions), meaning="those that something controls"),
    ))  # fmt: skip


def snooping_text(found: Snooping) -> str:
    """Lines for a person: what is out, the worst first."""
    lines = [
        f"Data snooping took out measures of {many(len(found.removals), 'point')}, by the search of adjust --reject; "
        f"sigma0 is {found.solution.sigma0:.4g} now"
    ]
    lines += [
        f"{np.sqrt(one.test):8.2f} (limit {np.sqrt(one.critical):.2f})  {some(one.names, len(one.names))}"
        for one in found.removals[:_MOST_REMOVED]
    ]
    if len(found.removals) > _MOST_REMOVED:
        lines.append(f"... and {len(found.removals) - _MOST_REMOVED} more")
    return "\n".join(lines)


def snooping_record(found: Snooping) -> dict[str, Any]:
    """What data snooping has removed, as analysis.json has it."""
    return {
        "sigma0": found.solution.sigma0,
        "removed": [
            {"measures": list(one.names), "test": one.test, "dimensions": one.dimensions, "critical": one.critical}
            for one in found.removals
        ],
    }  # fmt: skip

"""Reliability as people and programs read them: the table by suspicion, and all measures as CSV."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from mgsgraph.analysis.reliability import Reliability, Suspect, suspects
from mgsgraph.files.output.csv_json import picked
from mgsgraph.files.output.table import Column, Table
from mgsgraph.geometry.records import Index
from mgsgraph.results.section import Section
from mgsgraph.text import NAMED, many, some

_KINDS = ("image coordinate", "range", "a-priori place", "height", "stereo height", "prior", "crossover")
_MOST_ALIKE = 6
"""Measures of a group that are printed; analysis.json has all."""


def reliability_section(found: Reliability, most: int) -> Section:
    """Redundancy and tests of all measurements, and the `most` suspicious ones with those inseparable from them."""
    worst = suspects(found, most)
    over = sum(one.over for one in worst)
    loose = [found.name(int(k)) for k in found.uncontrolled[:NAMED]]
    said = [
        f"{len(found)} measurements, redundancy {found.degrees_of_freedom:.1f}; tests by Baarda: alpha "
        f"{found.levels.alpha:g}, power {found.levels.power:g}, critical value {found.critical:.3g}, found at "
        f"{found.levels.shift:.3g} sigmas.",
        f"{many(found.suspected.size, 'test')} over the critical value (expected of {len(found)} good measurements: "
        f"{found.levels.alpha * len(found):.1f}), {many(over, 'inseparable group')}.",
        f"Nothing controls {many(found.uncontrolled.size, 'measurement')}"
        + (f": {some(loose, found.uncontrolled.size)}." if loose else "."),
    ]
    record = {
        "alpha": found.levels.alpha, "power": found.levels.power, "critical": found.critical,
        "shift_sigmas": found.levels.shift, "measures": len(found), "redundancy": found.degrees_of_freedom,
        "over": int(found.suspected.size), "uncontrolled": int(found.uncontrolled.size),
        "suspects": [
            {"w": one.test, "over": one.over, "measures": [found.name(int(k)) for k in one.measures]} for one in worst
        ],
    }  # fmt: skip
    table = reliability_table(found)
    return Section("reliability", sentences=said, tables=[suspects_table(found, worst)], numbers=record, csv=[table])


def suspects_table(found: Reliability, worst: Sequence[Suspect]) -> Table:
    """Rows of `reliability_table` by suspicion; measures that are inseparable from one stand below it."""
    groups = [one.measures[:_MOST_ALIKE] for one in worst]
    marks = ["OVER" if one.over else "" for one in worst]
    names = [
        f"{'= ' if k else ''}{found.name(int(measure))} {mark if not k else ''}"
        for mark, group in zip(marks, groups, strict=True) for k, measure in enumerate(group)
    ]
    table = reliability_table(found, np.concatenate([np.zeros(0, dtype=np.int64), *groups]))
    named = Column("name", names, label="measurement (=: inseparable from the one above)", text="<", gap=2)
    return replace(table, columns=(*table.columns, named))


def reliability_table(found: Reliability, rows: Index | None = None) -> Table:
    """One row per scalar measure, or per those with indices `rows`, the largest test first; units in `unit`."""
    table, order = found.measures, found.order(len(found)) if rows is None else rows
    points = [*found.at.network.points.ids, ""]  # the last one is that of row -1
    images = [*(image.name for image in found.at.network.images), ""]

    def known(values: np.ndarray) -> np.ndarray:
        return np.where(np.isfinite(values), values, np.nan)[order]

    return Table("reliability", "Measures by suspicion", (
        Column("measure", found.names(order), meaning="its name"),
        Column("kind", picked(_KINDS, table.kind[order]), meaning=", ".join(_KINDS)),
        Column("point", picked(points, table.point[order]), meaning="that it is of"),
        Column("image", picked(images, table.image[order]), meaning="that it is of"),
        Column("unit", found.units(order), meaning="of residual, sigma and blunder", text="<4"),
        Column("w", known(table.test), meaning="normalised residual", text=">8.2f"),
        Column("residual", known(table.residual), meaning="measured minus predicted, in `unit`", text=">10.3g"),
        Column("sigma", known(table.sigma), meaning="a priori, in `unit`"),
        Column("redundancy", known(table.redundancy), meaning="0 .. 1", label="redund.", text=">7.3f"),
        Column("minimal_detectable_blunder", known(table.detectable), meaning="found by the tests, in `unit`",
               label="detectable", text=">10.3g"),
        Column("effect", known(table.effect), "m", "of one that goes unnoticed, on the point", label="moves (m)",
               text=">10.3g"),
        Column("external", known(table.external), meaning="the most that it shifts any result, in sigmas of it"),
        Column("joint_test", known(table.joint), meaning="of the whole ray or a-priori place, chi-square"),
        Column("joint_dimensions", known(table.dimensions), meaning="those that something controls"),
    ))  # fmt: skip

"""Passes in reports: how their trajectories were corrected along time, and how well that is known.

Corrections are those of the orientation images alone, in the terms of the flight (`datum.frames`): along, across and
radial; roll, pitch and yaw. What unknowns that images share do to them on top stands in `shared.csv`.
"""

from datetime import UTC, datetime, timedelta
from typing import Any

import numpy as np

from mgsgraph.adjustment.solution import Solution
from mgsgraph.analysis.separability import separations
from mgsgraph.analysis.statistics import pass_reports
from mgsgraph.analysis.vibrations import amplitudes
from mgsgraph.files.output.table import Table, numbers
from mgsgraph.geometry.orientation import COMPONENTS as AXES
from mgsgraph.geometry.records import Array
from mgsgraph.results.section import Section, table_of
from mgsgraph.units import ARCSEC

_J2000 = datetime(2000, 1, 1, 12, tzinfo=UTC)


# --- tables


def passes_table(solution: Solution) -> Table:
    """One row per pass."""
    reports = pass_reports(solution)
    largest, sigmas = numbers(reports, "largest").reshape(-1, 6), numbers(reports, "mean_sigmas").reshape(-1, 6)
    return table_of("passes", {
        "number": np.array([len(report.images) for report in reports]), "largest_correction": largest[:, :3],
        "largest_roll_pitch_yaw": largest[:, 3:], "mean_sigma": sigmas[:, :3],
        "mean_sigma_roll_pitch_yaw": sigmas[:, 3:],
        "trend": [[_trend_json(*trend_part) for trend_part in report.trend] for report in reports],
    }, reports)  # fmt: skip


def _trend_json(part: str, component: str, value: float, sigma: float) -> dict[str, Any]:
    unit, scale = ("arcsec", ARCSEC) if component in AXES[3:] else ("m", 1.0)
    return {"part": part, "component": component, f"value_{unit}": value / scale, f"sigma_{unit}": sigma / scale}


def nodes_table(solution: Solution) -> Table:
    """One row per node within a pass: its time, and corrections with sigmas in m and arcsec."""
    corrections = [(report.name, report.corrections) for report in pass_reports(solution)]
    times = np.concatenate([series.times for _, series in corrections])

    def amounts(quantity: str) -> dict[str, Array]:
        values = np.concatenate([getattr(series, "values" if quantity == "correction" else "sigmas")
                                 for _, series in corrections])
        return {f"{quantity}_{{}} m": values[:, :3], f"{quantity}_{{}} arcsec": values[:, 3:]}

    return table_of("nodes", {
        "pass": [name for name, series in corrections for _ in range(series.times.size)],
        "node": np.concatenate([np.arange(1, series.times.size + 1) for _, series in corrections]),
        "time_tdb": [calendar(time) for time in times.tolist()], "time_et": times,
        "time_in_pass": np.concatenate([series.times - series.times[0] for _, series in corrections]),
        **amounts("correction"), **amounts("sigma"),
    })  # fmt: skip


def calendar(time: float) -> str:
    """Calendar date of s TDB past J2000, in TDB: UTC is the leap seconds (64 to 69) behind."""
    return (_J2000 + timedelta(seconds=round(time, 3))).strftime("%Y-%m-%dT%H:%M:%S.%f")[:-3]


# --- words


def passes_section(solution: Solution) -> Section:
    """How trajectories were corrected."""
    table = passes_table(solution)
    csv = [nodes_table(solution)] if len(table) else []
    return Section("passes", tables=[table], csv=csv, numbers=table.records())


# --- unknowns that images share


def shared_table(solution: Solution) -> Table:
    """One row for each column of a shared unknown; values, sigmas and metres on the ground in or per `unit`."""
    columns = separations(solution)
    units = [column.unit for column in columns]
    return table_of("shared", {
        "text": [f"{column.unknown.name} {column.axis}".strip() for column in columns], "unit": units,
    }, columns)  # fmt: skip


def shared_section(solution: Solution) -> Section:
    """Verdict on each column."""
    table = shared_table(solution)
    sentences = [amplitude.sentence for amplitude in amplitudes(solution)] + [
        f"{column.unknown.name[0].upper()}{column.unknown.name[1:]}{f', axis {column.axis}' if column.axis else ''}: "
        f"{column.sentence}"
        for column in separations(solution)
        if column.unknown.sine is None
    ]
    return Section("shared", sentences=sentences, tables=[table], csv=[table] if solution.network.shared else [],
                   numbers=table.drop("unit").records())  # fmt: skip

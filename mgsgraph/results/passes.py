"""Passes in reports (strips are such): how their trajectories were corrected along time, and how well that is known.

Corrections are those of the orientation images alone, in the terms of the flight (`datum.frames`): along, across and
radial; roll, pitch and yaw. What unknowns that images share do to them on top stands in `shared.csv`.
"""

from datetime import UTC, datetime, timedelta
from typing import Any

import numpy as np

from mgsgraph.adjustment.frames import FLIGHT_NAMES
from mgsgraph.adjustment.solution import Solution
from mgsgraph.analysis.separability import separations
from mgsgraph.analysis.statistics import strip_reports
from mgsgraph.files.output.table import Column, Table, numbers
from mgsgraph.geometry.orientation import COMPONENTS as AXES
from mgsgraph.geometry.records import Array
from mgsgraph.results.section import Section
from mgsgraph.units import MGON

POSITION, ROTATION = FLIGHT_NAMES[:3], FLIGHT_NAMES[3:]
"""Components of corrections along a pass: m, and rad."""
_J2000 = datetime(2000, 1, 1, 12, tzinfo=UTC)


# --- tables


def passes_table(solution: Solution) -> Table:
    """One row per pass."""
    found = strip_reports(solution)
    largest, sigmas = numbers(found, "largest").reshape(-1, 6), numbers(found, "mean_sigmas").reshape(-1, 6)
    (m, mgon), heads = ((("along", "acr.", "rad."), ROTATION), (POSITION, ROTATION))
    of_largest, of_sigmas = (
        [tuple(f"{what} {name}" for name in some) for some in heads] for what in ("largest Δ", "σ")
    )
    return Table("passes", "Passes (sigmas for sigma0 = 1)", (
        Column("name", [one.name for one in found], head="pass", page="s", text="<22"),
        Column("basis", [one.basis for one in found], page="s"),
        Column("images", [one.images for one in found]),
        Column("number", np.array([len(one.images) for one in found]), head="images", page="s", files=False),
        Column("nodes", np.array([one.nodes for one in found]), page="s", text=">5"),
        Column("spacing", numbers(found, "spacing"), "s", "on the average", page=".3f", label="every", text=">8.2f"),
        Column("spacing_lines", numbers(found, "lines"), label="lines", text=">7.0f"),
        Column("spacing", numbers(found, "ground"), "km", "over ground", label="", text=">6.1f"),
        Column("largest_correction", largest[:, :3], "m", "at a node", m, of_largest[0], ".2f"),
        Column("largest_roll_pitch_yaw", largest[:, 3:], "mgon", "at a node", mgon, of_largest[1], ".2f"),
        Column("mean_sigma", sigmas[:, :3], "m", "of the nodes", m, of_sigmas[0], ".2f", "mean sigma [m]", ">5", 3),
        Column("mean_sigma_roll_pitch_yaw", sigmas[:, 3:], "mgon", "of the nodes", mgon, of_sigmas[1], ".2f",
               "mean sigma [mgon]", ">7", 2),
        Column("trend", [[_trend_json(*part) for part in one.trend] for one in found]),
    ), "Corrections at the orientation images: the largest, and the mean sigma.")  # fmt: skip


def _trend_json(part: str, component: str, value: float, sigma: float) -> dict[str, Any]:
    unit, scale = ("mgon", MGON) if component in AXES[3:] else ("m", 1.0)
    return {"part": part, "component": component, f"value_{unit}": value / scale, f"sigma_{unit}": sigma / scale}


def nodes_table(solution: Solution) -> Table:
    """One row per node within a pass: its time, and corrections with sigmas in m, mgon and arcsec."""
    found = [(one.name, one.corrections) for one in strip_reports(solution)]
    times = np.concatenate([series.times for _, series in found])

    def amounts(part: str, of: Array) -> list[Column]:
        what = "of the nominal trajectory, in terms of the flight" if part == "correction" else "for sigma0 = 1"
        turns = [Column(f"{part}_{{}}", of[:, 3:], unit, what, ROTATION) for unit in ("mgon", "arcsec")]
        return [Column(f"{part}_{{}}", of[:, :3], "m", what, POSITION), *turns]

    return Table("passes", "Orientation images", (
        Column("pass", [name for name, series in found for _ in range(series.times.size)], meaning="its name"),
        Column("node", np.concatenate([np.arange(1, series.times.size + 1) for _, series in found]), meaning="from 1"),
        Column("time_tdb", [calendar(time) for time in times.tolist()], meaning="calendar date"),
        Column("time_et", times, "s", "TDB past J2000"),
        Column("time_in_pass", np.concatenate([series.times - series.times[0] for _, series in found]), "s",
               "since the first node"),
        *amounts("correction", np.concatenate([series.values for _, series in found])),
        *amounts("sigma", np.concatenate([series.sigmas for _, series in found])),
    ))  # fmt: skip


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
    found = separations(solution)
    units = [one.unit for one in found]
    return Table("shared", "Unknowns that images share", (
        Column("text", [f"{one.unknown.name[:34]} {one.axis}".strip() for one in found], label="", text="<38",
               files=False),
        Column("name", [one.unknown.name for one in found], meaning="of the unknown", page="s"),
        Column("kind", [one.unknown.kind.value for one in found], meaning="as the case file names it", page="s"),
        Column("axis", [one.axis for one in found], meaning="of the camera, of a boresight or lever arm", page="s"),
        Column("unit", units, meaning="s, mrad, m or ppm", page="s", text="<5"),
        Column("value", numbers(found, "value"), units, "adjusted", page=".4g", text=">+10.4g"),
        Column("sigma", numbers(found, "sigma"), units, "for sigma0 = 1", head="σ", page=".4g", label="sigma",
               text=">9.3g"),
        Column("prior_sigma", numbers(found, "prior_sigma"), units, "the same beforehand", head="a-priori σ",
               page=".4g", label="before", text=">9.3g"),
        Column("ground_m_per_{unit}", numbers(found, "ground"), units, "m on the ground, middle of its first image"),
        Column("gain", numbers(found, "gain"), meaning="sigma over a-priori sigma"),
        Column("most_correlated_with", [one.other for one in found], meaning="of all other unknowns", page="s",
               head="most correlated with"),
        Column("largest_correlation", numbers(found, "correlation"), meaning="with that one, of the posterior",
               head="correlation", page=".3f", label="largest corr.", text=">14.2f"),
        Column("multiple_correlation", numbers(found, "together"), meaning="with all other unknowns together",
               head="with all others", page=".3f", label="multiple", text=">9.2f"),
        Column("verdict", [one.verdict.value for one in found], meaning="whether it is separable"),
    ))  # fmt: skip


def shared_section(solution: Solution) -> Section:
    """Verdict on each column."""
    table = shared_table(solution)
    said = [
        f"{one.unknown.name[0].upper()}{one.unknown.name[1:]}{f', axis {one.axis}' if one.axis else ''}: {one.sentence}"
        for one in separations(solution)
    ]
    return Section("shared", sentences=said, tables=[table], csv=[table] if solution.network.shared else [],
                   numbers=table.drop("unit").records())  # fmt: skip

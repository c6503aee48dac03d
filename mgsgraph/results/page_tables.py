"""Tables of the report page: what is in each column, in what unit, and what was cut."""

import dataclasses
from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from mgsgraph.adjustment.solution import Solution
from mgsgraph.analysis.group_fits import group_fits
from mgsgraph.analysis.statistics import (
    PLACES,
    range_statistics,
)
from mgsgraph.files.output.csv_json import picked
from mgsgraph.files.output.table import Column, Table, cut
from mgsgraph.geometry.records import Index
from mgsgraph.results.drivers import drivers_table
from mgsgraph.results.group_fits import group_fits_table
from mgsgraph.results.minima import minima_table
from mgsgraph.results.passes import passes_table
from mgsgraph.results.shared import ON_PAGE, shared_table
from mgsgraph.results.tables import classes_table, images_table, points_table, residuals_table

MOST_ROWS = 1000
"""Rows of one table; the CSV files have all."""
MOST_IMAGES = 300
"""Images of which the orientation is stated."""
_MOST_DRIVERS = 10
"""Images and points listed of each quantity that drives an adjustment which did not come to rest."""
_MOST_MEASURES = 300
"""Measures listed, those that fit worst."""


def tables(solution: Solution) -> list[Table]:
    """All tables of a solution that have rows."""
    found = [
        _drivers(solution), _images(solution), group_fits_table(group_fits(solution)), _points_by_class(solution),
        _ranges(solution), _shifts(solution),
        minima_table(solution.minima), shared_table(solution).pick(*ON_PAGE), passes_table(solution),
        _measures(solution), _points(solution),
    ]  # fmt: skip
    return [table for table in found if len(table)]


def _drivers(solution: Solution) -> Table:
    every = () if solution.drivers is None else solution.drivers.contributions
    ends = np.cumsum([0, *(one.members.size for one in every)])[:-1]
    shown = [np.arange(min(one.members.size, _MOST_DRIVERS)) + end for one, end in zip(every, ends, strict=True)]
    table, rows = drivers_table(solution), np.concatenate([np.zeros(0, dtype=np.int64), *shown])
    note = table.note + cut(len(table), rows.size, "the first ones of each", "drivers.csv")
    return replace(table.take(rows), note=note)


def _images(solution: Solution) -> Table:
    total = len(solution.network.images)
    shown = min(total, MOST_IMAGES)
    note = (
        "Residuals: rms of the measures that were used, measured minus predicted. Corrections: adjusted minus nominal, "
        f"mean over {PLACES} lines; positions along the body-fixed axes, rotations about the camera's own axes. "
        "Sigmas are those of the adjusted orientation, mean over the same lines; a dash: held. "
    )
    table = images_table(solution).take(np.arange(shown))
    return replace(table, note=note + cut(total, shown, "the first ones", "solution.json"))


def _points_by_class(solution: Solution) -> Table:
    there = [point_class for point_class, _ in solution.network.of_class()]
    return classes_table(solution).take(np.array(there, dtype=np.int64)).drop("mean_correction_{}")


def _ranges(solution: Solution) -> Table:
    found = range_statistics(solution)
    rows = slice(None) if found.count else slice(0)
    return Table("ranges", "Laser ranges", (
        Column("orientation", ["before", "after"][rows], page="s"),
        Column("ranges", np.full(2, found.count)[rows], page="s"),
        Column("used", np.full(2, found.used)[rows], page="s"),
        Column("mean residual", np.array([found.mean_before, found.mean])[rows], "m", page=".2f"),
        Column("rms residual", np.array([found.rms_before, found.rms])[rows], "m", page=".2f"),
    ), "Measured minus predicted.")  # fmt: skip


def _shifts(solution: Solution) -> Table:
    names, ways = solution.network.shift_names, ("east", "north")
    sigmas = [np.sqrt(np.diag(solution.shift_covariance(p))) for p in range(len(names))]
    return Table("shifts", "Horizontal shifts of profiles and terrain model", (
        Column("what", names, page="s"),
        Column("{}", np.array([solution.shifts[p] for p in range(len(names))]).reshape(-1, 2), "m", parts=ways,
               head="{}", page=".1f"),
        Column("sigma_{}", np.array(sigmas).reshape(-1, 2), "m", parts=ways, head="σ {}", page=".1f"),
    ))  # fmt: skip


def _measures(solution: Solution) -> Table:
    """Measures that fit worst, in units of their sigmas."""
    rays = solution.network.rays
    size = np.max(np.abs(solution.residuals / rays.sigmas), axis=1) if rays.point.size else np.zeros(0)
    sound = np.flatnonzero(np.isfinite(size))
    chosen = sound[np.argsort(-size[sound], kind="stable")][:_MOST_MEASURES]
    table = residuals_table(solution).take(chosen)
    state = picked(("rejected", "used"), solution.rays_used[chosen].astype(np.int64))
    more = Column("largest", size[chosen], head="largest over σ", page=".2f"), Column("state", state, page="s")
    pairs = [f"{what}_{way}" for what in ("residual_before", "residual", "sigma") for way in ("line", "sample")]
    note = (
        "Lines and samples as ISIS counts them, the first pixel's centre at (1, 1); residuals are measured minus "
        "predicted. " + cut(rays.point.size, chosen.size, "those with the largest residual over its sigma",
                            "the table of residuals")
    )  # fmt: skip
    shown = table.pick("point", "class", "image", "isis_line", "isis_sample", *pairs)
    units = {"isis_line": "px", "isis_sample": "px"}
    columns = (replace(column, unit=units.get(column.key, column.unit)) for column in shown.columns)
    return replace(table, title="Image measures that fit worst", columns=(*columns, *more), note=note)


def _points(solution: Solution) -> Table:
    chosen = _weakest(solution)
    table = points_table(solution, chosen)
    which = "those that nothing determines and those of the largest sigma"
    note = table.note + cut(len(solution.network.points), chosen.size, which, "the table of points")
    return replace(table.last("rays_used", "state"), note=note)


def _weakest(solution: Solution) -> Index:
    """Points that are listed, in their own order: all, or those without a place and those of the largest sigma."""
    size = np.nan_to_num(np.linalg.norm(solution.sigmas, axis=1), nan=np.inf)
    return np.sort(np.argsort(-size, kind="stable")[:MOST_ROWS])


# --- how it was made


def settings_table(solution: Solution) -> Table:
    """Settings of the solver, by the names that a case file has for them."""
    found = dataclasses.asdict(solution.settings)
    values = ["" if value is None else str(value) for value in found.values()]
    return _pairs("settings", "Settings of the solver", "setting", "value", list(found), values)


def versions_table(solution: Solution) -> Table:
    """Versions that computed, and the time that each stage took."""
    names = [*solution.versions, *(f"{stage} (s)" for stage in solution.seconds)]
    values = [*solution.versions.values(), *(f"{seconds:.2f}" for seconds in solution.seconds.values())]
    return _pairs("versions", "Versions and wall time", "what", "value", names, values)


def inputs_table(inputs: Mapping[str, str | None]) -> Table:
    """Files and their checksums."""
    sums = [checksum or "could not be read" for checksum in inputs.values()]
    return _pairs("inputs", "Files that this page was made from", "file", "SHA-256", list(inputs), sums)


def _pairs(name: str, title: str, first: str, second: str, names: list[str], values: list[str]) -> Table:
    return Table(name, title, (Column(first, names, page="s"), Column(second, values, page="s")))

"""An adjustment in two steps as a page of text, tables and a figure."""

import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from mgsgraph.adjustment.two_steps import TwoSteps
from mgsgraph.analysis.height_cells import HeightCells, height_cells
from mgsgraph.analysis.two_step_statistics import POINT_AXES, POSE_AXES, STAGES, GroupStatistics, TwoStepStatistics
from mgsgraph.files.output.csv_json import picked, write_json
from mgsgraph.files.output.folders import PROGRAM, fresh_folder
from mgsgraph.files.output.table import Column, Table, numbers
from mgsgraph.geometry.body import planetocentric
from mgsgraph.geometry.records import Array
from mgsgraph.network import TERRAIN
from mgsgraph.results.results import write_into
from mgsgraph.text import many, short, some_of, three
from mgsgraph.units import DEG, MGON

_ROWS = 24
"""Strips listed in a table."""
_NAME = 18
"""Characters of a strip's name."""
_HARDLY = 0.05
"""Share by which a figure changes without being worth a factor."""


def write_two_steps(
    statistics: TwoStepStatistics, folder: str | Path, figures: bool = True, networks: Sequence[Path] = ()
) -> None:
    """Write the results of step 2, as those of any adjustment, and what both steps did, to a folder.

    Beside the files of `results.results` there are two_steps.txt, .json and .csv (figures of merit at all stages),
    heights.csv (each point above the terrain), height_cells.csv, and height_map.png and .svg.

    Parameters
    ----------
    statistics : TwoStepStatistics
        Of both steps (`two_step_statistics`).
    folder : path
        Absent, empty, or an earlier result, which is replaced.
    figures : bool
        False leaves the figures out.
    networks : sequence of Path
        Files of the tie points.

    Raises
    ------
    InputError
        If the folder holds anything else, or can't be written.
    """
    with fresh_folder(folder) as aside:
        write_into(statistics.steps.fitted, aside, figures, networks=networks)
        write_statistics_into(statistics, aside, figures)


def write_statistics_into(statistics: TwoStepStatistics, folder: Path, figures: bool = True) -> None:
    """What both steps did, alone, into a folder that exists."""
    (folder / "two_steps.txt").write_text(two_steps_page(statistics) + "\n", encoding="utf-8", newline="\n")
    write_json(folder / "two_steps.json", two_steps_json(statistics))
    _statistics_table(statistics).write_csv(folder / "two_steps.csv")
    if not statistics.points.size:
        return
    _heights_table(statistics).write_csv(folder / "heights.csv")
    if not np.any(statistics.used):
        return
    found = cells_of(statistics)
    _cells_table(found).write_csv(folder / "height_cells.csv")
    if figures:
        from mgsgraph.results.figures.height_maps import height_map_sheet  # matplotlib takes its time
        from mgsgraph.results.figures.sheet import save

        save([height_map_sheet(statistics, found)], folder)


def cells_of(statistics: TwoStepStatistics, step: float | None = None) -> HeightCells:
    """Heights of points whose row took part, by cell of the map; `step` in rad."""
    places = statistics.steps.fitted.places[statistics.points[statistics.used]]
    return height_cells(places, statistics.heights[:, statistics.used], step)


# --- the page


def two_steps_page(statistics: TwoStepStatistics) -> str:
    """The table, and the sentences under it."""
    sentences = [f"- {sentence}" for sentence in two_steps_statements(statistics)]
    return "\n".join([two_steps_table(statistics), "", *sentences])


def two_steps_table(statistics: TwoStepStatistics) -> str:
    """Both steps and their figures of merit as aligned text of at most 110 columns."""
    sections = [
        _step_table(statistics),
        _stage_table(statistics, "Points, mean sigma [m]", POINT_AXES, lambda group: group.mean),
        _stage_table(statistics, "Points, median sigma [m]", POINT_AXES, lambda group: group.median),
        _stage_table(statistics, "Attitude, mean sigma [mgon]", POSE_AXES[3:], lambda group: group.poses[:, 3:] / MGON),
        _stage_table(statistics, "Position, mean sigma [m]", POSE_AXES[:3], lambda group: group.poses[:, :3]),
        _height_table(statistics),
    ]
    return "\n\n".join(sections)


def _step_table(statistics: TwoStepStatistics) -> str:
    steps = statistics.steps
    both = (steps.free, steps.fitted)
    out = np.array([[0 if one is None else int(one.sum()) for one in (step.rays_rejected, step.ranges_rejected)]
                    for step in both])  # fmt: skip
    heights = int(np.count_nonzero(_height_rows(steps))), int(np.count_nonzero(steps.off))
    table = Table("steps", "Both steps", (
        Column("step", ["step 1, no terrain", "step 2, terrain"], label="", text=f"<{_NAME}"),
        Column("sigma0", np.array([step.sigma0 for step in both]), text=">8"),
        Column("freedom", np.array([step.fit.degrees_of_freedom for step in both]), text=">9"),
        Column("rays", np.array([int(step.rays_used.sum()) for step in both]), text=">8"),
        Column("rays_rejected", out[:, 0], label="rejected", text=">8"),
        Column("ranges", np.array([int(step.ranges_used.sum()) for step in both]), text=">7"),
        Column("ranges_rejected", out[:, 1], label="rejected", text=">8"),
        Column("heights", ["-", str(heights[0])], text=">8"),
        Column("off", ["-", str(heights[1])], text=">5"),
        Column("iterations", np.array([len(history) for history in steps.history]), text=">10"),
        Column("seconds", np.array(steps.seconds), text=">7.1f"),
        Column("state", ["" if step.converged else "NOT CONVERGED" for step in both], label="", text="<", gap=2),
    ))  # fmt: skip
    return "\n".join([short(steps.fitted.name, 60), *table.text(indent=2)])


def _height_rows(steps: TwoSteps) -> np.ndarray:
    surface = steps.fitted.network.surface
    assert surface is not None
    return np.isfinite(surface.sigmas) & steps.fitted.determined


def _stage_table(
    statistics: TwoStepStatistics, title: str, axes: tuple[str, ...], values: Callable[[GroupStatistics], Array]
) -> str:
    groups = _listed(statistics)
    before, free, fitted = np.moveaxis(np.array([values(group) for group in groups]), 1, 0)
    with np.errstate(divide="ignore", invalid="ignore"):
        factor = np.where(free > 0.0, before / free, np.nan)
    stages = {"before": before, "step 1": free, "factor of step 1": factor, "step 2": fitted}
    table = Table("stages", title, (
        Column("strip", [group.name for group in groups], label="", text=f"<{_NAME}"),
        *(Column(stage, of_stage, parts=axes, text=">6", gap=2) for stage, of_stage in stages.items()),
    ))  # fmt: skip
    return "\n".join([title, *table.text(indent=2), *_unlisted(statistics)])


def _height_table(statistics: TwoStepStatistics) -> str:
    heights = [group.heights for group in _listed(statistics)]
    stages = ("before", "step 1", "step 2")
    table = Table("heights", "Points above the terrain [m]", (
        Column("strip", [group.name for group in _listed(statistics)], label="", text=f"<{_NAME}"),
        Column("points", np.array([one.count for one in heights]), text=">8"),
        Column("rms_{}", numbers(heights, "rms"), parts=stages, label="rms", text=">7", gap=2),
        Column("factor_{}", numbers(heights, "factors")[:, 1:], parts=stages[1:], label="reduced by", text=">7", gap=2),
        Column("mean_{}", numbers(heights, "mean"), parts=stages, label="mean", text=">7", gap=2),
    ))  # fmt: skip
    return "\n".join([table.title, *table.text(indent=2), *_unlisted(statistics)])


def _listed(statistics: TwoStepStatistics) -> list[GroupStatistics]:
    return [statistics.whole, *(statistics.groups[:_ROWS] if len(statistics.groups) > 1 else ())]


def _unlisted(statistics: TwoStepStatistics) -> list[str]:
    more = len(statistics.groups) - _ROWS
    return [f"  and {many(more, 'more strip')}: see two_steps.csv"] if more > 0 else []


# --- in words


def two_steps_statements(statistics: TwoStepStatistics) -> list[str]:
    """Sentences with figures and units."""
    steps, whole = statistics.steps, statistics.whole
    found = [_of_blunders(statistics)]
    if np.all(np.isfinite(whole.mean[:2])):
        found.append(
            f"Without the terrain the points' mean sigmas in X (flight), Y (across) and Z (height) go from "
            f"{three(whole.mean[0])} m, by forward intersection with the a-priori orientation, to "
            f"{three(whole.mean[1])} m: factors of {three(whole.point_factors[1])}; with it to "
            f"{three(whole.mean[2])} m: {three(whole.point_factors[2])}."
        )
    elif whole.points:
        found.append(
            f"The points' mean sigmas in X (flight), Y (across) and Z (height) are {three(whole.mean[1])} m without "
            f"the terrain and {three(whole.mean[2])} m with it; of some orientation nothing is known beforehand, so "
            "that there is no a-priori sigma."
        )
    attitude = whole.poses[:, 3:] / MGON
    before = f"from {three(attitude[0])} " if np.all(np.isfinite(attitude[0])) else ""
    found.append(
        f"Sigmas of roll, pitch and yaw go {before}to {three(attitude[1])} mgon without the terrain, and to "
        f"{three(attitude[2])} mgon with it."
    )
    found += _of_heights(statistics)
    if not steps.converged:
        which = " and ".join(
            name for name, one in (("step 1", steps.free), ("step 2", steps.fitted)) if not one.converged
        )
        found.insert(0, f"NOT CONVERGED: {which}. Nothing below is a result.")
    return found


def _of_blunders(statistics: TwoStepStatistics) -> str:
    steps = statistics.steps
    limit = steps.free.settings.reject
    if limit == 0.0:
        return "No blunders were sought (reject is 0): neither rays nor heights; --reject 4 does so."
    rays = 0 if steps.free.rays_rejected is None else int(steps.free.rays_rejected.sum())
    off = np.flatnonzero(steps.off)
    text = (
        f"Step 1 rejected {many(rays, 'ray')} of {steps.network.rays.point.size} beyond {limit:g} standard "
        "deviations, which stay out of step 2; "
    )
    if not off.size:
        return text + "no height above the terrain is off by as much."
    names = some_of(steps.network.points.ids, off)
    text += (
        f"{many(off.size, 'point')} lie{'s' * (off.size == 1)} so far off the terrain that the height row went: a "
        f"blunder of matching that all rays share, or other ground than the model's ({names})"
    )
    return text + ("." if steps.at_rest else "; which ones these are did not come to rest.")


def _of_heights(statistics: TwoStepStatistics) -> list[str]:
    heights, found = statistics.whole.heights, list[str]()
    if heights.count:
        found.append(
            f"Heights above the terrain: rms {three(heights.rms)} m before, after step 1 and after step 2 "
            f"({many(heights.count, 'point')}): {_change(heights.factors[1])} by the rays alone "
            f"and {_change(heights.factors[2])} with the terrain. All are of the places where the rays alone put "
            f"the points; of the adjusted ones, each pulled by its own height row, it is {heights.rms_adjusted:.3g} m."
        )
        if statistics.steps.network.terrain_moves and TERRAIN not in statistics.steps.network.considered:
            found.append(
                "In step 2 the terrain model has moved to where the rays put it; above the model as it was given the "
                f"rms is {heights.rms_given:.3g} m."
            )
    if count := statistics.without_row:
        found.append(
            f"{many(count, 'tie point')} had no height row, beside the terrain model or over missing posts."
        )
    if count := statistics.left_out:
        found.append(
            f"{many(count, 'tie point')} with a height row {'are' if count > 1 else 'is'} left out "
            "of these heights: over missing posts at one of the stages, or without a place, as where their rays were "
            "rejected."
        )
    return found


def _change(factor: float) -> str:
    """What has become of something that is so many times less than before."""
    if not math.isfinite(factor):
        return "not comparable"
    if abs(factor - 1.0) < _HARDLY:
        return "hardly changed"
    return f"reduced by a factor of {factor:.2g}" if factor > 1.0 else f"made larger by a factor of {1.0 / factor:.2g}"


# --- files


def two_steps_json(statistics: TwoStepStatistics) -> dict[str, Any]:
    """Everything but the single points, SI units but for mgon."""
    steps = statistics.steps
    return {
        "program": PROGRAM,
        "name": steps.fitted.name,
        "stages": STAGES,
        "steps": [
            {
                "name": solution.name,
                "converged": solution.converged,
                "message": solution.message,
                "sigma0": solution.sigma0,
                "observations": solution.fit.observations,
                "unknowns": solution.fit.unknowns,
                "rays_used": int(solution.rays_used.sum()),
                "ranges_used": int(solution.ranges_used.sum()),
                "cost": [solution.cost_initial, solution.cost_final],
                "iterations": [
                    {"cost": one.cost, "step": one.step, "damping": one.damping, "accepted": one.accepted}
                    for one in history
                ],
                "seconds": seconds,
            }
            for solution, history, seconds in zip(
                (steps.free, steps.fitted), steps.history, steps.seconds, strict=True
            )
        ],
        "rays_rejected": 0 if steps.free.rays_rejected is None else int(steps.free.rays_rejected.sum()),
        "heights_off": [steps.network.points.ids[i] for i in np.flatnonzero(steps.off).tolist()],
        "heights_at_rest": steps.at_rest,
        "ties_without_height": statistics.without_row,
        "ties_lost_from_heights": statistics.left_out,
        "all": _group_json(statistics.whole),
        "strips": [_group_json(group) for group in statistics.groups],
        "statements": two_steps_statements(statistics),
    }


def _group_json(group: GroupStatistics) -> dict[str, Any]:
    heights = group.heights
    return {
        "name": group.name,
        "points": group.points,
        "point_sigma_mean_m": _by_stage(POINT_AXES, group.mean),
        "point_sigma_median_m": _by_stage(POINT_AXES, group.median),
        "point_factor": _by_stage(POINT_AXES, group.point_factors),
        "position_sigma_m": _by_stage(POSE_AXES[:3], group.poses[:, :3]),
        "attitude_sigma_mgon": _by_stage(POSE_AXES[3:], group.poses[:, 3:] / MGON),
        "heights": {
            "points": heights.count,
            "rms_m": dict(zip(STAGES, heights.rms, strict=True)),
            "mean_m": dict(zip(STAGES, heights.mean, strict=True)),
            "factor": dict(zip(STAGES, heights.factors, strict=True)),
            "rms_above_given_model_m": heights.rms_given,
            "rms_of_adjusted_points_m": heights.rms_adjusted,
        },
    }


def _by_stage(axes: tuple[str, ...], values: Array) -> dict[str, dict[str, float]]:
    return {stage: dict(zip(axes, row, strict=True)) for stage, row in zip(STAGES, values, strict=True)}


def _statistics_table(statistics: TwoStepStatistics) -> Table:
    """One row per strip and quantity: before, after step 1, after step 2, and the factors of either."""
    rows = [(group.name, *row) for group in (statistics.whole, *statistics.groups) for row in _quantities(group)]
    names, quantities, units, values = zip(*rows, strict=True)
    stages = np.array(values)
    with np.errstate(divide="ignore", invalid="ignore"):
        factors = np.where(stages[:, 1:] > 0.0, stages[:, :1] / stages[:, 1:], np.nan)
    factors[[quantity.endswith("_mean_height") for quantity in quantities]] = np.nan  # a mean has a sign, and no factor
    return Table("two_steps", "Figures of statistics of both steps", (
        Column("strip", names), Column("quantity", quantities), Column("unit", units),
        Column("{}", stages, parts=STAGES), Column("factor_{}", factors, parts=("step_1", "step_2")),
    ))  # fmt: skip


def _quantities(group: GroupStatistics) -> list[tuple[str, str, Array]]:
    found = [(f"point_sigma_mean_{axis}", "m", group.mean[:, k]) for k, axis in enumerate(POINT_AXES)]
    found += [(f"point_sigma_median_{axis}", "m", group.median[:, k]) for k, axis in enumerate(POINT_AXES)]
    for k, axis in enumerate(POSE_AXES):
        unit, scale = ("m", 1.0) if k < 3 else ("mgon", MGON)
        found.append((f"pose_sigma_{axis}", unit, group.poses[:, k] / scale))
    return [*found, ("terrain_rms_height", "m", group.heights.rms), ("terrain_mean_height", "m", group.heights.mean)]


def _heights_table(statistics: TwoStepStatistics) -> Table:
    """One row per point with a height row."""
    network, points = statistics.steps.network, statistics.points
    longitude, latitude, _ = planetocentric(statistics.steps.fitted.places[points]).T
    return Table("heights", "Heights above the terrain", (
        Column("point", picked(network.points.ids, points)),
        Column("used", statistics.used),
        Column("longitude", longitude / DEG % 360.0, "deg", "planetocentric, east", scale=1.0),
        Column("latitude", latitude, "deg", "planetocentric"),
        Column("height_{}", statistics.heights.T, "m", "above the terrain model", STAGES),
    ))  # fmt: skip


def _cells_table(found: HeightCells) -> Table:
    """One row per cell of the map that holds points."""
    rows, columns = np.nonzero(found.count)
    longitude = (found.west + (columns + 0.5) * found.steps[0]) / DEG % 360.0
    return Table("height_cells", "Heights above the terrain, by cell", (
        Column("cell", [f"{row}-{column}" for row, column in zip(rows.tolist(), columns.tolist(), strict=True)]),
        Column("longitude", np.asarray(longitude), "deg", "of the middle, planetocentric, east", scale=1.0),
        Column("latitude", np.asarray(found.south + (rows + 0.5) * found.steps[1]), "deg", "of the middle"),
        Column("points", found.count[rows, columns].astype(np.float64)),
        *(Column(f"{what}_{stage}", values[k, rows, columns], "m")
          for k, stage in enumerate(STAGES) for what, values in (("rms", found.rms), ("mean", found.mean))),
    ))  # fmt: skip

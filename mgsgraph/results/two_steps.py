"""An adjustment in two steps as a page of text, tables and a figure."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from mgsgraph.analysis.two_step_statistics import POINT_AXES, POSE_AXES, STAGES, GroupStatistics, TwoStepStatistics
from mgsgraph.files.output.folders import fresh_folder
from mgsgraph.files.output.table import Table, picked
from mgsgraph.geometry.body import planetocentric
from mgsgraph.geometry.records import Array
from mgsgraph.results.results import write_into
from mgsgraph.results.section import Section, record_of, sheets_by, table_of, write_sections_into
from mgsgraph.results.verdict import headline
from mgsgraph.text import many, some_of
from mgsgraph.units import ARCSEC, DEG


def write_two_steps(
    statistics: TwoStepStatistics, folder: str | Path, figures: bool = True, networks: Sequence[Path] = ()
) -> None:
    """Write the results of step 2, as those of any adjustment, and what both steps did, to a folder.

    Beside the files of `results.results` there are two_steps.json and .csv (figures of merit at all stages),
    heights.csv (each point above the terrain), and height_map_1.png and _2.png (before and after).

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
    with fresh_folder(folder) as temporary:
        write_into(statistics.steps.fitted, temporary, figures, networks=networks)
        section = two_steps_section(statistics)
        write_sections_into([section], section.numbers, temporary, "two_steps.json", figures)


def two_steps_section(statistics: TwoStepStatistics) -> Section:
    """Both steps and their figures of merit at all stages, heights above the terrain, and a map of these."""
    csv = [_statistics_table([statistics.whole, *statistics.groups])]
    csv += [_heights_table(statistics)] if statistics.points.size else []
    return Section(
        "two_steps", headline(statistics.steps.fitted), two_steps_statements(statistics),
        [_step_table(statistics), _statistics_table([statistics.whole])], two_steps_json(statistics), csv,
        sheets=None if not np.any(statistics.used) else
        sheets_by("mgsgraph.results.figures.dem.height_map_sheets", statistics),
    )  # fmt: skip


def _step_table(statistics: TwoStepStatistics) -> Table:
    steps = statistics.steps
    solutions, surface = (steps.free, steps.fitted), steps.fitted.network.surface
    assert surface is not None
    rejected = np.array([[0 if mask is None else int(mask.sum()) for mask in (step.rays_rejected, step.ranges_rejected)]
                         for step in solutions])  # fmt: skip
    heights = np.isfinite(surface.sigmas) & steps.fitted.determined
    return table_of("steps", {
        "step": ["step 1, no terrain", "step 2, terrain"],
        "rays": np.array([int(step.rays_used.sum()) for step in solutions]), "rays_rejected": rejected[:, 0],
        "ranges": np.array([int(step.ranges_used.sum()) for step in solutions]), "ranges_rejected": rejected[:, 1],
        "heights": ["-", str(np.count_nonzero(heights))], "heights_rejected": ["-", str(steps.rejected.sum())],
        "iterations": np.array([len(history) for history in steps.history]), "seconds": np.array(steps.seconds),
        "state": ["" if step.converged else "NOT CONVERGED" for step in solutions],
    }, solutions)  # fmt: skip


# --- sentences


def two_steps_statements(statistics: TwoStepStatistics) -> list[str]:
    """Sentences on what the tables do not hold."""
    steps, block, heights = statistics.steps, statistics.whole, statistics.whole.heights
    limit, rejected_heights, sentences = steps.free.settings.reject, np.flatnonzero(steps.rejected), list[str]()
    if failed := [name for name, step in (("step 1", steps.free), ("step 2", steps.fitted)) if not step.converged]:
        sentences.append(f"NOT CONVERGED: {' and '.join(failed)}. The values below are not valid.")
    if limit:
        sentences.append(
            f"Beyond {limit:g} standard deviations step 1 rejected {many(_rejected_rays(statistics), 'ray')}, which "
            f"stay out of step 2; the height rows of {many(rejected_heights.size, 'point')} were rejected (matched "
            "wrongly in all images, or other ground than the model's; "
            f"{some_of(steps.network.points.ids, rejected_heights) or 'none'})."
            + ("" if steps.heights_converged else " The set of rejected heights did not converge.")
        )
    else:
        sentences.append("No blunders were sought (reject is 0): neither rays nor heights; --reject 4 does so.")
    if block.points and not np.all(np.isfinite(block.mean[:2])):
        sentences.append("Some orientation has no prior: there is no a-priori sigma.")
    if heights.count:
        sentences.append(
            f"Heights above the terrain are of {many(heights.count, 'point')}, where the rays alone put them."
        )
    for count, reason in (
        (statistics.without_row, "had no height row, beside the terrain model or over missing posts"),
        (statistics.left_out, "with a height row left out of these heights: over missing posts, or without a place"),
    ):
        sentences += [f"{many(count, 'tie point')} {reason}."] if count else []
    return sentences


def _rejected_rays(statistics: TwoStepStatistics) -> int:
    """Rays that step 1 rejected."""
    rejected = statistics.steps.free.rays_rejected
    return 0 if rejected is None else int(rejected.sum())


# --- files


def two_steps_json(statistics: TwoStepStatistics) -> dict[str, Any]:
    """Everything but the single points, SI units but for arcsec."""
    steps = statistics.steps
    return {
        "name": steps.fitted.name,
        "stages": STAGES,
        "steps": [
            {
                **record_of("step", solution),
                "rays_used": int(solution.rays_used.sum()),
                "ranges_used": int(solution.ranges_used.sum()),
                "cost": [solution.cost_initial, solution.cost_final],
                "iterations": [record_of("iteration", iteration) for iteration in history],
                "seconds": seconds,
            }
            for solution, history, seconds in zip((steps.free, steps.fitted), steps.history, steps.seconds, strict=True)
        ],
        "rays_rejected": _rejected_rays(statistics),
        "heights_rejected": [steps.network.points.ids[i] for i in np.flatnonzero(steps.rejected).tolist()],
        "heights_converged": steps.heights_converged,
        "ties_without_height": statistics.without_row,
        "ties_left_out": statistics.left_out,
        "figures": _statistics_table([statistics.whole, *statistics.groups]).records(),
        "statements": two_steps_statements(statistics),
    }


def _statistics_table(groups: Sequence[GroupStatistics]) -> Table:
    """One row per pass and quantity: before, after step 1, after step 2, and the factors of either."""
    names, quantities, units, values = zip(*((group.name, *row) for group in groups for row in _quantities(group)),
                                           strict=True)
    stages = np.array(values)
    with np.errstate(divide="ignore", invalid="ignore"):
        factors = np.where(stages[:, 1:] > 0.0, stages[:, :1] / stages[:, 1:], np.nan)
    factors[[quantity.endswith("_mean_height") for quantity in quantities]] = np.nan  # a mean has a sign, and no factor
    return table_of("two_steps", {
        "pass": names, "quantity": quantities, "unit": units, "{}": stages, "factor_{}": factors,
    })  # fmt: skip


def _quantities(group: GroupStatistics) -> list[tuple[str, str, Array]]:
    rows = [(f"point_sigma_mean_{axis}", "m", group.mean[:, k]) for k, axis in enumerate(POINT_AXES)]
    rows += [(f"point_sigma_median_{axis}", "m", group.median[:, k]) for k, axis in enumerate(POINT_AXES)]
    for k, axis in enumerate(POSE_AXES):
        unit, scale = ("m", 1.0) if k < 3 else ("arcsec", ARCSEC)
        rows.append((f"pose_sigma_{axis}", unit, group.poses[:, k] / scale))
    return [*rows, ("terrain_rms_height", "m", group.heights.rms), ("terrain_mean_height", "m", group.heights.mean)]


def _heights_table(statistics: TwoStepStatistics) -> Table:
    """One row per point with a height row."""
    network, points = statistics.steps.network, statistics.points
    longitude, latitude, _ = planetocentric(statistics.steps.fitted.places[points]).T
    return table_of("heights", {
        "point": picked(network.points.ids, points), "used": statistics.used, "longitude": longitude / DEG % 360.0,
        "latitude": latitude, "height_{}": statistics.heights.T,
    })  # fmt: skip

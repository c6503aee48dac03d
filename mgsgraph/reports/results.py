"""All products of one adjustment, in one folder."""

import json
from pathlib import Path

from mgsgraph.adjustment.analysis.merit import solution_connectivity
from mgsgraph.adjustment.solution import Solution
from mgsgraph.output.folders import RECORD, fresh_folder
from mgsgraph.reports.archive import ARCHIVE, write_archive
from mgsgraph.reports.shared import shared_csv
from mgsgraph.reports.strips import strips_csv
from mgsgraph.reports.tables import connectivity_csv, orientation_csv, points_csv, residuals_csv, solution_json


def write_results(solution: Solution, folder: str | Path, figures: bool = True) -> list[str]:
    """Write tables, archive and figures to a folder that appears whole or not at all.

    Parameters
    ----------
    solution : Solution
        Converged or not.
    folder : path
        Absent, empty, or an earlier result, which is replaced.
    figures : bool
        False leaves the figures out.

    Returns
    -------
    list of str
        Names of the files in the folder.

    Raises
    ------
    InputError
        If the folder holds anything else, or can't be written.
    """
    with fresh_folder(folder) as aside:
        return write_into(solution, aside, figures)


def write_into(solution: Solution, folder: Path, figures: bool = True) -> list[str]:
    """The same into a folder that exists, file by file; returns their names."""
    connected = solution_connectivity(solution)
    text = json.dumps(solution_json(solution, connected), indent=1, allow_nan=False, ensure_ascii=False)
    (folder / RECORD).write_text(text + "\n", encoding="utf-8", newline="\n")
    points_csv(solution, folder / "points.csv")
    orientation_csv(solution, folder / "orientation.csv")
    residuals_csv(solution, folder / "residuals.csv")
    connectivity_csv(connected, folder / "connectivity.csv")
    write_archive(solution, folder / ARCHIVE)
    names = [RECORD, "points.csv", "orientation.csv", "residuals.csv", "connectivity.csv", ARCHIVE]
    if solution.network.shared:
        shared_csv(solution, folder / "shared.csv")
        names.append("shared.csv")
    if solution.network.strips:
        strips_csv(solution, folder / "strips.csv")
        names.append("strips.csv")
    if not figures:
        return names
    from mgsgraph.figures import write_figures  # matplotlib takes its time; only those who draw wait for it

    return names + write_figures(solution, folder, connected)

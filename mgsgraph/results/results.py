"""All files of one adjustment, in one folder; and the record of all figures of merit, solution.json."""

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np

from mgsgraph.adjustment.settings import Device, Loss, SolverSettings
from mgsgraph.adjustment.solution import Solution
from mgsgraph.analysis.statistics import point_statistics, solution_connectivity
from mgsgraph.errors import InputError
from mgsgraph.files.opening import sha256_of
from mgsgraph.files.output.csv_json import plain, write_json
from mgsgraph.files.output.folders import PROGRAM, RECORD, fresh_folder
from mgsgraph.files.records import read_record
from mgsgraph.network.connectivity import Connectivity
from mgsgraph.results.archive import ARCHIVE, write_archive
from mgsgraph.results.large_tables import TableForm, write_large_tables
from mgsgraph.results.section import Section
from mgsgraph.results.summary import sentences_of, solution_sections
from mgsgraph.results.tables import connectivity_table, orientation_table
from mgsgraph.workers import called_in_workers

FORMAT = 1
"""Version of solution.json's layout."""
_SIGMAS = "standard deviations for sigma0 = 1, as the a-priori sigmas imply; times sigma0 they are scaled to the fit"


@dataclass(frozen=True, slots=True)
class Overrides:
    """Options that overrule all case files alike."""

    loss: Loss | None = None
    """Robust loss."""
    reject: float | None = None
    """Blunder limit in standard deviations, as `SolverSettings.reject`."""
    laser: bool = True
    """False leaves the laser rows out."""
    figures: bool = True
    """False leaves the figures out."""
    starts: int | None = None
    """Starts over a terrain model's unknown shift, as `SolverSettings.starts`."""
    tables: TableForm | None = None
    """Form of the tables of points and residuals, as `write_results`."""
    device: Device | None = None
    """Who goes over the points, as `SolverSettings.device`."""

    def over(self, settings: SolverSettings) -> SolverSettings:
        """A case file's settings with these over them."""
        chosen = {name: getattr(self, name) for name in ("loss", "reject", "starts", "device")}
        return dataclasses.replace(settings, **{name: value for name, value in chosen.items() if value is not None})


AS_WRITTEN = Overrides()
"""Nothing overrules the case files."""


def write_results(
    solution: Solution, folder: str | Path, figures: bool = True, case: str | Path | None = None,
    networks: Sequence[Path] = (), tables: TableForm | None = None,
) -> list[str]:  # fmt: skip
    """Write tables, archive and figures to a folder that appears whole or not at all.

    Parameters
    ----------
    solution : Solution
        Converged or not.
    folder : path
        Absent, empty, or an earlier result, which is replaced.
    figures : bool
        False leaves the figures out.
    case : path, optional
        Case file that was adjusted, for later commands (`case_of`).
    networks : sequence of Path
        Files of its tie points, which an export to ISIS takes more from.
    tables : "csv" or "parquet", optional
        Form of the tables of points and residuals; when absent CSV up to 200,000 rows, and else Parquet.

    Returns
    -------
    list of str
        Names of the files in the folder.

    Raises
    ------
    InputError
        If the folder holds anything else, or can't be written.

    Examples
    --------
    >>> files = mgsgraph.write_results(solution, "RESULT", figures=False, case="pair/case.toml")
    >>> [name for name in files if name.endswith(".csv")]
    ['points.csv', 'orientation.csv', 'residuals.csv', 'connectivity.csv']
    """
    with fresh_folder(folder) as aside:
        return write_into(solution, aside, figures, case, networks, tables)


def write_into(
    solution: Solution, folder: Path, figures: bool = True, case: str | Path | None = None,
    networks: Sequence[Path] = (), tables: TableForm | None = None,
) -> list[str]:  # fmt: skip
    """Write tables, archive and figures into a folder that exists; returns the names of the files."""
    connected = solution_connectivity(solution)
    sections = solution_sections(solution, connected)
    known: dict[str, Any] = {} if case is None else {"case": str(Path(case).resolve())}
    files = [{"path": str(path.resolve()), "sha256": sha256_of(path)} for path in networks if path.is_file()]
    known |= {"networks": files} if files else {}
    write_json(folder / RECORD, solution_json(solution, connected, sections) | known)
    orientation_table(solution).write_csv(folder / "orientation.csv")
    large = write_large_tables(solution, folder, tables)
    connectivity_table(connected).write_csv(folder / "connectivity.csv")
    write_archive(solution, folder / ARCHIVE)
    names = [RECORD, large[0], "orientation.csv", large[1], "connectivity.csv", ARCHIVE]
    names += [name for section in sections for name in section.write(folder, figures=False)]
    if figures:
        from mgsgraph.results.figures import FIGURES_END, figure_tasks  # matplotlib takes its time

        with called_in_workers(figure_tasks(solution, folder, connected), *FIGURES_END) as drawn:
            names += chain.from_iterable(drawn())
    return names


def case_of(folder: str | Path) -> Path:
    """Case file whose adjustment a result folder holds.

    Raises
    ------
    InputError
        A folder that is no result, or doesn't know its case.
    """
    path = Path(folder) / RECORD
    record = read_record(path) if path.exists() else {}
    if not isinstance(record.get("case"), str):
        raise InputError(
            str(path), "no word of the case that was adjusted", "the result of `mgsgraph adjust CASE`",
            f"give the case: mgsgraph coregister CASE --solution {folder}",
        )  # fmt: skip
    return Path(record["case"])


# --- the record


def solution_json(
    solution: Solution, connected: Connectivity | None = None, sections: Sequence[Section] | None = None
) -> dict[str, Any]:
    """All figures of merit of a solution, as plain values for strict JSON: what isn't a number is None.

    Units stand in the keys' names. `sigma_mean` is the mean standard deviation over the places, not that of the mean.
    `connected` and `sections` save finding them anew.
    """
    network, fit = solution.network, solution.fit
    connected = connected or solution_connectivity(solution)
    sections = sections or solution_sections(solution, connected)
    scaled = {
        c.name.lower(): point_statistics(solution, c).mean_sigma * solution.sigma0 for c in network.classes
    }  # fmt: skip
    record = {
        "program": PROGRAM,
        "format": FORMAT,
        "name": solution.name,
        "status": "converged" if solution.converged else "not converged",
        "message": solution.message,
        "iterations": solution.iterations,
        "cost_initial": solution.cost_initial,
        "cost_final": solution.cost_final,
        "sigma0": solution.sigma0,
        "degrees_of_freedom": fit.degrees_of_freedom,
        "observations": fit.observations,
        "unknowns": fit.unknowns,
        "islands": [[network.images[j].name for j in island] for island in connected.islands],
        "undetermined": [network.points.ids[i] for i in np.flatnonzero(~solution.determined)],
        **{section.name: section.numbers for section in sections if section.name},
        "sigmas": {"meaning": _SIGMAS, "sigma0": solution.sigma0, "scaled_by_sigma0": {"mean_sigma_m": scaled}},
        "settings": dataclasses.asdict(solution.settings),
        "seconds": dict(solution.seconds),
        "versions": dict(solution.versions),
        "statements": sentences_of(sections),
    }
    found: dict[str, Any] = plain(record)
    return found

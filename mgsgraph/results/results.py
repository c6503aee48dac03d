"""All files of one adjustment, in one folder; and the record of all figures of merit, solution.json."""

import dataclasses
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np

from mgsgraph.adjustment.solution import Solution
from mgsgraph.analysis.statistics import (
    ORIENTATION,
    PLACES,
    RayStatistics,
    laser_gain,
    orientation_statistics,
    point_statistics,
    range_statistics,
    ray_statistics,
    solution_connectivity,
)
from mgsgraph.errors import InputError
from mgsgraph.files.opening import sha256_of
from mgsgraph.files.output.csv_json import plain, write_json
from mgsgraph.files.output.folders import PROGRAM, RECORD, fresh_folder
from mgsgraph.files.records import read_record
from mgsgraph.network.connectivity import Connectivity
from mgsgraph.network.connectivity_words import connectivity_json
from mgsgraph.network.records import PointClass
from mgsgraph.results.archive import ARCHIVE, write_archive
from mgsgraph.results.control import control_json
from mgsgraph.results.drivers import drivers_json, drivers_table
from mgsgraph.results.group_fits import fits_json
from mgsgraph.results.large_tables import TableForm, write_large_tables
from mgsgraph.results.likelihood import linearity_json
from mgsgraph.results.minima import minima_json
from mgsgraph.results.passes import nodes_table, passes_table
from mgsgraph.results.shared import shared_table
from mgsgraph.results.soundness import soundness_json
from mgsgraph.results.summary import statements
from mgsgraph.results.tables import classes_table, connectivity_table, orientation_table
from mgsgraph.units import ARCSEC
from mgsgraph.workers import called_in_workers

FORMAT = 1
"""Version of solution.json's layout."""
_SIGMAS = "standard deviations for sigma0 = 1, as the a-priori sigmas imply; times sigma0 they are scaled to the fit"


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
    known: dict[str, Any] = {} if case is None else {"case": str(Path(case).resolve())}
    files = [{"path": str(path.resolve()), "sha256": sha256_of(path)} for path in networks if path.is_file()]
    known |= {"networks": files} if files else {}
    with _drawn_meanwhile(solution, folder, connected, figures) as drawn:
        write_json(folder / RECORD, solution_json(solution, connected) | known)
        return [*_write_tables(solution, folder, connected, tables), *drawn()]


@contextmanager
def _drawn_meanwhile(
    solution: Solution, folder: Path, connected: Connectivity, figures: bool
) -> Iterator[Callable[[], list[str]]]:
    """Let workers draw while the tables are written; yields what waits for them and gives the names of their files."""
    if not figures:
        yield list
        return
    from mgsgraph.results.figures import (  # matplotlib takes its time; only those who draw wait for it
        FIGURES_END,
        figure_tasks,
    )

    with called_in_workers(figure_tasks(solution, folder, connected), *FIGURES_END) as drawn:
        yield lambda: list(chain.from_iterable(drawn()))


def _write_tables(solution: Solution, folder: Path, connected: Connectivity, tables: TableForm | None) -> list[str]:
    """Tables and the archive; the names of all files but the figures."""
    orientation_table(solution).write_csv(folder / "orientation.csv")
    large = write_large_tables(solution, folder, tables)
    connectivity_table(connected).write_csv(folder / "connectivity.csv")
    write_archive(solution, folder / ARCHIVE)
    names = [RECORD, large[0], "orientation.csv", large[1], "connectivity.csv", ARCHIVE]
    if solution.network.shared:
        shared_table(solution).write_csv(folder / "shared.csv")
        names.append("shared.csv")
    if solution.network.passes:
        nodes_table(solution).write_csv(folder / "passes.csv")
        names.append("passes.csv")
    if solution.drivers is not None:
        drivers_table(solution).write_csv(folder / "drivers.csv")
        names.append("drivers.csv")
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


def solution_json(solution: Solution, connected: Connectivity | None = None) -> dict[str, Any]:
    """All figures of merit of a solution, as plain values for strict JSON: what isn't a number is None.

    Units stand in the keys' names. `sigma_mean` is the mean standard deviation over the places, not that of the mean.
    `connected` saves finding it anew.
    """
    network, fit = solution.network, solution.fit
    connected = connected or solution_connectivity(solution)
    rays = ray_statistics(solution)
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
        "fits": fits_json(solution),
        "soundness": soundness_json(solution),
        "drivers": drivers_json(solution),
        "linearity": linearity_json(solution.linearity),
        "minima": minima_json(solution.minima),
        "observations": fit.observations,
        "unknowns": fit.unknowns,
        "images": [_image(solution, j, rays) for j in range(len(network.images))],
        "islands": [[network.images[j].name for j in island] for island in connected.islands],
        "connectivity": connectivity_json(connected),
        "points": {row.pop("kind"): row for row in classes_table(solution).records()},
        "undetermined": [network.points.ids[i] for i in np.flatnonzero(~solution.determined)],
        "ranges": _ranges(solution),
        "laser_effect": _laser_effect(solution),
        "control": control_json(solution),
        "shared": shared_table(solution).drop("unit").records(),
        "passes": passes_table(solution).records(),
        "sigmas": _sigmas(solution),
        "settings": dataclasses.asdict(solution.settings),
        "seconds": dict(solution.seconds),
        "versions": dict(solution.versions),
        "statements": statements(solution, connected),
    }
    found: dict[str, Any] = plain(record)
    return found


def _name(point_class: PointClass) -> str:
    return point_class.name.lower()


def _image(solution: Solution, j: int, rays: RayStatistics) -> dict[str, Any]:
    image = solution.network.images[j]
    line, sample = rays.rms_of_images[j]
    record: dict[str, Any] = {
        "name": image.name,
        "held": bool(solution.network.held[j]),
        "pass": _strip_name(solution, j),
        "lines": image.lines,
        "samples": image.samples,
        "rays": int(rays.total[j]),
        "rays_used": int(rays.count[j].sum()),
        "residual_rms_line_px": line,
        "residual_rms_sample_px": sample,
    }
    for c in filter(lambda one: one.measured, PointClass):
        record[_name(c)] = {
            "count": int(rays.count[j, c]),
            "mean_line_px": rays.mean[j, c, 0],
            "mean_sample_px": rays.mean[j, c, 1],
            "rms_line_px": rays.rms[j, c, 0],
            "rms_sample_px": rays.rms[j, c, 1],
        }
    return record | {"orientation": _orientation(solution, j)}


def _strip_name(solution: Solution, j: int) -> str | None:
    strip = int(solution.network.pass_of[j])
    return solution.network.passes[strip].name if strip >= 0 else None


def _orientation(solution: Solution, j: int) -> dict[str, Any]:
    found = orientation_statistics(solution, j)
    record: dict[str, Any] = {"places": PLACES}
    for k, component in enumerate(ORIENTATION):
        unit, factor = ("m", 1.0) if k < 3 else ("arcsec", ARCSEC)
        record[f"{component.replace(' ', '_')}_{unit}"] = {
            "mean": found.mean[k] / factor, "rms": found.rms[k] / factor, "sigma_mean": found.mean_sigma[k] / factor,
        }
    return record


def _ranges(solution: Solution) -> dict[str, Any]:
    found = range_statistics(solution)
    return {
        "count": found.count,
        "used": found.used,
        "mean_residual_m": found.mean,
        "rms_residual_m": found.rms,
        "mean_residual_before_m": found.mean_before,
        "rms_residual_before_m": found.rms_before,
    }


def _laser_effect(solution: Solution) -> dict[str, Any] | None:
    without = solution.sigmas_without_laser
    if without is None:
        return None
    found = point_statistics(solution, PointClass.TIE)
    return {
        "tie_mean_sigma_m": found.mean_sigma,
        "tie_mean_sigma_without_laser_m": without,
        "ratio": without / found.mean_sigma,
        "tie_median_sigma_m": found.median_sigma,
        "tie_median_sigma_without_laser_m": solution.median_sigmas_without_laser,
        "ratio_overall": laser_gain(solution),
    }


def _sigmas(solution: Solution) -> dict[str, Any]:
    """What all sigmas mean, and the mean ones scaled to the fit."""
    scaled = {_name(c): point_statistics(solution, c).mean_sigma * solution.sigma0 for c in solution.network.classes}
    return {"meaning": _SIGMAS, "sigma0": solution.sigma0, "scaled_by_sigma0": {"mean_sigma_m": scaled}}

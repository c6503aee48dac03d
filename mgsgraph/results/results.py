"""All files of one adjustment, in one folder; and the record of all figures of merit, solution.json."""

import dataclasses
import math
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from mgsgraph.adjustment.settings import Device, Loss, SolverSettings
from mgsgraph.adjustment.solution import Solution
from mgsgraph.analysis.statistics import (
    ORIENTATION,
    PLACES,
    RayStatistics,
    orientation_statistics,
    point_statistics,
    ray_statistics,
    solution_connectivity,
    worst_first,
)
from mgsgraph.errors import InputError
from mgsgraph.files.opening import sha256_of
from mgsgraph.files.output.folders import PROGRAM, RECORD, fresh_folder
from mgsgraph.files.output.table import Table, plain, write_json
from mgsgraph.files.writing import read_record
from mgsgraph.network import PointClass
from mgsgraph.network.connectivity import Connectivity, connectivity_json, connectivity_statements
from mgsgraph.results.archive import ARCHIVE, write_archive
from mgsgraph.results.ground import (
    checkpoint_sections,
    control_section,
    laser_section,
    minima_section,
    points_section,
    ranges_section,
)
from mgsgraph.results.passes import passes_section, shared_section
from mgsgraph.results.section import ROWS, Section, record_of, table_of
from mgsgraph.results.tables import TableForm, connectivity_table, orientation_table, write_large_tables
from mgsgraph.results.verdict import drivers_section, linearity_section, reading_statements, state_of, verdict_section
from mgsgraph.text import many, short
from mgsgraph.units import ARCSEC

_NOTE = (
    "Residuals: rms of the measurements that were used, measured minus predicted. Corrections: adjusted minus nominal, "
    f"mean over {PLACES} lines; positions along the body-fixed axes, rotations about the camera's own axes. Sigmas are "
    "those of the adjusted orientation, mean over the same lines; a dash: held. "
)


def images_section(solution: Solution) -> Section:
    """How each class of points fits, and each image."""
    rays, sentences = ray_statistics(solution), list[str]()
    for point_class in PointClass:
        if count := int(rays.count[:, point_class].sum()):
            line, sample = rays.rms_of_classes[point_class]
            sentences.append(
                f"{point_class.name.capitalize()} points fit to {line:.2g} lines and {sample:.2g} samples "
                f"(rms of {many(count, 'ray')})."
            )
    record = [_image_record(solution, j, rays) for j in range(len(solution.network.images))]
    return Section("images", sentences=sentences, tables=[images_table(solution)], numbers=record)


def images_table(solution: Solution) -> Table:
    """One row per image: measurements, residuals, corrections; in large blocks those that fit worst first."""
    network, rays, count = solution.network, ray_statistics(solution), len(solution.network.images)
    statistics = [orientation_statistics(solution, j) for j in range(len(network.images))]
    mean, sigma = (np.array([getattr(statistic, name) for statistic in statistics]) for name in ("mean", "mean_sigma"))
    sigma = np.where(network.held[:, None], np.nan, sigma)
    passes = [network.passes[owner].name if owner >= 0 else "" for owner in network.pass_of.tolist()]
    held = dict.fromkeys(np.flatnonzero(network.held).tolist(), ("correction_{}", f"{'held':>23}"))
    table = table_of("results_images", {
        "pass": passes, "measures": rays.total, "used": rays.count.sum(axis=1), "residual_{}": rays.rms_of_images,
        "correction_{}": mean[:, :3], "sigma_{}": sigma[:, :3], "turn_{}": mean[:, 6:], "sigma_turn_{}": sigma[:, 6:],
    }, network.images, note=_NOTE, instead=held)  # fmt: skip
    return table if count <= ROWS else table.take(worst_first(solution))


def _image_record(solution: Solution, j: int, rays: RayStatistics) -> dict[str, Any]:
    """What a record holds of an image."""
    image, owner = solution.network.images[j], int(solution.network.pass_of[j])
    line, sample = rays.rms_of_images[j]
    record: dict[str, Any] = {
        "name": image.name, "held": bool(solution.network.held[j]),
        "pass": solution.network.passes[owner].name if owner >= 0 else None, "lines": image.lines,
        "samples": image.samples, "rays": int(rays.total[j]), "rays_used": int(rays.count[j].sum()),
        "residual_rms_line_px": line, "residual_rms_sample_px": sample,
    }
    for point_class in filter(lambda member: member.measured, PointClass):
        record[point_class.name.lower()] = {"count": int(rays.count[j, point_class])} | {
            f"{statistic}_{axis}_px": getattr(rays, statistic)[j, point_class, k]
            for statistic in ("mean", "rms") for k, axis in enumerate(("line", "sample"))
        }  # fmt: skip
    return record | {"orientation": _orientation_record(solution, j)}


def _orientation_record(solution: Solution, j: int) -> dict[str, Any]:
    statistics = orientation_statistics(solution, j)
    record: dict[str, Any] = {"places": PLACES}
    for k, component in enumerate(ORIENTATION):
        unit, factor = ("m", 1.0) if k < 3 else ("arcsec", ARCSEC)
        record[f"{component.replace(' ', '_')}_{unit}"] = {
            "mean": statistics.mean[k] / factor, "rms": statistics.rms[k] / factor,
            "sigma_mean": statistics.mean_sigma[k] / factor,
        }
    return record


def solution_sections(solution: Solution, connected: Connectivity | None = None) -> list[Section]:
    """Findings in the order in which they are read; `connected` saves computing it again. Those with a name are in
    solution.json.
    """
    connected = connected or solution_connectivity(solution)
    return [
        verdict_section(solution), Section("", sentences=_termination(solution)), drivers_section(solution),
        linearity_section(solution.linearity), minima_section(solution.minima), images_section(solution),
        ranges_section(solution), laser_section(solution), control_section(solution), *checkpoint_sections(solution),
        shared_section(solution),
        passes_section(solution), points_section(solution),
        Section("", sentences=reading_statements(solution.network.images)),
        Section("connectivity", sentences=connectivity_statements(connected), numbers=connectivity_json(connected)),
    ]


def statements(solution: Solution, connected: Connectivity | None = None) -> list[str]:
    """Sentences with figures and units; `connected` saves computing it again."""
    return sentences_of(solution_sections(solution, connected))


def sentences_of(sections: Sequence[Section]) -> list[str]:
    """Sentences of several sections."""
    return [sentence for section in sections for sentence in section.sentences]


def summary_table(solution: Solution, sections: Sequence[Section] | None = None) -> str:
    """Figures of merit and tables as aligned text of at most 110 columns; `sections` saves computing them again."""
    tables = [Section("", tables=section.tables).text() for section in sections or solution_sections(solution)]
    seconds = ", ".join(f"{stage} {time:.2f}" for stage, time in solution.seconds.items())
    return "\n\n".join([_heading(solution), *filter(None, tables), f"Seconds: {seconds}"])


def _termination(solution: Solution) -> list[str]:
    cost = f"the cost went from {solution.cost_initial:.4g} to {solution.cost_final:.4g}"
    return [f"{solution.message} It took {many(solution.iterations, 'iteration')}; {cost}."]


def figures_of_merit(solution: Solution) -> list[tuple[str, float]]:
    """Key figures: names and numbers."""
    fit, network = solution.fit, solution.network
    return [
        ("cost with the nominal orientation", solution.cost_initial), ("cost at the solution", solution.cost_final),
        ("sigma0", fit.sigma0), ("degrees of freedom", fit.degrees_of_freedom), ("observations", fit.observations),
        ("unknowns", fit.unknowns), ("images", len(network.images)), ("ground points", len(network.points)),
        ("image measurements", network.rays.point.size), ("laser ranges", network.ranges.point.size),
    ]  # fmt: skip


def value_text(value: float) -> str:
    """A figure of merit as text."""
    if isinstance(value, int):
        return str(value)
    return f"{value:.6g}" if math.isfinite(value) else "not defined"


def _heading(solution: Solution) -> str:
    figures = [f"{name} {value_text(value)}" for name, value in figures_of_merit(solution)]
    heading = f"{short(solution.name, 60)}: {state_of(solution)}, {many(solution.iterations, 'iteration')}"
    return "\n".join([heading, *(f"  {', '.join(figures[first:last])}" for first, last in ((0, 3), (3, 7), (7, 10)))])



FORMAT = 1
"""Version of solution.json's layout."""
_SIGMAS = "standard deviations for sigma0 = 1, as the a-priori sigmas imply; times sigma0 they are scaled to the fit"


@dataclass(frozen=True, slots=True)
class Overrides:
    """Options that override every case file."""

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
    """Processor that evaluates the points, as `SolverSettings.device`."""
    projects: bool = False
    """Whether the results of many cases are projects."""

    def over(self, settings: SolverSettings) -> SolverSettings:
        """A case file's settings with these over them."""
        overrides = {name: getattr(self, name) for name in ("loss", "reject", "starts", "device")}
        return dataclasses.replace(settings, **{name: value for name, value in overrides.items() if value is not None})


AS_WRITTEN = Overrides()
"""No option overrides the case files."""


def write_results(
    solution: Solution, folder: str | Path, figures: bool = True, case: str | Path | None = None,
    networks: Sequence[Path] = (), tables: TableForm | None = None,
) -> list[str]:  # fmt: skip
    """Write tables, archive and figures to a folder, atomically.

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
    with fresh_folder(folder) as temporary:
        return write_into(solution, temporary, figures, case, networks, tables)


def write_into(
    solution: Solution, folder: Path, figures: bool = True, case: str | Path | None = None,
    networks: Sequence[Path] = (), tables: TableForm | None = None,
) -> list[str]:  # fmt: skip
    """Write tables, archive and figures into a folder that exists; returns the names of the files."""
    with ThreadPoolExecutor(1) as beside:  # to compress and write large files leaves the interpreter to all else
        large = beside.submit(_write_large_files, solution, folder, tables)
        connected = solution_connectivity(solution)
        sections = solution_sections(solution, connected)
        inputs: dict[str, Any] = {} if case is None else {"case": str(Path(case).resolve())}
        files = [{"path": str(path.resolve()), "sha256": sha256_of(path)} for path in networks if path.is_file()]
        inputs |= {"networks": files} if files else {}
        write_json(folder / RECORD, solution_json(solution, connected, sections) | inputs)
        orientation_table(solution).write_csv(folder / "orientation.csv")
        connectivity_table(connected).write_csv(folder / "connectivity.csv")
        names = [name for section in sections for name in section.write(folder, figures=False)]
        if figures:
            from mgsgraph.results.figures import write_figures  # matplotlib loads slowly

            names += write_figures(solution, folder, connected)
        points, residuals, archive = large.result()
    return [RECORD, points, "orientation.csv", residuals, "connectivity.csv", archive, *names]


def _write_large_files(solution: Solution, folder: Path, tables: TableForm | None) -> tuple[str, str, str]:
    """Write tables of points and residuals, and the archive, into a folder; their names."""
    points, residuals = write_large_tables(solution, folder, tables)
    write_archive(solution, folder / ARCHIVE)
    return points, residuals, ARCHIVE


def case_of(folder: str | Path) -> Path:
    """Case file whose adjustment a result folder holds.

    Raises
    ------
    InputError
        A folder that holds no results, or doesn't name its case.
    """
    path = Path(folder) / RECORD
    record = read_record(path) if path.exists() else {}
    if not isinstance(record.get("case"), str):
        raise InputError(
            str(path), "no word of the case that was adjusted", "the result of `mgsgraph adjust CASE`",
            "name it by --case CASE",
        )  # fmt: skip
    return Path(record["case"])


# --- the record


def solution_json(
    solution: Solution, connected: Connectivity | None = None, sections: Sequence[Section] | None = None
) -> dict[str, Any]:
    """All figures of merit of a solution, as plain values for strict JSON: what isn't a number is None.

    Units stand in the keys' names. `sigma_mean` is the mean standard deviation over the places, not that of the mean.
    `connected` and `sections` save computing them again.
    """
    network, fit = solution.network, solution.fit
    connected = connected or solution_connectivity(solution)
    sections = sections or solution_sections(solution, connected)
    scaled = {
        point_class.name.lower(): point_statistics(solution, point_class).mean_sigma * solution.sigma0
        for point_class in network.classes
    }  # fmt: skip
    record = {
        "program": PROGRAM, "format": FORMAT, "name": solution.name,
        "status": "converged" if solution.converged else "not converged", **record_of("solution", solution),
        "degrees_of_freedom": fit.degrees_of_freedom, "observations": fit.observations, "unknowns": fit.unknowns,
        "islands": [[network.images[j].name for j in island] for island in connected.islands],
        "undetermined": [network.points.ids[i] for i in np.flatnonzero(~solution.determined)],
        **{section.name: section.numbers for section in sections if section.name},
        "sigmas": {"meaning": _SIGMAS, "sigma0": solution.sigma0, "scaled_by_sigma0": {"mean_sigma_m": scaled}},
        "settings": dataclasses.asdict(solution.settings), "seconds": dict(solution.seconds),
        "versions": dict(solution.versions), "statements": sentences_of(sections),
    }
    plain_record: dict[str, Any] = plain(record)
    return plain_record

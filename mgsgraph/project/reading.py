"""What a command reads from a folder of results, a demonstration or a project: files, network state, posterior."""

from pathlib import Path
from typing import NamedTuple

import numpy as np

from mgsgraph.adjustment.incremental.incremental import IncrementalAdjustment
from mgsgraph.adjustment.rounds import unmarked
from mgsgraph.adjustment.solution import Solution
from mgsgraph.analysis.linearised import at_values
from mgsgraph.analysis.posterior import Posterior, posterior_of, stands_alone
from mgsgraph.case.case_file import decode
from mgsgraph.errors import InputError, errors_from
from mgsgraph.files.opening import understood
from mgsgraph.files.records import read_record
from mgsgraph.network.parts import unknowns
from mgsgraph.planning.state import NetworkState, network_state, state_of_solution
from mgsgraph.project.changes import incremental, is_solved
from mgsgraph.project.connection import FILE
from mgsgraph.project.project import CHANGING, Project, open_project
from mgsgraph.results.archive import ARCHIVE, read_solution

_OWN_CASE = Path("inputs", "case.toml")
"""Where a demonstration's results hold their case."""
_SUMMARY = "summary.json"
"""Where they hold how they compare with the truth."""
_NETWORK = "network.pvl"


class Results(NamedTuple):
    """Results, and where they come from."""

    folder: Path
    """Folder of the results (or their archive)."""
    case: Path | None = None
    """The case, where it is known and still there."""
    ties: Path | None = None
    """Tie points that take the place of the case's own."""
    warning: str = ""
    """What of the project is not in them; empty where all is."""


def comparison_with_truth(folder: Path) -> str:
    """The sentence that says how a demonstration compares with its truth; empty for other results."""
    path = folder / _SUMMARY
    if not path.is_file():
        return ""
    with understood(f"{path}, statements", "what mgsgraph demo writes"):
        return str(next(iter(read_record(path).get("statements", [])), ""))


def results_of(path: Path) -> Results:
    """What a command means by a path: results as they are, or the last batch solution of a project.

    Raises
    ------
    InputError
        A project that has not been solved.
    """
    if not (path / FILE).is_file():
        own = path / _OWN_CASE
        return Results(path, own if own.is_file() else None)
    with open_project(path) as project:
        last = project.last_results()
        if last is None or last.folder is None:
            found, remedy = "a project without a batch solution", f"make one: mgsgraph solve {path}"
            raise InputError(str(path), found, "results of an adjustment", remedy)
        network = project.matches / _NETWORK
        ties = network if network.is_file() else None
        return Results(path / last.folder, _case_of_all(project), ties, _since(project, last.change))


def _since(project: Project, number: int) -> str:
    """What images and measures the project has taken in or out after a change of its."""
    later = [change for change in project.changes() if change.number > number and change.verb in CHANGING]
    if not later:
        return ""
    said = ", ".join(f"{change.verb} {change.what}" for change in later)
    remedy = f"for one of everything: mgsgraph solve {project.folder}"
    return f"The project has changed since this solution ({said}); {remedy}"


def _case_of_all(project: Project) -> Path | None:
    """The project's case, if it is still there and has all images that the project has, and no others."""
    case = project.case
    if case is None or not case.is_file():
        return None
    names = {image.name for image in decode(case).images}
    return case if names == set(project.store.image_names()) else None


def read_state(path: Path) -> tuple[str, NetworkState, str]:
    """Name and state of what was adjusted: a folder of results (or the archive in it), or a project's folder; and a
    warning where the adjustment has not converged, else an empty one.

    Raises
    ------
    InputError
        Neither of them; a project that has never been solved; a solution without covariance.
    """
    if _is_project(path):
        with open_project(path) as opened:
            adjustment = _adjusted(opened, str(path))
            with errors_from(str(path)):
                (network, places), values = adjustment.everything(), adjustment.values
            there, kept = np.isfinite(places[:, 0]), unmarked(network)
            rays, ranges = kept.rays & there[network.rays.point], kept.ranges & there[network.ranges.point]
            settings = opened.settings.solver.settings
            return opened.name, network_state(network, settings, values, places, rays, ranges), ""
    solution = read_solution(path)
    return solution.name, state_of_solution(solution), _warning(solution)


def read_posterior(path: Path) -> tuple[str, Posterior, str]:
    """Name, posterior and warning of the same."""
    if _is_project(path):
        with open_project(path) as opened:
            values, settings = _adjusted(opened, str(path)).values, opened.settings.solver.settings
            name, (network, near) = opened.name, opened.store.everything()
        every = [values.get(unknown, np.zeros(0)) for unknown in unknowns(network)]  # the file is free meanwhile
        with errors_from(str(path)):
            return name, Posterior(at_values(network, settings, every, near, near=True)), ""
    solution = read_solution(path)
    return solution.name, Posterior.of(solution), _warning(solution)


def posterior_near(path: Path, point: str) -> Posterior | None:
    """Posterior of a project's points that depend on the same unknowns as a point: their rows, and the covariance of
    these unknowns from iSAM2, so that no other point is read. None without such a point or an adjustment, and where
    they don't stand alone (`stands_alone`).
    """
    with open_project(path) as opened:
        members = opened.store.bundles_of([point]).get(point)
        if members is None or not is_solved(opened):
            return None
        bundle, adjustment = opened.store.bundle(members), _adjusted(opened, str(path))
        if opened.store.considered or not stands_alone(bundle.network):
            return None
        with errors_from(str(path)):
            return posterior_of(
                bundle.network, adjustment.settings, adjustment.values, bundle.places, adjustment.joint
            )  # fmt: skip


def _warning(solution: Solution) -> str:
    if solution.converged:
        return ""
    return f"The adjustment has NOT converged, so sigmas mean little: {solution.message}"


def _is_project(path: Path) -> bool:
    """Whether it is a project's folder; InputError for a folder that holds nothing of ours."""
    if not path.is_dir():
        return False
    if not (path / FILE).exists() and not (path / ARCHIVE).exists():
        found = f"a folder with neither {ARCHIVE} nor {FILE}"
        raise InputError(str(path), found, "results of `mgsgraph adjust`, or a project")
    return (path / FILE).exists()


def _adjusted(project: Project, where: str) -> IncrementalAdjustment:
    """The adjustment that a project holds; InputError for one that has never been solved."""
    if not project.store.image_names() or not is_solved(project):
        raise InputError(where, "a project without a solution", "an adjusted one", f"mgsgraph solve {where}")
    return incremental(project)

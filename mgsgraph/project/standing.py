"""What was adjusted, to be planned from and questioned: the results of an adjustment, or a kept project."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from mgsgraph.adjustment.solution import Solution
from mgsgraph.analysis.linearised import at_values
from mgsgraph.analysis.posterior import Posterior
from mgsgraph.errors import InputError
from mgsgraph.geometry.records import Array
from mgsgraph.incremental.incremental import IncrementalAdjustment
from mgsgraph.network import Network
from mgsgraph.network.parts import Unknown, unknowns
from mgsgraph.planning.standing import Standing, standing, standing_of
from mgsgraph.project.change import is_solved
from mgsgraph.project.connection import FILE
from mgsgraph.project.project import Project, open_project
from mgsgraph.reports.archive import ARCHIVE, read_solution

_Values = Mapping[Unknown, Array]


def read_standing(path: Path) -> tuple[str, Standing, str]:
    """Name and state of what was adjusted: a folder of results (or the archive in it), or a project's folder; and a
    warning where the adjustment has not converged, else an empty one.

    Raises
    ------
    InputError
        Neither of them; a project that has never been solved; a solution without covariance.
    """
    if _is_project(path):
        with open_project(path) as opened:
            network, values, places = _state(opened, str(path))
            settings = opened.settings.solver_settings
            return opened.name, standing(network, settings, values, places, *_taking_part(network, places)), ""
    solution = read_solution(path)
    return solution.name, standing_of(solution), _warning(solution)


def read_posterior(path: Path) -> tuple[str, Posterior, str]:
    """Name, posterior and warning of the same."""
    if _is_project(path):
        with open_project(path) as opened:
            network, values, places = _state(opened, str(path))
            every = [values.get(unknown, np.zeros(0)) for unknown in unknowns(network)]
            return opened.name, Posterior(at_values(network, opened.settings.solver_settings, every, places)), ""
    solution = read_solution(path)
    return solution.name, Posterior.of(solution), _warning(solution)


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


def _state(project: Project, where: str) -> tuple[Network, _Values, Array]:
    """Everything as one network, its shared unknowns, and the places (n, 3) in m of its points."""
    if not project.store.image_names() or not is_solved(project):
        raise InputError(where, "a project without a solution", "an adjusted one", f"mgsgraph solve {where}")
    adjustment = IncrementalAdjustment(project.settings.solver_settings, project.store)
    network = adjustment.network
    names, found, _ = adjustment.points()
    place = dict(zip(names, found, strict=True))
    return network, adjustment.values, np.array([place[name] for name in network.points.ids]).reshape(-1, 3)


def _taking_part(network: Network, places: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Rays and ranges that were not rejected, of points that have a place."""
    there, rays, ranges = np.isfinite(places[:, 0]), network.rays, network.ranges
    assert rays.rejected is not None
    assert ranges.rejected is not None
    return ~rays.rejected & there[rays.point], ~ranges.rejected & there[ranges.point]

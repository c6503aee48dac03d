"""Where the results of an adjustment are, and the case they come from: a folder's, a demonstration's, a project's."""

from pathlib import Path
from typing import NamedTuple

from mgsgraph.case.schema import decode
from mgsgraph.errors import InputError
from mgsgraph.project.connection import FILE
from mgsgraph.project.project import Project, open_project

_OWN_CASE = Path("inputs", "case.toml")
"""Where a demonstration's results hold their case."""
_NETWORK = "network.pvl"


class Results(NamedTuple):
    """Results, and where they come from."""

    folder: Path
    """Of the results (or their archive)."""
    case: Path | None = None
    """The case, where it is known and still there."""
    ties: Path | None = None
    """Tie points that take the place of the case's own."""
    warning: str = ""
    """What of the project is not in them; empty where all is."""


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
    later = [change for change in project.changes() if change.number > number and change.verb in ("add", "remove")]
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

"""Result folders are atomic: they are written beside their place and moved in one step."""

import errno
import os
import re
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from mgsgraph.atomic_write import is_aside, made_beside, put_in_place, resolved, sweep
from mgsgraph.errors import InputError, require
from mgsgraph.files.opening import read_json
from mgsgraph.files.writing import MATCH as MATCH  # makes a folder without any of the others matches by this program
from mgsgraph.files.writing import require_folder_above, require_writable

PROGRAM = "mgsgraph"
"""What `program` in solution.json says; by it a folder is known as ours."""
RECORD = "solution.json"
"""File that makes a folder a result of an adjustment by this program."""
REGISTRATION = "registration.json"
"""File that makes a folder without a solution a registration by this program."""
PLAN = "plan.json"
"""File that makes a folder without either a plan by this program."""
ANALYSIS = "analysis.json"
"""File that makes a folder without any of them an analysis by this program."""
NODES = "nodes.json"
"""File that makes a folder without any of them a study of orientation images by this program."""
DEM = "dem.json"
"""File that makes a folder without any of them a terrain model by this program."""
STAC_ITEM = "dem.stac.json"
"""Item of a STAC catalog beside it."""
COMPARISON = "comparison.json"
"""File that makes a folder without any of them a comparison of two solutions by this program."""
EXPORT = "export.json"
"""File that makes a folder without any of them an export by this program; it names all others."""
WITHOUT_LASER = "network_without_laser.net"
"""File of an export for ISIS: its network but for the points that are in lidar data, too."""
COREGISTRATION = "coregistration.json"
"""Record of a registration by relief, beside the solution that makes the folder a result."""

PROJECT = "project.sqlite"
"""File that makes a folder a project."""
DEMO = "demo.json"
"""File that makes a folder a demonstration by this program, results and all; it names the files of its case."""

_KINDS = (DEMO, RECORD, REGISTRATION, PLAN, ANALYSIS, NODES, MATCH, DEM, COMPARISON, EXPORT)
"""The first of these in a folder says of what kind its results are."""
TABLES = (
    DEMO, RECORD, "solution.npz", "summary.json", "points.csv", "points.parquet", "orientation.csv", "residuals.csv",
    "residuals.parquet", "connectivity.csv", "checkpoints.csv", "leave_out.csv",
    "shared.csv", "passes.csv", "drivers.csv", "report.html",
    "two_steps.txt", "two_steps.json", "two_steps.csv", "heights.csv", "height_cells.csv",  # of versions up to 0.2
    REGISTRATION, "registration.csv", "discrepancy.csv",
    PLAN, "plan.csv",
    ANALYSIS, "unexplained.csv", "vibrations.csv", "components.csv", "components_iterated.csv", "reliability.csv",
    "outliers.csv", "likelihood.csv", "sigmas.tif",
    NODES, "spacings.csv", "course.csv", "spectra.csv",  # the last two of versions up to 0.2
    EXPORT, MATCH, "matches.csv", "network.pvl", "network.net",
    DEM, "dem.tif", "ortho.tif", "ortho_sigma.tif", "shots.csv", STAC_ITEM,
    COMPARISON, "merit_compared.csv", "sigmas_compared.csv", "settings_compared.csv", "input_compared.csv",
    "images_compared.csv", "points_compared.csv",
    COREGISTRATION, "profiles.csv", "costs.csv", "disagreement.csv",
)  # fmt: skip
"""Files of results but for figures."""
FIGURES = (
    "residuals", "orientation", "passes", "pass", "strips", "registration", "map", "connectivity", "height_map",
    "overlay", "closeups", "discrepancy", "plan", "sigma_map", "quantiles", "unexplained", "vibrations", "spacings",
    "spectrum", "course", "matches", "dem", "costs", "profiles", "shifts", "story", "minima",
    "comparison", "overview_residuals", "overview_orientation", "overview_map",
)  # fmt: skip
"""Kinds of figures, .png, numbered where there are several (registration_1); earlier versions wrote .svg, and
overviews, too.
"""
_OURS = re.compile(
    "|".join(map(re.escape, TABLES))
    + rf"|({'|'.join(FIGURES)})(_\d+)?\.(png|svg)"
    + r"|sigmas_[A-Za-z0-9._-]+\.(csv|png|svg)"  # of one image, whose name is in it
)
"""Names of what results hold; a folder with anything else in it is not replaced."""
_ELSEWHERE = "choose another --out"
_REMEDIES = {
    errno.ENOSPC: "free some space, or choose another --out",
    errno.EDQUOT: "free some of your quota, or choose another --out",
    errno.EBUSY: "choose a folder inside it (nothing can be renamed onto a mount point)",
}


@contextmanager
def fresh_folder(path: str | Path, record: str = RECORD) -> Iterator[Path]:
    """Make a result folder.

    Inside the context everything is written to a new folder beside `path`; at its end that folder takes the place of
    `path`. On any exception it vanishes, and what was at `path` stays as it was.

    Parameters
    ----------
    path : path
        Absent, empty, or an earlier result of the same kind, which is replaced.
    record : str
        File by which results of this kind are known.

    Yields
    ------
    Path
        Where to write.

    Raises
    ------
    InputError
        If `path` holds anything else, or can't be written.
    """
    require_replaceable(path, record)
    target = resolved(path, _ELSEWHERE)
    try:
        with made_beside(target, folder=True) as temporary:
            yield temporary
            require_replaceable(path, record)
            _warn_of_unrelated_files(temporary, record)
            put_in_place(temporary, target)
    except OSError as error:
        raise _refusal(str(path), error) from None


def require_replaceable(path: str | Path, record: str = RECORD) -> None:
    """Raise InputError unless `path` is absent, an empty folder, or an earlier result known by the file `record`; to be
    asked before long work. What a killed process has left is repaired first.
    """
    shown, target = str(path), resolved(path, _ELSEWHERE)
    try:
        sweep(target.parent)
        if not target.exists():
            if Path(path).is_symlink():
                raise InputError(shown, "a link that leads nowhere", "a folder for the results", _ELSEWHERE)
            require_folder_above(target, shown, _ELSEWHERE)
            require_writable(next(parent for parent in target.parents if parent.exists()))
            return
        require(target.is_dir(), shown, "exists and is a file", "a folder for the results", _ELSEWHERE)
        if target in (Path.cwd(), *Path.cwd().parents):
            found = "is the folder you are in" if target == Path.cwd() else "holds the folder you are in"
            raise InputError(shown, f"{found}, and would be replaced", remedy=_ELSEWHERE)
        if any(target.iterdir()) and (kind := _kind(target)) != record:
            found = f"not a result of {PROGRAM}" if kind is None else f"another kind of result ({kind})"
            raise InputError(shown, f"exists and is {found}", remedy=_ELSEWHERE)
        for other in _unrelated_files(target)[:1]:
            found = f"an earlier result that holds {other!r}, too, which would be lost"
            raise InputError(shown, found, remedy="move that away, or choose another --out")
        require_writable(target.parent)
        require_writable(target)  # a folder that its owner has protected is not replaced
    except OSError as error:
        raise _refusal(shown, error) from None


def _warn_of_unrelated_files(folder: Path, record: str) -> None:
    """Warn where results hold a file that TABLES and FIGURES lack, which keeps the next ones from replacing them.

    Nothing is refused for it, for the work has been done; our tests, to which warnings are errors, stop there.
    """
    if record not in _KINDS or not (folder / record).exists():
        return
    for name in _unrelated_files(folder):
        warnings.warn(f"{name!r} is not a name that results are known to hold: see output.folders", stacklevel=2)


def _unrelated_files(folder: Path) -> list[str]:
    """Names in a folder of ours that no result has, in order; in folders of an export and a demonstration, too."""
    listed = _listed(folder)
    folders = {name.split("/")[0] for name in listed if "/" in name}
    names = {entry.name for entry in folder.iterdir() if not _OURS.fullmatch(entry.name)}
    within = (path for name in names & folders for path in (folder / name).rglob("*") if not path.is_dir())
    return sorted((names - folders | {path.relative_to(folder).as_posix() for path in within}) - listed)


def _listed(folder: Path) -> set[str]:
    """Files that an export or a demonstration lists as its own, in its folders too."""
    listed = set[str]()
    for record in (EXPORT, DEMO):
        names = _record(folder / record).get("files")
        listed |= {record, *map(str, names)} if isinstance(names, list) else set()
    return listed


def _kind(folder: Path) -> str | None:
    """The file by which a folder is known as a result, RECORD before others; None for a foreign folder."""
    return next((name for name in _KINDS if _record(folder / name).get("program") == PROGRAM), None)


def _record(path: Path) -> dict[str, Any]:
    """A record, perhaps of another program; empty for a file that is none."""
    try:
        return read_json(path)
    except InputError:
        return {}


def _refusal(shown: str, error: OSError) -> InputError:
    reason = error.strerror or str(error)
    name = Path(os.fsdecode(error.filename)).name if isinstance(error.filename, str | bytes) else ""
    inside = f" at {name}" if name and not is_aside(name) else ""
    remedy = _REMEDIES.get(error.errno or 0, "choose another --out, where you may write")
    return InputError(shown, f"can't be written ({reason}{inside})", remedy=remedy)

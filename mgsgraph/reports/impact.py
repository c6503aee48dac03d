"""The impact of a change as a CSV file: every point that moved, or that is new."""

from pathlib import Path

from mgsgraph.errors import InputError
from mgsgraph.incremental.impact import Impact
from mgsgraph.io.files import beside, fresh_file

_FIRST = "point,new,move_x_m,"
"""How every table of `Impact.points_table` begins as CSV: its first columns, by which an earlier one is known."""
_WRITABLE = "a file that may be written"


def require_writable(path: Path, project: Path) -> None:
    """Raise InputError unless the table may be made there: before a change, not after it.

    Nothing is overwritten but an earlier table of this kind, and nothing is written into the project's folder.
    """
    wanted = "a .csv file outside the project for the impact"
    if path.suffix.lower() != ".csv":
        raise InputError(str(path), "a name that doesn't end in .csv", wanted)
    if path.exists() and not path.is_file():
        raise InputError(str(path), "is no file", wanted)
    if not path.parent.is_dir():
        raise InputError(str(path), f"no folder {path.parent}", wanted, "make it first")
    if path.resolve().is_relative_to(project.resolve()):
        raise InputError(str(path), "lies in the project's folder", wanted)
    if path.is_file() and path.stat().st_size:
        with path.open("rb") as file:
            if not file.read(len(_FIRST)) == _FIRST.encode():
                raise InputError(str(path), "a file that is no earlier impact", wanted, "choose another name")
    trial = beside(path)
    try:
        trial.touch(exist_ok=False)
        trial.unlink()
    except OSError as error:
        raise InputError(str(path), f"can't be written ({error.strerror})", _WRITABLE) from None


def write_impact(impact: Impact, path: Path) -> None:
    """Write one row per point: name, whether new, move in m and in sigmas, sigmas before and after in m.

    Raises InputError if the file can't be written.
    """
    with fresh_file(path, _WRITABLE) as aside:
        impact.points_table().write_csv(aside)

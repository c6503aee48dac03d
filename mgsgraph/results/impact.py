"""The impact of a change as a CSV file: every point that moved, or that is new."""

from pathlib import Path

from mgsgraph.adjustment.incremental.impact import Impact
from mgsgraph.atomic_write import resolved
from mgsgraph.errors import InputError, require
from mgsgraph.files.writing import begins, fresh_file, require_free, writing_to
from mgsgraph.files.writing import require_writable as require_writable_folder

_IMPACT = begins("an earlier impact", "point,new,move_x_m,")
"""Tables of `Impact.points_table`, by their first columns."""
_WRITABLE = "a file that may be written"


def require_writable(path: Path, project: Path) -> None:
    """Raise InputError unless the table may be made there: before a change, not after it.

    Nothing is overwritten but an earlier table of this kind, and nothing is written into the project's folder.
    """
    expected = "a .csv file outside the project for the impact"
    require(path.suffix.lower() == ".csv", str(path), "a name that doesn't end in .csv", expected)
    require(not path.exists() or path.is_file(), str(path), "is no file", expected)
    require(path.parent.is_dir(), str(path), f"no folder {path.parent}", expected, "make it first")
    if resolved(path, "choose another name").is_relative_to(resolved(project, "")):
        raise InputError(str(path), "lies in the project's folder", expected)
    require_free(path, _IMPACT, expected)
    with writing_to(path, _WRITABLE):
        require_writable_folder(path.parent)


def write_impact(impact: Impact, path: Path) -> None:
    """Write one row per point: name, whether new, move in m and in sigmas, sigmas before and after in m.

    Raises InputError if the file can't be written.
    """
    with fresh_file(path, _WRITABLE, over=_IMPACT) as temporary:
        impact.points_table().write_csv(temporary)

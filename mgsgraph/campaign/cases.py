"""Which case files a campaign has, and the folder of each one's results."""

import os
from collections import Counter
from collections.abc import Iterable, Mapping
from pathlib import Path

from mgsgraph.errors import InputError

SUFFIX = ".toml"
_PLAIN = "case"
"""Stem of a case file that says nothing; its folder's name is taken instead."""
_JOINT = "-"


def find_cases(given: Iterable[Path], out: Path) -> tuple[Path, ...]:
    """Case files, resolved and without doubles, in the order in which they were given.

    Parameters
    ----------
    given : iterable of Path
        Case files, and folders of which every ``*.toml`` at any depth is one; what is hidden is left out.
    out : Path
        Folder of the results, which is left out, too: a demonstration's results hold case files of their own.

    Raises
    ------
    InputError
        Something that isn't there, or a folder without case files.
    """
    found: dict[Path, None] = {}
    for path in given:
        if path.is_dir():
            inside = _walk(path, out.resolve())
            if not inside:
                raise InputError(str(path), f"no case file (*{SUFFIX}) in this folder", "at least one")
            found.update(dict.fromkeys(inside))
        elif path.exists():
            found[path.resolve()] = None
        else:
            raise InputError(str(path), "no such file or folder", "case files, or folders of them")
    return tuple(found)


def _walk(folder: Path, out: Path) -> list[Path]:
    found = []
    for place, folders, files in os.walk(folder):
        folders[:] = sorted(name for name in folders if not name.startswith(".") and Path(place, name).resolve() != out)
        found += [
            Path(place, name).resolve() for name in sorted(files) if name.endswith(SUFFIX) and not name.startswith(".")
        ]
    return found


def result_folders(cases: Iterable[Path], taken: Mapping[Path, str]) -> dict[Path, str]:
    """Name of the folder of each case's results: the shortest end of its path that no other case has.

    ``sites/eos.toml`` gives ``eos``, ``sites/eos/case.toml`` as well; with ``a/eos.toml`` and ``b/eos.toml`` both
    grow: ``a-eos`` and ``b-eos``.

    Parameters
    ----------
    cases : iterable of Path
        Resolved.
    taken : mapping of Path to str
        Names that were given earlier; they stay.
    """
    names = dict(taken)
    ends = {case: _parts(case) for case in cases if case not in taken}
    lengths = dict.fromkeys(ends, 1)
    while True:
        tried = {case: _JOINT.join(parts[-lengths[case] :]) for case, parts in ends.items()}
        counts = Counter([*tried.values(), *taken.values()])
        longer = [case for case, name in tried.items() if counts[name] > 1 and lengths[case] < len(ends[case])]
        if not longer:
            break
        for case in longer:
            lengths[case] += 1
    for case, name in tried.items():
        if counts[name] > 1:
            other = next(path for path, its in (names | tried).items() if its == name and path != case)
            raise InputError(str(case), f"its results would go to {name!r}, like those of {other}", "another file name")
    return names | tried


def _parts(case: Path) -> tuple[str, ...]:
    """Folders and stem of a case file's path, without a stem that says nothing."""
    parts = tuple(part for part in case.parent.parts if part != case.anchor)
    return parts if case.stem == _PLAIN and parts else (*parts, case.stem)

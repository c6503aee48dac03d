"""Case files of a campaign, the folder of each one's results, and the checksums of all files that a case names."""

import os
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from functools import cache
from pathlib import Path

from mgsgraph.atomic_write import resolved
from mgsgraph.case.case_file import decode
from mgsgraph.case.schema import CaseInput
from mgsgraph.case.terrain import count_files
from mgsgraph.errors import InputError
from mgsgraph.files.opening import sha256_of
from mgsgraph.sandbox import read_apart

SUFFIX = ".toml"
_ELSEWHERE, _MEND = "choose another --out", "take it away"
_PLAIN = "case"
"""Stem of a case file that says nothing; its folder's name is taken instead."""
_JOINT = "-"
_BESIDE = (".lbl", ".img", ".imq", ".cub", ".pvl", ".isd", ".json")
"""Endings of files that belong together: a label, and the pixels, posts or tables that it describes."""


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
            inside = _walk(path, resolved(out, _ELSEWHERE))
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
        seen = [name for name in sorted(folders) if not name.startswith(".")]
        folders[:] = [name for name in seen if resolved(Path(place, name), _MEND) != out]
        cases = [name for name in sorted(files) if name.endswith(SUFFIX) and not name.startswith(".")]
        found += [resolved(Path(place, name), _MEND) for name in cases]
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


def checksums(case: Path) -> dict[str, str | None]:
    """SHA-256 of a case file and of every file that it names, by path as the case writes it; None for what can't be
    read. Of a case file that can't be understood there is only its own.
    """
    sums = {case.name: _checksum(case)}
    try:
        wanted = decode(case)
    except InputError:
        return sums
    for name in dict.fromkeys(_named(wanted, case.parent)):
        sums[name] = _checksum(case.parent / name)
        sums |= {os.path.relpath(other, case.parent): _checksum(other) for other in _described(case.parent / name)}
    for name in dict.fromkeys(_kernels(wanted)):
        sums[name] = _checksum(case.parent / name)
        sums |= {os.path.relpath(other, case.parent): _checksum(other) for other in _listed(case.parent / name)}
    return sums


def _named(wanted: CaseInput, folder: Path) -> Iterator[str]:
    """Every path in a case file, which lies in a folder, but those of kernels."""
    for image in wanted.images:
        times = None if image.line_times == "mean" else image.line_times
        files = image.isd, image.label, image.cube, image.state, image.pixels, times
        yield from (name for name in files if name is not None)
    yield from (group.network for group in wanted.tie_groups)
    if wanted.ground_control is not None:
        yield wanted.ground_control.file
    yield from (group.file for group in wanted.laser_groups)
    yield from (profile.file for profile in wanted.shots)
    yield from (cloud.file for cloud in wanted.altimetry)
    for terrain in wanted.terrain_models:
        for several in (terrain.radius, terrain.tracks):
            yield from (several,) if isinstance(several, str) else several
        yield from (name for name in (terrain.topography, terrain.areoid) if name is not None)
        yield from () if terrain.counts is True else count_files(terrain, folder)


def _kernels(wanted: CaseInput) -> Iterator[str]:
    for image in wanted.images:
        yield from image.kernels
    if wanted.spice is not None:
        yield from wanted.spice.kernels


def _described(path: Path) -> list[Path]:
    """A label and the files that it describes are read together though only one of them is named."""
    if path.suffix.lower() not in _BESIDE or not path.parent.is_dir():
        return []
    return [
        other
        for other in sorted(path.parent.iterdir())
        if other.name != path.name and other.stem.lower() == path.stem.lower() and other.suffix.lower() in _BESIDE
    ]


def _listed(kernel: Path) -> list[Path]:
    """Kernels that a meta-kernel lists."""
    from mgsgraph.files.spice.kernels import (
        members,  # SPICE takes its time to load; only those who need it wait
    )

    here, path = Path.cwd(), kernel.absolute()
    try:
        found = read_apart(lambda: members(path, here), str(kernel), "a SPICE kernel", "fetch it again")
        return [member for member in found if member != path]
    except InputError:
        return []  # reading the case will say what is wrong


def _checksum(path: Path) -> str | None:
    try:
        state = path.stat()
        return _of_content(path.resolve(), state.st_size, state.st_mtime_ns)
    except (OSError, InputError):
        return None


@cache
def _of_content(path: Path, size: int, changed: int) -> str:
    """SHA-256 of a file; kernels and terrain models that many cases share are read once."""
    return sha256_of(path)

"""What a case is made from: its file and all files that it names, with their checksums."""

import os
from collections.abc import Iterator
from functools import cache
from pathlib import Path

from mgsgraph.case.schema import CaseInput, decode
from mgsgraph.errors import InputError
from mgsgraph.io.files import sha256_of

_BESIDE = (".lbl", ".img", ".imq", ".cub")
"""Endings of files that belong together: a label, and the pixels or posts that it describes."""


def checksums(case: Path) -> dict[str, str | None]:
    """SHA-256 of a case file and of every file that it names, by path as the case writes it; None for what can't be
    read. Of a case file that can't be understood there is only its own.
    """
    sums = {case.name: _checksum(case)}
    try:
        wanted = decode(case)
    except InputError:
        return sums
    for name in dict.fromkeys(_named(wanted)):
        sums[name] = _checksum(case.parent / name)
        sums |= {os.path.relpath(other, case.parent): _checksum(other) for other in _described(case.parent / name)}
    for name in dict.fromkeys(_kernels(wanted)):
        sums[name] = _checksum(case.parent / name)
        sums |= {os.path.relpath(other, case.parent): _checksum(other) for other in _listed(case.parent / name)}
    return sums


def _named(wanted: CaseInput) -> Iterator[str]:
    """Every path in a case file but those of kernels."""
    for image in wanted.images:
        times = None if image.line_times == "mean" else image.line_times
        yield from (name for name in (image.isd, image.label, image.cube, image.pixels, times) if name is not None)
    yield from (group.network for group in wanted.tie_groups)
    if wanted.ground_control is not None:
        yield wanted.ground_control.file
    yield from (group.file for group in wanted.laser_groups)
    for profile in wanted.mola:
        yield profile.pedr
        yield from (name for name in (profile.leap_seconds,) if name is not None)
    if wanted.terrain is not None:
        terrain = wanted.terrain
        for several in (terrain.radius, terrain.tracks):
            yield from (several,) if isinstance(several, str) else several
        others = (terrain.topography, terrain.areoid, terrain.leap_seconds)
        yield from (name for name in others if name is not None)


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
    from mgsgraph.io.kernel_contents import members  # SPICE takes its time to load; only those who need it wait

    try:
        return [member for member in members(kernel) if member != kernel]
    except InputError:
        return []  # reading the case will say what is wrong


def _checksum(path: Path) -> str | None:
    try:
        state = path.stat()
        return _of_content(path.resolve(), state.st_size, state.st_mtime_ns)
    except OSError:
        return None


@cache
def _of_content(path: Path, size: int, changed: int) -> str:
    """SHA-256 of a file; kernels and terrain models that many cases share are read once."""
    return sha256_of(path)

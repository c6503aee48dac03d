"""Names of match files, PREFIX-IMAGE1__IMAGE2.match: the two images in one, and the file of two images.

Images go by their files' names without folder and ending. Sources: StereoPipeline, docs, "Match file naming
convention"; VisionWorkbench, src/vw/InterestPoint/MatcherIO.cc, strip_path and match_filename.
"""

from collections.abc import Collection
from itertools import combinations, product
from pathlib import Path

from mgsgraph.errors import InputError
from mgsgraph.files.networks.asp_measures import RENAME

_BETWEEN = "__"
_CLEAN = "-clean"
"""Ends the names of files from which bundle_adjust has taken the outliers."""
_LONGEST = 255
"""bytes of a file's name; the pipeline puts a hash into longer ones (since 2026), or cuts them (before)."""
_FORM = "PREFIX-IMAGE1__IMAGE2"


def stem(image: str) -> str:
    """An image's name without folder and ending."""
    name = image.rsplit("/", 1)[-1]
    return name.rpartition(".")[0] or name


def images_of(path: Path, known: Collection[str] = (), prefix: str | None = None) -> tuple[str, str]:
    """The two images of a match file, by its name.

    Parameters
    ----------
    path : Path
        Match file, binary or text.
    known : collection of str
        All images there are; the name is then taken apart by theirs.
    prefix : str, optional
        What precedes the first image, without the hyphen; empty for nothing. A folder before it counts for nothing.

    Raises
    ------
    InputError
        If the name is not of this form, or can be taken apart in several ways: hyphens may be of the prefix or of the
        first image, and there is no telling.
    """
    names = [path.stem.removesuffix(_CLEAN), path.stem]
    if known:  # one of them may itself be called so
        names.reverse()
    found = _readings(names[0], known, prefix) or _readings(names[1], known, prefix)
    if len(found) == 1:
        return found[0]
    if not found:
        if known:
            raise InputError(str(path), "a file's name without two of the images", _FORM, f"they are {_few(known)}")
        expected = _FORM if prefix is None else f"{prefix}-IMAGE1__IMAGE2"
        raise InputError(str(path), "a file's name that doesn't tell the images", expected)
    several = ", or ".join(" and ".join(pair) for pair in found[:3])
    raise InputError(str(path), f"its images may be {several}", "one reading", "say --prefix, or give the --case")


def _few(names: Collection[str]) -> str:
    return ", ".join(list(names)[:4]) + (", ..." if len(names) > 4 else "")


def _readings(name: str, known: Collection[str], prefix: str | None) -> list[tuple[str, str]]:
    """All ways to take a name apart."""
    of_stems: dict[str, list[str]] = {}
    for image in known:
        of_stems.setdefault(stem(image), []).append(image)
    readings = []
    for k in range(1, len(name) - len(_BETWEEN)):
        if not name.startswith(_BETWEEN, k):
            continue
        second = name[k + len(_BETWEEN) :]
        for first in _heads(name[:k], prefix, bool(known)):
            if not known:
                readings.append((first, second))
            else:
                readings += product(of_stems.get(first, ()), of_stems.get(second, ()))
    return [pair for pair in readings if pair[0] != pair[1]]


def _heads(head: str, prefix: str | None, known: bool) -> list[str]:
    """What may be the first image: all that follows a hyphen, or the whole where there is none, or where images are
    known, so that a wrong one does no harm.
    """
    if prefix is not None:
        start = f"{prefix.rsplit('/', 1)[-1]}-" if prefix else ""
        return [head[len(start) :]] if head.startswith(start) and len(head) > len(start) else []
    heads = [head[k + 1 :] for k, mark in enumerate(head) if mark == "-" and head[k + 1 :]]
    return [head, *heads] if known or not heads else heads


def require_distinct(images: Collection[str]) -> None:
    """Raise InputError where images can't be told apart by their names in match files."""
    stems = dict[str, str]()
    for image in images:
        name = stem(image)
        if not name or "\0" in name:
            raise InputError(f"image {image!r}", "a name that no file can have", remedy=RENAME)
        if stems.setdefault(name, image) != image:
            found = f"the same name as {stems[name]} without folder and ending ({name})"
            raise InputError(f"image {image}", found, "a name of its own in match files", RENAME)


def match_path(prefix: Path, first: str, second: str, ending: str) -> Path:
    """File of the matches of two images; InputError if its name is too long."""
    name = f"{prefix.name}-{stem(first)}{_BETWEEN}{stem(second)}{ending}"
    if len(name.encode()) > _LONGEST:
        raise InputError(name, f"a name of {len(name.encode())} bytes", f"at most {_LONGEST}", RENAME)
    return prefix.with_name(name)


def prefix_of(output: Path, images: Collection[str]) -> Path:
    """What match files written for `output` begin with: its name without its ending, and without a pair of images."""
    name = output.stem
    for first, second in combinations(images, 2):
        if (pair := f"-{stem(first)}{_BETWEEN}{stem(second)}") and name.endswith(pair):
            return output.with_name(name.removesuffix(pair))
    return output.with_name(name)

"""Images as a command names them: of a case with their nominal orientation, of results or a project as adjusted."""

from pathlib import Path
from typing import NamedTuple

from mgsgraph.case.case_file import decode
from mgsgraph.case.images import read_images
from mgsgraph.case.strips import members
from mgsgraph.errors import InputError
from mgsgraph.geometry.image import PushbroomImage
from mgsgraph.project.connection import FILE
from mgsgraph.project.reading import results_of
from mgsgraph.registration.footprints import Corrections
from mgsgraph.reports.archive import ARCHIVE, read_solution


class OrientedImages(NamedTuple):
    """Images with corrections of their orientation."""

    images: tuple[PushbroomImage, ...]
    """(m)."""
    corrections: Corrections
    """(m), None for the nominal orientation."""
    warning: str = ""
    """What is to be said of them."""


def oriented_images(path: Path, names: tuple[str, ...] = ()) -> OrientedImages:
    """Images of a case file, a folder of results (or their archive) or a project; some by their names, or all.

    Raises
    ------
    InputError
        A name that no image has, or several times; what `decode` and `read_solution` refuse.
    """
    if (path / FILE).is_file() or (path / ARCHIVE).is_file() or path.suffix == ".npz":
        results = results_of(path)
        solution = read_solution(results.folder)
        found = OrientedImages(
            tuple(solution.image(j) for j in range(len(solution.network.images))),
            [solution.correction(j) for j in range(len(solution.network.images))],
            results.warning if solution.converged else f"The adjustment has NOT converged: {solution.message}",
        )
    else:
        wanted = decode(path)
        known = [image.name for image in wanted.images]
        images, _ = read_images(wanted, wanted.orientations, members(wanted.strips, known, str(path)), path)
        found = OrientedImages(images, [None] * len(images))
    if not names:
        return found
    known = [image.name for image in found.images]
    for name in names:
        if name not in known:
            raise InputError(str(path), f"no image {name!r}", f"one of its images: {', '.join(known[:4])}")
    rows = [known.index(name) for name in dict.fromkeys(names)]
    return OrientedImages(
        tuple(found.images[j] for j in rows), [found.corrections[j] for j in rows], found.warning
    )

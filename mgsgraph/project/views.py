"""An image as a command names it: of a case with its nominal orientation, of results or a project as adjusted."""

from collections.abc import Sequence
from difflib import get_close_matches
from pathlib import Path
from typing import NamedTuple

from mgsgraph.analysis.places import View
from mgsgraph.case.case_file import decode
from mgsgraph.case.images import read_image
from mgsgraph.case.reading import terrain_shots
from mgsgraph.case.schema import CaseInput, TerrainInput
from mgsgraph.case.terrain import as_grid, read_terrain_model
from mgsgraph.errors import InputError
from mgsgraph.geometry.image import PushbroomImage
from mgsgraph.geometry.terrain import TerrainGrid
from mgsgraph.project.connection import FILE
from mgsgraph.project.reading import results_of
from mgsgraph.reports.archive import ARCHIVE, read_solution


class Scene(NamedTuple):
    """An image, and the ground that it is to be projected onto."""

    view: View
    """The image."""
    terrain: TerrainGrid | None
    """A terrain model; None for the ellipsoid."""
    warning: str = ""
    """What is to be said of it."""


def open_view(
    path: Path, image: str, terrain: Path | bool = True, reference_radius: float | None = None
) -> Scene:
    """An image by its name, or by a part of its name that no other has, and its terrain.

    Parameters
    ----------
    path : Path
        Case file, folder of results (or their archive), or project.
    image : str
        Its name.
    terrain : Path or bool
        A terrain model's file; True: that of the case or the results, if they have one; False: none.
    reference_radius : float, optional
        m, above which the heights of that file are.

    Raises
    ------
    InputError
        An image that isn't there; what `read_case` and `read_solution` refuse.
    """
    if (path / FILE).is_file() or (path / ARCHIVE).is_file() or path.suffix == ".npz":
        results = results_of(path)
        solution = read_solution(results.folder)
        view = View.adjusted(solution, _number([one.name for one in solution.network.images], image, path))
        surface = solution.network.surface
        grid = surface.grid if terrain is True and surface is not None else None
        warning = results.warning
        if not solution.converged:
            warning = f"The adjustment has NOT converged: {solution.message}"
    else:
        wanted = decode(path)
        number = _number([one.name for one in wanted.images], image, path)
        picture = read_image(wanted.images[number], wanted.spice, path.parent, f"{path}, images[{number}]")
        view, warning = View(wanted.orientations[number].nominal_of(picture)[0]), ""
        grid = _terrain(wanted, path, [view.image]) if terrain is True else None
    if isinstance(terrain, Path):
        entry = TerrainInput(radius=str(Path.cwd() / terrain), reference_radius_m=reference_radius)
        grid = as_grid(read_terrain_model(entry, terrain, [view.image], terrain_shots(entry))[0])
    return Scene(view, grid, warning)


def _terrain(wanted: CaseInput, path: Path, images: Sequence[PushbroomImage]) -> TerrainGrid | None:
    for entry in wanted.terrain_models[:1]:
        return as_grid(read_terrain_model(entry, path, images, terrain_shots(entry))[0])
    return None


def _number(names: Sequence[str], image: str, path: Path) -> int:
    """The image of this name, or the only one that has it as a part of its name."""
    found = [k for k, name in enumerate(names) if name == image] or [k for k, name in enumerate(names) if image in name]
    if len(found) == 1:
        return found[0]
    near = [names[k] for k in found] or get_close_matches(image, names, n=3, cutoff=0.3) or names
    what = f"{len(found)} images that {image!r} may be" if found else f"no image {image!r}"
    raise InputError(str(path), what, f"one of its images: {', '.join(near[:4])}")

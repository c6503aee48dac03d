"""An image as a command names it: of a case with its nominal orientation, of results or a project as adjusted."""

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from mgsgraph.analysis.places import View
from mgsgraph.case.reading import terrain_shots
from mgsgraph.case.schema import CaseInput, TerrainInput
from mgsgraph.case.terrain import as_grid, read_terrain_model
from mgsgraph.geometry.image import PushbroomImage
from mgsgraph.geometry.terrain import TerrainGrid
from mgsgraph.project.oriented import oriented_images


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
    seen = oriented_images(path, (image,))
    (view,) = seen.views
    grid: TerrainGrid | None = None
    if terrain is True and seen.case is not None:
        grid = _terrain(seen.case, path, seen.images)
    elif terrain is True and view.solution is not None and view.solution.network.surface is not None:
        grid = view.solution.network.surface.grid
    if isinstance(terrain, Path):
        entry = TerrainInput(radius=str(Path.cwd() / terrain), reference_radius_m=reference_radius)
        grid = as_grid(read_terrain_model(entry, terrain, [view.image], terrain_shots(entry))[0])
    return Scene(view, grid, seen.warning)


def _terrain(wanted: CaseInput, path: Path, images: Sequence[PushbroomImage]) -> TerrainGrid | None:
    for entry in wanted.terrain_models[:1]:
        return as_grid(read_terrain_model(entry, path, images, terrain_shots(entry))[0])
    return None

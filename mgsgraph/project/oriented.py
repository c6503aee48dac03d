"""Images as a command names them: of a case with their nominal orientation, of results or a project as adjusted."""

from collections.abc import Sequence
from difflib import get_close_matches
from pathlib import Path
from typing import NamedTuple

from mgsgraph.analysis.places import View
from mgsgraph.case.case_file import decode
from mgsgraph.case.images import read_image, read_images
from mgsgraph.case.passes import members
from mgsgraph.case.reading import terrain_shots
from mgsgraph.case.schema import CaseInput, TerrainInput
from mgsgraph.case.terrain import as_grid, read_terrain_model
from mgsgraph.errors import InputError
from mgsgraph.geometry.image import PushbroomImage
from mgsgraph.geometry.terrain import TerrainGrid
from mgsgraph.network.footprints import Corrections
from mgsgraph.project.connection import FILE
from mgsgraph.project.reading import results_of
from mgsgraph.results.archive import ARCHIVE, read_solution


class OrientedImages(NamedTuple):
    """Images with the orientation that is believed."""

    views: tuple[View, ...]
    """(m)."""
    warning: str = ""
    """What is to be said of them."""
    case: CaseInput | None = None
    """The case that they are of; None of results."""

    @property
    def images(self) -> tuple[PushbroomImage, ...]:
        """(m) their geometry."""
        return tuple(view.image for view in self.views)

    @property
    def corrections(self) -> Corrections:
        """(m) of their nominal orientation."""
        return [view.correction for view in self.views]


def oriented_images(path: Path, names: Sequence[str] = ()) -> OrientedImages:
    """Images of a case file, a folder of results (or their archive) or a project; all, or some by their names or parts
    of names that no other has: of a case only these are read then.

    Raises
    ------
    InputError
        A name that no image has, or several; what `decode` and `read_solution` refuse.
    """
    if (path / FILE).is_file() or (path / ARCHIVE).is_file() or path.suffix == ".npz":
        results = results_of(path)
        solution = read_solution(results.folder)
        chosen = _chosen([image.name for image in solution.network.images], names, path)
        warning = results.warning if solution.converged else f"The adjustment has NOT converged: {solution.message}"
        return OrientedImages(tuple(View.adjusted(solution, j) for j in chosen), warning)
    wanted = decode(path)
    known = [image.name for image in wanted.images]
    if names:
        images = [_alone(wanted, j, path) for j in _chosen(known, names, path)]
    else:
        images = [*read_images(wanted, wanted.orientations, members(wanted.passes, known, str(path)), path)]
    return OrientedImages(tuple(map(View, images)), case=wanted)


def _alone(wanted: CaseInput, number: int, path: Path) -> PushbroomImage:
    image = read_image(wanted.images[number], wanted.spice, path.parent, f"{path}, images[{number}]")
    return wanted.orientations[number].nominal_of(image)


def _chosen(known: Sequence[str], names: Sequence[str], path: Path) -> list[int]:
    """Numbers of the images of these names, each once; of all where there are none."""
    return list(dict.fromkeys(_number(known, name, path) for name in names)) if names else list(range(len(known)))


def _number(names: Sequence[str], image: str, path: Path) -> int:
    """The image of this name, or the only one that has it as a part of its name."""
    found = [k for k, name in enumerate(names) if name == image] or [k for k, name in enumerate(names) if image in name]
    if len(found) == 1:
        return found[0]
    near = [names[k] for k in found] or get_close_matches(image, names, n=3, cutoff=0.3) or names
    what = f"{len(found)} images that {image!r} may be" if found else f"no image {image!r}"
    raise InputError(str(path), what, f"one of its images: {', '.join(near[:4])}")


def open_view(
    path: Path, image: str, terrain: Path | bool = True, reference_radius: float | None = None
) -> tuple[View, TerrainGrid | None, str]:
    """An image by its name, or by a part of its name that no other has, the ground that it is to be projected onto
    (None for the ellipsoid), and what is to be said of it.

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
    entries = seen.case.terrain_models[:1] if terrain is True and seen.case is not None else ()
    if isinstance(terrain, Path):
        entries = (TerrainInput(radius=str(Path.cwd() / terrain), reference_radius_m=reference_radius),)
        path = terrain
    for entry in entries:
        return view, as_grid(read_terrain_model(entry, path, seen.images, terrain_shots(entry))[0]), seen.warning
    surface = view.solution.network.surface if terrain is True and view.solution is not None else None
    return view, None if surface is None else surface.grid, seen.warning

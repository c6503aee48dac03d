"""The terrain model of a case: grids and their tiles, heights above a sphere or the areoid, tracks of an altimeter."""

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from mgsgraph.case.schema import TerrainInput
from mgsgraph.errors import InputError
from mgsgraph.geometry.altimetry import AltimeterShots
from mgsgraph.geometry.image import PushbroomImage
from mgsgraph.geometry.records import Array
from mgsgraph.geometry.terrain import TerrainGrid, TerrainKind, areoid_grid
from mgsgraph.geometry.terrain_grids import above_areoid, mosaic
from mgsgraph.units import DEG

_EDGES = 65
"""Lines of each image at whose edges and middle its ground is taken."""
_MEGDR: dict[TerrainKind, str] = {"radius": "megr", "topography": "megt", "areoid": "mega"}
"""How MEGDR's files of each kind begin."""
_BEYOND = 8000.0
"""m, of a terrain model kept beside the ellipsoid's points under the images."""


def read_terrain_model(
    entry: TerrainInput, where: Path, images: Sequence[PushbroomImage], tracks: Callable[[Path], AltimeterShots]
) -> tuple[TerrainGrid, TerrainGrid | None]:
    """Radii, and the areoid, where it is known.

    Parameters
    ----------
    entry : TerrainInput
    where : Path
        The case file, to whose folder paths are relative.
    images : sequence of PushbroomImage
        Under whose ground tracks are triangulated.
    tracks : callable
        Reads a file of shots.
    """
    folder, place = where.parent, f"{where}, terrain"
    if bool(entry.grids) == bool(entry.profiles):
        found = "both radius and tracks" if entry.grids else "neither radius nor tracks"
        raise InputError(place, found, "one of them")
    if entry.areoid is not None:
        for other in ("topography", "reference_radius_m", "tracks"):
            if getattr(entry, other):
                raise InputError(place, f"both areoid and {other}", "heights above one reference")
    if entry.profiles:
        radii = _of_tracks(entry, folder, images, tracks)
    else:
        kind: TerrainKind = "topography" if entry.areoid is not None else "radius"
        radii = mosaic([_read_grid(folder / name, entry, kind) for name in entry.grids])
    areoid = None
    if entry.areoid is not None:
        areoid = _read_grid(folder / entry.areoid, entry, "areoid")
        radii = above_areoid(radii, areoid)
    elif entry.topography is not None:
        areoid = areoid_grid(radii, _read_grid(folder / entry.topography, entry, "topography"))
    return radii, areoid


def _read_grid(path: Path, entry: TerrainInput, kind: TerrainKind) -> TerrainGrid:
    from mgsgraph.io.megdr import read_megdr
    from mgsgraph.io.terrain_file import read_terrain

    sigmas = entry.vertical_sigma_m, entry.planimetric_sigma_m
    if path.suffix.lower() in (".img", ".lbl"):
        grid = read_megdr(path, *sigmas)
        if grid.kind != kind:
            raise InputError(str(path), f"a grid of {grid.kind}", f"one of {kind}", f"MEGDR's {_MEGDR[kind]} files")
        return grid
    return read_terrain(path, entry.reference_radius_m if kind == "radius" else None, kind, *sigmas)


def _of_tracks(
    entry: TerrainInput, folder: Path, images: Sequence[PushbroomImage], tracks: Callable[[Path], AltimeterShots]
) -> TerrainGrid:
    from mgsgraph.geometry.track_terrain import track_terrain  # scipy.spatial takes its time to load

    shots = [tracks(folder / name) for name in entry.profiles]
    return track_terrain(
        shots, _ground(images), entry.longest_edge_m, entry.post_step_deg * DEG, entry.vertical_sigma_m,
        entry.planimetric_sigma_m,
    )  # fmt: skip


def under_images(grid: TerrainGrid, images: Sequence[PushbroomImage]) -> TerrainGrid:
    """The part of a grid under images, and as far beyond as their heights and orientation may be wrong."""
    return grid.around(_ground(images), int(np.ceil(_BEYOND / (images[0].body.equatorial * grid.latitude_step))))


def _ground(images: Sequence[PushbroomImage]) -> Array:
    """(n, 3) m, on the ellipsoid, edges and middle of the images; NaN where they look past the body."""
    parts = []
    for image in images:
        lines, samples = np.meshgrid(np.linspace(0.0, image.lines, _EDGES), np.linspace(0.0, image.samples, 3))
        parts.append(image.image_to_ground(lines.ravel(), samples.ravel())[0])
    return np.concatenate(parts)

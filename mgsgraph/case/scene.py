"""A case's images with their pixels over its ground, to be matched; ties may be missing."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from mgsgraph.case.case_file import decode, read_images
from mgsgraph.case.passes import members
from mgsgraph.case.reading import picture_of, read_profile
from mgsgraph.case.schema import CaseInput
from mgsgraph.case.terrain import as_grid, ground_seen, read_terrain_model
from mgsgraph.errors import InputError, require
from mgsgraph.files.altimetry.lidar import read_lidar
from mgsgraph.files.rasters.pictures import read_picture
from mgsgraph.geometry.body import ellipsoidal_heights
from mgsgraph.geometry.image import PushbroomImage
from mgsgraph.geometry.orientation import OrientationPrior
from mgsgraph.geometry.records import Array, finite_rows
from mgsgraph.geometry.terrain import TerrainGrid
from mgsgraph.matching.scene import Ground, GroundChart, Picture, Scene

_ABOUT_MODEL = 100.0
"""m, by how much the ground may leave a terrain model, of MOLA's kind, between its posts."""
_LEAST_SIGMA = 100.0
"""m, the same of the mean height of laser shots."""


def read_scene(
    path: str | Path, height: float | None = None, height_sigma: float | None = None
) -> tuple[str, Scene]:
    """Read what `mgsgraph match` needs of a case: images, pixels, priors, and the ground.

    Parameters
    ----------
    path : path
        Case file; its ties are not looked at.
    height : float, optional
        m above the ellipsoid, of the ground where no terrain model says it; the mean of the case's laser shots when
        absent.
    height_sigma : float, optional
        m, by how much the ground may be higher or lower.

    Returns
    -------
    name : str
        What the case is called.
    scene : Scene

    Raises
    ------
    InputError
        As `read_case`; an image without pixels; no height of the ground.

    Examples
    --------
    >>> name, scene = mgsgraph.read_scene("gusev/case.toml")
    >>> name, [picture.pixels.shape for picture in scene.pictures]
    ('Gusev Crater', [(300, 1024), (300, 1024)])
    """
    path = Path(path)
    _require_sound(height, height_sigma)
    tables = decode(path)
    names = [image.name for image in tables.images]
    require(len(tables.images) >= 2, str(path), "one image", "two that overlap, at least")
    of_passes = members(tables.passes, names, str(path))
    images = read_images(tables, tables.orientations, of_passes, path)
    priors = image_priors(tables, of_passes, images, path)
    pictures = tuple(
        Picture(image, read_picture(picture_file(tables, j, path)), prior)
        for j, (image, prior) in enumerate(zip(images, priors, strict=True))
    )
    return tables.name, Scene(pictures, _ground(tables, images, path, height, height_sigma))


def _require_sound(height: float | None, height_sigma: float | None) -> None:
    require(height is None or np.isfinite(height), "height of the ground", f"{height}", "metres above the ellipsoid")
    if height_sigma is not None and not 0.0 < height_sigma < np.inf:
        raise InputError("sigma of the ground's height", f"{height_sigma}", "a positive number of metres")


def picture_file(tables: CaseInput, image: int, path: Path) -> Path:
    """File of an image's pixels; InputError where the case at `path` names none."""
    file = picture_of(tables.images[image], path.parent)
    if file is None:
        where = f"{path}, image {tables.images[image].name}"
        raise InputError(where, "no pixels", 'pixels = "FILE" (ISIS cube, GeoTIFF, PDS image)', "add it to [[images]]")
    return file


def image_priors(
    tables: CaseInput, of_passes: Sequence[Sequence[int]], images: Sequence[PushbroomImage], path: Path
) -> list[OrientationPrior]:
    """Prior of each image; an image of a pass has the prior of the pass."""
    priors, entries = list(tables.priors(str(path), images)), tables.passes
    for k, (entry, of_pass) in enumerate(zip(entries, of_passes, strict=True)):
        for j in of_pass:
            default = tables.orientation.prior(f"{path}, orientation", images[j].mission)
            priors[j] = entry.image_prior(f"{path}, passes[{k}]", default)
    return priors


def _ground(
    tables: CaseInput, images: Sequence[PushbroomImage], path: Path, height: float | None, height_sigma: float | None
) -> Ground:
    body = images[0].body
    terrain: TerrainGrid | None = None
    for model in tables.terrain_models[:1]:
        terrain = as_grid(read_terrain_model(model, path, images)[0])
    chart = _chart(images, height or 0.0)
    heights = _heights(tables, images, path, terrain) if height is None else np.array([height])
    require(
        heights.size, str(path), "neither a terrain model nor laser shots under the images",
        "the height of their ground", "add [terrain], or give --height METRES",
    )  # fmt: skip
    if height_sigma is None:
        height_sigma = _ABOUT_MODEL if terrain is not None else max(_LEAST_SIGMA, 2.0 * float(heights.std()))
    ground = Ground(chart, body, float(heights.mean()), height_sigma, terrain)
    return replace(ground, terrain=terrain.around(_places(images, ground.height))) if terrain is not None else ground


def _chart(images: Sequence[PushbroomImage], height: float) -> GroundChart:
    first = images[0]
    flight = first.pose(first.middle[0]).velocity[0]
    return GroundChart.about(_places(images, height), flight)


def _places(images: Sequence[PushbroomImage], height: float) -> Array:
    """(n, 3) m, corners and middles of the images' sides and themselves, those that see the body."""
    places = ground_seen(images, (9, 3), height)
    places = places[finite_rows(places)]
    require(places.size != 0, "images to match", "none that sees the body", "images of the ground")
    return places


def _in_images(images: Sequence[PushbroomImage], points: Array) -> Array:
    """(n, 3) m, those of points (k, 3) that lie in an image, or beside it by its width."""
    inside = np.zeros(len(points), dtype=bool)
    for image in images:
        lines, samples = image.ground_to_image(points)[0].T
        inside |= (lines > 0.0) & (lines < image.lines) & (np.abs(samples / image.samples - 0.5) < 1.5)
    return points[inside]


def _heights(
    tables: CaseInput, images: Sequence[PushbroomImage], path: Path, terrain: TerrainGrid | None
) -> Array:
    """(n,) m above the ellipsoid, of the terrain model under the images or else of the case's laser shots."""
    if terrain is not None:
        places = _places(images, 0.0)
        radii = terrain.at(places)
        places *= (radii / np.linalg.norm(places, axis=1))[:, None]
    else:
        shots = [read_lidar(path.parent / group.file).footprints for group in tables.laser_groups]
        shots += [(profile := read_profile(entry, path.parent)).footprints[profile.ground] for entry in tables.shots]
        places = _in_images(images, np.concatenate([np.zeros((0, 3)), *shots]))
    places = places[finite_rows(places)]
    return ellipsoidal_heights(places, images[0].body) if places.size else np.zeros(0)

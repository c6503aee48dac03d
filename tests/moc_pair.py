"""A project of the real MOC pair of `shared/data/mgs_moc_pair`: the crop of E02/01461, brought back into its camera,
and M01/00115, whose kernels are not at hand.
"""

import sys
import warnings
from dataclasses import replace
from pathlib import Path

import numpy as np

from mgsgraph.files.cameras.label import read_line_scan_label
from mgsgraph.files.labels.isis_cube import read_isis_cube
from mgsgraph.files.networks.tie_points import PointKind
from mgsgraph.geometry.orientation import OrientationPrior
from mgsgraph.names import Names
from mgsgraph.network import GroundPoints, ImageRays, Network, PointClass, Ranges
from mgsgraph.network.parts import KnownImage, image_columns
from mgsgraph.project.addition import Addition, NewImage
from mgsgraph.project.changes import solve_project, store_unadjusted
from mgsgraph.project.project import Project, open_project
from mgsgraph.project.settings import ProjectSettings

GIVEN = 5
"""Ties inside the crop."""


def moc_pair_project(shared_data: Path, folder: Path) -> tuple[Path, dict[str, tuple[np.ndarray, np.ndarray]]]:
    """A solved project of the pair, and places of matches of both images by name, for a person to click.

    E02's places are those of the crop.
    """
    sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "scripts"))
    try:
        import match_moc_pair as script
    finally:
        sys.path.pop(0)
    pair = shared_data / "mgs_moc_pair"
    cube, plain = pair / f"{script.E02}.tiny.cub", pair / f"{script.M01}.img"
    image, apparent = read_isis_cube(cube), read_isis_cube(cube, apparent=True)
    grid, ties, crop = script.MapGrid.read(cube), script.read_ties(pair / "tie_points.csv"), script.read_map(cube)
    ground = script.ground_about(image, grid, crop.shape, shared_data)
    window = script.into_camera(image, apparent, grid, crop, ground)
    points = ground.meet(*image.sightlines(*ties.e02.T))
    local = ties.e02 - window.corner
    inside = np.all((local > 0.0) & (local < window.pixels.shape), axis=1)
    inside[inside] = np.isfinite(window.pixels[tuple(local[inside].astype(int).T)])
    assert inside.sum() == GIVEN
    other, _ = script.resected(read_line_scan_label(plain), image, points[~inside], ties.m01[~inside])
    first = replace(window.image, name="E02/01461")
    second = replace(other, name="M01/00115")
    known = [KnownImage(first, OrientationPrior(script.RESECTED)), KnownImage(second, script.UNKNOWN)]
    n, free = len(ties.names), np.where(inside)[0]
    up = points / np.linalg.norm(points, axis=1, keepdims=True)
    covariances = np.eye(3) * 20.0**2 + (script.HEIGHT_SIGMA**2 - 20.0**2) * up[:, :, None] * up[:, None, :]
    covariances[inside] = 0.0
    kinds = np.where(inside, PointKind.FREE, PointKind.CONSTRAINED).astype(np.int64)
    classes = np.where(inside, PointClass.TIE, PointClass.CONTROL).astype(np.int64)
    ground_points = GroundPoints(Names.of(ties.names), classes, kinds, points, covariances)
    rays = ImageRays(
        np.concatenate([np.arange(n), free]), np.repeat([1, 0], [n, free.size]),
        np.concatenate([ties.m01, local[free]]), np.full((n + free.size, 2), script.TIE_SIGMA),
    )  # fmt: skip
    nothing = np.zeros(0, dtype=np.int64)
    network = Network(*image_columns(known), ground_points, rays, Ranges(nothing, nothing, *np.zeros((3, 0))))
    picture = _picture(folder / "E0201461.tif", window.pixels)
    project = folder / "project"
    with Project.create(project, "MOC pair", ProjectSettings()) as made:
        images = (NewImage(known[0], picture), NewImage(known[1], plain))
        store_unadjusted(made.store, Addition(images, network))
        for one in images:
            made.take_picture(one.known.image.name, one.picture)
        made.record("init", "the MOC pair", {})
    with open_project(project, write=True) as opened:
        solve_project(opened, figures=False)
    given = {name: (local[k], ties.m01[k]) for k, name in enumerate(ties.names) if inside[k]}
    return project, given


def _picture(path: Path, pixels: np.ndarray) -> Path:
    import rasterio
    from rasterio.errors import NotGeoreferencedWarning

    path.parent.mkdir(parents=True, exist_ok=True)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", NotGeoreferencedWarning)
        with rasterio.open(path, "w", driver="GTiff", height=pixels.shape[0], width=pixels.shape[1], count=1,
                           dtype="float32") as file:  # fmt: skip
            file.write(pixels.astype(np.float32), 1)
    return path


# --- the sheet of a point and the questions in a real browser, by keys alone: what is changed, undone, ask

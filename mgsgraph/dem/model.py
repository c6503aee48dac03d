"""A terrain model of dense matches, with what it was made from and how it was checked."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from pathlib import Path
from typing import TYPE_CHECKING, Literal, get_args

import numpy as np

from mgsgraph.analysis.posterior import Posterior
from mgsgraph.dem.checking import CheckProfile, HeightChecks, checked
from mgsgraph.dem.gridding import HeightGrid, gridded
from mgsgraph.dem.map import MapGrid
from mgsgraph.dem.points import intersected
from mgsgraph.errors import InputError
from mgsgraph.geometry.records import Array, Index
from mgsgraph.geometry.terrain import TerrainGrid, areoid_heights
from mgsgraph.matching.coarse import pixel_on_ground
from mgsgraph.matching.scene import Scene
from mgsgraph.stages import Progress, no_progress
from mgsgraph.units import KM
from mgsgraph.wording import root_mean_square

if TYPE_CHECKING:
    from mgsgraph.matching.dense import DenseMatches

Heights = Literal["sphere", "areoid"]
"""What heights are above."""


@dataclass(frozen=True, slots=True)
class DemSettings:
    """Choices of a terrain model."""

    post: float | None = None
    """m between its posts; as the matches' when None."""
    spacing: float | None = None
    """m between matches; five pixels of the ground grid when None."""
    heights: Heights = "sphere"
    """Above the sphere of its coordinate system, or above the case's areoid."""
    ortho_pixel: float | None = None
    """m, pixel of the ortho image; as the image's own on the ground when None."""
    images: tuple[str, ...] = ()
    """Names of the images to take; all of the case when empty."""
    mola: tuple[Path, ...] = ()
    """More laser shots to check heights by: PEDR files or tables."""

    def __post_init__(self) -> None:
        for name in ("post", "spacing", "ortho_pixel"):
            value = getattr(self, name)
            if value is not None and not (np.isfinite(value) and value > 0.0):
                raise InputError(f"terrain model, {name.replace('_', ' ')}", f"{value} m", "a positive number")
        if self.heights not in get_args(Heights):
            raise InputError("terrain model, heights", repr(self.heights), " or ".join(get_args(Heights)))


@dataclass(frozen=True, slots=True, eq=False)
class Dem:
    """A terrain model, what it was made from, and how it was checked."""

    name: str
    """Of the case."""
    images: tuple[str, ...]
    """Names of the scene's pictures."""
    ortho: int
    """Picture of the ortho image."""
    model: HeightGrid
    """Heights above the sphere, and sigmas."""
    heights: Array
    """(rows, columns) m above `reference`."""
    reference: str
    """What the heights are above, in words."""
    pairs: tuple[tuple[int, int], ...]
    """Pictures of each pair that was matched."""
    matches: tuple[tuple[int, int], ...]
    """Of each pair the matches, and the posts where one was sought."""
    misses: tuple[tuple[float, float], ...]
    """m rms, of each pair, by which rays of a match pass each other, and what matching explains of it."""
    spacing: float
    """m between matches."""
    window: float
    """m, width of a matching window."""
    checks: HeightChecks
    """Laser shots that took no part."""
    profiles: tuple[CheckProfile, ...]
    """Where these come from."""

    @property
    def covered(self) -> float:
        """m^2 with heights."""
        return float(np.isfinite(self.heights).sum()) * self.model.map.post**2

    def __repr__(self) -> str:
        grid = self.model.map
        return (
            f"Dem({self.name!r}: {grid.rows} x {grid.columns} posts every {grid.post:.4g} m, "
            f"{self.covered / KM**2:.4g} km^2 with heights, {len(self.checks)} check shots)"
        )


def dem_of(
    name: str, posterior: Posterior, scene: Scene, matches: Sequence["DenseMatches"], window: float,
    settings: DemSettings, profiles: Sequence[CheckProfile] = (), workers: int | None = None,
    progress: Progress = no_progress,
) -> Dem:
    """A terrain model of dense matches, in memory; `window` in m is the width of the windows that were matched."""
    require_reference(posterior, settings)
    progress("intersecting", 0, 1)
    points = intersected(posterior, scene, matches)
    spacing = max(one.spacing for one in matches)
    grid = MapGrid.around(points.places, scene.ground.body, settings.post or spacing)
    related = replace(points, pair=_kin([(one.first, one.second) for one in matches])[points.pair])
    model = gridded(related, grid, spacing, window, workers, progress)
    heights, reference = model.heights, f"a sphere of {grid.radius / KM:.3f} km"
    areoid = posterior.network.areoid
    if settings.heights == "areoid" and areoid is not None:
        heights, reference = _above_areoid(model, areoid), "the areoid"
    misses = [
        (root_mean_square(points.misses[mine]), root_mean_square(points.miss_sigmas[mine]))
        for k in range(len(matches))
        for mine in [points.pair == k]
    ]
    counts = [(len(one.anchors), one.posts) for one in matches]
    largest = max(matches, key=lambda one: len(one.anchors))
    return Dem(
        name, tuple(picture.image.name for picture in scene.pictures), largest.first, model, heights, reference,
        tuple((one.first, one.second) for one in matches), tuple(counts), tuple(misses), spacing, window,
        checked(model, profiles), tuple(profiles),
    )  # fmt: skip


def _kin(pairs: Sequence[tuple[int, int]]) -> Index:
    """(n,) the same number for pairs that share an image, whose noise is in both, or are linked by pairs that do."""
    kin = np.arange(len(pairs))
    for i, j in combinations(range(len(pairs)), 2):
        if set(pairs[i]) & set(pairs[j]):
            kin[kin == kin[j]] = kin[i]
    return kin


def ortho_grid(dem: Dem, scene: Scene, settings: DemSettings) -> MapGrid:
    """The pixels of the ortho image: over the terrain model, as large as the image's own where nothing is asked for."""
    pixel = settings.ortho_pixel
    if pixel is None:
        own = pixel_on_ground(scene.ground, scene.pictures[dem.ortho])
        pixel = float(np.sqrt(abs(np.linalg.det(own))))
    return dem.model.map.resampled(pixel)


def require_reference(posterior: Posterior, settings: DemSettings) -> None:
    """Raise InputError where heights are asked for above an areoid that nobody knows."""
    if settings.heights == "areoid" and posterior.network.areoid is None:
        raise InputError(
            "terrain model, heights", "areoid, which the adjusted case doesn't have",
            "[terrain] with topography or areoid", "adjust with it, or ask for heights above the sphere",
        )  # fmt: skip


def _above_areoid(model: HeightGrid, areoid: TerrainGrid) -> Array:
    """(rows, columns) m; NaN where the areoid isn't known."""
    there = np.isfinite(model.heights)
    found = np.full(there.shape, np.nan)
    points = model.map.points(model.map.posts()[there.ravel()], model.heights[there])
    found[there] = areoid_heights(points, areoid)
    if not np.any(np.isfinite(found)):
        raise InputError(f"terrain {areoid.source}", "no areoid under the terrain model", "one of the images' ground")
    return found

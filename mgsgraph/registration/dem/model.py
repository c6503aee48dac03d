"""A terrain model of dense matches, with what it was made from and how it was checked."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from pathlib import Path
from typing import TYPE_CHECKING, Literal, NamedTuple, get_args

import numpy as np

from mgsgraph.analysis.posterior import Posterior
from mgsgraph.errors import InputError, require
from mgsgraph.geometry.records import Array, Index
from mgsgraph.geometry.terrain import TerrainGrid, areoid_heights
from mgsgraph.matching.scene import Scene
from mgsgraph.record import Record
from mgsgraph.registration.dem.checking import CheckProfile, HeightChecks, checked
from mgsgraph.registration.dem.gridding import HeightGrid, MapGrid, gridded, intersected
from mgsgraph.registration.dem.ortho import ortho_accuracy
from mgsgraph.text import root_mean_square
from mgsgraph.units import KM
from mgsgraph.workers import Progress, no_progress

if TYPE_CHECKING:

    from mgsgraph.matching.dense import DenseMatches

Heights = Literal["sphere", "areoid"]
"""What heights are above."""


@dataclass(frozen=True, slots=True)
class DemSettings(Record):
    """Choices of a terrain model.

    Examples
    --------
    >>> settings = mgsgraph.DemSettings(post=25.0, heights="areoid")
    >>> settings.post, settings.heights
    (25.0, 'areoid')
    """

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
            good = value is None or 0.0 < value < np.inf
            require(good, f"terrain model, {name.replace('_', ' ')}", f"{value} m", "a positive number")
        choices = get_args(Heights)
        require(self.heights in choices, "terrain model, heights", repr(self.heights), " or ".join(choices))


class MatchedPair(NamedTuple):
    """Density and quality of the matches of two images."""

    images: tuple[str, str]
    """Names of both."""
    matched: int
    """Posts with a match."""
    posts: int
    """Posts on ground that both images show."""
    miss: float
    """m rms, by which the rays of a match pass each other."""
    miss_sigma: float
    """m rms, what matching explains of that."""


@dataclass(frozen=True, slots=True, eq=False)
class Dem(Record):
    """A terrain model, what it was made from, and how it was checked.

    Examples
    --------
    >>> print(dem)
    Dem('Gusev Crater': 24 x 61 posts every 50 m, 2.935 km^2 with heights, 0 check shots)
    >>> height, sigma = np.nanmedian(dem.heights), np.nanmedian(dem.model.sigmas)
    >>> print(f"{height:.0f} +- {sigma:.0f} m")
    -3971 +- 5 m
    >>> dem.heights.shape, dem.model.sigmas.shape
    ((24, 61), (24, 61))
    """

    name: str
    """Of the case."""
    images: tuple[str, ...]
    """Names of the scene's pictures."""
    ortho: int
    """Picture of the ortho image."""
    ortho_accuracy: Array
    """(3, rows, columns) of its ground at the posts: sigma east and north in m, and their correlation."""
    model: HeightGrid
    """Heights above the sphere, and sigmas."""
    heights: Array
    """(rows, columns) m above `reference`."""
    reference: str
    """What the heights are above, in words."""
    pairs: tuple[MatchedPair, ...]
    """Pairs of images that were matched."""
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
    spacing = max(pair.spacing for pair in matches)
    grid = MapGrid.around(points.positions, scene.ground.body, settings.post or spacing)
    related = replace(points, pair=_kin([(pair.first, pair.second) for pair in matches])[points.pair])
    model = gridded(related, grid, spacing, window, workers, progress)
    heights, reference = model.heights, f"a sphere of {grid.radius / KM:.3f} km"
    areoid = posterior.network.areoid
    if settings.heights == "areoid" and areoid is not None:
        heights, reference = _above_areoid(model, areoid), "the areoid"
    names = tuple(picture.image.name for picture in scene.pictures)
    pairs = tuple(
        MatchedPair(
            (names[pair.first], names[pair.second]), len(pair.anchors), pair.posts,
            *(root_mean_square(misses[points.pair == k]) for misses in (points.misses, points.miss_sigmas)),
        )
        for k, pair in enumerate(matches)
    )  # fmt: skip
    most = max(matches, key=lambda pair: len(pair.anchors))
    return Dem(
        name, names, most.first, ortho_accuracy(posterior, scene, most, model), model, heights, reference, pairs,
        spacing, window, checked(model, profiles), tuple(profiles),
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
        pixel = float(scene.pixel_sizes[dem.ortho])
    return dem.model.map.resampled(pixel)


def require_reference(posterior: Posterior, settings: DemSettings) -> None:
    """Raise InputError where heights are wanted above an unknown areoid."""
    if settings.heights == "areoid" and posterior.network.areoid is None:
        raise InputError(
            "terrain model, heights", "areoid, which the adjusted case doesn't have",
            "[terrain] with topography or areoid", "adjust with it, or ask for heights above the sphere",
        )  # fmt: skip


def _above_areoid(model: HeightGrid, areoid: TerrainGrid) -> Array:
    """(rows, columns) m; NaN where the areoid isn't known."""
    has_height = np.isfinite(model.heights)
    heights = np.full(has_height.shape, np.nan)
    points = model.map.points(model.map.posts()[has_height.ravel()], model.heights[has_height])
    heights[has_height] = areoid_heights(points, areoid)
    if not np.any(np.isfinite(heights)):
        raise InputError(f"terrain {areoid.source}", "no areoid under the terrain model", "one of the images' ground")
    return heights

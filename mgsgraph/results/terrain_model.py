"""A terrain model made of a case, as sentences and files: rasters, the record, the table of check shots, the figure."""

from collections.abc import Mapping
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any

import numpy as np

from mgsgraph.adjustment.solution import Solution
from mgsgraph.analysis.posterior import Posterior
from mgsgraph.case.case_file import decode
from mgsgraph.case.scene import read_scene
from mgsgraph.files.output.folders import DEM, PROGRAM, STAC_ITEM, fresh_folder, require_replaceable
from mgsgraph.files.output.table import Table, picked, write_json
from mgsgraph.files.rasters.raster_file import geotiff
from mgsgraph.geometry.body import planetocentric
from mgsgraph.geometry.records import Array, sigmas_of
from mgsgraph.matching.scene import Ground, Picture, Scene
from mgsgraph.registration.dem.checking import check_figures, check_profiles
from mgsgraph.registration.dem.gridding import HeightGrid, MapGrid
from mgsgraph.registration.dem.model import Dem, DemSettings, dem_of, ortho_grid, require_reference
from mgsgraph.registration.dem.ortho import (
    adjusted_names,
    adjusted_scene,
    densely_matched,
    expected_ground,
    ortho_tiles,
)
from mgsgraph.results.catalog import BANDS, ORTHO_BANDS, stac_item
from mgsgraph.results.section import Section, record_of, table_of
from mgsgraph.text import some
from mgsgraph.units import DEG, KM
from mgsgraph.workers import Progress, no_progress

FORMAT = 2
"""Version of dem.json's layout: 2 has the coordinate system as WKT2, not in PROJ's words."""
_UNEXPLAINED = 1.5
"""Ratio of the distance of rays to its sigma by matching, above which a pair of images is named."""


def make_dem(
    adjusted: Solution | Posterior,
    case: str | Path,
    out: str | Path,
    settings: DemSettings | None = None,
    workers: int | None = None,
    figures: bool = True,
    progress: Progress = no_progress,
) -> Dem:
    """Match the images of a case densely with their adjusted orientation, and write a terrain model.

    Parameters
    ----------
    adjusted : Solution or Posterior
        Of the adjustment of the case; images are known by their names.
    case : path
        Case file, for the pixels, the ground beforehand, and the laser profiles.
    out : path
        Folder with dem.tif, ortho.tif, ortho_sigma.tif, dem.json, shots.csv and the figure; written atomically.
    settings : DemSettings, optional
        Choices.
    workers : int, optional
        Threads; one per processor when None.
    figures : bool
        Whether the figure is drawn.
    progress : callable
        Called with the stage, and how much of it is done.

    Raises
    ------
    InputError
        As `read_scene`; images that were not adjusted; no overlap or no parallax to make a terrain model from; heights
        above an areoid that the case doesn't have; a folder that can't be written or holds something else.

    Examples
    --------
    >>> case = mgsgraph.read_case("gusev/case.toml", ties=Path("matches/network.pvl"))
    >>> settings = mgsgraph.DemSettings(post=50.0, spacing=30.0)
    >>> dem = mgsgraph.make_dem(mgsgraph.adjust(case), "gusev/case.toml", "dem", settings, figures=False)
    >>> print(dem)
    Dem('Gusev Crater': 24 x 61 posts every 50 m, 2.935 km^2 with heights, 0 check shots)
    """
    settings, path = settings or DemSettings(), Path(case)
    require_replaceable(out, DEM)
    posterior = adjusted if isinstance(adjusted, Posterior) else Posterior.of(adjusted)
    require_reference(posterior, settings)
    case_input = decode(path)
    adjusted_names([image.name for image in case_input.images], posterior, settings.images, str(path))
    profiles = check_profiles(posterior, case_input, path, settings.mola)
    name, scene = read_scene(path, *expected_ground(posterior, case_input))
    scene = adjusted_scene(scene, posterior, settings.images)
    matches, window = densely_matched(scene, settings.spacing, workers, progress)
    dem = dem_of(name, posterior, scene, matches, window, settings, profiles, workers, progress)
    with fresh_folder(out, DEM) as folder:
        write_dem(dem, scene, settings, folder, figures, progress)
    return dem


def write_dem(dem: Dem, scene: Scene, settings: DemSettings, folder: Path, figures: bool, progress: Progress) -> None:
    """Write all files into an existing folder."""
    grid = ortho_grid(dem, scene, settings)
    progress("ortho image", 0, 1)
    tags = {"case": dem.name, "images": some(dem.images, most=20), "sigmas": "for sigma0 = 1"}
    write_model(dem.model, dem.heights, dem.reference, tags, folder / "dem.tif")
    write_ortho_accuracy(dem, folder / "ortho_sigma.tif")
    write_ortho(scene.pictures[dem.ortho], dem.model, scene.ground, grid, folder / "ortho.tif", progress)
    shots_table(dem).write_csv(folder / "shots.csv")
    write_json(folder / DEM, _record(dem, settings, grid.post))
    if figures:
        from mgsgraph.results.figures.dem import dem_sheet, read_ortho  # matplotlib loads slowly
        from mgsgraph.results.figures.sheet import save

        progress("figure", 0, 1)
        save([dem_sheet(dem, read_ortho(folder / "ortho.tif"))], folder)
    images = [picture.image for picture in scene.pictures]
    write_json(folder / STAC_ITEM, stac_item(dem, grid, images, sorted(path.name for path in folder.iterdir())))


def dem_section(dem: Dem) -> Section:
    """Size, heights and sigmas of the terrain model, and its checks."""
    grid, has_height = dem.model.map, np.isfinite(dem.heights)
    low, high = (float(value) for value in (np.nanmin(dem.heights), np.nanmax(dem.heights)))
    total, matching, orientation = (
        float(np.median(band[has_height])) for band in (dem.model.sigmas, dem.model.matching, dem.model.orientation)
    )
    offered = sum(profile.shots.times.size for profile in dem.profiles)
    sentences = [
        f"The terrain model has {grid.rows} x {grid.columns} posts every {grid.post:.3g} m, of which "
        f"{int(has_height.sum())} have a height ({dem.covered / KM**2:.4g} km^2): {low:.0f} to {high:.0f} m above "
        f"{dem.reference}.",
        f"Sigma of a height (median, for sigma0 = 1): {total:.3g} m, of which {matching:.3g} m by matching and relief, "
        f"independent beyond {dem.window:.0f} m, and {orientation:.3g} m by the orientation, common to neighbours.",
    ]
    if inconsistent := [" and ".join(pair.images) for pair in dem.pairs if pair.miss > _UNEXPLAINED * pair.miss_sigma]:
        sentences.append(
            f"Rays of {some(inconsistent)} miss each other by more than matching explains: the rest "
            "is the orientation's, by its sigmas or by motion that the adjustment doesn't follow."
        )
    if not dem.profiles:
        sentences.append("Not checked by laser shots: there are none that took no part in the adjustment.")
    elif not len(dem.checks):
        sentences.append(f"Not checked by laser shots: of {offered} that took no part none lies on the terrain model.")
    return Section("dem", "", sentences, [_pairs_table(dem), _checks_table(dem)])


def _pairs_table(dem: Dem) -> Table:
    """One row per pair of images."""
    pairs = dem.pairs
    return table_of("pairs", {
        "pair": [" and ".join(pair.images) for pair in pairs], "images": [list(pair.images) for pair in pairs],
    }, pairs)  # fmt: skip


def _checks_table(dem: Dem) -> Table:
    """One row per profile with shots on the model, and one for all of them."""
    names = [*(profile.name for profile in dem.profiles), "all"]
    members = [*(dem.checks.profile == k for k in range(len(dem.profiles))), np.ones(len(dem.checks), dtype=bool)]
    rows = [(name, check_figures(dem.checks, mask)) for name, mask in zip(names, members, strict=True) if np.any(mask)]

    def values_of(key: str) -> Array:
        return np.array([figures[key] for _, figures in rows], dtype=np.float64)

    return table_of("checks", {
        "profile": [name for name, _ in rows], "shots": values_of("shots"), "mean": values_of("mean_m"),
        "rms": values_of("rms_m"), "rms_by_sigma": values_of("rms_by_sigma"), "beyond": values_of("beyond_3_sigma"),
    })  # fmt: skip


def _record(dem: Dem, settings: DemSettings, pixel: float) -> dict[str, Any]:
    grid, has_height, checks = dem.model.map, np.isfinite(dem.heights), dem.checks
    quantiles = {
        name: np.quantile(band[has_height], [0.05, 0.5, 0.95])
        for name, band in zip(BANDS[1:4], (dem.model.sigmas, dem.model.matching, dem.model.orientation), strict=True)
    }
    return {
        "program": PROGRAM, "format": FORMAT, "name": dem.name, "images": list(dem.images),
        "ortho_image": dem.images[dem.ortho],
        "settings": {
            **record_of("dem_settings", settings), "images": list(settings.images),
            "mola": [str(path) for path in settings.mola],
        },
        "pairs": _pairs_table(dem).records(), "coordinate_system": grid.crs, "heights_above": dem.reference,
        "post_m": grid.post, "spacing_m": dem.spacing, "window_m": dem.window, "ortho_pixel_m": pixel,
        "rows": grid.rows, "columns": grid.columns, "posts_with_heights": int(has_height.sum()), "area_m2": dem.covered,
        "height_m": [np.nanmin(dem.heights), np.nanmax(dem.heights)], "quantiles_5_50_95_m": quantiles,
        "checks": [
            {
                **record_of("dem_check", profile), "shift_sigma_m": sigmas_of(profile.shift_covariance),
                **(check_figures(checks, mask) if np.any(mask := checks.profile == k) else {"shots": 0}),
            }
            for k, profile in enumerate(dem.profiles)
        ],
        "all_checks": check_figures(checks, np.ones(len(checks), dtype=bool)) if len(checks) else {"shots": 0},
        "statements": dem_section(dem).sentences,
    }  # fmt: skip


def shots_table(dem: Dem) -> Table:
    """One row per check shot."""
    checks = dem.checks
    longitude, latitude, radius = planetocentric(checks.positions).T
    return table_of("terrain_model_shots", {
        "profile": picked(checks.profiles, checks.profile), "shot": checks.ids,
        "east_longitude": np.mod(longitude / DEG, 360.0), "planetocentric_latitude": latitude, "{}": checks.plane,
        "shot_above_sphere": radius - dem.model.map.radius, "model_above_sphere": checks.heights,
        "model_minus_shot": checks.differences, "sigma": checks.sigmas, "sigma_without_orientation": checks.independent,
    })  # fmt: skip


# --- rasters


def write_model(model: HeightGrid, heights: Array, reference: str, tags: Mapping[str, str], path: Path) -> None:
    """Write dem.tif: `heights` (rows, columns) in m above `reference`, the model's sigmas and counts, and more tags."""
    counts = np.where(np.isfinite(heights), model.counts, np.nan)
    bands = (heights, model.sigmas, model.matching, model.orientation, counts)
    with _map_geotiff(model.map, path, len(BANDS), dtype="float32", nodata=np.nan) as file:
        file.update_tags(program=PROGRAM, heights=f"above {reference}", **tags)
        for k, (name, values) in enumerate(zip(BANDS, bands, strict=True), start=1):
            file.write(np.where(np.isfinite(heights), values, np.nan).astype(np.float32), k)
            file.set_band_description(k, f"{name} above {reference}" if k == 1 else name)
            file.set_band_unit(k, "m" if k < len(BANDS) else "1")


def write_ortho(
    picture: Picture, model: HeightGrid, ground: Ground, grid: MapGrid, path: Path, progress: Progress = no_progress
) -> None:
    """Write ortho.tif: the picture on the pixels of `grid`, 0 where there is none."""
    from rasterio.windows import Window

    low, high = picture.levels
    with _map_geotiff(grid, path, 1, dtype="uint8", nodata=0) as file:
        file.update_tags(program=PROGRAM, image=picture.image.name, grey_1=f"{low:g}", grey_255=f"{high:g}")
        file.set_band_description(1, picture.image.name)
        for row, column, grey in ortho_tiles(picture, model, ground, grid, progress):
            file.write(grey, 1, window=Window(column, row, grey.shape[1], grey.shape[0]))


def write_ortho_accuracy(dem: Dem, path: Path) -> None:
    """Write ortho_sigma.tif: sigmas of positions in the ortho image, on the posts of the terrain model."""
    with _map_geotiff(dem.model.map, path, len(ORTHO_BANDS), dtype="float32", nodata=np.nan) as file:
        file.update_tags(program=PROGRAM, image=dem.images[dem.ortho], sigmas="for sigma0 = 1")
        file.descriptions, file.units = ORTHO_BANDS, ("m", "m", "1")
        file.write(dem.ortho_accuracy.astype(np.float32))


def _map_geotiff(grid: MapGrid, path: Path, bands: int, **kind: Any) -> AbstractContextManager[Any]:
    """A GeoTIFF on the posts of a map."""
    corner, steps = (grid.west, grid.north), (grid.post, grid.post)
    return geotiff(path, (bands, grid.rows, grid.columns), grid.crs, corner, steps, **kind)

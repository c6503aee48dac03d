"""Terrain models of the simulated ground, as MOLA's gridded data have it: means over cells, shifted, with noise."""

import numpy as np

from mgsgraph.errors import InputError
from mgsgraph.geometry.body import in_turn, planetocentric
from mgsgraph.geometry.records import Array
from mgsgraph.geometry.terrain import TerrainGrid
from mgsgraph.simulation.ground import SITES, SiteTerrain
from mgsgraph.units import DEG

GRID_PLANIMETRIC = 200.0
"""m, sigma by which a site's terrain grid lies off the true ground, east and north (design: MOLA grids)."""
GRID_VERTICAL = 10.0
"""m rms, noise of each post of a site's terrain grid."""

_SITE_PARTS, _BLOCK_PARTS = 5, 3
"""Points along and across a grid's cell whose mean is its post, of a study site and of a block."""
_BEYOND = 6
"""Posts by which a block's grid reaches beyond its points."""


def grid_shift(terrain: SiteTerrain) -> Array:
    """By how many m (2,) east and north the terrain grid lies off the true ground: drawn from its sigma."""
    return GRID_PLANIMETRIC * _grid_stream(terrain).standard_normal(2)


def terrain_grid(terrain: SiteTerrain, ppd: int, reach: tuple[float, float] = (20e3, 40e3)) -> TerrainGrid:
    """The site as a MOLA grid has it: off in the plane as a whole, with 10 m of noise in each post.

    Posts lie at odd multiples of half a step, `ppd` per degree, as MEGDR's, and enclose at least `reach` (2,) in m:
    east and west, north and south of the centre.
    """
    if ppd < 1:
        raise InputError("simulated terrain grid, posts per degree", f"{ppd}", "a positive whole number")
    shift, rng = grid_shift(terrain), _grid_stream(terrain)
    rng.standard_normal(2)  # taken by the shift
    centre, half = np.array([terrain.centre_lon, terrain.centre_lat]), np.array(reach) / terrain.metres_per_radian
    lon, lat = _posts(centre - half, centre + half, DEG / ppd)
    radii = cell_means(terrain, lon, lat, DEG / ppd, shift, _SITE_PARTS)
    radii += GRID_VERTICAL * rng.standard_normal(radii.shape)
    return _grid(f"simulated {terrain.site}", ppd, lon, lat, radii, GRID_VERTICAL, GRID_PLANIMETRIC)


def block_grid(
    terrain: SiteTerrain,
    points: Array,
    ppd: int,
    noise: float,
    shift: Array,
    missing: float,
    rng: np.random.Generator,
) -> TerrainGrid:
    """A grid under the points (n, 3) of a block, m, body-fixed, and some posts beyond.

    Its content lies off the truth by `shift` (2,) m east and north; each post has noise of `noise` m rms, and the share
    `missing` of them is NaN.
    """
    lon, lat, _ = planetocentric(points).T
    covered = np.stack([in_turn(lon, terrain.centre_lon), lat])
    lon, lat = _posts(covered.min(axis=1), covered.max(axis=1), DEG / ppd, _BEYOND)
    radii = cell_means(terrain, lon, lat, DEG / ppd, shift, _BLOCK_PARTS)
    radii += noise * rng.standard_normal(radii.shape)
    radii[rng.random(radii.shape) < missing] = np.nan
    return _grid("simulated block", ppd, lon, lat, radii, noise or None, None)


def areoid_under(terrain: SiteTerrain, grid: TerrainGrid) -> Array:
    """Radius (rows, columns) in m of the areoid at a grid's posts."""
    rows, columns = grid.radii.shape
    longitudes = grid.first_longitude + grid.longitude_step * np.arange(columns)
    latitudes = grid.first_latitude - grid.latitude_step * np.arange(rows)
    lon, lat = (axis.ravel() for axis in np.meshgrid(longitudes, latitudes))
    return terrain.areoid_radius(lon, lat).reshape(rows, columns)


def cell_means(terrain: SiteTerrain, lon: Array, lat: Array, step: float, shift: Array, parts: int) -> Array:
    """Radius (rows, columns) in m of the ground, the mean over cells of `step` rad about longitudes and latitudes
    (rows, columns): `parts` by `parts` points of each, `shift` (2,) m east and north of where they truly are.
    """
    off_lon, off_lat = shift / terrain.metres_per_radian
    shape, lon, lat = lon.shape, lon.ravel(), lat.ravel()
    radii = np.zeros(lon.size)
    within = (np.arange(parts) + 0.5) / parts - 0.5
    for i in within:
        for j in within:
            radii += terrain.ground_radius(lon + i * step - off_lon, lat + j * step - off_lat) / parts**2
    return radii.reshape(shape)


def _posts(low: Array, high: Array, step: float, beyond: int = 0) -> tuple[Array, Array]:
    """Longitudes and latitudes (rows, columns) in rad of the posts that enclose `low` and `high` (2,), and of as many
    rows and columns `beyond`; from the north, eastward.
    """
    west, south = np.floor(low / step - 0.5).astype(int) - beyond
    east, north = np.ceil(high / step - 0.5).astype(int) + beyond
    lon, lat = np.meshgrid((np.arange(west, east + 1) + 0.5) * step, (np.arange(north, south - 1, -1) + 0.5) * step)
    return lon, lat


def _grid(
    source: str, ppd: int, lon: Array, lat: Array, radii: Array, vertical: float | None, planimetric: float | None
) -> TerrainGrid:
    return TerrainGrid(
        source=f"{source} at {ppd} posts per degree",
        radii=radii,
        first_longitude=float(lon[0, 0]),
        first_latitude=float(lat[0, 0]),
        longitude_step=DEG / ppd,
        latitude_step=DEG / ppd,
        vertical_sigma=vertical,
        planimetric_sigma=planimetric,
    )


def _grid_stream(terrain: SiteTerrain) -> np.random.Generator:
    return np.random.default_rng([terrain.seed, list(SITES).index(terrain.site), 1])

"""The ground under a simulated HRSC block, and a terrain model of it like MOLA's.

The relief is fractal down to a kilometre and doesn't repeat itself within a block; a finer one lies over it. Amplitudes
are such that a grid of 1/64 degree tells the ground to some 7 m between its posts (rms), so that with the posts' noise
of 10 m a point lies 10 m off it, rms; slopes are 2 degrees at the posts' distance: what a shift of the grid shows by.
"""

from functools import lru_cache

import numpy as np

from mgsgraph.geometry.body import in_turn, planetocentric
from mgsgraph.geometry.records import Array
from mgsgraph.geometry.terrain import TerrainGrid
from mgsgraph.simulation.circle import MARS
from mgsgraph.simulation.relief import PeriodicSurface, fractal
from mgsgraph.simulation.terrain import SiteGround, SiteTerrain, cell_means
from mgsgraph.units import DEG

LEVEL = -1500.0
"""m, mean height of the ground above the ellipsoid."""
_COARSE, _FINE = 1000.0, 50.0
"""m between the coefficients of relief and detail."""
_ROUGHNESS, _HURST = 600.0, 0.6
"""m rms of the relief, over 1024 km, and its Hurst exponent; chosen for the figures above, not fitted to Mars."""
_DETAIL, _DETAIL_HURST = 15.0, 0.2
"""m rms of the detail, over 51 km, and its exponent."""
_PARTS = 3
"""Places along and across a cell of the terrain model whose mean is its post."""
_BEYOND = 6
"""Posts beyond the points."""


@lru_cache(maxsize=2)
def block_terrain(longitude: float, latitude: float, seed: int) -> SiteTerrain:
    """True ground about a place, rad; the same place and seed give the same ground."""
    of_relief, of_detail = np.random.default_rng(seed).spawn(2)
    ground = SiteGround(longitude, latitude, LEVEL, 0.0, _ROUGHNESS, _HURST, 0.0, 0.0, 0.0, 0.0)
    return SiteTerrain(
        site="block",
        seed=seed,
        ellipsoid=MARS,
        centre_lon=longitude,
        centre_lat=latitude,
        ground=ground,
        waves=np.zeros((0, 4)),
        relief=PeriodicSurface(_COARSE, np.float32(_ROUGHNESS) * fractal((4096, 1024), _HURST, of_relief)),
        detail=PeriodicSurface(_FINE, np.float32(_DETAIL) * fractal((1024, 1024), _DETAIL_HURST, of_detail)),
        brightness=PeriodicSurface(_FINE, np.ones((1, 1), dtype=np.float32)),
    )


def mola_grid(
    terrain: SiteTerrain,
    points: Array,
    posts_per_degree: int,
    noise: float,
    shift: Array,
    missing: float,
    rng: np.random.Generator,
) -> TerrainGrid:
    """Posts, as MEGDR's at odd multiples of half a step, under points (n, 3) in m and some beyond.

    Parameters
    ----------
    terrain : SiteTerrain
        True ground.
    points : (n, 3)
        m, body-fixed.
    posts_per_degree : int
    noise : float
        m rms, of each post.
    shift : (2,)
        m east and north by which the grid's content lies off the truth.
    missing : float
        Share of the posts that are NaN.
    rng : Generator
    """
    step = DEG / posts_per_degree
    lon, lat, _ = planetocentric(points).T
    turned = in_turn(lon, terrain.centre_lon)
    west, south = (int(np.floor(one.min() / step - 0.5)) - _BEYOND for one in (turned, lat))
    east, north = (int(np.ceil(one.max() / step - 0.5)) + _BEYOND for one in (turned, lat))
    columns, rows = (np.arange(west, east + 1) + 0.5) * step, (np.arange(north, south - 1, -1) + 0.5) * step
    grid_lon, grid_lat = (one.ravel() for one in np.meshgrid(columns, rows))
    radii = cell_means(terrain, grid_lon, grid_lat, step, shift, _PARTS)
    radii += noise * rng.standard_normal(radii.size)
    radii[rng.random(radii.size) < missing] = np.nan
    return TerrainGrid(
        source=f"simulated block at {posts_per_degree} posts per degree",
        radii=radii.reshape(rows.size, columns.size),
        first_longitude=float(columns[0]),
        first_latitude=float(rows[0]),
        longitude_step=step,
        latitude_step=step,
        vertical_sigma=noise or None,
    )

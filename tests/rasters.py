"""Rasters in map projections: hills as posts of any projection would have them, by formulas of Snyder (1987)."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mgsgraph.geometry.body import from_planetocentric
from mgsgraph.geometry.records import Array
from mgsgraph.simulation.orbit import MARS
from mgsgraph.units import DEG

RADIUS = 3396190.0
MIDDLE = np.array([87.0, 4.1]) * DEG
"""rad, of the site."""
STEP = 500.0
"""m, between posts."""
SPHERE, FLAT = f"+R={RADIUS}", f"+a={MARS.equatorial} +b={MARS.polar}"


def ground(longitudes: Array, latitudes: Array) -> Array:
    """m above the sphere, at planetocentric places in rad: hills 60 km wide."""
    return np.asarray(-2000.0 + 300.0 * np.sin(360.0 * longitudes) * np.cos(330.0 * latitudes))


def equirectangular(x: Array, y: Array) -> Array:
    return np.stack([84.0 * DEG + x / (RADIUS * np.cos(20.0 * DEG)), -10.0 * DEG + y / RADIUS])


def sinusoidal(x: Array, y: Array) -> Array:
    return np.stack([80.0 * DEG + x / (RADIUS * np.cos(y / RADIUS)), y / RADIUS])


def transverse_mercator(x: Array, y: Array) -> Array:
    d = y / RADIUS
    longitude = 86.0 * DEG + np.arctan2(np.sinh(x / RADIUS), np.cos(d))
    return np.stack([longitude, np.arcsin(np.sin(d) / np.cosh(x / RADIUS))])


def polar_stereographic(x: Array, y: Array) -> Array:
    return np.stack([np.arctan2(x, y), 2.0 * np.arctan(np.hypot(x, y) / (2.0 * RADIUS)) - 0.5 * np.pi])


PROJECTIONS: dict[str, tuple[str, Callable[[Array, Array], Array]]] = {
    "equirectangular": (f"+proj=eqc +lat_0=-10 +lat_ts=20 +lon_0=84 {SPHERE}", equirectangular),
    "sinusoidal": (f"+proj=sinu +lon_0=80 {SPHERE}", sinusoidal),
    "transverse Mercator": (f"+proj=tmerc +lon_0=86 {SPHERE}", transverse_mercator),
    "polar stereographic": (f"+proj=stere +lat_0=-90 +lon_0=0 {SPHERE}", polar_stereographic),
}
"""PROJ's definition, and longitude and latitude (2, n) in rad of x and y (n,) in m, closed: Snyder (1987)."""


def raster(
    path: Path, values: Array, crs: str, transform: Any, unit: str | None = None, **more: Any
) -> Path:
    """A GeoTIFF."""
    rasterio = pytest.importorskip("rasterio")
    with rasterio.open(
        path, "w", driver="GTiff", height=values.shape[0], width=values.shape[1], count=1, dtype=values.dtype, crs=crs,
        transform=transform, **more,
    ) as file:
        file.write(values, 1)
        if unit is not None:
            file.units = (unit,)
    return path


def pixels(
    crs: str, turned: float = 0.0, shape: tuple[int, int] = (30, 40), step: float = STEP, middle: Array = MIDDLE
) -> tuple[Any, Array, Array]:
    """An affine map of pixels about a place, turned by degrees, and x and y of their centres; `step` in m."""
    import rasterio
    from rasterio.warp import transform

    size = step / DEG / RADIUS if "longlat" in crs else step
    degrees = " ".join(["+proj=longlat", *(term for term in crs.split() if term.startswith(("+R=", "+a=", "+b=")))])
    (x,), (y,) = transform(degrees, crs, *([angle] for angle in middle / DEG))
    place = rasterio.Affine.translation(x, y) @ rasterio.Affine.rotation(turned) @ rasterio.Affine.scale(size, -size)
    place = place @ rasterio.Affine.translation(-shape[1] / 2, -shape[0] / 2)
    row, column = (one.ravel() + 0.5 for one in np.indices(shape, dtype=float))
    a, b, c, d, e, f = place[:6]
    return place, a * column + b * row + c, d * column + e * row + f


def on_sphere(x: Array, y: Array) -> Array:
    """(n, 3) m, the hills at planetocentric places (n,) in rad."""
    return from_planetocentric(np.column_stack([x, y, RADIUS + ground(x, y)]))

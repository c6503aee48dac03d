"""Coordinate systems of bodies in PROJ's and GDAL's hands: names, codes, radii, places, and what a GeoTIFF keeps."""

from pathlib import Path

import numpy as np
import pytest
import rasterio
from gis_files import tool
from rasterio.crs import CRS

from mgsgraph.files.rasters.raster_file import authority_code, equal_area_crs, geographic_crs, geotiff, wkt2
from mgsgraph.geometry.body import Ellipsoid
from mgsgraph.registration.dem.gridding import MapGrid

pyproj = pytest.importorskip("pyproj", reason="pyproj (of the extra [tables]) is not installed")
BODIES = {
    (3396190.0, 3376200.0): ("IAU_2015:49900", "Mars (2015) - Sphere / Ocentric"),
    (1737400.0, 1737400.0): ("IAU_2015:30100", "Moon (2015) - Sphere / Ocentric"),
    (2440530.0, 2438260.0): ("IAU_2015:19900", "Mercury (2015) - Sphere / Ocentric"),
    (3396000.0, 3376000.0): (None, "Mars, sphere of 3396000.000 m / Ocentric"),
    (252100.0, 248300.0): (None, "Body, sphere of 252100.000 m / Ocentric"),
}
"""Code and name by radii in m."""


@pytest.mark.parametrize("radii", BODIES)
def test_proj_knows_the_body_by_its_name_and_size(radii: tuple[float, float]) -> None:
    body = Ellipsoid(*radii)
    code, name = BODIES[radii]
    assert authority_code(body) == code
    for system in (
        pyproj.CRS.from_json_dict(geographic_crs(body)), pyproj.CRS.from_wkt(wkt2(geographic_crs(body)))
    ):
        assert (system.name, system.is_geographic) == (name, True)
        assert (system.ellipsoid.semi_major_metre, system.ellipsoid.semi_minor_metre) == (radii[0], radii[0])
        if code:
            assert system == pyproj.CRS.from_user_input(code)
            assert system.to_authority() == tuple(code.split(":"))
        else:
            assert system.to_authority() is None


@pytest.mark.parametrize("radii", BODIES)
@pytest.mark.parametrize("middle", [(175.3, -14.6), (-120.123457, 88.0), (0.0, 0.0)])
def test_the_plane_is_that_of_proj_s_laea_on_the_same_body(
    radii: tuple[float, float], middle: tuple[float, float]
) -> None:
    body, (longitude, latitude) = Ellipsoid(*radii), middle
    system = pyproj.CRS.from_json_dict(equal_area_crs(body, longitude, latitude))
    assert system.name.startswith(f"{BODIES[radii][1]} / Lambert Azimuthal Equal Area")
    assert system.geodetic_crs is not None
    assert system.geodetic_crs.name == BODIES[radii][1]
    words = f"+proj=laea +lat_0={latitude} +lon_0={longitude} +R={radii[0]} +units=m"
    between = pyproj.Transformer.from_crs(words, system, always_xy=True)
    places = np.random.default_rng(1).uniform(-1e5, 1e5, (2, 50))
    np.testing.assert_allclose(between.transform(*places), places, rtol=0.0, atol=1e-6)


@pytest.mark.program("gdalinfo")
@pytest.mark.parametrize("radii", BODIES)
def test_a_raster_keeps_the_name(radii: tuple[float, float], tmp_path: Path) -> None:
    grid = MapGrid(175.3, -14.6, radii[0], -1500.0, 1000.0, 10.0, 200, 300)
    path = tmp_path / "map.tif"
    shape = (1, grid.rows, grid.columns)
    with geotiff(path, shape, grid.crs, (grid.west, grid.north), (10.0, 10.0), dtype="float32") as file:
        file.write(np.ones(shape, dtype=np.float32))
    said = tool("gdalinfo", path)
    assert f'BASEGEOGCRS["{BODIES[radii][1]}"' in said
    assert "unknown" not in said.lower()
    with rasterio.open(path) as file:
        assert file.crs == CRS.from_wkt(grid.crs)
        assert BODIES[radii][1] in file.crs.to_wkt()

"""Terrain models in map projections: posts where formulas of Snyder (1987) have them, whatever heights are above."""

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from rasters import FLAT, PROJECTIONS, RADIUS, SPHERE, STEP, ground, on_sphere, pixels, raster, sinusoidal

from mgsgraph.errors import InputError
from mgsgraph.files.rasters.terrain_file import TerrainRaster, map_projection, read_terrain
from mgsgraph.geometry.body import Ellipsoid, from_geodetic, from_planetocentric, geodetic, planetocentric
from mgsgraph.geometry.records import Array
from mgsgraph.geometry.terrain import TerrainGrid
from mgsgraph.simulation.orbit import MARS
from mgsgraph.units import DEG, KM

rasterio = pytest.importorskip("rasterio")
def all_points(model: TerrainGrid | TerrainRaster | None) -> Array:
    """(n, 3) m, posts of a model by rows."""
    assert model is not None
    lattice = model.lattice()
    row, column = (one.ravel() for one in np.indices(lattice.values.shape, dtype=float))
    return lattice.located(row, column, lattice.values.ravel().astype(float))


@pytest.mark.parametrize("turned", [0.0, 25.0])
@pytest.mark.parametrize("name", PROJECTIONS)
def test_posts_are_where_the_projection_has_them(name: str, turned: float, tmp_path: Path) -> None:
    crs, inverse = PROJECTIONS[name]
    place, x, y = pixels(crs, turned)
    longitudes, latitudes = inverse(x, y)
    values = ground(longitudes, latitudes).reshape(30, 40)
    model = read_terrain(raster(tmp_path / "a.tif", values, crs, place), RADIUS, body=MARS)

    np.testing.assert_allclose(all_points(model), on_sphere(longitudes, latitudes), rtol=0, atol=1e-4)
    # patches: between the posts by as much as bilinear interpolation misses of hills 60 km wide
    assert isinstance(model, TerrainRaster)
    grid = model.grid()
    longitudes, latitudes, radii = planetocentric(on_sphere(longitudes, latitudes)[45:-45]).T
    off = grid.at(from_planetocentric(np.column_stack([longitudes, latitudes, radii]))) - radii
    assert np.nanmax(np.abs(off)) < 2.0 * 300.0 / 8.0 * (360.0 * STEP / RADIUS) ** 2 * 2.0
    assert np.count_nonzero(np.isfinite(off)) > 0.8 * off.size


@pytest.mark.parametrize("above", ["radii", "sphere", "ellipsoid", "areoid"])
@pytest.mark.parametrize(("projection", "flat"), [("longlat", False), ("longlat", True), ("eqc", False)])
def test_latitudes_and_heights_of_all_kinds(projection: str, above: str, flat: bool, tmp_path: Path) -> None:
    """Planetocentric on a sphere, planetographic on an ellipsoid; points are the same to what float64 leaves."""
    crs = f"+proj={projection} {FLAT if flat else SPHERE}"
    place, x, y = pixels(crs)
    longitudes, latitudes = (x, y) if projection == "longlat" else (x / RADIUS / DEG, y / RADIUS / DEG)
    own = np.stack([longitudes, latitudes]) * DEG
    points = from_geodetic(np.column_stack([*own, ground(*own)]), MARS) if flat else on_sphere(*own)
    areoid = TerrainGrid("areoid", np.add.outer([3395e3, 3396e3], [0.0, 100.0]), 1.4, 0.1, 0.2, 0.1, kind="areoid")
    radii = np.linalg.norm(points, axis=1)
    values, reference = {
        "radii": (radii, 0.0),
        "sphere": (radii - 3390000.0, 3390000.0),
        "ellipsoid": (geodetic(points, MARS)[:, 2], MARS),
        "areoid": (radii - areoid.at(points), areoid),
    }[above]
    path = raster(tmp_path / "a.tif", values.reshape(30, 40), crs, place)
    model = read_terrain(path, reference)

    assert isinstance(model, TerrainGrid) != flat
    np.testing.assert_allclose(all_points(model), points, rtol=0, atol=1e-4)
    if isinstance(model, TerrainRaster):
        inside = points.reshape(30, 40, 3)[5:-5, 5:-5].reshape(-1, 3)
        off = model.grid().at(inside) - np.linalg.norm(inside, axis=1)
        assert np.abs(off).max() < 2.0
        assert abs(off.mean()) < 0.3


def test_units_pixels_as_points_and_missing_posts(tmp_path: Path) -> None:
    crs, _ = PROJECTIONS["sinusoidal"]
    place, x, y = pixels(crs)
    heights = ground(*sinusoidal(x, y)).reshape(30, 40)
    plain = all_points(read_terrain(raster(tmp_path / "m.tif", heights, crs, place, "metre"), RADIUS))
    thousands = raster(tmp_path / "km.tif", heights / KM, crs, place, "km")
    np.testing.assert_allclose(all_points(read_terrain(thousands, RADIUS)), plain, rtol=0, atol=1e-6)
    # GDAL moves the corner of a file whose pixels are points by half of one, and so their centres are the same
    assert rasterio.open(raster(tmp_path / "p.tif", heights, crs, place, AREA_OR_POINT="Point")).transform == place
    kilometres = rasterio.Affine.scale(1e-3) @ place
    there = all_points(read_terrain(raster(tmp_path / "x.tif", heights, f"{crs} +units=km", kilometres), RADIUS))
    np.testing.assert_allclose(there, plain, rtol=0, atol=1e-4)
    heights[3, 4], heights[5, 6], heights[7, 8] = -9999.0, np.nan, -3.4e38
    model = read_terrain(raster(tmp_path / "n.tif", heights.astype(np.float32), crs, place, nodata=-9999.0), RADIUS)
    assert model is not None
    assert np.argwhere(np.isnan(model.lattice().values)).tolist() == [[3, 4], [5, 6], [7, 8]]
    with pytest.raises(InputError, match="heights in 'ft'"):
        read_terrain(raster(tmp_path / "ft.tif", heights, crs, place, "ft"), RADIUS)


@pytest.mark.parametrize("name", [*PROJECTIONS, "longlat"])
def test_only_what_lies_around_points_is_read(name: str, tmp_path: Path) -> None:
    crs = PROJECTIONS[name][0] if name in PROJECTIONS else f"+proj=longlat {SPHERE}"
    place, _, _ = pixels(crs, 0.0, (300, 400))
    values = np.add.outer(np.arange(300.0), 1000.0 * np.arange(400.0)).astype(np.float32)
    path = raster(tmp_path / "a.tif", values, crs, place, tiled=True, blockxsize=64, blockysize=64)
    whole = all_points(read_terrain(path, RADIUS)).reshape(300, 400, 3)
    near = whole[100:121, 200:211].reshape(-1, 3)
    model = read_terrain(path, RADIUS, near=near)
    assert model is not None
    assert model.lattice().values.shape == pytest.approx((30, 20), abs=3)
    there = all_points(model)
    gap = np.linalg.norm(there[:, None] - near[None], axis=2).min(axis=0)
    assert gap.max() < 1e-3
    assert read_terrain(path, RADIUS, near=-near) is None or name == "polar stereographic"


def test_a_window_across_the_seam_of_a_whole_body(tmp_path: Path) -> None:
    for crs in (f"+proj=longlat {SPHERE}", f"+proj=longlat {FLAT}"):
        values = np.add.outer(np.arange(90.0), 100.0 * np.arange(180.0))
        place = rasterio.Affine(2.0, 0.0, 0.0, 0.0, -2.0, 90.0)
        path = raster(tmp_path / "a.tif", values, crs, place)
        near = from_planetocentric(np.array([[-0.03, 0.1, RADIUS], [0.03, 0.1, RADIUS]]))
        part, whole = read_terrain(path, RADIUS, near=near), read_terrain(path, RADIUS)
        assert part is not None
        assert part.lattice().values.shape[1] < 15
        every = all_points(whole)
        gap = np.linalg.norm(all_points(part)[:, None] - every[None], axis=2).min(axis=1)
        assert gap.max() < 1e-3


def test_a_raster_that_holds_the_pole(tmp_path: Path) -> None:
    crs, _ = PROJECTIONS["polar stereographic"]
    place = rasterio.Affine(20e3, 0.0, -210e3, 0.0, -20e3, 210e3)
    model = read_terrain(raster(tmp_path / "a.tif", np.full((21, 21), -1000.0), crs, place), RADIUS)
    assert isinstance(model, TerrainRaster)
    grid = model.grid()
    assert grid.wraps
    around = np.column_stack([np.linspace(-3.0, 3.0, 50), np.linspace(-90.0, -87.0, 50) * DEG, np.full(50, RADIUS)])
    np.testing.assert_allclose(grid.at(from_planetocentric(around)), RADIUS - 1000.0, rtol=0, atol=1e-6)


@pytest.mark.parametrize(
    ("crs", "place", "said"),
    [
        (f"+proj=sinu +R={1737400.0}", (500.0, 0, 0, 0, -500.0, 0), "coordinates on a body of 1737 km"),
        ("EPSG:4326", (0.01, 0, 175.0, 0, -0.01, -14.0), "coordinates on a body of 6378 km"),
        ("", (0.01, 0, 175.0, 0, -0.01, -14.0), "no coordinate reference system"),
        (f"+proj=sinu {SPHERE}", (1.0, 0, 0, 0, 1.0, 0), "no place of its pixels"),
    ],
)
@pytest.mark.filterwarnings("ignore::rasterio.errors.NotGeoreferencedWarning")
def test_rasters_of_other_bodies_or_of_no_place(crs: str, place: Any, said: str, tmp_path: Path) -> None:
    path = raster(tmp_path / "a.tif", np.full((4, 4), -1900.0), crs, rasterio.Affine(*place))
    with pytest.raises(InputError, match=said):
        read_terrain(path, RADIUS, body=MARS)


@pytest.mark.parametrize("post", [1e20, -32768.0, np.inf])
def test_one_post_that_no_body_has(post: float, tmp_path: Path) -> None:
    """One bit turned in its exponent, or a missing one that nothing calls so; what is no number is missing anyway."""
    values = np.full((30, 40), -1900.0)
    values[3, 4] = post
    path = raster(tmp_path / "a.tif", values, f"+proj=longlat {SPHERE}", pixels("+proj=longlat")[0])
    if np.isinf(post):
        assert read_terrain(path, RADIUS, body=MARS) is not None
        return
    for reference, off in ((RADIUS, 0.0), (MARS, 0.0), (0.0, RADIUS)):
        raster(path, values + off, f"+proj=longlat {SPHERE}", pixels("+proj=longlat")[0])
        with pytest.raises(InputError, match="a post of"):
            read_terrain(path, reference, body=MARS)


@pytest.mark.parametrize(
    ("radius", "polar", "low", "high"), [(285e3, 229e3, -22.4e3, -5e3), (13e3, 9.1e3, -1500.0, 300.0)]
)
def test_small_bodies_are_not_round(radius: float, polar: float, low: float, high: float, tmp_path: Path) -> None:
    """Regions of Vesta and of Phobos, above spheres; what is no number there is refused still."""
    crs, body = f"+proj=longlat +R={radius}", Ellipsoid(radius, polar)
    place = rasterio.Affine(0.01, 0.0, 87.0, 0.0, -0.01, 4.0)
    values = np.linspace(low, high, 120).reshape(10, 12)
    model = read_terrain(raster(tmp_path / "a.tif", values, crs, place), radius, body=body)
    radii = np.linalg.norm(all_points(model), axis=1)
    np.testing.assert_allclose([radii.min(), radii.max()], [radius + low, radius + high], rtol=1e-9)
    values[3, 4] = 0.5 * radius
    with pytest.raises(InputError, match="a post of"):
        read_terrain(raster(tmp_path / "a.tif", values, crs, place), radius, body=body)


def test_topography_of_another_projection_is_refused(tmp_path: Path) -> None:
    """Its place depends on its height: without a reference nobody knows that."""
    crs, _ = PROJECTIONS["sinusoidal"]
    path = raster(tmp_path / "a.tif", np.full((30, 40), -1900.0), crs, pixels(crs)[0])
    with pytest.raises(InputError, match="topography in the projection 'sinu'"):
        read_terrain(path, kind="topography")


@pytest.mark.parametrize(("code", "said"), [(49901, "positive to the west"), (49902, "latitudes on an ellipsoid")])
def test_coordinates_that_a_geotiff_cannot_have(code: int, said: str, tmp_path: Path) -> None:
    """IAU's systems of planetographic latitudes with west longitudes, and of planetocentric ones on an ellipsoid."""
    file = SimpleNamespace(crs=rasterio.CRS.from_user_input(f"IAU_2015:{code}"), transform=pixels("+proj=longlat")[0])
    with pytest.raises(InputError, match=said):
        map_projection(file, tmp_path / "a.tif", None)


@pytest.mark.parametrize("grids", ["+nadgrids=/dev/zero", "+geoidgrids=egm.gtx"])
def test_coordinates_by_other_files_are_refused(grids: str, tmp_path: Path) -> None:
    crs = rasterio.CRS.from_user_input(f"+proj=longlat {SPHERE} {grids} +type=crs")
    file = SimpleNamespace(crs=crs, transform=pixels("+proj=longlat")[0])
    with pytest.raises(InputError, match="a coordinate system by other files"):
        map_projection(file, tmp_path / "a.tif", None)


def test_heights_above_another_ellipsoid_than_that_of_the_latitudes(tmp_path: Path) -> None:
    crs, other = f"+proj=longlat {SPHERE}", Ellipsoid(3396000.0, 3378000.0)
    place, x, y = pixels(crs)
    points = on_sphere(x * DEG, y * DEG)
    path = raster(tmp_path / "a.tif", geodetic(points, other)[:, 2].reshape(30, 40), crs, place)
    np.testing.assert_allclose(all_points(read_terrain(path, other)), points, rtol=0, atol=1e-4)

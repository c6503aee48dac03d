"""Terrain: posts where formulas of Snyder, MEGDR's labels and the altimeter's own shots have them; names of systems."""

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from outside import refuses
from rasters import FLAT, PROJECTIONS, RADIUS, SPHERE, STEP, ground, on_sphere, pixels, raster, sinusoidal

from mgsgraph.files.altimetry.shots import read_shots
from mgsgraph.files.rasters.megdr import read_megdr
from mgsgraph.files.rasters.raster_file import authority_code, equal_area_crs, geographic_crs, wkt2
from mgsgraph.files.rasters.terrain_file import TerrainRaster, map_projection, read_terrain
from mgsgraph.geometry.body import Ellipsoid, from_geodetic, from_planetocentric, geodetic, planetocentric
from mgsgraph.geometry.records import Array
from mgsgraph.geometry.terrain import TerrainGrid, areoid_grid, areoid_heights
from mgsgraph.simulation.orbit import MARS
from mgsgraph.units import DEG, KM

# --- in map projections


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
    refuses("heights in 'ft'", read_terrain, raster(tmp_path / "ft.tif", heights, crs, place, "ft"), RADIUS)


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
    refuses(said, read_terrain, path, RADIUS, body=MARS)


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
        refuses("a post of", read_terrain, path, reference, body=MARS)


def test_small_bodies_are_not_round(tmp_path: Path) -> None:
    """A region of Phobos, above a sphere; what is no number there is refused still."""
    radius, crs = 13e3, "+proj=longlat +R=13000"
    place, body = rasterio.Affine(0.01, 0.0, 87.0, 0.0, -0.01, 4.0), Ellipsoid(radius, 9.1e3)
    values = np.linspace(-1500.0, 300.0, 120).reshape(10, 12)
    model = read_terrain(raster(tmp_path / "a.tif", values, crs, place), radius, body=body)
    radii = np.linalg.norm(all_points(model), axis=1)
    np.testing.assert_allclose([radii.min(), radii.max()], [11_500.0, 13_300.0], rtol=1e-9)
    values[3, 4] = 0.5 * radius
    refuses("a post of", read_terrain, raster(tmp_path / "a.tif", values, crs, place), radius, body=body)


def test_topography_of_another_projection_is_refused(tmp_path: Path) -> None:
    """Its place depends on its height: without a reference nobody knows that."""
    crs, _ = PROJECTIONS["sinusoidal"]
    path = raster(tmp_path / "a.tif", np.full((30, 40), -1900.0), crs, pixels(crs)[0])
    refuses("topography in the projection 'sinu'", read_terrain, path, kind="topography")


@pytest.mark.parametrize(("code", "said"), [(49901, "positive to the west"), (49902, "latitudes on an ellipsoid")])
def test_coordinates_that_a_geotiff_cannot_have(code: int, said: str, tmp_path: Path) -> None:
    """IAU's systems of planetographic latitudes with west longitudes, and of planetocentric ones on an ellipsoid."""
    file = SimpleNamespace(crs=rasterio.CRS.from_user_input(f"IAU_2015:{code}"), transform=pixels("+proj=longlat")[0])
    refuses(said, map_projection, file, tmp_path / "a.tif", None)


def test_coordinates_by_other_files_are_refused(tmp_path: Path) -> None:
    crs = rasterio.CRS.from_user_input(f"+proj=longlat {SPHERE} +nadgrids=/dev/zero +type=crs")
    file = SimpleNamespace(crs=crs, transform=pixels("+proj=longlat")[0])
    refuses("a coordinate system by other files", map_projection, file, tmp_path / "a.tif", None)


def test_heights_above_another_ellipsoid_than_that_of_the_latitudes(tmp_path: Path) -> None:
    crs, other = f"+proj=longlat {SPHERE}", Ellipsoid(3396000.0, 3378000.0)
    place, x, y = pixels(crs)
    points = on_sphere(x * DEG, y * DEG)
    path = raster(tmp_path / "a.tif", geodetic(points, other)[:, 2].reshape(30, 40), crs, place)
    np.testing.assert_allclose(all_points(read_terrain(path, other)), points, rtol=0, atol=1e-4)


# --- MEGDR grids, by label, by name, and against real shots


def label(
    lines: int = 720, samples: int = 1440, resolution: float = 4.0, product: str = "MEGR90N000CB.IMG", **changed: object
) -> str:
    """A label in the style of the archive's; offsets follow dsmap.cat for a global grid."""
    values: dict[str, object] = {
        "PDS_VERSION_ID": "PDS3", "RECORD_TYPE": "FIXED_LENGTH", "RECORD_BYTES": 2 * samples, "FILE_RECORDS": lines,
        "^IMAGE": f'"{product}"', "PRODUCT_ID": f'"{product}"', "LINES": lines, "LINE_SAMPLES": samples,
        "SAMPLE_TYPE": "MSB_INTEGER", "SAMPLE_BITS": 16, "UNIT": "METER",
        "MAP_PROJECTION_TYPE": '"SIMPLE CYLINDRICAL"', "CENTER_LATITUDE": "0.0 <DEGREE>",
        "CENTER_LONGITUDE": "180.0 <DEGREE>", "MAP_RESOLUTION": f"{resolution} <PIXEL/DEGREE>",
        "LINE_PROJECTION_OFFSET": 0.5 * lines + 0.5, "SAMPLE_PROJECTION_OFFSET": 0.5 * samples + 0.5,
    } | changed
    return "\r\n".join(f"{key} = {value}" for key, value in values.items()) + "\r\nEND\r\n"


def radii(lines: int = 720, samples: int = 1440, north: float = 90.0, resolution: float = 4.0) -> np.ndarray:
    """Counts of hills on a planet whose polar radius is 20 km less."""
    latitude = (north - (0.5 + np.arange(lines)) / resolution) * DEG
    hills = np.random.default_rng(1).integers(-2000, 2000, (lines, samples))
    return (hills - 20e3 * np.sin(latitude)[:, None] ** 2).astype(int)


def image(folder: Path, name: str, counts: np.ndarray) -> Path:
    path = folder / name
    counts.astype(">i2").tofile(path)
    return path


def test_label_and_name_agree(tmp_path: Path) -> None:
    counts = radii()
    path = image(tmp_path, "megr90n000cb.img", counts)
    by_name = read_megdr(path)
    (tmp_path / "MEGR90N000CB.LBL").write_text(label())
    for given in (path, tmp_path / "MEGR90N000CB.LBL"):
        by_label = read_megdr(given)
        for field in ("first_longitude", "first_latitude", "longitude_step", "latitude_step"):
            assert abs(getattr(by_label, field) - getattr(by_name, field)) < 1e-12
        np.testing.assert_array_equal(by_label.radii, by_name.radii)
        assert by_label.kind == "radius"
        assert by_label.wraps
    np.testing.assert_array_equal(by_name.radii, counts + 3396000)
    np.testing.assert_allclose(by_name.first_latitude / DEG, 89.875)
    np.testing.assert_allclose(by_name.first_longitude / DEG, 0.125)


def test_the_archives_own_offset_of_a_southern_tile(tmp_path: Path) -> None:
    """LINE_PROJECTION_OFFSET = -5631.5 stands in the labels of the 128 pixel tiles that begin at 44 S."""
    (tmp_path / "megt44s090hb.lbl").write_text(label(
        5632, 11520, 128.0, "MEGT44S090HB.IMG", LINE_PROJECTION_OFFSET=-5631.5, SAMPLE_PROJECTION_OFFSET=11520.5,
    ))
    path = tmp_path / "megt44s090hb.img"
    with path.open("wb") as file:
        file.truncate(5632 * 11520 * 2)
    corner = from_planetocentric(np.array([[90.0 * DEG, -44.0 * DEG, 3390e3]]))  # the whole has 65 million posts
    by_label = read_megdr(path, near=corner)
    (tmp_path / "megt44s090hb.lbl").unlink()
    by_name = read_megdr(path, near=corner)

    assert by_label.radii.shape == by_name.radii.shape
    assert max(by_label.radii.shape) < 10
    np.testing.assert_allclose(by_label.first_latitude / DEG, -44.0 - 0.5 / 128.0, rtol=1e-14)
    np.testing.assert_allclose(by_label.first_longitude / DEG, 90.0 + 0.5 / 128.0, rtol=1e-14)
    np.testing.assert_allclose(by_name.first_latitude, by_label.first_latitude, rtol=1e-14)
    np.testing.assert_allclose(by_name.first_longitude, by_label.first_longitude, rtol=1e-14)
    assert not by_label.wraps
    assert by_label.kind == "topography"


def test_only_what_lies_around_points_is_read_of_megdr(tmp_path: Path) -> None:
    """Across the seam of the whole body, too; nothing, where there is nothing."""
    path = image(tmp_path, "megr90n000cb.img", radii())
    whole = read_megdr(path)
    for longitude in (0.0, 100.0):
        places = np.array([[longitude - 0.7, 12.0, 3390e3], [longitude + 0.9, 12.6, 3390e3]]) * [DEG, DEG, 1.0]
        near = from_planetocentric(places)
        part = read_megdr(path, 10.0, near=near)
        assert part.radii.size < 300
        assert not part.wraps
        assert part.vertical_sigma == 10.0
        np.testing.assert_allclose(part.at(near), whole.at(near), rtol=0, atol=1e-3)
    tile = image(tmp_path, "megt90n180gb.img", np.zeros((90 * 64, 180 * 64)))
    assert read_megdr(tile, near=from_planetocentric(np.array([[0.5, 0.2, 3390e3]]))) is None


def test_sixteen_pixels_areoid_and_offset_in_the_label(tmp_path: Path) -> None:
    path = image(tmp_path, "grid.img", radii(4, 8, 90.0, 1.0 / 45.0))
    (tmp_path / "grid.lbl").write_text(label(4, 8, 1.0 / 45.0, "MEGA90N000EB.IMG", OFFSET=3396000, SCALING_FACTOR=1))
    grid = read_megdr(path)

    assert grid.kind == "areoid"
    np.testing.assert_array_equal(grid.radii, 3396000.0 + radii(4, 8, 90.0, 1.0 / 45.0))


@pytest.mark.parametrize(("kind", "bits"), [("u1", 8), (">u2", 16)])
def test_counts_of_shots_have_one_byte_or_two(tmp_path: Path, kind: str, bits: int) -> None:
    """By the label, or without one by the size of the file."""
    counts = np.random.default_rng(1).integers(0, 255, (720, 1440))
    path = tmp_path / "megc90n000cb.img"
    counts.astype(kind).tofile(path)
    by_name = read_megdr(path)
    (tmp_path / "megc90n000cb.lbl").write_text(label(product="MEGC90N000CB.IMG", SAMPLE_BITS=bits))
    for found in (by_name, read_megdr(path)):
        assert found.kind == "counts"
        np.testing.assert_array_equal(found.radii, counts)


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"MAP_PROJECTION_TYPE": '"POLAR STEREOGRAPHIC"'}, "POLAR STEREOGRAPHIC"),
        ({"SAMPLE_TYPE": "IEEE_REAL", "SAMPLE_BITS": 32}, "IEEE_REAL 32"),
        ({"LINES": 721}, "2073600 bytes; expected 2076480"),
        ({"CENTER_LATITUDE": 10.0}, "CENTER_LATITUDE: 10"),
        ({"SCALING_FACTOR": 1e290}, "1e[+]290 m per count"),
    ],
)
def test_labels_that_cannot_be_followed(tmp_path: Path, changed: dict[str, object], message: str) -> None:
    path = image(tmp_path, "megr90n000cb.img", np.zeros((720, 1440)))
    (tmp_path / "megr90n000cb.lbl").write_text(label(**changed))  # type: ignore[arg-type]
    refuses(message, read_megdr, path)


def test_a_short_file_and_a_strange_name(tmp_path: Path) -> None:
    refuses("2070720 bytes; expected 2073600", read_megdr, image(tmp_path, "megr90n000cb.img", np.zeros((719, 1440))))
    refuses("a name without position", read_megdr, image(tmp_path, "terrain.img", np.zeros((3, 3))))


@pytest.mark.parametrize(
    ("true", "said", "top", "bottom"), [("r", "t", 0, 720), ("t", "r", 0, 360), ("t", "a", 360, 720)]
)
def test_heights_tell_radii_from_topography(
    shared_data: Path, tmp_path: Path, true: str, said: str, top: int, bottom: int
) -> None:
    """A file under another one's name, whole or by hemispheres, of which the real ones pass."""
    content = (shared_data / "mola_megdr" / f"meg{true}90n000cb.img").read_bytes()
    path = image(tmp_path, "a.img", np.frombuffer(content[top * 2880 : bottom * 2880], ">i2"))
    offset = 4 * (90 - top // 4) + 0.5
    products = [f"MEG{name.upper()}90N000CB.IMG" for name in (true, said)]
    real, other = (label(bottom - top, product=name, LINE_PROJECTION_OFFSET=offset) for name in products)
    (tmp_path / "a.lbl").write_text(real)
    assert read_megdr(path).radii.shape == (bottom - top, 1440)
    (tmp_path / "a.lbl").write_text(other)
    refuses("km from the equator to the poles", read_megdr, path)


@pytest.mark.parametrize(("site", "largest"), [("insight", 10.0), ("opportunity", 15.0)])
def test_real_grid_against_real_shots(shared_data: Path, site: str, largest: float) -> None:
    """On flat ground shots and grid agree to metres, and a grid moved by one post in any direction agrees worse."""
    shots = read_shots(shared_data / "mola_pedr_ode" / f"{site}_topography.csv")
    grid = read_megdr(shared_data / "mola_megdr" / "megr90n000cb.img")
    radii = np.linalg.norm(shots.footprints, axis=1)
    longitudes = np.arctan2(shots.footprints[:, 1], shots.footprints[:, 0])
    latitudes = np.arcsin(shots.footprints[:, 2] / radii)

    def height_difference(east: int, south: int) -> float:
        values, _, _ = grid.radius(longitudes + east * grid.longitude_step, latitudes - south * grid.latitude_step)
        return float(np.median(np.abs(radii - values)))

    here = height_difference(0, 0)
    assert here < largest
    assert all(height_difference(east, south) > 1.4 * here for east, south in ((1, 0), (-1, 0), (0, 1), (0, -1)))


@pytest.mark.parametrize("site", ["insight", "opportunity"])
def test_real_areoid_against_real_shots(shared_data: Path, site: str) -> None:
    shots = read_shots(shared_data / "mola_pedr_ode" / f"{site}_topography.csv")
    folder = shared_data / "mola_megdr"
    areoid = areoid_grid(read_megdr(folder / "megr90n000cb.img"), read_megdr(folder / "megt90n000cb.img"))
    off = areoid.at(shots.footprints) - shots.areoid_radii

    assert np.median(np.abs(off)) < 3.0
    topography = np.linalg.norm(shots.footprints, axis=1) - shots.areoid_radii
    np.testing.assert_allclose(areoid_heights(shots.footprints, areoid), topography - off, rtol=0, atol=1e-6)


# --- coordinate systems of bodies in PROJ's and GDAL's hands


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
    pyproj = pytest.importorskip("pyproj", reason="pyproj (of the extra [tables]) is not installed")
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
@pytest.mark.parametrize("middle", [(175.3, -14.6), (-120.123457, 88.0)])
def test_the_plane_is_that_of_proj_s_laea_on_the_same_body(
    radii: tuple[float, float], middle: tuple[float, float]
) -> None:
    pyproj = pytest.importorskip("pyproj", reason="pyproj (of the extra [tables]) is not installed")
    body, (longitude, latitude) = Ellipsoid(*radii), middle
    system = pyproj.CRS.from_json_dict(equal_area_crs(body, longitude, latitude))
    assert system.name.startswith(f"{BODIES[radii][1]} / Lambert Azimuthal Equal Area")
    assert system.geodetic_crs is not None
    assert system.geodetic_crs.name == BODIES[radii][1]
    words = f"+proj=laea +lat_0={latitude} +lon_0={longitude} +R={radii[0]} +units=m"
    between = pyproj.Transformer.from_crs(words, system, always_xy=True)
    places = np.random.default_rng(1).uniform(-1e5, 1e5, (2, 50))
    np.testing.assert_allclose(between.transform(*places), places, rtol=0.0, atol=1e-6)

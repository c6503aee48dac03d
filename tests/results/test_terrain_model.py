"""A terrain model's files in GDAL's hands, its check by laser shots, and that it appears whole or not at all."""

import importlib
import json
import subprocess
from dataclasses import replace
from functools import cache
from pathlib import Path

import dem_site
import numpy as np
import pytest
import rasterio
import shapely
from commands import rows_of
from full_disk import files_of_at_most
from outside import refuses
from rasterio.crs import CRS
from rasterio.warp import transform

from mgsgraph.adjustment.adjust import adjust_network
from mgsgraph.adjustment.graph.variables import footprint_shifts
from mgsgraph.analysis.posterior import Posterior
from mgsgraph.case.case_file import decode
from mgsgraph.case.reading import read_case
from mgsgraph.errors import InputError
from mgsgraph.files.output.folders import DEM, STAC_ITEM, fresh_folder
from mgsgraph.geometry.body import east_north, planetocentric
from mgsgraph.registration.dem.checking import check_profiles, checked
from mgsgraph.registration.dem.model import Dem, DemSettings, dem_of
from mgsgraph.results import terrain_model
from mgsgraph.results.catalog import stac_item
from mgsgraph.results.terrain_model import make_dem, write_dem

SETTINGS = DemSettings(ortho_pixel=12.0)
FILES = {"dem.json", "dem.tif", "ortho.tif", "ortho_sigma.tif", "shots.csv", "dem.stac.json", "dem.png"}


@cache
def made(heights: str = "sphere") -> Dem:
    matches = [dem_site.matched(np.random.default_rng(4))]
    profiles = check_profiles(dem_site.posterior(), decode(dem_site.case_path()), dem_site.case_path())
    settings = replace(SETTINGS, heights=heights)
    return dem_of("test", dem_site.posterior(), dem_site.scene(), matches, 1e-3, settings, profiles)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("dem") / "out"
    with fresh_folder(out, DEM) as temporary:
        write_dem(made(), dem_site.scene(), SETTINGS, temporary, True, lambda what, done, most: None)
    return out


# above two seconds: the site is solved, matched and gridded once for all tests of the file
def test_files_and_record(folder: Path) -> None:
    assert {path.name for path in folder.iterdir()} == FILES
    record = json.loads((folder / DEM).read_text(encoding="utf-8"))
    assert record["posts_with_heights"] == int(np.isfinite(made().heights).sum())
    assert record["checks"][0]["profile"] == "ap18933l"


@pytest.mark.program("gdalinfo")
def test_bands_in_gdal_s_hands(folder: Path) -> None:
    told = json.loads(subprocess.check_output(["gdalinfo", "-json", "-checksum", str(folder / "dem.tif")]))
    names = [band["description"] for band in told["bands"]]
    assert names == [
        "height above a sphere of 3396.190 km", "sigma", "sigma by matching", "sigma by orientation", "number of points"
    ]
    assert [band["unit"] for band in told["bands"]] == ["m"] * 4 + ["1"]
    assert {band["noDataValue"] for band in told["bands"]} == {"NaN"}
    assert {tuple(band["block"]) for band in told["bands"]} == {(256, 256)}
    assert told["metadata"]["IMAGE_STRUCTURE"]["COMPRESSION"] == "DEFLATE"
    assert told["metadata"][""]["images"] == "E02-00665, E02-01453"
    assert "Lambert Azimuthal Equal Area" in told["coordinateSystem"]["wkt"]
    assert 'BASEGEOGCRS["Mars (2015) - Sphere / Ocentric"' in told["coordinateSystem"]["wkt"]
    with rasterio.open(folder / "dem.tif") as file:
        height, sigma, matching, orientation, count = file.read()
    there = np.isfinite(height)
    np.testing.assert_array_equal(np.isfinite(made().heights), there)
    np.testing.assert_allclose(sigma[there] ** 2, matching[there] ** 2 + orientation[there] ** 2, rtol=1e-5)
    assert np.all(count[there] >= 4.0)
    assert np.all(np.isnan(count[~there]))


def test_a_reader_finds_each_height_by_longitude_and_latitude(folder: Path) -> None:
    """GDAL's transformation, not ours: the true ground at random places, read between posts."""
    rng = np.random.default_rng(1)
    with rasterio.open(folder / "dem.tif") as file:
        box = file.bounds
        x, y = rng.uniform(box.left, box.right, 400), rng.uniform(box.bottom, box.top, 400)
        lon, lat = transform(file.crs, "IAU_2015:49900", x.tolist(), y.tolist())
        heights = np.array([value[0] for value in file.sample(zip(x, y, strict=True))])
        sigmas = np.array([value[2] for value in file.sample(zip(x, y, strict=True), indexes=None)])
    true = dem_site.site().terrain.ground_radius(*np.radians([lon, lat])) - 3396190.0
    off = (heights - true)[np.isfinite(heights)]
    assert off.size > 150
    assert np.median(np.abs(off)) < 2.0  # half a post of slope, beside half a metre of noise
    assert np.nanmedian(sigmas) < 1.5


@pytest.mark.parametrize("name", ["dem.tif", "ortho.tif", "ortho_sigma.tif"])
def test_rasters_are_cloud_optimized(folder: Path, name: str) -> None:
    cogeo = pytest.importorskip("rio_cogeo.cogeo", reason="rio-cogeo (of the extra [test]) is not installed")
    assert cogeo.cog_validate(folder / name, strict=True, quiet=True) == (True, [], [])
    with rasterio.open(folder / name) as file:
        assert file.tags(ns="IMAGE_STRUCTURE")["LAYOUT"] == "COG"


def test_the_ortho_image_shows_the_ground_where_it_is(folder: Path) -> None:
    """Its grey values say from which line and sample they come."""
    picture = dem_site.scene().pictures[made().ortho]
    with rasterio.open(folder / "ortho.tif") as file:
        grey = file.read(1)
        assert (file.nodata, file.dtypes) == (0.0, ("uint8",))
        assert file.tags()["image"] == picture.image.name
        rows, columns = np.nonzero(grey)
        some = np.random.default_rng(1).choice(rows.size, 400, replace=False)
        x, y = file.xy(rows[some], columns[some])
        lon, lat = transform(file.crs, "IAU_2015:49900", list(x), list(y))
        low, high = (float(file.tags()[name]) for name in ("grey_1", "grey_255"))
    ground = dem_site.site().terrain.on_ground(*np.radians([lon, lat]))
    places = picture.project(ground)
    bare = dem_site.textured(picture.image.lines, picture.image.samples)
    smooth = np.abs((places[:, 1] // 4 + places[:, 0] // 16) % 254 - 127) < 110  # not where the ramp jumps back
    expected = (bare[tuple(places[smooth].astype(int).T)] - low) * 255.0 / (high - low)
    assert np.median(np.abs(grey[rows, columns][some][smooth] - expected)) < 2.0
    there = np.isfinite(made().heights)
    assert np.mean(grey > 0) == pytest.approx(there.mean(), abs=0.02)
    with rasterio.open(folder / "ortho_sigma.tif") as file:
        np.testing.assert_array_equal(np.isfinite(file.read()), [there] * 3)
        np.testing.assert_allclose(file.read(2)[there], made().ortho_accuracy[1][there], rtol=1e-6)
        assert (file.units, file.descriptions[:2]) == (("m", "m", "1"), ("sigma east", "sigma north"))


def test_pairs_that_share_an_image_are_no_independent_evidence() -> None:
    """The same matches over again, as of the pair with a third image, which is another name for the second."""
    scene, matches = dem_site.scene(), dem_site.matched(np.random.default_rng(4))
    again = replace(scene, pictures=(*scene.pictures, scene.pictures[1]))
    twice = [matches, replace(matches, second=2)]
    one, two = (
        dem_of("test", dem_site.posterior(), some, given, 1e-3, SETTINGS).model
        for some, given in ((scene, twice[:1]), (again, twice))
    )
    np.testing.assert_allclose(two.heights, one.heights, atol=0.5)
    assert 0.9 < np.nanmedian(two.matching / one.matching) < 1.1


def test_heights_above_the_areoid() -> None:
    sphere, areoid = made(), made("areoid")
    grid = areoid.model.map
    assert areoid.reference == "the areoid"
    points = grid.points(grid.posts(), sphere.heights.ravel())
    expected = np.linalg.norm(points, axis=1) - dem_site.posterior().network.areoid.at(points)
    np.testing.assert_allclose(areoid.heights.ravel(), expected, atol=1e-6)
    assert np.nanmedian(sphere.heights - areoid.heights) < -1000.0
    bare = dem_site.posterior()
    without = replace(bare.network, areoid=None)
    layout = replace(bare.linearised.layout, network=without)
    unknown = type(bare)(replace(bare.linearised, layout=layout))
    with pytest.raises(InputError, match="heights: areoid, which the adjusted case doesn't have"):
        dem_of("test", unknown, dem_site.scene(), [], 1.0, DemSettings(heights="areoid"))


# ---- laser shots


def test_shots_that_took_part_are_no_checks() -> None:
    used = {name for name in dem_site.posterior().network.points.ids if name.startswith("ap")}
    profiles = check_profiles(dem_site.posterior(), decode(dem_site.case_path()), dem_site.case_path())
    assert [one.name for one in profiles] == ["ap18933l", "ap19043l"]
    assert all(one.adjusted and (one.sigma, one.height_sigma) == (3.0, 1.0) for one in profiles)
    for one, image in zip(profiles, dem_site.site().images, strict=True):
        mine = [name for name in used if name.startswith(one.name)]
        assert not set(mine) & {f"{one.name}:{shot}" for shot in one.shots.ids}
        assert one.shots.times.size + len(mine) == int(image.profile.ground.sum())


def test_every_fifth_shot_is_kept_out() -> None:
    """Of those that would be used; and of what is not asked for, none."""
    path = dem_site.case_path()
    every = path.with_name("every.toml")
    every.write_text(path.read_text(encoding="utf-8").replace("check_every = 5\n", ""), encoding="utf-8")
    whole, some = read_case(every), read_case(path)
    assert len(whole.profiles) == len(some.profiles) == 2
    for one, other in zip(whole.profiles, some.profiles, strict=True):
        kept = [name for k, name in enumerate(one.ids, start=1) if k % 5]
        assert list(other.ids) == kept
    ranges = len(whole.network.ranges.point) - len(some.network.ranges.point)
    assert ranges == sum(one.times.size // 5 for one in whole.profiles) > 40
    every.write_text(path.read_text(encoding="utf-8").replace("check_every = 5", "check_every = 1"), encoding="utf-8")
    refuses(r"shots\[0\]\.check_every", decode, every)


def test_another_file_is_read_with_what_the_case_says_of_its_own(tmp_path: Path) -> None:
    other = tmp_path / "ap99999l.b"
    other.write_bytes((dem_site.case_path().parent / "ap18933l.b").read_bytes())
    one = check_profiles(dem_site.posterior(), decode(dem_site.case_path()), dem_site.case_path(), (other,))[-1]
    assert (one.name, one.adjusted, one.sigma, one.height_sigma) == ("ap99999l", False, 3.0, 1.0)
    np.testing.assert_array_equal(one.shift, 0.0)
    np.testing.assert_array_equal(one.shift_covariance, 1e4 * np.eye(2))


def test_shots_that_were_kept_out_move_as_their_neighbours_do() -> None:
    """With their profile's beam and drift: as far as the used shots before and after."""
    path = dem_site.case_path().with_name("beams.toml")
    text = dem_site.case_path().read_text(encoding="utf-8")
    unknown = "beam_sigma_mrad = 0.25\ndrift_sigma_m = 30.0"
    path.write_text(text.replace("beam_sigma_mrad = 0.0", unknown), encoding="utf-8")
    case = read_case(path)
    network = case.network
    values = tuple(one.sigmas for one in network.shared)  # as if each were found one sigma off
    moved = footprint_shifts(network, values)
    posterior = Posterior.of(adjust_network(network, case.settings))
    for p, one in enumerate(check_profiles(posterior, decode(path), path)):
        assert one.ways.shape[1:] == (7, 3)
        names = [shared.name for shared in network.shared if one.name in shared.name]
        own = np.concatenate([values[[other.name for other in network.shared].index(name)] for name in names])
        used = np.flatnonzero(network.shifts.profile == p)
        times = network.ranges.times[np.isin(network.ranges.point, used)]
        inside = (one.shots.times > times.min()) & (one.shots.times < times.max())
        expected = np.stack([np.interp(one.shots.times, times, column) for column in moved[used].T], axis=1)[inside]
        np.testing.assert_allclose(np.einsum("w,nwj->nj", own, one.ways[:, 2:])[inside], expected, atol=0.5)
        assert np.linalg.norm(expected, axis=1).max() > 50.0


def test_differences_are_those_of_the_truth_and_as_stated() -> None:
    """Many draws of shots on the true ground, off by what is stated, shift and all."""
    model, rng = made().model, np.random.default_rng(5)
    own = check_profiles(dem_site.posterior(), decode(dem_site.case_path()), dem_site.case_path())[0]
    inside = np.argwhere(np.isfinite(model.heights[2:-2, 2:-2])) + 2
    places = model.map.posts().reshape(*model.heights.shape, 2)[tuple(rng.choice(inside, own.shots.times.size).T)]
    longitude, latitude, _ = planetocentric(model.map.points(places, np.zeros(len(places)))).T
    true = dem_site.site().terrain.on_ground(longitude, latitude)
    shift = np.array([30.0, -40.0])
    given = true + rng.normal(0.0, 1.0, true.shape) - np.einsum("k,nkj->nj", shift, east_north(true))
    one = replace(
        own, shots=replace(own.shots, footprints=given), sigma=1.0, height_sigma=1.0,
        values=shift, covariance=np.eye(2) * 1e-6,
    )
    found = checked(model, [one])
    assert len(found) > 0.9 * len(true)
    assert np.sqrt(np.mean((found.differences / found.independent) ** 2)) == pytest.approx(1.0, abs=0.25)
    assert np.all(found.sigmas > found.independent)
    moved = checked(model, [replace(one, values=-shift)])  # the shift matters
    assert np.std(moved.differences) > 1.2 * np.std(found.differences)
    wide = checked(model, [replace(one, covariance=np.eye(2) * 1e4)])
    assert np.all(wide.sigmas >= found.sigmas)
    assert np.median(wide.sigmas / found.sigmas) > 1.05
    rough = checked(model, [replace(one, height_sigma=3.0)])  # variances add up
    np.testing.assert_allclose(rough.independent**2 - found.independent**2, 8.0, rtol=1e-9)


def test_the_table_has_every_shot_on_the_model(folder: Path) -> None:
    rows = rows_of(folder / "shots.csv")
    assert len(rows) == len(made().checks) > 0
    off = [float(row["model_minus_shot_m"]) for row in rows]
    np.testing.assert_array_equal(off, made().checks.differences)
    for row in rows:
        assert float(row["model_above_sphere_m"]) - float(row["shot_above_sphere_m"]) == pytest.approx(
            float(row["model_minus_shot_m"]), abs=1e-6
        )


def test_a_file_that_does_not_fit_is_an_error(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The whole road but for the matching, over the scene that the test has."""
    matches = dem_site.matched(np.random.default_rng(4))
    monkeypatch.setattr(terrain_model, "read_scene", lambda path, *ground: ("test", dem_site.scene()))
    monkeypatch.setattr(terrain_model, "densely_matched", lambda *given: ((matches,), 1e-3))
    with files_of_at_most(20_000), pytest.raises(InputError, match="can't be written"):
        make_dem(dem_site.solution(), dem_site.case_path(), tmp_path / "out", SETTINGS, figures=False)
    assert list(tmp_path.iterdir()) == []


# ---- the item of a catalog


def test_pystac_takes_the_item(folder: Path) -> None:
    """Against the schemas of STAC 1.1 that pystac brings; those of the extensions lie on the web alone."""
    pystac = pytest.importorskip("pystac", reason="pystac (of the extra [test]) is not installed")
    told = json.loads((folder / STAC_ITEM).read_text(encoding="utf-8"))
    validate, core = importlib.import_module("pystac.validation").validate_dict, told | {"stac_extensions": []}
    assert validate(core) == ["https://schemas.stacspec.org/v1.1.0/item-spec/json-schema/item.json"]
    with pytest.raises(pystac.errors.STACValidationError):
        validate(core | {"bbox": [0.0]})
    item = pystac.Item.from_file(folder / STAC_ITEM)
    assert {"dem", "ortho", "ortho_sigma", "record", "overview"} == set(item.assets)
    assert all((folder / asset.href).is_file() for asset in item.assets.values())
    assert item.properties["ssys:targets"] == ["Mars"]
    assert item.common_metadata.start_datetime < item.common_metadata.end_datetime


@pytest.mark.parametrize("name", ["dem", "ortho", "ortho_sigma"])
def test_the_item_says_of_the_rasters_what_they_are(folder: Path, name: str) -> None:
    told = json.loads((folder / STAC_ITEM).read_text(encoding="utf-8"))
    asset = told["assets"][name]
    with rasterio.open(folder / asset["href"]) as file:
        assert asset["proj:shape"] == [file.height, file.width]
        assert asset["proj:transform"] == pytest.approx(list(file.transform)[:6], abs=1e-9)
        assert asset["proj:bbox"] == pytest.approx(list(file.bounds), abs=1e-6)
        assert CRS.from_wkt(told["properties"]["proj:wkt2"]) == file.crs
        assert CRS.from_dict(told["properties"]["proj:projjson"]) == file.crs
        assert [band["data_type"] for band in asset["bands"]] == list(file.dtypes)
        there = np.argwhere(file.dataset_mask() > 0)[:: 50]
        x, y = file.xy(*there.T)
        lon, lat = transform(file.crs, "IAU_2015:49900", list(x), list(y))
    assert asset["type"] == "image/tiff; application=geotiff; profile=cloud-optimized"
    shape = shapely.geometry.shape(told["geometry"])
    assert shapely.contains_xy(shape.buffer(1e-3), lon, lat).mean() > 0.98  # an ortho pixel may reach beyond its post
    west, south, east, north = told["bbox"]
    assert (west, south, east, north) == pytest.approx(shape.bounds)


def test_an_item_on_the_date_line_of_the_moon() -> None:
    moved = replace(made().model.map, longitude=180.0, latitude=0.0, radius=1737400.0)
    dem = replace(made(), model=replace(made().model, map=moved))
    images = [picture.image for picture in dem_site.scene().pictures]
    told = stac_item(dem, moved, images, [])
    west, south, east, north = told["bbox"]
    assert told["geometry"]["type"] == "MultiPolygon"
    assert 170.0 < west < 180.0
    assert -180.0 < east < -170.0
    assert south < north
    assert told["properties"]["ssys:targets"] == ["Moon"]

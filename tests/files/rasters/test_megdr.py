"""MEGDR grids and GeoTIFF terrain: where posts lie, by label, by name, and against the altimeter's own shots."""

from pathlib import Path

import numpy as np
import pytest
from rasterio import Affine
from rasters import raster

from mgsgraph.errors import InputError
from mgsgraph.files.altimetry.shots import read_shots
from mgsgraph.files.rasters.megdr import read_megdr
from mgsgraph.files.rasters.terrain_file import read_terrain
from mgsgraph.geometry.body import from_planetocentric
from mgsgraph.geometry.terrain import areoid_grid, areoid_heights

DEG = np.pi / 180.0


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


def test_only_what_lies_around_points_is_read(tmp_path: Path) -> None:
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
    (tmp_path / "megc90n000cb.lbl").write_text(label(PRODUCT_ID="MEGC90N000CB.IMG", SAMPLE_BITS=bits))
    for found in (by_name, read_megdr(path)):
        assert found.kind == "counts"
        np.testing.assert_array_equal(found.radii, counts)


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"MAP_PROJECTION_TYPE": '"POLAR STEREOGRAPHIC"'}, "POLAR STEREOGRAPHIC"),
        ({"SAMPLE_TYPE": "IEEE_REAL", "SAMPLE_BITS": 32}, "IEEE_REAL 32"),
        ({"LINES": 721}, "2073600 bytes; expected 2076480"),
        ({"PRODUCT_ID": '"MEGX90N000CB.IMG"'}, "the product 'MEGX90N000CB.IMG'"),
        ({"CENTER_LATITUDE": 10.0}, "CENTER_LATITUDE: 10"),
        ({"SCALING_FACTOR": 1e290}, "1e[+]290 m per count"),
    ],
)
def test_labels_that_cannot_be_followed(tmp_path: Path, changed: dict[str, object], message: str) -> None:
    path = image(tmp_path, "megr90n000cb.img", np.zeros((720, 1440)))
    (tmp_path / "megr90n000cb.lbl").write_text(label(**changed))  # type: ignore[arg-type]
    with pytest.raises(InputError, match=message) as caught:
        read_megdr(path)
    assert "\n" not in str(caught.value)


def test_a_missing_keyword_a_short_file_a_strange_name(tmp_path: Path) -> None:
    path = image(tmp_path, "megr90n000cb.img", np.zeros((719, 1440)))
    with pytest.raises(InputError, match="2070720 bytes; expected 2073600"):
        read_megdr(path)
    (tmp_path / "megr90n000cb.lbl").write_text(label().replace("LINES = 720\r\n", ""))
    with pytest.raises(InputError, match="no LINES"):
        read_megdr(path)
    with pytest.raises(InputError, match="a name without position"):
        read_megdr(image(tmp_path, "terrain.img", np.zeros((3, 3))))
    with pytest.raises(InputError, match="no such file"):
        read_megdr(tmp_path / "megt90n000cb.img")


@pytest.mark.parametrize(("site", "largest"), [("insight", 10.0), ("opportunity", 15.0)])
def test_real_grid_against_real_shots(shared_data: Path, site: str, largest: float) -> None:
    """On flat ground shots and grid agree to metres, and a grid moved by one post in any direction agrees worse."""
    shots = read_shots(shared_data / "mola_pedr_ode" / f"{site}_topography.csv")
    grid = read_megdr(shared_data / "mola_megdr" / "megr90n000cb.img")
    radii = np.linalg.norm(shots.footprints, axis=1)
    longitudes = np.arctan2(shots.footprints[:, 1], shots.footprints[:, 0])
    latitudes = np.arcsin(shots.footprints[:, 2] / radii)

    def apart(east: int, south: int) -> float:
        values, _, _ = grid.radius(longitudes + east * grid.longitude_step, latitudes - south * grid.latitude_step)
        return float(np.median(np.abs(radii - values)))

    here = apart(0, 0)
    print(f"{site}: PEDR radius against MEGDR radius, 4 ppd: median absolute difference {here:.1f} m")
    assert here < largest
    assert all(apart(east, south) > 1.4 * here for east, south in ((1, 0), (-1, 0), (0, 1), (0, -1)))


@pytest.mark.parametrize("site", ["insight", "opportunity"])
def test_real_areoid_against_real_shots(shared_data: Path, site: str) -> None:
    shots = read_shots(shared_data / "mola_pedr_ode" / f"{site}_topography.csv")
    folder = shared_data / "mola_megdr"
    areoid = areoid_grid(read_megdr(folder / "megr90n000cb.img"), read_megdr(folder / "megt90n000cb.img"))
    off = areoid.at(shots.footprints) - shots.areoid_radii

    assert np.median(np.abs(off)) < 3.0
    topography = np.linalg.norm(shots.footprints, axis=1) - shots.areoid_radii
    np.testing.assert_allclose(areoid_heights(shots.footprints, areoid), topography - off, rtol=0, atol=1e-6)


def test_standard_parallel_stretches_longitude(tmp_path: Path) -> None:
    values, crs = np.full((4, 4), 3390000.0), "+proj=eqc +R=3396190 +lat_ts=60 +units=m"
    path = raster(tmp_path / "p.tif", values, crs, Affine(100.0, 0, 0, 0, -100.0, 0))
    grid = read_terrain(path)

    np.testing.assert_allclose(grid.longitude_step, 2.0 * grid.latitude_step, rtol=1e-12)

"""Pixels come as the file has them; GDAL opens no other file than asked, nor takes more memory than it can fill."""

import tracemalloc
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from outside import refuses
from rasters import RADIUS, SPHERE, pixels, raster

from mgsgraph.errors import InputError
from mgsgraph.files.rasters.pictures import as_bytes, is_moc, read_picture
from mgsgraph.files.rasters.raster_file import open_raster, read_band
from mgsgraph.files.rasters.terrain_file import read_terrain
from mgsgraph.geometry.body import from_planetocentric

rasterio = pytest.importorskip("rasterio")
GREY = np.arange(120, dtype=np.uint8).reshape(10, 12)
LONGLAT = f"+proj=longlat {SPHERE}"
PDS4 = """<?xml version="1.0"?>
<Product_Observational xmlns="http://pds.nasa.gov/pds4/pds/v1"><File_Area_Observational>
<File><file_name>{name}</file_name></File>
<Array_2D_Image><offset unit="byte">0</offset><axes>2</axes><axis_index_order>Last Index Fastest</axis_index_order>
<Element_Array><data_type>UnsignedByte</data_type></Element_Array>
<Axis_Array><axis_name>Line</axis_name><elements>10</elements><sequence_number>1</sequence_number></Axis_Array>
<Axis_Array><axis_name>Sample</axis_name><elements>12</elements><sequence_number>2</sequence_number></Axis_Array>
</Array_2D_Image></File_Area_Observational></Product_Observational>
"""
PDS3 = """PDS_VERSION_ID = PDS3
RECORD_TYPE = FIXED_LENGTH
RECORD_BYTES = 12
{pointer}
OBJECT = IMAGE
  LINES = 10
  LINE_SAMPLES = 12
  SAMPLE_TYPE = UNSIGNED_INTEGER
  SAMPLE_BITS = 8
END_OBJECT = IMAGE
END
"""
CUBE = """Object = IsisCube
  Object = Core
    {core}
    Format = BandSequential
    Group = Dimensions
      Samples = {samples}
      Lines = {lines}
      Bands = 1
    End_Group
    Group = Pixels
      Type = {kind}
      ByteOrder = Lsb
      Base = 0.0
      Multiplier = 1.0
    End_Group
  End_Object
End_Object
End
"""
BYTE_CUBE = CUBE.replace("{kind}", "UnsignedByte").replace("{lines}", "10").replace("{samples}", "12")
VRT = """<VRTDataset rasterXSize="12" rasterYSize="10"><VRTRasterBand dataType="Byte" band="1"><SimpleSource>
<SourceFilename>{}</SourceFilename></SimpleSource></VRTRasterBand></VRTDataset>"""
WMS = '<GDAL_WMS><Service name="TMS"><ServerUrl>http://127.0.0.1:9/{z}/{x}/{y}</ServerUrl></Service></GDAL_WMS>'


def tif(path: Path, pixels: NDArray[Any], **more: Any) -> Path:
    from rasterio.errors import NotGeoreferencedWarning

    bands = pixels if pixels.ndim == 3 else pixels[None]
    shape = {"height": bands.shape[1], "width": bands.shape[2], "count": bands.shape[0]}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", NotGeoreferencedWarning)
        with rasterio.open(path, "w", dtype=pixels.dtype, **shape, **{"driver": "GTiff"} | more) as file:
            file.write(bands)
    return path


def cube(path: Path, pixels: NDArray[Any], kind: str) -> Path:
    label = CUBE.format(core="StartByte = 4097", kind=kind, lines=pixels.shape[0], samples=pixels.shape[1])
    path.write_bytes(label.encode().ljust(4096, b"\0") + pixels.tobytes())
    return path


@pytest.mark.parametrize("kind", ["uint8", "uint16", "int16", "float32"])
def test_grey_values_come_as_they_are(kind: str, tmp_path: Path) -> None:
    pixels = np.arange(30).reshape(5, 6).astype(kind)
    found = read_picture(tif(tmp_path / "a.tif", pixels))
    assert found.dtype == pixels.dtype
    np.testing.assert_array_equal(found, pixels)


def test_missing_pixels_are_nan(tmp_path: Path) -> None:
    pixels = np.arange(1.0, 31.0).reshape(5, 6)
    pixels[0, 0], pixels[1, 1], pixels[2, 2], pixels[3, 3] = np.nan, np.inf, -7.0, -3.4e38
    found = read_picture(tif(tmp_path / "a.tif", pixels, nodata=-7.0))
    assert found.dtype == np.float32
    assert np.argwhere(np.isnan(found)).tolist() == [[k, k] for k in range(4)]
    whole = np.arange(30, dtype=np.int16).reshape(5, 6)
    whole[4, 5] = -32768
    found = read_picture(tif(tmp_path / "b.tif", whole, nodata=-32768))
    assert found.dtype == np.float32
    assert np.argwhere(np.isnan(found)).tolist() == [[4, 5]]
    whole[4, 5] = 1
    assert read_picture(tif(tmp_path / "c.tif", whole, nodata=-32768)).dtype == np.int16


def test_isis_cubes(tmp_path: Path) -> None:
    grey = np.arange(30, dtype=np.float32).reshape(5, 6)
    special = grey.copy()
    special.view(np.uint32)[0, :5] = 0xFF7FFFFB + np.arange(5)  # null, and saturated in four ways
    found = read_picture(cube(tmp_path / "a.cub", special, "Real"))
    assert np.all(np.isnan(found[0, :5]))
    np.testing.assert_array_equal(found.ravel()[5:], grey.ravel()[5:])
    byte = grey.astype(np.uint8) + 1
    np.testing.assert_array_equal(read_picture(cube(tmp_path / "b.cub", byte, "UnsignedByte")), byte)
    assert not is_moc(tmp_path / "a.cub")


def test_what_is_no_picture_is_told(tmp_path: Path) -> None:
    text, cut, label = (tmp_path / name for name in ("a.txt", "cut.tif", "a.img"))
    text.write_text("no picture\n" * 50)
    cut.write_bytes(tif(tmp_path / "whole.tif", np.ones((500, 600), dtype=np.uint8)).read_bytes()[:5000])
    label.write_bytes(b"PDS_VERSION_ID = PDS3\r\nEND\r\n")
    for path, said in (
        (tmp_path / "none.tif", "no such file"),
        (text, "no raster that is known here"),
        (cut, "is not a whole raster"),
        (label, "is not an image"),
        (tif(tmp_path / "rgb.tif", np.zeros((3, 5, 6), dtype=np.uint8)), "3 bands; expected one band"),
        (tif(tmp_path / "waves.tif", np.zeros((5, 6), dtype=np.complex64)), "pixels of type complex64; expected grey"),
    ):
        refuses(rf"{path.name}.*{said}", read_picture, path)


def test_bytes_to_look_at() -> None:
    byte = np.arange(30, dtype=np.uint8).reshape(5, 6)
    assert as_bytes(byte) is byte
    grey = np.random.default_rng(1).normal(1000.0, 50.0, (200, 300)).astype(np.float32)
    grey[3, 4] = np.nan
    shown = as_bytes(grey)
    assert (shown.dtype, shown.min(), shown.max(), shown[3, 4]) == (np.uint8, 0, 255, 0)
    assert np.corrcoef(shown.ravel()[2000:], grey.ravel()[2000:])[0, 1] > 0.98
    for odd in (np.nan, 7.0):
        assert not as_bytes(np.full((4, 4), odd)).any()


def test_special_pixels_of_whole_numbers_in_cubes_are_none(tmp_path: Path) -> None:
    pixels = np.arange(30, dtype=np.int16).reshape(5, 6)
    pixels[0, :3] = -32768, -32752, -32751
    found = read_picture(cube(tmp_path / "a.cub", pixels, "SignedWord"))
    np.testing.assert_array_equal(np.isnan(found[0]), [True, True, False, False, False, False])
    np.testing.assert_array_equal(found[1:], pixels[1:])
    words = np.arange(30, dtype=np.uint16).reshape(5, 6)
    words[4, 4:] = 65521, 65534
    found = read_picture(cube(tmp_path / "b.cub", words, "UnsignedWord"))
    assert np.isnan(found).sum() == 4
    assert found[4, 4] == 65521


# --- rasters stand alone


def heights(folder: Path, name: str = "a.tif", size: int = 40, **more: Any) -> Path:
    values = np.full((size, size), -1900.0, dtype=np.float32)
    return raster(folder / name, values, LONGLAT, pixels(LONGLAT, shape=(size, size))[0], **more)


@pytest.fixture
def elsewhere(tmp_path: Path) -> Path:
    """A file that nobody asked for, in another folder than those that name it."""
    folder = tmp_path / "private"
    folder.mkdir()
    GREY.tofile(folder / "grey.img")
    raster(folder / "grey.tif", GREY, LONGLAT, pixels(LONGLAT, shape=(10, 12))[0])
    return folder


@pytest.mark.parametrize("name", ["a.tif", "a.vrt", "a.cub"])
@pytest.mark.parametrize("what", ["virtual", "service"])
def test_what_is_read_from_other_files_is_refused_with_what_to_do(
    what: str, name: str, tmp_path: Path, elsewhere: Path
) -> None:
    """By what is in it, whatever it is called."""
    path = tmp_path / name
    path.write_text(VRT.format(elsewhere / "grey.tif") if what == "virtual" else WMS)
    for read in (read_picture, lambda path: read_terrain(path, RADIUS)):
        with pytest.raises(InputError) as caught:
            read(path)
        assert {"virtual": "virtual raster", "service": "a service"}[what] in caught.value.found
        assert f"gdal_translate {name} " in caught.value.remedy


def test_labels_lead_to_data_beside_them_and_nowhere_else(tmp_path: Path, elsewhere: Path) -> None:
    GREY.tofile(tmp_path / "grey.img")
    away = str(elsewhere / "grey.img")
    packed = f'OBJECT = COMPRESSED_FILE\n FILE_NAME = "{away}"\n ENCODING_TYPE = "GZIP"\nEND_OBJECT\n^IMAGE = 1'
    written = {
        ("pds4", ".xml"): (PDS4.format(name="grey.img"), PDS4.format(name=away), PDS4.format(name="private/grey.img"),
                           PDS4.format(name="private&#47;grey.img")),
        ("pds3", ".lbl"): (PDS3.format(pointer='^IMAGE = ("grey.img", 1)'), PDS3.format(pointer=f'^IMAGE = "{away}"'),
                           PDS3.format(pointer='^IMAGE /* */ = ("private/grey.img", 1)'), PDS3.format(pointer=packed)),
        ("cube", ".lbl"): tuple(BYTE_CUBE.format(core=core) for core in (
            "^Core = grey.img\nStartByte = 1", f"^Core = {away}", '^Core = "private/grey.img"', "Format = GeoTIFF",
        )),
    }  # fmt: skip
    for (name, ending), (good, *bad) in written.items():
        path = tmp_path / f"{name}{ending}"
        path.write_text(good)
        np.testing.assert_array_equal(read_picture(path), GREY)
        for text in bad:
            path.write_text(text)
            refuses("a label whose data are in another folder", read_picture, path)


@pytest.mark.parametrize(
    ("name", "label", "key", "damaged"),
    [
        ("a.img", PDS3.format(pointer="^IMAGE = 50"), "RECORD_BYTES", "RECORD_BYTEZ"),
        ("a.img", PDS3.format(pointer="^IMAGE = 50"), "^IMAGE = 50", "^IMAGE = 5 "),
        ("a.cub", BYTE_CUBE.format(core="StartByte = 589"), "StartByte = 589", "StartByte = 58 "),
        ("a.cub", BYTE_CUBE.format(core="StartByte = 589"), "ByteOrder", "ByteOrdez"),
    ],
)
def test_damaged_keys_of_labels_are_not_the_usual_ones(
    name: str, label: str, key: str, damaged: str, tmp_path: Path
) -> None:
    """GDAL would read the label's own text as pixels, or bytes in another order."""
    path = tmp_path / name
    path.write_bytes(label.encode().ljust(588) + GREY.tobytes())
    np.testing.assert_array_equal(read_picture(path), GREY)
    assert key in label
    path.write_bytes(label.replace(key, damaged).encode().ljust(588) + 9 * GREY.tobytes())
    with pytest.raises(InputError):
        read_picture(path)


def test_overviews_and_masks_in_other_files(tmp_path: Path, elsewhere: Path) -> None:
    """A GeoTIFF can name its overviews, and GDAL opens beside it what is called like its mask, of any kind."""
    path = heights(tmp_path)
    with rasterio.open(path, "r+") as file:
        file.update_tags(ns="OVERVIEWS", OVERVIEW_FILE=str(elsewhere / "grey.tif"))
    refuses("overviews in another file", read_terrain, path, RADIUS)
    masked = heights(tmp_path, "b.tif")
    (tmp_path / "b.tif.msk").write_text(VRT.format(elsewhere / "grey.tif"))
    refuses("its mask", read_terrain, masked, RADIUS)


def test_metadata_beside_a_file(tmp_path: Path) -> None:
    """What would change the heights is refused, neither heeded nor passed over; statistics of QGIS are nothing."""
    path, beside = heights(tmp_path), tmp_path / "a.tif.aux.xml"
    inside = '<PAMDataset><PAMRasterBand band="1">{}</PAMRasterBand></PAMDataset>'
    beside.write_text(inside.format('<Metadata><MDI key="STATISTICS_MEAN">1</MDI></Metadata>'))
    read_terrain(path, RADIUS)
    for changing in ("<NoDataValue>-1900</NoDataValue>", "<UnitType>km</UnitType>"):
        beside.write_text(inside.format(changing))
        refuses(r"a\.tif\.aux\.xml; expected a file that has everything in it", read_terrain, path, RADIUS)


@pytest.mark.parametrize("pointer", ['^IMAGE = ("grey.img")', '^IMAGE = "grey.img"'])
def test_labels_end_as_archives_have_them_end(pointer: str, tmp_path: Path) -> None:
    """Detached ones without a line's end, padded, or after a list of one file."""
    GREY.tofile(tmp_path / "grey.img")
    for end in (b"END", b"END\0"):
        (tmp_path / "a.lbl").write_bytes(PDS3.format(pointer=pointer).removesuffix("END\n").encode() + end)
        np.testing.assert_array_equal(read_picture(tmp_path / "a.lbl"), GREY)


@pytest.mark.parametrize("more", [{"compress": "deflate"}, {"BIGTIFF": "YES", "ENDIANNESS": "BIG"}])
def test_long_strips(more: dict[str, Any], tmp_path: Path) -> None:
    """GDAL gives packed ones of more than 2,000 lines as blocks of a row, which the file doesn't have."""
    from rasterio.windows import Window

    grey = np.resize(GREY, (2500, 12))
    path = raster(tmp_path / "a.tif", grey, LONGLAT, pixels(LONGLAT, shape=grey.shape)[0], blockysize=2500, **more)
    np.testing.assert_array_equal(read_picture(path), grey)
    with open_raster(path, "a picture") as file:
        np.testing.assert_array_equal(read_band(file, path, Window(3, 2000, 5, 9)), grey[2000:2009, 3:8])


def hollow(path: Path, size: int, **more: Any) -> Path:
    """A GeoTIFF that says how large it is, and holds nothing."""
    with rasterio.open(
        path, "w", driver="GTiff", width=size, height=size, count=1, dtype="float32", crs=LONGLAT, tiled=True,
        sparse_ok=True, transform=rasterio.Affine(1e-4, 0.0, 87.0, 0.0, -1e-4, 4.0), **more,
    ):
        pass
    return path


def test_a_hollow_raster_takes_no_memory(tmp_path: Path) -> None:
    """30,000 x 30,000 posts are 3.6 GB; a part of them that is small may be read, where missing ones are told."""
    path = hollow(tmp_path / "a.tif", 30_000, nodata=-9999.0)
    assert path.stat().st_size < 1e6
    tracemalloc.start()
    for read in (read_picture, lambda path: read_terrain(path, RADIUS)):
        refuses(r"30000 x 30000 pixels \(3600 MB\)", read, path)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 1e8
    near = from_planetocentric(np.array([[np.deg2rad(87.1), np.deg2rad(3.9), RADIUS]]))
    refuses("no valid value", read_terrain, path, RADIUS, near=near)


def test_blocks_that_are_not_there_are_no_zeros(tmp_path: Path) -> None:
    refuses("no pixels from row 1, column 1 on", read_picture, hollow(tmp_path / "a.tif", 300))
    assert np.all(np.isnan(read_picture(hollow(tmp_path / "b.tif", 300, nodata=-9999.0))))
    values = np.zeros((300, 300), dtype=np.uint8)
    values[:100] = GREY[5, 5]
    place = pixels(LONGLAT)[0]
    whole = raster(tmp_path / "c.tif", values, LONGLAT, place)
    np.testing.assert_array_equal(read_picture(whole), values)
    tiles = {"tiled": True, "blockxsize": 128, "blockysize": 128}
    part = raster(tmp_path / "d.tif", values, LONGLAT, place, sparse_ok=True, **tiles)
    refuses("no pixels from row 129, column 1 on", read_picture, part)


def test_names_that_gdal_understands_are_no_files(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    heights(tmp_path)
    for name in ("/vsicurl/http://127.0.0.1:9/a.tif", "GTIFF_DIR:1:a.tif"):
        refuses("no such file", read_picture, Path(name))


def test_pixels_of_odd_bits(tmp_path: Path) -> None:
    """One bit of the header makes 8 bits 9, and pixels run on into each other."""
    path = raster(tmp_path / "a.tif", np.zeros((10, 12), dtype=np.uint16), LONGLAT, pixels(LONGLAT)[0], nbits=9)
    refuses("pixels of 9 bits; expected 8, 16 or 32", read_picture, path)


def test_a_block_larger_than_its_file(tmp_path: Path) -> None:
    """A window of few pixels takes whole blocks."""
    path = raster(
        tmp_path / "a.tif", np.zeros((9000, 9000), dtype=np.uint8), LONGLAT, pixels(LONGLAT)[0], tiled=True,
        blockxsize=9008, blockysize=9008, compress="deflate",
    )  # fmt: skip
    with pytest.raises(InputError, match=r"in a file of 0\.\d+ MB"):
        read_terrain(path, RADIUS, near=from_planetocentric(np.array([[np.deg2rad(87.0), np.deg2rad(4.1), RADIUS]])))


@pytest.mark.parametrize(("kind", "ending"), [("JPEG", "jpg"), ("PNG", "png"), ("GTiff", "tif")])
def test_damaged_pictures_are_refused_in_silence(
    kind: str, ending: str, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    """Cut short, of all kinds: no grey is made up for what is missing, and GDAL prints nothing of its own."""
    grey: NDArray[Any] = np.random.default_rng(1).integers(0, 255, (64, 80), dtype=np.uint8)
    path = tif(tmp_path / f"a.{ending}", grey, driver=kind)
    (tmp_path / f"a.{ending}.aux.xml").unlink(missing_ok=True)
    assert read_picture(path).shape == (64, 80)
    content = path.read_bytes()
    for share in (0.02, 0.3, 0.9):
        path.write_bytes(content[: int(share * len(content))])
        with pytest.raises(InputError):
            read_picture(path)
    assert capfd.readouterr() == ("", "")


def test_check_sums_of_a_geotiff_are_heeded(tmp_path: Path) -> None:
    """GDAL stops when it has all pixels, before the sum behind them: of bits turned in a block it sees every other."""
    values = np.random.default_rng(1).integers(0, 9, (64, 64), dtype=np.uint8)
    path = raster(tmp_path / "a.tif", values, LONGLAT, pixels(LONGLAT)[0], compress="deflate")
    np.testing.assert_array_equal(read_picture(path), values)
    with rasterio.open(path) as file:
        begin, size = (int(file.get_tag_item(f"BLOCK_{what}_0_0", "TIFF", bidx=1)) for what in ("OFFSET", "SIZE"))
    content = path.read_bytes()
    for at in range(begin + 40, begin + size, 40):
        path.write_bytes(content[:at] + bytes([content[at] ^ 16]) + content[at + 1 :])
        refuses("not a whole raster", read_picture, path)

"""Rasters stand alone: whatever a file names, GDAL opens no other, and takes no more memory than the file can fill."""

import os
import sys
import threading
import time
import tracemalloc
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from rasters import RADIUS, SPHERE, pixels, raster

from mgsgraph.errors import InputError
from mgsgraph.files.rasters.pictures import read_picture
from mgsgraph.files.rasters.raster_file import open_raster, raster_understood, read_band
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
    StartByte = 1
    Format = BandSequential
    Group = Dimensions
      Samples = 12
      Lines = 10
      Bands = 1
    End_Group
    Group = Pixels
      Type = UnsignedByte
      ByteOrder = Lsb
      Base = 0.0
      Multiplier = 1.0
    End_Group
  End_Object
End_Object
End
"""
VRT = """<VRTDataset rasterXSize="12" rasterYSize="10"><VRTRasterBand dataType="Byte" band="1"><SimpleSource>
<SourceFilename>{}</SourceFilename></SimpleSource></VRTRasterBand></VRTDataset>"""
WMS = '<GDAL_WMS><Service name="TMS"><ServerUrl>http://127.0.0.1:9/{z}/{x}/{y}</ServerUrl></Service></GDAL_WMS>'


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
        ("cube", ".lbl"): (CUBE.format(core="^Core = grey.img"), CUBE.format(core=f"^Core = {away}"),
                           CUBE.format(core='^Core = "private/grey.img"'), CUBE.format(core="Format = GeoTIFF")),
    }  # fmt: skip
    for (name, ending), (good, *bad) in written.items():
        path = tmp_path / f"{name}{ending}"
        path.write_text(good)
        np.testing.assert_array_equal(read_picture(path), GREY)
        for text in bad:
            path.write_text(text)
            with pytest.raises(InputError, match="a label whose data are in another folder"):
                read_picture(path)


WHOLE = {
    "pds3": PDS3.format(pointer="^IMAGE = 50").encode().ljust(588),
    "cube": CUBE.format(core="").replace("StartByte = 1", "StartByte = 589").encode().ljust(588, b"\0"),
}


@pytest.mark.parametrize(
    ("kind", "key", "damaged"),
    [
        ("pds3", "RECORD_BYTES", "RECORD_BYTEZ"), ("pds3", "^IMAGE = 50", "^IMAGE = 5 "),
        ("pds3", "LINES = 10", "LINEZ = 10"),
        ("cube", "StartByte = 589", "StartByte = 58 "),
        ("cube", "ByteOrder", "ByteOrdez"),
        ("cube", "Type = ", "Typf = "),
    ],
)  # fmt: skip
def test_damaged_keys_of_labels_are_not_the_usual_ones(kind: str, key: str, damaged: str, tmp_path: Path) -> None:
    """GDAL would read the label's own text as pixels, or bytes in another order."""
    path = tmp_path / ("a.img" if kind == "pds3" else "a.cub")
    path.write_bytes(WHOLE[kind] + GREY.tobytes())
    np.testing.assert_array_equal(read_picture(path), GREY)
    content = WHOLE[kind].replace(key.encode(), damaged.encode())
    assert content != WHOLE[kind]
    path.write_bytes(content + 9 * GREY.tobytes())
    with pytest.raises(InputError):
        read_picture(path)


def test_data_beside_a_label_that_are_no_file(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "grey.img")
    (tmp_path / "a.lbl").write_text(PDS3.format(pointer='^IMAGE = ("grey.img", 1)'))
    with pytest.raises(InputError, match="a pipe"):
        read_picture(tmp_path / "a.lbl")


def test_overviews_and_masks_in_other_files(tmp_path: Path, elsewhere: Path) -> None:
    """A GeoTIFF can name its overviews, and GDAL opens beside it what is called like its mask, of any kind."""
    path = heights(tmp_path)
    with rasterio.open(path, "r+") as file:
        file.update_tags(ns="OVERVIEWS", OVERVIEW_FILE=str(elsewhere / "grey.tif"))
    with pytest.raises(InputError, match="overviews in another file"):
        read_terrain(path, RADIUS)
    masked = heights(tmp_path, "b.tif")
    (tmp_path / "b.tif.msk").write_text(VRT.format(elsewhere / "grey.tif"))
    with pytest.raises(InputError, match="its mask"):
        read_terrain(masked, RADIUS)


@pytest.mark.parametrize(
    ("inside", "refused"),
    [
        ('<PAMRasterBand band="1"><NoDataValue>-1900</NoDataValue></PAMRasterBand>', True),
        ('<PAMRasterBand band="1"><UnitType>km</UnitType></PAMRasterBand>', True),
        ('<PAMRasterBand band="1"><Metadata><MDI key="STATISTICS_MEAN">1</MDI></Metadata></PAMRasterBand>', False),
    ],
)
def test_metadata_beside_a_file(inside: str, refused: bool, tmp_path: Path) -> None:
    """What would change the heights is refused, neither heeded nor passed over; statistics of QGIS are nothing."""
    path = heights(tmp_path)
    (tmp_path / "a.tif.aux.xml").write_text(f"<PAMDataset>{inside}</PAMDataset>")
    if refused:
        with pytest.raises(InputError, match=r"a\.tif\.aux\.xml; expected a file that has everything in it"):
            read_terrain(path, RADIUS)
    else:
        read_terrain(path, RADIUS)


@pytest.mark.parametrize("end", ["END", "END\0"])
@pytest.mark.parametrize("pointer", ['^IMAGE = ("grey.img", 1)', '^IMAGE = ("grey.img")', '^IMAGE = "grey.img"'])
def test_labels_end_as_archives_have_them_end(end: str, pointer: str, tmp_path: Path) -> None:
    """Detached ones without a line's end, padded, or after a list of one file."""
    GREY.tofile(tmp_path / "grey.img")
    (tmp_path / "a.lbl").write_bytes(PDS3.format(pointer=pointer).removesuffix("END\n").encode() + end.encode())
    np.testing.assert_array_equal(read_picture(tmp_path / "a.lbl"), GREY)


@pytest.mark.parametrize("packing", ["deflate", None])
@pytest.mark.parametrize("more", [{}, {"BIGTIFF": "YES", "ENDIANNESS": "BIG"}])
def test_long_strips(packing: str | None, more: dict[str, Any], tmp_path: Path) -> None:
    """GDAL gives packed ones of more than 2,000 lines as blocks of a row, which the file doesn't have."""
    from rasterio.windows import Window

    grey = np.resize(GREY, (2500, 12))
    path = raster(
        tmp_path / "a.tif", grey, LONGLAT, pixels(LONGLAT, shape=grey.shape)[0], blockysize=2500,
        **({"compress": packing} if packing else {}), **more,
    )  # fmt: skip
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
        with pytest.raises(InputError, match=r"30000 x 30000 pixels \(3600 MB\)"):
            read(path)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 1e8
    near = from_planetocentric(np.array([[np.deg2rad(87.1), np.deg2rad(3.9), RADIUS]]))
    with pytest.raises(InputError, match="no valid value"):
        read_terrain(path, RADIUS, near=near)


def test_blocks_that_are_not_there_are_no_zeros(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no pixels from row 1, column 1 on"):
        read_picture(hollow(tmp_path / "a.tif", 300))
    assert np.all(np.isnan(read_picture(hollow(tmp_path / "b.tif", 300, nodata=-9999.0))))
    values = np.zeros((300, 300), dtype=np.uint8)
    values[:100] = GREY[5, 5]
    place = pixels(LONGLAT)[0]
    whole = raster(tmp_path / "c.tif", values, LONGLAT, place)
    np.testing.assert_array_equal(read_picture(whole), values)
    tiles = {"tiled": True, "blockxsize": 128, "blockysize": 128}
    part = raster(tmp_path / "d.tif", values, LONGLAT, place, sparse_ok=True, **tiles)
    with pytest.raises(InputError, match="no pixels from row 129, column 1 on"):
        read_picture(part)


def test_pixels_of_odd_bits(tmp_path: Path) -> None:
    """One bit of the header makes 8 bits 9, and pixels run on into each other."""
    path = raster(tmp_path / "a.tif", np.zeros((10, 12), dtype=np.uint16), LONGLAT, pixels(LONGLAT)[0], nbits=9)
    with pytest.raises(InputError, match="pixels of 9 bits; expected 8, 16 or 32"):
        read_picture(path)


def test_a_block_larger_than_its_file(tmp_path: Path) -> None:
    """A window of few pixels takes whole blocks."""
    path = raster(
        tmp_path / "a.tif", np.zeros((9000, 9000), dtype=np.uint8), LONGLAT, pixels(LONGLAT)[0], tiled=True,
        blockxsize=9008, blockysize=9008, compress="deflate",
    )  # fmt: skip
    with pytest.raises(InputError, match=r"in a file of 0\.\d+ MB"):
        read_terrain(path, RADIUS, near=from_planetocentric(np.array([[np.deg2rad(87.0), np.deg2rad(4.1), RADIUS]])))


@pytest.mark.parametrize("name", ["/vsicurl/http://127.0.0.1:9/a.tif", "/vsizip/a.zip/a.tif", "GTIFF_DIR:1:a.tif"])
def test_names_that_gdal_understands_are_no_files(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    heights(tmp_path)
    with pytest.raises(InputError, match="no such file"):
        read_picture(Path(name))


@pytest.mark.parametrize(
    ("kind", "ending"), [("JPEG", "jpg"), ("PNG", "png"), ("GTiff", "tif")]
)
def test_damaged_pictures_are_refused_in_silence(
    kind: str, ending: str, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    """Cut short, of all kinds: no grey is made up for what is missing, and GDAL prints nothing of its own."""
    grey: NDArray[Any] = np.random.default_rng(1).integers(0, 255, (64, 80), dtype=np.uint8)
    path = tmp_path / f"a.{ending}"
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        with rasterio.open(path, "w", driver=kind, width=80, height=64, count=1, dtype="uint8") as file:
            file.write(grey, 1)
    (tmp_path / f"a.{ending}.aux.xml").unlink(missing_ok=True)
    assert read_picture(path).shape == (64, 80)
    content = path.read_bytes()
    for share in (0.02, 0.3, 0.9):
        path.write_bytes(content[: int(share * len(content))])
        with pytest.raises(InputError):
            read_picture(path)
    assert capfd.readouterr() == ("", "")


def test_hooks_for_errors_are_back_whatever_threads_do() -> None:
    """They are one for all threads: whoever takes them last must not put back another one's silence."""
    before = sys.excepthook, sys.unraisablehook
    inside, out = threading.Event(), threading.Event()

    def first() -> None:
        with raster_understood("a", "a raster"):
            inside.set()
            out.wait(0.2)

    def second() -> None:
        inside.wait(5.0)
        with raster_understood("b", "a raster"):
            out.set()
            time.sleep(0.3)

    threads = [threading.Thread(target=one) for one in (first, second)]
    for one in threads:
        one.start()
    for one in threads:
        one.join()
    assert (sys.excepthook, sys.unraisablehook) == before

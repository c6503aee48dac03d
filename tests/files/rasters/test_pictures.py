"""Pixels of any camera: grey values as the file has them, missing ones told, anything else one clear line."""

import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from mgsgraph.errors import InputError
from mgsgraph.files.rasters.pictures import as_bytes, is_moc, read_picture

CUBE = """Object = IsisCube
  Object = Core
    StartByte   = 4097
    Format      = BandSequential
    Group = Dimensions
      Samples = 6
      Lines   = 5
      Bands   = 1
    End_Group
    Group = Pixels
      Type       = {kind}
      ByteOrder  = Lsb
      Base       = 0.0
      Multiplier = 1.0
    End_Group
  End_Object
End_Object
End
"""


def tif(path: Path, pixels: NDArray[Any], **more: Any) -> Path:
    import rasterio
    from rasterio.errors import NotGeoreferencedWarning

    bands = pixels if pixels.ndim == 3 else pixels[None]
    shape = {"height": bands.shape[1], "width": bands.shape[2], "count": bands.shape[0]}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", NotGeoreferencedWarning)
        with rasterio.open(path, "w", driver="GTiff", dtype=pixels.dtype, **shape, **more) as file:
            file.write(bands)
    return path


def cube(path: Path, pixels: NDArray[Any], kind: str) -> Path:
    path.write_bytes(CUBE.format(kind=kind).encode().ljust(4096, b"\0") + pixels.tobytes())
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
    text = tmp_path / "a.txt"
    text.write_text("no picture\n" * 50)
    cut = tmp_path / "cut.tif"
    cut.write_bytes(tif(tmp_path / "whole.tif", np.ones((500, 600), dtype=np.uint8)).read_bytes()[:5000])
    rgb = tif(tmp_path / "rgb.tif", np.zeros((3, 5, 6), dtype=np.uint8))
    waves = tif(tmp_path / "waves.tif", np.zeros((5, 6), dtype=np.complex64))
    label = tmp_path / "a.img"
    label.write_bytes(b"PDS_VERSION_ID = PDS3\r\nEND\r\n")
    for path, said in (
        (tmp_path / "none.tif", "no such file"),
        (tmp_path / "none.img", "no such file"),
        (tmp_path, "a folder"),
        (text, "no raster that is known here"),
        (cut, "is not a whole raster"),
        (label, "is not an image"),
        (rgb, "3 bands; expected one band"),
        (waves, "pixels of type complex64; expected grey values"),
    ):
        with pytest.raises(InputError) as caught:
            read_picture(path)
        assert said in str(caught.value)
        assert str(path) in str(caught.value)
        assert "\n" not in str(caught.value)


def test_bytes_to_look_at() -> None:
    byte = np.arange(30, dtype=np.uint8).reshape(5, 6)
    assert as_bytes(byte) is byte
    rng = np.random.default_rng(1)
    grey = (rng.normal(1000.0, 50.0, (200, 300))).astype(np.float32)
    grey[3, 4] = np.nan
    shown = as_bytes(grey)
    assert shown.dtype == np.uint8
    assert (shown.min(), shown.max(), shown[3, 4]) == (0, 255, 0)
    assert np.corrcoef(shown.ravel()[2000:], grey.ravel()[2000:])[0, 1] > 0.98
    assert as_bytes(np.full((4, 4), np.nan)).tolist() == [[0] * 4] * 4
    assert as_bytes(np.full((4, 4), 7.0)).tolist() == [[0] * 4] * 4


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

"""Tiles of pictures: full resolution as the file has it, coarser levels as means, one clear line for anything else."""

import io
import os
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from outside import refuses
from PIL import Image

from mgsgraph.errors import InputError
from mgsgraph.files.rasters.pictures import read_picture
from mgsgraph.studio import tiles
from mgsgraph.studio.tiles import SIDE, Tiles, halved, open_picture

Grey = NDArray[Any]


def tif(path: Path, pixels: Grey, **more: Any) -> Path:
    rasterio = pytest.importorskip("rasterio")
    from rasterio.errors import NotGeoreferencedWarning

    with warnings.catch_warnings():
        warnings.simplefilter("ignore", NotGeoreferencedWarning)
        kind = {"driver": "GTiff", "count": 1, "dtype": pixels.dtype, "height": len(pixels), "width": pixels.shape[1]}
        with rasterio.open(path, "w", **kind, **more) as file:
            file.write(pixels, 1)
    return path


def grey(lines: int, samples: int, kind: str = "uint8", seed: int = 1) -> Grey:
    values = np.random.default_rng(seed).integers(0, 255, (lines, samples))
    return values.astype(kind)


def decoded(png: bytes) -> Grey:
    return np.asarray(Image.open(io.BytesIO(png)))


def whole(found: tiles.Pyramid, level: int) -> Grey:
    """A level put together of its tiles."""
    lines, samples = found.shape(level)
    return np.block([
        [found.part(level, row, column) for column in range(-(-samples // SIDE))] for row in range(-(-lines // SIDE))
    ])


def means(pixels: Grey, level: int) -> Grey:
    """Means of blocks, of those pixels that are there and known."""
    step = 1 << level
    down, across = (-(-n // step) for n in pixels.shape)
    padded = np.full((down * step, across * step), np.nan)
    padded[: pixels.shape[0], : pixels.shape[1]] = pixels
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)
        return np.asarray(np.nanmean(padded.reshape(down, step, across, step), axis=(1, 3)))


@pytest.mark.parametrize("kind", ["uint8", "uint16", "float32"])
def test_full_resolution_is_what_the_file_has(kind: str, tmp_path: Path) -> None:
    pixels = grey(300, 523, kind)
    found = open_picture(tif(tmp_path / "a.tif", pixels), 300, 523)
    np.testing.assert_array_equal(whole(found, 0), pixels)
    assert found.levels == 3
    assert found.shape(1) == (150, 262)
    assert max(found.shape(2)) <= SIDE


@given(st.integers(1, 40), st.integers(1, 40), st.booleans())
def test_halved_pixels_are_means_of_those_that_are_known(lines: int, samples: int, hollow: bool) -> None:
    pixels = grey(lines, samples, "float32")
    if hollow:
        pixels[grey(lines, samples, seed=2) < 60] = np.nan
    np.testing.assert_allclose(halved(pixels), means(pixels, 1), rtol=1e-6)


def test_halved_bytes_are_rounded_means() -> None:
    pixels = grey(40, 60)
    assert np.abs(halved(pixels) - means(pixels, 1)).max() <= 0.5
    assert halved(pixels).dtype == np.uint8


@pytest.mark.parametrize("kind", ["uint8", "float32"])
def test_a_large_picture_is_read_by_tile_and_looks_the_same(
    kind: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pixels = grey(900, 700, kind)
    path = tif(tmp_path / "a.tif", pixels)
    expected = open_picture(path, 900, 700)
    monkeypatch.setattr(tiles, "_KEPT", 50_000)
    monkeypatch.setattr(tiles, "read_picture", lambda _: pytest.fail("read whole"))
    found = open_picture(path, 900, 700)
    assert found.finest == 2
    assert found.size < expected.size / 8
    for level in range(found.levels):
        np.testing.assert_array_equal(whole(found, level), whole(expected, level))


def test_contrast_leaves_few_pixels_out_and_is_chosen(tmp_path: Path) -> None:
    pixels = np.random.default_rng(3).normal(1000.0, 50.0, (200, 200)).astype("float32")
    pixels[0, :5] = 1e6  # cosmic rays
    shown = Tiles({"a": (tif(tmp_path / "a.tif", pixels), 200, 200)})
    found = shown.record("a")
    assert 800.0 < found["low"] < 900.0
    assert 1100.0 < found["high"] < 1200.0
    first = decoded(shown.tile("a", 0, 0, 0))
    chosen = decoded(shown.tile("a", 0, 0, 0, 1000.0, 1001.0))
    assert 60 < np.median(first) < 195
    np.testing.assert_array_equal(chosen[pixels < 1000.0], 0)
    np.testing.assert_array_equal(chosen[pixels > 1001.0], 255)


@pytest.mark.parametrize("kind", ["uint8", "float32"])
def test_a_histogram_counts_all_pixels_but_those_far_out(kind: str, tmp_path: Path) -> None:
    pixels = np.random.default_rng(3).normal(120.0, 10.0, (200, 200)).astype(kind)
    pixels[0, :5] = 255
    found = Tiles({"a": (tif(tmp_path / "a.tif", pixels), 200, 200)}).record("a")
    ends = found["first"] + found["step"] * np.arange(len(found["counts"]) + 1)
    np.testing.assert_array_equal(found["counts"], np.histogram(pixels, np.append(ends[:-1], ends[-1] - 1e-6))[0])
    assert sum(found["counts"]) == pixels.size - 5
    assert (found["step"] == 1.0) == (kind == "uint8")


def test_grey_values_and_contrast_of_a_part(tmp_path: Path) -> None:
    pixels = grey(1500, 40, "float32")
    pixels[700:] += 1000.0
    pixels[3, 4] = np.nan
    picture = open_picture(tif(tmp_path / "a.tif", pixels), 1500, 40)
    low, high = picture.contrast(np.array([[-20.0, -5.0], [500.0, 45.0]]))
    assert [low, high] == pytest.approx(np.nanquantile(pixels[:500], [0.005, 0.995]), abs=3.0)
    assert picture.contrast(np.array([[1400.0, 3.0], [800.0, 30.0]]))[0] > 1000.0
    assert picture.value(20.9, 7.1) == pixels[20, 7]
    assert np.isnan(picture.value(3.5, 4.5) or 0.0)
    assert picture.value(1500.0, 7.0) is picture.value(5.0, -0.1) is None


def test_missing_pixels_are_transparent(tmp_path: Path) -> None:
    pixels = grey(20, 30, "uint16") + 1
    pixels[3, 4] = 0
    shown = Tiles({"a": (tif(tmp_path / "a.tif", pixels, nodata=0), 20, 30)})
    found = decoded(shown.tile("a", 0, 0, 0))
    assert found.shape == (20, 30, 2)
    assert found[3, 4, 1] == 0
    assert (found[:, :, 1] == 255).sum() == 20 * 30 - 1


def test_a_changed_file_is_told_and_then_read_anew(tmp_path: Path) -> None:
    path = tif(tmp_path / "a.tif", grey(50, 60))
    shown = Tiles({"a": (path, 50, 60)})
    before = shown.record("a")["version"]
    shown.tile("a", 0, 0, 0)
    tif(path, grey(50, 60, seed=9))
    os.utime(path, ns=(1, 1))
    refuses(r"a\.tif", shown.tile, "a", 0, 0, 0)
    assert shown.record("a")["version"] != before
    np.testing.assert_array_equal(shown.picture("a").part(0, 0, 0), grey(50, 60, seed=9))
    shown.tile("a", 0, 0, 0)
    path.unlink()
    refuses(r"a\.tif", shown.tile, "a", 0, 0, 0)


@pytest.mark.parametrize(("lines", "samples"), [(50, 61), (49, 60)])
def test_a_picture_of_another_size_is_refused(lines: int, samples: int, tmp_path: Path) -> None:
    refuses("50 x 60", open_picture, tif(tmp_path / "a.tif", grey(50, 60)), lines, samples)


def test_wrong_requests_are_one_line(tmp_path: Path) -> None:
    path = tif(tmp_path / "a.tif", grey(50, 60))
    shown = Tiles({"a": (path, 50, 60), "b": (None, 5, 5), "c": (tmp_path / "c", 5, 5)})
    for at in ((1, 0, 0), (-1, 0, 0), (0, 1, 0), (0, 0, -1)):
        refuses("tile", shown.tile, "a", *at)
    for low, high in ((5.0, 5.0), (6.0, 5.0), (float("nan"), 5.0)):
        refuses("contrast", shown.tile, "a", 0, 0, 0, low, high)
    for name in ("b", "c", "d"):
        with pytest.raises(InputError):
            shown.tile(name, 0, 0, 0)
    assert not shown.has("b")


def test_pictures_are_kept_within_bounds(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tiles, "_MOST_KEPT", 10_000)
    files = {str(k): (tif(tmp_path / f"{k}.tif", grey(80, 90, seed=k)), 80, 90) for k in range(4)}
    shown = Tiles(files)
    for k in range(4):
        assert decoded(shown.tile(str(k), 0, 0, 0, 0.0, 255.0))[5, 5] == grey(80, 90, seed=k)[5, 5]
    assert len(shown._open) == 1


# above two seconds: pdr decompresses the real image in 3 s
@pytest.mark.parametrize("name", ["M0100115.img", "M0100115.imq", "E0201461.tiny.cub"])
def test_real_pictures_of_moc(name: str, shared_data: Path) -> None:
    if name.endswith("imq"):
        pytest.importorskip("pdr")
    path = shared_data / "mgs_moc_pair" / name
    pixels = read_picture(path)
    found = open_picture(path, *pixels.shape)
    np.testing.assert_array_equal(whole(found, 0), pixels)
    top = found.part(found.levels - 1, 0, 0)
    assert abs(float(np.nanmean(top)) - float(np.nanmean(pixels))) < 0.02 * float(np.nanstd(pixels)) + 0.5

"""The instruments' files of the simulation: PEDR frames and MOC images, laid out as the real ones and read back; the
mean range over a laser spot.
"""

import re
import struct
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from outside import refuses

from mgsgraph.files.cameras.label import read_line_scan_label
from mgsgraph.files.rasters.pictures import read_moc_pixels
from mgsgraph.geometry.body import from_planetocentric, planetocentric
from mgsgraph.geometry.records import Array
from mgsgraph.simulation.mgs_files import write_moc_image
from mgsgraph.simulation.mola_files import PedrFrames, write_pedr
from mgsgraph.simulation.site import ranges_over_spots
from mgsgraph.simulation.sites import ImageSettings, site_settings
from mgsgraph.units import DEG

CM, MICRODEG = 1e-2, 1e-6 * DEG


def track(shots: int, off_nadir: float = 0.0, longitude: float = 175.3, roughness: float = 300.0) -> PedrFrames:
    """Shots from a straight flight northward at 3.05 km/s on the ground, rolled by `off_nadir` (rad) to the east."""
    rng = np.random.default_rng(0)
    k = np.arange(shots)
    latitude, outward = -14.6 * DEG + 305.0 * k / 3.39e6, 3.39e6 + 378e3
    craft = np.column_stack([longitude * DEG - 0.02 * (latitude + 14.6 * DEG), latitude, outward + 3.0 * k])
    position = from_planetocentric(craft)
    up = position / craft[:, 2:]
    east = np.cross([0.0, 0.0, 1.0], up)
    look = -np.cos(off_nadir) * up + np.sin(off_nadir) * east / np.linalg.norm(east, axis=1, keepdims=True)
    radii = 3.39e6 + roughness * np.sin(0.3 * k) + rng.normal(0.0, 0.1 * roughness, shots)
    along = np.einsum("ni,ni->n", position, look)
    ranges = -along - np.sqrt(along**2 - craft[:, 2] ** 2 + radii**2)
    return PedrFrames(
        orbit=18933, times=37_315_939.123_456_7 + 0.1 * k, footprints=position + ranges[:, None] * look, ranges=ranges,
        areoid_radii=3.3895e6 - 40.0 * k, spacecraft=position, off_nadir=np.full(shots, off_nadir),
        ground=np.ones(shots, dtype=bool), spread=np.linspace(0.0, 15.0, shots),
    )


def foot(frames: PedrFrames) -> np.ndarray:
    """(3, n) longitudes and latitudes (rad) and radii (m) of the footprints."""
    return planetocentric(frames.footprints).T


def craft(frames: PedrFrames) -> np.ndarray:
    """(3, n) longitudes and latitudes (rad) and radii (m) of the spacecraft."""
    return planetocentric(frames.spacecraft).T


@given(st.integers(1, 90), st.floats(0.0, 0.36), st.sampled_from([175.3, 359.99, 0.0]), st.floats(0.0, 800.0))
@settings(max_examples=25, deadline=None)
def test_read_gives_back_what_was_written(
    tmp_path_factory: pytest.TempPathFactory, shots: int, off_nadir: float, longitude: float, roughness: float
) -> None:
    """To the format's resolution: cm, 1e-6 deg in midpoint and half the change, and 1e-9 deg/m of parallax."""
    crossovers = np.random.default_rng(shots).uniform(-3.0, 3.0, -(-shots // 20))
    frames = replace(track(shots, off_nadir, longitude, roughness), crossovers=crossovers)
    read = write_pedr(tmp_path_factory.mktemp("pedr") / "ap18933l.b", frames)
    assert read.times.size == shots
    np.testing.assert_allclose(read.times - frames.times, 0.0, atol=1e-6)
    np.testing.assert_allclose(read.ranges, frames.ranges, atol=0.51 * CM)
    place = planetocentric(read.footprints)
    np.testing.assert_allclose(place[:, 2], foot(frames)[2], atol=0.51 * CM)
    angle = 0.8 * MICRODEG + 0.5e-3 * MICRODEG * 2.0 * roughness + 0.7 / 3.39e6  # the track's curvature
    np.testing.assert_allclose(place[:, 1], foot(frames)[1], atol=angle)
    np.testing.assert_allclose(_turned(place[:, 0] - foot(frames)[0]), 0.0, atol=1.1 * angle)
    np.testing.assert_allclose(read.areoid_radii, frames.areoid_radii, atol=CM)
    there = planetocentric(read.spacecraft)
    np.testing.assert_allclose(there[:, 2], craft(frames)[2], atol=0.8)
    np.testing.assert_allclose(there[:, 1], craft(frames)[1], atol=MICRODEG)
    np.testing.assert_allclose(_turned(there[:, 0] - craft(frames)[0]), 0.0, atol=MICRODEG)
    np.testing.assert_allclose(read.off_nadir, off_nadir, atol=MICRODEG)


def _turned(angle: np.ndarray) -> np.ndarray:
    return np.remainder(angle + np.pi, 2.0 * np.pi) - np.pi


def test_ranges_stay_those_between_the_places_that_are_read(tmp_path: Path) -> None:
    """What an adjustment relies on: spacecraft, footprint and range belong together, rolled shots over relief, too."""
    read = write_pedr(tmp_path / "ap18933l.b", track(200, 20.0 * DEG, roughness=600.0))
    off = np.linalg.norm(read.spacecraft - read.footprints, axis=1) - read.ranges
    assert np.abs(off).max() < 1.0


def test_fields_lie_at_the_published_offsets(tmp_path: Path) -> None:
    """One shot by hand, from the second frame's bytes (domain facts, B), as PEDR2TAB takes them."""
    frames = replace(track(60, 0.3), crossovers=np.array([1.0, 1.5, 1.2]))
    path = tmp_path / "ap18933l.b"
    write_pedr(path, frames, {"START_TIME": "2001-03-08T12:52:54"})
    content = path.read_bytes()
    assert len(content) == 7760 + 3 * 776
    frame = content[7760 + 776 : 7760 + 2 * 776]

    def word(offset: int, kind: str = "i") -> float:
        return struct.unpack_from(f">{kind}", frame, offset)[0]

    k = 7  # counted from 1; shot 26 counted from 0
    x = (k - 10.5) / 20.0
    raw, middle = 0.01 * word(48 + 4 * (k - 1), "I"), 0.01 * word(128, "I")
    time = word(0) + 1e-6 * word(4) + 0.01 / (1e-9 * word(644)) * (k - 10.5)
    latitude = 1e-6 * word(336) + x * 1e-6 * word(768) + 1e-9 * word(324) * (raw - middle)
    longitude = 1e-6 * word(340) + x * 1e-6 * word(772) + 1e-9 * word(328) * (raw - middle)
    assert time == pytest.approx(frames.times[26], abs=1e-6)
    assert word(552, "d") == pytest.approx(word(0) + 1e-6 * word(4), abs=1e-8)
    assert latitude == pytest.approx(foot(frames)[1][26] / DEG, abs=1.5e-5)
    assert longitude == pytest.approx(foot(frames)[0][26] / DEG, abs=1.5e-5)
    assert word(332) == 150
    assert raw - 1.5 - x * (1.5 - 1.0) == pytest.approx(foot(frames)[2][26], abs=0.0051)
    assert 0.01 * (word(612) + x * word(640)) == pytest.approx(frames.areoid_radii[26], abs=0.01)
    assert 0.01 * (word(20, "I") + x * word(608)) == pytest.approx(craft(frames)[2][26], abs=0.5)
    assert 1e-6 * (word(12) + x * word(600)) == pytest.approx(craft(frames)[1][26] / DEG, abs=1e-6)
    assert 1e-6 * (word(16) + x * word(604)) == pytest.approx(craft(frames)[0][26] / DEG, abs=1e-6)
    assert 1e-6 * word(616) == pytest.approx(0.3 / DEG, abs=1e-6)
    assert 0.01 * word(648 + 4 * (k - 1)) == pytest.approx(frames.ranges[26], abs=0.0051)
    assert (word(8, "I"), word(490, "h"), word(384, "h"), word(224, "B")) == (18933, 2, 1, 1)
    assert word(536, "h") >= 3  # otherwise PEDR2TAB takes no parallax


def test_label_is_one_that_pedr2tab_accepts(tmp_path: Path) -> None:
    """It wants an SFDU, and 7.125 or more 25 characters after the start of SOFTWARE_NAME, in the first record."""
    write_pedr(tmp_path / "ap18933l.b", track(20), {"PRODUCT_VERSION_TYPE": "SIMULATED"})
    first = (tmp_path / "ap18933l.b").read_bytes()[:776].decode("ascii")
    assert first.startswith("CCSD3ZF0")
    start = first.index("SOFTWARE_NAME =")
    assert float(first[start + 25 : start + 29]) >= 7.125
    label = (tmp_path / "ap18933l.b").read_bytes()[:7760].decode("ascii")
    assert re.search(r"\r\nFILE_RECORDS = 11\r\n", label)
    assert "PRODUCT_VERSION_TYPE = SIMULATED\r\n" in label
    assert label.rstrip(" ").endswith("END\r\n")


def test_noise_and_missing_shots(tmp_path: Path) -> None:
    frames = track(30)
    ground, ranges = np.ones(30, dtype=bool), frames.ranges.copy()
    ground[[3, 22]], ranges[7] = False, 0.0
    read = write_pedr(tmp_path / "ap18933l.b", replace(frames, ground=ground, ranges=ranges))
    np.testing.assert_array_equal(read.ground, ground)
    np.testing.assert_array_equal(np.flatnonzero(np.isnan(read.ranges)), [7])


def test_shots_with_gaps_or_wild_values_are_refused(tmp_path: Path) -> None:
    frames = track(30)
    late = frames.times.copy()
    late[20:] += 0.1
    refuses(r"shot 20 is 0\.100000 s off; expected 10 shots a second", replace, frames, times=late)
    refuses("shot_radius", write_pedr, tmp_path / "ap18933l.b", replace(frames, footprints=1e3 * frames.footprints))
    assert list(tmp_path.iterdir()) == []


# --- MOC


IMAGE = replace(
    site_settings("gusev").images[0], name="E02-00665", exposure=1.4462e-3, downtrack_summing=1, crosstrack_summing=2,
    edit_mode=0,
)


def write(path: Path, grey: np.ndarray, image: ImageSettings = IMAGE) -> None:
    write_moc_image(path, image, "668523185:17", "Gusev", grey)


def pixels(lines: int, samples: int) -> np.ndarray:
    return np.random.default_rng(1).integers(0, 256, (lines, samples)).astype(np.uint8)


@pytest.mark.parametrize(("samples", "summing", "records"), [(1024, 2, 2), (672, 3, 4), (256, 8, 8)])
def test_images_are_read_back(tmp_path: Path, samples: int, summing: int, records: int) -> None:
    path, grey = tmp_path / "E0200665.img", pixels(33, samples)
    write(path, grey, replace(IMAGE, crosstrack_summing=summing))
    assert path.stat().st_size == (33 + records) * samples
    label = read_line_scan_label(path)
    assert (label.camera.name, label.product, label.start) == ("MGS MOC-NA", "E02/00665", "668523185:17")
    assert (label.lines, label.samples, label.sample_summing, label.first_sample) == (33, samples, summing, 0)
    assert label.period == pytest.approx(1.4462e-3, rel=1e-12)
    np.testing.assert_array_equal(read_moc_pixels(path), grey)


def test_label_is_laid_out_as_the_real_one(tmp_path: Path, shared_data: Path) -> None:
    """Same keywords in nearly the same places as M01/00115, same number of label records, blanks to the end."""
    real = (shared_data / "mgs_moc_pair" / "M0100115.img").read_bytes()[: 4 * 672]
    write(tmp_path / "M0100115.img", pixels(4864, 672))
    ours = (tmp_path / "M0100115.img").read_bytes()[: 4 * 672]
    keys = [re.findall(rb"^(\^?\w+) ?=", text, re.MULTILINE) for text in (ours, real)]
    assert keys[0] == keys[1]
    same = (b"RECORD_BYTES", b"FILE_RECORDS", b"LABEL_RECORDS", rb"\^IMAGE", b"LINES", b"SAMPLE_BIT_MASK")
    for key in (*same, b"DATA_SET_ID"):
        values = [re.search(rb"^" + key + rb" = (.*)\r$", text, re.MULTILINE) for text in (ours, real)]
        assert values[0] is not None
        assert values[1] is not None
        assert values[0][1] == values[1][1]
    assert set(ours[ours.index(b"END\r\n") + 5 :]) == {32}


def _checksum(content: bytes) -> tuple[int, int]:
    """The one a label states, and the sum of the signed bytes after 2048."""
    stated = re.search(rb"CHECKSUM = 16#(\w+)#", content[:2048])
    assert stated is not None
    return int(stated[1], 16), int(np.frombuffer(content, np.int8, offset=2048).sum(dtype=np.int64)) % 2**32


def test_checksums_follow_the_archive_s_rule(tmp_path: Path, shared_data: Path) -> None:
    write(tmp_path / "x.img", pixels(20, 1024))
    for path in (shared_data / "mgs_moc_pair" / "M0100115.imq", tmp_path / "x.img"):
        stated, found = _checksum(path.read_bytes())
        assert stated == found


def test_what_is_no_picture_is_refused(tmp_path: Path) -> None:
    for wrong in (np.zeros((3, 4)), np.zeros((3, 4, 1), dtype=np.uint8), np.zeros((0, 4), dtype=np.uint8)):
        refuses(r"expected \(lines, samples\) of uint8", write, tmp_path / "x.img", wrong)


# --- laser spots


HIGH, SIGMA = 400e3, 42.0
"""m, of the spacecraft; standard deviation of the energy on the ground."""


class Ground:
    """z = height(x, y) in place of Mars; rays go down."""

    def __init__(self, height: Callable[[Array, Array], Array]) -> None:
        self.height = height

    def intersect(self, origins: Array, directions: Array) -> Array:
        unit = directions / -directions[:, 2:]
        along = origins[:, 2].copy()
        for _ in range(60):
            points = origins + along[:, None] * unit
            along += points[:, 2] - self.height(points[:, 0], points[:, 1])
        return np.asarray(origins + along[:, None] * unit)


def measured(height: Callable[[Array, Array], Array], tilt: float = 0.0) -> tuple[float, float]:
    """Mean range and spread, of a beam that meets (0, 0, height there) and is tilted towards +X (rad)."""
    beam = np.array([[np.sin(tilt), 0.0, -np.cos(tilt)]])
    top = np.array([[0.0, 0.0, float(height(np.zeros(1), np.zeros(1))[0])]])
    ground: Any = Ground(height)
    mean, spread = ranges_over_spots(ground, top - HIGH * beam, beam)
    return float(mean[0]), float(spread[0])


@pytest.mark.parametrize("slope", [0.0, 0.1, 0.4])
@pytest.mark.parametrize("tilt", [0.0, 0.35])
def test_a_plane_is_ranged_at_its_middle(slope: float, tilt: float) -> None:
    mean, spread = measured(lambda x, y: 30.0 + slope * (0.6 * x + 0.8 * y), tilt)
    assert mean == pytest.approx(HIGH, abs=0.02)  # rays beside the axis are 5 mm longer
    if not tilt:
        assert spread == pytest.approx(slope * SIGMA, abs=0.1)


@pytest.mark.parametrize("radius", [500.0, -900.0])
def test_a_paraboloid_is_ranged_at_its_mean_height(radius: float) -> None:
    mean, _ = measured(lambda x, y: (x**2 + y**2) / (2.0 * radius))
    assert mean == pytest.approx(HIGH - SIGMA**2 / radius + SIGMA**2 / HIGH, abs=1e-3)


def test_a_saddle_and_a_twist_cancel() -> None:
    for height in (lambda x, y: (x**2 - y**2) / 500.0, lambda x, y: x * y / 300.0):
        assert measured(height)[0] == pytest.approx(HIGH, abs=0.01)

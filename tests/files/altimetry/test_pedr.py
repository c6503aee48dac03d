"""PEDR frames laid down byte by byte from the published offsets, against the archive's own formulas shot by shot."""

import struct
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mgsgraph.errors import InputError
from mgsgraph.files.altimetry.binary import FRAME, read_pedr
from mgsgraph.geometry.altimetry import AltimeterShots

LABEL = (
    "CCSD3ZF0000100000001NJPL3IF0PDSX00000001\r\nPDS_VERSION_ID = PDS3\r\nRECORD_TYPE = FIXED_LENGTH\r\n"
    "RECORD_BYTES = 776\r\nLABEL_RECORDS = 10\r\n^PEDR_TABLE = 11\r\n"
    'PRODUCT_ID = "AP18933L.B"\r\nSOFTWARE_NAME = "MOLA_PPROC;V7.25"\r\nEND\r\n'
)
COUNTED = LABEL.replace("LABEL_RECORDS", "FILE_RECORDS = 13\r\nLABEL_RECORDS")
"""Of three frames."""


def header(text: str = LABEL) -> bytes:
    return text.encode().ljust(7760)


def frame(**changed: Any) -> bytes:
    """One frame, written with the offsets of the published format (0-based bytes), not with the reader's own."""
    values: dict[str, Any] = {
        "seconds": 3000000, "microseconds": 250000, "orbit": 18933, "sc_lat": -14600000, "sc_lon": 175400000,
        "sc_rad": 376912345, "mid_range": 38812345, "radius": [339000000 + 700 * k for k in range(20)],
        "mid_radius": 339003000, "dlatdr": 120, "dlondr": -4500, "crossover": 250, "lat": -14571234,
        "lon": 175478901, "class": [1] * 20, "frame_index": 3, "model": 4, "d_sc": (103000, -14000, 5200),
        "areoid": 339012000, "off_nadir": 321000, "d_areoid": -900, "clock": 99996232,
        "range": [37900000 + k for k in range(20)], "correction": [-12 + k for k in range(20)],
        "d_ground": (103100, -13900), "channel": [1, 2] * 10,
        "sigma_optical": [80 + k for k in range(19)] + [0],
    } | changed
    out = bytearray(776)

    def put(offset: int, form: str, *what: Any) -> None:
        struct.pack_into(">" + form, out, offset, *what)

    put(0, "iiI", values["seconds"], values["microseconds"], values["orbit"])
    put(12, "iiI", values["sc_lat"], values["sc_lon"], values["sc_rad"])
    put(24, "i", values["mid_range"])
    put(48, "20I", *values["radius"])
    put(128, "I", values["mid_radius"])
    put(224, "20B", *values["channel"])
    put(284, "20h", *values["sigma_optical"])
    put(324, "iii", values["dlatdr"], values["dlondr"], values["crossover"])
    put(336, "ii", values["lat"], values["lon"])
    put(384, "20h", *values["class"])
    put(490, "h", values["frame_index"])
    put(536, "h", values["model"])
    put(552, "d", values["seconds"] + 1e-6 * values["microseconds"])
    put(600, "iii", *values["d_sc"])
    put(612, "i", values["areoid"])
    put(616, "i", values["off_nadir"])
    put(640, "ii", values["d_areoid"], values["clock"])
    put(648, "20i", *values["range"])
    put(728, "20h", *values["correction"])
    put(768, "ii", *values["d_ground"])
    return bytes(out)


def read(
    tmp_path: Path, *frames: bytes, name: str = "AP18933L.B", label: bytes | None = None, **how: Any
) -> AltimeterShots:
    path = tmp_path / name
    path.write_bytes((header() if label is None else label) + b"".join(frames))
    return read_pedr(path, **how)


def lon_lat_radius(points: np.ndarray) -> np.ndarray:
    x, y, z = points.T
    radius = np.sqrt(x * x + y * y + z * z)
    return np.column_stack([np.degrees(np.arctan2(y, x)), np.degrees(np.arcsin(z / radius)), radius])


def test_every_term_of_every_shot(tmp_path: Path) -> None:
    second = frame(seconds=3000002, crossover=310, frame_index=4)
    got = read(tmp_path, frame(), second)

    assert got.ids[:2] == ("18933:1:1", "18933:1:2")
    assert got.ids[-1] == "18933:2:20"
    want = []
    for xc, start in ((2.50, 3000000.25), (3.10, 3000002.25)):
        for k in range(1, 21):
            x = (k - 10.5) / 20
            raw = 0.01 * (339000000 + 700 * (k - 1))
            lift = raw - 3390030.0
            want.append([
                start + 0.01 / (1e-9 * 99996232) * (k - 10.5),
                175.478901 + x * -0.0139 + -4500e-9 * lift,
                -14.571234 + x * 0.1031 + 120e-9 * lift,
                raw - xc - x * 0.60,  # the first frame takes its change from the second
                3390120.0 + x * -9.0,
                0.01 * (37900000 + k - 1),
                0.01 * (-12 + k - 1),
                175.4 + x * -0.014, -14.6 + x * 0.103, 3769123.45 + x * 52.0,
            ])
    expected = np.array(want)
    np.testing.assert_allclose(got.times, expected[:, 0], rtol=0, atol=1e-9)
    for points, columns in ((got.footprints, expected[:, 1:4]), (got.spacecraft, expected[:, 7:])):
        np.testing.assert_allclose(lon_lat_radius(points)[:, :2], columns[:, :2], rtol=0, atol=1e-9)
        np.testing.assert_allclose(lon_lat_radius(points)[:, 2], columns[:, 2], rtol=0, atol=1e-6)
    np.testing.assert_allclose(got.areoid_radii, expected[:, 4], rtol=0, atol=1e-6)
    np.testing.assert_allclose(got.ranges, expected[:, 5], rtol=0, atol=1e-6)
    np.testing.assert_allclose(got.range_corrections, expected[:, 6], rtol=0, atol=1e-9)
    np.testing.assert_allclose(np.degrees(got.off_nadir), 0.321, rtol=1e-12)
    assert got.channels[:2].tolist() == [1, 2]
    assert np.all(got.clocks == 99996232)
    np.testing.assert_allclose(got.pulses[:19], 1e-10 * (80.0 + np.arange(19.0)))
    assert np.isnan(got.pulses[19])


def test_the_public_layout_is_the_published_one() -> None:
    one = np.frombuffer(frame(), FRAME)[0]

    assert FRAME.itemsize == 776
    assert (one["orbit"], one["clock"], one["d_longitude"], one["crossover"]) == (18933, 99996232, -13900, 250)
    assert one["shot_radius"][19] == 339000000 + 700 * 19
    assert one["range_correction"][0] == -12
    assert one["time"] == 3000000.25
    assert FRAME.fields is not None
    ends = sorted((offset, offset + form.itemsize) for form, offset, *_ in FRAME.fields.values())
    assert all(end <= start for (_, end), (start, _) in pairwise(ends))


def test_noise_shots_without_a_range_and_shots_that_are_none(tmp_path: Path) -> None:
    radii, ranges, classes = [339000000] * 20, [37900000] * 20, [1] * 20
    radii[4], ranges[4] = 0, 0
    ranges[7] = 0
    classes[9] = 0
    got = read(tmp_path, frame(**{"radius": radii, "range": ranges, "class": classes}))

    assert got.times.size == 19
    assert "18933:1:5" not in got.ids
    assert [got.ids[k] for k in np.flatnonzero(~got.ground)] == ["18933:1:10"]
    assert [got.ids[k] for k in np.flatnonzero(np.isnan(got.ranges))] == ["18933:1:8"]


def test_clock_bias_moves_times_alone(tmp_path: Path) -> None:
    plain, late = read(tmp_path, frame()), read(tmp_path, frame(), clock_bias=0.117)

    np.testing.assert_allclose(late.times - plain.times, 0.117, rtol=0, atol=1e-9)
    np.testing.assert_array_equal(late.footprints, plain.footprints)


def test_a_body_without_label_and_the_middle_of_a_day(tmp_path: Path) -> None:
    for seconds in (-26456702, 3000000, 46782844):
        bare = read(tmp_path, frame(seconds=seconds), label=b"")
        assert bare.times.size == 20
        assert abs(bare.times.mean() - (seconds + 0.25)) < 1e-6


@pytest.mark.parametrize("name", ["AP18933D.B", "ap18933k.tab"])
def test_earlier_versions_are_refused_by_name_or_label(tmp_path: Path, name: str) -> None:
    """They are in another frame: 14 km off."""
    for label, called in ((b"", name), (header(LABEL.replace("L.B", f"{name[7].upper()}.B")), "mola.b")):
        with pytest.raises(InputError, match=r"PEDR of version [DK]; expected version L"):
            read(tmp_path, frame(), name=called, label=label)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (header() + frame() + frame()[:400], r"1 frames and 400 bytes more"),
        (header(COUNTED) + frame(), r"FILE_RECORDS: 13, and 11 records in the file"),
        (header() + frame() + frame(lat=91_000_000), r"frame 2, latitude: 91 degrees; expected -90 \.\. 90"),
        (header() + frame(sc_lat=-2_000_000_000), r"frame 1, spacecraft's latitude: -2000 degrees"),
        (header() + frame(clock=99_996_232 + 2**22), r"frame 1, clock: 104190536 Hz"),
        (header(LABEL.replace("776", "780")) + frame(), r"RECORD_BYTES: 780; expected 776"),
        (header() + frame(radius=[12345] * 20), r"frame 1, radius: 123.45 m"),
        (header() + frame(range=[-37900000] * 20), r"range -379000.0 m; expected a positive range"),
        (header() + frame(radius=[0] * 20), r"without a single shot"),
        (header() + frame()[:552] + struct.pack(">d", 1.0) + frame()[560:], r"frame 1, difference of its two times"),
    ],
)
def test_what_is_no_pedr(tmp_path: Path, content: bytes, message: str) -> None:
    path = tmp_path / "AP18933L.B"
    path.write_bytes(content)
    with pytest.raises(InputError, match=message) as caught:
        read_pedr(path)
    assert "\n" not in str(caught.value)
    assert str(path) in str(caught.value)


def test_as_many_frames_as_the_label_counts(tmp_path: Path) -> None:
    """With the label's own records, as the archive counts them, or without."""
    for count in (3, 13):
        assert read(tmp_path, *[frame(orbit=k) for k in range(count)], label=header(COUNTED)).times.size == 20 * count


def test_profile_for_the_adjustment(tmp_path: Path) -> None:
    ranges = [37900000] * 20
    ranges[3] = 0
    shots = read(tmp_path, frame(range=ranges))
    with pytest.raises(InputError, match=r"18933:1:4: no range"):
        shots.profile(10.0, 10.0)
    profile = shots.chosen(~np.isnan(shots.ranges)).profile(10.0, 12.0, "E02-00665", "ap18933")

    assert profile.ids[0] == "ap18933:18933:1:1"
    assert profile.simultaneous_shot.tolist() == list(range(19))
    assert profile.simultaneous_image == ("E02-00665",) * 19
    np.testing.assert_array_equal(profile.range_sigmas, 10.0)
    np.testing.assert_allclose(profile.covariances, np.broadcast_to(144.0 * np.eye(3), (19, 3, 3)))


def test_spacing_is_of_neighbours_in_time(tmp_path: Path) -> None:
    shots = read(tmp_path, frame(), frame(seconds=3100000))
    steps = np.linalg.norm(np.diff(shots.footprints[:20], axis=0), axis=1)

    np.testing.assert_allclose(shots.spacing, np.median(steps), rtol=1e-6)
    assert np.isnan(shots.chosen(np.array([0, 5])).spacing)

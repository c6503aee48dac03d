"""PEDR in bytes, by published offsets and the archive's formulas, and as text: its program's tables and ODE's."""

import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from outside import refuses

from mgsgraph.files.altimetry.binary import read_pedr
from mgsgraph.files.altimetry.shots import read_shots
from mgsgraph.files.altimetry.tables import shots_of_table, table_of
from mgsgraph.geometry.altimetry import AltimeterShots

# --- bytes


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


def test_old_software_has_no_crossovers_and_parallax_by_gravity_model(tmp_path: Path) -> None:
    old = LABEL.replace("V7.25", "V7.05")
    with_parallax = read(tmp_path, frame(model=2), label=header(old))
    without = read(tmp_path, frame(model=1), label=header(old))

    np.testing.assert_allclose(np.linalg.norm(with_parallax.footprints, axis=1)[0], 3390000.0, rtol=0, atol=1e-6)
    np.testing.assert_allclose(lon_lat_radius(without.footprints)[0, 0], 175.478901 + 0.475 * 0.0139, atol=1e-9)
    shift = lon_lat_radius(with_parallax.footprints)[0, 0] - lon_lat_radius(without.footprints)[0, 0]
    np.testing.assert_allclose(shift, -4500e-9 * -30.0, atol=1e-9)


def test_iau1991_rotation_against_spice(tmp_path: Path) -> None:
    """The same rotation from two PCK texts, by SPICE."""
    spiceypy = pytest.importorskip("spiceypy")
    elements = {
        "old": ("317.681 -0.108", "52.886 -0.061", "176.868 350.8919830"),
        "new": ("317.68143 -0.1061", "52.88650 -0.0609", "176.630 350.89198226"),
    }
    for name, values in elements.items():
        keys = ("POLE_RA", "POLE_DEC", "PM")
        text = "".join(f"BODY499_{key} = ({value} 0)\n" for key, value in zip(keys, values, strict=True))
        (tmp_path / f"{name}.tpc").write_text(f"KPL/PCK\n\\begindata\n{text}\\begintext\n")
    old = read(tmp_path, frame(), name="AP18933D.B")
    new = read(tmp_path, frame(), name="AP18933L.B")
    body = {}
    for name in elements:
        spiceypy.furnsh(str(tmp_path / f"{name}.tpc"))
        body[name] = np.array([spiceypy.tipbod("J2000", 499, time) for time in new.times])
        spiceypy.unload(str(tmp_path / f"{name}.tpc"))
    turned = np.einsum("nij,nkj,nk->ni", body["new"], body["old"], new.footprints)

    np.testing.assert_allclose(old.footprints, turned, rtol=0, atol=1e-6)


def test_version_comes_from_name_label_or_caller(tmp_path: Path) -> None:
    by_label = read(tmp_path, frame(), name="mola.b")
    by_caller = read(tmp_path, frame(), name="other.b", label=b"", version="L")
    np.testing.assert_array_equal(by_label.footprints, by_caller.footprints)
    for how in ({}, {"version": "M"}, {"version": ""}):
        refuses("version", read, tmp_path, frame(), name="other.b", label=b"", **how)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (header() + frame() + frame()[:400], r"1 frames and 400 bytes more"),
        (header(COUNTED) + frame(), r"FILE_RECORDS: 13, and 11 records in the file"),
        (header() + frame() + frame(lat=91_000_000), r"frame 2, latitude: 91 degrees; expected -90 \.\. 90"),
        (header() + frame(clock=99_996_232 + 2**22), r"frame 1, clock: 104190536 Hz"),
        (header() + frame(radius=[12345] * 20), r"frame 1, radius: 123.45 m"),
        (header() + frame(range=[-37900000] * 20), r"range -379000.0 m; expected a positive range"),
        (header() + frame()[:552] + struct.pack(">d", 1.0) + frame()[560:], r"frame 1, difference of its two times"),
    ],
)
def test_what_is_no_pedr(tmp_path: Path, content: bytes, message: str) -> None:
    path = tmp_path / "AP18933L.B"
    path.write_bytes(content)
    refuses(rf"AP18933L\.B.*{message}", read_pedr, path)


def test_as_many_frames_as_the_label_counts(tmp_path: Path) -> None:
    """With the label's own records, as the archive counts them, or without."""
    for count in (3, 13):
        assert read(tmp_path, *[frame(orbit=k) for k in range(count)], label=header(COUNTED)).times.size == 20 * count


def test_profile_for_the_adjustment(tmp_path: Path) -> None:
    ranges = [37900000] * 20
    ranges[3] = 0
    shots = read(tmp_path, frame(range=ranges))
    refuses(r"18933:1:4: no range", shots.profile, 10.0, 10.0)
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


# --- text


HEADS = (
    "long_East lat_North topography MOLArange  planet_rad c A", "  SC_long   SC_lat     SC_radius",
    " offndr  EphemerisTime  areod_lat areoid_rad", " shot pkt  orbit gm",
)
RULES = (
    "---.-----  --.-----  ------.-- ------.-- --------.-- - -", " ---.----- ---.----- --------.--",
    " --.--- ---------------  --.-----  ------.--", " ---  ---- ----- --",
)
ODE = "long_East,lat_North,topography, MOLArange,  planet_rad, c,A,  Ephermis Time,            UTC,          Orbit"
ODE_SHOT = "137.37669, -4.09420,   -2659.75, 390043.53,  3393004.81,1,0, -23162931.18358,1999-04-08T09:50:04.631, 10372"
COUNTS = {
    "curiosity_topography.csv": 8840, "insight_topography.csv": 8410, "opportunity_topography.csv": 8715,
    "perseverance_topography.csv": 10108,
}


def shot(longitude: float, range_: float, channel: int = 1, flag: int = 0, groups: str = "0123") -> str:
    """A line by PEDR2TAB's Fortran formats (9000 to 9003)."""
    parts = {
        "0": f"{longitude:9.5f}{-14.57123:10.5f}{-1932.45:11.2f}{range_:10.2f}{3390123.45:12.2f}{channel:2d}{flag:2d}",
        "1": f"{175.4:10.5f}{-14.6:10.5f}{3769123.45:12.2f}",
        "2": f"{0.321:7.3f}{-23162931.18358:16.5f}{-14.74523:10.5f}{3392055.9:11.2f}",
        "3": f"{117:4d}{12345:6d}{18933:6d}{4:3d}",
    }
    return "".join(parts[group] for group in groups)


def table(tmp_path: Path, *lines: str, groups: str = "0123", name: str = "ap18933l.tab") -> Path:
    heads = ["".join(part[int(g)] for g in groups) for part in (HEADS, RULES)]
    path = tmp_path / name
    path.write_text("\n".join([*heads, *lines]) + "\n")
    return path


def test_table_of_all_groups(tmp_path: Path) -> None:
    got = read_shots(table(tmp_path, shot(175.47890, 379000.12), shot(175.47889, 379001.0, channel=4, flag=4)))

    np.testing.assert_allclose(np.linalg.norm(got.footprints, axis=1), 3390123.45, rtol=1e-12)
    x, y, z = got.footprints[0]
    np.testing.assert_allclose(np.degrees(np.arctan2(y, x)), 175.4789, atol=1e-9)
    np.testing.assert_allclose(np.degrees(np.arcsin(z / 3390123.45)), -14.57123, atol=1e-9)
    np.testing.assert_allclose(got.times, -23162931.18358, rtol=0, atol=1e-6)
    np.testing.assert_allclose(got.ranges, [379000.12, 379001.0])
    np.testing.assert_allclose(got.areoid_radii, 3392055.9)
    np.testing.assert_allclose(np.linalg.norm(got.spacecraft, axis=1), 3769123.45)
    np.testing.assert_allclose(np.degrees(got.off_nadir), 0.321)
    assert got.ground.tolist() == [True, False]
    assert got.channels.tolist() == [1, 4]
    assert got.ids == ("18933:3:1", "18933:4:1")


def test_fields_that_abut_are_cut_at_the_formats_widths(tmp_path: Path) -> None:
    wide = shot(-75.47890, 9379000.12, groups="02")  # the range fills its ten characters
    assert "-1932.459379000.12" in wide
    path = table(tmp_path, wide, groups="02")
    got = shots_of_table(table_of(path.read_text(), path))  # no altimeter ranges as far: `read_shots` refuses it

    assert got.ranges[0] == 9379000.12
    np.testing.assert_allclose(np.degrees(np.arctan2(got.footprints[0, 1], got.footprints[0, 0])), -75.4789, atol=1e-9)


def test_groups_may_lack_and_columns_may_be_spaced_otherwise(tmp_path: Path) -> None:
    fixed = read_shots(table(tmp_path, shot(175.4, 379000.0, groups="02"), groups="02"))
    spaced = "  ".join(shot(175.4, 379000.0, groups="02").split())
    loose = read_shots(table(tmp_path, spaced, groups="02"))

    np.testing.assert_array_equal(fixed.footprints, loose.footprints)
    assert np.all(np.isnan(fixed.spacecraft))
    assert fixed.orbits.tolist() == [0]


def test_the_variant_with_wider_numbers(tmp_path: Path) -> None:
    usual = shot(175.4, 379000.0, groups="02")
    line = usual[:56] + " " + usual[56:] + f"{117:4d}{12345:7d}{18933:8d}{4:3d}"
    got = read_shots(table(tmp_path, line, groups="023"))

    assert got.orbits.tolist() == [18933]
    np.testing.assert_allclose(np.degrees(got.off_nadir), 0.321)


def test_a_table_must_say_its_version(tmp_path: Path) -> None:
    path = table(tmp_path, shot(175.4, 379000.0), name="mola.tab")
    refuses("no product version", read_shots, path)
    new, old = read_shots(path, version="L"), read_shots(path, version="K")
    moved = np.linalg.norm(new.footprints - old.footprints, axis=1)
    # 0.2375 deg of longitude at 14.6 deg south
    np.testing.assert_allclose(moved, np.radians(0.2375) * 3390123.45 * np.cos(np.radians(14.57)), rtol=2e-3)


def ode(tmp_path: Path, *lines: str) -> Path:
    path = tmp_path / "shots.csv"
    path.write_text("\r\n".join(lines) + "\r\n")
    return path


def test_ode_header_as_it_is(tmp_path: Path) -> None:
    got = read_shots(ode(tmp_path, ODE, ODE_SHOT), clock_bias=0.5)

    assert got.ids == ("10372:2:1",)
    np.testing.assert_allclose(got.times, -23162930.68358, rtol=0, atol=1e-6)
    np.testing.assert_allclose(got.areoid_radii, 3393004.81 + 2659.75)
    assert got.ground.all()


def test_utc_alone_is_enough(tmp_path: Path) -> None:
    names, values = (line.split(",") for line in (ODE, ODE_SHOT))
    path = ode(tmp_path, ",".join(names[:7] + names[8:]), ",".join(values[:7] + values[8:]))
    got = read_shots(path)
    assert abs(got.times[0] - -23162931.18358) < 1.1e-3  # UTC stands there to the millisecond
    path.write_text(path.read_text().replace("1999-04-08", "1999-14-08"))
    refuses(r"UTC: .*1999-14-08", read_shots, path)


@pytest.mark.parametrize(
    ("lines", "message"),
    [
        ((ODE.replace("topography", "planet_rad"), ODE_SHOT), "the column 'planet_rad' twice"),
        ((ODE, ODE_SHOT, ODE_SHOT[:60]), "line 3: 8 fields; expected 10"),
        ((ODE, ODE_SHOT.replace("3393004.81", "3393.00")), "shot 10372:2:1: a radius of 3.393 km"),
    ],
)
def test_what_is_no_table(tmp_path: Path, lines: tuple[str, ...], message: str) -> None:
    refuses(message, read_shots, ode(tmp_path, *lines))


@pytest.mark.parametrize("name", COUNTS)
def test_real_files_whole(shared_data: Path, name: str) -> None:
    path = shared_data / "mola_pedr_ode" / name
    got = read_shots(path)

    assert got.times.size == COUNTS[name]
    assert 300.0 < got.spacing < 310.0  # MOLA's 305 m
    assert np.all(got.ground)
    # the header's topography is radius minus areoid: the areoid must be smooth along every track
    order = np.lexsort([got.times, got.orbits])
    step, gap = np.diff(got.areoid_radii[order]), np.diff(got.times[order])
    assert np.abs(step[(gap > 0) & (gap < 0.15)]).max() < 1.0


def test_real_utc_is_the_ephemeris_time(shared_data: Path, tmp_path: Path) -> None:
    source = shared_data / "mola_pedr_ode" / "insight_topography.csv"
    lines = source.read_text().replace("Ephermis Time", "unused").splitlines()
    path = tmp_path / "utc.csv"
    path.write_text("\n".join([lines[0], *lines[1::500]]))
    utc = read_shots(path)

    np.testing.assert_allclose(utc.times, read_shots(source).times[::500], rtol=0, atol=1.1e-3)

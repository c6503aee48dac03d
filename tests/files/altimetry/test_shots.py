"""Laser shots of all altimeters: units and frames by outside authority, by the geometry of the shots themselves."""

import gzip
import re
import struct
from datetime import datetime, timedelta
from pathlib import Path

import numpy as np
import pytest
from outside import require

from mgsgraph.errors import InputError
from mgsgraph.files.altimetry.lidar import read_lidar
from mgsgraph.files.altimetry.shots import read_shots
from mgsgraph.geometry.altimetry import ALTIMETERS, LOLA, MOLA, AltimeterShots
from mgsgraph.geometry.trajectory import tdb_of_tt, tdb_of_utc, utc_of_tdb
from mgsgraph.units import DEG

LIGHT = 299_792_458.0
def written(folder: Path, *lines: str, name: str = "shots.csv") -> Path:
    path = folder / name
    path.write_text("\n".join(lines) + "\n")
    return path


# --- LOLA


def test_lola_table_agrees_with_isis(shared_data: Path) -> None:
    """Times, ranges and places of the file that lrolola2isis was given are those that it wrote; no header is there."""
    folder = shared_data / "lro_nac_lola"
    found, theirs = read_shots(folder / "lidarPoints.csv"), read_lidar(folder / "lidarData.json")
    nearest = np.abs(found.times[:, None] - theirs.times).argmin(axis=0)

    assert len(set(nearest.tolist())) == 52
    np.testing.assert_allclose(found.times[nearest], theirs.times, atol=1e-7, rtol=0.0)  # TDB: TT is 1.4 ms off
    np.testing.assert_allclose(found.ranges[nearest], theirs.ranges, atol=1e-9)
    np.testing.assert_allclose(found.footprints[nearest], theirs.footprints, atol=1e-8)
    assert found.altimeter is LOLA


def test_lola_over_hadley_by_its_own_geometry(shared_data: Path) -> None:
    """Spacecraft, footprint and range close to 0.6 m, and the angle off nadir is between them: units are right."""
    shots = read_shots(shared_data / "lro_nac_hadley" / "RDR_hadley_LOLA.csv.gz")
    beams = shots.footprints - shots.spacecraft
    distances = np.linalg.norm(beams, axis=1)
    cosine = -np.einsum("ni,ni->n", beams, shots.spacecraft) / distances / np.linalg.norm(shots.spacecraft, axis=1)

    assert shots.times.size == 52363
    assert len({name[:10] for name in shots.profile_names()}) == 41
    assert np.all(np.abs(distances - shots.ranges) < 0.6)
    assert np.quantile(np.abs(np.arccos(cosine) - shots.off_nadir), 0.99) < 0.06 * DEG  # a slew is 1 degree off
    assert shots.areoid_radii == pytest.approx(np.full(52363, 1737.4e3), abs=200.0)
    assert np.all(shots.ground)


def lola_record(seconds: float, range_m: float) -> bytes:
    """A record of LOLARDR.FMT with the same five spots, straight below a spacecraft over 2.5 E, 25 S."""
    content = bytearray(256)
    whole = int(seconds)
    struct.pack_into("<2I", content, 8, whole, round((seconds - whole) * 2**32))
    struct.pack_into("<2i2I", content, 24, 25_000_000, -250_000_000, round((1735e3 + range_m) * 1e3), 1_737_373_000)
    for k in range(5):
        flag = 0 if k < 4 else 0x41
        struct.pack_into("<3iI", content, 40 + 40 * k, 25_000_000, -250_000_000, 1_735_000_000, round(range_m * 1e3))
        struct.pack_into("<I", content, 76 + 40 * k, flag)
    struct.pack_into("<H", content, 240, 92)
    return bytes(content)


@pytest.mark.parametrize("labelled", [False, True])
def test_records_of_lola_have_ranges_spacecraft_and_noise(tmp_path: Path, labelled: bool) -> None:
    path = tmp_path / "LOLARDR_092490702.DAT"
    path.write_bytes(lola_record(305495504.25, 50e3) + lola_record(305495504.5, 50.5e3))
    if labelled:
        path = written(
            tmp_path, "PDS_VERSION_ID = PDS3", "RECORD_TYPE = FIXED_LENGTH", '^TABLE = "LOLARDR_092490702.DAT"',
            'DATA_SET_ID = "LRO-L-LOLA-3-RDR-V1.0"', "OBJECT = TABLE", "ROWS = 2", '^STRUCTURE = "LOLARDR.FMT"',
            "END_OBJECT = TABLE", "END", name="LOLARDR_092490702.LBL",
        )  # fmt: skip
    shots = read_shots(path)

    assert shots.ground.tolist() == ([True] * 4 + [False]) * 2
    np.testing.assert_allclose(shots.ranges, [50e3] * 5 + [50.5e3] * 5)
    np.testing.assert_allclose(np.linalg.norm(shots.spacecraft - shots.footprints, axis=1), shots.ranges, atol=1e-6)
    np.testing.assert_allclose(shots.off_nadir, 0.0046)
    assert set(shots.orbits.tolist()) == {200909060750}
    assert shots.times[0] - 305495504.25 == pytest.approx(-1.457e-3, abs=1e-6)


@pytest.mark.parametrize(("column", "factor"), [("Pt_Range", 1000.0), ("SC_radius", 1000.0), ("Pt_Radius", 1000.0)])
def test_lengths_of_lola_in_two_units(shared_data: Path, tmp_path: Path, column: str, factor: float) -> None:
    """Of the three that close a triangle one is in metres: refused, and said as ranges that don't fit."""
    text = gzip.decompress((shared_data / "lro_nac_hadley" / "RDR_hadley_LOLA.csv.gz").read_bytes())
    head, *rows = text.decode().splitlines()[:5]
    k = [name.strip() for name in head.split(",")].index(column)
    parts = [row.split(",") for row in rows]
    for part in parts:
        part[k] = str(float(part[k]) * factor)
    with pytest.raises(InputError, match=r"ranges of .* times what they should be"):
        read_shots(written(tmp_path, head, *map(",".join, parts)))


def test_lola_cut_between_records_is_known_by_the_label_beside_it(tmp_path: Path) -> None:
    path = tmp_path / "LOLARDR_092490702.DAT"
    path.write_bytes(lola_record(305495504.25, 50e3) + lola_record(305495504.5, 50.5e3))
    counted = "PDS_VERSION_ID = PDS3\nRECORD_BYTES = 256\nFILE_RECORDS = {}\nEND"
    written(tmp_path, counted.format(2), name="LOLARDR_092490702.LBL")
    assert read_shots(path).times.size == 10
    written(tmp_path, counted.format(3), name="LOLARDR_092490702.LBL")
    with pytest.raises(InputError, match="FILE_RECORDS: 3, and 2 records in the file"):
        read_shots(path)


# --- times, and what is refused


def test_time_scales_are_those_of_spice(shared_data: Path) -> None:
    spiceypy = pytest.importorskip("spiceypy")
    kernels = require(shared_data / "mgs_moc_m0402852", "a leap seconds kernel")
    lsk = next(kernels.glob("naif*.tls"))
    texts = ["2000-01-01T12:00:00.25", "2009-09-06T07:50:38.77335829", "2011-07-20T23:05:00"]
    spiceypy.furnsh(str(lsk))
    try:
        expected = np.asarray(spiceypy.str2et(texts))
        terrestrial = np.array([spiceypy.unitim(float(one), "ET", "TDT") for one in expected])
    finally:
        spiceypy.kclear()
    known = 3 if "2009" in lsk.read_text() else 1  # an old kernel has fewer leap seconds
    np.testing.assert_allclose(tdb_of_utc(texts, "here")[:known], expected[:known], atol=1e-7, rtol=0.0)
    np.testing.assert_allclose(tdb_of_tt(terrestrial), expected, atol=1e-7, rtol=0.0)
    for text, time in zip(texts, tdb_of_utc(texts, "here"), strict=True):
        assert abs((utc_of_tdb(time) - datetime.fromisoformat(f"{text[:26]}Z")).total_seconds()) < 2e-6


@pytest.mark.parametrize("year", [1973, 1999, 2006, 2009, 2017])
def test_a_leap_second_is_a_second(year: int) -> None:
    """The last one of the year before."""
    texts = [f"{year - 1}-12-31T23:59:59", f"{year - 1}-12-31T23:59:60", f"{year}-01-01T00:00:00"]
    np.testing.assert_allclose(np.diff(tdb_of_utc(texts, "here")), 1.0, atol=1e-6)


def test_leap_seconds_are_those_of_naif(shared_data: Path) -> None:
    """Every step of the kernel's table, just before it and on it, and the leap second of 2008 itself; to and fro."""
    spiceypy = pytest.importorskip("spiceypy")
    kernel = require(shared_data / "kaguya_tc" / "naif0012.tls", "a leap seconds kernel")
    months = re.findall(r"(\d+),\s+@(\d{4})-(JAN|JUL)-1", kernel.read_text())
    days = [datetime.strptime(f"{year}-{month}-01Z", "%Y-%b-%d%z") for _, year, month in months]
    before = [day - timedelta(seconds=0.5) for day in days[1:]]
    texts = [f"{when:%Y-%m-%dT%H:%M:%S.%f}" for when in [*days, *before]]
    texts += ["2008-12-31T23:59:60.25", "2009-249T07:50:38.75"]
    spiceypy.furnsh(str(kernel))
    try:
        expected = np.asarray(spiceypy.str2et(texts))
    finally:
        spiceypy.kclear()
    found = tdb_of_utc(texts, "here")

    assert len(months) == 28
    np.testing.assert_allclose(found, expected, atol=1e-7, rtol=0.0)
    for text, time in zip(texts[:-2], found, strict=False):
        assert abs((utc_of_tdb(time) - datetime.fromisoformat(f"{text}Z")).total_seconds()) < 2e-6
    for wrong in ("1971-12-31T23:59:59", "2009-09-06", "2009-13-06T00:00:00", "2009-400T00:00", "2009-09-06T00:00:61"):
        with pytest.raises(InputError, match="here: a time that can't be read"):
            tdb_of_utc([wrong], "here")


LOLA_HEADER = "Pt_Longitude,Pt_Latitude,Pt_Radius,Pt_Range,Flg,S,Frm,Mission_ET,Terrestrial_Dyn_Time"


@pytest.mark.parametrize(
    ("row", "said"),
    [
        ("3,26,1736,50,1e30,1,2,209501234,305495504.25", "line 2, flg: 1e+30; expected a whole number"),
        ("3,26,1736,50,0.5,1,2,209501234,305495504.25", "line 2, flg: 0.5; expected a whole number"),
        ("3,26,1736,50,0,1,2,209501234,3.05495504e11", "a time of 3.05496e+11 s past J2000; expected"),
    ],
)
def test_numbers_that_can_not_be(tmp_path: Path, row: str, said: str) -> None:
    with pytest.raises(InputError) as caught:
        read_shots(written(tmp_path, LOLA_HEADER, row))
    assert said in str(caught.value)
    read_shots(written(tmp_path, LOLA_HEADER, "3,26,1736,50,4294967295,1,2,209501234,305495504.25"))


@pytest.mark.parametrize(
    ("lines", "said"),
    [
        (["PDS_VERSION_ID = PDS3", "END"], "a label of no known table of shots"),
        (['{"points": []}'], "ISIS lidar data go into [laser]"),
    ],
)
def test_what_is_refused(tmp_path: Path, lines: list[str], said: str) -> None:
    with pytest.raises(InputError) as caught:
        read_shots(written(tmp_path, *lines))
    assert said in str(caught.value)


SELECTION = "longitude_deg,latitude_deg,radius_m,range_m,time_s,altimeter,spacecraft_x_m,spacecraft_y_m,spacecraft_z_m"


@pytest.mark.parametrize(
    ("row", "said"),
    [
        ("0,0,3.2e6,380000,0,MOLA,,,", r"shot 0:7:1: a radius of 3200 km; expected 3274\.\d+ "),
        ("0,0,3390000,380000,1e9,MOLA,,,", "shot 0:7:1: a time of 1e[+]09 s"),
        ("0,0,3390000,3.8e8,0,MOLA,,,", "a range of 380000 km; .*metres stand where the format has kilometres"),
        ("0,0,3390000,1e299,0,MOLA,,,", "line 7, range_m: '1e299'; expected a finite number"),
        ("0,0,3390000,380000,0,MOLA,3.79e6,0,0", "shot 0:7:1: a range of 380 km; expected about 400 km, the way"),
    ],
)
def test_one_shot_that_can_not_be_among_many(tmp_path: Path, row: str, said: str) -> None:
    """Medians don't see it."""
    good = [f"{0.01 * k},0,3390000,380000,{k},MOLA,,," for k in range(1, 6)]
    path = written(tmp_path, SELECTION, *good, row)
    with pytest.raises(InputError, match=said):
        read_shots(path)
    assert read_shots(written(tmp_path, SELECTION, *good, "0,0,3390000,380000,0,MOLA,3.77e6,0,0")).times.size == 6


@pytest.mark.parametrize(
    ("lines", "said"),
    [
        ((SELECTION + "\u2028", "0,0,3390000,380000,0,MOLA,,,"), None),
        ((SELECTION, '0,0,"3390000",380000,0,"MOLA",,,'), None),
        ((SELECTION, '0,0,3390000,380000,0,MOLA,",,'), "line 2: no row of a CSV file"),
    ],
)
def test_rows_end_at_line_feeds_and_quotes_are_those_of_csv(
    tmp_path: Path, lines: tuple[str, ...], said: str | None
) -> None:
    path = written(tmp_path, *lines)
    if said is None:
        assert read_shots(path).times.size == 1
        return
    with pytest.raises(InputError, match=said):
        read_shots(path)


def test_the_table_of_altimeters() -> None:
    """Spots are what the beam sees from the height of the orbit; MOLA is the one that a case without words has."""
    heights = {"MOLA": 400e3, "LOLA": 50e3, "LALT": 100e3}
    for name, height in heights.items():
        assert ALTIMETERS[name].divergence * height == pytest.approx(ALTIMETERS[name].footprint)
    assert AltimeterShots.__dataclass_fields__["altimeter"].default is MOLA


def test_packed_tables_are_read(tmp_path: Path) -> None:
    path = tmp_path / "shots.csv.gz"
    path.write_bytes(gzip.compress(f"{SELECTION}\n0,0,3390000,380000,0,MOLA,,,\n".encode()))
    assert read_shots(path).times.size == 1

"""Laser shots of all altimeters and clouds of them: units and frames by outside authority and their own geometry."""

import gzip
import re
import struct
from datetime import datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from outside import refuses, require

from mgsgraph.errors import InputError
from mgsgraph.files.altimetry.lidar import read_lidar
from mgsgraph.files.altimetry.shots import read_altimetry_cloud, read_shots
from mgsgraph.files.networks.table import read_tie_points
from mgsgraph.files.support_data.isd import read_isd
from mgsgraph.geometry.altimetry import ALTIMETERS, LALT, LOLA, MLA, MOLA, AltimeterShots, AltimetryCloud
from mgsgraph.geometry.body import Ellipsoid, from_planetocentric, geodetic, planetocentric
from mgsgraph.geometry.trajectory import tdb_of_tt, tdb_of_utc, utc_of_tdb, utc_texts
from mgsgraph.network.footprints import points_in_images
from mgsgraph.units import DEG

LIGHT = 299_792_458.0
MLA_HEADER = (  # of ODE, as USGS's ode_csv2shapefile.py has it
    "longitude,latitude,altitude,radius,EphemerisTime,MET,frm,chn,Pulswd,thrsh,gain,1way_range,Emiss,TXmJ,UTC,TOF_ns_ET,"
    "Sat_long,Sat_lat,Sat_alt,Offnad,Phase,Sol_inc,SCRNGE,seqid,Product_id"
)


def mla_row(channel: int, time: float, radius: float = 2438.9, flight: float = 5.0e6) -> str:
    return (
        f"221.5, 63.25, -0.5, {radius}, {time}, 209501234, 3, {channel}, 12.5, 0.1, 3, {flight * LIGHT / 2e12}, 0.01,"
        f"18.2,{utc_of_tdb(time):%Y-%m-%dT%H:%M:%S.%f}, {flight}, 221.4, 63.2, 750.1, 0.4, 90.1, 80.0, 1.0, 17,"
        " MLASCIRDR1103291940"
    )


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


Spot = tuple[float, float, float, int]


def lola_record(seconds: float, range_m: float, *spots: Spot) -> bytes:
    """A record of LOLARDR.FMT: spots of longitude, latitude (degrees), radius (m) and flag at bytes 41, 81, ..., all
    at one range from a spacecraft that is straight above the first one; 0 for neither.
    """
    content, whole = bytearray(256), int(seconds)
    longitude, latitude, radius, _ = spots[0]
    struct.pack_into("<2I", content, 8, whole, round((seconds - whole) * 2**32))
    craft = (round(longitude * 1e7), round(latitude * 1e7), round((radius + range_m) * 1e3) if range_m else 0)
    struct.pack_into("<2i2I", content, 24, *craft, 1_737_373_000)
    for k, (longitude, latitude, radius, flag) in enumerate(spots):
        place = (round(longitude * 1e7), round(latitude * 1e7), round(radius * 1e3) if radius > 0.0 else -1)
        struct.pack_into("<3iI", content, 40 + 40 * k, *place, round(range_m * 1e3))
        struct.pack_into("<I", content, 76 + 40 * k, flag)
    struct.pack_into("<H", content, 240, 92)
    return bytes(content)


SPOTS: list[Spot] = [(2.5, -25.0, 1735000.0, 0)] * 4 + [(2.5, -25.0, 1735000.0, 0x41)]
TWO = lola_record(305495504.25, 50e3, *SPOTS) + lola_record(305495504.5, 50.5e3, *SPOTS)


@pytest.mark.parametrize("labelled", [False, True])
def test_records_of_lola_have_ranges_spacecraft_and_noise(tmp_path: Path, labelled: bool) -> None:
    path = tmp_path / "LOLARDR_092490702.DAT"
    path.write_bytes(TWO)
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


def test_lengths_of_lola_in_two_units(shared_data: Path, tmp_path: Path) -> None:
    """Of the three that close a triangle one is in metres: refused, and said as ranges that don't fit."""
    text = gzip.decompress((shared_data / "lro_nac_hadley" / "RDR_hadley_LOLA.csv.gz").read_bytes())
    head, *rows = text.decode().splitlines()[:5]
    k = [name.strip() for name in head.split(",")].index("SC_radius")
    parts = [row.split(",") for row in rows]
    for part in parts:
        part[k] = str(float(part[k]) * 1000.0)
    refuses(r"ranges of .* times what they should be", read_shots, written(tmp_path, head, *map(",".join, parts)))


# --- MLA


def test_mla_of_the_orbital_data_explorer(tmp_path: Path) -> None:
    path = written(tmp_path, MLA_HEADER, *[mla_row(channel, 354699676.684 + k) for k, channel in enumerate((0, 4, 5))])
    shots = read_shots(path)
    longitude, latitude, radius = planetocentric(shots.footprints[0])

    assert shots.altimeter is MLA
    assert shots.ground.tolist() == [True, True, False]
    np.testing.assert_allclose([longitude % (2 * np.pi), latitude, radius], [221.5 * DEG, 63.25 * DEG, 2438.9e3])
    np.testing.assert_allclose(shots.ranges, 749481.145)
    passes = [mla_row(0, 354699676.684 + since) for since in (7200.0, 0.0, 7201.0)]  # two, not in order
    names = read_shots(written(tmp_path, MLA_HEADER, *passes)).profile_names()
    assert names == ("2011-03-29T21:40", "2011-03-29T19:40", "2011-03-29T21:40")
    assert MLA.spot(shots.ranges) == pytest.approx(59.96, abs=0.01)
    assert np.isnan(MLA.spot(np.array([np.nan])))


# --- tables by their labels

LABEL = """PDS_VERSION_ID = PDS3
RECORD_TYPE = FIXED_LENGTH
INSTRUMENT_ID = "LALT"
^TABLE = "{data}"
OBJECT = TABLE
  INTERCHANGE_FORMAT = {form}
  ROWS = 2
  ROW_BYTES = {row}
  COLUMNS = 4
{columns}
END_OBJECT = TABLE
END
"""
COLUMN = """OBJECT = COLUMN
  NAME = "{}"
  DATA_TYPE = {}
  START_BYTE = {}
  BYTES = {}
  UNIT = "{}"
END_OBJECT = COLUMN"""


def column(name: str, kind: str, start: int, size: int, unit: str) -> str:
    return COLUMN.format(name, kind, start, size, unit)


def test_text_by_its_label(tmp_path: Path) -> None:
    """Heights of LALT stand above 1737.4 km; names of files in another case than on disk, as archives have them."""
    columns = "\n".join([
        column("UNIVERSAL TIME", "TIME", 1, 23, "N/A"), column("LONGITUDE", "ASCII_REAL", 25, 9, "DEGREE"),
        column("LATITUDE", "ASCII_REAL", 35, 10, "DEGREE"), column("TOPOGRAPHY", "ASCII_REAL", 46, 8, "KM"),
    ])
    rows = [f"2008-01-07 00:00:0{k}.500, 120.0{k}00,  -45.0000, -1.250{k}\r\n" for k in range(2)]
    (tmp_path / "LALT_LGT_TS.TAB").write_text("".join(rows), newline="")
    label = written(
        tmp_path, LABEL.format(data="lalt_lgt_ts.tab", form="ASCII", row=len(rows[0]), columns=columns), name="x.lbl",
    )
    shots = read_shots(label)
    longitude, latitude, radius = planetocentric(shots.footprints[1])

    assert shots.altimeter is LALT
    np.testing.assert_allclose([longitude, latitude, radius], [120.01 * DEG, -45.0 * DEG, 1737.4e3 - 1250.1])
    assert shots.times[1] - shots.times[0] == pytest.approx(1.0)
    assert shots.profile_names() == ("2008-01-07T00:00",) * 2
    text = label.read_text()
    label.write_text(text.replace('"LALT"', '"MLA"'))  # nothing says what its heights would be above
    refuses("without radii, above an unknown surface", read_shots, label)


def test_bytes_by_label_and_structure(tmp_path: Path) -> None:
    rows = [struct.pack("<diii", 254699676.5 + k, 2215000000 - 2**31, 632500000, 1737000000 + k) for k in range(2)]
    (tmp_path / "t.dat").write_bytes(b"".join(rows))
    columns = [
        ("EPHEMERIS_TIME", "PC_REAL", 1, 8, "SECONDS"), ("SURFACE_LONGITUDE", "LSB_INTEGER", 9, 4, "DEGREES"),
        ("SURFACE_LATITUDE", "LSB_INTEGER", 13, 4, "DEGREES"), ("RADIUS", "LSB_INTEGER", 17, 4, "MILLIMETERS"),
    ]  # fmt: skip
    texts = [column(*one) for one in columns]
    scaled = [text.replace("UNIT", "SCALING_FACTOR = 1e-7\n  UNIT") if "DEGREES" in text else text for text in texts]
    written(tmp_path, *scaled, "END", name="TABLE.FMT")
    label = written(
        tmp_path, LABEL.format(data="t.dat", form="BINARY", row=20, columns='^STRUCTURE = "table.fmt"'), name="t.lbl",
    )
    shots = read_shots(label)
    longitude, latitude, radius = planetocentric(shots.footprints[1])
    np.testing.assert_allclose(
        [longitude / DEG, latitude / DEG, radius], [(2215000000 - 2**31) * 1e-7, 63.25, 1737000.001], rtol=1e-12
    )
    assert shots.times.tolist() == [254699676.5, 254699677.5]


ROW = (254699676.5, 221.5, 63.25, 1737.0)


def table(
    folder: Path, row: tuple[float, ...] = ROW, rows: int = 2, changed: tuple[str, str] = ("", "")
) -> Path:
    """A binary table of `rows` such rows (time, longitude, latitude, radius), whose label counts two."""
    (folder / "t.dat").write_bytes(struct.pack("<4d", *row) * rows)
    columns = [
        ("EPHEMERIS_TIME", "PC_REAL", 1, 8, "SECONDS"), ("SURFACE_LONGITUDE", "PC_REAL", 9, 8, "DEGREES"),
        ("SURFACE_LATITUDE", "PC_REAL", 17, 8, "DEGREES"), ("RADIUS", "PC_REAL", 25, 8, "KM"),
    ]  # fmt: skip
    text = LABEL.format(data="t.dat", form="BINARY", row=32, columns="\n".join(column(*one) for one in columns))
    return written(folder, text.replace(*changed), name="t.lbl")


@pytest.mark.parametrize(
    ("fault", "said"),
    [
        ({"rows": 1}, "ROWS: 2, and 1 rows in the file"),
        ({"row": (np.nan, *ROW[1:])}, "row 1, ephemeristime: nan; expected a number that can be"),
        ({"row": (*ROW[:3], 1e306)}, "row 1, radius: inf"),
        ({"row": (ROW[0], 1e3, *ROW[2:])}, "row 1, longitude: 1000 degrees"),
        ({"changed": ("START_BYTE = 25", "START_BYTE = 26")}, "bytes 26 .. 33 of a row; expected 1 .. 32"),
    ],
)
def test_tables_that_are_not_what_their_label_says(tmp_path: Path, fault: dict[str, Any], said: str) -> None:
    assert read_shots(table(tmp_path)).times[0] == ROW[0]
    refuses(said, read_shots, table(tmp_path, **fault))


def test_lola_cut_between_records_is_known_by_the_label_beside_it(tmp_path: Path) -> None:
    path = tmp_path / "LOLARDR_092490702.DAT"
    path.write_bytes(TWO)
    written(tmp_path, "PDS_VERSION_ID = PDS3\nRECORD_BYTES = 256\nFILE_RECORDS = 3\nEND", name="LOLARDR_092490702.LBL")
    refuses("FILE_RECORDS: 3, and 2 records in the file", read_shots, path)


# --- times, and what is refused


@pytest.mark.parametrize("year", [1973, 1999, 2006, 2009, 2017])
def test_a_leap_second_is_a_second(year: int) -> None:
    """The last one of the year before."""
    texts = [f"{year - 1}-12-31T23:59:59", f"{year - 1}-12-31T23:59:60", f"{year}-01-01T00:00:00"]
    np.testing.assert_allclose(np.diff(tdb_of_utc(texts, "here")), 1.0, atol=1e-6)


def test_leap_seconds_and_time_scales_are_those_of_naif(shared_data: Path) -> None:
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
        terrestrial = np.array([spiceypy.unitim(float(one), "ET", "TDT") for one in expected])
    finally:
        spiceypy.kclear()
    found = tdb_of_utc(texts, "here")

    assert len(months) == 28
    np.testing.assert_allclose(found, expected, atol=1e-7, rtol=0.0)
    np.testing.assert_allclose(tdb_of_tt(terrestrial), expected, atol=1e-7, rtol=0.0)
    assert found.tolist() == [tdb_of_utc([text], "here")[0] for text in texts]
    for text, time in zip(texts[:-2], found, strict=False):
        assert abs((utc_of_tdb(time) - datetime.fromisoformat(f"{text}Z")).total_seconds()) < 2e-6
    for wrong in ("1971-12-31T23:59:59", "2009-09-06", "2009-02-29T00:00:00", "2009-400T00:00", "2009-09-06T00:00:61"):
        refuses("here: a time that can't be read", tdb_of_utc, ["2009-09-06T07:50:38.773", wrong], "here")


def test_times_written_are_those_of_each() -> None:
    """Python's datetime is the authority, leap seconds and times before J2000 included."""
    rng = np.random.default_rng(1)
    times = np.concatenate([rng.uniform(-8e8, 1e9, 3000), np.array([-0.0005, 0.0, 64.184, 5e8, 5e8 + 0.9995, 4.8e8])])
    expected = [f"{utc_of_tdb(time):%Y-%m-%dT%H:%M:%S.%f}"[:-3] for time in times.tolist()]
    assert utc_texts(times).tolist() == expected


SELECTION = "longitude_deg,latitude_deg,radius_m,range_m,time_s,altimeter,spacecraft_x_m,spacecraft_y_m,spacecraft_z_m"


@pytest.mark.parametrize(
    ("row", "said"),
    [
        ("0,0,3.2e6,380000,0,MOLA,,,", r"shot 0:7:1: a radius of 3200 km; expected 3274\.\d+ "),
        ("0,0,3390000,380000,1e9,MOLA,,,", "shot 0:7:1: a time of 1e[+]09 s"),
        ("0,0,3390000,3.8e8,0,MOLA,,,", "a range of 380000 km; .*metres stand where the format has kilometres"),
        ("0,0,3390000,380000,0,MOLA,3.79e6,0,0", "shot 0:7:1: a range of 380 km; expected about 400 km, the way"),
        ('0,0,3390000,380000,0,MOLA,",,', "line 7: no row of a CSV file"),
    ],
)
def test_one_shot_that_can_not_be_among_many(tmp_path: Path, row: str, said: str) -> None:
    """Medians don't see it."""
    good = [f'{0.01 * k},0,"3390000",380000,{k},"MOLA",,,' for k in range(1, 6)]
    path = written(tmp_path, SELECTION, *good, row)
    refuses(said, read_shots, path)
    assert read_shots(written(tmp_path, SELECTION, *good, "0,0,3390000,380000,0,MOLA,3.77e6,0,0")).times.size == 6


def test_the_table_of_altimeters() -> None:
    """Spots are what the beam sees from the height of the orbit; MOLA is the one that a case without words has."""
    heights = {"MOLA": 400e3, "LOLA": 50e3, "LALT": 100e3}
    for name, height in heights.items():
        assert ALTIMETERS[name].divergence * height == pytest.approx(ALTIMETERS[name].footprint)
    assert AltimeterShots.__dataclass_fields__["altimeter"].default is MOLA


MARS = Ellipsoid(3396.19e3, 3376.2e3)
MOON = Ellipsoid(1737.4e3, 1737.4e3)
HADLEY_DATES = {
    "2010-05-10", "2010-05-23", "2010-10-07", "2011-01-10", "2011-03-06", "2011-06-23", "2011-07-07", "2011-07-20",
}
LOLA_HEADER = (
    "Coordinated_Universal_Time,Pt_Longitude, Pt_Latitude,   Pt_Radius,   Flg,S,Frm,Mission_ET,Terrestrial_Dyn_Time"
)
LOLA_ROW = (
    "2009-09-06T07:50:38.77335829,   2.6301089,  25.7683364, 1735.473796,   0,1, 15,   6886213,305495504.957358301"
)


# --- clouds of ground points


@pytest.fixture(scope="module")
def hadley(shared_data: Path) -> AltimetryCloud:
    return read_altimetry_cloud(shared_data / "lro_nac_hadley" / "RDR_hadley_LOLA.csv.gz", MOON)


def test_lola_over_hadley(hadley: AltimetryCloud) -> None:
    """52,363 shots of 41 dates; on four of them LRO came by twice, 113 minutes or two orbits apart."""
    assert len(hadley.ids) == 52363
    assert len({name[:10] for name in hadley.profiles}) == 41
    assert len(hadley.profiles) == 45
    assert hadley.footprint == LOLA.footprint == 5.0
    assert hadley.ids[0] == "200909060750:688621315:1"
    longitude, latitude, radius = planetocentric(hadley.points[0])
    np.testing.assert_allclose([longitude / DEG, latitude / DEG, radius], [2.6301089, 25.7683364, 1735473.796], 1e-12)
    assert hadley.times[0] == pytest.approx(305495504.957358301 - 1.4574e-3, abs=1e-6)  # TT, not TDB
    for k in range(len(hadley.profiles)):
        its = hadley.times[hadley.profile == k]
        assert np.all(np.diff(its) >= 0.0)
        assert its[-1] - its[0] < 60.0


def test_shots_inside_an_image(shared_data: Path, hadley: AltimetryCloud) -> None:
    """7,329 shots of 8 dates, by the unadjusted orientation; a pixel at the edges is 6 shots."""
    folder = shared_data / "lro_nac_hadley"
    images = [read_isd(folder / f"observationImage{side}.isd", side) for side in "LR"]
    inside = points_in_images(images, hadley.points)
    chosen = hadley.chosen(inside[0])

    assert abs(len(chosen.ids) - 7329) <= 6
    assert {name[:10] for name in chosen.profiles} == HADLEY_DATES
    assert not np.any(inside[1])  # the box of the query ends at 3.44 degrees east, this image begins at 3.59
    wider = points_in_images(images[:1], hadley.points, margin=50.0)[0]
    assert np.all(wider[inside[0]])
    assert 7329 < np.count_nonzero(wider) < 8000


def test_shots_that_missed_the_ground_stay_out(tmp_path: Path) -> None:
    flagged = LOLA_ROW.replace("   0,1, 15", "  64,2, 15").replace("1735.473796", "-1.000000")
    cloud = read_altimetry_cloud(written(tmp_path, LOLA_HEADER, LOLA_ROW, flagged), MOON)

    assert cloud.ids == ("200909060750:688621315:1",)
    assert cloud.profiles == ("2009-09-06T07:50",)


def test_radii_of_lola_in_metres(tmp_path: Path) -> None:
    row = LOLA_ROW.replace("1735.473796", "1735473.796")
    cloud = read_altimetry_cloud(written(tmp_path, LOLA_HEADER, row))

    np.testing.assert_allclose(np.linalg.norm(cloud.points, axis=1), 1735473.796)


@pytest.mark.parametrize("packed", [False, True])
def test_records_of_lola(tmp_path: Path, packed: bool) -> None:
    """Spots without a radius or with a flag in the lowest byte are no ground; higher bytes are quality alone."""
    ground: list[Spot] = [(2.5 + 1e-4 * k, -25.0, 1735000.125 + k, 0) for k in range(5)]
    odd: list[Spot] = [(2.6, -25.1, -1.0, 0), (2.7, -25.2, 1734000.0, 0x40), (-2.8, 25.3, 1734500.5, 0x10300)]
    orbit = lola_record(305495504.25, 0.0, *ground) + lola_record(305495504.5, 0.0, ground[0], *odd, ground[4])
    path = tmp_path / "LOLARDR_092490702.DAT"
    path.write_bytes(gzip.compress(orbit) if packed else orbit)
    cloud = read_altimetry_cloud(path, MOON)

    assert [one.partition(":")[2] for one in cloud.ids] == ["1:1", "1:2", "1:3", "1:4", "1:5", "2:1", "2:4", "2:5"]
    assert cloud.profiles == ("2009-09-06T07:50",)
    np.testing.assert_array_equal(cloud.times, tdb_of_tt(np.array([305495504.25] * 5 + [305495504.5] * 3)))
    places = planetocentric(cloud.points[[0, 1, 6]])
    expected = [[2.5, -25.0, 1735000.125], [2.5001, -25.0, 1735001.125], [-2.8, 25.3, 1734500.5]]
    np.testing.assert_allclose(places / [DEG, DEG, 1.0], expected, rtol=1e-12)


def test_mola_of_the_orbital_data_explorer(shared_data: Path) -> None:
    cloud = read_altimetry_cloud(shared_data / "mola_pedr_ode" / "curiosity_topography.csv", MARS)

    assert (len(cloud.ids), len(cloud.profiles), cloud.profiles[0]) == (8840, 52, "10372")
    assert cloud.footprint == MOLA.footprint == 168.0


@pytest.mark.parametrize(
    ("columns", "values"),
    [
        ("longitude_deg,latitude_deg,radius_m", "{0:.9f},{1:.9f},{2:.4f}"),
        ("longitude_deg, latitude_deg, radius_km", "{0:.9f}, {1:.9f}, {3:.7f}"),
        ("longitude_deg,latitude_deg,height_m,quality", "{0:.9f},{1:.9f},{4:.4f},good"),
        ("x_m,y_m,z_m", "{5:.5f},{6:.5f},{7:.5f}"),
    ],
)
def test_columns_of_a_plain_file(tmp_path: Path, columns: str, values: str) -> None:
    rng = np.random.default_rng(3)
    places = np.column_stack([
        rng.uniform(-180.0, 180.0, 20) * DEG, rng.uniform(-90.0, 90.0, 20) * DEG, 3.39e6 + rng.uniform(-8e3, 2e4, 20)
    ])
    points = from_planetocentric(places)
    heights = geodetic(points, MARS)[:, 2]
    table = np.column_stack([places[:, :2] / DEG, places[:, 2], places[:, 2] / 1e3, heights, points])
    cloud = read_altimetry_cloud(written(tmp_path, columns, *[values.format(*row) for row in table]), MARS)

    np.testing.assert_allclose(cloud.points, points, rtol=0, atol=1e-3)
    assert cloud.ids == tuple(str(k + 2) for k in range(20))
    assert cloud.profiles == ("shots",)
    assert np.all(np.isnan(cloud.times))
    assert np.isnan(cloud.footprint)


HEAD = "longitude_deg,latitude_deg,radius_m"
SHOT = "12.5,-45.0,3390000.0"


def test_profiles_by_name(tmp_path: Path) -> None:
    """Shots of a profile are put into the order of their times; those of the file's order are kept without times."""
    rows = [f"{SHOT},{name},{t},{one}" for name, t, one in (("b", 3, "p"), ("a", 9, "q"), ("b", 1, "r"), ("a", 2, "s"))]
    cloud = read_altimetry_cloud(written(tmp_path, f"{HEAD},profile,time_s,id", *rows), MARS)
    untimed = read_altimetry_cloud(written(tmp_path, f"{HEAD},orbit,number,id", *rows), MARS)

    assert cloud.profiles == untimed.profiles == ("a", "b")
    assert cloud.ids == ("s", "q", "r", "p")
    assert cloud.times.tolist() == [2.0, 9.0, 1.0, 3.0]
    assert untimed.ids == ("q", "s", "p", "r")


def test_a_pause_of_half_an_hour_ends_a_profile(tmp_path: Path) -> None:
    times = [7000.0, 0.0, 1800.0, 8800.0, 10600.1]
    cloud = read_altimetry_cloud(written(tmp_path, f"{HEAD},time_s", *[f"{SHOT},{t}" for t in times]), MARS)

    assert cloud.profiles == ("1", "2", "3")
    assert cloud.times.tolist() == [0.0, 1800.0, 7000.0, 8800.0, 10600.1]
    assert cloud.profile.tolist() == [0, 0, 1, 1, 2]


def test_times_in_utc(tmp_path: Path) -> None:
    cloud = read_altimetry_cloud(written(tmp_path, f"{HEAD},utc", f"{SHOT},2009-09-06T07:50:38.77335829"), MARS)

    np.testing.assert_allclose(cloud.times, 305495504.957358, rtol=0, atol=2e-3)
    assert cloud.profiles == ("2009-09-06T07:50",)


@pytest.mark.parametrize(
    ("lines", "said"),
    [
        (["lon,lat,h", SHOT], "header: the columns lon, lat, h"),
        ([HEAD, SHOT, "", "12.5,south,3390000.0"], "line 4, latitude_deg: 'south'"),
        ([HEAD, SHOT, "0,90.5,3390000.0"], r"line 3, latitude: 90.5 degrees; expected -90 \.\. 90"),
        ([HEAD, "12.5,-45.0,1737400.0"], "1737.4 km; expected that of the body, 3396.2 km"),
        ([HEAD.replace("_m", ""), "12.5,-45.0,2106.5"], "radius: a median of 2106.5; expected the body's radius"),
        ([f"{HEAD},id", f"{SHOT},a", f"{SHOT},b", f"{SHOT},a"], "'a' twice"),
    ],
)
def test_what_is_refused(tmp_path: Path, lines: list[str], said: str) -> None:
    refuses(said, read_altimetry_cloud, written(tmp_path, *lines), MARS)


def test_a_cloud_is_in_order_of_time() -> None:
    points = np.full((3, 3), 1e6)
    cloud = AltimetryCloud("made", ("a", "b", "c"), points, [0.0, 5.0, 1.0], ("p", "q"), [0, 1, 0])

    assert cloud.chosen(np.array([False, True, False])).profiles == ("q",)
    with pytest.raises(InputError, match="shot b before its time"):
        AltimetryCloud("made", ("a", "b", "c"), points, [6.0, 5.0, 7.0], ("p",), [0, 0, 0])


# --- tables by columns: shots and tie points


ODE = "long_East,lat_North,topography, MOLArange,  planet_rad, c,A,  Ephermis Time,          UTC,          Orbit\n" + (
    "".join(f"137.3766{k}, -4.09420,   -2659.75, 390043.53,  3393004.81,1,0, -2316293{5 - k}.18358,"
            f"1999-04-08T09:50:0{k}.631, 10372\n" for k in range(5))
)  # fmt: skip
TIES = """\
id,image,type,isis_line,isis_sample,sigma_line_px,x_m,y_m,z_m,ignore,point_ignore
a1,A,free,100.25,33.5,0.5,,,,,
b 2,B,,21.5,32,1,,,,true,
c,B,fixed,1.5,2.5,,10,3390000,20,,
d,A,free,7,8,,,,,,true
a1,C,free,7.125,1e2,,,,,0,
"""


@pytest.mark.parametrize("place", [2, 4, -1, -2])
def test_lines_of_blanks_count_for_nothing(tmp_path: Path, place: int) -> None:
    for text, read, wanted in ((ODE, read_shots, "footprints"), (TIES, read_tie_points, "measures")):
        lines = text.split("\n")
        paths = written(tmp_path, text), written(tmp_path, *lines[:place], "", "   ", *lines[place:], name="blank.csv")
        found, expected = (getattr(read(path), wanted) for path in paths)
        np.testing.assert_array_equal(found, expected)


@pytest.mark.parametrize(
    ("row", "said"),
    [
        ("137.4,x,-2659.75,390043.5,3393004.8,1,0,-23162931.1,1999-04-08T09:50:04.6,10372", "lat_North: 'x'"),
        ("137.4,-4.1,-2659.75,390043.5,3393004.8,1,0,nan,1999-04-08T09:50:04.6,10372", "Ephermis Time: 'nan'"),
        ("137.4,-4.1,-2659.75", "3 fields; expected 10"),
    ],
)
def test_a_fault_far_down_is_said_with_its_line(tmp_path: Path, row: str, said: str) -> None:
    lines = ODE.split("\n")
    refuses(rf"shots\.csv, line 4[,:] {said}", read_shots, written(tmp_path, *lines[:3], row, *lines[3:]))

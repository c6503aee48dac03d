"""Altimetry as control from its formats: real files whole, records by their documented bytes, what is refused."""

import gzip
import re
import struct
import time
from pathlib import Path

import numpy as np
import pytest

from mgsgraph.errors import InputError
from mgsgraph.files.altimetry.binary import FRAME
from mgsgraph.files.altimetry.shots import read_altimetry_cloud
from mgsgraph.files.support_data.isd import read_isd
from mgsgraph.geometry.altimetry import LOLA, MOLA, AltimetryCloud
from mgsgraph.geometry.body import Ellipsoid, from_planetocentric, geodetic, planetocentric
from mgsgraph.geometry.trajectory import tdb_of_tt
from mgsgraph.network.footprints import points_in_images
from mgsgraph.units import DEG

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


def written(tmp_path: Path, *lines: str, name: str = "cloud.csv") -> Path:
    path = tmp_path / name
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


def refusal(path: Path, body: Ellipsoid | None = None) -> str:
    with pytest.raises(InputError) as caught:
        read_altimetry_cloud(path, body)
    message = str(caught.value)
    assert message.startswith(str(path))
    assert "\n" not in message
    return message


# --- LOLA as CSV


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


# --- LOLA's records


def record(seconds: float, *spots: tuple[float, float, float, int], selenoid: float = 1737373.0) -> bytes:
    """A record of LOLARDR.FMT: spots of longitude, latitude (degrees), radius (m) and flag at bytes 41, 81, ..."""
    content = bytearray(b"\x55" * 256)
    whole = int(seconds)
    struct.pack_into("<2I", content, 8, whole, round((seconds - whole) * 2**32))
    struct.pack_into("<2I", content, 32, 0, round(selenoid * 1e3))  # no place of the spacecraft
    for k, (longitude, latitude, radius, flag) in enumerate(spots):
        angles = (round(longitude * 1e7), round(latitude * 1e7))
        struct.pack_into("<3iI", content, 40 + 40 * k, *angles, round(radius * 1e3) if radius > 0.0 else -1, 0)
        struct.pack_into("<I", content, 76 + 40 * k, flag)
    return bytes(content)


GROUND = [(2.5 + 1e-4 * k, -25.0, 1735000.125 + k, 0) for k in range(5)]
ORBIT = record(305495504.25, *GROUND) + record(
    305495504.5, GROUND[0], (2.6, -25.1, -1.0, 0), (2.7, -25.2, 1734000.0, 0x40), (-2.8, 25.3, 1734500.5, 0x10300),
    GROUND[4],
)


def product(tmp_path: Path, content: bytes = ORBIT, name: str = "LOLARDR_092490702.DAT") -> Path:
    path = tmp_path / name
    path.write_bytes(content)
    return path


@pytest.mark.parametrize("packed", [False, True])
def test_records_of_lola(tmp_path: Path, packed: bool) -> None:
    """Spots without a radius or with a flag in the lowest byte are no ground; higher bytes are quality alone."""
    cloud = read_altimetry_cloud(product(tmp_path, gzip.compress(ORBIT) if packed else ORBIT), MOON)

    assert [one.partition(":")[2] for one in cloud.ids] == ["1:1", "1:2", "1:3", "1:4", "1:5", "2:1", "2:4", "2:5"]
    assert cloud.profiles == ("2009-09-06T07:50",)
    np.testing.assert_array_equal(cloud.times, tdb_of_tt(np.array([305495504.25] * 5 + [305495504.5] * 3)))
    places = planetocentric(cloud.points[[0, 1, 6]])
    expected = [[2.5, -25.0, 1735000.125], [2.5001, -25.0, 1735001.125], [-2.8, 25.3, 1734500.5]]
    np.testing.assert_allclose(places / [DEG, DEG, 1.0], expected, rtol=1e-12)


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (ORBIT[:-1], "255 bytes more"),
        (record(305495504.0, *[(2.5, 25.0, -1.0, 0)] * 5), "none of which reached the ground"),
        (record(12.0, *GROUND), "12 s past J2000"),
        (record(305495504.0, (2.5, 91.0, 1735e3, 0), *GROUND[1:]), "record 1, spot 1, latitude: 91 degrees"),
        (b"\0" * 256, "unknown format"),
        (b"\0", "1 bytes of an unknown format"),
        (b"", "an empty file"),
    ],
)
def test_records_that_are_refused(tmp_path: Path, content: bytes, said: str) -> None:
    assert said in refusal(product(tmp_path, content))


def test_a_packed_file_cut_short_is_refused(tmp_path: Path) -> None:
    assert "cut short" in refusal(product(tmp_path, gzip.compress(ORBIT)[:-20]))


# --- PEDR


def test_mola_of_the_orbital_data_explorer(shared_data: Path) -> None:
    cloud = read_altimetry_cloud(shared_data / "mola_pedr_ode" / "curiosity_topography.csv", MARS)

    assert len(cloud.ids) == 8840
    assert len(cloud.profiles) == 52
    assert cloud.profiles[0] == "10372"
    assert cloud.footprint == MOLA.footprint == 168.0


def test_frames_of_mola(tmp_path: Path) -> None:
    """Its own reader has tests of its own; here: ground returns alone, one profile for each orbit."""
    frames = np.zeros(2, FRAME)
    frames["seconds"], frames["clock"] = [-23162931, -23155873], 100_000_000
    frames["orbit"], frames["shot_radius"], frames["midpoint_radius"] = [11, 12], 339_300_000, 339_300_000
    frames["shot_class"][:, :15] = 1
    path = tmp_path / "ap00011l.b"
    path.write_bytes(frames.tobytes())
    cloud = read_altimetry_cloud(path, MARS)

    assert cloud.profiles == ("11", "12")
    assert np.bincount(cloud.profile).tolist() == [15, 15]
    assert cloud.ids[0] == "11:1:1"
    path.write_bytes(gzip.compress(frames.tobytes()))
    assert "gunzip" in refusal(path)
    path.write_bytes(frames.tobytes()[:-8])
    assert "768 bytes more" in refusal(path)


# --- plain CSV


@pytest.mark.parametrize(
    ("columns", "values"),
    [
        ("longitude_deg,latitude_deg,radius_m", "{0:.9f},{1:.9f},{2:.4f}"),
        ("longitude_deg, latitude_deg, radius_km", "{0:.9f}, {1:.9f}, {3:.7f}"),
        ("Latitude_deg,Longitude_deg,Radius", "{1:.9f},{0:.9f},{3:.7f}"),
        ("latitude_deg,longitude_deg,radius", "{1:.9f},{0:.9f},{2:.4f}"),
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
    assert cloud.profiles == ("cloud",)
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
        ([], "an empty file"),
        (["", "  "], "an empty file"),
        ([HEAD], "a header alone"),
        (["lon,lat,h", SHOT], "header: the columns lon, lat, h"),
        (["longitude_deg,latitude_deg", "1,2"], "header"),
        ([HEAD, SHOT, "12.5,-45.0"], "line 3: 2 fields; expected 3"),
        ([HEAD, SHOT, "", "12.5,south,3390000.0"], "line 4, latitude_deg: 'south'"),
        ([HEAD, SHOT, "12.5,nan,3390000.0"], "line 3, latitude_deg: 'nan'"),
        ([HEAD, SHOT, "12.5,,3390000.0"], "line 3, latitude_deg: nothing"),
        ([HEAD, "361,-45.0,3390000.0"], "line 2, longitude: 361 degrees; expected -180 .. 360"),
        ([HEAD, "-181,-45.0,3390000.0"], "line 2, longitude: -181 degrees"),
        ([HEAD, SHOT, "0,90.5,3390000.0"], "line 3, latitude: 90.5 degrees; expected -90 .. 90"),
        ([HEAD, SHOT, SHOT, "0,0,-1"], "line 4, radius: -1 m"),
        ([HEAD, "12.5,-45.0,1737400.0"], "1737.4 km; expected that of the body, 3396.2 km"),
        ([HEAD, "12.5,-45.0,3390.0"], "3.4 km; expected that of the body"),
        ([HEAD.replace("_m", ""), "12.5,-45.0,2106.5"], "radius: a median of 2106.5; expected the body's radius"),
        ([f"{HEAD},id", f"{SHOT},a", f"{SHOT},b", f"{SHOT},a"], "'a' twice"),
        ([f"{HEAD},id", f"{SHOT},"], "line 2, id: a text of 0 characters"),
        ([f"{HEAD},radius_m", f"{SHOT},3390000.0"], "twice"),
        ([LOLA_HEADER, LOLA_ROW], "1735.5 km; expected that of the body"),
        ([LOLA_HEADER, LOLA_ROW.replace(" 0,1", "64,1")], "1 shots, none of which reached the ground"),
        ([LOLA_HEADER, LOLA_ROW.replace("1735.473796", "5693.8")], "Pt_Radius: a median of 5693.8"),
    ],
)
def test_what_is_refused(tmp_path: Path, lines: list[str], said: str) -> None:
    message = refusal(written(tmp_path, *lines), MARS)
    assert re.search(re.escape(said), message), message


@pytest.mark.parametrize("column", ["radius", "height_m"])
def test_an_unknown_body_leaves_a_radius_without_unit_and_heights_unknown(tmp_path: Path, column: str) -> None:
    assert "radius_m or radius_km" in refusal(written(tmp_path, HEAD.replace("radius_m", column), SHOT))


def test_no_text_and_no_file(tmp_path: Path) -> None:
    path = tmp_path / "cloud.csv"
    assert "no such file" in refusal(path)
    path.write_bytes(b"longitude_deg,\xff\xfe")
    assert "byte 14" in refusal(path)


def test_ten_thousands_of_shots_take_a_moment(tmp_path: Path) -> None:
    n = 100_000
    rows = np.column_stack([np.linspace(0.0, 1.0, n), np.linspace(-2.0, 2.0, n), np.full(n, 3.39e6), np.arange(n)])
    path = tmp_path / "cloud.csv"
    np.savetxt(path, rows, "%.9f", ",", header=f"{HEAD},time_s", comments="")
    begin = time.process_time()
    cloud = read_altimetry_cloud(path, MARS)

    assert time.process_time() - begin < 10.0
    assert len(cloud.ids) == n


# --- the record


def test_a_record_in_order_of_time() -> None:
    points = np.full((3, 3), 1e6)
    cloud = AltimetryCloud("made", ("a", "b", "c"), points, [0.0, 5.0, 1.0], ("p", "q"), [0, 1, 0])

    assert cloud.chosen(np.array([False, True, False])).profiles == ("q",)
    assert cloud.chosen(np.array([True, False, True])).profile.tolist() == [0, 0]
    with pytest.raises(InputError, match="shot b before its time"):
        AltimetryCloud("made", ("a", "b", "c"), points, [6.0, 5.0, 7.0], ("p",), [0, 0, 0])

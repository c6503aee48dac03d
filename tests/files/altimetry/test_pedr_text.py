"""Shots as text: the archive program's formats and what ODE serves, columns by name, real files whole."""

from pathlib import Path

import numpy as np
import pytest

from mgsgraph.errors import InputError
from mgsgraph.files.altimetry.shots import read_shots
from mgsgraph.files.altimetry.tables import shots_of_table, table_of

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
    with pytest.raises(InputError, match=r"UTC: .*1999-14-08"):
        read_shots(path)


@pytest.mark.parametrize(
    ("lines", "message"),
    [
        ((ODE.replace("planet_rad", "areoid_x"), ODE_SHOT), "no column for the radius"),
        ((ODE.replace("topography", "planet_rad"), ODE_SHOT), "the column 'planet_rad' twice"),
        ((ODE, ODE_SHOT, ODE_SHOT[:60]), "line 3: 8 fields; expected 10"),
        ((ODE, ODE_SHOT.replace("3393004.81", "nan")), "line 2, planet_rad: 'nan'"),
        ((ODE, ODE_SHOT.replace("3393004.81", "3393.00")), "shot 10372:2:1: a radius of 3.393 km"),
        ((ODE,), "a header alone"),
    ],
)
def test_what_is_no_table(tmp_path: Path, lines: tuple[str, ...], message: str) -> None:
    with pytest.raises(InputError, match=message.replace("*", r"\*")) as caught:
        read_shots(ode(tmp_path, *lines))
    assert "\n" not in str(caught.value)


def test_a_table_cut_short(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"line 4: 50 characters; expected 151"):
        read_shots(table(tmp_path, shot(175.4, 379000.0), shot(175.4, 379000.0)[:50]))


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

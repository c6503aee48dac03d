"""Laser altimetry in a case file: its keys, and the shots that it names."""

from pathlib import Path

import numpy as np
import pytest

import mgsgraph
from mgsgraph.case.case_file import decode
from mgsgraph.case.reading import read_altimetry
from mgsgraph.case.schema import AltimetryInput
from mgsgraph.errors import InputError
from mgsgraph.network import PointClass, SharedKind
from mgsgraph.simulation.orbit import MARS

TABLE = """
[[altimetry]]
file = "cloud.csv"
sigma_m = [5.0, 0.5]
shift_sigma_m = [20.0, 30.0, 2.0]
drift_sigma_m = 1.5
footprint_m = 12.0
margin_px = 20.0
"""
SHOTS = "longitude_deg,latitude_deg,height_m,orbit\n175.5,-14.5,-1900.0,3\n175.5,-14.6,-1910.0,3\n"


def case_with(case_file: Path, table: str) -> Path:
    case_file.write_text(case_file.read_text(encoding="utf-8") + table, encoding="utf-8")
    return case_file


def test_shots_that_a_table_names(tmp_path: Path) -> None:
    (tmp_path / "cloud.csv").write_text(SHOTS, encoding="utf-8")
    cloud = read_altimetry(AltimetryInput("cloud.csv", footprint_m=12.0), tmp_path, MARS)

    assert (len(cloud.ids), cloud.profiles, cloud.footprint) == (2, ("3",), 12.0)
    with pytest.raises(InputError, match=r"cloud\.csv.*footprint_m"):
        read_altimetry(AltimetryInput("cloud.csv"), tmp_path, MARS)


def test_the_size_of_spots_goes_by_the_altimeter(shared_data: Path) -> None:
    entry = AltimetryInput("mola_pedr_ode/insight_topography.csv")
    cloud = read_altimetry(entry, shared_data, MARS)

    assert cloud.footprint == 168.0
    assert np.unique(cloud.profile).size == len(cloud.profiles)


@pytest.mark.parametrize(
    ("old", "new", "place"),
    [
        ('file = "cloud.csv"', "", "altimetry"),
        ("[5.0, 0.5]", "5.0", "altimetry[0].sigma_m"),
        ("[20.0, 30.0, 2.0]", "[20.0, 30.0, nan]", "altimetry[0].shift_sigma_m"),
        ("footprint_m = 12.0", "footprint_m = 0.0", "altimetry[0].footprint_m"),
        ("margin_px = 20.0", "margin = 20.0", "'margin'"),
    ],
)
def test_wrong_keys_are_said_in_one_line(case_file: Path, old: str, new: str, place: str) -> None:
    with pytest.raises(InputError) as caught:
        decode(case_with(case_file, TABLE.replace(old, new)))
    message = str(caught.value)
    assert message.startswith(str(case_file))
    assert place in message
    assert "\n" not in message


def test_shots_over_the_images_become_points_of_profiles(case_file: Path) -> None:
    """Those beside them don't; each profile has a shift, a height and a drift of its own."""
    alone = mgsgraph.read_case(case_file).network
    ties = alone.points.places[alone.points.classes == PointClass.TIE]
    ground = alone.images[0].image_to_ground(np.array([900.0, 1200.0, 1500.0]), np.full(3, 300.0))[0]
    assert np.linalg.norm(ground - ties.mean(axis=0), axis=1).max() < 50e3 or np.isnan(ties).all()
    rows = "".join(f"{x!r},{y!r},{z!r},{orbit}\n" for (x, y, z), orbit in zip(ground.tolist(), (7, 7, 8), strict=True))
    far = "3396190.0,0.0,0.0,9\n"
    (case_file.parent / "cloud.csv").write_text("x_m,y_m,z_m,orbit\n" + rows + far, encoding="utf-8")
    network = mgsgraph.read_case(case_with(case_file, TABLE.replace("20.0, 30.0", "20.0, 20.0"))).network
    new = np.arange(len(alone.points), len(network.points))

    assert new.size == 3
    np.testing.assert_allclose(network.points.places[new], ground, atol=1e-6)
    up = ground[0] / np.linalg.norm(ground[0])
    assert up @ network.points.covariances[new[0]] @ up == pytest.approx(0.25)
    assert network.shifts is not None
    assert network.shifts.names[-2:] == ("cloud:7", "cloud:8")
    assert network.shifts.profile[new].tolist() == [len(network.shifts.names) - 2] * 2 + [len(network.shifts.names) - 1]
    heights = [one for one in network.shared if one.kind is SharedKind.PROFILE_HEIGHT]
    assert [one.profile for one in heights] == ["cloud:7", "cloud:8"]
    np.testing.assert_allclose(heights[0].sigmas, [2.0, 1.5])


def test_shots_that_no_image_shows_are_refused(case_file: Path) -> None:
    (case_file.parent / "cloud.csv").write_text("x_m,y_m,z_m\n3396190.0,0.0,0.0\n", encoding="utf-8")
    with pytest.raises(InputError, match=r"cloud\.csv.*1 shots"):
        mgsgraph.read_case(case_with(case_file, TABLE.replace("20.0, 30.0", "20.0, 20.0")))

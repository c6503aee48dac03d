"""ISIS lidar data: units and orders are those of the file's authors, and what is wrong is said with point and id."""

import copy
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from outside import refuses

from mgsgraph.errors import InputError
from mgsgraph.files.altimetry.lidar import read_lidar
from mgsgraph.geometry.altimetry import LaserProfile

SHOT: dict[str, Any] = {
    "id": "Lidar0043",
    "aprioriMatrix": [3.3e-11, 0, 0, 1.4e-10, 0, 100],
    "latitude": 60.83,
    "longitude": 99.10,
    "radius": 1735.26,
    "range": 56.55,
    "sigmaRange": 10,
    "time": 317845268.66,
    "measures": [
        {"line": 1.0, "sample": 4979.6, "serialNumber": "LRO/1/286265995:36824/NACL"},
        {"line": 18988.3, "sample": 1, "serialNumber": "LRO/1/286272781:34203/NACL"},
    ],
    "simultaneousImages": ["LRO/1/286265995:36824/NACL"],
}


def read(folder: Path, *shots: dict[str, Any]) -> LaserProfile:
    path = folder / "lidar.json"
    path.write_text(json.dumps({"points": shots}))
    return read_lidar(path)


def edited(keys: tuple[str | int, ...], value: object) -> dict[str, Any]:
    """SHOT with the value under `keys` replaced, or removed where it is `...`."""
    shot = copy.deepcopy(SHOT)
    inner: Any = shot
    for key in keys[:-1]:
        inner = inner[key]
    if value is ...:
        del inner[keys[-1]]
    else:
        inner[keys[-1]] = value
    return shot


def test_units_and_pixels(tmp_path: Path) -> None:
    got = read(tmp_path, SHOT, edited(("id",), "next"))

    assert got.ids == ("Lidar0043", "next")
    np.testing.assert_array_equal(got.times, [317845268.66] * 2)
    np.testing.assert_allclose(got.ranges, 56550.0, rtol=1e-15)
    np.testing.assert_array_equal(got.range_sigmas, 10.0)
    np.testing.assert_allclose(np.linalg.norm(got.footprints, axis=1), 1735260.0, rtol=1e-15)
    latitude, longitude = np.radians(60.83), np.radians(99.10)
    np.testing.assert_allclose(got.footprints[0, 2], 1735260.0 * np.sin(latitude), rtol=1e-14)
    np.testing.assert_allclose(np.arctan2(got.footprints[0, 1], got.footprints[0, 0]), longitude, rtol=1e-14)
    assert got.measure_shot.tolist() == [0, 0, 1, 1]
    np.testing.assert_allclose(got.measures[:2], [[0.5, 4979.1], [18987.8, 0.5]], rtol=1e-15)
    assert got.simultaneous_shot.tolist() == [0, 1]
    assert got.simultaneous_image == ("LRO/1/286265995:36824/NACL",) * 2
    assert got.measure_image[1] == "LRO/1/286272781:34203/NACL"


def place(latitude: float, longitude: float, radius: float) -> np.ndarray:
    """m of rad, rad, m, in the order of the file's matrix; written out apart from the code under test."""
    planar = radius * np.cos(latitude)
    return np.array([planar * np.cos(longitude), planar * np.sin(longitude), radius * np.sin(latitude)])


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow])
@given(
    latitude=st.floats(-85.0, 85.0),
    longitude=st.floats(-180.0, 360.0),
    factor=st.lists(st.floats(-1.0, 1.0), min_size=9, max_size=9),
)
def test_covariance_is_carried_to_body_fixed_axes(
    tmp_path: Path, latitude: float, longitude: float, factor: list[float]
) -> None:
    """By differences over the file's own three numbers: latitude, longitude, radius."""
    scale = np.diag([3e-6, 5e-6, 7.0])
    root = scale @ (np.array(factor).reshape(3, 3) + 2.0 * np.eye(3) * (1.0 + np.abs(factor).sum()))
    matrix = root @ root.T
    shot = SHOT | {"latitude": latitude, "longitude": longitude}
    shot["aprioriMatrix"] = matrix[np.triu_indices(3)].tolist()

    got = read(tmp_path, shot).covariances[0]

    centre = np.array([np.radians(latitude), np.radians(longitude), 1735260.0])
    steps = np.diag([1e-4, 1e-4, 10.0])
    jacobian = np.stack(
        [(place(*(centre + step)) - place(*(centre - step))) / (2.0 * step.sum()) for step in steps], axis=1
    )
    np.testing.assert_allclose(got, jacobian @ matrix @ jacobian.T, rtol=0, atol=1e-6 * np.trace(got))
    np.testing.assert_array_less(0.0, np.linalg.eigvalsh(got))


def test_real_shots(shared_data: Path) -> None:
    """The file gives every footprint 10 m in all three directions: the covariance is 100 m^2 times 1."""
    path = shared_data / "lro_nac_lola" / "lidarData.json"
    got = read_lidar(path)

    assert len(got.ids) == 52
    assert got.measure_shot.tolist() == [k // 2 for k in range(104)]
    assert set(got.simultaneous_image.used) <= set(got.measure_image.used)
    np.testing.assert_allclose(got.covariances, np.broadcast_to(100.0 * np.eye(3), (52, 3, 3)), rtol=0, atol=1e-3)
    assert np.all((got.ranges > 50e3) & (got.ranges < 60e3))
    assert np.all(np.abs(np.linalg.norm(got.footprints, axis=1) - 1737400.0) < 5e3)


@pytest.mark.parametrize(
    ("keys", "value", "said"),
    [
        (("latitude",), ..., "points[1] (bad): no key 'latitude'"),
        (("latitude",), 90.5, "points[1].latitude (bad): 90.5; expected a number <= 90"),
        (("range",), 0.0, "points[1].range (bad)"),
        (("aprioriMatrix",), [1, 0, 0, 1, 0], "points[1].aprioriMatrix (bad)"),
        (("aprioriMatrix", 1), 1e-9, "point bad: an a-priori covariance that is not positive"),
        (("measures", 1, "line"), ..., "points[1].measures[1] (bad): no key 'line'"),
        (("measures", 0, "serialNumber"), SHOT["measures"][1]["serialNumber"], "two measures in image"),
        (("time",), 3.2e11, "a time of 3.2e+11 s past J2000"),
        (("simultaneousImages",), ["a\nb"], "an image's name with control characters"),
        (("id",), "Lidar0043", "points[1] (Lidar0043): the id 'Lidar0043' twice, first in points[0]"),
    ],
)
def test_a_fault_is_said_with_point_and_id(
    tmp_path: Path, keys: tuple[str | int, ...], value: object, said: str
) -> None:
    shot = edited(keys, value) if keys == ("id",) else edited(keys, value) | {"id": "bad"}
    with pytest.raises(InputError) as caught:
        read(tmp_path, SHOT, shot)
    assert said in str(caught.value)
    assert str(caught.value).startswith(str(tmp_path / "lidar.json"))


def test_a_key_twice_is_refused(tmp_path: Path) -> None:
    """However it is spaced: of the two no one knows which is meant."""
    path = tmp_path / "lidar.json"
    for key, twice in (('"time":', '"time" : 3, "time":'), ('"line": 1.0', '"line": 1.0, "line": 2.0')):
        path.write_text(json.dumps({"points": [SHOT]}).replace(key, twice, 1))
        refuses("twice", read_lidar, path)

"""Small inputs of the field that went through with a wrong place (../shared/field/README.md), with the right values."""

import json
import subprocess
import sys
from contextlib import suppress
from pathlib import Path
from typing import Any

import lies
import numpy as np
import pytest
from outside import refuses

from mgsgraph.errors import InputError
from mgsgraph.files.altimetry.shots import read_shots
from mgsgraph.files.cameras.label import read_line_scan_label
from mgsgraph.files.labels.aberration import Aberration
from mgsgraph.files.networks.asp_text import read_ground_control
from mgsgraph.files.support_data.isd import read_isd
from mgsgraph.geometry.body import Ellipsoid, planetocentric
from mgsgraph.geometry.image import PushbroomImage

MARS = Ellipsoid(3_396_190.0, 3_376_200.0)
RADII = {"BODY499_RADII": [3396.19, 3396.19, 3396.19], "BODY_CODE": 499}


def scanner(field: Path, folder: Path, **keys: Any) -> PushbroomImage:
    """The made-up line scanner of the field's own program."""
    words = [f"{key}={json.dumps(value)}" for key, value in keys.items()]
    subprocess.run([sys.executable, str(field / "line_scanner.py"), str(folder / "a.json"), *words], check=True)
    return read_isd(folder / "a.json", "A", Aberration("NONE"))


@pytest.mark.parametrize("name", ["sphere.gcp", "ellipsoid.gcp"])
def test_ground_control_is_where_its_header_says(shared_field: Path, name: str) -> None:
    found = read_ground_control(shared_field / "gcp_wkt" / name, MARS).places[0]
    np.testing.assert_allclose(found, [525747.937, 2332927.583, 2391435.134], rtol=0, atol=1e-3)


def test_a_datum_that_contradicts_the_header_is_refused(shared_field: Path) -> None:
    path = shared_field / "gcp_wkt" / "sphere.gcp"
    sphere = Ellipsoid(3_396_190.0, 3_396_190.0)
    assert read_ground_control(path, MARS, sphere).places[0, 2] == pytest.approx(2391435.134, abs=1e-3)
    refuses("datum", read_ground_control, path, MARS, MARS)


def test_a_map_is_no_raw_image(shared_field: Path, tmp_path: Path) -> None:
    words = "+proj=eqc +lat_ts=0 +lat_0=0 +lon_0=0 +x_0=0 +y_0=0 +R=3396190 +units=m +no_defs"
    with pytest.raises(InputError, match="projection"):
        scanner(
            shared_field, tmp_path, image_lines=2000, image_samples=2500, projection=words,
            geotransform=[4403020.0, 12.0, 0.0, 12000.0, 0.0, -12.0],
        )  # fmt: skip


@pytest.mark.parametrize("keyword", [{}, {"INS-131351_BORESIGHT_SAMPLE": 2047.5}])
def test_half_a_pixel_is_taken_off_once(shared_field: Path, tmp_path: Path, keyword: dict[str, float]) -> None:
    image = scanner(
        shared_field, tmp_path, sample0=2047.5, starting_detector_sample=0.5, samples=4000,
        naif_keywords=RADII | keyword,
    )  # fmt: skip
    ground, _ = image.image_to_ground(np.array([2000.0]), np.array([2047.0]))
    np.testing.assert_allclose(np.degrees(planetocentric(ground))[0, :2], [74.484513367, 0.0], rtol=0, atol=1e-8)


def test_the_detector_is_that_of_the_keywords(shared_field: Path, tmp_path: Path) -> None:
    keywords = RADII | {"INS-74021_ITRANSS": [0, 0, 142.857]}
    scanner(shared_field, tmp_path, focal2pixel_samples=[0, 0, 142.857], naif_keywords=keywords)
    with pytest.raises(InputError, match=r"143\.5.*142\.857"):
        scanner(shared_field, tmp_path, focal2pixel_samples=[0, 0, 143.5], naif_keywords=keywords)


def test_what_stands_for_nothing_is_no_ground_return(tmp_path: Path) -> None:
    form = lies.shot_table()
    form.read(form.text(), tmp_path)
    shots = read_shots(tmp_path / "t.lbl")
    assert shots.ground.tolist() == [k != 4 for k in range(10)]
    radii = np.linalg.norm(shots.footprints[shots.ground], axis=1)
    np.testing.assert_allclose(radii, 1737400.0 - 1250.0, rtol=0, atol=1e-6)


def test_longitudes_count_westward_where_the_label_says_so(tmp_path: Path) -> None:
    form = lies.shot_table()
    form.read(lies.changed(form.text(), "POSITIVE_LONGITUDE_DIRECTION", "WEST"), tmp_path)
    longitude = np.degrees(planetocentric(read_shots(tmp_path / "t.lbl").footprints))[0, 0]
    assert longitude % 360.0 == pytest.approx(360.0 - 221.5)
    rest = "DATA_TYPE = PC_REAL\n  START_BYTE = 9\n  BYTES = 8\n  UNIT ="
    refuses("UNIT", form.read, form.text().replace(f'{rest} "DEGREE"', f'{rest} "KM"'), tmp_path)


# --- what a reader from outside found to go through


def focal(said: dict[str, Any]) -> None:
    said["focal_length_model"] = {"focal_length": 1.05 * said["focal_length_model"]["focal_length"]}


def spelled(said: dict[str, Any]) -> None:
    focal(said)
    said["naif_keywords"] = {f" {key.lower()}": value for key, value in said["naif_keywords"].items()}


def nested(said: dict[str, Any]) -> None:
    said["naif_keywords"] = {"INS": said["naif_keywords"]}


def two_instruments(said: dict[str, Any]) -> None:
    focal(said)
    said["naif_keywords"]["INS-74605_FOCAL_LENGTH"] = 1.0


def another_body(said: dict[str, Any]) -> None:
    said["naif_keywords"]["BODY_CODE"] = 10


def clock_alone(said: dict[str, Any]) -> None:
    del said["starting_ephemeris_time"]
    said["center_ephemeris_time"] += 0.3


def turned_body(said: dict[str, Any]) -> None:
    half = np.radians(0.25)
    turn = np.array([np.cos(half), 0.0, 0.0, -np.sin(half)])
    table = said["body_rotation"]
    w, x, y, z = np.array(table["quaternions"]).T
    table["quaternions"] = np.stack([
        w * turn[0] - z * turn[3], x * turn[0] + y * turn[3], y * turn[0] - x * turn[3], z * turn[0] + w * turn[3]
    ], axis=1).tolist()  # fmt: skip


def first_row(said: dict[str, Any]) -> None:
    said["line_scan_rate"][0][0] = 1.0


def sun_backwards(said: dict[str, Any]) -> None:
    sun = said["sun_position"]
    sun["velocities"] = (-np.array(sun["velocities"])).tolist()


def one_position(said: dict[str, Any]) -> None:
    said["instrument_position"]["positions"][1][0] += 0.02


def one_attitude(said: dict[str, Any]) -> None:
    quaternions = said["instrument_pointing"]["quaternions"]
    quaternions[20] = quaternions[24]


def faster(said: dict[str, Any]) -> None:
    table = said["instrument_position"]
    table["velocities"] = (1.001 * np.array(table["velocities"])).tolist()


@pytest.mark.parametrize(
    "lie",
    [one_position, one_attitude, faster, spelled, nested, two_instruments, another_body, clock_alone, turned_body,
     first_row, sun_backwards],
)
def test_support_data_that_contradict_themselves(shared_data: Path, tmp_path: Path, lie: Any) -> None:
    path, changed = shared_data / "mro_ctx_isds" / "B10_013615_2178_XI_37N117W.crop.json", tmp_path / "a.json"
    said, true = json.loads(path.read_text()), read_isd(path, "A")
    lie(said)
    changed.write_text(json.dumps(said))
    with suppress(InputError):
        assert set(read_isd(changed, "A").remarks) - set(true.remarks)


@pytest.mark.parametrize("header", [
    "# id lon lat elevation", "# point_id longitude latitude height", "# id x y z", "# id lat lon radius",
    "# id lat lon height_km", "# id lat lon height sigma_lat sigma_lon sigma_h", "# WKT GEOGCS[...]",
    "# datum: D_MARS\n# datum: MOLA",
    '# WKT: GEOGCS["a",DATUM["a",SPHEROID["a",3396190,16.98]],PRIMEM["a",0],UNIT["degree",0.0174532925199433]]',
])  # fmt: skip
def test_headers_of_ground_control_that_mean_something_else(tmp_path: Path, header: str) -> None:
    path, row = tmp_path / "a.gcp", "1 45 77.3 -14190 1 1 1 a 100 200 1 1\n"
    path.write_text(f"# id lat lon height_above_datum sigma_x sigma_y sigma_z image_name\n{row}")
    read_ground_control(path, MARS)
    path.write_text(f"{header}\n{row}")
    refuses(r"line 1|line 2|datum", read_ground_control, path, MARS)


@pytest.mark.parametrize(("key", "value"), [
    ("PRODUCT_ID", '"MEGA90N000ZB.IMG"'), ("OBJECT", "A\nUNIT = FEET\nEND_OBJECT"),
])  # fmt: skip
def test_grids_of_two_kinds_and_objects_that_contradict(tmp_path: Path, key: str, value: str) -> None:
    form = lies.megdr()
    text = form.text().replace('"MEGR90N000ZB.IMG"\nPRODUCT', '"MEGR90N000CB.IMG"\nPRODUCT')
    changed = lies.changed(text, key, value) if key in text else text.replace("END\n", f"{key} = {value}\nEND\n")
    with pytest.raises(InputError):
        form.read(changed, tmp_path)


def test_a_label_of_the_other_side_is_refused(shared_data: Path, tmp_path: Path) -> None:
    path = shared_data / "lro_nac_m103595705" / "M103595705LE_pds3.lbl"
    assert read_line_scan_label(path).camera.instrument == -85600
    (tmp_path / "a.lbl").write_text(path.read_text().replace("= LEFT", "= RIGHT"))
    refuses("M103595705LE", read_line_scan_label, tmp_path / "a.lbl")
    (tmp_path / "a.lbl").write_text(path.read_text().replace("1.028800", "1.080240"))
    refuses("LINE_EXPOSURE_DURATION", read_line_scan_label, tmp_path / "a.lbl")

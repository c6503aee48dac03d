"""Ground of 25 pixels of every real line-scan ISD against usgscsm's published algorithm, which `usgscsm.py` has written
anew from its interpolation and distortion formulae; nothing of it is shared with the reader or the geometry.

Positions are compared as the files have them: usgscsm takes no light time off. It lays tables out anew in as many even
steps as they have uneven ones (constructStateFromIsd; ALE States.cpp, getState, Orientations.cpp, operator*), goes
through eight of these, and near the ends through two: up to 0.13 pixels of CTX, 0.03 of LROC are lost. Laid out densely
from the very tables, by Hermite's cubic and great arcs, nothing is lost; then both agree. What is right is the table,
between whose times ISIS interpolates so, as we do.
"""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import usgscsm

from mgsgraph.files.labels.aberration import Aberration
from mgsgraph.files.labels.labelled_image import read_labelled_image
from mgsgraph.files.support_data.isd import read_isd
from mgsgraph.files.support_data.isd_layout import support_optics
from mgsgraph.geometry.image import PushbroomImage
from mgsgraph.simulation.case_files import support_data

FILES = (
    *(f"lro_nac_lola/lidarObservationImage{k}.isd" for k in (1, 2)),
    *(f"lro_nac_hadley/observationImage{side}.isd" for side in "LR"),
    *(f"mro_ctx_isds/{name}.crop.json" for name in (
        "B10_013615_2178_XI_37N117W", "G02_019154_1800_XN_00N133W", "G02_019154_1800_XN_00N133W.ellipsoid",
        "G17_024823_2204_XI_40N109W", "K12_058001_2177_XI_37N117W", "N06_064753_1800_XN_00S133W",
        "N11_066770_2192_XN_39N109W", "N12_067021_2177_XN_37N117W", "P10_005031_2197_XI_39N109W",
    )),
)  # fmt: skip
DENSE = 4001
HADLEY = {2548: {"line": 0.0, "sample": 2547.5}, 2496: {"line": 0.0, "sample": 2495.5}}


def as_isis_takes_it(isd: dict[str, Any]) -> dict[str, Any]:
    """LROC's own files of ISIS: its tables begin with the first line and end with the last, whatever the label's times
    in line_scan_rate are; the middle of the principal point's pixel is at 2547.5 and 2495.5, counted from 0 at the edge
    of the first one (lro_instrumentAddendum: pixels 2548 and 2496, the first one's middle at 1).
    """
    if isd["detector_center"]["sample"] not in HADLEY:
        return isd
    first, *_, last = isd["instrument_position"]["ephemeris_times"]
    rate = [[0.5, first - isd["center_ephemeris_time"], (last - first) / isd["image_lines"]]]
    return isd | {"line_scan_rate": rate, "detector_center": HADLEY[isd["detector_center"]["sample"]]}


def laid_out(isd: dict[str, Any]) -> dict[str, Any]:
    """The same with many even samples, over the image alone, on the cubics and great arcs of the tables."""
    ((_, start, period),) = isd["line_scan_rate"]
    first = isd["center_ephemeris_time"] + start
    times = np.linspace(first, first + isd["image_lines"] * period, DENSE)
    tables = {"instrument_position": isd["instrument_position"] | hermite(isd["instrument_position"], times)}
    for key in ("instrument_pointing", "body_rotation"):
        table = isd[key]
        quaternions = usgscsm.great_arc(np.array(table["ephemeris_times"]), np.array(table["quaternions"]), times)
        tables[key] = table | {"ephemeris_times": times, "quaternions": quaternions}
    return isd | tables


def hermite(table: dict[str, Any], times: np.ndarray) -> dict[str, Any]:
    given, places, motions = (np.array(table[key]) for key in ("ephemeris_times", "positions", "velocities"))
    k = np.clip(np.searchsorted(given, times, side="right") - 1, 0, given.size - 2)
    span = (given[k + 1] - given[k])[:, None]
    t = (times - given[k])[:, None] / span
    a, b = places[k + 1] - places[k] - span * motions[k], span * (motions[k + 1] - motions[k])
    place = places[k] + t * span * motions[k] + t**2 * (3.0 * a - b) + t**3 * (b - 2.0 * a)
    motion = motions[k] + (2.0 * t * (3.0 * a - b) + 3.0 * t**2 * (b - 2.0 * a)) / span
    return {"ephemeris_times": times, "positions": place, "velocities": motion}


@pytest.mark.parametrize("file", FILES)
def test_ground_is_usgscsms(shared_data: Path, file: str) -> None:
    image = read_isd(shared_data / file, "image", Aberration("NONE"))
    isd = as_isis_takes_it(json.loads((shared_data / file).read_text()))
    lines, samples = np.meshgrid(np.linspace(0.5, image.lines - 0.5, 5), np.linspace(0.5, image.samples - 0.5, 5))
    places = np.column_stack([lines.ravel(), samples.ravel()])
    ground, _ = image.image_to_ground(*places.T)

    for content, most in ((laid_out(isd), 1e-3), (isd, 0.15)):
        seen = usgscsm.ground_to_image(usgscsm.state_of_support_data(content), ground)
        assert np.abs(seen - places).max() < most


CAMERAS: dict[str, tuple[str, dict[str, Any]]] = {
    "MOC-NA": ("mgs_moc_m0402852/m0402852_isis.lbl", {}),
    "HRSC": ("mex_hrsc_h5270/h5270_0000_ir2_pds3.lbl", {"line_times": "mean"}),
    "CTX": ("mro_ctx_b10/B10_013341_1010_XN_79S172W_pds3.lbl", {}),
    "LROC NAC": ("lro_nac_m103595705/M103595705LE_pds3.lbl", {}),
    "Kaguya TC": ("kaguya_tc/TC1S2B0_01_06691S820E0465_pds3.lbl", {}),
}
_ORDER = (".tls", ".tsc", ".tpc", ".bpc", ".tf", ".ti", ".bsp", ".bc")


def by_kernels(shared_data: Path, camera: str, **more: Any) -> PushbroomImage:
    file, its_own = CAMERAS[camera]
    folder = (shared_data / file).parent
    found = [path for path in (*folder.iterdir(), shared_data / "kernels" / "moon_pa_de421_1900-2050.bpc")
             if path.suffix.lower() in _ORDER]  # fmt: skip
    kernels = sorted(found, key=lambda path: (_ORDER.index(path.suffix.lower()), "ddendum" in path.name, path.name))
    return read_labelled_image(shared_data / file, kernels, camera, **its_own, **more)


def test_narrow_angle_as_ale_writes_it_is_where_its_kernels_see_it(shared_data: Path, tmp_path: Path) -> None:
    """With what mgs_drivers write wrongly of this very image, summed 8 x 8 (ALE, tests/pytests/data/isds/mgsmocna)."""
    image = by_kernels(shared_data, "MOC-NA", interval=0.25)
    isd = support_data(image)
    ((line, start, period),) = isd["line_scan_rate"]
    path = tmp_path / "m0402852.json"
    path.write_text(json.dumps(isd | {
        "name_sensor": "MGS_MOC_NA", "line_scan_rate": [[line, start, period / 8.0]], "detector_line_summing": 8,
        "optical_distortion": {"radial": {"coefficients": [0, 0.0131240578522949, 0.0131240578522949]}},
        "detector_center": {"line": 0.0, "sample": 1024.5}, "starting_detector_sample": 1,
    }))  # fmt: skip
    lines, samples = np.array([0.5, 700.0, 1535.5]), np.array([0.5, 100.0, 255.5])
    ground, _ = image.image_to_ground(lines, samples)

    places, _ = read_isd(path, "MOC").ground_to_image(ground)
    np.testing.assert_allclose(places, np.column_stack([lines, samples]), rtol=0, atol=1e-3)


@pytest.mark.slow
@pytest.mark.parametrize("camera", CAMERAS)
def test_ground_of_each_camera_is_usgscsms(shared_data: Path, camera: str) -> None:
    """By label and kernels, written as support data: line times, detector and distortion of each in usgscsm's terms."""
    image = by_kernels(shared_data, camera)
    isd = support_data(image) | {"optical_distortion": support_optics(image.interior.distortion, camera)}
    lines, samples = np.meshgrid(np.linspace(0.5, image.lines - 0.5, 5), np.linspace(0.5, image.samples - 0.5, 5))
    places = np.column_stack([lines.ravel(), samples.ravel()])
    ground, _ = image.image_to_ground(*places.T)

    content = isd if camera == "HRSC" else laid_out(isd)  # HRSC's line periods change
    seen = usgscsm.ground_to_image(usgscsm.state_of_support_data(content), ground)
    assert np.abs(seen - places).max() < 1e-3

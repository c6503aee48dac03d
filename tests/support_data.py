"""Image support data of a small made-up camera, to be edited, written and read."""

import copy
import json
from pathlib import Path
from typing import Any

from mgsgraph.files.labels.aberration import Aberration
from mgsgraph.files.support_data.isd import read_isd
from mgsgraph.geometry.image import PushbroomImage

TIMES = [100.0, 101.0, 102.0]
IDENTITY = [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]
ISD: dict[str, Any] = {
    "name_model": "USGS_ASTRO_LINE_SCANNER_SENSOR_MODEL",
    "image_lines": 1000,
    "image_samples": 512,
    "center_ephemeris_time": 101.0,
    "line_scan_rate": [[0.5, -0.5, 0.001]],
    "radii": {"semimajor": 3396.19, "semiminor": 3376.2, "unit": "km"},
    "detector_sample_summing": 1,
    "focal_length_model": {"focal_length": 3500.0},
    "detector_center": {"line": 0.0, "sample": 256.0},
    "starting_detector_line": 0,
    "starting_detector_sample": 0,
    "focal2pixel_lines": [0.0, 76.9, 0.0],
    "focal2pixel_samples": [0.0, 0.0, 76.9],
    "optical_distortion": {"radial": {"coefficients": [0.0, 1e-6, 0.0]}},
    "naif_keywords": {"INS-94031_LIGHTTIME_CORRECTION": "LT+S", "INS-94031_SWAP_OBSERVER_TARGET": "TRUE"},
    "instrument_position": {
        "reference_frame": 1,
        "ephemeris_times": TIMES,
        "positions": [[3796.0, 0.0, 3.0], [3796.0, 0.0, 0.0], [3796.0, 0.0, -3.0]],
        "velocities": [[0.0, 0.0, -3.0]] * 3,
    },
    "instrument_pointing": {
        "reference_frame": 1,
        "ephemeris_times": TIMES,
        "quaternions": [[0.0, 1.0, 0.0, 0.0]] * 3,
        "constant_rotation": IDENTITY,
    },
    "body_rotation": {
        "reference_frame": 1,
        "ephemeris_times": TIMES,
        "quaternions": [[1.0, 0.0, 0.0, 0.0]] * 3,
        "constant_rotation": IDENTITY,
    },
    "sun_position": {"ephemeris_times": [101.0], "positions": [[2e8, 0.0, 0.0]], "velocities": [[0.0, 24.0, 0.0]]},
}
"""A camera 400 km above the equator, looking at nothing in particular."""

Keys = tuple[str | int, ...]


def edited(keys: Keys, value: object, isd: dict[str, Any] = ISD) -> dict[str, Any]:
    """Support data with the value under `keys` replaced, or removed where it is `...`."""
    isd = copy.deepcopy(isd)
    inner: Any = isd
    for key in keys[:-1]:
        inner = inner[key]
    if value is ...:
        del inner[keys[-1]]
    else:
        inner[keys[-1]] = value
    return isd


def read(folder: Path, isd: object, aberration: Aberration | None = None) -> PushbroomImage:
    path = folder / "image.isd"
    path.write_text(isd if isinstance(isd, str) else json.dumps(isd))
    return read_isd(path, "M00/00001", aberration)

"""Ground of 25 pixels of every real line-scan ISD against usgscsm's published algorithm, which `csm_back` has written
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

from mgsgraph.export import csm_back
from mgsgraph.io.aberration import Aberration
from mgsgraph.io.isd import read_isd

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


def as_isis_times_it(isd: dict[str, Any]) -> dict[str, Any]:
    """Line times of ISIS's LROC: the label's after 1,024 lines of preroll, 0.45 % longer (LroNarrowAngleCamera)."""
    ((line, start, period),) = isd["line_scan_rate"]
    if isd["name_sensor"].startswith("LUNAR"):
        keywords = isd["naif_keywords"]
        (code,) = {key.partition("_")[0] for key in keywords if key.endswith("_ADDITIONAL_PREROLL")}
        if isd["instrument_pointing"]["ephemeris_times"][0] > isd["starting_ephemeris_time"] + 0.5:
            period *= 1.0 + keywords[f"{code}_MULTIPLI_LINE_ERROR"]
            start += keywords[f"{code}_ADDITIONAL_PREROLL"] * period
    return isd | {"line_scan_rate": [[line, start, period]]}


def laid_out(isd: dict[str, Any]) -> dict[str, Any]:
    """The same with many even samples, over the image alone, on the cubics and great arcs of the tables."""
    ((_, start, period),) = isd["line_scan_rate"]
    first = isd["center_ephemeris_time"] + start
    times = np.linspace(first, first + isd["image_lines"] * period, DENSE)
    tables = {"instrument_position": isd["instrument_position"] | hermite(isd["instrument_position"], times)}
    for key in ("instrument_pointing", "body_rotation"):
        table = isd[key]
        quaternions = csm_back._arc(np.array(table["ephemeris_times"]), np.array(table["quaternions"]), times)
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
    isd = as_isis_times_it(json.loads((shared_data / file).read_text()))
    lines, samples = np.meshgrid(np.linspace(0.5, image.lines - 0.5, 5), np.linspace(0.5, image.samples - 0.5, 5))
    places = np.column_stack([lines.ravel(), samples.ravel()])
    ground, _ = image.image_to_ground(*places.T)

    for content, most in ((laid_out(isd), 1e-3), (isd, 0.15)):
        seen = csm_back.ground_to_image(csm_back.state_of_support_data(content), ground)
        assert np.abs(seen - places).max() < most

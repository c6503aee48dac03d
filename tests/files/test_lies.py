"""No lie about a geometric key is silent where the input holds a second statement of the same thing."""

from collections import Counter
from pathlib import Path

import lies
import pytest

ALONE = {
    "support data": {"starting_detector_line", "constant_rotation"},
    "label of laser shots": {"POSITIVE_LONGITUDE_DIRECTION"},
    "table of PEDR": {"long_East", "lat_North", "MOLArange"},
    "model state": {"m_opticalDistCoeffs", "m_detectorLineOrigin", "m_startingDetectorLine", "m_focalLength"},
}
"""By the beginning of a format's name, the last part of keys of which the input has no second statement."""


def held(name: str, least: int, folder: Path) -> None:
    """Hold a format to the property, with at least so many lies that are refused or named."""
    found = [form for form in lies.formats() if form.name == name]
    if not found:
        pytest.skip("../shared is not here")
    alone = next((keys for begin, keys in ALONE.items() if name.startswith(begin)), set[str]())
    told = list(lies.outcomes(found[0], folder))
    silent = [(key, lie) for key, lie, outcome in told if outcome == "silent" and key.split("/")[-1] not in alone]
    assert silent == []
    assert Counter(outcome in ("refused", "named") for *_, outcome in told)[True] >= least


@pytest.mark.parametrize(("name", "least"), [
    ("MEGDR label", 110), ("label of laser shots", 45), ("ground control", 12), ("terrain model", 8),
    ("model state", 120), ("table of PEDR", 12), ("tables of a cube", 55),
    ("support data (mro_ctx_isds)", 200), ("support data (lro_nac_lola)", 200),
])  # fmt: skip
def test_no_lie_about_a_file_is_silent(name: str, least: int, tmp_path: Path) -> None:
    held(name, least, tmp_path)


@pytest.mark.slow
@pytest.mark.parametrize(("name", "least"), [
    ("lidar data in a case", 30), ("PDS3 label (kaguya_tc)", 50), ("PDS3 label (lro_nac_m103595705)", 25),
])  # fmt: skip
def test_no_lie_about_a_label_is_silent(name: str, least: int, tmp_path: Path) -> None:
    held(name, least, tmp_path)

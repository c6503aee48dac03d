"""Three ways to the ground by scripts/camera_roads.py: label and kernels, support data made by the script of SPICE
alone, and the script's own equations, to 0.02 px for 25 pixels of each image.
"""

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

SCRIPTS = Path(__file__).resolve().parents[2] / "scripts"
if not SCRIPTS.is_dir():
    pytest.skip("the scripts are not beside the tests", allow_module_level=True)
sys.path.append(str(SCRIPTS))

import camera_roads  # noqa: E402
from camera_equations import Scene  # noqa: E402

ALLOWED = 0.02
"""px."""
SUPPORT_ALONE, LABEL_ALONE = {"crism"}, {"moc_wide", "cube1", "cube2", "cube3"}


@pytest.mark.parametrize(
    "name", [pytest.param(one, marks=pytest.mark.slow if one == "hrsc" else ()) for one in camera_roads.CAMERAS]
)
def test_all_roads_lead_to_one_place(shared_data: Path, name: str) -> None:
    found = camera_roads.rows(name, shared_data)
    assert found
    for row in found:
        by_label, by_support = row.label < ALLOWED, row.support < ALLOWED
        assert by_label or (name in SUPPORT_ALONE and np.isnan(row.label)), row
        assert by_support or (name in LABEL_ALONE and np.isnan(row.support)), row
        assert row.between < ALLOWED or name in SUPPORT_ALONE | LABEL_ALONE, row


def test_a_difference_would_be_seen(shared_data: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A tenth of a pixel in the equations' principal point is one in both roads' columns."""
    make, *others = camera_roads.CAMERAS["ctx"]

    def off(data: Path, folder: Path) -> Scene:
        scene = make(data, folder)
        support = scene.support_data
        moved = replace(scene.optics, origin=(scene.optics.origin[0], scene.optics.origin[1] + 0.1))
        found = replace(scene, optics=moved, variants=())
        object.__setattr__(found, "support_data", support)
        return found

    monkeypatch.setitem(camera_roads.CAMERAS, "ctx", (off, *others))
    (row,) = camera_roads.rows("ctx", shared_data)
    assert row.label == pytest.approx(0.1, abs=1e-3)
    assert row.support == pytest.approx(0.1, abs=1e-3)
    assert row.between < 1e-4

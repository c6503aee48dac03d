"""`check` of cases whose tie points are still to be matched."""

from pathlib import Path

import pytest
from sites import plain_site

from mgsgraph.errors import InputError, Unmeasured
from mgsgraph.results.inventory import images_inventory
from mgsgraph.simulation.files import write_site


@pytest.fixture(scope="module")
def case(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_site(plain_site(), tmp_path_factory.mktemp("site") / "gusev")


def changed(case: Path, name: str, old: str, new: str) -> Path:
    text = case.read_text()
    assert old in text
    path = case.with_name(f"{name}.toml")
    path.write_text(text.replace(old, new))
    return path


def test_a_network_that_match_will_write(case: Path) -> None:
    """The folder of MATCHES isn't there yet; where it is, a missing file is a wrong path."""
    said = images_inventory(changed(case, "later", "network.pvl", "matches/network.pvl"))
    assert said is not None
    assert "matches/network.pvl" in said
    assert "Ready for match: 2 images with pixels, 1 overlap" in said
    assert f"mgsgraph match {case.with_name('later.toml')} --out {case.parent / 'matches'}" in said
    assert images_inventory(changed(case, "typo", "network.pvl", "netwrk.pvl")) is None
    assert images_inventory(case) is None


def test_a_case_of_which_reading_finds_no_measure(case: Path) -> None:
    found = Unmeasured(str(case), "no point is measured in it")
    bare = changed(case, "bare", '[ties]\nnetwork = "network.pvl"\nsigma_px = 1.0\n', "")
    said = images_inventory(bare, found)
    assert said is not None
    assert "Ready for match" in said
    with pytest.raises(InputError, match="no point is measured"):
        images_inventory(case, found)

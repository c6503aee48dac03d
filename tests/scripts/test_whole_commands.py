"""Scripts that run whole commands: kills of them, what counts for the state before or after; from `fetch` to
the terrain model, a small part of it, and its judgement.
"""

import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from flaky_archive import serving, write_archive
from sites import plain_site

SCRIPTS = Path(__file__).resolve().parents[2] / "scripts"
if not SCRIPTS.is_dir():
    pytest.skip("the scripts are not beside the tests", allow_module_level=True)
sys.path.append(str(SCRIPTS))

import kills  # noqa: E402
import power_cuts  # noqa: E402
import whole_road  # noqa: E402


def known(before: dict[str, str], after: dict[str, str], *changing: str) -> kills.Known:
    return kills.Known(before, after, frozenset(changing), frozenset((*before, *after)), 1.0, 1)


@pytest.mark.parametrize(
    ("now", "several", "state"),
    [
        ({"in": "i", "a": "old"}, False, "before"),
        ({"in": "i", "a": "new", "b.json": "b"}, False, "after"),
        ({"in": "i", "a": "new", "b.json": "b", ".a.0a1b2c3d.unfinished": "x"}, False, "after"),
        ({"in": "i", "a": "new"}, False, "BETWEEN"),
        ({"in": "i", "a": "new"}, True, "each"),
        ({"in": "i"}, True, "BETWEEN"),  # neither the old nor the new one
        ({"in": "changed", "a": "old"}, True, "BETWEEN"),
        ({"in": "i", "a": "torn"}, True, "BETWEEN"),
    ],
)
def test_states(tmp_path: Path, now: dict[str, str], several: bool, state: str) -> None:
    (tmp_path / "b.json").write_text("{}")
    states = known({"in": "i", "a": "old"}, {"in": "i", "a": "new", "b.json": "c"}, "b.json")
    assert kills.judged(tmp_path, now, states, several) == state


@pytest.mark.slow
def test_a_few_kills() -> None:
    """In a process of its own: it forks, which a process with other tests' threads should not."""
    command = [sys.executable, str(SCRIPTS / "kills.py"), "--kills", "12", "--only", "convert", "project init"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=280, check=False)
    assert done.returncode == 0, done.stderr
    *_, kills_made, _, before, after, each, between, left, behind, unclean, _ = done.stdout.splitlines()[-1].split("|")
    assert int(kills_made) == 12
    assert int(before) + int(after) + int(each) == 12
    assert (int(between), int(behind), int(unclean)) == (0, 0, 0)
    assert int(left) <= 12


@pytest.mark.slow
@pytest.mark.skipif(shutil.which("strace") is None, reason="strace is not installed")
def test_a_few_power_cuts() -> None:
    """What reaches the disk when, as the system's calls say."""
    command = [sys.executable, str(SCRIPTS / "power_cuts.py"), "--cuts", "20", "--only", "convert", "export --to csm"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=280, check=False)
    assert done.returncode == 0, done.stderr
    for row in done.stdout.splitlines()[2:]:
        _, _, events, cuts_made, whole, *_ = (cell.strip() for cell in row.split("|"))
        assert int(events) > 3
        assert cuts_made == whole == "20"


@pytest.mark.parametrize(
    ("calls", "lost"),
    [
        ("write sync rename names", False), ("write rename", True), ("write sync write rename", True),
        ("write sync rename", False), ("write sync rename remove", True), ("write sync rename names remove", False),
    ],
)  # fmt: skip
def test_what_a_power_cut_leaves(calls: str, lost: bool) -> None:
    new, events = "/w/.a.0a1b2c3d.unfinished", {
        "write": power_cuts.Event("write", "/w/.a.0a1b2c3d.unfinished/x"), "names": power_cuts.Event("sync", "/w"),
        "sync": power_cuts.Event("sync", "/w/.a.0a1b2c3d.unfinished/x"),
    }  # fmt: skip
    events |= {"rename": power_cuts.Event("rename", new, "/w/a"), "remove": power_cuts.Event("remove", f"{new}/old")}
    disk = power_cuts.Disk()
    for call in calls.split():
        disk.take(events[call])
    assert bool(disk.lost) == lost


@pytest.mark.slow
def test_fetch_and_init_from_a_served_archive(tmp_path: Path) -> None:
    site = plain_site()
    archive = write_archive(site, tmp_path / "archive", (4,))
    fetch, init = whole_road.commands(site)[:2]
    assert fetch == "mgsgraph fetch E02/00665 E02/01453 --out DATA"
    with serving(archive) as address:
        done = whole_road.step(fetch, ["--mirror", address, "--terrain", "4"], tmp_path)
    assert "The case is DATA/case.toml" in done.output
    assert done.megabytes > 10.0
    assert "Its images wait for tie points" in whole_road.step(init, [], tmp_path).output
    with pytest.raises(SystemExit, match="exit status 2"):
        whole_road.step("mgsgraph project solve PROJECT", [], tmp_path)


def test_a_model_that_lies_off_is_found_where_it_is() -> None:
    def truth(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        return 40.0 * np.sin(x / 300.0) + 25.0 * np.cos(y / 200.0)

    rng = np.random.default_rng(0)
    x, y = rng.uniform(-2e3, 2e3, (2, 5000))
    heights = truth(x - 20.0, y + 30.0) + 7.0 + 3.0 * y / 2e3 + 0.5 * rng.standard_normal(x.size)
    moved, left = whole_road.laid_on(truth, x, y, heights)
    np.testing.assert_allclose(moved, [20.0, -30.0, 7.0], atol=0.5)
    assert left == pytest.approx(0.5, rel=0.05)

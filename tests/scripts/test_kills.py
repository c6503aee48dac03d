"""The script of kills: what it takes for the state before or after, and a few kills of commands on a small case."""

import subprocess
import sys
from pathlib import Path

import pytest

SCRIPTS = Path(__file__).resolve().parents[2] / "scripts"
if not SCRIPTS.is_dir():
    pytest.skip("the scripts are not beside the tests", allow_module_level=True)
sys.path.append(str(SCRIPTS))

import kills  # noqa: E402


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


@pytest.mark.parametrize("total", [1, 7, 500])
def test_all_kills_are_dealt_out(total: int) -> None:
    shares = [one.share for one in kills.VERBS]
    dealt = [kills.kills_of(total, shares, number) for number in range(len(shares))]
    assert sum(dealt) == total
    assert min(dealt) >= (total >= 500)


@pytest.mark.slow
def test_a_few_kills() -> None:
    """In a process of its own: it forks, which a process with other tests' threads should not."""
    command = [sys.executable, str(SCRIPTS / "kills.py"), "--kills", "12", "--only", "convert", "init"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=280, check=False)
    assert done.returncode == 0, done.stderr
    *_, kills_made, _, before, after, each, between, left, behind, unclean, _ = done.stdout.splitlines()[-1].split("|")
    assert int(kills_made) == 12
    assert int(before) + int(after) + int(each) == 12
    assert (int(between), int(behind), int(unclean)) == (0, 0, 0)
    assert int(left) <= 12

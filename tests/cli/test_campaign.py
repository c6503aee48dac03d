"""`mgsgraph campaign` as a person uses it: exit status, table, one line on bad input, interrupts that lose nothing."""

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from functools import partial
from pathlib import Path

import pytest
from commands import COMMAND, call, run

from mgsgraph.adjustment.cluster.connection import open_cluster
from mgsgraph.cli import group
from mgsgraph.errors import InputError


def folders(record: Path) -> list[str]:
    """Cases that are recorded, in the order in which they ended."""
    return [json.loads(line)["folder"] for line in record.read_text(encoding="utf-8").splitlines()[1:]]


@pytest.fixture
def sites(case_file: Path, tmp_path: Path) -> Path:
    """Two sites."""
    for name in ("north", "south"):
        shutil.copytree(case_file.parent, tmp_path / "sites" / name)
    return tmp_path / "sites"


def test_all_done_is_exit_status_zero(sites: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    done = run("campaign", sites, "--out", out, "--no-figures", "-v")
    assert done.returncode == 0, done.stderr
    assert "2 cases: 2 done" in done.stdout
    assert "north: done, " in done.stdout
    assert sorted(path.name for path in out.iterdir()) == ["campaign.jsonl", "north", "south"]
    again = run("campaign", sites, "--out", out, "--no-figures")
    assert again.returncode == 0
    assert "2 of them earlier" in again.stdout
    assert "north" not in again.stdout


def test_a_failed_case_is_exit_status_one_and_in_the_table(sites: Path, tmp_path: Path) -> None:
    (sites / "south" / "case.toml").write_text("format = 7\n", encoding="utf-8")
    done = run("campaign", sites, "--out", tmp_path / "out", "--no-figures")
    assert done.returncode == 1
    assert "2 cases: 1 done, 1 failed" in done.stdout
    assert "format 7" in done.stdout
    assert "Traceback" not in done.stderr
    well = run("campaign", sites / "north", "--out", tmp_path / "out", "--no-figures")
    assert well.returncode == 0


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("none.toml", "--out", "out"), "none.toml: no such file or folder"),
        (("SITES", "--out", "SITES"), "has no campaign.jsonl"),
        (("SITES", "--out", "out", "--cluster", "dusk"), "expected local, local:N"),
        (("SITES", "--out", "out", "--cluster", "local:0"), "0 workers; expected 1 to"),
    ],
)
def test_bad_input_is_one_line(arguments: tuple[str, ...], said: str, sites: Path, tmp_path: Path) -> None:
    places = {"SITES": sites, "out": tmp_path / "out", "none.toml": tmp_path / "none.toml"}
    done = run("campaign", *(places.get(word, word) for word in arguments))
    assert done.returncode == 2
    assert len(done.stderr.splitlines()) == 1, done.stderr
    assert said in done.stderr
    assert not (tmp_path / "out").exists()


def test_a_scheduler_that_does_not_answer(sites: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("distributed", reason="dask.distributed is not installed (the extra `cluster`)")
    monkeypatch.setattr("mgsgraph.project.campaign.open_cluster", partial(open_cluster, timeout=0.5))
    out = tmp_path / "out"
    with pytest.raises(InputError, match=r"no scheduler answers there within 0\.5 s"):
        group(["campaign", str(sites), "--out", str(out), "--cluster", "tcp://127.0.0.1:9"], standalone_mode=False)
    assert not out.exists()


@pytest.mark.slow
@pytest.mark.parametrize("place", [(), ("--cluster", "local:2")])
def test_an_interrupt_leaves_the_record_true(place: tuple[str, ...], sites: Path, tmp_path: Path) -> None:
    if place:
        pytest.importorskip("distributed", reason="dask.distributed is not installed (the extra `cluster`)")
    for k in range(14):
        shutil.copytree(sites / "north", sites / f"more{k}")
    out = tmp_path / "out"
    command = [*COMMAND, "campaign", str(sites), "--out", str(out), "--no-figures", *place]
    process = subprocess.Popen(  # a session of its own: Ctrl-C reaches all of a terminal's processes
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True
    )
    deadline = time.monotonic() + 200.0
    while time.monotonic() < deadline and not ((out / "campaign.jsonl").exists() and folders(out / "campaign.jsonl")):
        time.sleep(0.05)
    os.killpg(process.pid, signal.SIGINT)
    _, errors = process.communicate(timeout=60)
    assert process.returncode == 130
    assert errors.splitlines()[-1].startswith("mgsgraph: interrupted; ")
    assert "Traceback" not in errors
    over = folders(out / "campaign.jsonl")
    assert 0 < len(over) < 16
    assert all((out / name / "solution.json").exists() for name in over)
    assert not [path for path in out.iterdir() if path.name.startswith(".")]
    done = run("campaign", sites, "--out", out, "--no-figures")
    assert done.returncode == 0, done.stderr
    assert f"({len(over)} of them earlier" in done.stdout
    assert sorted(folders(out / "campaign.jsonl")) == sorted(path.name for path in sites.iterdir())


def test_without_dask_the_verb_works_here(sites: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The extra is not needed without --cluster; `test_package` says that nothing imports it beforehand."""
    for name in ("dask", "distributed"):
        monkeypatch.setitem(sys.modules, name, None)
    assert call("campaign", sites / "north", "--out", tmp_path / "out", "--no-figures") == 0

"""`mgsgraph fetch` as a person uses it: what it says, exit statuses, one line for errors, interrupted and taken up."""

import os
import re
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import flaky_archive
import pytest
from commands import call, run
from flaky_archive import Flaky, stall


@pytest.fixture(scope="module")
def archive() -> Iterator[Flaky]:
    with flaky_archive.served() as server:
        server.files = flaky_archive.archive_files()
        yield server


def command(*arguments: str | Path) -> list[str]:
    return [sys.executable, "-m", "mgsgraph", *map(str, arguments)]


def test_fetch(archive: Flaky, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "a folder"
    assert call("fetch", "M04/02852", "m0402856", "--mirror", archive.address, "--out", out) == 0
    said = capsys.readouterr().out.splitlines()
    assert said[0] == "- M04/02852: 1999-08-24T14:12:13.64, orbit 2063, mgs_map2.bsp, mgs_sc_map2.bc, ap12058l.b"
    assert re.fullmatch(r"- \d+ files fetched, 0\.\d MB; 0 were here already", said[2])
    assert said[-6:] == [
        f"The case is {out / 'case.toml'}",
        "Next:",
        f"  mgsgraph init '{out}/project' --case '{out}/case.toml'",
        f"  mgsgraph match '{out}/project'",
        f"  mgsgraph solve '{out}/project'",
        f"  mgsgraph dem '{out}/project' --out '{out}/dem'",
    ]


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["M04/02853"], "of the wide angle (MOC-WA)"),
        (["M04/02999"], "in no volume that was looked through (mgsc_1029, mgsc_1030, mgsc_1280)"),
        (["M24/00001"], "expected phases M00 .. M23"),
        (["M04/02852", "--volume", "1030"], "volume '1030': not the name of a volume; expected one such as mgsc_1068"),
        (["nonsense"], "not the id of an image of MOC, CTX, LROC NAC or HRSC; expected one such as E02/00665"),
        ([], "at least one id"),
        (["M04/02852", "--mirror", "nowhere.toml"], "nowhere.toml: no such file"),
        (["M04/02852", "--verify"], "No such option '--verify'; the same fetch again holds the folder"),
        (["M04/02852", "--mirror", "ftp://x.org"], "an address such as https://"),
    ],
)
def test_one_line_for_errors(archive: Flaky, tmp_path: Path, arguments: list[str], said: str) -> None:
    where = [] if any(one.startswith("--") for one in arguments) else ["--mirror", archive.address]
    done = run("fetch", *arguments, *where, "--out", tmp_path / "out", cwd=tmp_path)
    assert done.returncode == 2, done.stderr
    assert said in done.stderr
    assert done.stderr.count("\n") == 1
    assert not done.stdout


def test_an_interrupted_fetch_goes_on(archive: Flaky, tmp_path: Path) -> None:
    name, over = "megdr/meg016/megr90n000eb.img", threading.Event()
    archive.faults[name].append(stall(3000, over))
    arguments = command("fetch", "M04/02852", "--mirror", archive.address, "--out", tmp_path / "out")
    running = subprocess.Popen(arguments, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    part = tmp_path / "out" / f"megdr/{Path(name).name}.part"
    deadline = time.monotonic() + 30.0
    while not (part.exists() and part.stat().st_size == 3000) and time.monotonic() < deadline:
        time.sleep(0.02)
    running.send_signal(signal.SIGINT)
    over.set()
    _, error = running.communicate(timeout=30)
    assert running.returncode == 130
    assert error == "mgsgraph: interrupted; what has come is kept, the same command goes on\n"
    archive.asked.clear()
    done = subprocess.run(arguments, capture_output=True, text=True, check=True, timeout=60, env=os.environ)
    assert "The case is" in done.stdout
    assert archive.requests(name) == [None]
    assert not list((tmp_path / "out").rglob("*.part*"))


def test_an_interruption_does_not_wait_for_a_silent_server(archive: Flaky, tmp_path: Path) -> None:
    name, over = "megdr/meg016/megt90n000eb.img", threading.Event()
    archive.faults[name].append(stall(3000, over))
    arguments = command("fetch", "M04/02852", "--mirror", archive.address, "--out", tmp_path / "out")
    running = subprocess.Popen(arguments, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    part, deadline = tmp_path / "out" / f"megdr/{Path(name).name}.part", time.monotonic() + 30.0
    while not (part.exists() and part.stat().st_size == 3000) and time.monotonic() < deadline:
        time.sleep(0.02)
    running.send_signal(signal.SIGINT)
    _, error = running.communicate(timeout=60.0)  # the server is silent for 120 s
    over.set()
    assert running.returncode == 130
    assert error == "mgsgraph: interrupted; what has come is kept, the same command goes on\n"

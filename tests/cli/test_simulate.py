"""`mgsgraph simulate`, `demo` and `campaign` as a person uses them: exit status, files, one line, interrupts."""

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
from commands import COMMAND, call, refusal, refused, run, run_afresh
from outside import refuses

from mgsgraph.adjustment.cluster.connection import open_cluster
from mgsgraph.cli import group
from mgsgraph.simulation.demo.demonstration import STAGES


# above two seconds: what is written is adjusted step by step, as a person would
def test_a_strip_with_its_steps_adjusts(tmp_path: Path) -> None:
    out = tmp_path / "strip"
    done = run("simulate", "strip", "--images", 4, "--ties", 20, "--steps", "--out", out)
    assert done.returncode == 0, done.stderr
    assert str(out / "case.toml") in done.stdout
    assert sorted(path.name for path in out.glob("step_*")) == ["step_000", "step_001", "step_002", "step_003"]
    assert len(json.loads((out / "truth.json").read_text())["ties"]) == 60
    assert len(list(out.glob("image_*.isd"))) == 4
    done = run("adjust", out / "case.toml", "--out", tmp_path / "results", "--no-figures")
    assert done.returncode == 0, done.stderr
    assert "4 images" in done.stdout or "STRIP/003X" in done.stdout


@pytest.mark.parametrize(
    ("args", "says"),
    [
        (("olympus",), "'olympus'; expected eos, gusev, isidis, pair, strip, three-sites or archive"),
        (("pair", "--attitude-time-bias", 1), "attitude time bias"),
        (("gusev", "--images", 4), "images: given for gusev; expected the site strip"),
        (("pair", "--ties", 4), "ties: given for pair"),
        (("archive", "--steps"), "steps: given for archive"),
        (("strip", "--kind", "moc"), "kind: given for strip; expected the site archive"),
        (("archive", "--kind", "themis"), "kind: 'themis'; expected kaguya, ctx, moc, dense, block or region"),
        (("strip", "--images", 1), "images: 1; expected a whole number, at least 2"),
        (("strip", "--images", 501), "images: 501; expected 2 .. 500"),
        (("strip", "--ties", 0), "ties: 0"),
    ],
)
def test_options_are_refused_where_they_mean_nothing(args: tuple[object, ...], says: str, tmp_path: Path) -> None:
    assert says in refusal("simulate", *args, "--out", tmp_path / "x")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("name", ["olympus", "strip"])
def test_sites_that_cannot_be_demonstrated(name: str, tmp_path: Path) -> None:
    assert f"'{name}'; expected eos, gusev, isidis or pair" in refusal("demo", name, "--out", tmp_path / "x")


def test_an_archive_is_written_and_adjusts(tmp_path: Path) -> None:
    out = tmp_path / "archive"
    done = run("simulate", "archive", "--kind", "moc", "--images", 6, "--ties", 100, "--out", out)
    assert done.returncode == 0, done.stderr
    assert sorted(path.name for path in out.iterdir()) == [
        "case.toml", "isd", "network.net", "true_corrections.npz", "true_points.parquet", "truth.json",
    ]
    done = run("adjust", out / "case.toml", "--out", tmp_path / "results", "--no-figures")
    assert done.returncode == 0, done.stderr
    assert "converged" in done.stdout


# --- `mgsgraph demo` and `mgsgraph simulate` as a person uses them, in processes of their own


@pytest.fixture(scope="module")
def demo(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, subprocess.CompletedProcess[str]]:
    """A site with its figures, in an interpreter of its own, and what it said."""
    out = tmp_path_factory.mktemp("site") / "demo"
    done = run_afresh("demo", "isidis", "--out", out)
    assert done.returncode == 0, done.stderr
    return out, done


@pytest.mark.slow
def test_a_site_with_figures(demo: tuple[Path, subprocess.CompletedProcess[str]]) -> None:
    out, done = demo
    said = [line for line in done.stderr.splitlines() if line]
    assert not said or said == [line for line in said if "compiling" in line]
    names = {path.name for path in out.iterdir()}
    assert {"solution.json", "registration.json", "disagreement.csv", "coregistration.json", "costs.png"} <= names
    record = json.loads((out / "summary.json").read_text(encoding="utf-8"))
    assert tuple(record["seconds"]) == STAGES
    assert record["converged"]
    sizes = {
        state: max(one["rms_m"] for one in record["disagreement"] if one["state"] == state)
        for state in ("kernels", "ties and ranges", "relief")
    }
    assert sizes["relief"] < 0.2 * min(sizes["kernels"], sizes["ties and ranges"])
    assert sizes["relief"] < 30.0
    assert [path.name for path in out.parent.iterdir()] == ["demo"]


@pytest.mark.slow
def test_results_can_be_registered_and_replaced(
    demo: tuple[Path, subprocess.CompletedProcess[str]], tmp_path: Path
) -> None:
    """The inputs beside the results serve the other verbs; a second run takes the place of the first."""
    out = tmp_path / "demo"
    shutil.copytree(demo[0], out)
    done = run("footprints", out, "--case", out / "inputs" / "case.toml", "--out", tmp_path / "again", "--no-figures")
    assert done.returncode == 0, done.stderr
    again, first = (
        json.loads((folder / "registration.json").read_text(encoding="utf-8")) for folder in (tmp_path / "again", out)
    )
    assert again["statements"] == first["statements"]
    assert "unfinished" not in json.dumps(first)
    assert b"unfinished" not in (out / "solution.npz").read_bytes()
    assert (out / first["orientations"]["nominal"][0]["source"]).is_file()
    assert run("demo", "pair", "--out", out, "--no-figures").returncode == 0
    assert not (out / "summary.json").exists()
    assert not list(out.glob("*.png"))


def test_simulate_gives_the_same_bytes_for_the_same_seed(tmp_path: Path) -> None:
    for name, seed in (("one", 4), ("two", 4), ("three", 5)):
        done = run("simulate", "pair", "--out", tmp_path / name, "--seed", str(seed), "--no-pictures")
        assert done.returncode == 0, done.stderr
        assert str(tmp_path / name / "case.toml") in done.stdout
        assert not done.stderr
    one, two, three = (
        {path.name: path.read_bytes() for path in (tmp_path / name).iterdir()} for name in ("one", "two", "three")
    )
    assert one == two
    assert one["truth.json"] != three["truth.json"]


@pytest.mark.slow
def test_simulate_renders_and_takes_the_option(tmp_path: Path) -> None:
    done = run("simulate", "isidis", "--out", tmp_path / "x", "--attitude-time-bias", "0.95")
    assert done.returncode == 0, done.stderr
    truth = json.loads((tmp_path / "x" / "truth.json").read_text(encoding="utf-8"))
    assert truth["images"]["E02-02016"]["errors"]["attitude_time_bias_s"] == 0.95
    assert len(set((tmp_path / "x" / "E0202016.img").read_bytes()[-100_000:])) > 50


def test_simulate_replaces_nothing(tmp_path: Path) -> None:
    (tmp_path / "thesis.txt").write_text("years of work", encoding="utf-8")
    refused(run("simulate", "pair", "--out", tmp_path), "choose another --out")
    assert [path.name for path in tmp_path.iterdir()] == ["thesis.txt"]


# --- `mgsgraph batch` as a person uses it: exit status, table, one line on bad input, interrupts that l


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
    done = run("batch", sites, "--out", out, "--no-figures", "-v")
    assert done.returncode == 0, done.stderr
    assert "2 cases: 2 done" in done.stdout
    assert "north: done, " in done.stdout
    assert sorted(path.name for path in out.iterdir()) == ["campaign.jsonl", "north", "south"]
    again = run("batch", sites, "--out", out, "--no-figures")
    assert again.returncode == 0
    assert "2 of them earlier" in again.stdout
    assert "north" not in again.stdout


def test_a_failed_case_is_exit_status_one_and_in_the_table(sites: Path, tmp_path: Path) -> None:
    (sites / "south" / "case.toml").write_text("format = 7\n", encoding="utf-8")
    done = run("batch", sites, "--out", tmp_path / "out", "--no-figures")
    assert done.returncode == 1
    assert "2 cases: 1 done, 1 failed" in done.stdout
    assert "format 7" in done.stdout
    assert "Traceback" not in done.stderr
    well = run("batch", sites / "north", "--out", tmp_path / "out", "--no-figures")
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
    assert said in refusal("batch", *(places.get(word, word) for word in arguments))
    assert not (tmp_path / "out").exists()


def test_a_scheduler_that_does_not_answer(sites: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("distributed", reason="dask.distributed is not installed (the extra `cluster`)")
    monkeypatch.setattr("mgsgraph.project.campaign.open_cluster", partial(open_cluster, timeout=0.5))
    out = tmp_path / "out"
    command = ["batch", str(sites), "--out", str(out), "--cluster", "tcp://127.0.0.1:9"]
    refuses(r"no scheduler answers there within 0\.5 s", group, [*command, "--insecure"], standalone_mode=False)
    for verb in (command, ["adjust", str(sites / "north" / "case.toml"), *command[2:]]):
        refuses(r"expected tls://127\.0\.0\.1:9, or --insecure", group, verb, standalone_mode=False)
    assert not out.exists()


@pytest.mark.slow
@pytest.mark.parametrize("place", [(), ("--cluster", "local:2")])
def test_an_interrupt_leaves_the_record_true(place: tuple[str, ...], sites: Path, tmp_path: Path) -> None:
    if place:
        pytest.importorskip("distributed", reason="dask.distributed is not installed (the extra `cluster`)")
    for k in range(14):
        shutil.copytree(sites / "north", sites / f"more{k}")
    out = tmp_path / "out"
    command = [*COMMAND, "batch", str(sites), "--out", str(out), "--no-figures", *place]
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
    assert '"status":"failed"' not in (out / "campaign.jsonl").read_text(encoding="utf-8")
    assert all((out / name / "solution.json").exists() for name in over)
    assert not [path for path in out.iterdir() if path.name.startswith(".")]
    done = run("batch", sites, "--out", out, "--no-figures")
    assert done.returncode == 0, done.stderr
    assert f"({len(over)} of them earlier" in done.stdout
    assert sorted(folders(out / "campaign.jsonl")) == sorted(path.name for path in sites.iterdir())


def test_without_dask_the_verb_works_here(sites: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The extra is not needed without --cluster; `test_package` says that nothing imports it beforehand."""
    for name in ("dask", "distributed"):
        monkeypatch.setitem(sys.modules, name, None)
    assert call("batch", sites / "north", "--out", tmp_path / "out", "--no-figures") == 0

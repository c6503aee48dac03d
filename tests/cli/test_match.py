"""`mgsgraph match` as a person uses it: from pictures to a network that is adjusted; one line for errors; going on."""

import json
import shutil
from pathlib import Path

import matched
import numpy as np
import pytest
from click.exceptions import Abort
from commands import call, run, run_afresh
from increments import strip

from mgsgraph.errors import InputError
from mgsgraph.files.networks.binary import read_control_network
from mgsgraph.matching import match as matching
from mgsgraph.simulation.files import write_strip

FEW = ("--cells", "40", "--no-figures")
"""Options, to be quick."""


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The case of the small pair, whose own ties are gone."""
    return matched.write_without_ties(tmp_path_factory.mktemp("site"))


@pytest.fixture(scope="module")
def out(site: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Its matches, found in a process of its own."""
    out = tmp_path_factory.mktemp("found") / "matches"
    done = run_afresh("match", site, "--out", out, "--cells", 40)
    assert done.returncode == 0, done.stderr
    assert done.stderr.split(" ...\n")[:-1] == ["coarse grid", "matching", "measuring"]
    record = json.loads((out / "match.json").read_text(encoding="utf-8"))
    said = done.stdout.splitlines()
    assert [line[2:] for line in said[:-1]] == record["statements"]
    assert said[-1] == f"The network is {out / 'network.pvl'}"
    return out


@pytest.mark.slow
def test_matches_are_written_and_replaced(site: Path, out: Path) -> None:
    assert {path.name for path in out.iterdir()} == {
        "match.json", "matches.csv", "network.net", "network.pvl", "matches.png",
    }  # fmt: skip
    before = read_control_network(out / "network.pvl")
    assert len(before.ids) > 60
    assert call("match", site, "--out", out, *FEW, "--workers", "1") == 0  # replaces it
    assert not list(out.glob("*.png"))
    after = read_control_network(out / "network.pvl")
    assert after.ids == before.ids
    np.testing.assert_allclose(after.measures, before.measures, atol=1e-9)
    np.testing.assert_allclose(after.measure_sigmas, before.measure_sigmas, rtol=1e-9)
    assert [path.name for path in out.parent.iterdir()] == ["matches"]


@pytest.mark.slow
def test_matches_are_adjusted(
    site: Path, out: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """By a case that has no ties; the network's path is the caller's, not the case's."""
    monkeypatch.chdir(out.parent)
    ties = ("--ties", Path("matches") / "network.pvl")
    points = len(read_control_network(out / "network.pvl").ids)
    assert call("check", site, *ties) == 0
    assert f"{points}" in capsys.readouterr().out
    result = tmp_path / "result"
    assert call("adjust", site, *ties, "--out", result, "--no-figures") == 0
    assert "sigma0" in capsys.readouterr().out
    record = json.loads((result / "solution.json").read_text(encoding="utf-8"))
    assert record["status"] == "converged"
    shutil.copy(out / "network.net", tmp_path / "binary.net")
    assert call("check", site, "--ties", tmp_path / "binary.net") == 0
    registration = tmp_path / "registration"
    assert call("register", site, *ties, "--solution", result, "--out", registration, "--no-figures") == 0
    assert (registration / "registration.json").exists()
    capsys.readouterr()


def test_ties_of_a_case_give_way_to_those_named(case_file: Path, tmp_path: Path) -> None:
    own = case_file.with_name("network.pvl")
    other = tmp_path / "other.pvl"
    shutil.move(own, other)
    with pytest.raises(InputError, match=r"network\.pvl"):
        call("check", case_file)
    assert call("check", case_file, "--ties", other) == 0
    with pytest.raises(InputError, match=r"none\.pvl: no such file"):
        call("check", case_file, "--ties", tmp_path / "none.pvl")


def test_nodes_take_ties_too(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    made = strip(6)
    write_strip(made, tmp_path)
    case = tmp_path / "case.toml"
    table = '\n[[passes]]\nname = "{0}"\nimages = ["{0}"]\nprior = {{}}\n'
    tables = "".join(table.format(one.name) for one in made.images)
    case.write_text(case.read_text(encoding="utf-8") + tables, encoding="utf-8")
    (network,) = tmp_path.glob("*.pvl")
    network.rename(tmp_path / "moved.pvl")
    with pytest.raises(InputError, match=r"\.pvl: no such file"):
        call("nodes", case, "--spacings", "3,1.85")
    assert call("nodes", case, "--spacings", "3,1.85", "--ties", tmp_path / "moved.pvl") == 0
    assert "chosen" in capsys.readouterr().out


# ---- going on


@pytest.mark.slow
def test_an_interrupted_run_leaves_nothing(site: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupted(*_: object) -> object:
        raise KeyboardInterrupt

    monkeypatch.setattr(matching, "_on_tile", interrupted)
    with pytest.raises((KeyboardInterrupt, Abort)):
        call("match", site, "--out", tmp_path / "out", *FEW, "--workers", "1", "--step", "7")
    assert not list(tmp_path.iterdir())


# ---- bad input


def refused(said: str, folder: Path, *arguments: str | Path) -> None:
    """Raised as one line, and the folder as it was."""
    names = sorted(path.name for path in folder.iterdir())
    with pytest.raises(InputError) as caught:
        call("match", *arguments)
    assert said in str(caught.value)
    assert "\n" not in str(caught.value)
    assert sorted(path.name for path in folder.iterdir()) == names


def test_bad_input_writes_nothing(site: Path, tmp_path: Path, case_file: Path) -> None:
    out = tmp_path / "out"
    refused("no such file", tmp_path, tmp_path / "none.toml", "--out", out)
    refused("no pixels", tmp_path, case_file, "--out", out)
    refused("matching, cells: 0; expected at least 1", tmp_path, site, "--out", out, "--cells", "0")
    refused("matching, step: -4.0; expected a positive number", tmp_path, site, "--out", out, "--step", "-4")
    foreign = tmp_path / "foreign"
    foreign.mkdir()
    (foreign / "mine.txt").write_text("")
    refused("not a result of mgsgraph", tmp_path, site, "--out", foreign)
    assert (foreign / "mine.txt").exists()
    unknown = site.with_name("unknown.toml")
    text = site.read_text(encoding="utf-8").replace("position_sigma_m = 100.0", "position_sigma_m = inf", 1)
    unknown.write_text(text, encoding="utf-8")
    refused("an infinite a-priori sigma of its orientation", tmp_path, unknown, "--out", out)


def test_errors_are_one_line_on_standard_error(site: Path, tmp_path: Path) -> None:
    for arguments, said in (
        (("match", tmp_path / "none.toml", "--out", tmp_path / "out"), "no such file"),
        (("match", site, "--out", tmp_path / "out", "--method", "grid"), "--method grid is gone"),
        (("match", site), "--out"),
    ):
        done = run(*arguments)
        assert done.returncode == 2, done.stderr
        assert len(done.stderr.strip().splitlines()) == 1, done.stderr
        assert said in done.stderr
    assert list(tmp_path.iterdir()) == []

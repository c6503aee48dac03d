"""Networks as a person uses them: found by `mgsgraph match`, judged in the studio, converted; one line for errors."""

import json
import shutil
from pathlib import Path

import click
import matched
import numpy as np
import pytest
from click.exceptions import Abort
from commands import call, refusal, run, run_afresh
from outside import refuses

from mgsgraph.export.verdicts import network_digest
from mgsgraph.files.networks.binary import read_control_network, read_network
from mgsgraph.matching import match as matching

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
    assert not done.stderr  # no terminal, no bar
    record = json.loads((out / "match.json").read_text(encoding="utf-8"))
    said = done.stdout.splitlines()
    assert [line[2:] for line in said[:-1]] == record["statements"]
    assert said[-1].startswith(f"The network is {out / 'network.pvl'} (")
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
    assert call("footprints", result, "--case", site, *ties, "--out", registration, "--no-figures") == 0
    assert (registration / "registration.json").exists()
    capsys.readouterr()


def test_ties_of_a_case_give_way_to_those_named(case_file: Path, tmp_path: Path) -> None:
    own = case_file.with_name("network.pvl")
    other = tmp_path / "other.pvl"
    shutil.move(own, other)
    refuses(r"network\.pvl", call, "check", case_file)
    assert call("check", case_file, "--ties", other) == 0
    refuses(r"none\.pvl: no such file", call, "check", case_file, "--ties", tmp_path / "none.pvl")


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


def test_what_cannot_be_matched_writes_nothing(site: Path, tmp_path: Path, case_file: Path) -> None:
    out, foreign, unknown = tmp_path / "out", tmp_path / "foreign", site.with_name("unknown.toml")
    foreign.mkdir()
    (foreign / "mine.txt").write_text("")
    text = site.read_text(encoding="utf-8").replace("position_sigma_m = 100.0", "position_sigma_m = inf", 1)
    unknown.write_text(text, encoding="utf-8")
    for said, arguments in {
        "no such file": (tmp_path / "none.toml", "--out", out),
        "neither a case file nor a project": (tmp_path,),
        "no pixels": (case_file, "--out", out),
        "matching, cells: 0; expected at least 1": (site, "--out", out, "--cells", "0"),
        "matching, step: -4.0; expected a positive number": (site, "--out", out, "--step", "-4"),
        "not a result of mgsgraph": (site, "--out", foreign),
        "an infinite a-priori sigma of its orientation": (unknown, "--out", out),
    }.items():
        assert said in refusal("match", *arguments)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["case", "foreign"]
    assert (foreign / "mine.txt").exists()


# --- `mgsgraph convert --verdicts` as a person uses it: a network without the rejected points


def test_a_network_without_rejected_points(pictured_case: Path, tmp_path: Path) -> None:
    network, kept, verdicts = pictured_case.with_name("network.pvl"), tmp_path / "kept.net", tmp_path / "verdicts.csv"
    before = read_control_network(network)
    verdicts.write_text(f"# network {network_digest(before)}\nid,verdict,note\n{before.ids[0]},reject,blurred\n")
    done = run("convert", network, kept, "--case", pictured_case, "--verdicts", verdicts)
    assert done.returncode == 0, done.stderr
    assert "- Ignored: 1 of 20 points" in done.stdout
    assert read_control_network(kept).ids == before.ids[1:]

    other = kept, tmp_path / "k.pvl", "--verdicts", verdicts  # the new network is another one
    assert "expected points of" in refusal("convert", *other)
    verdicts.write_text(f"# network {network_digest(before)}\nid,verdict\n{before.ids[1]},reject\n")
    assert "about network" in refusal("convert", *other)
    verdicts.write_text("id,verdict\nTIE00001,perhaps\n")
    assert "line 2: the verdict" in refusal("convert", network, tmp_path / "k.pvl", "--verdicts", verdicts)
    assert not (tmp_path / "k.pvl").exists()


def test_old_words_of_the_review_say_the_new_ones(pictured_case: Path, tmp_path: Path) -> None:
    done = run("studio", pictured_case, "--review", tmp_path / "page.html")
    assert done.returncode == 2
    assert "convert NETWORK OUT --verdicts CSV" in done.stderr
    assert "studio CASE --verdicts" in run("review", pictured_case).stderr
    network = pictured_case.with_name("network.pvl")
    assert "header" in refusal("studio", pictured_case, "--verdicts", network, "--no-browser")


# --- `mgsgraph convert` as a person uses it: endings, options, what was written and what was lost, one lin


def convert(*arguments: str | Path) -> int:
    """A command in this process; its exit status."""
    return call("convert", *arguments)


@pytest.fixture
def network(case_file: Path) -> Path:
    return case_file.parent / "network.pvl"


def test_what_was_written_and_lost_is_said(network: Path, capsys: pytest.CaptureFixture[str]) -> None:
    first, second = names(network)
    renamed = "--rename", f"{first}=a.cub", "--rename", f"{second}=b.cub"
    assert convert(network, network.parent / "run.match", *renamed) == 0

    said = capsys.readouterr().out.splitlines()
    assert said[0] == f"Wrote {network.parent / 'run-a__b.match'}"
    assert all(line.startswith("- Not kept: ") for line in said[1:])
    assert len(said) > 1


def names(network: Path) -> list[str]:
    points = read_network(network).points
    return list(dict.fromkeys(one.serial_number for point in points for one in point.measures))


def test_there_and_back_with_the_case(network: Path, case_file: Path) -> None:
    """A case says the sizes that NVM wants; its own network may be gone by then."""
    folder = network.parent
    kept = folder / "kept.pvl"
    shutil.move(network, kept)

    assert convert(kept, folder / "x.dat", "--case", case_file, "--to", "nvm") == 0
    assert convert(folder / "x.dat", folder / "back.net", "--body", "MARS", "--from", "nvm") == 0

    first, back = read_network(kept), read_network(folder / "back.net")
    assert len(first.points) == len(back.points)
    for one, other in zip(first.points, back.points, strict=True):
        for before, after in zip(one.measures, other.measures, strict=True):
            assert before.serial_number == after.serial_number
            assert before.line == pytest.approx(after.line, abs=1e-9)
            assert before.sample == pytest.approx(after.sample, abs=1e-9)


def test_united_and_selected(network: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """One image's measures and the other's make the whole again; what stays of it hangs together."""
    folder, whole = network.parent, read_network(network)
    first, second = names(network)
    for name, image in (("a.csv", first), ("b.csv", second)):
        assert convert(network, folder / "free.csv") == 0
        rows = (folder / "free.csv").read_text().splitlines(keepends=True)
        (folder / name).write_text("".join([rows[0], *(row for row in rows if f",{image}," in row)]))
    parts = [folder / "a.csv", folder / "b.csv", "--out", folder / "both.net", "--body", "MARS"]

    refuses(r"an id that .*a\.csv has, too; .*--duplicates", convert, *parts)
    assert convert(*parts, "--duplicates", "first") == 0
    assert "United: 20 points of several files, with 20 more measures" in capsys.readouterr().out
    before, after = ([(m.serial_number, m.line) for one in each.points for m in one.measures]
                     for each in (whole, read_network(folder / "both.net")))  # fmt: skip
    assert after == before
    assert convert(folder / "both.net", "--out", folder / "part.net", "--image", "SIM/*") == 0
    assert len(read_network(folder / "part.net").points) == 20
    for wrong, found in ((["--image", "SIM/A"], "no point"), (["--out", folder / "both.net"], "one of the files")):
        refuses(found, convert, folder / "both.net", "--out", folder / "c.net", *wrong)
    with pytest.raises(click.UsageError, match="one file alone"):
        convert(network)


def test_strict_is_exit_status_two_and_one_line(network: Path) -> None:
    """As a program of its own: what is lost is listed, nothing is written."""
    folder = network.parent
    assert refusal("convert", network, folder / "x.gcp", "--strict", "--radii", 3396190, 3376200)
    assert not (folder / "x.gcp").exists()
    done = run("convert", network, folder / "x.csv", "--strict")

    assert done.returncode == 2
    assert "- Not kept: NetworkId, TargetName, UserName" in done.stdout
    assert "it can't hold 1 kind of things" in done.stderr
    assert not (folder / "x.csv").exists()


def test_a_file_of_the_format_that_is_read_is_not_taken_for_out(network: Path, tmp_path: Path) -> None:
    for name in ("a.csv", "b.csv"):
        assert convert(network, tmp_path / name) == 0

    refuses("--replace", convert, tmp_path / "a.csv", tmp_path / "b.csv")

    assert convert("--replace", tmp_path / "a.csv", tmp_path / "b.csv") == 0

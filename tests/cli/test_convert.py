"""`mgsgraph convert` as a person uses it: endings, options, what was written and what was lost, one line for errors."""

import shutil
from pathlib import Path

import click
import pytest
from commands import run

from mgsgraph.cli import group
from mgsgraph.errors import InputError
from mgsgraph.files.networks.binary import read_network


def call(*arguments: str | Path) -> int:
    """A command in this process; its exit status."""
    return group(["convert", *(str(one) for one in arguments)], standalone_mode=False) or 0


@pytest.fixture
def network(case_file: Path) -> Path:
    return case_file.parent / "network.pvl"


def test_what_was_written_and_lost_is_said(network: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = network.parent / "run.match"

    assert call(network, out, "--rename", f"{names(network)[0]}=a.cub", "--rename", f"{names(network)[1]}=b.cub") == 0

    said = capsys.readouterr().out.splitlines()
    assert said[0] == f"Wrote {network.parent / 'run-a__b.match'}"
    assert all(line.startswith("- Not held: ") for line in said[1:])
    assert len(said) > 1


def names(network: Path) -> list[str]:
    points = read_network(network).points
    return list(dict.fromkeys(one.serial_number for point in points for one in point.measures))


def test_there_and_back_with_the_case(network: Path, case_file: Path) -> None:
    """A case says the sizes that NVM wants; its own network may be gone by then."""
    folder = network.parent
    kept = folder / "kept.pvl"
    shutil.move(network, kept)

    assert call(kept, folder / "x.nvm", "--case", case_file) == 0
    assert call(folder / "x.nvm", folder / "back.net", "--target", "MARS") == 0

    first, back = read_network(kept), read_network(folder / "back.net")
    assert len(first.points) == len(back.points)
    for one, other in zip(first.points, back.points, strict=True):
        for before, after in zip(one.measures, other.measures, strict=True):
            assert before.serial_number == after.serial_number
            assert before.line == pytest.approx(after.line, abs=1e-9)
            assert before.sample == pytest.approx(after.sample, abs=1e-9)


def test_united_and_split(network: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """One image's measures and the other's make the whole again; what stays of it hangs together."""
    folder, whole = network.parent, read_network(network)
    first, second = names(network)
    for name, image in (("a.csv", first), ("b.csv", second)):
        assert call(network, folder / "free.csv") == 0
        rows = (folder / "free.csv").read_text().splitlines(keepends=True)
        (folder / name).write_text("".join([rows[0], *(row for row in rows if f",{image}," in row)]))
    parts = [folder / "a.csv", folder / "b.csv", "--out", folder / "both.net", "--target", "MARS"]

    with pytest.raises(InputError, match=r"an id that .*a\.csv has, too; .*--duplicates"):
        call(*parts)
    assert call(*parts, "--duplicates", "first") == 0
    assert "United: 20 points of several files, with 20 more measures" in capsys.readouterr().out
    before, after = ([(m.serial_number, m.line) for one in each.points for m in one.measures]
                     for each in (whole, read_network(folder / "both.net")))  # fmt: skip
    assert after == before
    assert call(folder / "both.net", "--out", folder / "part.net", "--split", "--only", "SIM/*") == 0
    said = capsys.readouterr().out
    assert len(read_network(folder / "part_1.net").points) == 20
    assert "Part 1: 20 points in 2 images" in said
    assert not (folder / "part.net").exists()
    assert not (folder / "part_2.net").exists()
    for wrong, found in ((["--only", "SIM/A"], "no point"), (["--out", folder / "both.net"], "one of the files")):
        with pytest.raises(InputError, match=found):
            call(folder / "both.net", "--out", folder / "c.net", *wrong)
    with pytest.raises(click.UsageError, match="one file alone"):
        call(network)


def test_formats_may_be_named(network: Path) -> None:
    folder = network.parent
    assert call(network, folder / "table.dat", "--to", "csv") == 0
    assert call(folder / "table.dat", folder / "x.pvl", "--from", "csv", "--target", "MARS") == 0
    assert read_network(folder / "x.pvl").points == read_network(network).points


def test_strict_is_exit_status_two_and_one_line(network: Path) -> None:
    """As a program of its own: what is lost is listed, nothing is written."""
    folder = network.parent
    done = run("convert", network, folder / "x.gcp", "--strict", "--radii", 3396190, 3376200)

    assert done.returncode == 2
    assert done.stderr.startswith("mgsgraph: error: ")
    assert done.stderr.count("\n") == 1
    assert not (folder / "x.gcp").exists()

    done = run("convert", network, folder / "x.csv", "--strict")

    assert done.returncode == 2
    assert "- Not held: NetworkId, TargetName, UserName" in done.stdout
    assert "it can't hold 1 kind of things" in done.stderr
    assert not (folder / "x.csv").exists()


def test_a_file_of_the_format_that_is_read_is_not_taken_for_out(network: Path, tmp_path: Path) -> None:
    for name in ("a.csv", "b.csv"):
        assert call(network, tmp_path / name) == 0

    with pytest.raises(InputError, match="--replace"):
        call(tmp_path / "a.csv", tmp_path / "b.csv")

    assert call("--replace", tmp_path / "a.csv", tmp_path / "b.csv") == 0

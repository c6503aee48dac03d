"""Exports as a whole: written whole or not at all, and verified where asked."""

import json
from pathlib import Path

import numpy as np
import pytest
from networks import network, pair

from mgsgraph.adjustment.adjust import adjust_network
from mgsgraph.adjustment.settings import SolverSettings
from mgsgraph.cli import group
from mgsgraph.errors import InputError
from mgsgraph.export import Target, spice_back
from mgsgraph.export import solution_export as exports
from mgsgraph.export.solution_export import Exported, ExportSettings, export_solution, target_of
from mgsgraph.results.results import write_results

FINE = 0.01
"""pixels, that a product may be off."""


@pytest.fixture(scope="module")
def _made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("export") / "solution"
    write_results(adjust_network(network(pair(ties=40)), SolverSettings(), "pair"), folder, figures=False)
    return folder


@pytest.fixture
def solution(_made: Path, tmp_path: Path) -> Path:
    """A folder of its own."""
    folder = tmp_path / "solution"
    folder.mkdir()
    for file in _made.iterdir():
        (folder / file.name).write_bytes(file.read_bytes())
    return folder


@pytest.mark.parametrize("target", list(Target))
def test_an_export_says_its_files(target: Target, solution: Path, tmp_path: Path) -> None:
    done = export_solution(solution, target, tmp_path / "out")

    there = {path.relative_to(tmp_path / "out").as_posix() for path in (tmp_path / "out").rglob("*") if path.is_file()}
    assert there == {"export.json", *done.files}
    assert done.sentence == f"{len(done.files)} files for {target.value}."
    record = json.loads((tmp_path / "out" / "export.json").read_text())
    assert (record["target"], record["files"]) == (target.value, list(done.files))


def test_kernels_are_verified_where_asked(solution: Path, tmp_path: Path) -> None:
    done = export_solution(solution, "spice", tmp_path / "out", ExportSettings(verify=True))
    assert done.measures > 50
    assert done.largest < FINE
    assert "read back by SPICE alone" in done.sentence
    noted = json.loads((tmp_path / "out" / "export.json").read_text())
    assert (noted["measures"], noted["largest_difference_px"]) == (done.measures, done.largest)


def test_an_earlier_export_is_replaced_by_one_of_its_kind(solution: Path, tmp_path: Path) -> None:
    for target in ("spice", "csm", "csm"):
        export_solution(solution, target, tmp_path / "out" / target)
    with pytest.raises(InputError, match=r"spice: an export to spice.*csm"):
        export_solution(solution, "csm", tmp_path / "out" / "spice")
    assert list((tmp_path / "out" / "spice").glob("*.bsp"))


def test_other_folders_are_left_alone(solution: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    export_solution(solution, "csm", out)
    (out / "mine.txt").write_text("kept")
    with pytest.raises(InputError, match="mine"):
        export_solution(solution, "csm", out)
    with pytest.raises(InputError, match="another kind of result"):
        export_solution(solution, "csm", solution)


def test_a_file_of_the_users_in_a_folder_of_an_export_is_kept(solution: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    export_solution(solution, "asp", out)
    export_solution(solution, "asp", out)
    (out / "matches" / "mine.match").write_text("kept")
    with pytest.raises(InputError, match=r"matches/mine\.match"):
        export_solution(solution, "asp", out)


def test_a_damaged_record_is_refused_where_it_is_needed(solution: Path, tmp_path: Path) -> None:
    record, sound = solution / "solution.json", (solution / "solution.json").read_text()
    for damaged in ("[]", "{", sound.replace('"name"', '"nome"'), sound.replace('"crc32": "', '"crc32": "0')):
        record.write_text(damaged)
        export_solution(solution, "csm", tmp_path / "out")
        with pytest.raises(InputError, match=r"solution\.json"):  # it knows the networks whose content is kept
            export_solution(solution, "isis", tmp_path / "isis")


@pytest.mark.parametrize(
    ("target", "settings", "found"),
    [
        ("spice", ExportSettings(scaled=True), "scaled.*isis or asp"),
        ("csm", ExportSettings(scaled=True), "scaled"),
        ("gis", ExportSettings(scaled=True), "scaled"),
        ("csm", ExportSettings(raster=True), "raster.*gis"),
        ("csm", ExportSettings(verify=True), "verify.*spice alone"),
        ("isis", ExportSettings(support={}), "case.*csm or asp"),
        ("asp", ExportSettings(support={"OTHER": Path("other.isd")}), "file of OTHER: no image"),
    ],
)
def test_settings_that_would_do_nothing_are_refused(
    target: str, settings: ExportSettings, found: str, solution: Path, tmp_path: Path
) -> None:
    with pytest.raises(InputError, match=found):
        export_solution(solution, target, tmp_path / "out", settings)
    assert not (tmp_path / "out").exists()


def test_a_full_disk_is_said_of_the_folder_that_was_asked_for(
    solution: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(solution: object, folder: Path, settings: object, path: Path) -> None:
        raise InputError(str(folder / "network.net"), "can't be written (No space left on device)")

    monkeypatch.setitem(exports._WRITERS, Target.ISIS, full)
    with pytest.raises(InputError, match="free some space") as caught:
        export_solution(solution, "isis", tmp_path / "out")
    assert caught.value.where == str(tmp_path / "out" / "network.net")
    assert list(tmp_path.iterdir()) == [solution]


def test_what_to_beware_of_is_said() -> None:
    fine = Exported(Target.SPICE, Path("out"), ("a.tm",), 8, 0.001)
    assert fine.sentence.endswith("where the solution has them.")
    assert "farther off" in fine._replace(largest=0.02).sentence
    assert "NOT converge" in fine._replace(converged=False).sentence


@pytest.mark.parametrize("bad", [np.inf, np.nan])
def test_what_does_not_come_back_is_not_there(
    bad: float, solution: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(spice_back, "spice_differences", lambda *_: np.array([0.0, bad]))
    with pytest.raises(InputError, match="1 measures don't come back"):
        export_solution(solution, "spice", tmp_path / "out", ExportSettings(verify=True))
    assert not (tmp_path / "out").exists()


def test_targets_by_name() -> None:
    assert target_of("spice") == target_of(Target.SPICE) == Target.SPICE
    with pytest.raises(InputError, match="spice, csm, isis, asp, gis"):
        target_of("shapefile")


def test_the_command(solution: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    command = ["export", str(solution), "--to", "spice", "--verify", "--out", str(tmp_path / "out")]
    group(command, standalone_mode=False)
    assert "read back by SPICE alone" in capsys.readouterr().out
    case = tmp_path / "case.toml"
    labels = '[[images]]\nname = "A"\nlabel = "a.img"\n[[images]]\nname = "B"\nlabel = "b.img"\n'
    case.write_text(f'format = 1\nname = "labels"\n{labels}[ties]\nnetwork = "network.pvl"\n')
    command = ["export", str(solution), "--to", "csm", "--out", str(tmp_path / "x"), "--case", str(case)]
    with pytest.raises(InputError, match="no image of the solution"):
        group(command, standalone_mode=False)
    with pytest.raises(InputError, match="no such file"):
        group(["export", str(tmp_path / "none"), "--to", "isis", "--out", str(tmp_path / "x")], standalone_mode=False)


def test_sigmas_of_new_points_go_along_where_asked(solution: Path, tmp_path: Path) -> None:
    done = export_solution(solution, "gis", tmp_path / "out", ExportSettings(raster=True))
    assert "sigmas.tif" in done.files

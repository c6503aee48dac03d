"""Which cases a campaign has, where their results go, and what they are made from."""

import os
import sys
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import mgsgraph
from mgsgraph.errors import InputError
from mgsgraph.project.campaign import checksums, find_cases, result_folders

words = st.sampled_from(["a", "b", "eos", "case", "gusev"])
paths = st.lists(words, min_size=2, max_size=5).map(lambda parts: Path("/").joinpath(*parts).with_suffix(".toml"))


@given(st.lists(paths, unique=True, max_size=12), st.integers(0, 12))
@settings(max_examples=80)
def test_every_case_has_a_folder_of_its_own_which_stays(cases: list[Path], first: int) -> None:
    try:
        earlier = result_folders(cases[:first], {})
        folders = result_folders(cases, earlier)
    except InputError:  # /a/case.toml and /a.toml can't be told apart, nor those with all of their path taken
        return
    assert set(folders) == set(cases)
    assert len(set(folders.values())) == len(cases)
    assert all(folders[case] == name for case, name in earlier.items())
    for case, name in folders.items():
        whole = "-".join(part for part in case.with_suffix("").parts[1:])
        assert whole.removesuffix("-case").endswith(name) or whole.endswith(name)


def test_names_are_short_where_they_can_be() -> None:
    cases = [
        Path(f"/sites/{place}.toml") for place in ("eos/case", "eos/case_papers", "gusev/case", "isidis", "x/isidis")
    ]
    assert list(result_folders(cases, {}).values()) == ["eos", "case_papers", "gusev", "isidis", "x-isidis"]


def test_cases_of_a_folder(tmp_path: Path) -> None:
    for name in ("b/case.toml", "a.toml", "b/c/d.toml", ".hidden/e.toml", "out/f.toml", "b/.g.toml", "b/notes.txt"):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).touch()
    found = find_cases([tmp_path / "b" / "case.toml", tmp_path, tmp_path / "a.toml"], tmp_path / "out")
    assert [path.relative_to(tmp_path).as_posix() for path in found] == ["b/case.toml", "a.toml", "b/c/d.toml"]
    with pytest.raises(InputError, match=r"nothing\.toml: no such file"):
        find_cases([tmp_path / "nothing.toml"], tmp_path / "out")
    (tmp_path / "empty").mkdir()
    with pytest.raises(InputError, match="no case file"):
        find_cases([tmp_path / "empty"], tmp_path / "out")


# --- what a case is made from


def test_every_file_that_reading_opens_has_a_checksum(case_file: Path) -> None:
    """The interpreter's own audit tells which files are opened."""
    opened: set[Path] = set()
    watching = [True]

    def hook(event: str, arguments: tuple[Any, ...]) -> None:
        if watching and event == "open" and isinstance(arguments[0], str | Path):
            opened.add(Path(arguments[0]).resolve())

    sys.addaudithook(hook)  # can't be taken away again, only be made idle
    mgsgraph.read_case(case_file)
    watching.clear()
    folder = case_file.parent
    mine = {path.relative_to(folder).as_posix() for path in opened if path.is_relative_to(folder)}
    assert len(mine) > 3
    assert mine <= checksums(case_file).keys()


EVERYTHING = """
format = 1
name = "all that a case can name"
[[images]]
name = "A"
isd = "a.json"
[[images]]
name = "B"
label = "b.lbl"
kernels = ["own.tm"]
[ties]
network = "net.pvl"
[ground_control]
file = "points.gcp"
[laser]
file = "lidar.json"
[[shots]]
file = "ap.csv"
[[altimetry]]
file = "cloud.csv"
[terrain]
radius = "megr.img"
topography = "megt.lbl"
[spice]
kernels = ["common.tm"]
"""
META = "KPL/MK\n\\begindata\nKERNELS_TO_LOAD = ( 'inner.tls' )\n\\begintext\n"


@pytest.fixture
def everything(tmp_path: Path) -> Path:
    case = tmp_path / "case.toml"
    case.write_text(EVERYTHING, encoding="utf-8")
    for name in ("a.json", "b.lbl", "B.IMG", "net.pvl", "points.gcp", "lidar.json", "ap.csv", "megr.img",
                 "megr.lbl", "megt.lbl", "megt.img", "cloud.csv"):  # fmt: skip
        (tmp_path / name).write_text(name, encoding="utf-8")
    for name in ("own.tm", "common.tm"):
        (tmp_path / name).write_text(META, encoding="utf-8")
    (tmp_path / "inner.tls").write_text("KPL/LSK\n\\begindata\n", encoding="utf-8")
    return case


def test_every_file_that_a_case_names_counts(everything: Path) -> None:
    before = checksums(everything)
    names = {path.name for path in everything.parent.iterdir()}
    assert before.keys() == names
    assert None not in before.values()
    for name in sorted(names - {"case.toml"}):
        path = everything.parent / name
        kept = path.read_bytes()
        path.write_bytes(kept + b" ")
        assert {key for key, value in checksums(everything).items() if value != before[key]} == {name}
        path.unlink()
        assert checksums(everything).get(name) is None
        path.write_bytes(kept)
    assert checksums(everything) == before


def test_a_file_that_changes_and_keeps_its_size_counts(case_file: Path) -> None:
    """In a process that has read it before, too."""
    before, network = checksums(case_file), case_file.with_name("network.pvl")
    content, changed = network.read_bytes(), network.stat().st_mtime_ns
    network.write_bytes(content[:-1] + bytes([content[-1] ^ 1]))
    os.utime(network, ns=(changed + 1, changed + 1))
    assert checksums(case_file)[network.name] not in (None, before[network.name])

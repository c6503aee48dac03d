"""Campaigns: which cases they have, what is due is done, what fails is told, and their record stays true."""

import json
import os
import shutil
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from outside import refuses

import mgsgraph
from mgsgraph.adjustment.cluster.connection import Lost
from mgsgraph.atomic_write import beside
from mgsgraph.errors import InputError, SolverError
from mgsgraph.project import campaign as campaign_run
from mgsgraph.project.campaign import (
    RECORD,
    Campaign,
    CampaignEntry,
    checksums,
    find_cases,
    line,
    open_record,
    result_folders,
    run_campaign,
    summary,
)
from mgsgraph.results.results import Overrides, write_results

TABLES = ("points.csv", "orientation.csv", "residuals.csv")
QUICK = Overrides(figures=False)


@pytest.fixture
def sites(case_file: Path, tmp_path: Path) -> Path:
    """Three sites, of which one has no network."""
    folder = tmp_path / "sites"
    for name in ("north", "south", "west"):
        shutil.copytree(case_file.parent, folder / name)
    (folder / "west" / "network.pvl").unlink()
    return folder


Run = Callable[..., tuple[Campaign, set[str]]]


@pytest.fixture
def run(sites: Path, tmp_path: Path) -> Run:
    """Run the campaign and tell the folders of the cases that were done now."""

    def run(overrides: Overrides = QUICK, **options: Any) -> tuple[Campaign, set[str]]:
        now: list[CampaignEntry] = []
        out = tmp_path / "out"
        done = run_campaign(
            [sites], out, overrides, progress=lambda over, due, one: now.extend([one] if one else []), **options
        )
        lines = (out / RECORD).read_text(encoding="utf-8").splitlines()[1:]
        assert [json.loads(text)["folder"] for text in lines[len(lines) - len(now) :]] == [one.folder for one in now]
        return done, {one.folder for one in now}

    return run


def test_a_failed_case_does_not_stop_the_others(run: Run, sites: Path, tmp_path: Path) -> None:
    done, now = run()
    assert now == {"north", "south", "west"}
    assert {one.folder: one.status for one in done.entries} == {"north": "done", "south": "done", "west": "failed"}
    assert done.count("done") < len(done.entries)
    failure = done.entries[2]
    assert "network.pvl" in failure.message
    assert "no such file" in failure.message
    assert "network.pvl" not in failure.checksums
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == [RECORD, "north", "south"]
    good = done.entries[0]
    solution = mgsgraph.read_solution(tmp_path / "out" / "north")
    assert good.cost == solution.cost_final
    assert good.sigma0 == solution.sigma0
    assert good.iterations == solution.iterations
    assert summary(done).startswith("3 cases: 2 done, 1 failed\n")
    assert "\n- west: failed after" in summary(done)


def test_products_are_those_of_adjust(run: Run, sites: Path, tmp_path: Path) -> None:
    run()
    write_results(mgsgraph.adjust(mgsgraph.read_case(sites / "north" / "case.toml")), tmp_path / "alone", figures=False)
    assert {p.name for p in (tmp_path / "out" / "north").iterdir()} == {p.name for p in (tmp_path / "alone").iterdir()}
    for name in TABLES:
        assert (tmp_path / "out" / "north" / name).read_bytes() == (tmp_path / "alone" / name).read_bytes()


def test_what_is_done_and_unchanged_is_left(run: Run, sites: Path, tmp_path: Path) -> None:
    run()
    stamp = (tmp_path / "out" / "north" / "solution.json").stat().st_mtime_ns
    again, now = run()
    assert not now
    assert len(again.kept) == 3
    assert "3 of them earlier" in summary(again)
    assert (tmp_path / "out" / "north" / "solution.json").stat().st_mtime_ns == stamp
    (sites / "north" / "case.toml").touch()  # a newer file with the same content
    assert not run()[1]


def test_what_has_changed_is_done_again(run: Run, sites: Path, tmp_path: Path) -> None:
    run()
    network = sites / "south" / "network.pvl"
    network.write_text(network.read_text(encoding="utf-8") + "\n", encoding="utf-8")
    assert run()[1] == {"south"}
    case = sites / "north" / "case.toml"
    case.write_text(case.read_text(encoding="utf-8") + "# looked at\n", encoding="utf-8")
    assert run()[1] == {"north"}
    shutil.rmtree(tmp_path / "out" / "south")
    assert run()[1] == {"south"}
    assert run(Overrides(figures=False, laser=False))[1] == {"north", "south", "west"}
    shutil.copy(network, sites / "west" / "network.pvl")
    done, now = run(Overrides(figures=False, laser=False))
    assert now == {"west"}
    assert done.count("done") == len(done.entries)
    assert mgsgraph.read_solution(tmp_path / "out" / "west").network.ranges.point.size == 0


def test_a_record_of_matching_that_appears_beside_a_network_is_a_change(run: Run, sites: Path) -> None:
    """Field case 20: it says in which windows the network's points were compared."""
    run()
    (sites / "north" / "match.json").write_text('{"settings": {"half_window": 10}}', encoding="utf-8")
    assert run()[1] == {"north"}


def test_failures_are_tried_again_on_request(run: Run) -> None:
    run()
    assert run(retry=True)[1] == {"west"}
    done, now = run(Overrides(figures=False, reject=1.0))
    assert now == {"north", "south", "west"}
    assert done.count("failed") == 3
    assert "at least 2 standard deviations" in done.entries[0].message
    assert "what is in north is from before" in done.entries[0].message


def test_a_case_that_does_not_converge_is_told(run: Run, sites: Path, tmp_path: Path) -> None:
    case = sites / "north" / "case.toml"
    case.write_text(case.read_text(encoding="utf-8") + "\n[solver]\nmax_iterations = 1\n", encoding="utf-8")
    done, _ = run()
    assert done.entries[0].status == "not converged"
    assert (tmp_path / "out" / "north" / "solution.json").exists()
    assert "raise max_iterations" in summary(done)
    assert run()[1] == set()
    assert run(retry=True)[1] == {"north", "west"}


def test_a_fault_of_the_program_is_one_failed_case(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    read = campaign_run.read_case

    def faulty(path: Path, laser: bool = True) -> Any:
        if path.parent.name == "north":
            raise ZeroDivisionError("division\nby zero")
        return read(path, laser)

    monkeypatch.setattr(campaign_run, "read_case", faulty)
    done, _ = run()
    assert [one.status for one in done.entries] == ["failed", "done", "failed"]
    assert "unforeseen ZeroDivisionError: division by zero" in done.entries[0].message
    assert "\n" not in line(done.entries[0])


def test_what_a_library_makes_of_an_interrupt_is_no_failed_case(
    run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def faulty(path: Path, laser: bool = True) -> Any:
        try:
            raise KeyboardInterrupt
        except BaseException:
            raise ImportError("interrupted in an import") from None

    monkeypatch.setattr(campaign_run, "read_case", faulty)
    with pytest.raises(KeyboardInterrupt):
        run()
    assert not (tmp_path / "out").exists()


def test_leftovers_of_a_killed_worker_are_swept(run: Run, tmp_path: Path) -> None:
    leftover, foreign = beside(Path("north")).name, ".north.0a1b2c3d.mine"
    run()
    for name in (leftover, foreign):
        (tmp_path / "out" / name).mkdir()
    run(Overrides(figures=False, laser=False))
    assert not (tmp_path / "out" / leftover).exists()
    assert (tmp_path / "out" / foreign).exists()


def test_a_campaign_that_moved_as_a_whole_is_known(run: Run, sites: Path, tmp_path: Path) -> None:
    run()
    moved = tmp_path / "moved"
    moved.mkdir()
    shutil.move(sites, moved / "sites")
    shutil.move(tmp_path / "out", moved / "out")
    now: list[CampaignEntry | None] = []
    run_campaign([moved / "sites"], moved / "out", QUICK, progress=lambda over, due, one: now.append(one))
    assert not now


# --- on a cluster


@pytest.mark.slow
def test_on_a_cluster_the_same(run: Run, tmp_path: Path) -> None:
    pytest.importorskip("distributed", reason="dask.distributed is not installed (the extra `cluster`)")
    run()
    shutil.move(tmp_path / "out", tmp_path / "here")
    done, now = run(cluster="local:2")
    assert now == {"north", "south", "west"}
    assert [one.status for one in done.entries] == ["done", "done", "failed"]
    for name in TABLES:
        assert (tmp_path / "out" / "north" / name).read_bytes() == (tmp_path / "here" / "north" / name).read_bytes()
    assert not run(cluster="tls://127.0.0.1:9")[1]  # nothing is due, and nobody is asked


def test_what_was_over_when_the_cluster_went_is_recorded(
    run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    @contextmanager
    def hands(*_: object) -> Iterator[Any]:
        def each(function: Callable[[Any], Any], orders: Any) -> Iterator[tuple[int, Any]]:
            yield 1, function(orders[1])
            yield 2, Lost("each of the 4 workers that tried it died")
            raise SolverError("the scheduler has gone")

        yield each

    with monkeypatch.context() as patched:
        patched.setattr("mgsgraph.project.campaign._workers", hands)
        with pytest.raises(SolverError, match="has gone"):
            run()
    done, now = run()
    assert now == {"north"}
    assert [one.status for one in done.entries] == ["done", "done", "failed"]
    assert done.entries[2].message.startswith("each of the 4 workers")


# --- which cases a campaign has, where their results go, and what they are made from


words = st.sampled_from(["a", "b", "eos", "case", "gusev"])
paths = st.lists(words, min_size=2, max_size=5).map(lambda parts: Path("/").joinpath(*parts).with_suffix(".toml"))


@given(st.lists(paths, unique=True, max_size=12), st.integers(0, 12))
@settings(max_examples=80)
def test_every_case_has_a_folder_of_its_own_which_stays(cases: list[Path], first: int) -> None:
    try:
        earlier = result_folders(cases[:first], {})
        folders = result_folders(cases, earlier)
    except InputError:  # /a/case.toml and /a.toml can't be distinguished, nor those with all of their path taken
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
    refuses(r"nothing\.toml: no such file", find_cases, [tmp_path / "nothing.toml"], tmp_path / "out")
    (tmp_path / "empty").mkdir()
    refuses("no case file", find_cases, [tmp_path / "empty"], tmp_path / "out")


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


# above two seconds: a case of every kind of file is read once for each of them
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


# --- the record of a campaign is true after whatever happened to it


def entry(case: str = "a.toml", **changed: Any) -> CampaignEntry:
    whole: dict[str, Any] = {
        "case": case,
        "folder": case.removesuffix(".toml"),
        "status": "done",
        "message": "Converged: grün ist die Hoffnung.",
        "seconds": 1.5,
        "converged": True,
        "sigma0": 0.97,
        "cost": 12.5,
        "iterations": 4,
        "checksums": {case: "0f", "gone": None},
        "overrides": Overrides("huber", 5.0, False, True),
        "version": "0.1.0",
        "machine": "here",
        "finished": "2026-11-21T19:00:00+00:00",
    }
    return CampaignEntry(**whole | changed)


def test_what_is_recorded_is_read(tmp_path: Path) -> None:
    with open_record(tmp_path) as record:
        for one in (entry("a.toml"), entry("b.toml", sigma0=None, status="failed"), entry("a.toml", seconds=2.0)):
            record.append(one)
    with open_record(tmp_path) as record:
        assert record.entries == {
            "a.toml": entry("a.toml", seconds=2.0),
            "b.toml": entry("b.toml", sigma0=None, status="failed"),
        }
    assert len((tmp_path / RECORD).read_bytes().splitlines()) == 4


def test_a_record_cut_anywhere_keeps_its_whole_lines(tmp_path: Path) -> None:
    with open_record(tmp_path / "whole") as record:
        record.append(entry("a.toml"))
        record.append(entry("b.toml"))
    text = (tmp_path / "whole" / RECORD).read_bytes()
    folder = tmp_path / "cut"
    folder.mkdir()
    for size in range(0, len(text) + 1, 7):
        (folder / RECORD).write_bytes(text[:size])
        with open_record(folder) as record:
            assert list(record.entries) == ["a.toml", "b.toml"][: max(text[:size].count(b"\n") - 1, 0)]
            record.append(entry("c.toml"))
        with open_record(folder) as record:
            assert list(record.entries)[-1] == "c.toml"


def test_a_record_of_which_nothing_came_goes(tmp_path: Path) -> None:
    with open_record(tmp_path / "out"):
        assert (tmp_path / "out" / RECORD).exists()
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("{}\n", "line 1: no head of a campaign's record"),
        ("thesis\n", "line 1: no head"),
        ('{"program": "mgsgraph", "record": "campaign", "format": 1}\n', "line 1: no head"),
        ('{"program": "mgsgraph", "record": "campaign", "format": 2}\n{"case": 1}\n', "line 2: a damaged entry"),
        ("\xff\n", "line 1: no head"),
    ],
)
def test_a_record_that_is_none_is_refused_and_kept(text: str, said: str, tmp_path: Path) -> None:
    (tmp_path / RECORD).write_text(text, encoding="latin-1")
    refuses(said, open_record, tmp_path)
    assert (tmp_path / RECORD).read_text(encoding="latin-1") == text


def test_a_flipped_bit_is_found(tmp_path: Path) -> None:
    """Refused, or taken for a line that was cut short, whose case is done again."""
    with open_record(tmp_path / "whole") as record:
        record.append(entry("a.toml"))
        record.append(entry("b.toml", sigma0=1.0))
        whole = record.entries
    text = (tmp_path / "whole" / RECORD).read_bytes()
    (tmp_path / "flipped").mkdir()
    for place in range(len(text)):
        broken = bytearray(text)
        broken[place] ^= 1 << place % 8
        (tmp_path / "flipped" / RECORD).write_bytes(broken)
        try:
            with open_record(tmp_path / "flipped") as record:
                assert record.entries.items() < whole.items()
                assert place == len(text) - 1
        except InputError as error:
            assert str(tmp_path) in str(error)  # noqa: PT017


def test_a_record_that_is_a_pipe_is_refused(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / RECORD)
    refuses("is no file", open_record, tmp_path)


def test_foreign_folders_are_refused(tmp_path: Path) -> None:
    (tmp_path / "thesis.txt").write_text("years of work", encoding="utf-8")
    refuses(r"has no campaign\.jsonl; expected an absent or empty folder", open_record, tmp_path)
    refuses("exists and is a file", open_record, tmp_path / "thesis.txt")
    assert [path.name for path in tmp_path.iterdir()] == ["thesis.txt"]


@pytest.mark.skipif(sys.platform == "win32", reason="no locks there")
def test_one_campaign_at_a_time(tmp_path: Path) -> None:
    with open_record(tmp_path) as record:
        record.append(entry())
        refuses("another campaign is writing here", open_record, tmp_path)
    with open_record(tmp_path) as record:
        assert record.entries


def test_a_full_disk_leaves_whole_lines(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write = os.write
    with open_record(tmp_path) as record:
        record.append(entry("a.toml"))
        monkeypatch.setattr(os, "write", lambda descriptor, text: write(descriptor, text[:40]))
        refuses("disk is full", record.append, entry("b.toml"))
        monkeypatch.setattr(os, "write", write)
        record.append(entry("c.toml"))
    with open_record(tmp_path) as record:
        assert list(record.entries) == ["a.toml", "c.toml"]

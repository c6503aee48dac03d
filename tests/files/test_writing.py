"""What is made aside goes with its process; nothing but an earlier output of its kind is replaced; damage is told."""

import ast
import errno
import json
import os
import re
import signal
import tempfile
from collections.abc import Callable
from contextlib import AbstractContextManager
from hashlib import sha256
from pathlib import Path

import pytest
from outside import refuses

from mgsgraph import atomic_write
from mgsgraph.atomic_write import beside, is_aside, made_beside, scratch, sweep
from mgsgraph.errors import InputError
from mgsgraph.files.output import folders
from mgsgraph.files.output.folders import FIGURES, TABLES, fresh_folder, require_replaceable
from mgsgraph.files.writing import (
    FILES,
    MATCH,
    begins,
    claimed,
    fresh_file,
    page_of,
    read_record,
    record_text,
    require_as_recorded,
    require_free,
    require_writable,
    write_file,
    write_page,
)
from mgsgraph.results.page import require_page as require_report


def killed_within(made: Callable[[], AbstractContextManager[Path]]) -> str:
    """Name of what a process had made when it was killed."""
    receiving, sending = os.pipe()
    child = os.fork()
    if child == 0:
        with made() as place:
            os.write(sending, place.name.encode())
            os.kill(os.getpid(), signal.SIGKILL)
    os.close(sending)
    with os.fdopen(receiving) as said:
        name = said.read()
    assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == -signal.SIGKILL
    return name


def names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


# --- leftovers


@pytest.mark.parametrize("folder", [True, False])
def test_what_a_kill_leaves_goes_with_the_next_command(tmp_path: Path, folder: bool) -> None:
    left = killed_within(lambda: made_beside(tmp_path / "out", folder))
    assert names(tmp_path) == [left]
    assert is_aside(left)
    write_file(tmp_path / "other", "text")
    assert names(tmp_path) == ["other"]


@pytest.mark.parametrize("folder", [True, False])
def test_what_a_living_process_makes_stays(tmp_path: Path, folder: bool) -> None:
    with made_beside(tmp_path / "out", folder) as place:
        sweep(tmp_path)
        require_writable(tmp_path)
        assert names(tmp_path) == [place.name]
    assert not names(tmp_path)


def test_what_is_not_ours_stays(tmp_path: Path) -> None:
    foreign = [".out.unfinished", ".out.0a1b2c3.unfinished", ".out.0A1B2C3D.unfinished", "out.0a1b2c3d.unfinished",
               ".out.0a1b2c3d.unfinished.txt", ".out.0a1b2c3d.part"]  # fmt: skip
    for name in foreign:
        (tmp_path / name).write_text("mine")
    (tmp_path / "precious").mkdir()
    beside(tmp_path / "link").symlink_to(tmp_path / "precious")
    os.mkfifo(beside(tmp_path / "pipe"))
    before = names(tmp_path)
    sweep(tmp_path)
    assert names(tmp_path) == before
    if os.geteuid() == 0:
        others = beside(tmp_path / "others")
        others.touch()
        os.chown(others, 12345, 12345)
        sweep(tmp_path)
        assert others.exists()


def test_what_another_host_makes_stays(tmp_path: Path) -> None:
    """Where its lock isn't seen here, it looks like a leftover."""
    ours = beside(tmp_path / "out").name
    theirs = f"{ours[:5]}{int(ours[5]) ^ 1 if ours[5].isdigit() else 0}{ours[6:]}"
    (tmp_path / theirs).mkdir()
    (tmp_path / ours).mkdir()
    sweep(tmp_path)
    assert names(tmp_path) == [theirs]


def test_scratch_of_a_killed_process_goes_with_the_next(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """It is private from the beginning: a folder that others may enter for a moment could be entered in it."""
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    killed_within(scratch)
    assert len(names(tmp_path)) == 1
    modes = list[int]()
    monkeypatch.setattr(Path, "chmod", lambda self, mode: modes.append(self.stat().st_mode & 0o777))
    with scratch() as place:
        modes.append(place.stat().st_mode & 0o777)
        assert names(tmp_path) == [place.name]
    assert set(modes) == {0o700}
    assert not names(tmp_path)


def test_a_file_that_is_swept_before_it_is_locked_is_made_anew(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from mgsgraph import atomic_write

    lock, swept = atomic_write.lock, list[int]()

    def late(descriptor: int, required: bool = False) -> bool:
        if not swept:
            swept.append(descriptor)
            for name in names(tmp_path):
                (tmp_path / name).unlink()
        return lock(descriptor, required)

    monkeypatch.setattr(atomic_write, "lock", late)
    with fresh_file(tmp_path / "out") as place:
        place.write_text("text")
    assert names(tmp_path) == ["out"]


def test_whoever_reads_the_old_file_reads_it_to_its_end(tmp_path: Path) -> None:
    """A new file takes the place of the old one, and does not go into it: a reader would see half of each."""
    path = tmp_path / "out"
    write_file(path, "old")
    os.link(path, tmp_path / "same")
    with path.open() as reading:
        write_file(path, "new text")
        assert reading.read() == "old"
    assert (tmp_path / "same").read_text() == "old"
    assert path.read_text() == "new text"


def test_a_claimed_folder_may_be_written_into(tmp_path: Path) -> None:
    """By others, too: it is what another of the same command may not have."""
    with claimed(tmp_path, "somebody is here"):
        write_file(tmp_path / "out", "text")
        with pytest.raises(InputError, match="somebody is here"), claimed(tmp_path, "somebody is here"):
            pass


# --- what is there already


TABLE = begins("a table of ours", "id,value")


@pytest.mark.parametrize("text", ["id,value\n1,2\n", "\ufeffid,value\n", ""])
def test_an_earlier_output_is_replaced(tmp_path: Path, text: str) -> None:
    path = tmp_path / "table.csv"
    path.write_text(text, encoding="utf-8")
    write_file(path, "new", over=TABLE)
    assert path.read_text() == "new"


@pytest.mark.parametrize("content", [b"years of work", b"\xff\xfe\0", b"value,id\n", b"\0" * 10])
def test_nothing_else_is(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "thesis.tex"
    path.write_bytes(content)
    for attempt in (lambda: write_file(path, "new", over=TABLE), lambda: require_free(path, TABLE)):
        refuses(r"thesis\.tex: exists and is not a table of ours; choose another name", attempt)
    assert path.read_bytes() == content
    assert names(tmp_path) == ["thesis.tex"]


def test_a_file_that_appears_meanwhile_is_kept(tmp_path: Path) -> None:
    path = tmp_path / "out"

    def write() -> None:
        with fresh_file(path, over=TABLE) as place:
            place.write_text("id,value")
            path.write_text("somebody else's")

    refuses("not a table of ours", write)
    assert path.read_text() == "somebody else's"
    assert names(tmp_path) == ["out"]


def test_links_that_lead_nowhere_are_no_files(tmp_path: Path) -> None:
    for name, to in (("loop", "loop"), ("dangling", "nothing")):
        (tmp_path / name).symlink_to(to)
        refuses(f"{name}: can't be written", write_file, tmp_path / name, "new")
        assert (tmp_path / name).is_symlink()


# --- records, which say of themselves whether they are as they were written


RECORD = {"program": "mgsgraph", "settings": {"half_window": 12}, "statements": ["grün", "1.5 px"], "none": None}


def test_a_record_comes_back(tmp_path: Path) -> None:
    path = tmp_path / "x.json"
    path.write_text(record_text(RECORD), encoding="utf-8")
    assert read_record(path) == RECORD
    assert json.loads(path.read_text(encoding="utf-8")).items() > RECORD.items()  # any reader of JSON takes it


def test_a_flipped_bit_is_found_wherever_it_is(tmp_path: Path) -> None:
    path, text = tmp_path / "x.json", record_text(RECORD).encode()
    for place in range(len(text)):
        broken = bytearray(text)
        broken[place] ^= 1 << place % 8
        path.write_bytes(broken)
        refuses(r"x\.json", read_record, path)


def test_a_record_from_before_is_taken_as_it_is(tmp_path: Path) -> None:
    for record in (RECORD, {"a": {"b": {"c": []}}}):
        for text in (json.dumps(record, indent=1) + "\n", json.dumps(record)):
            (tmp_path / "x.json").write_text(text, encoding="utf-8")
            assert read_record(tmp_path / "x.json") == record


def test_a_file_that_its_record_knows(tmp_path: Path) -> None:
    network = tmp_path / "network.pvl"
    network.touch()
    (tmp_path / "mine.pvl").touch()
    require_as_recorded(network, b"content")  # beside none
    (tmp_path / MATCH).write_text(record_text({FILES: {"network.pvl": sha256(b"content").hexdigest()}}))
    require_as_recorded(network, b"content")
    require_as_recorded(tmp_path / "mine.pvl", b"other")
    refuses(r"network\.pvl: is damaged, or was changed", require_as_recorded, network, b"contenu")
    later = (tmp_path / MATCH).stat().st_mtime + 60.0
    os.utime(network, (later, later))  # qnet has saved it
    require_as_recorded(network, b"contenu")


# --- results: whatever one holds, the next run may replace


HOUSE = Path(folders.__file__).parents[2]
ROOMS = ("files/output", "matching", "registration", "results", "simulation/demo")
"""That write_result results; `export` says itself what it has made, in export.json."""
FILE = re.compile(r"[a-z_]+\.(json|csv|txt|npz|tif|png|svg)")


def test_every_name_of_a_result_is_known() -> None:
    found = {
        node.value
        for room in ROOMS
        for path in (HOUSE / room).rglob("*.py")
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if isinstance(node, ast.Constant) and isinstance(node.value, str) and FILE.fullmatch(node.value)
    }
    assert not found - set(TABLES)
    assert len(found) > 20


def test_every_kind_of_figure_is_known() -> None:
    """What is handed to `new_sheet` and `sheet_name` by name."""
    found = {
        node.args[0].value
        for path in (HOUSE / "results" / "figures").rglob("*.py")
        # sheets of the page stand in it, those of the studio's views are handed out one by one
        if not path.stem.startswith("page") and not path.stem.endswith("_views")
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if isinstance(node, ast.Call)
        and isinstance(node.func, ast.Name)
        and node.func.id in {"new_sheet", "sheet_name"}
        and isinstance(node.args[0], ast.Constant)
    }
    assert found <= set(FIGURES)
    assert {"residuals", "map", "quantiles"} <= found


def test_a_file_that_could_not_be_replaced_is_told_of(tmp_path: Path) -> None:
    with pytest.warns(UserWarning, match="'jitter.png' is not a name"):
        write_result(tmp_path / "out", ["jitter.png"])
    assert (tmp_path / "out" / "jitter.png").exists()

    figures = [f"{kind}{number}.png" for kind in FIGURES for number in ("", "_1", "_12")]
    write_result(tmp_path / "fine", [*figures, *TABLES])
    require_replaceable(tmp_path / "fine")


def write_result(out: Path, names: list[str]) -> None:
    with fresh_folder(out) as folder:
        for name in names:
            (folder / name).touch()
        (folder / "solution.json").write_text('{"program": "mgsgraph"}', encoding="utf-8")


def test_a_folder_that_cannot_be_written_is_refused_before_any_work(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(path: str, mode: int = 0o777) -> None:
        raise PermissionError(errno.EACCES, "Permission denied", path)

    (tmp_path / "empty").mkdir()
    monkeypatch.setattr(os, "mkdir", refuse)
    for out in (tmp_path / "out", tmp_path / "deep" / "out", tmp_path / "empty"):
        with pytest.raises(InputError) as caught:
            require_replaceable(out)
        assert str(caught.value).startswith(f"{out}: can't be written (Permission denied);")


# --- pages: earlier ones of the same verb are replaced


REPORT, OTHER = "results/templates/report.html", "results/templates/other.html"


def test_pages_are_known_by_the_head_of_the_template(tmp_path: Path) -> None:
    head = (HOUSE / "files/output/templates/page.html").read_text(encoding="utf-8")
    page = tmp_path / "page.html"
    for template, other in ((REPORT, OTHER), (OTHER, REPORT)):
        page.write_text(head.replace("{% block generator %}{% endblock %}", Path(template).stem), encoding="utf-8")
        assert page_of(template).known(page)
        assert not page_of(other).known(page)


def test_other_pages_are_left_alone(tmp_path: Path) -> None:
    page = tmp_path / "index.html"
    page.write_text("<!doctype html><title>Mine</title>", encoding="utf-8")
    for attempt in (lambda: require_report(page), lambda: write_page(REPORT, {}, page)):
        refuses(r"index\.html: exists and is not a page of mgsgraph re.*; choose another", attempt)
    assert "Mine" in page.read_text(encoding="utf-8")


@pytest.mark.parametrize("folder", [False, True])
def test_content_and_names_reach_the_disk_around_the_rename(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, folder: bool
) -> None:
    """A power cut leaves the former or the new result: fsync of all that is new, rename, fsync of the folder."""
    calls, sync, rename = list[str](), os.fsync, os.rename
    target = tmp_path / "result"

    def fsync(descriptor: int) -> None:
        path = os.readlink(f"/proc/self/fd/{descriptor}")
        calls.append("names" if path == str(tmp_path) else "content")
        sync(descriptor)

    def renamed(kind: str, done: Callable[..., object]) -> Callable[..., object]:
        def act(*arguments: object) -> object:
            calls.append(kind)
            return done(*arguments)

        return act

    def write() -> None:
        if folder:
            with fresh_folder(target) as new:
                write_file(new / folders.RECORD, record_text({"program": folders.PROGRAM}))
                write_file(new / next(iter(TABLES)), "1")
        else:
            write_file(target, "content")

    monkeypatch.setattr(os, "fsync", fsync)
    monkeypatch.setattr(os, "rename", renamed("rename", rename))
    monkeypatch.setattr(os, "replace", renamed("rename", os.replace))
    monkeypatch.setattr(atomic_write, "_exchanged", renamed("rename", atomic_write._exchanged))
    for _ in range(2):  # a first result, and one that replaces it
        calls.clear()
        write()
        last = len(calls) - calls[::-1].index("rename") - 1
        assert "content" in calls[:last]
        assert calls[last + 1 :] == ["names"]
        if folder:
            assert calls[:last].count("content") == 3  # two files and the names of both

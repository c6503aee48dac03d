"""What is made aside is gone when its process is, and nothing but an earlier output of its kind is replaced."""

import os
import signal
import tempfile
from collections.abc import Callable
from contextlib import AbstractContextManager
from pathlib import Path

import pytest

from mgsgraph.atomic_write import beside, is_aside, made_beside, scratch, sweep
from mgsgraph.errors import InputError
from mgsgraph.files.writing import begins, claimed, fresh_file, require_free, require_writable, write_file


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


def test_a_living_process_without_an_exchange_is_left_alone(tmp_path: Path) -> None:
    """Its earlier result has stepped aside; the new one is about to take its place."""
    with made_beside(tmp_path / "out", folder=True) as place:
        old = place.with_suffix(".replaced")
        old.mkdir()
        sweep(tmp_path)
        assert names(tmp_path) == sorted([place.name, old.name])


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


def test_scratch_is_private_from_the_beginning(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A folder that others may enter for a moment could be entered in it."""
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    modes = list[int]()
    monkeypatch.setattr(Path, "chmod", lambda self, mode: modes.append(self.stat().st_mode & 0o777))
    with scratch() as place:
        modes.append(place.stat().st_mode & 0o777)
    assert set(modes) == {0o700}


def test_scratch_of_a_killed_process_goes_with_the_next(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    killed_within(scratch)
    assert len(names(tmp_path)) == 1
    with scratch() as place:
        assert place.stat().st_mode & 0o777 == 0o700
        assert names(tmp_path) == [place.name]
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


def test_names_of_asides() -> None:
    assert is_aside(beside(Path("a/b.txt")).name)
    assert not is_aside("b.txt")


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
        with pytest.raises(InputError, match=r"thesis\.tex: exists and is not a table of ours; choose another name"):
            attempt()
    assert path.read_bytes() == content
    assert names(tmp_path) == ["thesis.tex"]


def test_a_file_that_appears_meanwhile_is_kept(tmp_path: Path) -> None:
    path = tmp_path / "out"

    def write() -> None:
        with fresh_file(path, over=TABLE) as place:
            place.write_text("id,value")
            path.write_text("somebody else's")

    with pytest.raises(InputError, match="not a table of ours"):
        write()
    assert path.read_text() == "somebody else's"
    assert names(tmp_path) == ["out"]


def test_links_that_lead_nowhere_are_no_files(tmp_path: Path) -> None:
    for name, to in (("loop", "loop"), ("dangling", "nothing")):
        (tmp_path / name).symlink_to(to)
        with pytest.raises(InputError, match=f"{name}: can't be written"):
            write_file(tmp_path / name, "new")
        assert (tmp_path / name).is_symlink()

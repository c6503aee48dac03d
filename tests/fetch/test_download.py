"""Downloads from a server with faults: each ends in the whole file or in one line, and nothing comes twice."""

import errno
import json
import os
import shutil
import socket
import threading
from dataclasses import asdict
from pathlib import Path
from typing import Any

import flaky_archive
import numpy as np
import pytest
from flaky_archive import (
    Flaky,
    cut,
    daf,
    elsewhere,
    endless,
    longer,
    redirect,
    said_length,
    some_at_a_time,
    stall,
    status,
    web_page,
)
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from mgsgraph.errors import InputError
from mgsgraph.fetch import download as parts
from mgsgraph.fetch.download import NotInArchive, Remote, RemoteSource, RetryPolicy
from mgsgraph.fetch.store import require_content

CONTENT = np.random.default_rng(1).bytes(200_000)
NAME = "spk/big.img"
QUICK = RetryPolicy(tries=4, first_wait=0.001, longest_wait=0.01, connecting=20.0, reading=20.0)


@pytest.fixture
def archive(archive_server: Flaky) -> Flaky:
    """Holding one file."""
    return archive_server.reset({NAME: CONTENT})


def nothing(path: Path) -> None:
    pass


def bring(archive: Flaky, folder: Path, retry: RetryPolicy = QUICK) -> None:
    """The one file to folder/big.img."""
    remote = Remote(retry)
    try:
        remote.download(archive.url(NAME), folder / "big.img", nothing)
    finally:
        remote.close()


def whole(folder: Path, content: bytes = CONTENT) -> bool:
    """Whether the file is there, and nothing else."""
    return (folder / "big.img").read_bytes() == content and [one.name for one in folder.iterdir()] == ["big.img"]


def said(error: pytest.ExceptionInfo[InputError]) -> str:
    text = str(error.value)
    assert "\n" not in text
    assert NAME in text or "big.img" in text
    return text


def test_a_cut_connection_is_taken_up_where_it_broke_off(archive: Flaky, tmp_path: Path) -> None:
    archive.faults[NAME] += [cut(70_000), cut(30_000)]
    bring(archive, tmp_path)
    assert whole(tmp_path)
    assert archive.requests(NAME) == [None, "bytes=70000-", "bytes=100000-"]
    assert archive.sent[NAME] == len(CONTENT)  # not a byte twice
    assert len(archive.conditions) == 2
    assert len(set(archive.conditions)) == 1  # if it is still the same


def test_a_server_that_gives_some_bytes_at_a_time(archive: Flaky, tmp_path: Path) -> None:
    archive.stays[NAME] = some_at_a_time(60_000)
    bring(archive, tmp_path)
    assert whole(tmp_path)
    assert len(archive.asked) == 4


@pytest.mark.parametrize("by", [-5, 5])
def test_a_server_that_gives_another_range(archive: Flaky, tmp_path: Path, by: int) -> None:
    archive.faults[NAME] += [cut(70_000), elsewhere(by)]
    bring(archive, tmp_path)
    assert whole(tmp_path)
    assert archive.requests(NAME) == [None, "bytes=70000-", None]


@settings(max_examples=25, suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow])
@given(cuts=st.lists(st.integers(0, 60_000), max_size=6), ranges=st.booleans(), validators=st.booleans())
def test_any_cuts_end_in_the_same_bytes(
    archive: Flaky, tmp_path: Path, cuts: list[int], ranges: bool, validators: bool
) -> None:
    folder = tmp_path / "any"
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir()
    archive.faults[NAME].clear()
    archive.ranges, archive.validators = ranges, validators
    archive.faults[NAME] += [cut(after) for after in cuts]
    bring(archive, folder, RetryPolicy(8, 0.0, 0.0, 20.0, 20.0))
    assert whole(folder)


def test_an_interrupted_run_is_taken_up_by_the_next(archive: Flaky, tmp_path: Path) -> None:
    archive.faults[NAME].append(cut(50_000))
    archive.faults[NAME] += [status(503)] * QUICK.tries
    with pytest.raises(InputError) as error:
        bring(archive, tmp_path)
    assert "503" in said(error)
    assert f"{QUICK.tries} times in a row" in said(error)
    assert sorted(one.name for one in tmp_path.iterdir()) == ["big.img.part", "big.img.part.json"]
    archive.asked.clear()
    archive.sent.clear()
    bring(archive, tmp_path)
    assert whole(tmp_path)
    assert archive.requests(NAME) == ["bytes=50000-"]
    assert archive.sent[NAME] == len(CONTENT) - 50_000


def test_a_part_that_is_whole_is_not_fetched(archive: Flaky, tmp_path: Path) -> None:
    """Killed after the last byte, before the file took its place."""
    (tmp_path / "big.img.part").write_bytes(CONTENT)
    entry = {"url": archive.url(NAME), "total": len(CONTENT), "etag": '"a"', "modified": ""}
    (tmp_path / "big.img.part.json").write_text(json.dumps(entry))
    bring(archive, tmp_path)
    assert whole(tmp_path)
    assert not archive.asked


@pytest.mark.parametrize("left", [
    b"", b"{", b"[]", b"\xff", {"total": True}, {"etag": 5}, {"modified": None}, {"url": ["x"]}, {"more": 1},
])  # fmt: skip
def test_a_part_that_says_nothing_is_begun_anew(archive: Flaky, tmp_path: Path, left: Any) -> None:
    if isinstance(left, dict):
        left = json.dumps(asdict(RemoteSource(archive.url(NAME), len(CONTENT), "", "")) | left).encode()
    (tmp_path / "big.img.part").write_bytes(b"something else")
    (tmp_path / "big.img.part.json").write_bytes(left)
    bring(archive, tmp_path)
    assert whole(tmp_path)
    assert archive.requests(NAME) == [None]


@pytest.mark.parametrize("code", [429, 500, 502, 503, 504])
def test_a_server_that_is_busy_is_asked_again(archive: Flaky, tmp_path: Path, code: int) -> None:
    archive.faults[NAME] += [status(code), status(code, Retry_After="0")]
    bring(archive, tmp_path)
    assert whole(tmp_path)
    assert len(archive.asked) == 3


def test_a_server_that_wants_an_hour_is_not_waited_for(archive: Flaky, tmp_path: Path) -> None:
    archive.stays[NAME] = status(503, Retry_After="3600")
    with pytest.raises(InputError, match="come back in 3600 s"):
        bring(archive, tmp_path)
    assert len(archive.asked) == 1


def test_waits_grow(archive: Flaky, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    waits: list[float] = []

    def wait(event: threading.Event, seconds: float | None = None) -> bool:
        waits.append(seconds or 0.0)
        return False

    monkeypatch.setattr(threading.Event, "wait", wait)
    archive.faults[NAME] += [status(503)] * 4 + [cut(1000), status(503), status(503, Retry_After="7")]
    bring(archive, tmp_path, RetryPolicy(tries=9, first_wait=1.0, longest_wait=20.0))
    # a byte more begins the count anew, and the server's own word counts
    assert [wait for wait in waits if wait >= 1.0] == [1.0, 2.0, 4.0, 8.0, 1.0, 1.0, 7.0]


@pytest.mark.parametrize("ranges", [True, False])
def test_fewer_bytes_than_announced(archive: Flaky, tmp_path: Path, ranges: bool) -> None:
    archive.ranges = ranges
    archive.stays[NAME] = longer(100)
    with pytest.raises(InputError, match="times in a row") as error:
        bring(archive, tmp_path)
    said(error)
    assert not (tmp_path / "big.img").exists()
    archive.stays.clear()
    bring(archive, tmp_path)
    assert whole(tmp_path)


@pytest.mark.parametrize(("validators", "knows"), [(True, True), (False, True), (True, False)])
def test_content_that_changes_between_parts(archive: Flaky, tmp_path: Path, validators: bool, knows: bool) -> None:
    """On servers that have validators or not, and know If-Range or not."""
    archive.validators, other = validators, CONTENT[::-1]

    def change(handler: flaky_archive.Handler, content: bytes) -> None:
        handler.serve(content, cut=80_000)
        archive.files[NAME] = other

    def ignorant(handler: flaky_archive.Handler, content: bytes) -> None:
        del handler.headers["If-Range"]
        handler.serve(content)

    archive.faults[NAME] += [change] if knows else [change, ignorant]
    bring(archive, tmp_path)
    assert whole(tmp_path, other)


def test_content_that_has_changed_since_the_last_run(archive: Flaky, tmp_path: Path) -> None:
    archive.faults[NAME].append(cut(80_000))
    archive.faults[NAME] += [status(503)] * QUICK.tries
    with pytest.raises(InputError):
        bring(archive, tmp_path)
    archive.files[NAME] = other = CONTENT[:1000]  # shorter than the part
    bring(archive, tmp_path)
    assert whole(tmp_path, other)


def test_a_stalled_server(archive: Flaky, tmp_path: Path) -> None:
    over = threading.Event()
    archive.faults[NAME].append(stall(90_000, over))
    bring(archive, tmp_path, RetryPolicy(3, 0.001, 0.01, 10.0, 0.5))
    over.set()
    assert whole(tmp_path)
    assert archive.requests(NAME) == [None, "bytes=90000-"]


@pytest.mark.parametrize(("code", "kind"), [(404, NotInArchive), (403, InputError)])
def test_a_missing_or_forbidden_file(archive: Flaky, tmp_path: Path, code: int, kind: type[InputError]) -> None:
    archive.stays[NAME] = status(code)
    with pytest.raises(kind, match=str(code)) as error:
        bring(archive, tmp_path)
    said(error)
    assert len(archive.asked) == 1
    assert not list(tmp_path.iterdir())


def test_a_redirect(archive: Flaky, tmp_path: Path) -> None:
    """Whose own content may have no end, or unpack to one that has none: it is not read."""
    archive.files["moved/here"] = CONTENT
    archive.stays[NAME] = endless(b"x" * 65536, 302, Location=archive.url("moved/here"), Content_Encoding="gzip")
    archive.faults["moved/here"].append(cut(80_000))
    bring(archive, tmp_path)
    assert whole(tmp_path)
    assert archive.requests("moved/here") == [None, "bytes=80000-"]


def test_redirects_without_end(archive: Flaky, tmp_path: Path) -> None:
    archive.stays[NAME] = redirect(archive.url("elsewhere"))
    archive.stays["elsewhere"] = redirect(archive.url(NAME))
    with pytest.raises(InputError, match="more than 10 redirects") as error:
        bring(archive, tmp_path)
    said(error)
    assert len(archive.asked) < 15


def test_a_port_where_nobody_listens(tmp_path: Path) -> None:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))  # bound, and never listened on
        nobody = Flaky(address=f"http://127.0.0.1:{taken.getsockname()[1]}")
        with pytest.raises(InputError, match=r"can't be reached \(.*refused") as error:
            bring(nobody, tmp_path)
    said(error)
    assert not list(tmp_path.iterdir())


def test_content_that_is_refused_leaves_what_was_there(archive: Flaky, tmp_path: Path) -> None:
    (tmp_path / "big.img").write_bytes(b"earlier")

    def refuse(path: Path) -> None:
        raise InputError("x", "nonsense", "sense")

    archive.faults[NAME].append(web_page)
    remote = Remote(QUICK)
    with pytest.raises(InputError, match="nonsense; expected sense; try later") as error:
        remote.download(archive.url(NAME), tmp_path / "big.img", refuse)
    remote.close()
    said(error)
    assert whole(tmp_path, b"earlier")


def test_a_full_disk(archive: Flaky, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "big.img").write_bytes(b"earlier")
    real = parts._write

    def full(path: Path, how: int, content: bytes) -> None:
        if how == os.O_APPEND:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        real(path, how, content)

    monkeypatch.setattr(parts, "_write", full)
    with pytest.raises(InputError, match=r"No space left on device.*free some space") as error:
        bring(archive, tmp_path)
    said(error)
    assert len(archive.asked) == 1  # it is no fault of the server's
    monkeypatch.undo()
    assert (tmp_path / "big.img").read_bytes() == b"earlier"
    bring(archive, tmp_path)
    assert whole(tmp_path)


def test_a_disk_that_will_be_full(archive: Flaky, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    usage = shutil.disk_usage(tmp_path)
    monkeypatch.setattr(parts.shutil, "disk_usage", lambda path: usage._replace(free=100_000))
    with pytest.raises(InputError, match=r"0\.1 MB free on the disk; expected 0\.2 MB") as error:
        bring(archive, tmp_path)
    said(error)
    assert archive.sent[NAME] <= len(CONTENT)
    assert not list(tmp_path.iterdir())


def test_heads_and_listings(archive: Flaky) -> None:
    remote = Remote(QUICK)
    archive.faults[NAME].append(status(503))
    assert remote.head(archive.url(NAME), 100) == CONTENT[:100]
    assert '"big.img"' in remote.listing(archive.url("spk/"))
    assert remote.listing(archive.url("none/")) == ""
    with pytest.raises(NotInArchive):
        remote.head(archive.url("none"), 100)
    archive.ranges = False
    assert remote.head(archive.url(NAME), 100) == CONTENT[:100]
    archive.files["empty"] = b""
    assert remote.head(archive.url("empty"), 100) == b""
    remote.close()


PAGE = b"<!DOCTYPE html><html><body>Down for maintenance</body></html>"


@pytest.mark.parametrize(
    ("name", "good", "bad"),
    [
        ("kernels/a.bsp", daf("SPK"), [PAGE, daf("CK"), daf("SPK")[:-1], b""]),
        ("kernels/a.bc", daf("CK"), [PAGE, daf("SPK"), b"DAF/CK"]),
        ("kernels/a.tls", flaky_archive.SPICE_TEXT, [PAGE, b"KPL/LSK cut"]),
        ("pedr/ap10717l.b", flaky_archive.pedr("1999-05-06T00:00:00", "1999-05-07T00:00:00"), [PAGE, bytes(776)]),
        ("megdr/a.lbl", flaky_archive.label(A="1"), [PAGE, b"nothing"]),
        ("megdr/a.img", bytes(100), [PAGE, bytes(101), b""]),
        ("index/a.tab", b'"MOC-NA"', [PAGE, b""]),
        (
            "images/m0402852.imq", flaky_archive.image("M04/02852", "1999-08-24T14:12:13", "1999-08-24T14:12:19"),
            [PAGE, flaky_archive.image("M04/02852", "1999-08-24T14:12:13", "1999-08-24T14:12:19")[:-1], b"\0" * 4096],
        ),
    ],
)  # fmt: skip
def test_contents_are_what_names_promise(tmp_path: Path, name: str, good: bytes, bad: list[bytes]) -> None:
    path = tmp_path / Path(name).name
    path.write_bytes(good)
    require_content(path, name)
    for content in bad:
        path.write_bytes(content)
        with pytest.raises(InputError) as error:
            require_content(path, name)
        assert "\n" not in str(error.value)


def test_the_real_image_is_whole_by_its_label(shared_data: Path) -> None:
    require_content(shared_data / "mgs_moc_pair" / "M0100115.imq", "images/m0100115.imq")
    for name in ("moc20.ti", "pck00009.tpc", "naif0012.tls", "MGS_SCLKSCET.00061.tsc", "m0402852.ale_1.bsp",
                 "mgs_sc_map2_1_sliced_-94000.bc"):  # fmt: skip
        require_content(shared_data / "mgs_moc_m0402852" / name, f"kernels/{name}")


# --- a hostile archive, and a hostile folder


def test_an_endless_file_is_not_brought(archive: Flaky, tmp_path: Path) -> None:
    """Neither one that says how long it is nor one that doesn't, which is cut off where a file of its kind ends."""
    remote = Remote(QUICK)
    with pytest.raises(InputError, match=r"a file of 0 MB; expected at most 0 MB of one of its kind"):
        remote.download(archive.url(NAME), tmp_path / "big.img", nothing, limit=len(CONTENT) - 1)
    assert not list(tmp_path.iterdir())
    archive.stays[NAME] = endless(CONTENT)
    with pytest.raises(InputError, match="a file of no end; expected at most 1 MB"):
        remote.download(archive.url(NAME), tmp_path / "big.img", nothing, limit=1_000_000)
    assert not list(tmp_path.iterdir())
    archive.stays.clear()
    remote.download(archive.url(NAME), tmp_path / "big.img", nothing, limit=len(CONTENT))
    assert whole(tmp_path)
    remote.close()


@pytest.mark.parametrize(
    "to", ["http://[::1", "//", "file:///etc/passwd", "http://name:word@127.0.0.1/x", "http://\x7f/"]
)  # fmt: skip
def test_a_redirect_to_what_is_no_address(archive: Flaky, tmp_path: Path, to: str) -> None:
    archive.stays[NAME] = redirect(to)
    with pytest.raises(InputError, match=r"big\.img"):
        bring(archive, tmp_path, QUICK)
    assert not list(tmp_path.iterdir())


def test_lengths_that_are_no_numbers(archive: Flaky, tmp_path: Path) -> None:
    for said in ("9" * 5000, "-1", "\u0663", "1e3"):
        archive.faults[NAME].append(said_length(said))
        bring(archive, tmp_path)
        assert whole(tmp_path)
        (tmp_path / "big.img").unlink()


@pytest.mark.parametrize("linked", ["big.img.part", "big.img.part.json", "big.img"])
@pytest.mark.parametrize("hard", [False, True])
def test_planted_links_lead_nowhere(archive: Flaky, tmp_path: Path, linked: str, hard: bool) -> None:
    folder, victim = tmp_path / "folder", tmp_path / "victim"
    folder.mkdir()
    victim.write_bytes(b"precious")
    source = RemoteSource(archive.url(NAME), len(CONTENT), "", "")
    if linked != "big.img.part.json":
        (folder / "big.img.part.json").write_text(json.dumps(asdict(source)))
    if linked != "big.img.part":
        (folder / "big.img.part").write_bytes(CONTENT[:10])
    (folder / linked).unlink(missing_ok=True)
    (os.link if hard else os.symlink)(victim, folder / linked)
    bring(archive, folder)
    assert whole(folder)
    assert victim.read_bytes() == b"precious"
    assert not (folder / "big.img").is_symlink()


def test_a_weak_etag_is_no_condition() -> None:
    """RFC 9110, 13.1.5: bytes of two files with one weak ETag may differ."""
    date = "Sat, 28 Nov 2026 07:28:00 GMT"
    assert RemoteSource("u", 3, '"a"', date).validator == '"a"'
    assert RemoteSource("u", 3, 'W/"a"', date).validator == date
    assert RemoteSource("u", 3, 'W/"a"', "").validator == ""

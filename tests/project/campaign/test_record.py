"""The record of a campaign is true after whatever happened to it."""

import os
import sys
from pathlib import Path
from typing import Any

import pytest

from mgsgraph.errors import InputError
from mgsgraph.project.campaign.record import RECORD, CampaignEntry, Overrides, open_record


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
    with pytest.raises(InputError, match=said):
        open_record(tmp_path)
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
    with pytest.raises(InputError, match="is no file"):
        open_record(tmp_path)


def test_foreign_folders_are_refused(tmp_path: Path) -> None:
    (tmp_path / "thesis.txt").write_text("years of work", encoding="utf-8")
    with pytest.raises(InputError, match=r"has no campaign\.jsonl; expected an absent or empty folder"):
        open_record(tmp_path)
    with pytest.raises(InputError, match="exists and is a file"):
        open_record(tmp_path / "thesis.txt")
    assert [path.name for path in tmp_path.iterdir()] == ["thesis.txt"]


@pytest.mark.skipif(sys.platform == "win32", reason="no locks there")
def test_one_campaign_at_a_time(tmp_path: Path) -> None:
    with open_record(tmp_path) as record:
        record.append(entry())
        with pytest.raises(InputError, match="another campaign is writing here"):
            open_record(tmp_path)
    with open_record(tmp_path) as record:
        assert record.entries


def test_a_full_disk_leaves_whole_lines(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write = os.write
    with open_record(tmp_path) as record:
        record.append(entry("a.toml"))
        monkeypatch.setattr(os, "write", lambda descriptor, text: write(descriptor, text[:40]))
        with pytest.raises(InputError, match="disk is full"):
            record.append(entry("b.toml"))
        monkeypatch.setattr(os, "write", write)
        record.append(entry("c.toml"))
    with open_record(tmp_path) as record:
        assert list(record.entries) == ["a.toml", "c.toml"]

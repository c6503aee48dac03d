"""A record says of itself whether it is as it was written."""

import json
import os
from hashlib import sha256
from pathlib import Path

import pytest

from mgsgraph.errors import InputError
from mgsgraph.files.writing import FILES, MATCH, read_record, record_text, require_as_recorded

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
        with pytest.raises(InputError, match=r"x\.json"):
            read_record(path)


@pytest.mark.parametrize("record", [RECORD, {"a": [1, 2]}, {"a": {"b": {"c": []}}}, {"a": 1}])
def test_a_record_from_before_is_taken_as_it_is(tmp_path: Path, record: dict[str, object]) -> None:
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
    with pytest.raises(InputError, match=r"network\.pvl: is damaged, or was changed"):
        require_as_recorded(network, b"contenu")
    later = (tmp_path / MATCH).stat().st_mtime + 60.0
    os.utime(network, (later, later))  # qnet has saved it
    require_as_recorded(network, b"contenu")

"""The door: only regular files of a bearable size come in, and what damages their parsers is one clear line."""

import gzip
import os
import socket
import struct
import zlib
from collections.abc import Callable
from pathlib import Path

import msgspec
import pytest

from mgsgraph.errors import InputError, printable
from mgsgraph.files.decoding import read_toml, toml_table, validated
from mgsgraph.files.opening import (
    head_of,
    json_object,
    name_of,
    number_of,
    opened,
    read_bytes,
    read_json,
    read_text,
    understood,
    unpacked_gzip,
)


def a_pipe(path: Path) -> None:
    os.mkfifo(path)


def a_socket(path: Path) -> None:
    with socket.socket(socket.AF_UNIX) as one:
        one.bind(os.path.relpath(path))


def a_loop(path: Path) -> None:
    path.symlink_to(path)


def a_device(path: Path) -> None:
    path.symlink_to("/dev/zero")


@pytest.mark.parametrize("made", [a_pipe, a_socket, a_loop, a_device, Path.mkdir])
@pytest.mark.parametrize("read", [read_bytes, read_text, read_json, lambda path: head_of(path, 10)])
def test_what_is_no_file_is_refused_at_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, made: Callable[[Path], None], read: Callable[[Path], object]
) -> None:
    monkeypatch.chdir(tmp_path)
    made(tmp_path / "x.json")
    with pytest.raises(InputError) as caught:
        read(tmp_path / "x.json")
    assert caught.value.where == str(tmp_path / "x.json")


def test_a_size_is_compared_before_anything_is_read(tmp_path: Path) -> None:
    path = tmp_path / "sparse"
    with path.open("wb") as file:
        file.truncate(1 << 40)
    with pytest.raises(InputError):
        read_bytes(path)
    with pytest.raises(InputError), opened(path, 1 << 39):
        pass
    assert head_of(path, 3) == b"\0\0\0"


def test_files_that_do_not_say_how_long_they_are_are_read_to_the_limit() -> None:
    assert b"Name:" in read_bytes(Path("/proc/self/status"))
    with pytest.raises(InputError):
        read_bytes(Path("/proc/self/status"), limit=10)


@pytest.mark.parametrize("name", ["a\0b", "\ud800", "x" * 300])
def test_names_that_no_file_can_have_are_input_errors(name: str) -> None:
    with pytest.raises(InputError):
        read_bytes(Path(name))


@pytest.mark.parametrize(
    "raised",
    [ValueError("x"), KeyError("x"), TypeError("x"), RecursionError("x"), struct.error("x"), zlib.error("x"),
     EOFError(), OverflowError("x"), UnicodeDecodeError("utf-8", b"x", 0, 1, "no")],
)  # fmt: skip
def test_what_parsers_raise_is_one_line_with_the_file(raised: Exception) -> None:
    with pytest.raises(InputError, match=r"^a\.img") as caught, understood("a.img", "an image"):
        raise raised
    assert caught.value.__cause__ is raised  # for whoever looks for a fault of ours


def test_too_little_memory_is_no_damage() -> None:
    with pytest.raises(MemoryError), understood("a.img", "an image"):
        raise MemoryError


def test_other_errors_are_the_programs_own() -> None:
    with pytest.raises(AssertionError), understood("a.img", "an image"):
        raise AssertionError
    with pytest.raises(InputError, match=r"^mine"), understood("a.img", "an image"):
        raise InputError("mine", "this")


@pytest.mark.parametrize(
    "text",
    ["[" * 1200 + "]" * 1200, '{"a":' * 1200 + "1" + "}" * 1200, '{"a":' + "[0," * 101 + "0" + "]" * 101 + "}",
     '{"a": 1e999}', '{"a": ' + "9" * 5000 + "}", '{"a": ' + "9" * 30 + "}", '{"a": NaN}', '{"a": 1, "a": 2}',
     '{"a": 1', "[]", b'{"\xff": 1}'],
)  # fmt: skip
def test_json_that_no_reader_should_see(text: str | bytes) -> None:
    with pytest.raises(InputError, match=r"^x\.json"):
        json_object(text, "x.json")


def test_json_of_the_field_is_as_it_was() -> None:
    assert json_object('{"a": [1, 2.5, {"b": -9223372036854775808}]}', "x") == {"a": [1, 2.5, {"b": -(1 << 63)}]}


@pytest.mark.parametrize(
    "text",
    ['"a".' * 20_000 + "a = 1", "a." * 20_000 + "a = 1", "a = " + "[" * 1200 + "]" * 1200, "a = " + "9" * 5000,
     "a = " + "{b = " * 1200 + "1" + "}" * 1200, "a = " + "9" * 30, "[" + "a . " * 30 + "a]"],
)  # fmt: skip
def test_toml_that_takes_all_memory_or_the_stack(text: str) -> None:
    with pytest.raises(InputError, match=r"^x\.toml"):
        toml_table(text, "x.toml")


def test_toml_that_only_looks_deep() -> None:
    assert toml_table('a = "../../../../../../../../../../../../../../../../../../../../../../x"', "x")
    text = "a = [[1, 2], [3, 4]]\nb.c.d = inf\n" + "[[e]]\n[[f]]\n" * 200
    assert toml_table(text, "x")["b"]["c"]["d"] == float("inf")


def test_an_endless_toml_is_not_read(tmp_path: Path) -> None:
    path = tmp_path / "a.toml"
    with path.open("wb") as file:
        file.truncate(1 << 30)
    with pytest.raises(InputError):
        read_toml(path, "case file")


def test_gzip_is_unpacked_to_a_limit() -> None:
    packed = gzip.compress(b"a" * 1000) + gzip.compress(b"b" * 1000) + b"\0" * 7
    assert unpacked_gzip(packed, "x.gz") == b"a" * 1000 + b"b" * 1000
    for limit, content in ((1999, packed), (4000, packed[:-20]), (4000, packed[:30] + b"?" + packed[31:])):
        with pytest.raises(InputError):
            unpacked_gzip(content, "x.gz", limit)


@pytest.mark.parametrize("name", ["", "\x1b[2J", "a\nb", "a\u202eb", "a" * 501, "\udc80"])
def test_names_with_control_characters_are_refused(name: str) -> None:
    with pytest.raises(InputError):
        name_of(name, "x")
    assert printable(name) == name or not name.isprintable()
    assert printable(name).isprintable()


def test_errors_are_one_printable_line_of_bearable_length() -> None:
    error = InputError("a\x1b[31m\n" * 1000, "b\u202e" * 1000, "c\udc80" * 1000, "d\x07" * 1000).within("e\r" * 1000)
    assert str(error).isprintable()
    assert str(error).isascii()
    assert len(str(error)) < 3500
    assert str(InputError("é/äöü.cub", "no label")) == "é/äöü.cub: no label"


@pytest.mark.parametrize("text", ["9" * 1_000_000 + "x", "." + "9" * 1_000_000 + "x", "1." + "0" * 1_000_000 + "x"])
def test_a_number_of_a_million_digits_is_refused_at_once(text: str) -> None:
    with pytest.raises(InputError) as caught:  # by the square of its length otherwise: hours
        number_of(text, "x")
    assert len(str(caught.value)) < 200


def test_a_bomb_is_known_by_how_much_it_packs() -> None:
    with pytest.raises(InputError):
        unpacked_gzip(gzip.compress(bytes(1 << 26)), "x.gz")


class _Settings(msgspec.Struct):
    sigma: float


def test_a_number_in_quotation_marks_is_a_text(tmp_path: Path) -> None:
    path = tmp_path / "a.toml"
    for text, good in (("sigma = 1", True), ('sigma = "1"', False), ("sigma = true", False)):
        path.write_text(f"format = 1\n{text}", encoding="utf-8")
        given = read_toml(path, "settings")
        del given.tables["format"]
        if good:
            assert validated(given, _Settings, path).sigma == 1.0
        else:
            with pytest.raises(InputError, match="line 2"):
                validated(given, _Settings, path)

"""Reading text and JSON with errors that name the file and the place."""

import json
from pathlib import Path
from typing import Any

from mgsgraph.errors import InputError


def read_text(path: Path) -> str:
    """The whole of a UTF-8 text file; InputError when it is missing, unreadable or not text."""
    try:
        return path.read_text(encoding="utf-8-sig")
    except FileNotFoundError:
        raise InputError(str(path), "no such file", remedy="check the path; a case file's are relative to it") from None
    except IsADirectoryError:
        raise InputError(str(path), "a folder", "a file") from None
    except UnicodeDecodeError as error:
        raise InputError(str(path), f"byte {error.start} is not UTF-8 text", "a text file") from None
    except OSError as error:
        raise InputError(str(path), f"can't be read ({error.strerror})") from None


def read_bytes(path: Path) -> bytes:
    """The whole of a file; InputError when it is missing or can't be read."""
    try:
        return path.read_bytes()
    except FileNotFoundError:
        raise InputError(str(path), "no such file", remedy="check the path; a case file's are relative to it") from None
    except IsADirectoryError:
        raise InputError(str(path), "a folder", "a file") from None
    except OSError as error:
        raise InputError(str(path), f"can't be read ({error.strerror})") from None


def read_json(path: Path) -> dict[str, Any]:
    """A JSON object; InputError with line and column when it is malformed, truncated, or holds NaN."""

    def refuse(constant: str) -> float:
        raise InputError(str(path), f"the value {constant}", "finite numbers")

    try:
        value = json.loads(read_text(path), parse_constant=refuse)
    except json.JSONDecodeError as error:
        place = f"{path}, line {error.lineno}, column {error.colno}"
        raise InputError(place, f"malformed or truncated JSON ({error.msg})", remedy="write the file anew") from None
    except RecursionError:
        raise InputError(str(path), "JSON nested too deeply", "image support data") from None
    if not isinstance(value, dict):
        raise InputError(str(path), f"a JSON {type(value).__name__}", "a JSON object")
    return value


_LARGEST = 1e300


class Fields:
    """A mapping out of a file whose look-ups raise InputError with the key's full path."""

    def __init__(self, values: dict[str, Any], where: str) -> None:
        self._values, self.where = values, where

    def __contains__(self, key: str) -> bool:
        return key in self._values

    def _get(self, key: str, expected: str) -> Any:
        if key not in self._values:
            raise InputError(self.where, f"no key {key!r}", expected)
        return self._values[key]

    def _wrong(self, key: str, value: object, expected: str) -> InputError:
        return InputError(f"{self.where}, {key}", f"{str(value)[:60]!r}", expected)

    def section(self, key: str) -> "Fields":
        """A nested object."""
        value = self._get(key, "an object")
        if not isinstance(value, dict):
            raise self._wrong(key, value, "an object")
        return Fields(value, f"{self.where}, {key}")

    def sections(self, key: str) -> list["Fields"]:
        """A list of objects."""
        value = self._get(key, "a list of objects")
        if not isinstance(value, list) or not all(isinstance(item, dict) for item in value):
            raise self._wrong(key, value, "a list of objects")
        return [Fields(item, f"{self.where}, {key}[{k}]") for k, item in enumerate(value)]

    def number(self, key: str) -> float:
        """A finite number."""
        value = self._get(key, "a number")
        if not _fits(value, ()):
            raise self._wrong(key, value, "a finite number")
        return float(value)

    def positive(self, key: str) -> float:
        """A number above zero."""
        value = self.number(key)
        if value <= 0.0:
            raise self._wrong(key, value, "a number above zero")
        return value

    def count(self, key: str) -> int:
        """A whole number above zero."""
        value = self._get(key, "a whole number")
        if isinstance(value, bool) or not isinstance(value, int) or value < 1:
            raise self._wrong(key, value, "a whole number above zero")
        return value

    def text(self, key: str) -> str:
        """A string that is not empty."""
        value = self._get(key, "a string")
        if not isinstance(value, str) or not value:
            raise self._wrong(key, value, "a string")
        return value

    def numbers(self, key: str, *shape: int | None) -> list[Any]:
        """A (nested) list of finite numbers of the given shape, None standing for any length above zero."""
        value = self._get(key, "a list of numbers")
        if not _fits(value, shape):
            want = " x ".join("n" if size is None else str(size) for size in shape)
            raise self._wrong(key, value, f"{want} finite numbers")
        return list(value)

    def mapping(self, key: str) -> dict[str, Any]:
        """A nested object as it stands, for keys that vary."""
        value = self._get(key, "an object")
        if not isinstance(value, dict):
            raise self._wrong(key, value, "an object")
        return value


def _fits(value: object, shape: tuple[int | None, ...]) -> bool:
    if not shape:
        # magnitudes beyond 1e300 are no measurements, and whole numbers may be too large for a float altogether
        return isinstance(value, int | float) and not isinstance(value, bool) and -_LARGEST < value < _LARGEST
    if not isinstance(value, list) or not value or shape[0] not in (None, len(value)):
        return False
    return all(_fits(item, shape[1:]) for item in value)

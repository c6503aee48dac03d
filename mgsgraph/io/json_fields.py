"""Look-ups in JSON objects out of a file, with errors that name the key's full path."""

from typing import Any

from mgsgraph.errors import InputError

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

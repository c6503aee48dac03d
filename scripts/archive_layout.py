"""Every array that a solution.npz may hold: its path, type, shape, unit and meaning, from the records themselves.

    python scripts/archive_layout.py            # as a table
    python scripts/archive_layout.py --page     # writes docs/solution_npz.md

The archive takes the record `Solution` apart (`mgsgraph.results.archive`), so what an array means is what stands
under the record's field in the source.
"""

import argparse
import re
import types
from collections.abc import Iterator, Mapping
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any, NamedTuple, Union, get_args, get_origin, get_type_hints

from mgsgraph.adjustment.solution import Solution
from mgsgraph.record import meanings
from mgsgraph.results.archive import FORMAT, array_scalar, kinds_of

PAGE = Path(__file__).resolve().parents[1] / "docs" / "solution_npz.md"
HEAD = "| array | numbers | unit | meaning |"
GROUPS = ("", "network", "network.images.*", "network.points", "network.rays", "network.ranges", "network.surface",
          "network.passes.*", "network.stereo", "network.crossovers", "joint_covariance")  # fmt: skip
"""Paths of records whose arrays have a table of their own; the longest one counts."""
_SHAPE = re.compile(r"(\([^()]*(?:\([^()]*\))?[^()]*\))[:,]? *")
_UNIT = re.compile(
    r"(m and rad squared|m and rad|1/m and 1/rad|pixels and pixels/m|rad/s|m/s|m\^2|m per m|pixels|rad|m|s)\b"
    r"(?![\w^])[,:;.]? *"
)
_LATER = re.compile(r", (pixels)\b|(m or rad)\b|in the unit (of its kind)")


class Row(NamedTuple):
    """An array, or several of the same place in the record."""

    path: str
    """With `*` for the numbers of a sequence, or the keys of a mapping."""
    scalars: tuple[str, ...]
    """NumPy's types of the numbers; one of them."""
    shape: str
    unit: str
    meaning: str

    @property
    def group(self) -> str:
        """Which table it stands in."""
        return max((one for one in GROUPS if not one or self.path.startswith(f"{one}.")), key=len)

    @property
    def line(self) -> str:
        """In the table of its group."""
        name = self.path.removeprefix(f"{self.group}.") if self.group else self.path
        numbers = f"{' or '.join(self.scalars)} {self.shape}"
        return f"| `{name}` | {numbers} | {self.unit} | {self.meaning.replace('|', chr(92) + '|')} |"


def rows() -> list[Row]:
    """All of them, in the order of the record; those of the same name and meaning, once."""
    found = [
        Row("format", ("int64",), "()", "-", f"Version of this layout: {FORMAT}."),
        Row("record", ("uint8",), "(b,)", "-", "JSON in UTF-8: all that is no array, and where the arrays belong."),
    ]
    merged = dict[tuple[str, str, str, str], list[str]]()
    for path, scalar, said in _walk(Solution, "", ""):
        shape, unit, meaning = _parts(said, scalar)
        scalars = merged.setdefault((path, shape, unit, meaning), [])
        scalars += [scalar] if scalar not in scalars else []
    return [*found, *(Row(path, tuple(scalars), *rest) for (path, *rest), scalars in merged.items())]


def table() -> list[str]:
    """Markdown: a heading and a table for each group that there is."""
    found, lines = rows(), list[str]()
    for group in GROUPS:
        title = f"Arrays of `{group}`" if group else "Arrays of the solution itself"
        mine = [row.line for row in found if row.group == group]
        lines += [f"## {title}", "", HEAD, "|---|---|---|---|", *mine, ""]
    return lines[:-1]


def _walk(kind: Any, path: str, said: str) -> Iterator[tuple[str, str, str]]:
    """Path, type and meaning of the arrays in a value of a declared type."""
    origin, options = get_origin(kind), get_args(kind)
    if scalar := array_scalar(kind):
        yield path, scalar.__name__, said
    elif origin in (Union, types.UnionType):
        for one in options:
            if one is not type(None):
                yield from _walk(one, path, said)
    elif origin is tuple and options[0] is str:
        yield path, "str", said
    elif origin is tuple or origin is Mapping:
        yield from _walk(options[0 if origin is tuple else 1], f"{path}.*", said)
    elif is_dataclass(kind) and isinstance(kind, type):
        said_of, hints = meanings(kind), get_type_hints(kind)
        for field in fields(kind):
            below = f"{path}.{field.name}" if path else field.name
            yield from _walk(hints[field.name], below, said_of.get(field.name, ""))
    else:
        for one in kinds_of(kind):
            yield from _walk(one, path, said)


def _parts(said: str, scalar: str) -> tuple[str, str, str]:
    """Shape, unit and meaning of a field that is described as "(n, 3) m, body-fixed"."""
    shape = _SHAPE.match(said)
    rest = said[shape.end() :] if shape else said
    unit = _UNIT.match(rest) if scalar.startswith("float") else None  # numbers of points and bytes have none
    later = _LATER.search(rest) if scalar.startswith("float") else None
    rest = rest[unit.end() :] if unit else rest
    dimension = unit[1] if unit else later[later.lastindex or 0] if later else "-"
    rest = rest[:1].upper() + rest[1:] if rest else "As the name says."
    return shape[1] if shape else "(i,)", dimension, " ".join(rest.split())


def main() -> None:
    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    options.add_argument("--page", action="store_true", help="write docs/solution_npz.md")
    if options.parse_args().page:
        head, _, _ = PAGE.read_text(encoding="utf-8").partition("## Arrays of")
        PAGE.write_text(head + "\n".join(table()) + "\n", encoding="utf-8")
        return
    print("\n".join(table()))


if __name__ == "__main__":
    main()

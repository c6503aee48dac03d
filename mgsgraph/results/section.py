"""A finding, made once: its title, sentences, tables, numbers and figures; and one writer each for the terminal, JSON
and the files of a folder. The page takes sentences and tables as they are.
"""

import tomllib
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from importlib import import_module
from operator import attrgetter
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from mgsgraph.files.output.folders import PROGRAM, fresh_folder
from mgsgraph.files.output.table import Column, Table, write_json

if TYPE_CHECKING:
    from mgsgraph.results.figures.sheet import Sheet

ROWS = 24
"""Rows of a table that are printed; the files have all."""


_ATTRIBUTE_KINDS: dict[str, tuple[str, Callable[[Iterable[Any]], Any]]] = {
    "items": ("values", list),
    "counts": ("values", lambda values: np.array(list(values), dtype=np.int64)),
    "numbers": ("values", lambda values: np.array(list(values), dtype=np.float64)),
    "units": ("unit", list),
}
"""Keys of tables.toml that name an attribute of records: field of the column that it fills, and the conversion."""


@cache
def _layouts() -> dict[str, dict[str, Any]]:
    """Names, titles and notes of tables; units, meanings and formats of their columns."""
    return tomllib.loads((Path(__file__).parent / "templates" / "tables.toml").read_text(encoding="utf-8"))


def columns_of(table: str, values: Mapping[str, Any], records: Sequence[Any] | None = None) -> tuple[Column, ...]:
    """Columns of a table in `templates/tables.toml`, in the order of the values; None leaves one out.

    With records, all columns of the file in its order: it names the attribute of those that have no values here.
    """
    layouts, columns = _layouts()[table]["columns"], list[Column]()
    assert records is None or values.keys() <= layouts.keys(), f"{table}: none of {values.keys() - layouts.keys()}"
    for name in values if records is None else layouts:
        value = values.get(name)
        if not isinstance(value, Column):
            layout = {"key": name, "values": value} | layouts[name]
            for kind in _ATTRIBUTE_KINDS.keys() & layout:
                target, convert = _ATTRIBUTE_KINDS[kind]
                layout[target] = convert(map(attrgetter(layout.pop(kind)), records or ()))
            value = Column(**layout) if layout["values"] is not None else None
        columns += [] if value is None else [value]
    return tuple(columns)


def record_of(name: str, record: Any) -> dict[str, Any]:
    """Members of a record for JSON, from attributes that `templates/tables.toml` names."""
    return {key: attrgetter(attribute)(record) for key, attribute in _layouts()["records"][name].items()}


def table_of(layout: str, values: Mapping[str, Any], records: Sequence[Any] | None = None, **overrides: Any) -> Table:
    """The table of a layout in `templates/tables.toml`, with `columns_of`; name, title or note may be given here."""
    members = {"name": layout} | _layouts()[layout] | overrides
    return Table(**members | {"columns": columns_of(layout, values, records)})


@dataclass(frozen=True, slots=True, eq=False)
class Section:
    """One finding."""

    name: str
    """Its key in a record."""
    title: str = ""
    """Heading, where one is needed."""
    sentences: Sequence[str] = ()
    """Results in sentences."""
    tables: Sequence[Table] = ()
    """What is shown: columns with a layout in text on the terminal, those with a format of the page there."""
    numbers: Any = None
    """Its JSON content, with units in the keys."""
    csv: Sequence[Table] = ()
    """Tables that become files by their names."""
    files: Mapping[str, Callable[[Path], None]] = field(default_factory=dict)
    """Functions that write further files, by file name."""
    sheets: Callable[[], Iterable["Sheet"]] | None = None
    """Function that draws its figures."""

    def text(self, max_rows: int | None = ROWS) -> str:
        """Lines for the terminal, with so many rows of each table at most; None: with all."""
        lines = [*([self.title] if self.title else []), *(f"- {sentence}" for sentence in self.sentences)]
        for table in self.tables:
            rows = table.text(max_rows, f"more row: see {table.name}.csv", indent=2, units=True)
            if len(table) and rows:
                lines += [*([""] if lines else []), table.title, *rows]
        return "\n".join(lines)

    def write(self, folder: Path, figures: bool) -> list[str]:
        """Write its files into a folder, with figures or without; their names."""
        writers = {f"{table.name}.csv": table.write_csv for table in self.csv} | dict(self.files)
        for name, write in writers.items():
            write(folder / name)
        if not figures or self.sheets is None:
            return list(writers)
        from mgsgraph.results.figures.sheet import save  # matplotlib loads slowly

        return [*writers, *save(self.sheets(), folder)]


def sheets_by(function: str, *arguments: Any) -> Callable[[], Iterable["Sheet"]]:
    """A callable that draws figures by the function of this dotted name; it imports matplotlib only then."""
    module, _, name = function.rpartition(".")

    def sheets() -> Iterable["Sheet"]:
        result = getattr(import_module(module), name)(*arguments)
        return result if isinstance(result, Iterable) else [result] if result is not None else []

    return sheets


def write_sections(
    sections: Iterable[Section], record: Mapping[str, Any], folder: str | Path, kind: str, figures: bool = True
) -> list[str]:
    """Write a record and the files of sections to a folder, atomically; the names of the files.

    Parameters
    ----------
    sections : iterable of Section
        In the order of their files.
    record : mapping
        What the folder's JSON file holds beside the program's name.
    folder : path
        Absent, empty, or an earlier result of the same kind, which is replaced.
    kind : str
        Name of the JSON file, by which such folders are known.
    figures : bool
        False leaves the figures out.

    Raises
    ------
    InputError
        If the folder holds anything else, or can't be written.
    """
    with fresh_folder(folder, kind) as temporary:
        return write_sections_into(sections, record, temporary, kind, figures)


def write_sections_into(
    sections: Iterable[Section], record: Mapping[str, Any], folder: Path, kind: str, figures: bool = True
) -> list[str]:
    """Write a record and the files of sections into a folder that exists; the names of the files."""
    write_json(folder / kind, {"program": PROGRAM, **record})
    return [kind, *(name for section in sections for name in section.write(folder, figures))]

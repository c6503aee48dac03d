"""The image index of an archive volume: an ASCII table whose columns its PDS3 label describes by name and bytes."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from mgsgraph.errors import InputError
from mgsgraph.fetch.product import ProductId
from mgsgraph.io.files import read_bytes
from mgsgraph.io.pvl import Block, Document, whole_label

_COLUMNS = ("PRODUCT_ID", "FILE_SPECIFICATION_NAME", "INSTRUMENT_NAME")


@dataclass(frozen=True, slots=True)
class IndexRow:
    """One image of a volume."""

    product: ProductId
    file: str
    """Path below the volume, in small letters: m08060/m0806047.imq."""
    instrument: str
    """MOC-NA or MOC-WA."""

    @property
    def narrow(self) -> bool:
        """Whether the narrow angle took it."""
        return not self.instrument.upper().endswith("WA")


def read_index(table: Path, label: Path) -> tuple[IndexRow, ...]:
    """Images of a volume in the table's order; those with ids of no mapping phase are left out.

    Raises
    ------
    InputError
        A label without one of the columns that are needed, or a row that is too short.
    """
    text = read_bytes(label).decode("latin-1").replace("\r\n", "\n")
    places = {block.text("NAME").upper(): _bytes(block) for block in _columns(whole_label(Document(str(label), text)))}
    for name in _COLUMNS:
        if name not in places:
            raise InputError(str(label), f"no column {name}", "the label of an image index")
    return tuple(_rows(table, [places[name] for name in _COLUMNS]))


def _columns(block: Block) -> Iterator[Block]:
    for inner in block.blocks:
        if inner.name == "column":
            yield inner
        yield from _columns(inner)


def _bytes(column: Block) -> slice:
    start = column.count("START_BYTE") - 1
    return slice(start, start + column.count("BYTES"))


def _rows(table: Path, places: list[slice]) -> Iterator[IndexRow]:
    needed = max(place.stop for place in places)
    for number, line in enumerate(read_bytes(table).decode("latin-1").split("\n"), 1):
        if not line.strip("\0\x1a\r "):
            continue
        if len(line) < needed:
            expected, remedy = f"at least {needed} by its label", "--update, or another mirror"
            raise InputError(f"{table}, row {number}", f"{len(line)} bytes", expected, remedy)
        product, file, instrument = (line[place].strip(' "') for place in places)
        try:
            yield IndexRow(ProductId.read(product), file.lower(), instrument)
        except InputError:
            continue  # calibration and the like

"""In which of the archive's volumes an image is, by their indices: ASCII tables that PDS3 labels describe.

Volumes are in the order of time, and so are ids: of the volumes that the archive's listing names (or, without one, of
all numbers there may be) some ten indices tell, each of a few hundred kilobytes, which one it is. They stay in the
folder, for the next image.
"""

import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

from mgsgraph.errors import InputError
from mgsgraph.fetch.needs import ProductId
from mgsgraph.files.opening import read_bytes
from mgsgraph.files.pvl import Block, Document, whole_label
from mgsgraph.text import some

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


NUMBERS = range(1001, 1601)
"""Of volumes, where the archive lists none: those of the mapping mission end at 1578 or a little later."""
NAMES = ("imgindx", "imgindex")
"""What the index of a volume is called, more often the first."""
_NAME = re.compile(r"mgsc_1\d{3}")
_BESIDE = 2
"""Volumes on either side in which an image is looked for that is not where its id says."""
_ASKED = 50
"""Volumes asked for, none of which is there, before it is taken that there are none at all."""
_TAIL = 10
"""Of a volume's ids the first and the last tenth don't tell where it stands: some image may have come late."""
_NEAREST = 3
"""Ids that an error suggests."""

Rows = Callable[[str], Sequence[IndexRow]]
"""Index of a volume by its name; empty where there is no such volume."""


class Found(NamedTuple):
    """An image, and where it is."""

    volume: str
    row: IndexRow


def volumes_listed(page: str) -> tuple[str, ...]:
    """Volumes to which the archive's listing has links; those of all numbers where it has none."""
    named = sorted({f"mgsc_{number}" for number in re.findall(r'href="[^"]*?mgsc_(1\d{3})/?"', page, re.IGNORECASE)})
    return tuple(named) or tuple(f"mgsc_{number}" for number in NUMBERS)


def volumes_of(texts: Sequence[str]) -> tuple[str, ...]:
    """Volumes by their names, in capitals or not; InputError for any other."""
    named = tuple(text.strip().lower() for text in texts)
    for name in named:
        if not _NAME.fullmatch(name):
            raise InputError(f"volume {name!r}"[:80], "not the name of a volume", "one such as mgsc_1068")
    return named


def find_image(product: ProductId, volumes: Sequence[str], rows: Rows) -> Found:
    """Look an image up.

    Parameters
    ----------
    product : ProductId
        Which.
    volumes : sequence of str
        In the order of time.
    rows : callable
        Reads the index of a volume.

    Raises
    ------
    InputError
        No volumes at all; an id that none has, with the nearest that there are; or an image of the wide angle.
    """
    seen: dict[str, Sequence[IndexRow]] = {}

    def look(volume: str) -> Sequence[IndexRow]:
        if volume not in seen:
            seen[volume] = rows(volume)
            if len(seen) >= min(_ASKED, len(volumes)) and not any(seen.values()):
                raise InputError(
                    f"image {product}", f"no volume where the archive should be (not {some([*seen], len(seen))})",
                    "mgsc_NNNN/index/", "check the mirror's address, or --volume",
                )
        return seen[volume]

    last = _nearest(product, volumes, look)
    around = sorted(range(len(volumes)), key=lambda k: abs(k - last))[: 2 * _BESIDE + 1]
    near = [volumes[k] for k in sorted(around)]
    for volume in [*seen, *near]:
        for row in look(volume):
            if row.product == product:
                return Found(volume, _narrow(row, seen))
    through = [volume for volume in near if seen[volume]]
    found = f"in no volume that was looked through ({some(through, len(through))})"
    raise InputError(f"image {product}", found, _suggestion(product, seen), "check the id")


def _nearest(product: ProductId, volumes: Sequence[str], look: Rows) -> int:
    """Position of the volume that has the image, or would have it, but for few that are out of order."""
    low, high, last = 0, len(volumes) - 1, 0
    while low <= high:
        middle = _existing(low, high, lambda k: look(volumes[k]))
        if middle is None:
            break
        orders = sorted(row.product.order for row in look(volumes[middle]))
        last, tail = middle, len(orders) // _TAIL
        if product.order < orders[tail]:
            high = middle - 1
        elif product.order > orders[-1 - tail]:
            low = middle + 1
        else:
            break
    return last


def _existing(low: int, high: int, look: Callable[[int], Sequence[IndexRow]]) -> int | None:
    """The volume nearest to the middle that there is."""
    middle = (low + high) // 2
    nearest = sorted(range(low, high + 1), key=lambda k: abs(k - middle))
    return next((k for k in nearest if look(k)), None)


def _narrow(row: IndexRow, seen: dict[str, Sequence[IndexRow]]) -> IndexRow:
    if not row.narrow:
        raise InputError(
            f"image {row.product}", f"of the wide angle ({row.instrument})", _suggestion(row.product, seen),
            "only the narrow angle's geometry is modelled",
        )
    return row


def _suggestion(product: ProductId, seen: dict[str, Sequence[IndexRow]]) -> str:
    """Narrow-angle images with ids near to one, in words."""

    def apart(other: ProductId) -> list[int]:
        return [abs(a - b) for a, b in zip(other.order, product.order, strict=True)]

    narrow = sorted({row.product for rows in seen.values() for row in rows if row.narrow}, key=lambda one: one.order)
    nearest = sorted(sorted(narrow, key=apart)[:_NEAREST], key=lambda one: one.order)
    return f"a narrow-angle image, such as {', '.join(map(str, nearest))}" if nearest else "a narrow-angle image"

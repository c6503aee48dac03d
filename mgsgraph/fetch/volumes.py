"""In which of the archive's volumes an image is.

Volumes are in the order of time, and so are ids: of the volumes that the archive's listing names (or, without one, of
all numbers there may be) some ten indices tell, each of a few hundred kilobytes, which one it is. They stay in the
folder, for the next image.
"""

import re
from collections.abc import Callable, Sequence
from typing import NamedTuple

from mgsgraph.errors import InputError
from mgsgraph.fetch.index import IndexRow
from mgsgraph.fetch.product import ProductId
from mgsgraph.wording import some

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

"""Ids of MOC images: the phase of the mission and a number."""

import re
from collections.abc import Sequence
from typing import NamedTuple

from mgsgraph.errors import InputError

_ID = re.compile(r"([a-z][a-z0-9]{2})[/_-]?(\d{5})(\.(imq|img|cub|lbl))?", re.IGNORECASE)
_MAPPING = re.compile(r"M[01]\d|M2[0-3]|[ERS](0[1-9]|1\d|2[0-3])")
"""Phases of the mapping mission: M00 .. M23, then E01 .. E23, R01 .. R23, S01 .. S23."""
_LETTERS = "MERS"
"""In the order of time."""


class ProductId(NamedTuple):
    """One image's id; of two the earlier one is that with the smaller `order`."""

    phase: str
    """Such as E02."""
    number: str
    """Five digits."""

    def __str__(self) -> str:
        return f"{self.phase}/{self.number}"

    @property
    def name(self) -> str:
        """As cases and networks call the image."""
        return f"{self.phase}-{self.number}"

    @property
    def order(self) -> tuple[int, int, int]:
        """What sorts ids by time."""
        return _LETTERS.index(self.phase[0]), int(self.phase[1:]), int(self.number)

    @classmethod
    def read(cls, text: str) -> "ProductId":
        """From E02/00665, E02-00665, e0200665 or E0200665.imq.

        Raises
        ------
        InputError
            Anything else, and images from before the mapping mission, which another data set holds.
        """
        match = _ID.fullmatch(text.strip())
        if match is None:
            raise InputError(f"image {text!r}"[:80], "not the id of a MOC image", "one such as E02/00665 or e0200665")
        product = cls(match[1].upper(), match[2])
        if not _MAPPING.fullmatch(product.phase):
            raise InputError(
                f"image {product}", f"of the phase {product.phase}, which is not in the archive's mapping volumes",
                "phases M00 .. M23, E01 .. E23, R01 .. R23, S01 .. S23",
            )
        return product


def products_of(texts: Sequence[str]) -> tuple[ProductId, ...]:
    """Ids in their order, each once."""
    if not texts:
        raise InputError("images", "none", "at least one id, such as E02/00665")
    return tuple(dict.fromkeys(map(ProductId.read, texts)))

"""What `networks.pvl_scan` knows of the words of control networks in PVL text, in tables for compiled code.

The words are those of `networks.pvl` and `files.pvl`; keywords that are not here, such as AprioriLatitude, and those of
versions 1 and 2, are for the reader of `networks.pvl` alone.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from mgsgraph.files.networks.pvl import (
    CONSTRAINTS,
    LOCKS,
    NAME_TEXTS,
    PIXEL_UNITS,
    PIXELS,
    PLACES,
    WORDS_OF_LOG,
    WORDS_OF_MEASURE_TYPE,
    WORDS_OF_POINT_TYPE,
    WORDS_OF_SOURCE,
)
from mgsgraph.files.networks.tie_points import KINDS
from mgsgraph.files.pvl import FLAGS, LENGTHS
from mgsgraph.units import KM

UNKNOWN, NAME, TEXT, FLAG, PIXEL, LENGTH, MATRIX, POINT_TYPE, MEASURE_TYPE, SOURCE, UNIT = range(11)
"""What stands behind a keyword: nothing that is known; a name; a text that nobody needs; a truth value; a number of
pixels; a length; six numbers in brackets; a type of point or of measure; where a place comes from; and a unit, behind
any of them."""
IN_PIXELS, IN_METRES, IN_KILOMETRES = 1, 2, 3
"""Numbers of units; 0 is none."""
_BLOCKS = ("object", "group", "end_object", "end_group")
_LOCKS, _AXES = (*LOCKS, "JigsawRejected"), "XYZ"
_OF_POINT = (
    {"PointId": NAME, "PointType": POINT_TYPE}
    | dict.fromkeys((*NAME_TEXTS, "AprioriXYZSourceFile", "AprioriRadiusSourceFile"), TEXT)
    | dict.fromkeys((*_LOCKS, *CONSTRAINTS), FLAG)
    | dict.fromkeys(("AprioriXYZSource", "AprioriRadiusSource"), SOURCE)
    | {f"{stage}{axis}": LENGTH for stage in ("Apriori", "Adjusted") for axis in _AXES}
    | dict.fromkeys(("AprioriCovarianceMatrix", "AdjustedCovarianceMatrix"), MATRIX)
)
_OF_MEASURE = (
    {"SerialNumber": NAME, "MeasureType": MEASURE_TYPE}
    | dict.fromkeys(NAME_TEXTS, TEXT)
    | dict.fromkeys((*_LOCKS, "Reference"), FLAG)
    | dict.fromkeys((*PLACES, *PIXELS, *WORDS_OF_LOG), PIXEL)
)
_COLUMNS = (
    {f"{stage}{axis}": 3 * k + c for k, stage in enumerate(("Apriori", "Adjusted")) for c, axis in enumerate(_AXES)}
    | {"AprioriCovarianceMatrix": 0, "AdjustedCovarianceMatrix": 1}
    | {"Line": 0, "Sample": 1, "LineSigma": 2, "SampleSigma": 3}
)
"""Where what stands behind a keyword is kept, in the arrays of its role; nowhere where it is only looked at."""
_KEYS = tuple(dict.fromkeys(key.lower() for key in (*_BLOCKS, *_OF_POINT, *_OF_MEASURE)))
OBJECT, GROUP, END_OBJECT, END_GROUP = range(4)
"""Numbers of keywords that begin and end blocks."""
IGNORE = _KEYS.index("ignore")
_CHOICES: dict[int, dict[str, int]] = {
    FLAG: {word: int(value) for word, value in FLAGS.items()},
    POINT_TYPE: {word: int(KINDS[kind]) for word, kind in WORDS_OF_POINT_TYPE.items()},
    MEASURE_TYPE: {word: int(kind) for word, kind in WORDS_OF_MEASURE_TYPE.items()},
    SOURCE: {word: int(source) for word, source in WORDS_OF_SOURCE.items()},
    UNIT: (
        {unit: IN_KILOMETRES if factor == KM else IN_METRES for unit, factor in LENGTHS.items() if unit}
        | {unit: IN_PIXELS for unit in PIXEL_UNITS if unit}
    ),
}
CONTROL_POINT, CONTROL_MEASURE = 0, 1
"""Numbers of the words that say what a block is."""
_WORDS = tuple(dict.fromkeys(("controlpoint", "controlmeasure", *(word for one in _CHOICES.values() for word in one))))

Vocabulary = tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.uint8]]
"""(2^q,) hash table of numbers of words, (m + 1,) where each begins, (b,) all of them, in lower case."""


def vocabulary(words: Sequence[str]) -> Vocabulary:
    """Words in lower case, of at most 32 ASCII characters, for `pvl_scan` to find their numbers."""
    texts = [word.encode("ascii") for word in words]
    slots = np.full(512, -1)
    for number, text in enumerate(texts):
        code = 14695981039346656037
        for byte in text:
            code = (code ^ byte) * 1099511628211 % 2**64
        slot = (code ^ code >> 32) % slots.size
        while slots[slot] >= 0:
            slot = (slot + 1) % slots.size
        slots[slot] = number
    return slots, np.cumsum([0, *map(len, texts)]), np.frombuffer(b"".join(texts), dtype=np.uint8)


def _roles() -> NDArray[np.int64]:
    """(2, m) what stands behind each keyword in a point, and in a measure."""
    found = np.full((2, len(_KEYS)), UNKNOWN)
    for row, roles in enumerate((_OF_POINT, _OF_MEASURE)):
        for key, role in roles.items():
            found[row, _KEYS.index(key.lower())] = role
    return found


def _columns() -> NDArray[np.int64]:
    """(m,) place in the arrays of a keyword's role, -1 for none."""
    found = np.full(len(_KEYS), -1)
    for key, column in _COLUMNS.items():
        found[_KEYS.index(key.lower())] = column
    return found


def _meanings() -> NDArray[np.int64]:
    """(roles, m) number of what each word means in a role, -1 for nothing."""
    found = np.full((UNIT + 1, len(_WORDS)), -1)
    for role, choices in _CHOICES.items():
        for word, meaning in choices.items():
            found[role, _WORDS.index(word)] = meaning
    return found


KNOWN = (vocabulary(_KEYS), vocabulary(_WORDS), _meanings(), _roles(), _columns())
"""What the scanner is given: keywords, other words, what these mean in each role, roles and columns of keywords."""

"""Tie points of a control network in PVL text without an object for each point and measure (`networks.pvl_scan`)."""

import re
from dataclasses import dataclass

import numpy as np
import pyarrow as pa

from mgsgraph.errors import InputError
from mgsgraph.files.networks.binary_columns import MOST_SLOTS, names_at, used_points
from mgsgraph.files.networks.pvl import parse_pvl_network
from mgsgraph.files.networks.record import ControlNetwork, with_names
from mgsgraph.files.networks.tie_points import FARTHEST, require_body
from mgsgraph.files.pvl import Document, inner_blocks
from mgsgraph.files.tie_points import PointKind, TiePoints
from mgsgraph.geometry.body import Ellipsoid
from mgsgraph.geometry.records import Array, Index, Mask
from mgsgraph.names import RepeatedNames
from mgsgraph.units import KM

_POINT, _MEASURE, _MATRIX = b"ControlPoint", b"ControlMeasure", b"AprioriCovarianceMatrix"
_FIRST = re.compile(rb"^[ \t]*Object[ \t]*=[ \t]*ControlPoint[ \t]*$", re.MULTILINE | re.IGNORECASE)
_ONE = "\nObject = ControlPoint\nPointId = 1\nPointType = Free\nEnd_Object\nEnd_Object\n"
"""A point that ends the head in place of those of the file."""
_VERSIONS = ("3", "4", "5")
_END = re.compile(rb"\s*(?:End\s|End\Z|\Z)", re.IGNORECASE)
_SLOTS = 1 << 14
"""Of the first hash table of images."""
_MARK = b"\xef\xbb\xbf"


@dataclass(slots=True, eq=False)
class _Scanned:
    """Where things are in a file, as `pvl_scan.read_points` says; of longer arrays the rest is void."""

    ids: Index
    kinds: Index
    ignored: Mask
    places: Index
    in_km: Mask
    matrices: Index
    of_matrix: Index
    first: Index
    spans: Index
    flags: Mask
    image: Index


def pvl_tie_points(data: bytes, source: str, body: Ellipsoid | None = None) -> TiePoints | None:
    """What an adjustment takes from the content of a network in PVL text of version 3 to 5; None where something is
    odd, of which `parse_pvl_network` and `tie_points` know what to think.

    Parameters
    ----------
    data : bytes
        All of the file.
    source : str
        File, for messages.
    body : Ellipsoid, optional
        That of the images.

    Raises
    ------
    InputError
        A network of another body; covariances that are none.
    """
    data = data.removeprefix(_MARK)
    if b"\r" in data:
        data = data.replace(b"\r\n", b"\n").replace(b"\r", b"\n")
    start = _FIRST.search(data)
    head = _head(data[: start.start()], source) if start else None
    found = _scanned(data, start.start(), source) if start and head else None
    if found is not None and head is not None and body is not None:
        require_body(head, found, body)
    return found


def _head(data: bytes, source: str) -> ControlNetwork | None:
    """Head of the network, from what stands before the first point; None where it is odd, or no head."""
    try:
        document = Document(source, data.decode() + _ONE)
        blocks = list(inner_blocks(document))
        (outer, block), *others = blocks
        if others or block.position != len(document.text) - len(_ONE) + 1:
            return None
        if "Version" not in outer or outer.text("Version") not in _VERSIONS:
            return None
        return with_names(parse_pvl_network(document))
    except (InputError, ValueError):  # what is wrong with it is said by the reader of all of it
        return None


def _scanned(data: bytes, start: int, source: str) -> TiePoints | None:
    """Points from a place in a file on."""
    from mgsgraph.files.networks import pvl_scan
    from mgsgraph.files.networks.pvl_words import KNOWN

    content, slots = np.frombuffer(data, dtype=np.uint8), _SLOTS
    n, k, c = (data.count(word, start) for word in (_POINT, _MEASURE, _MATRIX))
    into = _Scanned(
        np.zeros((n, 2), dtype=np.int64), np.zeros(n, dtype=np.int64), np.zeros(n, dtype=bool),
        np.zeros((3, n, 2), dtype=np.int64), np.zeros((3, n), dtype=bool), np.zeros((6, c, 2), dtype=np.int64),
        np.zeros(c, dtype=np.int64), np.zeros(n + 1, dtype=np.int64), np.zeros((4, k, 2), dtype=np.int64),
        np.zeros(k, dtype=bool), np.zeros(k, dtype=np.int64),
    )  # fmt: skip
    points = -2
    while points == -2 and slots <= MOST_SLOTS:
        table, images = np.full(slots, -1), np.zeros((slots // 2 + 2, 2), dtype=np.int64)
        points, measures, matrices, behind = pvl_scan.read_points(
            content, start, KNOWN, table, images, into.ids, into.kinds, into.ignored, into.places, into.in_km,
            into.matrices, into.of_matrix, into.first, into.spans, into.flags, into.image,
        )  # fmt: skip
        slots *= 16
    if points <= 0 or behind < 0 or not _END.match(data, behind) or not data[behind:].isascii():
        return None
    return _tie_points(content, into, points, measures, matrices, images[: images[-1, 0]], source)


def _tie_points(
    content: np.ndarray, into: _Scanned, n: int, k: int, c: int, images: Index, source: str
) -> TiePoints | None:  # fmt: skip
    """Of n points, k measures and c covariances the numbers; None for some that an adjustment can't take."""
    try:
        places = np.column_stack([_numbers(content, one[:n]) for one in into.places])
        measures = np.column_stack([_numbers(content, one[:k]) for one in into.spans])
        upper = np.column_stack([_numbers(content, one[:c]) for one in into.matrices])
    except pa.ArrowInvalid:  # beyond what a float64 holds
        return None
    places *= np.where(into.in_km[:, :n].T, KM, 1.0)
    covariances = np.full((n, 6), np.nan)
    covariances[into.of_matrix[:c]] = upper
    kinds, ignored, first = into.kinds[:n], into.ignored[:n], into.first[: n + 1]
    names = names_at(content, into.ids[:n])
    if names.first_repeated is not None or np.all(ignored):
        return None
    taken = ~into.flags[:k]
    counted = measures[taken & ~np.repeat(ignored, np.diff(first))]
    if np.isnan(counted[:, :2]).any() or not _are_usable(kinds[~ignored], places[~ignored], covariances[~ignored]):
        return None
    if np.any(counted[:, 2:] <= 0.0):
        return None
    image = RepeatedNames(tuple(names_at(content, images)), into.image[:k])
    return used_points(source, names, kinds, ~ignored, places, covariances, first, image, measures, taken)


def _are_usable(kinds: Index, places: Array, covariances: Array) -> bool:
    """Whether an adjustment can take points of these kinds (n,), places (n, 3) and covariances (n, 6)."""
    constrained = kinds == PointKind.CONSTRAINED
    placed = ~np.isnan(places[kinds != PointKind.FREE]).any()
    return bool(placed and not np.any(np.abs(places) > FARTHEST) and np.all(covariances[constrained][:, [0, 3, 5]] > 0))


def _numbers(content: np.ndarray, spans: Index) -> Array:
    """(m,) numbers whose decimals lie at spans (m, 2), NaN for an empty one; correctly rounded, as Python's float."""
    there = spans[:, 1] > 0
    found = np.full(spans.shape[0], np.nan)
    found[there] = np.from_dlpack(names_at(content, spans[there]).arrow.cast(pa.float64()))
    return found

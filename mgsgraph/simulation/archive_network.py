"""A simulated archive's tie points as an ISIS control network, binary version 5, written region by region in columns.

All ids are of one length, and so are all names of images: every point begins with a record of one length, and every
measure is one. They are laid out by NumPy as bytes, without a Python object for any. The layout is that of
`files.networks.binary`, which reads it; field numbers are those of `files.networks.messages`.
"""

from collections.abc import Sequence
from pathlib import Path
from types import TracebackType
from typing import BinaryIO, Self

import numpy as np
from numpy.typing import NDArray

from mgsgraph.files.networks.binary import LABEL_BYTES, network_header, network_label
from mgsgraph.files.networks.record import ControlNetwork, MeasureType, PointType
from mgsgraph.geometry.records import Index
from mgsgraph.simulation.archive_ties import Region
from mgsgraph.units import ISIS_OFFSET

_DIGITS = 8
"""Of a point's number in its id."""
_WRITTEN = "2000-01-01T00:00:00"
"""Date in the network; fixed, so that the same archive gives the same bytes."""
_BEHIND_ID = bytes([0x10, PointType.FREE, 0x40, 0, 0x48, 0, 0x58, 0])
"""type (2), referenceIndex (8), aprioriSurfPointSource (9) and aprioriRadiusSource (11) of every point."""
_MEASURES = bytes([0xCA, 0x01])
"""Tag of a point's field 25."""
Bytes = NDArray[np.uint8]


def point_ids(first: int, count: int) -> Bytes:
    """(count, 9) ASCII of the ids T00000001 and so on of points from number `first` on, counted from zero."""
    numbers = np.arange(first + 1, first + count + 1)[:, None] // 10 ** np.arange(_DIGITS - 1, -1, -1) % 10
    ids = np.full((count, _DIGITS + 1), ord("T"), dtype=np.uint8)
    ids[:, 1:] = numbers + ord("0")
    return ids


class NetworkWriter:
    """A network that is written region by region; its label is put before it at the end."""

    def __init__(self, path: Path, network_id: str, target: str, names: Sequence[str]) -> None:
        """`names` of all images, of one length."""
        self._path = path
        self._head = ControlNetwork(
            network_id=network_id, target_name=target, points=(), user_name="mgsgraph", created=_WRITTEN,
            last_modified=_WRITTEN, description="Simulated archive",
        )  # fmt: skip
        encoded = np.array([name.encode() for name in names])
        self._names = encoded.view(np.uint8).reshape(len(names), -1)
        self.points, self.measures, self._bytes = 0, 0, 0
        self._header = network_header(self._head)

    def __enter__(self) -> Self:
        self._file: BinaryIO = self._path.open("wb")
        self._file.write(bytes(LABEL_BYTES))
        self._file.write(self._header)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if kind is None:
            self._file.seek(0)
            self._file.write(network_label(self._head, self.points, self.measures, len(self._header), self._bytes))
        self._file.close()

    def add(self, region: Region) -> None:
        """Write the points of a region with their measures."""
        content = self._content(region)
        self._file.write(content.data)
        self.points += len(region.points)
        self.measures += region.images.size
        self._bytes += content.size

    def _content(self, region: Region) -> Bytes:
        measures = self._measure_records(region)
        length = measures.shape[1]
        sizes = length * region.counts
        heads = self._heads(region.counts.size, sizes)
        begins = np.cumsum(heads.shape[1] + sizes) - heads.shape[1] - sizes
        content = np.empty(heads.size + measures.size, dtype=np.uint8)
        content[begins[:, None] + np.arange(heads.shape[1])] = heads
        point = np.repeat(np.arange(region.counts.size), region.counts)
        rank = np.arange(point.size) - np.repeat(np.cumsum(region.counts) - region.counts, region.counts)
        places = begins[point] + heads.shape[1] + length * rank
        content[places[:, None] + np.arange(length)] = measures
        return content

    def _heads(self, count: int, sizes: Index) -> Bytes:
        """(count, bytes) of each point: its size, id and what all have alike; `sizes` in bytes are its measures'."""
        ids = point_ids(self.points, count)
        behind = np.frombuffer(_BEHIND_ID, dtype=np.uint8)
        before = np.array([0x0A, ids.shape[1]], dtype=np.uint8)
        size = (before.size + ids.shape[1] + behind.size + sizes).astype("<u4").view(np.uint8).reshape(count, 4)
        return np.hstack([size, np.tile(before, (count, 1)), ids, np.tile(behind, (count, 1))])

    def _measure_records(self, region: Region) -> Bytes:
        """(measures, bytes): serial number (1), type (2), sample (3) and line (4), behind tag and length."""
        names = self._names[region.images]
        pixels = region.measures[:, ::-1] + ISIS_OFFSET
        kind = [0x10, MeasureType.REGISTERED_SUBPIXEL]
        parts = [[0x0A, names.shape[1]], names, [*kind, 0x19], _float_bytes(pixels[:, 0]), [0x21],
                 _float_bytes(pixels[:, 1])]  # fmt: skip
        rows = [
            part if isinstance(part, np.ndarray) else np.tile(np.array(part, dtype=np.uint8), (len(names), 1))
            for part in parts
        ]
        length = sum(row.shape[1] for row in rows)
        begin = np.frombuffer(_MEASURES + bytes([length]), dtype=np.uint8)
        return np.hstack([np.tile(begin, (len(names), 1)), *rows])


def _float_bytes(values: NDArray[np.float64]) -> Bytes:
    """(n, 8) bytes of numbers (n,), little endian."""
    return np.ascontiguousarray(values, dtype="<f8").view(np.uint8).reshape(values.size, 8)

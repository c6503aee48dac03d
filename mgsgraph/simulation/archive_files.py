"""A simulated archive as files: support data in subfolders, a binary control network, a case file, and the truth.

Everything is written image by image and region by region, whatever the size of the archive.
"""

from collections.abc import Sequence
from pathlib import Path
from types import TracebackType
from typing import Any, BinaryIO, Self

import msgspec
import numpy as np
from numpy.typing import NDArray

from mgsgraph.files.networks.binary import LABEL_BYTES, network_header, network_label
from mgsgraph.files.networks.record import ControlNetwork, MeasureType, PointType
from mgsgraph.files.support_data.isd_layout import rotation_table, state_table, support_fields
from mgsgraph.geometry.body import target_name
from mgsgraph.geometry.image import PushbroomImage
from mgsgraph.geometry.records import Index
from mgsgraph.geometry.trajectory import Trajectory
from mgsgraph.simulation.archive import Archive
from mgsgraph.simulation.archive_ties import Footprints, Region, footprint, regions
from mgsgraph.simulation.case_files import json_text
from mgsgraph.simulation.files import write_texts, writing
from mgsgraph.units import ISIS_OFFSET, MRAD
from mgsgraph.workers import Progress, no_progress

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



NETWORK, TRUE_POINTS, TRUE_CORRECTIONS = "network.net", "true_points.parquet", "true_corrections.npz"
_IN_A_FOLDER = 1000
"""Files of a subfolder, at most."""


def write_archive(archive: Archive, folder: Path, progress: Progress = no_progress) -> Path:
    """Write an archive, its case file and its truth; the path of ``case.toml``.

    Parameters
    ----------
    archive : Archive
    folder : Path
        Made when absent; files of the same names in it are replaced.
    progress : Progress
        Called with what is written, how many images of it are done, and how many there are.

    Raises
    ------
    InputError
        Where the folder can't be written.
    """
    with writing(folder):
        footprints = _write_images(archive, folder, progress)
        measured = _write_ties(archive, footprints, folder, progress)
        names = [archive.name(j) for j in range(len(archive))]
        np.savez(folder / TRUE_CORRECTIONS, names=names, corrections=archive.corrections)
        truth = {"seed": archive.seed, "corrections": TRUE_CORRECTIONS, "ties": TRUE_POINTS}
        texts = {"case.toml": _case(archive, measured), "truth.json": json_text(truth)}
        write_texts(folder, texts)
    return folder / "case.toml"


def image_path(archive: Archive, j: int) -> str:
    """Of the support data of image `j`, in the archive's folder."""
    return f"isd/{j // _IN_A_FOLDER:03d}/{archive.name(j).partition('/')[2]}.json"


def _write_images(archive: Archive, folder: Path, progress: Progress) -> Footprints:
    """Write the support data of all images; their ground."""
    middles, halves = np.empty((len(archive), 3)), np.empty((len(archive), 2, 3))
    for j in range(len(archive)):
        image, path = archive.image(j), folder / image_path(archive, j)
        if j % _IN_A_FOLDER == 0:
            path.parent.mkdir(parents=True, exist_ok=True)
            progress("images", j, len(archive))
        path.write_bytes(msgspec.json.encode(_support_data(image)))
        middles[j], halves[j] = footprint(image)
    return Footprints(middles, halves)


def _support_data(image: PushbroomImage) -> dict[str, Any]:
    """Image support data as ALE lays them out, without the keys that only say the same again."""
    trajectory = image.trajectory
    assert isinstance(trajectory, Trajectory)
    epoch, state = trajectory.epoch, trajectory.position
    pointing, turning = (
        rotation_table(epoch + table.times, table.quaternions, table.constant)
        for table in (trajectory.camera, trajectory.body)
    )
    return {
        "name_sensor": "SIMULATED LINE CAMERA",
        "naif_keywords": {"INS-99901_LIGHTTIME_CORRECTION": "NONE"},
        **support_fields(
            image, epoch, state_table(epoch + state.times, state.positions, state.velocities), pointing, turning
        ),
        "optical_distortion": {},
    }


def _write_ties(archive: Archive, footprints: Footprints, folder: Path, progress: Progress) -> Index:
    """Write network and true places; number of measures (images,) of each image."""
    import pyarrow.parquet

    names = [archive.name(j) for j in range(len(archive))]
    measured = np.zeros(len(archive), dtype=np.int64)
    target = target_name(archive.settings.plan.camera.body.ellipsoid)
    with (
        NetworkWriter(folder / NETWORK, f"simulated_{archive.settings.kind}", target, names) as network,
        pyarrow.parquet.ParquetWriter(folder / TRUE_POINTS, _true_schema()) as truth,
    ):
        for region in regions(archive, footprints, lambda done, of: progress("ties of images", done, of)):
            truth.write_table(_true_table(region, network.points))
            network.add(region)
            measured += np.bincount(region.images, minlength=len(archive))
    return measured


def _true_schema() -> Any:
    import pyarrow

    return pyarrow.schema([("point_id", pyarrow.string()), *((f"{axis}_m", pyarrow.float64()) for axis in "xyz")])


def _true_table(region: Region, first: int) -> Any:
    """True places of a region's points, whose numbers begin at `first`."""
    import pyarrow

    ids = point_ids(first, len(region.points))
    offsets = np.arange(0, ids.size + 1, ids.shape[1], dtype=np.int32)
    names = pyarrow.StringArray.from_buffers(len(ids), pyarrow.py_buffer(offsets), pyarrow.py_buffer(ids.tobytes()))
    columns = [names, *(pyarrow.array(np.ascontiguousarray(axis)) for axis in region.points.T)]
    return pyarrow.Table.from_arrays(columns, schema=_true_schema())


def _case(archive: Archive, measured: Index) -> str:
    """The case file; images without a measure are left out of it."""
    settings = archive.settings
    lines = [
        "format = 1",
        f'name = "simulated archive {settings.kind}, {len(archive)} images"',
        "",
        "[orientation]",
        f"degree = {settings.degree}",
        f"position_sigma_m = {settings.position}",
        f"angle_sigma_mrad = {settings.angle / MRAD}",
        f"trend = {list(settings.trend)}",
        "",
        "[ties]",
        f'network = "{NETWORK}"',
        f"sigma_px = {settings.tie}",
    ]
    for j in np.flatnonzero(measured).tolist():
        lines += ["", "[[images]]", f'name = "{archive.name(j)}"', f'isd = "{image_path(archive, j)}"']
    return "\n".join([*lines, ""])

"""A simulated archive as files: support data in subfolders, a binary control network, a case file, and the truth.

Everything is written image by image and region by region, whatever the size of the archive.
"""

from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from mgsgraph.files.support_data.isd_layout import rotation_table, state_table, support_fields
from mgsgraph.geometry.body import target_name
from mgsgraph.geometry.image import PushbroomImage
from mgsgraph.geometry.records import Index
from mgsgraph.geometry.trajectory import Trajectory
from mgsgraph.progress import Progress, no_progress
from mgsgraph.simulation.archive import Archive
from mgsgraph.simulation.archive_network import NetworkWriter, point_ids
from mgsgraph.simulation.archive_ties import Footprints, Region, footprint, regions
from mgsgraph.simulation.files import write_texts, writing
from mgsgraph.simulation.isis_files import json_text
from mgsgraph.units import MRAD

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

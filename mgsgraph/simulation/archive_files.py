"""A simulated archive as files: support data in subfolders, a binary control network, a case file, and the truth.

Everything is written image by image and region by region, whatever the size of the archive.
"""

from collections.abc import Iterator, Sequence
from itertools import islice
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from mgsgraph.case.case_file import case_text, toml_lines
from mgsgraph.files.networks.binary import LABEL_BYTES, network_header, network_label
from mgsgraph.files.networks.messages import points_content
from mgsgraph.files.networks.record import ControlMeasure, ControlNetwork, ControlPoint, MeasureType, PointType
from mgsgraph.geometry.body import planetocentric, target_name
from mgsgraph.geometry.image import PushbroomImage
from mgsgraph.geometry.records import Index
from mgsgraph.simulation.archive import Archive
from mgsgraph.simulation.archive_ties import Footprints, Region, footprint, regions, shots_along
from mgsgraph.simulation.case_files import json_text, sampled_fields, sigma_lines
from mgsgraph.simulation.files import write_texts, writing
from mgsgraph.simulation.sites import SHIFT_SIGMA
from mgsgraph.units import DEG, ISIS_OFFSET
from mgsgraph.workers import Progress, no_progress

_WRITTEN = "2000-01-01T00:00:00"
"""Date in the network; fixed, so that the same archive gives the same bytes."""
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


def image_path(archive: Archive, j: int, kind: str = "isd", ending: str = "json") -> str:
    """Of the support data of image `j` (or of files of another kind), in the archive's folder."""
    return f"{kind}/{j // _IN_A_FOLDER:03d}/{archive.name(j).partition('/')[2]}.{ending}"


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
        if archive.settings.plan.profiles:
            _write_shots(archive, j, folder / image_path(archive, j, "shots", "csv"))
    return Footprints(middles, halves)


def _support_data(image: PushbroomImage) -> dict[str, Any]:
    """Image support data as ALE lays them out, without the keys that only say the same again."""
    return {
        "name_sensor": "SIMULATED LINE CAMERA",
        "naif_keywords": {"INS-99901_LIGHTTIME_CORRECTION": "NONE"},
        **sampled_fields(image),
        "optical_distortion": {},
    }


def _write_shots(archive: Archive, j: int, path: Path) -> None:
    """Write the laser shots of image `j` with the columns of a selection of `mgsgraph footprints`."""
    shots = shots_along(archive, j)
    longitude, latitude, radius = planetocentric(shots.points).T
    orbit, number = np.full(shots.times.size, j + 1), np.arange(1, shots.times.size + 1)
    columns = (orbit, number, shots.times, longitude / DEG, latitude / DEG, radius, shots.ranges)
    path.parent.mkdir(parents=True, exist_ok=True)
    np.savetxt(path, np.column_stack(columns), ("MOLA,%d", "%d", "%.6f", "%.9f", "%.9f", "%.3f", "%.3f"), ",",
               header="altimeter,orbit,shot,time_s,longitude_deg,latitude_deg,radius_m,range_m", comments="")


def _write_ties(archive: Archive, footprints: Footprints, folder: Path, progress: Progress) -> Index:
    """Write network and true places, region by region; number of measures (images,) of each image."""
    import pyarrow.parquet

    names = [archive.name(j) for j in range(len(archive))]
    measured, points, size = np.zeros(len(archive), dtype=np.int64), 0, 0
    head = ControlNetwork(
        network_id=f"simulated_{archive.settings.kind}", created=_WRITTEN, last_modified=_WRITTEN, points=(),
        target_name=target_name(archive.settings.plan.camera.body.ellipsoid), user_name="mgsgraph",
        description="Simulated archive",
    )  # fmt: skip
    header = network_header(head)
    schema = pyarrow.schema([("point_id", pyarrow.string()), *((f"{axis}_m", pyarrow.float64()) for axis in "xyz")])
    with (
        (folder / NETWORK).open("wb") as network,
        pyarrow.parquet.ParquetWriter(folder / TRUE_POINTS, schema) as truth,
    ):
        network.write(bytes(LABEL_BYTES) + header)
        for region in regions(archive, footprints, lambda done, of: progress("ties of images", done, of)):
            ids = [f"T{points + i + 1:08d}" for i in range(len(region.points))]
            truth.write_table(pyarrow.table([ids, *region.points.T], schema=schema))
            content = points_content(_control_points(region, ids, names))
            network.write(content)
            points, size = points + len(ids), size + len(content)
            measured += np.bincount(region.images, minlength=len(archive))
        network.seek(0)
        network.write(network_label(head, points, int(measured.sum()), len(header), size))
    return measured


def _control_points(region: Region, ids: Sequence[str], names: Sequence[str]) -> Iterator[ControlPoint]:
    """Free points by these ids with all their measures in images by name."""
    pixels, images = iter((region.measures + ISIS_OFFSET).tolist()), iter(region.images.tolist())
    for name, count in zip(ids, region.counts.tolist(), strict=True):
        measures = zip(islice(images, count), islice(pixels, count), strict=True)
        yield ControlPoint(name, PointType.FREE, reference=0, measures=tuple(
            ControlMeasure(names[j], MeasureType.REGISTERED_SUBPIXEL, sample, line) for j, (line, sample) in measures
        ))  # fmt: skip


def _case(archive: Archive, measured: Index) -> str:
    """The case file; images without a measure are left out of it."""
    settings = archive.settings
    lines = sigma_lines(settings.noise, NETWORK)
    for j in np.flatnonzero(measured).tolist():
        lines += toml_lines("[[images]]", name=archive.name(j), isd=image_path(archive, j))
    for j in np.flatnonzero(measured).tolist() if settings.plan.profiles else ():
        lines += toml_lines("[[shots]]", file=image_path(archive, j, "shots", "csv"), image=archive.name(j),
                            range_sigma_m=settings.noise.range, ground_sigma_m=settings.noise.ground,
                            shift_sigma_m=SHIFT_SIGMA, beam_sigma_mrad=0.0)  # fmt: skip
    return case_text(f"simulated archive {settings.kind}, {len(archive)} images", lines)

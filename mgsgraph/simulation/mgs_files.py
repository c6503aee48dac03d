"""MGS' files of a simulated study site: their names, what is written to them, and the MOC images themselves.

An image is a decompressed MOC narrow-angle product (.img): its label, then one byte for each pixel. It is laid out as
the real M01/00115: records of one line, lines of the label end in CR LF and are filled up with blanks; the label takes
as many records as the 2048 bytes of the archived compressed file's. CHECKSUM is the sum of the pixels as SIGNED bytes,
modulo 2^32: found by trial on the data of the real M0100115.imq.
"""

from dataclasses import dataclass
from datetime import datetime, timedelta
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mgsgraph.errors import InputError
from mgsgraph.files.rasters.megdr import REFERENCE_RADIUS
from mgsgraph.geometry.trajectory import Trajectory
from mgsgraph.simulation.ground import areoid_under
from mgsgraph.simulation.mola_files import MegdrLayout, write_megdr
from mgsgraph.simulation.site import SHOTS_PER_FRAME, SimulatedImage, SimulatedSite
from mgsgraph.simulation.sites import template
from mgsgraph.simulation.spice_files import KernelSegment
from mgsgraph.units import MILLISECOND

_LABEL_BYTES = 2048
"""bytes of the label of the archive's compressed images (RECORD_BYTES of M0100115.imq)."""


@dataclass(frozen=True, slots=True)
class MocImageLabel:
    """What a label says that depends on the image."""

    product_id: str
    """Such as E02/00665."""
    start_time: str
    """UTC of the first line, such as 2001-03-08T12:52:54.00."""
    stop_time: str
    """UTC of the end of the last line."""
    clock_start: str
    """Spacecraft clock count at the top edge of the first line, such as 610472061:131."""
    exposure: float
    """s, of one detector line before summing."""
    crosstrack_summing: int
    """detector pixels per sample."""
    downtrack_summing: int = 1
    """exposures per line."""
    edit_mode: int = 0
    """detector pixels before the first one used."""
    orbit: int = 1
    """Number of the orbit."""
    rationale: str = "Simulated"
    """What the image was taken for."""


def write_moc_image(path: Path, label: MocImageLabel, pixels: NDArray[np.uint8]) -> None:
    """Write an image of grey values (lines, samples) with its label attached, or replace it; the same arguments give
    the same bytes. InputError if the pixels are no picture, a value can't stand in a label, or the file can't be
    written.
    """
    if pixels.ndim != 2 or pixels.dtype != np.uint8 or pixels.size == 0:
        raise InputError(f"{path}, pixels", f"{pixels.dtype} of shape {pixels.shape}", "(lines, samples) of uint8")
    head = _label(path, label, pixels)
    try:
        path.write_bytes(head + pixels.tobytes())
    except OSError as error:
        raise InputError(str(path), f"can't be written ({error.strerror})", "a folder that may be written") from None


def _label(path: Path, label: MocImageLabel, pixels: NDArray[np.uint8]) -> bytes:
    """The label, filled up to whole records."""
    samples = pixels.shape[1]
    records = -(-_LABEL_BYTES // samples)
    text = _text(path, label, pixels, records)
    while len(text) > records * samples:  # a narrow image with a long rationale
        records += 1
        text = _text(path, label, pixels, records)
    return text.ljust(records * samples)


def _text(path: Path, label: MocImageLabel, pixels: NDArray[np.uint8], records: int) -> bytes:
    lines, samples = pixels.shape
    for text in (path.name, label.product_id, label.clock_start, label.rationale):
        if '"' in text or not text.isascii() or not text.isprintable():
            raise InputError("MOC label", repr(text), "printable ASCII without quotation marks")
    text = template("moc.lbl").format(
        name=path.name, label=label, lines=lines, samples=samples, records=records, file_records=records + lines,
        first=records + 1, level="SDP" if path.suffix == ".imq" else "DSDP", exposure=label.exposure / MILLISECOND,
        checksum=int(pixels.view(np.int8).sum(dtype=np.int64)) % 2**32,
    )  # fmt: skip
    return text.replace("\n", "\r\n").encode("ascii")


# --- of a simulated site


def shot_names(image: SimulatedImage) -> tuple[str, ...]:
    """Names of an image's shots as the PEDR's reader gives them: orbit, frame and shot."""
    orbit, numbers = image.profile.orbit, range(image.profile.times.size)
    return tuple(f"{orbit}:{k // SHOTS_PER_FRAME + 1}:{k % SHOTS_PER_FRAME + 1}" for k in numbers)


def moc_file(image: SimulatedImage) -> str:
    """Name of an image's file."""
    return image.settings.name.replace("-", "") + ".img"


def pedr_file(image: SimulatedImage) -> str:
    """Name of the PEDR file along with an image."""
    return image.settings.profile + ".b"


def kernel_segment(image: SimulatedImage) -> KernelSegment:
    """What the kernels are to say of an image."""
    trajectory = image.nominal.trajectory
    if not isinstance(trajectory, Trajectory):
        raise InputError(f"image {image.nominal.name}", "an orientation in polynomials", "tables, as kernels have")
    return KernelSegment(image.settings.name, image.settings.phase, trajectory)


def image_label(image: SimulatedImage, title: str) -> MocImageLabel:
    """What the label of an image says; `title` is the site's."""
    settings = image.settings
    start = datetime.fromisoformat(settings.start)
    stop = start + timedelta(seconds=settings.duration)
    return MocImageLabel(
        product_id=settings.name.replace("-", "/"),
        start_time=label_time(start),
        stop_time=label_time(stop),
        clock_start=image.clock_start,
        exposure=settings.exposure,
        crosstrack_summing=settings.crosstrack_summing,
        downtrack_summing=settings.downtrack_summing,
        edit_mode=settings.edit_mode,
        orbit=settings.orbit,
        rationale=f"Simulated image of {title}",
    )


def label_time(time: datetime) -> str:
    """ISO to hundredths of a second, as labels have it."""
    return time.strftime("%Y-%m-%dT%H:%M:%S") + f".{time.microsecond // 10_000:02d}"


def write_grids(simulated: SimulatedSite, folder: Path) -> None:
    """Planetary radius and topography as MEGDR products with labels."""
    grid = simulated.grid
    radii = np.asarray(grid.radii, dtype=np.float64)
    heights = radii - areoid_under(simulated.terrain, grid)
    for letter, offset, posts in (("r", REFERENCE_RADIUS, radii), ("t", 0.0, heights)):
        layout = MegdrLayout(posts.shape, grid.first_longitude, grid.first_latitude, grid.longitude_step, offset)
        write_megdr(folder, grid_file(simulated, letter), layout, [posts])


def grid_file(simulated: SimulatedSite, kind: str) -> str:
    """Name, without suffix, of a site's grid: of radii (kind "r") or of topography ("t")."""
    return f"meg{kind}_{simulated.settings.name}"

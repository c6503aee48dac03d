"""MGS' files of a simulated study site: their names, what is written to them, and the MOC images themselves.

An image is a decompressed MOC narrow-angle product (.img): its label, then one byte for each pixel. It is laid out as
the real M01/00115: records of one line, lines of the label end in CR LF and are filled up with blanks; the label takes
as many records as the 2048 bytes of the archived compressed file's. CHECKSUM is the sum of the pixels as SIGNED bytes,
modulo 2^32: found by trial on the data of the real M0100115.imq.
"""

from datetime import datetime, timedelta
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mgsgraph.errors import InputError
from mgsgraph.files.rasters.megdr import REFERENCE_RADIUS
from mgsgraph.files.writing import writing_to
from mgsgraph.geometry.trajectory import Trajectory
from mgsgraph.simulation.ground import areoid_under
from mgsgraph.simulation.mola_files import WRITABLE, MegdrLayout, write_megdr
from mgsgraph.simulation.site import SHOTS_PER_FRAME, SimulatedImage, SimulatedSite
from mgsgraph.simulation.sites import ImageSettings, template
from mgsgraph.simulation.spice_files import KernelSegment
from mgsgraph.units import MILLISECOND

_LABEL_BYTES = 2048
"""bytes of the label of the archive's compressed images (RECORD_BYTES of M0100115.imq)."""


def write_moc_image(
    path: Path, settings: ImageSettings, clock_start: str, rationale: str, pixels: NDArray[np.uint8]
) -> None:
    """Write an image of grey values (lines, samples) with its label attached, or replace it; the same arguments give
    the same bytes. The label has the spacecraft clock count at the top edge of the first line, such as 610472061:131,
    and what the image was taken for; lines and samples are those of the picture.

    Raises InputError if the pixels are no picture, a value can't stand in a label, or the file can't be written.
    """
    if pixels.ndim != 2 or pixels.dtype != np.uint8 or pixels.size == 0:
        raise InputError(f"{path}, pixels", f"{pixels.dtype} of shape {pixels.shape}", "(lines, samples) of uint8")
    for text in (path.name, settings.name, clock_start, rationale):
        if '"' in text or not text.isascii() or not text.isprintable():
            raise InputError("MOC label", repr(text), "printable ASCII without quotation marks")
    (lines, samples), start = pixels.shape, datetime.fromisoformat(settings.start)
    records, head = -(-_LABEL_BYTES // samples) - 1, " " * samples * _LABEL_BYTES
    while len(head) > records * samples:  # a narrow image with a long rationale
        records += 1
        head = template("moc.lbl").format(
            name=path.name, settings=settings, product=product_id(settings), clock_start=clock_start,
            rationale=rationale, lines=lines, samples=samples, records=records, file_records=records + lines,
            first=records + 1, level="SDP" if path.suffix == ".imq" else "DSDP", start=label_time(start),
            stop=label_time(start + timedelta(seconds=settings.duration)), exposure=settings.exposure / MILLISECOND,
            checksum=int(pixels.view(np.int8).sum(dtype=np.int64)) % 2**32,
        ).replace("\n", "\r\n")  # fmt: skip
    with writing_to(path, WRITABLE):
        path.write_bytes(head.ljust(records * samples).encode("ascii") + pixels.tobytes())


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
    """Data of an image for the kernels."""
    trajectory = image.nominal.trajectory
    if not isinstance(trajectory, Trajectory):
        raise InputError(f"image {image.nominal.name}", "an orientation in polynomials", "tables, as kernels have")
    return KernelSegment(image.settings.name, image.settings.phase, trajectory)


def product_id(settings: ImageSettings) -> str:
    """The image's name in labels and indices."""
    return settings.name.replace("-", "/")


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

"""A simulated site laid out as the public archives are: what `mgsgraph fetch` finds and fetches, from localhost.

Five roots under one folder: images/ (PDS imaging node, MOC), kernels/ and leap_seconds/ (NAIF), pedr/ and megdr/ (PDS
geosciences node, MOLA), with the archives' own folders, names and labels below. What differs from them: images are not
compressed, kernels and profiles hold the site's passes alone, away from the site the grids have a plain at its level,
and of other images there are index entries but no files.
"""

import shutil
from collections.abc import Iterator, Sequence
from datetime import datetime, timedelta
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from archive_index import IndexEntry, Value, write_indexes

from mgsgraph.errors import InputError
from mgsgraph.files.rasters.megdr import REFERENCE_RADIUS
from mgsgraph.geometry.body import geodetic
from mgsgraph.geometry.records import Array
from mgsgraph.simulation.camera import BORESIGHT_SAMPLE
from mgsgraph.simulation.files import writing
from mgsgraph.simulation.ground import areoid_under, terrain_grid
from mgsgraph.simulation.mgs_files import (
    kernel_segment,
    label_time,
    pedr_file,
    product_id,
    write_moc_image,
)
from mgsgraph.simulation.mola_files import MegdrLayout, write_megdr, write_pedr
from mgsgraph.simulation.site import SimulatedImage, SimulatedSite
from mgsgraph.simulation.spice_files import CAMERA, CAMERA_FRAME_TEXT, ephemeris_time, write_kernels
from mgsgraph.units import DEG, KM

ROOTS = ("images", "kernels", "leap_seconds", "pedr", "megdr")
"""Folders of the archives."""

_FIXED = {
    "mgs.tls": "leap_seconds/naif0012.tls",
    "mgs.tsc": "kernels/sclk/mgs_sclkscet_00061.tsc",
    "mars.tpc": "kernels/pck/pck00009.tpc",
    "mgs.tf": "kernels/fk/mgs_v10.tf",
    "mars.bsp": "kernels/spk/de405.bsp",
}
"""Kernels that don't go by mission phase: as the simulation calls them, and where the archive has them."""
_INSTRUMENT = "kernels/ik/mgs_moc_v20.ti"
_NOMINAL_FOCAL_LENGTH, _NOMINAL_PITCH = 3.5, 0.000013
"""m, of the instrument kernel."""
_PHASES = {
    "ext1": ("2001-02-01T00:00:04", "2001-04-03T23:59:55"),
    "ext2": ("2001-04-04T00:00:04", "2001-06-26T23:59:55"),
}
"""UTC from and to which the kernels of a mission phase go, by their labels."""
_OTHERS = (
    IndexEntry(1006, "M00/02320", "1999-04-24T06:10:35.00", {"ORBIT_NUMBER": 564}),
    IndexEntry(1015, "M01/03072", "1999-05-24T11:21:07.12", {"ORBIT_NUMBER": 934}),
    IndexEntry(1068, "M08/06047", "1999-10-26T17:45:30.51", {"ORBIT_NUMBER": 2837}),
    IndexEntry(1242, "E23/00003", "2003-01-01T02:14:55.20", {"ORBIT_NUMBER": 17028}),
)
"""Images whose volumes are known, so that there is something to search through; their times are made up."""
_ANCHORS = ((1068, datetime(1999, 10, 26)), (1242, datetime(2003, 1, 1)))
"""Volumes between which the others are spread evenly in time."""
_LETTERS = {4: "c", 16: "e"}
"""Of MEGDR's resolutions, posts per degree, in one file for all of Mars."""
_REACH = (100e3, 100e3)
"""m east and west, north and south of the site's centre, of its ground in the grids."""


def write_archive(simulated: SimulatedSite, folder: Path, resolutions: Sequence[int] = (16,)) -> Path:
    """Write a simulated site as archives; returns the folder, which is what a mirror's address stands for.

    Parameters
    ----------
    simulated : SimulatedSite
        As simulated.
    folder : Path
        Made when absent; files of the same names in it are replaced.
    resolutions : sequence of int
        posts per degree of the terrain grids: 4, 16 (66 MB) or both.

    Raises
    ------
    InputError
        If the folder can't be written, or there is no grid of that resolution.
    """
    for ppd in resolutions:
        if ppd not in _LETTERS:
            raise InputError("simulated archive, resolution", f"{ppd} posts per degree", "4 or 16")
    with writing(folder):
        for root in ROOTS:
            (folder / root).mkdir(exist_ok=True)
        _write_images(simulated, folder / "images")
        _write_kernels(simulated, folder)
        for image in simulated.images:
            _write_profile(image, folder / "pedr")
        for ppd in resolutions:
            _write_grids(simulated, folder / "megdr", ppd)
    return folder


def _placed(path: Path) -> Path:
    """The path, in a folder that is there."""
    path.parent.mkdir(parents=True, exist_ok=True)
    return path


# --- images


def _write_images(simulated: SimulatedSite, folder: Path) -> None:
    entries = list(_OTHERS)
    for image in simulated.images:
        entry = _entry(simulated, image)
        entries += [entry, *_beside(entry)]
        path = _placed(folder / entry.path)
        write_moc_image(path, image.settings, image.clock_start, _rationale(simulated), image.pixels)
    write_indexes(folder, entries)


def _rationale(simulated: SimulatedSite) -> str:
    return f"Simulated image of {simulated.settings.title}"


def _entry(simulated: SimulatedSite, image: SimulatedImage) -> IndexEntry:
    """The image in the index; its places are those of the nominal orientation on the ellipsoid."""
    settings, start = image.settings, datetime.fromisoformat(image.settings.start)
    high, wide = float(settings.lines), float(settings.samples)
    lines = np.array([0.5 * high, 0.0, 0.0, high, high])
    samples = np.array([0.5 * wide, 0.0, wide, 0.0, wide])
    ground, _ = image.nominal.image_to_ground(lines, samples, simulated.terrain.ground.level)
    across, along = (float(np.linalg.norm(ground[k] - ground[1])) for k in (2, 3))
    more: dict[str, Value] = {
        "LINE_SAMPLES": settings.samples,
        "LINES": settings.lines,
        "CROSSTRACK_SUMMING": settings.crosstrack_summing,
        "DOWNTRACK_SUMMING": settings.downtrack_summing,
        "EMISSION_ANGLE": settings.emission / DEG,
        "INCIDENCE_ANGLE": float(np.arccos(image.sun @ ground[0] / np.linalg.norm(ground[0]))) / DEG,
        "SPACECRAFT_CLOCK_START_COUNT": image.clock_start,
        "LINE_EXPOSURE_DURATION": 1e3 * settings.exposure,
        "EDIT_MODE_ID": settings.edit_mode,
        "SCALED_PIXEL_WIDTH": across / wide,
        "SCALED_IMAGE_WIDTH": across / KM,
        "SCALED_IMAGE_HEIGHT": along / KM,
        "SPACECRAFT_ALTITUDE": simulated.settings.altitude / KM,
        "RATIONALE_DESC": _rationale(simulated),
        "ORBIT_NUMBER": settings.orbit,
    }
    places = geodetic(ground, image.nominal.body)[:, :2] / DEG
    for corner, (longitude, latitude) in zip(
        ("CENTER", "UPPER_LEFT", "UPPER_RIGHT", "LOWER_LEFT", "LOWER_RIGHT"), places.tolist(), strict=True
    ):
        more |= {f"{corner}_LONGITUDE": -longitude % 360.0, f"{corner}_LATITUDE": latitude}
    return IndexEntry(_volume(start), product_id(settings), label_time(start), more)


def _beside(entry: IndexEntry) -> list[IndexEntry]:
    """Entries of the images before and after: a narrow-angle one, and the wide-angle one of the surroundings."""
    cycle, number = entry.product.split("/")
    start = datetime.fromisoformat(entry.time)
    orbit: dict[str, Value] = {"ORBIT_NUMBER": entry.more["ORBIT_NUMBER"]}
    wide: dict[str, Value] = {"INSTRUMENT_NAME": "MOC-WA", "FILTER_NAME": "RED", "LINE_SAMPLES": 480, "LINES": 480}
    return [
        IndexEntry(entry.volume, f"{cycle}/{int(number) + step:05d}", label_time(start + timedelta(minutes=at)), more)
        for step, at, more in ((-1, -40, orbit), (1, 0.02, orbit | wide), (2, 25, orbit))
    ]


def _volume(start: datetime) -> int:
    """Number of the volume that holds an image of that time."""
    (first, begin), (last, end) = _ANCHORS
    return first + int((last - first) * ((start - begin) / (end - begin)))


# --- kernels


def _write_kernels(simulated: SimulatedSite, folder: Path) -> None:
    phases = sorted({image.settings.phase for image in simulated.images})
    with TemporaryDirectory(dir=folder) as aside:
        write_kernels([kernel_segment(image) for image in simulated.images], Path(aside))
        places = _FIXED | {f"mgs_{phase}.bsp": f"kernels/spk/mgs_{phase}.bsp" for phase in phases}
        places |= {f"mgs_sc_{phase}.bc": f"kernels/ck/mgs_sc_{phase}.bc" for phase in phases}
        for name, place in places.items():
            shutil.move(Path(aside) / name, _placed(folder / place))
    _placed(folder / _INSTRUMENT).write_text(_instrument_text(), encoding="ascii", newline="\n")
    for path in sorted((folder / "kernels").rglob("*.*")):
        if path.suffix != ".lbl":
            start, stop = _PHASES.get(path.stem.rpartition("_")[2], ("N/A", "N/A"))
            text = _kernel_label(path, start, stop)
            path.with_suffix(".lbl").write_text(text, encoding="ascii", newline="\r\n")


def _instrument_text() -> str:
    """The camera in the words of NAIF's instrument kernel (moc20.ti): metres, first pixel 0.

    Its numbers are the nominal ones, as in the archive: 1 percent off the true scale, FOCAL_LENGTH_MM / PITCH_MM pixels
    per radian, to which a focal length of 3.4669 m belongs.
    """
    return f"""KPL/IK

MOC narrow angle camera. Focal length and pixel size in m, angles in radians; keywords as in NAIF's kernel.

\\begindata
INS{CAMERA}_FOCAL_LENGTH  = ( {_NOMINAL_FOCAL_LENGTH} )
INS{CAMERA}_PIXEL_SAMPLES = ( 2048 )
INS{CAMERA}_PIXEL_LINES   = ( 1 )
INS{CAMERA}_CENTER        = ( {BORESIGHT_SAMPLE - 1.0!r} 0.5 )
INS{CAMERA}_PIXEL_SIZE    = ( {_NOMINAL_PITCH} )

{CAMERA_FRAME_TEXT}\\begintext
"""


def _kernel_label(path: Path, start: str, stop: str) -> str:
    kind = path.parent.name.upper()
    binary = kind in ("SPK", "CK")
    bytes_of_record = "RECORD_BYTES              = 1024\n" if binary else ""
    return f"""PDS_VERSION_ID            = PDS3
RECORD_TYPE               = {"FIXED_LENGTH" if binary else "STREAM"}
{bytes_of_record}^SPICE_KERNEL             = "{path.name}"
MISSION_NAME              = "MARS GLOBAL SURVEYOR"
SPACECRAFT_NAME           = "MARS GLOBAL SURVEYOR"
DATA_SET_ID               = "MGS-M-SPICE-6-V1.0"
KERNEL_TYPE_ID            = {kind}
PRODUCT_ID                = "{path.name}"
PRODUCT_CREATION_TIME     = 2001-12-01T00:00:00
PRODUCER_ID               = "MGSGRAPH_SIMULATION"
TARGET_NAME               = MARS
START_TIME                = {start if start[0].isdigit() else f'"{start}"'}
STOP_TIME                 = {stop if stop[0].isdigit() else f'"{stop}"'}
OBJECT                    = SPICE_KERNEL
  INTERCHANGE_FORMAT      = {"BINARY" if binary else "ASCII"}
  KERNEL_TYPE             = {kind}
  DESCRIPTION             = "Simulated; it holds the site's passes alone."
END_OBJECT                = SPICE_KERNEL
END
"""


# --- altimetry


def _write_profile(image: SimulatedImage, folder: Path) -> None:
    name = pedr_file(image)
    start, frames = datetime.fromisoformat(image.settings.start), image.profile
    first, last = (
        label_time(start + timedelta(seconds=float(time) - ephemeris_time(image.settings.start)))
        for time in frames.times[[0, -1]]
    )
    path = _placed(folder / f"{name[:4]}xxx" / name)
    write_pedr(path, frames, {"START_TIME": first, "STOP_TIME": last})


def _write_grids(simulated: SimulatedSite, folder: Path, ppd: int) -> None:
    """Radius and topography of all of Mars: the site as a grid of that resolution has it, and a plain about it."""
    terrain, step, letter = simulated.terrain, DEG / ppd, _LETTERS[ppd]
    site = terrain_grid(terrain, ppd, _REACH)
    radii = np.asarray(site.radii, dtype=np.float64)
    latitudes = np.asarray(0.5 * np.pi - (np.arange(180 * ppd) + 0.5) * step, dtype=np.float64)
    areoid = terrain.areoid_radius(np.full(latitudes.size, terrain.centre_lon), latitudes)
    height = terrain.ground.level - terrain.ground.areoid
    corner = round((latitudes[0] - site.first_latitude) / step), round(site.first_longitude / step - 0.5)
    place = _placed(folder / f"meg{ppd:03d}" / "any").parent
    for kind, offset, plain, own in (
        ("r", REFERENCE_RADIUS, areoid + height, radii),
        ("t", 0.0, np.full(latitudes.size, height), radii - areoid_under(terrain, site)),
    ):
        layout = MegdrLayout((180 * ppd, 360 * ppd), 0.5 * step, float(latitudes[0]), step, offset)
        write_megdr(place, f"meg{kind}90n000{letter}b", layout, _pasted(plain, own, corner, 360 * ppd))


def _pasted(plain: Array, own: Array, corner: tuple[int, int], wide: int) -> Iterator[Array]:
    """Rows (wide,) that are plain (rows,) but for own (high, columns) with its upper left post at `corner`."""
    top, left = corner
    for number, height in enumerate(plain):
        row = np.full(wide, height)
        if 0 <= number - top < own.shape[0]:
            row[left : left + own.shape[1]] = own[number - top]
        yield row

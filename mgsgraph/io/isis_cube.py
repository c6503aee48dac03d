"""ISIS cubes after spiceinit: their own tables of position, attitude and body rotation, in place of kernels.

MOC's narrow angle. A map-projected cube gives the geometry of the image it was made of (its AlphaCube), whole.
What the tables hold, by ISIS's SpicePosition, SpiceRotation and MocNarrowAngleCamera: positions of the spacecraft as
seen from the body ("LT+S"), made geometric here; attitude whose times have the bias of -1.15 s in them already; all
against J2000, from the first line's edge to the last one's.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from mgsgraph.errors import InputError, errors_from
from mgsgraph.geometry.body import Ellipsoid
from mgsgraph.geometry.camera import InteriorOrientation
from mgsgraph.geometry.distortion import NoDistortion
from mgsgraph.geometry.image import LineTiming, PushbroomImage
from mgsgraph.geometry.records import Array
from mgsgraph.geometry.trajectory import AttitudeTable, PositionTable, Trajectory
from mgsgraph.io.aberration import geometric
from mgsgraph.io.image_label import cube_size, read_label
from mgsgraph.io.moc_label import EXPOSURE_UNITS
from mgsgraph.io.pvl import Block
from mgsgraph.units import ISIS_OFFSET, KM, MM

_MARS = Ellipsoid(3_396_190.0, 3_376_200.0)
"""m, IAU 2000, as in the PCK that spiceinit takes."""
_FOCAL_LENGTH, _PITCH, _CENTRE = 3500.0 * MM, 0.0131240578522949 * MM, 1024.5
"""m, m, and ISIS's detector pixel of the boresight: mocAddendum004.ti, which the tables' own label doesn't hold."""
_TABLES = ("InstrumentPosition", "InstrumentPointing", "BodyRotation", "SunPosition")
_QUATERNION = ("J2000Q0", "J2000Q1", "J2000Q2", "J2000Q3")
_POSITION, _VELOCITY = ("J2000X", "J2000Y", "J2000Z"), ("J2000XV", "J2000YV", "J2000ZV")
_TIME_SLACK = 1e-4
"""s, a tenth of the shortest line, by which the position table may be longer or shorter than the image."""
_REMEDY = "run spiceinit on the cube before it is adjusted, with its tables attached"


@dataclass(frozen=True, slots=True)
class _CubeTable:
    """A binary table of a cube: where it is said, its label, and its numbers by field."""

    where: str
    label: Block
    columns: dict[str, Array]
    """(records,) by field, as the file has them: km, km/s, s TDB past J2000."""

    def stack(self, names: tuple[str, ...]) -> Array:
        """(records, k) of some fields."""
        for name in names:
            if name not in self.columns:
                raise InputError(self.where, f"the fields {', '.join(self.columns)}", ", ".join(names), _REMEDY)
        return np.stack([self.columns[name] for name in names], axis=1)

    @property
    def times(self) -> Array:
        """(records,) s TDB past J2000."""
        return self.stack(("ET",))[:, 0]


def read_isis_cube(path: Path, name: str | None = None, apparent: bool = False) -> PushbroomImage:
    """Read a narrow-angle image's geometry out of a cube that spiceinit has been run on.

    Parameters
    ----------
    path : Path
        Cube in camera geometry, whole; or map-projected, whose camera image is then the one it came from, or any part.
    name : str, optional
        By which networks call the image; the product id when absent.
    apparent : bool
        Positions as ISIS takes them, some 100 m off; for maps that ISIS has made of the image, and for nothing else.

    Returns
    -------
    PushbroomImage
        Lines and samples are those of the image before any map projection.

    Raises
    ------
    InputError
        No cube, another instrument or body, no tables, tables that jigsaw has replaced by polynomials, or that are cut
        short.
    """
    cube = _moc_cube(path)
    tables = {table: _table(path, cube, table) for table in _TABLES}
    instrument = cube.inner("IsisCube").inner("Instrument")
    lines, samples = _camera_size(cube.inner("IsisCube"))
    period = _line_period(instrument)
    start = _start(tables["InstrumentPosition"], lines * period)
    epoch = start + 0.5 * lines * period
    with errors_from(str(path)):
        return PushbroomImage(
            name=name or cube.inner("IsisCube").inner("Archive").text("ProductId"),
            lines=lines,
            samples=samples,
            interior=_interior(instrument),
            timing=LineTiming(np.zeros(1), np.array([start - epoch]), np.array([period])),
            trajectory=_trajectory(tables, epoch, apparent),
            body=_MARS,
        )


def is_map_projected(path: Path) -> bool:
    """Whether a cube's pixels are those of a map, not of the camera."""
    return any(block.name == "mapping" for block in read_label(path).inner("IsisCube").blocks)


def _moc_cube(path: Path) -> Block:
    """The label of a cube of MOC's narrow angle at Mars."""
    root = read_label(path)
    if "PDS_VERSION_ID" in root:
        raise InputError(str(path), "a PDS3 label", "an ISIS cube", "give its label and kernels instead")
    instrument = root.inner("IsisCube").inner("Instrument")
    for key, wanted in (("InstrumentId", "MOC-NA"), ("TargetName", "MARS")):
        if instrument.text(key).upper() != wanted:
            raise InputError(instrument.where(key), repr(instrument.text(key)), f"{wanted}, the one known here")
    return root


def _camera_size(cube: Block) -> tuple[int, int]:
    """Lines and samples of the whole image in camera geometry."""
    if not any(block.name == "mapping" for block in cube.blocks):
        return cube_size(cube)
    alpha = cube.inner("AlphaCube")
    return alpha.count("AlphaLines"), alpha.count("AlphaSamples")


def _line_period(instrument: Block) -> float:
    exposure = instrument.number("LineExposureDuration", EXPOSURE_UNITS)
    if exposure <= 0.0:
        raise InputError(instrument.where("LineExposureDuration"), f"{exposure} s", "a positive line exposure")
    return exposure * instrument.count("DowntrackSumming")


def _interior(instrument: Block) -> InteriorOrientation:
    """As `read_moc` has it from the kernels: detector pixel = sample * summing + first."""
    to_pixel = np.array([[0.0, 1.0 / _PITCH, 0.0], [0.0, 0.0, 1.0 / _PITCH]])
    first = instrument.count("FirstLineSample") - 1.0
    return InteriorOrientation(
        focal_length=_FOCAL_LENGTH,
        to_pixel=to_pixel,
        centre=np.array([0.0, _CENTRE - ISIS_OFFSET]),
        first=np.array([0.0, first]),
        sample_summing=float(instrument.count("CrosstrackSumming")),
        distortion=NoDistortion(),
    )


def _start(position: _CubeTable, duration: float) -> float:
    """Time of the first line's edge, s TDB past J2000: StartTime is rounded, but positions are sampled from there."""
    times = position.times
    if abs(times[-1] - times[0] - duration) > _TIME_SLACK:
        raise InputError(
            f"{position.where}, ET", f"{times[-1] - times[0]:.6f} s from first to last",
            f"the image's {duration:.6f} s", "the table is not of this image, or of a part: run spiceinit again",
        )
    return float(times[0])


def _trajectory(tables: dict[str, _CubeTable], epoch: float, apparent: bool) -> Trajectory:
    seen = tables["InstrumentPosition"]
    position = PositionTable(seen.times - epoch, seen.stack(_POSITION) * KM, seen.stack(_VELOCITY) * KM)
    if not apparent:
        sun_velocity = tables["SunPosition"].stack(_VELOCITY).mean(axis=0) * KM
        position = geometric(position, -sun_velocity, body_observes=True)
    return Trajectory(
        epoch,
        position,
        _attitude(tables["InstrumentPointing"], epoch),
        _attitude(tables["BodyRotation"], epoch),
    )


def _attitude(table: _CubeTable, epoch: float) -> AttitudeTable:
    constant = np.eye(3)
    if "ConstantRotation" in table.label:
        constant = np.array(table.label.numbers("ConstantRotation", 9)).reshape(3, 3)
    with errors_from(table.where):
        return AttitudeTable(table.times - epoch, table.stack(_QUATERNION), constant)


def _table(path: Path, root: Block, name: str) -> _CubeTable:
    """Read a table (ISIS TableField: fields of doubles, record after record)."""
    for label in root.blocks:
        if label.name == "table" and label.text("Name").lower() == name.lower():
            break
    else:
        raise InputError(str(path), f"no table {name}", "the tables of spiceinit", _REMEDY)
    where = f"{path}, table {name}"
    fields = [block for block in label.blocks if block.name == "field"]
    for block in fields:
        if block.text("Type").lower() != "double" or block.count("Size") != 1:
            raise InputError(block.where(), f"a field of {block.count('Size')} {block.text('Type')}", "one Double")
    records, start, size = label.count("Records"), label.count("StartByte") - 1, label.count("Bytes")
    if size != records * len(fields) * 8:
        raise InputError(where, f"{size} bytes", f"{records} records of {len(fields)} doubles")
    order = ">" if label.text("ByteOrder").lower() == "msb" else "<"
    with path.open("rb") as file:
        file.seek(start)
        raw = file.read(size)
    if len(raw) < size:
        raise InputError(where, f"{len(raw)} bytes from byte {start + 1} on", f"{size}", "the cube is cut short")
    numbers = np.frombuffer(raw, f"{order}f8").astype(np.float64).reshape(records, len(fields))
    if not np.isfinite(numbers).all():
        raise InputError(where, "values that are no numbers", "finite ones")
    return _CubeTable(where, label, {block.text("Name"): numbers[:, k] for k, block in enumerate(fields)})

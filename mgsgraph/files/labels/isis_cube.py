"""ISIS cubes after spiceinit: label, NaifKeywords and the tables of position, attitude and body rotation, as they are.

The same content as JSON ("isis_camera_version" 1, which ISIS makes of cubes for its tests, and 2) is read with the
label beside it. What tables hold, by ISIS's SpicePosition and SpiceRotation: positions of the spacecraft, apparent
("LT+S", seen from the body) unless a keyword says otherwise, made geometric here; attitude whose times have the
camera's time bias in them already; all against J2000. jigsaw puts polynomials in place of what it has adjusted.

Tables that spiceinit and jigsaw attach to an ISIS cube: binary behind the label, or the same as JSON.

Layout: ISIS TableField (fields of doubles, record after record); what they mean: SpicePosition::LoadCache,
SpiceRotation::LoadCache. A table of positions or attitudes is a cache of samples, or the coefficients of polynomials of
scaled time (jigsaw, CacheType = PolyFunction): of X, Y, Z in km, or of three angles about the axes 3, 1, 3.
"""

import os
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from mgsgraph.errors import InputError, errors_from, require
from mgsgraph.files.cameras.camera import LineScanLabel, LineTimes, NaifKeywords, number
from mgsgraph.files.cameras.label import is_map_projected, label_of
from mgsgraph.files.labels.aberration import Aberration, aberration_of, geometric, remarks_on, spacecraft_of
from mgsgraph.files.opening import ANY_SIZE, opened, read_json
from mgsgraph.files.pvl import Block, read_label
from mgsgraph.geometry import rotation
from mgsgraph.geometry.body import Ellipsoid, require_possible
from mgsgraph.geometry.image import PushbroomImage
from mgsgraph.geometry.plausibility import MEASURED, require_flight, turning_otherwise
from mgsgraph.geometry.records import Array
from mgsgraph.geometry.trajectory import AttitudeTable, PositionTable, Trajectory
from mgsgraph.units import KM

_JSON_NAMES = {
    "InstrumentPosition": "instrument_position", "InstrumentPointing": "instrument_pointing",
    "BodyRotation": "body_rotation", "SunPosition": "sun_position",
}  # fmt: skip
QUATERNION, ANGLES = ("J2000Q0", "J2000Q1", "J2000Q2", "J2000Q3"), ("J2000Ang1", "J2000Ang2", "J2000Ang3")
POSITION, VELOCITY = ("J2000X", "J2000Y", "J2000Z"), ("J2000XV", "J2000YV", "J2000ZV")
RATES = ("AV1", "AV2", "AV3")
COEFFICIENTS = ("J2000SVX", "J2000SVY", "J2000SVZ")
_REMEDY = "run spiceinit on the cube again, with its tables attached"
CORRECTION = "LightTimeCorrection"
"""Key of a table of positions that says that they are geometric (NONE): ISIS takes positions as they are."""
_LARGEST = 1e100
"""Larger numbers are ISIS's Null, or none at all."""
_KAGUYA = -131
_SAME = 1e-6
"""Share by which constants that are the same may differ: digits."""
_NODES = 2049
"""Samples at which a polynomial of jigsaw is evaluated; between them cubic and great arc are far below a micropixel."""


@dataclass(frozen=True, slots=True)
class CubeTable:
    """A table of a cube: its place for messages, its numbers by field, and the keys of its label."""

    where: str
    """File and table, for messages."""
    columns: Mapping[str, Array]
    """(records,) by field, as the file has them: km, km/s, s TDB past J2000, rad."""
    constant: Array
    """(3, 3) constant rotation behind the sampled one."""
    first: float | None
    """s TDB past J2000 from which on the label says that it covers; None where it doesn't."""
    last: float | None
    """s TDB past J2000 up to which it does."""
    geometric: bool = False
    """Whether its label says that its positions are, whatever keywords of the camera say: `export --to cubes`."""

    def stack(self, names: tuple[str, ...]) -> Array:
        """(records, k) of some fields."""
        for name in names:
            if name not in self.columns:
                raise InputError(self.where, f"the fields {', '.join(self.columns)}", ", ".join(names), _REMEDY)
        return np.stack([self.columns[name] for name in names], axis=1)

    @property
    def sampled(self) -> bool:
        """Whether it holds samples, not coefficients."""
        return "ET" in self.columns

    @property
    def times(self) -> Array:
        """(records,) s TDB past J2000 of the samples."""
        return self.stack(("ET",))[:, 0]

    @property
    def velocities(self) -> Array:
        """(records, 3) km/s."""
        return self.stack(VELOCITY)

    @property
    def start(self) -> float:
        """First time, s TDB past J2000."""
        return float(self.times[0]) if self.sampled else self._stated(self.first)

    @property
    def stop(self) -> float:
        """Last time, s TDB past J2000."""
        return float(self.times[-1]) if self.sampled else self._stated(self.last)

    def _stated(self, time: float | None) -> float:
        if time is None:
            found, expected = "polynomials without the time that they are for", "its TableStartTime and TableEndTime"
            raise InputError(self.where, found, expected)
        return time


# --- as records


def position_table(table: CubeTable, epoch: float) -> PositionTable:
    """Positions in m, inertial, at times in s past an epoch."""
    with errors_from(table.where):
        if table.sampled:
            return PositionTable(table.times - epoch, table.stack(POSITION) * KM, table.velocities * KM)
        times, values, rates = _evaluated(table, COEFFICIENTS)
        return PositionTable(times - epoch, values * KM, rates * KM)


def attitude_table(table: CubeTable, epoch: float) -> AttitudeTable:
    """Attitude, inertial to the wanted frame, at times in s past an epoch."""
    with errors_from(table.where):
        if table.sampled:
            return AttitudeTable(table.times - epoch, table.stack(QUATERNION), table.constant)
        times, angles, _ = _evaluated(table, ANGLES)
        quaternions = rotation.from_matrix(rotation.from_angles_313(angles))
        return AttitudeTable(times - epoch, rotation.continuous(quaternions), table.constant)


def _evaluated(table: CubeTable, names: tuple[str, ...]) -> tuple[Array, Array, Array]:
    """Times (n,) in s TDB past J2000 over the table's coverage, values (n, 3) and rates (n, 3) of its polynomials.

    The last record holds base time, time scale and degree: t = (ET - base time) / time scale.
    """
    *coefficients, (base, scale, degree) = table.stack(names)
    if scale <= 0.0 or len(coefficients) != degree + 1.0:
        found = f"{len(coefficients)} coefficients of degree {degree:g}, time scale {scale:g} s"
        raise InputError(table.where, found, "degree + 1 coefficients and a positive time scale", _REMEDY)
    polynomial = np.polynomial.Polynomial
    times = np.linspace(table.start, table.stop, _NODES)
    of_axes = [polynomial(axis) for axis in np.stack(coefficients, axis=1)]
    with np.errstate(all="ignore"):  # the records that these are for take finite numbers only
        scaled = (times - base) / scale
        values = np.stack([axis(scaled) for axis in of_axes], axis=1)
        return times, values, np.stack([axis.deriv()(scaled) / scale for axis in of_axes], axis=1)


# --- as JSON


def tables_of_json(content: Mapping[str, Any], source: str) -> dict[str, CubeTable]:
    """Tables by ISIS's names."""
    tables = dict[str, CubeTable]()
    for name, key in _JSON_NAMES.items():
        if key in content:
            tables[name] = _of_json(content[key], f"{source}, {key}")
    return tables


def _of_json(table: Any, where: str) -> CubeTable:
    if not isinstance(table, dict):
        raise InputError(where, repr(table)[:60], "a table")
    columns = dict[str, Array]()
    for key, names in (
        ("positions", POSITION), ("velocities", VELOCITY), ("quaternions", QUATERNION),
        ("angular_velocities", RATES),
    ):  # fmt: skip
        if key in table:
            values = _numbers(table[key], (None, len(names)), f"{where}, {key}")
            columns |= dict(zip(names, values.T, strict=True))
    if "ephemeris_times" in table:
        columns["ET"] = _numbers(table["ephemeris_times"], (None,), f"{where}, ephemeris_times")
    lengths = {column.size for column in columns.values()}
    if len(lengths) != 1 or 0 in lengths:
        found = ", ".join(f"{column.size} of {name}" for name, column in columns.items())
        raise InputError(where, found or "no columns", "as many of each, and some")
    if "constant_rotation" not in table and len(table.get("constant_frames") or ()) > 1:
        found = f"constant_frames {table['constant_frames']} without constant_rotation"
        raise InputError(where, found, "the rotation between them")
    constant = _numbers(table.get("constant_rotation", np.eye(3).ravel().tolist()), (9,), f"{where}, constant_rotation")
    return CubeTable(where, columns, constant.reshape(3, 3), None, None)


def _numbers(values: Any, shape: tuple[int | None, ...], where: str) -> Array:
    try:
        array = np.array(values, dtype=np.float64)
    except (TypeError, ValueError):
        raise InputError(where, "what is not a table of numbers", "numbers") from None
    good = array.ndim == len(shape) and all(a in (None, b) for a, b in zip(shape, array.shape, strict=True))
    if not good or not (np.abs(array) < _LARGEST).all():
        wanted = " x ".join("n" if n is None else str(n) for n in shape)
        raise InputError(where, f"numbers of shape {array.shape}", f"{wanted} finite numbers")
    return array


# --- behind a label


def tables_of_label(path: Path, root: Block) -> dict[str, CubeTable]:
    """Tables of a cube, by their names; empty for a cube (or a label of one) that spiceinit has not been run on."""
    labels = {block.text("Name").lower(): block for block in root.blocks if block.name == "table"}
    return {name: _of_cube(path, labels[name.lower()], name) for name in _JSON_NAMES if name.lower() in labels}


def _of_cube(path: Path, label: Block, name: str) -> CubeTable:
    where = f"{path}, table {name}"
    fields = [block for block in label.blocks if block.name == "field"]
    for block in fields:
        if block.text("Type").lower() != "double" or block.count("Size") != 1:
            raise InputError(block.where(), f"a field of {block.count('Size')} {block.text('Type')}", "one Double")
    records, start, size = label.count("Records"), label.count("StartByte") - 1, label.count("Bytes")
    require(size == records * len(fields) * 8, where, f"{size} bytes", f"{records} records of {len(fields)} doubles")
    order = ">" if label.text("ByteOrder").lower() == "msb" else "<"
    with opened(detached_file(path, label), ANY_SIZE) as file:
        available = max(os.fstat(file.fileno()).st_size - start, 0)
        if available < size:
            remedy = "the cube is cut short, or a label alone: name the cube, or put its tables beside it (.isd)"
            raise InputError(where, f"{available} bytes from byte {start + 1} on", f"{size}", remedy)
        file.seek(start)
        raw = file.read(size)
    numbers = np.frombuffer(raw, f"{order}f8").astype(np.float64).reshape(records, len(fields))
    require((np.abs(numbers) < _LARGEST).all(), where, "values that are no numbers", "finite ones")
    kind = "Ck" if "Rotation" in name or "Pointing" in name else "Spk"
    ends = (f"{kind}Table{end}Time" for end in ("Start", "End"))
    first, last = (label.number(key) if key in label else None for key in ends)
    return CubeTable(
        where,
        {block.text("Name"): numbers[:, k] for k, block in enumerate(fields)},
        np.array(label.numbers("ConstantRotation", 9)).reshape(3, 3) if "ConstantRotation" in label else np.eye(3),
        first, last, CORRECTION in label and label.text(CORRECTION).upper() == "NONE",
    )


def detached_file(path: Path, label: Block) -> Path:
    """File of what an object of a label (Table, History, Core) describes: the label's own, or one in its folder that
    the object names (^Table = FILE: ISIS Blob::Find, Cube::open).
    """
    key = f"^{label.name}"
    return path.parent / label.text(key) if key in label else path


# --- the cube

_TABLES = ("InstrumentPosition", "InstrumentPointing", "BodyRotation")
_SUN = "SunPosition"
_JSON = (".isd", ".json")
_LABELS = (".pvl", ".lbl", ".cub", ".LBL")
_NO_TABLES = "run spiceinit on the cube (attach=yes), or name the label and its kernels"
_LINE_SLACK, _ROUNDING = 0.1, 2e-5
"""Lines, and s, by which the table of positions may begin and end off the image's own times; those of true cubes do so
by less than 1e-6 s, but jigsaw's labels have five decimals of them.
"""


def read_isis_cube(
    path: Path, name: str | None = None, aberration: Aberration | None = None, apparent: bool = False
) -> PushbroomImage:
    """Read an image's geometry out of a cube that spiceinit has been run on.

    Parameters
    ----------
    path : Path
        Cube in camera geometry, whole or cut out by ISIS crop; or map-projected, whose camera image is then the one it
        came from, or any part. Or a label whose tables are JSON beside it (``.isd``, ``.json``); or that JSON.
    name : str, optional
        By which networks call the image; ISIS's serial number when absent.
    aberration : Aberration, optional
        Overrules what keywords and camera say of the position table.
    apparent : bool
        Positions as ISIS takes them, some 100 m off; for maps that ISIS has made of the image, and for nothing else.

    Returns
    -------
    PushbroomImage
        Lines and samples are those of the image before any map projection.

    Raises
    ------
    InputError
        No cube, a camera that is not known here, no tables (spiceinit wasn't run), or tables that are cut short or of
        another image.
    """
    label_path, json_path = cube_files(path)
    root = read_label(label_path)
    if "PDS_VERSION_ID" in root:
        raise InputError(str(path), "a PDS3 label", "an ISIS cube", "name its kernels: label = ..., kernels = [...]")
    label = label_of(label_path, root)
    content = read_json(json_path) if json_path else None
    tables = tables_of_json(content, str(json_path)) if content else tables_of_label(label_path, root)
    for table in _TABLES:
        require(table in tables, str(path), f"no table {table}", "the tables of spiceinit", _NO_TABLES)
    mapped = ("the camera's image that its map was made of",) if is_map_projected(root) else ()
    with errors_from(str(path)):
        keywords = _keywords(content, str(json_path or label_path), label)
        stated = (Aberration("NONE"), "apparent, as ISIS has them") if apparent else None
        if tables["InstrumentPosition"].geometric:
            stated = Aberration("NONE"), "as their table says"
        stated = stated or (aberration and (aberration, "as the case says")) or _stated_aberration(keywords, label)
        image = _image(label, keywords, tables, name, *stated)
        return replace(image, remarks=(*image.remarks, *mapped))


def _image(
    label: LineScanLabel, keywords: NaifKeywords, tables: dict[str, CubeTable], name: str | None, stated: Aberration,
    why: str,
) -> PushbroomImage:
    times = _line_times(label, keywords, tables["InstrumentPosition"])
    epoch = 0.5 * (times.start + times.stop)
    interior, body = label.camera.interior(keywords, label), _body(keywords, label)
    return PushbroomImage(
        name=name or label.serial,
        lines=label.lines,
        samples=label.samples,
        interior=interior,
        timing=times.timing(epoch),
        trajectory=_trajectory(tables, epoch, stated, body),
        body=body,
        remarks=(*remarks_on(stated, why), *_other_constants(label, keywords), *_odd_rates(label, tables)),
        mission=label.camera.mission,
    )


def _odd_rates(label: LineScanLabel, tables: dict[str, CubeTable]) -> Iterator[str]:
    """A remark, or InputError, where attitudes don't turn as their own angular velocities say."""
    for name, noise in (("InstrumentPointing", MEASURED), ("BodyRotation", 0.0)):
        table = tables[name]
        if not (table.sampled and set(RATES) <= set(table.columns)):
            continue
        found = turning_otherwise(table.times, table.stack(QUATERNION), table.stack(RATES), noise)
        if found and label.camera.spacecraft != _KAGUYA:
            raise InputError(table.where, found, remedy="the table is damaged: run spiceinit again")
        if found:
            yield f"{name}: {found}, which Kaguya's C-kernels have wrong"


def _other_constants(label: LineScanLabel, keywords: NaifKeywords) -> Iterator[str]:
    """Remarks on keywords that are not those of the camera's record, where it has them."""
    for key, expected in label.camera.constants.items():
        if key not in keywords or len(np.atleast_1d(np.array(keywords.values[key], dtype=object))) < len(expected):
            continue
        stated = keywords.numbers(key, len(expected))
        if np.abs(stated - expected).max() > _SAME * np.abs(expected).max():
            in_label, in_addendum = (", ".join(f"{value:.9g}" for value in values) for values in (stated, expected))
            yield f"{key} is {in_label}, where {label.camera.addendum} has {in_addendum}"


def cube_files(path: Path) -> tuple[Path, Path | None]:
    """The label, and the JSON that has its tables; None where the file itself has them."""
    if path.suffix.lower() in _JSON:
        label = next((path.with_suffix(end) for end in _LABELS if path.with_suffix(end).is_file()), None)
        if label is None:
            raise InputError(str(path), "the tables of a cube without its label", f"{path.stem}.pvl or .lbl beside it")
        return label, path
    if path.suffix.lower() == ".cub":
        return path, None
    return path, next((path.with_suffix(end) for end in _JSON if _holds_tables(path.with_suffix(end))), None)


def _holds_tables(path: Path) -> bool:
    """Whether JSON beside the label has a cube's tables, and not anything else."""
    try:
        return path.is_file() and {"instrument_position", "instrument_pointing"} <= read_json(path).keys()
    except InputError:
        return False


def has_tables(path: Path, root: Block) -> bool:
    """Whether a cube (or the JSON beside its label) has the tables of spiceinit."""
    _, beside = cube_files(path)
    if beside is not None:
        return True
    tables = [block for block in root.blocks if block.name == "table" and block.text("Name") in _TABLES]
    files = [(detached_file(path, table), table.count("StartByte")) for table in tables]
    return len(tables) == len(_TABLES) and all(file.is_file() and start <= file.stat().st_size for file, start in files)


def has_pixels(path: Path) -> bool:
    """Whether a cube holds the pixels of an image in camera geometry; a label, JSON and a map don't."""
    if path.suffix.lower() != ".cub":
        return False
    root = read_label(path)
    core = root.inner("IsisCube").inner("Core")
    return not is_map_projected(root) and core.count("StartByte") <= path.stat().st_size


def is_cube_json(content: dict[str, Any]) -> bool:
    """Whether JSON holds a cube's tables alone: label and camera model are in other files."""
    return "isis_camera_version" in content and "image_lines" not in content


def serial_number(path: Path) -> str:
    """ISIS's serial number of a cube, by its label; see `read_isis_cube` for the files."""
    label_path, _ = cube_files(path)
    return label_of(label_path, read_label(label_path)).serial


def _keywords(content: dict[str, Any] | None, source: str, label: LineScanLabel) -> NaifKeywords:
    """Those of the cube; the addendum's, as the camera's record has them, for cubes of before there were any."""
    if content is not None:
        values = content.get("naif_keywords", {})
        if not isinstance(values, dict):
            raise InputError(f"{source}, naif_keywords", repr(values)[:60], "constants by name")
        return NaifKeywords(source, values)
    if label.keywords is not None:
        return label.keywords
    if not label.camera.constants or label.target != label.camera.constants_target:
        raise InputError(source, "no NaifKeywords", "the camera's and the body's constants", "run spiceinit again")
    return NaifKeywords(source, label.camera.constants)


def _line_times(label: LineScanLabel, keywords: NaifKeywords, position: CubeTable) -> LineTimes:
    """From what ISIS computed of the label's start when spiceinit was run, or, in older cubes, from the first time of
    the position table, which begins with the whole image's first line and ends with its last.
    """
    camera, key = label.camera, f"CLOCK_ET_{label.camera.clock or label.camera.spacecraft}_{label.start}_COMPUTED"
    has_start = not camera.start_is_utc and key in keywords
    if not has_start and not camera.start_is_utc:
        _require_no_other_start(keywords, key)
    first, last = position.start + label.padding[0], position.stop - label.padding[1]
    start = keywords.time(key) if has_start else first
    times = camera.line_times(keywords, label, start, last)
    if label.period == 0.0:  # lines have times of their own, which are held against both
        return times
    whole = camera.line_times(keywords, replace(label, lines=label.whole or label.lines, first_line=0.0), start, last)
    if not has_start and whole.start != start:
        found, remedy = f"no {key}", "run spiceinit again"
        raise InputError(f"{keywords.source}, NaifKeywords", found, "the time of the label's start", remedy)
    partial = has_start and label.whole > 0  # spiceinit may have been run before or after the cut
    needed = times if partial or camera.tables_of_bands else whole
    _require_coverage(position.where, (first, last), needed, longer=needed is not whole)
    return times


def _require_no_other_start(keywords: NaifKeywords, key: str) -> None:
    """Raise InputError where keywords hold times of clock counts, but not of the label's: they are another image's."""
    clock = key[: key.index("_", len("CLOCK_ET_")) + 1]
    others = [name for name in keywords.values if name.upper().startswith(clock) and name.upper().endswith("_COMPUTED")]
    if others:
        found, remedy = f"{others[0].upper()}", "the tables are another image's: run spiceinit again"
        raise InputError(f"{keywords.source}, NaifKeywords", found, f"{key}, the label's start", remedy)


def _require_coverage(where: str, covered: tuple[float, float], image: LineTimes, longer: bool) -> None:
    """Raise InputError unless a table is of the image's own times (s TDB past J2000), or of longer where it may be."""
    slack = max(_LINE_SLACK * float(image.periods.min()), _ROUNDING)
    late, early = covered[0] - image.start, image.stop - covered[1]
    if max(late, early) > slack or (not longer and min(late, early) < -slack):
        found = f"a beginning {late:+.6f} s past the first line's, {covered[1] - covered[0]:.6f} s from first to last"
        remedy = "the table is not of this image, or of a part: run spiceinit again"
        raise InputError(where, found, f"the image's {image.stop - image.start:.6f} s", remedy)


def _trajectory(tables: dict[str, CubeTable], epoch: float, stated: Aberration, body: Ellipsoid) -> Trajectory:
    position = position_table(tables["InstrumentPosition"], epoch)
    require_flight(position, tables["InstrumentPosition"].where)
    if stated.correction == "LT+S":
        position = geometric(position, _body_velocity(tables), stated, 0.5 * (body.equatorial + body.polar))
    return Trajectory(
        epoch, position, attitude_table(tables["InstrumentPointing"], epoch),
        attitude_table(tables["BodyRotation"], epoch),
    )  # fmt: skip


def _stated_aberration(keywords: NaifKeywords, label: LineScanLabel) -> tuple[Aberration, str]:
    """By the addendum's keywords, or else as ISIS does it for this spacecraft; why, where it was not the keywords."""
    stated = aberration_of(keywords.values, keywords.source, label.camera.instrument)
    spacecraft = spacecraft_of(label.camera.spacecraft)
    if stated is not None:
        return stated, ""
    assert spacecraft is not None, f"{label.camera.name} is of no spacecraft in `aberration`"
    return spacecraft.stated, spacecraft.source


def _body_velocity(tables: dict[str, CubeTable]) -> np.ndarray[Any, np.dtype[np.float64]]:
    """m/s, (3,), of the body about the Sun: minus the Sun's about the body."""
    if _SUN not in tables:
        where = tables["InstrumentPosition"].where
        raise InputError(where, f"no table {_SUN}", "the Sun's velocity, to undo the stellar aberration", _NO_TABLES)
    velocities = tables[_SUN].velocities
    return np.asarray(-velocities.mean(axis=0) * KM)


def _body(keywords: NaifKeywords, label: LineScanLabel) -> Ellipsoid:
    code = int(number(keywords, "BODY_CODE")) if "BODY_CODE" in keywords else None
    names = [key for key in keywords.values if key.upper().startswith("BODY") and key.upper().endswith("_RADII")]
    key = f"BODY{code}_RADII" if code is not None else names[0] if len(names) == 1 else "BODY..._RADII"
    a, b, c = keywords.numbers(key, 3) * KM
    if abs(a - b) > 1e-9 * a:
        raise InputError(f"{keywords.source}, {key}", f"{a} and {b} m on the equator", "a body of revolution")
    body = Ellipsoid(float(a), float(c))
    require_possible(body, label.target, f"{keywords.source}, {key}")
    return body

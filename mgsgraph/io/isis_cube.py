"""ISIS cubes after spiceinit: label, NaifKeywords and the tables of position, attitude and body rotation, as they are.

The same content as JSON ("isis_camera_version" 1, which ISIS makes of cubes for its tests, and 2) is read with the
label beside it. What tables hold, by ISIS's SpicePosition and SpiceRotation: positions of the spacecraft, apparent
("LT+S", seen from the body) unless a keyword says otherwise, made geometric here; attitude whose times have the
camera's time bias in them already; all against J2000. jigsaw puts polynomials in place of what it has adjusted.
"""

from pathlib import Path
from typing import Any

import numpy as np

from mgsgraph.errors import InputError, errors_from
from mgsgraph.geometry.body import Ellipsoid, may_be
from mgsgraph.geometry.image import PushbroomImage
from mgsgraph.geometry.trajectory import Trajectory
from mgsgraph.io.aberration import Aberration, Observer, geometric
from mgsgraph.io.cameras.camera import LineScanLabel
from mgsgraph.io.cameras.keywords import NaifKeywords, number
from mgsgraph.io.cameras.label import is_map_projected, label_of
from mgsgraph.io.cube_tables import CubeTable, attitude_table, position_table, tables_of_json, tables_of_label
from mgsgraph.io.files import read_json
from mgsgraph.io.image_label import read_label
from mgsgraph.io.pvl import Block
from mgsgraph.units import KM

_TABLES = ("InstrumentPosition", "InstrumentPointing", "BodyRotation")
_SUN = "SunPosition"
_JSON = (".isd", ".json")
_LABELS = (".pvl", ".lbl", ".cub", ".LBL")
_NO_TABLES = "run spiceinit on the cube (attach=yes), or name the label and its kernels"
_TIME_SLACK = 1e-4
"""s, a tenth of the shortest line, by which the table of positions may begin before or after the first line."""


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
    label_path, json_path = _files(path)
    root = read_label(label_path)
    if "PDS_VERSION_ID" in root:
        raise InputError(str(path), "a PDS3 label", "an ISIS cube", "name its kernels: label = ..., kernels = [...]")
    content = read_json(json_path) if json_path else None
    tables = tables_of_json(content, str(json_path)) if content else tables_of_label(label_path, root)
    for table in _TABLES:
        if table not in tables:
            raise InputError(str(path), f"no table {table}", "the tables of spiceinit", _NO_TABLES)
    label = label_of(label_path, root)
    with errors_from(str(path)):
        keywords = _keywords(content, str(json_path or label_path), label)
        stated = Aberration("NONE") if apparent else aberration or _stated_aberration(keywords, label)
        return _image(label, keywords, tables, stated, name)


def _image(
    label: LineScanLabel, keywords: NaifKeywords, tables: dict[str, CubeTable], stated: Aberration, name: str | None
) -> PushbroomImage:
    stop = tables["InstrumentPosition"].stop
    times = label.camera.line_times(keywords, label, _start(label, keywords, tables), stop)
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
    )


def _files(path: Path) -> tuple[Path, Path | None]:
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
    """Whether there is JSON with a cube's tables, and not anything else that is called like the label."""
    try:
        return path.is_file() and {"instrument_position", "instrument_pointing"} <= read_json(path).keys()
    except InputError:
        return False


def has_tables(path: Path, root: Block) -> bool:
    """Whether a cube (or the JSON beside its label) has the tables of spiceinit."""
    _, beside = _files(path)
    if beside is not None:
        return True
    tables = [block for block in root.blocks if block.name == "table" and block.text("Name") in _TABLES]
    size = path.stat().st_size
    return len(tables) == len(_TABLES) and all(one.count("StartByte") <= size for one in tables)


def has_pixels(path: Path) -> bool:
    """Whether a cube holds the pixels of an image in camera geometry; a label, JSON and a map don't."""
    if path.suffix.lower() != ".cub":
        return False
    root = read_label(path)
    core = root.inner("IsisCube").inner("Core")
    return not is_map_projected(root) and core.count("StartByte") <= path.stat().st_size


def is_cube_json(content: dict[str, Any]) -> bool:
    """Whether JSON holds a cube's tables alone: label and camera model are to be had from elsewhere."""
    return "isis_camera_version" in content and "image_lines" not in content


def serial_number(path: Path) -> str:
    """ISIS's serial number of a cube, by its label; see `read_isis_cube` for the files."""
    label_path, _ = _files(path)
    return label_of(label_path, read_label(label_path)).serial


def _keywords(content: dict[str, Any] | None, source: str, label: LineScanLabel) -> NaifKeywords:
    """Those of the cube; the addendum's, as the camera's record has them, for cubes of before there were any."""
    if content is not None:
        return NaifKeywords(source, content.get("naif_keywords", {}))
    if label.keywords is not None:
        return label.keywords
    if not label.camera.constants or label.target != label.camera.constants_target:
        raise InputError(source, "no NaifKeywords", "the camera's and the body's constants", "run spiceinit again")
    return NaifKeywords(source, label.camera.constants)


def _start(label: LineScanLabel, keywords: NaifKeywords, tables: dict[str, CubeTable]) -> float:
    """Time in s TDB past J2000 of the label's start: what ISIS computed when spiceinit was run; in older cubes, the
    position table's first time, from which on it is sampled.
    """
    camera, key = label.camera, f"CLOCK_ET_{label.camera.clock or label.camera.spacecraft}_{label.start}_COMPUTED"
    if not camera.start_is_utc and key in keywords:
        return keywords.time(key)
    position = tables["InstrumentPosition"]
    duration, covered = label.lines * label.period, position.stop - position.start
    if label.period > 0.0 and label.first_line == 0.0 and abs(covered - duration) > _TIME_SLACK:
        raise InputError(
            position.where, f"{covered:.6f} s from first to last", f"the image's {duration:.6f} s",
            "the table is not of this image, or of a part: run spiceinit again",
        )  # fmt: skip
    return position.start


def _trajectory(tables: dict[str, CubeTable], epoch: float, stated: Aberration, body: Ellipsoid) -> Trajectory:
    position = position_table(tables["InstrumentPosition"], epoch)
    if stated.correction == "LT+S":
        position = geometric(position, _body_velocity(tables), stated, 0.5 * (body.equatorial + body.polar))
    return Trajectory(
        epoch, position, attitude_table(tables["InstrumentPointing"], epoch),
        attitude_table(tables["BodyRotation"], epoch),
    )  # fmt: skip


def _stated_aberration(keywords: NaifKeywords, label: LineScanLabel) -> Aberration:
    """By the addendum's keywords, or else as ISIS does it for this camera. ISIS asks for the spacecraft as the body
    sees it, unless told to swap observer and target (SpicePosition, m_swapObserverTarget).
    """
    name = f"INS{label.camera.instrument}"
    correction = str(keywords.values.get(f"{name}_LIGHTTIME_CORRECTION", label.camera.aberration)).upper()
    if correction not in ("NONE", "LT+S"):
        raise InputError(f"{keywords.source}, {name}_LIGHTTIME_CORRECTION", repr(correction), "'NONE' or 'LT+S'")
    swapped, to_surface = (
        str(keywords.values.get(f"{name}_{key}", False)).upper() == "TRUE"
        for key in ("SWAP_OBSERVER_TARGET", "LT_SURFACE_CORRECT")
    )
    observer: Observer = "spacecraft" if swapped else "body"
    return Aberration("NONE") if correction == "NONE" else Aberration("LT+S", observer, to_surface)


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
    if not may_be(body, label.target):
        raise InputError(f"{keywords.source}, {key}", f"{a / KM:g} km on the equator", f"the radii of {label.target}")
    return body

"""ISIS cubes after spiceinit: label, NaifKeywords and the tables of position, attitude and body rotation, as they are.

The same content as JSON ("isis_camera_version" 1, which ISIS makes of cubes for its tests, and 2) is read with the
label beside it. What tables hold, by ISIS's SpicePosition and SpiceRotation: positions of the spacecraft, apparent
("LT+S", seen from the body) unless a keyword says otherwise, made geometric here; attitude whose times have the
camera's time bias in them already; all against J2000. jigsaw puts polynomials in place of what it has adjusted.
"""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from mgsgraph.errors import InputError, errors_from
from mgsgraph.files.cameras.camera import LineScanLabel, NaifKeywords, number
from mgsgraph.files.cameras.label import is_map_projected, label_of
from mgsgraph.files.cameras.line_times import LineTimes
from mgsgraph.files.labels.aberration import Aberration, aberration_of, geometric, remarks_on, spacecraft_of
from mgsgraph.files.labels.cube_tables import CubeTable, attitude_table, position_table, tables_of_json, tables_of_label
from mgsgraph.files.labels.image_label import read_label
from mgsgraph.files.opening import read_json
from mgsgraph.files.pvl import Block
from mgsgraph.geometry.body import Ellipsoid, require_possible
from mgsgraph.geometry.image import PushbroomImage
from mgsgraph.geometry.plausibility import require_flight
from mgsgraph.geometry.trajectory import Trajectory
from mgsgraph.units import KM

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
        asked = (Aberration("NONE"), "apparent, as ISIS has them") if apparent else None
        asked = asked or (aberration and (aberration, "as the case says")) or _stated_aberration(keywords, label)
        return _image(label, keywords, tables, name, *asked)


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
        remarks=remarks_on(stated, why),
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
    known = not camera.start_is_utc and key in keywords
    if not known and not camera.start_is_utc:
        _require_no_other_start(keywords, key)
    first, last = position.start + label.padding[0], position.stop - label.padding[1]
    start = keywords.time(key) if known else first
    times = camera.line_times(keywords, label, start, last)
    if label.period == 0.0:  # lines have times of their own, which are held against both
        return times
    whole = camera.line_times(keywords, replace(label, lines=label.whole or label.lines, first_line=0.0), start, last)
    if not known and whole.start != start:
        found, remedy = f"no {key}", "run spiceinit again"
        raise InputError(f"{keywords.source}, NaifKeywords", found, "the time of the label's start", remedy)
    partial = known and label.whole > 0  # spiceinit may have been run before or after the cut
    wanted = times if partial or camera.tables_of_bands else whole
    _require_coverage(position.where, (first, last), wanted, longer=wanted is not whole)
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

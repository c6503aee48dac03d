"""ISIS cubes with the adjusted orientation in their tables, as jigsaw's update leaves them; pixels are not touched.

By ISIS (DOI-USGS/ISIS3, isis/src): jigsaw.cpp deletes Polygon and the table CameraStatistics, marks new tables with the
comment "Jigged = time" and adds to the history. SpiceRotation::Cache and SpicePosition::Cache write quaternions with
angular velocities, positions with velocities, and the keys of the earlier label less Description and Kernels
(jigsaw/assets/ap15/jigged_tables.txt). Polynomials over SPICE become samples there, too; coefficients are written in
place of coefficients alone. Tables are taken as they are: positions (geometric here) and times, to which no bias is
added (SetTimeBias). Blobs go behind the rest (Cube::write, Blob::Write), or beside a detached label (^Table). Labels
of cubes have no checksum; their room is what Object = Label says (Cube::writeLabels).
"""

import json
import os
import re
import shutil
import stat
import zlib
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, suppress
from datetime import datetime
from hashlib import file_digest, sha256
from itertools import chain, pairwise
from pathlib import Path
from platform import node
from typing import NamedTuple

import numpy as np

from mgsgraph.adjustment.solution import Solution
from mgsgraph.atomic_write import resolved
from mgsgraph.errors import InputError, require
from mgsgraph.export.csm import described_times
from mgsgraph.export.spice_nodes import AdjustedNodes, adjusted_nodes
from mgsgraph.files.cameras.label import is_map_projected, label_of
from mgsgraph.files.labels.isis_cube import (
    ANGLES,
    COEFFICIENTS,
    CORRECTION,
    POSITION,
    QUATERNION,
    RATES,
    VELOCITY,
    CubeTable,
    attitude_table,
    cube_files,
    detached_file,
    is_cube_json,
    read_isis_cube,
    tables_of_json,
    tables_of_label,
)
from mgsgraph.files.opening import ANY_SIZE, opened, read_json, sha256_of
from mgsgraph.files.output.folders import PROGRAM
from mgsgraph.files.pvl import Block, Value, keyword_lines, read_label, text_value
from mgsgraph.files.support_data.isd import read_isd
from mgsgraph.files.writing import account, fresh_file, write_file, writing_to
from mgsgraph.geometry import rotation
from mgsgraph.geometry.image import PushbroomImage
from mgsgraph.geometry.orientation import OrientationCorrection
from mgsgraph.geometry.records import Array, all_pairs, finite_rows
from mgsgraph.text import listed, many, some
from mgsgraph.units import KM

_TOLERANCE, LARGEST, _CHANGED = 2e-5, 1e-4, 1e-2
"""px, by which interpolation between samples may be off, what is read back may, and a cube from what was adjusted."""
_DEGREES, _PLACES = range(1, 10), (np.arange(5) + 0.5) / 5
"""Of polynomials, tried in turn; shares of lines and samples at which cameras are compared."""
_POINTING, _POSITION = _RENEWED_TABLES = "InstrumentPointing", "InstrumentPosition"
_OUTDATED = {("polygon", ""), ("table", "camerastatistics")}
"""What says where the earlier orientation has seen the ground."""
_RENEWED = {"name", "startbyte", "bytes", "records", "byteorder", "cachetype", "description", "kernels", "^table",
            "^history", CORRECTION.lower()}  # fmt: skip
_START, _MARK = re.compile(r"(StartByte\s*=\s*)(\d+)"), re.compile(r"^# Jigged = .*\n", re.MULTILINE)
_BYTES = re.compile(r"^(Object\s*=\s*Label\s+Bytes\s*=\s*)\d+", re.MULTILINE | re.IGNORECASE)
_END = re.compile(r"^[ \t]*End[ \t]*$", re.MULTILINE | re.IGNORECASE)
_BLOCK = 65536
"""bytes; a label that has outgrown its room gets as many more, or a multiple."""
_REMEDY = "export csm or spice: cubes hold positions and attitudes, camera constants and line times are their own"


class _Blob(NamedTuple):
    """What stands behind a label: its kind, keys of its own, fields of its records, and bytes."""

    kind: str
    name: str
    keys: tuple[tuple[str, Value], ...]
    fields: tuple[str, ...]
    content: bytes


_Tables = Mapping[str, tuple[tuple[str, ...], Array]]
"""Fields and records by table."""
_New = list[tuple[Path, Path]]
"""Files, each with the one that it may replace, in this order."""


def write_cubes(
    solution: Solution, folder: Path, sources: Mapping[str, Path], when: datetime, state: str
) -> tuple[list[Path], tuple[str, ...], _New]:
    """Write an adjusted copy of each image's cube into an existing folder, read it back and compare. Images without a
    cube that has tables of spiceinit are left out, and named.

    Parameters
    ----------
    solution : Solution
        What was adjusted.
    folder : Path
        Where to; copies are called like their cubes, a second one of a name in a folder called by the image's number.
    sources : mapping
        By image: its cube, detached label, or label with its tables as JSON beside it.
    when : datetime
        Of the adjustment, for marks and history.
    state : str
        The verdict on it, for descriptions.

    Returns
    -------
    paths : list of Path
        What was written.
    notes : tuple of str
        What holds for them.
    new : list of (Path, Path)
        New files, each with the one that it may replace, in this order.

    Raises
    ------
    InputError
        No image with a cube; a cube that `read_isis_cube` refuses; a camera that is not the solution's to `LARGEST`,
        since its constants were adjusted, too; a file that can't be written.
    """
    paths, originals, biased, mapped, without = list[Path](), _New(), list[str](), list[str](), list[str]()
    largest, names = 0.0, solution.network.image_names
    for j, name in enumerate(names):
        cube = _cube(sources[name]) if name in sources else None
        if cube is None:
            without.append(name)
            continue
        path, beside, root, own = cube
        label, picture, correction = label_of(path, root), solution.image(j), solution.correction(j)
        biased += [name] * (label.camera.attitude_bias != 0.0)
        mapped += [name] * is_map_projected(root)
        files = _files_of(path, beside, root)
        place = folder / str(j + 1) if any(folder / file.name in paths for file in {path, *files}) else folder
        place.mkdir(exist_ok=True)
        words = _description(solution, state, label.camera.attitude_bias)
        tables = _adjusted(picture, correction, own)
        if beside is not None:
            new = _with_json(beside, place, tables, label.camera.instrument, words)
        else:
            new = _with_blobs(path, root, place, tables, f"{when:%Y-%m-%dT%H:%M:%S}", words)
        paths += [Path(shutil.copyfile(file, place / file.name)) for file in files]
        paths += [copy for copy, _ in new]
        originals += new
        largest = max(largest, _compared(place / path.name, picture, correction))
    found = f"no ISIS cube with tables of spiceinit of {some(names)}"
    require(paths, "export to cubes", found, "one of any image", "name the case that has them (--case)")
    return paths, tuple(_notes(len(names), without, largest, biased, mapped)), originals


def _description(solution: Solution, state: str, bias: float) -> str:
    """What copies say of themselves."""
    once = f"; times hold the attitude bias of {bias:g} s once" if bias else ""
    return f"{PROGRAM} {solution.versions.get(PROGRAM, '')}: adjusted, {state}; positions are geometric{once}"


def _notes(count: int, without: list[str], largest: float, biased: list[str], mapped: list[str]) -> Iterator[str]:
    read = many(count - len(without), "camera")
    yield f"Read back, 25 pixels of {read} fall within {largest:.1g} px of where the solution has them."
    if without:
        left = f"{len(without)} of {many(count, 'image')}, {some(without)}"
        yield f"Left out, as the case names no ISIS cube with tables of spiceinit of them: {left}."
    if biased:
        yield f"{listed(biased)}: attitude times hold MOC's -1.15 s once, as before; ISIS adds none to tables."
    if mapped:
        yield f"{listed(mapped)}: a map, whose pixels stay where the earlier orientation has put them."


# --- tables


def _cube(path: Path) -> tuple[Path, Path | None, Block, dict[str, CubeTable]] | None:
    """Label, JSON of tables beside it, the label's content, and tables, of which BodyRotation and constant rotations
    stay; None where it is no ISIS cube, or without a table of spiceinit.
    """
    label, beside = cube_files(path)
    if "PDS_VERSION_ID" in (root := read_label(label)):
        return None
    tables = tables_of_json(read_json(beside), str(beside)) if beside else tables_of_label(label, root)
    return (label, beside, root, tables) if {*_RENEWED_TABLES, "BodyRotation"} <= tables.keys() else None


def _adjusted(image: PushbroomImage, correction: OrientationCorrection, tables: dict[str, CubeTable]) -> _Tables:
    """Samples, or polynomials in place of such, over the time of the earlier positions; km, km/s, rad/s, s TDB past
    J2000.
    """
    epoch, position, middle = image.trajectory.epoch, tables[_POSITION], float(image.span.mean())
    if not position.start <= middle <= position.stop:
        found = f"positions from {position.start:.3f} to {position.stop:.3f} s TDB past J2000"
        raise InputError(position.where, found, f"those of {image.name}, taken at {middle:.3f} s", "name its own cube")
    first, last = image.timing.lines(np.array([position.start, position.stop]) - epoch).tolist()
    body = attitude_table(tables["BodyRotation"], epoch)
    nodes = adjusted_nodes(image, correction, (first, last), _TOLERANCE, body)
    matrices, times = tables[_POINTING].constant.T @ nodes.matrices, (nodes.times + nodes.epoch)[:, None]
    places, quaternions = nodes.positions / KM, rotation.continuous(rotation.from_matrix(matrices))
    made: dict[str, tuple[tuple[str, ...], Array]] = {
        _POINTING: ((*QUATERNION, *RATES, "ET"), np.hstack([quaternions, nodes.angular_rate, times])),
        _POSITION: ((*POSITION, *VELOCITY, "ET"), np.hstack([places, nodes.velocities / KM, times])),
    }
    angles = np.unwrap(rotation.angles_313(matrices), axis=0)
    forms = (_POINTING, ANGLES, angles, image.pixel_angle), (_POSITION, COEFFICIENTS, places, nodes.pixel / KM)
    for name, fields, values, scale in forms:
        if not tables[name].sampled and (rows := _polynomials(nodes, values, _TOLERANCE * scale)) is not None:
            made[name] = fields, rows
    return made


def _polynomials(nodes: AdjustedNodes, values: Array, tolerance: float) -> Array | None:
    """Coefficients of the lowest degree that does, and below them base time, time scale and degree; None without."""
    base, scale = 0.5 * (nodes.times[0] + nodes.times[-1]), 0.5 * (nodes.times[-1] - nodes.times[0])
    scaled = (nodes.times - base) / scale
    for degree in _DEGREES:
        found = np.polynomial.polynomial.polyfit(scaled, values, degree)
        if np.abs(np.polynomial.polynomial.polyval(scaled, found).T - values).max() <= tolerance:
            return np.vstack([found, [base + nodes.epoch, scale, degree]])
    return None


# --- files

def _with_json(path: Path, folder: Path, tables: _Tables, instrument: int, words: str) -> _New:
    """The label as it is, and the JSON with other tables."""
    content = read_json(path)
    (_, turned), (_, moved) = tables[_POINTING], tables[_POSITION]
    attitudes = {"quaternions": turned[:, :4].tolist(), "angular_velocities": turned[:, 4:7].tolist()}
    content["instrument_pointing"] |= attitudes | described_times("ck", turned[:, 7])
    places = {"positions": moved[:, :3].tolist(), "velocities": moved[:, 3:6].tolist()}
    content["instrument_position"] |= places | described_times("spk", moved[:, 6])
    kept = {key: value for key, value in content["naif_keywords"].items() if "LIGHTTIME_CORR" not in key.upper()}
    content |= {"naif_keywords": kept | {f"INS{instrument}_LIGHTTIME_CORRECTION": "NONE"}, PROGRAM: words}
    write_file(folder / path.name, json.dumps(content, indent=1, allow_nan=False))
    return [(folder / path.name, path)]


def _with_blobs(path: Path, root: Block, folder: Path, tables: _Tables, time: str, words: str) -> _New:
    """A cube with other tables behind it, or a detached label with a file of them."""
    blobs = [_history(path, root, time, words), *_table_blobs(root, tables, words)]
    data, behind = b"".join(blob.content for blob in blobs), sha256()
    if detached_file(path, root.inner("IsisCube").inner("Core")) != path:
        beside = f"{path.stem}.{zlib.crc32(data):08x}.tables"
        write_file(folder / beside, data)
        write_file(folder / path.name, _relabelled(root, blobs, 0, time, beside).encode("latin-1"))
        return [(folder / beside, path.with_name(beside)), (folder / path.name, path)]
    size, room, grown = _kept_size(path, root), _room(root), 0
    text = _relabelled(root, blobs, size, time)
    if len(text) >= room:
        grown = -(-(len(text) + _BLOCK // 16 - room) // _BLOCK) * _BLOCK
        text = _START.sub(lambda found: f"{found[1]}{int(found[2]) + grown}", text)
        text = _BYTES.sub(lambda found: f"{found[1]}{room + grown}", text)
    with fresh_file(folder / path.name) as temporary, opened(path, ANY_SIZE) as old:
        old.seek(room)
        with writing_to(folder / path.name), temporary.open("wb") as new:
            new.write(text.encode("latin-1").ljust(room + grown, b"\0"))
            for chunk in chain(iter(lambda: old.read(min(_BLOCK, size - old.tell())), b""), [data]):
                behind.update(chunk)
                new.write(chunk)
        with opened(temporary, ANY_SIZE) as copy:
            copy.seek(room + grown)
            if behind.digest() != file_digest(copy, "sha256").digest():
                raise InputError(str(folder / path.name), "bytes that are read back otherwise", f"those of {path}")
    return [(folder / path.name, path)]


def _kept_size(path: Path, root: Block) -> int:
    """Bytes before the history and tables at the file's end, whose place the new ones take."""
    size, renewed = path.stat().st_size, [block for block in root.blocks if _is_renewed(block)]
    for block in sorted(renewed, key=lambda block: -block.count("StartByte")):
        start, stop = np.cumsum([block.count("StartByte") - 1, block.count("Bytes")]).tolist()
        size = start if stop == size and detached_file(path, block) == path else size
    return size


def _is_renewed(block: Block) -> bool:
    return block.name == "history" or _key(block) in {("table", name.lower()) for name in _RENEWED_TABLES}


def _table_blobs(root: Block, tables: _Tables, words: str) -> Iterator[_Blob]:
    of_key = {_key(block): block for block in root.blocks}
    for name, (fields, rows) in tables.items():
        kind = "HermiteSpline" if "ET" in fields else "PolyFunction"
        cache = [("CacheType", kind), (CORRECTION, "NONE")] if name == _POSITION else []
        keys = [("Records", str(len(rows))), ("ByteOrder", "Lsb"), *cache, *_kept(of_key["table", name.lower()])]
        keys.append(("Description", text_value(words, name)))
        yield _Blob("Table", name, tuple(keys), fields, rows.astype("<f8").tobytes())


def _kept(block: Block) -> list[tuple[str, Value]]:
    """Keys of a table that are not renewed, with their values as they stand there."""
    marks = sorted([entry.position for entry in block.entries.values()] + [block.blocks[0].position])
    statements = (block.document.text[begin:end].split("=", 1) for begin, end in pairwise(marks))
    return [(key.strip(), value.strip()) for key, value in statements if key.strip().lower() not in _RENEWED]


def _history(path: Path, root: Block, time: str, words: str) -> _Blob:
    """The earlier history and an entry."""
    blocks, before = [block for block in root.blocks if block.name == "history"], b""
    for block in blocks[:1]:
        with opened(detached_file(path, block), ANY_SIZE) as file:
            file.seek(block.count("StartByte") - 1)
            before = file.read(block.count("Bytes")) + b"\n"
    keys: list[tuple[str, Value]] = [("ExecutionDateTime", time), ("HostName", text_value(node(), "history"))]
    keys += [("UserName", text_value(account(), "history")), ("Description", text_value(words, "history"))]
    entry = "\n".join([f"Object = {PROGRAM}", *keyword_lines(keys, 2), "End_Object", ""])
    return _Blob("History", blocks[0].text("Name") if blocks else "IsisCube", (), (), before + entry.encode())


# --- the label


def _relabelled(root: Block, blobs: list[_Blob], start: int, time: str, beside: str = "") -> str:
    """The label's text with other objects for what begins behind so many bytes, in the file or one beside it."""
    text, texts = root.document.text, dict[tuple[str, str], str]()
    for blob in blobs:
        texts[blob.kind.lower(), blob.name.lower()] = _object_text(blob, start + 1, time, beside)
        start += len(blob.content)
    last = _END.search(text, root.blocks[-1].position)
    bounds, pieces = [block.position for block in root.blocks] + [last.start() if last else len(text)], list[str]()
    for block, (begin, end) in zip(root.blocks, pairwise(bounds), strict=True):
        if (key := _key(block)) not in _OUTDATED:
            pieces.append(texts.pop(key, _MARK.sub("", text[begin:end])))
    return "".join([*pieces, *texts.values(), "End\n"])


def _key(block: Block) -> tuple[str, str]:
    return block.name, block.text("Name").lower() if block.name in ("table", "history") else ""


def _object_text(blob: _Blob, start: int, time: str, beside: str) -> str:
    keys = [("Name", blob.name), ("StartByte", str(start)), ("Bytes", str(len(blob.content))), *blob.keys]
    keys += [(f"^{blob.kind}", text_value(beside, beside))] if beside else []
    lines = [f"# Jigged = {time}"] * (blob.kind == "Table") + [f"Object = {blob.kind}", *keyword_lines(keys, 2)]
    for field in blob.fields:
        lines += ["", "  Group = Field", f"    Name = {field}", "    Type = Double", "    Size = 1", "  End_Group"]
    return "\n".join([*lines, "End_Object", "", ""])


def _room(root: Block) -> int:
    """Bytes that are the label's own: as it says, or what is before the first byte of anything else."""
    starts = [int(start) - 1 for _, start in _START.findall(root.document.text)]
    return min([block.count("Bytes") for block in root.blocks if block.name == "label"] + starts)


def _files_of(path: Path, beside: Path | None, root: Block) -> set[Path]:
    """Files of a cube that stay as they are: the label of JSON, what a detached one names beside the new tables."""
    kept = [root.inner("IsisCube").inner("Core"), *(block for block in root.blocks if not _is_renewed(block))]
    return {path} if beside else {detached_file(path, block) for block in kept} - {path}


# --- in place


def replace_cubes(pairs: Sequence[tuple[Path, Path]]) -> None:
    """Let copies take the places of their originals, each in one step and in this order, once all are beside them.

    Raises
    ------
    InputError
        Where one can't be written; what has no copy in its place by then is as it was.
    """
    with ExitStack() as stack:
        for copy, original in reversed(pairs):  # the last one entered is the first one put
            target = resolved(original, "name the file itself")
            if target.exists() and not target.stat().st_mode & stat.S_IWUSR:
                raise InputError(str(target), "a write-protected cube", "one to replace", "leave out --update")
            temporary = stack.enter_context(fresh_file(target, "a cube that may be replaced", "leave out --update"))
            shutil.copyfile(copy, temporary)
            with suppress(OSError, AttributeError):  # not allowed, none there yet, or Windows
                os.chown(temporary, target.stat().st_uid, target.stat().st_gid)
            shutil.copymode(target if target.exists() else copy, temporary)
            if sha256_of(temporary) != sha256_of(copy):
                raise InputError(str(target), "a copy that is read back otherwise", f"{copy}, byte for byte")


# --- read back


def is_changed(cube: PushbroomImage, solution: Solution, j: int) -> bool:
    """Whether a cube has neither the camera that was adjusted nor the adjusted one, which an earlier update leaves."""
    cameras = (solution.network.images[j], None), (solution.image(j), solution.correction(j))
    return not any(_distance(cube, *camera) <= _CHANGED for camera in cameras)


def _compared(path: Path, image: PushbroomImage, correction: OrientationCorrection) -> float:
    """px, the copy's camera from the solution's, as a cube and as support data (`isd`) where its JSON can be read as
    such; InputError where it is too far from it.
    """
    cameras, beside = [read_isis_cube(path, image.name)], cube_files(path)[1]
    if beside and not is_cube_json(read_json(beside)):
        cameras.append(read_isd(beside, image.name))
    largest = float(np.max([_distance(camera, image, correction) for camera in cameras]))
    if not largest <= LARGEST:
        raise InputError(str(path), f"a camera {largest:.3g} px off the solution's", f"at most {LARGEST:g} px", _REMEDY)
    return largest


def _distance(cube: PushbroomImage, image: PushbroomImage, correction: OrientationCorrection | None) -> float:
    """px, largest distance at 25 pixels of a cube's camera from another; NaN where that sees no ground."""
    lines, samples = all_pairs(_PLACES * image.lines, _PLACES * image.samples).T
    ground, _ = image.image_to_ground(lines, samples, 0.0, correction)
    seen, _ = cube.ground_to_image(ground)
    off = np.linalg.norm(seen - np.column_stack([lines, samples]), axis=1)[finite_rows(ground)]
    return float(off.max()) if off.size else np.nan

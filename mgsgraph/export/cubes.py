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
import re
import shutil
import zlib
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from datetime import datetime
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from mgsgraph.adjustment.solution import Solution
from mgsgraph.atomic_write import resolved
from mgsgraph.errors import InputError
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
    read_isis_cube,
    tables_of_json,
    tables_of_label,
)
from mgsgraph.files.opening import read_json, sha256_of
from mgsgraph.files.output.folders import PROGRAM
from mgsgraph.files.pvl import Block, Document, Value, keyword_lines, read_label, text_value, whole_label
from mgsgraph.files.writing import fresh_file, write_file
from mgsgraph.geometry import rotation
from mgsgraph.geometry.image import PushbroomImage
from mgsgraph.geometry.orientation import OrientationCorrection
from mgsgraph.geometry.records import Array
from mgsgraph.text import listed, many
from mgsgraph.units import KM

_TOLERANCE, LARGEST = 2e-5, 1e-4
"""px, by which interpolation between samples may be off, and by which what is read back may."""
_DEGREES = range(1, 10)
"""Of polynomials, in which case they are tried in turn."""
_PLACES = (np.arange(5) + 0.5) / 5
"""Shares of lines and samples at which cameras are compared."""
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
_CHUNK = 1 << 24
_REMEDY = "export csm or spice: cubes hold positions and attitudes, camera constants and line times are their own"


class CubeFiles(NamedTuple):
    """Files written, what they may replace, and sentences about them."""

    paths: list[Path]
    """Files."""
    notes: tuple[str, ...]
    """What holds for them."""
    originals: list[tuple[Path, Path]]
    """New files, each with the one that it may replace, in this order."""


@dataclass(frozen=True, slots=True)
class _Blob:
    """What stands behind a label: its kind, keys of its own, fields of its records, and bytes."""

    kind: str
    name: str
    keys: tuple[tuple[str, Value], ...]
    fields: tuple[str, ...]
    content: bytes


class _Said(NamedTuple):
    """What files say of the adjustment."""

    time: str
    """When it was."""
    version: str
    """Of the program."""
    positions: str
    """Description of positions."""
    attitudes: str
    """Description of attitudes."""


_Tables = Mapping[str, tuple[tuple[str, ...], Array]]
"""Fields and records by table."""


def write_cubes(solution: Solution, folder: Path, sources: Mapping[str, Path], when: datetime) -> CubeFiles:
    """Write an adjusted copy of each image's cube into an existing folder, read it back and compare.

    Parameters
    ----------
    solution : Solution
        What was adjusted.
    folder : Path
        Where to; copies are called like their cubes.
    sources : mapping
        By image: its cube, detached label, or label with its tables as JSON beside it.
    when : datetime
        Of the adjustment, for marks and history.

    Raises
    ------
    InputError
        An image without cube; two cubes of one name; a cube that `read_isis_cube` refuses; a camera that is not the
        solution's to `LARGEST`, since its constants were adjusted, too; a file that can't be written.
    """
    paths, originals, biased, mapped, largest = list[Path](), list[tuple[Path, Path]](), list[str](), list[str](), 0.0
    for j, image in enumerate(solution.network.images):
        source = _source(image.name, sources)
        root = read_label(source[0])
        label, picture = label_of(source[0], root), solution.image(j)
        biased += [image.name] * (label.camera.attitude_bias != 0.0)
        mapped += [image.name] * is_map_projected(root)
        said = _said(solution, when, label.camera.attitude_bias)
        tables = _adjusted_tables(picture, solution.correction(j), _tables(source, root))
        if folder / source[0].name in paths:
            raise InputError(str(source[0]), f"another image's file called {source[0].name}", "names that differ")
        if source[1] is not None:
            new = _with_json(source[1], folder, tables, label.camera.instrument, said)
        else:
            new = _with_blobs(source[0], root, folder, tables, said)
        others = [Path(shutil.copyfile(file, folder / file.name)) for file in _files_of(source, root)]
        paths += [*others, *(copy for copy, _ in new)]
        originals += new
        largest = max(largest, _compared(folder / source[0].name, picture, solution.correction(j)))
    return CubeFiles(paths, tuple(_notes(len(solution.network.images), largest, biased, mapped)), originals)


def _source(name: str, sources: Mapping[str, Path]) -> tuple[Path, Path | None]:
    """Label and JSON of an image's tables."""
    if name not in sources:
        where, expected = f"export to cubes, image {name}", "its ISIS cube, or the label of one"
        raise InputError(where, "none", expected, "name the case (--case), and the cube of each image in it")
    return cube_files(sources[name])


def _said(solution: Solution, when: datetime, bias: float) -> _Said:
    version = solution.versions.get(PROGRAM, "unknown")
    by = f"Adjusted by {PROGRAM} {version}, {'converged' if solution.converged else 'NOT converged'}."
    once = f" Times hold the camera's attitude bias of {bias:g} s once: add none." if bias else ""
    return _Said(f"{when:%Y-%m-%dT%H:%M:%S}", version, f"{by} Positions are geometric.", by + once)


def _notes(count: int, largest: float, biased: list[str], mapped: list[str]) -> Iterator[str]:
    yield f"Read back, {many(count, 'camera')} see 25 pixels within {largest:.1g} px of where the solution has them."
    if biased:
        yield f"{listed(biased)}: attitude times hold MOC's -1.15 s once, as before; ISIS adds none to tables."
    if mapped:
        yield f"{listed(mapped)}: a map, whose pixels stay where the earlier orientation has put them."


# --- tables


def _tables(source: tuple[Path, Path | None], root: Block) -> dict[str, CubeTable]:
    """The cube's own, whose body rotation and constant rotation stay."""
    path, beside = source
    tables = tables_of_json(read_json(beside), str(beside)) if beside else tables_of_label(path, root)
    for name in (_POINTING, _POSITION, "BodyRotation"):
        if name not in tables:
            raise InputError(str(path), f"no table {name}", "those of spiceinit", "run spiceinit with attach=yes")
    return tables


def _adjusted_tables(
    image: PushbroomImage, correction: OrientationCorrection, tables: Mapping[str, CubeTable]
) -> _Tables:
    """Samples, or polynomials in place of such, over the time of the earlier positions; km, km/s, rad/s, s TDB past
    J2000.
    """
    epoch, position = image.trajectory.epoch, tables[_POSITION]
    first, last = image.timing.lines(np.array([position.start, position.stop]) - epoch).tolist()
    body = attitude_table(tables["BodyRotation"], epoch)
    nodes = adjusted_nodes(image, correction, (first, last), _TOLERANCE, body)
    matrices, times = tables[_POINTING].constant.T @ nodes.matrices, (nodes.times + nodes.epoch)[:, None]
    places, quaternions = nodes.positions / KM, rotation.continuous(rotation.from_matrix(matrices))
    made = {
        _POINTING: ((*QUATERNION, *RATES, "ET"), np.hstack([quaternions, nodes.angular_rate, times])),
        _POSITION: ((*POSITION, *VELOCITY, "ET"), np.hstack([places, nodes.velocities / KM, times])),
    }
    angles = np.unwrap(rotation.angles_313(matrices), axis=0)
    for name, fields, values, scale in (
        (_POINTING, ANGLES, angles, image.pixel_angle), (_POSITION, COEFFICIENTS, places, nodes.pixel / KM)
    ):  # fmt: skip
        rows = None if tables[name].sampled else _polynomials(nodes, values, _TOLERANCE * scale)
        made |= {} if rows is None else {name: (fields, rows)}
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

_New = list[tuple[Path, Path]]
"""Files, each with the one that it may replace."""


def _with_json(path: Path, folder: Path, tables: _Tables, instrument: int, said: _Said) -> _New:
    """The label as it is, and the JSON with other tables."""
    content = read_json(path)
    for key, name, fields in (
        ("instrument_pointing", _POINTING, {"quaternions": slice(0, 4), "angular_velocities": slice(4, 7)}),
        ("instrument_position", _POSITION, {"positions": slice(0, 3), "velocities": slice(3, 6)}),
    ):
        rows = tables[name][1]
        content[key] |= {"ephemeris_times": rows[:, -1].tolist()}
        content[key] |= {field: rows[:, part].tolist() for field, part in fields.items()}
    end, keywords = "_LIGHTTIME_CORRECTION", dict[str, Any](content.get("naif_keywords", {}))
    kept = {key: value for key, value in keywords.items() if not key.upper().endswith(end)}
    content |= {"naif_keywords": kept | {f"INS{instrument}{end}": "NONE"}, PROGRAM: said.attitudes}
    write_file(folder / path.name, json.dumps(content, indent=1, allow_nan=False))
    return [(folder / path.name, path)]


def _with_blobs(path: Path, root: Block, folder: Path, tables: _Tables, said: _Said) -> _New:
    """A cube with other tables behind it, or a detached label with a file of them."""
    blobs = [*_table_blobs(root, tables, said), _history(path, root, said)]
    data = b"".join(blob.content for blob in blobs)
    core = root.inner("IsisCube").inner("Core")
    if detached_file(path, core) != path:
        beside = f"{path.stem}.{zlib.crc32(data):08x}.tables"
        write_file(folder / beside, data)
        write_file(folder / path.name, _relabelled(root, blobs, 0, said.time, beside).encode("latin-1"))
        return [(folder / beside, path.with_name(beside)), (folder / path.name, path)]
    size, room = path.stat().st_size, _room(root)
    text, grown = _relabelled(root, blobs, size, said.time), 0
    if len(text) >= room:
        grown = -(-(len(text) + _BLOCK // 16 - room) // _BLOCK) * _BLOCK
        text = _relabelled(_moved(root, room, grown), blobs, size + grown, said.time)
    with fresh_file(folder / path.name) as temporary, path.open("rb") as old, temporary.open("wb") as new:
        new.write(text.encode("latin-1").ljust(room + grown, b"\0"))
        old.seek(room)
        shutil.copyfileobj(old, new, _CHUNK)
        new.write(data)
    _require_same_bytes(path, room, folder / path.name, room + grown)
    return [(folder / path.name, path)]


def _table_blobs(root: Block, tables: _Tables, said: _Said) -> Iterator[_Blob]:
    of_name = {block.text("Name").lower(): block for block in root.blocks if block.name == "table"}
    described = {_POINTING: said.attitudes, _POSITION: said.positions}
    for name, (fields, rows) in tables.items():
        kind = "HermiteSpline" if "ET" in fields else "PolyFunction"
        cache = [("CacheType", kind), (CORRECTION, "NONE")] if name == _POSITION else []
        keys = [("Records", str(len(rows))), ("ByteOrder", "Lsb"), *cache, *_kept(of_name[name.lower()])]
        keys.append(("Description", text_value(described[name], name)))
        yield _Blob("Table", name, tuple(keys), fields, rows.astype("<f8").tobytes())


def _kept(block: Block) -> Iterator[tuple[str, str]]:
    """Keys of a table that are not renewed, with their values as they stand there."""
    marks = sorted([entry.position for entry in block.entries.values()] + [block.blocks[0].position])
    for begin, end in pairwise(marks):
        key, value = block.document.text[begin:end].split("=", 1)
        if key.strip().lower() not in _RENEWED:
            yield key.strip(), value.strip()


def _history(path: Path, root: Block, said: _Said) -> _Blob:
    """The earlier history, as far as it is there, and an entry."""
    name, before = "IsisCube", b""
    for block in root.blocks:
        if block.name == "history":
            name = block.text("Name")
            with detached_file(path, block).open("rb") as file:
                file.seek(block.count("StartByte") - 1)
                before = file.read(block.count("Bytes"))
    keys: list[tuple[str, Value]] = [
        ("ProgramVersion", text_value(said.version, "history")), ("ExecutionDateTime", said.time),
        ("Description", text_value(said.attitudes, "history")),
    ]  # fmt: skip
    lines = [f"Object = {PROGRAM}", *keyword_lines(keys, 2), "", "  Group = UserParameters"]
    lines += [f"    FROM = {text_value(path.name, 'history')}", "  End_Group", "End_Object", ""]
    return _Blob("History", name, (), (), (before + b"\n" if before else b"") + "\n".join(lines).encode())


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
        key = block.name, block.text("Name").lower() if block.name in ("table", "history") else ""
        if key not in _OUTDATED:
            pieces.append(texts.pop(key, _MARK.sub("", text[begin:end])))
    return "".join([*pieces, *texts.values(), "End\n"])


def _object_text(blob: _Blob, start: int, time: str, beside: str) -> str:
    where: list[tuple[str, Value]] = [
        ("Name", blob.name), ("StartByte", str(start)), ("Bytes", str(len(blob.content))), *blob.keys
    ]  # fmt: skip
    where += [(f"^{blob.kind}", beside)] if beside else []
    lines = [f"# Jigged = {time}"] * (blob.kind == "Table") + [f"Object = {blob.kind}", *keyword_lines(where, 2)]
    for field in blob.fields:
        lines += ["", "  Group = Field", f"    Name = {field}", "    Type = Double", "    Size = 1", "  End_Group"]
    return "\n".join([*lines, "End_Object", "", ""])


def _room(root: Block) -> int:
    """Bytes that are the label's own: as it says, or what is before the first byte of anything else."""
    starts = [int(start) for _, start in _START.findall(root.document.text)]
    stated = [block.count("Bytes") for block in root.blocks if block.name == "label"]
    return min([*stated, min(starts) - 1])


def _moved(root: Block, room: int, by: int) -> Block:
    """The label of a cube whose other bytes stand farther behind."""
    text = _START.sub(lambda found: found[1] + str(int(found[2]) + by), root.document.text)
    text = _BYTES.sub(lambda found: found[1] + str(room + by), text)
    return whole_label(Document(root.document.source, text))


def _files_of(source: tuple[Path, Path | None], root: Block) -> set[Path]:
    """Files of a cube that stay as they are: the label of JSON, what a detached one names beside the new tables."""
    path, beside = source
    if beside is not None:
        return {path}
    others = [block for block in root.blocks if block.name not in ("table", "history")]
    others += [block for block in root.blocks if block.name == "table" and block.text("Name") not in _RENEWED_TABLES]
    return {detached_file(path, block) for block in [root.inner("IsisCube").inner("Core"), *others]} - {path}


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
            temporary = stack.enter_context(fresh_file(target, "a cube that may be replaced", "leave out --update"))
            shutil.copyfile(copy, temporary)
            if target.exists():
                shutil.copymode(target, temporary)
            if sha256_of(temporary) != sha256_of(copy):
                raise InputError(str(target), "a copy that is read back otherwise", f"{copy}, byte for byte")


# --- read back


def _require_same_bytes(path: Path, begin: int, copy: Path, other: int) -> None:
    with path.open("rb") as old, copy.open("rb") as new:
        old.seek(begin)
        new.seek(other)
        while chunk := old.read(_CHUNK):
            if new.read(len(chunk)) != chunk:
                raise InputError(str(copy), "other bytes behind its label than were written", f"those of {path}")


def _compared(path: Path, image: PushbroomImage, correction: OrientationCorrection) -> float:
    """px, largest distance at 25 pixels of the copy's camera from the solution's; InputError where it is too large."""
    lines, samples = (axis.ravel() for axis in np.meshgrid(_PLACES * image.lines, _PLACES * image.samples))
    ground, _ = image.image_to_ground(lines, samples, 0.0, correction)
    seen, _ = read_isis_cube(path, image.name).ground_to_image(ground)
    off = np.linalg.norm(seen - np.column_stack([lines, samples]), axis=1)[np.isfinite(ground).all(axis=1)]
    largest = float(off.max()) if off.size else np.nan
    if not largest <= LARGEST:
        found = f"a camera that is {largest:.3g} px off the solution's when it is read back"
        raise InputError(f"image {image.name}, cube", found, f"at most {LARGEST:g} px", _REMEDY)
    return largest

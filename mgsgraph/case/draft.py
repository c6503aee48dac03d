"""Writes a case file for given files: the content of each tells its kind, comments name what is missing.

Tables of a case file for files that are no images, each looked at by itself: networks, shots, terrain models.
"""

import json
import os
import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, suppress
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np

from mgsgraph.atomic_write import made_beside
from mgsgraph.case.case_file import decode, stated
from mgsgraph.case.draft_images import DraftImage, draft_images, named_as, without_place
from mgsgraph.case.reading import case_of
from mgsgraph.case.schema import TerrainInput
from mgsgraph.case.terrain import MEGDR_SIGMAS, MegdrResolution, read_terrain_model
from mgsgraph.errors import InputError, Unmeasured, command_line, require
from mgsgraph.files.altimetry.lidar import read_lidar
from mgsgraph.files.altimetry.shots import read_shots
from mgsgraph.files.kinds import INSTEAD, Kind, described, kind_of, listed_names
from mgsgraph.files.labels.accuracy import Accuracy, accuracy_of
from mgsgraph.files.networks.table import read_tie_points
from mgsgraph.files.opening import head_of
from mgsgraph.files.writing import Output, fresh_file, require_free, writing_to
from mgsgraph.geometry.altimetry import MOLA
from mgsgraph.geometry.body import target_name
from mgsgraph.geometry.image import PushbroomImage
from mgsgraph.geometry.records import Array
from mgsgraph.text import many, some

_ALTIMETRY = "[[altimetry]]"
_RELIEF = "control by relief for `mgsgraph align`"
_CONTROL = re.compile(r"[\x00-\x1f\x7f-\x9f\u2028\u2029]+")
_SAME_SHOT = 1e-3
"""s between the times of one shot in two files."""
_MEGDR_STEPS: dict[str, MegdrResolution] = {"c": "4", "e": "16", "h": "128"}
"""Pixels per degree of MEGDR's grids, by the letter in their names."""


_WIDE = 1000.0
"""m, sigma of heights that leave the relief's scale to the images: with the terrain's own one, relief that the terrain
model lacks pulls the unknown base of a resected image."""


class Part(NamedTuple):
    """A table of the case that may turn out not to go with the others."""

    path: Path
    text: str
    measured: bool = False
    """Whether it holds measures in images."""
    note: str = ""
    """What is to be said of it."""


def quoted(text: str) -> str:
    """A text as a basic string of TOML, whose escapes are those of JSON, and one more."""
    try:
        text.encode()
    except UnicodeEncodeError:
        raise InputError(f"the name {text!r}", "no Unicode text, as a case file is", remedy="rename it") from None
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007f")


def place(path: Path, out: Path) -> str:
    """A path as the case file has it: relative to its folder."""
    return quoted(Path(os.path.relpath(path.absolute(), out.absolute().parent)).as_posix())


def commented(line: str, comment: str) -> str:
    """A line with a comment behind it."""
    return f"{line:39} # {in_line(comment)}\n"


def in_line(text: str) -> str:
    """A text that no line break or control character of it ends or alters."""
    return _CONTROL.sub(" ", text.encode(errors="backslashreplace").decode())


def draft_tables(
    kinds: dict[Path, Kind], images: Sequence[DraftImage], out: Path
) -> tuple[list[Part], list[str]]:
    """Tables of all files but images; and the files that can't be used, with the reason."""
    parts, refused = list[Part](), list[str]()
    for make in (_ties, _control, _lidar, partial(_shots, refused=refused), _altimetry, _terrain):
        of_kind = list(make(kinds, images, out))
        for path, text, measured in of_kind:
            head, _, rest = text.partition("\n")
            head = f"[{head}]" if len(of_kind) > 1 and not head.startswith("[[") else head
            text, note = f"\n{head}\n{rest}", ""
            if head == _ALTIMETRY:  # it says nothing without the images' relief, to which `adjust` is blind
                note = f"{_RELIEF}; in comments"
                text = "".join(f"\n# {line}" for line in (_RELIEF, head, *rest.splitlines())) + "\n"
                text = f"\n{text.lstrip()}"
            parts.append(Part(path, text, measured, note))
    return parts, refused


_Tables = Iterator[tuple[Path, str, bool]]


def _of(kinds: dict[Path, Kind], *accepted: Kind) -> list[Path]:
    return [path for path, kind in kinds.items() if kind in accepted]


def _ties(kinds: dict[Path, Kind], images: Sequence[DraftImage], out: Path) -> _Tables:
    for path in _of(kinds, Kind.NETWORK, Kind.TIE_TABLE):
        sigma = commented("sigma_px = 1.0", "of line and sample, where the network doesn't say")
        yield path, f"[ties]\nnetwork = {place(path, out)}\n{sigma}", True


def _control(kinds: dict[Path, Kind], images: Sequence[DraftImage], out: Path) -> _Tables:
    for path in _of(kinds, Kind.GROUND_CONTROL)[:1]:
        yield path, f"[ground_control]\nfile = {place(path, out)}\n", True


def _lidar(kinds: dict[Path, Kind], images: Sequence[DraftImage], out: Path) -> _Tables:
    for path in _of(kinds, Kind.LIDAR):
        sigma = commented("image_sigma_px = 30.0", "of shots; a convention: state your own, heights follow it")
        yield path, f"[laser]\nfile = {place(path, out)}\n{sigma}", True


def _shots(kinds: dict[Path, Kind], images: Sequence[DraftImage], out: Path, refused: list[str]) -> _Tables:
    """A profile taken along with an image has ranges from its trajectory, MOLA's a shift; others are altimetry."""
    lidar_times = list[Array]()
    for path in _of(kinds, Kind.LIDAR):
        with suppress(InputError):  # said where the case is read
            lidar_times.append(read_lidar(path).times)
    for path in _of(kinds, Kind.SHOTS):
        try:
            shots = read_shots(path)
        except InputError as error:
            refused.append(f"{path.name}: {without_place(str(error), path)}")
            continue
        if any(np.mean(np.abs(_nearest(shots.times, times) - times) < _SAME_SHOT) > 0.5 for times in lidar_times):
            refused.append(f"{path.name}: the same shots as the laser shots of ISIS")
            continue
        spans = [draft.image.span.tolist() for draft in images]
        along = any(np.any((shots.times > start) & (shots.times < stop)) for start, stop in spans)
        if along or shots.altimeter is MOLA:
            text = f"[[shots]]\nfile = {place(path, out)}\n"
            yield path, text + commented("shift_sigma_m = 100.0", "a common horizontal error, as an unknown"), False
        else:
            yield _of_relief(path, out)


def _nearest(sorted_or_not: Array, times: Array) -> Array:
    """For each time the nearest of the other times."""
    ordered = np.sort(sorted_or_not)
    after = np.clip(np.searchsorted(ordered, times), 1, ordered.size - 1)
    before = after - 1
    return np.asarray(np.where(times - ordered[before] < ordered[after] - times, ordered[before], ordered[after]))


def _altimetry(kinds: dict[Path, Kind], images: Sequence[DraftImage], out: Path) -> _Tables:
    yield from (_of_relief(path, out) for path in _of(kinds, Kind.ALTIMETRY))


def _of_relief(path: Path, out: Path) -> tuple[Path, str, bool]:
    sigma = commented("sigma_m = [10.0, 1.0]", "of each shot: horizontal, vertical; docs/align.md")
    return path, f"{_ALTIMETRY}\nfile = {place(path, out)}\n{sigma}", False


def _terrain(kinds: dict[Path, Kind], images: Sequence[DraftImage], out: Path) -> _Tables:
    pictures = [draft.image for draft in images]
    for path in _of(kinds, Kind.RADII, Kind.RASTER):
        text = f"[terrain]\nradius = {place(path, out)}\n"
        heights, level = _of(kinds, Kind.TOPOGRAPHY), None
        if kinds[path] is Kind.RASTER:
            level = _level(path, pictures, out)
            text += commented(f"reference_radius_m = {level}", "above which its heights are: is it?") if level else ""
        elif heights and heights[0].name[4:].lower() == path.name[4:].lower():
            text += commented(f"topography = {place(heights[0], out)}", "radius minus topography is the areoid")
        resolution = _MEGDR_STEPS.get(path.name[10:11].lower(), "none")
        grid = MEGDR_SIGMAS.get(resolution) if kinds[path] is Kind.RADII else None
        if any(draft.resected for draft in images):
            text += commented(f"vertical_sigma_m = {_WIDE}", "wide: else relief pulls the resected image")
        else:
            posts = " between its posts" if grid else ""
            text += commented(f"vertical_sigma_m = {grid or 10.0}", f"of its heights{posts}")
        text += commented("planimetric_sigma_m = 200.0", "of its horizontal place as a whole, which becomes an unknown")
        yield path, text, False


def _level(path: Path, images: Sequence[PushbroomImage], out: Path) -> float | None:
    """m, sphere above which a raster's values may be heights; None where they may be radii, or neither."""
    for level in (None, images[0].body.equatorial):
        with suppress(InputError):
            entry = TerrainInput(radius=str(path.absolute()), reference_radius_m=level)
            read_terrain_model(entry, out, images)
            return level
    return None


_KERNELS = (".tls", ".tsc", ".tpc", ".bpc", ".tf", ".ti", ".bc", ".bsp")
"""Endings in the order of loading: leap seconds, clock, body, frames, instrument, attitude, positions."""
_CASE_FILE = Output("a case file", lambda path: kind_of(path) is Kind.CASE)
_PLAIN = "case"
"""Name of most case files."""
_NOT_TAKEN = (Kind.CASE, Kind.LIST, Kind.OWN_RECORD, *(kind for kind in INSTEAD if kind is not Kind.RASTER))
_UNKNOWN, _NO_TEXT = "an unknown kind of file", "a name that is no Unicode text, as a case file is"
"""Why a file is left out."""
_ROUGH = "a rough guess: the label has no times of its lines; name the image itself, or a text file of them"
_NO_ORBIT = "no kernels; start by its label and tie points, with wide a-priori sigmas"
_HEAD = """\
# Written by `mgsgraph new`, and yours to change. All keys: mgsgraph new --keys.
format = 1
name = {name}
"""
_ORIENTATION = """
[orientation]                           # corrections of each image: polynomials of the line, with a-priori sigmas
degree = 2
{sigmas}trend = [1.0, 0.1, 0.01]                # of these, for the terms 1, u, u^2 (u = -1 .. 1 along the image)
"""
_RESECTION = """\
resection = {}                          # no kernels: orbit like the other image's, place by tie points, nadir; or state
# resection = { longitude_deg = 0.0, latitude_deg = 0.0, altitude_km = 400.0, emission_deg = 0.0 }
"""
_NO_MEASURES = """
# No tie points, ground control or laser shots with measures yet: `mgsgraph match` finds ties. Or name a network:
# [ties]
# network = "network.net"               # ISIS control network (.net, .pvl) or table (.csv, .parquet)
"""


class Draft(NamedTuple):
    """A case file that was written."""

    text: str
    """What it says."""
    said: tuple[str, ...]
    """What was taken, what was left out and why, a line each."""
    command: str
    """What to do next."""


def draft_case(given: Sequence[Path], out: Path, name: str = "", replace: bool = False) -> Draft:
    """Write a case file for files, and those directly in folders.

    Raises
    ------
    InputError
        No image among the files, or images of several bodies; a file given by its name that is of an unknown kind;
        a case file that is there already.
    """
    require(not out.is_dir(), str(out), "a folder", "a case file (case.toml in it, say)")
    require(not out.exists() or replace, str(out), "there already", remedy="choose another --out, or give --replace")
    require_free(out, _CASE_FILE, remedy="choose another --out")
    kinds, unknown = _kinds(given)
    kernels = _kernels(kinds)
    drafted = draft_images(kinds, kernels)
    where = str(given[0]) + (f" and {len(given) - 1} more" if len(given) > 1 else "")
    if not drafted.images:
        raise _no_image(where, kinds, drafted.left_out, unknown)
    bodies = {target_name(draft.image.body): draft for draft in drafted.images}
    each = " and ".join(f"{draft.path.name} of {body}" for body, draft in bodies.items())
    require(len(bodies) <= 1, where, f"images of {len(bodies)} bodies: {each}", "one body", "give their files apart")
    images, missing = named_as(drafted.images, _names_in_networks(kinds))
    parts, refused = draft_tables(kinds, images, out)
    name = name or _name(given, out)
    usual, *others = dict.fromkeys(accuracy_of(draft.image.mission) for draft in images)
    orientation = _ORIENTATION.format(sigmas="".join(usual.lines()))
    head = _HEAD.format(name=quoted(name)) + orientation + _spice(images, kernels, out) + _images(images, usual, out)
    parts, failed = _accepted(head, parts, images, out)
    left_out = [*drafted.left_out, *refused, *failed, *(f"{path.name}: {why}" for path, why in unknown.items())]
    left_out += [
        f"{path.name}: {kind}; unpack it with NAIF's tobin" for path, kind in kinds.items()
        if kind is Kind.TRANSFER and not path.with_suffix(f".b{path.suffix[2:]}").exists()
    ]
    measured = any(part.measured for part in parts)
    text = head + "".join(part.text for part in parts) + ("" if measured else _NO_MEASURES)
    text += "".join(f"\n# Left out: {in_line(line)}" for line in left_out) + ("\n" if left_out else "")
    with fresh_file(out, over=_CASE_FILE) as temporary:
        temporary.write_text(text, encoding="utf-8")
        try:
            decode(temporary)
        except InputError as error:  # never a case file under its name that can't be read
            raise InputError(str(out), str(error).replace(str(temporary), out.name)) from None
    remarks = [f"- {many(len(images), 'image')} of {next(iter(bodies))}: {some([draft.name for draft in images])}"]
    remarks += [f"- {part.path.name}: {kinds[part.path]}{part.note and f', {part.note}'}" for part in parts]
    remarks += [f"- {draft.path.name}: {_ROUGH} (line_times)" for draft in images if draft.line_times is not None]
    remarks += [f"- {draft.path.name}: {_NO_ORBIT} (resection)" for draft in images if draft.resected]
    remarks += [f"- No image for {len(missing)} that networks name: {some(missing)}"] if missing else []
    remarks += [f"- A-priori sigmas of {accuracy.words}" for accuracy in (usual, *others)]
    remarks += [f"- Left out: {line}" for line in left_out]
    remarks += [] if measured else ["- Missing: tie points, ground control, or laser shots with measures"]
    return Draft(text, tuple(map(in_line, remarks)), command_line("check", out))


def _kinds(given: Sequence[Path]) -> tuple[dict[Path, Kind], dict[Path, str]]:
    """Kinds of all files by their paths; and the files of unknown kind among several or in folders, with the reason."""
    kinds, unknown = dict[Path, Kind](), dict[Path, str]()
    for item in given:
        inside = _inside(item)
        for path in inside:
            kind = kind_of(path)
            if not _may_be_named(path):
                unknown[path] = _NO_TEXT
            elif kind is not None and kind not in _NOT_TAKEN:
                kinds[path] = kind
            elif path is item and kind is not Kind.OWN_RECORD and (len(given) == 1 or not path.is_file()):
                head_of(path, 1)  # says what it is that is no file
                found = described(path, kind) if kind else _UNKNOWN
                remedy = INSTEAD.get(kind, "leave it out") if kind else "leave it out"
                raise InputError(str(path), found, "an image, a network, shots, kernels or terrain", remedy)
            elif kind is Kind.OWN_RECORD or path.suffix.lower() not in (".md", ".txt", ".toml", ".html"):
                unknown[path] = str(kind) if kind else _UNKNOWN
    stems = {path.with_suffix("") for path in kinds}  # pixels beside their label
    return kinds, {path: why for path, why in unknown.items() if path.with_suffix("") not in stems}


def _inside(source: Path) -> list[Path]:
    """A file, those directly in a folder, or those that a list names."""
    try:
        if source.is_dir():
            return sorted(path for path in source.iterdir() if path.is_file() and not path.name.startswith("."))
        require(source.exists(), str(source), "no such file", "a file or folder", "check the path")
    except OSError as error:
        raise InputError(str(source), f"can't be read ({error.strerror})") from None
    return [source.parent / name for name in listed_names(source)] if kind_of(source) is Kind.LIST else [source]


def _may_be_named(path: Path) -> bool:
    """Whether a case file, which is Unicode text, can hold a file's name."""
    try:
        path.name.encode()
    except UnicodeEncodeError:
        return False
    return True


def _no_image(
    where: str, kinds: dict[Path, Kind], left_out: Sequence[str], unknown: Mapping[Path, str]
) -> InputError:
    if left_out:  # labels come last: where there are kernels, it is they that say what is missing
        file, _, reason = left_out[-1].partition(": ")
        tried = [line.partition(": ")[0] for line in left_out]
        return InputError(file, reason, remedy=f"so there is no image: {some(tried)} can't be read")
    unrecognized = [f"{path.name} {why}" for path, why in unknown.items()]
    holds = ", ".join([*dict.fromkeys(map(str, kinds.values())), *unrecognized[:1]])
    found = f"no image{f': it holds {holds}' if holds else ''}"
    expected, remedy = "a cube, support data, a label or a model state", "name an image too, or a folder of them"
    return InputError(where, found, expected, remedy)


def _kernels(kinds: dict[Path, Kind]) -> list[Path]:
    """Meta-kernels, or else all kernels in the order of loading."""
    if meta := [path for path, kind in kinds.items() if kind is Kind.META_KERNEL]:
        return meta
    loose = [path for path, kind in kinds.items() if kind is Kind.KERNEL]

    def order(path: Path) -> tuple[int, bool, str]:
        ending = path.suffix.lower()
        rank = _KERNELS.index(ending) if ending in _KERNELS else len(_KERNELS)
        return rank, "addendum" in path.name.lower(), path.name.lower()

    return sorted(loose, key=order)


def _names_in_networks(kinds: dict[Path, Kind]) -> list[str]:
    """What networks and lidar files call images, each once."""
    names: dict[str, None] = {}
    for path, kind in kinds.items():
        with suppress(InputError):  # said where its table is made
            if kind in (Kind.NETWORK, Kind.TIE_TABLE):
                names |= dict.fromkeys(read_tie_points(path).measure_image.used)
            elif kind is Kind.LIDAR:
                shots = read_lidar(path)
                names |= dict.fromkeys([*shots.measure_image.used, *shots.simultaneous_image.used])
    return list(names)


# --- text


def _spice(images: Sequence[DraftImage], kernels: Sequence[Path], out: Path) -> str:
    if not any(draft.by_kernels for draft in images):
        return ""
    listed = "".join(f"  {place(path, out)},\n" for path in kernels)
    return f"\n[spice]                                 # in the order of loading\nkernels = [\n{listed}]\n"


def _images(images: Sequence[DraftImage], usual: Accuracy, out: Path) -> str:
    """Tables of images; those of another mission than [orientation] is for have sigmas of their own."""
    text = ""
    for draft in images:
        text += "\n[[images]]\n"
        text += f"name = {quoted(draft.name)}\n"
        size = f"{draft.kind}, {draft.image.lines} x {draft.image.samples}"
        text += commented(f"image = {place(draft.path, out)}", size)
        text += f"pixels = {place(draft.pixels, out)}\n" if draft.pixels is not None else ""
        if (accuracy := accuracy_of(draft.image.mission)) != usual:
            text += commented(f"orientation = {{ {', '.join(accuracy.keys)} }}", f"a-priori sigmas of {accuracy.words}")
        text += _RESECTION if draft.resected else ""
        text += commented(f"line_times = {quoted(draft.line_times)}", _ROUGH) if draft.line_times is not None else ""
    return text


def _name(given: Sequence[Path], out: Path) -> str:
    """Name of a case: that of its file, or, if the file has the usual name, that of the folder of the data."""
    if out.stem.lower() != _PLAIN:
        return out.stem
    first = given[0].resolve()
    return first.name if first.is_dir() else first.parent.name


def _accepted(
    head: str, parts: list[Part], images: Sequence[DraftImage], out: Path
) -> tuple[list[Part], list[str]]:
    """The tables with which the case can be read, and those without, with the reason."""
    if not any(part.measured for part in parts):
        return parts, []
    failed, pictures = list[str](), tuple(replace(draft.image, name=draft.name) for draft in images)

    def refusal(those: Sequence[Part], whole: bool = False) -> str:
        return _refusal(head + "".join(part.text for part in those), pictures, out, whole)

    good = list[Part]() if refusal(parts) else parts
    for part in [] if good else parts:
        if error := refusal([*good, part]):
            failed.append(f"{part.path.name}: {without_place(error, part.path)}")
        else:
            good = [*good, part]
    if error := refusal(good, whole=True):
        failed += [f"{part.path.name}: {without_place(error, part.path)}" for part in good if part.measured]
        good = [part for part in good if not part.measured]
    return good, failed


def _refusal(text: str, images: tuple[PushbroomImage, ...], out: Path, whole: bool) -> str:
    """What is wrong with a case of images that have been read, in its reader's words; empty for nothing. Not `whole`:
    images without measures pass.
    """
    with ExitStack() as stack:
        with writing_to(out):  # and no more: what else can't be read isn't `out`
            temporary = stack.enter_context(made_beside(out))
            temporary.write_text(text, encoding="utf-8")
        try:
            tables = stated(temporary)
            case_of(tables, temporary, images)
        except InputError as error:
            if isinstance(error, Unmeasured) and not whole:
                return ""
            return str(error).replace(str(temporary), out.name)
    return ""

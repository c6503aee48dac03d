"""A case file for the files that somebody has: what each is says its content, what is missing is said in comments."""

from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

from mgsgraph.atomic_write import made_beside
from mgsgraph.case.case_file import decode, stated
from mgsgraph.case.draft_images import DraftImage, draft_images, named_as, without_place
from mgsgraph.case.draft_tables import Part, draft_tables, in_line, place, quoted, said
from mgsgraph.case.reading import case_of
from mgsgraph.errors import InputError, Unmeasured, require
from mgsgraph.files.altimetry.lidar import read_lidar
from mgsgraph.files.kinds import Kind, kind_of, listed_files
from mgsgraph.files.networks.table import read_tie_points
from mgsgraph.files.opening import head_of
from mgsgraph.files.writing import Output, fresh_file, require_free, writing_to
from mgsgraph.geometry.body import target_name
from mgsgraph.geometry.image import PushbroomImage
from mgsgraph.network.joining import found_passes, seconds
from mgsgraph.text import many, some


def _of_one_moment(images: Sequence[DraftImage]) -> list[str]:
    """A line for those images that overlap in time, at the same places."""
    pictures, told = [replace(one.image, name=one.name) for one in images], list[str]()
    for group in found_passes(pictures):
        names, spans = [pictures[j].name for j in sorted(group)], sorted(seconds(pictures[j]) for j in group)
        if any(later[0] < earlier[1] for earlier, later in pairwise(spans)):
            told.append(f"- {some(names, len(names))}: of one moment, so one trajectory: [[passes]] (docs/passes.md)")
    return told


_KERNELS = (".tls", ".tsc", ".tpc", ".bpc", ".tf", ".ti", ".bc", ".bsp")
"""Endings in the order of loading: leap seconds, clock, body, frames, instrument, attitude, positions."""
_CASE_FILE = Output("a case file", lambda path: kind_of(path) is Kind.CASE)
_PLAIN = "case"
"""Name of most case files."""
_NOT_TAKEN = (Kind.CASE, Kind.LIST, Kind.OWN_RECORD)
_UNKNOWN, _NO_TEXT = "of no kind known here", "a name that is no Unicode text, as a case file is"
"""Why a file is left out."""
_ROUGH = "a rough guess: the label has no times of its lines; name the image itself, or a text file of them"
_HEAD = """\
# Written by `mgsgraph new`, and yours to change. All keys: mgsgraph help case.
format = 1
name = {name}
"""
_ORIENTATION = """
[orientation]                           # corrections of each image: polynomials of the line, with a-priori sigmas
degree = 2
position_sigma_m = 100.0                # constant term, body-fixed X, Y, Z: how well the orbit is known
angle_sigma_mrad = 0.29                 # constant term, about the camera's axes (1 arcmin): how well the attitude is
trend = [1.0, 0.1, 0.01]                # of these, for the terms 1, u, u^2 (u = -1 .. 1 along the image)
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
        No image among the files, or images of several bodies; a file given by its name that is of no kind known here;
        a case file that is there already.
    """
    require(not out.is_dir(), str(out), "a folder", "a case file (case.toml in it, say)")
    if out.exists() and not replace:
        raise InputError(str(out), "there already", remedy="choose another --out, or give --replace")
    require_free(out, _CASE_FILE, remedy="choose another --out")
    kinds, unknown = _kinds(given)
    kernels = _kernels(kinds)
    found = draft_images(kinds, kernels)
    where = str(given[0]) + (f" and {len(given) - 1} more" if len(given) > 1 else "")
    if not found.images:
        raise _no_image(where, kinds, found.left_out, unknown)
    bodies = {target_name(one.image.body): one for one in found.images}
    if len(bodies) > 1:
        each = " and ".join(f"{one.path.name} of {body}" for body, one in bodies.items())
        raise InputError(where, f"images of {len(bodies)} bodies: {each}", "one body", "give their files apart")
    images, missing = named_as(found.images, _names_in_networks(kinds))
    parts, refused = draft_tables(kinds, images, out)
    name = name or _name(given, out)
    head = _HEAD.format(name=quoted(name)) + _ORIENTATION + _spice(images, kernels, out) + _images(images, out)
    parts, failed = _accepted(head, parts, images, out)
    left_out = [*found.left_out, *refused, *failed, *(f"{path.name}: {why}" for path, why in unknown.items())]
    left_out += [
        f"{path.name}: {kind}; unpack it with NAIF's tobin" for path, kind in kinds.items()
        if kind is Kind.TRANSFER and not path.with_suffix(f".b{path.suffix[2:]}").exists()
    ]
    measured = any(part.measured for part in parts)
    text = head + "".join(part.text for part in parts) + ("" if measured else _NO_MEASURES)
    text += "".join(f"\n# Left out: {in_line(line)}" for line in left_out) + ("\n" if left_out else "")
    with fresh_file(out, over=_CASE_FILE) as aside:
        aside.write_text(text, encoding="utf-8")
        try:
            decode(aside)
        except InputError as error:  # never a case file under its name that can't be read
            raise InputError(str(out), str(error).replace(str(aside), out.name)) from None
    called = some([one.name for one in images], len(images))
    told = [f"- {many(len(images), 'image')} of {next(iter(bodies))}: {called}"]
    told += [f"- {part.path.name}: {kinds[part.path]}{part.note and f', {part.note}'}" for part in parts]
    told += [f"- {one.path.name}: {_ROUGH} (line_times)" for one in images if one.line_times is not None]
    told += _of_one_moment(images)
    told += [f"- No image for {len(missing)} that networks name: {some(missing, len(missing))}"] if missing else []
    told += [f"- Left out: {line}" for line in left_out]
    told += [] if measured else ["- Missing: tie points, ground control, or laser shots with measures"]
    return Draft(text, tuple(map(in_line, told)), f"mgsgraph check {out}")


def _kinds(given: Sequence[Path]) -> tuple[dict[Path, Kind], dict[Path, str]]:
    """Kinds of all files by their paths; and those in folders that are of no kind, and why."""
    kinds, unknown = dict[Path, Kind](), dict[Path, str]()
    for one in given:
        inside = _inside(one)
        for path in inside:
            kind = kind_of(path)
            if not _may_be_named(path):
                unknown[path] = _NO_TEXT
            elif kind is not None and kind not in _NOT_TAKEN:
                kinds[path] = kind
            elif path is one and kind is not Kind.OWN_RECORD:
                head_of(path, 1)  # says what it is that is no file
                found = str(kind) if kind else _UNKNOWN
                raise InputError(str(path), found, "an image, a network, shots, kernels or terrain", "leave it out")
            elif kind is Kind.OWN_RECORD or path.suffix.lower() not in (".md", ".txt", ".toml", ".html"):
                unknown[path] = str(kind) if kind else _UNKNOWN
    stems = {path.with_suffix("") for path in kinds}  # pixels beside their label
    return kinds, {path: why for path, why in unknown.items() if path.with_suffix("") not in stems}


def _inside(one: Path) -> list[Path]:
    """A file, those directly in a folder, or those that a list names."""
    try:
        if one.is_dir():
            return sorted(path for path in one.iterdir() if path.is_file() and not path.name.startswith("."))
        require(one.exists(), str(one), "no such file", "a file or folder", "check the path")
    except OSError as error:
        raise InputError(str(one), f"can't be read ({error.strerror})") from None
    return listed_files(one) if kind_of(one) is Kind.LIST else [one]


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
        return InputError(file, reason, remedy=f"so there is no image: {some(tried, len(tried))} can't be read")
    strange = [f"{path.name} {why}" for path, why in unknown.items()]
    holds = ", ".join([*dict.fromkeys(map(str, kinds.values())), *strange[:1]])
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
        try:
            if kind in (Kind.NETWORK, Kind.TIE_TABLE):
                names |= dict.fromkeys(read_tie_points(path).measure_image.used)
            elif kind is Kind.LIDAR:
                shots = read_lidar(path)
                names |= dict.fromkeys([*shots.measure_image.used, *shots.simultaneous_image.used])
        except InputError:  # said where its table is made
            continue
    return list(names)


# --- text


def _spice(images: Sequence[DraftImage], kernels: Sequence[Path], out: Path) -> str:
    if not any(one.by_kernels for one in images):
        return ""
    listed = "".join(f"  {place(path, out)},\n" for path in kernels)
    return f"\n[spice]                                 # in the order of loading\nkernels = [\n{listed}]\n"


def _images(images: Sequence[DraftImage], out: Path) -> str:
    text = ""
    for one in images:
        text += "\n[[images]]\n"
        text += f"name = {quoted(one.name)}\n"
        size = f"{one.kind}, {one.image.lines} x {one.image.samples}"
        text += said(f"image = {place(one.path, out)}", size)
        text += f"pixels = {place(one.pixels, out)}\n" if one.pixels is not None else ""
        text += said(f"line_times = {quoted(one.line_times)}", _ROUGH) if one.line_times is not None else ""
    return text


def _name(given: Sequence[Path], out: Path) -> str:
    """What to call a case: as its file, or, if that is called as every case is, the folder of the data."""
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
    failed, pictures = list[str](), tuple(replace(one.image, name=one.name) for one in images)

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
            aside = stack.enter_context(made_beside(out))
            aside.write_text(text, encoding="utf-8")
        try:
            wanted = stated(aside)
            case_of(wanted, aside, images)
        except InputError as error:
            if isinstance(error, Unmeasured) and not whole:
                return ""
            return str(error).replace(str(aside), out.name)
    return ""

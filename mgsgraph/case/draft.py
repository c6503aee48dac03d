"""A case file for the files that somebody has: what each is says its content, what is missing is said in comments."""

import os
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np

from mgsgraph.altimetry.shots import read_shots
from mgsgraph.case.draft_images import DraftImage, draft_images, named_as, without_place
from mgsgraph.case.laser import AltimetryInput
from mgsgraph.case.reading import read_altimetry, read_case
from mgsgraph.case.schema import TerrainInput
from mgsgraph.case.terrain import read_terrain_model
from mgsgraph.errors import InputError, require
from mgsgraph.fetch.grids import SIGMAS, Terrain
from mgsgraph.geometry.altimeters import MOLA
from mgsgraph.geometry.body import target_name
from mgsgraph.geometry.records import Array
from mgsgraph.io.asp.gcp import read_ground_control
from mgsgraph.io.control.table import read_tie_points
from mgsgraph.io.files import beside, write_file
from mgsgraph.io.kinds import Kind, kind_of, listed_files
from mgsgraph.io.lidar import read_lidar
from mgsgraph.wording import many, some

_SAME_SHOT = 1e-3
"""s between the times of one shot in two files."""
_MEGDR_STEPS: dict[str, Terrain] = {"c": "4", "e": "16", "h": "128"}
"""Pixels per degree of MEGDR's grids, by the letter in their names."""
_KERNELS = (".tls", ".tsc", ".tpc", ".bpc", ".tf", ".ti", ".bc", ".bsp")
"""Endings in the order of loading: leap seconds, clock, body, frames, instrument, attitude, positions."""
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
# network = "network.net"               # ISIS control network (.net, .pvl) or table (.csv)
"""


class Draft(NamedTuple):
    """A case file that was written."""

    text: str
    """What it says."""
    said: tuple[str, ...]
    """What was taken, what was left out and why, a line each."""
    command: str
    """What to do next."""


class _Part(NamedTuple):
    """A table of the case that may turn out not to go with the others."""

    path: Path
    text: str
    measured: bool = False
    """Whether it holds measures in images."""


def draft_case(given: Sequence[Path], out: Path, name: str = "", replace: bool = False) -> Draft:
    """Write a case file for files, and those directly in folders.

    Raises
    ------
    InputError
        No image among the files, or images of several bodies; a file given by its name that is of no kind known here;
        a case file that is there already.
    """
    if out.exists() and not replace:
        raise InputError(str(out), "there already", remedy="choose another --out, or give --replace")
    kinds, unknown = _kinds(given)
    kernels = _kernels(kinds)
    found = draft_images(kinds, kernels)
    where = ", ".join(map(str, given))
    if not found.images:
        raise _no_image(where, kinds, found.left_out)
    bodies = {target_name(one.image.body): one for one in found.images}
    if len(bodies) > 1:
        each = " and ".join(f"{one.path.name} of {body}" for body, one in bodies.items())
        raise InputError(where, f"images of {len(bodies)} bodies: {each}", "one body", "give their files apart")
    images, missing = named_as(found.images, _names_in_networks(kinds))
    parts, refused = _parts(kinds, images, out)
    name = name or next((one.name for one in [*given, Path.cwd()] if one.is_dir()), images[0].path.stem)
    head = _HEAD.format(name=_quoted(name)) + _ORIENTATION + _spice(images, kernels, out) + _images(images, out)
    parts, failed = _accepted(head, parts, out)
    left_out = [*found.left_out, *refused, *failed, *(f"{path.name}: of no kind known here" for path in unknown)]
    left_out += [
        f"{path.name}: {kind}; unpack it with NAIF's tobin" for path, kind in kinds.items()
        if kind is Kind.TRANSFER and not path.with_suffix(f".b{path.suffix[2:]}").exists()
    ]
    measured = any(part.measured for part in parts)
    text = head + "".join(part.text for part in parts) + ("" if measured else _NO_MEASURES)
    text += "".join(f"\n# Left out: {line}" for line in left_out) + ("\n" if left_out else "")
    write_file(out, text)
    called = some([one.name for one in images], len(images))
    said = [f"- {many(len(images), 'image')} of {next(iter(bodies))}: {called}"]
    said += [f"- {part.path.name}: {kinds[part.path]}" for part in parts]
    said += [f"- {one.name}: {one.note}" for one in images if one.note]
    said += [f"- {one.path.name}: {_ROUGH} (line_times)" for one in images if one.line_times is not None]
    said += [f"- No image for {len(missing)} that networks name: {some(missing, len(missing))}"] if missing else []
    said += [f"- Left out: {line}" for line in left_out]
    said += [] if measured else ["- Missing: tie points, ground control, or laser shots with measures"]
    return Draft(text, tuple(said), f"mgsgraph check {out}")


def _kinds(given: Sequence[Path]) -> tuple[dict[Path, Kind], list[Path]]:
    """Kinds of all files by their paths; and those in folders that are of no kind."""
    kinds, unknown = dict[Path, Kind](), list[Path]()
    for one in given:
        require(one.exists(), str(one), "no such file", "a file or folder", "check the path")
        inside = [one]
        if one.is_dir():
            inside = sorted(path for path in one.iterdir() if path.is_file() and not path.name.startswith("."))
        elif kind_of(one) is Kind.LIST:
            inside = listed_files(one)
        for path in inside:
            kind = kind_of(path)
            if kind is not None and kind not in (Kind.CASE, Kind.LIST):
                kinds[path] = kind
            elif path is one:
                found = str(kind) if kind else "of no kind known here"
                raise InputError(str(path), found, "an image, a network, shots, kernels or terrain", "leave it out")
            elif path.suffix.lower() not in (".md", ".txt", ".toml", ".html"):
                unknown.append(path)
    stems = {path.with_suffix("") for path in kinds}  # pixels beside their label
    unknown = [path for path in unknown if path.with_suffix("") not in stems]
    return kinds, unknown


def _no_image(where: str, kinds: dict[Path, Kind], left_out: Sequence[str]) -> InputError:
    if left_out:  # labels come last: where there are kernels, it is they that say what is missing
        file, _, reason = left_out[-1].partition(": ")
        tried = [line.partition(": ")[0] for line in left_out]
        return InputError(where, f"no image that can be read ({some(tried, len(tried))}); {file}: {reason}")
    counts = {kind: list(kinds.values()).count(kind) for kind in kinds.values()}
    holds = ", ".join(f"{kind.value}{f' ({count})' if count > 1 else ''}" for kind, count in counts.items())
    return InputError(
        where, f"no image{f': it holds {holds}' if holds else ''}", "one image at least", "name a file of it, too"
    )


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
                names |= dict.fromkeys(read_tie_points(path).measure_image)
            elif kind is Kind.LIDAR:
                shots = read_lidar(path)
                names |= dict.fromkeys([*shots.measure_image, *(name for one in shots.simultaneous for name in one)])
        except InputError:  # said where its table is made
            continue
    return list(names)


# --- text


def _quoted(text: str) -> str:
    return '"' + text.replace("\\", "\\\\").replace('"', '\\"') + '"'


def _place(path: Path, out: Path) -> str:
    """A path as the case file has it: relative to its folder."""
    return _quoted(Path(os.path.relpath(path.absolute(), out.absolute().parent)).as_posix())


def _said(line: str, comment: str) -> str:
    return f"{line:39} # {comment}\n"


def _spice(images: Sequence[DraftImage], kernels: Sequence[Path], out: Path) -> str:
    if not any(one.by_kernels for one in images):
        return ""
    listed = "".join(f"  {_place(path, out)},\n" for path in kernels)
    return f"\n[spice]                                 # in the order of loading\nkernels = [\n{listed}]\n"


def _images(images: Sequence[DraftImage], out: Path) -> str:
    text = ""
    for one in images:
        text += "\n[[images]]\n"
        text += _said(f"name = {_quoted(one.name)}", one.note) if one.note else f"name = {_quoted(one.name)}\n"
        text += _said(f"image = {_place(one.path, out)}", f"{one.kind}, {one.image.lines} x {one.image.samples}")
        text += f"pixels = {_place(one.pixels, out)}\n" if one.pixels is not None else ""
        text += _said(f"line_times = {_quoted(one.line_times)}", _ROUGH) if one.line_times is not None else ""
    return text


def _parts(kinds: dict[Path, Kind], images: Sequence[DraftImage], out: Path) -> tuple[list[_Part], list[str]]:
    """Tables of all that is no image, each looked at by itself; and what can't be used, with the reason."""
    parts, refused = list[_Part](), list[str]()
    for make in (_ties, _control, _lidar, _shots, _altimetry, _terrain):
        of_kind = list(make(kinds, images, out))
        several = len(of_kind) > 1
        for path, text, read, measured in of_kind:
            try:
                read()
            except InputError as error:
                refused.append(f"{path.name}: {without_place(str(error), path)}")
                continue
            head, _, rest = text.partition("\n")
            head = f"[{head}]" if several and not head.startswith("[[") else head
            parts.append(_Part(path, f"\n{head}\n{rest}", measured))
    return parts, refused


_Made = Iterator[tuple[Path, str, Callable[[], object], bool]]


def _of(kinds: dict[Path, Kind], *wanted: Kind) -> list[Path]:
    return [path for path, kind in kinds.items() if kind in wanted]


def _ties(kinds: dict[Path, Kind], images: Sequence[DraftImage], out: Path) -> _Made:
    for path in _of(kinds, Kind.NETWORK, Kind.TIE_TABLE):
        sigma = _said("sigma_px = 1.0", "of line and sample, where the network doesn't say")
        text = f"[ties]\nnetwork = {_place(path, out)}\n{sigma}"
        yield path, text, partial(read_tie_points, path, images[0].image.body), True


def _control(kinds: dict[Path, Kind], images: Sequence[DraftImage], out: Path) -> _Made:
    for path in _of(kinds, Kind.GROUND_CONTROL)[:1]:
        text = f"[ground_control]\nfile = {_place(path, out)}\n"
        yield path, text, partial(read_ground_control, path, images[0].image.body), True


def _lidar(kinds: dict[Path, Kind], images: Sequence[DraftImage], out: Path) -> _Made:
    for path in _of(kinds, Kind.LIDAR):
        text = f"[laser]\nfile = {_place(path, out)}\n" + _said("image_sigma_px = 30.0", "of the shots' pixels")
        yield path, text, partial(read_lidar, path), True


def _shots(kinds: dict[Path, Kind], images: Sequence[DraftImage], out: Path) -> _Made:
    """A profile taken along with an image has ranges from its trajectory, MOLA's a shift; others are altimetry."""
    known = list[Array]()
    for path in _of(kinds, Kind.LIDAR):
        with suppress(InputError):  # said where its table is made
            known.append(read_lidar(path).times)
    for path in _of(kinds, Kind.SHOTS):
        try:
            shots = read_shots(path)
        except InputError as error:
            yield path, "", _raising(error), False
            continue
        if any(np.mean(np.abs(_nearest(shots.times, times) - times) < _SAME_SHOT) > 0.5 for times in known):
            yield path, "", _raising(InputError(path.name, "the same shots as the laser shots of ISIS")), False
            continue
        along = any(np.any((shots.times > start) & (shots.times < stop)) for start, stop in map(_span, images))
        if along or shots.altimeter is MOLA:
            text = f"[[shots]]\nfile = {_place(path, out)}\n"
            text += _said("shift_sigma_m = 100.0", "a common horizontal error of the profile, as an unknown")
            yield path, text, lambda: None, False
        else:
            yield from _of_relief(path, images, out)


def _raising(error: InputError) -> Callable[[], object]:
    def read() -> object:
        raise error

    return read


def _nearest(sorted_or_not: Array, times: Array) -> Array:
    """Of each time the nearest one of others."""
    known = np.sort(sorted_or_not)
    after = np.clip(np.searchsorted(known, times), 1, known.size - 1)
    before = after - 1
    return np.asarray(np.where(times - known[before] < known[after] - times, known[before], known[after]))


def _span(one: DraftImage) -> tuple[float, float]:
    """S TDB past J2000 of an image's first and last edge."""
    edges, _ = one.image.timing.at(np.array([0.0, float(one.image.lines)]))
    start, stop = (edges + one.image.trajectory.epoch).tolist()
    return start, stop


def _altimetry(kinds: dict[Path, Kind], images: Sequence[DraftImage], out: Path) -> _Made:
    for path in _of(kinds, Kind.ALTIMETRY):
        yield from _of_relief(path, images, out)


def _of_relief(path: Path, images: Sequence[DraftImage], out: Path) -> _Made:
    text = f"[[altimetry]]\nfile = {_place(path, out)}\n"
    text += _said("sigma_m = [10.0, 1.0]", "of each shot: horizontal, vertical; docs/coregister.md")
    wanted = AltimetryInput(file=str(path.absolute()))
    yield path, text, lambda: read_altimetry(wanted, Path(), images[0].image.body), False


def _terrain(kinds: dict[Path, Kind], images: Sequence[DraftImage], out: Path) -> _Made:
    pictures = [one.image for one in images]
    for path in _of(kinds, Kind.RADII, Kind.RASTER):
        text = f"[terrain]\nradius = {_place(path, out)}\n"
        heights = _of(kinds, Kind.TOPOGRAPHY)
        if kinds[path] is Kind.RASTER:
            text += "# reference_radius_m = 3396190.0      # above which its heights are, where they are no radii\n"
        elif heights and heights[0].name[4:].lower() == path.name[4:].lower():
            text += _said(f"topography = {_place(heights[0], out)}", "radius minus topography is the areoid")
        grid = SIGMAS.get(_MEGDR_STEPS.get(path.name[10:11].lower(), "none")) if kinds[path] is Kind.RADII else None
        text += _said(f"vertical_sigma_m = {grid or 10.0}", "of its heights" + (" between its posts" if grid else ""))
        text += _said("planimetric_sigma_m = 200.0", "of its horizontal place as a whole, which becomes an unknown")
        entry = TerrainInput(radius=str(path.absolute()))
        yield path, text, partial(read_terrain_model, entry, out, pictures, read_shots), False


def _accepted(head: str, parts: list[_Part], out: Path) -> tuple[list[_Part], list[str]]:
    """The tables with which the case can be read, and those without, with the reason."""
    failed = list[str]()
    while any(part.measured for part in parts):
        error = _refusal(head + "".join(part.text for part in parts), out)
        if not error:
            break
        named = [part for part in parts if part.path.name in error]
        culprit = next((
            part for part in [*named, *reversed(parts)]
            if not _refusal(head + "".join(one.text for one in parts if one is not part), out, least=True)
        ), next(iter(named), parts[-1]))  # fmt: skip
        parts = [part for part in parts if part is not culprit]
        failed.append(f"{culprit.path.name}: {without_place(error, culprit.path)}")
    return parts, failed


def _refusal(text: str, out: Path, least: bool = False) -> str:
    """What is wrong with a case, in its reader's words; empty for nothing. `least`: a case without measures passes."""
    aside = beside(out)
    out.parent.mkdir(parents=True, exist_ok=True)
    try:
        aside.write_text(text, encoding="utf-8")
        read_case(aside)
    except InputError as error:
        if least and "at least one of them" in str(error):
            return ""
        return str(error).replace(str(aside), out.name)
    finally:
        aside.unlink(missing_ok=True)
    return ""



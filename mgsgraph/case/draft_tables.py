"""Tables of a case file for files that are no images, each looked at by itself: networks, shots, terrain models."""

import json
import os
import re
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np

from mgsgraph.case.draft_images import DraftImage, without_place
from mgsgraph.case.reading import read_altimetry
from mgsgraph.case.schema import AltimetryInput, TerrainInput
from mgsgraph.case.terrain import MEGDR_SIGMAS, MegdrResolution, read_terrain_model
from mgsgraph.errors import InputError
from mgsgraph.files.altimetry.lidar import read_lidar
from mgsgraph.files.altimetry.shots import read_shots
from mgsgraph.files.kinds import Kind
from mgsgraph.files.networks.asp_gcp import read_ground_control
from mgsgraph.files.networks.table import read_tie_points
from mgsgraph.geometry.altimeters import MOLA
from mgsgraph.geometry.image import PushbroomImage
from mgsgraph.geometry.records import Array

_ALTIMETRY = "[[altimetry]]"
_RELIEF = "control by relief for `mgsgraph coregister`"
_CONTROL = re.compile(r"[\x00-\x1f\x7f-\x9f\u2028\u2029]+")
_SAME_SHOT = 1e-3
"""s between the times of one shot in two files."""
_MEGDR_STEPS: dict[str, MegdrResolution] = {"c": "4", "e": "16", "h": "128"}
"""Pixels per degree of MEGDR's grids, by the letter in their names."""


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


def said(line: str, comment: str) -> str:
    """A line with a comment behind it."""
    return f"{line:39} # {in_line(comment)}\n"


def in_line(text: str) -> str:
    """A text that no line break or control character of it ends or alters."""
    return _CONTROL.sub(" ", text.encode(errors="backslashreplace").decode())


def draft_tables(
    kinds: dict[Path, Kind], images: Sequence[DraftImage], out: Path
) -> tuple[list[Part], list[str]]:
    """Tables of all that is no image, each looked at by itself; and what can't be used, with the reason."""
    parts, refused = list[Part](), list[str]()
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
            text, note = f"\n{head}\n{rest}", ""
            if head == _ALTIMETRY:  # it says nothing without the images' relief, to which `adjust` is blind
                note = f"{_RELIEF}; in comments"
                text = "".join(f"\n# {line}" for line in (_RELIEF, head, *rest.splitlines())) + "\n"
                text = f"\n{text.lstrip()}"
            parts.append(Part(path, text, measured, note))
    return parts, refused


_Made = Iterator[tuple[Path, str, Callable[[], object], bool]]


def _of(kinds: dict[Path, Kind], *wanted: Kind) -> list[Path]:
    return [path for path, kind in kinds.items() if kind in wanted]


def _ties(kinds: dict[Path, Kind], images: Sequence[DraftImage], out: Path) -> _Made:
    for path in _of(kinds, Kind.NETWORK, Kind.TIE_TABLE):
        sigma = said("sigma_px = 1.0", "of line and sample, where the network doesn't say")
        text = f"[ties]\nnetwork = {place(path, out)}\n{sigma}"
        yield path, text, partial(read_tie_points, path, images[0].image.body), True


def _control(kinds: dict[Path, Kind], images: Sequence[DraftImage], out: Path) -> _Made:
    for path in _of(kinds, Kind.GROUND_CONTROL)[:1]:
        text = f"[ground_control]\nfile = {place(path, out)}\n"
        yield path, text, partial(read_ground_control, path, images[0].image.body), True


def _lidar(kinds: dict[Path, Kind], images: Sequence[DraftImage], out: Path) -> _Made:
    for path in _of(kinds, Kind.LIDAR):
        text = f"[laser]\nfile = {place(path, out)}\n" + said("image_sigma_px = 30.0", "of the shots' pixels")
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
            text = f"[[shots]]\nfile = {place(path, out)}\n"
            text += said("shift_sigma_m = 100.0", "a common horizontal error of the profile, as an unknown")
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
    text = f"{_ALTIMETRY}\nfile = {place(path, out)}\n"
    text += said("sigma_m = [10.0, 1.0]", "of each shot: horizontal, vertical; docs/coregister.md")
    wanted = AltimetryInput(file=str(path.absolute()))
    yield path, text, lambda: read_altimetry(wanted, Path(), images[0].image.body), False


def _terrain(kinds: dict[Path, Kind], images: Sequence[DraftImage], out: Path) -> _Made:
    pictures = [one.image for one in images]
    for path in _of(kinds, Kind.RADII, Kind.RASTER):
        text = f"[terrain]\nradius = {place(path, out)}\n"
        heights, level = _of(kinds, Kind.TOPOGRAPHY), None
        if kinds[path] is Kind.RASTER:
            level = _level(path, pictures, out)
            text += said(f"reference_radius_m = {level}", "above which its heights are: is it?") if level else ""
        elif heights and heights[0].name[4:].lower() == path.name[4:].lower():
            text += said(f"topography = {place(heights[0], out)}", "radius minus topography is the areoid")
        resolution = _MEGDR_STEPS.get(path.name[10:11].lower(), "none")
        grid = MEGDR_SIGMAS.get(resolution) if kinds[path] is Kind.RADII else None
        text += said(f"vertical_sigma_m = {grid or 10.0}", "of its heights" + (" between its posts" if grid else ""))
        text += said("planimetric_sigma_m = 200.0", "of its horizontal place as a whole, which becomes an unknown")
        entry = TerrainInput(radius=str(path.absolute()), reference_radius_m=level)
        yield path, text, partial(read_terrain_model, entry, out, pictures, read_shots), False


def _level(path: Path, images: Sequence[PushbroomImage], out: Path) -> float | None:
    """m, sphere above which a raster's values may be heights; None where they may be radii, or nothing of both."""
    for level in (None, images[0].body.equatorial):
        with suppress(InputError):
            entry = TerrainInput(radius=str(path.absolute()), reference_radius_m=level)
            read_terrain_model(entry, out, images, read_shots)
            return level
    return None

"""Tables of a case file for files that are no images, each looked at by itself: networks, shots, terrain models."""

import json
import os
import re
from collections.abc import Iterator, Sequence
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np

from mgsgraph.case.draft_images import DraftImage, without_place
from mgsgraph.case.schema import TerrainInput
from mgsgraph.case.terrain import MEGDR_SIGMAS, MegdrResolution, read_terrain_model
from mgsgraph.errors import InputError
from mgsgraph.files.altimetry.lidar import read_lidar
from mgsgraph.files.altimetry.shots import read_shots
from mgsgraph.files.kinds import Kind
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
    """Tables of all that is no image; and what can't be used beside the rest, with the reason."""
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


_Made = Iterator[tuple[Path, str, bool]]


def _of(kinds: dict[Path, Kind], *wanted: Kind) -> list[Path]:
    return [path for path, kind in kinds.items() if kind in wanted]


def _ties(kinds: dict[Path, Kind], images: Sequence[DraftImage], out: Path) -> _Made:
    for path in _of(kinds, Kind.NETWORK, Kind.TIE_TABLE):
        sigma = said("sigma_px = 1.0", "of line and sample, where the network doesn't say")
        yield path, f"[ties]\nnetwork = {place(path, out)}\n{sigma}", True


def _control(kinds: dict[Path, Kind], images: Sequence[DraftImage], out: Path) -> _Made:
    for path in _of(kinds, Kind.GROUND_CONTROL)[:1]:
        yield path, f"[ground_control]\nfile = {place(path, out)}\n", True


def _lidar(kinds: dict[Path, Kind], images: Sequence[DraftImage], out: Path) -> _Made:
    for path in _of(kinds, Kind.LIDAR):
        sigma = said("image_sigma_px = 30.0", "of the shots' pixels")
        yield path, f"[laser]\nfile = {place(path, out)}\n{sigma}", True


def _shots(kinds: dict[Path, Kind], images: Sequence[DraftImage], out: Path, refused: list[str]) -> _Made:
    """A profile taken along with an image has ranges from its trajectory, MOLA's a shift; others are altimetry."""
    known = list[Array]()
    for path in _of(kinds, Kind.LIDAR):
        with suppress(InputError):  # said where the case is read
            known.append(read_lidar(path).times)
    for path in _of(kinds, Kind.SHOTS):
        try:
            shots = read_shots(path)
        except InputError as error:
            refused.append(f"{path.name}: {without_place(str(error), path)}")
            continue
        if any(np.mean(np.abs(_nearest(shots.times, times) - times) < _SAME_SHOT) > 0.5 for times in known):
            refused.append(f"{path.name}: the same shots as the laser shots of ISIS")
            continue
        along = any(np.any((shots.times > start) & (shots.times < stop)) for start, stop in map(_span, images))
        if along or shots.altimeter is MOLA:
            text = f"[[shots]]\nfile = {place(path, out)}\n"
            yield path, text + said("shift_sigma_m = 100.0", "a common horizontal error, as an unknown"), False
        else:
            yield _of_relief(path, out)


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
    yield from (_of_relief(path, out) for path in _of(kinds, Kind.ALTIMETRY))


def _of_relief(path: Path, out: Path) -> tuple[Path, str, bool]:
    sigma = said("sigma_m = [10.0, 1.0]", "of each shot: horizontal, vertical; docs/coregister.md")
    return path, f"{_ALTIMETRY}\nfile = {place(path, out)}\n{sigma}", False


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
        yield path, text, False


def _level(path: Path, images: Sequence[PushbroomImage], out: Path) -> float | None:
    """m, sphere above which a raster's values may be heights; None where they may be radii, or nothing of both."""
    for level in (None, images[0].body.equatorial):
        with suppress(InputError):
            entry = TerrainInput(radius=str(path.absolute()), reference_radius_m=level)
            read_terrain_model(entry, out, images, read_shots)
            return level
    return None

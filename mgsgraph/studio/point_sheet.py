"""All that is known of one point: its place and sigmas, its rays with residuals and tests, points that go along."""

from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from mgsgraph.analysis.measures import MeasureKind
from mgsgraph.analysis.posterior import Posterior, cross_covariances
from mgsgraph.analysis.reliability import reliability
from mgsgraph.errors import InputError
from mgsgraph.files.output.csv_json import plain, vector
from mgsgraph.files.rasters.pictures import picture_size, read_picture_part
from mgsgraph.files.tie_points import PointKind
from mgsgraph.geometry.body import geodetic, planetocentric
from mgsgraph.geometry.records import Array
from mgsgraph.network import PointClass
from mgsgraph.project.edits import point_state
from mgsgraph.project.project import Measure, open_project
from mgsgraph.results.answers import Questions, answered
from mgsgraph.studio.block import Block
from mgsgraph.studio.map_points import MapPoints
from mgsgraph.studio.marks import projected
from mgsgraph.studio.opened import Opened
from mgsgraph.units import DEG

_SHOWN = 12
"""Points that go along with one of which most are shown."""
_CHIP = 32
"""px from the middle of a chip to its edge, at the most."""
_ENLARGED = 4
"""Screen pixels for one of a chip."""


def point_sheet(opened: Opened, point: str) -> dict[str, Any]:
    """Place, sigmas and rays of a point, as JSON.

    Raises
    ------
    InputError
        No such point.
    """
    block, posterior, before = opened.about(point)
    set_aside, edited = _of_project(opened, point)
    (found,) = block.network.points.ids.find([point]).tolist()
    if found < 0 and not set_aside:
        raise InputError(f"point {point}", "not in this block", f"one of its {len(block.network.points)} points")
    record: dict[str, Any] = {
        "name": point, "revision": opened.revision, "there": found >= 0, "edited": edited,
        "set_aside": [_measure_record(one) for one in set_aside],
    }  # fmt: skip
    if found < 0:
        return record | {"rays": [], "class": "tie", "kind": "free", "place": None}
    points = MapPoints(opened, block, before)
    rays = np.flatnonzero(block.network.rays.point == found)
    record |= {
        "class": PointClass(int(block.network.points.classes[found])).name.lower(),
        "kind": PointKind(int(block.network.points.kinds[found])).name.lower(),
        "place": _place(block, block.places[found]), "map_m": vector(points.plane[found]),
        "sigmas_m": vector(np.sqrt(np.diagonal(points.local[found]))), "moved_m": vector(points.moved[found]),
        "rays": [_ray(opened, block, found, k) for k in rays.tolist()],
        "ranges": int(np.count_nonzero(block.network.ranges.point == found)),
    }  # fmt: skip
    return record | _answer(posterior, point)


def _of_project(opened: Opened, point: str) -> tuple[tuple[Measure, ...], bool]:
    """Measures of a point that a person has rejected, and whether a person has changed it."""
    if opened.kind != "project":
        return (), False
    with open_project(opened.path) as project:
        state = point_state(project, point)
        return (() if state is None else state.set_aside), project.last_edit_of(point) is not None


def _measure_record(one: Measure) -> dict[str, Any]:
    return {"image": one.image, "line": one.line, "sample": one.sample, "sigma_px": [one.sigma_line, one.sigma_sample]}


def _place(block: Block, place: Array) -> dict[str, float] | None:
    if not np.all(np.isfinite(place)):
        return None
    longitude, latitude, radius = planetocentric(place[None])[0].tolist()
    _, geodetic_latitude, height = geodetic(place[None], block.images[0].body)[0].tolist()
    return {"longitude_deg": longitude / DEG % 360.0, "latitude_deg": latitude / DEG, "radius_m": radius,
            "geodetic_latitude_deg": geodetic_latitude / DEG, "height_m": height}  # fmt: skip


def _ray(opened: Opened, block: Block, point: int, ray: int) -> dict[str, Any]:
    """A measure with its residual."""
    rays = block.network.rays
    image = int(rays.image[ray])
    at = projected(block, image, block.places[point][None], rays.places[[ray], 0])[0]
    return {
        "image": block.images[image].name, "line": float(rays.places[ray, 0]), "sample": float(rays.places[ray, 1]),
        "sigma_px": rays.sigmas[ray].tolist(), "residual_px": vector(rays.places[ray] - at), "predicted": vector(at),
        "used": bool(block.used[ray]),
        "picture": opened.pictures.get(block.images[image].name) is not None,
    }  # fmt: skip


def _answer(posterior: Posterior | None, point: str) -> dict[str, Any]:
    """What `mgsgraph analyze --point` says of it, and its error ellipsoid; None before any adjustment, or of an
    undetermined point.
    """
    try:
        found = [] if posterior is None else list(answered(posterior, Questions(points=(point,))))
    except InputError:
        found = []
    if not found:
        return {"answer": None}
    return {"answer": "\n".join(found[0].sentences), "ellipsoid": plain(found[0].numbers["ellipsoid"])}


def tests_of(opened: Opened, point: str) -> dict[str, Any]:
    """Redundancy numbers, w-tests and minimal detectable errors of a point's image measures, as JSON.

    Raises
    ------
    InputError
        No such point; nothing adjusted.
    """
    block, posterior, _ = opened.about(point)
    number = block.network.point_number(point)
    if posterior is None:
        raise InputError(str(opened.path), "nothing has been adjusted", "an adjusted block: tests are of residuals")
    found = reliability(posterior.linearised)
    every = found.measures
    mine = np.flatnonzero((every.kind == MeasureKind.RAY) & (every.point == number))
    rows = dict[str, dict[str, list[float | None]]]()
    for k in mine.tolist():
        name = block.images[int(every.image[k])].name
        of_image = rows.setdefault(name, {key: [None, None] for key in ("redundancy", "w", "detectable_px")})
        values = {"redundancy": every.redundancy[k], "w": every.test[k], "detectable_px": every.detectable[k]}
        for key, value in values.items():
            of_image[key][int(every.component[k])] = plain(value)
    return {"critical": found.critical, "alpha": found.levels.alpha, "rays": rows}


def correlations(opened: Opened, point: str) -> dict[str, Any]:
    """How the place of a point goes along with those of others that feel the same unknowns: correlation east, north and
    up with those most correlated, and how many were looked at, as JSON.
    """
    block, posterior, before = opened.about(point)
    points = MapPoints(opened, block, before)
    number = block.network.point_number(point)
    if posterior is None:
        raise InputError(str(opened.path), "nothing has been adjusted", "an adjusted block")
    if not np.any(np.nan_to_num(points.local[number])):
        raise InputError(f"point {point}", "held or without a place: it goes along with nothing", "a free point")
    cross, frames = cross_covariances(posterior.linearised, number), points.frames()
    axes = np.einsum("ab,nbd,nad->na", frames[number], cross, frames)
    variances = np.diagonal(points.local, axis1=1, axis2=2)
    with np.errstate(invalid="ignore", divide="ignore"):
        found = axes / np.sqrt(variances[number] * variances)
    looked_at = np.flatnonzero(np.all(np.isfinite(found), axis=1) & (np.arange(len(found)) != number))
    size = np.abs(found[looked_at]).max(axis=1, initial=0.0)
    chosen = looked_at[np.argsort(-size, kind="stable")[:_SHOWN]]
    away = np.linalg.norm(block.places - block.places[number], axis=1)
    ids = block.network.points.ids
    rows = [{"name": ids[k], "correlation": found[k].tolist()} for k in chosen.tolist()]
    return {"axes": ["east", "north", "up"], "rows": rows, "looked_at": int(looked_at.size),
            "distance_m": {ids[k]: float(away[k]) for k in chosen.tolist()}}  # fmt: skip


def chip(path: Path, line: float, sample: float) -> bytes:
    """The pixels around a place of a picture, enlarged, as PNG; the place is in its middle, but at the edges.

    Raises
    ------
    InputError
        A picture that can't be read; a place outside it.
    """
    lines, samples = picture_size(path)
    row, column = int(np.floor(line)), int(np.floor(sample))
    if not (0 <= row <= lines and 0 <= column <= samples):
        raise InputError(str(path), f"line {line:g}, sample {sample:g}", f"a place in {lines} x {samples} pixels")
    high, wide = 2 * _CHIP + 1, 2 * _CHIP + 1
    grey = np.full((high, wide), np.nan)
    top, left = row - _CHIP, column - _CHIP
    rows, columns = slice(max(top, 0), min(top + high, lines)), slice(max(left, 0), min(left + wide, samples))
    part = read_picture_part(path, rows, columns).astype(np.float64)
    grey[rows.start - top : rows.stop - top, columns.start - left : columns.stop - left] = part
    known = grey[np.isfinite(grey)]
    low, top_value = np.quantile(known, [0.01, 0.99]) if known.size else (0.0, 1.0)
    shade = np.nan_to_num(255.0 * (grey - low) / max(top_value - low, 1e-9))
    picture = Image.fromarray(np.clip(shade, 0.0, 255.0).astype(np.uint8))
    file = BytesIO()
    picture.resize((_ENLARGED * wide, _ENLARGED * high), Image.Resampling.NEAREST).save(file, "png", compress_level=1)
    return file.getvalue()

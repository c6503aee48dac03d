"""All that is known of one point: its place and sigmas, its rays with residuals and tests, correlated points."""

from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from PIL import Image

from mgsgraph.analysis.measures import MeasureKind
from mgsgraph.analysis.posterior import cross_covariances
from mgsgraph.analysis.reliability import reliability
from mgsgraph.errors import InputError, require
from mgsgraph.files.networks.tie_points import PointKind
from mgsgraph.files.output.table import plain, vector
from mgsgraph.files.rasters.pictures import picture_size, read_picture_part
from mgsgraph.geometry.body import geodetic, planetocentric
from mgsgraph.geometry.records import Array, finite_rows, sigmas_of
from mgsgraph.matching.chips import stretched
from mgsgraph.matching.equations import SplinePicture
from mgsgraph.matching.least_squares import MatchStatus, match_least_squares
from mgsgraph.matching.measuring import FINEST
from mgsgraph.network import PointClass
from mgsgraph.planning.candidates import planned_point
from mgsgraph.planning.coverage import ImageCoverage
from mgsgraph.planning.plan import plan
from mgsgraph.project.decisions import Measure
from mgsgraph.project.edits import point_state
from mgsgraph.project.project import open_project
from mgsgraph.project.reading import read_state
from mgsgraph.results.answers import Questions, replies
from mgsgraph.studio.linked import LinkedImages
from mgsgraph.studio.map_points import MapPoints, map_points
from mgsgraph.studio.marks import projected
from mgsgraph.studio.opened import Block, Opened
from mgsgraph.studio.tiles import png
from mgsgraph.units import DEG

_SHOWN = 12
"""Most correlated points that are shown."""
CHIP = 96
"""px from the pixel in the middle of a chip to its edges; more than is shown at first, for turning and zooming out."""


def point_sheet(opened: Opened, point: str) -> dict[str, Any]:
    """Place, sigmas and rays of a point, as JSON.

    Raises
    ------
    InputError
        No such point.
    """
    at_once = opened.is_read and opened.now.solution is not None
    block = opened.block() if at_once else opened.about(point)[0]
    set_aside, edited = _of_project(opened, point)
    (number,) = block.network.points.ids.find([point]).tolist()
    if number < 0 and not set_aside:
        raise InputError(f"point {point}", "not in this block", f"one of its {len(block.network.points)} points")
    record: dict[str, Any] = {
        "name": point, "revision": opened.revision, "there": number >= 0, "edited": edited,
        "set_aside": [_measure_record(measure) for measure in set_aside],
    }  # fmt: skip
    if number < 0:
        return record | {"rays": [], "class": "tie", "kind": "free", "place": None, "adjusted": False}
    points = map_points(opened) if at_once else MapPoints(opened, block)
    rays = np.flatnonzero(block.network.rays.point == number)
    return record | {
        "class": PointClass(int(block.network.points.classes[number])).name.lower(),
        "kind": PointKind(int(block.network.points.kinds[number])).name.lower(),
        "place": _place(block, block.places[number]), "map_m": vector(points.plane[number]),
        "sigmas_m": vector(sigmas_of(points.local[number])),
        "rays": [_ray(opened, block, number, k) for k in rays.tolist()], "adjusted": block.adjusted,
    }  # fmt: skip


def _of_project(opened: Opened, point: str) -> tuple[tuple[Measure, ...], bool]:
    """Measures of a point that the user has rejected, and whether the user has changed it."""
    if opened.kind != "project":
        return (), False
    with open_project(opened.path) as project:
        state = point_state(project, point)
        return (() if state is None else state.set_aside), bool(project.decisions(point))


def _measure_record(measure: Measure) -> dict[str, Any]:
    return {"image": measure.image, "line": measure.line, "sample": measure.sample,
            "sigma_px": [measure.sigma_line, measure.sigma_sample]}  # fmt: skip


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
    predicted = projected(block, image, block.places[point][None], rays.places[[ray], 0])[0]
    return {
        "image": block.images[image].name, "line": float(rays.places[ray, 0]), "sample": float(rays.places[ray, 1]),
        "sigma_px": block.network.ray_sigmas[ray].tolist(), "residual_px": vector(rays.places[ray] - predicted),
        "predicted": vector(predicted), "used": bool(block.used[ray]),
        "picture": opened.pictures.get(block.images[image].name) is not None,
    }  # fmt: skip


def answer_of(opened: Opened, point: str) -> dict[str, Any]:
    """What `mgsgraph analyze --point` prints, as JSON; empty before any adjustment, or of an undetermined point."""
    posterior = opened.about(point)[1]
    with suppress(InputError):
        if posterior is not None:
            return {"answer": "\n".join(next(replies(posterior, Questions(points=(point,)))).sentences)}
    return {"answer": ""}


def tests_of(opened: Opened, point: str) -> dict[str, Any]:
    """Redundancy numbers, w-tests and minimal detectable errors of a point's image measures, as JSON.

    Raises
    ------
    InputError
        No such point; nothing adjusted.
    """
    block, posterior = opened.about(point)
    number = block.network.point_number(point)
    if posterior is None:
        raise InputError(str(opened.path), "nothing has been adjusted", "an adjusted block: tests are of residuals")
    tests = reliability(posterior.linearised)
    measures = tests.measures
    of_point = np.flatnonzero((measures.kind == MeasureKind.RAY) & (measures.point == number))
    rows = dict[str, dict[str, list[float | None]]]()
    for k in of_point.tolist():
        name = block.images[int(measures.image[k])].name
        of_image = rows.setdefault(name, {key: [None, None] for key in ("redundancy", "w", "detectable_px")})
        values = {"redundancy": measures.redundancy[k], "w": measures.test[k], "detectable_px": measures.detectable[k]}
        for key, value in values.items():
            of_image[key][int(measures.component[k])] = plain(value)
    return {"critical": tests.critical, "alpha": tests.levels.alpha, "rays": rows}


def correlations(opened: Opened, point: str) -> dict[str, Any]:
    """Correlations east, north and up of a point's place with the most correlated places of points that depend on the
    same unknowns, and how many were looked at, as JSON.
    """
    block, posterior = opened.about(point)
    points = MapPoints(opened, block)
    number = block.network.point_number(point)
    if posterior is None:
        raise InputError(str(opened.path), "nothing has been adjusted", "an adjusted block")
    if not np.any(np.nan_to_num(points.local[number])):
        raise InputError(f"point {point}", "held or without a place: it has no correlations", "a free point")
    covariances, frames = cross_covariances(posterior.linearised, number), points.frames()
    axes = np.einsum("ab,nbd,nad->na", frames[number], covariances, frames)
    variances = np.diagonal(points.local, axis1=1, axis2=2)
    with np.errstate(invalid="ignore", divide="ignore"):
        coefficients = axes / np.sqrt(variances[number] * variances)
    candidates = np.flatnonzero(finite_rows(coefficients) & (np.arange(len(coefficients)) != number))
    largest = np.abs(coefficients[candidates]).max(axis=1, initial=0.0)
    chosen = candidates[np.argsort(-largest, kind="stable")[:_SHOWN]]
    distances = np.linalg.norm(block.places - block.places[number], axis=1)
    ids = block.network.points.ids
    rows = [{"name": ids[k], "correlation": coefficients[k].tolist()} for k in chosen.tolist()]
    return {"axes": ["east", "north", "up"], "rows": rows, "looked_at": int(candidates.size),
            "distance_m": {ids[k]: float(distances[k]) for k in chosen.tolist()}}  # fmt: skip


def chip(path: Path, line: float, sample: float) -> bytes:
    """The pixels around a place of a picture as PNG, black outside the picture; that of the place is in its middle.

    Raises
    ------
    InputError
        A picture that can't be read; a place outside it.
    """
    lines, samples = picture_size(path)
    row, column = int(np.floor(line)), int(np.floor(sample))
    if not (0 <= row <= lines and 0 <= column <= samples):
        raise InputError(str(path), f"line {line:g}, sample {sample:g}", f"a place in {lines} x {samples} pixels")
    side, top, left = 2 * CHIP + 1, row - CHIP, column - CHIP
    grey = np.full((side, side), np.nan)
    rows, columns = slice(max(top, 0), min(top + side, lines)), slice(max(left, 0), min(left + side, samples))
    part = read_picture_part(path, rows, columns).astype(np.float64)
    grey[rows.start - top : rows.stop - top, columns.start - left : columns.stop - left] = part
    return png(Image.fromarray(stretched(grey[None])[0]))



_HALF = (10, 10)
"""px of the reference window on each side of its middle."""
_REACH = 8.0
"""px, largest distance from the clicked place."""
_MARGIN = 12
"""px that are read beyond the window and its reach."""
_REASONS = {
    MatchStatus.LEFT: "its window leaves the picture, or lies where that has no grey values",
    MatchStatus.NOT_CONVERGED: "it did not converge",
    MatchStatus.WANDERED: f"it wandered more than {_REACH:g} px away",
    MatchStatus.FLAT: "there is too little texture",
    MatchStatus.SATURATED: "too many pixels are saturated",
}


class Refined(NamedTuple):
    """A place refined by least squares."""

    place: Array
    """(2,) line and sample."""
    covariance: Array
    """(2, 2) px^2, for a fixed reference."""
    correlation: float
    """Of both windows."""

    @property
    def sigma(self) -> float:
        """px, of line and sample on the average."""
        return float((0.5 * self.covariance.trace()) ** 0.5)


def refine(
    linked: LinkedImages, pictures: Mapping[str, Path | None], reference: tuple[str, float, float],
    search: tuple[str, float, float],
) -> Refined:  # fmt: skip
    """Move a clicked place to where the ground around the reference's place is.

    The window's shape follows from the geometry of both images, turned and scaled by the Jacobian of one image's places
    by the other's; least squares adjust it (Grün 1985). The covariance is that of noise and of what the window's own
    bend has above its noise (`matching.least_squares`): in so small a window unknowns of the relief would add more
    noise than they take away.

    Parameters
    ----------
    linked : LinkedImages
    pictures : mapping
        File of each image's pixels.
    reference, search : (str, float, float)
        Image, line and sample of the fixed place, and of the clicked one.

    Raises
    ------
    InputError
        No pixels; images that don't show the same ground; a match that wasn't found.
    """
    name, image = reference[0], search[0]
    place, start = np.array(reference[1:]), np.array(search[1:])
    _, predictions = linked.under(*reference, required=(image,))
    block = linked.block
    prediction = next((p for p in predictions if p.image == block.network.image_number(image)), None)
    if prediction is None:
        raise InputError(f"image {image}", f"the ground of {name} isn't in it", "a place of the same ground")
    reach = int(np.ceil(_REACH + np.abs(prediction.jacobian) @ np.array(_HALF)).max())
    template, template_corner = _window(block, pictures, name, place, _HALF[0] + _MARGIN)
    searched, corner = _window(block, pictures, image, start, reach + _MARGIN)
    anchor = np.floor(place) + 0.5
    begin = start + prediction.jacobian @ (anchor - place)
    match = match_least_squares(
        template, searched, (anchor - template_corner)[None], (begin - corner)[None], prediction.jacobian[None], _HALF,
        reach=_REACH, threads=1,
    )  # fmt: skip
    if not match.converged[0]:
        reason = _REASONS[MatchStatus(int(match.status[0]))]
        raise InputError(f"image {image}", f"no least-squares match with {name}: {reason}", remedy="click it by eye")
    refined = match.pixels[0] + corner + match.affine[0] @ (place - anchor)
    return Refined(refined, match.covariance[0] + FINEST**2 * np.eye(2), float(match.correlation[0]))


def _window(
    block: Block, pictures: Mapping[str, Path | None], image: str, place: Array, half: int
) -> tuple[SplinePicture, Array]:
    """Part of a picture around a place, and line and sample (2,) of its corner."""
    path, record = pictures.get(image), block.images[block.network.image_number(image)]
    if path is None:
        raise InputError(f"image {image}", "no file of its pixels is known", remedy="measure without refinement")
    low = np.maximum(np.floor(place).astype(int) - half, 0)
    high = np.minimum(np.floor(place).astype(int) + half + 1, [record.lines, record.samples])
    if np.any(high - low < 2 * _HALF[0]):
        raise InputError(f"image {image}", "a place too near to its edge", "a window inside the picture")
    pixels = read_picture_part(path, slice(low[0], high[0]), slice(low[1], high[1]))
    return SplinePicture.of(pixels, f"image {image}"), low.astype(np.float64)



MOST_PLANNED = 60
"""Most images of a block whose candidates are judged while the user waits."""
_LINES, _SAMPLES, _MOST_PLACES = 9, 3, 80
"""Candidates along and across an image, and in all, about."""
_CHOSEN = 5
"""How many are chosen one after the other, each judged with those before it."""
_SIGMA = 1.0
"""px, of their measures."""


def next_measures(opened: Opened, linked: LinkedImages) -> dict[str, Any]:
    """Candidates on an even grid over the images, the best ones first, as JSON.

    Parameters
    ----------
    opened : Opened
        Adjusted.
    linked : LinkedImages
        Its images.

    Raises
    ------
    InputError
        A large block; one that has not been adjusted; one without ground that two images see.
    """
    block = opened.block()
    count, remedy = len(block.images), "mgsgraph plan RESULT CANDIDATES.toml judges your own"
    require(count <= MOST_PLANNED, str(opened.path), f"{count} images", f"up to {MOST_PLANNED} here", remedy)
    _, state, _ = read_state(opened.path)
    coverage = ImageCoverage(state)
    places = _apart(_grid(linked), opened)
    names = [f"next-{k + 1}" for k in range(len(places))]
    candidates = [planned_point(coverage, name, place, None, _SIGMA) for name, place in zip(names, places, strict=True)]
    candidates = [candidate for candidate in candidates if candidate.addition is not None]
    require(candidates, str(opened.path), "no ground that two images see", "images that overlap")
    planned = plan(state, candidates, _CHOSEN, ("ties",), "mean", opened.now.name)
    at, planes, chosen = dict(zip(names, places, strict=True)), opened.map_places(places).tolist(), []
    for step in planned.chosen:
        place = at[step.name]
        pixels = [(name, projected(block, block.network.image_number(name), place[None])[0]) for name in step.images]
        chosen.append({
            "name": step.name, "map_m": planes[names.index(step.name)], **(_place(block, place) or {}),
            "images": [{"image": name, "line": float(pixel[0]), "sample": float(pixel[1])} for name, pixel in pixels],
            "mean_sigma_m": step.after.total, "gain_percent": 100.0 * step.drop,
        })  # fmt: skip
    sentence = (
        f"{len(candidates)} places on a grid were compared. Measured to {_SIGMA:g} px in each image, these lower the "
        f"mean sigma of the tie points most, one after the other, from {planned.now.total:.4g} m to "
        f"{planned.after.total:.4g} m."
    )
    return {"sentence": sentence, "candidates": chosen}


def _apart(places: Array, opened: Opened) -> Array:
    """Places (n, 3), one in each cell of a grid on the map: images that overlap give several of nearly one place."""
    plane = opened.map_places(places)
    side = max(float(np.sqrt(np.prod(np.ptp(plane, axis=0)) / _MOST_PLACES)), 1.0) if len(places) else 1.0
    return places[np.sort(np.unique(np.floor(plane / side), axis=0, return_index=True)[1])]


def _grid(linked: LinkedImages) -> Array:
    """(n, 3) m, places on the ground, an even grid in each image, that another image shows, too."""
    images = linked.block.images
    step = max(len(images) * _LINES * _SAMPLES // _MOST_PLACES, 1)
    pixels = [
        (image.name, image.lines * (row + 0.5) / _LINES, image.samples * (column + 0.5) / _SAMPLES)
        for image in images for row in range(_LINES) for column in range(_SAMPLES)
    ]  # fmt: skip
    places = list[Array]()
    for name, line, sample in pixels[::step]:
        try:
            ground, predictions = linked.under(name, line, sample)
        except InputError:  # beside the body
            continue
        if predictions:
            places.append(ground.point)
    return np.array(places).reshape(-1, 3)

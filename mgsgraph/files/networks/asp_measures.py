"""Measures of a control network as columns of arrays, as the pipeline counts pixels; and back to ISIS's counts."""

import re
from collections.abc import Collection, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from mgsgraph.errors import InputError
from mgsgraph.files.networks.record import ControlMeasure, ControlNetwork, ControlPoint, MeasureType, PointType
from mgsgraph.files.opening import read_text
from mgsgraph.geometry.records import Array, Index
from mgsgraph.units import ASP_OFFSET, ISIS_OFFSET

FROM_ASP = ISIS_OFFSET - ASP_OFFSET
"""The first pixel's centre, (0, 0) in the pipeline, is (1, 1) in ISIS."""
UNSTATED_SIGMA = 1.0
"""pixels, written where the network has no sigma, as bundle_adjust does."""
RENAME = "give it another name (--rename OLD=NEW)"
"""What to do about an image's name that a format can't hold."""


SEPARATOR = re.compile(r"[\s,]+")
COMMENT = re.compile(r"(?:^|(?<=[\s,]))#.*")
"""What stands between the fields of ground control points, and behind them."""


def filled_lines(path: Path, ground_control: bool = False) -> Iterator[tuple[str, list[str]]]:
    """File and line, and fields of every line that has any: between blanks, or those of ground control points."""
    for number, line in enumerate(read_text(path).split("\n"), start=1):
        fields = list(filter(None, SEPARATOR.split(COMMENT.sub("", line)))) if ground_control else line.split()
        if fields:
            yield f"{path}, line {number}", fields


@dataclass(frozen=True, slots=True, eq=False)
class PixelMeasures:
    """Those points of a network that a format takes, and their measures, point by point."""

    points: tuple[ControlPoint, ...]
    """(n) as the network has them."""
    images: tuple[str, ...]
    """Names of the images that measures are in, in the order in which they come."""
    point: Index
    """(k,) index of the point measured; it never falls."""
    image: Index
    """(k,) index of the image."""
    pixels: Array
    """(k, 2) row, column, first pixel's centre at (0, 0)."""
    sigmas: Array
    """(k, 2) pixels, of row and column; NaN where the network does not say."""


def takes_part(point: ControlPoint, types: Collection[PointType]) -> bool:
    """Whether a point is of one of these types and not ignored."""
    return point.type in types and not point.ignore


def measures_of(network: ControlNetwork, types: Collection[PointType], least: int = 0) -> PixelMeasures:
    """Points of these types with at least so many measures; those with Ignore = True are left out.

    Raises InputError for a measure without a place and for an image twice in a point.
    """
    points, images = list[ControlPoint](), dict[str, int]()
    index, image, places, sigmas = list[int](), list[int](), list[tuple[float, float]](), list[tuple[float, float]]()
    for point in network.points:
        mine = [measure for measure in point.measures if not measure.ignore]
        if not takes_part(point, types) or len(mine) < least:
            continue
        _require_sound(mine, network, point)
        for measure in mine:
            index.append(len(points))
            image.append(images.setdefault(measure.serial_number, len(images)))
            places.append((measure.line or 0.0, measure.sample or 0.0))
            sigmas.append((_known(measure.line_sigma), _known(measure.sample_sigma)))
        points.append(point)
    return PixelMeasures(
        tuple(points), tuple(images), np.array(index, dtype=np.int64), np.array(image, dtype=np.int64),
        np.array(places, dtype=np.float64).reshape(-1, 2) - FROM_ASP,
        np.array(sigmas, dtype=np.float64).reshape(-1, 2),
    )  # fmt: skip


def _known(sigma: float | None) -> float:
    return sigma if sigma is not None and sigma > 0.0 else float("nan")


def _require_sound(measures: list[ControlMeasure], network: ControlNetwork, point: ControlPoint) -> None:
    where = f"{network.source}, point {point.id}" if network.source else f"point {point.id}"
    seen = set[str]()
    for measure in measures:
        if measure.line is None or measure.sample is None:
            raise InputError(f"{where}, image {measure.serial_number}", "a measure without line and sample", "both")
        if measure.serial_number in seen:
            found = f"two measures in image {measure.serial_number}"
            raise InputError(where, found, "one per image", "remove the worse one")
        seen.add(measure.serial_number)


def candidate(image: str, row: float, column: float, row_sigma: float, column_sigma: float) -> ControlMeasure:
    """A measure of which nothing is known but its place (first pixel's centre at 0, 0) and sigmas (NaN: unknown)."""
    return ControlMeasure(
        serial_number=image,
        type=MeasureType.CANDIDATE,
        sample=column + FROM_ASP,
        line=row + FROM_ASP,
        sample_sigma=column_sigma if column_sigma > 0.0 else None,
        line_sigma=row_sigma if row_sigma > 0.0 else None,
    )

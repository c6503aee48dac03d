"""Parts of a control network: points and measures in some images."""

from collections.abc import Mapping, Sequence
from fnmatch import fnmatchcase
from itertools import combinations

from msgspec import structs

from mgsgraph.errors import InputError
from mgsgraph.files.networks.record import ControlNetwork, ControlPoint, PointType
from mgsgraph.text import many, some


def images_of(network: ControlNetwork) -> list[str]:
    """Names of all images, in the order in which they are met."""
    return list(dict.fromkeys(one.serial_number for point in network.points for one in point.measures))


def used_images(point: ControlPoint) -> tuple[str, ...]:
    """Images in which a point has a measure that counts, each once; none of an ignored point."""
    if point.ignore:
        return ()
    return tuple(dict.fromkeys(one.serial_number for one in point.measures if not one.ignore))


def with_measures(point: ControlPoint, which: Sequence[int]) -> ControlPoint:
    """The point with some of its measures, and its reference if that is among them."""
    reference = which.index(point.reference) if point.reference in which else None
    return structs.replace(point, measures=tuple(point.measures[k] for k in which), reference=reference)


def in_images(network: ControlNetwork, patterns: Sequence[str]) -> tuple[ControlNetwork, list[str]]:
    """Measures in some images, and sentences about what was left out.

    Parameters
    ----------
    patterns : sequence of str
        Names of images, or patterns as of files (MGS/*). Points go with the measures in other images where none is
        left, or where a free one is left to a single image.

    Raises
    ------
    InputError
        A pattern that no image has, or no point left.
    """
    names = images_of(network)
    chosen = set[str]()
    for pattern in patterns:
        alike = [name for name in names if name == pattern or fnmatchcase(name, pattern)]
        if not alike:
            raise InputError(network.source, f"no image {pattern!r}", some(names, len(names)))
        chosen.update(alike)
    points, left_out, single = list[ControlPoint](), 0, 0
    for point in network.points:
        which = [k for k, one in enumerate(point.measures) if one.serial_number in chosen]
        left_out += len(point.measures) - len(which)
        if len(which) < len(point.measures):
            images = {point.measures[k].serial_number for k in which}
            if len(images) < (2 if point.type == PointType.FREE else 1):
                single += 1
                continue
            point = with_measures(point, which)
        points.append(point)
    if not points:
        found = "no point in the images that were chosen" if len(chosen) == 1 else "no point in two of them"
        raise InputError(network.source, found, "images that have points in common", "choose others")
    said = [f"Left out: {many(left_out, 'measure')} in {many(len(names) - len(chosen), 'other image')}, and "
            f"{many(single, 'point')} that too few others see"]  # fmt: skip
    return structs.replace(network, points=tuple(points)), said if left_out else []


def common_points(points: Sequence[tuple[str, ...]]) -> Mapping[tuple[str, str], int]:
    """How many points pairs of images have in common, of the images of each point."""
    counts: dict[tuple[str, str], int] = {}
    for images in points:
        for pair in combinations(sorted(images), 2):
            counts[pair] = counts.get(pair, 0) + 1
    return counts

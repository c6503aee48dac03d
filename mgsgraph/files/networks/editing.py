"""Edits of whole control networks: the part in some images, the union of several.

United: points of one id become one with the measures of all. Where two files say different things of a point, or of its
measure in an image, one of them counts, as ISIS's cnetmerge has it (DUPLICATEPOINTS=MERGE, with or without
OVERWRITEPOINTS, OVERWRITEMEASURES and OVERWRITEREFERENCE). A point or measure that is locked (EditLock) in an earlier
file stays as it is there. Source: DOI-USGS/ISIS3, isis/src/control/apps/cnetmerge/cnetmerge.xml.
"""

from collections import Counter
from collections.abc import Sequence
from fnmatch import fnmatchcase
from typing import Any

from msgspec import structs

from mgsgraph.errors import InputError, errors_from
from mgsgraph.files.networks.record import ControlMeasure, ControlNetwork, ControlPoint, Duplicates, PointType
from mgsgraph.names import image_names
from mgsgraph.text import many


def images_of(network: ControlNetwork) -> list[str]:
    """Names of all images, in the order in which they are met."""
    return list(dict.fromkeys(measure.serial_number for point in network.points for measure in point.measures))


def used_images(point: ControlPoint) -> tuple[str, ...]:
    """Images in which a point has a measure that counts, each once; none of an ignored point."""
    if point.ignore:
        return ()
    return tuple(dict.fromkeys(measure.serial_number for measure in point.measures if not measure.ignore))


def with_measures(point: ControlPoint, which: Sequence[int]) -> ControlPoint:
    """The point with some of its measures, and its reference if that is among them."""
    reference = which.index(point.reference) if point.reference in which else None
    return structs.replace(point, measures=tuple(point.measures[k] for k in which), reference=reference)


def in_images(network: ControlNetwork, patterns: Sequence[str]) -> tuple[ControlNetwork, list[str]]:
    """Measures in some images, and sentences about what was left out.

    Parameters
    ----------
    patterns : sequence of str
        Names of images or parts of them, or patterns as of files (MGS/*). Points go with the measures in other images
        where none is left, or where a free one is left to a single image.

    Raises
    ------
    InputError
        A pattern that no image has, or no point left.
    """
    names = images_of(network)
    chosen = set[str]()
    for pattern in patterns:
        matches = [name for name in names if name == pattern or fnmatchcase(name, pattern)]
        with errors_from(network.source):
            chosen.update(matches or image_names([pattern], names))
    points, left_out, single = list[ControlPoint](), 0, 0
    for point in network.points:
        which = [k for k, measure in enumerate(point.measures) if measure.serial_number in chosen]
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
    sentences = [f"Left out: {many(left_out, 'measure')} in {many(len(names) - len(chosen), 'other image')}, and "
            f"{many(single, 'point')} that too few others see"]  # fmt: skip
    return structs.replace(network, points=tuple(points)), sentences if left_out else []


# --- several networks


SAME_PLACE = 1e-6
"""px and m, within which two places are one."""
_KNOWN = (
    "type", "apriori", "apriori_covariance", "apriori_source", "apriori_source_file", "apriori_radius_source",
    "apriori_radius_source_file", "latitude_constrained", "longitude_constrained", "radius_constrained",
)  # fmt: skip
"""Fields of a point's a-priori coordinates."""


def _notes(counts: Counter[str], largest: float, rule: Duplicates) -> list[str]:
    """Sentences about the union; none where no point is in several files."""
    if not counts["points"]:
        return []
    sentences, counted = [], f"the {rule.value} file counts"
    far = f", {counts['moved']} of them elsewhere (up to {largest:.3g} px)" if counts["moved"] else ""
    for key, sentence in (
        ("points", f"United: {{}} of several files, with {many(counts['added'], 'more measure')}"),
        ("measures", f"In several files: {{}}{far}; {counted}"),
        ("other points", f"Of another type or a-priori place in another file: {{}}; {counted}"),
    ):
        if counts[key]:
            sentences.append(sentence.format(many(counts[key], key.removeprefix("other ").removesuffix("s"))))
    if counts["locked"]:
        sentences.append(f"Locked, and left as the earlier file has them: {counts['locked']} points and measures")
    return sentences


def united(
    networks: Sequence[ControlNetwork], duplicates: Duplicates = Duplicates.REFUSE
) -> tuple[tuple[ControlPoint, ...], list[str]]:
    """Points of several networks, in their order, and sentences about those that several have.

    Raises
    ------
    InputError
        For an id in two networks, if that is to be refused.
    """
    files: dict[str, str] = {}
    points: dict[str, ControlPoint] = {}
    counts, far = Counter[str](), [0.0]
    for network in networks:
        for point in network.points:
            if (first := files.setdefault(point.id, network.source)) == network.source:
                points[point.id] = point
                continue
            if duplicates == Duplicates.REFUSE:
                where = f"{network.source}, point {point.id}"
                remedy = "unite them (--duplicates first, or last), or rename one of the two"
                raise InputError(where, f"an id that {first} has, too", "each id in one file", remedy)
            points[point.id] = _united_point(points[point.id], point, duplicates == Duplicates.LAST, counts, far)
    return tuple(points.values()), _notes(counts, max(far), duplicates)


def _united_point(
    early: ControlPoint, late: ControlPoint, prefer_late: bool, counts: Counter[str], far: list[float]
) -> ControlPoint:
    """The union of two points of one id."""
    counts["points"] += 1
    if early.edit_lock:
        counts["locked"] += 1
        return early
    first, second = (late, early) if prefer_late else (early, late)
    apriori: dict[str, Any] = {}
    if first.type == PointType.FREE and first.apriori is None:  # what the other knows contradicts nothing
        apriori = {name: getattr(second, name) for name in _KNOWN}
    elif (second.type, second.apriori) != (PointType.FREE, None):
        counts["other points"] += any(getattr(first, name) != getattr(second, name) for name in _KNOWN[:3])
    measures = _measures(early, late, prefer_late, counts, far)
    reference = None
    for point in (second, first):
        if point.reference is not None:
            image = point.measures[point.reference].serial_number
            reference = next(k for k, measure in enumerate(measures) if measure.serial_number == image)
    return structs.replace(first, measures=tuple(measures), reference=reference, **apriori)


def _measures(
    early: ControlPoint, late: ControlPoint, prefer_late: bool, counts: Counter[str], far: list[float]
) -> list[ControlMeasure]:
    """Those of the earlier point, then others; of the same image the one that counts."""
    measures = list(early.measures)
    number = {measure.serial_number: k for k, measure in reversed(list(enumerate(measures)))}
    for measure in late.measures:
        k = number.get(measure.serial_number)
        if k is None:
            measures.append(measure)
            counts["added"] += 1
            continue
        off = separation(measures[k], measure)
        counts["measures"] += 1
        counts["moved"] += off > SAME_PLACE
        far.append(off)
        if prefer_late and measures[k].edit_lock:
            counts["locked"] += 1
        elif prefer_late:
            measures[k] = measure
    return measures


def separation(first: ControlMeasure, second: ControlMeasure) -> float:
    """px, the larger difference of two measures in line or sample; 0 where one has no coordinates."""
    pairs = ((first.line, second.line), (first.sample, second.sample))
    return max((abs(a - b) for a, b in pairs if a is not None and b is not None), default=0.0)

"""Control networks united: points of one id become one with the measures of all, and contradictions are counted.

Where two files say different things of a point, or of its measure in an image, one of them counts, as ISIS's cnetmerge
has it (DUPLICATEPOINTS=MERGE, with or without OVERWRITEPOINTS, OVERWRITEMEASURES and OVERWRITEREFERENCE). A point or
measure that is locked (EditLock) in an earlier file stays as it is there. Source: DOI-USGS/ISIS3,
isis/src/control/apps/cnetmerge/cnetmerge.xml.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from msgspec import structs

from mgsgraph.errors import InputError
from mgsgraph.files.networks.record import ControlMeasure, ControlNetwork, ControlPoint, Duplicates, PointType
from mgsgraph.text import many

SAME_PLACE = 1e-6
"""px and m, within which two places are one."""
_KNOWN = (
    "type", "apriori", "apriori_covariance", "apriori_source", "apriori_source_file", "apriori_radius_source",
    "apriori_radius_source_file", "latitude_constrained", "longitude_constrained", "radius_constrained",
)  # fmt: skip
"""Fields that say what is known of a point beforehand."""


@dataclass(slots=True)
class _Counts:
    """What was met in uniting."""

    points: int = 0
    """In several files."""
    added: int = 0
    """Measures that came to points of earlier files."""
    repeated: int = 0
    """Measures of one point and image in several files."""
    moved: int = 0
    """Of these, those at other places."""
    largest: float = 0.0
    """px, between two such places."""
    otherwise: int = 0
    """Points of another type, or with another a-priori place or covariance."""
    locked: int = 0
    """Points that would have been changed, and measures that would have been replaced, but for their lock."""

    def notes(self, rule: Duplicates) -> list[str]:
        """In sentences; none where no point is in several files."""
        if not self.points:
            return []
        said = [f"United: {many(self.points, 'point')} of several files, with {many(self.added, 'more measure')}"]
        kept = f"the {rule.value} file counts"
        if self.repeated:
            far = f", {self.moved} of them elsewhere (up to {self.largest:.3g} px)" if self.moved else ""
            said.append(f"In several files: {many(self.repeated, 'measure')}{far}; {kept}")
        if self.otherwise:
            said.append(f"Of another type or a-priori place in another file: {many(self.otherwise, 'point')}; {kept}")
        if self.locked:
            said.append(f"Locked, and left as the earlier file has them: {self.locked} points and measures")
        return said


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
    counts = _Counts()
    for network in networks:
        for point in network.points:
            if (first := files.setdefault(point.id, network.source)) == network.source:
                points[point.id] = point
                continue
            if duplicates == Duplicates.REFUSE:
                where = f"{network.source}, point {point.id}"
                remedy = "unite them (--duplicates first, or last), or rename one of the two"
                raise InputError(where, f"an id that {first} has, too", "each id in one file", remedy)
            points[point.id] = _one(points[point.id], point, duplicates == Duplicates.LAST, counts)
    return tuple(points.values()), counts.notes(duplicates)


def _one(early: ControlPoint, late: ControlPoint, prefer_late: bool, counts: _Counts) -> ControlPoint:
    """Two points of one id as one."""
    counts.points += 1
    if early.edit_lock:
        counts.locked += 1
        return early
    first, second = (late, early) if prefer_late else (early, late)
    known: dict[str, Any] = {}
    if first.type == PointType.FREE and first.apriori is None:  # what the other knows contradicts nothing
        known = {name: getattr(second, name) for name in _KNOWN}
    elif (second.type, second.apriori) != (PointType.FREE, None):
        counts.otherwise += any(getattr(first, name) != getattr(second, name) for name in _KNOWN[:3])
    measures = _measures(early, late, prefer_late, counts)
    reference = None
    for one in (second, first):
        if one.reference is not None:
            image = one.measures[one.reference].serial_number
            reference = next(k for k, measure in enumerate(measures) if measure.serial_number == image)
    return structs.replace(first, measures=tuple(measures), reference=reference, **known)


def _measures(early: ControlPoint, late: ControlPoint, prefer_late: bool, counts: _Counts) -> list[ControlMeasure]:
    """Those of the earlier point, then others; of the same image the one that counts."""
    measures = list(early.measures)
    number = {measure.serial_number: k for k, measure in reversed(list(enumerate(measures)))}
    for measure in late.measures:
        k = number.get(measure.serial_number)
        if k is None:
            measures.append(measure)
            counts.added += 1
            continue
        off = apart(measures[k], measure)
        counts.repeated += 1
        counts.moved += off > SAME_PLACE
        counts.largest = max(counts.largest, off)
        if prefer_late and measures[k].edit_lock:
            counts.locked += 1
        elif prefer_late:
            measures[k] = measure
    return measures


def apart(one: ControlMeasure, other: ControlMeasure) -> float:
    """px, how far apart two measures are along line or sample; 0 where one has no place."""
    pairs = ((one.line, other.line), (one.sample, other.sample))
    return max((abs(a - b) for a, b in pairs if a is not None and b is not None), default=0.0)

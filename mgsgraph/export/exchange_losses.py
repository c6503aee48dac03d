"""What a network format can't hold, in words."""

from collections import Counter
from collections.abc import Sequence
from typing import Any

import numpy as np

from mgsgraph.export import Format
from mgsgraph.files.networks.asp_match import (
    stem,
)
from mgsgraph.files.networks.asp_text import (
    PixelMeasures,
    keeps_ids,
    measures_of,
    takes_part,
)
from mgsgraph.files.networks.pvl import CONSTRAINTS, HEAD_TEXTS, LOCKS, LOG_NAMES, NAME_TEXTS
from mgsgraph.files.networks.record import (
    AprioriSource,
    ControlMeasure,
    ControlNetwork,
    ControlPoint,
    MeasureType,
    PointType,
)
from mgsgraph.text import listed, many

_TABLES = (Format.CSV, Format.PARQUET)
_ALL = frozenset(PointType)
_TAKEN = {
    Format.MATCH: (frozenset({PointType.FREE}), 2), Format.MATCH_TEXT: (frozenset({PointType.FREE}), 2),
    Format.GCP: (_ALL - {PointType.FREE}, 0), Format.NVM: (_ALL, 2),
}  # fmt: skip
"""Types of points that a format takes, and by how many images they must be seen; ignored ones are left out."""


def _keys(*tables: dict[str, str]) -> dict[str, str]:
    """ISIS's keywords by fields of the record."""
    return {attribute: key for table in tables for key, attribute in table.items()}


_KEYWORDS = _keys(NAME_TEXTS, LOCKS) | {"jigsaw_rejected": "JigsawRejected"}
_OF_NETWORK = _keys(HEAD_TEXTS) | {"target_radii": "TargetRadii"}
_OF_POINT = _KEYWORDS | {
    "reference": "the reference measure", "apriori_source": "AprioriXYZSource",
    "apriori_source_file": "AprioriXYZSourceFile", "apriori_radius_source": "AprioriRadiusSource",
    "apriori_radius_source_file": "AprioriRadiusSourceFile", **_keys(CONSTRAINTS),
    "apriori": "the a-priori place", "apriori_covariance": "the a-priori covariance",
    "adjusted": "the adjusted place", "adjusted_covariance": "the adjusted covariance",
}  # fmt: skip
_OF_MEASURE = _KEYWORDS | {
    "sample_residual": "SampleResidual", "line_residual": "LineResidual", "diameter": "Diameter",
    "apriori_sample": "AprioriSample", "apriori_line": "AprioriLine", "sample_sigma": "SampleSigma",
    "line_sigma": "LineSigma",
}  # fmt: skip
_OF_TABLE = {"ignore", "reference", "apriori", "apriori_covariance", "sample_sigma", "line_sigma"}
_HELD = {
    Format.CSV: _OF_TABLE, Format.PARQUET: _OF_TABLE,
    Format.MATCH: {"sample_sigma", "line_sigma"},
    Format.MATCH_TEXT: {"sample_sigma", "line_sigma"},
    Format.GCP: {"apriori", "apriori_covariance", "sample_sigma", "line_sigma"},
    Format.NVM: {"apriori", "adjusted"},
}
"""Fields that a format holds, if only in part, of which more is said below."""


def losses(network: ControlNetwork, form: Format) -> list[str]:
    """What a format can't hold of a network; empty for ISIS's own, which hold everything.

    Raises InputError where the format can't take the network at all: a measure without a place, an image twice in a
    point.
    """
    if form in (Format.PVL, Format.NET):
        return []
    written = _taken(network, form)
    lines = _left_out(network, form)
    if head := [word for name, word in _OF_NETWORK.items() if getattr(network, name)]:
        lines.append(f"{listed(head)} of the network")
    measures = [measure for point in written for measure in _measures(point, form)]
    lines += _fields(written, _OF_POINT, _HELD[form], "point") + _fields(measures, _OF_MEASURE, _HELD[form], "measure")
    lines += _figures(measures)
    if form in _TABLES:
        return lines + _of_table(network)
    lines += _line("MeasureType of {}", sum(m.type != MeasureType.CANDIDATE for m in measures), "measure")
    rows = measures_of(network, *_TAKEN[form])
    if form == Format.NVM:
        return lines + _of_nvm(rows)
    return lines + (_of_control(rows) if form == Format.GCP else _of_matches(rows, form))


def _taken(network: ControlNetwork, form: Format) -> list[ControlPoint]:
    """Points that are written."""
    if form not in _TAKEN:
        return list(network.points)
    types, least = _TAKEN[form]
    return [point for point in network.points if takes_part(point, types) and len(_measures(point, form)) >= least]


def _measures(point: ControlPoint, form: Format) -> list[ControlMeasure]:
    return [measure for measure in point.measures if form in _TABLES or not measure.ignore]


def _left_out(network: ControlNetwork, form: Format) -> list[str]:
    """Points and measures that are not written at all."""
    if form not in _TAKEN:
        return []
    types, least = _TAKEN[form]
    kinds = Counter(point.type for point in network.points if not point.ignore)
    lines = [many(kinds[kind], f"{kind.name.lower()} point") for kind in sorted(kinds) if kind not in types]
    rest = [point for point in network.points if takes_part(point, types)]
    lines += _line("{}", sum(point.ignore for point in network.points), "ignored point")
    few = sum(len(_measures(point, form)) < least for point in rest)
    lines += _line("{} that fewer than two images see", few, "point")
    return lines + _line("{}", sum(measure.ignore for point in rest for measure in point.measures), "ignored measure")


def _line(words: str, count: int, noun: str) -> list[str]:
    """A line for a count above zero."""
    return [words.format(many(count, noun))] if count else []


def _fields(records: Sequence[Any], words: dict[str, str], held: set[str], noun: str) -> list[str]:
    """Fields that are set and not held."""
    lines = list[str]()
    for name, word in words.items():
        if name in held:
            continue
        values = [getattr(record, name) for record in records]
        unset = sum(value in (None, "", ()) or value is False or value is AprioriSource.NONE for value in values)
        lines += _line(word + " of {}", len(values) - unset, noun)
    return lines


def _figures(measures: Sequence[ControlMeasure]) -> list[str]:
    """Figures of merit, by their names."""
    counts = Counter(kind for measure in measures for kind, _ in measure.log)
    return [
        f"{many(count, 'figure')} of {LOG_NAMES.get(kind, f'kind {kind}')}" for kind, count in sorted(counts.items())
    ]


def _of_table(network: ControlNetwork) -> list[str]:
    points = network.points
    measures = [measure for point in points for measure in point.measures]
    bare = sum(point.apriori is None and bool(point.apriori_covariance) for point in points)
    placeless = sum(measure.line is None or measure.sample is None for measure in measures)
    wrong = sum(measure.line_sigma is not None and measure.line_sigma <= 0.0 for measure in measures)
    wrong += sum(measure.sample_sigma is not None and measure.sample_sigma <= 0.0 for measure in measures)
    return [
        *_line("{} of zero or less", wrong, "sigma"),
        *_line("the a-priori covariance of {} without an a-priori place", bare, "point"),
        *_line("{} without line and sample", placeless, "measure"),
    ]


def _of_matches(rows: PixelMeasures, form: Format) -> list[str]:
    differ = int((np.ptp(rows.sigmas, axis=1) > 0.0).sum())
    rounded = form == Format.MATCH and np.any(rows.pixels != rows.pixels.astype(np.float32))
    return [
        *_line("PointId of {} (they are counted anew)", len(rows.points), "point"),
        *_line("folder and ending in the name of {}", sum(stem(name) != name for name in rows.images), "image"),
        *_unstated(rows),
        *_line("unlike sigmas of {} (the quadratic mean is written)", differ, "measure"),
        *(["places beyond single precision"] if rounded else []),
    ]


def _unstated(rows: PixelMeasures) -> list[str]:
    missing = int(np.isnan(rows.sigmas).any(axis=1).sum())
    return _line("the missing sigma of {} (1 px is written)", missing, "measure")


def _of_nvm(rows: PixelMeasures) -> list[str]:
    points = rows.points
    apriori = sum(point.apriori is not None for point in points)
    missing = sum(point.apriori is None and point.adjusted is None for point in points)
    return [
        *_line("PointId of {} (they are counted anew)", len(points), "point"),
        *_line("PointType of {} (all are free)", sum(point.type != PointType.FREE for point in points), "point"),
        *_line("the a-priori place of {} (it is an adjusted one)", apriori, "point"),
        *_line("the missing place of {} (0 0 0 is written)", missing, "point"),
    ]


def _of_control(rows: PixelMeasures) -> list[str]:
    fixed = sum(point.type == PointType.FIXED and bool(point.apriori_covariance) for point in rows.points)
    ids = 0 if keeps_ids(rows.points) else len(rows.points)
    return [
        *_line("PointId of {} (they are numbered)", ids, "point"),
        *_line("covariances between X, Y and Z of {}", sum(_skew(point) for point in rows.points), "point"),
        *_line("the a-priori covariance of {}", fixed, "fixed point"),
        *_unstated(rows),
    ]


def _skew(point: ControlPoint) -> bool:
    upper = point.apriori_covariance
    return point.type == PointType.CONSTRAINED and len(upper) == 6 and any((upper[1], upper[2], upper[4]))

"""Points of ISIS's binary control networks: of their messages the record, and of the record the messages.

Texts, numbers and choices are checked on both ways; errors name the keyword as ISIS's PVL does. Source: DOI-USGS/ISIS3,
isis/src/control/objs/ControlNetVersioner/ControlNetVersioner.cpp (createPoint, createMeasure, writeFirstPoint).
"""

from collections.abc import Iterator, Sequence
from typing import Any, TypeVar

from mgsgraph.errors import InputError
from mgsgraph.files.networks.messages import NULL, UNSET, messages
from mgsgraph.files.networks.record import AprioriSource, ControlMeasure, ControlPoint, MeasureType, PointType

LARGEST = 1e300
"""Larger numbers are none, here as in PVL: ISIS's special values begin there."""
_POINT_TYPES = {0: PointType.FREE, 1: PointType.FIXED} | {int(kind): kind for kind in PointType}
"""By number in the file; 0 and 1 are Tie and Ground of old."""
_MEASURE_TYPES = {int(kind): kind for kind in MeasureType}
_SOURCES = {int(source): source for source in AprioriSource} | {UNSET: AprioriSource.NONE}
_Kind = TypeVar("_Kind")


class Texts(dict[bytes, str]):
    """Texts by their bytes; equal ones are one object, for there are few names and dates in many measures."""

    def __missing__(self, data: bytes) -> str:
        try:
            text = self[data] = data.decode("utf-8")
        except UnicodeDecodeError:
            raise InputError("text", f"{data[:60]!r}", "UTF-8") from None
        return text

    def required(self, data: bytes, key: str) -> str:
        """A text that is not empty."""
        if not data:
            raise InputError(key, "none", "a name")
        return self[data]


def read_point(message: Any, where: str, texts: Texts) -> ControlPoint:
    """The point of a message; `where` begins its errors, `texts` are those met before."""
    if message.id:
        name = message.id[:60].decode("utf-8", "replace").replace("\n", " ")
        where += f" ({name})"
    reference, count = message.referenceIndex, len(message.measures)
    try:
        if not (reference == UNSET or 0 <= reference < count):
            found = f"measure {reference} (counted from 0) as reference"
            raise InputError("Reference", found, f"one of its {count} measures")
        return ControlPoint(
            id=texts.required(message.id, "PointId"),
            type=_chosen(message.type, _POINT_TYPES, "PointType"),
            measures=tuple(_read_measure(measure, k, texts) for k, measure in enumerate(message.measures, start=1)),
            chooser_name=texts[message.chooserName],
            date_time=texts[message.datetime],
            edit_lock=message.editLock,
            ignore=message.ignore,
            jigsaw_rejected=message.jigsawRejected,
            reference=reference if reference != UNSET else None,
            apriori_source=_chosen(message.aprioriSurfPointSource, _SOURCES, "AprioriXYZSource"),
            apriori_source_file=texts[message.aprioriSurfPointSourceFile],
            apriori_radius_source=_chosen(message.aprioriRadiusSource, _SOURCES, "AprioriRadiusSource"),
            apriori_radius_source_file=texts[message.aprioriRadiusSourceFile],
            latitude_constrained=message.latitudeConstrained,
            longitude_constrained=message.longitudeConstrained,
            radius_constrained=message.radiusConstrained,
            apriori=_place((message.aprioriX, message.aprioriY, message.aprioriZ), "Apriori"),
            apriori_covariance=_covariance(message.aprioriCovar, "AprioriCovarianceMatrix"),
            adjusted=_place((message.adjustedX, message.adjustedY, message.adjustedZ), "Adjusted"),
            adjusted_covariance=_covariance(message.adjustedCovar, "AdjustedCovarianceMatrix"),
        )
    except InputError as error:
        raise error.within(where) from None


def _read_measure(message: Any, number: int, texts: Texts) -> ControlMeasure:
    try:
        return ControlMeasure(
            serial_number=texts.required(message.serialnumber, "SerialNumber"),
            type=_chosen(message.type, _MEASURE_TYPES, "MeasureType"),
            sample=_optional(message.sample, "Sample"),
            line=_optional(message.line, "Line"),
            sample_residual=_optional(message.sampleResidual, "SampleResidual"),
            line_residual=_optional(message.lineResidual, "LineResidual"),
            chooser_name=texts[message.choosername],
            date_time=texts[message.datetime],
            edit_lock=message.editLock,
            ignore=message.ignore,
            jigsaw_rejected=message.jigsawRejected,
            diameter=_optional(message.diameter, "Diameter"),
            apriori_sample=_optional(message.apriorisample, "AprioriSample"),
            apriori_line=_optional(message.aprioriline, "AprioriLine"),
            sample_sigma=_optional(message.samplesigma, "SampleSigma"),
            line_sigma=_optional(message.linesigma, "LineSigma"),
            log=tuple(_logged(message.log)) if message.log else (),
        )
    except InputError as error:
        raise error.within(f"measure {number}") from None


def _logged(entries: Any) -> Iterator[tuple[int, float]]:
    """Figures of merit; those of no kind or without a value are none (ControlMeasureLogData::IsValid)."""
    for entry in entries:
        kind, value = entry.doubleDataType, _optional(entry.doubleDataValue, "log data")
        if kind > 0 and value is not None:
            yield kind, value


def point_message(point: ControlPoint) -> Any:
    """The message of a point; None is left out, the sources are not, as in ISIS."""
    ax, ay, az = point.apriori or (None, None, None)
    x, y, z = point.adjusted or (None, None, None)
    return messages().point(
        id=encoded(point.id),
        type=int(point.type),
        chooserName=encoded(point.chooser_name),
        datetime=encoded(point.date_time),
        editLock=point.edit_lock or None,
        ignore=point.ignore or None,
        jigsawRejected=point.jigsaw_rejected or None,
        referenceIndex=point.reference,
        aprioriSurfPointSource=int(point.apriori_source),
        aprioriSurfPointSourceFile=encoded(point.apriori_source_file),
        aprioriRadiusSource=int(point.apriori_radius_source),
        aprioriRadiusSourceFile=encoded(point.apriori_radius_source_file),
        latitudeConstrained=point.latitude_constrained or None,
        longitudeConstrained=point.longitude_constrained or None,
        radiusConstrained=point.radius_constrained or None,
        aprioriX=_number(ax, "AprioriX"),
        aprioriY=_number(ay, "AprioriY"),
        aprioriZ=_number(az, "AprioriZ"),
        aprioriCovar=_covariance(point.apriori_covariance, "AprioriCovarianceMatrix"),
        adjustedX=_number(x, "AdjustedX"),
        adjustedY=_number(y, "AdjustedY"),
        adjustedZ=_number(z, "AdjustedZ"),
        adjustedCovar=_covariance(point.adjusted_covariance, "AdjustedCovarianceMatrix"),
        measures=list(map(_measure_message, point.measures)),
    )


def _measure_message(measure: ControlMeasure) -> Any:
    """The message of a measure; None is left out."""
    kinds = messages()
    return kinds.measure(
        serialnumber=encoded(measure.serial_number),
        type=int(measure.type),
        sample=_number(measure.sample, "Sample"),
        line=_number(measure.line, "Line"),
        sampleResidual=_number(measure.sample_residual, "SampleResidual"),
        lineResidual=_number(measure.line_residual, "LineResidual"),
        choosername=encoded(measure.chooser_name),
        datetime=encoded(measure.date_time),
        editLock=measure.edit_lock or None,
        ignore=measure.ignore or None,
        jigsawRejected=measure.jigsaw_rejected or None,
        diameter=_number(measure.diameter, "Diameter"),
        apriorisample=_number(measure.apriori_sample, "AprioriSample"),
        aprioriline=_number(measure.apriori_line, "AprioriLine"),
        samplesigma=_number(measure.sample_sigma, "SampleSigma"),
        linesigma=_number(measure.line_sigma, "LineSigma"),
        log=[kinds.log(doubleDataType=kind, doubleDataValue=finite(value, "log")) for kind, value in measure.log],
    )


def _number(value: float | None, key: str) -> float | None:
    return value if value is None else finite(value, key)


def encoded(text: str) -> bytes | None:
    """A text's bytes; None for an empty one."""
    try:
        return text.encode("utf-8") if text else None
    except UnicodeEncodeError:
        raise InputError("text", f"{text[:60]!r}", "what UTF-8 can hold") from None


def finite(value: float, key: str) -> float:
    """The number, if it is one."""
    if not -LARGEST < value < LARGEST:
        raise InputError(key, f"{value}", "a finite number")
    return value


def _optional(value: float, key: str) -> float | None:
    """A number; None for the special values by which ISIS says that it was never set."""
    if -LARGEST < value < LARGEST:
        return value
    if NULL <= value < 0.0:
        return None
    raise InputError(key, f"{value}", "a finite number")


def _chosen(number: int, kinds: dict[int, _Kind], key: str) -> _Kind:
    """One of an enumeration."""
    kind = kinds.get(number)
    if kind is None:
        raise InputError(key, "none" if number == UNSET else f"{number}", f"one of {', '.join(map(str, kinds))}")
    return kind


def _place(values: tuple[float, float, float], stage: str) -> tuple[float, float, float] | None:
    x, y, z = (_optional(value, stage + axis) for axis, value in zip("XYZ", values, strict=True))
    if x is None and y is None and z is None:
        return None
    if x is None or y is None or z is None:
        raise InputError(stage, "a place in part", f"{stage}X, {stage}Y and {stage}Z")
    return x, y, z


def _covariance(values: Sequence[float], key: str) -> tuple[float, ...]:
    if len(values) not in (0, 6):
        raise InputError(key, f"{len(values)} numbers", "xx, xy, xz, yy, yz, zz")
    return tuple(finite(value, key) for value in values)

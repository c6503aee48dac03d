"""Binary control networks of version 1 in messages of version 2, as ISIS takes them.

There a network is one message and its figures of merit another one, of the same points and measures in the same order;
types of measures are counted from 1, a measure's place is a message of its own, and every point with an a-priori
covariance is constrained. Source: DOI-USGS/ISIS3, isis/src/control/objs/ControlNetVersioner/, of which
ControlNetVersioner.cpp (readProtobufV0001) and ControlPointV0003.cpp, where it is made of a ControlPointV0002.
"""

from collections.abc import Iterator
from typing import Any

from mgsgraph.errors import InputError
from mgsgraph.files.networks.messages import UNSET, messages
from mgsgraph.files.networks.record import PointType


def second_versions(network: Any, log: Any, where: str) -> Iterator[Any]:
    """Points of a network of version 1 and its figures of merit as messages of version 2.

    Raises
    ------
    InputError
        Figures of merit of other points or measures.
    """
    _require_same(len(log.points), len(network.points), f"{where}, LogData, points")
    for number, (point, figures) in enumerate(zip(network.points, log.points, strict=True), start=1):
        _require_same(len(figures.measures), len(point.measures), f"{where}, LogData, point {number}, measures")
        made = messages().point(
            measures=[_measure(*one) for one in zip(point.measures, figures.measures, strict=True)], **_fields(point)
        )
        if made.aprioriCovar:
            made.type = int(PointType.CONSTRAINED)
        yield made


def _measure(measure: Any, figures: Any) -> Any:
    kinds = messages()
    log = [kinds.log(**_fields(entry)) for entry in figures.log]
    made = kinds.measure(log=log, **_fields(measure), **_fields(measure.measurement))
    made.type = measure.type - 1 if measure.type != UNSET else UNSET
    return made


def _fields(message: Any) -> dict[str, Any]:
    """Fields that are set, but for messages in them."""
    return {field.name: value for field, value in message.ListFields() if field.message_type is None}


def _require_same(found: int, expected: int, where: str) -> None:
    if found != expected:
        raise InputError(where, f"{found}", f"{expected}, as in Core", "the file is damaged: write it anew")

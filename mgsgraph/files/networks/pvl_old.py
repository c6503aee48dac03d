"""What versions 1 and 2 of ISIS control networks in PVL text say otherwise than version 5, in the words of version 5.

Version 1 (the one without Version) has its own keywords: X, Y, Z or Latitude, Longitude, Radius for the adjusted place,
ApostCovarianceMatrix, AprioriLatLonSource, Held, ErrorLine and ErrorSample, other words for types of measures, and
sigmas in place of covariances. In both every point with an a-priori covariance is constrained. Source: DOI-USGS/ISIS3,
isis/src/control/objs/ControlNetVersioner/, of which ControlPointV0001.cpp, and ControlPointV0003.cpp, where it is made
of a ControlPointV0002; old networks beside them.
"""

from typing import Any

import numpy as np
from msgspec import structs

from mgsgraph.files.networks.record import ControlPoint, PointType
from mgsgraph.files.pvl import LENGTHS, Block, Entry
from mgsgraph.geometry.body import east_north_up

_POINT = {
    "x": "adjustedx", "y": "adjustedy", "z": "adjustedz", "latitude": "adjustedlatitude",
    "longitude": "adjustedlongitude", "radius": "adjustedradius", "apostcovariancematrix": "adjustedcovariancematrix",
    "apriorilatlonsource": "apriorixyzsource", "apriorilatlonsourcefile": "apriorixyzsourcefile",
}  # fmt: skip
_MEASURE = {"errorline": "lineresidual", "errorsample": "sampleresidual"}
_NEEDLESS = ("errormagnitude", "zscore")
"""Of a measure: they follow from others."""
_MEASURE_TYPES = {
    "estimated": "candidate", "unmeasured": "candidate", "automatic": "registeredpixel",
    "validatedmanual": "registeredpixel", "automaticpixel": "registeredpixel",
    "validatedautomatic": "registeredsubpixel", "automaticsubpixel": "registeredsubpixel",
}  # fmt: skip
_UNKNOWN_SIGMA = 10_000.0
"""m, what ISIS takes where one of three sigmas is not there, not positive, or larger."""
_AXES = ("Longitude", "Latitude", "Radius")


def renew_keywords(point: Block) -> None:
    """Give keywords of a point of version 1, and of its measures, their names of version 5."""
    _rename(point, _POINT)
    if point.flag("Held"):
        point.entries["pointtype"] = point.entries["held"]._replace(value="Ground")
    for measure in point.blocks:
        _rename(measure, _MEASURE)
        for key in _NEEDLESS:
            measure.entries.pop(key, None)
        kind = measure.entries.get("measuretype")
        if kind is not None and isinstance(kind.value, str):
            word = _MEASURE_TYPES.get(kind.value.lower(), kind.value)
            measure.entries["measuretype"] = kind._replace(value=word)
        if "Line" not in measure or "Sample" not in measure:  # it was never measured
            measure.entries["ignore"] = Entry("True", "", measure.position)


def _rename(block: Block, names: dict[str, str]) -> None:
    """Other names for keywords, and none for those that say nothing."""
    entries = {key: entry for key, entry in block.entries.items() if entry.value != ""}
    for old, new in names.items():
        if old in entries:
            entry = entries.pop(old)
            entries.setdefault(new, entry)
    block.entries = entries


def renewed_point(point: ControlPoint, block: Block, version: str) -> ControlPoint:
    """A point of version 1 or 2 as ISIS takes it: constrained where there is an a-priori covariance; in version 1 with
    the covariances of sigmas (m, on the ground and upward), and with the adjusted place where it has no a-priori one.
    """
    changed: dict[str, Any] = {}
    if version == "1":
        changed["apriori"] = point.apriori or point.adjusted
        changed |= _covariances(point, block)
    if changed.get("apriori_covariance", point.apriori_covariance):
        changed["type"] = PointType.CONSTRAINED
    return structs.replace(point, **changed)


def _covariances(point: ControlPoint, block: Block) -> dict[str, Any]:
    """Covariances of version 1, and whether coordinates are constrained, by their names in the record."""
    found: dict[str, Any] = {}
    adjusted, known = point.adjusted_covariance, point.apriori_covariance
    if place := point.apriori or point.adjusted:
        known = known or _of_sigmas(block, "AprioriSigma", place)
    if point.adjusted:
        adjusted = adjusted or _of_sigmas(block, "AdjustedSigma", point.adjusted)
    for axis in _AXES:
        whole = bool(point.apriori_covariance or point.adjusted_covariance)
        found[f"{axis.lower()}_constrained"] = whole or f"AprioriSigma{axis}" in block
    return found | {"apriori_covariance": known, "adjusted_covariance": adjusted}


def _of_sigmas(block: Block, key: str, place: tuple[float, float, float]) -> tuple[float, ...]:
    """xx, xy, xz, yy, yz, zz in m^2 of sigmas along longitude, latitude and radius; empty without any."""
    names = [f"{key}{axis}" for axis in _AXES]
    if not any(name in block for name in names):
        return ()
    stated = [block.number(name, LENGTHS) if name in block else 0.0 for name in names]
    sigmas = np.array([one if 0.0 < one < _UNKNOWN_SIGMA else _UNKNOWN_SIGMA for one in stated])
    (axes,) = east_north_up(np.array([place]))
    return tuple(((axes.T * sigmas**2) @ axes)[np.triu_indices(3)].tolist())

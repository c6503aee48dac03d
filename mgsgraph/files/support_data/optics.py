"""Models of distortion as usgscsm and ALE name, number and write them, in mm, and as records in m.

Names and layouts of support data: ALE (ale/base/type_distortion.py; C++ src/Util.cpp, getDistortionModel,
getDistortionCoeffs); numbers and orders of coefficients of model states: usgscsm (include/usgscsm/Distortion.h,
src/Distortion.cpp). ISIS writes a single coefficient as a number, ALE as a list of one.
"""

from collections.abc import Callable, Mapping
from dataclasses import astuple, dataclass
from typing import Any

import numpy as np

from mgsgraph.errors import InputError
from mgsgraph.geometry.camera import (
    CahvorDistortion,
    DawnDistortion,
    Distortion,
    KaguyaDistortion,
    LrocNacDistortion,
    NoDistortion,
    RadialDistortion,
    RadtanDistortion,
    ShadowCamDistortion,
    ThemisIrDistortion,
    TransverseDistortion,
)
from mgsgraph.geometry.records import Array
from mgsgraph.units import MM

_CUBIC = (1, 0, 0, -1, -1, -1, -2, -2, -2, -2)
_KAGUYA = (1, 1, 0, -1, -2)
_FRAMING = {"lunarorbiter": 6, "cassis": 9}
"""Models of cameras that are no line scanners."""


@dataclass(frozen=True, slots=True)
class _Model:
    """One model: its coefficients in the order of model states."""

    kind: type[Distortion]
    number: int
    """DistortionType of usgscsm."""
    powers: tuple[int, ...]
    """Of mm, the coefficients' units."""
    made: Callable[[list[float], float], Distortion]
    """From coefficients in m and the focal length in m."""
    axes: bool = False
    """Whether x and y have coefficients of their own, under their names."""


_MODELS = {
    "radial": _Model(RadialDistortion, 0, (0, -2, -4), lambda c, _: RadialDistortion(*c)),
    "transverse": _Model(
        TransverseDistortion, 1, _CUBIC * 2, lambda c, _: TransverseDistortion(_ten(c[:10]), _ten(c[10:])), axes=True
    ),
    "kaguyalism": _Model(KaguyaDistortion, 2, _KAGUYA * 2, lambda c, _: _kaguya(c), axes=True),
    "dawnfc": _Model(DawnDistortion, 3, (-2,), lambda c, _: DawnDistortion(*c)),
    "lrolrocnac": _Model(LrocNacDistortion, 4, (-2,), lambda c, _: LrocNacDistortion(*c)),
    "cahvor": _Model(
        CahvorDistortion, 5, (0, -2, -4, 1, 1), lambda c, _: CahvorDistortion(RadialDistortion(*c[:3]), *c[3:])
    ),
    "radtan": _Model(RadtanDistortion, 7, (0,) * 5, lambda c, f: RadtanDistortion(c[0], c[1], c[2], c[3], c[4], f)),
    "kplo_shadowcam": _Model(ShadowCamDistortion, 8, (-2,), lambda c, _: ShadowCamDistortion(*c)),
}
NUMBERS = {name: model.number for name, model in _MODELS.items()}
"""DistortionType of usgscsm by the name in support data."""
KNOWN = ", ".join(_MODELS)
"""Names, for messages."""


def _ten(c: list[float]) -> Any:
    return tuple(c)


def _kaguya(c: list[float]) -> KaguyaDistortion:
    """The boresight, which comes first of each axis, belongs to the constant term."""
    x, y = ((axis[0] + axis[1], axis[2], axis[3], axis[4]) for axis in (c[:5], c[5:]))
    return KaguyaDistortion(x, y)


# --- reading


def distortion_of_support(models: Mapping[str, Mapping[str, Any]], focal_length: float, where: str) -> Distortion:
    """Of ``optical_distortion`` of support data; the focal length in m.

    Raises
    ------
    InputError
        For several models, an unknown one or one of a framing camera, and for coefficients that are not as many
        finite numbers as the model has.
    """
    if not models:
        return NoDistortion()
    if len(models) > 1:
        raise InputError(where, f"{len(models)} models: {', '.join(models)}", "one")
    ((said, values),) = models.items()
    name = said.lower()
    model = _known(name, f"the model {said!r}", where)
    if not model.axes:
        coefficients = _numbers(values.get("coefficients", []), f"{where}.{said}.coefficients", len(model.powers))
        return _made(model, coefficients, focal_length)
    size = len(model.powers) // 2
    both = []
    for axis in ("x", "y"):
        ahead = [f"boresight_{axis}"] if name == "kaguyalism" else []
        own = _listed(values.get(axis, []))
        filled = [*own, *[0.0] * (size - len(ahead) - len(own))] if own else own  # ALE fills up with zeros, too
        both += [_numbers(values.get(key, 0.0), f"{where}.{said}.{key}", 1)[0] for key in ahead]
        both += _numbers(filled, f"{where}.{said}.{axis}", size - len(ahead))
    return _made(model, both, focal_length)


def distortion_of_state(number: int, coefficients: list[float], focal_length: float, where: str) -> Distortion:
    """Of ``m_distortionType`` and ``m_opticalDistCoeffs`` of a model state; the focal length in m."""
    names = {value: name for name, value in [*NUMBERS.items(), *_FRAMING.items()]}
    model = _known(names.get(number, ""), f"the type {number}", f"{where}, m_distortionType")
    return _made(model, _numbers(coefficients, f"{where}, m_opticalDistCoeffs", len(model.powers)), focal_length)


def _known(name: str, found: str, where: str) -> _Model:
    if name in _FRAMING:
        raise InputError(where, f"{found}, of a framing camera", f"a line scanner's: {KNOWN}")
    if name not in _MODELS:
        raise InputError(where, found, f"{KNOWN}, or none at all")
    return _MODELS[name]


def _listed(values: Any) -> list[Any]:
    return values if isinstance(values, list) else [values]


def _numbers(values: Any, where: str, size: int) -> list[float]:
    listed = _listed(values)
    good = all(isinstance(one, int | float) and not isinstance(one, bool) and abs(one) < 1e300 for one in listed)
    if not good or len(listed) != size:
        raise InputError(where, f"{listed}"[:60], f"{size} finite numbers")
    return [float(one) for one in listed]


def _made(model: _Model, coefficients: list[float], focal_length: float) -> Distortion:
    metres = np.array(coefficients) * _scales(model)
    return NoDistortion() if not metres.any() and model.number == 0 else model.made(metres.tolist(), focal_length)


def _scales(model: _Model) -> Array:
    return np.array([MM**power for power in model.powers])


# --- writing


def state_optics(distortion: Distortion, where: str) -> tuple[str, list[float]]:
    """Name of a model, and its coefficients for mm in the order of model states; InputError for one that usgscsm does
    not have. THEMIS's is a transverse one.

    Without distortion it is a radial one of zeros: ALE refuses support data that name none (src/Isd.cpp,
    getDistortionModel).
    """
    if isinstance(distortion, NoDistortion):
        return "radial", [0.0, 0.0, 0.0]
    if isinstance(distortion, ThemisIrDistortion):
        distortion = _transverse(distortion)
    for name, model in _MODELS.items():
        if isinstance(distortion, model.kind):
            return name, (_flat(distortion) / _scales(model)).tolist()
    found = f"the model {type(distortion).__name__}"
    raise InputError(f"{where}, optical_distortion", found, f"one that usgscsm knows: {KNOWN}, or none")


def support_optics(distortion: Distortion, where: str) -> dict[str, dict[str, Any]]:
    """``optical_distortion`` of support data; InputError for a model that usgscsm does not have."""
    name, coefficients = state_optics(distortion, where)
    if not _MODELS[name].axes:
        return {name: {"coefficients": coefficients}}
    size = len(coefficients) // 2
    both = {"x": coefficients[:size], "y": coefficients[size:]}
    if name == "kaguyalism":
        return {name: {axis: own[1:] for axis, own in both.items()} | {"boresight_x": 0.0, "boresight_y": 0.0}}
    return {name: dict(both)}


def _transverse(themis: ThemisIrDistortion) -> TransverseDistortion:
    """x_d = k x, y_d = (1 + a1) y + a2 y^2."""
    x, y = np.zeros(10), np.zeros(10)
    x[1], y[2], y[5] = themis.k, 1.0 + themis.a1, themis.a2
    return TransverseDistortion(_ten(x.tolist()), _ten(y.tolist()))


def _flat(distortion: Any) -> Array:
    if isinstance(distortion, KaguyaDistortion):
        return np.array([0.0, *distortion.x, 0.0, *distortion.y])
    values = np.hstack([np.ravel(one) for one in astuple(distortion)])
    return np.asarray(values[:-1] if isinstance(distortion, RadtanDistortion) else values)

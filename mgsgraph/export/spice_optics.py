"""Distortion as the instrument kernel of an export states it: model, coefficients in powers of mm, and the formula."""

from dataclasses import astuple, dataclass
from typing import Any, cast

import numpy as np

from mgsgraph.errors import InputError
from mgsgraph.geometry.distortion import (
    CorrectedDistortion,
    Distortion,
    KaguyaDistortion,
    KaguyaMiDistortion,
    LrocNacDistortion,
    MocWideAngleDistortion,
    NoDistortion,
    RadialDistortion,
    ThemisIrDistortion,
)
from mgsgraph.units import MM


@dataclass(frozen=True, slots=True)
class _Stated:
    """One model, as the kernel has it."""

    kind: type[Distortion]
    powers: tuple[int, ...]
    """Of metres, the units of the record's numbers."""
    said: str
    """The formula, in lines of the kernel's comment."""


_CUBIC = (1, 0, -1, -2)
_MODELS = {
    "NONE": _Stated(NoDistortion, (), "the measured place (xm, ym) is the ideal one"),
    "LROC_NAC": _Stated(LrocNacDistortion, (-2,), "x = xm, y = ym / (1 + k ym^2), OD_K = k"),
    "RADIAL": _Stated(
        RadialDistortion, (0, -2, -4),
        "(x, y) = (xm, ym) (1 - k0 - k1 r^2 - k2 r^4), r^2 = xm^2 + ym^2, OD_K = k0 k1 k2",
    ),
    "KAGUYA_TC": _Stated(
        KaguyaDistortion, _CUBIC * 2, "x = xm + a0 + a1 r + a2 r^2 + a3 r^3, y = ym + b0 + ... + b3 r^3,\n"
        "r^2 = xm^2 + ym^2, OD_K = a0 a1 a2 a3 b0 b1 b2 b3",
    ),
    "KAGUYA_MI": _Stated(KaguyaMiDistortion, _CUBIC * 2, "as KAGUYA_TC with ym in place of r"),
    "MOC_WIDE": _Stated(
        MocWideAngleDistortion, (0,) * 7 + (1,), "(x, y) = (xm, ym / s) tan t / tan a, tan a = |(xm, ym / s)| / f,\n"
        "t = c1 a + c3 a^3 + ... + c11 a^11, OD_K = c1 c3 ... c11 s f",
    ),
    "THEMIS_IR": _Stated(ThemisIrDistortion, (0, 0, -1), "x = xm / k, y (1 + a1) + a2 y^2 = ym, OD_K = k a1 a2"),
}  # fmt: skip


def optics_comment() -> str:
    """What the kernel's comment says of its models."""
    lines = []
    for name, model in _MODELS.items():
        first, *rest = model.said.split("\n")
        lines += [f"            {name:<11}{first}", *(f"            {'':<11}{line}" for line in rest)]
    lines += [
        "            OD_RADIAL, OD_POINT (where an adjustment found them) go on from there, with (x, y) of the model:",
        "                       (x, y) (1 + c1 r^2 + c2 r^4 + c3 r^6) - OD_POINT, r^2 = x^2 + y^2,",
        "                       OD_RADIAL = c1 c2 c3",
    ]
    return "\n".join(lines).replace("            NONE", "DISTORTION  NONE", 1)


def adjusted_optics(distortion: Distortion) -> dict[str, list[float]]:
    """What an adjustment added to a model: radial coefficients in powers of mm, and the principal point in mm."""
    if not isinstance(distortion, CorrectedDistortion):
        return {}
    radial = [value * MM ** (2 * n + 2) for n, value in enumerate(distortion.radial)]
    return {"OD_RADIAL": radial, "OD_POINT": [value / MM for value in distortion.point]}


def stated_optics(distortion: Distortion, name: str) -> tuple[str, list[float]]:
    """Model and coefficients, in powers of mm; InputError for a model that the kernel has no formula of.

    `name` is the image's. What an adjustment added is in `adjusted_optics`.
    """
    if isinstance(distortion, CorrectedDistortion):
        distortion = distortion.nominal
    for word, model in _MODELS.items():
        if isinstance(distortion, model.kind):
            fields = astuple(cast(Any, distortion))
            values = np.hstack([np.ravel(one) for one in fields]) if model.powers else np.zeros(1)
            scales = [MM**power for power in model.powers or (0,)]
            return word, (values / scales).tolist()
    found, known = f"the model {type(distortion).__name__}", ", ".join(_MODELS)
    raise InputError(f"image {name}, distortion", found, f"one of {known}", "export csm instead")

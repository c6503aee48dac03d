"""Text kernels of an exported solution: clock, frames, camera constants with their distortion, radii, and the
meta-kernel that loads all.

Times are s TDB past J2000, lengths in these files km and mm, as SPICE has them. Pixels are counted as everywhere in
this program: the first one's centre at (0.5, 0.5).
"""

from collections.abc import Sequence
from dataclasses import astuple, dataclass
from typing import Any, cast

import numpy as np

from mgsgraph.errors import InputError
from mgsgraph.files.output.folders import PROGRAM
from mgsgraph.geometry.camera import (
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
from mgsgraph.geometry.image import PushbroomImage
from mgsgraph.geometry.records import Array
from mgsgraph.units import KM, MM


@dataclass(frozen=True, slots=True)
class _Stated:
    """One distortion model, as in the kernel."""

    kind: type[Distortion]
    powers: tuple[int, ...]
    """Of metres, the units of the record's numbers."""
    formula: str
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
    """Comment of the kernel about its distortion models."""
    lines = []
    for name, model in _MODELS.items():
        first, *rest = model.formula.split("\n")
        lines += [f"            {name:<11}{first}", *(f"            {'':<11}{line}" for line in rest)]
    lines += [
        "            OD_RADIAL, OD_POINT (where an adjustment found them) go on from there, with (x, y) of the model:",
        "                       (x, y) (1 + c1 r^2 + c2 r^4 + c3 r^6) - OD_POINT, r^2 = x^2 + y^2,",
        "                       OD_RADIAL = c1 c2 c3",
    ]
    return "\n".join(lines).replace("            NONE", "DISTORTION  NONE", 1)


def adjusted_optics(distortion: Distortion) -> dict[str, list[float]]:
    """Adjusted terms of a model: radial coefficients in powers of mm, and the principal point in mm."""
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
            values = np.hstack([np.ravel(field) for field in fields]) if model.powers else np.zeros(1)
            scales = [MM**power for power in model.powers or (0,)]
            return word, (values / scales).tolist()
    found, models = f"the model {type(distortion).__name__}", ", ".join(_MODELS)
    raise InputError(f"image {name}, distortion", found, f"one of {models}", "export csm instead")


CLOCK = -900_000
"""Id of the clock that is made where the mission's isn't given: seconds TDB from `clock_zero` on."""
TICKS = 1_000_000
"""Of that clock, per second."""
NAMES = ("adjusted.tsc", "adjusted.tf", "adjusted.ti", "adjusted.tpc", "body.bc", "adjusted.bsp", "adjusted.bc")
"""Kernels in the order of loading; body.bc only where the solution knows how the body turned."""
META_KERNEL = "adjusted.tm"

_LONGEST_TEXT = 80
"""Characters of a string in a text kernel."""
_SECONDS = 1_000_000_000
"""Of the clock's only partition: 31 years; ticks stay whole numbers in float64."""
_NUMBERS_PER_LINE = 3
_ISIS_KEYWORDS = (
    ("CK_TIME_BIAS", "0.0"), ("SPK_TIME_BIAS", "0.0"), ("LIGHTTIME_CORRECTION", "'NONE'"),
    ("SWAP_OBSERVER_TARGET", "'FALSE'"),
)  # fmt: skip


@dataclass(frozen=True, slots=True)
class Body:
    """The body and its body-fixed frame in these files."""

    name: str
    """As SPICE calls it."""
    code: int
    """Its NAIF id."""
    radii: tuple[float, float, float]
    """m."""
    relative: str | None
    """Frame that the body-fixed frame is the same as; None where body.bc says how it turns."""

    @property
    def frame(self) -> str:
        """Name of the body-fixed frame of the solution."""
        return f"{PROGRAM.upper()}_{self.name.upper()}_FIXED"

    @property
    def frame_id(self) -> int:
        """Id of that frame, in the range that NAIF leaves to users."""
        return 1_900_000 + self.code

    @property
    def rotation_id(self) -> int:
        """Id of the body's rotation in body.bc."""
        return -900_000_000 - self.code


@dataclass(frozen=True, slots=True)
class Carrier:
    """Ids under which an image's orientation is kept, and its camera constants."""

    spacecraft: int
    """NAIF id of what flies."""
    camera: int
    """NAIF id of the camera's frame and of its CK."""
    instrument: int
    """Number of the camera constants in the instrument kernel, of this image alone."""
    image: PushbroomImage
    """With adjusted camera constants."""
    covered: tuple[float, float]
    """First and last line that SPK and CK cover."""

    @property
    def frame(self) -> str:
        """Name of the camera's frame."""
        return f"{PROGRAM.upper()}_CAMERA_{-self.camera}"


def clock_text(zero: float) -> str:
    """SCLK that counts seconds TDB from `zero` (s past J2000) on; it needs no leap seconds."""
    n = -CLOCK
    return f"""KPL/SCLK

A clock for attitudes that know no other: seconds TDB past {zero:.1f} s TDB past J2000, and {TICKS} ticks in each.

\\begindata
SCLK_DATA_TYPE_{n}       = ( 1 )
SCLK01_TIME_SYSTEM_{n}   = ( 1 )
SCLK01_N_FIELDS_{n}      = ( 2 )
SCLK01_MODULI_{n}        = ( {_SECONDS} {TICKS} )
SCLK01_OFFSETS_{n}       = ( 0 0 )
SCLK01_OUTPUT_DELIM_{n}  = ( 2 )
SCLK_PARTITION_START_{n} = ( 0.0 )
SCLK_PARTITION_END_{n}   = ( {float(_SECONDS * TICKS)!r} )
SCLK01_COEFFICIENTS_{n}  = ( 0.0 {zero!r} 1.0 )
\\begintext
"""


def frames_text(body: Body, carriers: Sequence[Carrier], clock: int) -> str:
    """FK of the body-fixed frame and of all cameras."""
    cameras = {carrier.camera: carrier for carrier in carriers}.values()
    return f"""KPL/FK

{body.frame} is the body-fixed frame of the adjusted coordinates. SPK and CK refer to it, so that places on the
ground and in the images are those of the solution whatever PCK is loaded.
{_turning_words(body)}

Camera frames: +Z out of the lens, x and y as in the instrument kernel.

\\begindata
{_body_frame(body, clock)}
\\begintext

\\begindata
{chr(10).join(_camera_frame(carrier, clock) for carrier in cameras)}
\\begintext
"""


def _turning_words(body: Body) -> str:
    if body.relative is None:
        return (
            "Its rotation against J2000 is that of the support data which were adjusted (body.bc), at the times of\n"
            "the images alone. To let a PCK of your own turn it, make it class 4 with a unit matrix to your frame."
        )
    return (
        f"It is {body.relative}. The solution doesn't hold its rotation against J2000: for inertial states load the\n"
        "PCK with which the images were read."
    )


def _body_frame(body: Body, clock: int) -> str:
    n, head = body.frame_id, f"FRAME_{body.frame} = {body.frame_id}\nFRAME_{body.frame_id}_NAME = '{body.frame}'"
    if body.relative is None:
        k = body.rotation_id
        return (
            f"{head}\nFRAME_{n}_CLASS = 3\nFRAME_{n}_CLASS_ID = {k}\nFRAME_{n}_CENTER = {body.code}\n"
            f"CK_{k}_SCLK = {clock}\nCK_{k}_SPK = {body.code}"
        )
    return (
        f"{head}\nFRAME_{n}_CLASS = 4\nFRAME_{n}_CLASS_ID = {n}\nFRAME_{n}_CENTER = {body.code}\n"
        f"TKFRAME_{n}_SPEC = 'MATRIX'\nTKFRAME_{n}_RELATIVE = '{body.relative}'\n"
        f"TKFRAME_{n}_MATRIX = ( 1 0 0 0 1 0 0 0 1 )"
    )


def _camera_frame(owner: Carrier, clock: int) -> str:
    n = owner.camera
    return (
        f"FRAME_{owner.frame} = {n}\nFRAME_{n}_NAME = '{owner.frame}'\nFRAME_{n}_CLASS = 3\nFRAME_{n}_CLASS_ID = {n}\n"
        f"FRAME_{n}_CENTER = {owner.spacecraft}\nCK_{n}_SCLK = {clock}\nCK_{n}_SPK = {owner.spacecraft}"
    )


def constants_text(body: Body) -> str:
    """PCK with the radii of the reference ellipsoid alone."""
    radii = " ".join(repr(radius / KM) for radius in body.radii)
    return f"""KPL/PCK

Reference ellipsoid of the adjustment, km. (How the body turns: see the frame kernel.)

\\begindata
BODY{body.code}_RADII = ( {radii} )
\\begintext
"""


def instruments_text(body: Body, carriers: Sequence[Carrier], named: bool) -> str:
    """IK with the camera constants and line times of every image.

    Raises
    ------
    InputError
        When an image's name or distortion can't be held by it.
    """
    listed = "\n    ".join(str(carrier.instrument) for carrier in carriers)  # lines end at 132 characters
    blocks = "\n\n".join(_instrument(body, carrier) for carrier in carriers)
    cameras = sorted({carrier.camera for carrier in carriers}) if named else []
    isis = "\n".join(
        f"{variable} = {value}"
        for camera in cameras for key, value in _ISIS_KEYWORDS
        if len(variable := f"INS{camera}_{key}") <= 32  # pool variables are no longer
    )  # fmt: skip
    return f"""KPL/IK

Camera constants, one set for each image. Millimetres, pixels; the first pixel of image and detector has its centre at
(0.5, 0.5). A ray in camera axes (X, Y, Z) meets the focal plane at x = f X / Z, y = f Y / Z (ideal).

{optics_comment()}

detector line   = DETECTOR_CENTRE(1) + ITRANSL(1) + ITRANSL(2) xm + ITRANSL(3) ym, which is DETECTOR_FIRST(1)
detector sample = DETECTOR_CENTRE(2) + ITRANSS(1) + ITRANSS(2) xm + ITRANSS(3) ym
                = DETECTOR_FIRST(2) + image sample * SAMPLE_SUMMING

FOV_...: what getfov reads, one line of the detector, its distortion taken off.

LINE_TIMES: triples of a line from which on a line period holds, its time (s TDB past J2000), and that period (s).
Positions are geometric and attitude belongs to the line's own time: time biases of the mission's kernels (MOC: the
attitude of 1.15 s before) are in them already and must not be applied again.

\\begindata
{PROGRAM.upper()}_INSTRUMENTS = ( {listed} )
\\begintext

\\begindata
{blocks}
{isis}
\\begintext
"""


def _instrument(body: Body, carrier: Carrier) -> str:
    image, interior = carrier.image, carrier.image.interior
    model, coefficients = stated_optics(interior.distortion, image.name)
    to_pixel = interior.to_pixel.copy()
    to_pixel[:, 1:] *= MM
    timing, epoch = image.timing, image.trajectory.epoch
    times = [
        value
        for line, start, period in zip(timing.first_lines, timing.start_times + epoch, timing.periods, strict=True)
        for value in (line, start, period)
    ]
    fields = {
        "IMAGE": _text(image.name, f"image {image.name}"),
        "IMAGE_LINES": str(image.lines),
        "IMAGE_SAMPLES": str(image.samples),
        "SPACECRAFT": str(carrier.spacecraft),
        "FRAME_ID": str(carrier.camera),
        "FRAME": f"'{carrier.frame}'",
        "BODY": str(body.code),
        "BODY_FRAME": f"'{body.frame}'",
        "FOCAL_LENGTH": _numbers([interior.focal_length / MM]),
        "ITRANSL": _numbers(to_pixel[0]),
        "ITRANSS": _numbers(to_pixel[1]),
        "DETECTOR_CENTRE": _numbers(interior.centre),
        "DETECTOR_FIRST": _numbers(interior.first),
        "SAMPLE_SUMMING": _numbers([interior.sample_summing]),
        "DISTORTION": f"'{model}'",
        "OD_K": _numbers(coefficients),
        **{key: _numbers(values) for key, values in adjusted_optics(interior.distortion).items()},
        "LINES_COVERED": _numbers(carrier.covered),
        "LINE_TIMES": _numbers(times),
        **_field_of_view(carrier),
    }
    return "\n".join(f"INS{carrier.instrument}_{key} = {value}" for key, value in fields.items())


def _field_of_view(carrier: Carrier) -> dict[str, str]:
    """What SPICE's getfov wants, in the camera's frame: a line of the detector, a pixel high."""
    interior = carrier.image.interior
    ends, by_sample = interior.focal_plane(np.array([0.0, 0.5, 1.0]) * carrier.image.samples)
    # across the line of the detector: half a square pixel
    across = 0.5 * by_sample[1, ::-1] * [-1.0, 1.0] / interior.sample_summing
    corners = [ends[0] - across, ends[0] + across, ends[2] + across, ends[2] - across]
    return {
        "FOV_FRAME": f"'{carrier.frame}'",
        "FOV_SHAPE": "'POLYGON'",
        "FOV_CLASS_SPEC": "'CORNERS'",
        "BORESIGHT": _numbers([*ends[1] / MM, interior.focal_length / MM]),
        "FOV_BOUNDARY": _numbers([v for x, y in corners for v in (x / MM, y / MM, interior.focal_length / MM)]),
    }


def _text(text: str, where: str) -> str:
    if not (text.isascii() and text.isprintable()) or len(text) > _LONGEST_TEXT - text.count("'"):
        found = f"a name of {len(text)} characters" if text.isascii() else "a name with letters beyond ASCII"
        expected = f"at most {_LONGEST_TEXT} printable ASCII characters, which text kernels hold"
        raise InputError(f"{where}, name", found, expected, "rename the image")
    return "'" + text.replace("'", "''") + "'"


def _numbers(values: Sequence[float] | Array) -> str:
    texts = [repr(float(value)) for value in values]
    rows = [" ".join(texts[k : k + _NUMBERS_PER_LINE]) for k in range(0, len(texts), _NUMBERS_PER_LINE)]
    return "( " + "\n    ".join(rows) + " )"


def list_text(names: Sequence[str], comments: Sequence[str]) -> str:
    """Meta-kernel of files beside it."""
    listed = "\n".join(f"  '$KERNELS/{name}'" for name in names)
    text = "\n".join(comments)
    return f"""KPL/MK

{text}

Load it from its own folder, or put that folder's path in place of the dot.

\\begindata
PATH_VALUES     = ( '.' )
PATH_SYMBOLS    = ( 'KERNELS' )
KERNELS_TO_LOAD = (
{listed}
)
\\begintext
"""

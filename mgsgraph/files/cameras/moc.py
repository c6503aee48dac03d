"""Mars Orbiter Camera of Mars Global Surveyor: narrow angle, and the wide angles behind their red and blue filters.

Formulas: ISIS MocNarrowAngleCamera, MocWideAngleCamera, MocWideAngleDistortionMap, MocLabels. Constants: the addendum
mocAddendum004.ti, which keeps the nominal focal length of the narrow angle and widens the pitch instead (one pixel is
then 3.750 microradians), or, for the narrow angle, NAIF's instrument kernel moc20.ti (3.714). Those of the wide angles'
place behind the lens stand in ISIS's camera models (and in the addendum under BORESIGHT_SAMPLE and ALONGTRACK_OFFSET,
which cubes don't hold).
"""

from collections.abc import Callable

import numpy as np

from mgsgraph.errors import InputError
from mgsgraph.files.cameras.camera import (
    Camera,
    Interior,
    LabelBlock,
    LabelKeys,
    LineScanLabel,
    interior_by_addendum,
    require_summing,
)
from mgsgraph.files.cameras.keywords import Keywords, number
from mgsgraph.geometry.camera import InteriorOrientation
from mgsgraph.geometry.distortion import MocWideAngleDistortion, NoDistortion
from mgsgraph.units import ISIS_OFFSET, MM

Six = tuple[float, float, float, float, float, float]
ATTITUDE_BIAS = -1.15
"""s, by which ISIS looks attitude up earlier for MOC (addendum keyword INS-94031_CK_TIME_BIAS)."""
_NARROW, _RED, _BLUE = -94031, -94032, -94033
_NARROW_PIXELS, _WIDE_PIXELS = 2048, 3456
_NARROW_SUMMING, _WIDE_SUMMING = 8, 127
_VARIABLE_SUMMING = (13, 27)
"""Summings of the wide angles that change along the detector (ISIS mocxtrack.h)."""
_MARS = (3396.19, 3396.19, 3376.2)
"""km, IAU 2000, as in the PCK that spiceinit takes."""
_METRES_BELOW, _METRES_BELOW_WIDE = 100.0, 1.0
"""INS-94031_FOCAL_LENGTH is 3.5 (m) in the instrument kernel and 3500 (mm) in the addendum, and the later one wins; of
the wide angles not the unit alone is another."""
PITCH = 0.0131240578522949
"""mm, the narrow angle's."""


def _checked(highest: int) -> Callable[[LabelBlock, LineScanLabel], LineScanLabel]:
    """A look at what only some of the label's numbers can be."""

    def facts(block: LabelBlock, label: LineScanLabel) -> LineScanLabel:
        down = "DowntrackSumming" if block.kind == "isis" else "DOWNTRACK_SUMMING"
        first = "FirstLineSample" if block.kind == "isis" else "EDIT_MODE_ID"
        if not (1.0 <= block.number(down) <= highest and block.number(down) % 1.0 == 0.0):
            raise InputError(block.where(down), f"{block.number(down):g}", f"1 .. {highest} for {label.camera.name}")
        if label.first_sample < 0.0 or label.first_sample % 1.0:
            raise InputError(block.where(first), block.text(first), "a whole number of detector pixels")
        return label

    return facts


def _narrow(keywords: Keywords, label: LineScanLabel) -> InteriorOrientation:
    require_summing(label, _NARROW_SUMMING, _NARROW_PIXELS)
    return interior_by_addendum(keywords, label, NoDistortion(), (0.0, 1024.5), _focal_length(keywords))


def _narrow_by_instrument_kernel(keywords: Keywords, label: LineScanLabel) -> InteriorOrientation:
    """m, first pixel 0."""
    require_summing(label, _NARROW_SUMMING, _NARROW_PIXELS)
    per_metre = 1.0 / number(keywords, f"INS{_NARROW}_PIXEL_SIZE")
    return InteriorOrientation(
        focal_length=_focal_length(keywords),
        to_pixel=np.array([[0.0, per_metre, 0.0], [0.0, 0.0, per_metre]]),
        centre=np.array([0.0, float(keywords.numbers(f"INS{_NARROW}_CENTER", 2)[0]) + ISIS_OFFSET]),
        first=np.array([0.0, label.first_sample]),
        sample_summing=label.sample_summing,
        distortion=NoDistortion(),
    )


def _focal_length(keywords: Keywords) -> float:
    stated = number(keywords, f"INS{_NARROW}_FOCAL_LENGTH")
    return stated if stated < _METRES_BELOW else stated * MM


def _wide(centre: float, offset: float, coefficients: Six, scale: float) -> Interior:
    """Of a wide angle whose principal point is at a detector sample, `offset` lines ahead of the detector."""

    def interior(keywords: Keywords, label: LineScanLabel) -> InteriorOrientation:
        if label.sample_summing in _VARIABLE_SUMMING:
            found = f"summing {label.sample_summing:g}, which changes along the detector"
            raise InputError(str(label.path), found, "one that is the same for all samples: 1 to 127 but 13 and 27")
        require_summing(label, _WIDE_SUMMING, _WIDE_PIXELS)
        name = f"INS{label.camera.instrument}_FOCAL_LENGTH"
        if (stated := number(keywords, name)) < _METRES_BELOW_WIDE:
            found, remedy = f"{stated:g} m, the instrument kernel's", "name the addendum after the instrument kernel"
            raise InputError(f"kernels, {name}", found, "the addendum's, such as 11.2 mm", remedy)
        focal_length = stated * MM
        distortion = MocWideAngleDistortion(coefficients, scale, focal_length)
        return interior_by_addendum(keywords, label, distortion, (-offset, centre))

    return interior


def _camera(
    name: str, instrument: int, identity: dict[str, str], interior: Interior, constants: dict[str, tuple[float, ...]]
) -> Camera:
    pds = {"InstrumentId": "INSTRUMENT_ID", "FilterName": "FILTER_NAME"}
    return Camera(
        name=f"MGS {name}",
        mission="MGS",
        spacecraft=-94,
        instrument=instrument,
        isis=LabelKeys(
            identity=identity, start="SpacecraftClockCount", utc="StartTime", stop="StopTime",
            period="LineExposureDuration", product="ProductId",
            target="TargetName", serial=("SpacecraftClockCount", "InstrumentId", "FilterName"),
            line_summing="DowntrackSumming", sample_summing="CrosstrackSumming", first_sample="FirstLineSample",
            first_pixel=1,
        ),
        pds3=LabelKeys(
            identity={pds[key]: value for key, value in identity.items()}, start="SPACECRAFT_CLOCK_START_COUNT",
            utc="START_TIME", stop="STOP_TIME", period="LINE_EXPOSURE_DURATION", product="PRODUCT_ID",
            target="TARGET_NAME",
            serial=("SPACECRAFT_CLOCK_START_COUNT", "INSTRUMENT_ID", "FILTER_NAME"),
            line_summing="DOWNTRACK_SUMMING", sample_summing="CROSSTRACK_SUMMING", first_sample="EDIT_MODE_ID",
        ),
        interior=interior,
        instrument_kernel=_narrow_by_instrument_kernel if instrument == _NARROW else None,
        addendum="mocAddendum004.ti",
        source="ISIS MocNarrowAngleCamera, MocWideAngleCamera",
        label_facts=_checked(_NARROW_SUMMING if instrument == _NARROW else _WIDE_SUMMING),
        attitude_bias=ATTITUDE_BIAS,
        constants_target="MARS",
        constants={"BODY499_RADII": _MARS} | {f"INS{instrument}_{key}": value for key, value in constants.items()},
    )  # fmt: skip


MOC_NARROW = _camera(
    "MOC-NA", _NARROW, {"InstrumentId": "MOC-NA"}, _narrow,
    {"FOCAL_LENGTH": (3500.0,), "ITRANSS": (0.0, 0.0, 1.0 / PITCH), "ITRANSL": (0.0, 1.0 / PITCH, 0.0)},
)  # fmt: skip
MOC_RED = _camera(
    "MOC-WA red", _RED, {"InstrumentId": "MOC-WA", "FilterName": "RED"},
    _wide(1674.65, 6.7785, (0.9993258, 0.4655529, -0.1548756, 1.827967, -3.057435, 2.226331), 1.0),
    {"FOCAL_LENGTH": (11.20537656,), "ITRANSS": (0.0, 0.0, -142.8571429), "ITRANSL": (0.0, 142.8571429, 0.0)},
)  # fmt: skip
MOC_BLUE = _camera(
    "MOC-WA blue", _BLUE, {"InstrumentId": "MOC-WA", "FilterName": "BLUE"},
    _wide(1688.58, -0.8486, (1.000246, 0.4612695, 0.2352545, 0.3535922, -0.2853861, 0.5574971), 1.000452),
    {"FOCAL_LENGTH": (11.22998086,), "ITRANSS": (0.0, 0.0, 142.857), "ITRANSL": (0.0, 142.857, 0.0)},
)  # fmt: skip

"""What programs are known to write wrongly into support data: put right where the file itself betrays it, and said."""

import re

import numpy as np
from msgspec import structs

from mgsgraph.errors import InputError
from mgsgraph.files.cameras.camera import NaifKeywords
from mgsgraph.files.cameras.mars import ATTITUDE_BIAS, PITCH
from mgsgraph.files.cameras.moon import CORRECTIONS, corrected
from mgsgraph.files.support_data.isd_layout import UNITS, SupportData
from mgsgraph.geometry.records import Array
from mgsgraph.units import ISIS_OFFSET, KM

_LONGEST = 1e5
"""s, longer than any image takes."""
_FASTEST = 1e5
"""m/s, faster than anything that takes images."""
_SAME = 1e-3
_MOC = "MGS_MOC_"
_HRSC = ("MEX_HRSC", "HIGH RESOLUTION STEREO CAMERA")
_CTX, _CTX_LONGEST = "CONTEXT CAMERA", 2.8e-3
"""s, longer than one line time of CTX (1.877 ms) and shorter than two."""
_HRSC_PITCH = 142.857
"""Pixels of 7 micrometres per mm."""
_HRSC_SIZES = {2584: 2, 1288: 4, 640: 8}
"""Macropixels of archived images by their number of samples."""
_ANOTHER_ROAD = "read its cube after spiceinit, or its label and kernels"


def repaired(isd: SupportData, source: str) -> tuple[SupportData, list[str]]:
    """Support data as they were meant, and what was put right, in sentences.

    Raises
    ------
    InputError
        Where something is known to be wrong, but not what would be right.
    """
    _require_units(isd, source)
    said = list[str]()
    for repair in (_line_times_past_epoch, _line_times_of_lroc, _boresight_by_isis, _moc, _hrsc, _ctx):
        isd, words = repair(isd, source)
        said += words
    return isd, said


def _require_units(isd: SupportData, source: str) -> None:
    """Refuse metres that are called kilometres, and the other way round."""
    table, where = isd.instrument_position, f"{source}, instrument_position"
    if table.velocities:
        speed = np.abs(np.array(table.velocities)).max() * UNITS[table.unit]
        if speed > _FASTEST:
            found = f"a camera that moves at {speed / KM:g} km/s"
            raise InputError(where, found, "kilometres", "divide positions and velocities by 1000, or write unit 'm'")


def _line_times_past_epoch(isd: SupportData, _: str) -> tuple[SupportData, list[str]]:
    """Older ALE wrote HRSC's line times as ephemeris times; those of all programs count from the centre time."""
    table = np.array(isd.line_scan_rate)
    late = np.abs(table[:, 1] - isd.center_ephemeris_time) < _LONGEST
    if not (np.any(np.abs(table[:, 1]) > _LONGEST) and np.all(late)):
        return isd, []
    table[:, 1] -= isd.center_ephemeris_time
    return _with_rates(isd, table), ["line times past J2000 counted from center_ephemeris_time"]


def _line_times_of_lroc(isd: SupportData, source: str) -> tuple[SupportData, list[str]]:
    """Line times with the corrections that ISIS's camera of LROC-NAC makes, where the file lacks them.

    ISIS's own support data have the times of the label, while its keywords state a preroll in lines and an error of
    the line period (ISIS LroNarrowAngleCamera). Its tables begin with the corrected first line, and so betray that the
    correction is still to be made; ALE's times hold it.
    """
    code_of = re.compile(rf"INS(-?\d{{1,9}})_{CORRECTIONS[1]}", re.ASCII)
    codes = {int(found[1]) for key in isd.naif_keywords if (found := code_of.fullmatch(key))}
    if len(isd.line_scan_rate) != 1 or len(codes) != 1:
        return isd, []
    keywords, code = NaifKeywords(source, isd.naif_keywords), codes.pop()
    line, label_start, label_period = isd.line_scan_rate[0]
    start, period = corrected(keywords, code, label_start, label_period)
    first = isd.instrument_pointing.ephemeris_times[0] - isd.center_ephemeris_time
    if abs(first - start) >= period:
        return isd, []
    words = f"line times of the label corrected as ISIS does: first line {start - label_start:+.6f} s, period x " \
        f"{period / label_period:g}"
    return _with_rates(isd, np.array([[line, start, period]])), [words]


def _boresight_by_isis(isd: SupportData, _: str) -> tuple[SupportData, list[str]]:
    """ISIS counts the centre of the detector's first pixel as 1. Older ALE gave its keyword for the centre as it
    stands, present drivers take the half pixel off. Only with it off do ISIS's own adjusted cameras of NAC-L and NAC-R
    see the points that they were fixed to (docs/real_networks.md).
    """
    stated = [value for key, value in isd.naif_keywords.items() if key.endswith("_BORESIGHT_SAMPLE")]
    if stated != [isd.detector_center.sample]:
        return isd, []
    centre = structs.replace(isd.detector_center, sample=isd.detector_center.sample - ISIS_OFFSET)
    words = f"detector_center {stated[0]:g} is ISIS's BORESIGHT_SAMPLE, half a pixel too much, which is taken off"
    return structs.replace(isd, detector_center=centre), [words]


def _moc(isd: SupportData, source: str) -> tuple[SupportData, list[str]]:
    """What ALE's mgs_drivers write of MOC: line periods without the summing, a pixel pitch as distortion, FORTRAN's
    counting of the first sample and the centre, and attitudes whose labels it moves by 1.15 s.
    """
    if not (isd.name_sensor or "").startswith(_MOC):
        return isd, []
    isd, of_lines = _moc_line_period(isd)
    isd, of_optics = _moc_optics(isd, source)
    _require_moc_attitude(isd, source)
    return isd, of_lines + of_optics


def _moc_line_period(isd: SupportData) -> tuple[SupportData, list[str]]:
    (line, start, period), *others = isd.line_scan_rate
    summing, lasts = isd.detector_line_summing, -2.0 * start  # center_ephemeris_time is the middle
    for times, unit in ((summing, ""), (summing / 1000.0, ", and milliseconds were called seconds")):
        if not others and abs(times - 1.0) > _SAME and abs(isd.image_lines * period * times / lasts - 1.0) < _SAME:
            words = f"line period multiplied by the summing of {summing:g} (ALE leaves it out{unit})"
            return _with_rates(isd, np.array([[line, start, period * times]])), [words]
    return isd, []


def _moc_optics(isd: SupportData, source: str) -> tuple[SupportData, list[str]]:
    coefficients = isd.optical_distortion.get("radial", {}).get("coefficients")
    if not isinstance(coefficients, list) or len(coefficients) != 3 or not any(coefficients):
        return isd, []
    pitches = all(isinstance(one, int | float) and abs(one - PITCH) <= 1e-9 for one in coefficients[1:])
    if isd.name_sensor != f"{_MOC}NA" or not pitches:
        raise InputError(
            f"{source}, optical_distortion", f"a radial one of {coefficients} for {isd.name_sensor}",
            "that of ISIS's camera: these are pixel sizes, given for coefficients by ALE's mgs_drivers", _ANOTHER_ROAD,
        )  # fmt: skip
    centre = structs.replace(isd.detector_center, sample=isd.detector_center.sample - 0.5)
    isd = structs.replace(
        isd, optical_distortion={}, detector_center=centre, starting_detector_sample=isd.starting_detector_sample - 1.0
    )
    words = "no distortion (ALE gives the pixel pitch for coefficients); first sample and centre counted from 0, not 1"
    return isd, [words]


def _require_moc_attitude(isd: SupportData, source: str) -> None:
    """ISIS's attitude at time t is the C-kernel's of t - 1.15 s. Where ALE has sampled the C-kernel at the times of
    lines, it lacks either that (older versions) or the first 1.15 s (newer ones, which move the labels only).
    """
    table, where = np.array(isd.instrument_pointing.ephemeris_times), f"{source}, instrument_pointing"
    first = isd.center_ephemeris_time + isd.line_scan_rate[0][1]
    after, dense = table[0] - first, table.size > 2 and (table[-1] - table[0]) / (table.size - 1) < 0.1
    if dense and abs(after + ATTITUDE_BIAS) < _SAME:
        found = f"attitudes from {-ATTITUDE_BIAS} s after the first line on (labels moved by MOC's bias, not times)"
        raise InputError(where, found, "attitudes for every line", _ANOTHER_ROAD)
    if dense and abs(after) < _SAME:
        found = "attitudes of the C-kernel at the lines' own times"
        raise InputError(where, found, f"those of {-ATTITUDE_BIAS} s before, as ISIS takes them for MOC", _ANOTHER_ROAD)


def _hrsc(isd: SupportData, source: str) -> tuple[SupportData, list[str]]:
    """What ALE's mex_drivers write of HRSC: no summing where the image has macropixels, and the pixels of the SRC."""
    if not (isd.name_sensor or "").startswith(_HRSC):
        return isd, []
    per_mm = float(np.linalg.norm(isd.focal2pixel_samples[1:]))
    if abs(per_mm / _HRSC_PITCH - 1.0) > _SAME:
        found = f"{per_mm:.6g} pixels per mm"
        expected = f"HRSC's {_HRSC_PITCH}, of 7 micrometres"
        raise InputError(f"{source}, focal2pixel_samples", found, expected, _ANOTHER_ROAD)
    summing = _HRSC_SIZES.get(isd.image_samples, 1)
    if isd.detector_sample_summing != 1.0 or summing == 1:
        return isd, []
    words = f"macropixels of {summing}, as {isd.image_samples} samples of HRSC are (ALE says 1)"
    return structs.replace(isd, detector_sample_summing=float(summing)), [words]


def _ctx(isd: SupportData, source: str) -> tuple[SupportData, list[str]]:
    """Lines of CTX summed 2 x 2 take two line times (ISIS CTXCamera), of which ALE's mro_drivers write one; by labels,
    its tables end with these, in the image's middle.
    """
    line, start, period = isd.line_scan_rate[0]
    summing = isd.detector_sample_summing
    if isd.name_sensor != _CTX or summing == 1.0 or period > _CTX_LONGEST or len(isd.line_scan_rate) > 1:
        return isd, []
    end = isd.center_ephemeris_time + start + isd.image_lines * period * summing
    if isd.instrument_position.ephemeris_times[-1] < end - _SAME:
        found, expected = f"lines of {period:g} s, summed {summing:g}", f"{period * summing:g} s, and tables as long"
        raise InputError(f"{source}, line_scan_rate", found, f"{expected} (ALE leaves the summing out)", _ANOTHER_ROAD)
    words = f"line period multiplied by the summing of {summing:g} (ALE leaves it out)"
    return _with_rates(isd, np.array([[line, start, period * summing]])), [words]


def _with_rates(isd: SupportData, table: Array) -> SupportData:
    rows = [(float(line), float(start), float(period)) for line, start, period in table]
    return structs.replace(isd, line_scan_rate=rows)

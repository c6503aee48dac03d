"""Compares support data with their second statements in `naif_keywords` and in their own tables.

A contradiction is refused where one of both would move the ground by more than a twentieth of a pixel and nothing tells
which; smaller and known ones become remarks.
"""

import re
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from mgsgraph.errors import InputError
from mgsgraph.files.cameras.camera import NaifKeywords, number
from mgsgraph.files.cameras.label import CAMERAS
from mgsgraph.files.cameras.line_scanners import CORRECTIONS, corrected
from mgsgraph.files.support_data.isd_layout import UNITS, RotationTable, StateTable, SupportData
from mgsgraph.geometry import rotation
from mgsgraph.geometry.body import Ellipsoid, body_name, require_possible
from mgsgraph.geometry.image import PushbroomImage
from mgsgraph.geometry.plausibility import MEASURED, are_unit, turning, turning_otherwise
from mgsgraph.geometry.records import Array
from mgsgraph.units import DEG, KM

_SAME = 1e-6
"""Share by which numbers that are the same may differ: digits."""
_SAME_RADII = 1e-3
"""Share by which radii may differ from those of the keywords: a sphere does so from Mars by six times that."""
_SAME_FOCAL_LENGTH = 0.01
"""Share by which a focal length may: a calibration changes it by less."""
_SAME_TIME = 1e-4
"""s."""
_LATE = 0.05
"""Lines by which the first line's two times may differ."""
_HALF = 0.5
_MASKED = 1.02
"""Times the pixels that see the ground that files may have (CTX: 5,056 of 5,000)."""
_SQUARE = 4.0
"""Times by which a pixel on the ground may be longer along track than across, or shorter."""
_ODD_RATES = -131000
"""The frame of Kaguya's spacecraft, whose C-kernels (SEL_M_ALL_D) hold angular velocities that are not those of the
attitudes beside them; ALE copies both.
"""
_MOVED, _TURNED, _FEW = 5.0, 5.0, 5
"""m and pixels by which a row may be off what velocities and rates lead to, of tables with so many rows at least."""
_PLAIN_POLE, _POLE = 1e-4, 0.02
"""rad between the body's rotation and that of its pole and prime meridian without nutation, which is less on Mars."""
_DAY, _CENTURY = 86400.0, 36525.0 * 86400.0
_OPTICS = r"INS(-\d{5,6})_(FOCAL_LENGTH|ITRANS|BORESIGHT_|OD_K|DISTORTION|PIXEL|CCD)"
_IAU2000 = 317.68143
"""degrees, right ascension of Mars's pole in the elements that have no nutation."""
_MODELS = {-74021: "radial", -74699: "radial", -85600: "lrolrocnac", -85610: "lrolrocnac"} | dict.fromkeys(
    (-131351, -131371, *range(-131335, -131330), *range(-131344, -131340)), "kaguyalism"
)
"""Models of distortion by the camera's NAIF id."""
_MOC = (-94031, -94032, -94033)
"""ALE writes pixel sizes for coefficients of these, which repairs have taken out."""


class _Repeated(NamedTuple):
    """Numbers that are stated twice."""

    key: str
    found: Array
    keyword: str
    stated: Array
    allowed: float
    """Largest difference of the same numbers."""


def contradictions_of_times(isd: SupportData, keywords: NaifKeywords, source: str) -> list[str]:
    """Remarks on times and tables of support data as they are, before any repair.

    Raises
    ------
    InputError
        Where the first line has two times, a table isn't the one that the file describes, or rates are not those of the
        attitudes beside them.
    """
    if isd.starting_ephemeris_time is not None and max(abs(row[1]) for row in isd.line_scan_rate) < _DAY:
        _, start, period = isd.line_scan_rate[0]
        off = isd.center_ephemeris_time + start - isd.starting_ephemeris_time
        if abs(off) > max(_LATE * period, _SAME * 10.0):
            found = f"a first line {off:+.6f} s from starting_ephemeris_time"
            raise InputError(f"{source}, line_scan_rate", found, "one time of the first line", "fix the wrong one")
    for name in ("instrument_position", "instrument_pointing", "body_rotation"):
        _require_described(getattr(isd, name), f"{source}, {name}")
    remarks = list(_clock(isd, keywords))
    for name in ("instrument_pointing", "body_rotation"):
        remarks += _turning(getattr(isd, name), name, source)
    return remarks


def odd_rows(isd: SupportData) -> Iterator[str]:
    """Remarks on single rows of positions and attitudes that their velocities and rates don't lead to."""
    table = isd.instrument_position
    if table.velocities is not None and len(table.velocities) == len(table.ephemeris_times) == len(table.positions) > 1:
        unit, steps = UNITS[table.unit], np.diff(np.array(table.ephemeris_times))
        places, speeds = np.array(table.positions) * unit, np.array(table.velocities) * unit
        off = np.linalg.norm(np.diff(places, axis=0) - 0.5 * steps[:, None] * (speeds[1:] + speeds[:-1]), axis=1)
        jerk = np.linalg.norm(speeds[1:], axis=1) ** 3 / np.linalg.norm(places[1:], axis=1) ** 2  # of an orbit, m/s^3
        for k in np.flatnonzero(off > _MOVED + 0.25 * steps**3 * jerk)[:1].tolist():
            yield f"positions {k} and {k + 1} are {off[k]:.4g} m off what their velocities lead to"
    pointing = isd.instrument_pointing
    times, rates = np.array(pointing.ephemeris_times), np.array(pointing.angular_velocities or [])
    turned, mean = turning(times, np.array(pointing.quaternions), rates)
    if len(turned) < _FEW - 1:
        return
    off = np.linalg.norm(turned - mean, axis=1) * np.diff(times)
    pixel = 1.0 / (float(np.linalg.norm(isd.focal2pixel_samples[1:])) * isd.focal_length_model.focal_length)
    if np.median(off) < _TURNED * pixel:  # else all of them do so, which is said
        for k in np.flatnonzero(off > max(20.0 * float(np.median(off)), _TURNED * pixel))[:1].tolist():
            yield f"attitudes {k} and {k + 1} are {off[k] / pixel:.2g} pixels off what their rates lead to"


def _require_described(table: StateTable | RotationTable, where: str) -> None:
    """Raise InputError where a table is not as long as its file says."""
    times = np.array(table.ephemeris_times)
    for kind in ("ck", "spk"):
        for end, actual in (("start_time", times[0]), ("end_time", times[-1]), ("original_size", times.size)):
            stated = getattr(table, f"{kind}_table_{end}", None)
            if stated is None or abs(stated - actual) <= _SAME_TIME or (end == "original_size" and stated > actual):
                continue  # ISIS makes tables smaller
            raise InputError(f"{where}, {kind}_table_{end}", f"{stated:.12g}", f"{actual:.12g}, as ephemeris_times say")


def _turning(table: RotationTable, name: str, source: str) -> Iterator[str]:
    """A remark, or InputError, where attitudes don't turn as their own angular velocities say."""
    if table.angular_velocities is None:
        return
    noise = MEASURED if name == "instrument_pointing" else 0.0
    times, quaternions, rates = map(np.array, (table.ephemeris_times, table.quaternions, table.angular_velocities))
    if not (remark := turning_otherwise(times, quaternions, rates, noise)):
        return
    if _ODD_RATES not in (table.time_dependent_frames or ()):
        raise InputError(f"{source}, {name}", remark, remedy="quaternions are scalar first, inertial to frame")
    yield f"{name}: {remark}, which Kaguya's C-kernels have wrong"


def _clock(isd: SupportData, keywords: NaifKeywords) -> Iterator[str]:
    """Where the label's clock count, as ISIS computed it, is not the first line's time, nor that of LROC's preroll."""
    names = [key for key in keywords.values if re.fullmatch(r"CLOCK_ET_.*_COMPUTED", key)]
    _, start, period = isd.line_scan_rate[0]
    if len(names) != 1 or abs(start) > _DAY:
        return
    first = isd.starting_ephemeris_time
    late = (isd.center_ephemeris_time + start if first is None else first) - keywords.time(names[0])
    preroll, usual = f"_{CORRECTIONS[1]}", [0.0]
    if code := re.fullmatch(rf"INS(-\d{{5,6}}){preroll}", _only(keywords, "INS", preroll)):
        number_of_camera = int(code[1])
        factor = 1.0 + number(keywords, f"INS{number_of_camera}_{CORRECTIONS[3]}")
        usual += [corrected(keywords, number_of_camera, 0.0, seconds)[0] for seconds in (period, period / factor)]
    if min(abs(late - usual_time) for usual_time in usual) > period:
        yield f"the first line is {late:+.6f} s from the clock count of {names[0]}"


def lopsided(isd: SupportData) -> Iterator[str]:
    """Remarks on line times that do not reach as far after the epoch as before it, do not begin with the first line, or
    leave gaps.
    """
    rows = np.array(isd.line_scan_rate)
    lines, starts, periods = rows.T
    if lines[0] != _HALF:
        yield f"line_scan_rate begins at line {lines[0]:g}, not at 0.5, the first line's edge"
    ends = starts + np.diff(lines, append=isd.image_lines + _HALF) * periods
    for k in np.flatnonzero(np.abs(starts[1:] - ends[:-1]) > 2.0 * periods[:-1])[:1].tolist():
        yield f"the line at {lines[k + 1]:g} begins {starts[k + 1] - ends[k]:+.6f} s after the one before it is done"
    if starts[0] < 0.0 and abs(starts[0]) < _DAY and abs(starts[0] + ends[-1]) > 2.0 * periods.min():
        yield (
            f"{isd.image_lines} lines end {ends[-1]:.6f} s after center_ephemeris_time, and begin {-starts[0]:.6f} s "
            "before it"
        )


def contradictions_of_constants(
    isd: SupportData, body: Ellipsoid, keywords: NaifKeywords, source: str
) -> list[str]:
    """Remarks on constants of support data, after repairs.

    Parameters
    ----------
    isd : SupportData
        What the file says.
    body : Ellipsoid
        By its radii.
    keywords : NaifKeywords
        The camera's (`keywords_of_camera`).
    source : str
        The file, for messages.

    Raises
    ------
    InputError
        Where radii, focal length, detector, distortion or the body's rotation contradict the file's own keywords.
    """
    remarks = list(_radii(keywords, body, f"{source}, radii"))
    remarks += _focal_length(isd, keywords, source)
    for pair in (*_affine(isd, keywords), *_distortion(isd, keywords, source)):
        if pair.found.shape != pair.stated.shape or np.abs(pair.found - pair.stated).max(initial=0.0) > pair.allowed:
            _refuse(pair, source)
    remarks += _center(isd, keywords, source)
    _require_on_detector(isd, keywords, source)
    _require_rotation(isd, keywords, source)
    return remarks


def _refuse(pair: _Repeated, source: str) -> None:
    found, stated = (", ".join(f"{number:.9g}" for number in values) for values in (pair.found, pair.stated))
    raise InputError(f"{source}, {pair.key}", found, f"{stated}, as {pair.keyword} says", "fix the wrong one")


def _radii(keywords: NaifKeywords, body: Ellipsoid, where: str) -> Iterator[str]:
    code = int(number(keywords, "BODY_CODE")) if "BODY_CODE" in keywords else None
    keys = [key for key in keywords.values if re.fullmatch(r"BODY\d+_RADII", key)]
    nearest = min(keys, key=lambda key: abs(float(keywords.numbers(key, 3)[0]) * KM - body.equatorial), default="")
    key = nearest if code is None else f"BODY{code}_RADII"
    require_possible(body, body_name(code) if code is not None else "", where)
    if keys and key not in keys:
        expected = f"the body of {', '.join(keys)}"
        raise InputError(f"{keywords.source}, BODY_CODE", f"{code}, without its radii", expected)
    if not keys:
        return
    stated = keywords.numbers(key, 3) * KM
    if abs(stated[0] - stated[1]) > _SAME * stated[0]:
        axes = f"{', '.join(f'{length / KM:.9g}' for length in stated)} km in {key}"
        raise InputError(where, axes, "a body of revolution: two radii on the equator that are the same")
    for name, radius, by_key in (("semimajor", body.equatorial, stated[0]), ("semiminor", body.polar, stated[2])):
        both = f"{radius / KM:.9g} km, where {key} says {by_key / KM:.9g} km"
        if abs(radius - by_key) > _SAME_RADII * abs(by_key):
            raise InputError(f"{where}.{name}", both, "one radius", f"fix radii, their unit or {key}")
        if abs(radius - by_key) > _SAME * abs(by_key):
            yield f"radii.{name} is {both}"


def _focal_length(isd: SupportData, keywords: NaifKeywords, source: str) -> Iterator[str]:
    if not (key := _only(keywords, "INS", "_FOCAL_LENGTH")):
        return
    stated, focal_length = number(keywords, key), isd.focal_length_model.focal_length
    text = f"{focal_length:g} mm, where {key} says {stated:g}"
    if abs(focal_length - stated) > _SAME_FOCAL_LENGTH * abs(stated):
        raise InputError(f"{source}, focal_length_model", text, "one focal length", "fix the wrong one")
    if abs(focal_length - stated) > _SAME * abs(stated):
        yield f"focal_length_model is {text}"


def _affine(isd: SupportData, keywords: NaifKeywords) -> Iterator[_Repeated]:
    """Detector and focal plane. ALE's lines of Kaguya may run the other way, which is a line's difference at most."""
    codes = _codes(keywords)
    for axis, row in (("L", isd.focal2pixel_lines), ("S", isd.focal2pixel_samples)):
        name = {"L": "focal2pixel_lines", "S": "focal2pixel_samples"}[axis]
        values, size = np.array(row), float(np.linalg.norm(row[1:]))
        if key := _only(keywords, "INS", f"_ITRANS{axis}"):
            stated = keywords.numbers(key, 3)
            turned = axis == "L" and codes & set(_MODELS) and _MODELS[min(codes & set(_MODELS))] == "kaguyalism"
            if turned and float(values[1:] @ stated[1:]) < 0.0:
                stated = -stated
            yield _Repeated(name, values, key, stated, max(1e-5 * size, 1e-9))
        elif key := _only(keywords, "INS", "_PIXEL_PITCH"):
            per_mm = np.array([1.0 / number(keywords, key)])
            yield _Repeated(f"{name} (their norm)", np.array([size]), f"{key} (its inverse)", per_mm, 1e-3 * size)


def _distortion(isd: SupportData, keywords: NaifKeywords, source: str) -> Iterator[_Repeated]:
    """Coefficients of the one model; another model than the camera's is refused, and none where there should be one."""
    where, models = f"{source}, optical_distortion", {key.lower(): m for key, m in isd.optical_distortion.items()}
    codes = _codes(keywords)
    model = next(iter({_MODELS[code] for code in codes if code in _MODELS}), "")
    coefficients = {name: _numbers(model.get("coefficients", [])) for name, model in models.items()}
    plain = {name for name, values in coefficients.items() if name == "radial" and not values.any()}
    for name in models.keys() - plain - {model} if model else ():
        raise InputError(where, f"the model {name!r}", f"{model!r}, the camera's", "write the support data again")
    if (key := _only(keywords, "INS", "_OD_K")) and not codes & set(_MOC):
        name = next((candidate for candidate in ("radial", "lrolrocnac") if candidate in models), "")
        own = coefficients[name] if name else np.zeros(1)
        stated = keywords.numbers(key, own.size or 1)
        yield _Repeated(f"optical_distortion.{name}", own, key, stated, 1e-5 * float(np.abs(stated).max(initial=1e-9)))
    for axis in "xy":
        if key := _only(keywords, "INS", f"_DISTORTION_COEF_{axis.upper()}"):
            own = _numbers(models.get("kaguyalism", {}).get(axis, [0.0]))
            stated = keywords.numbers(key, own.size or 1)
            yield _Repeated(f"optical_distortion.kaguyalism.{axis}", own, key, stated, 1e-9)


def _numbers(values: object) -> Array:
    return np.atleast_1d(np.array(values, dtype=np.float64))


def _center(isd: SupportData, keywords: NaifKeywords, source: str) -> Iterator[str]:
    """The principal point by ISIS's keywords, which count the first pixel's centre as 1; a file's pixels begin at 0, or
    at 0.5 where its first sample says so. Programs differ by halves in other keywords, and along track.
    """
    counted = isd.starting_detector_sample % 1.0 - _HALF
    for name, k, center, shift in (
        ("line", 1, isd.detector_center.line, 0.0), ("sample", 0, isd.detector_center.sample, counted)
    ):
        if not (key := _only(keywords, "INS", f"_BORESIGHT_{name.upper()}")):
            continue
        stated = number(keywords, key)
        off = abs(center - (stated + shift))
        if off <= _SAME * 100.0:
            continue
        keys = [_only(keywords, "INS", f"_{suffix}") for suffix in ("CCD_CENTER", "CENTER")]
        centers = [keywords.numbers(name, 2)[k] for name in keys if name and len(_numbers(keywords.values[name])) > 1]
        if not any(abs(center - c + half) < _SAME * 100.0 for c in (stated, *centers) for half in (0.0, _HALF)):
            both = f"{center:.9g}, where {key} says {stated:.9g} (its first pixel's centre is 1)"
            raise InputError(f"{source}, detector_center.{name}", both, "one principal point", "fix the wrong one")
        yield f"detector_center.{name} is {center:.9g}, where {key} says {stated:.9g}"


def _require_on_detector(isd: SupportData, keywords: NaifKeywords, source: str) -> None:
    """By the keywords, or by the camera that they are of; files of the archive may have masked pixels beside."""
    key, codes = _only(keywords, "INS", "_PIXEL_SAMPLES"), _codes(keywords)
    widths = [camera.pixels * _MASKED for camera in CAMERAS if camera.instrument in codes]
    if not key and not widths:
        return
    pixels, summing = number(keywords, key) if key else max(widths), isd.detector_sample_summing
    last = max(isd.starting_detector_sample, 0.0) + isd.image_samples * summing
    if last > pixels + summing or isd.starting_detector_sample < -summing:
        found = f"{isd.image_samples} samples of {summing:g} pixels from {isd.starting_detector_sample:g} on"
        expected = f"within the {pixels:.0f} pixels that {f'{key} says' if key else 'the camera has'}"
        raise InputError(f"{source}, detector_sample_summing", found, expected, "fix one of them")


def odd_pixels(image: PushbroomImage) -> list[str]:
    """A remark on pixels that are far from square on the ground: a wrong summing, line period or unit makes such."""
    try:
        _, slope = image.image_to_ground(*image.middle)
    except InputError:  # it does not see the body, which others say
        return []
    along, across = np.linalg.norm(slope.reshape(3, 2), axis=0).tolist()
    if not across > 0.0 or 1.0 / _SQUARE < along / across < _SQUARE:  # NaN beside the body
        return []
    return [f"its pixels on the ground are {along:.3g} m along track and {across:.3g} m across"]


def _require_rotation(isd: SupportData, keywords: NaifKeywords, source: str) -> None:
    """Raise InputError where the body doesn't turn as its pole and prime meridian do, which the keywords have without
    terms of nutation: another body's, or another order of the quaternions.
    """
    keys = [_only(keywords, "BODY", f"_{name}") for name in ("POLE_RA", "POLE_DEC", "PM")]
    if not all(keys) or _only(keywords, "BODY", "_NUT_PREC_PM") or _only(keywords, "BODY", "_NUT_PREC_RA"):
        return
    table = isd.body_rotation
    time = table.ephemeris_times[0]
    ra, dec = (float(keywords.numbers(key, 2) @ [1.0, time / _CENTURY]) * DEG for key in keys[:2])
    days = time / _DAY
    meridian = float(keywords.numbers(keys[2], 3) @ [1.0, days, days**2]) % 360.0 * DEG
    expected = rotation.from_angles_313(np.array([0.5 * np.pi + ra, 0.5 * np.pi - dec, meridian]))
    quaternions = np.array(table.quaternions[:1])
    if table.constant_frames or not are_unit(quaternions):
        return
    matrix = rotation.to_matrix(rotation.unit_vectors(quaternions))[0]
    off = float(np.linalg.norm(rotation.logarithm((matrix @ expected.T)[None])[0]))
    plain = abs(float(keywords.numbers(keys[0], 1)[0]) - _IAU2000) < 1e-3
    if off > (_PLAIN_POLE if plain else _POLE):
        raise InputError(
            f"{source}, body_rotation", f"a body turned by {off / DEG:.4g} degrees",
            f"the pole and prime meridian of {keys[2].removesuffix('_PM')}", "fix the wrong one",
        )  # fmt: skip


def _codes(keywords: NaifKeywords) -> set[int]:
    """NAIF ids of the instruments whose optics keywords have."""
    return {int(match[1]) for key in keywords.values if (match := re.match(_OPTICS, key))}


def _only(keywords: NaifKeywords, begin: str, end: str) -> str:
    """The keyword with such a beginning and end; of several the camera's, or any where all say the same; else empty."""
    names = [key for key in keywords.values if key.startswith(begin) and key.endswith(end)]
    names = [key for key in names if "_" not in key.removesuffix(end)]
    same = len({repr(keywords.values[name]) for name in names}) == 1
    return names[0] if same else ""


def keywords_of_camera(isd: SupportData, source: str) -> tuple[NaifKeywords, list[str]]:
    """Keywords in capitals without blanks, of several instruments those of the one whose frame the file has; remarks.

    InputError where they are not constants by name.
    """
    values = {key.strip().upper(): value for key, value in isd.naif_keywords.items()}
    if nested := [key for key, value in values.items() if isinstance(value, dict)]:
        raise InputError(f"{source}, naif_keywords, {nested[0]}", "an object", "a number, a word or a list")
    table = isd.instrument_pointing
    frames = {str(code) for code in (*(table.constant_frames or ()), *(table.time_dependent_frames or ()))}
    codes = {match[1] for key in values if (match := re.match(_OPTICS, key))}
    others = codes - frames if codes & frames else set[str]()
    # parts of a detector (HiRISE's CCDs) have constants that the whole camera lacks
    chosen = {key: value for key, value in values.items() if not any(key.startswith(f"INS{code}_") for code in others)}
    ends = {key.partition("_")[2] for key in chosen if key.startswith("INS")}
    chosen |= {key: value for key, value in values.items() if key not in chosen and key.partition("_")[2] not in ends}
    keywords = NaifKeywords(source, chosen)
    optics = sorted({key.partition("_")[2] for key in chosen if re.match(_OPTICS, key)})
    odd = [end for end in optics if not _only(keywords, "INS", f"_{end}")]
    return keywords, [f"keywords of several instruments that differ are not compared: {', '.join(odd)}"] if odd else []

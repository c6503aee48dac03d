"""Support data held against what they say themselves a second time, in `naif_keywords`, and keys that nothing reads."""

from collections.abc import Iterator, Sequence
from difflib import get_close_matches
from typing import Any

import msgspec

from mgsgraph.errors import InputError
from mgsgraph.files.cameras.keywords import NaifKeywords, number
from mgsgraph.files.support_data.isd_layout import SupportData
from mgsgraph.geometry.body import Ellipsoid, body_name, require_possible
from mgsgraph.text import listed
from mgsgraph.units import KM

_SAME_RADII = 1e-3
"""Share by which radii may differ from those of the keywords: a sphere does so from Mars by six times that."""
_SAME_FOCAL_LENGTH = 0.01
"""Share by which a focal length may: a calibration changes it by less."""
_ALIKE = 0.8
"""Likeness (difflib) from which on an unknown key is a slip in one that is known and missing."""
_NAMED = 6
_OF_ALE = frozenset({
    "isis_camera_version", "name_sensor", "reference_height", "interpolation_method", "starting_ephemeris_time",
    "t0_ephemeris", "dt_ephemeris", "t0_quaternion", "dt_quaternion", "projection", "geotransform", "ale_version",
    "instrument_id", "spacecraft_name", "target_name", "sensor_model_version",
})  # fmt: skip
"""Keys that ALE and ISIS write, and that say nothing of a line scanner's geometry which isn't said elsewhere."""


def require_own_constants(isd: SupportData, body: Ellipsoid, source: str) -> None:
    """Raise InputError where radii, focal length or the detector's width contradict the file's own keywords.

    Parameters
    ----------
    isd : SupportData
        What the file says.
    body : Ellipsoid
        By its radii.
    source : str
        The file, for messages.
    """
    keywords = NaifKeywords(source, isd.naif_keywords)
    _require_radii(keywords, body, f"{source}, radii")
    if key := _only(keywords, "INS", "_FOCAL_LENGTH"):
        stated, found = number(keywords, key), isd.focal_length_model.focal_length
        if abs(found - stated) > _SAME_FOCAL_LENGTH * abs(stated):
            where, said = f"{source}, focal_length_model", f"{found:g} mm, where {key} says {stated:g}"
            raise InputError(where, said, "one focal length", "mend the wrong one")
    if key := _only(keywords, "INS", "_PIXEL_SAMPLES"):
        pixels, summing = number(keywords, key), isd.detector_sample_summing
        if isd.image_samples * summing > pixels + summing:
            where, said = f"{source}, detector_sample_summing", f"{isd.image_samples} samples of {summing:g} pixels"
            raise InputError(where, said, f"no more than the {pixels:g} pixels that {key} says", "mend one of them")


def _require_radii(keywords: NaifKeywords, body: Ellipsoid, where: str) -> None:
    code = int(number(keywords, "BODY_CODE")) if "BODY_CODE" in keywords else None
    key = f"BODY{code}_RADII" if code is not None else _only(keywords, "BODY", "_RADII")
    require_possible(body, body_name(code) if code is not None else "", where)
    if key not in keywords:
        return
    stated = keywords.numbers(key, 3) * KM
    for name, found, said in (("semimajor", body.equatorial, stated[0]), ("semiminor", body.polar, stated[2])):
        if abs(found - said) > _SAME_RADII * abs(said):
            both = f"{found / KM:.9g} km, where {key} says {said / KM:.9g} km"
            raise InputError(f"{where}.{name}", both, "one radius", f"mend radii, their unit or {key}")


def _only(keywords: NaifKeywords, begin: str, end: str) -> str:
    """The only keyword with such a beginning and end; empty where there are none, or several."""
    names = [key for key in keywords.values if key.startswith(begin) and key.endswith(end)]
    return names[0] if len(names) == 1 else ""


def unread_keys(content: dict[str, Any], source: str) -> list[str]:
    """What is to be said of keys that nothing here reads: a sentence, or none.

    Raises
    ------
    InputError
        For one that is a slip in a key that is missing, and whose place a default would take.
    """
    unread = list[str]()
    for where, key, missing in _unknown(content, SupportData, ""):
        if close := get_close_matches(key, missing, n=1, cutoff=_ALIKE):
            place = f"{source}, {where}" if where else source
            raise InputError(place, f"the unknown key {key!r}", remedy=f"did you mean {close[0]!r}?")
        if not where and key not in _OF_ALE:
            unread.append(key)
    more = [f"{len(unread) - _NAMED} more"] if len(unread) > _NAMED else []
    return [f"keys that nothing reads: {listed([*unread[:_NAMED], *more])}"] if unread else []


def _unknown(table: dict[str, Any], kind: type[msgspec.Struct], where: str) -> Iterator[tuple[str, str, list[str]]]:
    """Where it stands, and each key of a table that its record doesn't have, with those of the record that it lacks."""
    fields = {field.encode_name: field.type for field in msgspec.structs.fields(kind)}
    missing = [name for name in fields if name not in table]
    for key, value in table.items():
        if key not in fields:
            yield where, key, missing
        elif isinstance(value, dict) and (inner := _record(fields[key])) is not None:
            yield from _unknown(value, inner, f"{where}.{key}".lstrip("."))


def _record(kind: Any) -> type[msgspec.Struct] | None:
    """The record that a field holds, which may be optional."""
    choices: Sequence[Any] = (kind, *getattr(kind, "__args__", ()))
    return next((one for one in choices if isinstance(one, type) and issubclass(one, msgspec.Struct)), None)

"""Support data held against what they say themselves a second time, in `naif_keywords`."""

from mgsgraph.errors import InputError
from mgsgraph.files.cameras.camera import NaifKeywords, number
from mgsgraph.files.support_data.isd_layout import SupportData
from mgsgraph.geometry.body import Ellipsoid, body_name, require_possible
from mgsgraph.units import KM

_SAME_RADII = 1e-3
"""Share by which radii may differ from those of the keywords: a sphere does so from Mars by six times that."""
_SAME_FOCAL_LENGTH = 0.01
"""Share by which a focal length may: a calibration changes it by less."""


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

"""What a position table of ISIS or ALE holds: geometric or apparent positions, by its keywords or by the spacecraft.

ISIS and ALE ask SPICE with "LT+S" and the body as observer unless an addendum's keywords INS..._LIGHTTIME_CORRECTION,
..._SWAP_OBSERVER_TARGET and ..._LT_SURFACE_CORRECT say otherwise (ISIS LightTimeCorrectionState, SpicePosition with its
m_swapObserverTarget; ALE ale/base/data_naif.py). Where nothing stands there, the spacecraft decides.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from mgsgraph.errors import InputError
from mgsgraph.files.labels.aberration import Aberration, Observer

_DEFAULT = "ISIS and ALE take their default, no keyword being in its addendum"


@dataclass(frozen=True, slots=True)
class Spacecraft:
    """What tables of its line scanners hold where no keyword says it."""

    code: int
    """NAIF's, thousandths of the instruments'."""
    names: tuple[str, ...]
    """As name_platform says them, capitals, blanks for anything else."""
    stated: Aberration
    source: str
    """Why."""


SPACECRAFT = (
    Spacecraft(-94, ("MARS GLOBAL SURVEYOR", "MGS"), Aberration("LT+S"), f"MGS: {_DEFAULT}"),
    Spacecraft(-41, ("MARS EXPRESS", "MEX"), Aberration("LT+S"), f"MEX: {_DEFAULT}"),
    Spacecraft(-74, ("MARS RECONNAISSANCE ORBITER", "MRO"), Aberration("LT+S"), f"MRO: {_DEFAULT}"),
    Spacecraft(-53, ("MARS ODYSSEY", "ODYSSEY", "ODY", "M01"), Aberration("LT+S"), f"ODY: {_DEFAULT}"),
    Spacecraft(-131, ("KAGUYA", "SELENE", "SELENE M"), Aberration("LT+S"),
               "Kaguya: ALE's selene_drivers take their default where the addendum says nothing"),
    Spacecraft(-85, ("LUNAR RECONNAISSANCE ORBITER", "LRO"), Aberration("NONE"),
               "LRO: lro_drivers of ALE and lro_instrumentAddendum say NONE"),
    Spacecraft(-155, ("KPLO", "KOREA PATHFINDER LUNAR ORBITER", "DANURI"), Aberration("NONE"),
               "KPLO: kplo_drivers of ALE say NONE"),
)  # fmt: skip


def spacecraft_of(code: int) -> Spacecraft | None:
    """By NAIF's code."""
    return next((one for one in SPACECRAFT if one.code == code), None)


def aberration_of(values: Mapping[str, Any], source: str, instrument: int | None = None) -> Aberration | None:
    """By keywords, of one instrument or of any; None where they don't say.

    Parameters
    ----------
    values : mapping
        Words by keyword, in capitals or not.
    source : str
        Where they stand, for messages.
    instrument : int, optional
        NAIF's code; keywords of others are left alone.

    Raises
    ------
    InputError
        Words that are none of ISIS's, or keywords of several instruments that differ.
    """
    start = "INS" if instrument is None else f"INS{instrument}"
    correction = _keyword(values, start, "_LIGHTTIME_CORRECTION", source)
    if correction is None:
        return None
    if not isinstance(correction, str) or correction.upper() not in ("NONE", "LT+S"):
        raise InputError(f"{source}, {start}..._LIGHTTIME_CORRECTION", repr(correction), "'NONE' or 'LT+S'")
    swapped, to_surface = (
        _truth(values, start, key, source) for key in ("_SWAP_OBSERVER_TARGET", "_LT_SURFACE_CORRECT")
    )
    observer: Observer = "spacecraft" if swapped else "body"
    return Aberration("NONE") if correction.upper() == "NONE" else Aberration("LT+S", observer, to_surface)


def remarks_on(stated: Aberration, why: str) -> tuple[str, ...]:
    """What was done with positions, in sentences; `why` is empty where keywords said it."""
    if stated.correction == "NONE":
        return (f"positions are taken as geometric ({why})",) if why else ()
    seen = "light time to the surface" if stated.to_surface else "light time and stellar aberration"
    return (f"{seen} taken off positions, the {stated.observer} being the observer ({why or 'naif_keywords'})",)


def _keyword(values: Mapping[str, Any], start: str, end: str, source: str) -> Any:
    """Value of the instrument's keyword; None where there is none."""
    found = [value for key, value in values.items() if key.upper().startswith(start) and key.upper().endswith(end)]
    if any(value != found[0] for value in found):
        words = f"keywords of several instruments that differ: {found}"
        raise InputError(f"{source}, naif_keywords", words, "those of the instrument that took the image")
    return ("" if found[0] is None else found[0]) if found else None


def _truth(values: Mapping[str, Any], start: str, end: str, source: str) -> bool:
    value = _keyword(values, start, end, source)
    if value is not None and str(value).upper() not in ("TRUE", "FALSE"):
        raise InputError(f"{source}, {start}...{end}", repr(value), "true or false")
    return str(value).upper() == "TRUE"

"""Times of an archive in s TDB past J2000: terrestrial time as LOLA's records have it, UTC as tables write it.

The difference of TDB and TT is the term of one year that SPICE has (leap seconds kernel: DELTET/K, EB, M), 1.7 ms: to a
spacecraft 2.7 m of its way. The leap seconds are those of IERS Bulletin C from 1972 up to now.
"""

import re
from collections.abc import Sequence
from datetime import UTC, datetime, timedelta

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from mgsgraph.errors import InputError
from mgsgraph.geometry.altimeters import YEARS
from mgsgraph.geometry.records import Array
from mgsgraph.names import Names, RepeatedNames

_J2000 = datetime(2000, 1, 1, 12, tzinfo=UTC)
_TT_OF_TAI = 32.184
_TERM, _ECCENTRICITY, _ANOMALY, _MOTION = 1.657e-3, 1.671e-2, 6.239996, 1.99096871e-7
_FIRST_LEAPS = 10
"""TAI minus UTC in s from 1972 on."""
_LEAPS = (
    "1972-01", "1972-07", "1973-01", "1974-01", "1975-01", "1976-01", "1977-01", "1978-01", "1979-01", "1980-01",
    "1981-07", "1982-07", "1983-07", "1985-07", "1988-01", "1990-01", "1991-01", "1992-07", "1993-07", "1994-07",
    "1996-01", "1997-07", "1999-01", "2006-01", "2009-01", "2012-07", "2015-07", "2017-01",
)  # fmt: skip
"""Months from whose first day on that difference is one second more than before."""
_STARTS = np.array([(datetime.fromisoformat(f"{month}-01T00:00Z") - _J2000).total_seconds() for month in _LEAPS])
"""s UTC past J2000 of these days."""
_UTC = re.compile(r"(\d{4})-(?:(\d\d)-(\d\d)|(\d{3}))[T ](\d\d):(\d\d)(?::(\d\d(?:\.\d*)?))?Z?")
"""Year, month and day or day of the year, hour, minute, second."""
_TO_MINUTE = len("2009-09-06T07:50")
_SECONDS = 61.0
"""Of a minute at most, a leap second among them."""


def tdb_of_tt(times: Array) -> Array:
    """S TDB past J2000 of times (n,) in s TT past J2000."""
    return np.asarray(times + _yearly_term(times))


def _yearly_term(times: Array) -> Array:
    """S of TDB - TT at times (n,) in either: it changes by 3e-13 s within itself."""
    anomaly = _ANOMALY + _MOTION * times
    return np.asarray(_TERM * np.sin(anomaly + _ECCENTRICITY * np.sin(anomaly)))


def tdb_of_utc(texts: Sequence[str], where: str) -> Array:
    """S TDB past J2000 of times such as 2009-09-06T07:50:38.773, from 1972 on; InputError names `where`."""
    minutes, seconds = _in_columns(Names.of(texts).arrow) or _one_by_one(texts, where)
    leaps = np.searchsorted(_STARTS, minutes, side="right") - 1
    return tdb_of_tt(minutes + seconds + leaps + _FIRST_LEAPS + _TT_OF_TAI)


def _in_columns(texts: pa.Array) -> tuple[Array, Array] | None:
    """S UTC past J2000 of the minutes of times (n,), each of which is read once, and their seconds; None where they are
    written otherwise than to the second, or can't be read.
    """
    seconds = pc.utf8_slice_codeunits(texts, _TO_MINUTE)
    whole = r"^\d{4}-\d\d-\d\d[T ]\d\d:\d\d:\d\d(\.\d+)?Z?$"
    if not pc.all(pc.match_substring_regex(texts, whole)).as_py():
        return None
    past = np.asarray(pc.utf8_rtrim(pc.utf8_slice_codeunits(seconds, 1), "Z").cast(pa.float64()))
    minutes = RepeatedNames.of(pc.utf8_slice_codeunits(texts, 0, _TO_MINUTE))
    try:
        begins = np.array([_minute_and_second(text, "")[0] for text in minutes.distinct] or [0.0])
    except InputError:
        return None
    return (begins[minutes.numbers], past) if np.all(past < _SECONDS) else None


def _one_by_one(texts: Sequence[str], where: str) -> tuple[Array, Array]:
    minutes, seconds = np.array([_minute_and_second(text, where) for text in texts]).reshape(-1, 2).T
    return minutes, seconds


def _minute_and_second(text: str, where: str) -> tuple[float, float]:
    """S UTC past J2000 of a time's minute, and its seconds; a leap second is the sixtieth."""
    found = _UTC.fullmatch(text.strip())
    try:
        if found is None:
            raise ValueError(text)
        year, month, day, of_year, hour, minute, second = found.groups(default="")
        when = datetime(int(year), int(month or 1), int(day or 1), int(hour), int(minute), tzinfo=UTC)
        when += timedelta(days=int(of_year or 1) - 1)
        past = (when - _J2000).total_seconds()
        if when.year != int(year) or past < _STARTS[0] or float(second or 0.0) >= _SECONDS:
            raise ValueError(text)
    except (ValueError, OverflowError):
        expected = "UTC such as 2009-09-06T07:50:38.773, from 1972 on"
        raise InputError(where, f"a time that can't be read: {text.strip()[:40]!r}", expected) from None
    return past, float(second or 0.0)


def utc_of_tdb(time: float) -> datetime:
    """UTC of a time in s TDB past J2000, from 1972 on."""
    tai = time - float(_yearly_term(np.asarray(time))) - _TT_OF_TAI
    leaps = np.searchsorted(_STARTS + np.arange(_STARTS.size) + _FIRST_LEAPS, tai, side="right") - 1
    return _J2000 + timedelta(seconds=tai - max(int(leaps), 0) - _FIRST_LEAPS)


def utc_texts(times: Array) -> Names:
    """UTC of times (n,) in s TDB past J2000, from 1972 on, as year, month, day, hour, minute, second and thousandths of
    it, cut off there.
    """
    tai = times - _yearly_term(times) - _TT_OF_TAI
    leaps = np.searchsorted(_STARTS + np.arange(_STARTS.size) + _FIRST_LEAPS, tai, side="right") - 1
    part, whole = np.modf(tai - np.maximum(leaps, 0) - _FIRST_LEAPS)
    past = whole.astype(np.int64) * 10**6 + np.rint(part * 1e6).astype(np.int64)
    since_1970 = past // 1000 + int(_J2000.timestamp()) * 1000
    texts = pa.array(since_1970).cast(pa.timestamp("ms")).cast(pa.large_string())
    return Names.of(pc.replace_substring(texts, " ", "T"))


def require_years(times: Array, source: str) -> None:
    """Raise InputError unless times (n,) in s past J2000 (NaN where unknown) are those of spacecraft."""
    for k in np.flatnonzero((times < YEARS[0]) | (times > YEARS[1]))[:1]:
        found, expected = f"a time of {times[k]:g} s past J2000", f"{YEARS[0]:g} .. {YEARS[1]:g} s, 1968 to 2101"
        raise InputError(source, found, expected, "check the unit of the times")

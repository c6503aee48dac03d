"""Times of an archive in s TDB past J2000: terrestrial time as LOLA's records have it, UTC as tables write it.

The difference of TDB and TT is the term of one year that SPICE has (leap seconds kernel: DELTET/K, EB, M), 1.7 ms: to a
spacecraft 2.7 m of its way. The leap seconds are those of IERS Bulletin C from 1972 up to now.
"""

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
_UTC = (
    r"^\s*(?P<minute>\d{4}-(?:\d\d-\d\d|\d{3})[T ]\d\d:\d\d)(?::(?P<second>(?:[0-5]\d|60)(?:\.\d*)?))?Z?\s*$"
)
"""Year, month and day or day of the year, hour, minute; second, a leap second among them."""


def tdb_of_tt(times: Array) -> Array:
    """S TDB past J2000 of times (n,) in s TT past J2000."""
    return np.asarray(times + _yearly_term(times))


def _yearly_term(times: Array) -> Array:
    """S of TDB - TT at times (n,) in either: it changes by 3e-13 s within itself."""
    anomaly = _ANOMALY + _MOTION * times
    return np.asarray(_TERM * np.sin(anomaly + _ECCENTRICITY * np.sin(anomaly)))


def tdb_of_utc(texts: Sequence[str], where: str) -> Array:
    """S TDB past J2000 of times such as 2009-09-06T07:50:38.773, from 1972 on; InputError names `where`."""
    given = Names.of(texts).arrow
    parts = pc.extract_regex(given, _UTC)
    begins = RepeatedNames.of(pc.fill_null(pc.struct_field(parts, "minute"), ""))
    minutes = np.array([_past(begin) for begin in begins.distinct], dtype=np.float64)[begins.numbers]
    for k in np.flatnonzero(np.isnan(minutes))[:1].tolist():
        expected = "UTC such as 2009-09-06T07:50:38.773, from 1972 on"
        raise InputError(where, f"a time that can't be read: {given[k].as_py().strip()[:40]!r}", expected)
    seconds = pc.struct_field(parts, "second")
    whole = np.asarray(pc.if_else(pc.equal(seconds, ""), "0", seconds).cast(pa.float64()))
    leaps = np.searchsorted(_STARTS, minutes, side="right") - 1
    return tdb_of_tt(minutes + whole + leaps + _FIRST_LEAPS + _TT_OF_TAI)


def _past(minute: str) -> float:
    """S UTC past J2000 of a minute as `_UTC` has it; NaN where there is none, or before 1972."""
    date, clock = minute[: -len("T07:50")], minute[-len("07:50") :]
    try:
        day = datetime.strptime(date, "%Y-%m-%d" if date.count("-") > 1 else "%Y-%j").replace(tzinfo=UTC)
        past = (day.replace(hour=int(clock[:2]), minute=int(clock[3:])) - _J2000).total_seconds()
    except ValueError:
        return float("nan")
    return past if past >= _STARTS[0] and day.year == int(date[:4]) else float("nan")


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

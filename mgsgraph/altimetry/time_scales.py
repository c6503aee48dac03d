"""Times of an archive in s TDB past J2000: terrestrial time as LOLA's records have it, UTC as tables write it.

The difference of TDB and TT is the term of one year that SPICE has (leap seconds kernel: DELTET/K, EB, M), 1.7 ms: to a
spacecraft 2.7 m of its way. The leap seconds are those of IERS Bulletin C up to now.
"""

from collections.abc import Sequence
from datetime import UTC, datetime, timedelta

import numpy as np

from mgsgraph.errors import InputError
from mgsgraph.geometry.records import Array

_J2000 = datetime(2000, 1, 1, 12, tzinfo=UTC)
_TT_OF_TAI = 32.184
_TERM, _ECCENTRICITY, _ANOMALY, _MOTION = 1.657e-3, 1.671e-2, 6.239996, 1.99096871e-7
_LEAPS = (
    (32, datetime(1999, 1, 1, tzinfo=UTC)), (33, datetime(2006, 1, 1, tzinfo=UTC)),
    (34, datetime(2009, 1, 1, tzinfo=UTC)), (35, datetime(2012, 7, 1, tzinfo=UTC)),
    (36, datetime(2015, 7, 1, tzinfo=UTC)), (37, datetime(2017, 1, 1, tzinfo=UTC)),
)
"""TAI minus UTC in s, and from when on."""


def tdb_of_tt(times: Array) -> Array:
    """S TDB past J2000 of times (n,) in s TT past J2000."""
    anomaly = _ANOMALY + _MOTION * times
    return np.asarray(times + _TERM * np.sin(anomaly + _ECCENTRICITY * np.sin(anomaly)))


def tdb_of_utc(texts: Sequence[str], where: str) -> Array:
    """S TDB past J2000 of times such as 2009-09-06T07:50:38.773, from 1999 on; InputError names `where`."""
    try:
        wholes = [datetime.fromisoformat(text.strip()[:19]).replace(tzinfo=UTC) for text in texts]
        parts = [float(f"0{text.strip().removesuffix('Z')[19:]}") for text in texts]
        seconds = [(one - _J2000).total_seconds() + _leaps(one) for one in wholes]
    except ValueError:
        expected = "UTC such as 2009-09-06T07:50:38.773, from 1999 on"
        raise InputError(where, "times that can't be read", expected) from None
    return tdb_of_tt(np.array(seconds) + np.array(parts) + _TT_OF_TAI)


def utc_of_tdb(time: float) -> datetime:
    """UTC of a time in s TDB past J2000, from 1999 on, to some milliseconds."""
    tai = _J2000 + timedelta(seconds=time - _TT_OF_TAI)
    passed = [leap for leap, start in _LEAPS if start + timedelta(seconds=leap) <= tai]
    return tai - timedelta(seconds=passed[-1] if passed else _LEAPS[0][0])


def _leaps(when: datetime) -> int:
    passed = [leap for leap, start in _LEAPS if start <= when]
    if not passed:
        raise ValueError(when)
    return passed[-1]

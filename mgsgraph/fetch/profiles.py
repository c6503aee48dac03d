"""Which PEDR file holds the laser profile of an image's orbit.

A file holds about a day and is called after its first orbit, MGS's mapping orbit + 10000: from the image's orbit one
goes downward to the first file that there is, and its label says whether it is the one.
"""

import re
from collections.abc import Iterator
from datetime import UTC, datetime, timedelta

from mgsgraph.errors import InputError
from mgsgraph.fetch.archives import Archives
from mgsgraph.fetch.download import NotInArchive, Remote
from mgsgraph.fetch.kernel_phases import Interval
from mgsgraph.files.altimetry.pedr import FRAME, HEADER_RECORDS
from mgsgraph.files.pvl import flat_label

RANGING_ENDED = datetime(2001, 6, 30, 23, 59, 59, tzinfo=UTC)
"""MOLA's last range was on this day."""
FIRST = 10_000
"""What MOLA adds to MGS's mapping orbit."""
_KNOWN_ORBIT, _KNOWN_TIME = 717, datetime(1999, 5, 6, 15, 33, 58, tzinfo=UTC)
"""M01/00115, by its label."""
_PERIOD = timedelta(seconds=7057.27)
"""Of MGS's mapping orbit: M04/02852 is of orbit 2063."""
_ABOVE, _BELOW = 15, 30
"""Orbits after and before an image's with which its file may begin: a day has 12, and its orbit may be reckoned."""


def orbit_at(when: datetime) -> int:
    """MGS's mapping orbit at a time, within some: its period changed."""
    return _KNOWN_ORBIT + round((when - _KNOWN_TIME) / _PERIOD)


def find_profile(orbit: int, taken: Interval, archives: Archives, remote: Remote, where: str) -> tuple[str, str]:
    """Path of the PEDR file below its archive, and a sentence: why there is none, or what is not confirmed.

    Parameters
    ----------
    orbit : int
        Mapping orbit of the image.
    taken : Interval
        When it was taken.
    archives, remote
        Where, and how.
    where : str
        The image, for the sentences.
    """
    if taken.start > RANGING_ENDED:
        return "", f"{where}: no laser profile, MOLA's ranging ended on {RANGING_ENDED:%Y-%m-%d}"
    for path in _candidates(orbit + FIRST, archives, remote):
        try:
            head = remote.head(archives.pedr + path, HEADER_RECORDS * FRAME.itemsize)
        except NotInArchive:
            continue
        covered = Interval.said_by(flat_label(_label_text(head, archives.pedr + path), archives.pedr + path))
        if covered is None:
            return path, f"{where}: the label of {path} says no times; it is taken by its orbit"
        if covered.holds(taken.middle):
            return path, ""
        if covered.stop < taken.middle:
            return "", f"{where}: no laser profile, {path} ends at {covered.stop:%Y-%m-%dT%H:%M:%S} before it"
    return "", f"{where}: no laser profile, the archive has no file of its day"


def _candidates(orbit: int, archives: Archives, remote: Remote) -> Iterator[str]:
    """Paths downward from an orbit, only those that the archive lists where it does."""
    listed: dict[str, frozenset[str]] = {}
    for number in range(orbit + _ABOVE, max(FIRST, orbit - _BELOW) - 1, -1):
        folder, name = f"ap{number // 1000:02d}xxx", f"ap{number:05d}l.b"
        if folder not in listed:
            page = remote.listing(f"{archives.pedr}{folder}/").lower()
            listed[folder] = frozenset(re.findall(r"ap\d{5}l\.b(?=\")", page))
        if not listed[folder] or name in listed[folder]:
            yield f"{folder}/{name}"


def _label_text(head: bytes, where: str) -> str:
    if b"PDS_VERSION_ID" not in head:
        raise InputError(where, f"it begins with {head[:16]!r}", "a PDS3 label", "try another mirror")
    return head.decode("latin-1")

"""When HRSC takes its lines: out of the lines' prefixes, the table of a cube, a text file, or a mean of the label's.

HRSC changes its line period within an image, to follow the speed over the ground; no label says so. What does:

* PDS3 images: the first 8 bytes of each line's prefix are the time at which its exposure begins (s TDB past J2000),
  the next 4 the exposure in ms, little-endian whatever the pixels are (ISIS hrsc2isis, ALE's notes on HRSC);
* ISIS cubes: the table LineScanTimes, which hrsc2isis makes of these, one record for each change of the exposure;
* text: this table as ISIS `tabledump` writes it, or made by hand.

A time is that of the line's leading edge: so says CkTableEndTime of the cube of h5270, which is the last change plus
all lines that follow, and so has ALE's support data. (Older ISIS took it for the middle, half a line later.)
"""

import csv
import io
from pathlib import Path

import numpy as np

from mgsgraph.errors import InputError, errors_from
from mgsgraph.files.cameras.line_times import JOINED, LineTimes, LineTimesLocation, LineTimesPlace
from mgsgraph.files.opening import ANY_SIZE, number_of, opened, read_text, understood
from mgsgraph.geometry.records import Array
from mgsgraph.units import MILLISECOND

_SHORTEST, _LONGEST = 1e-3, 0.5
"""s per line; HRSC exposes for 2.24 to 54.5 ms per detector line, of which a macropixel takes 8 at most."""
_LATEST = 1e11
"""s from J2000: three thousand years."""
_SLACK = 1.0
"""s by which times and the label's START_TIME and STOP_TIME may differ; those of h5270 agree within 1 ms."""
_COLUMNS = ("EphemerisTime", "ExposureTime", "LineStart")
_PREFIX = [("time", "<f8"), ("exposure", "<f4")]
_RECORD = np.dtype([("time", "<f8"), ("exposure", "<f8"), ("line", "<i4")])


def read_line_times(place: LineTimesPlace, lines: int, start: float, stop: float, label: str) -> LineTimes:
    """Times of an image's lines.

    Parameters
    ----------
    place : LineTimesLocation, Path, "mean" or None
        Where they are. "mean" is kilometres off in the middle of an image that changes its rate (h5270: 1.6 s, 6 km),
        and so must be asked for.
    lines : int
        of the image.
    start, stop : float
        s TDB past J2000, what its START_TIME and STOP_TIME stand for.
    label : str
        The label's file, for messages.

    Raises
    ------
    InputError
        No line times where they are looked for, a line rate that makes no sense, or times that are not the label's.
    """
    if not start < stop:
        raise InputError(label, f"STOP_TIME {stop - start:+.3f} s after START_TIME", "a time after START_TIME")
    if place == "mean":
        return _mean(label, lines, start, stop)
    if place is None:
        raise InputError(
            label, "a label without the times of its lines",
            "the image itself (PDS3 with line prefixes, or a cube with its table LineScanTimes)",
            f"name that, or line_times = a text file of {', '.join(_COLUMNS)}, or 'mean' for a rough one",
        )  # fmt: skip
    where = str(place if isinstance(place, Path) else place.file)
    with errors_from(where):
        if isinstance(place, Path):
            times = _of_text(place, lines)
        else:
            times = _of_prefixes(place) if place.kind == "prefixes" else _of_table(place, lines)
    for what, ours, theirs in (("START_TIME", times.start, start), ("STOP_TIME", times.last, stop)):
        if not abs(ours - theirs) <= _SLACK:
            raise InputError(
                where, f"line times {ours - theirs:+.3f} s off the label's {what}",
                f"the two within {_SLACK:g} s", "check the line rates, and whether they are this image's",
            )  # fmt: skip
    return times


def _mean(label: str, lines: int, start: float, stop: float) -> LineTimes:
    """STOP_TIME is that of the last line's beginning."""
    if lines < 2:
        raise InputError(label, "one line", "at least two for a mean line rate")
    with errors_from(f"{label}, START_TIME, STOP_TIME and lines"):
        return _times(np.zeros(1), np.array([start]), np.array([(stop - start) / (lines - 1)]), lines)


def _times(first: Array, starts: Array, periods: Array, lines: int) -> LineTimes:
    for k in np.flatnonzero(~((periods >= _SHORTEST) & (periods <= _LONGEST)))[:1]:
        found = f"a line rate of {float(periods[k]) / MILLISECOND:g} ms per line from line {first[k] + 1.0:g} on"
        raise InputError(
            "line times", found, f"{_SHORTEST / MILLISECOND:g} .. {_LONGEST / MILLISECOND:g} ms, as HRSC's are",
            "check the unit: ms in prefixes, s elsewhere",
        )  # fmt: skip
    for k in np.flatnonzero(~(np.abs(starts) < _LATEST))[:1]:
        found = f"the time {starts[k]:g} s for line {first[k] + 1.0:g}"
        raise InputError("line times", found, "s TDB past J2000")
    return LineTimes(first, starts, periods, lines)


def _of_prefixes(place: LineTimesLocation) -> LineTimes:
    """One segment from each change of the exposure, and from the end of each pause."""
    rest = place.stride - sum(np.dtype(kind).itemsize for _, kind in _PREFIX)
    with opened(place.file, ANY_SIZE) as file, understood(str(place.file), "an image with line prefixes"):
        rows = np.memmap(file, np.dtype([*_PREFIX, ("pixels", f"V{rest}")]), "r", place.offset, place.count)
        times = np.array(rows["time"], dtype=np.float64)
        with np.errstate(invalid="ignore"):  # signalling NaN
            periods = np.array(rows["exposure"], dtype=np.float64) * MILLISECOND
    for k in np.flatnonzero(~((np.abs(times) < _LATEST) & (periods > 0.0) & (periods < _LATEST)))[:1]:
        raise InputError(f"prefix of line {k + 1}", f"{times[k]:g} s and {periods[k]:g} s", "a time and an exposure")
    waited = np.abs(np.diff(times) - periods[:-1]) > JOINED * periods[:-1]
    begins = np.flatnonzero(np.concatenate([[True], waited | (np.diff(periods) != 0.0)]))
    return _times(begins.astype(np.float64), times[begins], periods[begins], place.count)


def _of_table(place: LineTimesLocation, lines: int) -> LineTimes:
    with opened(place.file, ANY_SIZE) as file, understood(str(place.file), "a cube with the times of its lines"):
        file.seek(place.offset)
        rows = np.frombuffer(file.read(place.count * place.stride), _RECORD, place.count)
    return _times(rows["line"] - 1.0, rows["time"].astype(np.float64), rows["exposure"].astype(np.float64), lines)


def _of_text(path: Path, lines: int) -> LineTimes:
    """Comma-separated, with a line of names."""
    with understood(str(path), "a table of line times"):
        rows = csv.DictReader(io.StringIO(read_text(path)), skipinitialspace=True)
        names = [name.strip() for name in rows.fieldnames or ()]
        if any(name not in names for name in _COLUMNS):
            raise InputError(str(path), f"the columns {', '.join(names) or 'none'}", f"{', '.join(_COLUMNS)}")
        rows.fieldnames = names
        values = [
            [number_of((row[name] or "").strip(), f"{path}, line {rows.line_num}, {name}") for name in _COLUMNS]
            for row in rows
        ]
    table = np.array(values, dtype=np.float64).reshape(-1, 3)
    return _times(table[:, 2] - 1.0, table[:, 0], table[:, 1], lines)

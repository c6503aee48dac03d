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
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np

from mgsgraph.errors import InputError, errors_from
from mgsgraph.geometry.image import LineTiming
from mgsgraph.geometry.records import Array, assign, frozen
from mgsgraph.io.files import number_of, read_text
from mgsgraph.io.hrsc_label import HrscLabel, LineTimesLocation
from mgsgraph.units import MILLISECOND

LineTimesSource = Path | Literal["mean"] | None
"""A text file; "mean", all lines alike between the label's START_TIME and STOP_TIME; or None, the image's own."""

_SHORTEST, _LONGEST = 1e-3, 0.5
"""s per line; HRSC exposes for 2.24 to 54.5 ms per detector line, of which a macropixel takes 8 at most."""
_SLACK = 1.0
"""s by which times and the label's START_TIME and STOP_TIME may differ; those of h5270 agree within 1 ms."""
_JOINED = 0.5
"""lines; a change that comes later or earlier by less is an uneven clock, one that comes later by more a pause."""
_COLUMNS = ("EphemerisTime", "ExposureTime", "LineStart")
_PREFIX = [("time", "<f8"), ("exposure", "<f4")]
_RECORD = np.dtype([("time", "<f8"), ("exposure", "<f8"), ("line", "<i4")])


@dataclass(frozen=True, slots=True, eq=False)
class LineTimes:
    """Times of the lines of one image, by its changes of the line period."""

    first_lines: Array
    """(s,) lines read before each change, from 0.0 on, increasing."""
    starts: Array
    """(s,) s TDB past J2000, beginning of the line that comes next."""
    periods: Array
    """(s,) s per line from there on."""
    lines: int
    """Number of the image's lines."""

    def __post_init__(self) -> None:
        first = frozen(self.first_lines, "line times, first lines", (None,))
        if first.size == 0 or first[0] != 0.0 or np.any(np.diff(first) < 1.0) or first[-1] >= self.lines:
            shown = ", ".join(f"{line + 1.0:g}" for line in first[:4]) or "none"
            raise InputError("line times", f"changes at lines {shown}", f"lines from 1 up to {self.lines}, increasing")
        starts = frozen(self.starts, "line times, starts", (first.size,))
        periods = frozen(self.periods, "line times, periods", (first.size,))
        for k in np.flatnonzero((periods < _SHORTEST) | (periods > _LONGEST))[:1]:
            found = f"a line rate of {periods[k] / MILLISECOND:g} ms per line from line {first[k] + 1.0:g} on"
            raise InputError(
                "line times", found, f"{_SHORTEST / MILLISECOND:g} .. {_LONGEST / MILLISECOND:g} ms, as HRSC's are",
                "check the unit: ms in prefixes, s elsewhere",
            )  # fmt: skip
        early = (starts[:-1] + np.diff(first) * periods[:-1] - starts[1:]) / periods[:-1]
        for k in np.flatnonzero(early > _JOINED)[:1]:
            found = f"line {first[k + 1] + 1.0:g} begins {early[k]:.3g} lines before the one ahead of it is done"
            raise InputError("line times", found, "times and line rates that agree")
        assign(self, first_lines=first, starts=starts, periods=periods)

    @property
    def start(self) -> float:
        """Time in s TDB past J2000 of the first line's leading edge."""
        return float(self.starts[0])

    @property
    def last(self) -> float:
        """Time in s TDB past J2000 of the last line's leading edge."""
        return float(self.starts[-1] + (self.lines - 1.0 - self.first_lines[-1]) * self.periods[-1])

    @property
    def stop(self) -> float:
        """Time in s TDB past J2000 of the last line's trailing edge."""
        return float(self.starts[-1] + (self.lines - self.first_lines[-1]) * self.periods[-1])

    def timing(self, epoch: float) -> LineTiming:
        """The same in s past a trajectory's epoch, the recorded times joined without steps but for true pauses.

        Recorded times are those of an uneven clock: at the changes of h5270 they lie 0.03 and 0.16 ms (0.01 lines) off
        what the exposures add up to. Each segment's period is what leads from its recorded time to the next.
        """
        starts, periods = self.starts - epoch, self.periods.copy()
        between = np.diff(starts) / np.diff(self.first_lines)
        joined = np.abs(between / periods[:-1] - 1.0) * np.diff(self.first_lines) < _JOINED
        periods[:-1] = np.where(joined, between, periods[:-1])
        return LineTiming(self.first_lines, starts, periods)


def read_line_times(label: HrscLabel, start: float, stop: float, source: LineTimesSource = None) -> LineTimes:
    """Times of an image's lines.

    Parameters
    ----------
    label : HrscLabel
        of the image.
    start, stop : float
        s TDB past J2000, what its START_TIME and STOP_TIME stand for.
    source : Path, "mean" or None
        Where to take them from. "mean" is kilometres off in the middle of an image that changes its rate (h5270: 1.6 s,
        6 km), and so must be asked for.

    Raises
    ------
    InputError
        No line times where they are looked for, a line rate that makes no sense, or times that are not the label's.
    """
    if not start < stop:
        raise InputError(str(label.path), f"STOP_TIME {label.stop_time}", f"a time after START_TIME {label.start_time}")
    if source == "mean":
        return _mean(label, start, stop)
    place = label.times
    if source is None and place is None:
        raise InputError(
            str(label.path), "a label without the times of its lines",
            "the image itself (PDS3 with line prefixes, or a cube with its table LineScanTimes)",
            f"name that, or line_times = a text file of {', '.join(_COLUMNS)}, or 'mean' for a rough one",
        )  # fmt: skip
    where = source or (place.file if place else label.path)
    with errors_from(str(where)):
        if source is not None:
            times = _of_text(source, label.lines)
        else:
            assert place is not None
            times = _of_prefixes(place) if place.kind == "prefixes" else _of_table(place, label.lines)
    for what, ours, theirs in (("START_TIME", times.start, start), ("STOP_TIME", times.last, stop)):
        if not abs(ours - theirs) <= _SLACK:
            raise InputError(
                str(where), f"line times {ours - theirs:+.3f} s off the label's {what}",
                f"the two within {_SLACK:g} s", "check the line rates, and whether they are this image's",
            )  # fmt: skip
    return times


def _mean(label: HrscLabel, start: float, stop: float) -> LineTimes:
    """STOP_TIME is that of the last line's beginning."""
    if label.lines < 2:
        raise InputError(str(label.path), "one line", "at least two for a mean line rate")
    period = (stop - start) / (label.lines - 1)
    with errors_from(f"{label.path}, START_TIME, STOP_TIME and lines"):
        return LineTimes(np.zeros(1), np.array([start]), np.array([period]), label.lines)


def _of_prefixes(place: LineTimesLocation) -> LineTimes:
    """One segment from each change of the exposure, and from the end of each pause."""
    rest = place.stride - sum(np.dtype(kind).itemsize for _, kind in _PREFIX)
    rows = np.memmap(place.file, np.dtype([*_PREFIX, ("pixels", f"V{rest}")]), "r", place.offset, place.count)
    times = np.array(rows["time"], dtype=np.float64)
    periods = np.array(rows["exposure"], dtype=np.float64) * MILLISECOND
    for k in np.flatnonzero(~(np.isfinite(times) & np.isfinite(periods)))[:1]:
        raise InputError(f"prefix of line {k + 1}", f"{times[k]:g} s and {periods[k]:g} s", "a time and an exposure")
    waited = np.abs(np.diff(times) - periods[:-1]) > _JOINED * periods[:-1]
    begins = np.flatnonzero(np.concatenate([[True], waited | (np.diff(periods) != 0.0)]))
    return LineTimes(begins.astype(np.float64), times[begins], periods[begins], place.count)


def _of_table(place: LineTimesLocation, lines: int) -> LineTimes:
    rows = np.fromfile(place.file, _RECORD, place.count, offset=place.offset)
    return LineTimes(rows["line"] - 1.0, rows["time"], rows["exposure"], lines)


def _of_text(path: Path, lines: int) -> LineTimes:
    """Comma-separated, with a line of names."""
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
    return LineTimes(table[:, 2] - 1.0, table[:, 0], table[:, 1], lines)

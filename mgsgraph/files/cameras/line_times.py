"""When an image's lines were taken: one line period, or one for each stretch of lines between changes."""

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np

from mgsgraph.errors import InputError
from mgsgraph.geometry.image import LineTiming
from mgsgraph.geometry.records import Array, assign, frozen

LineTimesSource = Path | Literal["mean"] | None
"""A text file; "mean", all lines alike between the label's first and last time; or None, the image's own."""
JOINED = 0.5
"""lines; a change that comes later or earlier by less is an uneven clock, one that comes later by more a pause."""


@dataclass(frozen=True, slots=True)
class LineTimesLocation:
    """Where in a file the times of lines lie."""

    file: Path
    """Which holds them."""
    kind: Literal["prefixes", "table"]
    """Before each line's pixels (PDS3), or the table LineScanTimes that hrsc2isis made of these."""
    offset: int
    """bytes before the first."""
    count: int
    """Number of lines, or of records."""
    stride: int
    """bytes from one to the next."""


LineTimesPlace = LineTimesLocation | LineTimesSource


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
        early = (starts[:-1] + np.diff(first) * periods[:-1] - starts[1:]) / periods[:-1]
        for k in np.flatnonzero(early > JOINED)[:1]:
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
        joined = np.abs(between / periods[:-1] - 1.0) * np.diff(self.first_lines) < JOINED
        periods[:-1] = np.where(joined, between, periods[:-1])
        return LineTiming(self.first_lines, starts, periods)


def uniform(start: float, period: float, lines: int, first_line: float = 0.0) -> LineTimes:
    """Lines of one period (s), the image's first one `first_line` lines after `start` (s TDB past J2000)."""
    return LineTimes(np.zeros(1), np.array([start + first_line * period]), np.array([period]), lines)

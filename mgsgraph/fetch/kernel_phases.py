"""Which SPK and CK hold an image's time (UTC): predicted by the mission's phases, confirmed by the kernels' labels."""

from collections.abc import Callable
from contextlib import suppress
from datetime import UTC, date, datetime, time, timedelta
from typing import NamedTuple

from mgsgraph.errors import InputError
from mgsgraph.files.pvl import Block

_NONE = ("N/A", "UNK", "")
"""What PDS3 labels write for no value."""
_DAY_OF_YEAR = "%Y-%jT%H:%M:%S"


class Interval(NamedTuple):
    """From one UTC to another, both included."""

    start: datetime
    stop: datetime

    @classmethod
    def of(cls, label: Block) -> "Interval":
        """START_TIME and STOP_TIME of a label; InputError where one is missing, no time, or they are exchanged."""
        own = cls(*(utc(label.text(key), label.where(key)) for key in ("START_TIME", "STOP_TIME")))
        if own.start > own.stop:
            raise InputError(label.where(), f"START_TIME {own.start} after STOP_TIME {own.stop}", "the reverse")
        return own

    @classmethod
    def stated_by(cls, label: Block) -> "Interval | None":
        """The same; None for a label that says no times."""
        stated = [str(label.entries[key.lower()].value) for key in ("START_TIME", "STOP_TIME") if key in label]
        return cls.of(label) if len(stated) == 2 and not any(text.upper() in _NONE for text in stated) else None

    @property
    def middle(self) -> datetime:
        """The time half-way."""
        return self.start + (self.stop - self.start) / 2

    def wider(self, seconds: float) -> "Interval":
        """With so much more before and after."""
        return Interval(self.start - timedelta(seconds=seconds), self.stop + timedelta(seconds=seconds))

    def holds(self, time: datetime) -> bool:
        """Whether a time lies in it."""
        return self.start <= time <= self.stop

    def meets(self, other: "Interval") -> bool:
        """Whether the two have a time in common."""
        return self.start <= other.stop and other.start <= self.stop

    def __str__(self) -> str:
        return f"{self.start:%Y-%m-%dT%H:%M:%S} .. {self.stop:%Y-%m-%dT%H:%M:%S}"


def utc(text: str, where: str) -> datetime:
    """A time such as 1999-06-02T00:00:02.183 or 1999-153T00:00:02; InputError names `where`."""
    plain = text.strip().strip('"').removesuffix("Z")
    with suppress(ValueError):
        return datetime.fromisoformat(plain).replace(tzinfo=UTC)
    try:
        return datetime.strptime(plain.partition(".")[0], _DAY_OF_YEAR).replace(tzinfo=UTC)
    except ValueError:
        raise InputError(where, repr(text[:40]), "a time such as 1999-06-02T00:00:02") from None


KINDS = {"SPK": ("spk/mgs_", ".bsp"), "CK": ("ck/mgs_sc_", ".bc")}
"""Beginnings and endings of the kernels' paths, the name of a phase between them."""
MARGIN = 5.0
"""s before and after an image that its tables hold, and by which attitude is looked up earlier."""
_CYCLES = timedelta(days=84)
"""Length of a phase: three cycles of 28 days."""
_REACH = 2
"""Phases before and after the predicted one that are asked, too."""

# NAIF's labels: map2 from 1999-06-02, map4 1999-11-17, map5 2000-02-09, map8 2000-10-18 to 2001-01-31,
# ext12 from 2003-07-23, ext26 2006-10-11; the others follow from the phases' length.
_PHASES = (
    *((f"map{k}", date(1999, 3, 10) + (k - 1) * _CYCLES) for k in range(1, 9)),
    ("ext1", date(2001, 2, 1)),
    *((f"ext{k}", date(2001, 4, 4) + (k - 2) * _CYCLES) for k in range(2, 27)),
)
_NAMES = tuple(name for name, _ in _PHASES)
_STARTS = tuple(datetime.combine(start, time(), UTC) for _, start in _PHASES)

Cover = Callable[[str], Interval | None]
"""What a kernel's label says that it covers, by its path with the ending .lbl; None where there is no label."""


def phase_of(when: datetime) -> int:
    """Position of the phase at a time among all phases; the first or the last one for times outside."""
    return max(0, sum(start <= when for start in _STARTS) - 1)


def find_kernels(exposure: Interval, cover: Cover, where: str) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Paths of the SPK and the CK of an image, and sentences about what could not be confirmed.

    Parameters
    ----------
    exposure : Interval
        When the image was taken.
    cover : callable
        Reads kernels' labels.
    where : str
        The image, for errors.

    Raises
    ------
    InputError
        When by their labels no kernels hold its time.
    """
    paths, notes = [], []
    for kind, (stem, suffix) in KINDS.items():
        phases, confirmed = _phases(exposure, stem, cover, f"{where}, {kind}")
        paths += [f"{stem}{_NAMES[k]}{suffix}" for k in phases]
        if not confirmed:
            notes.append(f"{where}: {paths[-1]} has no label that would confirm its time; it is taken by its name")
    return tuple(paths), tuple(notes)


def _phases(exposure: Interval, stem: str, cover: Cover, where: str) -> tuple[list[int], bool]:
    """Phases that hold an interval, in order, and whether labels say so; the predicted one is asked first."""
    predicted, wanted = phase_of(exposure.middle), exposure.wider(MARGIN)
    reach = range(max(0, predicted - _REACH), min(len(_NAMES), predicted + _REACH + 1))
    covered: dict[int, Interval] = {}
    for k in sorted(reach, key=lambda k: (abs(k - predicted), k)):
        stated = cover(f"{stem}{_NAMES[k]}.lbl")
        if stated is None and k == predicted:
            return [k], False
        if stated is not None and stated.meets(wanted):
            covered[k] = stated
        if all(any(interval.holds(end) for interval in covered.values()) for end in wanted):
            break
    if not all(any(interval.holds(end) for interval in covered.values()) for end in exposure):
        near = ", ".join(f"{_NAMES[k]} {interval}" for k, interval in sorted(covered.items())) or "none of its time"
        raise InputError(where, f"no kernel of {_NAMES[reach[0]]} .. {_NAMES[reach[-1]]} holds {exposure}", near)
    return sorted(covered), True

"""When something was taken, or what a file covers: UTC as labels write it."""

from datetime import UTC, datetime, timedelta
from typing import NamedTuple

from mgsgraph.errors import InputError
from mgsgraph.io.pvl import Block

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
        found = cls(*(utc(label.text(key), label.where(key)) for key in ("START_TIME", "STOP_TIME")))
        if found.start > found.stop:
            raise InputError(label.where(), f"START_TIME {found.start} after STOP_TIME {found.stop}", "the reverse")
        return found

    @classmethod
    def said_by(cls, label: Block) -> "Interval | None":
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
    try:
        return datetime.fromisoformat(plain).replace(tzinfo=UTC)
    except ValueError:
        pass
    try:
        return datetime.strptime(plain.partition(".")[0], _DAY_OF_YEAR).replace(tzinfo=UTC)
    except ValueError:
        raise InputError(where, repr(text[:40]), "a time such as 1999-06-02T00:00:02") from None

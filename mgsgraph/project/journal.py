"""The journal of edits of single points, by which they are undone, and the measures that a person has set aside."""

import sqlite3
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import msgspec

from mgsgraph.errors import InputError
from mgsgraph.project.connection import ELSEWHERE, FILE


@dataclass(frozen=True, slots=True)
class Measure:
    """Image coordinates of a point."""

    image: str
    """Name of the image."""
    line: float
    """px, the first pixel's centre at 0.5."""
    sample: float
    """px."""
    sigma_line: float
    """px."""
    sigma_sample: float
    """px."""
    back_projected: bool = False
    """Whether it is a projection with the nominal orientation."""
    rejected: bool = False
    """Whether the last batch adjustment took it for a blunder."""


@dataclass(frozen=True, slots=True)
class PointRecord:
    """A point and its measures, as an edit finds and leaves them."""

    point_class: int
    """PointClass."""
    kind: int
    """PointKind."""
    place: tuple[float, float, float] | None = None
    """m, body-fixed, a-priori; None where unknown."""
    covariance: tuple[float, ...] = (0.0,) * 9
    """m^2, (3, 3) row by row, of that place; zeros unless the point is constrained."""
    surface_sigma: float | None = None
    """m, of its height above the terrain model; None for a point that doesn't lie on one."""
    measures: tuple[Measure, ...] = ()
    """Those that the adjustment has, by the names of their images."""
    set_aside: tuple[Measure, ...] = field(default=())
    """Those that a person has rejected, the same."""

    def __post_init__(self) -> None:
        for name in ("measures", "set_aside"):
            object.__setattr__(self, name, tuple(sorted(getattr(self, name), key=lambda one: one.image)))

    def of(self, image: str) -> Measure | None:
        """The measure in an image, if the adjustment has one."""
        return next((one for one in self.measures if one.image == image), None)

    def aside(self, image: str) -> Measure | None:
        """The measure in an image that has been set aside, if any."""
        return next((one for one in self.set_aside if one.image == image), None)

    def with_measure(self, measure: Measure) -> "PointRecord":
        """The same with a measure, in the place of any other in its image."""
        left = self.without(measure.image)
        return replace(left, measures=(*left.measures, measure))

    def without(self, image: str) -> "PointRecord":
        """The same without the measures in an image."""
        measures, aside = (tuple(m for m in ms if m.image != image) for ms in (self.measures, self.set_aside))
        return replace(self, measures=measures, set_aside=aside)

    def says_the_same(self, other: "PointRecord") -> bool:
        """Whether both are alike but for what a batch adjustment took for blunders."""
        one, two = (replace(r, measures=tuple(replace(m, rejected=False) for m in r.measures)) for r in (self, other))
        return one == two


@dataclass(frozen=True, slots=True)
class Edit:
    """An edit of a point."""

    change: int
    """Its number in the history."""
    point: str
    """Name of the point."""
    before: PointRecord | None
    """None where the point was not there."""
    after: PointRecord | None
    """None where it was taken out."""
    undone: int | None
    """Number of the change that took it back."""


_COLUMNS = "change, point, before, after, undone"


class Journal:
    """The tables of edits and of measures set aside, on an open connection."""

    def __init__(self, connection: sqlite3.Connection, where: str) -> None:
        self._connection, self._where = connection, where

    # --- edits

    def note(self, change: int, point: str, before: PointRecord | None, after: PointRecord | None) -> None:
        """Note an edit of a point."""
        texts = (None if one is None else msgspec.json.encode(one).decode() for one in (before, after))
        self._connection.execute(f"INSERT INTO edit ({_COLUMNS}) VALUES (?, ?, ?, ?, NULL)", (change, point, *texts))

    def take_back(self, change: int, by: int) -> None:
        """Note that a change has taken an edit back."""
        self._connection.execute("UPDATE edit SET undone = ? WHERE change = ?", (by, change))

    def last(self) -> Edit | None:
        """The last edit that has not been taken back; None where there is none."""
        return self._edit("undone IS NULL")

    def edit(self, change: int) -> Edit | None:
        """The edit that a change of the history was; None where it was none."""
        return self._edit("change = ?", change)

    def _edit(self, condition: str, *values: object) -> Edit | None:
        row = self._connection.execute(
            f"SELECT {_COLUMNS} FROM edit WHERE {condition} ORDER BY change DESC LIMIT 1", values
        ).fetchone()
        if row is None:
            return None
        change, point, before, after, undone = row
        return Edit(change, point, self._read(before, PointRecord), self._read(after, PointRecord), undone)

    # --- measures set aside

    def set_aside(self, point: str) -> tuple[Measure, ...]:
        """Measures of a point that have been set aside."""
        rows = self._connection.execute("SELECT measure FROM set_aside WHERE point = ?", (point,)).fetchall()
        return tuple(self._read(text, Measure) for (text,) in rows)

    def all_set_aside(self) -> dict[str, tuple[Measure, ...]]:
        """All measures that have been set aside, by point."""
        rows = self._connection.execute("SELECT DISTINCT point FROM set_aside ORDER BY point").fetchall()
        return {point: self.set_aside(point) for (point,) in rows}

    def put_set_aside(self, point: str, measures: Iterable[Measure]) -> None:
        """The measures of a point that are set aside from now on; others are not."""
        self._connection.execute("DELETE FROM set_aside WHERE point = ?", (point,))
        rows: Sequence[tuple[str, str, str]] = [
            (point, msgspec.json.encode(one).decode(), one.image) for one in measures
        ]
        self._connection.executemany(
            "INSERT INTO set_aside (point, measure, image) SELECT ?, ?, id FROM image WHERE name = ?", rows
        )

    def _read(self, text: str | None, kind: type[Any]) -> Any:
        if text is None:
            return None
        try:
            return msgspec.json.decode(text, type=kind)
        except msgspec.MsgspecError as error:
            raise InputError(self._where, f"{FILE} is damaged ({error})", remedy=ELSEWHERE) from None

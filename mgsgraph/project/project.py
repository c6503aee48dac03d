"""A project: a folder with an SQLite file (one transaction for each change) and the products of solutions."""

import importlib.metadata
import json
import re
import shutil
import sqlite3
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import msgspec

from mgsgraph.adjustment.settings import SolverSettings
from mgsgraph.atomic_write import made_beside, put_in_place, resolved
from mgsgraph.errors import InputError, errors_from, require
from mgsgraph.files.opening import understood
from mgsgraph.files.output.folders import PROJECT
from mgsgraph.files.writing import account, writing_to
from mgsgraph.geometry.image import LineTiming
from mgsgraph.geometry.plausibility import ImageTimes
from mgsgraph.names import image_names
from mgsgraph.project.connection import EXPECTED_PROJECT, RESTORE_COPY, connected, new_file
from mgsgraph.project.decisions import Decision, Decisions, Measure, PointState, combined
from mgsgraph.project.settings import ProjectSettings, settings_from_json, settings_to_json
from mgsgraph.project.store import ProjectStore
from mgsgraph.record import Record
from mgsgraph.results.archive import unpack_parts

if TYPE_CHECKING:
    from mgsgraph.adjustment.incremental.incremental import IncrementalAdjustment
    from mgsgraph.adjustment.incremental.state import StateStore
    from mgsgraph.adjustment.solution import Solution

class AdjustmentCache:
    """Keeps the adjustment with its Bayes tree in memory until another process changes the project."""

    def __init__(self) -> None:
        self._adjustment: IncrementalAdjustment | None = None
        self._last_change: object = None

    def resumed(self, change: object, settings: SolverSettings, store: "StateStore") -> "IncrementalAdjustment":
        """The adjustment of a project whose last change in its history is `change`: the cached one if it made this
        change and has the same settings, else a new one that starts from the store.
        """
        from mgsgraph.adjustment.incremental.incremental import IncrementalAdjustment

        cached = self._adjustment
        if cached is not None and change is not None and change == self._last_change and cached.settings == settings:
            cached.resume(store)
        else:
            cached = self._adjustment = IncrementalAdjustment(settings, store)
        self._last_change = None  # until the next change is recorded
        return cached

    def noted(self, change: object) -> None:
        """The cached adjustment has the state of the project after this change of the history."""
        self._last_change = change

    def forget(self) -> None:
        """Drop the cached adjustment: a change was rolled back."""
        self._adjustment = self._last_change = None


SOLUTIONS = "solutions"
"""Folder of the results, one folder each, in a project's folder."""
MATCHES = "matches"
"""Folder of the tie points found in its images, in a project's folder."""
_ANOTHER = "choose another one"
_TIMES = {"image.trajectory.epoch": float, "image.timing": LineTiming}
"""Parts of an image's record that contain the time of the image."""
CHANGING = ("add", "remove", "edit", "match", "undo", "redo")
"""Verbs of changes that add or remove measurements."""
_UNDOABLE = "former IS NOT NULL AND verb NOT IN ('undo', 'redo')"
"""SQL: changes of content that undo can take back."""
_Kind = TypeVar("_Kind")
_RESULT = re.compile(r"\d{4,}|\.\d{4,}\.[0-9a-f]{8}\.(unfinished|replaced)")
"""Names of result folders, complete or left by a killed process."""


class Change(msgspec.Struct, frozen=True):
    """One step of a project's history."""

    number: int
    """Number, from 1 on."""
    at: str
    """UTC, ISO 8601."""
    verb: str
    """init, match, add, remove, edit, align, undo, redo, solve or check."""
    what: str
    """Short description of the change."""
    summary: Mapping[str, Any]
    """Numbers, with units in their names."""
    who: str
    """Account of the user."""
    why: str
    """Reason that the user gave; empty for none."""
    stands: bool
    """False for a change that is undone."""
    undoes: int | None
    """Number of the change that an undo or redo is about."""


class SolutionRow(msgspec.Struct, frozen=True):
    """Record of a solution."""

    number: int
    """Number, from 1 on."""
    change: int
    """Number of the last change that the solution contains."""
    at: str
    """UTC, ISO 8601."""
    kind: str
    """batch or incremental."""
    converged: bool
    """Whether the adjustment converged."""
    message: str
    """Reason why the adjustment ended."""
    cost: float | None
    """Half the weighted sum of squared residuals; None where unknown."""
    sigma0: float | None
    """Standard deviation of unit weight; None without redundancy."""
    degrees_of_freedom: int | None
    """Degrees of freedom."""
    images: int
    """Number of images."""
    points: int
    """Number of points."""
    folder: str | None
    """Folder of its products, relative to the project's folder."""


class Project(Record):
    """An open project; made by `create_project` and `open_project`.

    Attributes
    ----------
    folder : Path
    store : ProjectStore
        State of the adjustment.
    cache : AdjustmentCache or None
        For a process that makes several changes.
    """

    def __init__(self, folder: Path, connection: sqlite3.Connection, cache: AdjustmentCache | None = None) -> None:
        self.folder, self.cache = folder, cache
        self.store = ProjectStore(connection, str(folder))
        self._connection = connection

    @staticmethod
    @contextmanager
    def create(
        folder: str | Path, name: str, settings: ProjectSettings, case: Path | None = None
    ) -> "Iterator[Project]":
        """Create a project: written beside the target folder and renamed at the end, so that it is complete or absent.

        It records the path of the case file that it is made from, if any.

        Raises
        ------
        InputError
            If the folder exists and isn't empty, or can't be written.
        """
        shown, target = str(folder), resolved(folder, _ANOTHER)
        remedy = "choose another folder, where you may write"
        with ExitStack() as stack:
            with writing_to(shown, remedy=remedy):
                _require_free(target, shown)
                temporary = stack.enter_context(made_beside(target, folder=True))
            with new_file(temporary, Path(folder)) as connection:
                project = Project(temporary, connection)
                project._introduce(name or target.name, settings, case)
                yield project
            with writing_to(shown, remedy=remedy):
                _require_free(target, shown)
                put_in_place(temporary, target)

    def _introduce(self, name: str, settings: ProjectSettings, case: Path | None) -> None:
        version = importlib.metadata.version("mgsgraph")
        facts = {"name": name, "created": _now(), "version": version, "settings": settings_to_json(settings)}
        if case is not None:
            facts["case"] = str(case.resolve())
        self._connection.executemany("INSERT INTO meta VALUES (?, ?)", facts.items())

    # --- facts

    def _fact(self, key: str) -> str:
        row = self._connection.execute("SELECT value FROM meta WHERE key = ?", (key,)).fetchone()
        if row is None:
            raise InputError(str(self.folder), f"no {key} in the table meta", remedy=RESTORE_COPY)
        return str(row[0])

    @property
    def name(self) -> str:
        """Name of the project."""
        return self._fact("name")

    @property
    def created(self) -> str:
        """UTC, ISO 8601."""
        return self._fact("created")

    @property
    def settings(self) -> ProjectSettings:
        """Settings for all images and measurements that are added."""
        return settings_from_json(self._fact("settings"), str(self.folder))

    @property
    def case(self) -> Path | None:
        """Path of the case file that the project was made from; None where there was none."""
        row = self._connection.execute("SELECT value FROM meta WHERE key = 'case'").fetchone()
        return None if row is None else Path(str(row[0]))

    @property
    def matches(self) -> Path:
        """Folder of the tie points that `mgsgraph match` has found for it, if it has."""
        return self.folder / MATCHES

    @property
    def matched_ties(self) -> Path | None:
        """File of these tie points; None where there is none."""
        network = self.matches / "network.pvl"
        return network if network.is_file() else None

    def content_facts(self) -> dict[str, str]:
        """Settings and paths of networks, as the file has them."""
        rows = "SELECT key, value FROM meta WHERE key IN ('settings', 'networks')"
        return dict(self._connection.execute(rows).fetchall())

    def restore_facts(self, facts: Mapping[str, str]) -> None:
        """Replace them by those of an earlier time."""
        self._connection.execute("DELETE FROM meta WHERE key IN ('settings', 'networks')")
        self._connection.executemany("INSERT INTO meta VALUES (?, ?)", facts.items())

    def take_settings(self, settings: ProjectSettings) -> None:
        """Replace the settings, before any adjustment has used them."""
        self._connection.execute("UPDATE meta SET value = ? WHERE key = 'settings'", (settings_to_json(settings),))

    def image_times(self) -> dict[str, ImageTimes]:
        """Time of each image, in the order of addition, without reading the rest of the records."""
        rows = self._connection.execute("SELECT name, record FROM image ORDER BY id")
        return {name: ImageTimes(*unpack_parts(data, _TIMES, f"{self.folder}, image {name}")) for name, data in rows}

    # --- where images come from

    def take_picture(self, image: str, picture: Path) -> None:
        """Record the file of an image's pixels."""
        self._connection.execute("UPDATE image SET picture = ? WHERE name = ?", (str(picture.resolve()), image))

    def pictures(self) -> dict[str, str | None]:
        """Recorded file of each image's pixels; None where unknown."""
        return dict(self._connection.execute("SELECT name, picture FROM image ORDER BY id").fetchall())

    def add_networks(self, files: Iterable[Path]) -> None:
        """Record files of tie points."""
        names = dict.fromkeys([*map(str, self.networks), *(str(file.resolve()) for file in files)])
        self._connection.execute("INSERT OR REPLACE INTO meta VALUES ('networks', ?)", (json.dumps(list(names)),))

    @property
    def networks(self) -> tuple[Path, ...]:
        """Recorded files of tie points."""
        row = self._connection.execute("SELECT value FROM meta WHERE key = 'networks'").fetchone()
        return () if row is None else tuple(map(Path, self._from_json(row[0], tuple[str, ...])))

    # --- history

    def images_named(self, asked: Iterable[str]) -> list[str]:
        """Names of images, each once, from names or unique parts of names."""
        with errors_from(str(self.folder)):
            return image_names(asked, self.store.image_names())

    def record(
        self, verb: str, what: str, summary: Mapping[str, Any], why: str = "", former: bytes | None = None,
        undoes: int | None = None,
    ) -> int:  # fmt: skip
        """Record a change, with the content that it replaced (`project.history`), if any; its number."""
        row = (_now(), verb, what, json.dumps(summary, ensure_ascii=False), account(), why, undoes, former)
        columns = "at, verb, what, summary, who, why, undoes, former"
        found = self._connection.execute(f"INSERT INTO change ({columns}) VALUES (?, ?, ?, ?, ?, ?, ?, ?)", row)
        return int(found.lastrowid or 0)

    def changes(self, last: int | None = None) -> list[Change]:
        """The last changes, or all, in their order."""
        return self._rows(Change, "change", "ORDER BY number DESC LIMIT ?", -1 if last is None else last)[::-1]

    def change(self, number: int) -> Change | None:
        """A change by its number; None where there is none."""
        return next(iter(self._rows(Change, "change", "WHERE number = ?", number)), None)

    def former(self, number: int) -> bytes | None:
        """The content that a change replaced; None where it replaced none."""
        row = self._connection.execute("SELECT former FROM change WHERE number = ?", (number,)).fetchone()
        return None if row is None else row[0]

    def mark(self, number: int, stands: bool) -> None:
        """Mark a change as undone, or as one that stands again; its decisions follow."""
        self._connection.execute("UPDATE change SET stands = ? WHERE number = ?", (int(stands), number))

    def standing_changes(self) -> list[int]:
        """Numbers of the changes that undo can take back, in their order."""
        return self._numbers(f"SELECT number FROM change WHERE {_UNDOABLE} AND stands ORDER BY number")

    def last_undo(self) -> int | None:
        """Number of the last undo that redo can take back: no new change follows it; None where there is none."""
        undone = "undoes IN (SELECT number FROM change WHERE NOT stands)"
        later = f"number > coalesce((SELECT max(number) FROM change WHERE {_UNDOABLE}), 0)"
        rest = f"verb = 'undo' AND {undone} AND {later} ORDER BY number DESC LIMIT 1"
        return next(iter(self._numbers(f"SELECT number FROM change WHERE {rest}")), None)

    def _numbers(self, statement: str) -> list[int]:
        return [number for (number,) in self._connection.execute(statement)]

    # --- decisions of users about points

    def record_decision(
        self, change: int, kind: str, point: str, image: str, measure: Measure | None, state: PointState | None
    ) -> None:
        """Record a decision about a point, or about its measurement in an image."""
        texts = (None if value is None else msgspec.json.encode(value).decode() for value in (measure, state))
        self._connection.execute(
            "INSERT INTO decision (change, kind, point, image, measure, state) VALUES (?, ?, ?, ?, ?, ?)",
            (change, kind, point, image, *texts),
        )

    def decisions(self, point: str | None = None) -> list[Decision]:
        """Decisions of changes that stand, about one point or about all, the latest last."""
        rows = self._connection.execute(
            "SELECT change, at, who, why, kind, point, image, measure, state FROM decision JOIN change "
            "ON change.number = decision.change WHERE stands AND point = coalesce(?, point) ORDER BY decision.number",
            (point,),
        )
        names, records = Decision.__struct_fields__, list[Decision]()
        for *values, measure, state in rows:
            parts = [None if text is None else self._from_json(text, dict[str, Any]) for text in (measure, state)]
            records.append(self._record(dict(zip(names, (*values, *parts), strict=True)), Decision))
        return records

    def standing_decisions(self, point: str | None = None) -> Decisions:
        """What stands after these decisions, by the name of the point."""
        return combined(self.decisions(point))

    def last_solution(self, kind: str | None = None) -> SolutionRow | None:
        """The latest solution, of one kind or of any; None where there is none."""
        return self._last("kind = coalesce(?, kind)", kind)

    def last_results(self) -> SolutionRow | None:
        """The latest solution with a folder of products (a check against batch has none); None where there is none."""
        return self._last("folder IS NOT NULL")

    def _last(self, condition: str, *values: object) -> SolutionRow | None:
        """The latest solution that fulfills an SQL condition; None where there is none."""
        rest = f"WHERE {condition} ORDER BY number DESC LIMIT 1"
        return next(iter(self._rows(SolutionRow, "solution", rest, *values)), None)

    def _rows(self, kind: type[_Kind], table: str, rest: str, *values: object) -> list[_Kind]:
        """Rows of a table as records of a kind, which has a field for each column, of the same name."""
        names = [field.name for field in msgspec.structs.fields(kind)]  # type: ignore[arg-type]
        rows = self._connection.execute(f"SELECT {', '.join(names)} FROM {table} {rest}", values)
        records = (dict(zip(names, row, strict=True)) for row in rows)
        return [
            self._record({key: self._from_json(value, dict[str, Any]) if key == "summary" else value
                          for key, value in row.items()}, kind)
            for row in records
        ]  # fmt: skip

    def _from_json(self, text: object, kind: type[_Kind]) -> _Kind:
        """Value of a kind from a cell of JSON; InputError where it does not fit."""
        with understood(str(self.folder), EXPECTED_PROJECT, RESTORE_COPY):
            return self._record(json.loads(str(text)), kind)

    def _record(self, value: object, kind: type[_Kind]) -> _Kind:
        """Record of a kind from a value; InputError where it does not fit."""
        try:
            return msgspec.convert(value, kind, strict=False)
        except msgspec.ValidationError as error:
            raise InputError(str(self.folder), f"{PROJECT} is damaged ({error})", remedy=RESTORE_COPY) from None

    def record_incremental(self, converged: bool, message: str) -> int:
        """Record an incremental solution that contains the last change; its number."""
        (points,) = self._connection.execute("SELECT coalesce(sum(points), 0) FROM bundle").fetchone()
        images = len(self.store.image_names())
        return self._insert_solution(converged, message, None, None, None, images, points, None, "incremental")

    def keep_solution(self, solution: "Solution", write: Callable[[Path], object]) -> Path:
        """Write a batch solution's products to a new folder by the function `write`, and record it; the folder."""
        self._sweep()
        following = "SELECT coalesce(max(seq), 0) + 1 FROM sqlite_sequence WHERE name = 'solution'"
        (number,) = self._connection.execute(following).fetchone()
        folder = f"{SOLUTIONS}/{number:04d}"
        write(self.folder / folder)
        self.record_batch(solution, folder)
        return self.folder / folder

    def record_batch(self, solution: "Solution", folder: str | None = None) -> int:
        """Record a batch solution and the folder of its products, if any; its number."""
        network = solution.network
        return self._insert_solution(
            solution.converged, solution.message, solution.cost_final, solution.sigma0,
            solution.fit.degrees_of_freedom, len(network.images), len(network.points), folder, "batch",
        )  # fmt: skip

    def _insert_solution(self, *values: object) -> int:
        cursor = self._connection.execute(
            "INSERT INTO solution (change, at, converged, message, cost, sigma0, degrees_of_freedom, images, points, "
            "folder, kind) SELECT coalesce(max(number), 0), ?, ?, ?, ?, ?, ?, ?, ?, ?, ? FROM change",
            (_now(), *values),
        )
        return int(cursor.lastrowid or 0)

    def _sweep(self) -> None:
        """Delete result folders without a recorded solution: a killed process has left them."""
        known = {row[0] for row in self._connection.execute("SELECT folder FROM solution WHERE folder IS NOT NULL")}
        solutions = self.folder / SOLUTIONS
        for path in sorted(solutions.iterdir()) if solutions.is_dir() else []:
            is_result = path.name.startswith(".") or (path / "solution.json").is_file()
            if path.is_dir() and is_result and _RESULT.fullmatch(path.name) and f"{SOLUTIONS}/{path.name}" not in known:
                shutil.rmtree(path, ignore_errors=True)

    # --- counts

    @property
    def held_images(self) -> int:
        """Number of images with held orientation."""
        (count,) = self._connection.execute("SELECT count(*) FROM image WHERE held").fetchone()
        return int(count)

    def bundle_images(self) -> list[tuple[str, int, int]]:
        """Image name, bundle number and number of the bundle's points, for each image of each bundle."""
        return self._connection.execute(
            "SELECT image.name, bundle.id, bundle.points FROM bundle "
            "JOIN bundle_image ON bundle_image.bundle = bundle.id JOIN image ON image.id = bundle_image.image"
        ).fetchall()

    def __repr__(self) -> str:
        return f"Project({self.name!r} in {self.folder}, {len(self.store.image_names())} images)"


@contextmanager
def open_project(
    folder: str | Path, write: bool = False, cache: AdjustmentCache | None = None, discard: bool = False
) -> Iterator[Project]:
    """Open a project for one change, or for reading, in a `with` statement. An exception inside rolls the change back.

    Parameters
    ----------
    folder : path
        The project.
    write : bool
        Open it for a change: no other process may change it in the meantime.
    cache : AdjustmentCache, optional
        Keeps the adjustment in memory for the next change of this process.
    discard : bool
        At the end nothing has changed, as after an exception.

    Raises
    ------
    InputError
        If there is no project, it can't be read or written, or another process is changing it.

    Examples
    --------
    >>> _ = mgsgraph.create_project("opened", case="pair/case.toml")
    >>> with mgsgraph.open_project("opened") as project:
    ...     print([change.verb for change in project.changes()])
    ['init']
    """
    path = Path(folder)
    try:
        with connected(path, write, discard) as connection:
            project = Project(path, connection, cache)
            with understood(str(folder), EXPECTED_PROJECT, RESTORE_COPY):
                project.store.require_whole()
            yield project
    except BaseException:
        if cache is not None:  # it may differ from the file
            cache.forget()
        raise


def _require_free(target: Path, shown: str) -> None:
    require(not target.exists() or target.is_dir(), shown, "exists and is a file", "a folder for the project", _ANOTHER)
    if target.is_dir() and any(target.iterdir()):
        raise InputError(shown, "exists and is not empty", "an absent or empty folder", _ANOTHER)


def _now() -> str:
    return datetime.now(UTC).isoformat(timespec="seconds")


def rejected_measurements(project: Project) -> list[tuple[str, Measure]]:
    """Point and image measurement of all that users have rejected, in images of the project."""
    names = set(project.store.image_names())
    return [
        (point, measure) for point, of in project.standing_decisions().items()
        for image, measure in of.rejected.items() if image in names
    ]  # fmt: skip

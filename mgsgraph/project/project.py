"""A kept project: a folder with an SQLite file (the state, one transaction per change) and its solutions' products."""

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
from mgsgraph.atomic_write import made_beside, resolved
from mgsgraph.errors import InputError, errors_from
from mgsgraph.files.opening import understood
from mgsgraph.files.output.folders import PROJECT
from mgsgraph.files.writing import writing_to
from mgsgraph.geometry.image import LineTiming
from mgsgraph.geometry.plausibility import ImageTimes
from mgsgraph.names import image_names
from mgsgraph.project.connection import A_PROJECT, ELSEWHERE, connected, made
from mgsgraph.project.settings import ProjectSettings, settings_from_json, settings_to_json
from mgsgraph.project.store import ProjectStore
from mgsgraph.record import Record
from mgsgraph.results.archive import unpack_parts

if TYPE_CHECKING:
    from mgsgraph.adjustment.incremental.incremental import IncrementalAdjustment
    from mgsgraph.adjustment.incremental.state import StateStore
    from mgsgraph.adjustment.solution import Solution

class KeptAdjustment:
    """An adjustment with its tree, for as long as no other process changes the project."""

    def __init__(self) -> None:
        self._adjustment: IncrementalAdjustment | None = None
        self._after: object = None

    def resumed(self, after: object, settings: SolverSettings, store: "StateStore") -> "IncrementalAdjustment":
        """The adjustment of a project whose last change, as its history has it, is `after`: the one that is kept, if it
        has made that change itself and has the same settings, else one that begins with what the store holds.
        """
        from mgsgraph.adjustment.incremental.incremental import IncrementalAdjustment

        kept = self._adjustment
        if kept is not None and after is not None and after == self._after and kept.settings == settings:
            kept.resume(store)
        else:
            kept = self._adjustment = IncrementalAdjustment(settings, store)
        self._after = None  # until the change that comes is noted
        return kept

    def noted(self, change: object) -> None:
        """What the adjustment holds is what the project is after a change, as its history has it."""
        self._after = change

    def forget(self) -> None:
        """Begin anew the next time: a change was not carried out."""
        self._adjustment = self._after = None


SOLUTIONS = "solutions"
"""Folder of the results, one folder each, in a project's folder."""
MATCHES = "matches"
"""Folder of the tie points found in its images, in a project's folder."""
_ANOTHER = "choose another one"
_TIMES = {"image.trajectory.epoch": float, "image.timing": LineTiming}
"""Of an image's record, what says when it was taken."""
CHANGING = ("add", "remove", "edit")
"""Verbs of changes that put measures in or take them out."""
_Kind = TypeVar("_Kind")
_RESULT = re.compile(r"\d{4,}|\.\d{4,}\.[0-9a-f]{8}\.(unfinished|replaced)")
"""Names of these, whole or left over by a process that was killed."""


class Change(msgspec.Struct, frozen=True):
    """One step of a project's history."""

    number: int
    """Number, from 1 on."""
    at: str
    """UTC, ISO 8601."""
    verb: str
    """init, match, add, remove, edit, solve, check or align (coregister up to version 0.2)."""
    what: str
    """What was changed, in a few words."""
    summary: Mapping[str, Any]
    """Numbers, with units in their names."""


class EditRow(msgspec.Struct, frozen=True):
    """A change of a point, as the journal has it."""

    number: int
    kind: str
    point: str
    before: str | None
    """JSON (`PointState`); None where there was no such point."""
    after: str | None
    """JSON; None where there is none any longer."""


class SolutionRow(msgspec.Struct, frozen=True):
    """Record of a solution."""

    number: int
    """Number, from 1 on."""
    change: int
    """Number of the last change that it knows of."""
    at: str
    """UTC, ISO 8601."""
    kind: str
    """batch or incremental."""
    converged: bool
    """Whether the adjustment converged."""
    message: str
    """Reason why the adjustment ended."""
    cost: float | None
    """Half the weighted sum of squares; None where nothing is known of it."""
    sigma0: float | None
    """Of unit weight; None without redundancy."""
    degrees_of_freedom: int | None
    """Degrees of freedom."""
    images: int
    """Number of images."""
    points: int
    """Number of points."""
    folder: str | None
    """Of its products, in the project's folder."""


class Project(Record):
    """An open project; made by `create_project` and `open_project`.

    Attributes
    ----------
    folder : Path
    store : ProjectStore
        State of the adjustment.
    kept : KeptAdjustment or None
        Of a process that makes several changes.
    """

    def __init__(self, folder: Path, connection: sqlite3.Connection, kept: KeptAdjustment | None = None) -> None:
        self.folder, self.kept = folder, kept
        self.store = ProjectStore(connection, str(folder))
        self._connection = connection

    @staticmethod
    @contextmanager
    def create(
        folder: str | Path, name: str, settings: ProjectSettings, case: Path | None = None
    ) -> "Iterator[Project]":
        """Make a project: written beside its place and renamed into it at the end, so that it is whole or not there.

        It remembers the case file that it begins with, if any.

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
                aside = stack.enter_context(made_beside(target, folder=True))
            with made(aside, Path(folder)) as connection:
                project = Project(aside, connection)
                project._introduce(name or target.name, settings, case)
                yield project
            with writing_to(shown, remedy=remedy):
                _require_free(target, shown)
                aside.rename(target)

    def _introduce(self, name: str, settings: ProjectSettings, case: Path | None) -> None:
        version = importlib.metadata.version("mgsgraph")
        facts = {"name": name, "created": _now(), "version": version, "settings": settings_to_json(settings)}
        if case is not None:
            facts["case"] = str(case.resolve())
        self._connection.executemany("INSERT INTO meta VALUES (?, ?)", facts.items())

    # --- facts

    def _fact(self, key: str) -> str:
        found = self._connection.execute("SELECT value FROM meta WHERE key = ?", (key,)).fetchone()
        if found is None:
            raise InputError(str(self.folder), f"no {key} in the table meta", remedy=ELSEWHERE)
        return str(found[0])

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
        """What holds for every image and measure that is added."""
        return settings_from_json(self._fact("settings"), str(self.folder))

    @property
    def case(self) -> Path | None:
        """The case file that it began with, where it was then; None where there was none."""
        found = self._connection.execute("SELECT value FROM meta WHERE key = 'case'").fetchone()
        return None if found is None else Path(str(found[0]))

    @property
    def matches(self) -> Path:
        """Folder of the tie points that `mgsgraph match` has found for it, if it has."""
        return self.folder / MATCHES

    def take_settings(self, settings: ProjectSettings) -> None:
        """Settings in place of those that it had, before anything has been adjusted by them."""
        self._connection.execute("UPDATE meta SET value = ? WHERE key = 'settings'", (settings_to_json(settings),))

    def image_times(self) -> dict[str, ImageTimes]:
        """When each image was taken, in the order in which they came; the rest of their records stays unread."""
        rows = self._connection.execute("SELECT name, record FROM image ORDER BY id")
        return {name: ImageTimes(*unpack_parts(data, _TIMES, f"{self.folder}, image {name}")) for name, data in rows}

    # --- where images come from

    def take_picture(self, image: str, picture: Path) -> None:
        """Remember the file of an image's pixels."""
        self._connection.execute("UPDATE image SET picture = ? WHERE name = ?", (str(picture.resolve()), image))

    def pictures(self) -> dict[str, str | None]:
        """File of each image's pixels, where it was then; None where it isn't known."""
        return dict(self._connection.execute("SELECT name, picture FROM image ORDER BY id").fetchall())

    def add_networks(self, files: Iterable[Path]) -> None:
        """Remember files of tie points."""
        names = dict.fromkeys([*map(str, self.networks), *(str(file.resolve()) for file in files)])
        self._connection.execute("INSERT OR REPLACE INTO meta VALUES ('networks', ?)", (json.dumps(list(names)),))

    @property
    def networks(self) -> tuple[Path, ...]:
        """Files of tie points that it was given, where they were then."""
        found = self._connection.execute("SELECT value FROM meta WHERE key = 'networks'").fetchone()
        return () if found is None else tuple(map(Path, self._from_json(found[0], tuple[str, ...])))

    # --- history

    def images_named(self, asked: Iterable[str]) -> list[str]:
        """Names of images, each once, by their names or parts of names that no other has."""
        with errors_from(str(self.folder)):
            return image_names(asked, self.store.image_names())

    def record(self, verb: str, what: str, summary: Mapping[str, Any]) -> int:
        """Record a change; its number."""
        row = (_now(), verb, what, json.dumps(summary, ensure_ascii=False))
        found = self._connection.execute("INSERT INTO change (at, verb, what, summary) VALUES (?, ?, ?, ?)", row)
        return int(found.lastrowid or 0)

    def changes(self, last: int | None = None) -> list[Change]:
        """The last changes, or all, in their order."""
        return self._rows(Change, "change", "ORDER BY number DESC LIMIT ?", -1 if last is None else last)[::-1]

    # --- changes of single points

    def record_edit(self, *row: int | str | None) -> None:
        """Note a change of a point (`project.edits`) in the journal: change, kind, point, before, after, undoes."""
        columns = "change, kind, point, before, after, undoes"
        self._connection.execute(f"INSERT INTO edit ({columns}) VALUES (?, ?, ?, ?, ?, ?)", row)

    def last_edit(self, undone: bool = False) -> EditRow | None:
        """The last change of a point that has not been undone; or the last undo that has not been redone, where only
        undo, redo and solve came after it. None where there is none.
        """
        back = "number NOT IN (SELECT change FROM edit WHERE kind IN ('undo', 'redo'))"
        newest = f"SELECT max(number) FROM change WHERE verb <> 'solve' AND {back}"
        kind = f"kind = 'undo' AND change > ({newest})" if undone else "kind <> 'undo'"
        stands = "number NOT IN (SELECT undoes FROM edit WHERE undoes IS NOT NULL)"
        return next(iter(self._rows(EditRow, "edit", f"WHERE {kind} AND {stands} ORDER BY number DESC LIMIT 1")), None)

    def edit(self, change: int) -> EditRow | None:
        """The change of a point that a change of the history was; None where it was none."""
        return next(iter(self._rows(EditRow, "edit", "WHERE change = ?", change)), None)

    def undone_by(self, number: int) -> int | None:
        """Number in the history of what undid a change of a point, which has its number in the journal."""
        found = self._connection.execute("SELECT change FROM edit WHERE undoes = ?", (number,)).fetchone()
        return None if found is None else int(found[0])

    def edited_points(self) -> list[str]:
        """Points that a person has changed."""
        rows = self._connection.execute("SELECT DISTINCT point FROM edit ORDER BY point")
        return [point for (point,) in rows]

    def last_edit_of(self, point: str) -> tuple[int, str | None] | None:
        """Number of the last change of a point, and its state since; None where nobody has changed it."""
        found = self._connection.execute(
            "SELECT number, after FROM edit WHERE point = ? ORDER BY number DESC LIMIT 1", (point,)
        ).fetchone()
        return None if found is None else (int(found[0]), found[1])

    def last_solution(self, kind: str | None = None) -> SolutionRow | None:
        """The latest one, of a kind or of any; None before the first."""
        return self._last("kind = coalesce(?, kind)", kind)

    def last_results(self) -> SolutionRow | None:
        """The latest one that has a folder of products, which a closing check has not; None before the first."""
        return self._last("folder IS NOT NULL")

    def _last(self, condition: str, *values: object) -> SolutionRow | None:
        """The latest solution for which a condition of ours holds."""
        rest = f"WHERE {condition} ORDER BY number DESC LIMIT 1"
        return next(iter(self._rows(SolutionRow, "solution", rest, *values)), None)

    def _rows(self, kind: type[_Kind], table: str, rest: str, *values: object) -> list[_Kind]:
        """Rows of a table as records of a kind, whose fields are called as its columns."""
        names = [field.name for field in msgspec.structs.fields(kind)]  # type: ignore[arg-type]
        rows = self._connection.execute(f"SELECT {', '.join(names)} FROM {table} {rest}", values)
        found = (dict(zip(names, row, strict=True)) for row in rows)
        return [
            self._record({key: self._from_json(one, dict[str, Any]) if key == "summary" else one
                          for key, one in row.items()}, kind)
            for row in found
        ]  # fmt: skip

    def _from_json(self, text: object, kind: type[_Kind]) -> _Kind:
        """A cell of JSON as a value of a kind; InputError where it is none."""
        with understood(str(self.folder), A_PROJECT, ELSEWHERE):
            return self._record(json.loads(str(text)), kind)

    def _record(self, value: object, kind: type[_Kind]) -> _Kind:
        """A value as a record of a kind; InputError where it is none."""
        try:
            return msgspec.convert(value, kind, strict=False)
        except msgspec.ValidationError as error:
            raise InputError(str(self.folder), f"{PROJECT} is damaged ({error})", remedy=ELSEWHERE) from None

    def record_incremental(self, converged: bool, message: str) -> int:
        """Note that the state is adjusted as far as the last change; the solution's number."""
        (points,) = self._connection.execute("SELECT coalesce(sum(points), 0) FROM bundle").fetchone()
        images = len(self.store.image_names())
        return self._insert_solution((converged, message, None, None, None, images, points, None, "incremental"))

    def keep_solution(self, solution: "Solution", write: Callable[[Path], object]) -> Path:
        """Write a batch solution's products to a folder of their own, by a function of it, and note it; that folder."""
        self._sweep()
        following = "SELECT coalesce(max(seq), 0) + 1 FROM sqlite_sequence WHERE name = 'solution'"
        (number,) = self._connection.execute(following).fetchone()
        folder = f"{SOLUTIONS}/{number:04d}"
        write(self.folder / folder)
        self.record_batch(solution, folder)
        return self.folder / folder

    def record_batch(self, solution: "Solution", folder: str | None = None) -> int:
        """Note a batch solution of everything, and the folder of its products, if it has any; its number."""
        network = solution.network
        return self._insert_solution(
            (
                solution.converged, solution.message, solution.cost_final, solution.sigma0,
                solution.fit.degrees_of_freedom, len(network.images), len(network.points), folder, "batch",
            )
        )  # fmt: skip

    def _insert_solution(self, values: tuple[object, ...]) -> int:
        found = self._connection.execute(
            "INSERT INTO solution (change, at, converged, message, cost, sigma0, degrees_of_freedom, images, points, "
            "folder, kind) SELECT coalesce(max(number), 0), ?, ?, ?, ?, ?, ?, ?, ?, ?, ? FROM change",
            (_now(), *values),
        )
        return int(found.lastrowid or 0)

    def _sweep(self) -> None:
        """Take away result folders that no solution knows: whoever wrote them was killed before he could say so."""
        known = {row[0] for row in self._connection.execute("SELECT folder FROM solution WHERE folder IS NOT NULL")}
        solutions = self.folder / SOLUTIONS
        for path in sorted(solutions.iterdir()) if solutions.is_dir() else []:
            ours = path.name.startswith(".") or (path / "solution.json").is_file()
            if path.is_dir() and ours and _RESULT.fullmatch(path.name) and f"{SOLUTIONS}/{path.name}" not in known:
                shutil.rmtree(path, ignore_errors=True)

    # --- counts

    @property
    def held_images(self) -> int:
        """Number of images whose orientation is not adjusted."""
        (count,) = self._connection.execute("SELECT count(*) FROM image WHERE held").fetchone()
        return int(count)

    def bundle_images(self) -> list[tuple[str, int, int]]:
        """Name of the image, number of the bundle and number of its points, for each image of each bundle."""
        return self._connection.execute(
            "SELECT image.name, bundle.id, bundle.points FROM bundle "
            "JOIN bundle_image ON bundle_image.bundle = bundle.id JOIN image ON image.id = bundle_image.image"
        ).fetchall()

    def __repr__(self) -> str:
        return f"Project({self.name!r} in {self.folder}, {len(self.store.image_names())} images)"


@contextmanager
def open_project(
    folder: str | Path, write: bool = False, kept: KeptAdjustment | None = None
) -> Iterator[Project]:
    """Open a project for one change, or for reading, in a `with` statement.

    On any exception inside, nothing has changed.

    Parameters
    ----------
    folder : path
        The project.
    write : bool
        For a change: no other process may change it meanwhile.
    kept : KeptAdjustment, optional
        The adjustment after this process' last change, for the next one.

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
        with connected(path, write) as connection:
            project = Project(path, connection, kept)
            with understood(str(folder), A_PROJECT, ELSEWHERE):
                project.store.require_whole()
            yield project
    except BaseException:
        if kept is not None:  # it may hold what the file does not
            kept.forget()
        raise


def _require_free(target: Path, shown: str) -> None:
    if target.exists() and not target.is_dir():
        raise InputError(shown, "exists and is a file", "a folder for the project", _ANOTHER)
    if target.is_dir() and any(target.iterdir()):
        raise InputError(shown, "exists and is not empty", "an absent or empty folder", _ANOTHER)


def _now() -> str:
    return datetime.now(UTC).isoformat(timespec="seconds")


class Measure(msgspec.Struct, frozen=True):
    """A point's place in an image, as it was measured."""

    image: str
    line: float
    """px, the first pixel's centre at 0.5."""
    sample: float
    """px."""
    sigma_line: float
    """px."""
    sigma_sample: float
    """px."""
    back_projected: bool = False
    """Whether it repeats the nominal orientation as if measured."""
    rejected: bool = False
    """Whether the last batch adjustment holds it for a blunder."""


class PointState(msgspec.Struct, frozen=True):
    """What is known of a point beforehand."""

    class_: int
    """PointClass."""
    kind: int
    """PointKind."""
    place: tuple[float, float, float] | None
    """m, body-fixed, a-priori; None where unknown."""
    covariance: tuple[float, ...]
    """(9) m^2 of it, row by row."""
    measures: tuple[Measure, ...]
    """In images, those that take part."""
    set_aside: tuple[Measure, ...] = ()
    """Those that a person has rejected."""
    surface_sigma: float | None = None
    """m, of its height above the terrain model; None for a point that does not lie on one."""

    def of(self, image: str) -> Measure | None:
        """The measure in an image; None where there is none that takes part."""
        return next((one for one in self.measures if one.image == image), None)


def state_of(project: Project, text: str) -> PointState:
    """A state as the journal has it; InputError where it is damaged."""
    try:
        return msgspec.json.decode(text, type=PointState)
    except msgspec.MsgspecError as error:
        raise InputError(str(project.folder), f"{PROJECT} is damaged ({error})", remedy=ELSEWHERE) from None


def last_state(project: Project, point: str) -> PointState | None:
    """A point as its last change left it, set aside measures in images that are there; None: never changed, or out."""
    last = project.last_edit_of(point)
    if last is None or last[1] is None:
        return None
    state, there = state_of(project, last[1]), set(project.store.image_names())
    kept = tuple(one for one in state.set_aside if one.image in there)
    return msgspec.structs.replace(state, set_aside=kept)


def all_set_aside(project: Project) -> dict[str, tuple[Measure, ...]]:
    """Measures that a person has rejected, by point."""
    found = {point: last_state(project, point) for point in project.edited_points()}
    return {point: state.set_aside for point, state in found.items() if state is not None and state.set_aside}

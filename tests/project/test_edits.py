"""Edits of single points: they end at batch of the edited network, undo gives back the same, nothing is lost.

The network that is expected is kept by the test itself, point by point, and laid out anew each time.
"""

import os
import signal
import sqlite3
import time
import warnings
from collections.abc import Callable
from copy import deepcopy
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from shutil import copytree
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from increments import NOISE, apart, distances, fan, network_of, places_of, state_of

from mgsgraph.adjustment.adjust import adjust_network
from mgsgraph.case.schema import OrientationInput
from mgsgraph.errors import InputError
from mgsgraph.geometry.body import east_north_up
from mgsgraph.incremental.incremental import IncrementalAdjustment
from mgsgraph.network import Network, PointClass
from mgsgraph.network.observations import observed
from mgsgraph.network.parts import KnownImage
from mgsgraph.project import edits
from mgsgraph.project.changes import incremental, remove, solve
from mgsgraph.project.project import Project, open_project
from mgsgraph.project.settings import MeasuresInput, ProjectSettings
from mgsgraph.project.status import status
from mgsgraph.ties import PointKind, TiePoints
from mgsgraph.units import MRAD

IMAGES = 4
SETTINGS = ProjectSettings(
    OrientationInput(position_sigma_m=NOISE.position, angle_sigma_mrad=NOISE.angle / MRAD, trend=NOISE.trend),
    measures=MeasuresInput(NOISE.tie, 1.0, NOISE.shot_image),
)


@dataclass
class Tie:
    """A tie point as the test keeps it: line, sample and sigma by image."""

    measures: dict[str, tuple[float, float, float]] = field(default_factory=dict)
    aside: dict[str, tuple[float, float, float]] = field(default_factory=dict)
    place: Any = None
    sigmas: tuple[float, float, float] | None = None


Ties = dict[str, Tie]


@cache
def _ties() -> Ties:
    ties = fan(IMAGES).ties
    found = {name: Tie() for name in ties.ids}
    for point, image, place, sigma in zip(
        ties.measure_point.tolist(), ties.measure_image, ties.measures.tolist(), ties.measure_sigmas, strict=True
    ):
        size = NOISE.tie if np.isnan(sigma[0]) else float(sigma[0])
        found[ties.ids[point]].measures[image] = (*place, size)
    return found


def expected_network(ties: Ties) -> Network:
    """All of it as one network, made without any edit."""
    rows = [(k, image, *one) for k, tie in enumerate(ties.values()) for image, one in tie.measures.items()]
    held = [tie.place is not None for tie in ties.values()]
    kinds = [
        PointKind.FREE if tie.place is None else PointKind.CONSTRAINED if any(tie.sigmas or ()) else PointKind.FIXED
        for tie in ties.values()
    ]
    places = np.array([tie.place if there else [np.nan] * 3 for tie, there in zip(ties.values(), held, strict=True)])
    covariances = np.zeros((len(ties), 3, 3))
    for k, tie in enumerate(ties.values()):
        if kinds[k] == PointKind.CONSTRAINED:
            axes = east_north_up(places[k][None])[0]
            covariances[k] = axes.T @ np.diag(np.square(tie.sigmas)) @ axes
    sigmas = np.array([[row[4]] * 2 for row in rows])
    all_ties = TiePoints(
        "expected", tuple(ties), np.array(kinds), places, covariances, np.array([row[0] for row in rows]),
        tuple(row[1] for row in rows), np.array([row[2:4] for row in rows]), sigmas,
    )  # fmt: skip
    made = fan(IMAGES)
    images = {image.name: KnownImage(image, NOISE.prior) for image in made.images}
    network = observed(images, [all_ties, *made.lasers], NOISE.tie, NOISE.shot_image)
    assert network is not None
    return network


@pytest.fixture(scope="module")
def solved(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A solved project; to be copied."""
    folder = tmp_path_factory.mktemp("edits") / "project"
    with Project.create(folder, "edited", SETTINGS) as project:
        solution = adjust_network(expected_network(_ties()), SETTINGS.solver.settings)
        IncrementalAdjustment(SETTINGS.solver.settings, project.store).adopt(solution)
        project.record("solve", f"{IMAGES} images", {})
        project.record_batch(solution)
    return folder


@pytest.fixture
def folder(solved: Path, tmp_path: Path) -> Path:
    return Path(copytree(solved, tmp_path / "project"))


# --- random edits


class Editor:
    """Random edits of a project and of what the test expects of it."""

    def __init__(self, seed: int) -> None:
        self.rng, self.ties = np.random.default_rng(seed), deepcopy(_ties())
        self.before = list[tuple[str, Tie | None]]()

    def step(self, project: Project) -> str:
        """One edit that may be made; its name."""
        kind = str(self.rng.choice(["new_point", "measure", "move", "reject", "accept", "hold", "release", "remove",
                                    "undo"]))  # fmt: skip
        done: Callable[[Project], str | None] = getattr(self, kind)
        found = done(project)
        return self.step(project) if found is None else found

    def _chosen(self, good: Callable[[Tie], bool]) -> str | None:
        names = [name for name, tie in self.ties.items() if good(tie)]
        return None if not names else str(self.rng.choice(names))

    def _note(self, name: str) -> None:
        self.before.append((name, deepcopy(self.ties.get(name))))

    def new_point(self, project: Project) -> str | None:
        model = self.ties[str(self._chosen(lambda tie: len(tie.measures) > 1))]
        name = edits.next_name(project)
        self._note(name)
        measures = {i: (one[0], min(one[1] + 0.3, 400.0), 0.7) for i, one in model.measures.items()}
        edits.new_point(project, name, {i: one[:2] for i, one in measures.items()}, 0.7)
        self.ties[name] = Tie(measures)
        return f"new {name}"

    def measure(self, project: Project) -> str | None:
        """Of a point whose measure has been taken out, or that a copy sees elsewhere: here a measure comes anew."""
        name = self._chosen(lambda tie: len(tie.measures) > 2)
        if name is None:
            return None
        image = str(self.rng.choice(list(self.ties[name].measures)))
        place = self.ties[name].measures[image]
        self._note(name)
        edits.reject(project, name, image)
        self.ties[name].aside[image] = self.ties[name].measures.pop(image)
        with pytest.raises(InputError):
            edits.measure(project, name, image, place[:2])
        return f"reject {name} {image}"

    def move(self, project: Project) -> str | None:
        name = str(self._chosen(lambda tie: bool(tie.measures)))
        image = str(self.rng.choice(list(self.ties[name].measures)))
        line, sample, sigma = self.ties[name].measures[image]
        line, sample = (float(v) for v in np.array([line, sample]) + self.rng.normal(size=2) * 0.3)
        if min(line, sample) < 0.0:
            return None
        self._note(name)
        edits.move(project, name, image, (line, sample))
        self.ties[name].measures[image] = (line, sample, sigma)
        return f"move {name} {image}"

    def reject(self, project: Project) -> str | None:
        name = self._chosen(lambda tie: len(tie.measures) > 1)
        if name is None:
            return None
        self._note(name)
        image = str(self.rng.choice(list(self.ties[name].measures)))
        edits.reject(project, name, image)
        self.ties[name].aside[image] = self.ties[name].measures.pop(image)
        return f"reject {name} {image}"

    def accept(self, project: Project) -> str | None:
        name = self._chosen(lambda tie: bool(tie.aside))
        if name is None:
            return None
        self._note(name)
        image = str(self.rng.choice(list(self.ties[name].aside)))
        edits.accept(project, name, image)
        self.ties[name].measures[image] = self.ties[name].aside.pop(image)
        return f"accept {name} {image}"

    def hold(self, project: Project) -> str | None:
        name = str(self._chosen(lambda tie: bool(tie.measures)))
        made = fan(IMAGES)
        names = list(made.ties.ids)
        if name not in names:
            return None
        place = np.asarray(made.true_ties[names.index(name)])
        sigmas = (2.0, 3.0, 4.0) if self.rng.random() < 0.7 else (0.0, 0.0, 0.0)
        self._note(name)
        edits.hold(project, name, place, sigmas)
        self.ties[name].place, self.ties[name].sigmas = place, sigmas
        return f"hold {name} {sigmas}"

    def release(self, project: Project) -> str | None:
        name = self._chosen(lambda tie: tie.place is not None)
        if name is None:
            return None
        self._note(name)
        edits.release(project, name)
        self.ties[name].place = self.ties[name].sigmas = None
        return f"release {name}"

    def remove(self, project: Project) -> str | None:
        name = str(self._chosen(lambda tie: True))
        self._note(name)
        edits.remove_point(project, name)
        del self.ties[name]
        return f"remove {name}"

    def undo(self, project: Project) -> str | None:
        if not self.before:
            return None
        name, was = self.before.pop()
        edits.undo(project)
        if was is None:
            del self.ties[name]
        else:
            self.ties[name] = was
        return f"undo {name}"


@settings(max_examples=6, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.integers(0, 2**31), st.integers(3, 9))
def test_edits_end_at_batch_of_the_edited_network(
    solved: Path, tmp_path_factory: pytest.TempPathFactory, seed: int, count: int
) -> None:
    folder = Path(copytree(solved, tmp_path_factory.mktemp("one") / "project"))
    editor = Editor(seed)
    done = list[str]()
    for _ in range(count):
        with open_project(folder, write=True) as project:
            done.append(editor.step(project))
    batch = adjust_network(expected_network(editor.ties), SETTINGS.solver.settings)
    with open_project(folder, write=True) as project:
        found = distances(incremental(project), batch)
        assert found.within(), f"{done}: {found}"
        solution = solve(project, figures=False).solution
        assert solution.cost_final == pytest.approx(batch.cost_final, rel=1e-9)
        assert solution.network.rays.point.size == sum(len(tie.measures) for tie in editor.ties.values()) + int(
            np.count_nonzero(batch.network.points.classes[batch.network.rays.point] == PointClass.LASER)
        )
        for name, tie in editor.ties.items():
            record = edits.require_point(project, name)
            for measures, mine in ((record.measures, tie.measures), (record.set_aside, tie.aside)):
                assert {m.image: (m.line, m.sample, m.sigma_line) for m in measures} == mine


@settings(max_examples=4, deadline=None)
@given(st.integers(0, 2**31))
def test_undo_gives_back_the_same_numbers(
    solved: Path, tmp_path_factory: pytest.TempPathFactory, seed: int
) -> None:
    folder = Path(copytree(solved, tmp_path_factory.mktemp("one") / "project"))
    editor = Editor(seed)
    with open_project(folder) as project:
        before = state_of(incremental(project)), places_of(incremental(project))
        records = {name: edits.point_record(project, name) for name in editor.ties}
    with open_project(folder, write=True) as project:
        for _ in range(4):
            while editor.step(project).startswith("undo"):
                pass
        changed = len(editor.before)
    assert changed
    with open_project(folder, write=True) as project:
        for _ in range(changed):
            edits.undo(project)
        with pytest.raises(InputError, match="undo"):
            edits.undo(project)
        assert {name: edits.point_record(project, name) for name in records} == records
        assert project.journal.all_set_aside() == {}
        assert apart(incremental(project), before) < 0.01
        verbs = [one.verb for one in project.changes()]
        assert verbs.count("undo") >= changed


def test_one_edit_may_be_undone_by_its_number_while_others_stay(folder: Path) -> None:
    name, other = list(_ties())[:2]
    image = next(iter(_ties()[name].measures))
    with open_project(folder, write=True) as project:
        was = edits.point_record(project, name)
        edits.reject(project, name, image)
        number = project.changes(1)[0].number
        edits.remove_point(project, other)
        edits.undo(project, number)
        assert edits.point_record(project, name) == was
        assert edits.point_record(project, other) is None
        with pytest.raises(InputError, match=f"was undone by change {number + 2}"):
            edits.undo(project, number)
        edits.undo(project)
        assert edits.point_record(project, other) is not None


def test_an_edit_of_what_has_been_changed_since_is_not_undone(folder: Path) -> None:
    name = next(name for name, tie in _ties().items() if len(tie.measures) > 2)
    first, second, *_ = _ties()[name].measures
    with open_project(folder, write=True) as project:
        edits.reject(project, name, first)
        remove(project, [second])
        with pytest.raises(InputError, match="changed since"):
            edits.undo(project)
    with open_project(folder, write=True) as project:
        remove(project, [first])
        assert project.journal.all_set_aside() == {}  # gone with its image


def test_the_impact_says_what_moved(folder: Path) -> None:
    name = next(name for name, tie in _ties().items() if len(tie.measures) > 1)
    image, (line, sample, _) = next(iter(_ties()[name].measures.items()))
    with open_project(folder, write=True) as project:
        impact = edits.move(project, name, image, (line + 20.0 if line < 200 else line - 20.0, sample))
        assert impact is not None
        assert impact.verb == "edit"
        assert impact.subjects == (name,)
        k = impact.points.ids.index(name)
        assert impact.points.in_sigmas[k] > 1.0
        assert np.linalg.norm(impact.points.moves[k]) > 1.0
        assert any(name in one for one in impact.sentences())
        assert not any("Unconnected" in one for one in impact.sentences())
        gone = edits.remove_point(project, name)
        assert gone is not None
        assert gone.lost == (name,)


def test_history_and_status_show_edits(folder: Path) -> None:
    name = next(iter(_ties()))
    image = next(iter(_ties()[name].measures))
    with open_project(folder, write=True) as project:
        edits.reject(project, name, image)
        edits.undo(project)
        last = project.changes(2)
        assert [one.verb for one in last] == ["reject", "undo"]
        assert last[0].summary["point"] == name
        assert last[0].summary["images_reached"] >= 1
        text = status(project)
    assert f"reject {name} in {image}" in text
    assert "2 changes since the last closing check" in text
    assert "measures set aside by hand: none" in text


def test_a_project_that_was_never_solved_takes_edits_without_adjusting(tmp_path: Path) -> None:
    folder = tmp_path / "waiting"
    made = fan(IMAGES)
    with Project.create(folder, "waiting", SETTINGS) as project:
        for image in made.images:
            project.store.put_image(KnownImage(image, NOISE.prior))
        project.record("init", "images", {})
    first, second = (image.name for image in made.images[:2])
    with open_project(folder, write=True) as project:
        assert edits.new_point(project, "A", {first: (100.0, 50.0), second: (120.0, 60.0)}) is None
        assert edits.move(project, "A", first, (101.0, 50.0)) is None
        assert edits.reject(project, "A", second) is None
        assert project.last_solution() is None
        edits.undo(project)
        record = edits.require_point(project, "A")
        assert [(m.image, m.line, m.sigma_line) for m in record.measures] == [(first, 101.0, 1.0), (second, 120.0, 1.0)]
        for _ in range(2):
            edits.undo(project)
        assert edits.point_record(project, "A") is None
        assert project.store.members() == []


# --- what is refused


def _refusals(project: Project) -> dict[str, Callable[[], Any]]:
    name, tie = next((name, tie) for name, tie in _ties().items() if len(tie.measures) == 2)
    image, (line, sample, _) = next(iter(tie.measures.items()))
    away = next(one.name for one in fan(IMAGES).images if one.name not in tie.measures)
    known = project.store.image(image).image
    shot = fan(IMAGES).lasers[0].ids[0]

    def last_measure() -> None:
        for one in tie.measures:
            edits.reject(project, name, one)

    return {
        "no such point": lambda: edits.move(project, "nobody", image, (line, sample)),
        "no such image": lambda: edits.new_point(project, "N", {"nowhere": (1.0, 1.0)}),
        "it is there already": lambda: edits.new_point(project, name, {image: (line, sample)}),
        "no measure; expected a place": lambda: edits.new_point(project, "N", {}),
        "a name that can't be shown": lambda: edits.new_point(project, "a\x1b[2J", {image: (line, sample)}),
        "1 to 500 characters": lambda: edits.new_point(project, " ", {image: (line, sample)}),
        "measured at line": lambda: edits.measure(project, name, image, (line, sample)),
        f"inside {known.lines} lines": lambda: edits.move(project, name, image, (known.lines + 1.0, sample)),
        "line nan": lambda: edits.move(project, name, image, (float("nan"), sample)),
        "a sigma of": lambda: edits.move(project, name, image, (line, sample), -1.0),
        "no measure; expected an image": lambda: edits.move(project, name, away, (line, sample)),
        "its last measure": last_measure,
        "no measure; expected a rejected": lambda: edits.accept(project, name, away),
        "a measure that is not rejected": lambda: edits.accept(project, name, image),
        "the sigmas": lambda: edits.hold(project, name, None, (1.0, 0.0, 1.0)),
        "from the body's centre": lambda: edits.hold(project, name, np.array([1.0, 2.0, 3.0])),
        "three coordinates": lambda: edits.hold(project, name, np.array([np.nan, 2.0, 3.0])),
        "it is not held": lambda: edits.release(project, name),
        "a laser shot": lambda: edits.remove_point(project, shot),
        "no edit of a point to undo": lambda: edits.undo(project),
        "change 1 is no edit": lambda: edits.undo(project, 1),
    }


@pytest.mark.parametrize("said", [
    "no such point", "no such image", "it is there already", "no measure; expected a place",
    "a name that can't be shown", "1 to 500 characters", "measured at line", "inside", "line nan", "a sigma of",
    "no measure; expected an image", "its last measure", "no measure; expected a rejected",
    "a measure that is not rejected", "the sigmas", "from the body's centre", "three coordinates", "it is not held",
    "a laser shot", "no edit of a point to undo", "change 1 is no edit",
])  # fmt: skip
def test_what_is_refused_changes_nothing(folder: Path, said: str) -> None:
    before = (folder / "project.sqlite").read_bytes()[100:]
    with pytest.raises(InputError, match=said) as caught, open_project(folder, write=True) as project:
        next(call for words, call in _refusals(project).items() if words.startswith(said))()
    assert "\n" not in str(caught.value)
    assert str(folder) in str(caught.value)
    assert (folder / "project.sqlite").read_bytes()[100:] == before


def test_a_ray_that_misses_the_body_is_refused(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Whatever fails within the adjustment leaves the file as it was."""
    name = next(iter(_ties()))
    image, (line, sample, _) = next(iter(_ties()[name].measures.items()))
    before = (folder / "project.sqlite").read_bytes()[100:]

    def broken(*_: Any) -> None:
        raise InputError("ray", "misses the body")

    monkeypatch.setattr(IncrementalAdjustment, "_keep", broken)
    with pytest.raises(InputError, match="misses"), open_project(folder, write=True) as project:
        edits.move(project, name, image, (line, sample + 1.0))
    assert (folder / "project.sqlite").read_bytes()[100:] == before


def test_a_measure_set_aside_is_not_added_again_by_the_file_it_came_from(folder: Path) -> None:
    from mgsgraph.project.addition import unknown_alone

    name = next(name for name, tie in _ties().items() if len(tie.measures) > 1)
    image = next(iter(_ties()[name].measures))
    with open_project(folder, write=True) as project:
        edits.reject(project, name, image)
        again = network_of(fan(IMAGES), range(IMAGES))
        left = unknown_alone(again, project.store, project.journal.all_set_aside())
        assert left is None


# --- kills


def edit_for_ever(folder: Path, name: str, image: str, place: tuple[float, float]) -> None:
    """What the process does that will be killed: one edit after the other."""
    number = 0
    while True:
        with open_project(folder, write=True) as project:
            number = project.changes(1)[0].number
            if number % 5 == 4:
                edits.undo(project)
            else:
                edits.move(project, name, image, (place[0], place[1] + 0.001 * number))


@pytest.mark.skipif(not hasattr(os, "fork"), reason="kills a process of its own")
def test_killed_in_the_middle_of_an_edit_nothing_is_lost(folder: Path) -> None:
    name = next(name for name, tie in _ties().items() if len(tie.measures) > 1)
    image, (line, sample, _) = next(iter(_ties()[name].measures.items()))
    with open_project(folder, write=True) as project:
        began = time.perf_counter()
        edits.move(project, name, image, (line, sample + 0.5))
        took = time.perf_counter() - began
    rng, seen = np.random.default_rng(), set[int]()
    for _ in range(8):
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", DeprecationWarning)  # Python warns of threads that might hold a lock
            child = os.fork()
        if child == 0:
            try:
                edit_for_ever(folder, name, image, (line, sample))
            finally:
                os._exit(1)
        time.sleep(float(rng.uniform(0.3, 4.0)) * took)
        os.kill(child, signal.SIGKILL)
        _, ended = os.waitpid(child, 0)
        assert os.WIFSIGNALED(ended), "it should have gone on until it was killed"
        with open_project(folder, thorough=True) as project:
            last = project.journal.last()
            assert last is not None
            assert edits.point_record(project, name) == last.after
            solution = project.last_solution()
            assert solution is not None
            assert solution.change == project.changes(1)[0].number
            seen.add(solution.change)
            found = distances(incremental(project), adjust_network(project.store.network(), SETTINGS.solver.settings))
            assert found.within(), found
    assert len(seen) > 1


def test_a_damaged_journal_is_named(folder: Path) -> None:
    name = next(iter(_ties()))
    with open_project(folder, write=True) as project:
        edits.remove_point(project, name)
    plain = sqlite3.connect(folder / "project.sqlite")
    plain.execute("UPDATE edit SET before = '{\"kind\": 1}'")
    plain.execute("PRAGMA user_version = 0")
    plain.commit()
    plain.close()
    with pytest.raises(InputError, match=r"project\.sqlite is damaged"), open_project(folder, write=True) as project:
        edits.undo(project)

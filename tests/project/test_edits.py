"""Points changed by a person: any changes end at batch of the changed network, undoing gives back the same.

The network that is expected is kept by the test itself, point by point, and made anew each time.
"""

import sqlite3
from collections.abc import Callable
from contextlib import suppress
from copy import deepcopy
from dataclasses import dataclass, field, replace
from functools import cache, partialmethod
from pathlib import Path
from shutil import copytree
from typing import Any

import msgspec
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from increments import NOISE, distances, fan, largest_difference, network_of, places_of, slope, state_of
from outside import refuses
from projects import digest

from mgsgraph.adjustment.adjust import adjust_network
from mgsgraph.adjustment.incremental.incremental import IncrementalAdjustment
from mgsgraph.case.schema import OrientationInput
from mgsgraph.errors import InputError
from mgsgraph.files.networks.tie_points import PointKind, TiePoints
from mgsgraph.geometry.body import east_north_up
from mgsgraph.network import Network, PointClass, Surface
from mgsgraph.network.observations import build_network
from mgsgraph.network.parts import KnownImage, joined
from mgsgraph.project import edits, history
from mgsgraph.project.addition import Addition, NewImage, new_measurements_only
from mgsgraph.project.changes import Changed, remove_images, solve_project, store_unadjusted
from mgsgraph.project.decisions import Measure, PointState, decided
from mgsgraph.project.project import (
    AdjustmentCache,
    Project,
    open_project,
    rejected_measurements,
)
from mgsgraph.project.settings import MeasuresInput, ProjectSettings
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
    network = build_network(images, [all_ties, *made.lasers], NOISE.tie, NOISE.shot_image)
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


def adjusted(project: Project) -> IncrementalAdjustment:
    return IncrementalAdjustment(SETTINGS.solver.settings, project.store)


def a_tie(least: int = 2) -> tuple[str, list[str]]:
    """A tie point and the images that it is measured in."""
    name = next(name for name, tie in _ties().items() if len(tie.measures) >= least)
    return name, list(_ties()[name].measures)


def sorted_state(state: PointState | None) -> PointState | None:
    """With measures in the order of their images."""
    if state is None:
        return None
    return msgspec.structs.replace(state, measures=tuple(sorted(state.measures, key=lambda one: one.image)))


# --- random edits


class Editor:
    """Random edits of a project and of what the test expects of it."""

    def __init__(self, seed: int) -> None:
        self.rng, self.ties = np.random.default_rng(seed), deepcopy(_ties())
        self.before, self.undone, self.made = list[tuple[str, Tie | None]](), list[tuple[str, Tie | None]](), 0

    def step(self, project: Project) -> str:
        """One edit that may be made; its name."""
        kind = str(self.rng.choice(["new_point", "measure", "move", "reject", "accept", "hold", "release", "remove",
                                    "undo", "redo"]))  # fmt: skip
        done: Callable[[Project], str | None] = getattr(self, kind)
        found = done(project)
        return self.step(project) if found is None else found

    def _chosen(self, good: Callable[[Tie], bool]) -> str | None:
        names = [name for name, tie in self.ties.items() if good(tie)]
        return None if not names else str(self.rng.choice(names))

    def _note(self, name: str) -> None:
        self.before.append((name, deepcopy(self.ties.get(name))))
        self.undone.clear()

    def new_point(self, project: Project) -> str | None:
        model = self.ties[str(self._chosen(lambda tie: len(tie.measures) > 1))]
        self.made += 1
        name = f"HAND{self.made}"
        self._note(name)
        measures = {i: (one[0], min(one[1] + 0.3, 400.0), 0.7) for i, one in model.measures.items()}
        edits.measure(project, name, [Measure(i, *one, one[2]) for i, one in measures.items()])
        self.ties[name] = Tie(measures)
        return f"new {name}"

    def measure(self, project: Project) -> str | None:
        """A measure that was rejected is measured anew, elsewhere and with another sigma."""
        name = self._chosen(lambda tie: bool(tie.aside))
        if name is None:
            return None
        self._note(name)
        image, (line, sample, _) = self.ties[name].aside.popitem()
        self.ties[name].measures[image] = line, sample + 0.25, 0.6
        edits.measure(project, name, [Measure(image, line, sample + 0.25, 0.6, 0.6)])
        return f"measure {name} {image}"

    def move(self, project: Project) -> str | None:
        name = str(self._chosen(lambda tie: bool(tie.measures)))
        image = str(self.rng.choice(list(self.ties[name].measures)))
        line, sample, sigma = self.ties[name].measures[image]
        line, sample = (float(v) for v in np.array([line, sample]) + self.rng.normal(size=2) * 0.3)
        if min(line, sample) < 0.0:
            return None
        self._note(name)
        edits.move(project, name, image, line, sample)
        self.ties[name].measures[image] = (line, sample, sigma)
        return f"move {name} {image}"

    def _turned(self, act: Callable[..., Any], source: str, target: str, project: Project) -> str | None:
        name = self._chosen(lambda tie: len(getattr(tie, source)) > (source == "measures"))
        if name is None:
            return None
        self._note(name)
        image = str(self.rng.choice(list(getattr(self.ties[name], source))))
        act(project, name, image)
        getattr(self.ties[name], target)[image] = getattr(self.ties[name], source).pop(image)
        return f"{act.__name__} {name} {image}"

    reject = partialmethod(_turned, edits.reject, "measures", "aside")
    accept = partialmethod(_turned, edits.accept, "aside", "measures")

    def hold(self, project: Project) -> str | None:
        name = str(self._chosen(lambda tie: bool(tie.measures)))
        made = fan(IMAGES)
        names = list(made.ties.ids)
        if name not in names:
            return None
        place = np.asarray(made.true_ties[names.index(name)])
        sigmas = (2.0, 3.0, 4.0) if self.rng.random() < 0.7 else (0.0, 0.0, 0.0)
        self._note(name)
        edits.hold(project, name, place, np.array(sigmas))
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
        return self._back(project, history.undo, self.before, self.undone)

    def redo(self, project: Project) -> str | None:
        return self._back(project, history.redo, self.undone, self.before)

    def _back(
        self, project: Project, act: Callable[[Project], Changed], given: list[tuple[str, Tie | None]],
        taken: list[tuple[str, Tie | None]],
    ) -> str | None:  # fmt: skip
        """Undo or redo one change: the point's state is the one on `given`, and the present one goes to `taken`."""
        if not given:
            refuses(r"no change .*to (undo|redo)", act, project)
            return None
        name, was = given.pop()
        taken.append((name, self.ties.pop(name, None)))
        self.ties |= {} if was is None else {name: was}
        return f"{act(project).kind} {name}"


@settings(max_examples=3, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.integers(0, 2**31), st.lists(st.sampled_from(["keeping", "alone", "failing"]), min_size=3, max_size=7))
def test_edits_end_at_batch_of_the_edited_network(
    solved: Path, tmp_path_factory: pytest.TempPathFactory, seed: int, ways: list[str]
) -> None:
    """By a process that keeps its adjustment between edits, beside one that doesn't, and after edits that fail."""
    folder = Path(copytree(solved, tmp_path_factory.mktemp("one") / "project"))
    editor, cache = Editor(seed), AdjustmentCache()
    done = list[str]()
    for way in ways:
        if way == "failing":
            other = deepcopy(editor)
            with suppress(RuntimeError), open_project(folder, write=True, cache=cache) as project:
                other.step(project)
                raise RuntimeError
        with open_project(folder, write=True, cache=None if way == "alone" else cache) as project:
            done.append(editor.step(project))
    batch = adjust_network(expected_network(editor.ties), SETTINGS.solver.settings)
    with open_project(folder, write=True) as project:
        found = distances(adjusted(project), batch)
        assert found.within(), f"{done}: {found}"
        solution = solve_project(project, figures=False).solution
        assert solution.cost_final == pytest.approx(batch.cost_final, rel=1e-9)
        assert solution.network.rays.point.size == sum(len(tie.measures) for tie in editor.ties.values()) + int(
            np.count_nonzero(batch.network.points.classes[batch.network.rays.point] == PointClass.LASER)
        )
        for name, tie in editor.ties.items():
            record = edits.point_state(project, name)
            assert record is not None
            for measures, mine in ((record.measures, tie.measures), (record.set_aside, tie.aside)):
                assert {m.image: (m.line, m.sample, m.sigma_line) for m in measures} == mine


@settings(max_examples=2, deadline=None)
@given(st.integers(0, 2**31))
def test_undo_gives_back_the_same_numbers(
    solved: Path, tmp_path_factory: pytest.TempPathFactory, seed: int
) -> None:
    folder = Path(copytree(solved, tmp_path_factory.mktemp("one") / "project"))
    editor = Editor(seed)
    with open_project(folder) as project:
        before = state_of(adjusted(project)), places_of(adjusted(project))
        records = {name: edits.point_state(project, name) for name in editor.ties}
    with open_project(folder, write=True) as project:
        for _ in range(4):
            while editor.step(project).startswith(("undo", "redo")):
                pass
        changed = len(editor.before)
    assert changed
    with open_project(folder, write=True) as project:
        after = {name: edits.point_state(project, name) for name in {name for name, _ in editor.before}}
        for _ in range(changed):
            history.undo(project)
        for _ in range(changed):
            history.redo(project)
        for name, was in after.items():
            assert sorted_state(edits.point_state(project, name)) == sorted_state(was)
        refuses("redo", history.redo, project)
        for _ in range(changed):
            history.undo(project)
        refuses("undo", history.undo, project)
        for name, was in records.items():
            assert sorted_state(edits.point_state(project, name)) == sorted_state(was)
        assert rejected_measurements(project) == []
        assert largest_difference(adjusted(project), before) < 0.01
        assert sum(one.verb == "undo" for one in project.changes()) >= changed


@pytest.mark.parametrize("new", [edits.remove_point, lambda one, _: remove_images(one, one.store.image_names()[:1])])
def test_a_new_change_ends_what_can_be_redone(folder: Path, new: Callable[[Project, str], object]) -> None:
    name, other = list(_ties())[:2]
    with open_project(folder, write=True) as project:
        edits.reject(project, name, next(iter(_ties()[name].measures)))
        history.undo(project)
        project.record("solve", "changes no input", {})
        history.redo(project)
        history.undo(project)
        new(project, other)
        refuses("no change to redo", history.redo, project)


def test_one_edit_may_be_undone_by_its_number_while_others_stay(folder: Path) -> None:
    name, other = list(_ties())[:2]
    image = next(iter(_ties()[name].measures))
    with open_project(folder, write=True) as project:
        was = edits.point_state(project, name)
        edits.reject(project, name, image)
        number = project.changes(1)[0].number
        edits.remove_point(project, other)
        history.undo(project, number)
        assert sorted_state(edits.point_state(project, name)) == sorted_state(was)
        assert edits.point_state(project, other) is None
        refuses(f"change {number} is undone", history.undo, project, number)
        history.undo(project)
        assert edits.point_state(project, other) is not None


def test_undo_by_number_is_refused_where_the_point_has_changed_since(folder: Path) -> None:
    name = next(name for name, tie in _ties().items() if len(tie.measures) > 2)
    first, second, *_ = _ties()[name].measures
    with open_project(folder, write=True) as project:
        was = edits.point_state(project, name)
        edits.reject(project, name, first)
        number = project.changes(1)[0].number
        remove_images(project, [second])
        refuses(f"change {number + 1} has changed point", history.undo, project, number)
        remove_images(project, [first])
        assert rejected_measurements(project) == []  # in no image of the project
        refuses("later ones", history.undo, project, number + 1)
        for _ in range(3):
            history.undo(project)
        assert sorted_state(edits.point_state(project, name)) == sorted_state(was)


def test_what_a_user_decided_stays_decided_when_the_file_is_given_again(folder: Path) -> None:
    name, (first, second, *_) = a_tie()
    other = list(_ties())[-1]
    with open_project(folder, write=True) as project:
        line, sample, _ = _ties()[name].measures[second]
        edits.reject(project, name, first)
        edits.move(project, name, second, line + 0.25, sample)
        edits.remove_point(project, other)
        again = network_of(fan(IMAGES), range(IMAGES))
        left = decided(again, project.standing_decisions())
        assert left is not None
        assert new_measurements_only(left, project.store) is None
        refuses("measured there before", joined, [project.store.network(), new_measurements_only(again, project.store)])
        for _ in range(3):
            history.undo(project)
        assert decided(again, project.standing_decisions()) is again


def test_a_blunder_of_batch_is_accepted_until_batch_judges_anew(folder: Path) -> None:
    name, (image, *_) = a_tie()
    with open_project(folder, write=True) as project:
        members = project.store.bundles_of([name])[name]
        bundle = project.store.bundle(members)
        rays, (k,) = bundle.network.rays, bundle.network.points.ids.find([name])
        j = bundle.network.image_names.index(image)
        marked = bundle.network.with_rejected((rays.point == k) & (rays.image == j), None)
        project.store.replace([members], {members: replace(bundle, network=marked)})
        state = edits.point_state(project, name)
        assert state is not None
        assert [one.image for one in state.measures if one.rejected] == [image]
        edits.accept(project, name, image)
        state = edits.point_state(project, name)
        assert state is not None
        assert not any(one.rejected for one in state.measures)


def test_every_measure_may_be_rejected_and_accepted_again(folder: Path) -> None:
    name, images = a_tie()
    with open_project(folder, write=True) as project:
        place = np.asarray(fan(IMAGES).true_ties[list(fan(IMAGES).ties.ids).index(name)])
        edits.hold(project, name, place, np.full(3, 2.0))
        for image in images:
            edits.reject(project, name, image)
        assert project.store.bundles_of([name]) == {}
        edits.accept(project, name, images[0])
        state = edits.point_state(project, name)
        assert state is not None
        assert state.class_ == PointClass.CONTROL
        assert state.place == tuple(place.tolist())
        assert [one.image for one in state.measures] == images[:1]


def test_a_point_is_measured_image_by_image_with_the_usual_sigma(folder: Path) -> None:
    """With one ray it has no place; the second one gives it."""
    name, images = a_tie()
    with open_project(folder, write=True) as project:
        for count, image in enumerate(images[:2], 1):
            line, sample, _ = _ties()[name].measures[image]
            edits.measure(project, "by hand", [Measure(image, line, sample, 0.0, 0.0)])
            names, places, _ = adjusted(project).points()
            assert np.all(np.isfinite(places[list(names).index("by hand")])) == (count == 2)
        state = edits.point_state(project, "by hand")
    assert state is not None
    assert {one.sigma_line for one in state.measures} == {NOISE.tie}


def test_mistakes_are_one_line_and_change_nothing(folder: Path) -> None:
    name, (image, *_) = a_tie()
    with open_project(folder) as project:
        before, network, state = digest(project.store), project.store.network(), edits.point_state(project, name)
    assert state is not None
    first = state.measures[0]
    shot = network.points.ids[int(np.flatnonzero(network.points.classes == PointClass.LASER)[0])]
    wrong: list[tuple[Callable[..., object], tuple[object, ...]]] = [
        (edits.move, (name, image, 1e9, 1.0)), (edits.move, (name, "nowhere", 1.0, 1.0)),
        (edits.move, (name, image, np.nan, 1.0)), (edits.move, ("nobody", image, 1.0, 1.0)),
        (edits.reject, (name, "nowhere")), (edits.accept, (name, image)), (edits.release, (name,)),
        (edits.measure, (name, [first])), (edits.measure, ("new", [])), (edits.measure, ("new", [first, first])),
        (edits.measure, ("", [first])), (edits.measure, ("a\x1bb", [first])),
        (edits.measure, ("new", [msgspec.structs.replace(first, sigma_line=-1.0)])),
        (edits.hold, (name, np.array([1.0, 2.0, 3.0]), np.ones(3))),
        (edits.hold, (name, np.full(3, np.nan), np.ones(3))), (edits.remove_point, (shot,)), (history.undo, ()),
    ]  # fmt: skip
    for act, arguments in wrong:
        with pytest.raises(InputError) as error, open_project(folder, write=True) as project:
            act(project, *arguments)
        assert len(str(error.value).splitlines()) == 1
    with open_project(folder) as project:
        assert digest(project.store) == before


def test_a_project_that_was_never_solved_takes_changes(tmp_path: Path) -> None:
    name, (image, *_) = a_tie()
    line, sample, _ = _ties()[name].measures[image]
    new = [NewImage(KnownImage(one, NOISE.prior), ()) for one in fan(IMAGES).images]
    with Project.create(tmp_path / "new", "new", SETTINGS) as project:
        store_unadjusted(project.store, Addition(tuple(new), expected_network(_ties())))
    with open_project(tmp_path / "new", write=True) as project:
        assert edits.move(project, name, image, line + 0.5, sample).impact is None
        solve_project(project, figures=False)
        state = edits.point_state(project, name)
    assert state is not None
    moved = state.of(image)
    assert moved is not None
    assert moved.line == line + 0.5


# --- on a terrain model


def on_terrain_model(tmp_path: Path) -> Path:
    """A solved project whose ties lie on a terrain model."""
    folder, ties = tmp_path / "terrain", expected_network(_ties())
    sigmas = np.where(ties.points.classes == PointClass.TIE, 20.0, np.inf)
    network = replace(ties, surface=Surface(slope(ties), sigmas, 50.0))
    with Project.create(folder, "terrain", SETTINGS) as project:
        adjusted(project).adopt(adjust_network(network, replace(SETTINGS.solver.settings, starts=0)))
        project.record("solve", "images", {})
    return folder


def test_points_on_a_terrain_model_stay_on_it(tmp_path: Path) -> None:
    folder, (name, _) = on_terrain_model(tmp_path), a_tie()
    with open_project(folder, write=True) as project:
        was = edits.point_state(project, name)
        assert was is not None
        assert was.surface_sigma == 20.0
        edits.measure(project, "NEW", [replace_image(one) for one in was.measures])
        new = edits.point_state(project, "NEW")
        assert new is not None
        assert new.surface_sigma is not None
        place = np.asarray(fan(IMAGES).true_ties[list(fan(IMAGES).ties.ids).index(name)])
        edits.hold(project, name, place, np.full(3, 2.0))
        held = edits.point_state(project, name)
        assert held is not None
        assert (held.class_, held.surface_sigma) == (PointClass.CONTROL, None)
        edits.release(project, name)
        free = edits.point_state(project, name)
        assert free is not None
        assert free.surface_sigma == new.surface_sigma  # of the model's own control there
        for _ in range(2):
            history.undo(project)
        edits.remove_point(project, name)
        assert edits.point_state(project, name) is None
        history.undo(project)
        assert sorted_state(edits.point_state(project, name)) == sorted_state(was)
        batch = adjust_network(project.store.network(), replace(SETTINGS.solver.settings, starts=0))
        assert distances(adjusted(project), batch).within()


def replace_image(one: Measure) -> Measure:
    """A little beside."""
    return msgspec.structs.replace(one, sample=one.sample + 0.5)


@pytest.mark.parametrize("damage", ["UPDATE change SET former = x'00'", "UPDATE decision SET measure = '[1]'"])
def test_a_damaged_history_is_named(folder: Path, damage: str) -> None:
    name, (image, *_) = a_tie()
    with open_project(folder, write=True) as project:
        edits.reject(project, name, image)
    plain = sqlite3.connect(folder / "project.sqlite")
    plain.execute(damage)
    plain.execute("PRAGMA user_version = 0")
    plain.commit()
    plain.close()
    with open_project(folder, write=True) as project, pytest.raises(InputError, match=r"project|damaged"):
        _ = edits.point_state(project, name) and history.undo(project)

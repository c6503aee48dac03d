"""Points changed by a person: the adjustment that comes of it is that of the changed network; undoing gives it back."""

import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import msgspec
import numpy as np
import pytest
from click.testing import CliRunner
from projects import digest

from mgsgraph.adjustment.adjust import adjust_network
from mgsgraph.adjustment.incremental.impact import EXACT
from mgsgraph.adjustment.incremental.incremental import IncrementalAdjustment
from mgsgraph.cli import group
from mgsgraph.errors import InputError
from mgsgraph.files.networks.tie_points import PointKind
from mgsgraph.geometry.body import east_north_up
from mgsgraph.network import PointClass
from mgsgraph.project import edits
from mgsgraph.project.edits import Edited, point_state
from mgsgraph.project.project import Measure, Project, open_project
from mgsgraph.simulation.files import write_pair
from mgsgraph.simulation.pair import PairSettings, simulate_pair


def command(*words: object) -> None:
    run = CliRunner().invoke(group, [str(word) for word in words])
    assert run.exit_code == 0, run.output


@pytest.fixture
def project(solved: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(solved, tmp_path / "project"))


def edit(folder: Path, act: Callable[..., Edited], *arguments: object) -> Edited:
    with open_project(folder, write=True) as opened:
        return act(opened, *arguments)


def places(project: Project) -> tuple[dict[str, np.ndarray], dict[str, np.ndarray]]:
    """Places and sigmas by name, as iSAM2 has them."""
    chosen = project.settings.solver.settings
    names, found, covariances = IncrementalAdjustment(chosen, project.store).points()
    sigmas = np.sqrt(np.diagonal(covariances, axis1=1, axis2=2))
    return dict(zip(names, found, strict=True)), dict(zip(names, sigmas, strict=True))


def require_batch(folder: Path) -> None:
    """What the project has is the batch adjustment of its network."""
    with open_project(folder) as opened:
        found, sigmas = places(opened)
        chosen = replace(opened.settings.solver.settings, starts=0)
        batch = adjust_network(opened.store.network(), chosen)
    names = batch.network.points.ids
    for k in np.flatnonzero(batch.determined):
        np.testing.assert_array_less(np.abs(found[names[k]] - batch.places[k]), EXACT * sigmas[names[k]] + 1e-9)
        np.testing.assert_allclose(sigmas[names[k]], batch.sigmas[k], rtol=1e-3)


def tie(folder: Path, number: int = 3) -> tuple[str, tuple[Measure, ...]]:
    with open_project(folder) as opened:
        network = opened.store.network()
        name = network.points.ids[int(np.flatnonzero(network.points.classes == 0)[number])]
        state = point_state(opened, name)
    assert state is not None
    return name, state.measures


def test_a_moved_measure_is_adjusted(project: Path) -> None:
    name, (first, _) = tie(project)
    edited = edit(project, edits.move, name, first.image, first.line + 2.0, first.sample - 1.0)
    assert edited.impact is not None
    assert name in edited.impact.points.ids
    require_batch(project)
    with open_project(project) as opened:
        state = point_state(opened, name)
    assert state is not None
    assert state.of(first.image) == msgspec.structs.replace(first, line=first.line + 2.0, sample=first.sample - 1.0)


def test_a_rejected_measure_is_out_and_can_come_back(project: Path) -> None:
    name, (first, second) = tie(project)
    edited = edit(project, edits.reject, name, second.image)
    assert edited.impact is not None
    assert edited.impact.undetermined == (name,)
    with open_project(project) as opened:
        state = point_state(opened, name)
    assert state is not None
    assert state.set_aside == (second,)
    require_batch(project)
    edit(project, edits.accept, name, second.image)
    with open_project(project) as opened:
        state = point_state(opened, name)
    assert state is not None
    assert {one.image: one for one in state.measures} == {first.image: first, second.image: second}
    assert state.set_aside == ()
    require_batch(project)


def test_a_new_point_is_a_tie_of_the_usual_sigma(project: Path) -> None:
    _, measures = tie(project)
    new = [msgspec.structs.replace(one, line=one.line + 4.0, sigma_line=0.0, sigma_sample=0.0) for one in measures]
    edit(project, edits.measure, "by hand", new)
    with open_project(project) as opened:
        state, found = point_state(opened, "by hand"), places(opened)[0]
        usual = opened.settings.measures.tie_sigma_px
    assert state is not None
    assert {one.sigma_line for one in state.measures} == {usual}
    assert np.all(np.isfinite(found["by hand"]))
    require_batch(project)
    command("solve", project, "--no-figures")
    require_batch(project)


def test_a_point_is_measured_image_by_image(project: Path) -> None:
    """With one ray it has no place; the second one gives it."""
    _, (first, second) = tie(project)
    edit(project, edits.measure, "new", [first])
    with open_project(project) as opened:
        assert np.all(np.isnan(places(opened)[0]["new"]))
    edit(project, edits.measure, "new", [second])
    with open_project(project) as opened:
        assert np.all(np.isfinite(places(opened)[0]["new"]))
    require_batch(project)


@pytest.mark.parametrize("sigmas", [(5.0, 4.0, 2.0), (0.0, 0.0, 0.0)])
def test_a_held_point_is_control(project: Path, sigmas: tuple[float, float, float]) -> None:
    name, _ = tie(project)
    with open_project(project) as opened:
        place = places(opened)[0][name] + 3.0
    edit(project, edits.hold, name, place, np.array(sigmas))
    require_batch(project)
    with open_project(project) as opened:
        network = opened.store.network()
        now, state = places(opened)[0][name], point_state(opened, name)
    assert state is not None
    (k,) = network.points.ids.find([name])
    frame = east_north_up(place[None])[0]
    local = frame @ network.points.covariances[k] @ frame.T
    np.testing.assert_allclose(local, np.diag(np.square(sigmas)), atol=1e-9)
    assert state.kind == (PointKind.CONSTRAINED if any(sigmas) else PointKind.FIXED)
    if not any(sigmas):
        np.testing.assert_array_equal(now, place)
    edit(project, edits.release, name)
    with open_project(project) as opened:
        state = point_state(opened, name)
    assert state is not None
    assert state.kind == PointKind.FREE
    require_batch(project)


def test_an_error_in_mid_change_leaves_all_as_it_was(project: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    name, (first, _) = tie(project)
    with open_project(project) as opened:
        before, changes = digest(opened.store), len(opened.changes())

    def fail(*_: object) -> None:
        raise RuntimeError("in the middle")

    monkeypatch.setattr(Project, "record_edit", fail)
    with pytest.raises(RuntimeError):
        edit(project, edits.move, name, first.image, first.line + 2.0, first.sample)
    with open_project(project) as opened:
        assert digest(opened.store) == before
        assert len(opened.changes()) == changes


def test_mistakes_are_one_line_and_change_nothing(project: Path) -> None:
    name, (first, _) = tie(project)
    with open_project(project) as opened:
        before = digest(opened.store)
        network = opened.store.network()
        shot = network.points.ids[int(np.flatnonzero(network.points.classes == PointClass.LASER)[0])]
    wrong: list[tuple[Callable[..., Edited], tuple[object, ...]]] = [
        (edits.move, (name, first.image, 1e9, 1.0)), (edits.move, (name, "nowhere", 1.0, 1.0)),
        (edits.move, (name, first.image, np.nan, 1.0)), (edits.move, ("nobody", first.image, 1.0, 1.0)),
        (edits.reject, (name, "nowhere")), (edits.accept, (name, first.image)), (edits.release, (name,)),
        (edits.measure, (name, [first])), (edits.measure, ("new", [])), (edits.measure, ("new", [first, first])),
        (edits.measure, ("", [first])), (edits.measure, ("a\x1bb", [first])),
        (edits.measure, ("new", [msgspec.structs.replace(first, sigma_line=-1.0)])),
        (edits.hold, (name, np.array([1.0, 2.0, 3.0]), np.ones(3))),
        (edits.hold, (name, np.full(3, np.nan), np.ones(3))), (edits.remove_point, (shot,)), (edits.undo, ()),
    ]  # fmt: skip
    for act, arguments in wrong:
        with pytest.raises(InputError) as error:
            edit(project, act, *arguments)
        assert len(str(error.value).splitlines()) == 1
    with open_project(project) as opened:
        assert digest(opened.store) == before


def test_a_project_that_was_never_solved_takes_changes(tmp_path: Path) -> None:
    case = write_pair(simulate_pair(PairSettings(ties=20, shots=8), seed=2), tmp_path / "case")
    command("init", tmp_path / "project", "--case", case)
    name, (first, _) = tie(tmp_path / "project")
    edited = edit(tmp_path / "project", edits.move, name, first.image, first.line + 0.5, first.sample)
    assert edited.impact is None
    command("solve", tmp_path / "project", "--no-figures")
    require_batch(tmp_path / "project")


def test_history_and_status_tell(project: Path) -> None:
    name, (first, _) = tie(project)
    edit(project, edits.move, name, first.image, first.line + 0.5, first.sample)
    run = CliRunner().invoke(group, ["status", str(project)])
    assert name in run.output
    assert "edit" in run.output


def test_a_change_of_something_else_forbids_undoing(project: Path) -> None:
    """The measure that was moved is gone since."""
    name, (first, _) = tie(project)
    edit(project, edits.move, name, first.image, first.line + 0.5, first.sample)
    command("remove", project, first.image)
    with pytest.raises(InputError, match=name):
        edit(project, edits.undo)

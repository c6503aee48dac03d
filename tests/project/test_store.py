"""The store of a project: in a file as in memory, whole after a kill, and what is added meets what is there."""

import os
import signal
import sqlite3
import time
import warnings
from collections.abc import Iterator
from dataclasses import replace
from itertools import count
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from outside import refuses
from projects import ODD, StopHere, bundle_of, change, contents, differences, digest, four_images, images, interrupted

from mgsgraph.adjustment.incremental.state import Bundle, InMemory
from mgsgraph.errors import InputError
from mgsgraph.files.networks.tie_points import PointKind
from mgsgraph.geometry.plausibility import ImageTimes
from mgsgraph.geometry.trajectory import Trajectory
from mgsgraph.network import TERRAIN, Network, PointClass
from mgsgraph.network.parts import KnownImage, Members, bundles, joined, select_points, with_images, without_images
from mgsgraph.project.addition import (
    Addition,
    ImageArgument,
    NewImage,
    new_measurements_only,
    on_terrain,
    parse_image,
    require_distinct_from,
)
from mgsgraph.project.changes import store_unadjusted
from mgsgraph.project.columns import packed, unpacked
from mgsgraph.project.project import Project, open_project
from mgsgraph.project.settings import ProjectSettings
from mgsgraph.project.store import ProjectStore
from mgsgraph.results.archive import pack


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("projects") / "one"
    with Project.create(path, "one", ProjectSettings()):
        pass
    return path


@pytest.fixture
def store(folder: Path) -> Iterator[ProjectStore]:
    """An empty store; what a test does to it is rolled back."""
    with pytest.raises(StopHere), open_project(folder, write=True) as project:  # noqa: PT012
        yield project.store
        raise StopHere


def everything(rng: np.random.Generator) -> dict[Members, Bundle]:
    return {members: bundle_of(rng, members, net) for members, net in bundles(four_images()).items()}


@settings(max_examples=8, deadline=None, suppress_health_check=list(HealthCheck))
@given(st.lists(st.integers(0, 10**6), min_size=1, max_size=6))
def test_it_does_what_the_store_in_memory_does(folder: Path, seeds: list[int]) -> None:
    memory = InMemory()
    with pytest.raises(StopHere), open_project(folder, write=True) as project:  # noqa: PT012
        for seed in seeds:
            change(memory, seed)
            change(project.store, seed)
            assert differences(memory, project.store) == []
        assert project._connection.execute("PRAGMA foreign_key_check").fetchall() == []
        fresh = ProjectStore(project._connection, "fresh")
        assert differences(memory, fresh) == []
        raise StopHere


def test_it_is_the_same_when_it_is_opened_again(tmp_path: Path) -> None:
    memory, path = InMemory(), tmp_path / "kept"
    with Project.create(path, "kept", ProjectSettings()) as project:
        for seed in range(3):
            change(memory, seed)
            change(project.store, seed)
    with open_project(path) as project:
        assert differences(memory, project.store) == []
    with open_project(path, write=True) as project:
        change(memory, 3)
        change(project.store, 3)
        assert differences(memory, project.store) == []


@pytest.mark.parametrize("number", [-0.0, 5e-324, np.nan])
def test_every_number_comes_back(store: ProjectStore, number: float) -> None:
    """A-priori place, adjusted place, height sigma, measure: each through its own column."""
    for known in images():
        store.add_image(known)
    members, net = max(bundles(four_images()).items(), key=lambda item: len(item[1].points))
    bundle = bundle_of(np.random.default_rng(1), members, net)
    places = bundle.places.copy()
    places[0] = number
    if np.isfinite(number):
        measures = net.rays.places.copy()
        measures[0, 1] = number
        net = replace(net, rays=replace(net.rays, places=measures))
    store.replace([], {members: replace(bundle, network=net, places=places)})
    back = store.bundle(members)
    assert back.places.tobytes() == places.tobytes()
    assert back.network.rays.places.tobytes() == net.rays.places.tobytes()


def test_all_of_it_as_one_network(store: ProjectStore) -> None:
    for known in images():
        store.add_image(known)
    store.replace([], everything(np.random.default_rng(0)))
    kept = store.network()
    whole = with_images(joined([store.bundle(members).network for members in store.members()]), images())
    assert described(kept) == described(whole)
    assert kept.ranges.point.size == four_images().ranges.point.size
    assert [image.name for image in kept.images] == [image.name for image in four_images().images]


def described(net: Network) -> list[tuple[object, ...]]:
    """Its points and rows by name, in order."""
    ids, names = net.points.ids, net.image_names
    assert net.shifts is not None
    assert net.surface is not None
    assert set(net.considered) == set(net.shift_names)
    shift = [net.shifts.names[p] if p >= 0 else "" for p in net.shifts.profile]
    rows: list[tuple[object, ...]] = [
        (ids[i], int(net.points.classes[i]), int(net.points.kinds[i]), net.points.places[i].tobytes(),
         net.points.covariances[i].tobytes(), shift[i], float(net.surface.sigmas[i]))
        for i in range(len(ids))
    ]  # fmt: skip
    marks = net.rays.back_projected
    assert marks is not None
    rows += [
        (ids[net.rays.point[k]], names[net.rays.image[k]], net.rays.places[k].tobytes(), net.rays.sigmas[k].tobytes(),
         bool(marks[k]))
        for k in range(net.rays.point.size)
    ]  # fmt: skip
    rows += [
        (ids[net.ranges.point[k]], names[net.ranges.image[k]], float(net.ranges.times[k]), float(net.ranges.values[k]))
        for k in range(net.ranges.point.size)
    ]
    return sorted(rows, key=repr)


def test_an_unconnected_image_is_in_the_network(store: ProjectStore) -> None:
    for known in images():
        store.add_image(known)
    assert len(store.network().images) == 4
    assert store.network().surface is None


def test_equal_grids_are_one(store: ProjectStore) -> None:
    """Parts of a network know their terrain model by identity; files and case files bring copies of it."""
    for known in images():
        store.add_image(known)
    found = everything(np.random.default_rng(0))
    store.replace([], found)
    net = four_images()
    assert net.surface is not None
    copy = replace(net, surface=replace(net.surface, grid=replace(net.surface.grid)))
    with pytest.raises(ValueError, match="terrain model"):
        joined([select_points(net, np.arange(3)), select_points(copy, np.arange(3, 6))])
    own = store.with_known_grids(copy)
    assert own.surface is not None
    assert store.terrain is not None
    assert own.surface.grid is store.terrain[0]


def test_what_is_not_there_is_an_error(store: ProjectStore) -> None:
    members = next(iter(bundles(four_images())))
    for change_it in (
        lambda: store.drop_image("x"), lambda: store.drop_shared([members[0]]), lambda: store.replace([members], {}),
    ):  # fmt: skip
        with pytest.raises(KeyError):
            change_it()
    for ask in (lambda: store.image("x"), lambda: store.bundle(members)):
        with pytest.raises(InputError):
            ask()


def test_sql_and_numpy_alone_read_it(folder: Path, tmp_path: Path) -> None:
    with Project.create(tmp_path / "plain", "plain", ProjectSettings()) as project:
        change(project.store, 0)
        rays = sum(project.store.bundle(m).network.rays.point.size for m in project.store.members())
        assert list(contents(project.store))
    plain = sqlite3.connect(tmp_path / "plain" / "project.sqlite")
    cells = plain.execute("SELECT size, cell FROM packed WHERE kind = 'rays' AND name = 'sigma'").fetchall()
    assert sum(size for size, _ in cells) == rays
    assert all(np.all(np.frombuffer(cell, "<f8") > 0.0) for _, cell in cells)
    assert "m, body-fixed" in plain.execute("SELECT sql FROM sqlite_master WHERE name = 'packed'").fetchone()[0]
    plain.close()


@given(st.lists(st.sampled_from([*ODD, np.inf, -np.inf, np.nan]), max_size=6), st.integers(1, 3))
def test_a_packed_column_comes_back_to_the_bit(numbers: list[float], times: int) -> None:
    column = np.array(numbers * times)
    cell = packed(column, "<f8")
    assert unpacked(cell, "<f8", column.shape).tobytes() == column.tobytes()
    alike = len({np.float64(number).tobytes() for number in numbers}) == 1
    assert len(cell) == (8 if alike else column.nbytes)


# --- a process that is killed while it changes a project leaves the state before its change, or the one af


_MOMENTS = 6


def change_for_ever(folder: Path) -> None:
    """What the process does that will be killed: one change after the other, numbered by the history."""
    while True:
        with open_project(folder, write=True) as project:
            number = len(project.changes())
            change(project.store, number)
            project.record("change", str(number), {})


def killed(folder: Path, after: float) -> None:
    """Have a process change the project, and kill it after some seconds."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)  # Python warns of threads that might hold a lock; none does
        child = os.fork()
    if child == 0:
        try:
            change_for_ever(folder)
        finally:
            os._exit(1)
    time.sleep(after)
    os.kill(child, signal.SIGKILL)
    _, status = os.waitpid(child, 0)
    assert os.WIFSIGNALED(status), "it should have gone on until it was killed"


@pytest.mark.skipif(not hasattr(os, "fork"), reason="kills a process of its own")
def test_killed_at_any_moment_it_holds_the_state_before_or_after(tmp_path: Path) -> None:
    folder, replayed, done = tmp_path / "project", InMemory(), 0
    with Project.create(folder, "killed", ProjectSettings()):
        pass
    change(InMemory(), 0)  # the network that all changes deal with is made once
    began = time.perf_counter()
    with open_project(folder, write=True) as project:
        change(project.store, 0)
        project.record("change", "0", {})
    took = time.perf_counter() - began
    rng = np.random.default_rng()  # moments are random by nature: the clock decides in any case
    for number in count():
        if number >= _MOMENTS and done > 1:
            break
        assert number < 10 * _MOMENTS
        killed(folder, float(rng.uniform(0.1, 6.0)) * took)
        with open_project(folder) as project:
            now = len(project.changes())
            if now == done:  # others may have come to share the machine
                took *= 1.5
            for earlier in range(done, now):
                change(replayed, earlier)
            done = now
            assert differences(replayed, project.store) == []


def test_a_journal_left_over_is_played_back_by_a_reader(tmp_path: Path) -> None:
    folder = tmp_path / "project"
    with Project.create(folder, "cut", ProjectSettings()) as project:
        change(project.store, 9)
    before, after = interrupted(folder, tmp_path / "copy")
    assert (tmp_path / "copy" / "project.sqlite-journal").stat().st_size > 0
    assert before != after
    for path, expected in ((tmp_path / "copy", before), (folder, after)):
        with open_project(path) as project:
            assert digest(project.store) == expected


# --- what is added meets what is there: known points, known measures, the terrain model


def whole() -> Network:
    """A network on a terrain model whose own sigma is that of its points."""
    net = four_images()
    assert net.surface is not None
    return replace(net, surface=replace(net.surface, grid=replace(net.surface.grid, vertical_sigma=25.0)))


def without(net: Network, *names: str) -> Network:
    left = without_images(net, names)
    assert left is not None
    return left


@pytest.fixture
def lacking(tmp_path: Path) -> Iterator[ProjectStore]:
    """A project that lacks the image SIM/B."""
    new = tuple(NewImage(known, ()) for known in images() if known.image.name != "SIM/B")
    with pytest.raises(StopHere), Project.create(tmp_path / "p", "p", ProjectSettings()) as project:  # noqa: PT012
        store_unadjusted(project.store, Addition(new, without(whole(), "SIM/B")))
        yield project.store
        raise StopHere


def test_of_a_whole_network_only_what_is_new_remains(lacking: ProjectStore) -> None:
    net = whole()
    before = sum(one.network.rays.point.size for one in map(lacking.bundle, lacking.members()))
    left = new_measurements_only(net, lacking)
    assert left is not None
    new = next(j for j, image in enumerate(left.images) if image.name == "SIM/B")
    known = np.array([name in lacking.bundles_of(net.points.ids) for name in left.points.ids])
    assert np.all((left.rays.image == new) | ~known[left.rays.point])
    assert left.rays.point.size + before == net.rays.point.size
    assert np.all(left.points.kinds[known] == PointKind.FREE)
    assert left.ranges.point.size + lacking.network().ranges.point.size == net.ranges.point.size


def test_put_in_one_after_the_other_is_put_in_at_once(lacking: ProjectStore, tmp_path: Path) -> None:
    net = whole()
    added = new_measurements_only(net, lacking)
    assert added is not None
    new = next(known for known in images() if known.image.name == "SIM/B")
    store_unadjusted(lacking, Addition((NewImage(new, ()),), added))
    assert set(lacking.members()) == set(bundles(net))
    for members, expected in bundles(net).items():
        found = lacking.bundle(members).network
        assert set(found.points.ids) == set(expected.points.ids)
        order = [found.points.ids.index(name) for name in expected.points.ids]
        np.testing.assert_array_equal(found.points.kinds[order], expected.points.kinds)
        np.testing.assert_array_equal(found.points.places[order], expected.points.places)
        assert found.rays.point.size == expected.rays.point.size
        assert (found.surface is None) == (expected.surface is None)


def test_a_measure_that_contradicts_is_not_dropped(lacking: ProjectStore) -> None:
    net = whole()
    moved = replace(net, rays=replace(net.rays, places=net.rays.places + 1e-9))
    left = new_measurements_only(moved, lacking)
    assert left is not None
    assert left.rays.point.size == net.rays.point.size
    refuses("measured there before", joined, [lacking.network(), lacking.with_known_grids(left)])


def test_new_ties_lie_on_the_terrain_model_of_the_project(lacking: ProjectStore) -> None:
    net = whole()
    ties = np.flatnonzero(net.points.classes == PointClass.TIE)
    bare = replace(select_points(net, ties), surface=None, considered=())
    on = on_terrain(bare, lacking)
    assert on.surface is not None
    assert on.considered == (TERRAIN,)
    assert lacking.terrain is not None
    assert on.surface.grid is lacking.terrain[0]
    assert on.surface.sigmas.min() == 25.0  # of a tie by itself; of m that share posts up to 25 m times the root of m
    assert 25.0 < on.surface.sigmas.max() <= 50.0
    laser = replace(select_points(net, np.flatnonzero(net.points.classes == PointClass.LASER)), surface=None)
    assert on_terrain(laser, lacking).surface is None


def test_names_before_paths(tmp_path: Path) -> None:
    odd = tmp_path / "a=b.isd"
    odd.touch()
    assert parse_image(str(odd)) == ImageArgument(odd)
    assert parse_image("MOC/1=x.isd") == ImageArgument(Path("x.isd"), "MOC/1")
    refuses("empty or unprintable name", parse_image, "=x.isd")


def later(known: KnownImage, name: str, seconds: float) -> KnownImage:
    """The image under a name, so many seconds after it was taken."""
    image, trajectory = known.image, known.image.trajectory
    assert isinstance(trajectory, Trajectory)
    moved = replace(trajectory, epoch=trajectory.epoch + seconds)
    return replace(known, image=replace(image, name=name, trajectory=moved))


def test_times_of_images_are_those_of_their_records(tmp_path: Path) -> None:
    """Epoch and line timing, bit for bit, in the order in which the images came."""
    with Project.create(tmp_path / "p", "p", ProjectSettings()) as project:
        store_unadjusted(project.store, Addition(tuple(NewImage(known, ()) for known in images()), None))
    with open_project(tmp_path / "p") as project:
        times = project.image_times()
        assert list(times) == project.store.image_names()
        for name, found in times.items():
            whole = ImageTimes.of(project.store.image(name).image)
            assert found.epoch == whole.epoch
            assert pack(found.timing) == pack(whole.timing)


def test_images_that_begin_with_a_new_one_are_compared_and_no_others(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    first = images()[0]
    there = [later(first, f"image {k}", 100.0 * k) for k in range(5)]
    with Project.create(tmp_path / "p", "p", ProjectSettings()) as project:
        store_unadjusted(project.store, Addition(tuple(NewImage(known, ()) for known in there), None))
    with open_project(tmp_path / "p") as project:
        read, image = list[str](), project.store.image
        monkeypatch.setattr(project.store, "image", lambda name: (read.append(name), image(name))[1])
        require_distinct_from(project, [later(first, "new", 150.0)])
        assert read == []
        with pytest.raises(InputError, match="image 3 and again"):
            require_distinct_from(project, [later(first, "new", 150.0), later(first, "again", 300.0)])
        assert read == ["image 3"]
        with pytest.raises(InputError, match="new and again"):
            require_distinct_from(project, [later(first, "new", 150.0), later(first, "again", 150.0)])

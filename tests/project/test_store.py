"""The store in a file does what the one in memory does, bit for bit, whatever the changes."""

import sqlite3
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from projects import ODD, StopHere, bundle_of, change, contents, differences, four_images, images

from mgsgraph.adjustment.incremental.state import Bundle, InMemory
from mgsgraph.errors import InputError
from mgsgraph.network import Network
from mgsgraph.network.parts import Members, bundles, joined, part, with_images
from mgsgraph.project.columns import packed, unpacked
from mgsgraph.project.project import Project, open_project
from mgsgraph.project.settings import ProjectSettings
from mgsgraph.project.store import ProjectStore


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


@settings(max_examples=12, deadline=None, suppress_health_check=list(HealthCheck))
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
        store.put_image(known)
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
        store.put_image(known)
    store.replace([], everything(np.random.default_rng(0)))
    kept = store.network()
    whole = with_images(joined([store.bundle(members).network for members in store.members()]), images())
    assert described(kept) == described(whole)
    assert kept.ranges.point.size == four_images().ranges.point.size
    assert [image.name for image in kept.images] == [image.name for image in four_images().images]


def described(net: Network) -> list[tuple[object, ...]]:
    """Its points and rows by name, in order."""
    ids, names = net.points.ids, [image.name for image in net.images]
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
        store.put_image(known)
    assert len(store.network().images) == 4
    assert store.network().surface is None


def test_equal_grids_are_one(store: ProjectStore) -> None:
    """Parts of a network know their terrain model by identity; files and case files bring copies of it."""
    for known in images():
        store.put_image(known)
    found = everything(np.random.default_rng(0))
    store.replace([], found)
    net = four_images()
    assert net.surface is not None
    copy = replace(net, surface=replace(net.surface, grid=replace(net.surface.grid)))
    with pytest.raises(ValueError, match="terrain model"):
        joined([part(net, np.arange(3)), part(copy, np.arange(3, 6))])
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

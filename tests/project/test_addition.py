"""What is added meets what is there: known points, known measures, the terrain model."""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from projects import StopHere, four_images, images

from mgsgraph.errors import InputError
from mgsgraph.files.networks.tie_points import PointKind
from mgsgraph.geometry.image import ImageTimes
from mgsgraph.geometry.trajectory import Trajectory
from mgsgraph.network import TERRAIN, Network, PointClass
from mgsgraph.network.parts import KnownImage, bundles, joined, part, without_images
from mgsgraph.project.addition import (
    Addition,
    ImageArgument,
    NewImage,
    on_terrain,
    parse_image,
    require_distinct_from,
    unknown_alone,
)
from mgsgraph.project.changes import put_in
from mgsgraph.project.project import Project, open_project
from mgsgraph.project.settings import ProjectSettings
from mgsgraph.project.store import ProjectStore
from mgsgraph.results.archive import pack


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
def store(tmp_path: Path) -> Iterator[ProjectStore]:
    """A project that lacks the image SIM/B."""
    new = tuple(NewImage(known, ()) for known in images() if known.image.name != "SIM/B")
    with pytest.raises(StopHere), Project.create(tmp_path / "p", "p", ProjectSettings()) as project:  # noqa: PT012
        put_in(project.store, Addition(new, without(whole(), "SIM/B")))
        yield project.store
        raise StopHere


def test_of_a_whole_network_only_what_is_new_remains(store: ProjectStore) -> None:
    net = whole()
    before = sum(one.network.rays.point.size for one in map(store.bundle, store.members()))
    left = unknown_alone(net, store)
    assert left is not None
    new = next(j for j, image in enumerate(left.images) if image.name == "SIM/B")
    known = np.array([name in store.bundles_of(net.points.ids) for name in left.points.ids])
    assert np.all((left.rays.image == new) | ~known[left.rays.point])
    assert left.rays.point.size + before == net.rays.point.size
    assert np.all(left.points.kinds[known] == PointKind.FREE)
    assert left.ranges.point.size + store.network().ranges.point.size == net.ranges.point.size


def test_put_in_one_after_the_other_is_put_in_at_once(store: ProjectStore, tmp_path: Path) -> None:
    net = whole()
    added = unknown_alone(net, store)
    assert added is not None
    new = next(known for known in images() if known.image.name == "SIM/B")
    put_in(store, Addition((NewImage(new, ()),), added))
    assert set(store.members()) == set(bundles(net))
    for members, expected in bundles(net).items():
        found = store.bundle(members).network
        assert set(found.points.ids) == set(expected.points.ids)
        order = [found.points.ids.index(name) for name in expected.points.ids]
        np.testing.assert_array_equal(found.points.kinds[order], expected.points.kinds)
        np.testing.assert_array_equal(found.points.places[order], expected.points.places)
        assert found.rays.point.size == expected.rays.point.size
        assert (found.surface is None) == (expected.surface is None)


def test_a_measure_that_contradicts_is_not_dropped(store: ProjectStore) -> None:
    net = whole()
    moved = replace(net, rays=replace(net.rays, places=net.rays.places + 1e-9))
    left = unknown_alone(moved, store)
    assert left is not None
    assert left.rays.point.size == net.rays.point.size
    with pytest.raises(InputError, match="measured there before"):
        joined([store.network(), store.with_known_grids(left)])


def test_new_ties_lie_on_the_terrain_model_of_the_project(store: ProjectStore) -> None:
    net = whole()
    bare = replace(part(net, np.flatnonzero(net.points.classes == PointClass.TIE)), surface=None, considered=())
    on = on_terrain(bare, store)
    assert on.surface is not None
    assert on.considered == (TERRAIN,)
    assert store.terrain is not None
    assert on.surface.grid is store.terrain[0]
    assert on.surface.sigmas.min() == 25.0  # of a tie by itself; of m that share posts 25 m times the root of m
    assert set(np.round((on.surface.sigmas / 25.0) ** 2, 6)) <= {1.0, 2.0, 3.0, 4.0}
    laser = replace(part(net, np.flatnonzero(net.points.classes == PointClass.LASER)), surface=None)
    assert on_terrain(laser, store).surface is None


def test_names_before_paths(tmp_path: Path) -> None:
    odd = tmp_path / "a=b.isd"
    odd.touch()
    assert parse_image(str(odd)) == ImageArgument(odd)
    assert parse_image("MOC/1=x.isd") == ImageArgument(Path("x.isd"), "MOC/1")
    with pytest.raises(InputError, match="empty or unprintable name"):
        parse_image("=x.isd")


def later(known: KnownImage, name: str, seconds: float) -> KnownImage:
    """The image under a name, so many seconds after it was taken."""
    image, trajectory = known.image, known.image.trajectory
    assert isinstance(trajectory, Trajectory)
    moved = replace(trajectory, epoch=trajectory.epoch + seconds)
    return replace(known, image=replace(image, name=name, trajectory=moved))


def test_times_of_images_are_those_of_their_records(tmp_path: Path) -> None:
    """Epoch and line timing, bit for bit, in the order in which the images came."""
    with Project.create(tmp_path / "p", "p", ProjectSettings()) as project:
        put_in(project.store, Addition(tuple(NewImage(known, ()) for known in images()), None))
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
        put_in(project.store, Addition(tuple(NewImage(known, ()) for known in there), None))
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

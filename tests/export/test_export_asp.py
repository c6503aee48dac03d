"""Exports for the Ames Stereo Pipeline, read back by our own readers and by a few lines that know the formats."""

import struct
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from networks import network, pair

from mgsgraph.adjustment.adjust import adjust_network
from mgsgraph.adjustment.settings import SolverSettings
from mgsgraph.adjustment.solution import Solution
from mgsgraph.errors import InputError
from mgsgraph.export.asp import write_asp
from mgsgraph.export.csm import write_csm
from mgsgraph.files.networks.asp_text import read_ground_control
from mgsgraph.files.networks.tie_points import PointKind
from mgsgraph.network import PointClass


@pytest.fixture(scope="module")
def solution() -> Solution:
    return adjust_network(network(pair()), SolverSettings(), "pair")


def matches(path: Path) -> np.ndarray:
    """Columns and rows (2, n, 2) of a match file without descriptors, by struct alone."""
    data, record = path.read_bytes(), struct.Struct("<ffiifffBIIQ")
    first, second = struct.unpack_from("<QQ", data)
    assert first == second
    assert len(data) == 16 + 2 * first * record.size
    places = [record.unpack_from(data, 16 + k * record.size)[:2] for k in range(2 * first)]
    return np.array(places).reshape(2, first, 2)


def test_free_points_are_matches(solution: Solution, tmp_path: Path) -> None:
    write_asp(solution, tmp_path)
    (path,) = (tmp_path / "matches").iterdir()
    found, rays, net = matches(path), solution.network.rays, solution.network
    ties = net.points.classes[rays.point] == PointClass.TIE
    for j in range(2):
        mine = np.flatnonzero(ties & (rays.image == j))
        mine = mine[np.argsort(rays.point[mine])]
        np.testing.assert_allclose(found[j], rays.places[mine, ::-1] - 0.5, atol=1e-3)


def test_control_points_are_as_given_and_adjusted_ones_as_adjusted(solution: Solution, tmp_path: Path) -> None:
    write_asp(solution, tmp_path)
    net, body = solution.network, solution.network.images[0].body
    control, adjusted = (read_ground_control(tmp_path / f"{name}.gcp", body) for name in ("control", "adjusted"))
    given = np.flatnonzero(net.points.kinds == PointKind.CONSTRAINED)
    np.testing.assert_allclose(control.places, net.points.places[given], atol=1e-6, rtol=0.0)
    sigmas = np.sqrt(np.diagonal(net.points.covariances[given], axis1=1, axis2=2))
    np.testing.assert_allclose(np.sqrt(np.diagonal(control.covariances, axis1=1, axis2=2)), sigmas, rtol=1e-12)
    np.testing.assert_allclose(adjusted.places, solution.places, atol=1e-6, rtol=0.0)
    np.testing.assert_allclose(np.sqrt(np.diagonal(adjusted.covariances, axis1=1, axis2=2)), solution.sigmas, rtol=1e-9)
    places = solution.network.rays.places[np.argsort(solution.network.rays.point, kind="stable")]
    np.testing.assert_allclose(adjusted.measures, places, atol=1e-9)
    write_asp(solution, tmp_path, scaled=True)
    scaled = read_ground_control(tmp_path / "adjusted.gcp", body)
    np.testing.assert_allclose(scaled.covariances, adjusted.covariances * solution.sigma0**2, rtol=1e-9)


def test_rejected_measures_are_left_out(solution: Solution, tmp_path: Path) -> None:
    rays = solution.network.rays
    used = solution.rays_used & ~np.isin(rays.point, [0, 1])
    some = replace(solution, rays_used=used)
    write_asp(some, tmp_path)
    (path,) = (tmp_path / "matches").iterdir()
    ties = int(np.sum(solution.network.points.classes == PointClass.TIE))
    assert matches(path).shape[1] == ties - 2
    readme = (tmp_path / "README.txt").read_text(encoding="utf-8")
    assert f"Measures that took part: {used.sum()}, {np.sum(~used)} left out as rejected." in readme
    nothing = replace(solution, rays_used=np.zeros_like(used))
    with pytest.raises(InputError, match="no measure that took part"):
        write_asp(nothing, tmp_path / "nothing")


def test_lists_go_together_and_commands_name_files_that_are_there(solution: Solution, tmp_path: Path) -> None:
    names = [image.name for image in solution.network.images]
    files = write_asp(solution, tmp_path, {names[1]: "cubes/other.cub"})
    images, cameras = ((tmp_path / f"{name}.txt").read_text().split() for name in ("images", "cameras"))
    assert len(images) == len(cameras) == len(names)
    assert images[1] == "cubes/other.cub"
    assert all(camera.endswith(".adjusted_state.json") for camera in cameras)
    assert Path(images[0]).stem == cameras[0].removesuffix(".adjusted_state.json")
    assert all(path.is_file() for path in files)
    readme = (tmp_path / "README.txt").read_text(encoding="utf-8")
    for option in ("--image-list", "--camera-list", "--match-files-prefix", "control.gcp"):
        (command,) = [line for line in readme.splitlines() if line.startswith("  bundle_adjust")]
        assert option in command
    assert "converge" not in readme
    write_asp(replace(solution, converged=False), tmp_path)
    assert "NOT converge" in (tmp_path / "README.txt").read_text(encoding="utf-8")
    write_asp(solution, tmp_path, {names[1]: "cubes/other.cub"})
    assert "cubes/other.cub" in (tmp_path / "adjusted.gcp").read_text(encoding="utf-8")


def test_cameras_are_called_like_the_files_of_their_images(solution: Solution, tmp_path: Path) -> None:
    """Support data are no pixels: the cube of that name is meant."""
    names = [image.name for image in solution.network.images]
    write_asp(solution, tmp_path, {names[0]: "first.isd", names[1]: "cubes/second.tif"})
    images, cameras = ((tmp_path / f"{name}.txt").read_text().split() for name in ("images", "cameras"))
    assert images[:2] == ["first.cub", "cubes/second.tif"]
    assert cameras[:2] == ["first.adjusted_state.json", "second.adjusted_state.json"]
    csm = write_csm(solution, tmp_path, files={names[0]: "first.cub"})
    assert {path.name for path in csm} >= {"first.json", "first.adjusted_state.json"}


def test_without_free_or_control_points(solution: Solution, tmp_path: Path) -> None:
    ties = adjust_network(network(pair(), laser=False), SolverSettings(), "ties")
    names = {path.name for path in write_asp(ties, tmp_path / "ties")}
    assert "control.gcp" not in names
    net = solution.network
    kinds = np.where(net.points.kinds == PointKind.FREE, PointKind.FIXED, net.points.kinds)
    fixed = replace(net, points=replace(net.points, kinds=kinds, places=solution.places))
    names = {path.name for path in write_asp(replace(solution, network=fixed), tmp_path / "fixed")}
    assert not any(name.endswith(".match") for name in names)
    assert "1e-10" in (tmp_path / "fixed" / "control.gcp").read_text()


@pytest.mark.parametrize(
    ("images", "said"),
    [
        ({"nobody": "a.cub"}, "the image 'nobody'"),
        ({0: "a b.cub"}, "a name without blanks"),
        ({0: "same.cub", 1: "same.cub"}, "called same"),
        ({0: "a/same.cub", 1: "b/same.cub"}, "called same"),
    ],
)
def test_files_that_cant_be_told_apart(solution: Solution, tmp_path: Path, images: dict, said: str) -> None:
    names = [image.name for image in solution.network.images]
    asked = {names[key] if isinstance(key, int) else key: file for key, file in images.items()}
    with pytest.raises(InputError, match=said):
        write_asp(solution, tmp_path, asked)
    assert not list(tmp_path.iterdir())

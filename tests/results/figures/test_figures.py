"""Figures: the numbers they show against other roads to the same numbers, and that sheets are made in every case."""

import logging
import tomllib
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import matplotlib as mpl
import numpy as np
import pytest

import mgsgraph
from mgsgraph.adjustment.marginals import JointCovariance, SquareRoot
from mgsgraph.adjustment.solution import Solution, orientation_profile
from mgsgraph.files.networks.tie_points import PointKind
from mgsgraph.geometry.body import centre_of, plane_coordinates
from mgsgraph.geometry.footprint import footprint
from mgsgraph.network import GroundPoints, ImageRays, Network, PointClass, Ranges
from mgsgraph.results.figures import solution_sheets, write_figures
from mgsgraph.results.figures.map import block_window, map_sheets
from mgsgraph.results.figures.orientation import components, image_curve
from mgsgraph.results.figures.sheet import encoded
from mgsgraph.simulation.files import write_pair
from mgsgraph.simulation.pair import PairSettings, simulate_pair
from mgsgraph.units import ARCSEC, KM


@pytest.fixture(scope="module")
def case_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_pair(simulate_pair(PairSettings(ties=40, shots=20)), tmp_path_factory.mktemp("case"))


@pytest.fixture(scope="module")
def solution(case_file: Path) -> Solution:
    return mgsgraph.adjust(mgsgraph.read_case(case_file))


def adjust_text(case_file: Path, name: str, change: Callable[[str], str]) -> Solution:
    path = case_file.with_name(name)
    path.write_text(change(case_file.read_text()))
    assert tomllib.loads(path.read_text())
    return mgsgraph.adjust(mgsgraph.read_case(path))


def kinds(names: list[str]) -> set[str]:
    return {Path(name).stem.rstrip("_0123456789") for name in names}


def require_files(folder: Path, names: list[str], pixels: bool = False) -> None:
    """They are all that there is, PNG, whole if there are `pixels`."""
    assert sorted(path.name for path in folder.iterdir()) == sorted(names)
    for name in names:
        assert name.endswith(".png")
        data = (folder / name).read_bytes()
        if pixels:
            assert len(data) > 10_000
            assert data[:8] == b"\x89PNG\r\n\x1a\n"
            assert data[-8:-4] == b"IEND"


def captions(solution: Solution) -> dict[str, str]:
    """Of all sheets, by their names."""
    return {sheet.name: sheet.caption for _, sheet in solution_sheets(solution)}


def test_orientation_components_are_the_coefficients(solution: Solution) -> None:
    """At the image's middle u = 0: position and rotation corrections are the constant coefficients there."""
    profile = orientation_profile(solution, 0, 101)
    shown, spread = (values[50] for values in components(profile))
    unit = np.array([1.0, 1.0, 1.0, ARCSEC, ARCSEC, ARCSEC])
    assert np.abs(shown * unit - solution.coefficients[0][0])[:3].max() < 1e-6
    assert np.abs(shown * unit - solution.coefficients[0][0])[3:].max() < 1e-9
    want = np.sqrt(np.diagonal(solution.image_covariance(0))[:6])
    assert np.allclose(spread * unit, want, rtol=1e-3)
    assert 0.5 < image_curve(solution, 0).coupling <= 1.0


def test_points_lie_inside_the_footprints_of_the_images_that_measure_them(solution: Solution) -> None:
    centre = centre_of(solution.places)
    for j, image in enumerate(solution.network.images):
        outline = footprint(image, correction=solution.correction(j)).outline
        assert np.array_equal(outline[0], outline[-1])
        ring = plane_coordinates(outline, centre)
        mine = solution.network.rays.point[solution.network.rays.image == j]
        for place in plane_coordinates(solution.places[mine], centre):
            to = ring - place
            turn = np.arctan2(to[:-1, 0] * to[1:, 1] - to[:-1, 1] * to[1:, 0], np.sum(to[:-1] * to[1:], axis=1))
            assert abs(abs(turn.sum()) - 2.0 * np.pi) < 1e-6  # once around: inside


def test_the_map_has_three_dimensional_sigmas_and_corrections_of_points(solution: Solution) -> None:
    shown = block_window(solution)
    assert np.allclose(shown.values, np.linalg.norm(solution.sigmas, axis=1))
    assert shown.covariances is not None
    assert np.all(np.trace(shown.covariances, axis1=1, axis2=2) < shown.values**2)
    assert shown.moved is not None
    away = np.linalg.norm(solution.places - solution.places_before, axis=1)
    assert np.all(np.linalg.norm(shown.moved, axis=1) <= away + 1e-9)


# --- files


def test_files_of_the_pair_whatever_the_users_style(
    solution: Solution, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    """Slow: the one test whose figures get their pixels, twice."""
    settings, first, again = dict(mpl.rcParams), tmp_path / "new" / "folder", tmp_path / "again"
    with caplog.at_level(logging.WARNING):
        names = write_figures(solution, first)
    require_files(first, names, pixels=True)
    assert {Path(name).stem for name in names} == {"residuals", "orientation", "map", "connectivity"}
    assert not caplog.records  # matplotlib complains by log, too
    assert dict(mpl.rcParams) == settings
    with mpl.rc_context({"font.size": 20.0, "axes.facecolor": "black", "svg.fonttype": "none", "text.usetex": False}):
        assert write_figures(solution, again) == names
        assert mpl.rcParams["font.size"] == 20.0
    for name in names:
        assert (first / name).read_bytes() == (again / name).read_bytes(), name


@pytest.mark.usefixtures("light_figures")
def test_without_ties(case_file: Path, tmp_path: Path) -> None:
    def change(text: str) -> str:
        head, rest = text.split("[ties]")
        return head + "[laser]" + rest.split("[laser]")[1]

    found = adjust_text(case_file, "no_ties.toml", change)
    assert kinds(write_figures(found, tmp_path)) == {"residuals", "orientation", "map", "connectivity"}


@pytest.mark.usefixtures("light_figures")
def test_held_images(case_file: Path, tmp_path: Path) -> None:
    def hold(which: int) -> Callable[[str], str]:
        return lambda text: text.replace('.isd"', '.isd"\nheld = true', which)

    for which in (1, 2):
        found = adjust_text(case_file, f"held{which}.toml", hold(which))
        assert found.network.held.sum() == which
        assert image_curve(found, 0).coupling == 0.0
        require_files(tmp_path / str(which), write_figures(found, tmp_path / str(which)))


def blunders(solution: Solution) -> Solution:
    """One point that nothing determines and one rejected ray."""
    lost = np.zeros(len(solution.network.points), dtype=bool)
    lost[0] = True
    rays_lost = lost[solution.network.rays.point]

    def blank(values: np.ndarray, where: np.ndarray) -> np.ndarray:
        return np.where(where.reshape(-1, *[1] * (values.ndim - 1)), np.nan, values)

    used = ~rays_lost
    used[np.flatnonzero(used)[0]] = False
    return replace(
        solution, places=blank(solution.places, lost), places_before=blank(solution.places_before, lost),
        covariances=blank(solution.covariances, lost), determined=~lost, rays_used=used,
        residuals=blank(solution.residuals, rays_lost), residuals_before=blank(solution.residuals_before, rays_lost),
    )


@pytest.mark.usefixtures("light_figures")
def test_undetermined_points_and_rejected_rays(solution: Solution, tmp_path: Path) -> None:
    found = blunders(solution)
    names = write_figures(found, tmp_path)
    require_files(tmp_path, names)
    said = captions(found)
    assert "Rejected measurements: 1." in said["residuals"]
    assert f"{len(found.network.points) - 1} points" in said["map"]


def repeated_joint(joint: JointCovariance, sets: int) -> JointCovariance:
    """Joint covariance of as many pairs, which have nothing in common."""
    root, at = joint.square_root, np.arange(sets)[:, None]
    one = SquareRoot(
        (root.first + joint.columns * at).ravel(), np.tile(root.width, sets), (root.members + 2 * at).ravel(),
        np.tile(root.sizes, sets), np.tile(root.frontals, sets), np.tile(root.rows, sets),
    )
    return JointCovariance(one, np.tile(joint.blocks, sets))


def repeated(solution: Solution, images: int, copies: int) -> Solution:
    """A block made of the pair's images again and again, and of its points `copies` times (only for drawing)."""
    network, points, rays = solution.network, solution.network.points, solution.network.rays
    n, sets = len(points), images // 2
    pictures = tuple(replace(network.images[j % 2], name=f"IMAGE/{j:03d}") for j in range(2 * sets))

    def times(values: np.ndarray, count: int) -> np.ndarray:
        return np.concatenate([values] * count)

    count = max(sets, copies)
    big = Network(
        pictures, network.priors * sets, np.zeros(2 * sets, dtype=bool),
        GroundPoints(
            tuple(f"P{i}" for i in range(n * count)), times(points.classes, count), times(points.kinds, count),
            times(points.places, count), times(points.covariances, count),
        ),
        ImageRays(
            np.concatenate([rays.point + k * n for k in range(count)]),
            np.concatenate([rays.image + 2 * (k % sets) for k in range(count)]),
            times(rays.places, count), times(rays.sigmas, count),
        ),
        Ranges(*(np.zeros(0, dtype=kind) for kind in (int, int, float, float, float))),
    )
    many = {name: times(getattr(solution, name), count) for name in (
        "places_before", "places", "covariances", "determined", "rays_used", "residuals", "residuals_before"
    )}
    none = np.zeros(0)
    return replace(
        solution, network=big, coefficients=solution.coefficients * sets,
        joint_covariance=repeated_joint(solution.joint_covariance, sets),
        range_residuals=none, range_residuals_before=none, ranges_used=np.zeros(0, dtype=bool), **many,
    )


@pytest.mark.usefixtures("light_figures")
def test_a_large_block_has_few_sheets_which_say_so(solution: Solution, tmp_path: Path) -> None:
    block = repeated(solution, 40, 1)
    names = write_figures(block, tmp_path)
    require_files(tmp_path, names)
    assert {"residuals.png", "orientation.png", "map.png"} <= set(names)
    said = captions(block)
    assert said["orientation"].startswith("40 images")
    assert "of 40 images" in said["residuals"]


@pytest.mark.usefixtures("light_figures")
def test_many_points_are_cells_or_thinned_which_is_said(solution: Solution, tmp_path: Path) -> None:
    found = repeated(solution, 2, 1000)
    assert found.network.rays.point.size == 120_000
    require_files(tmp_path, write_figures(found, tmp_path))
    said = captions(found)
    assert "60000 points, medians of" in said["map"]
    assert len(encoded(next(iter(map_sheets(found))), "svg")) < 4e6


@pytest.mark.usefixtures("light_figures")
def test_one_image(solution: Solution, tmp_path: Path) -> None:
    """One image and ground control that is fixed: no pair, no ties."""
    network, rays = solution.network, solution.network.rays
    keep = rays.image == 0
    classes = np.where(network.points.classes == PointClass.TIE, int(PointClass.CONTROL), network.points.classes)
    points = GroundPoints(
        network.points.ids, classes, np.full(classes.size, int(PointKind.FIXED)), solution.places,
        np.zeros((classes.size, 3, 3)),
    )
    only = Network(
        network.images[:1], network.priors[:1], np.zeros(1, dtype=bool), points,
        ImageRays(*(getattr(rays, name)[keep] for name in ("point", "image", "places", "sigmas"))), network.ranges,
    )
    found = mgsgraph.adjust_network(only, mgsgraph.SolverSettings(), "one image")
    require_files(tmp_path, write_figures(found, tmp_path))
    drawn = kinds([path.name for path in tmp_path.iterdir()])
    assert drawn == {"residuals", "orientation", "map", "connectivity"}


def test_units_of_the_map(solution: Solution) -> None:
    """5,000 lines of 1.446 ms at 3 km/s are 22 km on the ground, 1,024 samples 2.9 km (PE&RS 2005, MOC-NA)."""
    outline = plane_coordinates(footprint(solution.network.images[0]).outline, centre_of(solution.places)) / KM
    foot = 32  # the first edge runs along the lines
    down, across = (float(np.linalg.norm(outline[foot] - outline[k])) for k in (0, 40))
    assert (across, down) == pytest.approx((2.9, 22.0), rel=0.05)

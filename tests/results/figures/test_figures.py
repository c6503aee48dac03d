"""Figures: the numbers they show against other roads to the same numbers, and that sheets are made in every case."""

import logging
import tomllib
import xml.etree.ElementTree as ElementTree
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import matplotlib as mpl
import numpy as np
import pytest

import mgsgraph
from mgsgraph.adjustment.marginals import JointCovariance
from mgsgraph.adjustment.solution import Solution, orientation_profile
from mgsgraph.adjustment.square_root import SquareRoot
from mgsgraph.files.tie_points import PointKind
from mgsgraph.geometry.footprint import footprint
from mgsgraph.geometry.map_plane import centre_of, east_north
from mgsgraph.network import GroundPoints, ImageRays, Network, PointClass, Ranges
from mgsgraph.registration.measured import registration_discrepancy, registration_offsets
from mgsgraph.results.figures import write_figures
from mgsgraph.results.figures.content import image_residuals
from mgsgraph.results.figures.ground_map import map_sheet, tie_sigmas
from mgsgraph.results.figures.orientation import components, coupling, orientation_sheets
from mgsgraph.results.figures.registration import MOST_SHOTS, magnification, registration_sheets
from mgsgraph.results.figures.residuals import residual_sheets
from mgsgraph.results.figures.sheet import MOST_MARKS, encoded
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


def require_files(folder: Path, names: list[str], pixels: bool = False, large: bool = False) -> None:
    """Every PNG but an overview, and those of a `large` block, has its SVG, SVGs (and PNGs, if there are `pixels`) are
    whole, and that is all.
    """
    assert sorted(path.name for path in folder.iterdir()) == sorted(names)
    for name in names:
        data = (folder / name).read_bytes()
        if name.endswith(".png"):
            assert (name.replace(".png", ".svg") in names) != (large or name.startswith("overview_"))
            if pixels:
                assert len(data) > 10_000
                assert data[:8] == b"\x89PNG\r\n\x1a\n"
                assert data[-8:-4] == b"IEND"
        else:
            assert len(data) > 10_000
            assert ElementTree.fromstring(data).tag.endswith("svg")


# --- registration


def test_registration_after_is_the_residual_of_the_adjustment(solution: Solution) -> None:
    """Two roads to one number: Newton's projection here, the factors' residual there (one step: 1e-3 px)."""
    rays = solution.network.rays
    for j in range(2):
        found = registration_offsets(solution, j)
        rows = {int(rays.point[k]): k for k in np.flatnonzero(rays.image == j)}
        want = solution.residuals[[rows[int(i)] for i in found.points]]
        assert found.points.size == 20
        assert np.abs(found.offset_after - want).max() < 2e-3
        assert np.all(np.diff(found.lines) >= 0.0)


def test_registration_before_uses_what_was_known_beforehand(solution: Solution) -> None:
    """Rays of the nominal image through the projected places hit the a-priori footprints."""
    for j, image in enumerate(solution.network.images):
        found = registration_offsets(solution, j)
        origins, looks, _, _ = image.rays(found.before[:, 0], found.before[:, 1])
        to_point = solution.network.points.places[found.points] - origins
        looks = looks / np.linalg.norm(looks, axis=1)[:, None]
        assert np.linalg.norm(np.cross(looks, to_point), axis=1).max() < 1e-3  # m beside the ray


def moved_laser(solution: Solution, shift: np.ndarray) -> Solution:
    """The same with the a-priori footprints elsewhere."""
    points = solution.network.points
    places = points.places + np.where((points.classes == PointClass.LASER)[:, None], shift, 0.0)
    network = replace(solution.network, points=replace(points, places=places))
    return replace(solution, network=network)


def test_a_common_shift_of_footprints_moves_the_offsets_but_not_the_discrepancy(solution: Solution) -> None:
    up = centre_of(solution.places)
    up = up / np.linalg.norm(up)
    east = np.array([-up[1], up[0], 0.0]) / np.hypot(up[0], up[1])
    one, two = (registration_offsets(solution, j) for j in range(2))
    pair = registration_discrepancy(solution, one, two)
    for direction in (east, np.cross(up, east)):
        moved = moved_laser(solution, 40.0 * direction)
        shifted = [registration_offsets(moved, j) for j in range(2)]
        assert np.abs(shifted[0].offset_before - one.offset_before).max() > 8.0
        again = registration_discrepancy(moved, *shifted)
        assert np.abs(again.before - pair.before).max() < 0.1
    lifted = moved_laser(solution, 40.0 * up)  # heights don't cancel: that is parallax
    again = registration_discrepancy(lifted, *(registration_offsets(lifted, j) for j in range(2)))
    assert np.abs(again.before - pair.before).max() > 3.0


def test_an_image_against_itself_has_no_discrepancy(solution: Solution) -> None:
    one = registration_offsets(solution, 0)
    pair = registration_discrepancy(solution, one, one)
    assert pair.lines.size == 20
    assert max(np.abs(pair.before).max(), np.abs(pair.after).max()) < 1e-6


def test_unmeasured_laser_points_are_seen_but_have_no_offset(solution: Solution) -> None:
    network = solution.network
    keep = ~((network.points.classes[network.rays.point] == PointClass.LASER) & (network.rays.image == 1))
    rays = ImageRays(*(getattr(network.rays, name)[keep] for name in ("point", "image", "places", "sigmas")))
    fewer = replace(
        solution, network=replace(network, rays=rays), residuals=solution.residuals[keep],
        residuals_before=solution.residuals_before[keep], rays_used=solution.rays_used[keep],
    )
    found = registration_offsets(fewer, 1)
    assert found.points.size == 20
    assert np.all(np.isnan(found.offset_after))
    assert np.all(np.isfinite(found.after))
    assert np.all(np.diff(found.lines) > 0.0)
    assert registration_discrepancy(fewer, registration_offsets(fewer, 0), found).lines.size == 0


def test_registration_of_real_laser_points(shared_data: Path) -> None:
    """README of the data: the stored measures lie -13.2 and -18.6 lines from the unadjusted projections, constantly."""
    assert shared_data.is_dir()
    case = Path(__file__).resolve().parents[3] / "scripts" / "cases" / "lro_nac_lola.toml"
    found = mgsgraph.adjust(mgsgraph.read_case(case))
    for j, lines in enumerate((-13.2, -18.6)):
        offsets = registration_offsets(found, j).offset_before
        assert offsets.shape == (52, 2)
        assert offsets[:, 0].mean() == pytest.approx(lines, abs=0.1)
        assert offsets[:, 0].std() < 0.05


def test_thinned_shots_are_the_same_in_every_image(solution: Solution) -> None:
    one, two = (registration_offsets(solution, j, most=7) for j in range(2))
    assert one.points.size == 7
    assert set(one.points) == set(two.points)


# --- residuals, orientation, map


def test_image_residuals_are_all_rays_of_the_image(solution: Solution) -> None:
    every = [image_residuals(solution, j) for j in range(2)]
    assert sum(one.used.size for one in every) == solution.network.rays.point.size
    squares = sum(float(np.sum(one.residuals**2)) for one in every)
    assert squares == pytest.approx(float(np.sum(solution.residuals**2)))
    assert every[0].of(PointClass.LASER).size == 20
    assert every[0].of(PointClass.CONTROL).size == 0


def test_orientation_components_are_the_coefficients(solution: Solution) -> None:
    """At the image's middle u = 0: position and rotation corrections are the constant coefficients there."""
    profile = orientation_profile(solution, 0, 101)
    shown = [value[50] for value, _ in components(profile)]
    spread = [sigma[50] for _, sigma in components(profile)]
    unit = np.array([1.0, 1.0, 1.0, ARCSEC, ARCSEC, ARCSEC])
    assert np.abs(np.array(shown) * unit - solution.coefficients[0][0])[:3].max() < 1e-6
    assert np.abs(np.array(shown) * unit - solution.coefficients[0][0])[3:].max() < 1e-9
    want = np.sqrt(np.diagonal(solution.image_covariance(0))[:6])
    assert np.allclose(np.array(spread) * unit, want, rtol=1e-3)
    assert 0.5 < coupling(solution, 0) <= 1.0


def test_points_lie_inside_the_footprints_of_the_images_that_measure_them(solution: Solution) -> None:
    centre = centre_of(solution.places)
    for j, image in enumerate(solution.network.images):
        outline = footprint(image, correction=solution.correction(j)).outline
        assert np.array_equal(outline[0], outline[-1])
        ring = east_north(outline, centre)
        mine = solution.network.rays.point[solution.network.rays.image == j]
        for place in east_north(solution.places[mine], centre):
            to = ring - place
            turn = np.arctan2(to[:-1, 0] * to[1:, 1] - to[:-1, 1] * to[1:, 0], np.sum(to[:-1] * to[1:], axis=1))
            assert abs(abs(turn.sum()) - 2.0 * np.pi) < 1e-6  # once around: inside


def test_tie_sigmas_are_the_lengths_of_the_three_sigmas(solution: Solution) -> None:
    ties, sigmas = tie_sigmas(solution)
    assert ties.size == 40
    assert np.allclose(sigmas, np.linalg.norm(solution.sigmas[ties], axis=1))


def test_enlarged_marks_stay_near_their_place(solution: Solution) -> None:
    found = registration_offsets(solution, 0)
    factor = magnification(found)
    gap = np.ptp(found.lines) / 19.0
    assert factor == 1.0 or np.quantile(np.abs(found.offset_before), 0.9) * factor < gap


# --- files


def test_files_of_the_pair_whatever_the_users_style(
    solution: Solution, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    settings, first, again = dict(mpl.rcParams), tmp_path / "new" / "folder", tmp_path / "again"
    with caplog.at_level(logging.WARNING):
        names = write_figures(solution, first)
    require_files(first, names, pixels=True)
    assert {Path(name).stem for name in names} == {"residuals", "orientation", "registration", "map", "connectivity"}
    assert not caplog.records  # matplotlib complains by log, too
    assert dict(mpl.rcParams) == settings
    with mpl.rc_context({"font.size": 20.0, "axes.facecolor": "black", "svg.fonttype": "none", "text.usetex": False}):
        assert write_figures(solution, again) == names
        assert mpl.rcParams["font.size"] == 20.0
    for name in names:
        assert (first / name).read_bytes() == (again / name).read_bytes(), name
    assert b"<dc:date>" not in (first / "map.svg").read_bytes()


@pytest.mark.usefixtures("light_figures")
def test_without_laser_there_is_no_registration(case_file: Path, tmp_path: Path) -> None:
    found = mgsgraph.adjust(mgsgraph.read_case(case_file, laser=False))
    names = write_figures(found, tmp_path)
    require_files(tmp_path, names)
    assert kinds(names) == {"residuals", "orientation", "map", "connectivity"}


@pytest.mark.usefixtures("light_figures")
def test_without_ties(case_file: Path, tmp_path: Path) -> None:
    def change(text: str) -> str:
        head, rest = text.split("[ties]")
        return head + "[laser]" + rest.split("[laser]")[1]

    found = adjust_text(case_file, "no_ties.toml", change)
    assert kinds(write_figures(found, tmp_path)) == {"residuals", "orientation", "registration", "map", "connectivity"}


@pytest.mark.usefixtures("light_figures")
def test_held_images(case_file: Path, tmp_path: Path) -> None:
    def hold(which: int) -> Callable[[str], str]:
        return lambda text: text.replace('.isd"', '.isd"\nheld = true', which)

    for which in (1, 2):
        found = adjust_text(case_file, f"held{which}.toml", hold(which))
        assert found.network.held.sum() == which
        assert coupling(found, 0) == 0.0
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
    assert "rejected measures: 1" in (tmp_path / "residuals.svg").read_text()
    assert "points that nothing determines are left out (1)" in (tmp_path / "map.svg").read_text()


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
def test_a_large_block_has_overviews_and_few_sheets_which_say_so(solution: Solution, tmp_path: Path) -> None:
    block = repeated(solution, 40, 1)
    names = write_figures(block, tmp_path)
    require_files(tmp_path, names, large=True)
    assert {"overview_residuals.png", "overview_orientation.png"} <= set(names)
    drawn = {"residuals": residual_sheets, "orientation": orientation_sheets, "registration": registration_sheets}
    for kind, made in drawn.items():
        sheets = [name for name in names if name.startswith(kind) and name.endswith(".png")]
        assert sheets == [f"{kind}_{k + 1}.png" for k in range(2)]
        assert all("of 40 images the" in one.caption for one in made(block) if not one.name.startswith("overview_"))
    assert b"outlines of 40 images" in encoded(map_sheet(block), "svg")


@pytest.mark.usefixtures("light_figures")
def test_many_points_are_averaged_or_thinned_which_is_said(solution: Solution, tmp_path: Path) -> None:
    found = repeated(solution, 2, 1000)
    assert found.network.rays.point.size == 120_000
    names = write_figures(found, tmp_path)
    require_files(tmp_path, names)
    assert "overview_map.png" in names
    for name, words in (
        ("residuals", "the mean residuals of"), ("map", f"at most {MOST_MARKS} points"),
        ("registration", f"{MOST_SHOTS} of 20000 shots"),
    ):
        text = (tmp_path / f"{name}.svg").read_text()
        assert words in text
        assert len(text) < 4e6


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
    assert drawn == {"residuals", "orientation", "registration", "map", "connectivity"}


def test_units_of_the_map(solution: Solution) -> None:
    """5,000 lines of 1.446 ms at 3 km/s are 22 km on the ground, 1,024 samples 2.9 km (PE&RS 2005, MOC-NA)."""
    outline = east_north(footprint(solution.network.images[0]).outline, centre_of(solution.places)) / KM
    foot = 32  # the first edge runs along the lines
    down, across = (float(np.linalg.norm(outline[foot] - outline[k])) for k in (0, 40))
    assert (across, down) == pytest.approx((2.9, 22.0), rel=0.05)

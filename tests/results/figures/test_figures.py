"""Figures: the numbers they show against other roads to the same numbers; sheets are made in every case."""

import logging
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import matplotlib as mpl
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from matplotlib.collections import EllipseCollection
from matplotlib.quiver import Quiver
from pass_files import block

from mgsgraph.adjustment.adjust import adjust_network
from mgsgraph.adjustment.settings import SolverSettings
from mgsgraph.adjustment.solution import Solution, orientation_profile
from mgsgraph.analysis.statistics import medians, solution_connectivity
from mgsgraph.files.networks.tie_points import PointKind
from mgsgraph.geometry.body import centre_of, from_planetocentric, plane_coordinates
from mgsgraph.geometry.footprint import footprint
from mgsgraph.geometry.records import thinned
from mgsgraph.network import PointClass
from mgsgraph.results.figures import draw_figures, write_figures
from mgsgraph.results.figures.connectivity import adjacency
from mgsgraph.results.figures.map import MapWindow, cell_medians, message, points_window, window_sheet
from mgsgraph.results.figures.orientation import components, pass_curve
from mgsgraph.results.figures.residuals import residual_matrix
from mgsgraph.results.figures.sheet import FLAT, image_rows, means, round_figure
from mgsgraph.units import ARCSEC, KM


@pytest.fixture(scope="module")
def block_solution() -> Solution:
    return adjust_network(block().network, SolverSettings())


def captions(solution: Solution) -> dict[str, str]:
    """Of all sheets, by their names."""
    return {sheet.name: sheet.caption for _, sheet in draw_figures(solution)}


def test_orientation_components_are_the_coefficients(pair_solution: Solution) -> None:
    """At the image's middle u = 0: position and rotation corrections are the constant coefficients there."""
    profile = orientation_profile(pair_solution, 0, 101)
    shown, spread = (values[50] for values in components(profile))
    unit = np.array([1.0, 1.0, 1.0, ARCSEC, ARCSEC, ARCSEC])
    assert np.abs(shown * unit - pair_solution.coefficients[0][0])[:3].max() < 1e-6
    assert np.abs(shown * unit - pair_solution.coefficients[0][0])[3:].max() < 1e-9
    want = np.sqrt(np.diagonal(pair_solution.image_covariance(0))[:6])
    assert np.allclose(spread * unit, want, rtol=1e-3)


def test_points_lie_inside_the_footprints_of_the_images_that_measure_them(pair_solution: Solution) -> None:
    centre = centre_of(pair_solution.places)
    for j, image in enumerate(pair_solution.network.images):
        outline = footprint(image, correction=pair_solution.correction(j)).outline
        assert np.array_equal(outline[0], outline[-1])
        ring = plane_coordinates(outline, centre)
        mine = pair_solution.network.rays.point[pair_solution.network.rays.image == j]
        for place in plane_coordinates(pair_solution.places[mine], centre):
            to = ring - place
            turn = np.arctan2(to[:-1, 0] * to[1:, 1] - to[:-1, 1] * to[1:, 0], np.sum(to[:-1] * to[1:], axis=1))
            assert abs(abs(turn.sum()) - 2.0 * np.pi) < 1e-6  # once around: inside


# --- files


def test_files_of_the_pair_whatever_the_users_style(
    pair_solution: Solution, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    """Slow: the one test whose figures get their pixels, twice."""
    settings, first, again = dict(mpl.rcParams), tmp_path / "new" / "folder", tmp_path / "again"
    with caplog.at_level(logging.WARNING):
        names = write_figures(pair_solution, first)
    assert sorted(path.name for path in first.iterdir()) == sorted(names)
    assert {Path(name).stem for name in names} == {"residuals", "orientation", "map"}
    for name in names:
        data = (first / name).read_bytes()
        assert len(data) > 10_000
        assert (data[:8], data[-8:-4]) == (b"\x89PNG\r\n\x1a\n", b"IEND")
    assert not caplog.records  # matplotlib complains by log, too
    assert dict(mpl.rcParams) == settings
    with mpl.rc_context({"font.size": 20.0, "axes.facecolor": "black", "svg.fonttype": "none", "text.usetex": False}):
        assert write_figures(pair_solution, again) == names
        assert mpl.rcParams["font.size"] == 20.0
    for name in names:
        assert (first / name).read_bytes() == (again / name).read_bytes(), name


def one_image(solution: Solution) -> Solution:
    """And ground control that is fixed: no pair, no ties."""
    net, points = solution.network, solution.network.points
    classes = np.where(points.classes == PointClass.TIE, int(PointClass.CONTROL), points.classes)
    fixed = replace(points, classes=classes, kinds=np.full(classes.size, int(PointKind.FIXED)), places=solution.places,
                    covariances=np.zeros((classes.size, 3, 3)))  # fmt: skip
    only = replace(net, images=net.images[:1], priors=net.priors[:1], held=np.zeros(1, dtype=bool), points=fixed,
                   rays=net.rays.chosen(net.rays.image == 0),
                   ranges=net.ranges.chosen(net.ranges.image == 0))  # fmt: skip
    return adjust_network(only, SolverSettings())


def held(solution: Solution) -> Solution:
    return adjust_network(replace(solution.network, held=np.array([True, True])), SolverSettings())


def lossy(solution: Solution) -> Solution:
    """One point that nothing determines and one rejected ray."""
    rays = solution.network.rays
    kept = np.flatnonzero((rays.point != 0) | (rays.image == 0))
    found = adjust_network(replace(solution.network, rays=rays.chosen(kept)), SolverSettings())
    used = found.rays_used.copy()
    used[-1] = False
    return replace(found, rays_used=used)


@pytest.mark.usefixtures("light_figures")
@pytest.mark.parametrize("change", [one_image, held, lossy])
def test_odd_solutions_have_all_sheets(
    pair_solution: Solution, change: Callable[[Solution], Solution], tmp_path: Path
) -> None:
    found = change(pair_solution)
    names = write_figures(found, tmp_path)
    assert {Path(name).stem for name in names} == {"residuals", "orientation", "map"}
    said = captions(found)
    assert f"{np.count_nonzero(found.determined)} points" in said["map"]
    assert ("Rejected measurements: 1." in said["residuals"]) == (change is lossy)


def test_nothing_is_cut_off(block_solution: Solution, monkeypatch: pytest.MonkeyPatch) -> None:
    """The largest residual of each image, by its own mark, and every correction with its band lie within the axes."""
    spike = 999 * np.eye(900, 1)
    monkeypatch.setattr("mgsgraph.results.figures.orientation.pass_curve", lambda *asked: replace(
        one := pass_curve(*asked), values=one.values * spike[: len(one.values)]
    ))
    sheets = {sheet.name: sheet.figure.axes for _, sheet in draw_figures(block_solution)}
    assert "connectivity" in sheets  # of more than two images
    network, used = block_solution.network, block_solution.rays_used
    (marks,) = [line for panel in sheets["residuals"] for line in panel.lines]
    of_ties = used & (network.points.classes[network.rays.point] == PointClass.TIE)
    largest = [
        np.abs(block_solution.residuals[of_ties & (network.rays.image == j)]).max() for j in range(len(network.images))
    ]
    assert marks.get_xdata() == pytest.approx(largest)
    assert max(largest) < marks.axes.get_xlim()[1]
    for panel in sheets["passes"]:
        low, high = panel.get_ylim()
        for band in panel.collections:
            heights = np.concatenate([path.vertices[:, 1] for path in band.get_paths()])
            assert low < heights.min() <= heights.max() < high


@pytest.mark.usefixtures("light_figures")
def test_a_large_block_says_so(pair_solution: Solution, monkeypatch: pytest.MonkeyPatch) -> None:
    """Here two images and 28 points are many."""
    for name, most in (("orientation._NAMED", 1), ("residuals._NAMED", 1), ("connectivity._NAMED", 1),
                       ("connectivity._NUMBERED", 1), ("map.MOST_MARKS", 20)):  # fmt: skip
        monkeypatch.setattr(f"mgsgraph.results.figures.{name}", most)
    said = captions(pair_solution)
    assert said["orientation"].startswith("2 images")
    assert "28 points, medians of" in said["map"]


def test_units_of_the_map(pair_solution: Solution) -> None:
    """5,000 lines of 1.446 ms at 3 km/s are 22 km on the ground, 1,024 samples 2.9 km (PE&RS 2005, MOC-NA)."""
    image, centre = pair_solution.network.images[0], centre_of(pair_solution.places)
    outline = plane_coordinates(footprint(image).outline, centre) / KM
    foot = 32  # the first edge runs along the lines
    down, across = (float(np.linalg.norm(outline[foot] - outline[k])) for k in (0, 40))
    assert (across, down) == pytest.approx((2.9, 22.0), rel=0.05)


# --- what large blocks are drawn by


FLOATS = st.one_of(st.floats(-1e6, 1e6, width=32), st.just(float("nan")))


@given(st.lists(st.tuples(FLOATS, st.integers(0, 6)), max_size=60))
def test_means_and_medians_are_those_of_a_loop(pairs: list[tuple[float, int]]) -> None:
    values = np.array([value for value, _ in pairs])
    groups = np.array([group for _, group in pairs], dtype=np.int64)
    for found, of in ((means(values, groups, 7), np.mean), (medians(values, groups, 7), np.median)):
        for k in range(7):
            mine = values[(groups == k) & np.isfinite(values)]
            assert found[k] == pytest.approx(of(mine) if mine.size else np.nan, rel=1e-6, abs=1e-6, nan_ok=True)


def test_the_residual_matrix_has_the_medians_of_images_and_lines(block_solution: Solution) -> None:
    solution = block_solution
    rays, network = solution.network.rays, solution.network
    found = residual_matrix(solution, PointClass.TIE)
    assert found is not None
    bins = found.shape[2]
    compared = 0
    for j, image in enumerate(network.images):
        for b in range(bins):
            part = np.minimum(rays.places[:, 0] / image.lines * bins, bins - 1).astype(int)
            mine = (rays.image == j) & (part == b) & solution.rays_used & (network.points.classes[rays.point] == 0)
            if np.any(mine):
                assert found[:, j, b] == pytest.approx(np.median(solution.residuals[mine], axis=0), rel=1e-5)
                compared += 1
            else:
                assert np.all(np.isnan(found[:, j, b]))
    assert compared > 5


def test_cells_of_the_map_are_those_of_a_loop() -> None:
    rng = np.random.default_rng(11)
    box = np.array([-2e3, 1e3, 6e3, 3e3])
    places, values = rng.uniform(box[:2], box[2:], (3000, 2)), rng.normal(size=3000)
    middles, (found,) = cell_medians(box, places, values)
    rows, columns = found.shape
    assert (rows, columns) == (25, 100)
    size = (box[2:] - box[:2]) / [columns, rows]
    at = np.floor((places - box[:2]) / size).astype(int)
    for row in range(rows):
        for column in range(columns):
            mine = values[(at[:, 0] == column) & (at[:, 1] == row)]
            want = np.median(mine) if mine.size else np.nan
            assert found[row, column] == pytest.approx(want, rel=1e-5, nan_ok=True)
    assert middles[columns + 3] == pytest.approx(box[:2] + size * [3.5, 1.5])


@given(st.integers(1, 300), st.integers(1, 40))
def test_rows_are_all_used_and_in_order(images: int, most: int) -> None:
    row = image_rows(images, most)
    assert row.size == images
    assert np.array_equal(np.unique(row), np.arange(min(images, most)))
    assert np.all(np.diff(row) >= 0)
    assert np.ptp(np.bincount(row)) <= 1


def test_cells_of_links_have_the_most_points_of_their_pairs(block_solution: Solution) -> None:
    connected = solution_connectivity(block_solution)
    count, most = len(connected.names), 3
    found, row = adjacency(connected, most), image_rows(count, most)
    want = np.full((most, most), np.nan)
    for (i, j), points in zip(connected.pairs.tolist(), connected.points.tolist(), strict=True):
        if points:
            for a, b in ((row[i], row[j]), (row[j], row[i])):
                want[a, b] = np.fmax(want[a, b], points)
    assert np.array_equal(found, want, equal_nan=True)


# --- small pure functions behind the figures


def test_map_is_true_to_distance_and_direction() -> None:
    """Against the spherical law: a point x rad along a great circle lies x R from the centre; poles included."""
    for longitude, latitude in ((0.3, 0.7), (-3.1, -1.2), (1.0, 0.5 * np.pi)):
        centre = from_planetocentric(np.array([longitude, latitude, 3.39e6]))
        north_pole_of_it = np.array([-np.sin(latitude) * np.cos(longitude), -np.sin(latitude) * np.sin(longitude),
                                     np.cos(latitude)])
        for angle in (1e-7, 0.1, 2.5):
            point = np.cos(angle) * centre + np.sin(angle) * 3.39e6 * north_pole_of_it
            place = plane_coordinates(point[None], centre)[0]
            assert np.hypot(*place) == pytest.approx(angle * 3.39e6, rel=1e-8)
            if latitude < 1.5:
                assert place[1] == pytest.approx(angle * 3.39e6, rel=1e-8)
        assert np.abs(plane_coordinates(centre[None], centre)).max() < 1e-6


@given(st.floats(1e-12, 1e12))
def test_round_figures(value: float) -> None:
    step = round_figure(value)
    assert step <= value * (1.0 + 1e-6) < 2.5 * step * (1.0 + 1e-6)
    assert f"{step:.0e}"[0] in "125"


@given(st.integers(0, 5000), st.integers(2, 400))
def test_thinning_keeps_both_ends(size: int, most: int) -> None:
    chosen = thinned(size, most)
    assert chosen.size == min(size, most)
    assert len(set(chosen.tolist())) == chosen.size
    if size:
        assert (chosen[0], chosen[-1]) == (0, size - 1)


# --- the studio's map as a figure


NORTH_POLE = np.array([0.0, 0.0, 3.38e6])


def window(n: int = 12) -> MapWindow:
    random = np.random.default_rng(4)
    places = random.uniform(-1e4, 1e4, (n, 2))
    covariances = np.tile(np.diag([9.0, 4.0]), (n, 1, 1))
    return MapWindow(
        "block", NORTH_POLE, np.array([-1e4, -1e4, 1e4, 1e4]), {"one": places[:4]}, places, np.arange(float(n)),
        ("3-D sigma", "m"), (0.0, float(n)), n, np.full(n, int(PointClass.TIE)), covariances,
        np.tile([3.0, -4.0], (n, 1)), None, 50.0,
    )  # fmt: skip


def test_ellipses_hold_95_percent() -> None:
    panel = window_sheet(window()).figure.axes[0]
    (ellipses,) = [one for one in panel.collections if isinstance(one, EllipseCollection)]
    assert np.allclose(ellipses.get_widths(), 2e-3 * 50.0 * 3.0 * np.sqrt(5.991465), rtol=1e-6)
    assert np.allclose(ellipses.get_heights(), 2e-3 * 50.0 * 2.0 * np.sqrt(5.991465), rtol=1e-6)
    drawn = np.random.default_rng(5).multivariate_normal([0.0, 0.0], [[9.0, 0.0], [0.0, 4.0]], 40_000)
    across, up = ellipses.get_widths()[0] / 0.1, ellipses.get_heights()[0] / 0.1
    assert np.mean((drawn[:, 0] / across) ** 2 + (drawn[:, 1] / up) ** 2 < 1.0) == pytest.approx(0.95, abs=0.005)


@pytest.mark.parametrize("factor", [50.0, 0.0])
def test_corrections_are_as_long_as_said(factor: float) -> None:
    sheet = window_sheet(replace(window(), factor=factor))
    (arrows,) = [one for one in sheet.figure.axes[0].collections if isinstance(one, Quiver)]
    said = arrows.U[0] / 3e-3
    assert np.allclose(arrows.V, -4e-3 * said)
    assert f"{said:g} times" in sheet.caption
    assert factor in (0.0, pytest.approx(said))


def test_cells_lie_where_they_are() -> None:
    values = np.full((4, 5), np.nan)
    values[0, 4] = 7.0
    cells = replace(window(), classes=None, values=values, covariances=None, moved=None)
    (picture,) = window_sheet(cells).figure.axes[0].images
    assert picture.get_array()[0, 4] == 7.0
    assert picture.get_array().count() == 1
    assert picture.origin == "lower"
    assert picture.get_extent() == [-10.0, 10.0, -10.0, 10.0]


@given(st.floats(0.5, 1e5), st.floats(0.0, 10.0))
def test_colors_begin_at_zero_and_only_what_varies_is_said_to(least: float, spread: float) -> None:
    values = least * np.linspace(1.0, 1.0 + spread, 50)
    shown = window(50)
    about = shown.name, shown.centre, shown.places, shown.outlines
    assert shown.classes is not None
    made = points_window(about, shown.places, values, shown.quantity, shown.classes)
    low, high = np.quantile(values, [0.02, 0.98])
    assert made.scale == (0.0, pytest.approx(high))
    assert ("the same" in message(made)) == (high < FLAT * low)


@pytest.mark.parametrize("width", [1e4, 2e3])
def test_names_of_outlines_do_not_collide(width: float) -> None:
    """Each number lies on its own outline. Ellipses keep their shape on a long map."""
    corners = np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0], [-1.0, -1.0]]) * [width, 2e4]
    outlines = {"one": corners, "other": corners * 0.97, "third": corners * 0.5}
    shown = replace(window(), box=np.array([-width, -2e4, width, 2e4]), outlines=outlines)
    panel = window_sheet(shown).figure.axes[0]
    labels = [one for one in panel.texts if one.get_text() in "123"]
    for label, outline in zip(labels, outlines.values(), strict=True):
        assert np.linalg.norm(outline / KM - label.xy, axis=1).min() < 1e-9
    (ellipses,) = [one for one in panel.collections if isinstance(one, EllipseCollection)]
    assert (panel.get_aspect() == "auto") == (width < 5e3)
    assert ellipses._units == "y"  # the scale of the longer side

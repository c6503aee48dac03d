"""Matching from end to end on a small simulated pair, sparse and dense: against truth, and what is written of it."""

import json
from dataclasses import replace
from functools import cache
from pathlib import Path

import matched
import numpy as np
import pytest
from commands import rows_of
from numpy.typing import NDArray

from mgsgraph.errors import InputError
from mgsgraph.files.networks.table import read_tie_points
from mgsgraph.files.networks.tie_points import PointKind
from mgsgraph.matching.dense import DenseMatches, dense_matches
from mgsgraph.matching.match import Matches, match_scene, matches_of
from mgsgraph.matching.measuring import Measured
from mgsgraph.matching.patches import Patch, disparities
from mgsgraph.matching.scene import Picture, Scene
from mgsgraph.results.matching import match_statements, write_matches

FEW = replace(matched.SETTINGS, cells=20, features=400)


# above two seconds: matches two and three pictures whole, once for all tests of the run
@pytest.mark.parametrize("count", [2, 3])
def test_matches_are_where_the_ground_is(count: int) -> None:
    found = matched.matches(count)
    off = matched.errors(found)
    assert np.all(np.sqrt(np.mean(off**2, axis=0)) < 0.3)
    assert np.linalg.norm(off, axis=1).max() < 1.5
    filled, whole = found.cells
    assert whole > 50
    assert filled > 0.8 * whole
    assert len(off) >= 100


@pytest.mark.parametrize("count", [2, 3])
def test_tie_points_are_in_order(count: int) -> None:
    """Free points; the reference first, a pixel's centre; every sigma positive and finite."""
    found = matched.matches(count)
    ties = found.ties
    assert len(set(ties.ids)) == len(ties.ids) == ties.measure_point.max() + 1
    assert np.all(ties.kinds == PointKind.FREE)
    assert np.all(np.diff(ties.measure_point) >= 0)
    begins = np.flatnonzero(np.diff(ties.measure_point, prepend=-1))
    np.testing.assert_array_equal(np.flatnonzero(found.reference), begins)
    np.testing.assert_array_equal(ties.measures[begins] % 1.0, 0.5)
    if count == 2:  # two features beside one sharp pixel are measured at that pixel, both
        assert len(np.unique(ties.measures[begins], axis=0)) == len(begins)
    assert np.all((ties.measure_sigmas > 0.0) & (ties.measure_sigmas < 0.5))
    assert np.all(found.covariances[begins] == 0.0)
    others = ~found.reference
    assert np.all(np.linalg.eigvalsh(found.covariances[others]) > 0.0)
    assert np.all(found.correlation[others] >= matched.SETTINGS.least_correlation)
    assert np.all(np.isfinite(found.misfit) == others)
    pairs = set(zip(ties.measure_point.tolist(), ties.measure_image, strict=True))
    assert len(pairs) == len(ties.measure_image)  # no point twice in an image
    size = [matched.LINES, 1024]
    assert np.all((ties.measures > 0.0) & (ties.measures < size))


def test_what_is_lost_is_counted() -> None:
    found = matched.matches()
    counts = [value for name, value in found.losses._asdict().items() if name != "linked"]
    assert counts == sorted(counts, reverse=True)
    assert found.losses.kept == np.count_nonzero(~found.reference) == len(found.ties.ids)
    (agreement,) = found.agreements
    assert agreement.moved == pytest.approx(229.0, abs=15.0)  # the published contradiction of this pair
    assert agreement.agreed > 0.8 * agreement.candidates
    assert 5.0 < agreement.height_sigma < 40.0
    assert found.step == pytest.approx(4.0, abs=0.3)  # the second image's
    assert repr(found) == f"Matches({len(found.ties.ids)} points in 60 of 60 cells)"


def test_cells_hold_no_more_than_wanted() -> None:
    found, scene = matched.matches(), matched.scene()
    ties = found.ties
    first = np.array([name == scene.pictures[0].image.name for name in ties.measure_image])
    plane = scene.pictures[0].on_chart(scene.ground, ties.measures[first & found.reference])
    cells, counts = np.unique(np.floor(plane / found.cell), axis=0, return_counts=True)
    # the nominal orientation shifts the chart a little: a match at an edge may count as its neighbour's
    assert np.mean(counts > matched.SETTINGS.per_cell) < 0.2
    assert len(cells) > 50


def test_tracks_of_three_agree_with_each_other() -> None:
    found = matched.matches(3)
    rays = np.bincount(found.ties.measure_point)
    assert np.sum(rays == 3) > 50
    assert rays.max() == 3
    names = list(matched.truth())
    by_point = found.ties.measures[np.isin(found.ties.measure_point, np.flatnonzero(rays == 3))].reshape(-1, 3, 2)
    images = [name for name, i in zip(found.ties.measure_image, found.ties.measure_point, strict=True) if rays[i] == 3]
    places = {name: np.full((len(by_point), 2), np.nan) for name in names}
    for row, name in enumerate(images):
        places[name][row // 3] = by_point[row // 3, row % 3]
    again = places[names[2]] - places[names[0]]  # the first image over again
    assert np.all(np.linalg.norm(again, axis=1) < 0.5)
    assert np.all(np.sqrt(np.mean(again**2, axis=0)) < 0.1)
    across = places[names[1]] - matched.true_places(names[2], places[names[2]], names[1])
    assert np.all(np.sqrt(np.mean(across**2, axis=0)) < 0.3)
    assert {frozenset((a.first, a.second)) for a in found.agreements} <= {
        frozenset(pair) for pair in ((0, 1), (0, 2), (1, 2))
    }
    parallel = [a for a in found.agreements if {a.first, a.second} == {0, 2}]
    assert all(np.isnan(a.height_sigma) for a in parallel)  # rays side by side tell no heights


def test_variances_are_shared_half_and_half() -> None:
    """The reference's, carried into the other picture, and the other's add up to the match's."""
    rng = np.random.default_rng(1)
    affine = np.array([[[1.1, 0.1], [-0.2, 0.8]], [[0.9, 0.0], [0.1, 1.2]], [[1.0, 0.3], [0.0, 1.0]]])
    roots = rng.standard_normal((3, 2, 2))
    covariances = 1e-3 * (roots @ roots.mT + np.eye(2))
    whole = np.zeros(3, dtype=np.int64)
    measured = Measured(
        np.array([4, 4, 9]), np.array([1, 1, 0]), np.array([0, 2, 2]), whole,
        np.array([[3.5, 4.5], [3.5, 4.5], [7.5, 8.5]]), rng.uniform(0.0, 9.0, (3, 2)), affine, covariances,
        np.array([0.9, 0.8, 0.7]), whole, np.ones(3, dtype=bool),
    )  # fmt: skip
    ties, told, correlation, misfit = matches_of(measured, np.array([0.1, 0.2, 0.3]), ("a", "b", "c"), np.array([1, 0]))
    assert [name[-7:] for name in ties.ids] == ["_000001", "_000002"]
    assert len({name[:9] for name in ties.ids}) == 1
    assert ties.measure_image == ("a", "c", "b", "a", "c")  # the second track was to be numbered first
    assert ties.measure_point.tolist() == [0, 0, 1, 1, 1]
    np.testing.assert_array_equal(ties.measures[[0, 2]], [[7.5, 8.5], [3.5, 4.5]])
    np.testing.assert_array_equal(told[[1, 3, 4]], covariances[[2, 0, 1]])
    np.testing.assert_array_equal(np.isnan(correlation), [True, False, True, False, False])
    np.testing.assert_array_equal(misfit[[1, 3, 4]], [0.3, 0.1, 0.2])
    variance = np.diagonal(covariances, axis1=1, axis2=2)
    np.testing.assert_allclose(ties.measure_sigmas[[1, 3, 4]] ** 2, 0.5 * variance[[2, 0, 1]])
    inverse = np.linalg.inv(affine)
    carried = np.diagonal(inverse @ covariances @ inverse.mT, axis1=1, axis2=2)
    np.testing.assert_allclose(ties.measure_sigmas[0] ** 2, 0.5 * carried[2])
    np.testing.assert_allclose(ties.measure_sigmas[2] ** 2, 0.25 * (carried[0] + carried[1]))


# ---- tiles, workers, and what is kept


@pytest.fixture
def many_tiles(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("mgsgraph.matching.patches._SIZE", 400)


def assert_equal(one: Matches, other: Matches) -> None:
    for name in ("covariances", "correlation", "misfit"):
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name))
    for name in ("measures", "measure_sigmas", "measure_point"):
        np.testing.assert_array_equal(getattr(one.ties, name), getattr(other.ties, name))
    assert one.ties.measure_image == other.ties.measure_image
    assert one.losses == other.losses


@pytest.mark.slow
@pytest.mark.usefixtures("many_tiles")
def test_workers_change_nothing() -> None:
    scene, told = matched.scene(), list[tuple[str, int, int]]()
    alone = match_scene(scene, FEW, workers=1)
    assert_equal(match_scene(scene, FEW, 2, lambda *step: told.append(step)), alone)
    count = max(most for what, _, most in told if what == "matching")
    assert count > 3
    assert [done for what, done, _ in told if what == "matching"] == list(range(count + 1))
    assert {what: most for what, done, most in told if done == most} == {
        "coarse grid": 2, "matching": count, "measuring": 2,
    }  # fmt: skip


# above two seconds: a pair matched whole
def test_a_narrow_search_still_finds_what_is_near() -> None:
    """Images whose orientations are known well: a search of less than a few pixels of the coarse grid."""
    found = match_scene(matched.true_scene(), replace(FEW, search=20.0), workers=1)
    assert found.agreements[0].moved < 10.0
    assert np.linalg.norm(matched.errors(found), axis=1).max() < 1.5


# --- dense matches


SPACING = 50.0


@cache
def scene() -> Scene:
    """The pair as it was taken, over the model of its ground, not over the ground itself."""
    pictures = [Picture(image.true, image.pixels, matched.prior(100.0)) for image in matched.site().images]
    return Scene(tuple(pictures), matched.ground(matched.site().grid))


@cache
def found() -> DenseMatches:
    (one,) = dense_matches(scene(), SPACING)
    return one


@cache
def off() -> NDArray[np.float64]:
    """(n, 2) pixels from where the ground under the anchors truly is on the second picture."""
    names = [scene().pictures[j].image.name for j in (found().first, found().second)]
    return found().pixels - matched.true_places(names[0], found().anchors, names[1])


def test_nearly_every_post_is_matched_where_its_ground_is() -> None:
    assert len(off()) > 0.94 * found().posts
    assert np.all(np.sqrt(np.mean(off() ** 2, axis=0)) < 0.2)
    assert np.mean(np.linalg.norm(off(), axis=1) > 1.0) < 1e-3


def test_posts_are_on_a_grid_over_all_the_ground_that_both_show() -> None:
    one, two = (scene().pictures[j] for j in (found().first, found().second))
    plane = one.on_chart(scene().ground, found().anchors)
    lines, samples = np.meshgrid(np.arange(10.0, one.image.lines), np.arange(10.0, one.image.samples), indexing="ij")
    every = one.on_chart(scene().ground, np.column_stack([lines.ravel(), samples.ravel()])[::37])
    places = two.project(scene().ground.points(every))
    shared = np.all((places > 0.0) & (places < [two.image.lines, two.image.samples]), axis=1).mean()
    whole = shared * one.image.lines * one.image.samples * 2.88 * 4.42  # m along and across of a pixel
    assert found().posts == pytest.approx(whole / SPACING**2, rel=0.1)
    np.testing.assert_array_equal(found().anchors % 1.0, 0.5)
    apart = np.linalg.norm(plane[:, None] - plane[None, :200], axis=2)
    apart[apart == 0.0] = np.inf
    nearest = apart.min(axis=0)
    assert np.median(nearest) == pytest.approx(SPACING, rel=0.1)


def test_covariances_are_those_of_the_errors() -> None:
    squares = np.einsum("ni,nij,nj->n", off(), np.linalg.inv(found().covariances), off())
    assert 0.5 < np.mean(squares) / 2.0 < 1.5
    sigmas = np.sqrt(np.diagonal(found().covariances, axis1=1, axis2=2).mean(axis=0))
    assert np.all(np.abs(np.log(sigmas / np.sqrt(np.mean(off() ** 2, axis=0)))) < np.log(1.5))


def test_threads_don_t_matter_and_progress_is_told() -> None:
    told = []
    several, one = (
        dense_matches(scene(), 4.0 * SPACING, workers, lambda *what: told.append(what))[0] for workers in (None, 1)
    )
    np.testing.assert_array_equal(several.pixels, one.pixels)
    assert told[0] == ("dense matching", 0, told[0][2])
    assert told[-1] == ("dense matching", told[0][2], told[0][2])


def test_orientations_that_contradict_each_other_give_hardly_a_match() -> None:
    """228 m between the nominal orientations: nothing is alike along the parallax, and chance is not delivered."""
    with pytest.raises(InputError, match=r"none of \d+ posts matches; expected .* adjusted orientations"):
        dense_matches(matched.scene(), 2.0 * SPACING)


@pytest.mark.parametrize("shift", [-7, 0, 11])
def test_disparities_of_a_shifted_patch(shift: int) -> None:
    rng = np.random.default_rng(2)
    grey = np.kron(rng.integers(40, 210, (60, 90)), np.ones((2, 2))).astype(np.uint8)
    valid = np.full(grey.shape, 255, dtype=np.uint8)
    half = valid.copy()
    half[:, :60] = 0
    found = disparities(Patch(grey, half), Patch(np.roll(grey, -shift, axis=1), valid), 16)
    inner = found[10:-10, 80:-40]
    assert np.isfinite(inner).mean() > 0.95
    assert np.nanmedian(inner) == pytest.approx(shift, abs=0.1)
    assert np.all(np.isnan(found[:, :60]))


# --- what matching writes


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("matches") / "out"
    write_matches(matched.matches(3), matched.scene(3), "three images", matched.SETTINGS, folder)
    return folder


@pytest.mark.parametrize("name", ["network.pvl", "network.net"])
def test_networks_hold_the_ties(written: Path, name: str) -> None:
    ties, found = matched.matches(3).ties, read_tie_points(written / name, matched.scene(3).ground.body)
    assert found.ids == ties.ids
    assert found.measure_image == ties.measure_image
    np.testing.assert_array_equal(found.measure_point, ties.measure_point)
    np.testing.assert_allclose(found.measures, ties.measures, atol=1e-9)
    np.testing.assert_allclose(found.measure_sigmas, ties.measure_sigmas, rtol=1e-6)
    np.testing.assert_array_equal(found.kinds, ties.kinds)


def test_pixels_in_networks_are_those_of_isis(written: Path) -> None:
    text = (written / "network.pvl").read_text(encoding="utf-8")
    line = matched.matches(3).ties.measures[0, 0]
    assert f"= {line + 0.5:g}" in text


def test_table_has_every_measure(written: Path) -> None:
    found = matched.matches(3)
    rows = rows_of(written / "matches.csv")
    assert len(rows) == len(found.ties.measure_image)
    assert [row["image"] for row in rows] == list(found.ties.measure_image)
    assert [row["id"] for row in rows] == [found.ties.ids[i] for i in found.ties.measure_point.tolist()]
    assert [row["reference"] == "true" for row in rows] == found.reference.tolist()
    for name, values in (
        ("isis_line", found.ties.measures[:, 0] + 0.5),
        ("isis_sample", found.ties.measures[:, 1] + 0.5),
        ("sigma_line_px", found.ties.measure_sigmas[:, 0]),
        ("against_reference_line_sample_px2", found.covariances[:, 0, 1]),
        ("correlation", found.correlation),
        ("coplanarity_m", found.misfit),
    ):
        told = np.array([float(row[name]) if row[name] else np.nan for row in rows])
        np.testing.assert_array_equal(told, values)


def test_the_record_has_what_was_found(written: Path) -> None:
    found = matched.matches(3)
    record = json.loads((written / "match.json").read_text(encoding="utf-8"))
    assert record["program"] == "mgsgraph"
    assert record["points"] == len(found.ties.ids)
    assert record["measures"] == len(found.ties.measure_image)
    assert record["losses"]["kept"] == found.losses.kept
    assert record["settings"]["cells"] == matched.SETTINGS.cells
    assert (record["cells_with_matches"], record["cells"]) == found.cells
    assert None in [one["height_sigma_m"] for one in record["orientations"]]  # parallel rays
    assert record["statements"] == match_statements(found, matched.scene(3))

"""What the studio says of places and points: the ground in all images, Jacobians, ellipses, refinement, sheets."""

import shutil
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import cast

import matched
import numpy as np
import pytest
from commands import call
from outside import refuses
from PIL import Image
from sites import plain_site

from mgsgraph.adjustment.adjust import adjust_network
from mgsgraph.adjustment.settings import SolverSettings
from mgsgraph.adjustment.solution import Solution
from mgsgraph.analysis.measures import MeasureKind
from mgsgraph.analysis.posterior import Posterior, cross_covariances
from mgsgraph.analysis.reliability import reliability
from mgsgraph.case.reading import read_case
from mgsgraph.errors import InputError
from mgsgraph.geometry.body import centre_of, east_north_up, geodetic, plane_coordinates
from mgsgraph.geometry.records import Array
from mgsgraph.geometry.terrain import areoid_heights
from mgsgraph.network.corrections import whole_correction
from mgsgraph.network.parts import KnownImage, alone, with_images
from mgsgraph.project.reading import posterior_near, read_posterior
from mgsgraph.simulation.files import write_site
from mgsgraph.studio.changes import change
from mgsgraph.studio.linked import Ellipse, GroundModel, LinkedImages, ground_record
from mgsgraph.studio.map_images import ground_at
from mgsgraph.studio.marks import laser_profiles, shots_of, ties_of
from mgsgraph.studio.opened import Block, Opened
from mgsgraph.studio.point_sheet import answer_of, correlations, point_sheet, refine
from mgsgraph.studio.point_sheet import tests_of as judged


@pytest.fixture(scope="module")
def solution(pair_solution: Solution) -> Solution:
    return pair_solution


@pytest.fixture(scope="module")
def block(solution: Solution) -> Block:
    """On the heights of its points alone, which do not change with the orientation here."""
    return replace(Block.of_solution(solution), terrain=None)


def middle(block: Block, image: int = 0) -> tuple[float, float]:
    """The place of a tie, where all images see the ground."""
    rays = block.rays_by_image[image]
    line, sample = block.network.rays.places[rays].mean(axis=0)
    return float(line), float(sample)


def test_others_show_the_ground_under_a_place(block: Block) -> None:
    linked = LinkedImages(block)
    line, sample = middle(block)
    ground, (other,) = linked.under(block.images[0].name, line, sample)
    back, _ = block.images[0].ground_to_image(ground.point[None], block.corrections[0])
    np.testing.assert_allclose(back[0], [line, sample], atol=1e-6)
    there, _ = block.images[1].ground_to_image(ground.point[None], block.corrections[1])
    np.testing.assert_allclose(other.place, there[0], atol=1e-9)
    assert other.inside
    assert geodetic(ground.point, block.images[0].body)[2] == pytest.approx(ground.height, abs=1e-6)


def test_ground_is_near_the_adjusted_ties(block: Block, solution: Solution) -> None:
    """The ray of a measure meets the ground, at the height of points nearby, close to the point that was measured."""
    rays, model = solution.network.rays, GroundModel(block)
    for k in np.flatnonzero(solution.rays_used)[::7].tolist():
        ground = model.under(int(rays.image[k]), *rays.places[k].tolist())
        assert np.linalg.norm(ground.point - solution.places[rays.point[k]]) < 60.0


def test_jacobian_is_the_change_of_the_predicted_place(block: Block) -> None:
    line, sample = middle(block)
    ground, (other,) = LinkedImages(block).under(block.images[0].name, line, sample)
    numeric = np.zeros((2, 2))
    for k, (down, right) in enumerate(((0.5, 0.0), (0.0, 0.5))):
        ends = [_at_height(block, line + sign * down, sample + sign * right, ground.height) for sign in (-1.0, 1.0)]
        numeric[:, k] = ends[1] - ends[0]
    np.testing.assert_allclose(other.jacobian, numeric, atol=2e-4)


def _at_height(block: Block, line: float, sample: float, height: float, values: list[Array] | None = None) -> Array:
    """Where the second image shows the ground at a height under a place of the first; by other unknowns, if given."""
    corrections = [
        block.corrections[j] if values is None else whole_correction(block.network, j, values, block.settings.angles)
        for j in range(2)
    ]
    point, _ = block.images[0].image_to_ground(np.array([line]), np.array([sample]), height, corrections[0])
    return np.asarray(block.images[1].ground_to_image(point, corrections[1])[0][0])


def test_ellipse_is_the_propagated_covariance_of_both_orientations(block: Block, solution: Solution) -> None:
    line, sample = middle(block)
    ground, (other,) = LinkedImages(block).under(block.images[0].name, line, sample)
    assert other.ellipse is not None
    values = [np.array(one, dtype=np.float64) for one in solution.values]
    columns = []
    for v in range(2):
        for c in range(values[v].size):
            sigma = float(np.sqrt(solution.joint_covariance.block(v, v)[c, c]))
            step = sigma if sigma > 0.0 else 1e-6
            ends = []
            for sign in (-1.0, 1.0):
                moved = [one.copy() for one in values]
                moved[v][c] += sign * step
                ends.append(_at_height(block, line, sample, ground.height, moved))
            columns.append((ends[1] - ends[0]) / (2.0 * step))
    design = np.array(columns).T
    expected = design @ solution.joint_covariance.of([0, 1]) @ design.T
    high = _at_height(block, line, sample, ground.height + 1.0) - _at_height(block, line, sample, ground.height - 1.0)
    expected += ground.height_sigma**2 * np.outer(high, high) / 4.0
    np.testing.assert_allclose(other.ellipse.covariance, expected, rtol=2e-3, atol=1e-9)


def test_what_both_orientations_share_cancels(block: Block) -> None:
    """An ellipse is smaller than that of the two images as if they knew nothing of each other."""
    line, sample = middle(block)
    _, (other,) = LinkedImages(block).under(block.images[0].name, line, sample)
    _, (nominal,) = LinkedImages(
        Block.of_network(block.network, block.settings)
    ).under(block.images[0].name, line, sample)
    assert other.ellipse is not None
    assert nominal.ellipse is not None
    assert other.ellipse.semi_axes[0] < 0.5 * nominal.ellipse.semi_axes[0]


def test_ellipse_holds_its_share_of_places() -> None:
    covariance = np.array([[4.0, 1.5], [1.5, 1.0]])
    found = Ellipse.of(covariance)
    places = np.random.default_rng(1).multivariate_normal([0.0, 0.0], covariance, 40_000)
    along = places[:, 1] * np.cos(found.angle) + places[:, 0] * np.sin(found.angle)
    across = -places[:, 1] * np.sin(found.angle) + places[:, 0] * np.cos(found.angle)
    inside = (along / found.semi_axes[0]) ** 2 + (across / found.semi_axes[1]) ** 2 <= 1.0
    assert inside.mean() == pytest.approx(0.95, abs=0.005)


def test_words_say_which_surface(block: Block, solution: Solution) -> None:
    line, sample = middle(block)
    assert "adjusted point" in GroundModel(block).under(0, line, sample).surface
    bare = replace(block, places=np.full_like(block.places, np.nan))
    assert "ellipsoid" in GroundModel(bare).under(0, line, sample).surface
    nominal = Block.of_network(block.network, block.settings)
    record = ground_record(*LinkedImages(nominal).under(block.images[0].name, line, sample), nominal)
    assert record["sigmas"] == "a-priori"
    assert not nominal.adjusted


def test_places_that_show_nothing_are_one_line(block: Block) -> None:
    linked, name = LinkedImages(block), block.images[0].name
    for line, sample in ((-1e6, 5.0), (5.0, 1e7), (float("nan"), 5.0)):
        refuses("line", linked.under, name, line, sample)
    refuses("nobody", linked.under, "nobody", 5.0, 5.0)


def test_images_asked_for_are_answered_beside_their_edges(block: Block) -> None:
    linked, other = LinkedImages(block), block.images[1]
    lines, samples = np.meshgrid(np.linspace(-0.4, 1.4, 15) * block.images[0].lines, [0.5 * block.images[0].samples])
    beside = 0
    for line, sample in zip(lines.ravel(), samples.ravel(), strict=True):
        found = linked.under(block.images[0].name, float(line), float(sample), required=[other.name])[1]
        silent = linked.under(block.images[0].name, float(line), float(sample))[1]
        assert all(one.inside for one in silent)
        assert len(found) >= len(silent)
        beside += sum(not one.inside for one in found)
    assert beside > 0


def test_ties_have_the_residuals_of_the_solution(block: Block, solution: Solution) -> None:
    for j in range(2):
        mine = solution.network.rays.image == j
        found = ties_of(block, j)
        assert found["count"] == mine.sum()
        residuals = np.array([one or (np.nan, np.nan) for one in found["residuals"]])
        np.testing.assert_allclose(residuals, solution.residuals[mine], atol=1e-6)
        assert found["used"] == solution.rays_used[mine].tolist()


def test_shots_move_from_nominal_to_adjusted_places(block: Block, solution: Solution) -> None:
    profiles = laser_profiles(block)
    assert sum(points.size for _, points in profiles) == (solution.network.points.classes == 1).sum()
    found = shots_of(block, 0)
    assert found["profiles"]
    for profile in found["profiles"]:
        along = np.array(profile["along_m"])
        assert np.all(np.diff(along) >= 0.0)
        assert all(sigma is not None and sigma > 0.0 for sigma in profile["sigma_m"])
        number = [list(solution.network.points.ids).index(name) for name in profile["names"]]
        after, _ = solution.image(0).ground_to_image(solution.places[number], solution.correction(0))
        before, _ = solution.network.images[0].ground_to_image(solution.network.points.places[number])
        np.testing.assert_allclose(np.array(profile["after"]), after, atol=1e-6)
        np.testing.assert_allclose(np.array(profile["before"]), before, atol=1e-6)


def test_the_surface_under_shots_is_that_of_the_nearest_other_points(block: Block, solution: Solution) -> None:
    ties = solution.places[solution.network.points.classes == 0]
    heights = geodetic(ties, block.images[0].body)[:, 2]
    found = shots_of(block, 0)
    assert found["surface"]
    for profile in found["profiles"]:
        for name, height in zip(profile["names"], profile["surface_m"], strict=True):
            away = np.linalg.norm(ties - solution.places[list(solution.network.points.ids).index(name)], axis=1)
            nearest = np.argsort(away)[:5]
            assert height == pytest.approx(np.average(heights[nearest], weights=1.0 / away[nearest] ** 2), abs=1e-3)


def test_a_posterior_gives_the_same_block_as_its_solution(block: Block, solution: Solution) -> None:
    """So that a project looks alike before and after its batch adjustment."""
    other = replace(Block.of_posterior(Posterior.of(solution)), terrain=None)
    np.testing.assert_allclose(other.places, block.places, atol=1e-6)
    assert other.covariances is not None
    assert block.covariances is not None
    np.testing.assert_allclose(other.covariances, block.covariances, rtol=1e-5, atol=1e-9)
    np.testing.assert_array_equal(other.used, block.used)
    at = block.images[0].name, *middle(block)
    (one,), (two,) = LinkedImages(block).under(*at)[1], LinkedImages(other).under(*at)[1]
    np.testing.assert_allclose(two.place, one.place, atol=1e-4)
    assert one.ellipse is not None
    assert two.ellipse is not None
    np.testing.assert_allclose(two.ellipse.covariance, one.ellipse.covariance, rtol=1e-3)


@pytest.fixture(scope="module")
def on_terrain(tmp_path_factory: pytest.TempPathFactory) -> Block:
    """A site whose terrain model the adjustment moves."""
    case = read_case(write_site(plain_site("gusev", 1), tmp_path_factory.mktemp("site")))
    return Block.of_solution(adjust_network(case.network, case.settings, case.name))


def test_a_moved_terrain_model_is_the_ground(on_terrain: Block) -> None:
    """The ground lies on the model where it has moved to."""
    ground = GroundModel(on_terrain).under(0, *middle(on_terrain))
    assert on_terrain.terrain is not None
    motion = on_terrain.terrain_motion(ground.point[None])[0]
    assert np.linalg.norm(motion) > 50.0
    below = ground.point - motion
    assert on_terrain.terrain.at(below[None])[0] == pytest.approx(float(np.linalg.norm(below)), abs=0.5)


def test_the_ground_under_the_map_is_the_same_model(on_terrain: Block) -> None:
    centre = centre_of(on_terrain.places)
    opened = cast(Opened, SimpleNamespace(block=lambda: on_terrain, centre=centre, once=lambda _, make: make()))
    plane = np.random.default_rng(6).uniform(-2000.0, 2000.0, (50, 2))
    ground = ground_at(opened, plane)
    np.testing.assert_allclose(plane_coordinates(ground, centre), plane, atol=1e-3)
    below = ground - on_terrain.terrain_motion(ground)
    assert on_terrain.terrain is not None
    assert np.linalg.norm(ground - below, axis=1).min() > 50.0
    np.testing.assert_allclose(on_terrain.terrain.at(below), np.linalg.norm(below, axis=1), atol=0.5)


def test_the_surface_under_shots_is_the_moved_terrain_model(on_terrain: Block) -> None:
    """As that of the rays through the shots, which meet it near by."""
    ground, away = GroundModel(on_terrain), list[float]()
    for profile in shots_of(on_terrain, 0)["profiles"]:
        for place, height in list(zip(profile["after"], profile["surface_m"], strict=True))[::7]:
            if place is not None and height is not None:
                found = ground.under(0, *place)
                areoid = on_terrain.network.areoid
                away.append((found.height if areoid is None else areoid_heights(found.point[None], areoid)[0]) - height)
    assert len(away) > 5
    assert np.median(np.abs(away)) < 2.0


def test_jacobian_follows_the_slope_of_the_terrain(on_terrain: Block) -> None:
    linked, (line, sample) = LinkedImages(on_terrain), middle(on_terrain)
    name, step = on_terrain.images[0].name, 0.5

    def there(line: float, sample: float) -> Array:
        return linked.under(name, line, sample)[1][0].place

    numeric = np.column_stack([
        (there(line + step, sample) - there(line - step, sample)) / (2.0 * step),
        (there(line, sample + step) - there(line, sample - step)) / (2.0 * step),
    ])
    np.testing.assert_allclose(linked.under(name, line, sample)[1][0].jacobian, numeric, atol=5e-3)


# --- refinement of clicked places on rendered images whose truth is known: near the truth, and honest abou


Clicked = tuple[str, float, float]


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> tuple[LinkedImages, dict[str, Path | None]]:
    """The rendered pair over a terrain model that is 40 m off, and files of its pixels."""
    pytest.importorskip("cv2")
    folder, scene = tmp_path_factory.mktemp("pixels"), matched.true_scene()
    known = [KnownImage(one.image, matched.prior(100.0)) for one in scene.pictures]
    network = with_images(alone(known[0]), known)
    files = dict[str, Path | None]()
    for number, one in enumerate(scene.pictures):
        pixels = np.asarray(one.pixels)
        files[one.image.name] = folder / f"{number}.tif"
        Image.fromarray(np.asarray(pixels)).save(folder / f"{number}.tif")
    return LinkedImages(replace(Block.of_network(network, SolverSettings()), terrain=matched.true_terrain())), files


def test_a_click_goes_to_the_ground_of_the_reference(site: tuple[LinkedImages, dict[str, Path | None]]) -> None:
    linked, files = site
    one, two = list(files)
    rng, away, squares, sigmas = np.random.default_rng(4), list[float](), list[float](), list[float]()
    size = [linked.block.images[0].lines, linked.block.images[0].samples]
    for place in rng.uniform(60.0, np.array(size) - 60.0, (60, 2)):
        true = matched.true_places(one, place[None], two)[0]
        start = true + rng.normal(0.0, 1.0, 2)
        try:
            found = refine(linked, files, (one, *place.tolist()), (two, *start.tolist()))
        except InputError:  # flat ground, or beside the other image
            continue
        off = found.place - true
        away.append(float(np.linalg.norm(off)))
        squares.append(float(off @ np.linalg.solve(found.covariance, off)))
        sigmas.append(float(np.sqrt(0.5 * found.covariance.trace())))
        assert 0.3 < found.correlation <= 1.0
    assert len(away) > 25
    assert np.median(away) < 0.2  # clicked 1 px beside in each direction
    assert np.median(sigmas) < 0.2
    assert 0.4 < np.median(squares) / 1.386 < 2.5  # median of chi square with two degrees of freedom


@pytest.mark.parametrize(("what", "said"), [
    ("file", "no file of its pixels"), ("edge", "too near to its edge|leaves the picture"),
    ("image", "image nobody: no such image"), ("elsewhere", "isn't in it|no least-squares match"),
])  # fmt: skip
def test_what_cannot_be_refined_is_said(
    site: tuple[LinkedImages, dict[str, Path | None]], what: str, said: str
) -> None:
    linked, files = site
    one, two = list(files)
    place = np.array([300.0, 250.0])
    true = matched.true_places(one, place[None], two)[0]
    first, second = (one, *place.tolist()), (two, *true.tolist())
    if what == "file":
        files = files | {two: None}
    elif what == "edge":
        first = one, 0.5, 0.5
    elif what == "image":
        first = "nobody", 1.0, 1.0
    else:
        second = two, float(true[0]) + 200.0, float(true[1])
    refuses(said, refine, linked, files, first, second)


# --- the sheet of a point: what it says near by, without the rest of the block, is what the whole posterio


@pytest.fixture
def changed(solved: Path, tmp_path: Path) -> tuple[Opened, str]:
    """A project after a change of one of its ties, and that tie."""
    opened = Opened(Path(shutil.copytree(solved, tmp_path / "project")))
    ids = opened.block().network.points.ids
    name = ids[int(np.flatnonzero(opened.block().network.points.classes == 0)[4])]
    ray = point_sheet(opened, name)["rays"][0]
    change(opened, {"kind": "move", "point": name, "image": ray["image"], "line": ray["line"] + 0.5,
                    "sample": ray["sample"]})  # fmt: skip
    return opened, name


def test_after_a_change_the_sheet_reads_its_point_alone(changed: tuple[Opened, str]) -> None:
    opened, name = changed
    sheet = point_sheet(opened, name)
    assert not opened.is_read
    whole = read_posterior(opened.path)[1]
    found = whole.point(name)
    frame = east_north_up(found.position[None])[0]
    np.testing.assert_allclose(sheet["sigmas_m"], np.sqrt(np.diag(frame @ found.covariance @ frame.T)), rtol=1e-5)
    assert sheet["edited"]
    for ray in sheet["rays"]:
        at = whole.projection(name, ray["image"]).pixel
        np.testing.assert_allclose(ray["residual_px"], [ray["line"] - at[0], ray["sample"] - at[1]], atol=1e-4)
    assert name in answer_of(opened, name)["answer"]


def test_tests_of_a_point_are_those_of_the_whole_block(changed: tuple[Opened, str]) -> None:
    opened, name = changed
    found = judged(opened, name)
    assert not opened.is_read
    whole = reliability(read_posterior(opened.path)[1].linearised)
    every, number = whole.measures, whole.at.network.points.ids.find([name])[0]
    mine = np.flatnonzero((every.kind == MeasureKind.RAY) & (every.point == number))
    assert mine.size == 4
    for k in mine.tolist():
        ray = found["rays"][whole.at.network.images[int(every.image[k])].name]
        for key, value in (("redundancy", every.redundancy), ("w", every.test), ("detectable_px", every.detectable)):
            said = ray[key][int(every.component[k])]
            if said is None:  # nothing controls the measure
                assert not np.isfinite(value[k])
            else:
                np.testing.assert_allclose(said, value[k], rtol=1e-3, atol=1e-5)
    assert found["critical"] == pytest.approx(whole.critical)


def test_correlations_are_those_most_correlated(changed: tuple[Opened, str], solved: Path) -> None:
    name = changed[1]
    for opened in (changed[0], Opened(solved), Opened(solved / "solutions" / "0001")):
        found = correlations(opened, name)
        posterior = opened.posterior()
        ids = posterior.network.points.ids
        (k,) = ids.find([name]).tolist()
        cross = cross_covariances(posterior.linearised, k)
        frames = east_north_up(posterior.linearised.places)
        sigmas = np.array([
            np.sqrt(np.diag(frame @ posterior.point(one).covariance @ frame.T))
            for frame, one in zip(frames, ids, strict=True)
        ])  # fmt: skip
        every = np.einsum("ab,nbd,nad->na", frames[k], cross, frames) / (sigmas[k] * sigmas)
        every[k] = 0.0
        order = np.argsort(-np.abs(every).max(axis=1))[:12]
        rows = {row["name"]: row["correlation"] for row in found["rows"]}
        sizes = np.abs(list(rows.values())).max(axis=1)
        # iSAM2's covariance is that of its last linearisation
        np.testing.assert_allclose(sizes[:8], np.abs(every[order[:8]]).max(axis=1), rtol=1e-3)
        for other, values in rows.items():
            np.testing.assert_allclose(values, every[ids.find([other])[0]], atol=1e-3)
        assert set(found["distance_m"]) == set(rows)


def test_a_point_held_where_its_sheet_says_it_is_stays_there(changed: tuple[Opened, str]) -> None:
    opened, name = changed
    place = point_sheet(opened, name)["place"]
    before = read_posterior(opened.path)[1].point(name).position
    sigmas = {f"sigma_{axis}_m": 5.0 for axis in ("east", "north", "up")}
    keys = "longitude_deg", "geodetic_latitude_deg", "height_m"
    change(opened, {"kind": "hold", "point": name, **{key: place[key] for key in keys}, **sigmas})
    held = read_posterior(opened.path)[1]
    np.testing.assert_allclose(held.point(name).position, before, rtol=0.0, atol=1e-3)
    sheet = point_sheet(opened, name)
    assert (sheet["class"], sheet["kind"]) == ("control", "constrained")
    assert max(sheet["sigmas_m"]) < 5.0


def test_near_by_there_is_nothing_without_the_point_or_an_adjustment(
    solved: Path, case_file: Path, tmp_path: Path
) -> None:
    assert posterior_near(solved, "nobody") is None
    assert call("project", "init", tmp_path / "new", "--case", case_file) == 0
    opened = Opened(tmp_path / "new")
    name = opened.block().network.points.ids[0]
    assert posterior_near(tmp_path / "new", name) is None
    assert not point_sheet(opened, name)["adjusted"]
    assert answer_of(opened, name)["answer"] == ""
    refuses("nothing has been adjusted", judged, opened, name)
    refuses("no", point_sheet, opened, "nobody")

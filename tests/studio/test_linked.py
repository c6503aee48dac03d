"""Images linked by geometry: the same ground in all of them, Jacobians and error ellipses by finite differences."""

from dataclasses import replace

import numpy as np
import pytest
from sites import plain_site

from mgsgraph.adjustment.adjust import adjust_network
from mgsgraph.adjustment.solution import Solution
from mgsgraph.analysis.posterior import Posterior
from mgsgraph.case.reading import read_case
from mgsgraph.errors import InputError
from mgsgraph.geometry.body import geodetic
from mgsgraph.geometry.records import Array
from mgsgraph.network.corrections import whole_correction
from mgsgraph.simulation.files import write_site
from mgsgraph.studio.linked import Ellipse, GroundModel, LinkedImages, ground_record
from mgsgraph.studio.marks import laser_profiles, shots_of, ties_of
from mgsgraph.studio.opened import Block


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
        with pytest.raises(InputError, match="line"):
            linked.under(name, line, sample)
    with pytest.raises(InputError, match="nobody"):
        linked.under("nobody", 5.0, 5.0)


def test_images_asked_for_are_answered_beside_their_edges(block: Block) -> None:
    linked, other = LinkedImages(block), block.images[1]
    lines, samples = np.meshgrid(np.linspace(-0.4, 1.4, 15) * block.images[0].lines, [0.5 * block.images[0].samples])
    beside = 0
    for line, sample in zip(lines.ravel(), samples.ravel(), strict=True):
        found = linked.under(block.images[0].name, float(line), float(sample), wanted=[other.name])[1]
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

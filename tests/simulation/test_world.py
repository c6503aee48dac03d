"""What the world does besides: each effect alone, of its size, and nothing else with it."""

import json
from pathlib import Path

import numpy as np
import pytest

from mgsgraph.case.reading import read_case
from mgsgraph.errors import InputError
from mgsgraph.geometry.body import east_north_up
from mgsgraph.simulation.demo.demonstration import simulation_options
from mgsgraph.simulation.files import write_site
from mgsgraph.simulation.site import SimulatedSite, SimulationOptions, simulate_site
from mgsgraph.simulation.strip import StripSettings, simulate_strip
from mgsgraph.simulation.world import EFFECTS, STRIP_EFFECTS, World, common_errors, of_tracks
from mgsgraph.units import MRAD

SEED = 11


def site(*effects: str) -> SimulatedSite:
    return simulate_site("isidis", SEED, SimulationOptions(pictures=False, world=World.of(effects)))


@pytest.fixture(scope="module")
def plain() -> SimulatedSite:
    return site()


def changed(one: SimulatedSite, other: SimulatedSite) -> set[str]:
    """What differs."""
    pairs = list(zip(one.images, other.images, strict=True))
    differences = {
        "measures": [one.ties.measures - other.ties.measures],
        "ties": [one.true_ties - other.true_ties],
        "given": [a.profile.footprints - b.profile.footprints for a, b in pairs],
        "footprints": [a.profile.true_footprints - b.profile.true_footprints for a, b in pairs],
        "ranges": [a.profile.ranges - b.profile.ranges for a, b in pairs],
        "kernels": [a.errors.position - b.errors.position for a, b in pairs],
        "grid": [one.grid.radii - other.grid.radii],
    }
    return {name for name, values in differences.items() if any(np.any(value != 0.0) for value in values)}


@pytest.mark.parametrize(
    ("effect", "expected"),
    [
        ("beam", {"given"}), ("drift", {"given"}), ("pulse", {"given", "ranges"}), ("tracks", {"grid"}),
        ("orbit", {"kernels"}), ("matching", {"measures"}),
        ("jitter", {"measures", "ties", "given", "footprints", "ranges"}),
    ],
)  # fmt: skip
def test_an_effect_changes_what_it_acts_on_alone(plain: SimulatedSite, effect: str, expected: set[str]) -> None:
    assert changed(site(effect), plain) == expected


def test_a_beam_turns_footprints_about_the_spacecraft(plain: SimulatedSite) -> None:
    """Their distance to it stays, and a rolled profile's heights change by the sine of the roll."""
    turned = site("beam")
    heights = []
    for one, other in zip(turned.images, plain.images, strict=True):
        mine, given = one.profile, other.profile.footprints
        rays = [points - mine.spacecraft for points in (mine.footprints, given)]
        away = [np.linalg.norm(ray, axis=1) for ray in rays]
        # the shift along the sphere is drawn after the turn, and so not quite a turn itself
        np.testing.assert_allclose(away[0], away[1], rtol=2e-6)
        moved = np.linalg.norm(mine.footprints - given, axis=1)
        np.testing.assert_allclose(moved, np.linalg.norm(mine.beam) * away[0], rtol=0.02)
        up = np.einsum("nij,nj->ni", east_north_up(given), mine.footprints - given)[:, 2]
        heights.append(np.abs(up).max())
        across = abs(mine.beam[0]) * away[0].mean()
        assert abs(np.abs(up).mean() - across * np.sin(mine.off_nadir.mean())) < 0.1 * across + 1.0
    rolled = int(np.argmax([image.profile.off_nadir.mean() for image in turned.images]))
    assert heights[rolled] > 3.0 * heights[1 - rolled]


def test_a_vibration_moves_points_as_it_says(plain: SimulatedSite) -> None:
    shaken = site("jitter")
    for one, other in zip(shaken.images, plain.images, strict=True):
        before, after = (image.true.ground_to_image(plain.true_ties)[0] for image in (other, one))
        assert one.vibration is not None
        # ground does not pass along the lines quite: what pitch does to a line does a tenth of it to a sample
        np.testing.assert_allclose(after - before, one.vibration.pixels(one.true, before[:, 0]), atol=0.2)
        assert 1.0 < np.abs(after - before).max() < 1.6


def test_tracks_keep_what_they_measured() -> None:
    rng = np.random.default_rng(3)
    radii = rng.standard_normal((40, 300))
    filled, measured = of_tracks(radii, (460.0, 460.0), 2000.0, rng)
    np.testing.assert_array_equal(filled[measured], radii[measured])
    assert np.all(np.isfinite(filled))
    assert abs(measured.mean() - 460.0 / 2000.0) < 0.1
    assert filled[~measured].std() < 0.9 * radii.std()


def test_common_errors_keep_their_variance_and_go_together_within_the_window() -> None:
    rng = np.random.default_rng(5)
    world = World(matching=0.7, window=50.0)
    products = []
    for _ in range(60):
        places = np.repeat(rng.uniform(0.0, 5000.0, (100, 2)), 2, axis=0) + np.tile([[0.0, 0.0], [5.0, 0.0]], (100, 1))
        errors = common_errors(world, rng.standard_normal((200, 2)), np.zeros(200, int), places, rng)
        products.append((np.mean(errors**2), np.mean(errors[::2] * errors[1::2]), np.mean(errors[:-2] * errors[2:])))
    variance, near, far = np.mean(products, axis=0)
    assert abs(variance - 1.0) < 0.05
    assert abs(near - 0.7 * np.exp(-0.01)) < 0.06
    assert abs(far) < 0.05


def test_a_strip_s_measures_move_as_its_images_vibrate() -> None:
    settings = StripSettings(images=4, ties=40, shots=10)
    steady, shaken, alike = (
        simulate_strip(StripSettings(images=4, ties=40, shots=10, world=World.of(effects)), 2)
        for effects in ((), ("jitter",), ("orbit",))
    )
    assert settings.world == World()
    moved = shaken.ties.measures - steady.ties.measures
    assert 1.0 < np.abs(moved).max() < 1.6
    common = [
        two.coefficients - one.coefficients
        for one, two in zip(steady.true_corrections, alike.true_corrections, strict=True)
    ]
    sizes = [np.linalg.norm(one[0, :3]) for one in common]
    np.testing.assert_allclose(sizes, sizes[0], rtol=1e-9)
    assert all(np.all(one[1:] == 0.0) and np.all(one[0, 3:] == 0.0) for one in common)
    together = [alike.addition(k).ties for k in range(4)]
    assert sum(len(part.measures) for part in together) == len(alike.ties.measures)


def test_files_tell_of_the_world(tmp_path: Path) -> None:
    simulated = site(*EFFECTS)
    case = read_case(write_site(simulated, tmp_path))
    truth = json.loads((tmp_path / "truth.json").read_text())
    assert truth["world"] == list(EFFECTS)
    assert (tmp_path / "megc_isidis.lbl").exists()
    assert len(case.network.shared) >= 2
    for image in truth["images"].values():
        assert image["vibration"]["period_s"] > 0.0
        assert np.linalg.norm(image["profile"]["beam_x_y_rad"]) < 5.0 * 0.25 * MRAD


@pytest.mark.parametrize(
    ("where", "effects"), [("pair", "beam"), ("strip", "tracks,jitter"), ("eos", "jitter,"), ("three-sites", "orbit")]
)
def test_an_effect_that_a_simulation_cannot_have_is_refused(where: str, effects: str) -> None:
    with pytest.raises(InputError, match="world"):
        simulation_options(where, effects=effects)


def test_all_effects_are_those_that_a_simulation_can_have() -> None:
    assert simulation_options("strip", effects="all").world == World.of(STRIP_EFFECTS)
    assert simulation_options("gusev", effects="all").world == World.of(EFFECTS)


@pytest.mark.parametrize("effects", [("jiter",), ("beam", "")])
def test_an_unknown_effect_is_refused(effects: tuple[str, ...]) -> None:
    with pytest.raises(InputError, match="simulated world"):
        World.of(effects)

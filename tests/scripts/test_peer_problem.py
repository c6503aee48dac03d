"""Problems of the C++ peer: files, equations, networks, against its own generator and its published costs; ours."""

import math
import re
import sys
from dataclasses import replace
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from outside import refuses, require

SCRIPTS = Path(__file__).resolve().parents[2] / "scripts"
if not SCRIPTS.is_dir():
    pytest.skip("the scripts are not beside the tests", allow_module_level=True)
sys.path.append(str(SCRIPTS))

import peer_blocks as blocks  # noqa: E402
import peer_problem as peer  # noqa: E402

from mgsgraph.errors import InputError  # noqa: E402
from mgsgraph.files.networks.tie_points import PointKind  # noqa: E402
from mgsgraph.geometry.orientation import OrientationCorrection  # noqa: E402
from mgsgraph.network import PointClass  # noqa: E402

SHARED = blocks.SHARED
FIELDS = [name for name, _, _ in peer._sections(1, 1, 1, 1)]


@pytest.fixture(scope="module")
def chain() -> tuple[peer.PeerProblem, peer.Truth]:
    return blocks.chain(5, 60, seed=3, shots=7)


@pytest.fixture(scope="module")
def generator() -> ModuleType:
    require_peer("gen.py")
    return blocks.peer_generator(SHARED)


def require_peer(name: str) -> Path:
    """A file of the peer."""
    return require(SHARED / name, "the peer")


@pytest.fixture(scope="module")
def small(chain: tuple[peer.PeerProblem, peer.Truth], tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("peer") / "chain.bin"
    peer.write_problem(chain[0], path)
    return path


# --- the file


def test_what_is_written_is_read(chain: tuple[peer.PeerProblem, peer.Truth], small: Path) -> None:
    again = peer.read_problem(small)
    for name in FIELDS:
        np.testing.assert_array_equal(getattr(again, name), getattr(chain[0], name))
    assert (again.ties, again.focal_mm, again.pixel_mm) == (60, 3437.4, 0.039)
    assert [path.name for path in small.parent.iterdir()] == ["chain.bin"]


@pytest.mark.filterwarnings("ignore::ResourceWarning")  # the peer's reader leaves the file to the collector
def test_the_peer_reads_what_we_write(
    chain: tuple[peer.PeerProblem, peer.Truth], small: Path, generator: ModuleType
) -> None:
    theirs, ours = generator.read_bin(small), chain[0]
    assert (theirs["n_img"], theirs["n_tie"], theirs["n_mola"]) == (5, 60, 35)
    assert (theirs["f_mm"], theirs["pix_mm"]) == (ours.focal_mm, ours.pixel_mm)
    names = {
        "eo_prior": "orientation", "eo_sigma": "orientation_sigmas", "pt_init": "places", "obs_img": "ray_image",
        "obs_pt": "ray_point", "obs_u": "u", "obs_y": "y", "obs_sigma": "sigmas", "mola_pt": "shot_point",
        "mola_img": "shot_image", "mola_u": "shot_u", "mola_range": "ranges", "mola_sr": "range_sigmas",
        "mola_xyz": "footprints", "mola_sxyz": "footprint_sigmas",
    }  # fmt: skip
    assert sorted(names.values()) == sorted(FIELDS)
    for their, our in names.items():
        np.testing.assert_array_equal(theirs[their].ravel(), getattr(ours, our).ravel())


def test_we_read_what_the_peer_writes(generator: ModuleType, tmp_path: Path) -> None:
    drawn, _ = generator.generate("S", 7)
    generator.write_bin(tmp_path / "S.bin", drawn)
    read, made = peer.read_problem(tmp_path / "S.bin"), blocks.peer_size("S", SHARED, 7)[0]
    for name in FIELDS:
        np.testing.assert_array_equal(getattr(read, name), getattr(made, name))


@given(share=st.floats(0.0, 1.0, exclude_max=True))
def test_a_file_cut_short_is_one_clear_line(small: Path, share: float) -> None:
    whole = small.read_bytes()
    cut = small.with_name("cut")
    cut.write_bytes(whole[: int(share * len(whole))])
    with pytest.raises(InputError, match=r"cut.*(expected|problem file)") as caught:
        peer.read_problem(cut)
    assert "\n" not in str(caught.value)
    cut.unlink()


def test_what_cannot_be_is_refused(chain: tuple[peer.PeerProblem, peer.Truth]) -> None:
    problem = chain[0]
    twice = problem.shot_point.copy()
    twice[1] = twice[0]
    far = problem.u.copy()
    far[3] = -1.6
    for change, message in (
        ({"shot_point": twice}, "two laser shots"),
        ({"u": far}, "normalised line -1.6"),
    ):
        refuses(message, replace, problem, **change)


# --- equations


def test_projection_is_the_peers(generator: ModuleType) -> None:
    problem, truth = blocks.peer_size("S", SHARED)
    image, point = problem.ray_image, problem.ray_point
    line, sample, distance = generator.project(truth.orientation.reshape(-1, 18), image, problem.u, truth.places[point])
    ours, far = peer.project(truth.orientation, image, problem.u, truth.places[point], problem.focal)
    np.testing.assert_allclose(ours, np.column_stack([line, sample]), atol=1e-9)  # pixels
    np.testing.assert_allclose(far, distance, atol=1e-8)  # m


def test_network_has_the_peers_residuals(chain: tuple[peer.PeerProblem, peer.Truth]) -> None:
    problem, rng = chain[0], np.random.default_rng(1)
    added = rng.standard_normal(problem.orientation.shape) * problem.orientation_sigmas
    places = problem.places + rng.normal(0.0, 50.0, problem.places.shape)
    wanted = peer.residuals(problem, problem.orientation + added, places)
    network, _ = peer.network(problem, "measured")
    pixel = problem.pixel_mm * 1e-3
    for j, image in enumerate(network.images):
        mine = network.rays.image == j
        correction = OrientationCorrection((added[j] * peer.FROM_PEER[:, None]).T, "opk-peer")
        pose = image.pose(network.rays.places[mine, 0], correction)
        ray = np.einsum("kij,kj->ki", pose.matrix, places[network.rays.point[mine]] - pose.position)
        assert ray[:, 2].min() > 0.0  # in front of the camera
        seen = image.interior.focal_length * ray[:, :2] / ray[:, 2:]
        off = (seen - image.interior.focal_plane(network.rays.places[mine, 1])[0]) / pixel
        off /= network.rays.sigmas[mine]
        np.testing.assert_allclose(off[:, 0], -wanted["image"][mine, 0], atol=1e-8)
        np.testing.assert_allclose(off[:, 1], wanted["image"][mine, 1], atol=1e-8)
        shots = network.ranges.image == j
        at = image.pose(image.timing.lines(network.ranges.times[shots]), correction).position
        found = network.ranges.values[shots] - np.linalg.norm(places[network.ranges.point[shots]] - at, axis=1)
        np.testing.assert_allclose(found / network.ranges.sigmas[shots], wanted["range"][shots], atol=1e-8)
        np.testing.assert_array_equal(network.priors[j].sigmas, problem.orientation_sigmas[j].T)


def test_rates_of_the_trajectory_are_its_derivatives(chain: tuple[peer.PeerProblem, peer.Truth]) -> None:
    trajectory, step, times = peer.trajectory(chain[0], 1), 1e-5, np.linspace(-0.9, 0.9, 7)
    here, ahead, behind = (trajectory.pose(times + one) for one in (0.0, step, -step))
    np.testing.assert_allclose((ahead.position - behind.position) / (2.0 * step), here.velocity, rtol=1e-7, atol=1e-3)
    turned = (ahead.matrix - behind.matrix) / (2.0 * step)  # dM = -[turning]x M
    expected = np.cross(here.matrix, here.angular_rate[:, :, None], axis=1)
    np.testing.assert_allclose(turned, expected, atol=1e-9)


def test_points_and_their_priors(chain: tuple[peer.PeerProblem, peer.Truth]) -> None:
    problem = chain[0]
    network, settings = peer.network(problem, "measured")
    points = network.points
    np.testing.assert_array_equal(points.classes, np.repeat([PointClass.TIE, PointClass.LASER], [60, 35]))
    np.testing.assert_array_equal(points.kinds, np.repeat([PointKind.FREE, PointKind.CONSTRAINED], [60, 35]))
    np.testing.assert_array_equal(points.places[60:], problem.footprints)
    np.testing.assert_allclose(points.covariances[60:], np.broadcast_to(100.0 * np.eye(3), (35, 3, 3)))
    assert (settings.line, settings.angles, settings.cost_tolerance) == ("measured", "opk-peer", 1e-10)
    assert peer.network(problem, "predicted")[1].line == "predicted"


def test_a_line_sigma_moves_the_image_by_its_pixels(chain: tuple[peer.PeerProblem, peer.Truth]) -> None:
    problem = chain[0]
    network, _ = peer.network(problem, "predicted")
    np.testing.assert_array_equal(network.rays.sigmas[:, 1], problem.sigmas)
    step = network.rays.sigmas[:, 0] * 2.0 / peer.LINES  # of u
    places = problem.places[problem.ray_point]
    before, after = (
        peer.project(problem.orientation, problem.ray_image, problem.u + sign * 0.5 * step, places, problem.focal)[0]
        for sign in (-1.0, 1.0)
    )
    np.testing.assert_allclose(np.abs(after - before)[:, 0], problem.sigmas, rtol=1e-6)


# --- generated problems


@pytest.mark.parametrize(("images", "ties", "shots"), [(2, 500, 40), (9, 400, 0)])
def test_a_chain_is_drawn_from_its_sigmas(images: int, ties: int, shots: int) -> None:
    problem, truth = blocks.chain(images, ties, seed=5, shots=shots)
    assert (problem.orientation.shape[0], problem.ties, problem.ranges.size) == (images, ties, images * shots)
    assert np.abs(problem.u).max() < 1.1
    assert np.abs(problem.y).max() < 0.5 * peer.SAMPLES
    assert np.bincount(problem.ray_image, minlength=images).min() > 0
    for name, values in peer.residuals(problem, truth.orientation, truth.places).items():
        if values.size:  # normal with sigma one: mean square within four of its own sigmas
            assert np.mean(values**2) == pytest.approx(1.0, abs=4.0 * math.sqrt(2.0 / values.size)), name
            assert np.mean(values) == pytest.approx(0.0, abs=4.0 / math.sqrt(values.size)), name
    off = problem.places[:ties] - truth.places[:ties]
    assert off.std() == pytest.approx(blocks.GUESS, rel=0.1)


# --- end to end


def published_costs() -> dict[str, float]:
    line = re.search(r"Final costs:(.*)", require_peer("README.md").read_text(encoding="utf-8"))
    assert line is not None
    return {size: float(cost) for size, cost in re.findall(r"(S|M|L|XL) ([\d.]+\d)", line[1])}


@pytest.mark.parametrize("size", ["S", "M"])
def test_cost_is_the_peers(size: str) -> None:
    from mgsgraph.adjustment.adjust import adjust_network

    wanted = published_costs()[size]
    require_peer("gen.py")
    problem, _ = blocks.peer_size(size, SHARED)
    solution = adjust_network(*peer.network(problem, "measured"))
    assert solution.converged
    assert solution.cost_final == pytest.approx(wanted, rel=1e-8)
    again = peer.cost(problem, peer.peer_orientation(problem, solution.coefficients), solution.places)
    assert again == pytest.approx(wanted, rel=1e-8)  # the corrections mean the same in the peer's equations

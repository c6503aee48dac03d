"""Exports of passes with mounted cameras: one trajectory for each spacecraft, and all that moves poses is in them."""

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
import spiceypy
from exported import network_differences
from outside import refuses
from pass_files import write_block
from rigs import BORESIGHT, adjusted_rig, rig
from usgscsm import csm_differences

from mgsgraph.adjustment.adjust import adjust_network
from mgsgraph.adjustment.settings import SolverSettings
from mgsgraph.adjustment.solution import Solution
from mgsgraph.case.reading import adjust, read_case
from mgsgraph.errors import InputError
from mgsgraph.export.bundle_out import orientation_polynomials
from mgsgraph.export.csm import write_csm
from mgsgraph.export.isis import write_isis
from mgsgraph.export.spice import NaifIds, SpiceNaming, write_spice
from mgsgraph.export.spice_back import spice_differences
from mgsgraph.export.spice_nodes import TOLERANCE, reprojection
from mgsgraph.geometry import rotation
from mgsgraph.geometry.camera import RadialDistortion
from mgsgraph.geometry.image import PushbroomImage
from mgsgraph.geometry.orientation import Sine, evenly_spaced
from mgsgraph.geometry.trajectory import AttitudeTable, Trajectory
from mgsgraph.network import NodePrior, Pass, PolynomialPrior, SharedKind, SharedUnknown
from mgsgraph.network.joining import mountings, seconds

HADLEY = Path(__file__).resolve().parents[2] / "scripts" / "cases" / "jigsaw_nac.toml"
CSM = 2e-4
"""px, by which places of model states may be off (docs/exchange.md)."""
VALUES = {
    SharedKind.CAMERA_BORESIGHT: [2e-4, -3e-4, 5e-4],
    SharedKind.ATTITUDE_TIME: [0.02],
    SharedKind.POSITION_TIME: [0.02],
    SharedKind.ORBIT_POSITION: [60.0, -80.0, 90.0],
    SharedKind.FOCAL_LENGTH: [0.05],
    SharedKind.CAMERA_LEVER_ARM: [15.0, -12.0, 20.0],
    SharedKind.LINE_RATE: [-1e-3],
    SharedKind.PRINCIPAL_POINT: [3e-5, -5e-5],
    SharedKind.RADIAL_DISTORTION_1: [4e-5],
    SharedKind.VIBRATION: [3e-5, -2e-5, 1e-5, 0.0, 2e-5, 3e-5, 0.0, 1e-5, 1e-4, 0.0, 0.0, 0.0],
}
"""Of an unknown of R alone."""
NO_STATE = (SharedKind.PRINCIPAL_POINT, SharedKind.RADIAL_DISTORTION_1)
"""usgscsm has no model of these beside a camera's own."""


def segments(folder: Path) -> dict[int, list[tuple[float, float]]]:
    """Times of the segments of the SPK, in order, of each spacecraft, as SPICE lists them."""
    handle, found = spiceypy.dafopr(str(folder / "adjusted.bsp")), dict[int, list[tuple[float, float]]]()
    spiceypy.dafbfs(handle)
    while spiceypy.daffna():
        (start, stop), (body, *_) = spiceypy.dafus(spiceypy.dafgs(5), 2, 6)
        found.setdefault(int(body), []).append((float(start), float(stop)))
    spiceypy.dafcls(handle)
    return {body: sorted(spans) for body, spans in found.items()}


def sine_of(kind: SharedKind) -> Sine | None:
    """5 Hz, over the time of R."""
    start, stop = seconds(rig().images[1])
    return Sine(4.0, 0.5 * (start + stop), 0.5 * (stop - start)) if kind is SharedKind.VIBRATION else None


@cache
def adjusted_with(kinds: tuple[SharedKind, ...]) -> Solution:
    """The rig's solution with such unknowns of R alone, about nothing."""
    shared = tuple(
        SharedUnknown(f"{kind.name} of R", kind, np.array([1]), np.abs(VALUES[kind]) * 1e-3 + 1e-9, sine=sine_of(kind))
        for kind in kinds
    )
    solution = adjust_network(replace(rig(), shared=shared), SolverSettings())
    return replace(solution, shared=tuple(np.zeros(kind.width) for kind in kinds))


def beside(kind: SharedKind) -> tuple[SharedKind, ...]:
    """The unknown and those that are adjusted with it, once for all."""
    return NO_STATE if kind in NO_STATE else tuple(one for one in VALUES if one not in NO_STATE)


def with_unknown(kind: SharedKind) -> Solution:
    """The same with a value of one unknown."""
    values = tuple(np.array(VALUES[one]) if one is kind else np.zeros(one.width) for one in beside(kind))
    return replace(adjusted_with(beside(kind)), shared=values)


def by_hand(image: PushbroomImage, kind: SharedKind) -> PushbroomImage:
    """R with such a nominal orientation as the unknown makes of it: nothing of `network.shared` is used."""
    values, trajectory = np.array(VALUES[kind]), image.trajectory
    assert isinstance(trajectory, Trajectory)
    camera, position = trajectory.camera, trajectory.position
    if kind is SharedKind.FOCAL_LENGTH:
        return replace(image, interior=replace(image.interior, focal_length=image.interior.focal_length + values[0]))
    if kind is SharedKind.PRINCIPAL_POINT:
        moved = image.interior.to_pixel.copy()
        moved[:, 0] += moved[:, 1:] @ values  # the pixel that saw (x, y) sees (x - xp, y - yp)
        return replace(image, interior=replace(image.interior, to_pixel=moved))
    if kind is SharedKind.RADIAL_DISTORTION_1:
        place, _ = image.interior.focal_plane(np.array([0.5, image.samples - 0.5]))
        cubic = values[0] / np.linalg.norm(place, axis=1).max() ** 3
        return replace(image, interior=replace(image.interior, distortion=RadialDistortion(0.0, -cubic, 0.0)))
    if kind is SharedKind.LINE_RATE:
        timing, middle = image.timing, 0.5 * image.lines
        starts = timing.start_times - values[0] * timing.periods * (middle - timing.first_lines)
        return replace(image, timing=replace(timing, start_times=starts, periods=timing.periods * (1.0 + values[0])))
    if kind is SharedKind.CAMERA_LEVER_ARM:
        axes, _ = camera.at(position.times)
        position = replace(position, positions=position.positions + values @ axes)
    elif kind is SharedKind.CAMERA_BORESIGHT:
        camera = replace(camera, constant=rotation.exponential(-values[None])[0] @ camera.constant)
    elif kind is SharedKind.VIBRATION:
        start, stop = seconds(image) - np.float64(trajectory.epoch)
        times, axes = np.linspace(start - 0.1, stop + 0.1, 6000), rig().axes_of(1)
        assert axes is not None
        middle, half = 0.5 * (start + stop), 0.5 * (stop - start)
        wave = np.exp(-8j * np.pi * (times - middle))[:, None]
        amounts, drift = (values[k::4] + 1j * values[k + 1 :: 4] for k in (0, 2))
        turn = np.real(wave * (amounts + (times - middle)[:, None] / half * drift)) @ axes.T
        matrices = rotation.exponential(-turn) @ camera.at(times)[0]
        quaternions = rotation.continuous(rotation.from_matrix(matrices))
        camera = AttitudeTable(times, quaternions, np.eye(3))
    elif kind is SharedKind.ATTITUDE_TIME:
        camera = replace(camera, times=camera.times - values[0])
    elif kind is SharedKind.POSITION_TIME:
        position = replace(position, times=position.times - values[0])
    else:
        up = position.positions / np.linalg.norm(position.positions, axis=1)[:, None]
        left = np.cross(position.positions, position.velocities)
        left /= np.linalg.norm(left, axis=1)[:, None]
        moved = values[0] * up + values[1] * np.cross(left, up) + values[2] * left
        position = replace(position, positions=position.positions + moved)
    return replace(image, trajectory=replace(trajectory, camera=camera, position=position))


@pytest.mark.parametrize("kind", VALUES)
def test_what_moves_poses_is_in_all_exports(kind: SharedKind, tmp_path: Path) -> None:
    solution, plain = with_unknown(kind), adjusted_with(beside(kind))
    images = [*plain.network.images]
    images[1] = by_hand(images[1], kind)
    wanted = reprojection(replace(plain, network=replace(plain.network, images=tuple(images))))
    mine = np.array(wanted.image) == "R"
    moved = np.linalg.norm(wanted.places[mine] - reprojection(plain).places[mine], axis=1)
    assert mine.sum() > 60
    assert moved.max() > 1.0
    linear = 5e-3 * moved.max()  # a small angle beside others, an even motion, corrections that change meanwhile
    write_spice(solution, tmp_path)
    assert spice_differences(tmp_path, wanted).max() < linear
    assert spice_differences(tmp_path, reprojection(solution)).max() < 2.0 * TOLERANCE
    if kind in NO_STATE:
        refuses("optical_distortion", write_csm, solution, tmp_path)
        return
    write_csm(solution, tmp_path)
    assert csm_differences(tmp_path, wanted).max() < linear
    assert csm_differences(tmp_path, reprojection(solution)).max() < CSM


def test_a_rig_comes_back_on_one_trajectory(tmp_path: Path) -> None:
    solution = adjusted_rig()
    write_spice(solution, tmp_path)
    write_csm(solution, tmp_path)
    write_isis(solution, tmp_path)
    assert spice_differences(tmp_path, reprojection(solution)).max() < 2.0 * TOLERANCE
    assert csm_differences(tmp_path, reprojection(solution)).max() < CSM
    assert network_differences(tmp_path, solution).predicted.max() < 1e-6
    assert {code: len(spans) for code, spans in segments(tmp_path).items()} == {-900_001: 1, -900_003: 1}
    text = (tmp_path / "adjusted.tf").read_text()
    assert "FRAME_-900002000_CENTER = -900001\n" in text
    assert "Pass 'one pass': one trajectory, spacecraft -900001, of the images L, R." in (
        tmp_path / "adjusted.tm"
    ).read_text()


def test_lines_of_a_strip_say_its_position_once(tmp_path: Path) -> None:
    (tmp_path / "out").mkdir()
    solution = adjust(read_case(write_block(tmp_path)))
    write_spice(solution, tmp_path / "out")
    found = segments(tmp_path / "out")
    assert len(found) == len(solution.network.passes)
    for code, one in zip(sorted(found, reverse=True), solution.network.passes, strict=True):
        times = np.array(found[code])
        assert np.all(times[1:, 0] >= times[:-1, 1])
        covered = np.array([seconds(solution.network.images[j]) for j in one.images])
        assert times.min() < covered.min()
        assert times.max() > covered.max()


def test_cameras_on_paths_of_their_own_are_told_apart(tmp_path: Path) -> None:
    solution = with_unknown(SharedKind.ORBIT_POSITION)
    write_spice(with_unknown(SharedKind.CAMERA_LEVER_ARM), tmp_path)
    assert "Image R: a spacecraft of its own, 27.7 m off" in (tmp_path / "adjusted.tm").read_text()
    write_spice(solution, tmp_path)
    assert len(segments(tmp_path)) == 3
    assert "Image R: a spacecraft of its own, 135 m off" in (tmp_path / "adjusted.tm").read_text()
    ids = {"L": NaifIds(-85, -85600), "R": NaifIds(-85, -85610)}
    with pytest.raises(InputError, match=r"NAIF id -85: both L and R at the same time, whose perspective centres are"):
        write_spice(solution, tmp_path, SpiceNaming(images=ids))


def test_the_missions_ids_of_a_rig(tmp_path: Path) -> None:
    solution = adjusted_rig()
    ids = {"L": NaifIds(-85, -85600), "R": NaifIds(-85, -85610)}
    write_spice(solution, tmp_path, SpiceNaming(images=ids))
    assert spice_differences(tmp_path, reprojection(solution)).max() < 2.0 * TOLERANCE
    assert len(segments(tmp_path)[-85]) == 1
    with pytest.raises(InputError, match=r"NAIF id -85600: both L and R at the same time"):
        write_spice(solution, tmp_path, SpiceNaming(images=ids | {"R": NaifIds(-85, -85600)}))
    network = replace(solution.network, passes=())
    apart = adjust_network(network, SolverSettings())
    with pytest.raises(InputError, match=r"NAIF id -85: both L and R at the same time, which have orientation of"):
        write_spice(apart, tmp_path, SpiceNaming(images=ids))


def test_polynomials_of_a_rig_hold_its_boresight() -> None:
    """The angles of R change by its boresight's whole value where nothing else does."""
    solution, values = adjusted_rig(), np.array([0.0, 0.0, 5e-4])
    nodes = tuple(np.zeros_like(one) for one in solution.nodes)
    still = replace(solution, nodes=nodes, trends=tuple(np.zeros_like(one) for one in solution.trends))
    left, right = (orientation_polynomials(replace(still, shared=(values,)), j, 2) for j in range(2))
    np.testing.assert_allclose(left.correction, 0.0, atol=1e-12)
    assert np.abs(right.correction[5, 0]) == pytest.approx(5e-4, rel=1e-3)
    assert rig().shared == (BORESIGHT,)


def test_the_real_rig_comes_back(shared_data: Path, tmp_path: Path) -> None:
    network = read_case(HADLEY).network
    start, stop = np.min([seconds(one) for one in network.images]), np.max([seconds(one) for one in network.images])
    nodes = evenly_spaced("lagrange", start, (0.0, stop - start), (stop - start) / 3.0)
    prior = NodePrior(np.array([1.0] * 3 + [2.9e-4] * 3), np.zeros(6), np.zeros(6))
    one = Pass("rig", np.array([0, 1]), nodes, prior, mountings(network.images, "rig"))
    boresight = SharedUnknown("of R", SharedKind.CAMERA_BORESIGHT, np.array([1]), np.full(3, 3e-4))
    solution = adjust_network(replace(network, passes=(one,), shared=(boresight,)), SolverSettings())
    assert one.axes is not None
    assert np.linalg.norm(rotation.logarithm(one.axes[1:])[0]) > 3.1
    write_spice(solution, tmp_path)
    write_csm(solution, tmp_path)
    assert len(segments(tmp_path)) == 1
    assert spice_differences(tmp_path, reprojection(solution)).max() < TOLERANCE
    assert csm_differences(tmp_path, reprojection(solution)).max() < CSM


# above two seconds: thousands of draws hold a scatter to a few percent
def test_prior_sigmas_of_a_pass_are_those_of_its_draws() -> None:
    """Nodes drawn from the prior, independently, make the polynomials' coefficients scatter by what is written."""
    solution, rng = adjusted_rig(), np.random.default_rng(5)
    one, prior = solution.network.passes[0], solution.network.passes[0].prior
    assert isinstance(prior, NodePrior)
    memory = np.exp(-np.diff(one.nodes.times) / prior.correlation_time)
    drawn = []
    for _ in range(400):
        noise = rng.standard_normal((len(one.nodes), 6)) * prior.sigmas
        for k, forgotten in enumerate(np.sqrt(1.0 - memory**2).tolist()):
            noise[k + 1] = memory[k] * noise[k] + forgotten * noise[k + 1]
        nodes = noise + rng.standard_normal(6) * prior.bias
        drawn.append(orientation_polynomials(replace(solution, nodes=(nodes,), shared=(np.zeros(3),)), 1, 2).correction)
    scatter = np.sqrt(np.mean(np.square(drawn), axis=0))
    np.testing.assert_allclose(orientation_polynomials(solution, 1, 2).prior, scatter, rtol=0.16)


def test_polynomials_of_a_pass_have_its_degree(tmp_path: Path) -> None:
    one = rig().passes[0]
    third = float(np.ptp(one.nodes.times)) / 3.0
    nodes = evenly_spaced("lagrange", one.nodes.epoch, one.nodes.coverage, third)
    prior = PolynomialPrior(np.full((1, 3), 200.0), np.full((4, 3), 4e-4))
    solution = adjust_network(replace(rig(), passes=(replace(one, nodes=nodes, prior=prior),)), SolverSettings())
    write_isis(solution, tmp_path)
    assert "RA(t3)" in (tmp_path / "bundleout_images.csv").read_text()
    write_spice(solution, tmp_path)
    assert spice_differences(tmp_path, reprojection(solution)).max() < 2.0 * TOLERANCE

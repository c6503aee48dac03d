"""[[passes]], [[mountings]] and priors of nodes in a case file."""

import re
from dataclasses import replace
from pathlib import Path

import click
import numpy as np
import pytest
from mex import CHANGES, FOLDER, LINES, kernels, times_file
from outside import refuses
from pass_files import PASSES, block, write_block
from rigs import PASS, TURN, later, rig, write_rig

import mgsgraph
from mgsgraph.adjustment.adjust import adjust_network
from mgsgraph.analysis.vibrations import adjusted
from mgsgraph.case.motion import NodePriorInput
from mgsgraph.case.passes import MountingInput, mounted_images, mounting_unknowns
from mgsgraph.case.reading import adjust
from mgsgraph.cli import group
from mgsgraph.errors import InputError
from mgsgraph.geometry import rotation
from mgsgraph.geometry.body import Ellipsoid
from mgsgraph.geometry.image import PushbroomImage
from mgsgraph.geometry.records import Array
from mgsgraph.geometry.trajectory import Trajectory, tdb_of_utc
from mgsgraph.network import NodePrior, Pass, ProcessPrior, SharedKind, SharedUnknown
from mgsgraph.network.joining import found_passes, mountings, same_values, seconds, straightest
from mgsgraph.network.passes import normalised
from mgsgraph.network.shared import image_effect
from mgsgraph.project.addition import images_of_case
from mgsgraph.project.project import open_project
from mgsgraph.units import MGON, MRAD
from mgsgraph.workers import no_progress


def pass_of(folder: Path, table: str = "") -> Pass:
    """The first pass, `table` being what follows its images."""
    return mgsgraph.read_case(write_rig(folder, PASS + table)).network.passes[0]


# --- polynomials


def test_degrees_and_units(tmp_path: Path) -> None:
    """Sigmas at the ends and in the middle are those of the sums of the terms."""
    tables = """
[passes.position]
sigmas_m = [[50.0, 40.0, 30.0], 10.0]
[passes.attitude]
degree = 2
sigmas_mrad = [20.0, [8.0, 6.0, 4.0], 2.0]
"""
    found = pass_of(tmp_path, tables)
    assert len(found.nodes) == 4
    sigmas = found.prior.node_sigmas(normalised(found.nodes))
    np.testing.assert_allclose(sigmas[0, :3], np.hypot([50.0, 40.0, 30.0], 10.0), rtol=1e-6)
    np.testing.assert_allclose(sigmas[3, 3:], np.sqrt(404.0 + np.array([8.0, 6.0, 4.0]) ** 2) * MRAD, rtol=1e-6)


def test_processes_add_up_beside_a_line_in_time(tmp_path: Path) -> None:
    """The CTX case: slow departures of the attitude, whose strength is estimated, rough ones and a vibration; positions
    are a line.
    """
    tables = """
[passes.position]
degree = 1
sigmas_m = [50.0, 10.0]
[passes.attitude]
model = "matern-5/2"
sigma_mrad = "estimated"
correlation_time_s = 1.0
bias_sigma_mrad = 0.3
plus = [{ model = "white", sigma_mrad = 0.004 }, { model = "white", sigma_mrad = 0.03, sigma_factor = 10 }]
[[passes.vibrations]]
frequency_hz = 5.0
sigma_mrad = 0.02
drift = 0.5
"""
    found = pass_of(tmp_path, tables)
    (vibration,) = mgsgraph.read_case(tmp_path / "case.toml").network.shared
    assert vibration.sine is not None
    assert vibration.sine.frequency == 5.0
    assert vibration.images.tolist() == found.images.tolist()
    np.testing.assert_allclose(vibration.sigmas.reshape(3, 4) / MRAD, [[0.02, 0.02, 0.01, 0.01]] * 3)
    start, stop = found.nodes.coverage
    assert vibration.sine.middle == pytest.approx(found.nodes.epoch + 0.5 * (start + stop))
    assert vibration.sine.half == pytest.approx(0.5 * (stop - start))
    prior = found.prior
    assert isinstance(prior, ProcessPrior)
    slow, rough, about = prior.attitude
    assert (slow.kind, slow.correlation_time, slow.estimated, slow.spread) == ("matern-5/2", 1.0, True, 1.0)
    assert (rough.kind, rough.estimated) == ("white", False)
    assert (about.estimated, about.spread) == (True, pytest.approx(np.log(10.0)))
    np.testing.assert_allclose(about.sigmas, 0.03 * MRAD)
    np.testing.assert_allclose(rough.sigmas, 0.004 * MRAD)
    np.testing.assert_allclose(prior.bias, np.repeat([50.0, 0.3e-3], 3))
    np.testing.assert_allclose(prior.drift, np.repeat([10.0, 0.0], 3))
    assert prior.position[0].sigmas.max() < 0.01


# --- which images make which pass


def test_cameras_of_one_moment_are_mounted_as_their_tables_say(tmp_path: Path) -> None:
    found = pass_of(tmp_path)
    assert found.images.tolist() == [0, 1]
    assert found.axes is not None
    np.testing.assert_allclose(found.axes, [np.eye(3), TURN], atol=1e-6)


def test_images_of_several_passes_are_found_by_one_table(tmp_path: Path) -> None:
    """L and R an orbit later are a pass of their own; each is called by the UTC of its first line."""
    left, right, other = rig().images
    images = (later(right, "R2", 7000.0), left, other, later(left, "L2", 7000.0), right)
    assert sorted(map(sorted, found_passes(images))) == [[0, 3], [1, 4], [2]]
    path = write_rig(tmp_path, "[[passes]]")
    passes = mgsgraph.read_case(path).network.passes
    assert [one.images.tolist() for one in passes] == [[0, 1], [2]]
    assert all(len(one.name) == len("2009-07-13T02:03:04") and one.name[10] == "T" for one in passes)
    path = write_rig(tmp_path, '[[passes]]\nname = "LRO"')
    named = mgsgraph.read_case(path).network.passes
    assert [one.name for one in named] == [f"LRO {one.name}" for one in passes]


@pytest.mark.parametrize(("table", "proposed"), [("", True), ("[[passes]]", False)])
def test_images_of_one_moment_without_a_pass_are_named(tmp_path: Path, table: str, proposed: bool) -> None:
    left, right, other = (image.name for image in rig().images)
    notes = [note for note in mgsgraph.read_case(write_rig(tmp_path, table)).notes if "[[mountings]]" in note]
    assert len(notes) == proposed
    assert all(left in note and right in note and other not in note for note in notes)


def test_images_of_two_cameras_that_follow_upon_each_other() -> None:
    """L and R, and both again after five minutes, R before L in the list: each later one goes by its own camera."""
    left, right, _ = rig().images
    images = (left, right, later(right, "R2", 300.0), later(left, "L2", 300.0))
    axes = mountings(images, "here")
    assert axes is not None
    np.testing.assert_allclose(axes, [np.eye(3), TURN, TURN, np.eye(3)], atol=1e-6)


# --- what is wrong, in one line

R = '[[mountings]]\ncamera = ["R"]\nname = "NAC-R"\n'
MARKOV = '''
position = {{ model = "gauss-markov", sigma_m = 1{0} }}
attitude = {{ model = "gauss-markov", sigma_mrad = 1{0} }}
'''
ROUGH = 'attitude = {{ model = "white", sigma_mrad = 0.01{0} }}\n'
VIBRATION = "[[passes.vibrations]]\nfrequency_hz = {0}\nsigma_mrad = 0.01\n"
TWO = '[[passes]]\nname = "two"\n'
WRONG = {
    "an image in two passes": (PASS + TWO + 'images = ["R"]', r"passes\[1\], images: 'R', which pass 'one' has"),
    "strips": ('[[strips]]\nname = "s"', r"strips: a word of earlier versions; expected \[\[passes\]\] with a prior"),
    "a high degree": (PASS + "position = { degree = 4 }", r"degree: a polynomial of degree 4; expected 0 to 3.*proce"),
    "too few sigmas": (PASS + "attitude = { degree = 2, sigmas_mrad = [1, 2] }", "2 sigmas; expected 3 for degree = 2"),
    "unknown units": (PASS + "attitude = { sigmas_deg = [1] }", "'sigmas_deg'.*sigmas_mrad"),
    "no correlation time": (
        PASS + MARKOV.format(""),
        r"passes\[0\]\.position, correlation_time_s: gauss-markov without it; expected seconds in which",
    ),
    "jitter": (PASS + ROUGH.format("").replace("white", "jitter"), r"model: .*\[\[passes.vibrations\]\]; freq"),
    "a drift as a vibration": (PASS + VIBRATION.format(0.1), r"vibrations\[0\]: .*0.1 Hz over .*one cycle or more"),
    "a vibration that lines don't sample": (PASS + VIBRATION.format(5e3), "5000 Hz, of lines .* two lines"),
    "a cubic beside a process": (
        PASS + ROUGH.format("") + "position = { degree = 2 }", "a polynomial of degree 2 beside a"
    ),
    "another unit": (PASS + ROUGH.format(', plus = [{ model = "white", sigma_m = 1 }]'), "sigma_m, of att"),
    "nodes coarser than a slow process's": (
        PASS + MARKOV.format(", correlation_time_s = 0.01") + "nodes = { spacing_s = 0.5 }",
        r"s apart for gauss-markov of correlation time 0\.01 s; expected at most 0\.02 s",
    ),
    "an unknown model": (PASS + 'position = { model = "spline" }', "'spline'; expected one of 'gauss-markov', "),
    "no camera": ("[[mountings]]\nboresight_sigma_mrad = 1", r"mountings\[0\]: no camera; expected one of camera, ins"),
    "no sigma": (R, "an unknown mounting without a sigma"),
    "a fixed one of nothing": (R + 'sharing = "fixed"', "a fixed mounting without angles and arms"),
    "two mountings": (R + "boresight_sigma_mrad = 1\n" + R + "lever_arm_sigma_m = 1", r"'R', which mountings\[0\] has"),
    "two cameras": (
        '[[mountings]]\ncamera = ["L", "R"]\nboresight_sigma_mrad = 1', r"L and R of one camera, mounted 178 deg apart"
    ),
    "shared, too": (
        R + 'boresight_sigma_mrad = 1\n[[shared]]\nkind = "camera boresight"\nimages = ["R"]\nsigma_mrad = 1',
        r"mountings: a camera boresight of image R in \[\[shared\]\], too",
    ),
    "an instrument that no file names": (
        '[[mountings]]\ninstrument = "NACR"\nboresight_sigma_mrad = 1', "'NACR', of no image; .*ISDs and states"
    ),
    "opk angles": (PASS + '[solver]\nangles = "opk-paper"', "angles: 'opk-paper' for cameras mounted aga.*'one'"),
}  # fmt: skip


@pytest.mark.parametrize("fault", WRONG)
def test_one_clear_line(tmp_path: Path, fault: str) -> None:
    tables, message = WRONG[fault]
    tables = PASS + tables if tables.startswith("[[mountings]]") else tables
    with pytest.raises(InputError, match=message) as caught:
        mgsgraph.read_case(write_rig(tmp_path, tables))
    assert "\n" not in str(caught.value)


def test_two_clocks(tmp_path: Path) -> None:
    """R's tables by a clock that is 0.42 s off L's."""
    left, right, other = rig().images
    tables = right.trajectory
    slow = replace(
        tables,
        position=replace(tables.position, times=tables.position.times + 0.42),
        camera=replace(tables.camera, times=tables.camera.times + 0.42),
        body=replace(tables.body, times=tables.body.times + 0.42),
    )
    shown = replace(right, trajectory=slow, lines=right.lines)
    with pytest.raises(InputError, match=r"L and R, whose clocks are 0\.42 s apart: at one time they are"):
        mgsgraph.read_case(write_rig(tmp_path, images=(left, shown, other)))


def test_two_bodies_and_long_pauses() -> None:
    left, right, _ = rig().images
    elsewhere = replace(right, body=Ellipsoid(1737400.0, 1737400.0))
    refuses(r"here: images L of \w+ \(.* km\) and R of \w+ \(1737\.4 km\); exp", mountings, [left, elsewhere], "here")
    refuses(r"minutes apart; expected images of one pass", mountings, [left, later(left, "L2", 7000.0)], "here")


def test_nodes_closer_than_the_rays_support_are_named(tmp_path: Path) -> None:
    """By pass, node, UTC, rays near it and a spacing that does, which then does."""
    table = PASS + 'nodes = {{ spacing_s = {0} }}\nattitude = {{ model = "matern-3/2", sigma_mrad = 0.01, '
    table += "correlation_time_s = 1 }}\nposition = {{ sigmas_m = [50, 10] }}\n"
    with pytest.raises(InputError) as caught:
        mgsgraph.adjust(mgsgraph.read_case(write_rig(tmp_path, table.format(0.001))))
    message = str(caught.value)
    said = re.search(
        r"^pass 'one', nodes closer than the data supports: of \d+ nodes \(.*\) (\d+) at (\S+), (\S+) s "
        r"\([012] rays? near it.*a spacing of (\S+) s is what they support",
        message,
    )
    assert said is not None, message
    assert "strip" not in message
    case = mgsgraph.read_case(write_rig(tmp_path, table.format(said[4])))
    nodes = case.network.passes[0].nodes
    since = tdb_of_utc([said[2]], "")[0] - nodes.epoch - nodes.coverage[0]
    assert since == pytest.approx(float(said[3]), abs=2e-3)
    assert mgsgraph.adjust(case).converged


def test_vibrations_to_be_found_are_those_of_the_passes_that_ask(tmp_path: Path) -> None:
    """Nothing vibrates here: the same result, and it is said."""
    path = write_rig(tmp_path, PASS + 'vibrations = "estimated"\n')
    (tmp_path / "calm").mkdir()
    case, calm = mgsgraph.read_case(path), mgsgraph.read_case(write_rig(tmp_path / "calm", PASS))
    assert case.vibrating == ("one",)
    assert not calm.vibrating
    solution, said = adjusted(case.network, case.settings, case.name, no_progress, case.vibrating)
    assert solution.cost_final == pytest.approx(mgsgraph.adjust(calm).cost_final, rel=1e-9)
    assert len(said) == 1
    refuses("to be estimated", images_of_case, path)


def test_estimated_strengths_leave_the_sigmas_of_ties(tmp_path: Path) -> None:
    """A factor for ties would absorb whatever is wrong with them: sigma0 says it, with estimated strengths, too."""
    table = """
[passes.attitude]
model = "matern-3/2"
sigma_mrad = "estimated"
correlation_time_s = 1.0
"""
    path = write_rig(tmp_path, PASS + table)
    case = mgsgraph.read_case(path)
    solution = mgsgraph.adjust(case)
    np.testing.assert_array_equal(solution.network.rays.sigmas, case.network.rays.sigmas)
    start, found = (one.passes[0].prior for one in (case.network, solution.network))
    assert isinstance(start, ProcessPrior)
    assert isinstance(found, ProcessPrior)
    assert not np.allclose(start.attitude[0].sigmas, found.attitude[0].sigmas)
    with pytest.raises(InputError, match="strengths or vibrations to be estimated"):
        group(["project", "init", str(tmp_path / "project"), "--case", str(path)], standalone_mode=False)
    with pytest.raises(click.UsageError, match="estimated strengths"):
        group(["adjust", str(path), "--cluster", "local:1", "--out", str(tmp_path / "out")], standalone_mode=False)


# --- [[mountings]] in a case file


def shared_of(folder: Path, tables: str) -> list[SharedUnknown]:
    return list(mgsgraph.read_case(write_rig(folder, PASS + tables)).network.shared)


def turned(angles: list[float], arm: list[float]) -> tuple[Array, Array, Array]:
    """Places (n, 3) and matrices (n, 3, 3) of R so mounted, at some lines; and these lines."""
    image = rig().images[1]
    entry = MountingInput(camera=("R",), sharing="fixed", boresight_mrad=tuple(angles), lever_arm_m=tuple(arm))
    (moved,) = mounted_images([entry], [""], [image], "here")
    lines = np.linspace(0.0, image.lines, 7)
    pose = moved.pose(lines)
    return pose.position, pose.matrix, lines


def test_what_is_stated_is_what_the_unknowns_of_the_same_values_do() -> None:
    """To first order: of a boresight and of a lever arm, by the effects that the adjustment takes."""
    image = rig().images[1]
    angles, arm = [0.03, -0.02, 0.05], [1.5, -2.0, 0.7]
    places, matrices, lines = turned(angles, arm)
    nominal = image.pose(lines)
    u = image.normalised(lines)[:, None] ** np.arange(6)
    by_arm = np.einsum("c,cpk,np->nk", arm, image_effect(image, SharedKind.CAMERA_LEVER_ARM, "camera"), u)
    by_turn = np.einsum(
        "c,cpk,np->nk", np.array(angles) * MRAD, image_effect(image, SharedKind.CAMERA_BORESIGHT, "camera"), u
    )
    np.testing.assert_allclose(places - nominal.position, by_arm[:, :3], atol=1e-3)
    turns = rotation.logarithm(nominal.matrix @ matrices.mT)
    np.testing.assert_allclose(turns, by_turn[:, 3:], atol=1e-9)


def test_a_fixed_mounting_is_no_unknown(tmp_path: Path) -> None:
    path = write_rig(tmp_path, PASS + R + 'sharing = "fixed"\nboresight_mrad = [0.5, 0.0, 0.0]\n')
    net = mgsgraph.read_case(path).network
    assert net.shared == ()
    before = mgsgraph.read_case(write_rig(tmp_path, PASS)).network
    assert net.passes[0].axes is not None
    assert before.passes[0].axes is not None
    turn = rotation.logarithm((net.passes[0].axes[1] @ before.passes[0].axes[1].T)[None])[0]
    np.testing.assert_allclose(turn, [-0.5 * MRAD, 0.0, 0.0], atol=1e-9)


def test_unknowns_of_a_campaign_and_of_each_pass(tmp_path: Path) -> None:
    (one,) = shared_of(tmp_path, R + "boresight_sigma_mrad = [1.6, 1.6, 0.5]\n")
    assert (one.name, one.kind, one.images.tolist()) == ("boresight of NAC-R", SharedKind.CAMERA_BORESIGHT, [1])
    np.testing.assert_allclose(one.sigmas, np.array([1.6, 1.6, 0.5]) * MRAD)
    both = '[[mountings]]\ncamera = ["other", "R"]\nname = "R"\nsharing = "pass"\nlever_arm_sigma_m = 0.2\n'
    found = shared_of(tmp_path, both)
    assert [one.name for one in found] == ["lever arm of R, one", "lever arm of R, other"]
    assert [one.images.tolist() for one in found] == [[1], [2]]
    assert {one.kind for one in found} == {SharedKind.CAMERA_LEVER_ARM}


def test_a_stated_lever_arm_of_a_camera_moves_no_range() -> None:
    """The trajectory of L is the origin of ranges; R carries none, and an arm of 0 or a turn moves none."""
    net = rig(boresight=False)
    assert set(net.ranges.image.tolist()) == {0}

    def unknowns(**stated: tuple[float, ...]) -> tuple[SharedUnknown, ...]:
        entry = MountingInput(camera=("L",), sharing="fixed", **stated)  # type: ignore[arg-type]
        return mounting_unknowns([entry], [[0]], net, "case.toml")

    with pytest.raises(InputError, match=r"mountings\[0\], lever_arm_m: a stated arm of image L, whose traj.*_sigma_m"):
        unknowns(lever_arm_m=(0.0, 0.0, 200.0))
    assert unknowns(lever_arm_m=(0.0, 0.0, 0.0)) == unknowns(boresight_mrad=(0.1, 0.0, 0.0)) == ()
    right = MountingInput(camera=("R",), sharing="fixed", lever_arm_m=(0.0, 0.0, 200.0))
    assert mounting_unknowns([right], [[1]], net, "case.toml") == ()


# --- [[passes]] with a `prior` in a case file: images of one camera


@pytest.fixture(scope="module")
def block_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("block")
    write_block(path)
    return path


def case_with(block_folder: Path, passes: str, name: str = "other.toml") -> Path:
    """The block's case with other passes."""
    text = (block_folder / "case.toml").read_text(encoding="utf-8")
    assert text.endswith(PASSES)
    path = block_folder / name
    path.write_text(text.removesuffix(PASSES) + passes, encoding="utf-8")
    return path


def first_pass(block_folder: Path, table: str) -> Pass:
    """The first pass alone, `table` being what follows its name."""
    images = 'images = ["HRSC/00/S1", "HRSC/00/P1", "HRSC/00/ND", "HRSC/00/P2", "HRSC/00/S2"]'
    table += "" if "prior" in table else "\nprior = {}"
    case = case_with(block_folder, f'[[passes]]\nname = "one"\n{images}\n{table}\n')
    return mgsgraph.read_case(case).network.passes[0]


def prior_of(block_folder: Path, table: str) -> NodePrior:
    prior = first_pass(block_folder, f"prior = {{ {table} }}").prior
    assert isinstance(prior, NodePrior)
    return prior


def test_the_case_is_the_block(block_folder: Path) -> None:
    """Read from its files, with the defaults that the block was drawn with: the same passes, cost and places."""
    case, net = mgsgraph.read_case(block_folder / "case.toml"), block().network
    for read, made in zip(case.network.passes, net.passes, strict=True):
        assert (read.name, read.images.tolist()) == (made.name, made.images.tolist())
        assert isinstance(read.prior, NodePrior)
        assert isinstance(made.prior, NodePrior)
        for part in ("sigmas", "bias", "drift", "correlation_time"):
            np.testing.assert_allclose(getattr(read.prior, part), getattr(made.prior, part), rtol=1e-12)
        np.testing.assert_allclose(read.nodes.times + read.nodes.epoch, made.nodes.times + made.nodes.epoch, atol=1e-6)
    assert [image.timing.periods.size for image in case.network.images] == [3] * 10
    got, want = adjust(case), adjust_network(net, case.settings)
    assert got.cost_final == pytest.approx(want.cost_final, rel=1e-6)
    np.testing.assert_allclose(got.places, want.places, atol=0.01)
    assert not np.any(case.network.held)


# --- where the nodes stand


def test_spacing_in_seconds_and_lines(block_folder: Path) -> None:
    """Lines are those of the nadir image, by its own mean period; nodes reach from the first line to the last."""
    pictures = block().network.images[:5]
    edges = np.array([seconds(image) for image in pictures])
    assert straightest(pictures) == 2
    start, stop = seconds(pictures[2])
    for table, spacing in (
        ("spacing_s = 4.0", 4.0), ("spacing_lines = 1500", 1500 * (stop - start) / pictures[2].lines), ("", 10.0)
    ):
        nodes = first_pass(block_folder, f"nodes = {{ {table} }}").nodes
        times = nodes.times + nodes.epoch
        step = np.diff(times)
        np.testing.assert_allclose(times[[0, -1]], [edges[:, 0].min(), edges[:, 1].max()], atol=1e-6)
        np.testing.assert_allclose(step, step[0], rtol=1e-6)
        assert step[0] <= spacing * (1.0 + 1e-9)
        assert (times[-1] - times[0]) / (step.size - 1) > spacing or step.size == 3  # one fewer would be too few


def test_times_in_utc(block_folder: Path) -> None:
    """START_TIME of h5270 and the time of its first line, within its milliseconds; the block flew at another time."""
    said = ", ".join(f'"2008-02-08T12:08:{second}.843"' for second in (53, 54, 55, 56))
    path = case_with(block_folder, f'[[passes]]\nname = "one"\nimages = ["HRSC/00/ND"]\nprior = {{}}\n'
                     f"nodes = {{ times_utc = [{said}] }}\n")
    with pytest.raises(InputError, match="expected lines within its nodes'") as caught:
        mgsgraph.read_case(path)
    time = float(str(caught.value).split("nodes' ")[1].split(" to")[0])
    epoch = float(str(caught.value).split("s past ")[1].split(" s TDB")[0])
    assert epoch + time == pytest.approx(CHANGES[0][0], abs=2e-3)


# --- a-priori sigmas


def test_units_of_the_prior(block_folder: Path) -> None:
    prior = prior_of(
        block_folder,
        "position_sigma_m = [2.0, 3.0, 4.0], angle_sigma_mrad = 0.01, angle_bias_sigma_mrad = [0.5, 0.0, 0.25], "
        "position_drift_sigma_m = 0.0, angle_drift_sigma_mrad = 0.1, correlation_time_s = 0",
    )
    np.testing.assert_allclose(prior.sigmas, [2.0, 3.0, 4.0, *[0.01 * MRAD] * 3])
    np.testing.assert_allclose(prior.bias, [50.0, 50.0, 50.0, 0.5 * MRAD, 0.0, 0.25 * MRAD])
    np.testing.assert_allclose(prior.drift, [0.0, 0.0, 0.0, *[0.1 * MRAD] * 3])
    assert prior.correlation_time == 0.0


def test_defaults_give_way_where_nodes_know_nothing() -> None:
    prior = NodePriorInput(position_sigma_m=float("inf")).prior("here")
    assert np.all(np.isinf(prior.sigmas[:3]))
    assert prior.bias[:3].tolist() == prior.drift[:3].tolist() == [0.0] * 3
    assert np.all(prior.bias[3:] == pytest.approx(28.0 * MGON))
    with pytest.raises(InputError, match=r"here: node prior, bias: sigma 5.0 of component 0 whose nodes have none"):
        NodePriorInput(position_sigma_m=float("inf"), position_bias_sigma_m=5.0).prior("here")


# --- what is wrong, in one line

ONE = '[[passes]]\nname = "one"\nimages = ["HRSC/00/S1", "HRSC/00/ND"]\n'
OTHER = '[[passes]]\nname = "two"\n'
WRONG_PASSES = {
    "unknown image": (ONE.replace("00/S1", "00/S9"), r"passes\[0\], images: the image 'HRSC/00/S9'; expected some of"),
    "in two passes": (ONE + OTHER + 'images = ["HRSC/00/ND"]', r"passes\[1\], images: 'HRSC/00/ND', which pass 'one'"),
    "two passes": (OTHER, r"passes\[0\]: images HRSC/00/.. and HRSC/01/.., 39\d minutes apart; expected images of one"),
    "an unknown unit": (ONE + "nodes = { spacing_km = 3 }", r"passes\[0\]\.nodes.*'spacing_km'.*'spacing_s'"),
    "a basis": (ONE + 'nodes = { basis = "lagrange" }', "basis: a word of earlier versions"),
    "two spacings": (ONE + "nodes = { spacing_lines = 10, times_et_s = [1] }", "spacing_lines and times_et_s; expe"),
    "long spacing": (ONE + "nodes = { spacing_s = 3000 }", r"nodes, spacing_s: 3000 s; expected less than"),
    "a slip in the unit": (ONE + "nodes = { spacing_s = 1e-4 }", "at most 10000 nodes"),
    "times that go back": (ONE + "nodes = { times_et_s = [1, 2, 4, 3] }", "times that don't increase"),
    "times of another pass": (ONE + "nodes = { times_et_s = [1, 2, 3, 4] }", "00/S1.*lines within its nodes'"),
}  # fmt: skip


@pytest.mark.parametrize("fault", WRONG_PASSES)
def test_one_clear_line_of_passes(block_folder: Path, fault: str) -> None:
    passes, message = WRONG_PASSES[fault]
    passes += "" if "prior" in passes else "\nprior = {}"
    path = case_with(block_folder, passes)
    with pytest.raises(InputError, match=message) as caught:
        mgsgraph.read_case(path)
    assert str(caught.value).startswith(str(path))
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('name = "HRSC/00/ND"', 'name = "HRSC/00/ND"\nheld = true', "image HRSC/00/ND, which is held"),
        ('name = "HRSC/00/ND"', 'name = "HRSC/00/ND"\norientation = { degree = 1 }', "an orientation table of its own"),
        ("[ties]", '[orientation]\nnominal = "polynomial"\n[ties]', "nominal = 'polynomial'; expected the trajectory"),
    ],
)
def test_what_contradicts_a_strip(block_folder: Path, old: str, new: str, message: str) -> None:
    path = case_with(block_folder, f"{ONE}prior = {{}}")
    path.write_text(path.read_text(encoding="utf-8").replace(old, new, 1), encoding="utf-8")
    with pytest.raises(InputError, match=message) as caught:
        mgsgraph.read_case(path)
    assert str(caught.value).startswith(f"{path}, passes[0] (one)")


def test_cameras_of_one_pass_are_mounted_as_their_attitudes_say() -> None:
    """Alike; turned by 0.02 rad at the same time; 5 km away; turning against each other."""
    one, other = block().network.images[:2]
    assert mountings([one, other], "here") is None
    assert isinstance(other.trajectory, Trajectory)
    turn = np.array([[1.0, 0.0, 0.0], [0.0, np.cos(0.02), np.sin(0.02)], [0.0, -np.sin(0.02), np.cos(0.02)]])

    def with_table(**tables: object) -> PushbroomImage:
        return replace(other, trajectory=replace(other.trajectory, **tables))  # type: ignore[type-var]

    camera = other.trajectory.camera
    turned = with_table(camera=replace(camera, constant=turn @ camera.constant))
    axes = mountings([one, turned], "here")
    assert axes is not None
    np.testing.assert_allclose(axes, [np.eye(3), turn], atol=1e-5)
    table = other.trajectory.position
    moved = with_table(position=replace(table, positions=table.positions + np.array([5e3, 0.0, 0.0])))
    refuses(r"5000 m apart", mountings, [moved, one], "here")
    still = replace(camera, quaternions=np.broadcast_to(camera.quaternions[:1], camera.quaternions.shape))
    with pytest.raises(InputError, match=r"turn against each other"):
        mountings([one, with_table(camera=replace(still, constant=turn @ turn))], "here")


# --- HRSC by labels: one trajectory


def test_labels_of_one_pass_are_read_on_one_trajectory(shared_data: Path, tmp_path: Path) -> None:
    """Of the real kernels; outside of a pass each label has a trajectory of its own."""
    label = (shared_data / FOLDER / "h5270_0000_ir2_pds3.lbl").read_text()
    times_file(tmp_path)
    names = ("IR", "NADIR")
    text = ["format = 1", 'name = "h5270"', "[ground_control]", 'file = "points.gcp"', "[spice]", "sampling_s = 0.5"]
    text.append(f"kernels = {[str(path) for path in kernels(shared_data)]}")
    for name in names:
        (tmp_path / f"{name}.lbl").write_text(label.replace("MEX_HRSC_IR", f"MEX_HRSC_{name}"))
        text += ["[[images]]", f'name = "{name}"', f'label = "{name}.lbl"', 'line_times = "line_times.csv"']
    text.append("focal_length_m = 0.17")  # of the nadir line alone
    (tmp_path / "points.gcp").write_text("G1 20.0 77.6 0.0 1 1 1 IR 100 200 1 1 NADIR 300 400 1 1\n")
    path = tmp_path / "case.toml"
    path.write_text("\n".join(text))
    apart = mgsgraph.read_case(path).network.images
    text += ["[[passes]]", "prior = {}", 'name = "h5270"', "nodes = { spacing_lines = 1000 }"]
    path.write_text("\n".join(text))
    net = mgsgraph.read_case(path).network

    assert apart[0].trajectory is not apart[1].trajectory
    assert net.images[0].trajectory is net.images[1].trajectory
    assert net.image_names == list(names)
    assert net.images[0].interior.focal_length == pytest.approx(0.17482)
    assert net.images[1].interior.focal_length == 0.17
    places = np.array([0.0, 7000.3, LINES]), np.array([3.0, 600.0, 1288.0])
    for one, alone in zip(net.images, apart, strict=True):
        np.testing.assert_allclose(one.image_to_ground(*places)[0], alone.image_to_ground(*places)[0], atol=1e-4)
    assert len(net.passes[0].nodes) == 17  # 15,088 lines in 16 intervals


# --- in projects


def test_projects_keep_them(block_folder: Path, tmp_path: Path) -> None:
    """The project's network is the case's, pass by pass."""
    words = ["project", "init", str(tmp_path / "project"), "--case", str(block_folder / "case.toml")]
    group(words, standalone_mode=False)
    with open_project(tmp_path / "project") as project:
        kept = project.store.network()
    wanted = mgsgraph.read_case(block_folder / "case.toml").network
    assert len(kept.points) == len(wanted.points)
    for one, other in zip(kept.passes, wanted.passes, strict=True):
        assert [kept.images[j].name for j in one.images] == [wanted.images[j].name for j in other.images]
        np.testing.assert_array_equal(one.nodes.times, other.nodes.times)
        assert same_values(one.prior, other.prior)

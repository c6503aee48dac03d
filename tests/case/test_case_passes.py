"""[[passes]] in a case file."""

import re
from dataclasses import replace
from pathlib import Path

import click
import numpy as np
import pytest
from rigs import PASS, TURN, later, rig, write_rig

import mgsgraph
from mgsgraph.cli import group
from mgsgraph.errors import InputError
from mgsgraph.geometry.body import Ellipsoid
from mgsgraph.geometry.trajectory import tdb_of_utc
from mgsgraph.network import Pass, ProcessPrior
from mgsgraph.network.joining import found_passes, mountings
from mgsgraph.network.passes import normalised
from mgsgraph.units import MRAD


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
    """The CTX case: slow departures and jitter of the attitude, whose strengths are estimated; positions are a line."""
    tables = """
[passes.position]
degree = 1
sigmas_m = [50.0, 10.0]
[passes.attitude]
model = "matern-5/2"
sigma_mrad = "estimated"
correlation_time_s = 1.0
bias_sigma_mrad = 0.3
plus = [{ model = "jitter", sigma_mrad = 0.004, frequency_hz = 2.0 }]
"""
    found = pass_of(tmp_path, tables)
    prior = found.prior
    assert isinstance(prior, ProcessPrior)
    slow, jitter = prior.attitude
    assert (slow.kind, slow.correlation_time, slow.estimated) == ("matern-5/2", 1.0, True)
    assert (jitter.frequency, jitter.bandwidth, jitter.estimated) == (2.0, 0.2, False)
    np.testing.assert_allclose(jitter.sigmas, 0.004 * MRAD)
    np.testing.assert_allclose(prior.bias, np.repeat([50.0, 0.3e-3], 3))
    np.testing.assert_allclose(prior.drift, np.repeat([10.0, 0.0], 3))
    assert prior.position[0].sigmas.max() < 0.01
    assert 0.9 / 16.0 < found.nodes.spacing <= 1.0 / 16.0  # an eighth of a cycle


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


def test_images_of_two_cameras_that_follow_upon_each_other() -> None:
    """L and R, and both again after five minutes, R before L in the list: each later one goes by its own camera."""
    left, right, _ = rig().images
    images = (left, right, later(right, "R2", 300.0), later(left, "L2", 300.0))
    axes = mountings(images, "here")
    assert axes is not None
    np.testing.assert_allclose(axes, [np.eye(3), TURN, TURN, np.eye(3)], atol=1e-6)


# --- what is wrong, in one line

MARKOV = '''
position = {{ model = "gauss-markov", sigma_m = 1{0} }}
attitude = {{ model = "gauss-markov", sigma_mrad = 1{0} }}
'''
JITTER = 'attitude = {{ model = "jitter", sigma_mrad = 0.01{0} }}\n'
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
    "jitter without frequency": (PASS + JITTER.format(""), "attitude, frequency_hz: jitter without it; expected cyc"),
    "a cubic beside a process": (
        PASS + JITTER.format(", frequency_hz = 2") + "position = { degree = 2 }", "a polynomial of degree 2 beside a"
    ),
    "another unit": (
        PASS + JITTER.format(', frequency_hz = 2, plus = [{ model = "white", sigma_m = 1 }]'), "sigma_m, of att"
    ),
    "nodes coarser than a vibration": (
        PASS + JITTER.format(", frequency_hz = 50") + "nodes = { spacing_s = 1 }",
        r"passes\[0\]\.nodes: nodes [0-9.]+ s apart for a vibration of 50 Hz; expected at most 0\.008 s.*0\.0025",
    ),
    "nodes coarser than a slow process's": (
        PASS + MARKOV.format(", correlation_time_s = 0.01") + "nodes = { spacing_s = 0.5 }",
        r"s apart for gauss-markov of correlation time 0\.01 s; expected at most 0\.02 s",
    ),
    "an unknown model": (PASS + 'position = { model = "spline" }', "'spline'; expected one of 'gauss-markov', "),
    "opk angles": (PASS + '[solver]\nangles = "opk-paper"', "angles: 'opk-paper' for cameras mounted aga.*'one'"),
}  # fmt: skip


@pytest.mark.parametrize("fault", WRONG)
def test_one_clear_line(tmp_path: Path, fault: str) -> None:
    tables, message = WRONG[fault]
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
    with pytest.raises(InputError, match=r"here: images L of \w+ \(.* km\) and R of \w+ \(1737\.4 km\); exp"):
        mountings([left, elsewhere], "here")
    with pytest.raises(InputError, match=r"minutes apart; expected images of one pass"):
        mountings([left, later(left, "L2", 7000.0)], "here")


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
    with pytest.raises(InputError, match="strengths of processes to be estimated"):
        group(["init", str(tmp_path / "project"), "--case", str(path)], standalone_mode=False)
    with pytest.raises(click.UsageError, match="estimated strengths"):
        group(["adjust", str(path), "--two-steps", "--out", str(tmp_path / "out")], standalone_mode=False)

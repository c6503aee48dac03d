"""Jitter modelled from data: what measures see is taken out, with strengths of the right size; what not is said."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from joint_prior import JointNodePrior

from mgsgraph.adjustment.adjust import adjust_network
from mgsgraph.adjustment.settings import SolverSettings
from mgsgraph.analysis.spacing.jitter_model import JitterModel, jitter_model
from mgsgraph.errors import InputError
from mgsgraph.simulation.ctx import (
    PIXEL,
    ControlSettings,
    CtxSettings,
    JitterSettings,
    SimulatedCtxPair,
    dense_truth,
    height_errors,
    ripple,
    simulate_ctx_pair,
)

PLAIN = SolverSettings(starts=0)


@cache
def short(control: bool) -> tuple[SimulatedCtxPair, JitterModel]:
    """Six seconds of jitter at 1.5 Hz."""
    settings = CtxSettings(
        lines=3000, ties=900, jitter=JitterSettings(frequency=1.5), spacing=2.0,
        control=ControlSettings(posts_per_degree=512, vertical=2.0) if control else None,
    )  # fmt: skip
    mine = simulate_ctx_pair(settings, 2)
    return mine, jitter_model(mine.network, PLAIN, [1.5], PIXEL)


def strength(model: JitterModel, process: str, axis: str) -> tuple[float, float, bool]:
    (one,) = [one for one in model.strengths if process in one.process and one.axis == axis]
    return one.sigma / PIXEL, one.seen, one.found


def test_dense_truth_is_at_true_places() -> None:
    mine, _ = short(False)
    truth = dense_truth(mine, 64, 3)
    assert np.abs(height_errors(truth, mine.network.images, mine.corrections)).max() < 1e-3


def test_ripple_of_a_sine_is_its_amplitude() -> None:
    truth = dense_truth(short(False)[0], 16, 5)
    heights = 4.0 * np.sin(3.0 * np.pi * truth.times[truth.row.astype(int)] + 0.7) + 30.0
    assert ripple(truth, heights, 1.5) == pytest.approx(4.0, rel=0.1)
    assert ripple(truth, np.full(heights.size, 30.0), 1.5) == pytest.approx(0.0, abs=1e-9)


@pytest.mark.slow
def test_control_takes_ripples_out() -> None:
    mine, model = short(True)
    truth, images = dense_truth(mine), mine.network.images
    before, after = (
        ripple(truth, height_errors(truth, images, [one.correction(0), one.correction(1)]), 1.5)
        for one in (adjust_network(mine.network, PLAIN), adjust_network(model.network, PLAIN))
    )
    assert before > 4.0
    assert after < before / 4.0
    assert strength(model, "1.5", "roll")[2]
    assert model.evidence > 100.0


def test_what_ties_do_not_see_is_said_and_taken_over() -> None:
    _, model = short(False)
    pitch, roll = strength(model, "1.5", "pitch"), strength(model, "1.5", "roll")
    assert pitch[2]
    assert 0.05 < pitch[0] < 1.0
    assert pitch[1] > 0.5
    assert not roll[2]
    assert roll[1] < 1e-3
    assert roll[0] == pytest.approx(pitch[0])


def test_other_priors_are_refused() -> None:
    network = short(False)[0].network
    one = network.passes[0]
    joint = JointNodePrior(np.eye(6 * len(one.nodes)))
    with pytest.raises(InputError, match="JointNodePrior"):
        jitter_model(replace(network, passes=(replace(one, prior=joint), network.passes[1])), PLAIN, [], PIXEL)

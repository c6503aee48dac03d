"""What is not told apart by geometry is named with the mixture that is determined, and nothing else is."""

from dataclasses import replace

import numpy as np
import pytest
from rigs import adjusted_rig, rig

from mgsgraph.adjustment.adjust import adjust_network
from mgsgraph.adjustment.settings import SolverSettings
from mgsgraph.adjustment.solution import Solution
from mgsgraph.analysis.posterior import Posterior
from mgsgraph.analysis.separability import Inseparable, inseparable
from mgsgraph.network import NodePrior, SharedKind, SharedUnknown
from mgsgraph.results.analysis import Wanted, analysed

ALTITUDE = 380.0
"""m on the ground per mrad."""


def found(solution: Solution) -> dict[tuple[str, ...], Inseparable]:
    every = inseparable(solution.network, solution.joint_covariance, solution.settings.angles)
    return {tuple(sorted(part.name.removesuffix(" of pass one pass") for part in one.quantities)): one
            for one in every}  # fmt: skip


def with_shared(*shared: SharedUnknown) -> Solution:
    return adjust_network(replace(rig(), shared=shared), SolverSettings())


def of(name: str, kind: SharedKind, images: list[int], sigma: float) -> SharedUnknown:
    return SharedUnknown(name, kind, np.array(images), np.full(kind.width, sigma))


def test_position_and_attitude_are_one_over_so_short_an_arc() -> None:
    groups = found(adjusted_rig())
    assert set(groups) == {("across-track position", "roll"), ("along-track position", "pitch")}
    for one in groups.values():
        assert abs(one.correlation) > 0.999
        assert one.coefficients[0] == 1.0
        assert one.coefficients[1] == pytest.approx(ALTITUDE, rel=0.01)
        assert one.sigma < 0.05 * one.quantities[0].sigma
        assert one.quantities[1].unit == "mrad"


def test_the_sigma_is_that_of_the_mixture() -> None:
    """By the law of error propagation from its parts."""
    solution = adjusted_rig()
    one = found(solution)["along-track position", "pitch"]
    by_parts = [part.sigma for part in one.quantities] * one.coefficients
    variance = by_parts @ np.array([[1.0, one.correlation], [one.correlation, 1.0]]) @ by_parts
    assert one.sigma == pytest.approx(np.sqrt(variance), rel=1e-6)


def test_two_boresights_have_only_a_difference() -> None:
    kind = SharedKind.CAMERA_BORESIGHT
    groups = found(with_shared(of("boresight of L", kind, [0], 3e-4), of("boresight of R", kind, [1], 3e-4)))
    for angle, place in (("roll", "across-track position"), ("pitch", "along-track position")):
        one = groups[f"{angle} of boresight of L", f"{angle} of boresight of R"]
        assert one.coefficients[1] == pytest.approx(-1.0, abs=1e-2)
        assert one.sigma < 0.02 * one.quantities[0].sigma
        together = next(one for names, one in groups.items() if place in names)
        assert len(together.quantities) == 3
        assert "largest correlation of two" in together.sentence
        assert together.coefficients[1:] == pytest.approx([ALTITUDE, ALTITUDE], rel=0.02)


def test_what_priors_tell_apart_is_not_named() -> None:
    """Known positions leave nothing that attitude could be taken for."""
    one = rig().passes[0]
    prior = one.prior
    assert isinstance(prior, NodePrior)
    firm = NodePrior(prior.sigmas * ([0.01] * 3 + [1.0] * 3), prior.bias * ([1e-3] * 3 + [1.0] * 3), prior.drift, 4.0)
    network = replace(rig(), passes=(replace(one, prior=firm),), shared=())
    solution = adjust_network(network, SolverSettings())
    assert not found(solution)
    (section,) = (part for part in analysed(Posterior.of(solution), Wanted(weak=1), "rig") if part.name[:3] == "sep")
    assert "are separable" in section.text()
    assert section.numbers == []

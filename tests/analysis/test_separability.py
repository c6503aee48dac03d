"""What geometry leaves inseparable is named with the mixture that is determined; which shared unknowns are it."""

import json
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from commands import rows_of
from networks import network, pair, with_shift_and_surface
from rigs import adjusted_rig, rig
from sharing import camera_clock, drawn, shared, with_all_kinds

from mgsgraph.adjustment.adjust import adjust_network
from mgsgraph.adjustment.settings import SolverSettings
from mgsgraph.adjustment.solution import Solution
from mgsgraph.analysis.separability import Inseparable, Verdict, column_names, inseparable, separations
from mgsgraph.network import NodePrior, SharedKind
from mgsgraph.results.passes import shared_section
from mgsgraph.results.results import statements, write_results
from mgsgraph.units import ARCSEC

ALTITUDE = 380e3 * ARCSEC
"""m on the ground per arcsec."""


def found(solution: Solution) -> dict[tuple[str, ...], Inseparable]:
    every = inseparable(solution.network, solution.joint_covariance, solution.settings.angles)
    return {tuple(sorted(part.name.removesuffix(" of pass one pass") for part in one.quantities)): one
            for one in every}  # fmt: skip


def test_position_and_attitude_are_one_over_so_short_an_arc() -> None:
    groups = found(adjusted_rig())
    assert set(groups) == {("across-track position", "roll"), ("along-track position", "pitch")}
    for one in groups.values():
        assert abs(one.correlation) > 0.999
        assert one.coefficients[0] == 1.0
        assert one.coefficients[1] == pytest.approx(ALTITUDE, rel=0.01)
        assert one.sigma < 0.05 * one.quantities[0].sigma
        assert one.quantities[1].unit == "arcsec"
        by_parts = [part.sigma for part in one.quantities] * one.coefficients
        variance = by_parts @ np.array([[1.0, one.correlation], [one.correlation, 1.0]]) @ by_parts
        assert one.sigma == pytest.approx(np.sqrt(variance), rel=1e-6)  # of the mixture, by error propagation


def test_two_boresights_have_only_a_difference() -> None:
    ones = (shared(SharedKind.CAMERA_BORESIGHT, [j], 3e-4) for j in range(2))
    both = tuple(replace(one, name=f"boresight of {side}") for one, side in zip(ones, "LR", strict=True))
    groups = found(adjust_network(replace(rig(), shared=both), SolverSettings()))
    for angle, place in (("roll", "across-track position"), ("pitch", "along-track position")):
        one = groups[f"{angle} of boresight of L", f"{angle} of boresight of R"]
        assert one.coefficients[1] == pytest.approx(-1.0, abs=1e-2)
        assert one.sigma < 0.02 * one.quantities[0].sigma
        together = next(one for names, one in groups.items() if place in names)
        assert len(together.quantities) == 3
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


# --- which shared unknowns are separable


def test_figures_are_those_of_the_dense_covariance() -> None:
    solution = of_all_kinds()
    dense, found = solution.joint_covariance.dense(), separations(solution)
    names = column_names(solution.network, solution.joint_covariance.square_root)
    sigmas = np.sqrt(np.diag(dense))
    correlation = dense / np.outer(sigmas, sigmas)
    information = np.diag(np.linalg.inv(correlation))
    prior = np.concatenate([one.sigmas for one in solution.network.shared])
    first = int(solution.joint_covariance.square_root.first[solution.network.first_shared])
    assert len(found) == prior.size
    for k, one in enumerate(found):
        mine = first + k
        others = np.abs(np.delete(correlation[mine], mine))
        assert one.name == names[mine]
        assert one.gain == pytest.approx(sigmas[mine] / prior[k], rel=1e-6)
        assert abs(one.correlation) == pytest.approx(others.max(), abs=1e-6)
        assert correlation[mine, names.index(one.other)] == pytest.approx(one.correlation, abs=1e-6)
        assert one.together == pytest.approx(np.sqrt(1.0 - 1.0 / information[mine]), abs=1e-5)
        assert one.together >= abs(one.correlation) - 1e-9


def with_unknowns(*kinds: tuple[SharedKind, float]) -> Solution:
    """A pair whose laser shots place it, and unknowns of both images' camera with their sigmas."""
    unknowns = tuple(shared(kind, [0, 1], sigma) for kind, sigma in kinds)
    return adjust_network(replace(network(pair(60, 12)), shared=unknowns), SolverSettings())


def test_a_principal_point_is_no_boresight_only_by_their_priors() -> None:
    """A narrow angle: the axis displaced by 1 mm over 3.5 m is the camera turned by as many mrad."""
    solution = with_unknowns((SharedKind.PRINCIPAL_POINT, 3.5e-3), (SharedKind.CAMERA_BORESIGHT, 1e-3))
    by_name = {one.name: one for one in separations(solution)}
    for name, other in (("principal point x", "camera boresight y"), ("principal point y", "camera boresight x")):
        assert by_name[name].verdict is Verdict.NOT_FROM_ONE
        assert by_name[name].other == other
        assert f"Not separable from {other}" in by_name[name].sentence


def test_what_the_measures_do_not_see_is_said_to_be_from_its_prior() -> None:
    (one,) = separations(with_unknowns((SharedKind.RADIAL_DISTORTION_3, 1e-8)))
    assert one.verdict is Verdict.FROM_PRIOR
    assert "Determined by its prior alone" in one.sentence


def test_a_single_unknown_of_known_images_is_separable() -> None:
    net = replace(network(pair(60, 12), held=(True, True)), shared=(shared(SharedKind.CAMERA_BORESIGHT, [0, 1], 1e-3),))
    for one in separations(adjust_network(net, SolverSettings())):
        if "z" not in one.name:
            assert one.verdict is Verdict.SEPARABLE
    two = replace(net.shared[0], name="the same again")
    twice = adjust_network(replace(net, shared=(*net.shared, two)), SolverSettings())
    assert {one.verdict for one in separations(twice)} <= {Verdict.NOT_FROM_ONE, Verdict.FROM_PRIOR}


# --- reports of what images share


@cache
def single() -> Solution:
    """One nadir image and a held one, whose camera's clock may be late."""
    return adjust_network(camera_clock(network(drawn(1))), SolverSettings())


@cache
def of_all_kinds() -> Solution:
    return adjust_network(with_all_kinds(with_shift_and_surface(network(pair()))), SolverSettings())


def test_a_single_pair_says_that_its_pitch_and_the_clock_are_inseparable() -> None:
    (one,) = separations(single())
    assert one.verdict is Verdict.NOT_FROM_OTHERS
    assert one.other == "constant rotation y of image SIM/A"
    assert one.together > 0.999
    assert 0.6 < abs(one.correlation) < 0.9
    assert 320.0 < one.ground < 345.0
    (sentence,) = shared_section(single()).sentences
    assert sentence in statements(single())


def test_where_pitch_is_known_the_position_is_its_rival() -> None:
    """A thousand times sharper priors on the attitude: late by so much is ahead by so much."""
    net = network(drawn(1))
    sharp = tuple(replace(prior, sigmas=prior.sigmas * np.repeat([1.0, 1e-3], 3)) for prior in net.priors)
    (one,) = separations(adjust_network(camera_clock(replace(net, priors=sharp)), SolverSettings()))
    assert one.verdict is Verdict.NOT_FROM_ONE
    assert one.other == "constant Z of image SIM/A"
    assert one.sigma < 0.4


def test_images_that_are_held_are_no_rivals() -> None:
    (one,) = separations(adjust_network(camera_clock(network(pair(), held=(True, True))), SolverSettings()))
    assert one.other == ""
    assert one.sigma < 0.5


def test_files_have_a_row_for_each_component(tmp_path: Path) -> None:
    solution = of_all_kinds()
    assert "shared.csv" in write_results(solution, tmp_path / "out", figures=False)
    rows = rows_of(tmp_path / "out" / "shared.csv")
    assert [row["kind"] for row in rows] == [str(kind) for kind in SharedKind for _ in range(kind.width)]
    assert [row["axis"] for row in rows[2:5]] == ["x", "y", "z"]
    assert float(rows[0]["value"]) == solution.shared[0][0]
    assert float(rows[3]["value"]) == pytest.approx(solution.shared[2][1] / ARCSEC, rel=1e-12)
    assert float(rows[3]["prior_sigma"]) * ARCSEC == pytest.approx(1e-4)
    record = json.loads((tmp_path / "out" / "solution.json").read_text(encoding="utf-8"))
    assert record["shared"][3]["value_arcsec"] == pytest.approx(float(rows[3]["value"]))
    assert record["shared"][-1 - SharedKind.VIBRATION.width]["ground_m_per_m"] is None

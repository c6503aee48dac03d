"""Which shared unknowns can be told apart, on cameras whose optics are known: simulated truths, and dense matrices."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from networks import network, pair, with_shift_and_surface
from sharing import shared, with_all_kinds

from mgsgraph.adjustment.adjust import adjust_network
from mgsgraph.adjustment.settings import SolverSettings
from mgsgraph.adjustment.solution import Solution
from mgsgraph.analysis.separability import Verdict, column_names, separations
from mgsgraph.network import SharedKind, SharedUnknown


@cache
def everything() -> Solution:
    return adjust_network(with_all_kinds(with_shift_and_surface(network(pair()))), SolverSettings())


def test_figures_are_those_of_the_dense_covariance() -> None:
    solution = everything()
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
    two = SharedUnknown("the same again", SharedKind.CAMERA_BORESIGHT, np.array([0, 1]), np.full(3, 1e-3))
    twice = adjust_network(replace(net, shared=(*net.shared, two)), SolverSettings())
    assert {one.verdict for one in separations(twice)} <= {Verdict.NOT_FROM_ONE, Verdict.FROM_PRIOR}

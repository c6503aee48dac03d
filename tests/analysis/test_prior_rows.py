"""Rows of what is known of passes beforehand: which values they are about, and how well these are known."""

from dataclasses import replace
from functools import cache

import numpy as np
from networks import network, pair

from mgsgraph.adjustment.adjust import adjust_network
from mgsgraph.adjustment.settings import SolverSettings
from mgsgraph.adjustment.solution import Solution
from mgsgraph.analysis.linearised import at_solution, prior_rows
from mgsgraph.analysis.reliability import reliability
from mgsgraph.geometry.orientation import evenly_spaced
from mgsgraph.network import Pass, PolynomialPrior

POSITION = np.array([[30.0, 40.0, 50.0], [5.0, 6.0, 7.0]])
ATTITUDE = np.array([[3e-4, 2e-4, 1e-4], [5e-5, 6e-5, 7e-5], [1e-5, 2e-5, 3e-5]])


@cache
def of_polynomials() -> Solution:
    """A pair whose first image is a pass: positions linear in time, attitude quadratic."""
    net = network(pair(ties=30, shots=8, seed=4))
    left = net.images[0]
    start, stop = left.timing.at(np.array([0.0, float(left.lines)]))[0]
    nodes = evenly_spaced("lagrange", left.trajectory.epoch, (start, stop), stop - start)
    one = Pass("one", np.array([0]), nodes, PolynomialPrior(POSITION, ATTITUDE))
    return adjust_network(replace(net, passes=(one,)), SolverSettings())


def test_rows_of_a_polynomial_are_of_its_coefficients() -> None:
    at = at_solution(of_polynomials())
    known, first = prior_rows(at), int(at.network.first_of_passes[0])
    begin = at.layout.columns_of(first).start
    mine = (known.about >= begin) & (known.about < begin + 24)
    found = known.sigma[mine][np.argsort(known.about[mine])].reshape(4, 6)
    np.testing.assert_allclose(found[:2, :3], POSITION)
    np.testing.assert_allclose(found[:3, 3:], ATTITUDE)
    assert np.all(np.isfinite(known.sigma) & (known.sigma > 0.0))


def test_names_of_a_polynomial_s_rows() -> None:
    found = reliability(of_polynomials())
    names = [name for k in range(len(found)) if "of pass one" in (name := found.name(k))]
    assert len(set(names)) == len(names) == 24
    assert sum("a-priori" in name and "of the coefficient of s^2 of pass one" in name for name in names) == 6
    assert not any("node" in name for name in names)

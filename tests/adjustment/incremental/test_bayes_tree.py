"""The tree over reduced systems agrees with dense algebra."""

from collections.abc import Iterable

import gtsam
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mgsgraph.adjustment.incremental.bayes_tree import Tree
from mgsgraph.adjustment.incremental.state import ReducedSystem
from mgsgraph.errors import SolverError
from mgsgraph.network.parts import Members, Unknown

ANY = settings(max_examples=20, deadline=None, derandomize=True)
Priors = dict[Unknown, np.ndarray]
Systems = dict[Members, ReducedSystem]


def drawn(seed: int) -> tuple[Priors, Systems]:
    """Unknowns of several sizes and units, and positive semidefinite systems on one to five of them, rank-poor ones,
    too; half of them tell a hundred times more than the priors.
    """
    rng = np.random.default_rng(seed)
    sizes = rng.choice([2, 6, 12], int(rng.integers(1, 8)))
    priors = {Unknown("image", f"i{k}"): 10.0 ** rng.uniform(-5.0, 2.0, size) for k, size in enumerate(sizes)}
    systems = Systems()
    for _ in range(int(rng.integers(1, 9))):
        count = int(rng.integers(1, min(5, len(priors)) + 1))
        members = tuple(sorted(list(priors)[k] for k in rng.choice(len(priors), count, replace=False)))
        systems[members] = system(members, priors, rng)
    return priors, systems


def system(members: Members, priors: Priors, rng: np.random.Generator) -> ReducedSystem:
    """A random one."""
    scale = np.concatenate([priors[u] for u in members])
    rows = rng.standard_normal((int(rng.integers(1, 2 * scale.size)), scale.size)) * 10.0 ** rng.choice([0.0, 2.0])
    rows /= scale
    at = rng.standard_normal(scale.size) * scale
    return ReducedSystem(members, at, rows.T @ rows, rows.T @ rng.standard_normal(rows.shape[0]), 3.0, 1.0)


def dense(priors: Priors, systems: Iterable[ReducedSystem]) -> tuple[dict[Unknown, slice], np.ndarray, np.ndarray]:
    """Where each unknown stands, the solution, and the covariance, by inverting the summed normal matrix."""
    ends = np.cumsum([0, *(one.size for one in priors.values())])
    place = {u: slice(a, b) for u, a, b in zip(priors, ends[:-1], ends[1:], strict=True)}
    scale = np.concatenate(list(priors.values()))
    normal, right = np.eye(scale.size), np.zeros(scale.size)
    for one in systems:
        mine = np.concatenate([np.arange(place[u].start, place[u].stop) for u in one.unknowns])
        normal[np.ix_(mine, mine)] += one.normal * np.outer(scale[mine], scale[mine])
        right[mine] += (one.normal @ one.at - one.gradient) * scale[mine]
    covariance = np.linalg.inv(normal)
    return place, covariance @ right * scale, covariance * np.outer(scale, scale)


CLOSE = (1e-5, 1e-8)
"""Limits of `from_dense`."""


def from_dense(tree: Tree, priors: Priors, systems: Systems, seed: int = 0) -> np.ndarray:
    """(2,) how far the tree is from `dense`, at most: its estimate in sigmas, covariances as a share of themselves."""
    estimate, covariances = [0.0], [0.0]
    place, solution, covariance = dense(priors, systems.values())
    values = tree.values()
    assert set(values) == set(priors)
    for unknown, at in place.items():
        sigmas = np.sqrt(np.diag(covariance)[at])
        estimate.append(np.max(np.abs(values[unknown] - solution[at]) / sigmas))
    rng = np.random.default_rng(seed)
    for count in range(1, min(4, len(priors)) + 1):
        some = [list(priors)[k] for k in rng.permutation(len(priors))[:count]]
        mine = np.concatenate([np.arange(place[u].start, place[u].stop) for u in some])
        expected = covariance[np.ix_(mine, mine)]
        sigmas = np.sqrt(np.diag(expected))
        covariances.append(np.max(np.abs(tree.covariance(some) - expected) / np.outer(sigmas, sigmas)))
    return np.array([np.max(estimate), np.max(covariances)])


@ANY
@given(st.integers(0, 10_000))
def test_replacing_and_removing_is_building_anew(seed: int) -> None:
    """Unknowns and systems come one by one; some are replaced, some go, at last an unknown with all that feels it."""
    rng = np.random.default_rng(seed + 1)
    priors, systems = drawn(seed)
    tree = Tree()
    for unknown, sigmas in priors.items():
        tree.change({unknown: sigmas})
    for members, one in systems.items():
        tree.change(systems={members: one})
        assert members in tree
    for members in list(systems):
        match int(rng.integers(0, 3)):
            case 0:
                systems[members] = system(members, priors, rng)
                tree.change(systems={members: systems[members]})
            case 1:
                del systems[members]
                tree.change(replaced=[members])
                assert members not in tree
    assert np.all(from_dense(tree, priors, systems, seed) < CLOSE)
    leaving = next(iter(priors))
    gone = [members for members in systems if leaving in members]
    tree.change(replaced=gone, dropped=[leaving])
    left = {members: one for members, one in systems.items() if members not in gone}
    rest = {unknown: sigmas for unknown, sigmas in priors.items() if unknown != leaving}
    assert set(tree.values()) == set(rest)
    if rest:
        assert np.all(from_dense(tree, rest, left, seed) < CLOSE)


def test_an_unknown_that_comes_back_counts_as_new() -> None:
    """Also where its value is what it was: whoever asks what has moved has forgotten it with the unknown."""
    one, other = Unknown("image", "one"), Unknown("image", "other")
    tree = Tree()
    tree.change({one: np.ones(6), other: np.ones(6)})
    assert set(tree.moved()) == {one, other}
    assert not tree.moved()
    tree.change(dropped=[one])
    tree.change({one: np.ones(6)})
    assert set(tree.moved()) == {one}


def pair_of_poorly_scaled_images(rows: int) -> tuple[Priors, Systems]:
    """Directions known 10,000 times better than beforehand, across all components: hundreds of good ties do that."""
    rng = np.random.default_rng(1)
    one, other = Unknown("image", "one"), Unknown("image", "other")
    priors = {one: np.full(18, 100.0), other: np.full(18, 1e-3)}
    scale = np.concatenate(list(priors.values()))
    row, at = 1e4 * rng.standard_normal((rows, 36)) / scale, rng.standard_normal(36) * scale
    gradient = row.T @ rng.standard_normal(rows)
    return priors, {(one, other): ReducedSystem((one, other), at, row.T @ row, gradient, 50.0, 1.0)}


@pytest.mark.parametrize("rows", [3, 20])
def test_what_gtsam_s_cholesky_calls_indeterminate_is_no_harder(rows: int) -> None:
    priors, systems = pair_of_poorly_scaled_images(rows)
    (system,) = systems.values()
    scale = np.concatenate(list(priors.values()))
    graph = gtsam.GaussianFactorGraph()
    graph.push_back(gtsam.HessianFactor(0, np.eye(36) + system.normal * np.outer(scale, scale), np.zeros(36), 0.0))
    with pytest.raises(RuntimeError, match="Indeterminate"):  # else this tests nothing
        graph.eliminateMultifrontal(gtsam.Ordering.ColamdGaussianFactorGraph(graph))
    tree = Tree()
    tree.change(priors, systems)
    assert np.all(from_dense(tree, priors, systems) < (1e-4, 1e-5))
    assert not tree.moved()
    tree.change(replaced=list(systems))
    assert np.all(from_dense(tree, priors, {}) < CLOSE)


def test_a_gradient_without_curvature_is_balanced_by_the_prior() -> None:
    """Rounding leaves such systems: the estimate is off by all of the gradient where it is lost."""
    name = Unknown("image", "one")
    normal, gradient = np.diag([1e6, 0.0, -1e-6]), np.array([0.0, 1e-3, 0.0])
    tree = Tree()
    tree.change({name: np.ones(3)}, {(name,): ReducedSystem((name,), np.zeros(3), normal, gradient, 1.0, 1.0)})
    assert tree.values()[name] == pytest.approx([0.0, -1e-3, 0.0], abs=1e-7)


def test_a_sum_that_is_no_normal_matrix_is_an_error() -> None:
    priors, systems = drawn(3)
    members, one = next(iter(systems.items()))
    tree = Tree()
    tree.change(priors, systems)
    bad = ReducedSystem(members, one.at, -1e3 * np.eye(one.at.size) - one.normal, one.gradient, 0.0, 1.0)
    with pytest.raises(SolverError, match="iSAM2 can't eliminate") as caught:
        tree.change(systems={members: bad})
    assert "\n" not in str(caught.value)

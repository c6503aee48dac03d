"""Elimination of normal equations; blocks of the joint covariance, against gtsam.Marginals and the dense inverse."""

import itertools
import pickle
import tracemalloc
from collections.abc import Sequence, Set
from dataclasses import dataclass, replace

import gtsam
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from networks import network, pair, with_shift_and_surface
from outside import refuses

from mgsgraph.adjustment import marginals, sparse_cholesky
from mgsgraph.adjustment.adjust import adjust_network
from mgsgraph.adjustment.marginals import JointCovariance, SquareRoot, joint_covariance
from mgsgraph.adjustment.settings import SolverSettings
from mgsgraph.adjustment.sparse_cholesky import SparseCholesky
from mgsgraph.geometry.records import Array, Index

UNITS = np.array([100.0, 100.0, 100.0, 3e-4, 3e-4, 3e-4])
"""What the columns are measured in: m and rad."""
PATTERNS = ("alone", "chain", "second neighbours", "star", "grid", "all")


@dataclass
class System:
    """A linear system with its dense covariance."""

    linear: gtsam.GaussianFactorGraph
    keys: list[int | None]
    widths: list[int]
    links: list[tuple[int, int]]
    normal: Array
    authority: Array

    @property
    def slices(self) -> list[slice]:
        """Columns of each variable; none for a held one."""
        taken = [0 if key is None else width for key, width in zip(self.keys, self.widths, strict=True)]
        ends = np.cumsum(taken).tolist()
        return [slice(end - width, end) for width, end in zip(taken, ends, strict=True)]

    @property
    def joint(self) -> JointCovariance:
        own = [(v, v) for v, key in enumerate(self.keys) if key is not None]
        pairs = np.array([*own, *self.links], dtype=np.int64).reshape(-1, 2)
        blocks = [self.normal[self.slices[v], self.slices[w]].ravel() for v, w in pairs.tolist()]
        ends = np.cumsum([0, *(block.size for block in blocks)])
        first = np.array([-1 if key is None else part.start for key, part in zip(self.keys, self.slices, strict=True)])
        structure = SparseCholesky(first, np.array(self.widths), pairs, ends[:-1])
        scales = 1.0 / np.sqrt(np.diag(self.normal))
        flat = np.concatenate([np.zeros(0), *blocks])
        return joint_covariance(structure.factor(flat, np.zeros(scales.size), scales).square_root())

    def of(self, variables: Sequence[int]) -> Array:
        """The authority's joint covariance of adjusted variables."""
        columns = np.concatenate([np.arange(self.authority.shape[0])[self.slices[v]] for v in variables])
        return self.authority[np.ix_(columns, columns)]


def links_of(pattern: str, n: int) -> list[tuple[int, int]]:
    rows = max(int(np.sqrt(n)), 1)
    tests = {
        "alone": lambda i, j: False,
        "chain": lambda i, j: j - i == 1,
        "second neighbours": lambda i, j: j - i <= 2,
        "star": lambda i, j: j == n - 1,
        "grid": lambda i, j: max(abs(i // rows - j // rows), abs(i % rows - j % rows)) == 1,
        "all": lambda i, j: True,
    }
    return [(i, j) for i, j in itertools.combinations(range(n), 2) if tests[pattern](i, j)]


def system(
    pattern: str, widths: list[int], held: Set[int] = frozenset(), seed: int = 0
) -> System:
    """Random factors on linked variables, too few rows each to determine them, and a weak prior on each variable.

    Keys are no small numbers, and not in the order of the variables.
    """
    rng, n = np.random.default_rng(seed), len(widths)
    turn = rng.permutation(n).tolist()
    keys = [None if v in held else int(gtsam.symbol("os"[turn[v] % 2], turn[v])) for v in range(n)]
    links = [link for link in links_of(pattern, n) if not held & set(link)]
    made = System(gtsam.GaussianFactorGraph(), keys, widths, links, *np.zeros((2, 0, 0)))
    made.normal = normal = np.zeros((made.slices[-1].stop,) * 2)
    for v in (v for v in range(n) if v not in held):
        root = np.eye(widths[v]) / np.resize(UNITS, widths[v])
        made.linear.push_back(gtsam.JacobianFactor(keys[v], root, rng.normal(size=widths[v]), unit(widths[v])))
        normal[made.slices[v], made.slices[v]] = root**2
    for i, j in links:
        a, b = (rng.normal(size=(4, widths[v])) / np.resize(UNITS, widths[v]) for v in (i, j))
        made.linear.push_back(gtsam.JacobianFactor(keys[i], a, keys[j], b, rng.normal(size=4), unit(4)))
        for (v, left), (w, right) in itertools.product(((i, a), (j, b)), repeat=2):
            normal[made.slices[v], made.slices[w]] += left.T @ right
    scale = np.sqrt(np.diag(normal))
    made.authority = np.linalg.inv(normal / scale[:, None] / scale) / scale[:, None] / scale
    return made


def unit(size: int) -> gtsam.noiseModel.Unit:
    return gtsam.noiseModel.Unit.Create(size)


@st.composite
def systems(draw: st.DrawFn) -> System:
    widths = draw(st.lists(st.sampled_from([2, 6, 18]), min_size=1, max_size=9))
    held = draw(st.sets(st.integers(0, len(widths) - 1), max_size=len(widths) - 1))
    return system(draw(st.sampled_from(PATTERNS)), widths, held, draw(st.integers(0, 99)))


def in_sigmas(found: Array, authority: Array) -> float:
    """Largest difference in units of the sigmas; of the two, the authority's."""
    sigmas = np.sqrt(np.diag(authority))
    return float(np.abs((found - authority) / sigmas[:, None] / sigmas).max(initial=0.0))


# --- what it says


@settings(max_examples=25, deadline=None)
@given(systems())
def test_equals_gtsam_marginals_and_the_dense_inverse(made: System) -> None:
    values = gtsam.Values()
    taken = [(key, width) for key, width in zip(made.keys, made.widths, strict=True) if key is not None]
    for key, width in taken:
        values.insert(key, np.zeros(width))
    theirs = gtsam.Marginals(made.linear, values)
    joint = made.joint
    for authority in (made.authority, theirs.jointMarginalCovariance([key for key, _ in taken]).fullMatrix()):
        assert in_sigmas(joint.dense(), authority) < 1e-10
        np.testing.assert_allclose(joint.sigmas, np.sqrt(np.diag(authority)), rtol=1e-10)


@settings(max_examples=25, deadline=None)
@given(systems(), st.integers(0, 99))
def test_all_ways_to_ask_agree(made: System, seed: int) -> None:
    joint, rng = made.joint, np.random.default_rng(seed)
    adjusted = [v for v, key in enumerate(made.keys) if key is not None]
    assert joint.adjusted.tolist() == adjusted
    for v in set(range(len(made.keys))) - set(adjusted):
        assert not joint.of([v, *adjusted])[: made.widths[v]].any()
    sets = [rng.permutation(adjusted)[: rng.integers(1, len(adjusted) + 1)].tolist() for _ in range(4)] + [[]]
    each, begin = joint.of_each(sets), 0
    for members in sets:
        block = joint.of(members)
        found = each[begin : begin + block.size].reshape(block.shape)
        begin += block.size
        np.testing.assert_array_equal(block, block.T)
        assert not members or max(in_sigmas(block, made.of(members)), in_sigmas(found, made.of(members))) < 1e-10
    assert begin == each.size
    first, second = (np.array(part) for part in zip(*itertools.product(adjusted, adjusted), strict=True))
    width = joint.square_root.width
    size = width[first] * width[second]
    offset = np.cumsum(size + 3) - size
    flat, whole = joint.pairs(first, second, offset), np.zeros_like(made.authority)
    for v, w, start, length in zip(first, second, offset, size, strict=True):
        whole[made.slices[v], made.slices[w]] = flat[start : start + length].reshape(width[v], width[w])
        flat[start : start + length] = 0.0
        block = made.authority.copy()
        block[made.slices[v], made.slices[w]] = joint.block(v, w)
        assert in_sigmas(block, made.authority) < 1e-10
    assert in_sigmas(whole, made.authority) < 1e-10
    assert not flat.any()


@pytest.mark.parametrize("pattern", PATTERNS)
@pytest.mark.parametrize("held", [set(), {0, 5, 13}])
def test_linked_pairs_need_no_solving(pattern: str, held: set[int], monkeypatch: pytest.MonkeyPatch) -> None:
    made = system(pattern, [18, 2, 6, 18] * 4, held)
    joint, authority = made.joint, made.authority

    def refuse(*_: object) -> Array:
        raise AssertionError("solved for")

    monkeypatch.setattr(SquareRoot, "cross", refuse)
    linked = made.links + [(v, v) for v in joint.adjusted.tolist()]
    for v, w in linked + [(w, v) for v, w in linked]:
        np.testing.assert_allclose(
            joint.block(v, w) / np.outer(joint.sigmas[made.slices[v]], joint.sigmas[made.slices[w]]),
            authority[made.slices[v], made.slices[w]]
            / np.sqrt(np.outer(np.diag(authority)[made.slices[v]], np.diag(authority)[made.slices[w]])),
            atol=1e-10,
        )
    if pattern == "chain":
        with pytest.raises(AssertionError, match="solved for"):
            joint.block(1, 12)


def test_any_two_of_many_at_a_fraction_of_the_memory() -> None:
    """No array of all columns by all columns on the way, nor in store."""
    made = system("second neighbours", [18] * 90)
    tracemalloc.start()
    joint = made.joint
    far = joint.of((3, 50))
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < made.authority.nbytes / 4
    assert joint.blocks.nbytes + joint.square_root.rows.nbytes < made.authority.nbytes / 8
    assert in_sigmas(far, made.of((3, 50))) < 1e-10


def test_wide_grid_crosses_the_pieces() -> None:
    """Products and copies large enough to be cut into pieces; pairs solved for in more than one go."""
    made = system("grid", [18] * 64)
    joint = made.joint
    assert joint.square_root.shapes[1].max() > 120
    assert in_sigmas(joint.dense(), made.authority) < 1e-10


def test_a_solution_tells_the_covariance_of_images_and_shifts() -> None:
    solution = adjust_network(with_shift_and_surface(network(pair())), SolverSettings())
    whole = solution.joint_covariance.dense()
    assert whole.shape == (40, 40)
    np.testing.assert_array_equal(solution.image_covariance(1), whole[18:36, 18:36])
    np.testing.assert_array_equal(solution.shift_covariance(1), whole[38:, 38:])
    held = adjust_network(network(pair(), (True, False)), SolverSettings())
    assert not held.image_covariance(0).any()
    np.testing.assert_array_equal(held.image_covariance(1), held.joint_covariance.dense())


# --- what it refuses


def test_the_record_is_read_only_and_travels() -> None:
    joint = system("grid", [6] * 9).joint
    for array in (joint.blocks, joint.square_root.rows, joint.square_root.members):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 0
    joint.block(0, 8)
    back = pickle.loads(pickle.dumps(joint))
    np.testing.assert_array_equal(back.dense(), joint.dense())
    assert repr(joint) == f"JointCovariance(54 columns, {joint.blocks.size} numbers stored)"


def spoilt(values: Index, place: int, value: int) -> Index:
    changed = values.copy()
    changed[place] = value
    return changed


def test_arrays_that_contradict_each_other_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sparse_cholesky, "_RELAXED", 0.0)  # cliques of their own
    joint = system("second neighbours", [6] * 5, {2}).joint
    root = joint.square_root
    assert root.frontals.tolist() == [2, 1, 1]
    at = root.first_member.tolist()
    cliques = [root.members[a:b] for a, b in itertools.pairwise(at)]
    wrong = {
        "first": spoilt(root.first, 2, 3),
        "width": spoilt(root.width, 0, 7),
        "members": np.concatenate([cliques[0], cliques[2], cliques[1]]),  # a child before its parent
        "sizes": root.sizes[:-1],
        "frontals": spoilt(root.frontals, -1, 9),
        "rows": root.rows[1:],
    }
    for name, value in wrong.items():
        refuses("contradict each other", replace, root, **{name: value})
    refuses("joint covariance: shape", replace, joint, blocks=joint.blocks[1:])


# --- elimination


WIDTH, REACH = 6, 10


def overlapping(near: Array) -> tuple[SparseCholesky, Array, Array]:
    """Images, each coupled with those that are near (n, n); the flat blocks of a positive definite matrix, and the
    whole of it.
    """
    count, pairs = len(near), np.argwhere(np.triu(near))
    blocks = np.random.default_rng(3).standard_normal((len(pairs), WIDTH, WIDTH))
    whole = np.zeros((count, WIDTH, count, WIDTH))
    for (j, k), block in zip(pairs, blocks, strict=True):
        if j == k:
            block[:] = block + block.T + 10.0 * WIDTH * np.eye(WIDTH)
        whole[j, :, k], whole[k, :, j] = block, block.T
    first, offset = WIDTH * np.arange(count), WIDTH**2 * np.arange(len(pairs))
    made = SparseCholesky(first, np.full(count, WIDTH), pairs, offset)
    return made, blocks.ravel(), whole.reshape(count * WIDTH, -1)


def test_a_band_stays_a_band() -> None:
    """Its fronts stay as wide as the band, and twice as long a band takes twice the work, not eight times."""
    at = np.arange(400)
    short, long = (overlapping(np.abs(at[:n, None] - at[:n]) <= REACH)[0] for n in (200, 400))
    assert max(front.columns.size for front in long._fronts) < 4 * REACH * WIDTH
    assert long.operations / short.operations == pytest.approx(2.0, rel=0.2)


@pytest.mark.parametrize("dissected", [False, True])
@pytest.mark.parametrize("threads", [False, True])
def test_solution_and_covariance_of_a_block_are_those_of_the_dense_matrix(
    dissected: bool, threads: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """In either order of elimination, with one thread of the BLAS or many."""
    if dissected:
        monkeypatch.setattr(sparse_cholesky, "_MANY", 0.0)
        monkeypatch.setattr("gtsam.Ordering.ColamdSymbolicFactorGraph", gtsam.Ordering.MetisSymbolicFactorGraph)
    if threads:
        monkeypatch.setattr(marginals, "_WORTHWHILE", 0.0)
    row, column = np.divmod(np.arange(72), 8)
    near = (np.abs(row[:, None] - row) <= 1) & (np.abs(column[:, None] - column) <= 1)
    cholesky, flat, whole = overlapping(near)
    scales = np.random.default_rng(4).uniform(0.5, 2.0, cholesky.columns)
    factor = cholesky.factor(flat, np.full(cholesky.columns, 0.5), scales)
    inverse = np.linalg.inv(whole + 0.5 * np.eye(cholesky.columns))
    right = np.random.default_rng(2).standard_normal(cholesky.columns)
    np.testing.assert_allclose(factor.solve(right), inverse @ right, atol=1e-14)
    joint = joint_covariance(factor.square_root())
    np.testing.assert_allclose(joint.dense(), inverse, atol=1e-15)
    np.testing.assert_allclose(joint.sigmas, np.sqrt(np.diag(inverse)), rtol=1e-13)


@pytest.mark.parametrize("size", [1, 2, 3, 6, 15])
def test_one_clique_is_ordered_as_colamd_orders_it(size: int) -> None:
    """Without GTSAM, which takes long to import; draws from a covariance depend on the order."""
    pairs, graph = np.stack(np.triu_indices(size), axis=1) + 3, gtsam.SymbolicFactorGraph()
    for ends in pairs.tolist():
        graph.push_factor(*dict.fromkeys(ends))
    order = gtsam.Ordering.ColamdSymbolicFactorGraph(graph)
    cliques = sparse_cholesky._best_cliques(pairs, np.full(size + 3, 6))
    assert cliques.order.tolist() == [order.at(k) for k in range(size)]
    assert len(cliques.members) == 1

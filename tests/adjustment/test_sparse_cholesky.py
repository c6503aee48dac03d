"""Elimination of normal equations whose blocks lie in a band, as those of orientation images do."""

import gtsam
import numpy as np
import pytest

from mgsgraph.adjustment import marginals, sparse_cholesky
from mgsgraph.adjustment.marginals import joint_covariance
from mgsgraph.adjustment.sparse_cholesky import SparseCholesky

WIDTH, REACH = 6, 10


def band(count: int) -> tuple[SparseCholesky, np.ndarray, np.ndarray]:
    """Nodes coupled with the REACH before them; the flat blocks of a positive definite matrix, and the whole of it."""
    pairs = np.array([(j, k) for k in range(count) for j in range(max(0, k - REACH), k + 1)])
    blocks = np.random.default_rng(1).standard_normal((len(pairs), WIDTH, WIDTH))
    whole = np.zeros((count * WIDTH, count * WIDTH))
    for (j, k), block in zip(pairs, blocks, strict=True):
        if j == k:
            block[:] = block + block.T + 8.0 * WIDTH * REACH * np.eye(WIDTH)
        whole[WIDTH * j : WIDTH * (j + 1), WIDTH * k : WIDTH * (k + 1)] = block
        whole[WIDTH * k : WIDTH * (k + 1), WIDTH * j : WIDTH * (j + 1)] = block.T
    first = WIDTH * np.arange(count)
    offset = WIDTH**2 * np.arange(len(pairs))
    return SparseCholesky(first, np.full(count, WIDTH), pairs, offset), blocks.ravel(), whole


def test_the_factor_of_a_band_solves_its_equations() -> None:
    cholesky, flat, whole = band(120)
    right = np.random.default_rng(2).standard_normal(cholesky.columns)
    found = cholesky.factor(flat, np.zeros(cholesky.columns), np.ones(cholesky.columns)).solve(right)
    np.testing.assert_allclose(whole @ found, right, atol=1e-12)


def test_a_band_stays_a_band() -> None:
    """Its fronts stay as wide as the band, and twice as long a band takes twice the work, not eight times."""
    short, long = (band(count)[0] for count in (200, 400))
    assert max(front.columns.size for front in long._fronts) < 4 * REACH * WIDTH
    assert long.operations / short.operations == pytest.approx(2.0, rel=0.2)


def overlapping(rows: int, columns: int) -> tuple[SparseCholesky, np.ndarray, np.ndarray]:
    """Images on a grid, each coupled with its neighbours; the flat blocks, and the whole of it."""
    count = rows * columns
    row, column = np.divmod(np.arange(count), columns)
    near = (np.abs(row[:, None] - row) <= 1) & (np.abs(column[:, None] - column) <= 1)
    pairs = np.argwhere(np.triu(near))
    blocks = np.random.default_rng(3).standard_normal((len(pairs), WIDTH, WIDTH))
    whole = np.zeros((count, WIDTH, count, WIDTH))
    for (j, k), block in zip(pairs, blocks, strict=True):
        if j == k:
            block[:] = block + block.T + 10.0 * WIDTH * np.eye(WIDTH)
        whole[j, :, k], whole[k, :, j] = block, block.T
    first, offset = WIDTH * np.arange(count), WIDTH**2 * np.arange(len(pairs))
    made = SparseCholesky(first, np.full(count, WIDTH), pairs, offset)
    return made, blocks.ravel(), whole.reshape(count * WIDTH, -1)


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
    cholesky, flat, whole = overlapping(9, 8)
    scales = np.random.default_rng(4).uniform(0.5, 2.0, cholesky.columns)
    factor = cholesky.factor(flat, np.full(cholesky.columns, 0.5), scales)
    inverse = np.linalg.inv(whole + 0.5 * np.eye(cholesky.columns))
    right = np.random.default_rng(2).standard_normal(cholesky.columns)
    np.testing.assert_allclose(factor.solve(right), inverse @ right, atol=1e-14)
    joint = joint_covariance(factor.square_root())
    np.testing.assert_allclose(joint.dense(), inverse, atol=1e-15)
    np.testing.assert_allclose(joint.sigmas, np.sqrt(np.diag(inverse)), rtol=1e-13)

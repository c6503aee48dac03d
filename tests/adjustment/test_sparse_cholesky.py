"""Elimination of normal equations whose blocks lie in a band, as those of orientation images do."""

import numpy as np
import pytest

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

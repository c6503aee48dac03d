"""A basis of simple structure for directions that are equally weak, so that they can be named.

Eigenvectors of (nearly) equal eigenvalues are any mixture of each other. Of all bases of their space, the one with the
largest sum of fourth powers has few large entries per direction (quartimax: Neuhaus & Wrigley 1954; Kaiser's varimax is
the same here). It begins from the pivoted QR decomposition of the projector on the space, which depends on the space
alone, not on the basis it is given in (Damle, Lin & Ying 2015).
"""

import numpy as np

from mgsgraph.geometry.records import Array

_STEPS = 100
_TOLERANCE = 1e-8
"""Relative gain of a step below which the basis is good enough."""


def simple_basis(vectors: Array) -> Array:
    """(k, k) orthogonal R such that the columns of vectors (n, k), orthonormal, times R have simple structure."""
    if vectors.shape[1] < 2:
        return np.eye(vectors.shape[1])
    turn = _start(vectors)
    before = 0.0
    for _ in range(_STEPS):
        turned = vectors @ turn
        left, sums, right = np.linalg.svd(vectors.T @ turned**3)
        turn = left @ right
        if sums.sum() < before * (1.0 + _TOLERANCE):
            break
        before = float(sums.sum())
    return np.asarray(turn)


def _start(vectors: Array) -> Array:
    """The basis nearest to the coordinates that the space holds best."""
    from scipy.linalg import qr  # slow to import

    _, _, pivots = qr(vectors.T, mode="economic", pivoting=True)
    left, _, right = np.linalg.svd(vectors[pivots[: vectors.shape[1]]].T)
    return np.asarray(left @ right)

"""A-priori knowledge of the unknowns that points share, as pseudo-observations (Yoon & Shan 2005, Eq. 4)."""

from collections.abc import Sequence

import gtsam
import numpy as np

from mgsgraph.errors import InputError
from mgsgraph.factors.records import Array


def orientation_prior(key: int, sigmas: Array) -> gtsam.NonlinearFactor:
    """Zero-mean prior on an image's EO coefficients, or on any unknowns about zero (Yoon & Shan 2005, Eq. 4).

    Parameters
    ----------
    key : int
        GTSAM key of a Vector.
    sigmas : (degree + 1, 6) or (columns,)
        m and rad, in the order of the coefficients; infinite where nothing is known.

    Raises
    ------
    InputError
        For sigmas that are not positive.

    Examples
    --------
    >>> from gtsam.symbol_shorthand import X
    >>> prior = mgsgraph.factors.orientation_prior(X(0), network.priors[0].sigmas)
    """
    flat = np.asarray(sigmas, dtype=np.float64).ravel()
    if np.ndim(sigmas) == 0:
        raise InputError("orientation prior", f"one sigma, {sigmas}", "one of each coefficient")
    if not np.all(flat > 0.0):
        raise InputError("orientation prior", f"sigma {flat[~(flat > 0.0)][0]:g}", "positive sigmas")
    precisions = np.where(np.isinf(flat), 0.0, 1.0 / flat**2)
    return gtsam.PriorFactorVector(key, np.zeros(flat.size), gtsam.noiseModel.Diagonal.Precisions(precisions))


def linear_prior(keys: Sequence[int], blocks: Sequence[Array], target: Array) -> gtsam.CustomFactor:
    """Whitened rows sum_k blocks[k] x_k about a target (rows,) on several unknowns; each block (rows, width of its
    variable).

    Examples
    --------
    >>> from gtsam.symbol_shorthand import X
    >>> same = mgsgraph.factors.linear_prior([X(0), X(1)], [0.2 * np.eye(6), -0.2 * np.eye(6)], np.zeros(6))
    """
    fixed = [np.asfortranarray(block) for block in blocks]

    def error(this: gtsam.CustomFactor, values: gtsam.Values, jacobians: list[Array] | None) -> Array:
        if jacobians is not None:
            for k, block in enumerate(fixed):
                jacobians[k] = block
        return np.asarray(sum(block @ values.atVector(key) for key, block in zip(keys, fixed, strict=True)) - target)

    return gtsam.CustomFactor(gtsam.noiseModel.Unit.Create(fixed[0].shape[0]), list(keys), error)

"""A-priori knowledge of the unknowns that points share, as pseudo-observations (Yoon & Shan 2005, Eq. 4)."""

from collections.abc import Sequence

import gtsam
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def zero_prior(key: int, sigmas: Array) -> gtsam.NonlinearFactor:
    """Zero-mean prior on shared unknowns (an image's coefficients, a profile's shift).

    Sigmas (d,) in m and rad, infinite where nothing is known.
    """
    precisions = np.where(np.isinf(sigmas), 0.0, 1.0 / sigmas**2)
    return gtsam.PriorFactorVector(key, np.zeros(sigmas.size), gtsam.noiseModel.Diagonal.Precisions(precisions))


def linear_prior(keys: Sequence[int], blocks: Sequence[Array], target: Array) -> gtsam.CustomFactor:
    """Whitened rows sum_k blocks[k] x_k about a target (rows,) on several unknowns; each block (rows, width of its
    variable).
    """
    fixed = [np.asfortranarray(block) for block in blocks]

    def error(this: gtsam.CustomFactor, values: gtsam.Values, jacobians: list[Array] | None) -> Array:
        if jacobians is not None:
            for k, block in enumerate(fixed):
                jacobians[k] = block
        return np.asarray(sum(block @ values.atVector(key) for key, block in zip(keys, fixed, strict=True)) - target)

    return gtsam.CustomFactor(gtsam.noiseModel.Unit.Create(fixed[0].shape[0]), list(keys), error)

"""A-priori knowledge: of the unknowns, and of ground points moved by their profile (Yoon & Shan 2005, Eq. 4)."""

from collections.abc import Sequence

import gtsam
import numpy as np
from numpy.typing import NDArray

from mgsgraph.factors.lanes import ACTIVE, BY_POINT, BY_STATE, CENTRE, DELTA, LANES, PLACE, RESIDUAL, ROOT, lane
from mgsgraph.factors.pose import correct

Array = NDArray[np.float64]


@lane
def ground_rows(rows, sight, x, n, w, s):
    """RESIDUAL, BY_POINT and BY_STATE (3: shift of the a-priori place, m) of ground priors: U (P - P0 - shift)."""
    correct(rows, sight, x, n, w, s, 3, False)
    place = 0
    for row in range(3):
        for l in range(n):
            w[s + RESIDUAL + row * LANES + l] = 0.0
        for j in range(3):
            point, state = s + BY_POINT + (3 * row + j) * LANES, s + BY_STATE + (7 * row + j) * LANES
            if j < row:
                for l in range(n):
                    w[point + l] = 0.0
                    w[state + l] = 0.0
                continue
            for l in range(n):
                root = w[s + ROOT + place * LANES + l] * w[ACTIVE + l]
                offset = w[PLACE + j * LANES + l] - w[s + CENTRE + j * LANES + l] - w[DELTA + j * LANES + l]
                w[s + RESIDUAL + row * LANES + l] += root * offset
                w[point + l] = root
                w[state + l] = -root
            place += 1


def zero_prior(key: int, sigmas: Array) -> gtsam.NonlinearFactor:
    """Zero-mean prior on shared unknowns (an image's coefficients, a profile's shift).

    Sigmas (d,) in m and rad, infinite where nothing is known.
    """
    precisions = np.where(np.isinf(sigmas), 0.0, 1.0 / sigmas**2)
    return gtsam.PriorFactorVector(key, np.zeros(sigmas.size), gtsam.noiseModel.Diagonal.Precisions(precisions))


def linear_prior(keys: Sequence[int], blocks: Sequence[Array]) -> gtsam.CustomFactor:
    """Whitened rows sum_k blocks[k] x_k about zero on several unknowns; each block (rows, width of its variable)."""
    fixed = [np.asfortranarray(block) for block in blocks]

    def error(this: gtsam.CustomFactor, values: gtsam.Values, jacobians: list[Array] | None) -> Array:
        if jacobians is not None:
            for k, block in enumerate(fixed):
                jacobians[k] = block
        return np.asarray(sum(block @ values.atVector(key) for key, block in zip(keys, fixed, strict=True)))

    return gtsam.CustomFactor(gtsam.noiseModel.Unit.Create(fixed[0].shape[0]), list(keys), error)

"""A-priori knowledge: of shared unknowns (zero mean) and of ground points. Yoon & Shan 2005, Eq. 4.

Plain ones are GTSAM's own prior factors; what is decided here is their noise.
"""

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


def ground_prior(key: int, place: Array, root: Array) -> gtsam.NonlinearFactor:
    """Prior on a ground point: place (3,) in m, and upper triangular square root (3, 3) of its information, 1/m."""
    return gtsam.PriorFactorPoint3(key, place, gtsam.noiseModel.Gaussian.SqrtInformation(root))


def shifted_ground_prior(key: int, shift_key: int, place: Array, root: Array, directions: Array) -> gtsam.CustomFactor:
    """Prior on a footprint whose a-priori place moves with its profile: residual U (P - P0 - D' s).

    `directions` (2, 3) are the unit vectors, body-fixed, along which the two shift unknowns (m) move it.
    """

    def error(this: gtsam.CustomFactor, values: gtsam.Values, jacobians: list[Array] | None) -> Array:
        if jacobians is not None:
            jacobians[0] = np.asfortranarray(root)
            jacobians[1] = np.asfortranarray(-root @ directions.T)
        offset = values.atPoint3(key) - place - values.atVector(shift_key) @ directions
        return np.asarray(root @ offset)

    return gtsam.CustomFactor(gtsam.noiseModel.Unit.Create(3), [key, shift_key], error)

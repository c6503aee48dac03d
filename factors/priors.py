"""A-priori knowledge: of orientation coefficients (zero mean) and of ground points. Yoon & Shan 2005, Eq. 4.

Both are GTSAM's own prior factors; what is decided here is their noise.
"""

import gtsam
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def orientation_prior(key: int, sigmas: Array) -> gtsam.NonlinearFactor:
    """Zero-mean prior on one image's coefficients; sigmas (d,) in m and rad, infinite where nothing is known."""
    precisions = np.where(np.isinf(sigmas), 0.0, 1.0 / sigmas**2)
    return gtsam.PriorFactorVector(key, np.zeros(sigmas.size), gtsam.noiseModel.Diagonal.Precisions(precisions))


def ground_prior(key: int, place: Array, root: Array) -> gtsam.NonlinearFactor:
    """Prior on a ground point: place (3,) in m, and upper triangular square root (3, 3) of its information, 1/m."""
    return gtsam.PriorFactorPoint3(key, place, gtsam.noiseModel.Gaussian.SqrtInformation(root))

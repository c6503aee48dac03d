"""Robust losses on the norm of an image's row pair and on each range: rho(s) and its weight rho'(s) for s = |r|^2.

Cost contribution and weight as GTSAM's mEstimators define them; k is the width in sigmas. The rows of a robust
adjustment are those of the plain one times the root of the weight.
"""

import numpy as np

from mgsgraph.compiled import equation

HUBER_WIDTH = 1.345
"""Sigmas, at which Huber's loss is 95% efficient under normal errors (Holland & Welsch 1977)."""


@equation
def huber(square, k):
    """|r|^2 / 2 up to the width, then k (|r| - k / 2)."""
    norm = np.sqrt(square)
    inner = np.minimum(norm, k)
    return inner * (norm - 0.5 * inner), inner / np.maximum(norm, 1e-300)


@equation
def cauchy(square, k):
    """k^2 / 2 log(1 + |r|^2 / k^2)."""
    ratio = square / (k * k)
    return 0.5 * k * k * np.log1p(ratio), 1.0 / (1.0 + ratio)


@equation
def tukey(square, k):
    """k^2 / 6 (1 - (1 - |r|^2 / k^2)^3), constant beyond the width."""
    rest = np.maximum(1.0 - square / (k * k), 0.0)
    return k * k / 6.0 * (1.0 - rest * rest * rest), rest * rest

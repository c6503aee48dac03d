"""Means and root mean squares of what is finite."""

import numpy as np

from mgsgraph.geometry.records import Array
from mgsgraph.text import root_mean_square


def rms(values: Array) -> float:
    """Root mean square of what is finite; NaN when nothing is."""
    return root_mean_square(values[np.isfinite(values)])


def mean(values: Array) -> float:
    """Mean of what is finite; NaN when nothing is."""
    sound = values[np.isfinite(values)]
    return float(sound.mean()) if sound.size else float("nan")

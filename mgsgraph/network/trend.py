"""What a whole pass's corrections have in common: a constant part (bias) and one that is linear in time (drift)."""

import numpy as np

from mgsgraph.geometry.records import Array, Index
from mgsgraph.record import Record


class BiasAndDrift(Record):
    """The trend of a prior that has sigmas of a bias and of a drift, as unknowns: those with a sigma above zero."""

    __slots__ = ()
    bias: Array
    """(6,) m and rad, sigma of the constant part; 0 where there is none."""
    drift: Array
    """(6,) m and rad, sigma of the linear part, at the ends of the pass; 0 where there is none."""

    @property
    def trend_sigmas(self) -> Array:
        """(w,) of the trend's unknowns: the components with a bias, then those with a drift."""
        return np.concatenate([self.bias[self.bias > 0.0], self.drift[self.drift > 0.0]])

    @property
    def trend_components(self) -> Index:
        """(w,) component of each of them."""
        return np.concatenate([np.flatnonzero(self.bias > 0.0), np.flatnonzero(self.drift > 0.0)])

    @property
    def trend_names(self) -> tuple[str, ...]:
        """What each of them is: a bias or a drift."""
        return ("bias",) * int(np.count_nonzero(self.bias)) + ("drift",) * int(np.count_nonzero(self.drift))

    def trend(self, s: Array) -> Array:
        """(n, 6, w) what the trend's unknowns do to nodes at s (n,) in [-1, 1]."""
        result = np.zeros((s.size, 6, self.trend_sigmas.size))
        column = np.arange(self.trend_sigmas.size)
        biases = int(np.count_nonzero(self.bias))
        result[:, self.trend_components, column] = np.where(column < biases, 1.0, s[:, None])
        return result

    def scaled_trend(self, factors: Array) -> tuple[Array, Array]:
        """(6,) sigmas of the bias, and (6,) of the drift, those of the trend's unknowns times factors (w,)."""
        of_bias, of_drift = np.ones(6), np.ones(6)
        biases = int(np.count_nonzero(self.bias))
        of_bias[self.bias > 0.0], of_drift[self.drift > 0.0] = factors[:biases], factors[biases:]
        return self.bias * of_bias, self.drift * of_drift

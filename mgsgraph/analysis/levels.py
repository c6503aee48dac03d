"""Baarda's levels: how large a test must be to count, and how large a blunder must be to be found.

One error, the non-centrality at which a test of one dimension with size alpha has the stated power, is kept for tests
of every dimension (the B-method): their sizes and critical values follow, so that the same blunder is found with the
same power by all of them (Baarda 1968, A testing procedure for use in geodetic networks; Teunissen 2006, Testing
theory).
"""

import math
from dataclasses import dataclass

from mgsgraph.errors import InputError


@dataclass(frozen=True, slots=True)
class Levels:
    """Sizes of the tests."""

    alpha: float = 0.001
    """Share of good measures whose test exceeds the critical value, two-sided."""
    power: float = 0.80
    """Share of blunders of one minimal detectable blunder that are found."""
    scaled: bool = False
    """Whether tests are divided by the a-posteriori sigma0, and held against Pope's tau; else sigma0 is 1, as the
    a-priori sigmas imply."""

    def __post_init__(self) -> None:
        for name, value, low, high in (("alpha", self.alpha, 0.0, 0.5), ("power", self.power, self.alpha, 1.0)):
            if not (math.isfinite(value) and low < value < high):
                raise InputError(f"levels, {name}", f"{value}", f"a number between {low:g} and {high:g}")

    @property
    def critical(self) -> float:
        """Modulus that the test of a single good measure exceeds with probability alpha."""
        from scipy.special import ndtri  # slow to import

        return float(-ndtri(0.5 * self.alpha))

    @property
    def shift(self) -> float:
        """delta0: by how many of its sigmas a blunder of one minimal detectable blunder shifts the test."""
        from scipy.special import ndtri

        return self.critical + float(ndtri(self.power))

    def critical_tau(self, degrees_of_freedom: float) -> float:
        """The same as `critical` for tests divided by the a-posteriori sigma0 (Pope 1976), one among whose degrees of
        freedom they are.
        """
        from scipy.special import stdtrit

        if degrees_of_freedom <= 1.0:
            return math.inf
        t = -float(stdtrit(degrees_of_freedom - 1.0, 0.5 * self.alpha))
        return t * math.sqrt(degrees_of_freedom / (degrees_of_freedom - 1.0 + t * t))

    def critical_squares(self, dimensions: int) -> float:
        """Critical value of a test of several dimensions, distributed as chi-square; `critical` squared for one."""
        from scipy.stats import ncx2

        if dimensions == 1:
            return self.critical**2
        return float(ncx2.ppf(1.0 - self.power, dimensions, self.shift**2))

    def alpha_of(self, dimensions: int) -> float:
        """Size of a test of several dimensions; of the global test, with the degrees of freedom."""
        from scipy.stats import chi2

        return self.alpha if dimensions == 1 else float(chi2.sf(self.critical_squares(dimensions), dimensions))

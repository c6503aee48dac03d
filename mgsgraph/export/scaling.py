"""Whether an export's covariances are for sigma0 = 1, as everywhere here, or scaled to the fit, as jigsaw's."""

import math

from mgsgraph.adjustment.solution import Solution
from mgsgraph.errors import InputError


def covariance_factor(solution: Solution, scaled: bool) -> float:
    """sigma0^2 when `scaled`, else 1; InputError where there is no sigma0."""
    if not scaled:
        return 1.0
    if not math.isfinite(solution.sigma0):
        found = f"{solution.fit.degrees_of_freedom} degrees of freedom"
        raise InputError(f"solution {solution.name!r}, sigma0", found, "more than none, to scale by it", "don't scale")
    return solution.sigma0**2

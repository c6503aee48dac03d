"""Choices of matching, and their defaults."""

from dataclasses import dataclass

import numpy as np

from mgsgraph.errors import require
from mgsgraph.record import Record


@dataclass(frozen=True, slots=True)
class MatchSettings(Record):
    """How images are matched.

    Examples
    --------
    >>> settings = mgsgraph.MatchSettings(cells=20, per_cell=4)
    >>> settings.cells * settings.per_cell
    80
    """

    step: float | None = None
    """m between pixels of the ground grid; as the coarsest picture's pixels when None."""
    search: float | None = None
    """m on the ground within which the nominal orientations may contradict each other; three a-priori sigmas when
    None."""
    cells: int = 250
    """Cells into which the ground that two images share is divided, about."""
    per_cell: int = 2
    """Matches that are kept in each cell for each pair, the most precise first."""
    half_window: int = 10
    """pixels of the ground grid from the middle of a window of least-squares matching to its edge."""
    ratio: float = 0.85
    """Most that the difference to the best feature may be of the difference to the second best."""
    least_correlation: float = 0.6
    """Of the two windows after least-squares matching."""
    largest_sigma: float = 0.5
    """pixels, in any direction."""
    features: int = 6000
    """Features that are looked at on each tile of each picture, at most."""
    seed: int = 0
    """Of the trials of RANSAC."""

    def __post_init__(self) -> None:
        for name in ("step", "search", "largest_sigma"):
            value = getattr(self, name)
            require(value is None or 0.0 < value < np.inf, f"matching, {name}", f"{value}", "a positive number")
        for name, least in (("cells", 1), ("per_cell", 1), ("half_window", 4), ("features", 10), ("seed", 0)):
            require(getattr(self, name) >= least, f"matching, {name}", f"{getattr(self, name)}", f"at least {least}")
        for name in ("ratio", "least_correlation"):
            value = getattr(self, name)
            require(0.0 < value < 1.0, f"matching, {name}", f"{value}", "a number between 0 and 1")

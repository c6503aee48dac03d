"""Choices of matching, and their defaults."""

from dataclasses import dataclass
from typing import Literal, cast, get_args

import numpy as np

from mgsgraph.errors import InputError, require
from mgsgraph.record import Record

Method = Literal["sift", "grid"]
"""Where matches are sought: at features, or at the nodes of a regular grid by correlation."""


def method_of(name: str) -> Method:
    """The method of this name."""
    require(name in get_args(Method), "matching, method", repr(name), " or ".join(get_args(Method)))
    return cast(Method, name)


@dataclass(frozen=True, slots=True)
class MatchSettings(Record):
    """How images are matched.

    Examples
    --------
    >>> settings = mgsgraph.MatchSettings(cells=20, per_cell=4)
    >>> settings.method, settings.cells * settings.per_cell
    ('sift', 80)
    """

    method: Method = "sift"
    """At features, or at the nodes of a regular grid."""
    step: float | None = None
    """m between pixels of the ground grid; as the coarsest picture's pixels when None."""
    spacing: float | None = None
    """m between nodes of the regular grid; a window's width when None."""
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
        method_of(self.method)
        for name in ("step", "spacing", "search", "largest_sigma"):
            value = getattr(self, name)
            require(value is None or 0.0 < value < np.inf, f"matching, {name}", f"{value}", "a positive number")
        for name, least in (("cells", 1), ("per_cell", 1), ("half_window", 4), ("features", 10), ("seed", 0)):
            require(getattr(self, name) >= least, f"matching, {name}", f"{getattr(self, name)}", f"at least {least}")
        if self.spacing is not None and self.step is not None and self.spacing < self.step:
            found = f"{self.spacing:g} m between nodes on a grid of {self.step:g} m"
            raise InputError("matching, spacing", found, "at least a pixel of the ground grid")
        for name in ("ratio", "least_correlation"):
            value = getattr(self, name)
            require(0.0 < value < 1.0, f"matching, {name}", f"{value}", "a number between 0 and 1")

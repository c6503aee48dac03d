"""The simulated Gusev pair without pictures, and dense matches as they would come out of them over the true ground."""

from functools import cache
from typing import Any

import dem_site
import numpy as np
import pytest
from once import once

from mgsgraph.matching.dense import DenseMatches
from mgsgraph.registration import relief_surfaces
from mgsgraph.simulation.matches import true_matches

NOISE = 0.1
"""pixels, of a match."""
STEP = 14.0
"""pixels between matches."""
WINDOW = 42.0
"""m, width of a matching window."""


@once
def matches() -> DenseMatches:
    """Of the first image with the second, both as they were taken."""
    site = dem_site.site()
    first, second = (image.true for image in site.images)
    return true_matches(site.terrain, first, second, STEP, NOISE, np.random.default_rng(7))


def use_matches(monkeypatch: pytest.MonkeyPatch) -> None:
    """Take these in place of matching."""

    def densely_matched(*_: Any) -> tuple[tuple[DenseMatches, ...], float]:
        return (matches(),), WINDOW

    monkeypatch.setattr(relief_surfaces, "densely_matched", densely_matched)


@cache
def case_text() -> str:
    """Of the case, whose files are beside `dem_site.case_path()`."""
    return dem_site.case_path().read_text(encoding="utf-8")

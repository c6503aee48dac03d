"""The simulated Gusev pair without pictures, and dense matches as they would come out of them over the true ground."""

from functools import cache
from pathlib import Path
from typing import Any

import dem_site
import numpy as np
import pytest
from once import once
from true_matches import true_matches

from mgsgraph.adjustment.adjust import adjust_network
from mgsgraph.adjustment.solution import Solution
from mgsgraph.case.reading import read_case
from mgsgraph.matching.dense import DenseMatches
from mgsgraph.registration import relief_surfaces
from mgsgraph.registration.minima import ReliefRegistration, ReliefSettings
from mgsgraph.registration.relief import register_by_relief
from mgsgraph.results.archive import write_archive

NOISE = 0.1
"""pixels, of a match."""
STEP = 14.0
"""pixels between matches."""
WINDOW = 42.0
"""m, width of a matching window."""
SETTINGS = ReliefSettings(reach=400.0)


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
def case_path() -> Path:
    """The case without its terrain model, on which tie points lie; for reading only."""
    text = dem_site.case_path().read_text(encoding="utf-8")
    path = dem_site.case_path().with_name("relief.toml")
    path.write_text(text[: text.index("[terrain]")], encoding="utf-8")
    return path


@once
def solution() -> Solution:
    """Adjusted, without stereo rows."""
    case = read_case(case_path())
    return adjust_network(case.network, case.settings, case.name)


@cache
def result() -> Path:
    """Its archive."""
    path = case_path().with_name("relief.npz")
    write_archive(solution(), path)
    return path


@once
def registration() -> ReliefRegistration:
    """Of both profiles with the stereo surface."""
    with pytest.MonkeyPatch.context() as patch:
        use_matches(patch)
        return register_by_relief(read_case(case_path()), SETTINGS, before=solution())

"""The simulated Gusev pair without pictures, and dense matches as they would come out of them over the true ground."""

from functools import cache
from pathlib import Path
from typing import Any

import dem_site
import numpy as np
import pytest
from numpy.typing import NDArray
from once import once

from mgsgraph.adjustment.adjust import adjust_network
from mgsgraph.adjustment.solution import Solution
from mgsgraph.case.reading import read_case
from mgsgraph.matching.dense import DenseMatches
from mgsgraph.registration import relief
from mgsgraph.reports.archive import write_archive

Array = NDArray[np.float64]

NOISE = 0.1
"""pixels, of a match."""
STEP = 14.0
"""pixels between matches."""
WINDOW = 42.0
"""m, width of a matching window."""


@once
def matches() -> DenseMatches:
    """Of the first image with the second, both as they were taken."""
    first, second = (image.true for image in dem_site.site().images)
    lines, samples = np.meshgrid(
        np.arange(12.0, first.lines, STEP), np.arange(12.0, first.samples, STEP), indexing="ij"
    )
    anchors = np.column_stack([lines.ravel(), samples.ravel()]) + 0.5
    points = dem_site.site().terrain.intersect(*first.sightlines(*anchors.T))
    pixels: Array = second.ground_to_image(points)[0]
    seen = np.all((pixels > 0.5) & (pixels < np.array([second.lines, second.samples]) - 0.5), axis=1)
    count = int(seen.sum())
    noise = np.random.default_rng(7).normal(0.0, NOISE, (count, 2))
    covariances = np.broadcast_to(NOISE**2 * np.eye(2), (count, 2, 2))
    return DenseMatches(
        0, 1, WINDOW, anchors.shape[0], anchors[seen], pixels[seen] + noise, covariances, np.full(count, 0.9)
    )


def use_matches(monkeypatch: pytest.MonkeyPatch) -> None:
    """Take these in place of matching."""

    def densely_matched(*_: Any) -> tuple[tuple[DenseMatches, ...], float]:
        return (matches(),), WINDOW

    monkeypatch.setattr(relief, "densely_matched", densely_matched)


@cache
def case_path() -> Path:
    """The case without its terrain model, on whose patches tie points move for many passes; for reading only."""
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

"""Files of laser shots searched for those over images: by dates, quality and angle off nadir."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from mgsgraph.errors import InputError
from mgsgraph.files.altimetry.shots import read_shots
from mgsgraph.geometry.altimetry import AltimeterShots, joined_shots, require_on_body
from mgsgraph.geometry.records import Mask
from mgsgraph.geometry.time_scales import tdb_of_utc
from mgsgraph.project.oriented import OrientedImages
from mgsgraph.registration.crossings import ShotsOverImages, shots_over_images
from mgsgraph.units import DEG

_DAY = 86400.0 - 1e-3
"""s to the last millisecond of a day."""
_DATE = len("2010-05-10")


@dataclass(frozen=True, slots=True)
class ShotChoice:
    """Which shots may be chosen, apart from where they fall."""

    dates: tuple[str, str] | None = None
    """UTC, both included: days, or times."""
    ground: bool = True
    """Returns from the ground alone."""
    off_nadir: float | None = None
    """deg, at the most."""
    margin: float = 0.0
    """pixels by which they may lie beside an image."""
    along: bool = False
    """Those alone that were fired while an image was taken in which they fall."""
    version: str | None = None
    """Letter of PEDR products whose names don't say it."""

    def of(self, shots: AltimeterShots) -> Mask:
        """(n,) True for shots that may be chosen."""
        found = shots.ground.copy() if self.ground else np.ones(shots.times.size, dtype=bool)
        if self.off_nadir is not None:
            found &= shots.off_nadir <= self.off_nadir * DEG
        if self.dates is not None:
            first, last = _interval(self.dates)
            found &= (shots.times >= first) & (shots.times <= last)
        return found


def _interval(dates: tuple[str, str]) -> tuple[float, float]:
    """S TDB past J2000 from the beginning of the first to the end of the last."""
    texts = [text.strip() + "T00:00:00"[len(text.strip()) - _DATE :] for text in dates]
    first, last = tdb_of_utc(texts, "dates").tolist()
    last += _DAY if len(dates[1].strip()) == _DATE else 0.0
    if first > last:
        raise InputError("dates", f"{dates[0]} after {dates[1]}", "FROM before TO")
    return first, last


def search_shots(files: Sequence[Path], seen: OrientedImages, choice: ShotChoice) -> ShotsOverImages:
    """Shots of all files over images.

    Raises
    ------
    InputError
        What `read_shots` refuses; files of several altimeters; shots on another body than the images'.
    """
    parts = [read_shots(path, version=choice.version) for path in files]
    for part in parts:
        require_on_body(part.footprints, seen.images[0].body, part.source)
    shots = joined_shots(parts)
    over = shots_over_images(seen.images, shots.chosen(choice.of(shots)), seen.corrections, choice.margin)
    return replace(over, inside=over.inside & (over.seconds == 0.0)) if choice.along else over

"""Laser altimetry: shots with their ranges, footprints and, where there are any, measures in images."""

from dataclasses import dataclass

import numpy as np

from mgsgraph.errors import InputError
from mgsgraph.geometry.records import Array, Index, assign, frozen, frozen_index, require_covariances, require_unique


@dataclass(frozen=True, slots=True, eq=False)
class LaserProfile:
    """Laser shots, struct of arrays; the footprints' covariances are a-priori knowledge of the ground points."""

    source: str
    """File they come from, for messages."""
    ids: tuple[str, ...]
    """(n) names, each once."""
    times: Array
    """(n,) s TDB past J2000, time of the shot."""
    ranges: Array
    """(n,) m, one-way, from the instrument to the footprint."""
    range_sigmas: Array
    """(n,) m, positive."""
    footprints: Array
    """(n, 3) m, body-fixed."""
    covariances: Array
    """(n, 3, 3) m^2, body-fixed, positive definite."""
    simultaneous: tuple[tuple[str, ...], ...]
    """(n) names of the images taken from the same place at the same time (their orientation carries the range)."""
    measure_shot: Index
    """(k,) index of the shot measured."""
    measure_image: tuple[str, ...]
    """(k) name of the image."""
    measures: Array
    """(k, 2) line, sample, first pixel's centre at (0.5, 0.5)."""

    def __post_init__(self) -> None:
        n, k = len(self.ids), len(self.measure_image)
        require_unique(self.ids, self.source)
        ranges = frozen(self.ranges, f"{self.source}, ranges", (n,))
        sigmas = frozen(self.range_sigmas, f"{self.source}, range sigmas", (n,))
        for what, values in (("range", ranges), ("range sigma", sigmas)):
            for i in np.flatnonzero(values <= 0.0)[:1]:
                raise InputError(f"{self.source}, shot {self.ids[i]}", f"{what} {values[i]} m", "a positive number")
        covariances = frozen(self.covariances, f"{self.source}, covariances", (n, 3, 3))
        require_covariances(covariances, np.ones(n, dtype=bool), self.ids, self.source)
        assign(
            self,
            times=frozen(self.times, f"{self.source}, times", (n,)),
            ranges=ranges,
            range_sigmas=sigmas,
            footprints=frozen(self.footprints, f"{self.source}, footprints", (n, 3)),
            covariances=covariances,
            measure_shot=frozen_index(self.measure_shot, f"{self.source}, measures", k, n),
            measures=frozen(self.measures, f"{self.source}, measures", (k, 2)),
        )

    def __repr__(self) -> str:
        return f"LaserProfile({len(self.ids)} shots, {len(self.measure_image)} image measures, from {self.source})"

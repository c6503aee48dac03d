"""Tie points and ground control points as a control network holds them, image places already in our pixels."""

from dataclasses import dataclass, replace
from enum import IntEnum

import numpy as np

from mgsgraph.errors import InputError
from mgsgraph.geometry.records import (
    Array,
    Index,
    Mask,
    assign,
    chosen_rows,
    frozen,
    frozen_index,
    of_kind,
    require_covariances,
    require_names,
)
from mgsgraph.names import Names, RepeatedNames
from mgsgraph.record import Record


class PointKind(IntEnum):
    """How a ground point enters the adjustment; the names are those of ISIS control networks."""

    FREE = 0
    """Unknown; an a-priori place is only a first guess."""
    CONSTRAINED = 1
    """Unknown, with an a-priori place and covariance that enter as an observation."""
    FIXED = 2
    """Known; it has no unknowns of its own."""


@dataclass(frozen=True, slots=True, eq=False)
class TiePoints(Record):
    """Ground points and their measures in images, struct of arrays.

    Examples
    --------
    >>> ties = case.ties
    >>> print(ties)
    TiePoints(20 points (20 free), 40 measures, from pair/network.pvl)
    >>> len(ties.chosen(np.arange(5)).ids)
    5
    """

    source: str
    """File they come from, for messages."""
    ids: Names
    """(n) names, each once; made of any sequence of them."""
    kinds: Index
    """(n,) PointKind."""
    places: Array
    """(n, 3) m, body-fixed, a-priori place; NaN where there is none."""
    covariances: Array
    """(n, 3, 3) m^2, body-fixed, of the a-priori places of constrained points; zero elsewhere."""
    measure_point: Index
    """(k,) index of the point measured."""
    measure_image: RepeatedNames
    """(k) name of the image it was measured in; made of any sequence of them."""
    measures: Array
    """(k, 2) line, sample, first pixel's centre at (0.5, 0.5)."""
    measure_sigmas: Array
    """(k, 2) pixels, line and sample; NaN where the file does not say."""

    def __post_init__(self) -> None:
        assign(self, ids=Names.of(self.ids, self.source), measure_image=RepeatedNames.of(self.measure_image))
        n, k = len(self.ids), len(self.measure_image)
        require_names(self.ids, self.source)
        kinds = frozen_index(self.kinds, f"{self.source}, kinds", n, len(PointKind))
        places, sigmas = (of_kind(given, np.float64) for given in (self.places, self.measure_sigmas))
        if places.shape != (n, 3) or sigmas.shape != (k, 2):
            raise InputError(self.source, f"places {places.shape}, sigmas {sigmas.shape}", f"({n}, 3) and ({k}, 2)")
        for i in np.flatnonzero((kinds != PointKind.FREE) & ~np.all(np.isfinite(places), axis=1))[:1]:
            raise InputError(
                f"{self.source}, point {self.ids[i]}", f"{PointKind(kinds[i]).name.lower()} without an a-priori place",
                "X, Y, Z or latitude, longitude, radius",
            )
        covariances = frozen(self.covariances, f"{self.source}, covariances", (n, 3, 3))
        require_covariances(covariances, kinds == PointKind.CONSTRAINED, self.ids, self.source)
        for j in np.flatnonzero(np.any(sigmas <= 0.0, axis=1))[:1]:
            where = f"{self.source}, point {self.ids[int(self.measure_point[j])]}, image {self.measure_image[j]}"
            raise InputError(where, f"measure sigma {sigmas[j].min()} px", "a positive sigma")
        places.flags.writeable = sigmas.flags.writeable = False
        assign(
            self,
            kinds=kinds,
            places=places,
            covariances=covariances,
            measure_point=frozen_index(self.measure_point, f"{self.source}, measures", k, n),
            measures=frozen(self.measures, f"{self.source}, measures", (k, 2)),
            measure_sigmas=sigmas,
        )
        self._require_one_measure_per_image()

    def _require_one_measure_per_image(self) -> None:
        code = self.measure_point * len(self.measure_image.distinct) + self.measure_image.numbers
        order = np.argsort(code, kind="stable")
        code = code[order]
        for k in np.sort(order[1:][code[1:] == code[:-1]])[:1].tolist():
            raise InputError(
                f"{self.source}, point {self.ids[int(self.measure_point[k])]}",
                f"two measures in image {self.measure_image[k]}", "one per image", "remove the worse one",
            )

    def chosen(self, which: Index) -> "TiePoints":
        """Some of the points, by their numbers, with their measures in the order in which they were."""
        new = np.full(len(self.ids), -1, dtype=np.int64)
        new[which] = np.arange(which.size)
        left = self.with_measures(new[self.measure_point] >= 0)
        return replace(
            left,
            ids=self.ids[which],
            kinds=self.kinds[which],
            places=self.places[which],
            covariances=chosen_rows(self.covariances, which),
            measure_point=new[left.measure_point],
        )

    def with_measures(self, which: Mask) -> "TiePoints":
        """All of the points, with some of their measures (k,)."""
        return replace(
            self,
            measure_point=self.measure_point[which],
            measure_image=self.measure_image[which],
            measures=self.measures[which],
            measure_sigmas=self.measure_sigmas[which],
        )

    def __repr__(self) -> str:
        kinds = np.bincount(self.kinds, minlength=len(PointKind))
        names = ", ".join(f"{kinds[kind]} {kind.name.lower()}" for kind in PointKind if kinds[kind])
        return f"TiePoints({len(self.ids)} points ({names}), {len(self.measure_image)} measures, from {self.source})"

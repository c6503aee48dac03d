"""Tie points and ground control points of a control network, in our pixels; conversion between it and TiePoints.

Pixels counted from 1 end and begin here.
"""

import math
from dataclasses import dataclass, replace
from enum import IntEnum

import numpy as np
from msgspec import structs

from mgsgraph.errors import InputError
from mgsgraph.files.networks.record import ControlMeasure, ControlNetwork, ControlPoint, MeasureType, PointType, Where
from mgsgraph.geometry.altimetry import require_lengths
from mgsgraph.geometry.body import Ellipsoid, distances, is_another, nearness, require_near, surface_radii, target_name
from mgsgraph.geometry.records import (
    Array,
    Index,
    Mask,
    assign,
    chosen_rows,
    finite_rows,
    frozen,
    frozen_index,
    of_kind,
    place_of,
    repeated,
    require_covariances,
    require_names,
)
from mgsgraph.names import Names, RepeatedNames
from mgsgraph.record import Record
from mgsgraph.units import ISIS_OFFSET


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
        for i in np.flatnonzero((kinds != PointKind.FREE) & ~finite_rows(places))[:1]:
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
        new = place_of(which, len(self.ids))
        left = self.with_measures(new[self.measure_point] >= 0)
        return replace(
            left,
            ids=self.ids[which],
            kinds=self.kinds[which],
            places=self.places[which],
            covariances=chosen_rows(self.covariances, which),
            measure_point=new[left.measure_point],
        )

    def with_measures(self, which: Mask | Index) -> "TiePoints":
        """All of the points, with some of their measures (k,), or these in another order."""
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


_KIND_OF_TYPE = np.array([PointKind.FREE] * 3 + [PointKind.CONSTRAINED, PointKind.FIXED])
"""PointKind by a type's number in ISIS."""
_TYPE_OF_KIND = np.array([PointType.FREE, PointType.CONSTRAINED, PointType.FIXED])
_FULL = [0, 1, 2, 1, 3, 4, 2, 4, 5]
"""Elements of a symmetric matrix, of those in its upper triangle."""
FARTHEST = 1e12
"""m from a body's centre: no point on it."""
_TINY, _UNLIKE = 1e-8, 1e6
"""m^2, of a variance that no measurement has, and times by which another one beside it is larger."""
_UNKNOWN = (math.nan, math.nan, math.nan)


@dataclass(frozen=True, slots=True, eq=False)
class PointArrays:
    """Points and measures of a network as its file has them, in columns; ignored ones, too."""

    head: ControlNetwork
    """The network without its points; its source is the file."""
    ids: Names
    """(n)"""
    types: Index
    """(n,) PointType."""
    ignored: Mask
    """(n,)"""
    places: Array
    """(n, 3) m, body-fixed, NaN where none is said."""
    covariances: Array
    """(n, 6) m^2 of the places: xx, xy, xz, yy, yz, zz; NaN where none are said."""
    first: Index
    """(n + 1,) number of each point's first measure, and of all measures."""
    image: RepeatedNames
    """(k) image of each measure, point by point."""
    measures: Array
    """(k, 4) line and sample, first pixel's centre at (1, 1), and their sigmas, pixels; NaN where none are said."""
    left_out: Mask
    """(k,) measures that are ignored."""

    def tie_points(self, where: Where, body: Ellipsoid | None = None) -> TiePoints:
        """What an adjustment takes from them; see `tie_points`."""
        self._require_usable(where)
        source, used, selected = self.head.source or "network", ~self.ignored, ~self.left_out
        if not np.any(used):
            found = "no control point, or only ignored ones"
            raise InputError(source, found, "an ISIS control network (Object = ControlNetwork)")
        point = np.repeat(np.arange(used.size), np.diff(self.first))
        names, types, places, covariances = self.ids, self.types, self.places, self.covariances
        if not np.all(used):
            selected, point = selected & used[point], (np.cumsum(used) - 1)[point]
            names, types, places, covariances = names[used], types[used], places[used], covariances[used]
        image, measures = self.image, self.measures
        if not np.all(selected):
            point, image, measures = point[selected], image[selected], measures[selected]
        measures, sigmas = measures[:, :2] - ISIS_OFFSET, measures[:, 2:].copy()
        full = repeated(0.0, (types.size, 3, 3))
        if np.any(constrained := types == PointType.CONSTRAINED):
            full = np.where(constrained[:, None], covariances, 0.0)[:, _FULL].reshape(-1, 3, 3)
        kinds = _KIND_OF_TYPE[types]
        for array in (kinds, places, point, measures, sigmas, full):
            array.flags.writeable = False
        try:
            ties = TiePoints(
                source=source, ids=names, kinds=kinds, places=places, covariances=full, measure_point=point,
                measure_image=image, measures=measures, measure_sigmas=sigmas,
            )  # fmt: skip
        except InputError:
            self.require_once(where)
            raise
        if body is not None:
            require_body(self.head, ties, body)
        return ties

    def _require_usable(self, where: Where) -> None:
        """Raise InputError unless an adjustment can take all points and measures that are not ignored."""
        point = np.repeat(np.arange(self.ignored.size), np.diff(self.first))
        places, unknown = self.places, np.isnan(self.places).any(axis=1)
        constrained = self.types == PointType.CONSTRAINED
        variances = self.covariances[:, [0, 3, 5]]
        for bad, key, found, expected, remedy in (
            (np.any(np.abs(places) > FARTHEST, axis=1), "", "a place at {place} m", "one on the body", ""),
            (unknown & (self.types != PointType.FREE), "", "{kind} without an a-priori place",
             "AprioriX, AprioriY, AprioriZ", ""),
            (constrained & np.isnan(variances).any(axis=1), "", "constrained without AprioriCovarianceMatrix",
             "xx, xy, xz, yy, yz, zz in m^2", "add it, or make the point Free or Fixed"),
            (constrained & np.any(variances <= 0.0, axis=1), "AprioriCovarianceMatrix", "variances {variances} m^2",
             "positive variances", ""),
            (constrained & (variances.min(axis=1) < _TINY) & (variances.max(axis=1) > _TINY * _UNLIKE),
             "AprioriCovarianceMatrix", "variances {variances} m^2", "equal sigmas along X, Y, Z",
             "of latitude and longitude in rad^2? they are in m^2 along X, Y, Z"),
        ):  # fmt: skip
            for i in np.flatnonzero(bad & ~self.ignored)[:1].tolist():
                text = found.format(
                    place=tuple(places[i].tolist()), kind=PointType(self.types[i]).name.lower(),
                    variances=", ".join(f"{variance:g}" for variance in variances[i]),
                )  # fmt: skip
                raise InputError(where(i, None, key), text, expected, remedy)
        selected = ~self.left_out & ~self.ignored[point]
        for column, key in enumerate(("Line", "Sample", "LineSigma", "SampleSigma")):
            values = self.measures[:, column]
            for k in np.flatnonzero(selected & (np.isnan(values) if column < 2 else values <= 0.0))[:1].tolist():
                i, measure = int(point[k]), int(k - self.first[point[k]])
                if column < 2:
                    raise InputError(where(i, measure, ""), f"no {key}", f"{key} of the measure")
                raise InputError(where(i, measure, key), f"{values[k]:g} px", "a positive sigma")

    def require_once(self, where: Where) -> None:
        """Raise InputError for an image twice in a point."""
        point = np.repeat(np.arange(self.ignored.size), np.diff(self.first))
        rows = np.flatnonzero(~self.left_out & ~self.ignored[point])
        code = (point * len(self.image.distinct) + self.image.numbers)[rows]
        order = np.argsort(code, kind="stable")
        for k in np.sort(rows[order[1:][np.diff(code[order]) == 0]])[:1].tolist():
            place = where(int(point[k]), int(k - self.first[point[k]]), "")
            raise InputError(place, "a second measure in this image", "one per point", "remove the worse one")

    def network(self, measure_types: Index, references: Index) -> ControlNetwork:
        """The network: types of its measures (k,), and number of each point's reference (n,) among its measures, -1 for
        none.
        """
        rows = zip(self.image, measure_types.tolist(), self.measures.tolist(), self.left_out.tolist(), strict=True)
        measures = [
            ControlMeasure(
                serial_number=image, type=MeasureType(kind), line=line, sample=sample,
                line_sigma=None if math.isnan(line_sigma) else line_sigma,
                sample_sigma=None if math.isnan(sample_sigma) else sample_sigma, ignore=left_out,
            )
            for image, kind, (line, sample, line_sigma, sample_sigma), left_out in rows
        ]  # fmt: skip
        columns = (self.types, self.ignored, references, self.places, self.covariances, self.first[:-1], self.first[1:])
        points = tuple(
            ControlPoint(
                id=name, type=PointType(kind), measures=tuple(measures[begin:end]), ignore=ignored,
                reference=None if reference < 0 else reference, apriori=None if math.isnan(x) else (x, y, z),
                apriori_covariance=() if math.isnan(upper[0]) else tuple(upper),
            )
            for name, kind, ignored, reference, (x, y, z), upper, begin, end in zip(
                self.ids, *(column.tolist() for column in columns), strict=True
            )
        )  # fmt: skip
        return structs.replace(self.head, points=points)


def tie_points(network: ControlNetwork, where: Where | None = None, body: Ellipsoid | None = None) -> TiePoints:
    """What an adjustment takes from a network.

    What ``jigsaw`` does is done here: points and measures with ``Ignore = True`` are left out; ``JigsawRejected`` ones
    are kept, since it is the verdict of an earlier adjustment, which jigsaw forgets before it starts
    (BundleAdjust::init, ControlNet::ClearJigsawRejected); measures of every MeasureType count, Candidate too. The place
    of a free point is its a-priori place or else its adjusted one, a mere first guess. The covariance is the a-priori
    one (xx, xy, xz, yy, yz, zz in m^2).

    Parameters
    ----------
    network : ControlNetwork
        As read.
    where : Where
        Words for where something stands, for messages; those of the network by default.
    body : Ellipsoid, optional
        That of the images.

    Returns
    -------
    TiePoints
        In the network's order; images are called by their serial numbers; measure sigmas are NaN where there are none.

    Raises
    ------
    InputError
        With file and point: a point that is not free without a-priori position, a constrained one without covariance or
        with one that is not positive; a measure without line or sample, or with a sigma that is not positive; an image
        twice in a point; no point that is not ignored; a network of another body, by its name, its radii or where its
        points lie.
    """
    return arrays_of(network).tie_points(where or network.where, body)


def arrays_of(network: ControlNetwork) -> PointArrays:
    """The points and measures of a network in columns."""
    points = network.points
    measures = [measure for point in points for measure in point.measures]
    rows = [(m.line, m.sample, m.line_sigma, m.sample_sigma) for m in measures]
    return PointArrays(
        head=structs.replace(network, points=()), ids=Names.of([point.id for point in points]),
        types=np.array([point.type for point in points], dtype=np.int64),
        ignored=np.array([point.ignore for point in points], dtype=bool),
        places=np.array([_place(point) for point in points]).reshape(-1, 3),
        covariances=np.array([point.apriori_covariance or _UNKNOWN * 2 for point in points]).reshape(-1, 6),
        first=np.cumsum([0, *(len(point.measures) for point in points)]),
        image=RepeatedNames.of([measure.serial_number for measure in measures]),
        measures=np.array(rows, dtype=np.float64).reshape(-1, 4),
        left_out=np.array([measure.ignore for measure in measures], dtype=bool),
    )  # fmt: skip


def require_body(network: ControlNetwork, ties: TiePoints, body: Ellipsoid) -> None:
    """Raise InputError for a network of another body than the images'. Of points that are free any may lie anywhere,
    for their places are first guesses, but not most of them.
    """
    where, remedy = network.source or "network", "name a network of this body"
    if is_another(body, network.target_name):
        found = f"the target body {network.target_name}"
        raise InputError(f"{where}, TargetName", found, f"{target_name(body)}, as the images'", remedy)
    near = nearness(body)
    for radius, own in zip(network.target_radii[::2], (body.equatorial, body.polar), strict=False):
        if not own / near <= radius <= own * near:
            raise InputError(f"{where}, TargetRadii", f"{radius:.7g} m", f"{own:.7g} m, as the images'", remedy)
    require_places(ties.places, body, where)
    radii = np.where(ties.kinds == PointKind.FREE, np.nan, distances(ties.places))
    require_near(radii, body, lambda i: f"{where}, point {ties.ids[i]}")


def require_places(places: Array, body: Ellipsoid, where: str) -> None:
    """Raise InputError where points (n, 3) in m, NaN for unknown ones, are not on a body: by their median radius."""
    radii = distances(places)
    if np.any(finite := np.isfinite(radii)):
        require_lengths(radii[finite], surface_radii(places[finite], body), "radii of points", where, nearness(body))


def control_network(
    ties: TiePoints,
    network_id: str,
    target_name: str,
    description: str = "",
    *,
    created: str = "",
    measure_type: MeasureType = MeasureType.REGISTERED_SUBPIXEL,
) -> ControlNetwork:
    """A network that holds tie points: the first measure of each point is its reference.

    Parameters
    ----------
    ties : TiePoints
        Measures without sigmas have none in the network either; places of free points go in as a-priori ones.
    network_id, target_name, description : str
        For its head.
    created : str
        Date and time in ISO 8601, also of its last modification; left open by default.
    measure_type : MeasureType
        Of all measures.
    """
    order = np.argsort(ties.measure_point, kind="stable")
    first = np.searchsorted(ties.measure_point[order], np.arange(len(ties.ids) + 1))
    places = ties.measures[order] + ISIS_OFFSET
    head = ControlNetwork(
        network_id=network_id, target_name=target_name, points=(), user_name="mgsgraph", created=created,
        last_modified=created, description=description, source=ties.source,
    )  # fmt: skip
    constrained = ties.kinds == PointKind.CONSTRAINED
    arrays = PointArrays(
        head, ties.ids, _TYPE_OF_KIND[ties.kinds], np.zeros(first.size - 1, dtype=bool), ties.places,
        np.where(constrained[:, None], ties.covariances[:, *np.triu_indices(3)], np.nan), first,
        ties.measure_image[order], np.hstack([places, ties.measure_sigmas[order]]), np.zeros(order.size, dtype=bool),
    )  # fmt: skip
    return arrays.network(np.full(order.size, measure_type), np.where(np.diff(first) > 0, 0, -1))


def _place(point: ControlPoint) -> tuple[float, float, float]:
    """A-priori place, m body-fixed; NaN for a free point that has none."""
    if point.apriori is not None or point.type != PointType.FREE:
        return point.apriori or _UNKNOWN
    return point.adjusted or _UNKNOWN

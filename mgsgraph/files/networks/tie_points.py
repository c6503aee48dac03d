"""TiePoints of a control network and a control network of TiePoints: what each means to the other.

Pixels counted from 1 end and begin here.
"""

import math

import numpy as np

from mgsgraph.errors import InputError
from mgsgraph.files.networks.record import ControlMeasure, ControlNetwork, ControlPoint, MeasureType, PointType, Where
from mgsgraph.files.tie_points import PointKind, TiePoints
from mgsgraph.geometry.altimetry import require_lengths
from mgsgraph.geometry.body import Ellipsoid, distances, is_another, nearness, require_near, surface_radii, target_name
from mgsgraph.geometry.records import Array
from mgsgraph.names import Names, RepeatedNames
from mgsgraph.units import ISIS_OFFSET

KINDS = {
    PointType.FREE: PointKind.FREE, PointType.CONSTRAINED: PointKind.CONSTRAINED, PointType.FIXED: PointKind.FIXED,
}  # fmt: skip
"""PointKind of each type of a network's points."""
FARTHEST = 1e12
"""m from a body's centre: no point on it."""
_TYPES = {kind: point_type for point_type, kind in KINDS.items()}
_UNKNOWN = (math.nan, math.nan, math.nan)


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
    where = where or network.where
    used = [index for index, point in enumerate(network.points) if not point.ignore]
    points = [network.points[index] for index in used]
    if not points:
        raise InputError(
            network.source or "network", "no control point, or only ignored ones",
            "an ISIS control network (Object = ControlNetwork)",
        )
    for index in used:
        require_usable(network.points[index], index, where)
    measures = [measure for point in points for measure in point.measures if not measure.ignore]
    counts = [sum(not measure.ignore for measure in point.measures) for point in points]
    nan = math.nan
    ties = TiePoints(
        source=network.source or "network",
        ids=Names.of(point.id for point in points),
        kinds=np.array([KINDS[point.type] for point in points], dtype=np.int64),
        places=np.array([_place(point) for point in points]),
        covariances=np.array([_covariance(point) for point in points]),
        measure_point=np.repeat(np.arange(len(points), dtype=np.int64), counts),
        measure_image=RepeatedNames.of([measure.serial_number for measure in measures]),
        measures=np.array([(m.line, m.sample) for m in measures], dtype=np.float64).reshape(-1, 2) - ISIS_OFFSET,
        measure_sigmas=np.array(
            [(m.line_sigma or nan, m.sample_sigma or nan) for m in measures], dtype=np.float64
        ).reshape(-1, 2),
    )
    if body is not None:
        require_body(network, ties, body)
    return ties


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
    if np.any(known := np.isfinite(radii)):
        require_lengths(radii[known], surface_radii(places[known], body), "radii of points", where, nearness(body))


def control_network(
    ties: TiePoints,
    network_id: str,
    target_name: str,
    description: str = "",
    *,
    user_name: str = "mgsgraph",
    created: str = "",
    measure_type: MeasureType = MeasureType.REGISTERED_SUBPIXEL,
) -> ControlNetwork:
    """A network that holds tie points: the first measure of each point is its reference.

    Parameters
    ----------
    ties : TiePoints
        Measures without sigmas have none in the network either; places of free points go in as a-priori ones.
    network_id, target_name, description, user_name : str
        For its head.
    created : str
        Date and time in ISO 8601, also of its last modification; left open by default.
    measure_type : MeasureType
        Of all measures.
    """
    order = np.argsort(ties.measure_point, kind="stable")
    bounds = np.searchsorted(ties.measure_point[order], np.arange(len(ties.ids) + 1)).tolist()
    places = (ties.measures[order] + ISIS_OFFSET).tolist()
    measures = [
        ControlMeasure(
            serial_number=ties.measure_image[k],
            type=measure_type,
            line=line,
            sample=sample,
            line_sigma=None if math.isnan(line_sigma) else line_sigma,
            sample_sigma=None if math.isnan(sample_sigma) else sample_sigma,
        )
        for k, (line, sample), (line_sigma, sample_sigma) in zip(
            order.tolist(), places, ties.measure_sigmas[order].tolist(), strict=True
        )
    ]
    upper = ties.covariances[:, *np.triu_indices(3)].tolist()
    points = tuple(
        ControlPoint(
            id=name,
            type=_TYPES[PointKind(kind)],
            measures=tuple(measures[bounds[i] : bounds[i + 1]]),
            reference=0 if bounds[i] < bounds[i + 1] else None,
            apriori=None if math.isnan(x) else (x, y, z),
            apriori_covariance=tuple(upper[i]) if kind == PointKind.CONSTRAINED else (),
        )
        for i, (name, kind, (x, y, z)) in enumerate(
            zip(ties.ids, ties.kinds.tolist(), ties.places.tolist(), strict=True)
        )
    )
    return ControlNetwork(
        network_id=network_id, target_name=target_name, points=points, user_name=user_name, created=created,
        last_modified=created, description=description, source=ties.source,
    )


def require_usable(point: ControlPoint, index: int, where: Where) -> None:
    """Raise InputError unless an adjustment can take the point and its measures."""
    if max(map(abs, _place(point))) > FARTHEST:
        raise InputError(where(index, None, ""), f"a place at {_place(point)} m", "one on the body")
    if point.type != PointType.FREE and point.apriori is None:
        found = f"{point.type.name.lower()} without an a-priori place"
        raise InputError(where(index, None, ""), found, "AprioriX, AprioriY, AprioriZ")
    if point.type == PointType.CONSTRAINED:
        _require_covariance(point, index, where)
    images: set[str] = set()
    for k, measure in enumerate(point.measures):
        if measure.ignore:
            continue
        if measure.serial_number in images:
            found = "a second measure in this image"
            raise InputError(where(index, k, ""), found, "one per point", "remove the worse one")
        images.add(measure.serial_number)
        _require_measured(measure, index, k, where)


def _require_covariance(point: ControlPoint, index: int, where: Where) -> None:
    if not point.apriori_covariance:
        raise InputError(
            where(index, None, ""), "constrained without AprioriCovarianceMatrix", "xx, xy, xz, yy, yz, zz in m^2",
            "add it, or make the point Free or Fixed",
        )
    xx, _, _, yy, _, zz = point.apriori_covariance
    if min(xx, yy, zz) <= 0.0:
        found = f"variances {xx:g}, {yy:g}, {zz:g} m^2"
        raise InputError(where(index, None, "AprioriCovarianceMatrix"), found, "positive variances")


def _require_measured(measure: ControlMeasure, point: int, k: int, where: Where) -> None:
    for key, value in (("Line", measure.line), ("Sample", measure.sample)):
        if value is None:
            raise InputError(where(point, k, ""), f"no {key}", f"{key} of the measure")
    for key, sigma in (("LineSigma", measure.line_sigma), ("SampleSigma", measure.sample_sigma)):
        if sigma is not None and sigma <= 0.0:
            raise InputError(where(point, k, key), f"{sigma:g} px", "a positive sigma")


def _place(point: ControlPoint) -> tuple[float, float, float]:
    """A-priori place, m body-fixed; NaN for a free point that has none."""
    if point.apriori is not None or point.type != PointType.FREE:
        return point.apriori or _UNKNOWN
    return point.adjusted or _UNKNOWN


def _covariance(point: ControlPoint) -> Array:
    """(3, 3) m^2, body-fixed; zero for points that are not constrained."""
    if point.type != PointType.CONSTRAINED:
        return np.zeros((3, 3))
    xx, xy, xz, yy, yz, zz = point.apriori_covariance
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])

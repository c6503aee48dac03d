"""ISIS control networks as PVL text to TiePoints; degrees and pixels counted from 1 end here.

Format: ISIS ControlNetVersioner (what ``cnetbin2pvl`` writes). ISIS takes the points of versions 3, 4 and 5 with one
and the same code (ControlPointV0003): only the names of point types changed, Ground to Fixed and Tie to Free.
"""

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from mgsgraph.errors import InputError
from mgsgraph.geometry.body import from_planetocentric
from mgsgraph.geometry.records import Array
from mgsgraph.io.pvl import Block, Document, inner_blocks
from mgsgraph.io.text import read_text
from mgsgraph.ties import PointKind, TiePoints
from mgsgraph.units import DEG, KM

_VERSIONS = ("3", "4", "5")
_KINDS = {
    "free": PointKind.FREE, "tie": PointKind.FREE, "constrained": PointKind.CONSTRAINED,
    "fixed": PointKind.FIXED, "ground": PointKind.FIXED,
}  # fmt: skip
_LENGTHS = dict.fromkeys(("", "m", "meter", "meters", "metre", "metres"), 1.0) | dict.fromkeys(
    ("km", "kilometer", "kilometers", "kilometre", "kilometres"), KM
)
_ANGLES = dict.fromkeys(("", "deg", "degree", "degrees"), DEG) | dict.fromkeys(("rad", "radian", "radians"), 1.0)
_PIXELS = dict.fromkeys(("", "pixel", "pixels"), 1.0)
_FIRST_CENTRE = 0.5
"""ISIS counts the first pixel's centre (1, 1), which is (0.5, 0.5) inside."""


@dataclass(slots=True, eq=False)
class _Rows:
    """Columns of a TiePoints while the file is read."""

    places: list[Array] = field(default_factory=list)
    kinds: list[PointKind] = field(default_factory=list)
    covariances: list[Array] = field(default_factory=list)
    positions: dict[str, int] = field(default_factory=dict)
    """By point id, in the file's order: where its block begins, in characters."""
    measure_point: list[int] = field(default_factory=list)
    measure_image: list[str] = field(default_factory=list)
    measures: list[tuple[float, float]] = field(default_factory=list)
    sigmas: list[tuple[float, float]] = field(default_factory=list)


def read_control_network(path: Path) -> TiePoints:
    """Read an ISIS control network, version 3, 4 or 5, in PVL text.

    What ``jigsaw`` does is done here: points and measures with ``Ignore = True`` are left out; ``JigsawRejected`` ones
    are kept, since it is the verdict of an earlier adjustment, which jigsaw forgets before it starts
    (BundleAdjust::init, ControlNet::ClearJigsawRejected); measures of every MeasureType count, Candidate too.
    X, Y, Z (m) come before latitude, longitude (degrees, planetocentric) and radius (m). The place of a free point is
    its a-priori place or else its adjusted one, a mere first guess. The covariance is AprioriCovarianceMatrix
    (xx, xy, xz, yy, yz, zz in m^2); AprioriLatitudeSigma and its like are mere comments in what ISIS writes.

    Parameters
    ----------
    path : Path
        PVL file.

    Returns
    -------
    TiePoints
        In the file's order; images are called by their serial numbers; measure sigmas are NaN where the file has none.

    Raises
    ------
    InputError
        With file, line and point: no control network or another version; text cut short or malformed; a point without
        PointId, PointType or (unless free) a-priori place, a constrained one without covariance; an id twice; a measure
        without SerialNumber, Line or Sample, or with a sigma that is not positive; an image twice in a point.
    """
    rows, network = _Rows(), None
    for outer, block in inner_blocks(Document(str(path), _text(path))):
        if outer is not network:
            _require_network(outer, network)
            network = outer
        if block.name != "controlpoint":
            raise InputError(block.where(), f"{block.kind} {block.name}", "Object = ControlPoint")
        if not block.flag("Ignore"):
            _add_point(rows, block)
    if not rows.positions:
        raise InputError(
            str(path), "no control point, or only ignored ones",
            "an ISIS control network in PVL text (Object = ControlNetwork)",
        )
    return TiePoints(
        source=str(path),
        ids=tuple(rows.positions),
        kinds=np.array(rows.kinds, dtype=np.int64),
        places=np.array(rows.places),
        covariances=np.array(rows.covariances),
        measure_point=np.array(rows.measure_point, dtype=np.int64),
        measure_image=tuple(rows.measure_image),
        measures=np.array(rows.measures, dtype=np.float64).reshape(-1, 2) - _FIRST_CENTRE,
        measure_sigmas=np.array(rows.sigmas, dtype=np.float64).reshape(-1, 2),
    )


def _text(path: Path) -> str:
    try:
        return read_text(path)
    except InputError as error:
        if error.expected != "a text file":
            raise
        remedy = "convert a binary network with cnetbin2pvl"
        raise InputError(error.where, error.found, "a network in PVL text", remedy) from None


def _require_network(outer: Block, earlier: Block | None) -> None:
    """Raise InputError unless this is the file's one control network, in a version that is understood."""
    if outer.name != "controlnetwork":
        remedy = "convert a binary network with cnetbin2pvl" if outer.name == "protobuffer" else ""
        raise InputError(outer.where(), f"{outer.kind} {outer.name}", "Object = ControlNetwork", remedy)
    if earlier is not None:
        raise InputError(outer.where(), "a second network", "one in a file", "put it into a file of its own")
    version = outer.text("Version") if "Version" in outer else "1 (none is stated)"
    if version not in _VERSIONS:
        raise InputError(
            outer.where("Version"), f"version {version}", "5 (3 and 4 are understood too)",
            "let ISIS write it anew: cnetpvl2bin, then cnetbin2pvl",
        )


def _add_point(rows: _Rows, point: Block) -> None:
    name = point.text("PointId")
    point.label = f"point {name}"
    if name in rows.positions:
        first = point.document.where(rows.positions[name])
        raise InputError(point.where("PointId"), f"the id twice, first at {first}", "each id once")
    kind = _KINDS.get(point.text("PointType").lower())
    if kind is None:
        raise InputError(point.where("PointType"), repr(point.text("PointType")), "Free, Constrained or Fixed")
    index = len(rows.positions)
    rows.positions[name] = point.position
    rows.kinds.append(kind)
    rows.places.append(_place(point, kind))
    rows.covariances.append(_covariance(point) if kind == PointKind.CONSTRAINED else np.zeros((3, 3)))
    images: set[str] = set()
    for measure in point.blocks:
        if measure.name != "controlmeasure":
            raise InputError(measure.where(), f"{measure.kind} {measure.name}", "Group = ControlMeasure")
        measure.label = point.label
        if not measure.flag("Ignore"):
            images.add(_add_measure(rows, measure, index, images))


def _place(point: Block, kind: PointKind) -> Array:
    """A-priori place, (3,) m body-fixed; NaN for a free point that has none."""
    for stage in ("Apriori", "Adjusted") if kind == PointKind.FREE else ("Apriori",):
        if any(stage + axis in point for axis in "XYZ"):
            return np.array([point.number(stage + axis, _LENGTHS) for axis in "XYZ"])
        if any(stage + part in point for part in ("Latitude", "Longitude", "Radius")):
            return _planetocentric_place(point, stage)
    if kind != PointKind.FREE:
        found = f"{kind.name.lower()} without an a-priori place"
        raise InputError(point.where(), found, "AprioriX, AprioriY, AprioriZ")
    return np.full(3, np.nan)


def _planetocentric_place(point: Block, stage: str) -> Array:
    longitude, latitude = point.number(f"{stage}Longitude", _ANGLES), point.number(f"{stage}Latitude", _ANGLES)
    radius = point.number(f"{stage}Radius", _LENGTHS)
    if abs(latitude) > 90.0 * DEG or radius <= 0.0:
        found = f"latitude {latitude / DEG:g} degrees, radius {radius:g} m"
        raise InputError(point.where(f"{stage}Latitude"), found, "-90 .. 90 degrees and a positive radius")
    return from_planetocentric(np.array([longitude, latitude, radius]))


def _covariance(point: Block) -> Array:
    """(3, 3) m^2, body-fixed."""
    if "AprioriCovarianceMatrix" not in point:
        raise InputError(
            point.where(), "constrained without AprioriCovarianceMatrix", "xx, xy, xz, yy, yz, zz in m^2",
            "add it, or make the point Free or Fixed",
        )
    xx, xy, xz, yy, yz, zz = point.numbers("AprioriCovarianceMatrix", 6)
    if min(xx, yy, zz) <= 0.0:
        raise InputError(
            point.where("AprioriCovarianceMatrix"), f"variances {xx:g}, {yy:g}, {zz:g} m^2", "positive variances"
        )
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


def _add_measure(rows: _Rows, measure: Block, point: int, images: set[str]) -> str:
    """Append a measure; returns its image."""
    image = measure.text("SerialNumber")
    measure.label += f", image {image}"
    if image in images:
        raise InputError(measure.where(), "a second measure in this image", "one per point", "remove the worse one")
    rows.measure_point.append(point)
    rows.measure_image.append(image)
    rows.measures.append((measure.number("Line", _PIXELS), measure.number("Sample", _PIXELS)))
    rows.sigmas.append((_sigma(measure, "LineSigma"), _sigma(measure, "SampleSigma")))
    return image


def _sigma(measure: Block, key: str) -> float:
    """pixels; NaN where the file does not say."""
    if key not in measure:
        return float("nan")
    sigma = measure.number(key, _PIXELS)
    if sigma <= 0.0:
        raise InputError(measure.where(key), f"{sigma:g} px", "a positive sigma")
    return sigma

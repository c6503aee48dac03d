"""Tie points of a table (CSV or Parquet) by columns, without an object for each point and measure.

What is odd in the least is left to `networks.table`, which reads row by row and says what is wrong where.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from mgsgraph.errors import InputError
from mgsgraph.files.csv_columns import PlainRows, numbers_of, plain_text, short_names
from mgsgraph.files.networks.record import ControlNetwork, PointType
from mgsgraph.files.networks.table_columns import (
    AXES,
    CARTESIAN,
    FLAGS,
    GEODETIC,
    ISIS,
    LARGEST_SIGMA,
    MATRIX,
    MEASURE_TYPES,
    NORMAL,
    OF_MEASURE,
    OURS,
    PLACES,
    PLANETOCENTRIC,
    POINT_TYPES,
    TURN,
    UNCERTAINTIES,
    header_of,
    whole,
)
from mgsgraph.files.networks.tie_points import FARTHEST, KINDS, require_body
from mgsgraph.files.opening import LARGEST_NUMBER, name_of
from mgsgraph.files.tie_points import PointKind, TiePoints
from mgsgraph.geometry.body import (
    Ellipsoid,
    distances,
    from_geodetic,
    from_planetocentric,
    planetocentric,
    require_near,
)
from mgsgraph.geometry.records import Array, Index, Mask, repeated
from mgsgraph.names import Names, RepeatedNames
from mgsgraph.units import DEG, ISIS_OFFSET

_POLE = 90.0
_FULL = [0, 1, 2, 1, 3, 4, 2, 4, 5]
"""Elements of a symmetric matrix, of those in its upper triangle."""


class _Doubtful(Exception):
    """What the reader of rows has to look at."""


@dataclass(frozen=True, slots=True, eq=False)
class _OfPoints:
    """What a table says of its p points."""

    kinds: Index
    """(p,) PointKind."""
    used: Mask
    """(p,) which are not ignored."""
    places: Array
    """(p, 3) m, body-fixed; NaN where none is said."""
    covariances: Array
    """(p, 3, 3) m^2, body-fixed; zero for points that are not constrained, or ignored."""


def csv_ties(content: bytes, source: str, ellipsoid: Ellipsoid | None = None) -> TiePoints | None:
    """What an adjustment takes from a table in CSV; None where something is odd.

    Parameters
    ----------
    content : bytes
        All of the file.
    source : str
        File, for messages.
    ellipsoid : Ellipsoid, optional
        As `networks.table.read_table` has it.
    """
    text = plain_text(content)
    if text is None:
        return None
    begin = 0
    while text[begin : begin + 1] == b"#" and (end := text.find(b"\n", begin)) >= 0:
        begin = end + 1
    head, _, _ = text[begin : text.find(b"\n", begin) + 1].decode().partition("\n")
    try:
        names = header_of(head.split(","), source)
    except InputError:
        return None
    rows = PlainRows.of(text, begin + len(head.encode()) + 1)
    found = rows.columns(len(names), (), range(len(names))) if rows else None
    if found is None:
        return None
    if pc.any(pc.starts_with(found[0], "#")).as_py():  # a comment
        return None
    return tie_points_of({name: found[k] for k, name in enumerate(names)}, source, ellipsoid)


def tie_points_of(
    columns: Mapping[str, pa.Array], source: str, ellipsoid: Ellipsoid | None = None
) -> TiePoints | None:
    """What an adjustment takes from a table's columns.

    Parameters
    ----------
    columns : mapping
        By the names of a proper header (`table_columns.header_of`): texts without blanks around them, empty ones for
        nothing, or float64, null for nothing.
    source, ellipsoid
        As `csv_ties`.

    Returns
    -------
    TiePoints or None
        None for what `networks.table` has to look at: anything that it would refuse.
    """
    try:
        return _tie_points(columns, source, ellipsoid)
    except (_Doubtful, InputError):
        return None


def _tie_points(columns: Mapping[str, pa.Array], source: str, ellipsoid: Ellipsoid | None) -> TiePoints:
    coded = _names(columns["id"], gaps=False).arrow.dictionary_encode()
    if not len(coded):
        raise _Doubtful
    ids, point = Names.of(coded.dictionary), np.asarray(coded.indices).astype(np.int64)
    images = _names(columns["image"], gaps=True)
    rows = np.flatnonzero(np.diff(images.offsets))
    unmeasured = np.delete(np.arange(point.size), rows)
    for name in [name for name in OF_MEASURE if name in columns]:
        if np.any(_filled(columns[name])[unmeasured]):
            raise _Doubtful
    said = _of_points(columns, point, ids, source, ellipsoid)
    chosen = {name: columns[name].take(pa.array(rows)) for name in OF_MEASURE if name in columns}
    of_point, image = point[rows], RepeatedNames.of(images[rows])
    for name in image.distinct:
        name_of(name, source)
    _require_once(of_point * len(image.distinct) + image.numbers)
    reference = _flags(chosen.get("reference"), rows.size)
    _require_once(of_point[reference])
    _words(chosen.get("measure_type"), MEASURE_TYPES, "_")
    places, sigmas = _places(chosen), _sigmas(chosen, rows.size)
    taken = ~_flags(chosen.get("ignore"), rows.size) & said.used[of_point]
    order = np.flatnonzero(taken)[np.argsort(of_point[taken], kind="stable")]
    number = np.cumsum(said.used) - 1
    ties = TiePoints(
        source=source, ids=ids[said.used], kinds=said.kinds[said.used], places=said.places[said.used],
        covariances=said.covariances[said.used], measure_point=number[of_point[order]], measure_image=image[order],
        measures=places[order], measure_sigmas=sigmas[order],
    )  # fmt: skip
    if not len(ties.ids) or np.any(np.abs(ties.places) > FARTHEST):
        raise _Doubtful
    if ellipsoid is not None:
        require_body(ControlNetwork("", "", (), source=source), ties, ellipsoid)
    return ties


# --- cells


def _names(column: pa.Array, gaps: bool) -> Names:
    names = short_names(column, gaps)
    if names is None or not names.text.isprintable():
        raise _Doubtful
    return names


def _filled(column: pa.Array) -> Mask:
    """Which cells (n,) hold anything."""
    if pa.types.is_floating(column.type):
        return np.asarray(column.is_valid())
    return np.asarray(pc.not_equal(column, ""))


def _numbers(column: pa.Array) -> Array:
    """(n,) numbers, NaN for empty cells."""
    if not pa.types.is_floating(column.type):
        found = numbers_of(column, LARGEST_NUMBER)
        if found is None:
            raise _Doubtful
        return found
    values = np.asarray(column.fill_null(0.0))
    if not np.all(np.abs(values) < LARGEST_NUMBER):
        raise _Doubtful
    return np.where(_filled(column), values, np.nan)


def _words(column: pa.Array | None, known: Mapping[str, object], left_out: str = "\n") -> RepeatedNames | None:
    """Words of a column, each of which is known, in small letters and without a mark that is left out, or empty; None
    where there is no such column.
    """
    if column is None:
        return None
    words = RepeatedNames.of(column)
    if not {word.lower().replace(left_out, "") for word in words.distinct if word} <= {*known}:
        raise _Doubtful
    return words


def _flags(column: pa.Array | None, count: int) -> Mask:
    """Truth values (n,), false where nothing stands."""
    words = _words(column, FLAGS)
    if words is None:
        return np.zeros(count, dtype=bool)
    return np.array([FLAGS.get(word.lower(), False) for word in words.distinct] or [False])[words.numbers]


def _require_once(numbers: Index) -> None:
    if np.any(np.diff(np.sort(numbers, kind="stable")) == 0):
        raise _Doubtful


def _require(sound: Mask) -> None:
    if not np.all(sound):
        raise _Doubtful


# --- measures


def _places(columns: Mapping[str, pa.Array]) -> Array:
    """(k, 2) line and sample of measures."""
    names, shift = (ISIS, 0.0) if ISIS[0] in columns else (OURS, ISIS_OFFSET)
    places = np.column_stack([_numbers(columns[name]) for name in names])
    _require(~np.isnan(places))
    return np.asarray(places + shift - ISIS_OFFSET)


def _sigmas(columns: Mapping[str, pa.Array], count: int) -> Array:
    """(k, 2) px, of line and sample; NaN where none are said."""
    sigmas = np.full((count, 2), np.nan)
    for k, name in enumerate(("sigma_line_px", "sigma_sample_px")):
        if name in columns:
            sigmas[:, k] = _numbers(columns[name])
    _require(np.isnan(sigmas) | _positive(sigmas))
    return sigmas


def _positive(values: Array) -> Mask:
    with np.errstate(invalid="ignore"):
        return np.asarray((values > 0.0) & (values < LARGEST_SIGMA))


# --- points


def _of_points(
    columns: Mapping[str, pa.Array], point: Index, ids: Names, source: str, ellipsoid: Ellipsoid | None
) -> _OfPoints:
    """What rows say of their points (n,), in the first row that says it; all others must say the same, or nothing."""
    n, names = len(ids), tuple(columns)

    def first(name: str) -> pa.Array | None:
        return _first_of(columns[name], point, n) if name in columns else None

    types = _words(first("type"), POINT_TYPES)
    type_of = [POINT_TYPES.get(word.lower(), PointType.FREE) for word in types.distinct] if types else []
    kinds = np.full(n, int(PointKind.FREE))
    if types is not None:
        kinds = np.array([int(KINDS[one]) for one in type_of], dtype=np.int64)[types.numbers]
    ignored = _flags(first("point_ignore"), n)
    place = {name: _numbers(first(name)) for name in whole(names, PLACES)}
    uncertainty = {name: _numbers(first(name)) for name in whole(names, UNCERTAINTIES)}
    placed, stated = (_any_filled(group, n) for group in (place, uncertainty))
    constrained = (kinds == PointKind.CONSTRAINED) & ~ignored
    _require(placed | ignored | (kinds == PointKind.FREE))
    _require(stated | ~constrained)
    _require(placed | ~stated)
    places = np.full((n, 3), np.nan)
    places[placed] = _on_body({name: values[placed] for name, values in place.items()}, source, ellipsoid)
    covariances = repeated(0.0, (n, 3, 3))
    if np.any(stated):
        some = {name: values[stated] for name, values in (place | uncertainty).items()}
        full = np.zeros((n, 3, 3))
        full[stated] = _covariances(some, tuple(uncertainty), places[stated], constrained[stated])
        if np.any(constrained):
            covariances = np.where(constrained[:, None, None], full, 0.0)
    return _OfPoints(kinds, ~ignored, places, covariances)


def _first_of(column: pa.Array, point: Index, n: int) -> pa.Array:
    """(n) what the first filled row of each point says."""
    rows = np.flatnonzero(_filled(column))
    coded = column.take(pa.array(rows)).dictionary_encode()
    codes, of_point = np.asarray(coded.indices).astype(np.int64), point[rows]
    found = np.full(n, -1)
    found[of_point[::-1]] = codes[::-1]
    _require(codes == found[of_point])
    said = coded.dictionary.take(pa.array(found, mask=found < 0))
    return said if pa.types.is_floating(column.type) else said.fill_null("")


def _any_filled(group: Mapping[str, Array], n: int) -> Mask:
    return np.any([~np.isnan(values) for values in group.values()], axis=0) if group else np.zeros(n, dtype=bool)


def _on_body(place: Mapping[str, Array], source: str, ellipsoid: Ellipsoid | None) -> Array:
    """(m, 3) m, body-fixed, near the ellipsoid, if there is one."""
    if not place:
        return np.zeros((0, 3))
    columns, values = tuple(place), np.column_stack(list(place.values()))
    _require(~np.isnan(values))
    if columns != CARTESIAN:
        _require((np.abs(values[:, 1]) <= _POLE) & (np.abs(values[:, 0]) <= TURN))
        turned = values * [DEG, DEG, 1.0]
        if columns == PLANETOCENTRIC:
            _require(_positive(values[:, 2]))
            values = from_planetocentric(turned)
        elif values.size:
            if ellipsoid is None:
                raise _Doubtful
            values = from_geodetic(turned, ellipsoid)
    if ellipsoid is not None:
        require_near(distances(values), ellipsoid, lambda _: source)
    return values


def _covariances(columns: Mapping[str, Array], names: Sequence[str], places: Array, used: Mask) -> Array:
    """(m, 3, 3) m^2, body-fixed, of uncertainties that are said; variances of what is not `used` may be zero."""
    values = np.column_stack([columns[name] for name in names])
    _require(~np.isnan(values))
    if tuple(names) == MATRIX:
        _require(_positive(values[:, [0, 3, 5]]) | ~used[:, None])
        return np.asarray(values[:, _FULL].reshape(-1, 3, 3))
    _require(_positive(values))
    if tuple(names) == AXES:
        return np.asarray(values[:, :, None] ** 2 * np.eye(3))
    longitude, latitude, _ = planetocentric(places).T
    if tuple(names) == NORMAL and GEODETIC[1] in columns:
        latitude = columns[GEODETIC[1]] * DEG
    zero, (sl, cl), (sb, cb) = np.zeros(longitude.size), *((np.sin(a), np.cos(a)) for a in (longitude, latitude))
    axes = np.moveaxis(np.array([[-sl, cl, zero], [-sb * cl, -sb * sl, cb], [cb * cl, cb * sl, sb]]), 2, 0)
    full = (np.swapaxes(axes, 1, 2) * values[:, None, :] ** 2) @ axes
    upper = full[:, *np.triu_indices(3)]
    return np.asarray(upper[:, _FULL].reshape(-1, 3, 3))

"""Lists of a block: points, image measurements, images, passes and laser profiles as tables, sorted and filtered.

Columns that take long (`GROUPS`) are computed at a request of their own, and are in the tables from then on.
"""

import io
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np

from mgsgraph.errors import InputError, require
from mgsgraph.export.verdicts import Verdicts
from mgsgraph.files.networks.tie_points import PointKind, TiePoints
from mgsgraph.files.output.table import Column, Table, digits, padded
from mgsgraph.files.rasters.pictures import read_picture
from mgsgraph.geometry.body import east_north_up
from mgsgraph.geometry.records import Array, Index, Mask, no_rows, thinned
from mgsgraph.matching.chips import chip_frames, likeness, misfit_beside_neighbours
from mgsgraph.matching.scene import Pixels
from mgsgraph.names import Names, RepeatedNames
from mgsgraph.network import PointClass
from mgsgraph.project.decisions import Measure
from mgsgraph.project.project import open_project, rejected_measurements
from mgsgraph.studio.inputs import number_of
from mgsgraph.studio.map_points import CLASSES, largest, map_points, ray_residuals, ray_tests
from mgsgraph.studio.marks import laser_profiles
from mgsgraph.studio.opened import Opened

MOST_ROWS = 300
"""Most rows of an answer."""
_STATES = ("used", "not used", "rejected by hand", "rejected by the adjustment")
_REJECTED = 2
"""The first of these states that says so."""
_KINDS = tuple(kind.name.lower() for kind in PointKind)
_CONDITION = re.compile(r"(<=|>=|<|>|=)?\s*([-+]?[0-9.]+(?:[eE][-+]?[0-9]+)?)")
_COMPARED = {"<": np.less, ">": np.greater, "<=": np.less_equal, ">=": np.greater_equal, "=": np.equal}
_KEPT = 8
"""Views, and images whose pixels are kept."""
_SAMPLE = 5000
"""Values by which the decimals of a column are chosen."""


# --- image measurements


@dataclass(frozen=True, eq=False)
class ListedRays:
    """k image measurements: those of the block, then those that users have rejected."""

    ids: Names
    """(n,) points of the block, then those that have rejected measurements alone."""
    images: tuple[str, ...]
    """(m,) likewise."""
    point: Index
    """(k,)"""
    image: Index
    """(k,)"""
    places: Array
    """(k, 2) px, line and sample."""
    state: Index
    """(k,) numbers of `_STATES`."""

    def per_point(self, values: Array) -> Array:
        """(n,) the largest value of each point, of the measurements of the block; NaN where none is known."""
        return largest(values, self.point[: values.size], len(self.ids))


def listed_rays(opened: Opened) -> ListedRays:
    """The image measurements as they are now."""

    def make() -> ListedRays:
        block, by_hand = opened.block(), _rejected_by_hand(opened)
        network, solution, rays = block.network, opened.now.solution, block.network.rays
        blunders = rays.rejected if solution is None else solution.rays_rejected
        state = np.where(block.used, 0, 1 if blunders is None else np.where(blunders, 3, 1))
        names = tuple(dict.fromkeys([*network.image_names, *(measure.image for _, measure in by_hand)]))
        ids, points, others = network.points.ids, rays.point, no_rows()
        if by_hand:
            ids, (numbers, others) = Names.united([ids, Names.of([name for name, _ in by_hand])])
            points = numbers[points]
        images = RepeatedNames.of([measure.image for _, measure in by_hand]).over(names)
        places = np.array([(measure.line, measure.sample) for _, measure in by_hand]).reshape(-1, 2)
        return ListedRays(
            ids, names, np.concatenate([points, others]), np.concatenate([rays.image, images]),
            np.concatenate([rays.places, places]), np.concatenate([state, np.full(len(by_hand), _REJECTED)]),
        )  # fmt: skip

    return opened.once("listed rays", make)


def _rejected_by_hand(opened: Opened) -> list[tuple[str, Measure]]:
    """Point and image measurement of all that users have rejected."""
    if opened.kind != "project":
        return []
    with open_project(opened.path) as project:
        return rejected_measurements(project)


# --- columns that take long


def matches(opened: Opened) -> Array:
    """(3, n) how well the chips of each tie point match that two images with pixels show: lowest correlation with the
    first measurement; misfit of the rays beside that of neighbors, and largest offset of the best match, in px of
    chips. NaN where unknown.
    """

    def make() -> Array:
        network, points, rays = opened.block().network, opened.block().network.points, opened.block().network.rays
        names = tuple(network.image_names)
        ties = TiePoints(str(opened.path), points.ids, points.kinds, points.places, points.covariances, rays.point,
                         RepeatedNames(names, rays.image), rays.places, network.ray_sigmas)  # fmt: skip
        ties = ties.with_measures(np.array([opened.pictures.get(name) is not None for name in names])[rays.image])
        seen = np.bincount(ties.measure_point, minlength=len(points))
        chosen = np.flatnonzero((points.classes == PointClass.TIE) & (seen > 1))
        ties = ties.chosen(chosen)
        frames = chip_frames(network.images, ties)
        alike, beside = likeness(_pixels(opened), ties, frames), misfit_beside_neighbours(frames, ties)
        lowest, offset = (largest(values, ties.measure_point, chosen.size)
                          for values in (-alike.correlation, np.hypot(*alike.shift.T)))  # fmt: skip
        found = np.full((3, len(points)), np.nan)
        found[:, chosen] = -lowest, np.where(np.isfinite(beside), np.abs(beside), frames.skew_pixels), offset
        return found

    return opened.once("matches", make)


def _pixels(opened: Opened) -> Callable[[int], Pixels]:
    """Pixels of an image by its number; those of some images are kept."""

    @lru_cache(_KEPT)
    def read(number: int) -> Pixels:
        image = opened.block().images[number]
        path, size = opened.pictures[image.name], (image.lines, image.samples)
        assert path is not None
        pixels = read_picture(path)
        require(pixels.shape == size, str(path), f"pixels of shape {pixels.shape}", f"{size}, as image {image.name}")
        return pixels

    return read


GROUPS: dict[str, tuple[str, Callable[[Opened], object], float]] = {
    "residuals": ("residuals", ray_residuals, np.inf),
    "tests": ("w-tests and redundancy", ray_tests, 1e5),
    "matches": ("correlation of the chips", matches, 2e3),
}
"""Title, and what computes them; most image measurements with which the page asks for them by itself."""


def _possible(opened: Opened) -> list[str]:
    pictures = sum(path is not None for path in opened.pictures.values())
    is_possible = (opened.block().adjusted, opened.now.posterior is not None, pictures > 1)
    return [name for name, possible in zip(GROUPS, is_possible, strict=True) if possible]


def _ready(opened: Opened) -> set[str]:
    """Groups whose columns are in the tables of this state."""
    return opened.once("groups of lists", lambda: set() if opened.now.solution is None else {"residuals"})


def compute(opened: Opened, group: str) -> dict[str, Any]:
    """Compute the columns of a group; returns when the tables have them."""
    possible, ready = _possible(opened), _ready(opened)
    require(group in possible, "request, group", repr(group)[:60], f"one of {', '.join(possible)}")
    GROUPS[group][1](opened)
    ready.add(group)
    return {"revision": opened.revision}


def compute_at_once(opened: Opened) -> None:
    """Compute the columns for which the page asks by itself."""
    for one in window(opened, {})["missing"]:
        if one["at_once"]:
            compute(opened, one["group"])


# --- tables; values of the block's own rows may be fewer than the rows


def _points(opened: Opened, rays: ListedRays) -> Iterator[Column]:
    points, ready, count = map_points(opened), _ready(opened), len(rays.ids)
    more = count - len(points.classes)
    yield Column("id", rays.ids)
    yield Column("class", RepeatedNames(tuple(CLASSES), np.pad(points.classes, (0, more))))
    yield Column("kind", RepeatedNames(_KINDS, np.pad(points.block.network.points.kinds, (0, more))))
    for key, is_counted in (("images", rays.state == 0), ("rejected", rays.state >= _REJECTED)):
        yield Column(key, np.bincount(rays.point[is_counted], minlength=count), meaning="image measurements")
    if "residuals" in ready:
        pixels, sigmas = _sizes(opened)
        yield Column("residual", rays.per_point(pixels), "px", "largest of the point")
        yield Column("residual_sigmas", rays.per_point(sigmas), head="residual / sigma", meaning="largest of the point")
    if "tests" in ready:
        yield Column("w", rays.per_point(ray_tests(opened)[0]), head="|w|", meaning="largest w-test of the point")
    if "matches" in ready:
        correlation, misfit, offset = matches(opened)
        yield Column("correlation", correlation, meaning="of the chips, lowest of the point")
        yield Column("misfit", misfit, "px", "of the rays, less that of neighbors")
        yield Column("offset", offset, "px", "of the best match of the chips, largest of the point")
    if not points.block.adjusted:
        return
    yield Column("sigma", points.value("sigma"), "m", "3-D")
    for axis, name in enumerate(("east", "north", "up")):
        yield Column(f"sigma_{name}", np.sqrt(points.local[:, axis, axis]), "m")
    yield Column("correction", np.linalg.norm(points.moved, axis=1), "m", "adjusted minus a-priori")


def _sizes(opened: Opened) -> tuple[Array, Array]:
    """(k,) sizes of the block's residuals, in px and in their sigmas."""
    residuals, sigmas = ray_residuals(opened), opened.block().network.ray_sigmas
    return np.hypot(*residuals.T), np.hypot(*(residuals / sigmas).T)


def _measurements(opened: Opened, rays: ListedRays) -> Iterator[Column]:
    ready = _ready(opened)
    yield Column("point", rays.ids[rays.point])
    yield Column("image", RepeatedNames(rays.images, rays.image))
    yield Column("state", RepeatedNames(_STATES, rays.state))
    yield from (Column(name, rays.places[:, axis], "px") for axis, name in enumerate(("line", "sample")))
    if "residuals" in ready:
        for axis, name in enumerate(("line", "sample")):
            yield Column(f"residual_{name}", ray_residuals(opened)[:, axis], "px")
        yield Column("residual_sigmas", _sizes(opened)[1], head="residual / sigma")
    if "tests" in ready:
        test, redundancy = ray_tests(opened)
        yield Column("w", test, head="|w|", meaning="larger w-test of line and sample")
        yield Column("redundancy", redundancy, meaning="redundancy number of the same coordinate")


def _grouped(opened: Opened, rays: ListedRays, group: Index, count: int) -> Iterator[Column]:
    """Columns of image measurements by the group (k,) of each, the last one of `count` for none."""
    ready, own = _ready(opened), group[: opened.block().network.rays.point.size]
    for key, is_counted in (("measurements", rays.state == 0), ("rejected", rays.state >= _REJECTED)):
        yield Column(key, np.bincount(group[is_counted], minlength=count)[:-1])
    if "residuals" in ready:
        squares = np.where(opened.block().used[:, None], ray_residuals(opened) ** 2, np.nan)
        for name, values in (("rms", squares.sum(axis=1)), ("rms_line", squares[:, 0]), ("rms_sample", squares[:, 1])):
            known = np.isfinite(values)
            total, number = (np.bincount(own[known], weights, count)[:-1] for weights in (values[known], None))
            rms = np.sqrt(np.divide(total, number, out=np.full(count - 1, np.nan), where=number > 0))
            yield Column(name, rms, "px", "of the residuals")
    if "tests" in ready:
        yield Column("w", largest(ray_tests(opened)[0], own, count)[:-1], head="|w|", meaning="largest w-test")


def _images(opened: Opened, rays: ListedRays) -> Iterator[Column]:
    block, sizes = opened.block(), np.full((2, len(rays.images)), np.nan)
    for j, (image, correction) in enumerate(zip(block.images, block.corrections, strict=True)):
        if correction is not None:
            values = correction.at(image.moments(np.array([0.5 * image.lines])))[0][0]
            sizes[:, j] = np.linalg.norm(values[:3]), np.linalg.norm(values[3:])
    yield Column("image", Names.of(rays.images))
    yield from _grouped(opened, rays, rays.image, len(rays.images) + 1)
    yield Column("shift", sizes[0], "m", "correction of the position at the middle line")
    yield Column("angle", sizes[1], "arcsec", "correction of the rotation at the middle line")
    pixels = np.array([opened.pictures.get(name) is not None for name in rays.images], dtype=np.int64)
    yield Column("pixels", RepeatedNames(("no", "yes"), pixels))


def _passes(opened: Opened, rays: ListedRays) -> Iterator[Column]:
    passes = opened.block().network.passes
    number = np.full(len(rays.images), len(passes))
    for k, one in enumerate(passes):
        number[one.images] = k
    yield Column("pass", Names.of([one.name for one in passes]))
    yield Column("images", np.bincount(number, minlength=len(passes) + 1)[:-1])
    yield from _grouped(opened, rays, number[rays.image], len(passes) + 1)


def _profiles(opened: Opened, _: ListedRays) -> Iterator[Column]:
    block, solution, profiles = opened.block(), opened.now.solution, laser_profiles(opened.block())
    ranges, shifts = block.network.ranges, block.network.shifts
    values = np.full((5, len(profiles)), np.nan)
    for k, (name, points) in enumerate(profiles):
        rows = np.flatnonzero(np.isin(ranges.point, points))
        if solution is not None and rows.size:
            for row, residuals in enumerate((solution.range_residuals_before, solution.range_residuals)):
                values[row, k] = np.sqrt(np.nanmean(residuals[rows] ** 2))
        if block.values is not None and shifts is not None and name in shifts.names:
            number = shifts.names.index(name)
            east, north = block.values[len(block.images) + number][:2]
            ends = block.network.points.places[points[[0, -1]]]
            track = (east_north_up(ends[:1])[0] @ (ends[1] - ends[0]))[:2]
            along = track / max(float(np.linalg.norm(track)), 1e-9)
            values[2:4, k] = east * along[0] + north * along[1], north * along[0] - east * along[1]
            values[4, k] = np.hypot(east, north) / shifts.sigmas[number]
    yield Column("profile", Names.of([name for name, _ in profiles]))
    yield Column("shots", np.array([points.size for _, points in profiles], dtype=np.int64))
    middles = np.array([points[points.size // 2] for _, points in profiles], dtype=np.int64)
    yield Column("middle", block.network.points.ids[middles], meaning="shot in the middle")
    meanings = ("of the ranges' residuals", "of the ranges' residuals", "along the track", "across it, to the left")
    keys = ("rms_before", "rms_after", "shift_along", "shift_across")
    yield from (Column(key, values[k], "m", meanings[k]) for k, key in enumerate(keys))
    yield Column("shift_sigmas", values[4], head="shift / sigma", meaning="horizontal shift over its a-priori sigma")


_TABLES: dict[str, Callable[[Opened, ListedRays], Iterator[Column]]] = {
    "points": _points, "measurements": _measurements, "images": _images, "passes": _passes, "profiles": _profiles,
}  # fmt: skip


def table(opened: Opened, name: str) -> Table:
    """One of the lists, all of its rows; of points with verdicts and notes, where there may be some."""
    require(name in _TABLES, "request, table", repr(name)[:60], f"one of {', '.join(_TABLES)}")
    rays = listed_rays(opened)

    def make() -> Table:
        first, *rest = _TABLES[name](opened, rays)
        short = [len(first.values) - len(column.values) for column in rest]
        return Table(name, name, (first, *(
            replace(column, values=padded(np.asarray(column.values), 0, more)) if more else column
            for column, more in zip(rest, short, strict=True)
        )))  # fmt: skip

    found = opened.once(f"list {name} {sorted(_ready(opened))}", make)
    if name != "points" or opened.judging is None:
        return found
    verdicts, judged = opened.judging.verdicts, opened.once("judged", dict[Verdicts, list[Column]])
    if verdicts not in judged:
        judged.clear()
        of_rows = {"verdict": _given(rays.ids, verdicts.of), "note": _given(rays.ids, verdicts.notes)}
        judged[verdicts] = [Column(key, values) for key, values in of_rows.items()]
    return replace(found, columns=(*found.columns[:3], *judged[verdicts], *found.columns[3:]))


def _given(ids: Names, texts: Mapping[str, str]) -> RepeatedNames:
    """(n,) text of each point, empty for those without one."""
    labels, numbers = tuple(dict.fromkeys(["", *texts.values()])), np.zeros(len(ids), dtype=np.int64)
    if texts:
        rows = ids.find(list(texts))
        numbers[rows[rows >= 0]] = np.array([labels.index(text) for text in texts.values()])[rows >= 0]
    return RepeatedNames(labels, numbers)


# --- order and filter


def rows_of(opened: Opened, shown: Table, query: Mapping[str, str]) -> Index:
    """Rows of a table that meet conditions on its columns (`query` has them by keys), in an order: `sort` is the key
    of a column, after a minus for the largest first; `only=rejected` leaves out what is not.
    """
    by_key = {column.key: column for column in shown.columns}
    conditions = {key: query[key].strip() for key in by_key if query.get(key)}
    if query.get("only") == "rejected":
        conditions |= {key: text for key, text in (("state", "rejected"), ("rejected", "> 0")) if key in by_key}
    sort = query.get("sort", "")
    views = opened.once("views of lists", dict[tuple[Any, ...], Index])
    verdicts = None if opened.judging is None else opened.judging.verdicts
    key = (len(shown.columns), shown.name, sort, verdicts, *conditions.items())
    rows = views.get(key)
    if rows is None:
        rows = np.arange(len(shown))
        if by_key.get(sort.removeprefix("-")) is not None:
            rows = _order(opened, shown.name, by_key[sort.removeprefix("-")], sort.startswith("-"))
        for name, condition in conditions.items():
            rows = rows[_meets(by_key[name].scaled, condition)[rows]]
        while len(views) >= _KEPT:
            views.pop(next(iter(views)), None)
        views[key] = rows
    return rows


def _order(opened: Opened, name: str, column: Column, down: bool) -> Index:
    """Rows by a column, unknown values last."""

    def make() -> Index:
        values = _keys(column.values)
        return np.argsort(-values if down else values, kind="stable")

    if column.key in ("verdict", "note"):  # they change in one state
        return make()
    return opened.once(f"order {name} {column.key} {down}", make)


def _keys(values: Any) -> Array:
    """Numbers that order values: texts as they are read, with numbers in them by their size."""
    if isinstance(values, RepeatedNames):
        return _keys(Names.of(values.distinct))[values.numbers]
    if not isinstance(values, Names):
        return np.asarray(values, dtype=np.float64)
    texts: list[str] = values.tolist()
    if np.ptp(np.diff(values.offsets)):  # of one length they need no care
        texts = [re.sub(r"\d+", lambda digits: digits[0].zfill(12), text) for text in texts]
    ranks = np.empty(len(texts))
    ranks[sorted(range(len(texts)), key=texts.__getitem__)] = np.arange(len(texts))
    return ranks


def _meets(values: Any, condition: str) -> Mask:
    """(n,) whether texts contain a text, or are it after `=`; whether numbers meet a condition such as `> 3`."""
    if isinstance(values, RepeatedNames):
        return np.asarray(_meets(Names.of(values.distinct), condition)[values.numbers])
    if isinstance(values, Names):
        return values.containing(condition.removeprefix("=").strip(), whole=condition.startswith("="))
    match = _CONDITION.fullmatch(condition)
    if match is None:
        raise InputError("filter", repr(condition)[:60], "a condition such as > 3 or <= 0.5")
    with np.errstate(invalid="ignore"):
        return np.asarray(_COMPARED[match[1] or "="](values, float(match[2])))


# --- answers


def window(opened: Opened, query: Mapping[str, str]) -> dict[str, Any]:
    """Some rows of a list as JSON: `first` and `count` say which of its order, `find` a point whose row is wanted."""
    shown = table(opened, query.get("table", "points"))
    rows, size = rows_of(opened, shown, query), opened.block().network.rays.point.size
    first, count = (int(max(number_of(query, key, 0.0), 0.0)) for key in ("first", "count"))
    part = shown.take(rows[first : first + min(count, MOST_ROWS)])
    return {
        "revision": opened.revision, "total": len(shown), "count": int(rows.size), "first": first,
        "at": _position(opened, shown.name, rows, query["find"]) if query.get("find") else None,
        "columns": [{"key": one.key, "title": one.head or one.key.replace("_", " "), "unit": one.unit,
                     "meaning": one.meaning, "decimals": _decimals(opened, shown.name, one)} for one in shown.columns],
        "rows": list(zip(*map(_cells, part.columns), strict=True)),
        "missing": [{"group": name, "title": GROUPS[name][0], "at_once": size <= GROUPS[name][2]}
                    for name in _possible(opened) if name not in _ready(opened)],
    }  # fmt: skip


def _position(opened: Opened, name: str, rows: Index, point: str) -> int | None:
    """Where a point is in an order: its first row; None where it has none."""
    rays = listed_rays(opened)
    (number,) = rays.ids.find([point]).tolist()
    places = np.flatnonzero((rays.point[rows] if name == "measurements" else rows) == number)
    return int(places[0]) if places.size and name in ("points", "measurements") else None


def _decimals(opened: Opened, name: str, column: Column) -> int | None:
    """Decimals with which most numbers of a column have three digits or more; None of texts."""
    values = column.scaled
    if not isinstance(values, np.ndarray) or values.dtype.kind != "f":
        return 0 if isinstance(values, np.ndarray) else None

    def make() -> int:
        some = values[thinned(values.size, _SAMPLE)]
        sizes = np.abs(some[np.isfinite(some) & (some != 0.0)])
        return int(np.clip(2.0 - np.floor(np.log10(np.median(sizes))), 0.0, 6.0)) if sizes.size else 0

    return opened.once(f"decimals {name} {column.key}", make)


def _cells(column: Column) -> Sequence[Any]:
    values = column.scaled
    if isinstance(values, np.ndarray):
        return digits(values) if values.dtype.kind == "f" else values.tolist()
    return list(values)


def csv_of(opened: Opened, query: Mapping[str, str]) -> str:
    """All rows of a list that meet conditions, in an order, as CSV."""
    shown, file = table(opened, query.get("table", "points")), io.StringIO()
    shown.take(rows_of(opened, shown, query)).write_csv(file)
    return file.getvalue()

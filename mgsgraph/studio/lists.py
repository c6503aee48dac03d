"""Lists of a block: points, image measurements, images, passes and laser profiles as tables, sorted and filtered.

Columns that take long (`GROUPS`) are computed at a request of their own, and are in the tables from then on.
"""

import io
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np

from mgsgraph.errors import InputError, require
from mgsgraph.export.verdicts import Verdicts
from mgsgraph.files.networks.tie_points import PointKind, TiePoints
from mgsgraph.files.output.table import Column, Table, digits, padded
from mgsgraph.files.rasters.pictures import read_picture
from mgsgraph.geometry.body import east_north_up
from mgsgraph.geometry.records import Array, Index
from mgsgraph.matching.chips import chip_frames, likeness, misfit_beside_neighbours
from mgsgraph.matching.scene import Pixels
from mgsgraph.names import Names, RepeatedNames
from mgsgraph.network import PointClass
from mgsgraph.project.project import open_project
from mgsgraph.studio.inputs import number_of
from mgsgraph.studio.map_points import CLASSES, largest, map_points, ray_residuals, ray_tests
from mgsgraph.studio.marks import laser_profiles
from mgsgraph.studio.opened import Block, Opened

MOST_ROWS = 300
"""Most rows of an answer."""
_STATES = ("used", "rejected by hand", "rejected by the adjustment", "not used")
_BY_HAND = _STATES.index("rejected by hand")
_CONDITION = re.compile(r"\s*(<=|>=|<|>|=)?\s*([-+]?[0-9.]+(?:[eE][-+]?[0-9]+)?)\s*")
_COMPARED = {"<": np.less, ">": np.greater, "<=": np.less_equal, ">=": np.greater_equal, "=": np.equal}
_KEPT_VIEWS, _KEPT_PICTURES = 8, 8


class Group(NamedTuple):
    """Columns that are computed together."""

    title: str
    compute: Callable[[Opened], object]
    at_once: int
    """Most image measurements with which the page asks for them by itself."""


# --- rows


@dataclass(frozen=True, eq=False)
class ListedRays:
    """k image measurements: those of the block, then those that users have rejected; n points in them or in the block."""

    ids: Names
    """(n) names of points."""
    images: tuple[str, ...]
    """(m) names."""
    point: Index
    """(k,)"""
    image: Index
    """(k,)"""
    places: Array
    """(k, 2) px, line and sample."""
    state: Index
    """(k,) numbers of `_STATES`."""

    @property
    def rejected(self) -> Index:
        """(r,) those that a user or the adjustment has rejected."""
        return np.flatnonzero((self.state == _BY_HAND) | (self.state == _BY_HAND + 1))

    def per_point(self, values: Array) -> Array:
        """(n,) the largest value (k,) of each point; NaN where none is known."""
        return largest(padded(values, 0, self.point.size - values.size), self.point, len(self.ids))


def listed_rays(opened: Opened) -> ListedRays:
    """The image measurements as they are now."""
    block, by_hand = opened.block(), _rejected_by_hand(opened)
    network, solution = block.network, opened.now.solution
    rays = network.rays
    blunders = rays.rejected if solution is None else solution.rays_rejected
    state = np.where(block.used, 0, 3 if blunders is None else np.where(blunders, 2, 3))
    names = tuple(dict.fromkeys([*(image.name for image in network.images), *(image for _, image, *_ in by_hand)]))
    ids, points, others = network.points.ids, rays.point, np.zeros(0, dtype=np.int64)
    if by_hand:
        ids, (numbers, others) = Names.united([ids, Names.of([name for name, *_ in by_hand])])
        points = numbers[points]
    images = RepeatedNames.of([image for _, image, *_ in by_hand]).over(names)
    places = np.array([place for *_, place in by_hand]).reshape(-1, 2)
    return ListedRays(
        ids, names, np.concatenate([points, others]), np.concatenate([rays.image, images]),
        np.concatenate([rays.places, places]), np.concatenate([state, np.full(len(by_hand), _BY_HAND)]),
    )  # fmt: skip


def _rejected_by_hand(opened: Opened) -> list[tuple[str, str, tuple[float, float]]]:
    """Point, image, line and sample of each measurement that users have rejected."""
    if opened.kind != "project":
        return []
    with open_project(opened.path) as project:
        images = set(project.store.image_names())
        return [
            (point, image, (measure.line, measure.sample))
            for point, of in project.standing_decisions().items()
            for image, measure in of.rejected.items()
            if image in images
        ]


# --- columns that take long


class Matches(NamedTuple):
    """How well the chips of each point match, (n,) of all points; NaN where unknown."""

    correlation: Array
    """Lowest of its measurements, with the first one."""
    misfit: Array
    """px, of its rays, less that of its neighbors where there are enough."""
    offset: Array
    """px, of the best match from the measurement, the largest."""


def matches(opened: Opened) -> Matches:
    """Compare the chips of all tie points that two images with pixels show."""
    block, files = opened.block(), opened.pictures
    network, points, rays = block.network, block.network.points, block.network.rays
    names = [image.name for image in network.images]
    every = TiePoints(str(opened.path), points.ids, points.kinds, points.places, points.covariances, rays.point,
                      RepeatedNames(tuple(names), rays.image), rays.places, network.ray_sigmas)  # fmt: skip
    pictured = every.with_measures(np.array([files.get(name) is not None for name in names])[rays.image])
    seen = np.bincount(pictured.measure_point, minlength=len(points))
    chosen = np.flatnonzero((points.classes == PointClass.TIE) & (seen > 1))
    ties = pictured.chosen(chosen)
    frames = chip_frames(network.images, ties)
    alike, beside = likeness(_pixels(opened), ties, frames), misfit_beside_neighbours(frames, ties)
    found = np.full((3, len(points)), np.nan)
    found[0, chosen] = -largest(-alike.correlation, ties.measure_point, chosen.size)
    found[1, chosen] = np.where(np.isfinite(beside), np.abs(beside), frames.skew_pixels)
    found[2, chosen] = largest(np.hypot(*alike.shift.T), ties.measure_point, chosen.size)
    return Matches(*found)


def _pixels(opened: Opened) -> Callable[[int], Pixels]:
    """Pixels of an image by its number; those of some images are kept."""

    @lru_cache(_KEPT_PICTURES)
    def read(number: int) -> Pixels:
        image = opened.block().images[number]
        path = opened.pictures[image.name]
        assert path is not None
        pixels, size = read_picture(path), (image.lines, image.samples)
        require(pixels.shape == size, str(path), f"pixels of shape {pixels.shape}", f"{size}, as image {image.name}")
        return pixels

    return read


GROUPS = {
    "residuals": Group("residuals", ray_residuals, 2**62),
    "tests": Group("w-tests and redundancy", ray_tests, 100_000),
    "matches": Group("correlation of the chips", lambda opened: opened.once("matches", lambda: matches(opened)), 2_000),
}  # fmt: skip


def _possible(opened: Opened) -> list[str]:
    pictures = sum(path is not None for path in opened.pictures.values())
    has = {"residuals": True, "tests": opened.now.posterior is not None, "matches": pictures > 1}
    return [name for name, is_possible in has.items() if is_possible]


def _computed(opened: Opened) -> set[str]:
    """Groups whose columns are in the tables of this state."""
    return opened.once("groups of lists", lambda: {"residuals"} if opened.now.solution is not None else set())


def compute(opened: Opened, group: str) -> dict[str, Any]:
    """Compute the columns of a group; returns when the tables have them."""
    require(group in _possible(opened), "request, group", repr(group)[:60], f"one of {', '.join(_possible(opened))}")
    ready = _computed(opened)
    GROUPS[group].compute(opened)
    ready.add(group)
    return {"revision": opened.revision}


# --- tables


def _points(opened: Opened, rays: ListedRays) -> list[Column]:
    points, ready = map_points(opened), _computed(opened)
    block, count = points.block, len(rays.ids)
    more = count - len(points.classes)
    kinds = np.pad(block.network.points.kinds, (0, more), constant_values=int(PointKind.FREE))
    classes = np.pad(points.classes, (0, more), constant_values=int(PointClass.TIE))
    used = np.bincount(rays.point[rays.state == 0], minlength=count)
    columns = [
        Column("id", rays.ids), Column("class", RepeatedNames(tuple(CLASSES), classes)),
        Column("kind", RepeatedNames(tuple(kind.name.lower() for kind in PointKind), kinds)),
        Column("images", used, meaning="image measurements that are used"),
        Column("rejected", np.bincount(rays.point[rays.rejected], minlength=count), meaning="image measurements"),
    ]  # fmt: skip
    if "residuals" in ready:
        residuals = ray_residuals(opened)
        with np.errstate(invalid="ignore"):
            in_sigmas = np.linalg.norm(residuals / block.network.ray_sigmas, axis=1)
        columns += [
            Column("residual", rays.per_point(np.linalg.norm(residuals, axis=1)), "px", "largest of the point"),
            Column("residual_sigmas", rays.per_point(in_sigmas), head="residual / sigma", meaning="largest of the point"),
        ]
    if "tests" in ready:
        columns += [Column("w", rays.per_point(ray_tests(opened)[0]), head="|w|", meaning="largest w-test")]
    if "matches" in ready:
        of_chips = GROUPS["matches"].compute(opened)
        assert isinstance(of_chips, Matches)
        columns += [
            Column("correlation", padded(of_chips.correlation, 0, more), meaning="of the chips, lowest of the point"),
            Column("misfit", padded(of_chips.misfit, 0, more), "px", "of the rays, less that of neighbors"),
            Column("offset", padded(of_chips.offset, 0, more), "px", "of the best match of chips, largest"),
        ]
    sigmas = [np.sqrt(points.local[:, axis, axis]) for axis in range(3)]
    values = {"sigma": points.value("sigma"), **dict(zip(("sigma_east", "sigma_north", "sigma_up"), sigmas, strict=True))}
    values["correction"] = np.linalg.norm(points.moved, axis=1)
    columns += [Column(key, padded(of_points, 0, more), "m") for key, of_points in values.items()]
    return columns


def _measurements(opened: Opened, rays: ListedRays) -> list[Column]:
    more, ready = rays.point.size - opened.block().network.rays.point.size, _computed(opened)
    columns = [
        Column("point", rays.ids[rays.point]), Column("image", RepeatedNames(rays.images, rays.image)),
        Column("state", RepeatedNames(_STATES, rays.state)),
        Column("line", rays.places[:, 0], "px"), Column("sample", rays.places[:, 1], "px"),
    ]  # fmt: skip
    if "residuals" in ready:
        residuals = ray_residuals(opened)
        in_sigmas = np.linalg.norm(residuals / opened.block().network.ray_sigmas, axis=1)
        columns += [
            Column("residual_line", padded(residuals[:, 0], 0, more), "px"),
            Column("residual_sample", padded(residuals[:, 1], 0, more), "px"),
            Column("residual_sigmas", padded(in_sigmas, 0, more), head="residual / sigma"),
        ]
    if "tests" in ready:
        test, redundancy = ray_tests(opened)
        columns += [
            Column("w", padded(test, 0, more), head="|w|", meaning="larger w-test of line and sample"),
            Column("redundancy", padded(redundancy, 0, more), meaning="smaller one of line and sample"),
        ]
    return columns


def _grouped(opened: Opened, rays: ListedRays, group: Index, count: int) -> list[Column]:
    """Columns of image measurements by groups: (k,) number of the group of each, -1 for none."""
    ready, network = _computed(opened), opened.block().network.rays
    in_use = np.flatnonzero((rays.state == 0) & (group >= 0))
    columns = [Column("measurements", np.bincount(group[in_use], minlength=count), meaning="used")]
    if "residuals" in ready:
        squares = ray_residuals(opened)[in_use] ** 2
        for axis, name in enumerate(("line", "sample")):
            known = np.isfinite(squares[:, axis])
            numbers = np.bincount(group[in_use[known]], minlength=count)
            total = np.bincount(group[in_use[known]], squares[known, axis], minlength=count)
            with np.errstate(invalid="ignore"):
                columns += [Column(f"rms_{name}", np.sqrt(total / numbers), "px", "of the residuals", head=f"rms {name}")]
    if "tests" in ready:
        of_block = group[: network.point.size]
        seen = np.flatnonzero(of_block >= 0)
        columns += [Column("w", largest(ray_tests(opened)[0][seen], of_block[seen], count), head="|w|",
                           meaning="largest w-test")]  # fmt: skip
    rejected = group[rays.rejected]
    return [*columns, Column("rejected", np.bincount(rejected[rejected >= 0], minlength=count))]


def _corrections(block: Block) -> Array:
    """(m, 2) m and rad, size of each image's correction at its middle line; NaN without one."""
    sizes = np.full((len(block.images), 2), np.nan)
    for j, (image, correction) in enumerate(zip(block.images, block.corrections, strict=True)):
        if correction is not None:
            values = correction.at(image.moments(np.array([0.5 * image.lines])))[0][0]
            sizes[j] = np.linalg.norm(values[:3]), np.linalg.norm(values[3:])
    return sizes


def _images(opened: Opened, rays: ListedRays) -> list[Column]:
    sizes = opened.once("corrections", lambda: _corrections(opened.block()))
    more = len(rays.images) - len(sizes)
    pixels = np.array([opened.pictures.get(name) is not None for name in rays.images], dtype=np.int64)
    return [
        Column("image", Names.of(rays.images)), *_grouped(opened, rays, rays.image, len(rays.images)),
        Column("shift", padded(sizes[:, 0], 0, more), "m", "correction of the position at the middle line"),
        Column("angle", padded(sizes[:, 1], 0, more), "arcsec", "correction of the rotation at the middle line"),
        Column("pixels", RepeatedNames(("no", "yes"), pixels)),
    ]  # fmt: skip


def _passes(opened: Opened, rays: ListedRays) -> list[Column]:
    passes = opened.block().network.passes
    number = np.full(len(rays.images), -1)
    for k, one in enumerate(passes):
        number[one.images] = k
    return [
        Column("pass", Names.of([one.name for one in passes])),
        Column("images", np.array([one.images.size for one in passes], dtype=np.int64)),
        *_grouped(opened, rays, number[rays.image], len(passes)),
    ]  # fmt: skip


def _profiles(opened: Opened, _: ListedRays) -> list[Column]:
    block, solution = opened.block(), opened.now.solution
    profiles = laser_profiles(block)
    ranges, shifts = block.network.ranges, block.network.shifts
    values = np.full((len(profiles), 4), np.nan)
    for k, (name, points) in enumerate(profiles):
        rows = np.flatnonzero(np.isin(ranges.point, points))
        if solution is not None and rows.size:
            of_profile = np.stack([solution.range_residuals_before[rows], solution.range_residuals[rows]])
            values[k, :2] = np.sqrt(np.nanmean(of_profile**2, axis=1))
        if block.values is not None and shifts is not None and name in shifts.names:
            east, north = block.values[len(block.images) + shifts.names.index(name)][:2]
            ends = block.network.points.places[points[[0, -1]]]
            track = (east_north_up(ends[:1])[0] @ (ends[1] - ends[0]))[:2]
            along = track / max(float(np.linalg.norm(track)), 1e-9)
            values[k, 2:] = east * along[0] + north * along[1], north * along[0] - east * along[1]
    of_ranges = {"rms_before": "of the ranges' residuals", "rms_after": "of the ranges' residuals"}
    meanings = {**of_ranges, "shift_along": "along the track", "shift_across": "across it, to the left"}
    return [
        Column("profile", Names.of([name for name, _ in profiles])),
        Column("shots", np.array([points.size for _, points in profiles], dtype=np.int64)),
        *(Column(key, values[:, k], "m", meaning) for k, (key, meaning) in enumerate(meanings.items())),
    ]  # fmt: skip


_TABLES: dict[str, Callable[[Opened, ListedRays], list[Column]]] = {
    "points": _points, "measurements": _measurements, "images": _images, "passes": _passes, "profiles": _profiles,
}  # fmt: skip


def table(opened: Opened, name: str) -> Table:
    """One of the lists, all of its rows; of points with verdicts and notes, where there may be some."""
    require(name in _TABLES, "request, table", repr(name)[:60], f"one of {', '.join(_TABLES)}")
    rays = opened.once("listed rays", lambda: listed_rays(opened))

    def make() -> Table:
        return Table(name, name, tuple(_TABLES[name](opened, rays)))

    found = opened.once(f"list {name} {sorted(_computed(opened))}", make)
    if name != "points" or opened.judging is None:
        return found
    judged, verdicts = opened.once("judged", dict[Verdicts, list[Column]]), opened.judging.verdicts
    if verdicts not in judged:
        judged.clear()
        judged[verdicts] = [Column("verdict", _given(rays.ids, verdicts.of)), Column("note", _given(rays.ids, verdicts.notes))]
    return replace(found, columns=(*found.columns[:3], *judged[verdicts], *found.columns[3:]))


def _given(ids: Names, texts: Mapping[str, str]) -> RepeatedNames:
    """(n,) text of each point, empty for those without one."""
    labels = tuple(dict.fromkeys(["", *texts.values()]))
    rows, numbers = ids.find(list(texts)) if texts else np.zeros(0, dtype=np.int64), np.zeros(len(ids), dtype=np.int64)
    chosen = np.array([labels.index(text) for text in texts.values()], dtype=np.int64)
    numbers[rows[rows >= 0]] = chosen[rows >= 0]
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
        while len(views) >= _KEPT_VIEWS:
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


def _meets(values: Any, condition: str) -> Array:
    """(n,) whether texts contain a text, or are it after `=`; whether numbers meet a condition such as `> 3`."""
    if isinstance(values, RepeatedNames):
        return np.asarray(_meets(Names.of(values.distinct), condition)[values.numbers])
    if isinstance(values, Names):
        whole, wanted = condition.startswith("="), condition.removeprefix("=").strip().casefold()
        texts = map(str.casefold, values)
        return np.fromiter((text == wanted if whole else wanted in text for text in texts), bool, len(values))
    match = _CONDITION.fullmatch(condition)
    if match is None:
        raise InputError("filter", repr(condition)[:60], "a condition such as > 3 or <= 0.5")
    with np.errstate(invalid="ignore"):
        return np.asarray(_COMPARED[match[1] or "="](values, float(match[2])))


# --- answers


def window(opened: Opened, query: Mapping[str, str]) -> dict[str, Any]:
    """Some rows of a list as JSON: `first` and `count` say which of its order, `find` a point whose row is wanted."""
    shown = table(opened, query.get("table", "points"))
    rows = rows_of(opened, shown, query)
    first = int(min(max(number_of(query, "first", 0.0), 0.0), rows.size))
    part = shown.take(rows[first : first + min(int(number_of(query, "count", 0.0)), MOST_ROWS)])
    missing = [name for name in _possible(opened) if name not in _computed(opened)]
    size = opened.block().network.rays.point.size
    return {
        "revision": opened.revision, "total": len(shown), "count": int(rows.size), "first": first,
        "at": _position(opened, shown.name, rows, query["find"]) if query.get("find") else None,
        "columns": [{"key": one.key, "title": one.head or one.key.replace("_", " "), "unit": one.unit,
                     "meaning": one.meaning, "decimals": _decimals(opened, shown.name, one)} for one in shown.columns],
        "rows": list(zip(*map(_cells, part.columns), strict=True)),
        "missing": [{"group": name, "title": GROUPS[name].title, "at_once": size <= GROUPS[name].at_once}
                    for name in missing],
    }  # fmt: skip


def _decimals(opened: Opened, name: str, column: Column) -> int | None:
    """Decimals with which most numbers of a column have three digits or more; None of texts."""
    values = column.scaled
    if not isinstance(values, np.ndarray) or values.dtype.kind != "f":
        return 0 if isinstance(values, np.ndarray) else None

    def make() -> int:
        sizes = np.abs(values[np.isfinite(values) & (values != 0.0)])
        return int(np.clip(2.0 - np.floor(np.log10(np.median(sizes))), 0.0, 6.0)) if sizes.size else 0

    return opened.once(f"decimals {name} {column.key}", make)


def _cells(column: Column) -> Sequence[Any]:
    values = column.scaled
    if isinstance(values, np.ndarray):
        return digits(values) if values.dtype.kind == "f" else values.tolist()
    return list(values)


def _position(opened: Opened, name: str, rows: Index, point: str) -> int | None:
    """Where a point is in an order: its first row; None where it has none."""
    rays = opened.once("listed rays", lambda: listed_rays(opened))
    (number,) = rays.ids.find([point]).tolist()
    places = np.flatnonzero((rays.point[rows] if name == "measurements" else rows) == number)
    return int(places[0]) if places.size else None


def csv_of(opened: Opened, query: Mapping[str, str]) -> str:
    """All rows of a list that meet conditions, in an order, as CSV."""
    shown, file = table(opened, query.get("table", "points")), io.StringIO()
    shown.take(rows_of(opened, shown, query)).write_csv(file)
    return file.getvalue()

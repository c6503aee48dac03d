"""The state of an incremental adjustment in a project's file: like `InMemory`, on an open connection."""

import json
import sqlite3
from collections import OrderedDict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from functools import lru_cache
from typing import Any

import numpy as np

from mgsgraph.adjustment.incremental.state import Bundle, Bundles, ReducedSystem, Shared
from mgsgraph.errors import InputError, require
from mgsgraph.files.output.folders import PROJECT
from mgsgraph.geometry.records import Array, Index
from mgsgraph.geometry.terrain import TerrainGrid
from mgsgraph.names import Names
from mgsgraph.network import TERRAIN, ImageRays, Network, ProfileShifts, Ranges, Surface
from mgsgraph.network.joining import Definitions, NamedPass, NamedShared, with_definitions
from mgsgraph.network.parts import KnownImage, Members, Unknown, image_columns
from mgsgraph.project.columns import Cells, StoredGrids, StoredPoints, index_among
from mgsgraph.project.connection import RESTORE_COPY, with_read_errors
from mgsgraph.results.archive import pack, unpack

_REDUCED = ("unknowns", "at", "normal", "gradient", "cost", "slack")
"""Columns of a reduced system; NULL in a bundle that has none."""
_BUNDLE = (
    "id", "points", "rays", "ranges",
    "terrain", "terrain_shift_sigma", "terrain_considered", "areoid", *_REDUCED,
)  # fmt: skip
_CACHED_BUNDLES = 100
"""Number of bundles in memory: a change reads the same bundles several times."""
_CACHED_MEMBERS = 1 << 16
"""Number of bundles whose decoded members stay in memory: a change reads those of all bundles several times."""
_COMMON: dict[str, Any] = {"passes": NamedPass, "shared": NamedShared}
"""Records of passes and of unknowns that images share, by kind."""
_SHARED = ("prior", "motion", "ground", "value", "covariance")


@with_read_errors
class ProjectStore:
    """Implements `mgsgraph.adjustment.incremental.state.StateStore`.

    Images and terrain grids are read once: later calls return the same object.
    """

    def __init__(self, connection: sqlite3.Connection, where: str) -> None:
        self._connection, self._where = connection, where
        self._cells = Cells(connection)
        self._images = dict[str, KnownImage]()
        self._grids = StoredGrids(connection, where)
        self._bundles: OrderedDict[Members, Bundle] = OrderedDict()
        self._definitions: Definitions | None = None
        self._names: tuple[Names, Index, Index] | None = None

    # --- images

    def image_names(self) -> list[str]:
        """Names of all images, in the order of addition."""
        return [name for (name,) in self._ask("SELECT name FROM image ORDER BY id")]

    def image(self, name: str) -> KnownImage:
        """An image by its name."""
        if name not in self._images:
            (record,) = self._row("SELECT record FROM image WHERE name = ?", name)
            known = unpack(record, KnownImage, f"{self._where}, image {name}")
            self._require(known.image.name == name, f"the image {name} is called {known.image.name}")
            self._images[name] = known
        return self._images[name]

    def add_image(self, known: KnownImage) -> None:
        """Add an image."""
        name = known.image.name
        self._connection.execute(
            "INSERT INTO image (name, held, record) VALUES (?, ?, ?) "
            "ON CONFLICT (name) DO UPDATE SET held = excluded.held, record = excluded.record",
            (name, int(known.held), pack(replace(known, held=bool(known.held)))),
        )
        self._images[name] = known

    def drop_image(self, name: str) -> None:
        """Delete an image; its bundles have been replaced before."""
        if not self._connection.execute("DELETE FROM image WHERE name = ?", (name,)).rowcount:
            raise KeyError(name)
        self._images.pop(name, None)

    # --- shared unknowns

    def shared(self) -> dict[Unknown, Shared]:
        """All adjusted unknowns."""
        rows = self._ask(f"SELECT kind, name, considered, {', '.join(_SHARED)} FROM shared ORDER BY id")
        return {Unknown(kind, name): _shared(bool(held), *blobs) for kind, name, held, *blobs in rows}

    def set_shared(self, shared: Mapping[Unknown, Shared]) -> None:
        """Add unknowns or replace their values."""
        columns = "considered", *_SHARED
        updates = ", ".join(f"{name} = excluded.{name}" for name in columns)
        self._connection.executemany(
            f"INSERT INTO shared (kind, name, {', '.join(columns)}) VALUES ({', '.join('?' * (2 + len(columns)))}) "
            f"ON CONFLICT (kind, name) DO UPDATE SET {updates}",
            [
                (*unknown, int(values.considered), *(getattr(values, name).tobytes() for name in _SHARED))
                for unknown, values in shared.items()
            ],
        )

    def drop_shared(self, unknowns: Iterable[Unknown]) -> None:
        """Delete unknowns."""
        for unknown in unknowns:
            if not self._connection.execute("DELETE FROM shared WHERE kind = ? AND name = ?", unknown).rowcount:
                raise KeyError(unknown)

    # --- passes and unknowns that images share

    def definitions(self) -> Definitions:
        """Passes and shared unknowns; read once."""
        if self._definitions is None:
            records = {kind: dict[str, Any]() for kind in _COMMON}
            for kind, name, record in self._ask("SELECT kind, name, record FROM common ORDER BY name"):
                records[kind][name] = unpack(record, _COMMON[kind], f"{self._where}, {kind} {name}")
            self._definitions = Definitions(**records)
        return self._definitions

    def set_definitions(self, known: Definitions) -> None:
        """Replace all passes and shared unknowns."""
        rows = [(kind, name, pack(record)) for kind in _COMMON for name, record in getattr(known, kind).items()]
        self._connection.execute("DELETE FROM common")
        self._connection.executemany("INSERT INTO common VALUES (?, ?, ?)", rows)
        self._definitions = known

    # --- bundles

    def members(self) -> list[Members]:
        """Members of all bundles."""
        return [_members(text) for (text,) in self._ask("SELECT members FROM bundle ORDER BY id")]

    def reduced(self) -> dict[Members, ReducedSystem]:
        """The reduced systems of all bundles that have one, without reading points."""
        rows = self._ask(f"SELECT members, {', '.join(_REDUCED)} FROM bundle WHERE unknowns IS NOT NULL ORDER BY id")
        systems = dict[Members, ReducedSystem]()
        for text, reduced_text, *rest in rows:
            members = _members(text)
            systems[members] = _reduced(members if reduced_text == text else _members(reduced_text), *rest)
        return systems

    def bundles_of(self, ids: Iterable[str]) -> dict[str, Members]:
        """The bundle of each of these points that is stored."""
        wanted_ids = list(ids)
        if self._names is None:  # cached: reading a million names is slow
            self._names = self._cells.names()
        names, bundles, sizes = self._names
        positions = Names.of(wanted_ids).find(names)
        is_wanted = np.flatnonzero(positions >= 0)
        owners = np.repeat(bundles, sizes)[is_wanted].tolist()
        members = {number: _members(text) for number, text in self._ask("SELECT id, members FROM bundle")}
        return {wanted_ids[k]: members[number] for k, number in zip(positions[is_wanted].tolist(), owners, strict=True)}

    def seen_by(self, image: str) -> list[Members]:
        """Bundles with points that have a ray or a range from an image."""
        rows = self._ask(
            "SELECT bundle.members FROM image JOIN bundle_image ON bundle_image.image = image.id "
            "JOIN bundle ON bundle.id = bundle_image.bundle WHERE image.name = ? ORDER BY bundle.id",
            image,
        )
        return [_members(text) for (text,) in rows]

    def bundle(self, members: Members) -> Bundle:
        """A bundle with its points; the same object while it is in the cache."""
        if members not in self._bundles:
            self._bundles[members] = self._read(members)
            if len(self._bundles) > _CACHED_BUNDLES:
                self._bundles.popitem(last=False)
        self._bundles.move_to_end(members)
        return self._bundles[members]

    def _read(self, members: Members) -> Bundle:
        row = self._row(f"SELECT {', '.join(_BUNDLE)} FROM bundle WHERE members = ?", _text(members))
        number, points, rays, ranges, terrain, shift_sigma, stays, areoid, *reduced = row
        surface = None if terrain is None else (self._grids.record(terrain, TerrainGrid), shift_sigma)
        names, numbers = self._images_of(number)
        network, points_read = self._network_of(
            number, names, numbers, {number: np.arange(len(names))}, surface,
            None if areoid is None else self._grids.record(areoid, TerrainGrid),
            [*self._considered_profiles, *([TERRAIN] if stays else [])],
        )  # fmt: skip
        self._require(
            (points, rays, ranges) == (len(points_read.points), network.rays.point.size, network.ranges.point.size),
            f"a bundle of other points or measures than it says ({_text(members)})",
        )
        system = None if reduced[0] is None else _reduced(_members(reduced[0]), *reduced[1:])
        return Bundle(network, system, points_read.places, points_read.covariances)

    def _network_of(
        self, bundle: int | None, names: Sequence[str], numbers: Index, images: Mapping[int, Index],
        terrain: tuple[TerrainGrid, float] | None, areoid: TerrainGrid | None, considered: Sequence[str],
    ) -> tuple[Network, StoredPoints]:  # fmt: skip
        """Network and stored points of one bundle, or of all; `images` are places in `names`, for each bundle."""
        points = self._cells.points(bundle)
        rays, ranges = (self._cells.rows(kind, bundle, points.runs, images) for kind in ("rays", "ranges"))
        surface = None if terrain is None else Surface(terrain[0], points.surface_sigmas, terrain[1])
        network = Network(
            *image_columns([self.image(name) for name in names]), points.points, ImageRays(*rays), Ranges(*ranges),
            self._shifts(points), surface, areoid,
            stereo=self._grids.stereo_control(bundle, points.runs, numbers, points.places),
        ).considering(considered)  # fmt: skip
        return with_definitions(network, self.definitions()), points

    def replace(self, removed: Iterable[Members], new: Bundles) -> None:
        """Delete bundles (`removed`) and store new ones."""
        self._names = None
        for members in removed:
            self._bundles.pop(members, None)
            self._drop(members)
        for members, bundle in new.items():
            self._insert(members, bundle)
        self._grids.delete_unused()

    def renew(self, bundles: Bundles) -> None:
        """Store new reduced systems and positions of bundles whose points stay the same."""
        for members, bundle in bundles.items():
            self._bundles.pop(members, None)
            text = _text(members)
            (number,) = self._row("SELECT id FROM bundle WHERE members = ?", text)
            self._cells.write(number, "adjusted", bundle.places, bundle.covariances)
            change = ", ".join(f"{name} = ?" for name in _REDUCED)
            row = (*_reduced_row(bundle.reduced), text)
            self._connection.execute(f"UPDATE bundle SET {change} WHERE members = ?", row)

    def _drop(self, members: Members) -> None:
        (number,) = self._row("SELECT id FROM bundle WHERE members = ?", _text(members))
        self._cells.delete(number)
        self._connection.execute("DELETE FROM bundle_image WHERE bundle = ?", (number,))
        self._connection.execute("DELETE FROM bundle WHERE id = ?", (number,))

    def _insert(self, members: Members, bundle: Bundle) -> None:
        network, connection = bundle.network, self._connection
        surface = network.surface
        (number,) = self._row("SELECT coalesce(max(seq), 0) + 1 FROM sqlite_sequence WHERE name = 'bundle'")
        images = self._numbers_of(tuple(network.image_names))
        points, rays, ranges = network.points, network.rays, network.ranges
        sigmas = np.full(len(points), np.inf) if surface is None else surface.sigmas
        self._cells.write_names(number, points.ids)
        self._cells.write(
            number, "points", points.classes, points.kinds, self._profiles(network), sigmas, points.places,
            points.covariances,
        )  # fmt: skip
        self._cells.write(number, "adjusted", bundle.places, bundle.covariances)
        self._cells.write(
            number, "rays", rays.point, rays.image, rays.places, rays.sigmas, rays.back_projected, rays.rejected
        )
        self._cells.write(
            number, "ranges", ranges.point, ranges.image, ranges.times, ranges.values, ranges.sigmas, ranges.rejected
        )
        self._grids.write_heights(number, network, images)
        connection.execute(
            f"INSERT INTO bundle (members, {', '.join(_BUNDLE)}) VALUES ({', '.join('?' * (1 + len(_BUNDLE)))})",
            (
                _text(members), number, len(points), rays.point.size, ranges.point.size,
                None if surface is None else self._grids.number(surface.grid),
                None if surface is None else surface.shift_sigma,
                int(TERRAIN in network.considered),
                None if network.areoid is None else self._grids.number(network.areoid),
                *_reduced_row(bundle.reduced),
            ),
        )  # fmt: skip
        connection.executemany(
            "INSERT INTO bundle_image (image, bundle, position) VALUES (?, ?, ?)",
            [(image, number, position) for position, image in enumerate(images.tolist())],
        )

    # --- the whole state

    def network(self) -> Network:
        """The whole state as one network: images in the order of addition, points bundle by bundle."""
        return self.as_network()[0]

    def as_network(self) -> tuple[Network, Array]:
        """The same network, and the adjusted positions (n, 3) in m of its points, NaN where undetermined."""
        names = self.image_names()
        numbers = self._numbers_of(tuple(names))
        images = self._images_by_bundle(numbers)
        network, points = self._network_of(None, names, numbers, images, self.terrain, self.areoid, self.considered)
        return network, points.places

    @property
    def considered(self) -> list[str]:
        """Names of considered (not estimated) shifts: of laser profiles and of the terrain model."""
        stays = self._ask("SELECT 1 FROM bundle WHERE terrain_considered LIMIT 1")
        return [*self._considered_profiles, *([TERRAIN] if stays else [])]

    @property
    def _considered_profiles(self) -> list[str]:
        return [name for (name,) in self._ask("SELECT name FROM profile WHERE considered ORDER BY id")]

    @property
    def terrain(self) -> tuple[TerrainGrid, float] | None:
        """The terrain model that serves as control and the a-priori sigma (m) of its shift; None without one."""
        rows = self._ask("SELECT DISTINCT terrain, terrain_shift_sigma FROM bundle WHERE terrain IS NOT NULL")
        require(len(rows) <= 1, self._where, f"{len(rows)} terrain models", "one for all points")
        return (self._grids.record(rows[0][0], TerrainGrid), rows[0][1]) if rows else None

    @property
    def areoid(self) -> TerrainGrid | None:
        """The areoid if heights refer to it, else None."""
        rows = self._ask("SELECT min(areoid) FROM bundle")
        return None if rows[0][0] is None else self._grids.record(rows[0][0], TerrainGrid)

    def grid_number(self, grid: TerrainGrid) -> int:
        """Number of a terrain grid in the file, where it is written unless it is there."""
        return self._grids.number(grid)

    def grid(self, number: int) -> TerrainGrid:
        """A terrain grid by its number."""
        return self._grids.record(number, TerrainGrid)

    def with_known_grids(self, network: Network) -> Network:
        """The network with stored terrain grids in place of equal ones, so that all bundles share one grid."""
        surface, areoid = network.surface, network.areoid
        if surface is not None:
            surface = replace(surface, grid=self._grids.stored_grid(surface.grid))
            if (known := self.terrain) is not None and known[0] is not surface.grid:
                found = "a terrain model that is not the project's, or another part of it"
                remedy = "leave [terrain] out: the project's serves its ties, too, as far as it reaches"
                raise InputError(surface.grid.source, found, "the project's own", remedy)
        return replace(network, surface=surface, areoid=None if areoid is None else self._grids.stored_grid(areoid))

    # --- numbers and names

    def point_classes(self) -> dict[int, int]:
        """Number of points of each class that has points (`mgsgraph.network.PointClass`)."""
        counts = np.zeros(128, dtype=np.int64)
        for _, size, (classes, *_) in self._cells.read("points", None):
            counts += np.bincount(classes, minlength=counts.size) if classes.strides[0] else 0
            counts[classes[0]] += 0 if classes.strides[0] else size
        return {number: count for number, count in enumerate(counts.tolist()) if count}

    def measures(self) -> tuple[int, int]:
        """Numbers of rays and of ranges."""
        (counts,) = self._ask("SELECT coalesce(sum(rays), 0), coalesce(sum(ranges), 0) FROM bundle")
        return counts[0], counts[1]

    def _images_of(self, bundle: int) -> tuple[list[str], Index]:
        rows = self._ask(
            "SELECT image.name, image.id FROM bundle_image JOIN image ON image.id = bundle_image.image "
            "WHERE bundle_image.bundle = ? ORDER BY position",
            bundle,
        )
        return [name for name, _ in rows], np.array([number for _, number in rows], dtype=np.int64)

    def _numbers_of(self, names: tuple[str, ...]) -> Index:
        return np.array([self._row("SELECT id FROM image WHERE name = ?", name)[0] for name in names], dtype=np.int64)

    def _images_by_bundle(self, numbers: Index) -> dict[int, Index]:
        """For each bundle the indices of its images in `numbers`."""
        rows = np.array(self._ask("SELECT bundle, image FROM bundle_image ORDER BY bundle, position"), dtype=np.int64)
        bundle, image = rows.reshape(-1, 2).T
        edges = np.flatnonzero(np.diff(bundle)) + 1
        parts = np.split(index_among(image, numbers), edges)
        return dict(zip(bundle[np.concatenate([[0], edges])].tolist(), parts, strict=True)) if bundle.size else {}

    def _profiles(self, network: Network) -> Index | None:
        """(n,) number of each point's profile in the table of profiles, 0 for none; writes new profiles."""
        if network.shifts is None:
            return None
        numbers = list[int]()
        for name, sigma in zip(network.shifts.names, network.shifts.sigmas.tolist(), strict=True):
            self._connection.execute(
                "INSERT INTO profile (name, sigma, considered) VALUES (?, ?, ?) "
                "ON CONFLICT (name) DO UPDATE SET sigma = excluded.sigma, considered = excluded.considered",
                (name, sigma, int(name in network.considered)),
            )
            numbers.append(self._row("SELECT id FROM profile WHERE name = ?", name)[0])
        return np.array([*numbers, 0], dtype=np.int64)[network.shifts.profile]  # -1, no profile, is the last one

    def _shifts(self, points_read: StoredPoints) -> ProfileShifts | None:
        used, profile = np.unique(points_read.profiles, return_inverse=True)
        if not np.any(used):
            return None
        start = int(used[0] == 0)
        rows = [self._row("SELECT name, sigma FROM profile WHERE id = ?", int(number)) for number in used[start:]]
        return ProfileShifts(tuple(name for name, _ in rows), profile - start, np.array([sigma for _, sigma in rows]))

    def require_whole(self) -> None:
        """Raise InputError if tables contradict each other: images of bundles, and shared unknowns."""
        stored_images = set(self._ask("SELECT bundle, name FROM bundle_image JOIN image ON image.id = image"))
        sizes = {Unknown(*name): size for *name, size in self._ask("SELECT kind, name, length(prior) FROM shared")}
        held = {Unknown("image", name) for (name,) in self._ask("SELECT name FROM image WHERE held")}
        for number, text, reduced_text, size in self._ask("SELECT id, members, unknowns, length(at) FROM bundle"):
            members, unknowns = _members(text), _members(reduced_text or "[]")
            images = {(number, unknown.name) for unknown in members if unknown.kind == "image"}
            self._require(images <= stored_images, f"a bundle lacks its images ({text})")
            lasting = {unknown for unknown in unknowns if unknown.kind != "node"}  # nodes follow the predicted lines
            self._require(lasting <= set(members), f"a bundle was reduced to others' unknowns ({text})")
            self._require(not held.intersection(unknowns), f"a bundle adjusts an image that is held ({text})")
            is_solved = all(unknown in sizes for unknown in unknowns)  # others wait for a solution
            is_consistent = not is_solved or sum(int(sizes[unknown]) for unknown in unknowns) == (size or 0)
            self._require(is_consistent, f"a bundle has other unknowns than there are ({text})")

    def _require(self, is_consistent: bool, found: str) -> None:
        """Raise InputError (damaged project) unless `is_consistent`."""
        require(is_consistent, self._where, f"{PROJECT} is damaged ({found})", remedy=RESTORE_COPY)

    def _ask(self, statement: str, *values: object) -> list[tuple[Any, ...]]:
        return self._connection.execute(statement, values).fetchall()

    def _row(self, statement: str, *values: object) -> tuple[Any, ...]:
        row: tuple[Any, ...] | None = self._connection.execute(statement, values).fetchone()
        if row is None:
            raise KeyError(*values)
        return row


def _text(members: Members) -> str:
    return json.dumps(members, ensure_ascii=False, separators=(",", ":"))


@lru_cache(_CACHED_MEMBERS)
def _members(text: str) -> Members:
    members = tuple(Unknown(kind, name) for kind, name in json.loads(text))
    if not all(isinstance(word, str) for unknown in members for word in unknown):
        raise ValueError("an unknown that is no pair of names")
    return members


def _float64(blob: bytes) -> Array:
    return np.frombuffer(blob, "<f8")


def _shared(considered: bool, prior: bytes, motion: bytes, ground: bytes, value: bytes, covariance: bytes) -> Shared:
    sigmas = _float64(prior)
    ground_motion, covariances = (_float64(blob).reshape(-1, sigmas.size) for blob in (ground, covariance))
    return Shared(sigmas, _float64(motion), ground_motion, _float64(value), covariances, considered)


def _reduced(unknowns: Members, at: bytes, normal: bytes, gradient: bytes, cost: float, slack: float) -> ReducedSystem:
    values, cost, slack = _float64(at), float(cost), float(slack)
    return ReducedSystem(unknowns, values, _float64(normal).reshape(values.size, -1), _float64(gradient), cost, slack)


def _reduced_row(reduced: ReducedSystem | None) -> tuple[object, ...]:
    if reduced is None:
        return (None,) * len(_REDUCED)
    arrays = (array.tobytes() for array in (reduced.at, reduced.normal, reduced.gradient))
    return _text(reduced.unknowns), *arrays, float(reduced.cost), float(reduced.slack)

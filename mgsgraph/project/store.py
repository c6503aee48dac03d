"""The state of an incremental adjustment in a project's file: what `InMemory` does, on an open connection."""

import json
import sqlite3
from collections import OrderedDict
from collections.abc import Iterable, Mapping
from dataclasses import replace
from functools import lru_cache
from typing import Any

import numpy as np

from mgsgraph.adjustment.incremental.state import Bundle, ReducedSystem, Shared
from mgsgraph.errors import InputError
from mgsgraph.files.output.folders import PROJECT
from mgsgraph.geometry.records import Array, Index
from mgsgraph.geometry.terrain import TerrainGrid
from mgsgraph.names import Names
from mgsgraph.network import TERRAIN, ImageRays, Network, ProfileShifts, Ranges, Surface
from mgsgraph.network.joining import Definitions, NamedPass, NamedShared, with_definitions
from mgsgraph.network.parts import KnownImage, Members, Unknown, image_columns
from mgsgraph.project.columns import Cells, StoredGrids, StoredPoints, index_among
from mgsgraph.project.connection import ELSEWHERE, guarded_readings
from mgsgraph.results.archive import pack, unpack

_REDUCED = ("unknowns", "at", "normal", "gradient", "cost", "slack")
"""Columns of a reduced system; NULL in a bundle that has none."""
_BUNDLE = (
    "id", "points", "rays", "ranges",
    "terrain", "terrain_shift_sigma", "terrain_considered", "areoid", *_REDUCED,
)  # fmt: skip
_AT_HAND = 100
"""Bundles that are kept after they were read: a change looks at the same ones several times."""
_TEXTS = 1 << 16
"""Members of bundles that are kept after their text was read: a change reads those of all bundles several times."""
_COMMON: dict[str, Any] = {"passes": NamedPass, "shared": NamedShared}
"""Records of passes and of unknowns that images share, by kind."""
_SHARED = ("prior", "motion", "ground", "value", "covariance")


@guarded_readings
class ProjectStore:
    """Implements `mgsgraph.adjustment.incremental.state.StateStore`.

    Images and terrain grids are read once and kept: what comes back twice is the same object.
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
        """All images, in the order in which they came."""
        return [name for (name,) in self._ask("SELECT name FROM image ORDER BY id")]

    def image(self, name: str) -> KnownImage:
        """An image by its name."""
        if name not in self._images:
            (record,) = self._one("SELECT record FROM image WHERE name = ?", name)
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
        """Take an image out; its bundles have been replaced before."""
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
        renewed = ", ".join(f"{name} = excluded.{name}" for name in columns)
        self._connection.executemany(
            f"INSERT INTO shared (kind, name, {', '.join(columns)}) VALUES ({', '.join('?' * (2 + len(columns)))}) "
            f"ON CONFLICT (kind, name) DO UPDATE SET {renewed}",
            [
                (*unknown, int(one.considered), *(getattr(one, name).tobytes() for name in _SHARED))
                for unknown, one in shared.items()
            ],
        )

    def drop_shared(self, unknowns: Iterable[Unknown]) -> None:
        """Take unknowns out."""
        for unknown in unknowns:
            if not self._connection.execute("DELETE FROM shared WHERE kind = ? AND name = ?", unknown).rowcount:
                raise KeyError(unknown)

    # --- passes and unknowns that images share

    def definitions(self) -> Definitions:
        """Passes and shared unknowns; read once and kept."""
        if self._definitions is None:
            found = {kind: dict[str, Any]() for kind in _COMMON}
            for kind, name, record in self._ask("SELECT kind, name, record FROM common ORDER BY name"):
                found[kind][name] = unpack(record, _COMMON[kind], f"{self._where}, {kind} {name}")
            self._definitions = Definitions(**found)
        return self._definitions

    def set_definitions(self, known: Definitions) -> None:
        """Take these in the place of all that there are."""
        rows = [(kind, name, pack(one)) for kind in _COMMON for name, one in getattr(known, kind).items()]
        self._connection.execute("DELETE FROM common")
        self._connection.executemany("INSERT INTO common VALUES (?, ?, ?)", rows)
        self._definitions = known

    # --- bundles

    def members(self) -> list[Members]:
        """Members of all bundles."""
        return [_members(text) for (text,) in self._ask("SELECT members FROM bundle ORDER BY id")]

    def reduced(self) -> dict[Members, ReducedSystem]:
        """The reduced systems of all bundles that have one, without any of their points."""
        rows = self._ask(
            f"SELECT members, {', '.join(_REDUCED)} FROM bundle WHERE unknowns IS NOT NULL ORDER BY id"
        )
        found = dict[Members, ReducedSystem]()
        for text, own, *rest in rows:
            members = _members(text)
            found[members] = _reduced(members if own == text else _members(own), *rest)
        return found

    def bundles_of(self, ids: Iterable[str]) -> dict[str, Members]:
        """For those of the points that are there: their bundle."""
        wanted = list(ids)
        if self._names is None:  # a change asks several times, and a million names take their time
            self._names = self._cells.names()
        names, bundles, sizes = self._names
        found = Names.of(wanted).find(names)
        there = np.flatnonzero(found >= 0)
        of_point = np.repeat(bundles, sizes)[there].tolist()
        members = {number: _members(text) for number, text in self._ask("SELECT id, members FROM bundle")}
        return {wanted[k]: members[number] for k, number in zip(found[there].tolist(), of_point, strict=True)}

    def seen_by(self, image: str) -> list[Members]:
        """Bundles with points that have a ray or a range from an image."""
        rows = self._ask(
            "SELECT bundle.members FROM image JOIN bundle_image ON bundle_image.image = image.id "
            "JOIN bundle ON bundle.id = bundle_image.bundle WHERE image.name = ? ORDER BY bundle.id",
            image,
        )
        return [_members(text) for (text,) in rows]

    def bundle(self, members: Members) -> Bundle:
        """A bundle with its points; of the last ones that were asked for, the same object."""
        if members not in self._bundles:
            self._bundles[members] = self._read(members)
            if len(self._bundles) > _AT_HAND:
                self._bundles.popitem(last=False)
        self._bundles.move_to_end(members)
        return self._bundles[members]

    def _read(self, members: Members) -> Bundle:
        row = self._one(f"SELECT {', '.join(_BUNDLE)} FROM bundle WHERE members = ?", _text(members))
        number, points, rays, ranges, terrain, shift_sigma, stays, areoid, *reduced = row
        surface = None if terrain is None else (self._grids.record(terrain, TerrainGrid), shift_sigma)
        names, numbers = self._images_of(number)
        read, places = self._cells.points(number), {number: np.arange(len(names))}
        known = [self.image(name) for name in names]
        network = Network(
            *image_columns(known),
            read.points,
            ImageRays(*self._cells.rows("rays", number, read.runs, places)),
            Ranges(*self._cells.rows("ranges", number, read.runs, places)),
            self._shifts(read),
            _surface(surface, read),
            None if areoid is None else self._grids.record(areoid, TerrainGrid),
            stereo=self._grids.control(number, read.runs, numbers, read.places),
        ).considering([*self._considered_profiles, *([TERRAIN] if stays else [])])
        network = with_definitions(network, self.definitions())
        self._require(
            (points, rays, ranges) == (len(read.points), network.rays.point.size, network.ranges.point.size),
            f"a bundle of other points or measures than it says ({_text(members)})",
        )
        system = None if reduced[0] is None else _reduced(_members(reduced[0]), *reduced[1:])
        return Bundle(network, system, read.places, read.covariances)

    def replace(self, gone: Iterable[Members], new: Mapping[Members, Bundle]) -> None:
        """Take bundles out and put others in, none of which is there."""
        self._names = None
        for members in gone:
            self._bundles.pop(members, None)
            self._drop(members)
        for members, bundle in new.items():
            self._put(members, bundle)
        self._grids.sweep()

    def renew(self, bundles: Mapping[Members, Bundle]) -> None:
        """New systems and places for bundles whose points are the same."""
        for members, bundle in bundles.items():
            self._bundles.pop(members, None)
            text = _text(members)
            (number,) = self._one("SELECT id FROM bundle WHERE members = ?", text)
            self._cells.put(number, "adjusted", bundle.places, bundle.covariances)
            change = ", ".join(f"{name} = ?" for name in _REDUCED)
            row = (*_reduced_row(bundle.reduced), text)
            self._connection.execute(f"UPDATE bundle SET {change} WHERE members = ?", row)

    def _drop(self, members: Members) -> None:
        (number,) = self._one("SELECT id FROM bundle WHERE members = ?", _text(members))
        self._cells.drop(number)
        self._connection.execute("DELETE FROM bundle_image WHERE bundle = ?", (number,))
        self._connection.execute("DELETE FROM bundle WHERE id = ?", (number,))

    def _put(self, members: Members, bundle: Bundle) -> None:
        network, connection = bundle.network, self._connection
        surface = network.surface
        (number,) = self._one("SELECT coalesce(max(seq), 0) + 1 FROM sqlite_sequence WHERE name = 'bundle'")
        images = self._numbers_of(tuple(image.name for image in network.images))
        points, rays, ranges = network.points, network.rays, network.ranges
        sigmas = np.full(len(points), np.inf) if surface is None else surface.sigmas
        self._cells.put_names(number, points.ids)
        self._cells.put(
            number, "points", points.classes, points.kinds, self._profiles(network), sigmas, points.places,
            points.covariances,
        )  # fmt: skip
        self._cells.put(number, "adjusted", bundle.places, bundle.covariances)
        self._cells.put(
            number, "rays", rays.point, rays.image, rays.places, rays.sigmas, rays.back_projected, rays.rejected
        )
        self._cells.put(
            number, "ranges", ranges.point, ranges.image, ranges.times, ranges.values, ranges.sigmas, ranges.rejected
        )
        self._grids.put_heights(number, network, images)
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

    # --- all of it

    def network(self) -> Network:
        """Everything as one network, images in the order in which they came, points bundle by bundle."""
        return self.as_network()[0]

    def as_network(self) -> tuple[Network, Array]:
        """The same, and the places (n, 3) in m of its points, NaN where undetermined."""
        names = self.image_names()
        numbers, known = self._numbers_of(tuple(names)), [self.image(name) for name in names]
        read, images = self._cells.points(None), self._images_by_bundle(numbers)
        network = Network(
            *image_columns(known),
            read.points,
            ImageRays(*self._cells.rows("rays", None, read.runs, images)),
            Ranges(*self._cells.rows("ranges", None, read.runs, images)),
            self._shifts(read),
            _surface(self.terrain, read),
            self.areoid,
            stereo=self._grids.control(None, read.runs, numbers, read.places),
        ).considering(self.considered)
        return with_definitions(network, self.definitions()), read.places

    @property
    def considered(self) -> list[str]:
        """Shifts that are not estimated: of profiles, and the terrain model's."""
        stays = self._ask("SELECT 1 FROM bundle WHERE terrain_considered LIMIT 1")
        return [*self._considered_profiles, *([TERRAIN] if stays else [])]

    @property
    def _considered_profiles(self) -> list[str]:
        return [name for (name,) in self._ask("SELECT name FROM profile WHERE considered ORDER BY id")]

    @property
    def terrain(self) -> tuple[TerrainGrid, float] | None:
        """The terrain model as control and the a-priori sigma (m) of its shift; None where there is none."""
        found = self._ask("SELECT DISTINCT terrain, terrain_shift_sigma FROM bundle WHERE terrain IS NOT NULL")
        if len(found) > 1:
            raise InputError(self._where, f"{len(found)} terrain models", "one for all points")
        return (self._grids.record(found[0][0], TerrainGrid), found[0][1]) if found else None

    @property
    def areoid(self) -> TerrainGrid | None:
        """The areoid, where heights are to be above it."""
        found = self._ask("SELECT min(areoid) FROM bundle")
        return None if found[0][0] is None else self._grids.record(found[0][0], TerrainGrid)

    def with_known_grids(self, network: Network) -> Network:
        """The network with this store's terrain grids in place of equal ones: parts of one network share one grid."""
        surface, areoid = network.surface, network.areoid
        if surface is not None:
            surface = replace(surface, grid=self._grids.equal(surface.grid))
            if (known := self.terrain) is not None and known[0] is not surface.grid:
                found = "a terrain model that is not the project's, or another part of it"
                remedy = "leave [terrain] out: the project's serves its ties, too, as far as it reaches"
                raise InputError(surface.grid.source, found, "the project's own", remedy)
        return replace(network, surface=surface, areoid=None if areoid is None else self._grids.equal(areoid))

    # --- numbers and names

    def point_classes(self) -> dict[int, int]:
        """Number of points of each class that there is (`mgsgraph.network.PointClass`)."""
        found = np.zeros(128, dtype=np.int64)
        for _, size, (classes, *_) in self._cells.read("points", None):
            found += np.bincount(classes, minlength=found.size) if classes.strides[0] else 0
            found[classes[0]] += 0 if classes.strides[0] else size
        return {number: count for number, count in enumerate(found.tolist()) if count}

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
        return np.array([self._one("SELECT id FROM image WHERE name = ?", name)[0] for name in names], dtype=np.int64)

    def _images_by_bundle(self, numbers: Index) -> dict[int, Index]:
        """Of each bundle, the places of its images among those of some `numbers`."""
        rows = np.array(self._ask("SELECT bundle, image FROM bundle_image ORDER BY bundle, position"), dtype=np.int64)
        bundle, image = rows.reshape(-1, 2).T
        edges = np.flatnonzero(np.diff(bundle)) + 1
        parts = np.split(index_among(image, numbers), edges)
        return dict(zip(bundle[np.concatenate([[0], edges])].tolist(), parts, strict=True)) if bundle.size else {}

    def _profiles(self, network: Network) -> Index | None:
        """(n,) number of each point's profile in its table, 0 for none; unknown profiles are written."""
        if network.shifts is None:
            return None
        numbers = list[int]()
        for name, sigma in zip(network.shifts.names, network.shifts.sigmas.tolist(), strict=True):
            self._connection.execute(
                "INSERT INTO profile (name, sigma, considered) VALUES (?, ?, ?) "
                "ON CONFLICT (name) DO UPDATE SET sigma = excluded.sigma, considered = excluded.considered",
                (name, sigma, int(name in network.considered)),
            )
            numbers.append(self._one("SELECT id FROM profile WHERE name = ?", name)[0])
        return np.array([*numbers, 0], dtype=np.int64)[network.shifts.profile]  # -1, no profile, is the last one

    def _shifts(self, read: StoredPoints) -> ProfileShifts | None:
        used, profile = np.unique(read.profiles, return_inverse=True)
        if not np.any(used):
            return None
        first = int(used[0] == 0)
        rows = [self._one("SELECT name, sigma FROM profile WHERE id = ?", int(number)) for number in used[first:]]
        return ProfileShifts(tuple(name for name, _ in rows), profile - first, np.array([sigma for _, sigma in rows]))

    def require_whole(self) -> None:
        """Raise InputError where tables contradict each other: images that bundles depend on, and shared unknowns."""
        seen = set(self._ask("SELECT bundle, name FROM bundle_image JOIN image ON image.id = image"))
        sizes = {Unknown(*name): size for *name, size in self._ask("SELECT kind, name, length(prior) FROM shared")}
        held = {Unknown("image", name) for (name,) in self._ask("SELECT name FROM image WHERE held")}
        for number, text, own, size in self._ask("SELECT id, members, unknowns, length(at) FROM bundle"):
            members, unknowns = _members(text), _members(own or "[]")
            images = {(number, unknown.name) for unknown in members if unknown.kind == "image"}
            self._require(images <= seen, f"a bundle lacks its images ({text})")
            stay = {unknown for unknown in unknowns if unknown.kind != "node"}  # nodes follow the predicted lines
            self._require(stay <= set(members), f"a bundle was reduced to others' unknowns ({text})")
            self._require(not held.intersection(unknowns), f"a bundle adjusts an image that is held ({text})")
            solved = all(unknown in sizes for unknown in unknowns)  # others wait for a solution
            right = not solved or sum(int(sizes[unknown]) for unknown in unknowns) == (size or 0)
            self._require(right, f"a bundle has other unknowns than there are ({text})")

    def _require(self, good: bool, found: str) -> None:
        """Raise InputError unless `good`: tables contradict each other."""
        if not good:
            raise InputError(self._where, f"{PROJECT} is damaged ({found})", remedy=ELSEWHERE)

    def _ask(self, statement: str, *values: object) -> list[tuple[Any, ...]]:
        return self._connection.execute(statement, values).fetchall()

    def _one(self, statement: str, *values: object) -> tuple[Any, ...]:
        row: tuple[Any, ...] | None = self._connection.execute(statement, values).fetchone()
        if row is None:
            raise KeyError(*values)
        return row


def _text(members: Members) -> str:
    return json.dumps(members, ensure_ascii=False, separators=(",", ":"))


@lru_cache(_TEXTS)
def _members(text: str) -> Members:
    found = tuple(Unknown(kind, name) for kind, name in json.loads(text))
    if not all(isinstance(word, str) for unknown in found for word in unknown):
        raise ValueError("an unknown that is no pair of names")
    return found


def _surface(terrain: tuple[TerrainGrid, float] | None, read: StoredPoints) -> Surface | None:
    return None if terrain is None else Surface(terrain[0], read.surface_sigmas, terrain[1])


def _vector(blob: bytes) -> Array:
    return np.frombuffer(blob, "<f8")


def _shared(considered: bool, prior: bytes, motion: bytes, ground: bytes, value: bytes, covariance: bytes) -> Shared:
    sigmas = _vector(prior)
    two = [_vector(blob).reshape(-1, sigmas.size) for blob in (ground, covariance)]
    return Shared(sigmas, _vector(motion), two[0], _vector(value), two[1], considered)


def _reduced(unknowns: Members, at: bytes, normal: bytes, gradient: bytes, cost: float, slack: float) -> ReducedSystem:
    place, cost, slack = _vector(at), float(cost), float(slack)
    return ReducedSystem(unknowns, place, _vector(normal).reshape(place.size, -1), _vector(gradient), cost, slack)


def _reduced_row(reduced: ReducedSystem | None) -> tuple[object, ...]:
    if reduced is None:
        return (None,) * len(_REDUCED)
    arrays = (array.tobytes() for array in (reduced.at, reduced.normal, reduced.gradient))
    return _text(reduced.unknowns), *arrays, float(reduced.cost), float(reduced.slack)

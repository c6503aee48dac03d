"""States of an incremental adjustment for the tests of its stores: random ones, and how two of them compare."""

import hashlib
import shutil
from collections.abc import Iterator, Mapping
from dataclasses import fields, is_dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from networks import network, pair, with_shift_and_surface

from mgsgraph.adjustment.incremental.state import Bundle, ReducedSystem, Shared, StateStore
from mgsgraph.network import Network
from mgsgraph.network.parts import KnownImage, Members, Unknown, bundles, select_points
from mgsgraph.project.project import open_project
from mgsgraph.results.archive import pack

ODD = (0.0, -0.0, 5e-324, -1.7976931348623157e308, 1e-17, np.nextafter(1.0, 2.0), 3.0)
"""Numbers that a careless store would change."""


class StopHere(Exception):
    """What a test breaks a change off with."""


@cache
def four_images() -> Network:
    """The simulated pair with a twin of each image (same geometry, own name), its measures dealt out at random: ties in
    four bundles, laser points with a profile's shift, ties on a terrain model (both considered), one held image.
    """
    net = with_shift_and_surface(network(pair(ties=24, shots=9)))
    twins = tuple(replace(image, name=f"{image.name}'") for image in net.images)
    rng = np.random.default_rng(5)
    image = net.rays.image + 2 * rng.integers(0, 2, net.rays.image.size)
    rays = replace(net.rays, image=image, back_projected=rng.random(image.size) < 0.2)
    return replace(
        net, images=(*net.images, *twins), priors=(*net.priors, *net.priors), rays=rays,
        held=np.array([False, False, False, True]), considered=net.shift_names,
    )  # fmt: skip


def images() -> list[KnownImage]:
    net = four_images()
    return [KnownImage(i, p, bool(h)) for i, p, h in zip(net.images, net.priors, net.held, strict=True)]


def odd(rng: np.random.Generator, *shape: int) -> np.ndarray:
    """Numbers of all sizes, some of them odd."""
    values = rng.normal(size=shape) * 10.0 ** rng.uniform(-12, 12, shape)
    return np.where(rng.random(shape) < 0.1, rng.choice(ODD, shape), values)


def shared_of(rng: np.random.Generator, size: int) -> Shared:
    shape = {"prior": (size,), "motion": (size,), "ground": (3, size), "value": (size,), "covariance": (size, size)}
    return Shared(**{name: odd(rng, *one) for name, one in shape.items()}, considered=bool(rng.random() < 0.5))


def bundle_of(rng: np.random.Generator, members: Members, net: Network) -> Bundle:
    """Any numbers for what an adjustment would have found."""
    n, d = len(net.points), sum(18 if unknown.kind == "image" else 2 for unknown in members)
    reduced = None
    if members and rng.random() < 0.8:
        slack = float(rng.choice([np.inf, 0.0, 0.25]))
        reduced = ReducedSystem(members, odd(rng, d), odd(rng, d, d), odd(rng, d), float(odd(rng, 1)[0]), slack)
    places, covariances = odd(rng, n, 3), odd(rng, n, 3, 3)
    lost = rng.random(n) < 0.2
    places[lost], covariances[lost] = np.nan, np.nan
    return Bundle(net, reduced, places, covariances)


def change(store: StateStore, seed: int) -> None:
    """One random change, the same for the same seed and state."""
    rng, net = np.random.default_rng(seed), four_images()
    there = set(store.image_names())
    if len(there) < 4 or rng.random() < 0.1:
        for known in images():
            store.add_image(known)
    members = store.members()
    gone = [one for one in members if rng.random() < 0.6]
    free = set(range(len(net.points)))
    kept = [store.bundle(one).network.points.ids for one in members if one not in gone]
    free -= {net.points.ids.index(name) for ids in kept for name in ids}
    chosen = np.array(sorted(i for i in free if rng.random() < 0.7), dtype=np.int64)
    rng.shuffle(chosen)
    found = bundles(select_points(net, chosen)) if chosen.size else {}
    new = {one: bundle_of(rng, one, network) for one, network in found.items() if one not in members or one in gone}
    store.replace(gone, new)
    felt = {unknown for one in new for unknown in one}
    store.set_shared({unknown: shared_of(rng, 18 if unknown.kind == "image" else 2) for unknown in sorted(felt)})
    adjusted = sorted(store.shared())
    if adjusted and rng.random() < 0.3:
        store.drop_shared([adjusted[int(rng.integers(len(adjusted)))]])


def contents(store: StateStore) -> Iterator[tuple[str, Any]]:
    """Everything that a store says, in a form that can be compared bit by bit."""
    yield "images", tuple(store.image_names())
    for name in store.image_names():
        yield f"image {name}", pack(store.image(name))
        yield f"seen by {name}", tuple(store.seen_by(name))
    for unknown, one in sorted(store.shared().items()):
        yield from leaves(f"shared {unknown}", one)
    reduced = store.reduced()
    yield "reduced", tuple(reduced)
    yield "members", tuple(store.members())
    for members in store.members():
        bundle = store.bundle(members)
        yield from leaves(f"bundle {members}", bundle)
        if bundle.reduced is not None:
            yield from leaves(f"reduced {members}", reduced[members])
        ids = bundle.network.points.ids
        yield f"bundles of {members}", store.bundles_of([*ids, "nowhere"]) == dict.fromkeys(ids, members)


def leaves(where: str, value: Any) -> Iterator[tuple[str, Any]]:
    """What is in a record, bit by bit, with the path to it."""
    if isinstance(value, np.ndarray):
        yield where, (value.dtype.str, value.shape, np.ascontiguousarray(value).tobytes())
    elif isinstance(value, Mapping):
        yield f"{where}, keys", tuple(value)
        for key, item in value.items():
            yield from leaves(f"{where}[{key}]", item)
    elif is_dataclass(value):
        yield f"{where}, kind", type(value).__name__
        for field in fields(value):
            yield from leaves(f"{where}.{field.name}", getattr(value, field.name))
    elif isinstance(value, tuple) and not isinstance(value, Unknown):
        yield f"{where}, size", len(value)
        for k, item in enumerate(value):
            yield from leaves(f"{where}[{k}]", item)
    else:
        yield where, float(value).hex() if isinstance(value, float) else repr(value)


def differences(one: StateStore, other: StateStore) -> list[str]:
    """Where two stores say something else."""
    want, got = dict(contents(one)), dict(contents(other))
    return [name for name in want | got if want.get(name, "nothing") != got.get(name, "nothing")]


def files_of(folder: Path) -> dict[str, bytes]:
    """Contents of all files of a folder, by their paths in it."""
    return {str(path.relative_to(folder)): path.read_bytes() for path in sorted(folder.rglob("*")) if path.is_file()}


def digest(store: StateStore) -> str:
    """Of everything in it."""
    return hashlib.sha256(repr(list(contents(store))).encode()).hexdigest()


def interrupted(folder: Path, copy: Path) -> tuple[str, str]:
    """A copy of the project as a power cut in the middle of a commit leaves it; digests before and after."""
    with open_project(folder) as project:
        before = digest(project.store)
    with open_project(folder, write=True) as project:
        # SQLite hears of these between transactions only
        for statement in ("COMMIT", "PRAGMA cache_size = 5", "PRAGMA cache_spill = 5", "BEGIN IMMEDIATE"):
            project._connection.execute(statement)
        for seed in range(4):
            change(project.store, seed)
        after = digest(project.store)
        shutil.copytree(folder, copy)
    with (copy / "project.sqlite-journal").open("rb") as journal:
        assert journal.read(1) != b"\0", "pages were written: the journal is needed"
    return before, after

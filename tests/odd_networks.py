"""Networks of every kind, from those that a case may hold to those that only chance makes."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
from networks import network, pair, with_shift_and_surface

from mgsgraph.adjustment.graph import Layout, lay_out
from mgsgraph.adjustment.settings import Line, SolverSettings
from mgsgraph.files.networks.tie_points import PointKind
from mgsgraph.geometry.orientation import OrientationPrior
from mgsgraph.kernel.rows import Rows
from mgsgraph.network import GroundPoints, ImageRays, Network, PointClass, ProfileShifts, Ranges


@dataclass(eq=False)
class Case:
    """A network laid out, and which of its rows take part."""

    layout: Layout
    rows: Rows


def case(net: Network, line: Line = "predicted", without: tuple[tuple[int, ...], ...] = ((), (), ())) -> Case:
    """Everything takes part but these rays, ranges and points."""
    layout = lay_out(net, SolverSettings(line=line))
    sizes = (net.rays.point.size, net.ranges.point.size, len(net.points))
    left = [np.isin(np.arange(size), mine) for size, mine in zip(sizes, without, strict=True)]
    return Case(layout, layout.active(~left[0], ~left[1], left[2]))


def with_rays(net: Network, point: list[int], image: list[int], offset: float = 0.5) -> Network:
    """The same with more rays: beside those that these points have in these images already."""
    rays = net.rays
    at = [int(np.flatnonzero((rays.point == p) & (rays.image == j))[0]) for p, j in zip(point, image, strict=True)]
    more = (np.array(point), np.array(image), rays.places[at] + offset, rays.sigmas[at])
    old = (rays.point, rays.image, rays.places, rays.sigmas)
    return replace(net, rays=ImageRays(*(np.concatenate(both) for both in zip(old, more, strict=True))))


def with_fixed(net: Network) -> Network:
    """Its laser points are known."""
    points = net.points
    kinds = np.where(points.classes == PointClass.LASER, PointKind.FIXED, points.kinds)
    covariances = np.where((kinds == PointKind.FIXED)[:, None, None], 0.0, points.covariances)
    return replace(net, points=replace(points, kinds=kinds, covariances=covariances))


def of_twelve_images(seed: int = 2) -> Network:
    """The pair six times over: two thirds of the points seen by all twelve images, the others by some of them, each by
    a set of its own.
    """
    net, rng = network(pair()), np.random.default_rng(seed)
    images = tuple(replace(image, name=f"{image.name}/{k}") for k in range(6) for image in net.images)
    n, rays = len(net.points), net.rays
    seen = np.ones((n, 6), dtype=bool)
    for i in range(0, n, 3):
        seen[i] = np.arange(6) == i % 6
        seen[i, rng.integers(0, 6)] = True
    which, k = np.nonzero(seen[rays.point])
    place = rays.places[which] + rng.standard_normal((which.size, 2))
    return Network(
        images,
        tuple(net.priors[0] for _ in images),
        np.zeros(12, dtype=bool),
        net.points,
        ImageRays(rays.point[which], rays.image[which] + 2 * k, place, rays.sigmas[which]),
        net.ranges,
    )


def one_seen_twice_by_one_image() -> Network:
    """A free point whose two rays are of one image, of two lines side by side: nothing says how far away it is."""
    net = network(pair())
    kept = ~((net.rays.point == 0) & (net.rays.image == 1))
    rays = ImageRays(*(values[kept] for values in (net.rays.point, net.rays.image, net.rays.places, net.rays.sigmas)))
    return with_rays(replace(net, rays=rays), [0], [0], offset=0.0)


def seen_by_the_held_one_alone(net: Network) -> Network:
    """Two of three laser points lose their rays in the second image: no unknown is left in the rows of these."""
    kept = (net.rays.image == 0) | (net.points.classes[net.rays.point] == PointClass.TIE) | (net.rays.point % 3 == 0)
    return replace(net, rays=net.rays.chosen(kept))


NETWORKS: dict[str, Callable[[], Network]] = {
    "plain": lambda: network(pair()),
    "shifts and terrain": lambda: with_shift_and_surface(network(pair())),
    "measured twice": lambda: with_rays(network(pair()), [0, 3, 3, 14], [1, 0, 1, 0]),
    "first held": lambda: network(pair(), held=(True, False)),
    "second held": lambda: with_shift_and_surface(network(pair(), held=(False, True))),
    "fixed points": lambda: with_fixed(network(pair())),
    "points left out": lambda: with_shift_and_surface(network(pair())),
    "weights of zero": lambda: with_shift_and_surface(network(pair())),
    "more than a tile": lambda: network(pair(ties=150, shots=70)),
    "twelve rays": of_twelve_images,
    "groups of one point": lambda: with_rays(of_twelve_images(), [0, 1], [0, 0]),
}
WITHOUT: dict[str, tuple[tuple[int, ...], ...]] = {
    "points left out": ((), (), (0, 5, 13)),
    "weights of zero": ((24, 27, 30, 31), (1, 4), ()),  # of laser points, which their a-priori places determine
}


@cache
def made(name: str, line: Line = "predicted") -> Case:
    return case(NETWORKS[name](), line, WITHOUT.get(name, ((), (), ())))


def random_network(seed: int) -> Network:
    """Up to forty points of all kinds in up to six images, some held, of unlike degrees; points unseen, or seen twice
    by an image; ranges, shifts of two profiles, a terrain model that may move.
    """
    rng, base = np.random.default_rng(seed), with_shift_and_surface(network(pair()))
    copies, n = int(rng.integers(1, 4)), int(rng.integers(1, 41))
    images = tuple(replace(image, name=f"{image.name}/{k}") for k in range(copies) for image in base.images)
    m, source = len(images), rng.integers(0, len(base.points), n)
    kinds = rng.choice([PointKind.FREE, PointKind.CONSTRAINED, PointKind.FIXED], n, p=[0.6, 0.3, 0.1])
    covariances = np.where((kinds == PointKind.CONSTRAINED)[:, None, None], base.points.covariances[source], 0.0)
    lacking = (kinds == PointKind.CONSTRAINED) & ~np.any(covariances, axis=(1, 2))
    roots = rng.standard_normal((n, 3, 3)) + 3.0 * np.eye(3)
    covariances[lacking] = (roots @ roots.mT)[lacking]
    true = np.concatenate([pair().true_ties, pair().true_footprints])[source]
    places = true + 10.0 * rng.standard_normal((n, 3))
    points = GroundPoints(tuple(f"p{i}" for i in range(n)), np.full(n, PointClass.TIE), kinds, places, covariances)
    count = int(rng.integers(0, 4 * n))
    # each image sees something, or the network would be refused
    point = np.append(rng.integers(0, n, count), np.zeros(m, dtype=int))
    image = np.append(rng.integers(0, m, count), np.arange(m))
    at = {(int(p), int(j)): k for k, (p, j) in enumerate(zip(base.rays.point, base.rays.image, strict=True))}
    like = [at[int(source[p]), int(j) % 2] for p, j in zip(point, image, strict=True)]
    rays = ImageRays(point, image, base.rays.places[like], rng.uniform(0.5, 2.0, (point.size, 2)))
    ties = len(pair().ties.ids)
    shooting = rng.choice(np.flatnonzero(source >= ties), int(rng.integers(0, n + 1))) if np.any(source >= ties) else []
    target = np.array(shooting, dtype=int)
    shot = source[target] - ties
    ranges = Ranges(
        target,
        2 * rng.integers(0, copies, shot.size),
        base.ranges.times[shot],
        base.ranges.values[shot] + rng.standard_normal(shot.size),
        rng.uniform(0.5, 2.0, shot.size),
    )
    shifts = ProfileShifts(
        ("a", "b"), np.where(kinds == PointKind.CONSTRAINED, rng.integers(-1, 2, n), -1), np.array([60.0, 40.0])
    )
    assert base.surface is not None
    surface = replace(
        base.surface,
        sigmas=np.where(rng.random(n) < 0.4, rng.uniform(5.0, 30.0, n), np.inf),
        shift_sigma=float(rng.choice([0.0, 150.0])),
    )
    priors = tuple(OrientationPrior(base.priors[0].sigmas[: rng.integers(1, 4)]) for _ in images)
    held = rng.random(m) < 0.3
    chosen = (shifts if rng.random() < 0.7 else None, surface if rng.random() < 0.7 else None)
    return Network(images, priors, held, points, rays, ranges, *chosen)

"""Whether the rays of a network support the orientation images of its passes: nodes with too few rays near them are
named.

A node is observed by the rays near it: those up to the next node on either side (the next but one for a spline,
whose functions are wider). They must be of points that something else places, too (another ray, or an a-priori place):
a lone ray tells nothing of orientation. And they must be of two lines at least, where two lines look for half of that
time or longer: with one alone, position and pointing can't be told apart.
"""

from dataclasses import dataclass

import numpy as np

from mgsgraph.errors import InputError
from mgsgraph.files.tie_points import PointKind
from mgsgraph.geometry.orientation_images import SUPPORT, OrientationImages, evenly_spaced
from mgsgraph.geometry.records import Array, Index, Mask, assign
from mgsgraph.geometry.time_scales import utc_of_tdb
from mgsgraph.network.network import Network
from mgsgraph.text import NAMED, many, some

LEAST = 3
"""Rays near a node: they bring the six rows that its six unknowns take, were the points known."""
_COARSER = 0.95
"""Share of the number of intervals that is tried next when a supported spacing is sought."""


@dataclass(frozen=True, slots=True, eq=False)
class PassRays:
    """Rays of one pass, by time."""

    of_pass: str
    """Its name."""
    rays: Index
    """(m,) rays of the network."""
    line: Index
    """(m,) which of the pass's images each belongs to, counted within the pass."""
    times: Array
    """(m,) s past the epoch of the pass's nodes."""
    looks: Array
    """(lines, 2) s past that epoch, when each image begins and ends."""

    def only(self, chosen: Mask) -> "PassRays":
        """Some of them."""
        return PassRays(self.of_pass, self.rays[chosen], self.line[chosen], self.times[chosen], self.looks)


def pass_rays(network: Network, number: int) -> PassRays:
    """All rays of a pass's images."""
    one = network.passes[number]
    place = np.full(len(network.images), -1)
    place[one.images] = np.arange(one.images.size)
    rays = np.flatnonzero(place[network.rays.image] >= 0)
    line, times, looks = place[network.rays.image[rays]], np.empty(rays.size), np.empty((one.images.size, 2))
    for k, j in enumerate(one.images.tolist()):
        image, mine = network.images[j], line == k
        later = image.trajectory.epoch - one.nodes.epoch
        times[mine] = image.timing.at(network.rays.places[rays[mine], 0])[0] + later
        looks[k] = image.timing.at(np.array([0.0, float(image.lines)]))[0] + later
    return PassRays(one.name, rays, line, times, looks)


@dataclass(frozen=True, slots=True, eq=False)
class Support:
    """What the rays of a pass do for its nodes."""

    of_pass: str
    """Its name."""
    nodes: OrientationImages
    """They."""
    rays: Index
    """(k,) useful rays near each node."""
    lines: Index
    """(k,) lines that these are of."""
    looking: Index
    """(k,) lines that look there for half the time or longer."""
    least: int
    """Rays that there should be."""

    def __post_init__(self) -> None:
        for name in ("rays", "lines", "looking"):
            value = np.array(getattr(self, name), dtype=np.int64)
            value.flags.writeable = False
            assign(self, **{name: value})

    @property
    def weak(self) -> Mask:
        """(k,) True for nodes that the rays don't support."""
        return np.asarray(self.unobserved | (self.lines < np.minimum(self.looking, 2)))

    @property
    def unobserved(self) -> Mask:
        """(k,) True for nodes with too few rays near them, of however many lines."""
        return np.asarray(self.rays < self.least)

    @property
    def gaps(self) -> Index:
        """Nodes with too few rays between others that have them; all where none has."""
        seen, weak = np.flatnonzero(~self.unobserved), np.flatnonzero(self.unobserved)
        return weak[(weak > seen[0]) & (weak < seen[-1])] if seen.size else weak


def support(network: Network, number: int, least: int = LEAST, taken: Mask | None = None) -> Support:
    """How many rays observe each node of a pass.

    Parameters
    ----------
    network : Network
    number : int
        Of the pass.
    least : int
        Rays that each node should have near it.
    taken : (rays,), optional
        Those that take part; when absent all that are not marked as blunders.
    """
    return support_of(network.passes[number].nodes, useful_rays(network, number, taken), least)


def useful_rays(network: Network, number: int, taken: Mask | None = None) -> PassRays:
    """Rays of a pass whose points something else places, too."""
    used = ~network.rays.rejected if taken is None and network.rays.rejected is not None else taken
    used = np.ones(network.rays.point.size, dtype=bool) if used is None else used
    counts = np.bincount(network.rays.point, used, len(network.points))
    placed = (counts >= 2) | (network.points.kinds != PointKind.FREE)
    mine = pass_rays(network, number)
    return mine.only(used[mine.rays] & placed[network.rays.point[mine.rays]])


def support_of(nodes: OrientationImages, rays: PassRays, least: int = LEAST) -> Support:
    """The same for any nodes over rays of a pass."""
    reach = 1 if nodes.basis == "lagrange" else 2
    number, last = np.arange(len(nodes)), len(nodes) - 1
    start, stop = nodes.times[np.maximum(number - reach, 0)], nodes.times[np.minimum(number + reach, last)]
    counts, looking = np.zeros((rays.looks.shape[0], len(nodes)), dtype=np.int64), np.zeros(len(nodes), dtype=np.int64)
    for k, (first, end) in enumerate(rays.looks.tolist()):
        times = np.sort(rays.times[rays.line == k])
        counts[k] = np.searchsorted(times, stop, side="right") - np.searchsorted(times, start, side="left")
        looking += np.minimum(stop, end) - np.maximum(start, first) >= 0.5 * (stop - start)
    return Support(rays.of_pass, nodes, counts.sum(axis=0), np.count_nonzero(counts, axis=0), looking, least)


def supported_spacing(nodes: OrientationImages, rays: PassRays, least: int = LEAST) -> float:
    """Spacing, s, of even nodes over the same time that the rays support throughout, at least that of `nodes`; infinite
    where they support none.
    """
    start, stop = nodes.coverage
    intervals = max(round((stop - start) / float(np.diff(nodes.times).min())), SUPPORT - 1)
    while True:
        spacing = (stop - start) / intervals
        if not np.any(support_of(evenly_spaced(nodes.basis, nodes.epoch, (start, stop), spacing), rays, least).weak):
            return spacing
        if intervals == SUPPORT - 1:
            return float("inf")
        intervals = max(min(int(intervals * _COARSER), intervals - 1), SUPPORT - 1)


def require_observed_nodes(network: Network, taken: Mask | None = None) -> None:
    """Raise InputError unless every node of every pass has some rays near it: the least that an adjustment needs.

    Rays of one line alone will do: what is known of the nodes beforehand tells position from pointing. And nodes before
    the first rays and after the last ones need none: there a pass follows its prior. `taken` as there, below.
    """
    require_supported(network, taken=taken, between=True)


def require_supported(
    network: Network, least: int = LEAST, taken: Mask | None = None, between: bool = False
) -> None:
    """Raise InputError, naming the weak nodes, unless rays observe every node of every pass.

    Parameters
    ----------
    network : Network
    least : int
        Rays that each node should have near it; see `Support`.
    taken : (rays,), optional
        Those that take part; when absent all that are not marked as blunders.
    between : bool
        Whether nodes between others alone count, with rays of however many lines (`Support.gaps`).
    """
    for k in range(len(network.passes)):
        rays = useful_rays(network, k, taken)
        found = support_of(network.passes[k].nodes, rays, least)
        weak = found.gaps if between else np.flatnonzero(found.weak)
        if weak.size:
            raise unsupported(found, rays, weak)


def unsupported(found: Support, rays: PassRays, weak: Index) -> InputError:
    """The error for nodes that are closer than the rays support: which ones, what is near them, what would do."""
    spacing = supported_spacing(found.nodes, rays, found.least)
    names = [_node(found, k) for k in weak[:NAMED].tolist()]
    but_one = "" if found.nodes.basis == "lagrange" else " but one"
    remedy = "leave the pass out, or match more points"
    if np.isfinite(spacing):
        remedy = f"a spacing of {_rounded_up(spacing)} s is what they support"
        remedy += ", or other times for the nodes" if found.nodes.basis == "lagrange" else ""
    return InputError(
        f"pass {found.of_pass!r}, nodes closer than the data supports",
        f"of {len(found.nodes)} nodes (times in UTC, and from the pass's beginning) {some(names, weak.size)}",
        f"{found.least} rays or more near each (up to the next node{but_one}, of two images where two look)",
        remedy,
    )


def _node(found: Support, node: int) -> str:
    """A node by its number, its time and what is near it."""
    time = float(found.nodes.times[node])
    utc = utc_of_tdb(time + found.nodes.epoch).isoformat(timespec="milliseconds").removesuffix("+00:00")
    since, rays = time - found.nodes.coverage[0], int(found.rays[node])
    alone = ", all of one image" if rays > 1 and int(found.lines[node]) == 1 else ""
    return f"{node + 1} at {utc}, {since:.4g} s ({many(rays, 'ray')} near it{alone})"


def _rounded_up(spacing: float) -> str:
    """Three digits, not below what is meant."""
    digits = 10.0 ** (int(np.floor(np.log10(spacing))) - 2)
    return f"{np.ceil(spacing / digits - 1e-9) * digits:.4g}"

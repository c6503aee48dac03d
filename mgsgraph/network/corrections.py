"""An image's whole orientation correction: its own coefficients or its pass's orientation images, and what unknowns
that it shares do to it.

Interior orientations as unknowns that images share: focal length, principal point, radial distortion. What a pixel
looks along is D = (x, y, f) in camera components, its ideal place in the focal plane and the focal length. Each unknown
moves D along a direction of the pixel's own, and by as much as its value, whatever the others are:

    D = (x, y, f) + (0, 0, 1) df - (xp, yp, 0) + sum_n k_n (r / R)^2n (x, y, 0) / R        n = 1, 2, 3

with r = |(x, y)| (Brown 1971, Eq. 4, radial terms; Wolf, Dewitt & Wilkinson 2014, Eq. 4-25, outward positive).
R, the *reference radius*, is that of the pixel farthest from the principal point among all images that share the
unknown, so that k_n is in metres what it moves that pixel outward.

Whether the rays of a network support the orientation images of its passes: nodes with too few rays near them are
named.

A node is observed by the rays near it: those up to the next node on either side. They must be of points that something
else places, too (another ray, or an a-priori place): a lone ray tells nothing of orientation. And they must be of two
lines at least, where two lines look for half of that time or longer: with one alone, position and pointing are
inseparable.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from mgsgraph.errors import InputError
from mgsgraph.files.networks.tie_points import PointKind
from mgsgraph.geometry.camera import CorrectedDistortion, InteriorOrientation
from mgsgraph.geometry.image import PushbroomImage
from mgsgraph.geometry.orientation import (
    SUPPORT,
    Angles,
    Moments,
    OrientationCorrection,
    OrientationImages,
    evenly_spaced,
    polynomial,
)
from mgsgraph.geometry.records import Array, Index, Mask, assign, place_of, read_only
from mgsgraph.geometry.trajectory import utc_of_tdb
from mgsgraph.network.network import Network
from mgsgraph.network.shared import SharedKind, SharedUnknown, image_effect
from mgsgraph.text import NAMED, many, some

Adjusted = Sequence[tuple[SharedKind, float, Array]]
"""Unknowns of a camera: kind, reference radius (m; 1 where none is needed), value (kind.width,) in m."""


def reference_radius(images: Sequence[PushbroomImage]) -> float:
    """m, from the principal point to the farthest pixel of some images."""
    return max(
        float(np.linalg.norm(image.interior.focal_plane(np.array([0.5, image.samples - 0.5]))[0], axis=1).max())
        for image in images
    )


def radius_of(network: Network, shared: SharedUnknown) -> float:
    """m, the reference radius of an unknown of radial distortion; 1 of any other."""
    if not shared.kind.radial_order:
        return 1.0
    return reference_radius([network.images[j] for j in shared.images.tolist()])


def interior_effect(
    interior: InteriorOrientation, kind: SharedKind, samples: Array, radius: float
) -> tuple[Array, Array]:
    """What a metre of an unknown of the interior orientation does to what pixels look along.

    Parameters
    ----------
    interior : InteriorOrientation
        The nominal one.
    kind : SharedKind
        One that `is_interior`.
    samples : (n,)
        Image samples, first pixel's centre at 0.5.
    radius : float
        m, reference radius (`radius_of`).

    Returns
    -------
    directions : (kind.width, n, 3)
        m per m, of (x, y, focal length).
    slopes : (kind.width, n, 3)
        m per m and sample, how they change along the detector.
    """
    directions, slopes = np.zeros((kind.width, samples.size, 3)), np.zeros((kind.width, samples.size, 3))
    if kind is SharedKind.FOCAL_LENGTH:
        directions[0, :, 2] = 1.0
    elif kind is SharedKind.PRINCIPAL_POINT:
        directions[0, :, 0] = directions[1, :, 1] = -1.0
    else:
        (place, slope), n = interior.focal_plane(samples), kind.radial_order
        place, slope = place / radius, slope / radius
        square, outward = np.einsum("kc,kc->k", place, place), np.einsum("kc,kc->k", place, slope)
        directions[0, :, :2] = (square**n)[:, None] * place
        slopes[0, :, :2] = (square**n)[:, None] * slope + (2.0 * n * square ** (n - 1) * outward)[:, None] * place
    return directions, slopes


def adjusted_interior(nominal: InteriorOrientation, adjusted: Adjusted) -> InteriorOrientation:
    """The interior orientation that looks along D: of the same detector, with its own distortion and a correction."""
    longer, point, radial = 0.0, np.zeros(2), np.zeros(3)
    for kind, radius, value in adjusted:
        if kind is SharedKind.FOCAL_LENGTH:
            longer += float(value[0])
        elif kind is SharedKind.PRINCIPAL_POINT:
            point += value
        else:
            radial[kind.radial_order - 1] += float(value[0]) / radius ** (2 * kind.radial_order + 1)
    distortion = nominal.distortion
    if point.any() or radial.any():
        distortion = CorrectedDistortion(distortion, (point[0], point[1]), (radial[0], radial[1], radial[2]))
    return replace(nominal, focal_length=nominal.focal_length + longer, distortion=distortion)


def adjusted_of(network: Network, image: int, values: Sequence[Array]) -> Adjusted:
    """Unknowns of an image's camera, `values` being those of all variables."""
    first = network.first_shared
    return [
        (shared.kind, radius_of(network, shared), np.asarray(values[first + k]))
        for k, shared in enumerate(network.shared)
        if shared.kind.is_interior and shared.of(image)
    ]


def correction_parts(network: Network, image: int, angles: Angles) -> dict[int, Array]:
    """How the coefficients of an image's whole correction, row after row, follow from the variables it depends on.

    Returns
    -------
    dict
        Of each variable (images, then shifts, then shared unknowns, then passes' nodes) a matrix (6 d, width), m and
        rad per unit. Of the d rows the first are those of the polynomial of the larger degree of those that add up;
        then come the nodes of the image's pass, and four of each vibration. (Of k nodes that makes k matrices of 6 k
        rows: `designs` needs none.)
    """
    polynomials, number = _of_polynomial(network, image, angles), int(network.pass_of[image])
    vibrations, turn = _vibrations(network, image), _to_camera(network, image)
    if number < 0 and not vibrations:
        return polynomials
    rows, first = _polynomial_rows(polynomials), int(network.first_of_passes[number])
    more = {first + k: turn for k in range(0 if number < 0 else len(network.passes[number].nodes))}
    # of axis a and part k the column is 4 a + k, and the row 6 k + c of component c
    more |= {v: np.einsum("ca,kl->kcal", turn[:, 3:], np.eye(4)).reshape(24, 12) for v in vibrations}
    size, at = rows + sum(len(part) for part in more.values()), rows
    parts = {v: np.pad(part, ((0, size - len(part)), (0, 0))) for v, part in polynomials.items()}
    for v, part in more.items():
        parts[v] = np.pad(part, ((at, size - at - len(part)), (0, 0)))
        at += len(part)
    return parts


def _vibrations(network: Network, image: int) -> dict[int, SharedUnknown]:
    """Of an image, by variable."""
    unknowns = enumerate(network.shared, network.first_shared)
    return {v: unknown for v, unknown in unknowns if unknown.sine is not None and unknown.of(image)}


def _of_polynomial(network: Network, image: int, angles: Angles) -> dict[int, Array]:
    """(6 d, width) of each variable, of the polynomials alone; none for an image of a pass that shares nothing."""
    picture, first = network.images[image], network.first_shared
    parts = {
        first + k: np.moveaxis(image_effect(picture, shared.kind, angles), 0, -1).reshape(-1, shared.kind.width)
        for k, shared in enumerate(network.shared)
        if shared.kind.moves_pose and shared.sine is None and shared.of(image)
    }
    own_size = 0 if network.pass_of[image] >= 0 else network.priors[image].sigmas.size
    rows = max([own_size, *(int(part.shape[0]) for part in parts.values())])
    blocks = {image: np.eye(rows, own_size)} if own_size else {}
    return blocks | {v: np.pad(part, ((0, rows - part.shape[0]), (0, 0))) for v, part in parts.items()}


def _to_camera(network: Network, image: int) -> Array:
    """(6, 6) from corrections of an image's pass to those of the image: rotations about the camera's own axes."""
    turn, axes = np.eye(6), network.axes_of(image)
    if axes is not None:
        turn[3:, 3:] = axes
    return turn


def _polynomial_rows(polynomials: dict[int, Array]) -> int:
    """6 d of the polynomials; a correction has a constant term at least."""
    return max([6, *(int(part.shape[0]) for part in polynomials.values())])


class Design(NamedTuple):
    """How an image's whole correction at some of its lines follows from the variables that it depends on there."""

    lines: slice
    """Which of the lines asked for."""
    variables: tuple[int, ...]
    """Variables, the same at all of them; of a pass the four nodes around them."""
    parts: tuple[Array, ...]
    """Of each variable (n, 6, width), m and rad per unit."""

    @property
    def matrix(self) -> Array:
        """(n, 6, widths of all variables together)."""
        return np.concatenate(self.parts, axis=2)


def design(network: Network, image: int, angles: Angles, moments: Moments) -> list[Design]:
    """How an image's whole correction at some moments follows from the variables it depends on, run by run of moments
    that depend on the same ones.
    """
    polynomials, number = _of_polynomial(network, image, angles), int(network.pass_of[image])
    basis, _ = polynomial(moments.u, _polynomial_rows(polynomials) // 6 - 1)
    vibrations, turn = _vibrations(network, image), _to_camera(network, image)
    variables = (*polynomials, *vibrations)
    parts = (
        *(np.einsum("nd,dcw->ncw", basis, part.reshape(-1, 6, part.shape[1])) for part in polynomials.values()),
        *(turn @ vibration.waves(moments)[0].mT for vibration in vibrations.values()),
    )
    if number < 0:
        return [Design(slice(0, moments.u.size), variables, parts)]
    start = int(network.first_of_passes[number])
    first, values, _ = network.passes[number].nodes.at(moments.times, moments.epoch)
    edges = [0, *(np.flatnonzero(np.diff(first)) + 1).tolist(), first.size]
    return [
        Design(
            slice(a, b),
            (*variables, *range(start + int(first[a]), start + int(first[a]) + values.shape[1])),
            (*(part[a:b] for part in parts), *(weight[:, None, None] * turn for weight in values[a:b].T)),
        )
        for a, b in pairwise(edges)
    ]


def designs(network: Network, image: int, angles: Angles, lines: Array) -> list[dict[int, Array]]:
    """How an image's whole correction at lines (n,) follows from the variables it depends on there.

    Returns
    -------
    list of dict
        Of each line: of each variable a matrix (6, width), m and rad per unit; of a pass's nodes those around it that
        count.
    """
    first, by_line = int(network.first_of_passes[network.pass_of[image]]), list[dict[int, Array]]()
    on_pass = network.pass_of[image] >= 0
    for run in design(network, image, angles, network.images[image].moments(lines)):
        for k in range(run.lines.stop - run.lines.start):
            pairs = zip(run.variables, (part[k] for part in run.parts), strict=True)
            by_line.append({v: part for v, part in pairs if not on_pass or v < first or np.any(part)})
    return by_line


def whole_correction(network: Network, image: int, values: Sequence[Array], angles: Angles) -> OrientationCorrection:
    """The whole correction of one image, `values` being those of all variables."""
    polynomials, number = _of_polynomial(network, image, angles), int(network.pass_of[image])
    flat = sum((part @ values[v] for v, part in polynomials.items()), np.zeros(_polynomial_rows(polynomials)))
    coefficients, nodes, turn = np.reshape(flat, (-1, 6)), None, _to_camera(network, image)
    if number >= 0:
        nodes, first = network.passes[number].nodes, int(network.first_of_passes[number])
        of_nodes = np.array(values[first : first + len(nodes)]) @ turn.T
        coefficients = np.vstack([coefficients, of_nodes])
    vibrations = _vibrations(network, image)
    amounts = [np.reshape(values[v], (3, 4)).T @ turn[:, 3:].T for v in vibrations]
    sines = tuple(vibration.sine for vibration in vibrations.values() if vibration.sine is not None)
    return OrientationCorrection(np.vstack([coefficients, *amounts]), angles, nodes, sines)


def adjusted_image(network: Network, image: int, values: Sequence[Array]) -> PushbroomImage:
    """One image with its adjusted interior orientation, `values` being those of all variables; its trajectory and its
    lines' times stay nominal.
    """
    picture, adjusted = network.images[image], adjusted_of(network, image, values)
    return replace(picture, interior=adjusted_interior(picture.interior, adjusted)) if adjusted else picture


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
    pass_ = network.passes[number]
    place = place_of(pass_.images, len(network.images))
    rays = np.flatnonzero(place[network.rays.image] >= 0)
    line, times, looks = place[network.rays.image[rays]], np.empty(rays.size), np.empty((pass_.images.size, 2))
    for k, j in enumerate(pass_.images.tolist()):
        image, of_image = network.images[j], line == k
        later = image.trajectory.epoch - pass_.nodes.epoch
        times[of_image] = image.timing.at(network.rays.places[rays[of_image], 0])[0] + later
        looks[k] = image.timing.at(np.array([0.0, float(image.lines)]))[0] + later
    return PassRays(pass_.name, rays, line, times, looks)


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
            assign(self, **{name: read_only(np.array(getattr(self, name), dtype=np.int64))})

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
        observed, weak = np.flatnonzero(~self.unobserved), np.flatnonzero(self.unobserved)
        return weak[(weak > observed[0]) & (weak < observed[-1])] if observed.size else weak


def useful_rays(network: Network, number: int, taken: Mask | None = None) -> PassRays:
    """Rays of a pass whose points something else places, too."""
    used = ~network.rays.rejected if taken is None and network.rays.rejected is not None else taken
    used = np.ones(network.rays.point.size, dtype=bool) if used is None else used
    counts = np.bincount(network.rays.point, used, len(network.points))
    placed = (counts >= 2) | (network.points.kinds != PointKind.FREE)
    of_pass = pass_rays(network, number)
    return of_pass.only(used[of_pass.rays] & placed[network.rays.point[of_pass.rays]])


def support_of(nodes: OrientationImages, rays: PassRays, least: int = LEAST) -> Support:
    """How many rays of a pass observe each node; `least` (of any) should be near each."""
    number, last = np.arange(len(nodes)), len(nodes) - 1
    start, stop = nodes.times[np.maximum(number - 1, 0)], nodes.times[np.minimum(number + 1, last)]
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
        Whether nodes between others alone count, with rays of however many lines (`Support.gaps`): the least that an
        adjustment needs, for what is known of nodes beforehand tells position from pointing, and before the first
        rays and after the last ones a pass follows its prior.
    """
    for k in range(len(network.passes)):
        rays = useful_rays(network, k, taken)
        support = support_of(network.passes[k].nodes, rays, least)
        weak = support.gaps if between else np.flatnonzero(support.weak)
        if weak.size:
            raise unsupported(support, rays, weak)


def unsupported(support: Support, rays: PassRays, weak: Index) -> InputError:
    """The error for nodes that are closer than the rays support: which ones, what is near them, what would do."""
    spacing = supported_spacing(support.nodes, rays, support.least)
    names = [_node(support, k) for k in weak[:NAMED].tolist()]
    remedy = "leave the pass out, or match more points"
    if np.isfinite(spacing):
        remedy = f"a spacing of {_rounded_up(spacing)} s is what they support, or other times for the nodes"
    return InputError(
        f"pass {support.of_pass!r}, nodes closer than the data supports",
        f"of {len(support.nodes)} nodes (times in UTC, and from the pass's beginning) {some(names, weak.size)}",
        f"{support.least} rays or more near each (up to the next node, of two images where two look)",
        remedy,
    )


def _node(support: Support, node: int) -> str:
    """A node by its number, its time and what is near it."""
    time = float(support.nodes.times[node])
    utc = utc_of_tdb(time + support.nodes.epoch).isoformat(timespec="milliseconds").removesuffix("+00:00")
    since, rays = time - support.nodes.coverage[0], int(support.rays[node])
    alone = ", all of one image" if rays > 1 and int(support.lines[node]) == 1 else ""
    return f"{node + 1} at {utc}, {since:.4g} s ({many(rays, 'ray')} near it{alone})"


def _rounded_up(spacing: float) -> str:
    """Three digits, not below what is meant."""
    digits = 10.0 ** (int(np.floor(np.log10(spacing))) - 2)
    return f"{np.ceil(spacing / digits - 1e-9) * digits:.4g}"

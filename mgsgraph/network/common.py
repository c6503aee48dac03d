"""Errors that neighboring rows have in common: matches whose windows overlap, heights above the same posts or over the
same gap between laser tracks.

Of a group of neighbors the error of row m is sigma_m (l_m . z + e_m): its own part e_m, and what the group has in
common by its factors z, unknowns of unit covariance. With the correlation C of the group C = L L' + D by its leading
eigenvectors (factor analysis; Mulaik 2009), D diagonal: rows keep the sigma that D leaves them. What neighboring groups
have in common links their factors, each given those of the groups before it (Vecchia 1988, by blocks).
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from mgsgraph.errors import require
from mgsgraph.geometry.records import Array, Index, assign, by_value, frozen, frozen_index, no_rows
from mgsgraph.names import grouped
from mgsgraph.network.records import ImageRays, LinearRows, Surface
from mgsgraph.record import Record

MOST = 12
"""Rows of a group: more cost more than they gain."""
_LEAST = 0.05
"""Share of its variance that a row keeps as its own, and of a factor's that those of other groups leave it."""
SPHERE = float(np.sqrt(5.0))
"""Range of the spherical model, in radii of the circle that counts as much within a plane."""
_SLIGHT = 0.01
"""Correlation up to which two rows have nothing in common."""
_SEEN, _AMID = 0.2, 0.45
"""What a factor must add to the group's variances, in that of one row; or by what share of the largest, where that is
less: not by half, where the middle eigenvalue of three rows in a chain lies whatever their correlations are."""


@dataclass(frozen=True, slots=True, eq=False)
class CommonErrors(Record):
    """Groups of rows with factors in common: m rows, g groups."""

    members: Index
    """(m,) rays, or points with a height above the terrain model; each once."""
    group: Index
    """(m,) of each."""
    loads: Array
    """(m, q) what a unit of each factor of its group does to a row, in the row's own sigmas; zero beyond `widths`."""
    widths: Index
    """(g,) factors of each group."""
    independent: Array
    """(m,) with what sigmas, in their own, rows may count as independent: none that follows from many is then too
    small, for the variances D_i = sum_j C_ij have D - C diagonally dominant."""
    links: tuple[LinearRows, ...] = ()
    """Whitened rows on the factors of groups that are not independent; their variables are groups. Factors of groups
    that are the last variable of none have unit variance by themselves."""

    def __post_init__(self) -> None:
        m, g = np.size(self.members), np.size(self.widths)
        members = frozen_index(self.members, "common errors, rows", m, 2**31)
        require(np.unique(members).size == m, "common errors, rows", "a row of two groups", "each once")
        group = frozen_index(self.group, "common errors, groups", m, max(g, 1))
        loads = frozen(self.loads, "common errors, loads", (m, np.shape(self.loads)[-1]))
        widths = frozen_index(self.widths, "common errors, widths", g, loads.shape[1] + 1)
        independent = frozen(self.independent, "common errors, sigmas", (m,))
        assign(self, members=members, group=group, loads=loads, widths=widths, independent=independent)

    @property
    def total(self) -> Array:
        """(m,) what the whole sigma of each row is, in its own."""
        return np.asarray(np.sqrt(1.0 + np.sum(self.loads**2, axis=1)))

    def errors(self, values: Sequence[Array]) -> Array:
        """(m, c) what the factors make of each row, in its own sigmas, by the values (width c,) of each group, then
        others'.
        """
        flat = np.concatenate([np.reshape(value, -1) for value in values[: self.widths.size]])
        of_row = flat.size // int(self.widths.sum())
        first = np.cumsum(self.widths) - self.widths
        place = np.minimum(first[self.group][:, None] + np.arange(self.loads.shape[1]), flat.size // of_row - 1)
        return np.asarray(np.einsum("mq,mqc->mc", self.loads, flat.reshape(-1, of_row)[place]))

    def renumbered(self, number: Index) -> "CommonErrors":
        """The same groups, where each row of the network has another number, or -1 for one that is left out."""
        rows = np.flatnonzero(number[self.members] >= 0)
        return replace(
            self, members=number[self.members[rows]], group=self.group[rows], loads=self.loads[rows],
            independent=self.independent[rows],
        )  # fmt: skip

    def by_width(self) -> Iterator[tuple[Index, Array]]:
        """Rows whose groups have as many factors, and their loads (k, width)."""
        for width, rows in by_value(self.widths[self.group]):
            yield rows, self.loads[rows, :width]


def common_matches(rays: ImageRays, sides: Array, shares: Array) -> tuple[ImageRays, CommonErrors | None]:
    """Rays with the sigmas of what each has for itself, and what those of one image have in common.

    Parameters
    ----------
    rays : ImageRays
        With their whole sigmas.
    sides : (k,)
        Pixels, of the windows that were matched; 0 for none.
    shares : (k,)
        Of the variance, that windows have in common as far as they overlap.
    """
    matched = np.flatnonzero(sides > 0.0)
    places, reach = rays.places[matched].copy(), sides[matched]
    places[:, 0] += rays.image[matched] * (np.ptp(places[:, 0]) + 2.0 * reach.max() if matched.size else 0.0)
    parts = [(np.sqrt(shares[matched]), reach)]
    common, own = common_errors(places, parts, matched, rays.point[matched], rays.image[matched])
    return replace(rays, sigmas=scaled(rays.sigmas, matched, own)), common


def common_heights(surface: Surface, places: Array) -> tuple[Surface, CommonErrors | None]:
    """A terrain model as control of points at places (n, 3) in m, with the sigmas of what each height has for itself,
    and what they have in common: posts, as if a mean of those within a circle as large as a cell, and interpolation
    between laser tracks, as far as half the distance of these.
    """
    on_model, (posts, gaps) = np.flatnonzero(np.isfinite(surface.sigmas)), surface.grid.parts_of_sigmas(places)
    total = surface.sigmas[on_model]
    parts = [(sigmas[on_model] / total, SPHERE * reaches[on_model]) for sigmas, reaches in (posts, gaps)]
    common, own = common_errors(places[on_model], parts, on_model)
    return replace(surface, sigmas=scaled(surface.sigmas, on_model, own)), common


def gap_variances(places: Array, sigmas: Array, reaches: Array) -> Array:
    """Variances (n,) with which errors of `sigmas` (n,) may count as independent that places (n, 3) have in common
    within `reaches` (n,), all in m.
    """
    common, own = common_errors(places, [((sigmas > 0.0).astype(np.float64), SPHERE * reaches)], np.arange(sigmas.size))
    if common is not None:
        own = scaled(own, common.members, common.independent)
    return np.asarray((own * sigmas) ** 2)


def scaled(sigmas: Array, rows: Index, factors: Array) -> Array:
    """Sigmas (n, ...), those of some rows (m,) times factors (m,)."""
    result = sigmas.copy()
    result[rows] = (result[rows].T * factors).T
    return result


def tent(offsets: Array, sides: Array) -> Array:
    """Correlation of means over windows with `offsets` (..., 2), line and sample: the share of their `sides` (...)
    that they overlap.
    """
    return np.asarray(np.prod(np.maximum(1.0 - np.abs(offsets) / sides[..., None], 0.0), axis=-1))


def sphere(offsets: Array, ranges: Array) -> Array:
    """Spherical model of correlation of places with `offsets` (..., 3), 0 from the distances `ranges` (...) on
    (Wackernagel 2003).
    """
    near = np.minimum(np.linalg.norm(offsets, axis=-1) / ranges, 1.0)
    return np.asarray(1.0 - 1.5 * near + 0.5 * near**3)


def correlation(places: Array, parts: Sequence[tuple[Array, Array]], first: Index, second: Index) -> Array:
    """Correlation (...) of rows `first` with rows `second`, indices of shapes that broadcast: at places (n, 2) in an
    image or (n, 3) on the ground; of each part the share of a row's sigma (n,), and how far it reaches (n,).
    """
    offsets, model = places[first] - places[second], tent if places.shape[1] == 2 else sphere
    total = np.zeros(offsets.shape[:-1])
    for shares, reaches in parts:
        reach = np.minimum(reaches[first], reaches[second])
        total += shares[first] * shares[second] * model(offsets, np.maximum(reach, 1e-9)) * (reach > 0.0)
    return np.where(first == second, 1.0, total)


def common_errors(
    places: Array, parts: Sequence[tuple[Array, Array]], members: Index, point: Index | None = None,
    image: Index | None = None,
) -> tuple[CommonErrors | None, Array]:  # fmt: skip
    """Groups of rows at some places, as `correlation` has them; None where no two have anything in common.

    Parameters
    ----------
    places : (n, 2) or (n, 3)
    parts : sequence of (n,), (n,)
    members : (n,)
        What the rows are called.
    point, image : (n,), optional
        Rows of neighboring points are a group in each image: so the same points share groups in all of them. Each row
        is a point of its own, and all are of one image, when absent.

    Returns
    -------
    CommonErrors
    own : (n,)
        By what each row's sigma becomes its own.
    """
    own, groups, loads, pairs = np.ones(len(places)), list[Index](), list[Array](), _pairs(places, parts)
    points = np.arange(len(places)) if point is None else point
    for neighbors in _neighborhoods(places, pairs, points, np.zeros_like(points) if image is None else image):
        of_group, sigmas = _factors(correlation(places, parts, neighbors[:, None], neighbors))
        if of_group.size:
            own[neighbors] = sigmas
            groups.append(neighbors)
            loads.append(of_group)
    if not groups:
        return None, own
    widths = np.array([load.shape[1] for load in loads])
    rows = np.concatenate(groups)
    padded = np.concatenate([np.pad(load, ((0, 0), (0, widths.max() - load.shape[1]))) for load in loads])
    group = np.repeat(np.arange(len(groups)), [neighbors.size for neighbors in groups])
    shared = np.tile(correlation(places, parts, *pairs), 2)
    variances = 1.0 + np.bincount(np.concatenate(pairs), shared, len(places))
    links = _links(places, parts, groups, loads, pairs)
    single = np.sqrt(variances[rows]) / own[rows]
    return CommonErrors(members[rows], group, padded / own[rows][:, None], widths, single, links), own


def _pairs(places: Array, parts: Sequence[tuple[Array, Array]]) -> tuple[Index, Index]:
    """Pairs of rows that have something in common."""
    from scipy.spatial import cKDTree  # slow to import

    farthest = max(float(reaches[shares > 0.0].max(initial=0.0)) for shares, reaches in parts)
    if farthest <= 0.0:
        return no_rows(), no_rows()
    first, second = cKDTree(places).query_pairs(farthest, p=np.inf, output_type="ndarray").T
    near = correlation(places, parts, first, second) > _SLIGHT
    return first[near], second[near]


def _neighborhoods(
    places: Array, pairs: tuple[Index, Index], point: Index, image: Index
) -> list[Index]:
    """Groups of rows: in each image those of connected points, split in the middle to `MOST` at most."""
    from scipy.sparse import coo_array  # slow to import
    from scipy.sparse.csgraph import connected_components

    from_row, to_row = pairs
    if not from_row.size:
        return []
    _, first, owner = np.unique(point, return_index=True, return_inverse=True)
    links = coo_array((np.ones(from_row.size), (owner[from_row], owner[to_row])), (first.size,) * 2)
    label = connected_components(links, directed=False)[1]
    order = np.argsort(label, kind="stable")
    waiting = [part for part in np.split(order, np.flatnonzero(np.diff(label[order])) + 1) if part.size > 1]
    cluster, count = np.full(first.size, -1), 0
    while waiting:
        part = waiting.pop()
        if part.size <= MOST:
            cluster[part], count = count, count + 1
            continue
        widest = int(np.argmax(np.ptp(places[first[part]], axis=0)))
        part = part[np.argsort(places[first[part], widest], kind="stable")]
        waiting += [part[: part.size // 2], part[part.size // 2 :]]
    rows = np.flatnonzero(cluster[owner] >= 0)
    number = cluster[owner[rows]] * (int(image.max()) + 1) + image[rows]
    rows = rows[np.argsort(number, kind="stable")]
    return [part for part in np.split(rows, np.flatnonzero(np.diff(np.sort(number))) + 1) if part.size > 1]


def _factors(correlations: Array) -> tuple[Array, Array]:
    """Loads (n, q) of a group with such correlations, in whole sigmas, and the own sigma (n,) of each row."""
    values, vectors = np.linalg.eigh(correlations)
    least = max(float(values[0]), _LEAST)
    leading = values - least > min(_SEEN, _AMID * (values[-1] - least))
    loads = vectors[:, leading] * np.sqrt(values[leading] - least)
    own = np.maximum(1.0 - np.sum(loads**2, axis=1), _LEAST)
    return loads * np.sqrt((1.0 - own) / np.maximum(np.sum(loads**2, axis=1), 1e-300))[:, None], np.sqrt(own)


def _links(
    places: Array, parts: Sequence[tuple[Array, Array]], groups: list[Index], loads: list[Array],
    pairs: tuple[Index, Index],
) -> tuple[LinearRows, ...]:  # fmt: skip
    """Of each group that has something in common with groups before it, its factors given theirs."""
    number = np.full(len(places), -1)
    for g, members in enumerate(groups):
        number[members] = g
    ends = np.sort(np.stack([number[rows] for rows in pairs], axis=1), axis=1)
    ends = np.unique(ends[(ends[:, 0] != ends[:, 1]) & (ends[:, 0] >= 0)], axis=0)
    before = grouped((later, earlier) for earlier, later in ends.tolist())
    linked = {g for later, earlier_groups in before.items() for g in (later, *earlier_groups)}
    scores, links = {g: np.linalg.pinv(loads[g]) for g in linked}, list[LinearRows]()
    for later, earlier_groups in before.items():
        linked_groups = [*earlier_groups, later]
        edges = np.cumsum([0, *(scores[g].shape[0] for g in linked_groups)])
        across = np.zeros((edges[-1], edges[-1]))
        for k, g in enumerate(linked_groups):
            for h, column in zip(linked_groups[:k], edges, strict=False):
                block = scores[g] @ correlation(places, parts, groups[g][:, None], groups[h]) @ scores[h].T
                across[edges[k] : edges[k + 1], column : column + len(block.T)] = block
        across += across.T
        across *= min(1.0, (1.0 - _LEAST) / max(-float(np.linalg.eigvalsh(across)[0]), 1e-300))  # positive definite
        joint, begin = np.eye(edges[-1]) + across, edges[-2]
        weights = np.linalg.solve(joint[:begin, :begin], joint[:begin, begin:]).T
        eigenvalues, turn = np.linalg.eigh(joint[begin:, begin:] - weights @ joint[:begin, begin:])
        root = turn.T / np.sqrt(eigenvalues)[:, None]
        blocks = np.split(np.hstack([-root @ weights, root]), edges[1:-1], axis=1)
        links.append(LinearRows(tuple(linked_groups), tuple(blocks), np.zeros(len(root))))
    return tuple(links)

"""Which measures and priors share one assumption about their sigma, and a network with these sigmas scaled."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from mgsgraph.adjustment.covariances import Linearised, PointRows
from mgsgraph.adjustment.graph import Layout
from mgsgraph.adjustment.marginals import JointCovariance, one_thread
from mgsgraph.analysis.linearised import prior_rows
from mgsgraph.errors import InputError
from mgsgraph.geometry.orientation import OrientationPrior
from mgsgraph.geometry.records import Array, Index, joined_rows, no_rows
from mgsgraph.kernel.rows import GROUND, OUT
from mgsgraph.names import numbered
from mgsgraph.network import Network, Pass, PointClass, ProfileShifts

if TYPE_CHECKING:
    from scipy.sparse import csr_array

_CLASS = {PointClass.TIE: "tie", PointClass.LASER: "laser", PointClass.CONTROL: "control", PointClass.POST: "post"}
POSITION, POINTING, SHIFTS, TILTS = "position priors", "pointing priors", "shifts", "tilts"
_SHIFT = {"m": SHIFTS, "rad": TILTS}
NODE_POSITION, NODE_POINTING = "position priors of nodes", "pointing priors of nodes"
POSITION_TREND, POINTING_TREND = "position trends", "pointing trends"
RANGES, GROUND_PRIORS, HEIGHTS, STEREO_HEIGHTS = "ranges", "ground priors", "surface heights", "stereo heights"
CROSSOVERS = "crossovers"
BACK_PROJECTED = "back-projected"
"""In the names of groups of image places that are no measures."""


@dataclass(frozen=True, slots=True, eq=False)
class Grouping:
    """Groups of rows whose sigmas may be wrong by one factor; each a number, g of them."""

    names: tuple[str, ...]
    """(g,) each once."""
    rays: Index
    """(k,) group of each image ray."""
    ranges: Index
    """(r,) of each range."""
    ground: Index
    """(n,) of the a-priori place of each point; of no meaning for points without one."""
    heights: Index
    """(n,) of each point's height above the terrain model; of no meaning where it has none."""
    stereo: Index
    """(n,) of each point's height above a stereo surface; of no meaning where it has none."""
    unknowns: tuple[Index, ...]
    """Of the priors of each variable's columns: images, then shifts, then shared unknowns, then those of passes,
    then factors of errors in common."""
    crossovers: int = 0
    """Of crossovers; of no meaning without any."""

    def __post_init__(self) -> None:
        parts = [self.rays, self.ranges, self.ground, self.heights, self.stereo, *self.unknowns]
        if any(part.size and not 0 <= part.min() <= part.max() < len(self.names) for part in parts):
            raise InputError("grouping", "a group without a name", f"numbers 0 .. {len(self.names) - 1}")

    def of_observations(self, layout: Layout) -> Index:
        """(t,) group of each observation of a layout."""
        places, rows = layout.observation_rows, layout.rows
        groups = np.full(rows.weight.shape[1], -1)
        groups[places.rays], groups[places.ranges] = self.rays, self.ranges
        groups[places.heights] = self.heights[places.on_terrain]
        if layout.stereo is not None:
            groups[places.stereo] = self.stereo[layout.stereo.points]
        for pattern, first, count, _, among in rows.piece.tolist():
            observations = slice(rows.pattern_observation[pattern], rows.pattern_observation[pattern + 1])
            for i in np.flatnonzero(rows.observation_kind[observations] == GROUND).tolist():
                of_points = self.ground[layout.point_order[first : first + count]]
                groups[among + i * count : among + (i + 1) * count] = of_points
        return groups

    def of_priors(self, layout: Layout) -> Index:
        """(rows,) group of each row of the layout's prior, crossovers among them."""
        groups = self.of_columns(layout)[layout.prior.about]
        groups[groups.size - layout.prior.crossovers :] = self.crossovers
        return groups

    def of_columns(self, layout: Layout) -> Index:
        """(columns,) group of each adjusted column's prior."""
        parts = [self.unknowns[v] for v in layout.variables.adjusted()]
        return joined_rows(parts)


def group_rows(network: Network) -> Grouping:
    """The usual groups: image points of ties, of laser shots and of control, ranges, ground priors, heights above
    the terrain and above stereo surfaces, position and pointing priors, shifts, tilts of the terrain, one of each kind
    of shared unknown, and position and pointing of passes' nodes and trends. Groups without any row are left out.

    Image places that are projections with the nominal orientation are no measures and make a group of their own.
    """
    rays = network.rays
    classes = network.points.classes[rays.point]
    of_ray = np.array([f"{_CLASS[PointClass(c)]} image points" for c in range(len(PointClass))], dtype=object)[classes]
    if rays.back_projected is not None:
        of_ray[rays.back_projected] = [f"{name}, {BACK_PROJECTED}" for name in of_ray[rays.back_projected]]
    parts = [np.where(np.arange(prior.sigmas.size) % 6 < 3, POSITION, POINTING) for prior in network.priors]
    parts += [np.array([_SHIFT[term.unit] for term in terms]) for terms in network.shift_terms]
    parts += [np.full(shared.sigmas.size, f"{shared.kind} priors") for shared in network.shared]
    parts += [part for pass_ in network.passes for part in _labels_of_pass(pass_)]
    parts += _of_common(network, of_ray)
    n = len(network.points)
    ground = np.full(n if np.any(network.points.covariances) else 0, GROUND_PRIORS)
    stereo = np.full(0 if network.stereo is None else n, STEREO_HEIGHTS)
    heights = np.full(0 if network.surface is None else n, HEIGHTS)
    labels = [of_ray.astype(str), np.full(network.ranges.point.size, RANGES), ground, heights, stereo]
    polynomial = network.with_polynomial
    labels += [part for j, part in enumerate(parts) if j >= polynomial.size or polynomial[j]]
    labels.append(np.full(0 if network.crossovers is None else 1, CROSSOVERS))
    names = list(dict.fromkeys(name for part in labels for name in dict.fromkeys(part.tolist())))
    number = numbered(names)

    def numbers_in(part: Sequence[str]) -> Index:
        return np.array([number.get(name, 0) for name in part], dtype=np.int64)

    def constant(name: str, size: int) -> Index:
        return np.full(size, number.get(name, 0))

    return Grouping(
        tuple(names),
        numbers_in(of_ray.tolist()),
        constant(RANGES, network.ranges.point.size),
        constant(GROUND_PRIORS, n),
        constant(HEIGHTS, n),
        constant(STEREO_HEIGHTS, n),
        tuple(numbers_in(part.tolist()) for part in parts),
        number.get(CROSSOVERS, 0),
    )


def _of_common(network: Network, of_ray: NDArray[np.object_]) -> list[NDArray[np.object_]]:
    """Labels of the factors of errors in common: those of the rows, for they are parts of the same errors. A group may
    have lost all its rows to a rejection.
    """
    parts = list[NDArray[np.object_]]()
    for errors, of_row, _ in network.common:
        labels = np.full(errors.widths.size, of_ray[0] if of_row == 2 else HEIGHTS, dtype=object)
        if of_row == 2:
            labels[errors.group] = of_ray[errors.members]
        parts += [np.full(width * of_row, label) for width, label in zip(errors.widths.tolist(), labels, strict=True)]
    return parts


def _labels_of_pass(pass_: Pass) -> list[NDArray[np.str_]]:
    """Labels of the priors of a pass's unknowns."""
    count = len(pass_.nodes)
    labels = [np.where(angular, NODE_POINTING, NODE_POSITION) for angular in pass_.angular[:count]]
    return labels + [np.where(angular, POINTING_TREND, POSITION_TREND) for angular in pass_.angular[count:]]


def scaled(network: Network, grouping: Grouping, factors: Array) -> Network:
    """The network with the sigmas of each group times its factor (g,)."""
    factors = np.asarray(factors, dtype=np.float64)
    if factors.shape != (len(grouping.names),) or not np.all(np.isfinite(factors) & (factors > 0.0)):
        raise InputError("factors of sigmas", f"{factors}", f"{len(grouping.names)} positive numbers")
    images, shifts = len(network.images), len(network.shift_names)
    of_unknown = [factors[part] for part in grouping.unknowns]
    firsts = network.first_of_passes[:-1].tolist()
    profiles, surface, stereo = network.shifts, network.surface, network.stereo
    if profiles is not None:
        scales = np.array([of_unknown[images + p][0] for p in range(len(profiles.names))]).reshape(-1)
        profiles = ProfileShifts(profiles.names, profiles.profile, profiles.sigmas * scales)
    if surface is not None:
        scales = of_unknown[images + shifts - 1] if network.terrain_moves else np.zeros(0)
        surface = surface.scaled(factors[grouping.heights], scales)
    if stereo is not None:
        stereo = replace(stereo, sigmas=stereo.sigmas * factors[grouping.stereo])
    crossing = network.crossovers
    if crossing is not None:
        crossing = replace(crossing, sigmas=crossing.sigmas * factors[grouping.crossovers])
    own_covariances = network.points.covariances * factors[grouping.ground][:, None, None] ** 2
    return replace(
        network,
        priors=tuple(
            OrientationPrior(prior.sigmas * of_unknown[j].reshape(prior.sigmas.shape))
            for j, prior in enumerate(network.priors)
        ),
        points=replace(network.points, covariances=own_covariances),
        rays=replace(network.rays, sigmas=network.rays.sigmas * factors[grouping.rays][:, None]),
        ranges=replace(network.ranges, sigmas=network.ranges.sigmas * factors[grouping.ranges]),
        shifts=profiles,
        surface=surface,
        stereo=stereo,
        crossovers=crossing,
        shared=tuple(
            replace(shared, sigmas=shared.sigmas * of_unknown[images + shifts + k])
            for k, shared in enumerate(network.shared)
        ),
        passes=tuple(
            _scaled_pass(pass_, of_unknown[first:]) for pass_, first in zip(network.passes, firsts, strict=True)
        ),
    )


def _scaled_pass(pass_: Pass, factors: Sequence[Array]) -> Pass:
    """A pass with its a-priori sigmas times factors, `factors` being those of its unknowns, then others'."""
    trend = pass_.prior.trend_sigmas.size
    return pass_.scaled(factors[0], factors[len(pass_.nodes)] if trend else np.zeros(0))



DENSE = 2000
"""Shared unknowns up to which the last term is exact; beyond, it is estimated with random signs (Hutchinson 1990)."""
_PROBES = 64
CORRELATED = 0.5
"""Correlation of two groups' squared factors from which on a verdict names the other group."""


@dataclass(frozen=True, slots=True, eq=False)
class Redundancy:
    """What the residuals of g groups of rows say of their sigmas."""

    names: tuple[str, ...]
    """(g,) groups."""
    counts: Index
    """(g,) rows that take part."""
    sums_of_squares: Array
    """(g,) sum of the squares of the whitened residuals."""
    redundancy: Array
    """(g,) sum of the redundancy numbers, expected value of `sums_of_squares`."""
    helmert: Array
    """(g, g) Helmert's matrix; its rows add up to `redundancy`."""
    exact: bool
    """False where the matrix is an estimate with random signs."""


def group_redundancy(at: Linearised, grouping: Grouping, dense: int = DENSE) -> Redundancy:
    """Redundancy of groups of rows at a solution; `dense` as `DENSE`."""
    sums = _Sums(at, len(grouping.names))
    for rows, groups in _rows_by_group(at, grouping):
        sums.add(rows, groups)
    sums.close()
    priors, size = prior_rows(at), len(grouping.names)
    of_row = grouping.of_priors(at.layout)
    counts = sums.counts + np.bincount(of_row, minlength=size)
    sums_of_squares = sums.sums_of_squares + np.bincount(of_row, priors.misfit**2, size)
    shares = sums.shares + np.bincount(of_row, priors.share, size)
    normals = sums.normals(of_row)
    redundancy, exact = counts - shares, at.layout.columns <= dense
    if exact:
        helmert = sums.cross + _traces(normals, at.joint.dense())
        helmert[np.diag_indices(size)] += counts - 2.0 * shares
    else:
        helmert = sums.cross + _estimated_traces(normals, at.joint)
        # between groups the estimate is good; within one the rows' sum is known, which leaves no need for it
        np.fill_diagonal(helmert, 0.0)
        helmert[np.diag_indices(size)] = redundancy - helmert.sum(axis=1)
    return Redundancy(grouping.names, counts, sums_of_squares, redundancy, helmert, exact)


def _rows_by_group(at: Linearised, grouping: Grouping) -> Iterator[tuple[PointRows, Index]]:
    """Rows of points that take part and whose rows belong to the same groups (r,)."""
    of_observation, rows = grouping.of_observations(at.layout), at.rows
    for piece, (pattern, first, count, _, among) in enumerate(rows.piece.tolist()):
        inside = np.flatnonzero(rows.kind[first : first + count] != OUT)
        observations = int(rows.pattern_observation[pattern + 1] - rows.pattern_observation[pattern])
        if not inside.size or not observations:
            continue
        block = at.rows_of_piece(piece)
        groups = of_observation[among : among + observations * count].reshape(observations, count)[:, inside]
        sets, which = np.unique(groups, axis=1, return_inverse=True)
        for k, of_set in enumerate(sets.T):
            same = inside[which.reshape(-1) == k]
            part = replace(
                block, residuals=block.residuals[same], by_point=block.by_point[same], by_shared=block.by_shared[same]
            )
            yield part, of_set[part.observation]


class _Sums:
    """What is summed over the points; the blocks of N of one set of unknowns are gathered before they are put away."""

    def __init__(self, at: Linearised, groups: int) -> None:
        self._at, self._blocks = at, at.layout.blocks
        self.counts = np.zeros(groups, dtype=np.int64)
        self.sums_of_squares, self.shares, self.cross = np.zeros(groups), np.zeros(groups), np.zeros((groups, groups))
        self._flat = np.zeros((groups, self._blocks.target.size))
        self._variables: tuple[int, ...] | None = None
        self._normal, self._covariance = np.zeros((groups, 0, 0)), np.zeros((0, 0))

    @one_thread()
    def add(self, rows: PointRows, groups: Index) -> None:
        """Rows of some points, each row (r,) of one group for all of them."""
        self._open(rows.variables)
        through, rest = rows.following()
        # rows that were rejected are zero
        present = np.any(rows.by_point != 0.0, axis=2) | np.any(rows.by_shared != 0.0, axis=2) | (rows.residuals != 0.0)
        inner, outer, carried = dict[int, Array](), dict[int, Array](), dict[int, Array]()
        numbers = np.unique(groups).tolist()
        for g in numbers:
            members = groups == g
            through_group, rest_group = through[:, members], rest[:, members]
            turned = through_group.mT
            inner[g], outer[g] = (turned @ through_group).reshape(-1), _stacked(turned @ rest_group)
            flat = _stacked(rest_group)
            normal = flat.T @ flat
            carried[g] = outer[g] @ self._covariance
            self._normal[g] += normal
            self.counts[g] += np.count_nonzero(present[:, members])
            self.sums_of_squares[g] += np.sum(rows.residuals[:, members] ** 2)
            self.shares[g] += np.sum(through_group**2) + np.sum(normal * self._covariance)
        for g in numbers:
            for k in numbers:
                self.cross[g, k] += inner[g] @ inner[k] + 2.0 * np.vdot(carried[g], outer[k])

    def close(self) -> None:
        """Add the gathered blocks to the sums."""
        if self._variables is None:
            return
        layout = self._at.layout
        group = layout.group_variables.index(self._variables)
        width = layout.variables.width[list(self._variables)].tolist()
        ends, start = np.concatenate([[0], np.cumsum(width)]).tolist(), int(layout.groups.pair_first[group])
        for i, a in enumerate(width):
            for j, b in enumerate(width[i:], i):
                at = int(self._blocks.target.pair[start + i * len(width) + j])
                part = self._normal[:, ends[i] : ends[i] + a, ends[j] : ends[j] + b]
                self._flat[:, at : at + a * b] += part.reshape(part.shape[0], -1)
        self._variables = None

    def normals(self, of_row: Index) -> "list[csr_array]":
        """N of each group, with its priors' own rows, whose groups are `of_row`."""
        from scipy.sparse import coo_array  # slow to import

        layout, matrices = self._at.layout, []
        variables = layout.variables
        links = list[tuple[Index, Index, Index]]()
        """Row, column, and place in the flat arrays, of the numbers of each block."""
        for v, w, at in zip(self._blocks.first, self._blocks.second, self._blocks.offset, strict=True):
            a, b = np.arange(variables.width[v]), np.arange(variables.width[w])
            where = at + np.arange(a.size * b.size)
            first = np.repeat(variables.first[v] + a, b.size)
            second = np.tile(variables.first[w] + b, a.size)
            links += [(first, second, where)] if v == w else [(first, second, where), (second, first, where)]
        links.append((no_rows(),) * 3)
        row, column, place = (np.concatenate(part) for part in zip(*links, strict=True))
        for g, flat in enumerate(self._flat):
            values, prior = flat[place], layout.prior.design[np.flatnonzero(of_row == g)]
            taken = values != 0.0
            normal = coo_array((values[taken], (row[taken], column[taken])), shape=(layout.columns, layout.columns))
            matrices.append(normal.tocsr() + (prior.T @ prior).tocsr())
        return matrices

    def _open(self, variables: tuple[int, ...]) -> None:
        if variables != self._variables:
            self.close()
            self._variables = variables
            self._covariance = self._at.joint.of(variables) if variables else np.zeros((0, 0))
            self._normal = np.zeros((self.counts.size, *self._covariance.shape))


def _stacked(matrices: Array) -> Array:
    """(m r, c) rows of matrices (m, r, c), of which c may be none: that is, of points that held images alone see."""
    m, r, c = matrices.shape
    return matrices.reshape(m * r, c)


def _traces(normals: "list[csr_array]", covariance: Array) -> Array:
    """(g, g) tr(N_g S N_k S)."""
    half = [normal @ covariance for normal in normals]
    traces = np.zeros((len(half), len(half)))
    for g, first in enumerate(half):
        for k, second in enumerate(half[: g + 1]):
            traces[g, k] = traces[k, g] = np.sum(first * second.T)
    return traces


def _estimated_traces(normals: "list[csr_array]", joint: JointCovariance) -> Array:
    """(g, g) estimates of tr(N_g S N_k S): with S = U U' and random signs z it is E (U'N_g U z)'(U'N_k U z)."""
    signs, root = np.random.default_rng(0).choice([-1.0, 1.0], (joint.columns, _PROBES)), joint.square_root
    spread = root.back(signs)
    projected = [root.forward(normal @ spread) for normal in normals]
    return np.array([[np.sum(first * second) for second in projected] for first in projected]) / _PROBES


def nearest(by_group: Redundancy, group: int) -> tuple[str, float]:
    """The group whose residuals have most in common with those of a group that can't be judged, and minus the cosine
    between the two in Helmert's matrix: -1 where all redundancy of the one is the other's.
    """
    scale = 1.0 / np.sqrt(np.maximum(np.diag(by_group.helmert), 1e-300))
    cosines = (by_group.helmert * scale[:, None] * scale)[group]
    cosines[group] = -1.0
    k = int(np.argmax(cosines))
    return by_group.names[k], -float(cosines[k])


def most_correlated(by_group: Redundancy, judged: Index, group: int) -> tuple[str, float]:
    """The judged group whose squared factor is most correlated with that of a group, were they estimated together."""
    others = judged[judged != group]
    if not others.size or by_group.helmert[group, group] <= 0.0:
        return "", math.nan
    both = np.concatenate([[group], others])
    scale = 1.0 / np.sqrt(np.diag(by_group.helmert)[both])
    inverse = np.linalg.pinv(by_group.helmert[np.ix_(both, both)] * scale[:, None] * scale, hermitian=True)
    shared = inverse[0, 1:] / np.sqrt(np.maximum(inverse[0, 0] * np.diag(inverse)[1:], np.finfo(np.float64).tiny))
    k = int(np.argmax(np.abs(shared)))
    return by_group.names[int(others[k])], float(shared[k])

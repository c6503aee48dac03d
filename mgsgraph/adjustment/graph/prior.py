"""What is known of the shared unknowns without any point, as whitened rows: of most each by itself, about zero, of a
strip's orientation images together (`network.passes`), and of laser profiles that cross (`network.crossovers`).
"""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from mgsgraph.adjustment.graph.shared import footprint_motion
from mgsgraph.adjustment.graph.variables import Variables
from mgsgraph.geometry.body import east_north
from mgsgraph.geometry.records import Array, Index
from mgsgraph.network import Network

if TYPE_CHECKING:
    from scipy.sparse import csr_array

    from mgsgraph.adjustment.graph.patterns import PairBlocks


class PriorFactor(NamedTuple):
    """Whitened rows sum_v blocks[v] x_v - target on a few variables."""

    variables: tuple[int, ...]
    """Ascending."""
    blocks: tuple[Array, ...]
    """Of each a matrix (rows, width)."""
    about: Index
    """(rows,) column of the shared unknowns that each row is chiefly about."""
    target: Array
    """(rows,) zero but for crossovers."""


@dataclass(frozen=True, eq=False)
class Prior:
    """Half the sum of squares of all its rows is the prior's part of the cost."""

    columns: int
    """Number of shared unknowns."""
    weights: Array
    """(columns,) 1/m and 1/rad of unknowns that are known each by itself; 0 of strips', and where nothing is known."""
    factors: tuple[PriorFactor, ...]
    """On the unknowns of strips, then those of crossovers, one row each."""
    first: Index
    """(v,) first column of each variable."""
    considered: tuple[int, ...] = ()
    """Variables with considered columns: they get a joint covariance, whatever the observations say."""
    crossovers: int = 0
    """Rows at the end that are crossovers."""

    @property
    def pairs(self) -> list[tuple[int, int]]:
        """Pairs of variables, first < second, that some factor joins."""
        members = [*(factor.variables for factor in self.factors), self.considered]
        return sorted({(v, w) for mine in members for k, v in enumerate(mine) for w in mine[k + 1 :]})

    @cached_property
    def root(self) -> "csr_array":
        """(rows, columns) of the factors alone."""
        from scipy.sparse import coo_array  # slow to import

        rows, columns, values, count = [np.zeros(0, dtype=np.int64)], [np.zeros(0, dtype=np.int64)], [np.zeros(0)], 0
        for factor in self.factors:
            for v, block in zip(factor.variables, factor.blocks, strict=True):
                row, column = np.nonzero(block)
                rows.append(count + row)
                columns.append(self.first[v] + column)
                values.append(block[row, column])
            count += factor.blocks[0].shape[0]
        entries = np.concatenate(values), (np.concatenate(rows), np.concatenate(columns))
        return coo_array(entries, shape=(count, self.columns)).tocsr()

    @cached_property
    def every(self) -> "csr_array":
        """(rows, columns) of all rows: those of unknowns known each by itself, then the factors'."""
        from scipy.sparse import csr_array, vstack  # slow to import

        known = np.flatnonzero(self.weights)
        own = csr_array((self.weights[known], (np.arange(known.size), known)), shape=(known.size, self.columns))
        return csr_array(vstack([own, self.root]))

    @cached_property
    def about(self) -> Index:
        """(rows,) column that each row is chiefly about."""
        return np.concatenate([np.flatnonzero(self.weights), *(factor.about for factor in self.factors)])

    @cached_property
    def target(self) -> Array:
        """(rows of factors,) what the factors' rows are about."""
        return np.concatenate([np.zeros(0), *(factor.target for factor in self.factors)])

    @cached_property
    def joined(self) -> frozenset[int]:
        """Variables that some factor joins with others."""
        return frozenset(v for factor in self.factors for v in factor.variables)

    @property
    def group(self) -> Index:
        """(v,) number of the set of variables that factors join, one with the next, to which each belongs."""
        from scipy.sparse import coo_array  # slow to import
        from scipy.sparse.csgraph import connected_components

        one, other = np.array(self.pairs, dtype=np.int64).reshape(-1, 2).T
        links = coo_array((np.ones(one.size), (one, other)), (self.first.size, self.first.size))
        return np.asarray(connected_components(links, directed=False)[1], dtype=np.int64)

    @property
    def rows(self) -> int:
        """Number of rows."""
        return int(np.count_nonzero(self.weights)) + sum(factor.about.size for factor in self.factors)

    def residuals(self, values: Array) -> Array:
        """(columns + rows of factors,) whitened, of all unknowns (columns,); zero where nothing is known."""
        own = values * self.weights
        return np.append(own, self.root @ values - self.target) if self.factors else own

    def cost(self, values: Array) -> float:
        """Of all unknowns (columns,)."""
        residuals = self.residuals(values)
        return 0.5 * float(residuals @ residuals)

    def gradient(self, values: Array) -> Array:
        """(columns,) per m and rad."""
        own = values * self.weights**2
        return own + self.root.T @ (self.root @ values - self.target) if self.factors else own

    def normal(self) -> Array:
        """(columns, columns) of all rows; for small networks."""
        own = np.diag(self.weights**2)
        return own + (self.root.T @ self.root).toarray() if self.factors else own

    def whitening(self, scales: Array) -> "csr_array | None":
        """(rows, columns) square root of all this information on unknowns in units of `scales` (columns,), of order one
        where nothing is known; None without factors: then it is the identity.
        """
        from scipy.sparse import csr_array, diags_array, vstack  # slow to import

        if not self.factors:
            return None
        known = self.every @ diags_array(scales)
        unknown = np.flatnonzero(np.asarray(abs(known).sum(axis=0)).ravel() == 0.0)
        ones = csr_array((np.ones(unknown.size), (np.arange(unknown.size), unknown)), (unknown.size, self.columns))
        return csr_array(vstack([known, ones]))

    def information(self, blocks: "PairBlocks") -> Array:
        """The factors' normal matrix, flat in the blocks of the reduced one; empty where there are none."""
        if not self.factors:
            return np.zeros(0)
        pairs = zip(blocks.first.tolist(), blocks.second.tolist(), strict=True)
        place = dict(zip(pairs, blocks.offset.tolist(), strict=True))
        flat = np.zeros(blocks.target.size)
        for variables, own, _, _ in self.factors:
            for k, v in enumerate(variables):
                for w, other in zip(variables[k:], own[k:], strict=True):
                    product = own[k].T @ other
                    flat[place[v, w] : place[v, w] + product.size] += product.ravel()
        return flat


def make_prior(network: Network, variables: Variables) -> Prior:
    """Of a network."""
    weights = 1.0 / variables.prior_sigmas
    factors = list[PriorFactor]()
    for strip, first in network.numbered_passes:
        weights[variables.columns_from(first, strip.widths.size)] = 0.0
        for unknowns, blocks, about in strip.prior.factors(strip.nodes):
            columns = variables.first[first + about[:, 0]] + about[:, 1]
            joined = tuple(first + k for k in unknowns)
            factors.append(PriorFactor(joined, blocks, columns, np.zeros(columns.size)))
    of_crossovers = list(_of_crossovers(network, variables))
    return Prior(
        variables.sigmas.size, weights, (*factors, *of_crossovers), variables.first,
        tuple(variables.with_considered), len(of_crossovers),
    )  # fmt: skip


def _of_crossovers(network: Network, variables: Variables) -> Iterator[PriorFactor]:
    """Rows of crossovers, one factor each: they depend on the shifts of two profiles, and on what moves their shots."""
    crossing, shifts, places = network.crossovers, network.shifts, network.points.places
    if crossing is None or shifts is None:
        return
    effects, shots = dict[int, Array](), crossing.shots
    ways = east_north(places[shots.ravel()]).reshape(*shots.shape, 2, 3).swapaxes(2, 3)
    for p in np.unique(shifts.profile[shots]).tolist():
        mine = (shifts.profile[shots] == p)[:, :, None, None]
        effects[len(network.images) + p] = crossing.effect(places, np.where(mine, ways, 0.0))
    for k, shared in enumerate(network.shared):
        if shared.kind.moves_footprints:
            points, motion = footprint_motion(network, shared)
            index = np.searchsorted(points, shots).clip(max=points.size - 1)
            moved = np.where((points[index] == shots)[:, :, None, None], motion[index].swapaxes(2, 3), 0.0)
            effects[network.first_shared + k] = crossing.effect(places, moved)
    differences = crossing.differences(places)
    for row, sigma in enumerate(crossing.sigmas.tolist()):
        mine = [v for v in sorted(effects) if np.any(effects[v][row] != 0.0)]
        blocks = tuple(effects[v][row][None] / sigma for v in mine)
        about = np.array([variables.first[mine[0]]])
        yield PriorFactor(tuple(mine), blocks, about, np.array([-differences[row] / sigma]))

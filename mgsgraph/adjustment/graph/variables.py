"""The unknowns that points share, in the order of the columns of one vector, and their priors.

Priors are whitened rows: of most unknowns each by itself, about zero; jointly of a pass's orientation images
(`network.passes`), and of laser profiles that cross (`network.crossovers`). And the directions of the unknowns in the
states of the observations.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from mgsgraph.geometry.body import east_north
from mgsgraph.geometry.records import Array, Index, Mask, joined_rows, no_rows
from mgsgraph.network import HELD, Network

if TYPE_CHECKING:
    from scipy.sparse import csr_array
from mgsgraph.geometry.orientation import Angles
from mgsgraph.kernel.rows import CAMERA, OPK_PAPER, OPK_PEER, Model
from mgsgraph.network.effects import crossover_rows, footprint_motion


@dataclass(frozen=True, slots=True, eq=False)
class Variables:
    """Unknowns that points share: orientation coefficients of images, horizontal shifts of profiles, shift and tilt of
    the terrain model, those of `Network.shared`, orientation images of passes, and factors of errors in common.

    Variable j is image j, variable `images` + p is profile p, after the profiles may come the terrain model, and then
    come the shared unknowns; then, pass by pass, its nodes and its trend; then the groups of errors in common. An image
    that is held, or of a pass, has no columns.
    """

    images: int
    """Number of images."""
    first: Index
    """(v,) first column of each variable in the orientation vector; -1 for one without columns."""
    width: Index
    """(v,) number of its columns."""
    sigmas: Array
    """(columns,) a-priori sigmas, m and rad, each by itself; infinite where nothing is known."""
    angular: Mask
    """(columns,) True for a column in rad."""
    considered: Mask
    """(columns,) True for one that is held at zero, while its a-priori covariance is carried."""

    @property
    def prior_sigmas(self) -> Array:
        """(columns,) sigmas of the priors about zero in the solver, m and rad: those that hold considered unknowns."""
        return self.sigmas * np.where(self.considered, HELD, 1.0)

    @property
    def with_considered(self) -> list[int]:
        """Variables of which some column is considered."""
        return [v for v in self.adjusted() if np.any(self.considered[self.columns_of(v)])]

    def columns_of(self, variable: int) -> slice:
        """Columns of one variable."""
        first = int(self.first[variable])
        return slice(first, first + int(self.width[variable]))

    def columns_of_all(self, variables: Iterable[int]) -> Index:
        """Columns of some variables, one after the other."""
        each = [self.first[v] + np.arange(self.width[v]) for v in variables]
        return joined_rows(each)

    def columns_from(self, variable: int, count: int) -> slice:
        """Columns of `count` adjusted variables, one after the other, from one on."""
        return slice(self.columns_of(variable).start, self.columns_of(variable + count - 1).stop)

    def adjusted(self) -> list[int]:
        """Variables that have columns."""
        return [int(v) for v in np.flatnonzero(self.first >= 0)]

    def joined(self, values: Sequence[Array]) -> Array:
        """(columns,) vector of the values (width,) of all variables."""
        return np.concatenate([np.zeros(0), *(values[v] for v in self.adjusted())])

    def split(self, vector: Array) -> list[Array]:
        """Values (width,) of all variables in a vector (columns,); zeros where a variable has no columns."""
        return [
            vector[self.columns_of(v)] if first >= 0 else np.zeros(int(self.width[v]))
            for v, first in enumerate(self.first.tolist())
        ]


def make_variables(network: Network) -> Variables:
    """Of a network."""
    sigmas = [prior.sigmas.ravel() for prior in network.priors]
    angular = [np.arange(part.size) % 6 >= 3 for part in sigmas]
    sigmas += [np.array([term.sigma for term in terms]) for terms in network.shift_terms]
    angular += [np.array([term.unit == "rad" for term in terms]) for terms in network.shift_terms]
    sigmas += [shared.sigmas for shared in network.shared]
    angular += [np.full(shared.kind.width, shared.kind.unit == "rad") for shared in network.shared]
    sigmas += [part for pass_ in network.passes for part in pass_.sigmas]
    angular += [part for pass_ in network.passes for part in pass_.angular]
    considered = [np.zeros(prior.sigmas.size, dtype=bool) for prior in network.priors]
    for name, terms in zip(network.shift_names, network.shift_terms, strict=True):  # heights and tilts are estimated
        considered.append(np.array([term.horizontal and name in network.considered for term in terms]))
    considered += [np.full(shared.kind.width, shared.name in network.considered) for shared in network.shared]
    considered += [np.zeros(part.size, dtype=bool) for pass_ in network.passes for part in pass_.sigmas]
    factors = network.widths[len(sigmas) :]
    sigmas += [np.ones(size) for size in factors]
    for flags in (angular, considered):
        flags += [np.zeros(size, dtype=bool) for size in factors]
    width = np.array([part.size for part in sigmas], dtype=np.int64)
    adjusted = np.concatenate([network.with_polynomial, np.ones(len(sigmas) - len(network.images), dtype=bool)])
    first = np.where(adjusted, np.cumsum(width * adjusted) - width, -1)
    columns = np.repeat(adjusted, width)
    columns_of_all = (np.concatenate(part)[columns] for part in (sigmas, angular, considered))
    return Variables(len(network.images), first, width, *columns_of_all)


class PriorFactor(NamedTuple):
    """Whitened rows sum_v blocks[v] x_v - target on a few variables."""

    variables: tuple[int, ...]
    """Ascending."""
    blocks: tuple[Array, ...]
    """Of each a matrix (rows, width)."""
    about: Index
    """(rows,) column of the main shared unknown of each row."""
    target: Array
    """(rows,) zero for orientation images."""


@dataclass(frozen=True, eq=False)
class Prior:
    """Half the sum of squares of all its rows is the prior's part of the cost."""

    columns: int
    """Number of shared unknowns."""
    weights: Array
    """(columns,) 1/m and 1/rad of unknowns with a prior of their own; 0 for those of passes, and without a prior."""
    factors: tuple[PriorFactor, ...]
    """On the unknowns of passes, those of the user's own, then those of crossovers, one row each."""
    first: Index
    """(v,) first column of each variable."""
    considered: tuple[int, ...] = ()
    """Variables with considered columns: they always get a joint covariance."""
    crossovers: int = 0
    """Rows at the end that are crossovers."""

    @property
    def pairs(self) -> list[tuple[int, int]]:
        """Pairs of variables, first < second, that some factor connects."""
        members = [*(factor.variables for factor in self.factors), self.considered]
        return sorted({(v, w) for joined in members for k, v in enumerate(joined) for w in joined[k + 1 :]})

    @cached_property
    def root(self) -> "csr_array":
        """(rows, columns) of the factors alone."""
        from scipy.sparse import coo_array  # slow to import

        rows, columns, values, count = [no_rows()], [no_rows()], [np.zeros(0)], 0
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
    def design(self) -> "csr_array":
        """(rows, columns) of all rows: priors of single unknowns, then the factors'."""
        from scipy.sparse import csr_array, vstack  # slow to import

        with_prior = np.flatnonzero(self.weights)
        count = with_prior.size
        single = csr_array((self.weights[with_prior], (np.arange(count), with_prior)), shape=(count, self.columns))
        return csr_array(vstack([single, self.root]))

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

        first, second = np.array(self.pairs, dtype=np.int64).reshape(-1, 2).T
        links = coo_array((np.ones(first.size), (first, second)), (self.first.size, self.first.size))
        return np.asarray(connected_components(links, directed=False)[1], dtype=np.int64)

    @property
    def rows(self) -> int:
        """Number of rows."""
        return int(np.count_nonzero(self.weights)) + sum(factor.about.size for factor in self.factors)

    def residuals(self, values: Array) -> Array:
        """(columns + rows of factors,) whitened, of all unknowns (columns,); zero where nothing is known."""
        single = values * self.weights
        return np.append(single, self.root @ values - self.target) if self.factors else single

    def cost(self, values: Array) -> float:
        """Of all unknowns (columns,)."""
        residuals = self.residuals(values)
        return 0.5 * float(residuals @ residuals)

    def gradient(self, values: Array) -> Array:
        """(columns,) per m and rad."""
        single = values * self.weights**2
        return single + self.root.T @ (self.root @ values - self.target) if self.factors else single

    def normal(self) -> Array:
        """(columns, columns) of all rows; for small networks."""
        single = np.diag(self.weights**2)
        return single + (self.root.T @ self.root).toarray() if self.factors else single

    def whitening(self, scales: Array) -> "csr_array | None":
        """(rows, columns) square root of all this information on unknowns in units of `scales` (columns,), of order one
        where nothing is known; None without factors: then it is the identity.
        """
        from scipy.sparse import csr_array, diags_array, vstack  # slow to import

        if not self.factors:
            return None
        rows = self.design @ diags_array(scales)
        unknown = np.flatnonzero(np.asarray(abs(rows).sum(axis=0)).ravel() == 0.0)
        ones = csr_array((np.ones(unknown.size), (np.arange(unknown.size), unknown)), (unknown.size, self.columns))
        return csr_array(vstack([rows, ones]))


def make_prior(network: Network, variables: Variables) -> Prior:
    """Of a network."""
    weights = 1.0 / variables.prior_sigmas
    factors = list[PriorFactor]()
    for pass_, first in network.numbered_passes:
        weights[variables.columns_from(first, pass_.widths.size)] = 0.0
        for unknowns, blocks, about in pass_.prior.factors(pass_.nodes):
            columns = variables.first[first + about[:, 0]] + about[:, 1]
            factors.append(PriorFactor(tuple(first + k for k in unknowns), blocks, columns, np.zeros(columns.size)))
    for link in network.common_links:
        about = np.arange(weights.size)[variables.columns_of(link.variables[-1])]
        weights[about] = 0.0
        factors.append(PriorFactor(link.variables, link.blocks, about, link.target))
    for linear in network.linear:
        about = np.repeat(variables.first[linear.variables[0]], linear.target.size)
        factors.append(PriorFactor(linear.variables, linear.blocks, about, linear.target))
    of_crossovers = [
        PriorFactor(row.variables, row.blocks, variables.first[list(row.variables[:1])], row.target)
        for row in crossover_rows(network)
    ]
    return Prior(
        variables.sigmas.size, weights, (*factors, *of_crossovers), variables.first,
        tuple(variables.with_considered), len(of_crossovers),
    )  # fmt: skip


ANGLE_CODES: dict[Angles, int] = {"camera": CAMERA, "opk-paper": OPK_PAPER, "opk-peer": OPK_PEER}
"""Code of each."""
_NAMES = {code: name for name, code in ANGLE_CODES.items()}


def angles_of(model: Model) -> Angles:
    """Name of the one that a model has."""
    return _NAMES[model.angles]


def shared_values(network: Network, variables: Variables, orientation: Array) -> tuple[Array, ...]:
    """Value (width,) of each shared unknown, in the vector (columns,) of all that points share."""
    first = network.first_shared
    return tuple(orientation[variables.columns_of(first + k)] for k in range(len(network.shared)))


def shift_values(network: Network, variables: Variables, orientation: Array) -> tuple[Array, Array | None]:
    """(p, 2) m east and north of each shift, and (w,) m and rad of the terrain model's height and tilt, None where they
    are known, in the vector (columns,) of all that points share.
    """
    first, surface = len(network.images), network.surface
    values = [orientation[variables.columns_of(first + p)] for p in range(len(network.shift_names))]
    if surface is None or not surface.raised:
        return np.array(values).reshape(-1, 2), None
    level = 2 if surface.shift_sigma else 0
    values[-1], lift = np.pad(values[-1][:level], (0, 2 - level)), values[-1][level:]
    return np.array(values), lift


def pass_values(
    network: Network, variables: Variables, orientation: Array
) -> tuple[tuple[Array, ...], tuple[Array, ...]]:
    """Of each pass its nodes (k, 6) and its trend (w,), in the vector (columns,) of all that points share."""
    nodes, trends = list[Array](), list[Array]()
    for pass_, first in network.numbered_passes:
        columns = variables.columns_from(first, len(pass_.nodes))
        nodes.append(orientation[columns].reshape(-1, 6))
        trends.append(orientation[columns.stop : columns.stop + pass_.prior.trend_sigmas.size])
    return tuple(nodes), tuple(trends)


def crossover_differences(network: Network, shifts: Array, values: tuple[Array, ...]) -> Array:
    """(m,) m, heights of the first profile minus those of the second where two cross, by shifts (p, 2) in m of the
    profiles and values of all shared unknowns.
    """
    if network.crossovers is None or network.shifts is None:
        return np.zeros(0)
    places, shots = network.points.places, network.crossovers.shots.ravel()
    moved = footprint_shifts(network, values)[shots]
    moved += np.einsum("pk,pkj->pj", shifts[network.shifts.profile[shots]], east_north(places[shots]))
    return network.crossovers.differences(places) + network.crossovers.effect(places, moved.reshape(-1, 4, 3))


def footprint_shifts(network: Network, values: tuple[Array, ...]) -> Array:
    """(n, 3) m by which the values of all shared unknowns move a-priori places."""
    moved = np.zeros((len(network.points), 3))
    for shared, value in zip(network.shared, values, strict=True):
        if shared.kind.moves_footprints:
            points, motion = footprint_motion(network, shared)
            moved[points] += np.einsum("k,pkc->pc", value, motion)
    return moved

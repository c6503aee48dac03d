"""Whether unknowns that images share can be told apart from all others, and which of their mixtures are determined.

Of each component k, with S the posterior covariance of all unknowns (points eliminated) and N its inverse:

    gain         sqrt(S_kk) / a-priori sigma                    1: the measures say nothing about it
    correlation  S_kj / sqrt(S_kk S_jj)                         the largest, over all other unknowns j
    together     sqrt(1 - 1 / (S_kk N_kk))                      multiple correlation with all others

S_kk N_kk is the variance inflation factor of regression. Both correlations are the posterior's, priors included. The
determined mixtures are eigenvectors of the posterior of the shared unknowns, each in units of its a-priori sigma: an
eigenvalue far below one is a combination that the measures determine, whatever its members are.
"""

from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from mgsgraph.adjustment.solution import Solution
from mgsgraph.adjustment.square_root import SquareRoot
from mgsgraph.geometry.orientation import COMPONENTS
from mgsgraph.geometry.records import Array, Index
from mgsgraph.network import Network
from mgsgraph.record import Record

INSEPARABLE = 0.95
"""Correlation from which two unknowns count as not separable."""
FROM_PRIOR = 0.9
"""Share of the a-priori sigma from which an unknown counts as determined by its prior alone."""
_DETERMINED = 0.3
"""Share of the a-priori sigmas up to which a mixture counts as determined."""
_MEMBER = 0.2
"""Share of the largest coefficient from which an unknown is named in a mixture."""


class Verdict(StrEnum):
    """What can be said of an unknown."""

    SEPARABLE = "separable"
    """No other unknown, nor all of them together, correlates with it by 0.95."""
    FROM_PRIOR = "from its prior alone"
    """Its sigma is what it was beforehand."""
    NOT_FROM_ONE = "not separable from one other"
    """One other unknown correlates with it by 0.95 or more."""
    NOT_FROM_OTHERS = "not separable from others together"
    """None by itself, but a mixture of the others does."""


@dataclass(frozen=True, slots=True)
class Separation(Record):
    """What tells one component of a shared unknown apart."""

    name: str
    """Unknown and component."""
    gain: float
    """Posterior over a-priori sigma."""
    other: str
    """The unknown with which it correlates most; empty without any other."""
    correlation: float
    """With that one, with its sign."""
    together: float
    """Multiple correlation with all others, 0 to 1."""

    @property
    def verdict(self) -> Verdict:
        """What can be said of it."""
        if self.gain >= FROM_PRIOR:
            return Verdict.FROM_PRIOR
        if abs(self.correlation) >= INSEPARABLE:
            return Verdict.NOT_FROM_ONE
        return Verdict.NOT_FROM_OTHERS if self.together >= INSEPARABLE else Verdict.SEPARABLE

    @property
    def sentence(self) -> str:
        """The verdict, with its figures."""
        most = f"most like {self.other}, r = {self.correlation:+.2f}" if self.other else "nothing else is unknown"
        return {
            Verdict.FROM_PRIOR: f"Determined by its prior alone: {100.0 * self.gain:.0f} % of its sigma are left.",
            Verdict.NOT_FROM_ONE: f"Not separable from {self.other}: r = {self.correlation:+.3f}.",
            Verdict.NOT_FROM_OTHERS: f"Not separable from all others together: r = {self.together:.3f} ({most}).",
            Verdict.SEPARABLE: f"Separable: r = {self.together:.2f} with all other unknowns ({most}).",
        }[self.verdict]


@dataclass(frozen=True, slots=True, eq=False)
class Mixture(Record):
    """A combination of shared unknowns that the measures determine."""

    names: tuple[str, ...]
    """Its members, two or more."""
    coefficients: Array
    """(k,) per a-priori sigma of each, the largest 1 or -1."""
    gain: float
    """Its posterior sigma over its a-priori one."""

    @property
    def words(self) -> str:
        """As a formula in a-priori sigmas."""
        terms = [f"{c:+.2g} {name}" for c, name in zip(self.coefficients.tolist(), self.names, strict=True)]
        return f"{' '.join(terms)} (each per a-priori sigma), to {self.gain:.2g} of what was known of it"


def separations(solution: Solution) -> tuple[Separation, ...]:
    """Of all components of all shared unknowns, in their order."""
    network, root = solution.network, solution.joint_covariance.square_root
    own, names = _shared_columns(solution), column_names(network, root)
    if not own.size:
        return ()
    right = np.zeros((root.columns, own.size))
    right[own, np.arange(own.size)] = 1.0
    covariance = root.covariance_times(right)
    sigmas, mine = solution.joint_covariance.sigmas, covariance[own, np.arange(own.size)]
    correlation = covariance / np.outer(sigmas, np.sqrt(mine))
    correlation[own, np.arange(own.size)] = 0.0
    prior = np.concatenate([one.sigmas for one in network.shared])
    information = information_of(root, own)
    others = np.abs(correlation).argmax(axis=0)
    return tuple(
        Separation(
            names[own[k]],
            float(np.sqrt(mine[k]) / prior[k]),
            names[other] if root.columns > 1 else "",
            float(correlation[other, k]),
            float(np.sqrt(max(0.0, 1.0 - 1.0 / (mine[k] * information[k])))),
        )
        for k, other in enumerate(others.tolist())
    )


def mixtures(solution: Solution) -> tuple[Mixture, ...]:
    """Combinations of two or more shared unknowns that the measures determine, the best known first; those of a single
    one are said by its own gain.
    """
    own = _shared_columns(solution)
    if own.size < 2:
        return ()
    names = column_names(solution.network, solution.joint_covariance.square_root)
    first = solution.network.first_shared
    covariance = solution.joint_covariance.of(range(first, first + len(solution.network.shared)))
    prior = np.concatenate([one.sigmas for one in solution.network.shared])
    values, vectors = np.linalg.eigh(covariance / np.outer(prior, prior))
    found = []
    for value, vector in zip(values.tolist(), vectors.T, strict=True):
        size = np.abs(vector) / np.abs(vector).max()
        members = np.flatnonzero(size >= _MEMBER)
        if np.sqrt(max(value, 0.0)) <= _DETERMINED and members.size > 1:
            scaled = vector[members] / vector[np.abs(vector).argmax()]
            found.append(Mixture(tuple(names[own[k]] for k in members), scaled, float(np.sqrt(max(value, 0.0)))))
    return tuple(found)


def _shared_columns(solution: Solution) -> Index:
    """Columns of the shared unknowns, in their order."""
    first, begins = solution.network.first_shared, solution.joint_covariance.square_root.first
    parts = [begins[first + k] + np.arange(one.kind.width) for k, one in enumerate(solution.network.shared)]
    return np.concatenate([np.zeros(0, dtype=np.int64), *parts])


def column_names(network: Network, root: SquareRoot) -> list[str]:
    """What each column of the unknowns is, as a person calls it."""
    names = [""] * root.columns
    for variable in root.adjusted.tolist():
        for inside in range(int(root.width[variable])):
            names[int(root.first[variable]) + inside] = _name(network, variable, inside)
    return names


def _name(network: Network, variable: int, inside: int) -> str:
    if variable < len(network.images):
        power, component = divmod(inside, 6)
        term = ("constant", "linear", "quadratic", "cubic")[power] if power < 4 else f"u^{power}"
        return f"{term} {COMPONENTS[component]} of image {network.images[variable].name}"
    if variable >= network.first_of_passes[0]:
        one, unknown = network.of_passes(variable)
        what, component = one.part(unknown, inside)
        return f"{COMPONENTS[component]} of {what} of pass {one.name}"
    if variable < network.first_shared:
        k = variable - len(network.images)
        return f"{network.shift_terms[k][inside].name} of {network.shift_names[k]}"
    shared = network.shared[variable - network.first_shared]
    return f"{shared.name} {shared.kind.components[inside]}".strip()


def information_of(root: SquareRoot, columns: Index) -> Array:
    """(d,) information on each of some columns, all others held: the diagonal of the normal matrix."""
    squares = np.zeros(root.columns)
    for clique, members in enumerate(root.columns_of):
        np.add.at(squares, members, np.einsum("rc,rc->c", root.rows_of(clique), root.rows_of(clique)))
    return np.asarray(squares[columns])

"""What an adjustment cannot separate: mounting angles, lever arms and times, attitude and position of a pass.

Of each pass the mean correction of position (along, across, radial) and of attitude (roll, pitch, yaw) over its time
are compared with each other and with the unknowns that its images share, all in the axes of the flight, by their
posterior correlations. Where one exceeds a limit, a mixture of the two is known far better than either: the
eigenvector of the smallest eigenvalue of their correlation matrix. Priors are in the posterior: it is their ratio that
splits what the measures know of the mixture alone.

Each component k of an unknown that images share is also compared with all other unknowns. With S the posterior
covariance of all unknowns (points eliminated) and N its inverse:

    gain         sqrt(S_kk) / a-priori sigma                    1: the measures say nothing about it
    correlation  S_kj / sqrt(S_kk S_jj)                         the largest, over all other unknowns j
    together     sqrt(1 - 1 / (S_kk N_kk))                      multiple correlation with all others

S_kk N_kk is the variance inflation factor of regression. Both correlations are the posterior's, priors included.
"""

from dataclasses import dataclass
from enum import StrEnum
from typing import TYPE_CHECKING

import numpy as np

from mgsgraph.adjustment.frames import camera_axes, flight_axes
from mgsgraph.adjustment.marginals import JointCovariance, SquareRoot
from mgsgraph.adjustment.solution import Solution
from mgsgraph.analysis.linearised import unknown_name
from mgsgraph.analysis.statistics import pass_turns
from mgsgraph.geometry.image import PushbroomImage
from mgsgraph.geometry.orientation import Angles
from mgsgraph.geometry.records import Array, Index, by_value, joined_rows, place_of
from mgsgraph.network import Network, SharedKind, SharedUnknown
from mgsgraph.network.shared import ground_shift
from mgsgraph.record import Record
from mgsgraph.units import ARCSEC

if TYPE_CHECKING:
    pass

LIMIT = 0.95
"""Correlation above which two quantities are inseparable."""
_PLACES = 65
"""Times over which a pass's corrections are averaged."""
_PARTS = ("along-track position", "across-track position", "radial position", "roll", "pitch", "yaw")
_TURNING = (SharedKind.CAMERA_BORESIGHT, SharedKind.ALTIMETER_BORESIGHT)
_ARMS = (SharedKind.CAMERA_LEVER_ARM, SharedKind.ALTIMETER_LEVER_ARM)
_IN_MIXTURE = 0.2
"""Of the largest coefficient, from what share on a quantity belongs to a mixture."""
_LEAST_SHARE = 0.05
"""Of the largest, what a coefficient of a mixture is named from, both in posterior sigmas."""
FROM_PRIOR = 0.9
"""Share of the a-priori sigma from which an unknown counts as determined by its prior alone."""


@dataclass(frozen=True, slots=True, eq=False)
class Quantity:
    """A mean correction of a pass, or a component of a shared unknown."""

    name: str
    """As a person calls it."""
    owner: str
    """Pass or shared unknown."""
    unit: str
    """m, arcsec, s or ppm."""
    sigma: float
    """Posterior, in that unit."""


@dataclass(frozen=True, slots=True, eq=False)
class Inseparable(Record):
    """Quantities that correlate by more than the limit, two by two or one with the others together, and the mixture of
    them that is known best.
    """

    quantities: tuple[Quantity, ...]
    """Two or more."""
    correlation: float
    """Largest between two of them, with its sign."""
    coefficients: Array
    """(k,) of the best-known mixture, in the first one's unit per unit of each; that of the first is 1."""
    sigma: float
    """Posterior sigma of the mixture, in the first one's unit."""

    @property
    def mixture(self) -> str:
        """The mixture as a formula."""
        first, *others = self.quantities
        share = np.abs(self.coefficients) * [quantity.sigma for quantity in self.quantities]
        terms = [
            f"{'+' if c > 0.0 else '-'} {abs(c):.4g} {_ratio(first.unit, quantity.unit)}x {quantity.name}"
            for quantity, c, s in zip(others, self.coefficients[1:].tolist(), share[1:].tolist(), strict=True)
            if s > _LEAST_SHARE * share.max()
        ]
        return " ".join([first.name, *terms])

    @property
    def sentence(self) -> str:
        """A sentence with figures and units."""
        names = [f"{quantity.name} (sigma {quantity.sigma:.3g} {quantity.unit})" for quantity in self.quantities]
        listed = f"{', '.join(names[:-1])} and {names[-1]}"
        of = "correlation" if len(names) == 2 else "largest correlation of two"
        return (
            f"{listed} are inseparable ({of} {self.correlation:+.3f}); determined is {self.mixture}, to "
            f"{self.sigma:.3g} {self.quantities[0].unit}."
        )


def _ratio(unit: str, second: str) -> str:
    return "" if unit == second else f"{unit or '1'}/{second or '1'} "


def inseparable(
    network: Network, joint: JointCovariance, angles: Angles
) -> tuple[Inseparable, ...]:
    """Groups of quantities of passes and shared unknowns that the posterior cannot separate.

    Parameters
    ----------
    network : Network
        Without passes nothing is found.
    joint : JointCovariance
        Posterior of its unknowns.
    angles : Angles
        What rotations of corrections are.
    """
    if not network.passes:
        return ()
    named, design = _quantities(network, joint, angles)
    covariance = design.T @ joint.square_root.covariance_times(design)
    sigmas = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    determined = np.flatnonzero(sigmas > 0.0)
    correlation = covariance[np.ix_(determined, determined)] / np.outer(sigmas[determined], sigmas[determined])
    groups = []
    for group in _groups(correlation, LIMIT):
        members = determined[group].tolist()
        quantities = [Quantity(named[k][0], named[k][1], named[k][2], float(sigmas[k])) for k in members]
        groups.append(_inseparable(quantities, correlation[np.ix_(group, group)]))
    return tuple(sorted(groups, key=lambda group_found: group_found.sigma / group_found.quantities[0].sigma))


def _inseparable(quantities: list[Quantity], correlation: Array) -> Inseparable:
    values, vectors = np.linalg.eigh(correlation)
    sigmas = np.array([quantity.sigma for quantity in quantities])
    lead = int(np.abs(vectors[:, 0]).argmax()) if abs(vectors[0, 0]) < _LEAST_SHARE else 0
    order = [lead, *(k for k in range(len(quantities)) if k != lead)]
    coefficients = (vectors[:, 0] / sigmas)[order]
    off = correlation - np.eye(len(quantities))
    largest = float(off.flat[np.abs(off).argmax()])
    scale = float(coefficients[0])
    sigma = float(np.sqrt(max(values[0], 0.0))) / abs(scale)
    return Inseparable(tuple(quantities[k] for k in order), largest, coefficients / scale, sigma)


def _groups(correlation: Array, limit: float) -> list[Index]:
    """Groups that are connected by pairs; then each quantity of none of them whose multiple correlation with all others
    exceeds the limit, with those of the others that it depends on.
    """
    from scipy.sparse import csr_array
    from scipy.sparse.csgraph import connected_components

    _, label = connected_components(csr_array(np.abs(correlation) > limit), directed=False)
    groups = [group for _, group in by_value(label) if group.size > 1]
    paired = joined_rows(groups)
    listed = {tuple(group.tolist()) for group in groups}
    for k in np.setdiff1d(np.arange(label.size), paired).tolist():
        others = np.delete(np.arange(label.size), k)
        shares = np.linalg.lstsq(correlation[np.ix_(others, others)], correlation[others, k], rcond=1e-10)[0]
        if shares @ correlation[others, k] <= limit**2:
            continue
        taken = others[np.abs(shares) > _IN_MIXTURE * np.abs(shares).max()]
        group = np.sort(np.append(taken, k))
        if tuple(group.tolist()) not in listed:
            listed.add(tuple(group.tolist()))
            groups.append(group)
    return groups


def _quantities(
    network: Network, joint: JointCovariance, angles: Angles
) -> tuple[list[tuple[str, str, str]], Array]:
    """Name, owner and unit of each quantity, and its design (columns, q) in that unit."""
    first, named, columns = joint.square_root.first, list[tuple[str, str, str]](), list[Array]()
    for k, pass_ in enumerate(network.passes):
        variable = int(network.first_of_passes[k])
        for name, unit, part in zip(_PARTS, ("m",) * 3 + ("arcsec",) * 3, _means(network, k, angles), strict=True):
            column = np.zeros(joint.columns)
            for node, weights in enumerate(part):
                column[first[variable + node] : first[variable + node] + 6] = weights
            named.append((f"{name} of pass {pass_.name}", pass_.name, unit))
            columns.append(column)
    for k, unknown in enumerate(network.shared):
        if network.first_shared + k not in joint.adjusted:
            continue
        start = int(first[network.first_shared + k])
        factor, unit = unknown.kind.reported
        for name, weights in _components(network, unknown):
            column = np.zeros(joint.columns)
            column[start : start + unknown.kind.width] = weights / factor
            named.append((name, unknown.name, unit))
            columns.append(column)
    return named, np.stack(columns, axis=1)


def _means(network: Network, k: int, angles: Angles) -> Array:
    """(6, nodes, 6) m and arcsec of the mean corrections in the axes of the flight, of each node's corrections."""
    nodes = network.passes[k].nodes
    start, stop = nodes.coverage
    times = np.linspace(start, stop, _PLACES)
    basis, _ = nodes.dense(times, nodes.epoch)
    turns = pass_turns(network, k, times + nodes.epoch, angles)
    units = np.array([1.0] * 3 + [ARCSEC] * 3)
    return np.asarray(np.einsum("tn,tqc->qnc", basis, turns) / _PLACES / units[:, None, None])


def _components(network: Network, unknown: SharedUnknown) -> list[tuple[str, Array]]:
    """Name and weights (width,) of each component: those about a camera's axes as of the flight of its first image."""
    image = next((network.images[j] for j in unknown.images.tolist()), None)
    if image is not None and unknown.kind in (*_TURNING, *_ARMS):
        turned = unknown.kind in _TURNING
        axes = ("roll", "pitch", "yaw") if turned else ("along", "across", "up")
        return [(f"{axis} of {unknown.name}", row) for axis, row in zip(axes, _flight(image, turned), strict=True)]
    names = unknown.kind.components
    return [(f"{name} of {unknown.name}" if name else unknown.name, row)
            for name, row in zip(names, np.eye(len(names)), strict=True)]  # fmt: skip


def _flight(image: PushbroomImage, turned: bool) -> Array:
    """(3, 3) from a camera's own axes to roll, pitch and yaw, or to along, across and up."""
    pose = image.pose(image.middle[0])
    level = flight_axes(pose.position[0], pose.velocity[0])
    if turned:
        return camera_axes(pose.matrix[0] @ level[0])
    return np.asarray(level @ pose.matrix[0].T)


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
    """One component of a shared unknown: its estimate, and what separates it. Units of reports: s, arcsec, m, ppm."""

    name: str
    """Unknown and component."""
    unknown: SharedUnknown
    """That it is of."""
    axis: str
    """x, y or z of the camera, of a boresight or lever arm; else empty."""
    unit: str
    """s, arcsec, m or ppm."""
    value: float
    """Estimated value, in that unit."""
    sigma: float
    """Its standard deviation, for sigma0 = 1."""
    prior_sigma: float
    """Its a-priori standard deviation."""
    ground: float
    """m on the ground, per unit of it, in the middle of its first image; NaN where it moves none there."""
    other: str
    """The unknown with which it correlates most; empty without any other."""
    correlation: float
    """With that one, with its sign."""
    together: float
    """Multiple correlation with all others, 0 to 1."""

    @property
    def gain(self) -> float:
        """Posterior over a-priori sigma."""
        return self.sigma / self.prior_sigma

    @property
    def verdict(self) -> Verdict:
        """What can be said of it."""
        if self.gain >= FROM_PRIOR:
            return Verdict.FROM_PRIOR
        if abs(self.correlation) >= LIMIT:
            return Verdict.NOT_FROM_ONE
        return Verdict.NOT_FROM_OTHERS if self.together >= LIMIT else Verdict.SEPARABLE

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


def separations(solution: Solution) -> tuple[Separation, ...]:
    """Of all components of all shared unknowns, in their order."""
    network, root = solution.network, solution.joint_covariance.square_root
    columns, names = _shared_columns(solution), column_names(network, root)
    if not columns.size:
        return ()
    right = np.zeros((root.columns, columns.size))
    right[columns, np.arange(columns.size)] = 1.0
    covariance = root.covariance_times(right)
    sigmas, variances = solution.joint_covariance.sigmas, covariance[columns, np.arange(columns.size)]
    correlation = covariance / np.outer(sigmas, np.sqrt(variances))
    correlation[columns, np.arange(columns.size)] = 0.0
    informations, partners = np.diag(information(root, columns)), np.abs(correlation).argmax(axis=0)
    results = list[Separation]()
    for unknown, values in zip(network.shared, solution.shared, strict=True):
        factor, unit = unknown.kind.reported
        ground = _ground(network, unknown) * factor
        for c, axis in enumerate(unknown.kind.components):
            k = len(results)
            partner, sigma = int(partners[k]), float(np.sqrt(variances[k])) / factor
            results.append(Separation(
                names[columns[k]], unknown, axis, unit, float(values[c]) / factor, sigma,
                float(unknown.sigmas[c]) / factor, float(ground[c]),
                names[partner] if root.columns > 1 else "", float(correlation[partner, k]),
                float(np.sqrt(max(0.0, 1.0 - 1.0 / (variances[k] * informations[k])))),
            ))  # fmt: skip
    return tuple(results)


def _ground(network: Network, unknown: SharedUnknown) -> Array:
    """(c,) m per s, rad, m or 1 of each component, in the middle of its first image; NaN where it moves none there."""
    kind = unknown.kind
    if not unknown.images.size or not (kind.moves_instrument or kind is SharedKind.ALTIMETER_BORESIGHT):
        return np.full(kind.width, np.nan)
    return np.asarray(np.linalg.norm(ground_shift(network.images[int(unknown.images[0])], kind), axis=1))


def _shared_columns(solution: Solution) -> Index:
    """Columns of the shared unknowns, in their order."""
    first, begins = solution.network.first_shared, solution.joint_covariance.square_root.first
    parts = [begins[first + k] + np.arange(shared.kind.width) for k, shared in enumerate(solution.network.shared)]
    return joined_rows(parts)


def column_names(network: Network, root: SquareRoot) -> list[str]:
    """What each column of the unknowns is, as a person calls it."""
    names = [""] * root.columns
    for variable in root.adjusted.tolist():
        for inside in range(int(root.width[variable])):
            names[int(root.first[variable]) + inside] = unknown_name(network, variable, inside)[0]
    return names


def information(root: SquareRoot, columns: Index) -> Array:
    """(d, d) of the information on some columns, all others held."""
    information, place = np.zeros((columns.size,) * 2), place_of(columns, root.columns)
    for clique, members in enumerate(root.columns_of):
        wanted = place[members]
        inside = wanted >= 0
        rows = root.rows_of(clique)[:, inside]
        information[np.ix_(wanted[inside], wanted[inside])] += rows.T @ rows
    return information

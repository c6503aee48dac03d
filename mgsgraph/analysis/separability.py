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

from collections.abc import Iterator
from dataclasses import dataclass
from enum import StrEnum
from itertools import chain
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from mgsgraph.adjustment.datum import Part, in_words, parts_of, simple_basis
from mgsgraph.adjustment.frames import Frames, camera_axes, flight_axes
from mgsgraph.adjustment.graph import Layout, lay_out
from mgsgraph.adjustment.marginals import JointCovariance
from mgsgraph.adjustment.solution import Solution
from mgsgraph.adjustment.square_root import SquareRoot
from mgsgraph.analysis.measures import unknown_name
from mgsgraph.analysis.statistics import strip_turns
from mgsgraph.errors import InputError
from mgsgraph.geometry.image import PushbroomImage
from mgsgraph.geometry.orientation import Angles
from mgsgraph.geometry.records import Array, Index
from mgsgraph.network import Network, SharedKind, SharedUnknown
from mgsgraph.network.shared import ground_shift
from mgsgraph.record import Record
from mgsgraph.units import MRAD

if TYPE_CHECKING:
    from scipy.sparse import csr_array

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
    """m, mrad, s or ppm."""
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
        share = np.abs(self.coefficients) * [one.sigma for one in self.quantities]
        terms = [
            f"{'+' if c > 0.0 else '-'} {abs(c):.4g} {_ratio(first.unit, one.unit)}x {one.name}"
            for one, c, s in zip(others, self.coefficients[1:].tolist(), share[1:].tolist(), strict=True)
            if s > _LEAST_SHARE * share.max()
        ]
        return " ".join([first.name, *terms])

    @property
    def sentence(self) -> str:
        """A sentence with figures and units."""
        names = [f"{one.name} (sigma {one.sigma:.3g} {one.unit})" for one in self.quantities]
        listed = f"{', '.join(names[:-1])} and {names[-1]}"
        of = "correlation" if len(names) == 2 else "largest correlation of two"
        return (
            f"{listed} are inseparable ({of} {self.correlation:+.3f}); determined is {self.mixture}, to "
            f"{self.sigma:.3g} {self.quantities[0].unit}."
        )


def _ratio(unit: str, other: str) -> str:
    return "" if unit == other else f"{unit or '1'}/{other or '1'} "


def inseparable(
    network: Network, joint: JointCovariance, angles: Angles, limit: float = LIMIT
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
    limit : float
        Correlation, of two or of one with all others together, above which quantities are of one group.
    """
    if not network.passes:
        return ()
    named, design = _quantities(network, joint, angles)
    covariance = design.T @ joint.square_root.covariance_times(design)
    sigmas = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    known = np.flatnonzero(sigmas > 0.0)
    correlation = covariance[np.ix_(known, known)] / np.outer(sigmas[known], sigmas[known])
    found = []
    for group in _groups(correlation, limit):
        members = known[group].tolist()
        mine = [Quantity(named[k][0], named[k][1], named[k][2], float(sigmas[k])) for k in members]
        found.append(_inseparable(mine, correlation[np.ix_(group, group)]))
    return tuple(sorted(found, key=lambda one: one.sigma / one.quantities[0].sigma))


def _inseparable(mine: list[Quantity], correlation: Array) -> Inseparable:
    values, vectors = np.linalg.eigh(correlation)
    sigmas = np.array([one.sigma for one in mine])
    lead = int(np.abs(vectors[:, 0]).argmax()) if abs(vectors[0, 0]) < _LEAST_SHARE else 0
    order = [lead, *(k for k in range(len(mine)) if k != lead)]
    coefficients = (vectors[:, 0] / sigmas)[order]
    off = correlation - np.eye(len(mine))
    largest = float(off.flat[np.abs(off).argmax()])
    scale = float(coefficients[0])
    sigma = float(np.sqrt(max(values[0], 0.0))) / abs(scale)
    return Inseparable(tuple(mine[k] for k in order), largest, coefficients / scale, sigma)


def _groups(correlation: Array, limit: float) -> list[Index]:
    """Groups that are connected by pairs; then each quantity of none of them whose multiple correlation with all others
    exceeds the limit, with those of the others that it depends on.
    """
    from scipy.sparse import csr_array
    from scipy.sparse.csgraph import connected_components

    _, label = connected_components(csr_array(np.abs(correlation) > limit), directed=False)
    groups = [group for k in np.unique(label).tolist() if (group := np.flatnonzero(label == k)).size > 1]
    paired = np.concatenate([np.zeros(0, dtype=np.int64), *groups])
    seen = {tuple(group.tolist()) for group in groups}
    for k in np.setdiff1d(np.arange(label.size), paired).tolist():
        others = np.delete(np.arange(label.size), k)
        shares = np.linalg.lstsq(correlation[np.ix_(others, others)], correlation[others, k], rcond=1e-10)[0]
        if shares @ correlation[others, k] <= limit**2:
            continue
        taken = others[np.abs(shares) > _IN_MIXTURE * np.abs(shares).max()]
        group = np.sort(np.append(taken, k))
        if tuple(group.tolist()) not in seen:
            seen.add(tuple(group.tolist()))
            groups.append(group)
    return groups


def _quantities(
    network: Network, joint: JointCovariance, angles: Angles
) -> tuple[list[tuple[str, str, str]], Array]:
    """Name, owner and unit of each quantity, and its design (columns, q) in that unit."""
    first, named, columns = joint.square_root.first, list[tuple[str, str, str]](), list[Array]()
    for k, one in enumerate(network.passes):
        variable = int(network.first_of_passes[k])
        for name, unit, part in zip(_PARTS, ("m",) * 3 + ("mrad",) * 3, _means(network, k, angles), strict=True):
            column = np.zeros(joint.columns)
            for node, weights in enumerate(part):
                column[first[variable + node] : first[variable + node] + 6] = weights
            named.append((f"{name} of pass {one.name}", one.name, unit))
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
    """(6, nodes, 6) m and mrad of the mean corrections in the axes of the flight, of each node's corrections."""
    nodes = network.passes[k].nodes
    start, stop = nodes.coverage
    times = np.linspace(start, stop, _PLACES)
    basis, _ = nodes.dense(times, nodes.epoch)
    turns = strip_turns(network, k, times + nodes.epoch, angles)
    units = np.array([1.0] * 3 + [MRAD] * 3)
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
    pose = image.pose(np.array([0.5 * image.lines]))
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
    """One component of a shared unknown: its estimate, and what separates it. Units of reports: s, mrad, m, ppm."""

    name: str
    """Unknown and component."""
    unknown: SharedUnknown
    """That it is of."""
    axis: str
    """x, y or z of the camera, of a boresight or lever arm; else empty."""
    unit: str
    """s, mrad, m or ppm."""
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
    own, names = _shared_columns(solution), column_names(network, root)
    if not own.size:
        return ()
    right = np.zeros((root.columns, own.size))
    right[own, np.arange(own.size)] = 1.0
    covariance = root.covariance_times(right)
    sigmas, mine = solution.joint_covariance.sigmas, covariance[own, np.arange(own.size)]
    correlation = covariance / np.outer(sigmas, np.sqrt(mine))
    correlation[own, np.arange(own.size)] = 0.0
    informations, others = np.diag(information(root, own)), np.abs(correlation).argmax(axis=0)
    found = list[Separation]()
    for unknown, values in zip(network.shared, solution.shared, strict=True):
        factor, unit = unknown.kind.reported
        ground = _ground(network, unknown) * factor
        for c, axis in enumerate(unknown.kind.components):
            k = len(found)
            other, sigma = int(others[k]), float(np.sqrt(mine[k])) / factor
            found.append(Separation(
                names[own[k]], unknown, axis, unit, float(values[c]) / factor, sigma,
                float(unknown.sigmas[c]) / factor, float(ground[c]),
                names[other] if root.columns > 1 else "", float(correlation[other, k]),
                float(np.sqrt(max(0.0, 1.0 - 1.0 / (mine[k] * informations[k])))),
            ))  # fmt: skip
    return tuple(found)


def _ground(network: Network, unknown: SharedUnknown) -> Array:
    """(c,) m per s, rad, m or 1 of each component, in the middle of its first image; NaN where it moves none there."""
    kind = unknown.kind
    if not unknown.images.size or not (kind.moves_instrument or kind is SharedKind.ALTIMETER_BORESIGHT):
        return np.full(kind.width, np.nan)
    return np.asarray(np.linalg.norm(ground_shift(network.images[int(unknown.images[0])], kind), axis=1))


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
            names[int(root.first[variable]) + inside] = unknown_name(network, variable, inside)[0]
    return names


def information(root: SquareRoot, columns: Index) -> Array:
    """(d, d) of the information on some columns, all others held."""
    information, place = np.zeros((columns.size,) * 2), np.full(root.columns, -1)
    place[columns] = np.arange(columns.size)
    for clique, members in enumerate(root.columns_of):
        wanted = place[members]
        there = wanted >= 0
        rows = root.rows_of(clique)[:, there]
        information[np.ix_(wanted[there], wanted[there])] += rows.T @ rows
    return information



_DENSE = 2000
"""Columns up to which the whole matrix is decomposed."""
_LANCZOS = 1e-4
"""Relative accuracy of Lanczos's eigenvalues; those of equals hardly converge any further."""
_EQUAL = 0.01
"""Difference of sigmas up to which directions are equally weak."""
_TURNED = 60
"""Directions, of equals, that are turned to simple structure at least: those that move most."""


class _EqualDirections(NamedTuple):
    """Directions that are equally weak."""

    vectors: Array
    """(columns, k) unit vectors, orthogonal where the priors are of single unknowns."""
    number: int
    """How many such directions there are, k or more."""


@dataclass(frozen=True, slots=True, eq=False)
class WeakDirection(Record):
    """A direction of the shared unknowns of which little was learnt."""

    ratio: float
    """Ratio of its sigma to the a-priori one."""
    sigma: float
    """m or rad, how far one sigma moves the axis of its main part."""
    unit: str
    """Of that: m or rad."""
    parts: tuple[Part, ...]
    """Largest share first; shares below 1 % are left out."""
    sentence: str
    """What it is, and how weak."""
    equals: int
    """Directions, it among them, that are as weak to 1 %; at least as many where not all were found."""
    direction: Array
    """(columns,) unit vector, in units of the a-priori sigmas (`Layout.scales`)."""


def weak_directions(solution: Solution, count: int = 5) -> tuple[WeakDirection, ...]:
    """The directions of which the adjustment has learnt least, weakest first.

    Parameters
    ----------
    count : int
        How many are wanted.

    Raises
    ------
    InputError
        When `count` is not positive, or all orientation was held.

    Examples
    --------
    >>> from mgsgraph.analysis.separability import weak_directions
    >>> for direction in weak_directions(solution, 2):
    ...     print(direction)
    constant along-track position against pitch of image SIM/B (100 %): one sigma is 24.2 m against 0.0593 mrad,
    1.00 of what was known before
    constant across-track position against roll of image SIM/B (100 %): one sigma is 24.7 m against 0.0565 mrad,
    1.00 of what was known before
    """
    layout = lay_out(solution.network, solution.settings, solution.places)
    return weakest(layout, solution.joint_covariance, count)


def weakest(layout: Layout, joint: JointCovariance, count: int = 5) -> tuple[WeakDirection, ...]:
    """The directions of a layout's shared unknowns of which a covariance says least, weakest first."""
    if count < 1:
        raise InputError("weak directions, count", f"{count}", "1 or more")
    if joint.columns == 0 or joint.columns != layout.columns:
        raise InputError(
            "weak directions", f"a covariance of {joint.columns} unknowns",
            f"one of {layout.columns or 'at least one'}, as the network has",
            "give an adjustment with free orientation",
        )  # fmt: skip
    frames, found = Frames(layout), list[WeakDirection]()
    prior = layout.prior.whitening(layout.scales)
    values, vectors = spectrum(joint, layout.scales, min(count, layout.columns), prior)
    runs = _runs(values, vectors)
    if values.size < layout.columns:
        runs = chain(_single_images(frames, joint, float(values[0]), count), runs)
    for run in runs:
        if len(found) >= count:
            break
        for direction in _legible(frames, run, max(_TURNED, count))[:, : count - len(found)].T:
            whitened = _before(prior, direction) / layout.scales
            variance = whitened @ joint.square_root.covariance_times(whitened)
            found.append(_described(frames, direction, float(np.sqrt(variance)), run.number))
    return tuple(found)


def _before(prior: "csr_array | None", direction: Array) -> Array:
    """(columns,) R'R d / |R d|: with it the covariance gives the share that is left along a direction d."""
    if prior is None:
        return direction
    whitened = prior @ direction
    return np.asarray(prior.T @ whitened / np.linalg.norm(whitened))


def spectrum(
    joint: JointCovariance, scales: Array, count: int, prior: "csr_array | None" = None, dense: int = _DENSE
) -> tuple[Array, Array]:
    """Eigenvalues, largest first, and directions (columns, k) of the covariance in units of `scales` (columns,), or of
    R S R' with the a-priori square root R = `prior` in these units (`Prior.whitening`).

    All of them up to `dense` columns; above, by Lanczos's method on the square root, the first `count` (and some more).
    """
    whole = joint.columns <= max(dense, count + 1)
    values, vectors = (_dense_spectrum if whole else _lanczos)(joint, scales, count, prior)
    if prior is None:
        return values, vectors
    # R S R' w = l w belongs to the direction S R' w, and R S R' w / l = w
    turned = np.stack([joint.square_root.covariance_times(w / scales) / scales for w in (prior.T @ vectors).T], axis=1)
    return values, turned / np.linalg.norm(turned, axis=0)


def _dense_spectrum(
    joint: JointCovariance, scales: Array, count: int, prior: "csr_array | None"
) -> tuple[Array, Array]:
    covariance = joint.dense() / scales / scales[:, None]
    if prior is not None:
        covariance = prior @ (prior @ covariance).T
    values, vectors = np.linalg.eigh(covariance)
    few = slice(None) if prior is None else slice(-max(4 * count, 40), None)
    return values[few][::-1], vectors[:, few][:, ::-1]


def _lanczos(joint: JointCovariance, scales: Array, count: int, prior: "csr_array | None") -> tuple[Array, Array]:
    from scipy.sparse.linalg import LinearOperator, eigsh  # slow to import

    size, root = joint.columns if prior is None else prior.shape[0], joint.square_root

    def times(x: Array) -> Array:
        whitened = x.ravel() if prior is None else prior.T @ x.ravel()
        covered = root.covariance_times(whitened / scales) / scales
        return np.asarray(covered if prior is None else prior @ covered)

    operator = LinearOperator((size, size), matvec=times, dtype=np.float64)
    start = np.random.default_rng(1).normal(size=size)  # the same result each time
    few = min(size, max(4 * count, 40))
    values, vectors = eigsh(operator, k=count, which="LA", v0=start, tol=_LANCZOS, ncv=few)
    order = np.argsort(-values)
    return values[order], vectors[:, order]


def _single_images(frames: Frames, joint: JointCovariance, largest: float, count: int) -> Iterator[_EqualDirections]:
    """Directions of single images that are as weak as the weakest, where there are `count`; those that move most."""
    layout, found = frames.layout, list[tuple[slice, Array]]()
    for variable in (v for v in layout.variables.adjusted() if v not in layout.prior.joined):
        columns = layout.columns_of(variable)
        scales = layout.scales[columns]
        values, vectors = np.linalg.eigh(joint.block(variable, variable) / scales / scales[:, None])
        weak = vectors[:, values >= largest * (1.0 - _EQUAL) ** 2]
        found.append((columns, _longest(weak, frames.moved(columns, weak))))
    each = [(columns, vector) for columns, vectors in found for vector in vectors.T]
    if len(each) < count:
        return
    lengths = [np.linalg.norm(frames.moved(columns, vectors), axis=0) for columns, vectors in found]
    chosen = np.argsort(-np.concatenate(lengths), kind="stable")[: max(_TURNED, count)]
    together = np.zeros((layout.columns, chosen.size))
    for place, k in enumerate(chosen):
        together[each[k][0], place] = each[k][1]
    yield _EqualDirections(together, len(each))


def _runs(values: Array, vectors: Array) -> Iterator[_EqualDirections]:
    """Runs of equally weak directions."""
    first, sigmas = 0, np.sqrt(np.maximum(values, 0.0))
    while first < sigmas.size:
        last = max(int(np.searchsorted(-sigmas, -sigmas[first] * (1.0 - _EQUAL), side="right")), first + 1)
        yield _EqualDirections(vectors[:, first:last], last - first)
        first = last


def _longest(vectors: Array, moved: Array) -> Array:
    """Directions turned to the main axes of what they move, (columns or c, k) m, the longest first."""
    return np.asarray(vectors @ np.linalg.eigh(moved.T @ moved)[1][:, ::-1])


def _legible(frames: Frames, run: _EqualDirections, most: int) -> Array:
    """(columns, k) directions of one run, `most` at the most, turned to simple structure, what moves most first."""
    every, vectors = slice(0, run.vectors.shape[0]), run.vectors
    if vectors.shape[1] > most:
        vectors = _longest(vectors, frames.moved(every, vectors))[:, :most]
    vectors = vectors @ simple_basis(frames.turned(vectors))
    length = np.linalg.norm(frames.moved(every, vectors), axis=0)
    return np.asarray(vectors[:, np.argsort(-np.round(length, 3), kind="stable")])


def _described(frames: Frames, direction: Array, ratio: float, equals: int) -> WeakDirection:
    turned = frames.turned(direction[:, None])[:, 0]
    direction = direction * (1.0 if turned[np.argmax(np.abs(np.round(turned, 9)))] >= 0.0 else -1.0)
    parts = parts_of(frames, direction)
    main = parts[0]
    variable = frames.layout.sigmas[frames.layout.columns_of(main.axis.variable)]
    before = "1 km and 10 mrad (nothing was known before)" if np.any(np.isinf(variable)) else "what was known before"
    direction.flags.writeable = False
    return WeakDirection(
        ratio=ratio,
        sigma=abs(main.amount) * ratio,
        unit=main.axis.unit,
        parts=parts,
        sentence=f"{in_words(frames, parts, ratio)}, {ratio:.2f} of {before}",
        equals=equals,
        direction=direction,
    )

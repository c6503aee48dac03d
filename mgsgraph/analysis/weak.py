"""The least-constrained directions of an adjustment, in words.

The posterior covariance S of the shared unknowns in units of what was known before, D^-1 S D^-1 with the a-priori
sigmas D, has eigenvalues in 0 .. 1: the share of the a-priori variance that remains after the measures. (In place of an
infinite sigma stands 1 km or 10 mrad, `Layout.scales`; then shares may exceed 1.) The prior of a pass's nodes is a
joint one: there the square root R of the a-priori information takes the place of D^-1, R S R'.

Many directions are often equally weak: measurements hardly separate position from pointing of one image. Directions
whose sigmas differ by less than 1 % are therefore turned to simple structure (`simple`) and sorted by what they move,
in m; their variances are no longer exactly eigenvalues, but within that 1 %.

In a network of more than some 100 images there are hundreds of equals, and a handful of eigenvectors is a mixture of
all of them. There Lanczos's method tells how weak the weakest is, and single images' own directions, as weak as that
to 1 %, are named before any eigenvector.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import chain
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from mgsgraph.adjustment.datum import Part, in_words, parts_of, simple_basis
from mgsgraph.adjustment.frames import Frames
from mgsgraph.adjustment.graph import Layout, lay_out
from mgsgraph.adjustment.marginals import JointCovariance
from mgsgraph.adjustment.solution import Solution
from mgsgraph.errors import require
from mgsgraph.geometry.records import Array
from mgsgraph.record import Record

if TYPE_CHECKING:
    from scipy.sparse import csr_array

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
    solution : Solution
    count : int
        How many are wanted.

    Returns
    -------
    tuple of WeakDirection
        Each with the ratio of its sigma after the adjustment to that before.

    Raises
    ------
    InputError
        When `count` is not positive, or all orientation was held.

    Examples
    --------
    >>> for direction in mgsgraph.weak_directions(solution, 2):
    ...     print(direction)
    constant along-track position against pitch of image SIM/B (100 %): one sigma is 24.2 m against 12.2 arcsec,
    1.00 of the prior sigma
    constant across-track position against roll of image SIM/B (100 %): one sigma is 24.7 m against 11.7 arcsec,
    1.00 of the prior sigma
    """
    layout = lay_out(solution.network, solution.settings, solution.places)
    return weakest(layout, solution.joint_covariance, count)


def weakest(layout: Layout, joint: JointCovariance, count: int = 5) -> tuple[WeakDirection, ...]:
    """The directions of a layout's shared unknowns of which a covariance says least, weakest first."""
    require(count >= 1, "least-constrained directions", f"{count}", "1 or more")
    require(
        joint.columns and joint.columns == layout.columns, "least-constrained directions",
        f"a covariance of {joint.columns} unknowns", f"one of {layout.columns or 'at least one'}, as the network has",
        "give an adjustment with free orientation",
    )  # fmt: skip
    frames, directions = Frames(layout), list[WeakDirection]()
    prior = layout.prior.whitening(layout.scales)
    factors = sum(layout.network.widths[layout.network.first_of_passes[-1] :])
    scales = layout.scales  # of errors in common nothing is said: nobody asks for them
    scales[layout.columns - factors :] = np.inf
    if factors and prior is not None:
        prior = prior[np.unique(prior[:, : layout.columns - factors].nonzero()[0])]
    values, vectors = spectrum(joint, scales, min(count, layout.columns), prior)
    runs = _runs(values, vectors)
    if values.size < layout.columns:
        runs = chain(_single_images(frames, joint, float(values[0]), count), runs)
    for run in runs:
        if len(directions) >= count:
            break
        for direction in _legible(frames, run, max(_TURNED, count))[:, : count - len(directions)].T:
            whitened = _before(prior, direction) / layout.scales
            variance = whitened @ joint.square_root.covariance_times(whitened)
            directions.append(_described(frames, direction, float(np.sqrt(variance)), run.number))
    return tuple(directions)


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
    dense_matrix = joint.columns <= max(dense, count + 1)
    values, vectors = (_dense_spectrum if dense_matrix else _lanczos)(joint, scales, count, prior)
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
    layout, weak_ones = frames.layout, list[tuple[slice, Array]]()
    for variable in (v for v in layout.variables.adjusted() if v not in layout.prior.joined):
        columns = layout.columns_of(variable)
        scales = layout.scales[columns]
        values, vectors = np.linalg.eigh(joint.block(variable, variable) / scales / scales[:, None])
        weak = vectors[:, values >= largest * (1.0 - _EQUAL) ** 2]
        weak_ones.append((columns, _longest(weak, frames.moved(columns, weak))))
    each = [(columns, vector) for columns, vectors in weak_ones for vector in vectors.T]
    if len(each) < count:
        return
    lengths = [np.linalg.norm(frames.moved(columns, vectors), axis=0) for columns, vectors in weak_ones]
    chosen = np.argsort(-np.concatenate(lengths), kind="stable")[: max(_TURNED, count)]
    directions = np.zeros((layout.columns, chosen.size))
    for place, k in enumerate(chosen):
        directions[each[k][0], place] = each[k][1]
    yield _EqualDirections(directions, len(each))


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
    all_columns, vectors = slice(0, run.vectors.shape[0]), run.vectors
    if vectors.shape[1] > most:
        vectors = _longest(vectors, frames.moved(all_columns, vectors))[:, :most]
    vectors = vectors @ simple_basis(frames.turned(vectors))
    length = np.linalg.norm(frames.moved(all_columns, vectors), axis=0)
    return np.asarray(vectors[:, np.argsort(-np.round(length, 3), kind="stable")])


def _described(frames: Frames, direction: Array, ratio: float, equals: int) -> WeakDirection:
    turned = frames.turned(direction[:, None])[:, 0]
    direction = direction * (1.0 if turned[np.argmax(np.abs(np.round(turned, 9)))] >= 0.0 else -1.0)
    parts = parts_of(frames, direction)
    main = parts[0]
    variable = frames.layout.sigmas[frames.layout.columns_of(main.axis.variable)]
    before = "1 km and 2063 arcsec (no prior)" if np.any(np.isinf(variable)) else "the prior sigma"
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

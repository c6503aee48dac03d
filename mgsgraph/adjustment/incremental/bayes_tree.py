"""The Bayes tree of iSAM2 over the shared unknowns: reduced systems go in and out, estimates and covariances come out.

Kaess, Johannsson, Roberts, Ila, Leonard & Dellaert, "iSAM2" (2012). Every factor is quadratic, so the tree is iSAM2's
incremental elimination and nothing else; for nonlinearity a bundle's system is replaced by one made at the present
values (`incremental`). Unknowns are in units of their a-priori sigmas: numbers of order one, for which the wildfire
threshold means the same everywhere.

The tree is eliminated by Cholesky's method as long as GTSAM accepts it, and from then on by QR, which takes seven times
as long and more memory on a block of images. GTSAM's Cholesky refuses a pivot below 2^-24 of the diagonal that it
began with (measured, 4.3): hundreds of ties good to a tenth of a pixel cause such pivots under priors of some hundred
meters, though the priors themselves keep every direction determined. Where it doesn't refuse, no more than 24 of 53
bits are lost: 1e-8 of a sigma. QR has no such limit. It needs the rows: GTSAM's own rows of quadratic factors come from
Cholesky's method again.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import cache

import gtsam
import numpy as np

from mgsgraph.adjustment.incremental.state import ReducedSystem, stretches
from mgsgraph.errors import SolverError
from mgsgraph.geometry.records import Array
from mgsgraph.names import grouped
from mgsgraph.network.parts import ByUnknown, Members, Unknown

_WILDFIRE = 1e-7
"""A-priori sigmas: smaller changes are not passed on (1e-4 posterior sigmas where the posterior is a thousand times
sharper than the prior)."""


_ROUNDING = tuple(10.0**k for k in range(-15, -7))
"""Shares of a system's largest curvature by which rounding may have made others negative: the least one with which
Cholesky's method succeeds is added. It depends on how much of the rows the points absorb: 1e-15 to 1e-10."""
_CORNER = 1e200
"""In place of the cost where only the gradient's row of the factor is wanted: no pivot runs out there."""


def square_root(block: Array, right: Array, cost: float, sigmas: Array) -> tuple[Array, Array]:
    """Rows (A, e) with A'A = block, A'e = right and |e|^2 = 2 cost: the reduced system as GTSAM wants it.

    Parameters
    ----------
    block, right : (d, d), (d,)
        Reduced normal matrix and gradient, per m and rad.
    cost : float
        Full cost of the rows behind them.
    sigmas : (d,)
        A-priori sigmas: the decomposition is done in these units, where small pivots mean something.

    Returns
    -------
    jacobian : (d + 1, d)
        Its last row is zero.
    error : (d + 1,)

    Raises
    ------
    RuntimeError
        "Indeterminate linear system", as GTSAM words it, for a block that is not positive semidefinite.
    """
    d, bordered = right.size, np.empty((right.size + 1, right.size + 1))
    bordered[:d, :d], bordered[d, d] = block * sigmas[:, None] * sigmas, _CORNER
    bordered[d, :d] = bordered[:d, d] = right * sigmas
    plain = np.diagonal(bordered)[:d].copy()
    largest = float(plain.max(initial=0.0)) or 1.0
    jacobian, error = np.zeros((d + 1, d)), np.zeros(d + 1)
    # Eigenvalues would tell the rank, but their routine is threaded, and waits for a busy second core
    # (`marginals.one_thread`). The gradient is kept in directions without curvature, too: the prior balances it.
    for share in _ROUNDING:
        np.fill_diagonal(bordered[:d, :d], plain + share * largest)
        try:
            lower = np.linalg.cholesky(bordered)
        except np.linalg.LinAlgError:
            continue
        jacobian[:d], error[:d] = lower[:d, :d].T / sigmas, lower[d, :d]
        error[d] = np.sqrt(max(2.0 * cost - float(error[:d] @ error[:d]), 0.0))
        return jacobian, error
    raise RuntimeError("Indeterminate linear system: a reduced system that is not positive semidefinite")


@contextmanager
def _solvable(what: str) -> Iterator[None]:
    """Turn GTSAM's errors into SolverErrors that say what failed."""
    try:
        yield
    except RuntimeError as error:
        message = " ".join(str(error).split())[:100] or "not positive definite"
        remedy = "look for sigmas that differ by many orders of magnitude, or adjust by batch"
        raise SolverError(f"iSAM2 can't {what} ({message}); {remedy}") from error


JOINT_PRIORS = ("node", "trend")
"""Kinds of unknowns with joint priors: those of passes."""


class PriorRows:
    """Whitened rows sum_v blocks[v] x_v on unknowns of a pass, about zero; equal where they say the same."""

    def __init__(self, unknowns: Members, blocks: Sequence[Array]) -> None:
        self.unknowns, self.whitened = unknowns, tuple(blocks)
        self._content = unknowns, b"".join(np.ascontiguousarray(block).tobytes() for block in blocks)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, PriorRows) and self._content == other._content

    def __hash__(self) -> int:
        return hash(self._content)


_Owner = Unknown | Members | PriorRows
"""What a factor belongs to: the prior of an unknown, the reduced system of a bundle, prior rows of some unknowns."""


class Tree:
    """Unknowns with their priors, and reduced systems on them."""

    def __init__(self) -> None:
        self._isam, self._by_qr = _isam("CHOLESKY"), False
        self._keys = dict[Unknown, int]()
        self._scale = dict[Unknown, Array]()
        self._factors = dict[_Owner, gtsam.NonlinearFactor]()
        self._slots = dict[_Owner, int]()
        self._next = 0
        self._taken = dict[Unknown, Array]()

    def __contains__(self, members: Members) -> bool:
        return members in self._slots

    def change(
        self,
        new: ByUnknown | None = None,
        systems: Mapping[Members, ReducedSystem] | None = None,
        replaced: Iterable[Members] = (),
        dropped: Iterable[Unknown] = (),
        rows: Iterable[PriorRows] | None = None,
    ) -> None:
        """Add unknowns (with a-priori sigmas (d,)) and systems, remove others; a system replaces the one of the same
        members. `rows` are all priors of the unknowns of passes, whose sigmas are units only; None leaves them as they
        are.

        Raises SolverError when the sum can't be eliminated; discard the tree then.
        """
        new, systems, dropped = dict(new or {}), dict(systems or {}), list(dropped)
        present = [prior for prior in self._slots if isinstance(prior, PriorRows)]
        wanted = present if rows is None else list(dict.fromkeys(rows))
        leaving: list[_Owner] = [owner for owner in {*replaced, *systems} if owner in self._slots]
        leaving += [unknown for unknown in dropped if unknown in self._slots]
        leaving += [prior for prior in present if prior not in wanted]
        for unknown, sigmas in new.items():
            self._keys[unknown], self._scale[unknown] = self._next, sigmas
            self._next += 1
        with _solvable("eliminate the change"):
            added = [prior for prior in wanted if prior not in self._slots]
            self._replace(leaving, self._factors_of(new, added, systems), new)
        for unknown in dropped:
            del self._keys[unknown], self._scale[unknown]
            self._taken.pop(unknown, None)

    def _factors_of(
        self, new: Iterable[Unknown], rows: Iterable[PriorRows], systems: Mapping[Members, ReducedSystem]
    ) -> dict[_Owner, gtsam.NonlinearFactor]:
        """Factors of priors of single unknowns, of prior rows on several, and of reduced systems."""
        factors = dict[_Owner, gtsam.NonlinearFactor]()
        for unknown in new:
            if unknown.kind not in JOINT_PRIORS:
                size = self._scale[unknown].size
                unit = gtsam.noiseModel.Unit.Create(size)
                factors[unknown] = gtsam.PriorFactorVector(self._keys[unknown], np.zeros(size), unit)
        for prior in rows:
            factors[prior] = self._linear(prior.unknowns, prior.whitened, np.zeros(prior.whitened[0].shape[0]))
        return factors | {members: self._factor(system) for members, system in systems.items()}

    def _replace(
        self, leaving: Sequence[_Owner], coming: Mapping[_Owner, gtsam.NonlinearFactor], new: Iterable[Unknown]
    ) -> None:
        """Replace factors, also on new unknowns; the whole tree by QR where Cholesky's method fails."""
        removed = [self._slots.pop(owner) for owner in leaving]
        for owner in leaving:
            del self._factors[owner]
        self._factors |= coming
        try:
            self._update(coming, new, removed)
        except RuntimeError as error:
            if self._by_qr or "Indeterminate" not in str(error):
                raise
            self._isam, self._by_qr = _isam("QR"), True
            felt = {key for factor in self._factors.values() for key in factor.keys()}  # noqa: SIM118
            self._update(self._factors, [unknown for unknown, key in self._keys.items() if key in felt], [])

    def _update(
        self, coming: Mapping[_Owner, gtsam.NonlinearFactor], new: Iterable[Unknown], removed: list[int]
    ) -> None:
        factors, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
        for unknown in new:
            values.insert(self._keys[unknown], np.zeros(self._scale[unknown].size))
        for factor in coming.values():
            factors.add(factor)
        slots = self._isam.update(factors, values, removed).getNewFactorsIndices()
        self._slots |= {owner: int(slot) for owner, slot in zip(coming, slots, strict=True)}

    def _factor(self, system: ReducedSystem) -> gtsam.LinearContainerFactor:
        """A reduced system as GTSAM factor on whitened unknowns: rows (A, b) with the error |A x - b|^2 / 2."""
        scale = np.concatenate([self._scale[unknown] for unknown in system.unknowns])
        jacobian, error = square_root(system.normal, system.gradient, system.cost, scale)
        parts = stretches(system.unknowns, self._scale)
        blocks = [jacobian[:, part] for part in parts.values()]
        return self._linear(system.unknowns, blocks, jacobian @ system.at - error)

    def _linear(self, unknowns: Members, blocks: Sequence[Array], right: Array) -> gtsam.LinearContainerFactor:
        """Rows sum_v blocks[v] x_v = right (r,), per m and rad, as GTSAM factor on whitened unknowns."""
        terms = [(self._keys[v], block * self._scale[v]) for v, block in zip(unknowns, blocks, strict=True)]
        # from Python, a conditional alone takes rows on any number of unknowns
        rows = gtsam.GaussianConditional(terms, 1, right, gtsam.noiseModel.Unit.Create(right.size))
        return gtsam.LinearContainerFactor(gtsam.JacobianFactor(rows))

    def values(self) -> dict[Unknown, Array]:
        """Present values of all unknowns, m and rad."""
        self._taken.clear()
        return self.moved()

    def moved(self) -> dict[Unknown, Array]:
        """Present values, m and rad, of the unknowns that have moved since the last call, and of new ones."""
        with _solvable("solve"):
            estimate, changed = self._isam.calculateEstimate(), dict[Unknown, Array]()
        for size, names in grouped((scale.size, name) for name, scale in self._scale.items()).items():
            # many unknowns, of which few have moved: compared all at once
            now = np.array([estimate.atVector(self._keys[name]) for name in names]).reshape(len(names), size)
            before = np.array([self._taken.get(name, _undefined(size)) for name in names]).reshape(now.shape)
            for k in np.flatnonzero(np.any(now != before, axis=1)).tolist():
                self._taken[names[k]] = now[k]
                changed[names[k]] = now[k] * self._scale[names[k]]
        return changed

    def covariance(self, unknowns: Sequence[Unknown]) -> Array:
        """Joint covariance (d, d) of some unknowns, in their order, m and rad, for sigma0 = 1."""
        keys, scale = [self._keys[u] for u in unknowns], np.concatenate([self._scale[u] for u in unknowns])
        if len(keys) == 1:
            return np.asarray(self._isam.marginalCovariance(keys[0]) * scale[:, None] * scale)
        joint = self._isam.jointMarginalCovariance(keys)
        blocks = np.block([[joint.at(first, second) for second in keys] for first in keys])
        return np.asarray(blocks * scale[:, None] * scale)


@cache
def _undefined(size: int) -> Array:
    return np.full(size, np.nan)


def _isam(factorisation: str) -> gtsam.ISAM2:
    parameters = gtsam.ISAM2Params()
    parameters.setOptimizationParams(gtsam.ISAM2GaussNewtonParams(_WILDFIRE))
    parameters.setFactorization(factorisation)
    parameters.enableRelinearization = False
    parameters.findUnusedFactorSlots = True
    return gtsam.ISAM2(parameters)

"""The Bayes tree of iSAM2 over the shared unknowns: reduced systems go in and out, estimates and covariances come out.

Kaess, Johannsson, Roberts, Ila, Leonard & Dellaert, "iSAM2" (2012). Every factor is quadratic, so the tree is iSAM2's
incremental elimination and nothing else; what is not linear is mended by taking a bundle's system out and putting in
one that was made at the present values (`incremental`). Unknowns are held in units of their a-priori sigmas: numbers of
order one, for which the wildfire threshold means the same everywhere.

The tree is eliminated by QR, from rows whose square each reduced system is. GTSAM's Cholesky refuses a pivot below
2^-24 of the diagonal that it began with (measured, 4.3): hundreds of ties good to a tenth of a pixel bring that about
under priors of some hundred metres, though the priors themselves keep every direction determined. QR has no such limit.
It needs the rows: what GTSAM makes of quadratic factors itself is Cholesky's again.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import cache

import gtsam
import numpy as np

from mgsgraph.adjustment.graph.bundle_factors import square_root
from mgsgraph.errors import SolverError
from mgsgraph.geometry.records import Array
from mgsgraph.incremental.state import ReducedSystem, stretches
from mgsgraph.network.parts import Members, Unknown

_WILDFIRE = 1e-7
"""A-priori sigmas: changes smaller than this are not handed on (a thousandth of what is promised where the posterior
is a thousand times sharper than the prior)."""


@contextmanager
def _solvable(what: str) -> Iterator[None]:
    """GTSAM's errors as SolverErrors that say what it can't do."""
    try:
        yield
    except RuntimeError as error:
        said = " ".join(str(error).split())[:100] or "not positive definite"
        remedy = "look for sigmas that differ by many orders of magnitude, or adjust by batch"
        raise SolverError(f"iSAM2 can't {what} ({said}); {remedy}") from error


TOGETHER = ("node", "trend")
"""Kinds of unknowns that are known beforehand together: those of passes."""


class PriorRows:
    """Whitened rows sum_v blocks[v] x_v on unknowns of a pass, about zero; equal where they say the same."""

    def __init__(self, unknowns: Members, blocks: Sequence[Array]) -> None:
        self.unknowns, self.whitened = unknowns, tuple(blocks)
        self._content = unknowns, b"".join(np.ascontiguousarray(block).tobytes() for block in blocks)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, PriorRows) and self._content == other._content

    def __hash__(self) -> int:
        return hash(self._content)


class Tree:
    """Unknowns with their priors, and reduced systems on them."""

    def __init__(self) -> None:
        self._isam = _isam()
        self._keys = dict[Unknown, int]()
        self._scale = dict[Unknown, Array]()
        self._slots = dict[Members, int]()
        self._priors = dict[Unknown, int]()
        self._rows = dict[PriorRows, int]()
        self._next = 0
        self._taken = dict[Unknown, Array]()

    def __contains__(self, members: Members) -> bool:
        return members in self._slots

    def change(
        self,
        new: Mapping[Unknown, Array] | None = None,
        systems: Mapping[Members, ReducedSystem] | None = None,
        gone: Iterable[Members] = (),
        dropped: Iterable[Unknown] = (),
        rows: Iterable[PriorRows] | None = None,
    ) -> None:
        """Put unknowns (with a-priori sigmas (d,)) and systems in, take others out; a system whose members are there
        replaces the one that was. `rows` are all that is known beforehand of the unknowns of passes, whose sigmas are
        mere units; None leaves them as they are.

        Raises SolverError when the sum can't be eliminated; the tree is of no use after that.
        """
        systems, dropped = dict(systems or {}), list(dropped)
        removed = [self._slots.pop(members) for members in {*gone, *systems} if members in self._slots]
        removed += [self._priors.pop(unknown) for unknown in dropped if unknown in self._priors]
        known = self._rows if rows is None else dict.fromkeys(rows)
        removed += [self._rows.pop(one) for one in list(self._rows) if one not in known]
        factors, values, of_slot = gtsam.NonlinearFactorGraph(), gtsam.Values(), list[Members | Unknown | PriorRows]()
        for unknown, sigmas in (new or {}).items():
            key = self._keys[unknown] = self._next
            self._next += 1
            self._scale[unknown] = sigmas
            values.insert(key, np.zeros(sigmas.size))
            if unknown.kind in TOGETHER:
                continue
            factors.add(
                gtsam.PriorFactorVector(key, np.zeros(sigmas.size), gtsam.noiseModel.Unit.Create(sigmas.size))
            )
            of_slot.append(unknown)
        with _solvable("eliminate the change"):
            for one in known:
                if one not in self._rows:
                    factors.add(self._linear(one.unknowns, one.whitened, np.zeros(one.whitened[0].shape[0])))
                    of_slot.append(one)
            for members, system in systems.items():
                factors.add(self._factor(system))
                of_slot.append(members)
            result = self._isam.update(factors, values, removed)
        for owner, slot in zip(of_slot, result.getNewFactorsIndices(), strict=True):
            if isinstance(owner, Unknown):
                self._priors[owner] = int(slot)
            elif isinstance(owner, PriorRows):
                self._rows[owner] = int(slot)
            else:
                self._slots[owner] = int(slot)
        for unknown in dropped:
            del self._keys[unknown], self._scale[unknown]
            self._taken.pop(unknown, None)

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
            estimate, found = self._isam.calculateEstimate(), dict[Unknown, Array]()
        for size, names in self._by_size().items():
            # many unknowns, of which few have moved: compared all at once
            now = np.array([estimate.atVector(self._keys[name]) for name in names]).reshape(len(names), size)
            before = np.array([self._taken.get(name, _nothing(size)) for name in names]).reshape(now.shape)
            for k in np.flatnonzero(np.any(now != before, axis=1)).tolist():
                self._taken[names[k]] = now[k]
                found[names[k]] = now[k] * self._scale[names[k]]
        return found

    def _by_size(self) -> dict[int, list[Unknown]]:
        groups = dict[int, list[Unknown]]()
        for name, scale in self._scale.items():
            groups.setdefault(scale.size, []).append(name)
        return groups

    def covariance(self, unknowns: Sequence[Unknown]) -> Array:
        """Joint covariance (d, d) of some unknowns, in their order, m and rad, for sigma0 = 1."""
        keys, scale = [self._keys[u] for u in unknowns], np.concatenate([self._scale[u] for u in unknowns])
        if len(keys) == 1:
            return np.asarray(self._isam.marginalCovariance(keys[0]) * scale[:, None] * scale)
        joint = self._isam.jointMarginalCovariance(keys)
        blocks = np.block([[joint.at(one, other) for other in keys] for one in keys])
        return np.asarray(blocks * scale[:, None] * scale)


@cache
def _nothing(size: int) -> Array:
    return np.full(size, np.nan)


def _isam() -> gtsam.ISAM2:
    parameters = gtsam.ISAM2Params()
    parameters.setOptimizationParams(gtsam.ISAM2GaussNewtonParams(_WILDFIRE))
    parameters.setFactorization("QR")
    parameters.enableRelinearization = False
    parameters.findUnusedFactorSlots = True
    return gtsam.ISAM2(parameters)

"""The Bayes tree of iSAM2 over the shared unknowns: reduced systems go in and out, estimates and covariances come out.

Kaess, Johannsson, Roberts, Ila, Leonard & Dellaert, "iSAM2" (2012). Every factor is quadratic, so the tree is iSAM2's
incremental elimination and nothing else; what is not linear is mended by taking a bundle's system out and putting in
one that was made at the present values (`incremental`). Unknowns are held in units of their a-priori sigmas: numbers of
order one, for which the wildfire threshold and the pivots of Cholesky's method mean the same everywhere.

GTSAM's Cholesky calls a system indeterminate where a pivot falls below some 2^-24 of what it began with: hundreds of
ties good to a tenth of a pixel do that to priors of some hundred metres, though every direction is determined. The sum
is then solved as one dense matrix: the same result, at a cost that grows with the cube of the unknowns.
"""

from collections.abc import Iterable, Mapping, Sequence
from functools import cache
from typing import NamedTuple

import gtsam
import numpy as np

from mgsgraph.adjustment.incremental.state import ReducedSystem, stretches
from mgsgraph.adjustment.square_root import is_indeterminate
from mgsgraph.errors import SolverError
from mgsgraph.geometry.records import Array
from mgsgraph.network.parts import Members, Unknown

_WILDFIRE = 1e-7
"""A-priori sigmas: changes smaller than this are not handed on (a thousandth of what is promised where the posterior
is a thousand times sharper than the prior)."""


class _Whole(NamedTuple):
    """All unknowns at once, in units of their a-priori sigmas."""

    place: dict[Unknown, slice]
    """Where each stands."""
    values: Array
    """(columns,) the estimate."""
    covariance: Array
    """(columns, columns)."""


class Tree:
    """Unknowns with their priors, and reduced systems on them."""

    def __init__(self) -> None:
        self._isam: gtsam.ISAM2 | None = _isam()
        self._systems = dict[Members, ReducedSystem]()
        self._solved: _Whole | None = None
        self._keys = dict[Unknown, int]()
        self._scale = dict[Unknown, Array]()
        self._slots = dict[Members, int]()
        self._priors = dict[Unknown, int]()
        self._next = 0
        self._taken = dict[Unknown, Array]()

    def __contains__(self, members: Members) -> bool:
        return members in self._systems

    def change(
        self,
        new: Mapping[Unknown, Array] | None = None,
        systems: Mapping[Members, ReducedSystem] | None = None,
        gone: Iterable[Members] = (),
        dropped: Iterable[Unknown] = (),
    ) -> None:
        """Put unknowns (with a-priori sigmas (d,)) and systems in, take others out; a system whose members are there
        replaces the one that was.

        Raises SolverError when the sum can't be eliminated; the tree is of no use after that.
        """
        new, systems, gone, dropped = dict(new or {}), dict(systems or {}), list(gone), list(dropped)
        for members in gone:
            self._systems.pop(members, None)
        self._systems |= systems
        self._scale |= new
        for unknown in dropped:
            del self._scale[unknown]
            self._taken.pop(unknown, None)
        self._solved = None
        if self._isam is not None:
            try:
                self._update(self._isam, new, systems, gone, dropped)
            except RuntimeError as error:
                self._leave(error)
        if self._isam is None:
            self._whole()

    def _leave(self, error: RuntimeError) -> None:
        """Go on without iSAM2, where it can't, though the sum may be sound."""
        if not is_indeterminate(error):
            raise _failure(error) from None
        self._isam = None

    def _update(
        self, isam: gtsam.ISAM2, new: Mapping[Unknown, Array], systems: Mapping[Members, ReducedSystem],
        gone: Sequence[Members], dropped: Sequence[Unknown],
    ) -> None:  # fmt: skip
        """The change in iSAM2."""
        removed = [self._slots.pop(members) for members in {*gone, *systems} if members in self._slots]
        removed += [self._priors.pop(unknown) for unknown in dropped]
        factors, values, of_slot = gtsam.NonlinearFactorGraph(), gtsam.Values(), list[Members | Unknown]()
        for unknown, sigmas in new.items():
            key = self._keys[unknown] = self._next
            self._next += 1
            values.insert(key, np.zeros(sigmas.size))
            factors.add(
                gtsam.PriorFactorVector(key, np.zeros(sigmas.size), gtsam.noiseModel.Unit.Create(sigmas.size))
            )
            of_slot.append(unknown)
        for members, system in systems.items():
            factors.add(self._factor(system))
            of_slot.append(members)
        result = isam.update(factors, values, removed)
        for owner, slot in zip(of_slot, result.getNewFactorsIndices(), strict=True):
            if isinstance(owner, Unknown):
                self._priors[owner] = int(slot)
            else:
                self._slots[owner] = int(slot)
        for unknown in dropped:
            del self._keys[unknown]

    def _whole(self) -> _Whole:
        """All unknowns at once."""
        if self._solved is None:
            place = stretches(list(self._scale), self._scale)
            columns = sum(sigmas.size for sigmas in self._scale.values())
            normal, right = np.eye(columns), np.zeros(columns)
            for system in self._systems.values():
                mine = np.concatenate([np.arange(place[u].start, place[u].stop) for u in system.unknowns])
                scale = np.concatenate([self._scale[u] for u in system.unknowns])
                normal[np.ix_(mine, mine)] += system.normal * scale[:, None] * scale
                right[mine] += (system.normal @ system.at - system.gradient) * scale
            try:
                root = np.linalg.inv(np.linalg.cholesky(normal))
            except np.linalg.LinAlgError as error:
                raise _failure(error) from None
            self._solved = _Whole(place, root.T @ (root @ right), root.T @ root)
        return self._solved

    def _factor(self, system: ReducedSystem) -> gtsam.LinearContainerFactor:
        """A reduced system as GTSAM factor, in whitened units."""
        keys = [self._keys[unknown] for unknown in system.unknowns]
        scale = np.concatenate([self._scale[unknown] for unknown in system.unknowns])
        normal, right = system.normal * scale[:, None] * scale, -system.gradient * scale
        at, parts = gtsam.Values(), list(stretches(system.unknowns, self._scale).values())
        for key, part in zip(keys, parts, strict=True):
            at.insert(key, (system.at / scale)[part])
        return gtsam.LinearContainerFactor(_hessian(keys, parts, normal, right, 2.0 * system.cost), at)

    def values(self) -> dict[Unknown, Array]:
        """Present values of all unknowns, m and rad."""
        self._taken.clear()
        return self.moved()

    def moved(self) -> dict[Unknown, Array]:
        """Present values, m and rad, of the unknowns that have moved since the last call, and of new ones."""
        found = dict[Unknown, Array]()
        if self._isam is None:
            whole, limit = self._whole(), _WILDFIRE
            estimate = {unknown: whole.values[at] for unknown, at in whole.place.items()}
        else:
            values, limit = self._isam.calculateEstimate(), 0.0
            estimate = {unknown: values.atVector(self._keys[unknown]) for unknown in self._scale}
        for size, names in self._by_size().items():
            # many unknowns, of which few have moved: compared all at once
            now = np.array([estimate[name] for name in names]).reshape(len(names), size)
            before = np.array([self._taken.get(name, _nothing(size)) for name in names]).reshape(now.shape)
            for k in np.flatnonzero(np.any(~(np.abs(now - before) <= limit), axis=1)).tolist():
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
        scale = np.concatenate([self._scale[u] for u in unknowns])
        blocks: Array | None = None
        if self._isam is not None:
            try:
                blocks = _marginal(self._isam, [self._keys[u] for u in unknowns])
            except RuntimeError as error:
                self._leave(error)
        if blocks is None:
            whole = self._whole()
            mine = np.concatenate([np.arange(whole.place[u].start, whole.place[u].stop) for u in unknowns])
            blocks = whole.covariance[np.ix_(mine, mine)]
        return np.asarray(blocks * scale[:, None] * scale)


@cache
def _nothing(size: int) -> Array:
    return np.full(size, np.nan)


def _marginal(isam: gtsam.ISAM2, keys: Sequence[int]) -> Array:
    if len(keys) == 1:
        return np.asarray(isam.marginalCovariance(keys[0]))
    joint = isam.jointMarginalCovariance(keys)
    return np.block([[joint.at(one, other) for other in keys] for one in keys])


def _failure(error: Exception) -> SolverError:
    said = " ".join(str(error).split())[:100] or "not positive definite"
    remedy = "look for sigmas that differ by many orders of magnitude, or adjust by batch"
    return SolverError(f"iSAM2 can't eliminate the change ({said}); {remedy}")


def _isam() -> gtsam.ISAM2:
    parameters = gtsam.ISAM2Params()
    parameters.setOptimizationParams(gtsam.ISAM2GaussNewtonParams(_WILDFIRE))
    parameters.enableRelinearization = False
    parameters.findUnusedFactorSlots = True
    return gtsam.ISAM2(parameters)


def _hessian(keys: list[int], parts: list[slice], normal: Array, right: Array, constant: float) -> gtsam.HessianFactor:
    """GTSAM's Hessian factor: error = x' normal x / 2 - x' right + constant / 2."""
    if len(keys) == 1:
        return gtsam.HessianFactor(keys[0], normal, right, constant)
    if len(keys) == 2:
        a, b = parts
        return gtsam.HessianFactor(
            keys[0], keys[1], normal[a, a], normal[a, b], right[a], normal[b, b], right[b], constant
        )
    graph = gtsam.GaussianFactorGraph()  # GTSAM takes more than three keys as a sum of factors only
    for k, a in enumerate(parts):
        graph.push_back(gtsam.HessianFactor(keys[k], normal[a, a], right[a], constant if k == 0 else 0.0))
        for m, b in enumerate(parts[k + 1 :], k + 1):
            none, other = np.zeros_like(normal[a, a]), np.zeros_like(normal[b, b])
            zero, zeros = np.zeros_like(right[a]), np.zeros_like(right[b])
            graph.push_back(gtsam.HessianFactor(keys[k], keys[m], none, normal[a, b], zero, other, zeros, 0.0))
    return gtsam.HessianFactor(graph)

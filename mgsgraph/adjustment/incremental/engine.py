"""Incremental adjustment: bundles enter and leave iSAM2 (`bayes_tree`) until the linear system is the true one.

A change relinearizes the bundles that it touches, and then those whose unknowns have moved farther than their slack,
until none has. The engine then follows the change outward, from bundle to bundle, as long as points can move by a
noticeable part of a sigma.
"""

from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from mgsgraph.adjustment.incremental.bayes_tree import JOINT_PRIORS, PriorRows, Tree
from mgsgraph.adjustment.incremental.state import (
    NOTICEABLE,
    Bundle,
    ReducedSystem,
    Settled,
    Shared,
    StateStore,
    image_motion,
    stretches,
)
from mgsgraph.adjustment.incremental.sweep import Sweep
from mgsgraph.adjustment.incremental.trajectories import expected, prior_rows
from mgsgraph.adjustment.marginals import carried
from mgsgraph.adjustment.settings import SolverSettings
from mgsgraph.files.networks.tie_points import PointKind
from mgsgraph.geometry.records import Array
from mgsgraph.network import Network
from mgsgraph.network.joining import Definitions, definitions
from mgsgraph.network.parts import ByUnknown, Members, Unknown, bundles, joined, known_images

if TYPE_CHECKING:
    from mgsgraph.adjustment.solution import Solution

MOST_KEPT = 150_000
"""Points whose sweeps are kept (about 1 kB each)."""


_MOST_UPDATES = 12
_REACH = 0.5 * NOTICEABLE
"""Sigmas of a bundle's unknowns below which a change isn't followed any farther: its points can't move by more sigmas
than they do. The half allows for several paths to the next bundle."""
_LIKELY = 0.7 * NOTICEABLE
"""Sigmas by which a point has to move for its bundle to be written, or share by which its sigmas have to change."""
_ANYWHERE = 1e3
"""m, sigma of a point's coordinate from which on its place is of no use as a start value."""
_MOST_UNKNOWNS = 60
"""Unknowns whose joint covariance is asked for at a time."""


class Engine:
    """Shared unknowns, reduced systems, and the tree over them; points stay in the store.

    Parameters
    ----------
    store : StateStore
        Read here, never written.
    """

    def __init__(self, settings: SolverSettings, store: StateStore) -> None:
        self._settings, self._store = settings, store
        self._begin(store.shared(), store.reduced(), store.definitions())

    def _begin(
        self, shared: dict[Unknown, Shared], systems: dict[Members, ReducedSystem], definitions: Definitions
    ) -> None:
        """Set unknowns, systems and definitions, without any sweep."""
        self.shared, self.systems, self.known = shared, systems, definitions
        self._clear_sweeps()
        self._plant()
        self._take_values()

    def resume(self, store: StateStore) -> None:
        """Read from another store that holds the same state from now on."""
        self._store = store

    def _clear_sweeps(self) -> None:
        self._sweeps, self._kept = dict[Members, Sweep](), 0
        self._changing = dict[Members, Sweep]()

    def _plant(self) -> None:
        """Take the values of the unknowns as they are; the tree is made when it is first needed."""
        self._grown: Tree | None = None
        self.value = {unknown: state.value for unknown, state in self.shared.items()}
        self._holding: defaultdict[Unknown, set[Members]] = defaultdict(set)
        self._hold(self.systems)

    @property
    def _tree(self) -> Tree:
        """The tree of all unknowns and systems: from reduced systems, never from points."""
        if self._grown is None:
            self._grown = Tree()
            units = {unknown: state.prior_sigmas for unknown, state in self.shared.items()}
            self._grown.change(units, self.systems, rows=prior_rows(self.known) if self.shared else ())
        return self._grown

    @contextmanager
    def all_or_nothing(self) -> Iterator[None]:
        """Restore the engine's state when anything within fails."""
        before = dict(self.shared), dict(self.systems), self.known
        try:
            yield
        except BaseException:
            self._begin(*before)
            raise

    def replaced(
        self,
        removed: Sequence[Members],
        networks: Mapping[Members, Network],
        new: Mapping[Unknown, Shared],
        dropped: Sequence[Unknown] = (),
        definitions: Definitions | None = None,
    ) -> Settled:
        """Replace bundles, add and drop unknowns, and iterate to convergence. `definitions` are the passes and shared
        unknowns from now on, where they have changed.

        Raises
        ------
        PointBehindCamera
            At the present values of the unknowns.
        SolverError
            When iSAM2 can't eliminate the change.
        """
        tree, before = self._tree, dict(self.value)
        self.shared |= new
        rows = None if definitions is None else prior_rows(definitions)
        self.known = self.known if definitions is None else definitions
        self.value |= self._expected(new, rows or ())
        places = places_by_name(self._store.bundle(members) for members in removed)
        self._forget(removed)
        for members, network in networks.items():
            self._changing[members] = Sweep(network, self._settings, _places_of(network, places))
        systems = self._systems_of(networks)
        dropped = [*dropped, *self._unused_shifts(removed, networks)]
        tree.change({unknown: state.prior_sigmas for unknown, state in new.items()}, systems, removed, dropped, rows)
        for unknown in dropped:
            del self.shared[unknown], self.value[unknown]
        self._take(systems)
        updates, relinearized, converged = self._relinearize()
        reached = self._reached(set(systems), removed, before)
        self._note(reached, new)
        bundles = self._placed(networks, reached)
        far = {members: joint for members, joint in reached.items() if members not in networks}
        bundles |= self._far(relinearized - set(networks), far)
        self._end_change()
        return Settled(bundles, reached, updates, len(systems) + len(relinearized), converged)

    def _expected(self, new: Mapping[Unknown, Shared], rows: Iterable[PriorRows]) -> dict[Unknown, Array]:
        """Start values of new unknowns: zero; of orientation images what their neighbors predict."""
        nodes = {unknown: state.prior for unknown, state in new.items() if unknown.kind in JOINT_PRIORS}
        likely = expected(rows, nodes, self.value) if nodes else {}
        return {unknown: likely.get(unknown, state.value) for unknown, state in new.items()}

    def adopted(
        self, shared: Mapping[Unknown, Shared], solution: "Solution", network: Network
    ) -> dict[Members, Bundle]:
        """Begin again from a batch solution of a network: its values of the unknowns, and all bundles."""
        self._clear_sweeps()
        self.shared, self.known, networks = dict(shared), definitions(network), bundles(network)
        self.value = {unknown: state.value for unknown, state in shared.items()}
        if network.passes or network.stereo is not None or network.common:
            return self._adopted_one_by_one(networks, dict(zip(network.points.ids, solution.places, strict=True)))
        places = np.where((network.points.kinds == PointKind.FIXED)[:, None], np.nan, solution.places)
        sweep = Sweep(network, self._settings, places)
        placed = sweep.of_bundles(self.value, solution.joint_covariance, networks, self._motion)
        self.systems = {members: bundle.reduced for members, bundle in placed.items() if bundle.reduced is not None}
        self._plant()
        return placed

    def _adopted_one_by_one(
        self, networks: Mapping[Members, Network], places: Mapping[str, Array]
    ) -> dict[Members, Bundle]:
        """All bundles, one by one: their points may depend on other orientation images than those about the measured
        lines, and rows of stereo surfaces are relinearized; `places` (3,) of points by name, where known.
        """
        sweeps = {m: Sweep(network, self._settings, _places_of(network, places)) for m, network in networks.items()}
        systems = {m: sweep.system(self.value, self._motion(m, sweep.network)) for m, sweep in sweeps.items()}
        self.systems = {members: system for members, system in systems.items() if system is not None}
        self._plant()
        adopted = dict[Members, Bundle]()
        for members, sweep in sweeps.items():
            system = systems[members]
            joint = None if system is None else self.joint(system.unknowns)
            adopted[members] = sweep.placed(self.value, system, joint)
        return adopted

    def refreshed(self, wanted: Iterable[Members]) -> dict[Members, Bundle]:
        """Bundles with their points where the present unknowns put them."""
        wanted = list(wanted)
        joint = {members: self.joint(self.systems[members].unknowns) for members in wanted if members in self.systems}
        return self._placed(wanted, joint)

    def joint(self, unknowns: Sequence[Unknown]) -> Array:
        """Joint covariance (d, d) of some unknowns, m and rad, straight from iSAM2, with what is considered carried."""
        considered = [unknown for unknown, state in self.shared.items() if state.considered]
        wanted = [*unknowns, *(unknown for unknown in considered if unknown not in unknowns)]
        covariance = self._tree.covariance(wanted)
        if not considered:
            return covariance
        place, d = stretches(wanted, self.value), sum(self.value[unknown].size for unknown in unknowns)
        columns = np.concatenate([np.arange(place[unknown].start, place[unknown].stop) for unknown in considered])
        sigmas = np.concatenate([self.shared[unknown].prior for unknown in considered])
        root = carried(covariance[:, columns], columns, sigmas)[:d]
        return np.asarray(covariance[:d, :d] + root @ root.T)

    # --- books

    def _hold(self, systems: Mapping[Members, ReducedSystem]) -> None:
        for members, system in systems.items():
            for unknown in system.unknowns:
                self._holding[unknown].add(members)

    def _release(self, members: Members, system: ReducedSystem) -> None:
        for unknown in system.unknowns:
            self._holding[unknown].discard(members)

    def _take(self, systems: Mapping[Members, ReducedSystem]) -> None:
        for members in systems:
            if members in self.systems:
                self._release(members, self.systems[members])
        self.systems |= systems
        self._hold(systems)

    def _forget(self, removed: Iterable[Members]) -> None:
        for members in removed:
            self._release_sweep(members)
            if (system := self.systems.pop(members, None)) is not None:
                self._release(members, system)

    def _unused_shifts(self, removed: Sequence[Members], networks: Iterable[Members]) -> list[Unknown]:
        """Shifts on which no bundle depends any longer, not even one whose points have no place."""
        shifts = {unknown for members in removed for unknown in members if unknown.kind == "shift"}
        doubtful = [unknown for unknown in shifts if not self._holding[unknown]]
        # reading the names of all bundles takes long
        remaining = {*self._store.members()} - {*removed} | {*networks} if doubtful else set()
        return [unknown for unknown in doubtful if not any(unknown in members for members in remaining)]

    # --- to the true linear system

    def _relinearize(self) -> tuple[int, set[Members], bool]:
        """Relinearize until all unknowns lie within their slack: number of changes of the tree, relinearized systems,
        and whether it converged.
        """
        changed = set[Members]()
        for updates in range(1, _MOST_UPDATES + 1):
            stale = self._stale(self._take_values())
            if not stale:
                return updates, changed, True
            systems = self._systems_of(stale)
            self._tree.change(systems=systems)
            self._take(systems)
            changed |= set(systems)
        self._take_values()
        return _MOST_UPDATES, changed, False

    def _systems_of(self, bundles: Iterable[Members]) -> dict[Members, ReducedSystem]:
        """Reduced systems at the present values."""
        systems = dict[Members, ReducedSystem]()
        for members in bundles:
            sweep = self._sweep_of(members)
            if (system := sweep.system(self.value, self._motion(members, sweep.network))) is not None:
                systems[members] = system
        return systems

    def _motion(self, members: Members, network: Network) -> Array:
        """(2,) pixels per m and per rad, the largest of the images of a bundle."""
        moving = [self.shared[unknown].motion for unknown in members if unknown.kind in ("image", "node")]
        moving = moving or [image_motion(image) for image in known_images(network)]  # all of them held
        return max((motion[[0, 3]] for motion in moving), key=lambda motion: float(motion[1]))

    def _take_values(self) -> list[Unknown]:
        """Values from the tree; which unknowns have moved."""
        moved = self._tree.moved()
        self.value |= moved
        return list(moved)

    def _stale(self, moved: Iterable[Unknown]) -> set[Members]:
        """Bundles of unknowns that have moved farther from where their system was made than its slack."""
        near = {members for unknown in moved for members in self._holding[unknown]}
        return {members for members in near if self._distance(self.systems[members]) > self.systems[members].slack}

    def _distance(self, system: ReducedSystem) -> float:
        """Pixels by which image places can have moved since a system was made."""
        farthest = 0.0
        for unknown, part in stretches(system.unknowns, self.value).items():
            step = self.value[unknown] - system.at[part]
            farthest = max(farthest, float(np.abs(step) @ self.shared[unknown].motion))
        return farthest

    # --- how far a change reaches

    def _reached(
        self, changed: set[Members], removed: Iterable[Members], before: ByUnknown
    ) -> dict[Members, Array]:
        """Bundles changed, and those whose unknowns have moved noticeably, outwards; with their joint covariance.

        Points move by no more of their sigmas than the unknowns of their bundle do of theirs (in Mahalanobis' sense):
        dp = A dx, and S_p is at least A S_x A'.
        """
        reached = dict[Members, Array]()
        start = {unknown for members in removed for unknown in members} & set(self.shared)
        waiting = changed | {members for unknown in start for members in self._holding[unknown]}
        visited = set(waiting)
        while waiting:
            near = set[Members]()
            for members, joint in self._joints(waiting):
                unknowns = self.systems[members].unknowns
                if members in changed or self._has_moved(unknowns, joint, before):
                    reached[members] = joint
                    near |= {neighbor for unknown in unknowns for neighbor in self._holding[unknown]}
            waiting = near - visited
            visited |= near
        return reached

    def _has_moved(self, unknowns: Members, joint: Array, before: ByUnknown) -> bool:
        """Whether unknowns have moved noticeably, by their joint covariance."""
        # new unknowns have moved from zero
        step = np.concatenate([self.value[unknown] - before.get(unknown, 0.0) for unknown in unknowns])
        # jointly by no less than each of them alone, which is faster to compute
        parts = [*stretches(unknowns, self.value).values(), slice(None)]
        return any(step[part] @ np.linalg.solve(joint[part, part], step[part]) >= _REACH**2 for part in parts)

    def _joints(self, bundles: Iterable[Members]) -> Iterator[tuple[Members, Array]]:
        """Bundles with the joint covariance of their unknowns, computed for many bundles at a time: iSAM2 takes hardly
        longer for many than for few.
        """
        for some in _gathered({members: self.systems[members].unknowns for members in sorted(bundles)}):
            unknowns_of_all = tuple(dict.fromkeys(unknown for unknowns in some.values() for unknown in unknowns))
            joint, place = self.joint(unknowns_of_all), stretches(unknowns_of_all, self.value)
            columns = np.arange(joint.shape[0])
            for members, unknowns in some.items():
                chosen = np.concatenate([columns[place[unknown]] for unknown in unknowns])
                yield members, joint[np.ix_(chosen, chosen)]

    def _note(self, reached: Mapping[Members, Array], new: Iterable[Unknown]) -> None:
        """Values and covariances of the unknowns reached, for the records of the store."""
        covariances = dict[Unknown, Array]()
        for members, joint in reached.items():
            place = stretches(self.systems[members].unknowns, self.value)
            covariances |= {unknown: joint[part, part] for unknown, part in place.items()}
        covariances |= {unknown: self.joint([unknown]) for unknown in new if unknown not in covariances}
        for unknown, covariance in covariances.items():
            self.shared[unknown] = replace(self.shared[unknown], value=self.value[unknown], covariance=covariance)

    # --- points

    def _end_change(self) -> None:
        """End a change: its bundles are in the store now."""
        for members, sweep in self._changing.items():
            self._keep(members, sweep)
        self._changing = {}

    def _sweep_of(self, members: Members) -> Sweep:
        """The sweep of a bundle; rebuilt when it is not kept any longer."""
        if members in self._changing:
            return self._changing[members]
        if (sweep := self._sweeps.get(members)) is None:
            bundle = self._store.bundle(members)
            sweep = Sweep(bundle.network, self._settings, bundle.places)
        return self._keep(members, sweep)

    def _keep(self, members: Members, sweep: Sweep) -> Sweep:
        """Keep a sweep as the most recent one; drop the oldest ones where there are too many points."""
        self._release_sweep(members)
        self._sweeps[members] = sweep
        self._kept += len(sweep.network.points)
        while self._kept > MOST_KEPT and len(self._sweeps) > 1:
            self._release_sweep(next(iter(self._sweeps)))
        return sweep

    def _release_sweep(self, members: Members) -> None:
        if members in self._sweeps:
            self._kept -= len(self._sweeps.pop(members).network.points)

    def _placed(self, bundles: Iterable[Members], joint: Mapping[Members, Array]) -> dict[Members, Bundle]:
        """Bundles of a change with their points where the present unknowns put them."""
        return {
            members: self._sweep_of(members).placed(self.value, self.systems.get(members), joint.get(members))
            for members in bundles
        }

    def _placed_jointly(
        self, bundles: Iterable[Members], joint: Mapping[Members, Array]
    ) -> Iterator[tuple[Members, Bundle, Bundle]]:
        """Bundles of the store as they were and as the present unknowns put them: many at a time, since laying out and
        sweeping dozens of small ones one by one takes ten times as long.
        """
        for batch in self._batches(bundles):
            if len(batch) == 1:
                (now,) = self._placed(batch, joint).items()
                placed = dict([now])
            else:
                network = joined([bundle.network for bundle in batch.values()])
                sweep = Sweep(network, self._settings, _places_of(network, places_by_name(batch.values())))
                placed = sweep.placed_bundles(self.value, batch, self.systems, joint)
            yield from ((members, batch[members], now) for members, now in placed.items())

    def _batches(self, bundles: Iterable[Members]) -> Iterator[dict[Members, Bundle]]:
        """Bundles, as many at a time as may be laid out; alone those that are laid out already, and those with
        orientation images or stereo surfaces.
        """
        batch, size = dict[Members, Bundle](), 0
        for members in bundles:
            bundle = self._store.bundle(members)
            if self._sweeps.get(members) or bundle.network.passes or bundle.network.stereo is not None:
                yield {members: bundle}
                continue
            if batch and size + len(bundle.network.points) > MOST_KEPT:
                yield batch
                batch, size = {}, 0
            batch[members] = bundle
            size += len(bundle.network.points)
        if batch:
            yield batch

    def _far(self, renewed: Iterable[Members], joint: Mapping[Members, Array]) -> dict[Members, Bundle]:
        """Bundles whose points are the same as before: relinearized ones with their new system; and of those reached
        (with the covariance of their unknowns) those that have moved noticeably, with their places now, and their
        covariances if their sigmas have changed by as much.
        """
        far = {m: replace(self._store.bundle(m), reduced=self.systems.get(m)) for m in renewed}
        for members, was, now in self._placed_jointly(joint, joint):
            moved, changed = _noticeably(was, now)
            if moved:
                far[members] = now if changed else replace(now, covariances=was.covariances)
        return far


def _gathered(bundles: Mapping[Members, Members]) -> Iterator[dict[Members, Members]]:
    """Bundles by their unknowns, grouped as long as these are no more than `_MOST_UNKNOWNS`."""
    some, felt = dict[Members, Members](), set[Unknown]()
    for members, unknowns in bundles.items():
        if some and len(felt.union(unknowns)) > _MOST_UNKNOWNS:
            yield some
            some, felt = {}, set()
        some[members] = unknowns
        felt.update(unknowns)
    if some:
        yield some


def _noticeably(was: Bundle, now: Bundle) -> tuple[bool, bool]:
    """Whether any point has moved noticeably, and whether any sigma has changed."""
    with np.errstate(invalid="ignore", divide="ignore"):
        moved = np.abs(now.places - was.places) / was.sigmas
        changed = np.abs(now.sigmas / was.sigmas - 1.0)
    return bool(np.any(moved > _LIKELY)), bool(np.any(changed > _LIKELY))


def places_by_name(bundles: Iterable[Bundle]) -> dict[str, Array]:
    """Places (3,) in m of all points, NaN for undetermined ones, and for those whose rays are nearly parallel: no start
    value when another ray is added.
    """
    places = dict[str, Array]()
    for bundle in bundles:
        poor = np.any(bundle.sigmas > _ANYWHERE, axis=1)[:, None]
        places |= zip(bundle.network.points.ids, np.where(poor, np.nan, bundle.places), strict=True)
    return places


def _places_of(network: Network, places: Mapping[str, Array]) -> Array:
    """(n, 3) m, NaN for a point without a known place, and for a fixed one."""
    positions = np.array([places.get(name, np.full(3, np.nan)) for name in network.points.ids]).reshape(-1, 3)
    positions[network.points.kinds == PointKind.FIXED] = np.nan
    return positions

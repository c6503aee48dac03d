"""Incremental adjustment: bundles go into iSAM2 (`bayes_tree`) and out of it until the linear system is the true one.

A change makes the reduced systems of the bundles that it touches anew, and then those whose unknowns have moved farther
than their slack, until none has. What has to be looked at afterwards is found by following the change outwards, from
bundle to bundle, for as long as points can move by a noticeable part of a sigma.
"""

from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from mgsgraph.adjustment.incremental.bayes_tree import TOGETHER, PriorRows, Tree
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
from mgsgraph.network.parts import Members, Unknown, bundles, joined, known_images

if TYPE_CHECKING:
    from mgsgraph.adjustment.solution import Solution

MOST_KEPT = 150_000
"""Points that stay laid out (about 1 kB each)."""


_MOST_UPDATES = 12
_REACH = 0.5 * NOTICEABLE
"""Sigmas of a bundle's unknowns below which a change isn't followed any farther: its points can't move by more sigmas
than they do, and several ways may lead farther, hence the half."""
_LIKELY = 0.7 * NOTICEABLE
"""Sigmas by which a point has to move for its bundle to be written, or share by which its sigmas have to change."""
_ANYWHERE = 1e3
"""m, sigma of a point's coordinate from which on its place is of no use as a beginning."""
_MOST_TOGETHER = 60
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
        self, shared: dict[Unknown, Shared], systems: dict[Members, ReducedSystem], known: Definitions
    ) -> None:
        """Stand as unknowns, systems and definitions say, with no points laid out."""
        self.shared, self.systems, self.known = shared, systems, known
        self._lay_nothing_out()
        self._plant()
        self._take_values()

    def resume(self, store: StateStore) -> None:
        """Read from now on from a store that holds the same state."""
        self._store = store

    def _lay_nothing_out(self) -> None:
        self._sweeps, self._kept = dict[Members, Sweep](), 0
        self._changing = dict[Members, Sweep]()

    def _plant(self) -> None:
        """Take the values of the unknowns as they are; the tree grows when it is asked for first."""
        self._grown: Tree | None = None
        self.value = {unknown: one.value for unknown, one in self.shared.items()}
        self._holding: defaultdict[Unknown, set[Members]] = defaultdict(set)
        self._hold(self.systems)

    @property
    def _tree(self) -> Tree:
        """The tree of all unknowns and systems: from reduced systems, never from points."""
        if self._grown is None:
            self._grown = Tree()
            units = {unknown: one.prior_sigmas for unknown, one in self.shared.items()}
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
        gone: Sequence[Members],
        networks: Mapping[Members, Network],
        new: Mapping[Unknown, Shared],
        dropped: Sequence[Unknown] = (),
        known: Definitions | None = None,
    ) -> Settled:
        """Put bundles in the place of others, with unknowns that come and go, and settle. `known` are the passes from
        now on, where they have changed.

        Raises
        ------
        PointBehindCamera
            At the present values of the unknowns.
        SolverError
            When iSAM2 can't eliminate the change.
        """
        tree, before = self._tree, dict(self.value)  # of what was there before
        self.shared |= new
        rows = None if known is None else prior_rows(known)
        self.known = self.known if known is None else known
        self.value |= self._expected(new, rows or ())
        places = places_by_name(self._store.bundle(members) for members in gone)
        self._forget(gone)
        for members, network in networks.items():
            self._changing[members] = Sweep(network, self._settings, _places_of(network, places))
        systems = self._made(networks)
        dropped = [*dropped, *self._unfelt(gone, networks)]
        units = {unknown: one.prior_sigmas for unknown, one in new.items()}
        tree.change(units, systems, gone, dropped, rows)
        for unknown in dropped:
            del self.shared[unknown], self.value[unknown]
        self._take(systems)
        updates, others, converged = self._relinearize()
        reached = self._reached(set(systems), gone, before)
        self._note(reached, new)
        bundles = self._placed(networks, reached)
        far = {members: joint for members, joint in reached.items() if members not in networks}
        bundles |= self._far(others - set(networks), far)
        self._settle_down()
        return Settled(bundles, reached, updates, len(systems) + len(others), converged)

    def _expected(self, new: Mapping[Unknown, Shared], rows: Iterable[PriorRows]) -> dict[Unknown, Array]:
        """Values with which new unknowns begin: zero, and of orientation images what their neighbours make likely."""
        nodes = {unknown: one.prior for unknown, one in new.items() if unknown.kind in TOGETHER}
        likely = expected(rows, nodes, self.value) if nodes else {}
        return {unknown: likely.get(unknown, one.value) for unknown, one in new.items()}

    def adopted(
        self, shared: Mapping[Unknown, Shared], solution: "Solution", network: Network
    ) -> dict[Members, Bundle]:
        """Begin again from a batch solution of a network: its values of the unknowns, and all bundles."""
        self._lay_nothing_out()
        self.shared, self.known, every = dict(shared), definitions(network), bundles(network)
        self.value = {unknown: one.value for unknown, one in shared.items()}
        if network.passes or network.stereo is not None or network.common:
            return self._adopted_one_by_one(every, dict(zip(network.points.ids, solution.places, strict=True)))
        places = np.where((network.points.kinds == PointKind.FIXED)[:, None], np.nan, solution.places)
        sweep = Sweep(network, self._settings, places)
        kept = sweep.of_bundles(self.value, solution.joint_covariance, every, self._motion)
        self.systems = {members: one.reduced for members, one in kept.items() if one.reduced is not None}
        self._plant()
        return kept

    def _adopted_one_by_one(
        self, networks: Mapping[Members, Network], places: Mapping[str, Array]
    ) -> dict[Members, Bundle]:
        """Bundles whose points feel other orientation images than are about their measured lines, or whose rows of
        stereo surfaces are made anew; places (3,) of points by name, as far as known.
        """
        sweeps = {m: Sweep(network, self._settings, _places_of(network, places)) for m, network in networks.items()}
        found = {m: sweep.system(self.value, self._motion(m, sweep.network)) for m, sweep in sweeps.items()}
        self.systems = {members: system for members, system in found.items() if system is not None}
        self._plant()
        kept = dict[Members, Bundle]()
        for members, sweep in sweeps.items():
            system = found[members]
            joint = None if system is None else self.joint(system.unknowns)
            kept[members] = sweep.placed(self.value, system, joint)
        return kept

    def refreshed(self, wanted: Iterable[Members]) -> dict[Members, Bundle]:
        """Bundles with their points where the present unknowns put them."""
        wanted = list(wanted)
        joint = {members: self.joint(self.systems[members].unknowns) for members in wanted if members in self.systems}
        return self._placed(wanted, joint)

    def joint(self, unknowns: Sequence[Unknown]) -> Array:
        """Joint covariance (d, d) of some unknowns, m and rad, straight from iSAM2, with what is considered carried."""
        considered = [unknown for unknown, one in self.shared.items() if one.considered]
        every = [*unknowns, *(unknown for unknown in considered if unknown not in unknowns)]
        covariance = self._tree.covariance(every)
        if not considered:
            return covariance
        place, d = stretches(every, self.value), sum(self.value[unknown].size for unknown in unknowns)
        columns = np.concatenate([np.arange(place[unknown].start, place[unknown].stop) for unknown in considered])
        sigmas = np.concatenate([self.shared[unknown].prior for unknown in considered])
        root = carried(covariance[:, columns], columns, sigmas)[:d]
        return np.asarray(covariance[:d, :d] + root @ root.T)

    # --- books

    def _hold(self, systems: Mapping[Members, ReducedSystem]) -> None:
        for members, system in systems.items():
            for unknown in system.unknowns:
                self._holding[unknown].add(members)

    def _let_go(self, members: Members, system: ReducedSystem) -> None:
        for unknown in system.unknowns:
            self._holding[unknown].discard(members)

    def _take(self, systems: Mapping[Members, ReducedSystem]) -> None:
        for members in systems:
            if members in self.systems:
                self._let_go(members, self.systems[members])
        self.systems |= systems
        self._hold(systems)

    def _forget(self, gone: Iterable[Members]) -> None:
        for members in gone:
            self._let_sweep_go(members)
            if (system := self.systems.pop(members, None)) is not None:
                self._let_go(members, system)

    def _unfelt(self, gone: Sequence[Members], networks: Iterable[Members]) -> list[Unknown]:
        """Shifts that no bundle feels any longer, not even one whose points have no place."""
        shifts = {unknown for members in gone for unknown in members if unknown.kind == "shift"}
        doubtful = [unknown for unknown in shifts if not self._holding[unknown]]
        left = {*self._store.members()} - {*gone} | {*networks} if doubtful else set()  # all bundles are many to read
        return [unknown for unknown in doubtful if not any(unknown in members for members in left)]

    # --- to the true linear system

    def _relinearize(self) -> tuple[int, set[Members], bool]:
        """Make systems anew until all unknowns lie within their slack: how often the tree was changed, which systems
        were made, and whether it converged.
        """
        others = set[Members]()
        for updates in range(1, _MOST_UPDATES + 1):
            stale = self._stale(self._take_values())
            if not stale:
                return updates, others, True
            made = self._made(stale)
            self._tree.change(systems=made)
            self._take(made)
            others |= set(made)
        self._take_values()
        return _MOST_UPDATES, others, False

    def _made(self, bundles: Iterable[Members]) -> dict[Members, ReducedSystem]:
        """Reduced systems at the present values."""
        made = dict[Members, ReducedSystem]()
        for members in bundles:
            sweep = self._laid_out(members)
            if (system := sweep.system(self.value, self._motion(members, sweep.network))) is not None:
                made[members] = system
        return made

    def _motion(self, members: Members, network: Network) -> Array:
        """(2,) pixels per m and per rad of the image of a bundle that has most of them."""
        moving = [self.shared[unknown].motion for unknown in members if unknown.kind in ("image", "node")]
        moving = moving or [image_motion(one) for one in known_images(network)]  # all of them held
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
        for unknown, mine in stretches(system.unknowns, self.value).items():
            step = self.value[unknown] - system.at[mine]
            farthest = max(farthest, float(np.abs(step) @ self.shared[unknown].motion))
        return farthest

    # --- how far a change reaches

    def _reached(
        self, changed: set[Members], gone: Iterable[Members], before: Mapping[Unknown, Array]
    ) -> dict[Members, Array]:
        """Bundles changed, and those whose unknowns have moved noticeably, outwards; with their joint covariance.

        Points move by no more of their sigmas than the unknowns of their bundle do of theirs (in Mahalanobis' sense):
        dp = A dx, and S_p is at least A S_x A'.
        """
        reached = dict[Members, Array]()
        start = {unknown for members in gone for unknown in members} & set(self.shared)
        waiting = changed | {members for unknown in start for members in self._holding[unknown]}
        seen = set(waiting)
        while waiting:
            near = set[Members]()
            for members, joint in self._joints(waiting):
                unknowns = self.systems[members].unknowns
                if members in changed or self._has_moved(unknowns, joint, before):
                    reached[members] = joint
                    near |= {other for unknown in unknowns for other in self._holding[unknown]}
            waiting = near - seen
            seen |= near
        return reached

    def _has_moved(self, unknowns: Members, joint: Array, before: Mapping[Unknown, Array]) -> bool:
        """Whether unknowns have moved noticeably, of the joint covariance given."""
        # new unknowns have moved from zero
        step = np.concatenate([self.value[one] - before.get(one, 0.0) for one in unknowns])
        # all of them together by no less than each of them, which is sooner found
        parts = [*stretches(unknowns, self.value).values(), slice(None)]
        return any(step[mine] @ np.linalg.solve(joint[mine, mine], step[mine]) >= _REACH**2 for mine in parts)

    def _joints(self, bundles: Iterable[Members]) -> Iterator[tuple[Members, Array]]:
        """Bundles with the joint covariance of their unknowns: out of that of many at a time, for which iSAM2 takes
        hardly longer than for few.
        """
        for some in _gathered({members: self.systems[members].unknowns for members in sorted(bundles)}):
            every = tuple(dict.fromkeys(unknown for unknowns in some.values() for unknown in unknowns))
            joint, place = self.joint(every), stretches(every, self.value)
            columns = np.arange(joint.shape[0])
            for members, unknowns in some.items():
                mine = np.concatenate([columns[place[unknown]] for unknown in unknowns])
                yield members, joint[np.ix_(mine, mine)]

    def _note(self, reached: Mapping[Members, Array], new: Iterable[Unknown]) -> None:
        """Values and covariances of the unknowns reached, for the records of the store."""
        found = dict[Unknown, Array]()
        for members, joint in reached.items():
            place = stretches(self.systems[members].unknowns, self.value)
            found |= {unknown: joint[mine, mine] for unknown, mine in place.items()}
        found |= {unknown: self.joint([unknown]) for unknown in new if unknown not in found}
        for unknown, covariance in found.items():
            self.shared[unknown] = replace(self.shared[unknown], value=self.value[unknown], covariance=covariance)

    # --- points

    def _settle_down(self) -> None:
        """The bundles of a change are in the store from now on."""
        for members, sweep in self._changing.items():
            self._keep(members, sweep)
        self._changing = {}

    def _laid_out(self, members: Members) -> Sweep:
        """The sweep of a bundle; rebuilt when it isn't at hand any longer."""
        if members in self._changing:
            return self._changing[members]
        if (sweep := self._sweeps.get(members)) is None:
            bundle = self._store.bundle(members)
            sweep = Sweep(bundle.network, self._settings, bundle.places)
        return self._keep(members, sweep)

    def _keep(self, members: Members, sweep: Sweep) -> Sweep:
        """Keep a sweep as the last one that was asked for; the first ones go where there are too many points."""
        self._let_sweep_go(members)
        self._sweeps[members] = sweep
        self._kept += len(sweep.network.points)
        while self._kept > MOST_KEPT and len(self._sweeps) > 1:
            self._let_sweep_go(next(iter(self._sweeps)))
        return sweep

    def _let_sweep_go(self, members: Members) -> None:
        if members in self._sweeps:
            self._kept -= len(self._sweeps.pop(members).network.points)

    def _placed(self, bundles: Iterable[Members], joint: Mapping[Members, Array]) -> dict[Members, Bundle]:
        """Bundles of a change with their points where the present unknowns put them."""
        return {
            members: self._laid_out(members).placed(self.value, self.systems.get(members), joint.get(members))
            for members in bundles
        }

    def _placed_together(
        self, bundles: Iterable[Members], joint: Mapping[Members, Array]
    ) -> Iterator[tuple[Members, Bundle, Bundle]]:
        """Bundles of the store as they were and as the present unknowns put them: many at a time, for laying out and
        sweeping dozens of small ones one by one would take ten times as long.
        """
        for batch in self._batches(bundles):
            if len(batch) == 1:
                (now,) = self._placed(batch, joint).items()
                together = dict([now])
            else:
                network = joined([one.network for one in batch.values()])
                sweep = Sweep(network, self._settings, _places_of(network, places_by_name(batch.values())))
                together = sweep.placed_bundles(self.value, batch, self.systems, joint)
            yield from ((members, batch[members], now) for members, now in together.items())

    def _batches(self, bundles: Iterable[Members]) -> Iterator[dict[Members, Bundle]]:
        """Bundles, as many together as may be laid out; alone those that are laid out already, and those with
        orientation images or stereo surfaces.
        """
        batch, size = dict[Members, Bundle](), 0
        for members in bundles:
            one = self._store.bundle(members)
            if self._sweeps.get(members) or one.network.passes or one.network.stereo is not None:
                yield {members: one}
                continue
            if batch and size + len(one.network.points) > MOST_KEPT:
                yield batch
                batch, size = {}, 0
            batch[members] = one
            size += len(one.network.points)
        if batch:
            yield batch

    def _far(self, made: Iterable[Members], joint: Mapping[Members, Array]) -> dict[Members, Bundle]:
        """Bundles whose points are the same as before: those whose system was made anew, with it; and of those reached
        (with the covariance of their unknowns) the ones that have moved noticeably, with their places now, and their
        covariances, if their sigmas have changed by as much.
        """
        found = {members: replace(self._store.bundle(members), reduced=self.systems.get(members)) for members in made}
        for members, was, now in self._placed_together(joint, joint):
            moved, changed = _noticeably(was, now)
            if moved:
                found[members] = now if changed else replace(now, covariances=was.covariances)
        return found


def _gathered(bundles: Mapping[Members, Members]) -> Iterator[dict[Members, Members]]:
    """Bundles by what they feel, together as long as that is no more than `_MOST_TOGETHER` unknowns."""
    some, felt = dict[Members, Members](), set[Unknown]()
    for members, unknowns in bundles.items():
        if some and len(felt.union(unknowns)) > _MOST_TOGETHER:
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
    """Places (3,) in m of all points, NaN for undetermined ones, and for those that rays all but parallel leave
    anywhere along themselves: no place to begin at with another ray.
    """
    found = dict[str, Array]()
    for one in bundles:
        poor = np.any(one.sigmas > _ANYWHERE, axis=1)[:, None]
        found |= zip(one.network.points.ids, np.where(poor, np.nan, one.places), strict=True)
    return found


def _places_of(network: Network, places: Mapping[str, Array]) -> Array:
    """(n, 3) m, NaN where a point isn't among those known, or is where its a-priori place says."""
    nowhere = np.full(3, np.nan)
    found = np.array([places.get(name, nowhere) for name in network.points.ids]).reshape(-1, 3)
    found[network.points.kinds == PointKind.FIXED] = np.nan
    return found

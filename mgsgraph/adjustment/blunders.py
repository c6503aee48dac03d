"""Search for blunders among rays, ranges and heights above stereo surfaces, by tests that use their redundancy.

An observation's residuals v have the covariance M = 1 - A Q A' (in sigmas), and T = v' M^+ v is chi-square with as many
degrees of freedom as M has rank: a ray of a tie that two images see has one, since nothing checks it along the epipolar
line (Baarda 1968; Pope 1976; Foerstner & Wrobel 2016, section 4.6). A limit of so many standard deviations is the
two-sided probability of a normal error beyond it, for any number of degrees of freedom. The search rejects the worst
observation first, with those inseparable from it; several at a time where none could have caused the other. At the end
it readmits rejected observations that agree with the prediction of the others. It judges none without redundancy.

Of whole observations both rows are tested together; H is the covariance of the adjusted measures and M = 1 - H that of
the residuals, both in sigmas.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from mgsgraph.adjustment.covariances import Linearised, PointRows
from mgsgraph.adjustment.graph import Layout
from mgsgraph.adjustment.graph.forms import BETWEEN, IN_PROCESS, MISFIT, SHARE, Sweeper, numbers
from mgsgraph.geometry.records import Array, Index, Mask, joined_rows
from mgsgraph.kernel.rows import OUT, Small
from mgsgraph.network import PointClass

UNCONTROLLED = 1e-6
"""Redundancy number up to which a measure is uncontrolled: its minimal detectable blunder is over 4000 sigmas."""
_SINGULAR = 1e-12
"""Share of its largest eigenvalue below which one of a point's normal matrix is rounding."""
_PARALLEL = 0.005
"""rad, half the convergence of two rays below which they hardly determine a point: 0.6 deg."""
INSEPARABLE = 0.99
"""Correlation of two tests from which on they can't be separated."""


def swept(at: Linearised, ground: Index) -> tuple[Array, Array]:
    """The kernel's numbers (t, 8), and all of them (g, 3, 7) for some observations (`graph.forms.numbers`)."""
    layout = at.layout
    constants = layout.groups, layout.blocks.target, layout.model, at.orientation
    return numbers(at.rows, *constants, at.pair_blocks(layout), at.points, ground)


def pair_tests(misfit: Array, share: Array, between: Array, root: Array | None) -> tuple[Array, Small]:
    """Test (k,) of both rows of each ray together, and its dimensions.

    Parameters
    ----------
    misfit, share : (k, 2)
        As for `judge_scalars`.
    between : (k,)
        H between the two rows.
    root : (k,), optional
        Roots of the robust weights.

    With M = 1 - H = sum l q q': sum (q'v)^2 / l, or, of an error of prediction, / (l (l p + 1 - l)) for the weighted v;
    eigenvalues of zero are left out: these rows are uncontrolled.
    """
    (z0, z1), (h0, h1) = misfit.T, share.T
    a, b = 1.0 - h0, 1.0 - h1
    trace = a + b
    determinant = a * b - between * between
    # the smaller eigenvalue is between one and two times determinant / trace; where it is none, v lies along the other
    two, some = determinant > UNCONTROLLED * trace, trace > UNCONTROLLED
    dimensions = some.astype(np.int8) + two
    if root is None:
        with np.errstate(divide="ignore", invalid="ignore"):
            test = (b * z0 * z0 + (2.0 * between * z0 + a * z1) * z1) / determinant
        rest = np.flatnonzero(~two)
        test[rest] = (z0[rest] ** 2 + z1[rest] ** 2) / np.where(some[rest], trace[rest], np.inf)
        return test, dimensions
    angle, half = 0.5 * np.arctan2(-between, 0.5 * (a - b)), np.hypot(0.5 * (a - b), between)
    along, across = z0 * np.cos(angle) + z1 * np.sin(angle), z1 * np.cos(angle) - z0 * np.sin(angle)
    test = np.zeros(z0.size)
    for part, size, present in ((along, 0.5 * trace + half, some), (across, 0.5 * trace - half, two)):
        test += np.where(present, part**2 / np.where(present, size * (size * root**2 + 1.0 - size), 1.0), 0.0)
    return test, dimensions


def residual_covariance(at: Linearised, rows: PointRows) -> tuple[Array, Array]:
    """Covariance (m, r, r) of the whitened residuals of m points' rows, 1 - A Q A'; and how the shared unknowns enter
    the residuals once the points follow them: (m, r, columns).
    """
    by_point, through = rows.following()
    turned = through.mT
    shared = through @ at.joint.of(rows.variables) @ turned
    return np.eye(rows.row.size) - by_point @ by_point.mT - shared, through


def direction(covariance: Array, residuals: Array, rows: Mask) -> tuple[Array, Array, Index]:
    """Joint tests of some rows of m points.

    Parameters
    ----------
    covariance, residuals : (m, r, r), (m, r)
        Of the points' whitened residuals.
    rows : (r,)
        Which to test.

    Returns
    -------
    combinations : (m, r)
        c, zero but for the rows: of all c'v it has the largest (c'v)^2 / c'Qc.
    tests, dimensions : (m,)
        That value, chi-square with these degrees of freedom.
    """
    tested = np.flatnonzero(rows)
    values, vectors = np.linalg.eigh(covariance[:, tested[:, None], tested])
    checked = values > UNCONTROLLED
    turned = np.einsum("mrd,mr->md", vectors, residuals[:, tested])
    scaled = np.where(checked, turned / np.where(checked, values, 1.0), 0.0)
    combinations = np.zeros(residuals.shape)
    combinations[:, tested] = np.einsum("mrd,md->mr", vectors, scaled)
    return combinations, np.einsum("md,md->m", turned, scaled), np.count_nonzero(checked, axis=1)


def prediction(rows: PointRows, back: Mask, used: Mask, shared: Array) -> Array:
    """Tests (m,) of rows (r,) of m points by what others that are used (m, r) predict for them; each is chi-square with
    as many degrees of freedom as there are rows. `shared` (columns, columns) is their unknowns' covariance.
    """
    by_point, through = np.zeros_like(rows.by_point[:, back]), rows.by_shared[:, back]
    if not rows.known:
        carried, noise = replace(
            rows, by_point=rows.by_point * used[:, :, None], by_shared=rows.by_shared * used[:, :, None]
        ).eliminated()
        by_point, through = rows.by_point[:, back] @ noise, through + rows.by_point[:, back] @ carried
    covariance = np.eye(by_point.shape[1]) + by_point @ by_point.mT
    covariance += through @ shared @ through.mT
    error = rows.residuals[:, back, None]
    return np.asarray((error.mT @ np.linalg.solve(covariance, error))[:, 0, 0])


def closure(rows: PointRows, chosen: Mask, shared: Array) -> tuple[Array, Index]:
    """Tests (m,) of how well chosen rows (m, r), which had no part in the unknowns' covariance `shared`, meet in their
    points, and their degrees of freedom.
    """
    by_point, error = rows.by_point * chosen[:, :, None], (rows.residuals * chosen)[:, :, None]
    through = rows.by_shared * chosen[:, :, None]
    covariance = np.eye(rows.row.size) + through @ shared @ through.mT
    turned = np.linalg.solve(covariance, by_point).mT
    normal = turned @ by_point  # of rays that hardly converge, or do so behind a camera, singular
    misclosure = error - by_point @ (np.linalg.pinv(normal, _SINGULAR, hermitian=True) @ (turned @ error))
    test = misclosure.mT @ np.linalg.solve(covariance, misclosure)
    rank = np.linalg.matrix_rank(normal, rtol=_SINGULAR, hermitian=True)
    return test[:, 0, 0], chosen.sum(axis=1) - rank


def hardly_converging(rows: PointRows, chosen: Mask) -> Mask:
    """(m,) points that chosen rows (m, r) place no better than a single ray does."""
    by_point = rows.by_point * chosen[:, :, None]
    eigenvalues = np.linalg.eigvalsh(by_point.mT @ by_point)
    return np.asarray(eigenvalues[:, 0] < _PARALLEL**2 * eigenvalues[:, 2])



_INDEPENDENT = 0.1
"""Correlation of the tests of different points up to which both may be rejected at a time."""
_MOST_COLUMNS = 4000
"""Shared unknowns whose dense covariance (128 MB) is made to compare candidates: the others wait."""
_MOST_CANDIDATES = 2000
"""Points that are compared at a time."""
_MEDIANS = 0.4549364, 1.3862944
"""Medians of chi-square of one and of two degrees of freedom."""
_DECISIVE = 2.0 * math.log(100.0)
"""Difference of two tests that makes one of two observations of a point the blunder with odds of 100 to 1."""
_FEW = 0.005
"""Share of the tests up to which those beyond the limit are rejected one by one, without a robust adjustment."""
_FLOOR = 0.1
"""A-priori sigmas, lower bound of a class's spread."""
_CONTRADICTED = 3.0
"""Standard errors of a class's spread from which on it replaces the a-priori sigmas."""
_SPREAD_ERROR = 1.17
"""Standard error of the logarithm of a spread that is estimated from a median, times the root of the sample's size."""


class Judged(NamedTuple):
    """Observations that may be blunders: k rays, r ranges, n heights above stereo surfaces (of all points)."""

    place: Index
    """(k + r + n,) among the layout's observations; -1 for points that lie on no stereo surface."""
    point: Index
    """(k + r + n,) network point."""
    group: Index
    """(k + r + n,) class whose spread they share."""

    @property
    def single(self) -> Mask:
        """Which have one row: all but rays."""
        return self.group >= len(PointClass)


def judged(layout: Layout) -> Judged:
    """Observations of a layout's network that may be blunders, and where the layout has them."""
    network, places = layout.network, layout.observation_rows
    stereo = np.full(len(network.points), -1)
    if layout.stereo is not None:
        stereo[layout.stereo.points] = places.stereo
    kinds, points = len(PointClass), np.arange(stereo.size)
    return Judged(
        np.concatenate([places.rays, places.ranges, stereo]).astype(np.int64),
        np.concatenate([network.rays.point, network.ranges.point, points]),
        np.concatenate([
            network.points.classes[network.rays.point], np.full(network.ranges.point.size, kinds),
            np.full(stereo.size, kinds + 1),
        ]).astype(np.int64),
    )  # fmt: skip


def critical_value(limit: float, dimensions: int) -> float:
    """What chi-square of so many degrees of freedom exceeds as rarely as a normal error `limit` standard deviations."""
    from scipy.special import chdtri  # slow to import

    return float(chdtri(dimensions, math.erfc(limit / math.sqrt(2.0)))) if dimensions else math.inf


@dataclass(slots=True, eq=False)
class Search:
    """A search for blunders, from one adjustment to the next."""

    limit: float
    """Standard deviations of a normal error that is as rare as a good observation beyond the limit."""
    sweeper: Sweeper = IN_PROCESS
    """Computes the kernel's sums over the points."""
    dimensions: Small | None = field(default=None, init=False)
    """(k + r + n,) degrees of freedom of each one's last test while it took part; 0 where nothing checked it."""
    _returned: Mask | None = field(default=None, init=False)
    """(k + r + n,) readmitted observations: each once."""

    @property
    def memory(self) -> bytes:
        """What the next step depends on beside the adjustment it judges."""
        return b"" if self._returned is None else self._returned.tobytes()

    def many_beyond(self, at: Linearised) -> bool:
        """Whether more than a few tests are beyond the limit, perhaps because of one another: by the a-priori sigmas,
        or by those of the residuals where smaller.
        """
        tests, dimensions, units = self._tests(at, judged(at.layout))
        over = np.count_nonzero(tests > np.minimum(units, 1.0) * self._critical(dimensions))
        return bool(over > _FEW * np.count_nonzero(dimensions))

    def without_gross(self, at: Linearised, taken: Mask) -> Mask:
        """Observations without the worst of each point beyond the limit, where blunders hardly disturb `at`."""
        tested = judged(at.layout)
        return _without(at, tested, taken, self._candidates(at, tested, *self._tests(at, tested), most=taken.size))

    def next(self, at: Linearised, with_all: Linearised, taken: Mask) -> Mask:
        """Observations of the next adjustment; those of this one when the search has ended.

        Parameters
        ----------
        at : Linearised
            The adjustment of the observations `taken` (k + r + n,).
        with_all : Linearised
            The same with the rows of all; points without a place are where all their rays put them.
        """
        tested = judged(at.layout)
        tests, dimensions, units = self._tests(at, tested)
        self._returned = np.zeros(taken.size, dtype=bool) if self._returned is None else self._returned
        if candidates := self._candidates(at, tested, tests, dimensions, units):
            sizes, limits = np.array([(candidate.size, candidate.limit) for candidate in candidates]).T
            pulls = [(candidate.variables, candidate.pull) for candidate in candidates]
            return _without(at, tested, taken, [candidates[k] for k in independent(pulls, sizes, limits, at)])
        back = self._agreeing(at, with_all, tested, taken, units)
        self._returned |= back
        return taken | back

    def _tests(self, at: Linearised, tested: Judged) -> tuple[Array, Small, Array]:
        """Tests, NaN where there is none, their degrees of freedom, and the square of the unit in which each counts."""
        tests, dimensions = observed_tests(at, tested, self.sweeper)
        before = dimensions if self.dimensions is None else self.dimensions
        self.dimensions = np.where(_present(at, tested), dimensions, before)
        return tests, dimensions, squared_units(tests, dimensions, tested)

    def _critical(self, dimensions: Small) -> Array:
        return np.array([critical_value(self.limit, d) for d in range(3)])[dimensions]

    def _candidates(
        self, at: Linearised, tested: Judged, tests: Array, dimensions: Small, units: Array,
        most: int = _MOST_CANDIDATES,
    ) -> "list[_Candidate]":  # fmt: skip
        """The worst of each point that has one beyond the limit, and what is inseparable from it; worst first."""
        severity = np.nan_to_num(tests / (units * self._critical(dimensions)))
        over = np.flatnonzero(severity > 1.0)
        worst = over[np.argsort(-severity[over], kind="stable")]
        points, first = np.unique(tested.point[worst], return_index=True)
        candidates = list[_Candidate]()
        for rows, table in _pieces(at, tested, points[np.argsort(first)[:most]]):
            candidates += _worst(at, rows, table, np.where(table >= 0, severity[table], 0.0), units[table])
        return sorted(candidates, key=lambda candidate: -candidate.size / candidate.limit)

    def _agreeing(self, at: Linearised, with_all: Linearised, tested: Judged, taken: Mask, units: Array) -> Mask:
        """Rejected observations, never readmitted before, that agree with the others."""
        assert self._returned is not None
        out, back = ~taken & ~self._returned & (tested.place >= 0), np.zeros(taken.size, dtype=bool)
        without_place = at.layout.network_order(at.rows.kind) == OUT
        points = np.unique(tested.point[out])
        for rows, table in _pieces(with_all, tested, points[~without_place[points]]):
            shared, used = at.joint.of(rows.variables), np.where(table >= 0, taken[table], True)[:, rows.observation]
            wanted = (table >= 0) & out[table]
            tests = np.full(table.shape, np.inf)
            for slot in np.flatnonzero(np.any(wanted, axis=0)).tolist():
                row, chosen = rows.observation == slot, wanted[:, slot]
                test = prediction(rows, row, used, shared) / units[table[:, slot]]
                fits = chosen & (test <= critical_value(self.limit, int(row.sum())))
                tests[fits, slot] = test[fits]
            for k in np.flatnonzero(np.any(np.isfinite(tests), axis=1)).tolist():
                some = np.flatnonzero(np.isfinite(tests[k]))
                row = np.isin(rows.observation, some)
                joint = prediction(rows.of(k), row, used[[k]], shared)[0] / units[table[k, some]].max()
                if some.size > 1 and joint > critical_value(self.limit, int(row.sum())):
                    second = np.sort(tests[k, some])[1]
                    some = some[tests[k, some] < second - _DECISIVE]
                back[table[k, some]] = True
        for rows, table in _pieces(with_all, tested, points[without_place[points]]):
            present = table >= 0
            chosen = np.where(present, taken[table] | out[table], True)
            returns = self._reinstated(rows, chosen, present, units[table], at)
            back[table[returns & out[table]]] = True
        return back

    def _reinstated(self, rows: PointRows, chosen: Mask, present: Mask, units: Array, at: Linearised) -> Mask:
        """Observations (m, slots) that place lost points again: all of a point, or all but the blunder."""
        shared, unit = at.joint.of(rows.variables), np.where(present, units, 0.0).max(axis=1)
        omitted, tests = [-1, *np.flatnonzero(np.any(present, axis=0)).tolist()], list[Array]()
        for slot in omitted:
            used = chosen[:, rows.observation] & (rows.observation != slot)
            test, dimensions = closure(rows, used, shared)
            limits = np.array([critical_value(self.limit, d) if d > 0 else -1.0 for d in dimensions.tolist()])
            tests.append(np.where((test <= unit * limits) & ~hardly_converging(rows, used), test / unit, np.inf))
        with_each, *without = tests
        best, second = np.partition(without, 1, axis=0)[:2] if len(without) > 1 else (without[0], np.inf)
        but_one = ~np.isfinite(with_each) & np.isfinite(best) & (second > best + _DECISIVE)
        returns = present & chosen & (np.isfinite(with_each) | but_one)[:, None]
        returns[but_one, np.array(omitted[1:])[np.argmin(without, axis=0)][but_one]] = False
        return returns


class _Candidate(NamedTuple):
    """The observation of a point that is farthest beyond the limit, and those inseparable from it."""

    observations: Index
    """As in `Judged`."""
    variables: tuple[int, ...]
    pull: Array
    """(columns of the variables,) how they enter its test, before that is divided by its sigma."""
    size: float
    """Root of its test."""
    limit: float
    """Limit of the root."""


def observed_tests(at: Linearised, tested: Judged, sweeper: Sweeper = IN_PROCESS) -> tuple[Array, Small]:
    """Tests (k + r + n,) of whole observations and their degrees of freedom; NaN and 0 for those that take no part, and
    those that nothing checks.
    """
    joint = at.pair_blocks(at.layout)
    numbers = sweeper.leverage(at.layout, at.rows, at.orientation, joint, at.points)[tested.place]
    share = numbers[:, SHARE]
    share[tested.single, 1] = 1.0  # there is no second row
    tests, dimensions = pair_tests(numbers[:, MISFIT], share, numbers[:, BETWEEN], None)
    none = ~_present(at, tested) | (dimensions == 0)
    tests[none], dimensions[none] = np.nan, 0
    return tests, dimensions


def _present(at: Linearised, tested: Judged) -> Mask:
    """Which take part (k + r + n,)."""
    kind = at.layout.network_order(at.rows.kind)[tested.point]
    return np.asarray((tested.place >= 0) & (at.rows.weight[0, tested.place] > 0.0) & (kind != OUT))


def squared_units(tests: Array, dimensions: Small, tested: Judged) -> Array:
    """Squared unit (k + r + n,) of each test: of the a-priori sigmas, or of the spread of its class.

    The median of the tests over that of chi-square (0.455 for one degree of freedom, 1.386 for two) estimates it from
    the middle of the class, which blunders hardly move. It holds in place of 1 where it differs by three of its
    standard errors: of few tests it is less reliable than the a-priori sigmas. Points count: the rays of a tie share
    theirs.
    """
    units = np.ones(tests.size)
    for group in np.unique(tested.group):
        members = np.flatnonzero((tested.group == group) & (dimensions > 0))
        if not members.size:
            continue
        median = np.array([np.nan, *_MEDIANS])[dimensions[members]]
        units[tested.group == group] = squared_unit(tests[members] / median, np.unique(tested.point[members]).size)
    return units


def squared_unit(ratios: Array, count: int) -> float:
    """Square of the unit of one class, of its tests over the median of chi-square, `count` of them independent."""
    unit = max(float(np.median(ratios)), _FLOOR**2)
    return unit if abs(0.5 * math.log(unit)) > _CONTRADICTED * _SPREAD_ERROR / math.sqrt(count) else 1.0


def independent(
    pulls: Sequence[tuple[tuple[int, ...], Array]], sizes: Array, limits: Array, at: Linearised
) -> list[int]:
    """Which of c tests on different points, worst first, to act on at a time: the first, and later ones that exceed
    their limits even without the largest effect of the ones before.

    Parameters
    ----------
    pulls : sequence
        Shared unknowns of each, and how they enter it, before it is divided by its sigma: (columns,).
    sizes, limits : (c,)
        Roots of the tests, and of what each is to stay below.
    """
    width, columns = at.layout.variables.width, dict[int, int]()
    compared, total = list[int](), 0
    for k, (variables, _) in enumerate(pulls):
        new = [v for v in variables if v not in columns]
        if compared and total + sum(int(width[v]) for v in new) > _MOST_COLUMNS:
            continue
        for v in new:
            columns[v] = total
            total += int(width[v])
        compared.append(k)
    pulls_of_all = np.zeros((len(compared), total))
    for row, k in zip(pulls_of_all, compared, strict=True):
        variables, pull = pulls[k]
        places = [np.arange(columns[v], columns[v] + width[v]) for v in variables]
        row[joined_rows(places)] = pull
    size, limit = sizes[compared], limits[compared]
    correlation = np.abs(pulls_of_all @ at.joint.of(columns) @ pulls_of_all.T) / size[:, None] / size
    disturbed, nearest, taken = np.zeros(size.size), np.zeros(size.size), list[int]()
    for j, k in enumerate(compared):
        if taken and (nearest[j] > _INDEPENDENT or size[j] - disturbed[j] <= limit[j]):
            continue
        taken.append(k)
        disturbed += correlation[j] * size[j]
        nearest = np.maximum(nearest, correlation[j])
    return taken


def _without(at: Linearised, tested: Judged, taken: Mask, candidates: Sequence[_Candidate]) -> Mask:
    """Observations left after rejecting some, without those of points whose other rays hardly converge."""
    remaining = taken.copy()
    for candidate in candidates:
        remaining[candidate.observations] = False
    for rows, table in _pieces(at, tested, np.unique(tested.point[taken & ~remaining])):
        if rows.known:
            continue
        present = table >= 0
        hardly = hardly_converging(rows, np.where(present, remaining[table], True)[:, rows.observation])
        remaining[table[hardly][present[hardly]]] = False
    return remaining


def _pieces(at: Linearised, tested: Judged, points: Index) -> Iterator[tuple[PointRows, Index]]:
    """Rows of some network points, piece by piece, and which of the judged each observation of them is: (m, slots), -1
    for none.
    """
    rows, patterns = at.rows, at.layout.patterns
    wanted = np.zeros(rows.kind.size, dtype=bool)
    wanted[points] = True
    wanted_rows = np.flatnonzero(wanted[tested.point] & (tested.place >= 0))
    number = patterns.point_index[tested.point[wanted_rows]]
    order = np.lexsort((tested.place[wanted_rows], patterns.piece_of(number)))
    wanted_rows, number = wanted_rows[order], number[order]
    pieces, begins = np.unique(patterns.piece_of(number), return_index=True)
    for piece, (a, b) in zip(pieces.tolist(), pairwise([*begins.tolist(), wanted_rows.size]), strict=True):
        _, first, count, _, observation = rows.piece[piece].tolist()
        inside = number[a:b] - first
        slot = (tested.place[wanted_rows[a:b]] - observation - inside) // count
        several, row = np.unique(inside, return_inverse=True)
        piece_rows = at.rows_inside(piece, several)
        table = np.full((several.size, int(piece_rows.observation.max()) + 1), -1)
        table[row, slot] = wanted_rows[a:b]
        yield piece_rows, table


def _worst(at: Linearised, rows: PointRows, table: Index, severity: Array, units: Array) -> Iterator[_Candidate]:
    """The worst of each point of a piece that has one beyond the limit, by test over limit (m, slots), the tests in
    units (m, slots).
    """
    covariance, through = residual_covariance(at, rows)
    slots = np.flatnonzero(np.any(table >= 0, axis=0))
    each = [direction(covariance, rows.residuals, rows.observation == slot) for slot in slots.tolist()]
    combinations, tests = np.stack([part[0] for part in each]), np.stack([part[1] for part in each], axis=1)
    numbers, severity = table[:, slots], severity[:, slots]
    for k, worst in enumerate(severity.argmax(axis=1).tolist()):
        test = tests[k, worst]
        if severity[k, worst] <= 1.0 or test <= 0.0:
            continue
        combination = combinations[worst, k]
        inseparable = (numbers[k] >= 0) & (tests[k] > max(test - _DECISIVE * units[k, slots[worst]], 0.0))
        inseparable[worst] = True
        size = math.sqrt(test)
        pull = through[k].T @ combination
        yield _Candidate(numbers[k, inseparable], rows.variables, pull, size, size / math.sqrt(severity[k, worst]))

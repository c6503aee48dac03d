"""May a solution be used? One record, from which sentences, exit status, JSON and pages follow.

A solution is *invalid* if it did not converge, or what it converged to proves nothing: half of a kind of observations
left out, residuals ten times larger than stated, an orientation a hundred prior sigmas from where it was. It is
*suspect* if a test finds what its stated sigmas don't explain. Tests: the squares of each group of observations and of
priors; each correction of what points share against its prior; errors that clock, position, pointing, terrain or
ranges may have in common; constant residuals of each class of points in each image; each observation alone. All of
them together call a good solution suspect with a probability of LEVEL at most (Bonferroni). Beside them stand checks
of common sense: heights against their neighbors, observations given twice, laser shots far from where the camera
looks. *Valid* is what passes, and no more is said than that: what nothing tests is named, and so is what an error of
an input could still hide (`undetected`).

Of networks of more than MOST_POINTS points a random sample of these is tested, beside all priors.
"""

import math
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from enum import StrEnum
from weakref import WeakKeyDictionary

import numpy as np

from mgsgraph.adjustment.covariances import Linearised
from mgsgraph.adjustment.fit import ABSURD
from mgsgraph.adjustment.solution import Solution
from mgsgraph.analysis.checkpoints import checkpoint_discrepancies
from mgsgraph.analysis.geometry_checks import deviating_heights, misplaced_profiles
from mgsgraph.analysis.group_tests import UNTESTED, GroupTest, fit_of_groups
from mgsgraph.analysis.grouping import group_rows
from mgsgraph.analysis.linearised import PriorRows, at_points, at_solution, at_values, prior_rows, unknown_name
from mgsgraph.analysis.residual_rows import ResidualRows, residual_rows
from mgsgraph.analysis.sanity import losses, unexplained_ranges, unexplained_residuals
from mgsgraph.analysis.undetected import Undetected, undetected
from mgsgraph.errors import InputError
from mgsgraph.geometry.records import Array, Index
from mgsgraph.kernel.rows import IMAGE
from mgsgraph.network import Network, PointClass
from mgsgraph.network.duplicates import duplicates
from mgsgraph.record import Record

LEVEL = 0.015
"""Probability that tests call a solution suspect whose stated sigmas are right, at most."""
MOST_POINTS = 5_000
"""Points of a network up to which all of its rows are tested."""
_SAMPLE = 500
"""Points of a larger one that are tested."""
_SHARES = {"groups": 0.4, "corrections": 0.2, "common errors": 0.2, "offsets": 0.1, "observations": 0.1}
"""Of the level, of each kind of tests: the first ones stand for what harms most."""
_CHECKPOINTS = 0.001
"""Level of the test of all checkpoints together, beside that of all other tests."""
_COMMON_ERRORS = 60
"""Possible errors, about, among which one is to be found."""
_RELEVANT = 1.1
"""sigma0 of a group from which on it matters: smaller ones change a sigma by less than its second digit."""
_CONTROLLED = 1e-3
"""Redundancy number of an observation below which its residual says nothing but rounding."""
_PIXELS = 0.5
"""Constant residual in pixels below which it does no harm."""
_FEW = 8
"""Fewer residuals don't show how they scatter."""
_MOST_IMAGES = 50
"""Images up to which constant residuals are looked at in each."""
_CORRECTIONS = 10
"""Corrections that are kept, the most significant ones."""


class State(StrEnum):
    """Whether a solution may be used.

    Examples
    --------
    >>> mgsgraph.verdict(solution).state
    <State.VALID: 'valid'>
    """

    VALID = "valid"
    """All tests passed."""
    SUSPECT = "suspect"
    """A test found what the stated sigmas don't explain: look at the input."""
    INVALID = "invalid"
    """Not a result."""


class Cause(StrEnum):
    """What a reason is about.

    Examples
    --------
    >>> from mgsgraph.analysis.verdict import Cause
    >>> mgsgraph.verdict(solution).of(Cause.GROUP)
    ()
    """

    NOT_CONVERGED = "not converged"
    LEFT_OUT = "observations left out"
    SIGMA0 = "sigma0"
    ORIENTATION = "orientation beyond its prior"
    CORRECTION = "correction against its prior"
    COMMON_ERROR = "common error"
    GROUP = "group of observations"
    CHECKPOINT = "checkpoints"
    OFFSET = "constant residual"
    OBSERVATION = "single observation"
    NOMINAL = "nominal residuals"
    PROFILE = "laser shots beside their image"
    HEIGHT = "height against neighbors"
    DUPLICATE = "observation given twice"
    UNTESTED = "not tested"


@dataclass(frozen=True, slots=True)
class Reason(Record):
    """Why a solution is suspect or invalid.

    Examples
    --------
    >>> stopped = mgsgraph.adjust_network(network, mgsgraph.SolverSettings(max_iterations=1))
    >>> reason = mgsgraph.verdict(stopped).reasons[0]
    >>> reason.state.value, reason.cause.value
    ('invalid', 'not converged')
    """

    state: State
    """Suspect or invalid."""
    cause: Cause
    """What it is about."""
    what: str
    """Of which group, unknown, image or point."""
    size: float
    """How much."""
    unit: str
    """Of `size`: sigmas, m, px, share, or a factor."""
    count: int = 1
    """How many of them."""
    p_value: float = math.nan
    """Chance of it, if the stated sigmas are right; NaN of what is no test."""


@dataclass(frozen=True, slots=True)
class Correction(Record):
    """The correction of one unknown that points share, against its prior.

    Examples
    --------
    >>> largest = mgsgraph.verdict(solution).corrections[0]
    >>> abs(largest.test) < 4.0, 0.0 < largest.p_value < 1.0
    (True, True)
    """

    name: str
    """Of the unknown."""
    unit: str
    """m, rad or s."""
    value: float
    """Correction, in that unit."""
    in_sigmas: float
    """Over its prior sigma."""
    test: float
    """Over its own expected size, the root of prior variance minus posterior variance: standard normal."""
    p_value: float
    """Chance of a correction so large, or larger."""


@dataclass(frozen=True, slots=True, eq=False)
class Verdict(Record):
    """Whether a solution may be used, and why (not).

    Examples
    --------
    >>> found = mgsgraph.verdict(solution)
    >>> found.state.value, len(found.reasons), found.tests > 50
    ('valid', 0, True)
    """

    state: State
    """Valid, suspect or invalid."""
    reasons: tuple[Reason, ...]
    """Why, the gravest first."""
    groups: tuple[GroupTest, ...]
    """All groups of observations and priors; none where there is no covariance or redundancy."""
    corrections: tuple[Correction, ...]
    """The most significant ones."""
    undetected: tuple[Undetected, ...]
    """What errors of inputs could still hide."""
    tests: int
    """Number of tests."""
    points: int
    """Points whose rows were tested."""

    @property
    def untested(self) -> tuple[str, ...]:
        """Groups that nothing tests."""
        return tuple(group.name for group in self.groups if not group.tested)

    def of(self, cause: Cause) -> tuple[Reason, ...]:
        """Reasons about one thing."""
        return tuple(reason for reason in self.reasons if reason.cause is cause)


_UNTESTED = Verdict(State.VALID, (), (), (), (), 0, 0)
_VERDICTS: "WeakKeyDictionary[Solution, Verdict]" = WeakKeyDictionary()
"""Verdicts of solutions, which never change: sentences, tables, files and exit status all ask for them."""


def verdict(solution: Solution) -> Verdict:
    """The verdict on a solution.

    Examples
    --------
    >>> found = mgsgraph.verdict(solution)
    >>> found.state.value, found.untested
    ('valid', ())
    """
    result = _VERDICTS.get(solution)
    if result is None:
        result = _VERDICTS[solution] = _verdict(solution)
    return result


def is_valid(solution: Solution) -> bool:
    """Whether a solution is valid or suspect: not invalid."""
    return verdict(solution).state is not State.INVALID


def _verdict(solution: Solution) -> Verdict:
    with ThreadPoolExecutor(1) as pool:  # sorts and searches beside linear algebra
        checks = pool.submit(lambda: [*_grave(solution), *_of_common_sense(solution)])
        try:
            tested = _tested(solution)
        except (InputError, np.linalg.LinAlgError):
            what = "factors of your own on points" if solution.own_factors else "no covariance of all points"
            reason = Reason(State.SUSPECT, Cause.UNTESTED, what, math.nan, "")
            tested = replace(_UNTESTED, reasons=(reason,))
        reasons = [*checks.result(), *tested.reasons, *_of_checkpoints(solution)]
    causes = list(Cause)
    reasons.sort(key=lambda reason: (reason.state is not State.INVALID, causes.index(reason.cause),
                                  np.nan_to_num(reason.p_value), -abs(reason.size)))  # fmt: skip
    states = {reason.state for reason in reasons}
    state = next((candidate for candidate in (State.INVALID, State.SUSPECT) if candidate in states), State.VALID)
    return replace(tested, state=state, reasons=tuple(reasons))


def _tested(solution: Solution) -> Verdict:
    """What the tests find; nothing of a solution that did not converge or has no redundancy."""
    if not solution.converged or solution.fit.degrees_of_freedom < 1:
        return _UNTESTED
    small = len(solution.network.points) <= MOST_POINTS
    at = at_solution(solution).of_estimator() if small else _sampled(solution)
    rows, priors = residual_rows(at, np.arange(len(at.network.points))), prior_rows(at)
    groups = fit_of_groups(rows, priors, group_rows(at.network))
    corrections, tested = _corrections(at, priors)
    common, offsets = _common_errors(solution, rows), list(_offsets(rows))
    level = _level("offsets", len(offsets))
    reasons = [
        *_of_groups(groups),
        *(Reason(State.SUSPECT, Cause.CORRECTION, unknown.name, unknown.in_sigmas, "sigmas", p_value=unknown.p_value)
          for unknown in corrections if unknown.p_value < _level("corrections", tested)),
        *_common_error([error for error in common if math.isfinite(error.p_value)]),
        *(offset for offset in offsets if offset.p_value < level and abs(offset.size) > _PIXELS),
        *(_outliers(rows) if small else _outlying_rays(solution)),
    ]  # fmt: skip
    count = sum(group.tested for group in groups) + tested + len(common) + len(offsets)
    count += rows.begin_of_priors if small else solution.residuals.size
    points = np.unique(rows.point[: rows.begin_of_priors]).size
    return Verdict(State.VALID, tuple(reasons), groups, tuple(corrections[:_CORRECTIONS]), common, count, points)


def _of_checkpoints(solution: Solution) -> Iterator[Reason]:
    """Checkpoints that are farther from their known coordinates than stated."""
    found = checkpoint_discrepancies(solution) if solution.converged else None
    if found is not None and found.p_value < _CHECKPOINTS:
        size = math.sqrt(found.chi_square / found.degrees)
        yield Reason(State.SUSPECT, Cause.CHECKPOINT, "checkpoints", size, "factor", p_value=found.p_value)


def _level(kind: str, tests: int) -> float:
    """Of a single test of a kind of which there are so many."""
    return LEVEL * _SHARES[kind] / max(tests, 1)


def level_of_groups(groups: Sequence[GroupTest]) -> float:
    """Of the test of each of some groups."""
    return _level("groups", sum(group.tested for group in groups))


def _critical(level: float) -> float:
    """What a standard normal variable exceeds in modulus with a probability."""
    from scipy.special import ndtri  # slow to import

    return float(-ndtri(0.5 * level))


def _sampled(solution: Solution) -> Linearised:
    """Some of the points where they were solved."""
    determined = np.flatnonzero(solution.determined)
    chosen = np.random.default_rng(0).choice(determined, min(_SAMPLE, determined.size), replace=False)
    return at_points(solution, np.sort(chosen))


# --- what is no test


def _grave(solution: Solution) -> Iterator[Reason]:
    """What makes a solution invalid, and what comes near to it."""
    if not solution.converged:
        yield Reason(State.INVALID, Cause.NOT_CONVERGED, solution.message, math.nan, "")
    for loss in losses(solution):
        what = f"{loss.kind}{f' of {loss.image}' if loss.image else ''}"
        state = State.INVALID if loss.fatal else State.SUSPECT
        yield Reason(state, Cause.LEFT_OUT, what, loss.share, "share", loss.left_out)
    if solution.sigma0 > ABSURD:
        yield Reason(State.INVALID, Cause.SIGMA0, "all observations", solution.sigma0, "factor")
    for moved in solution.strained:
        state = State.INVALID if moved.impossible else State.SUSPECT
        name = solution.network.images[moved.image].name
        yield Reason(state, Cause.ORIENTATION, name, moved.most, "sigmas")


def _of_common_sense(solution: Solution) -> Iterator[Reason]:
    """Checks of the geometry and of the input, before and after."""
    network = solution.network
    for exceeding, before, unit in (
        (unexplained_residuals, solution.residuals_before, "px"),
        (unexplained_ranges, solution.range_residuals_before, "m"),
    ):
        for excess in exceeding(network, before):
            yield Reason(State.SUSPECT, Cause.NOMINAL, network.images[excess.image].name, excess.size, unit)
    for twice in duplicates(network):
        yield Reason(State.SUSPECT, Cause.DUPLICATE, twice.sentence, twice.count / twice.total, "share", twice.count)
    for profile in misplaced_profiles(network):
        yield Reason(State.SUSPECT, Cause.PROFILE, profile.name, profile.angle, "rad", profile.shots)
    heights = deviating_heights(network, solution.places, solution.covariances)
    for point, height in zip(heights.points.tolist(), heights.deviations.tolist(), strict=True):
        yield Reason(State.SUSPECT, Cause.HEIGHT, network.points.ids[point], height, "m")


def _common_errors(solution: Solution, rows: ResidualRows) -> tuple[Undetected, ...]:
    """Errors of inputs that observations have in common, with the terrain model and without."""
    network, critical = solution.network, _critical(_level("common errors", _COMMON_ERRORS))
    if network.surface is None or len(network.points) > MOST_POINTS:
        return undetected(rows, critical)
    values = list(solution.values)
    if network.terrain_moves:
        del values[len(network.images) + len(network.shift_names) - 1]
    try:
        at = at_values(replace(network, surface=None), solution.settings, values, solution.places)
        return undetected(rows, critical, residual_rows(at, np.arange(len(network.points))))
    except (InputError, np.linalg.LinAlgError):  # nothing else holds some of it
        errors = undetected(rows, critical)
        return tuple(replace(error, size_without_terrain=math.inf, effect_without_terrain=math.inf) for error in errors)


# --- tests


def _of_groups(groups: Sequence[GroupTest]) -> list[Reason]:
    """Groups that fit worse than stated."""
    level = level_of_groups(groups)
    return [
        Reason(State.SUSPECT, Cause.GROUP, group.name, group.sigma0, "factor", p_value=group.p_value)
        for group in groups if group.tested and group.p_value < level and group.sigma0 > _RELEVANT
    ]  # fmt: skip


def _corrections(at: Linearised, priors: PriorRows) -> tuple[list[Correction], int]:
    """Corrections of unknowns that something but their priors tests, most significant first; how many there are."""
    from scipy.special import ndtr  # slow to import

    redundancy = 1.0 - priors.share
    redundancy[redundancy.size - priors.crossovers :] = 0.0  # those are observations
    tested = np.flatnonzero(redundancy > UNTESTED)
    test = priors.misfit[tested] / np.sqrt(redundancy[tested])
    order = np.argsort(-np.abs(test), kind="stable")[: 5 * _CORRECTIONS]
    variables = at.layout.variables
    adjusted = np.array(variables.adjusted(), dtype=np.int64)
    of_column = np.repeat(adjusted, variables.width[adjusted])
    corrections = []
    for k in order.tolist():
        row, value = int(tested[k]), float(test[k])
        column = int(priors.about[row])
        name, unit = unknown_name(at.network, int(of_column[column]), column - int(variables.first[of_column[column]]))
        p = 2.0 * float(ndtr(-abs(value)))
        in_sigmas = float(priors.misfit[row])
        corrections.append(Correction(name, unit, float(at.orientation[column]), in_sigmas, value, p))
    return corrections, tested.size


def _common_error(checked: Sequence[Undetected]) -> list[Reason]:
    """The most significant one: others that look like it go with it."""
    over = [error for error in checked if error.p_value < _level("common errors", len(checked))]
    if not over:
        return []
    largest = max(over, key=lambda each: abs(each.test))
    what = f"{largest.what} of {largest.of}"
    return [Reason(State.SUSPECT, Cause.COMMON_ERROR, what, largest.test, "sigmas", len(over), largest.p_value)]


def _offsets(rows: ResidualRows) -> Iterator[Reason]:
    """Constant residuals of each class of points in each image: reasons, whether significant or not."""
    network = rows.at.network
    if len(network.images) > _MOST_IMAGES:
        return
    rays = rows.of_kind(IMAGE)
    image, classes = network.rays.image[rows.measure[rays]], network.points.classes[rows.point[rays]]
    for j, picture in enumerate(network.images):
        for point_class in PointClass:
            for component, way in enumerate(("lines", "samples")):
                members = rays[(image == j) & (classes == point_class) & (rows.component[rays] == component)]
                what = f"{way} of {point_class.name.lower()} points in {picture.name}"
                yield from _offset(rows, members, rows.scale[members], what, "px")


def _offset(rows: ResidualRows, members: Index, column: Array, what: str, unit: str) -> Iterator[Reason]:
    """The score test of a constant that some rows (q,) have in common, whitened (q,) per unit; and the test of their
    mean by their own scatter, which finds it behind stated sigmas that are too large.
    """
    from scipy.special import ndtr, stdtr  # slow to import

    if not members.size:
        return
    variance, score = float(rows.variance(members, column[:, None])[0, 0]), float(column @ rows.residuals[members])
    if variance > _CONTROLLED * float(column @ column):
        p = 2.0 * float(ndtr(-abs(score) / math.sqrt(variance)))
        yield Reason(State.SUSPECT, Cause.OFFSET, what, score / variance, unit, members.size, p)
    values = rows.residuals[members] / column
    if members.size >= _FEW and np.ptp(values) > 0.0:
        mean, error = float(values.mean()), float(values.std(ddof=1)) / math.sqrt(members.size)
        p = 2.0 * float(stdtr(members.size - 1, -abs(mean) / error))
        yield Reason(State.SUSPECT, Cause.OFFSET, what, mean, unit, members.size, p)


def _outliers(rows: ResidualRows) -> Iterator[Reason]:
    """Observations whose own test none of so many good ones would exceed, as one reason."""
    redundancy = rows.redundancy[: rows.begin_of_priors]
    tested = np.flatnonzero(redundancy > _CONTROLLED)
    test = np.abs(rows.residuals[tested]) / np.sqrt(redundancy[tested])
    return _outlying(rows.at.network, rows.point[tested], test, tested.size)


def _outlying_rays(solution: Solution) -> Iterator[Reason]:
    """The same of all image measurements of a large network, by their residuals over their own sigmas: these exceed
    what redundancy leaves of them, so that none is named in vain.
    """
    network = solution.network
    test = np.nan_to_num(np.abs(solution.residuals / network.ray_sigmas).max(axis=1))
    return _outlying(network, network.rays.point, np.where(solution.rays_used, test, 0.0), solution.residuals.size)


def _outlying(network: Network, point: Index, test: Array, count: int) -> Iterator[Reason]:
    """Observations (k,) of some points that exceed what none of `count` good tests would, as one reason."""
    from scipy.special import ndtr  # slow to import

    over = np.flatnonzero(test > _critical(_level("observations", count)))
    if over.size:
        worst = int(over[np.argmax(test[over])])
        name, size = network.points.ids[int(point[worst])], float(test[worst])
        points = np.unique(point[over]).size
        yield Reason(State.SUSPECT, Cause.OBSERVATION, name, size, "sigmas", points, 2.0 * float(ndtr(-size)))

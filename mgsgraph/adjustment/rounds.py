"""Passes of one adjustment: solve, reject and re-admit rows, solve again; rays laid out about the lines in which their
points are seen, so that every row is that of the true trajectory there.

The kernel takes the pose from the line about which a ray is laid out, the measured one to begin with, to the predicted
line by its rates. Over some lines that is right to 1e-9 of a line, but not across a sample of the attitude (where the
rates jump), nor over a misfit of hundreds of lines. So rays are relinearized about their predicted lines until
nothing moves. So are the slopes of detector lines, by which misplacements count in samples, where unknowns bend them.
Heights above stereo surfaces are made linear about the state that counts in the same turns.
"""

import math
from dataclasses import dataclass, replace

import numpy as np

from mgsgraph.adjustment.batch import Outcome, solve_bundle
from mgsgraph.adjustment.blunders import Search
from mgsgraph.adjustment.covariances import Linearised, orientation_covariance
from mgsgraph.adjustment.drivers import driver_sentences, drivers_of
from mgsgraph.adjustment.fit import residuals
from mgsgraph.adjustment.graph import BundleGraph, Layout
from mgsgraph.adjustment.graph.forms import IN_PROCESS, Sweeper
from mgsgraph.adjustment.graph.rays import followed
from mgsgraph.adjustment.graph.stereo import require_seen
from mgsgraph.adjustment.settings import Iteration, Progress, SolverSettings
from mgsgraph.errors import PointBehindCamera, SolverError, Unsolvable
from mgsgraph.files.networks.tie_points import PointKind
from mgsgraph.geometry.plausibility import resection_remedy
from mgsgraph.geometry.records import Array, Index, Mask
from mgsgraph.kernel.rows import BEHIND, GOOD, NO_LOSS, OUT, PREDICTED, TUKEY, WEAK, Rows, Small
from mgsgraph.kernel.sweep import COSTS, SYSTEM, Reduction
from mgsgraph.network import Network
from mgsgraph.network.parallel import nearly_parallel

NEAR = 1e-5
"""Lines from where a ray is laid out to its predicted line. The rates of a pose jump from sample to sample by much
less than a tenth of themselves, so that a row is then right to 1e-6 lines, and its derivatives to 1e-10."""
NEAR_ENOUGH = 1e-3
"""The same where places of points alone are asked for: rows are right to 1e-4 lines where the rates of a pose jump, and
to rounding everywhere else."""
_MOST = 20
"""Times that points follow their lines, and lines their points."""
_MOST_TURNS = 20
"""Times that rays are relinearized: two or three do it, more where a predicted line lies beside a sample at which the
rates jump."""
_BEYOND = 0.5
"""Share of an image's lines by which a predicted line may lie before it or after it."""
_UNBENT = 1e-9
"""m, change of unknowns of the interior orientation that changes the slope of a detector line by a ten-millionth."""


def about_predicted_lines(
    layout: Layout, orientation: Array, points: Array, near: float = NEAR, in_place: bool = False,
    sweeper: Sweeper = IN_PROCESS,
) -> Layout:  # fmt: skip
    """The layout itself where its rays are laid out about the lines predicted by shared unknowns (columns,) and points
    (n, 3), layout order, to `near` lines, and its stereo rows are linear about these; else one where they are. In the
    measured-line form lines do not change. `in_place`: the layout may be overwritten, the caller does not use it again.
    """
    now = layout
    if layout.model.line == PREDICTED:
        now = _about_followed_lines(layout, orientation, points, near, in_place, sweeper)
    return now if now.stereo is None else now.about_stereo(layout.network_order(points), orientation)


def _about_followed_lines(
    layout: Layout, orientation: Array, points: Array, near: float, in_place: bool, sweeper: Sweeper
) -> Layout:
    """The same of rays alone, in the strict form."""
    network, now, rays = layout.network, layout, layout.network.rays
    size = np.array([image.lines for image in network.images], dtype=np.float64)
    lines = np.empty(now.lines.size)
    for _ in range(_MOST_TURNS):
        values = sweeper.residuals(now, now.rows, orientation, points)
        ways = now.observation_rows.rays, now.rows.kind, rays.point, now.patterns.point_index, rays.image
        moved = followed(now.lines, rays.places, values, *ways, size, _BEYOND, OUT, lines)
        bending = np.abs(orientation - now.bent)[now.bending].max(initial=0.0)
        if moved <= near and bending <= _UNBENT:
            break
        renewed = now.about(lines, orientation, in_place or now is not layout)
        if renewed.patterns is not now.patterns:
            points = now.network_order(points)[renewed.point_order]
        lines, now = np.empty(lines.size) if now is layout else now.lines, renewed
    return now


def exactly(
    layout: Layout, orientation: Array, points: Array, sweeper: Sweeper = IN_PROCESS
) -> tuple[Layout, Array]:
    """The same, and the points in its order: for a network that is linearized where it was adjusted."""
    renewed = about_predicted_lines(layout, orientation, points, sweeper=sweeper)
    return renewed, points if renewed is layout else layout.network_order(points)[renewed.point_order]


_MOST_PASSES = 100
"""When blunders are sought: each takes something out, or back once."""
_STAGE = 1e-4
"""Share of the cost: a stage ends where a step gains less."""
_RESTING = 1e-4
"""Posterior sigmas: where convergence is slow, rays are not relinearized any more after a first step as short."""
_MOST_LAYOUTS = 60
"""Times that rays are relinearized in one pass."""


@dataclass(frozen=True, slots=True, eq=False)
class Selection:
    """Which rows take part, in network order."""

    rays: Mask
    """(k,)"""
    ranges: Mask
    """(r,)"""
    out: Mask
    """(n,) undetermined points, even with all rows."""
    stereo: Mask
    """(n,) points whose height above a stereo surface takes part, if they lie on one."""

    def same(self, selection: "Selection") -> bool:
        """Whether the same rays, ranges and heights take part."""
        return all(
            np.array_equal(getattr(self, name), getattr(selection, name)) for name in ("rays", "ranges", "stereo")
        )

    @property
    def key(self) -> bytes:
        """The same for selections in which the same rows take part."""
        return b"".join(part.tobytes() for part in (self.rays, self.ranges, self.stereo))

    def without_stereo(self) -> "Selection":
        """The same without heights above stereo surfaces."""
        return replace(self, stereo=np.zeros_like(self.stereo))

    def rows(self, layout: Layout) -> Rows:
        """The layout's rows that take part; free points that rejection has left with fewer than two rays go too."""
        network = layout.network
        every = network.ray_counts  # counting takes a tenth of a large solve
        remaining = every if np.all(self.rays) else np.bincount(network.rays.point, self.rays, every.size)
        out = self.out | ((network.points.kinds == PointKind.FREE) & (remaining < 2))
        return layout.active(self.rays, self.ranges, out, self.stereo)


def relinearized(
    layout: Layout, selection: Selection, reduction: Reduction, task: int = SYSTEM, in_place: bool = False,
    sweeper: Sweeper = IN_PROCESS,
) -> tuple[Layout, Reduction]:  # fmt: skip
    """Layout and reduction of selected points that follow their lines, and lines their points, the shared unknowns
    held; `in_place` as of `about_predicted_lines`.
    """
    for _ in range(_MOST):
        at = reduction.orientation, reduction.points
        renewed = about_predicted_lines(layout, *at, in_place=in_place, sweeper=sweeper)
        if renewed is layout:
            break
        layout, in_place = renewed, True
        reduction = BundleGraph(renewed, selection.rows(renewed), sweeper).reduction(reduction.orientation, task)
    return layout, reduction


def all_rows(network: Network) -> Selection:
    """All rows, without undetermined points."""
    sizes = network.rays.point.size, network.ranges.point.size, len(network.points)
    rays, ranges, stereo = (np.ones(size, dtype=bool) for size in sizes)
    return Selection(rays, ranges, network.undetermined.copy(), stereo)


def unmarked(network: Network) -> Selection:
    """All rows but known blunders, as the network marks them."""
    selected, rays, ranges = all_rows(network), network.rays.rejected, network.ranges.rejected
    assert rays is not None  # a network fills them in
    assert ranges is not None
    selection = replace(selected, rays=~rays, ranges=~ranges)
    if network.stereo is None or network.stereo.rejected is None:
        return selection
    return replace(selection, stereo=~network.stereo.rejected)


@dataclass(frozen=True, slots=True, eq=False)
class Solved:
    """The result of the passes."""

    layout: Layout
    """All rows, laid out as in the last pass."""
    outcome: Outcome
    """How the last pass ended."""
    history: tuple[Iteration, ...]
    """Every step tried, over all passes."""
    cost_initial: float
    """Cost of the nominal orientation."""
    orientation: Array
    """(columns,) shared unknowns, m and rad."""
    points: Array
    """(n, 3) m, layout order."""
    rows: Rows
    """Rows that took part in the last pass."""
    selection: Selection
    """The same in network order."""
    reduction: Reduction
    """Points eliminated at the end."""
    rounds: int
    """How many there were."""
    circling: bool = False
    """Whether they ran in a circle."""
    dimensions: Small | None = None
    """(k + r + n,) as of `blunders.Search`; None when none were sought."""


def solve_in_rounds(
    layout: Layout,
    settings: SolverSettings,
    selection: Selection,
    before: Reduction,
    progress: Progress,
    sweeper: Sweeper = IN_PROCESS,
    begin: Array | None = None,
) -> Solved:
    """Solve; when blunders are sought, reject and re-admit rows and solve again until none changes. Where the passes
    run in a circle, the best of it counts. `before` is the reduction of these rows at the nominal orientation, the
    start, or at the shared unknowns `begin` (columns,). Without `begin` stereo surfaces are added after the images have
    been adjusted: before that they do not show the ground.
    """
    history, initial = tuple[Iteration, ...](), float("nan")
    solved_before: dict[bytes, Solved] = {}
    orientation = np.zeros(layout.columns) if begin is None else begin
    reduction: Reduction | None = before if begin is None else None
    if layout.network.stereo is not None:
        bare = selection.without_stereo()
        if begin is None:
            first = _solve_exactly(layout, bare, orientation, reduction, settings, progress, sweeper)
            layout, orientation, points = first.layout, first.orientation, first.points
            history, initial = first.history, first.cost_initial
        else:
            points = BundleGraph(layout, bare.rows(layout), sweeper).reduction(orientation, COSTS).points
        layout, reduction = _on_surfaces(layout.convex, orientation, points), None
    search, returned = Search(settings.reject, sweeper) if settings.reject > 0.0 else None, b""
    for number in range(1, _MOST_PASSES + 1):
        solved = _solve_exactly(layout, selection, orientation, reduction, settings, progress, sweeper)
        layout, selection, history = solved.layout, solved.selection, history + solved.history
        initial = solved.cost_initial if np.isnan(initial) else initial
        solved = replace(solved, history=history, cost_initial=initial, rounds=number)
        if search is None:
            return solved
        chosen, onward, tried = _next(search, layout, solved, settings, sweeper)
        history += tried
        solved = replace(solved, dimensions=search.dimensions)
        if chosen.same(selection):
            return solved
        solved_before[selection.key + returned] = solved
        selection, orientation, reduction, returned = chosen, onward, None, search.memory
        if selection.key + returned in solved_before:
            break
    last = tuple(solved_before.values())[-1].selection  # costs compare where the same rows take part
    same_rows = (earlier for earlier in solved_before.values() if earlier.selection.same(last))
    return replace(min(same_rows, key=lambda earlier: earlier.outcome.cost_final), history=history, circling=True)


def _on_surfaces(layout: Layout, orientation: Array, points: Array) -> Layout:
    """Layout with stereo rows about an orientation, and about where a search has put their points, else about points
    (n, 3), layout order.
    """
    control, places = layout.network.stereo, layout.network_order(points)
    if control is not None and control.starts is not None:
        places = np.where(np.isfinite(control.starts), control.starts, places)
    layout = layout.without_steps.about_stereo(places, orientation)
    if layout.stereo is not None:
        require_seen(layout.network, layout.stereo)
    return layout


def _solve_exactly(
    layout: Layout,
    selection: Selection,
    orientation: Array,
    reduction: Reduction | None,
    settings: SolverSettings,
    progress: Progress,
    sweeper: Sweeper,
) -> Solved:
    """One pass: solve, and again with rays laid out about their predicted lines until every row is exact."""
    layout, begun = layout.without_steps, None
    if settings.loss == "tukey" and layout.model.loss != TUKEY:
        begun = _graduated(layout, selection, orientation, settings, progress, sweeper)
        layout, selection, orientation, reduction = begun.layout, begun.selection, begun.orientation, None
    graph = BundleGraph(layout, selection.rows(layout), sweeper)
    if reduction is None:
        selection, graph, reduction = _start(graph, selection, orientation, None, settings)
    solved = _solve(graph, selection, orientation, reduction, settings, progress)
    initial, history = solved.cost_initial, solved.history
    if begun is not None:
        initial, history = begun.cost_initial, begun.history + history
    for _ in range(_MOST_LAYOUTS):
        in_place = solved.layout is not layout or settings.reject == 0.0  # a search looks at earlier passes again
        at = solved.orientation, solved.points
        renewed = about_predicted_lines(solved.layout, *at, in_place=in_place, sweeper=sweeper)
        if renewed is solved.layout or not solved.outcome.converged:
            break
        graph = BundleGraph(renewed, selection.rows(renewed), sweeper)
        points = solved.layout.network_order(solved.points)[renewed.point_order]
        selection, graph, reduction = _start(graph, selection, solved.orientation, points, settings)
        solved = _solve(graph, selection, solved.orientation, reduction, settings, progress, solved.outcome.slow)
        history += solved.history
        if solved.outcome.slow and solved.history[0].step < _RESTING:  # their lines continue to move by as little
            break
    else:
        if solved.layout.stereo is not None:
            message = f"Heights above stereo surfaces have not converged in {_MOST_LAYOUTS} rounds."
            solved = replace(solved, outcome=replace(solved.outcome, converged=False, message=message))
    if settings.loss == "tukey" and (weighted := _with_weight(solved, sweeper)) is not selection:
        graph = BundleGraph(solved.layout, weighted.rows(solved.layout), sweeper)
        solved = _solve(graph, weighted, solved.orientation, None, settings, progress, solved.outcome.slow)
        history += solved.history
    return replace(solved, cost_initial=initial, history=history)


def _graduated(
    layout: Layout, selection: Selection, orientation: Array, settings: SolverSettings, progress: Progress,
    sweeper: Sweeper,
) -> Solved:  # fmt: skip
    """Start of a redescending loss: a convex one, with sigmas that become narrower (`SolverSettings.narrowing`). Priors
    of orientations keep theirs, so that they bound the effect of blunders first. Rows without weight at the end are
    left out: with them points have several minima, and the cost jumps from one to another.
    """
    graph = BundleGraph(layout, selection.rows(layout), sweeper)
    begin, places = graph.reduction(orientation, COSTS), layout.observation_rows
    squares = _squares(layout, selection, begin, sweeper).values()
    largest = max(float(np.nanmax(values, initial=0.0)) for values in squares)
    early, history = replace(settings, cost_tolerance=max(settings.cost_tolerance, _STAGE)), tuple[Iteration, ...]()
    for factor in settings.narrowing(math.sqrt(largest)):
        wide = graph.rows._replace(weight=graph.rows.weight.copy())
        wide.weight[:, np.concatenate([places.rays, places.ranges, places.stereo])] /= factor
        layout = layout if factor > 1.0 else layout.with_loss("tukey", settings.width)
        solved = _solve(BundleGraph(layout, wide, sweeper), selection, orientation, None, early, progress)
        orientation, history = solved.orientation, history + solved.history
    return replace(solved, selection=_with_weight(solved, sweeper), cost_initial=graph.cost(begin), history=history)


def _squares(layout: Layout, selection: Selection, at: Reduction, sweeper: Sweeper) -> dict[str, Array]:
    """Squares in sigmas of selected rays (k,), ranges (r,), and heights above stereo surfaces (n,); else NaN."""
    residuals_, network = residuals(layout, at.orientation, at.points, sweeper), layout.network
    stereo = residuals_.stereo if network.stereo is None else residuals_.stereo / network.stereo.sigmas
    rays = np.sum((residuals_.image / network.rays.sigmas) ** 2, axis=1)
    rays[selection.out[network.rays.point]] = np.nan
    by_kind = {"rays": rays, "ranges": (residuals_.ranges / network.ranges.sigmas) ** 2, "stereo": stereo**2}
    return {name: np.where(getattr(selection, name), squares, np.nan) for name, squares in by_kind.items()}


def _with_weight(solved: Solved, sweeper: Sweeper) -> Selection:
    """The selection without rows to which a redescending loss gives no weight, and without points that the others don't
    determine; itself when there are none.
    """
    layout, selection, limit = solved.layout, solved.selection, solved.layout.model.width**2
    squares = _squares(layout, selection, solved.reduction, sweeper)
    weighted = {name: getattr(selection, name) & ~(values >= limit) for name, values in squares.items()}
    remaining = replace(selection, **weighted)
    return _without_undetermined(layout, selection if remaining.same(selection) else remaining, solved.reduction)


def _start(
    graph: BundleGraph, selection: Selection, orientation: Array, points: Array | None, settings: SolverSettings
) -> tuple[Selection, BundleGraph, Reduction]:
    """The start of an optimization; when blunders are sought, without points that have no place there."""
    reduction = graph.reduction(orientation, points=points)
    strong = _without_undetermined(graph.layout, selection, reduction) if settings.reject > 0.0 else selection
    if strong is selection:
        return selection, graph, reduction
    graph = BundleGraph(graph.layout, strong.rows(graph.layout), graph.sweeper)
    return strong, graph, graph.reduction(orientation, points=points)


def _solve(
    graph: BundleGraph,
    selection: Selection,
    orientation: Array,
    start: Reduction | None,
    settings: SolverSettings,
    progress: Progress,
    slow: bool = False,
) -> Solved:
    """One optimization; `start` is a reduction at its start, `slow` whether the one before converged slowly.

    Raises SolverError that names images and points.
    """
    try:
        outcome, reduction = solve_bundle(graph, orientation, start, settings, progress, slow)
    except Unsolvable as error:
        reached = error.state if isinstance(error.state, np.ndarray) else orientation
        at = start if start is not None and start.serves(reached, COSTS) else graph.reduction(reached, COSTS)
        words = " ".join(driver_sentences(drivers_of(graph, at), graph.layout.network))
        raise SolverError(f"{error}. {words}") from None
    return Solved(
        graph.layout, outcome, outcome.history, outcome.cost_initial, outcome.state, reduction.points, graph.rows,
        selection, reduction, rounds=1,
    )  # fmt: skip


def _next(
    search: Search, layout: Layout, solved: Solved, settings: SolverSettings, sweeper: Sweeper
) -> tuple[Selection, Array, tuple[Iteration, ...]]:
    """Rows of the next pass, start values of its shared unknowns, and the steps tried before.

    Tests are those of least squares, about the adjustment's unknowns. Where the first finds something, a robust loss
    follows, whose unknowns gross blunders hardly move: there the worst of each point is rejected at once.
    """
    selection, network, first = solved.selection, layout.network, search.dimensions is None
    taken = np.concatenate([selection.rays, selection.ranges, selection.stereo])
    at, reduction = _least_squares(layout, solved, settings, sweeper)
    strong = _without_undetermined(layout, selection, reduction)
    if strong is not selection:
        return strong, solved.orientation, ()
    wanted = first and settings.loss == "none" and search.many_beyond(at)
    robust = _robust(layout, solved, settings, sweeper) if wanted else None
    if robust is not None:
        next_taken = search.without_gross(_least_squares(robust.layout, robust, settings, sweeper)[0], taken)
    else:
        places = places_of_all(layout, solved, sweeper)
        next_taken = search.next(at, replace(at, rows=at.layout.rows, points=places), taken)
    rays, ranges, stereo = np.split(next_taken, np.cumsum([network.rays.point.size, network.ranges.point.size]))
    begin, history = (solved.orientation, ()) if robust is None else (robust.orientation, robust.history)
    return Selection(rays, ranges, selection.out, stereo), begin, history


def _without_undetermined(layout: Layout, selection: Selection, reduction: Reduction) -> Selection:
    """The selection without rays of points that their remaining rays put behind a camera, or don't determine; itself
    when there are none.
    """
    undetermined = layout.point_order[(reduction.states != GOOD) & determined_points(selection.rows(layout))]
    if not undetermined.size:
        return selection
    return replace(selection, rays=selection.rays & ~np.isin(layout.network.rays.point, undetermined))


def _robust(layout: Layout, solved: Solved, settings: SolverSettings, sweeper: Sweeper) -> Solved | None:
    """The same adjustment with a loss that bounds the effect of a blunder; None where it fails."""
    selection, layout = solved.selection, layout.with_loss("cauchy")
    graph = BundleGraph(layout, selection.rows(layout), sweeper)
    begin = graph.reduction(solved.orientation, points=solved.points)
    if not math.isfinite(begin.cost):
        return None
    try:
        return _solve_exactly(layout, selection, solved.orientation, begin, settings, lambda _: None, sweeper)
    except SolverError:  # it has more than one minimum
        return None


def _least_squares(
    layout: Layout, solved: Solved, settings: SolverSettings, sweeper: Sweeper
) -> tuple[Linearised, Reduction]:
    """Rows that take part, linearised about the unknowns of an adjustment, at full weight; and their reduction."""
    plain = layout if layout.model.loss == NO_LOSS else layout.with_loss("none")
    graph = BundleGraph(plain, solved.selection.rows(plain), sweeper)
    reduction = solved.reduction if plain is layout else graph.reduction(solved.orientation, points=solved.points)
    joint = orientation_covariance(graph, reduction, consider=False)
    return Linearised(plain, settings, graph.rows, solved.orientation, reduction.points, joint), reduction


def places_of_all(layout: Layout, solved: Solved, sweeper: Sweeper = IN_PROCESS) -> Array:
    """(n, 3) m, layout order: solved places; for points whose rays were rejected, the place that all its rays give."""
    with_all = replace(all_rows(layout.network), out=solved.selection.out)
    by_all = BundleGraph(layout, with_all.rows(layout), sweeper).reduction(solved.orientation, COSTS).points
    return np.where(determined_points(solved.rows)[:, None], solved.points, by_all)


def determined_points(rows: Rows) -> Mask:
    """(n,) points that take part, layout order."""
    return np.asarray(rows.kind != OUT)


def without_weak(layout: Layout, reduction: Reduction, selection: Selection) -> Selection:
    """Leave out points that their rays don't determine, among them those whose rays are nearly parallel and part;
    refuse other points behind a camera.
    """
    behind = np.flatnonzero(reduction.states == BEHIND)
    behind = behind[~nearly_parallel(layout.network, layout.point_order[behind])]
    if behind.size:
        raise behind_camera(layout, behind, reduction.points[behind[0]])
    out = selection.out.copy()
    out[layout.point_order[(reduction.states == WEAK) | (reduction.states == BEHIND)]] = True
    return replace(selection, out=out)


def behind_camera(layout: Layout, behind: Index, point: Array) -> PointBehindCamera:
    """The error for points (indices in the layout) that lie behind a camera, the first of which is at a place (3,) m:
    names that point and its image, and the image that sees the most of them.
    """
    network, i = layout.network, int(layout.point_order[behind[0]])
    for k in np.flatnonzero(network.rays.point == i):
        image = network.images[network.rays.image[k]]
        pose = image.pose(network.rays.places[[k], 0])
        if (pose.matrix[0] @ (point - pose.position[0]))[2] <= 0.0:
            break
    more = ""
    if behind.size > 1:
        images_behind = network.rays.image[np.isin(network.rays.point, layout.point_order[behind])]
        number = np.bincount(images_behind, minlength=len(network.images))
        most, totals = int(number.argmax()), np.bincount(network.rays.image, minlength=number.size)
        most = max(np.flatnonzero(number == number[most]).tolist(), key=lambda j: number[j] / totals[j])
        more = f", as do {behind.size - 1} others; image {network.images[most].name} sees {number[most]} of them all"
    return PointBehindCamera(
        f"point {network.points.ids[i]}, image {image.name}",
        f"the point lies behind the camera{more}",
        "a point before it",
        resection_remedy(network.images) or "check the point's a-priori place, the measure and the image's orientation",
    )

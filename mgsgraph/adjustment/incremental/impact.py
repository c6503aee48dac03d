"""The effect of a change: which images and points moved, by how much and by how many of their sigmas."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from mgsgraph.adjustment.incremental.state import NOTICEABLE, Bundle, Bundles, Settled, Shared, shared_of
from mgsgraph.files.output.table import Column, Table
from mgsgraph.geometry.records import Array, Mask
from mgsgraph.names import numbered
from mgsgraph.network.parts import ByUnknown, Members, Unknown
from mgsgraph.record import Record, card
from mgsgraph.text import many

_FAR = 5.0
"""A-priori sigmas beyond which a new image's correction is remarkable."""
SHOWN = 12
"""Rows of a printed table."""
_NAME = 28
"""Characters of a printed name."""


@dataclass(frozen=True, slots=True, eq=False)
class MovedImages(Record):
    """Images that a change reached, and orientation images of passes (then position and rotation are those at their
    time); i of them.
    """

    names: tuple[str, ...]
    """(i) of an orientation image the pass and its time past the pass's epoch."""
    new: Mask
    """(i,) whether the change brought them."""
    moves: Array
    """(i, 6) m and rad, change of the constant term of the orientation: position, rotation about the camera axes."""
    in_sigmas: Array
    """(i,) largest change of a coefficient, in its sigmas before."""
    sigmas_before: Array
    """(i, 6) m and rad, of the constant term."""
    sigmas_after: Array
    """(i, 6) m and rad."""
    on_ground: Array
    """(i,) m, by which the ground under the image's middle moved."""
    ground_before: Array
    """(i,) m, sigma of that place, root of the trace of its covariance along the ground."""
    ground_after: Array
    """(i,) m."""
    nodes: Mask
    """(i,) True for an orientation image of a pass."""


@dataclass(frozen=True, slots=True, eq=False)
class MovedPoints(Record):
    """Points that moved by more than `NOTICEABLE` of a sigma, or that the change brought; n of them."""

    ids: tuple[str, ...]
    """(n)"""
    new: Mask
    """(n,) whether they had no place before."""
    moves: Array
    """(n, 3) m, body-fixed; NaN for new ones."""
    in_sigmas: Array
    """(n,) largest of x, y, z in sigmas before; NaN for new ones."""
    sigmas_before: Array
    """(n, 3) m; NaN for new ones."""
    sigmas_after: Array
    """(n, 3) m."""


@dataclass(frozen=True, slots=True, eq=False)
class Impact(Record):
    """What adding or removing images, or editing points, has done to the rest.

    Examples
    --------
    >>> adjustment = mgsgraph.IncrementalAdjustment.of(solution)
    >>> print(adjustment.remove("SIM/B").sentences[0])
    1 image reached; most moved is SIM/A: 0.092 of its sigmas, 3.2 m on the ground.
    """

    verb: str
    """add, remove, or what was done to points."""
    subjects: tuple[str, ...]
    """Images added or removed."""
    images: MovedImages
    """Images that the change reached."""
    points: MovedPoints
    """Points that it moved."""
    neighbours: dict[str, int]
    """Images that share determined points with those added, and how many."""
    unconnected: tuple[str, ...]
    """Images added that share no points with any other."""
    removed: tuple[str, ...]
    """Points that no image sees any longer, removed with the image."""
    undetermined: tuple[str, ...]
    """Points that had a place, and have too few rays left."""
    updates: int
    """How often iSAM2's tree was changed until everything lay within its slack."""
    systems: int
    """Number of reduced systems that were made."""
    converged: bool
    """Whether the adjustment converged."""
    seconds: float = float("nan")
    """s, wall time of the whole change."""

    def __repr__(self) -> str:
        moved = int(np.count_nonzero(~self.points.new))
        return (
            f"Impact({self.verb} {', '.join(self.subjects)}: {len(self.images.names)} images reached, {moved} points "
            f"moved by more than {NOTICEABLE} of a sigma, {len(self.points.ids) - moved} new)"
        )

    def after(self, seconds: float) -> "Impact":
        """The record with the wall time (s) of the change."""
        return replace(self, seconds=seconds)

    @property
    def sentences(self) -> list[str]:
        """The main results, in sentences."""
        lines = list[str]()
        if self.unconnected:
            names = ", ".join(self.unconnected)
            lines.append(f"Unconnected: {names}. No point is shared with another image; tie points would join it.")
        if self.neighbours:
            most = sorted(self.neighbours.items(), key=lambda pair: -pair[1])[:5]
            lines.append("Shared points: " + ", ".join(f"{count} with {name}" for name, count in most) + ".")
        lines += [*self._of_images(), *self._of_points()]
        if self.undetermined:
            lines.append(f"{many(len(self.undetermined), 'point')} with too few rays left, without a place now.")
        if self.removed:
            which = " that no other image saw" if self.subjects else ""
            lines.append(f"{many(len(self.removed), 'point')}{which}: removed.")
        return [*lines, *([] if self.converged else ["It did not converge; solve the project."])]

    def _of_images(self) -> list[str]:
        images, old = self.images, ~self.images.new
        lines = [
            f"{images.names[k]} lies {images.in_sigmas[k]:.2g} of its a-priori sigmas from where it was thought to be: "
            "look whether file, name and measures belong together."
            for k in np.flatnonzero(~old & (images.in_sigmas > _FAR)).tolist()
        ]
        if not np.any(old):
            return lines
        k = int(np.argmax(np.where(old, self.images.in_sigmas, -1.0)))
        alone, nodes = (int(np.count_nonzero(old & which)) for which in (~images.nodes, images.nodes))
        counts = [*([many(alone, "image")] if alone else []), *([many(nodes, "orientation image")] if nodes else [])]
        return [
            *lines,
            f"{' and '.join(counts)} reached; most moved is {self.images.names[k]}: "
            f"{self.images.in_sigmas[k]:.2g} of its sigmas, {self.images.on_ground[k]:.3g} m on the ground."
        ]

    def _of_points(self) -> list[str]:
        lines, points, moved = list[str](), self.points, ~self.points.new
        if np.any(moved):
            k = int(np.nanargmax(np.where(moved, points.in_sigmas, -1.0)))
            lines.append(
                f"{many(int(np.count_nonzero(moved)), 'point')} moved by more than {NOTICEABLE} of a sigma; most "
                f"of all {points.ids[k]}: {np.linalg.norm(points.moves[k]):.3g} m, {points.in_sigmas[k]:.2g} sigmas."
            )
        if np.any(points.new):
            mean = ", ".join(f"{value:.3g}" for value in np.nanmean(points.sigmas_after[points.new], axis=0))
            lines.append(f"{many(int(np.count_nonzero(points.new)), 'new point')}; mean sigmas x, y, z {mean} m.")
        return lines

    def table(self) -> Table:
        """The images reached, new ones first, then the most moved; for the terminal and for notebooks."""
        images = self.images
        moved = ["new" if new else f"{size:.3f}" for new, size in zip(images.new, images.in_sigmas, strict=True)]

        def column(name: str, values: Array, unit: str, width: int = 9) -> Column:
            return Column(name, values, unit, page=".3g", text=f">{width}.3g", gap=2)

        reached = Table("images", "Images reached", (
            Column("image", images.names, page="s", text=f"<{_NAME}"),
            Column("moved", moved, "sigmas", page="s", text=">8", gap=2),
            column("position", np.linalg.norm(images.moves[:, :3], axis=1), "m"),
            column("pointing", np.linalg.norm(images.moves[:, 3:], axis=1), "arcsec"),
            column("ground", images.on_ground, "m"),
            column("sigma before", np.where(images.new, np.nan, images.ground_before), "m", 13),
            column("after", images.ground_after, "m"),
        ))  # fmt: skip
        return reached.take(np.argsort(-np.where(images.new, np.inf, images.in_sigmas), kind="stable"))

    def points_table(self) -> Table:
        """Every point that moved, or that is new; for the terminal also the root of the trace of the covariances."""
        points, axes = self.points, ("x", "y", "z")
        before, after = (np.linalg.norm(part, axis=1) for part in (points.sigmas_before, points.sigmas_after))
        return Table("impact", "Points that moved", (
            Column("point", points.ids, text=f"<{_NAME}"),
            Column("new", np.asarray(points.new, dtype=np.bool_)),
            Column("move_{}", points.moves, "m", "after minus before, body-fixed", axes, label="moved, m", text=">9.3g",
                   gap=2),
            Column("move_sigmas", points.in_sigmas, label="sigmas", text=">9.3g", gap=2),
            Column("sigma_before_{}", points.sigmas_before, "m", "for sigma0 = 1", axes),
            Column("sigma_{}", points.sigmas_after, "m", "for sigma0 = 1", axes),
            Column("sigma before", before, "m", text=">13.3g", gap=2, files=False),
            Column("after", after, "m", text=">9.3g", gap=2, files=False),
        ))  # fmt: skip

    def tables_text(self) -> list[str]:
        """Lines of aligned text: the images reached, and the points that moved most."""
        points, lines = self.points, self.table().text(SHOWN, "more image: each moved less", units=True)
        order = np.argsort(-np.where(points.new, -1.0, points.in_sigmas), kind="stable")
        moved = order[: int(np.count_nonzero(~points.new))]
        if moved.size:
            lines += self.points_table().take(moved).text(SHOWN, "more point: each moved less", units=True)
        return lines

    def _repr_html_(self) -> str:
        """HTML for notebooks."""
        table = self.table().take(np.arange(min(SHOWN, len(self.images.names))))
        heads = [[name for name, _ in table.headings], [unit for _, unit in table.headings]]
        return card(repr(self), self.sentences, [*heads, *table.rows], head=2)


def impact(
    verb: str,
    subjects: Sequence[str],
    settled: Settled,
    old: Bundles,
    before: Mapping[Unknown, Shared],
    after: Mapping[Unknown, Shared],
) -> Impact:
    """Make the record of a change.

    Parameters
    ----------
    verb, subjects
        What was done with which images.
    settled : Settled
        How the change converged, and where the points are now.
    old : mapping
        The bundles changed and reached, as they were.
    before, after : mapping
        Shared unknowns.
    """
    bundles = settled.bundles
    was, replaced = _as_they_were(old, bundles)
    reached = {unknown for members in settled.reached for unknown in members} | set(after) - set(before)
    moving = sorted(u for u in reached if u.kind in ("image", "node") and u in after)
    now = {name for bundle in bundles.values() for name in bundle.network.points.ids}
    adding = verb == "add"
    neighbours, linked = _neighbours(subjects, bundles)
    return Impact(
        verb,
        tuple(subjects),
        _moved_images(moving, before, after),
        _moved_points(bundles, was),
        neighbours if adding else {},
        tuple(name for name in subjects if name not in linked) if adding else (),
        tuple(name for name in replaced if name not in now),
        _left_undetermined(bundles, was),
        settled.updates,
        settled.systems,
        settled.converged,
    )


def _moved_images(
    unknowns: Sequence[Unknown], before: Mapping[Unknown, Shared], after: Mapping[Unknown, Shared]
) -> MovedImages:
    table = np.array([_moved_image(before.get(u), after[u]) for u in unknowns]).reshape(len(unknowns), 22)
    moves, in_sigmas, first, second, ground = np.split(table, [6, 7, 13, 19], axis=1)
    new = np.array([unknown not in before for unknown in unknowns], dtype=bool)
    nodes = np.array([unknown.kind == "node" for unknown in unknowns], dtype=bool)
    names = tuple(_shown(unknown) for unknown in unknowns)
    shift, was, now = ground.T
    return MovedImages(names, new, moves, in_sigmas[:, 0], first, second, shift, was, now, nodes)


def _shown(unknown: Unknown) -> str:
    """Name of an image; of an orientation image its time to the millisecond, and its pass."""
    of_pass, _, time = unknown.name.rpartition(" at ")
    return f"{float(time.removesuffix(' s')):.3f} s of {of_pass}" if unknown.kind == "node" else unknown.name


def _moved_image(before: Shared | None, after: Shared) -> list[float]:
    """Six moves, their size in sigmas, six sigmas before and after, move on the ground, its sigma before and after."""
    was = before or replace(after, value=np.zeros_like(after.value), covariance=np.diag(after.prior**2))
    step, sigmas = after.value - was.value, was.sigmas
    spread = [float(np.sqrt(np.trace(after.ground @ state.covariance @ after.ground.T))) for state in (was, after)]
    size = float(np.max(np.abs(step) / sigmas))
    return [*step[:6], size, *sigmas[:6], *after.sigmas[:6], float(np.linalg.norm(after.ground @ step)), *spread]


def _as_they_were(
    old: Bundles, bundles: Bundles
) -> tuple[dict[Members, tuple[Array, Array]], list[str]]:
    """Places and sigmas (n, 3) of the points of each bundle before, NaN for those that had none; and the points of the
    bundles that were replaced.
    """
    same = {members for members, part in bundles.items() if members in old and part.network is old[members].network}
    mixed = [part for members, part in old.items() if members not in same]
    row = numbered(name for part in mixed for name in part.network.points.ids)
    undetermined = np.full((1, 3), np.nan)
    places = np.concatenate([*(part.places for part in mixed), undetermined])
    sigmas = np.concatenate([*(part.sigmas for part in mixed), undetermined])
    states = dict[Members, tuple[Array, Array]]()
    for members, bundle in bundles.items():
        if members in same:
            states[members] = old[members].places, old[members].sigmas
        else:
            rows = np.array([row.get(name, -1) for name in bundle.network.points.ids], dtype=np.int64)
            states[members] = places[rows], sigmas[rows]
    return states, list(row)


def _moved_points(bundles: Bundles, was: Mapping[Members, tuple[Array, Array]]) -> MovedPoints:
    """Points that have moved noticeably, and new ones."""
    parts = [_moved_of(bundle, *was[members]) for members, bundle in bundles.items()]
    ids = tuple(name for names, _ in parts for name in names)
    table = np.concatenate([np.zeros((0, 11)), *(values for _, values in parts)])
    return MovedPoints(ids, table[:, 0] > 0.0, table[:, 1:4], table[:, 4], table[:, 5:8], table[:, 8:11])


def _moved_of(bundle: Bundle, places: Array, sigmas: Array) -> tuple[list[str], Array]:
    """Names, and whether new, three moves, their size in sigmas, three sigmas before and after, (n, 11)."""
    moves = bundle.places - places
    with np.errstate(invalid="ignore", divide="ignore"):
        size = np.max(np.abs(moves) / sigmas, axis=1)
    new = np.isnan(places[:, 0]) & np.isfinite(bundle.places[:, 0])
    chosen = np.flatnonzero(new | (size > NOTICEABLE))
    table = np.column_stack([new, moves, size, sigmas, bundle.sigmas])
    return bundle.network.points.ids[chosen].tolist(), table[chosen]


def _left_undetermined(
    bundles: Bundles, was: Mapping[Members, tuple[Array, Array]]
) -> tuple[str, ...]:
    """Points that had a place and have none now."""
    missing_now = list[str]()
    for members, bundle in bundles.items():
        missing = np.isnan(bundle.places[:, 0])
        if np.any(missing):
            missing_now += bundle.network.points.ids[missing & np.isfinite(was[members][0][:, 0])].tolist()
    return tuple(missing_now)


def _neighbours(subjects: Sequence[str], bundles: Bundles) -> tuple[dict[str, int], set[str]]:
    """Images that share determined points with some others, and how many; and all images that share such points."""
    shared, linked, names = dict[str, int](), set[str](), set(subjects)
    for bundle in bundles.values():
        network = bundle.network
        number = numbered(network.image_names)
        visible = np.zeros((len(number), len(network.points)), dtype=bool)
        visible[network.rays.image, network.rays.point] = True
        visible &= np.isfinite(bundle.places[:, 0])
        several = visible.sum(axis=0) > 1
        with_own = np.any(visible[[number[name] for name in names if name in number]], axis=0)
        for name, j in number.items():
            if np.any(visible[j] & several):
                linked.add(name)
            if name not in names and (count := int(np.count_nonzero(visible[j] & with_own))):
                shared[name] = shared.get(name, 0) + count
    return shared, linked


if TYPE_CHECKING:
    from mgsgraph.adjustment.solution import Solution

CLOSE = 1e-2
"""Sigmas within which incremental and batch results count as the same."""
EXACT = 1e-4
"""Sigmas beyond which the check against batch takes over what batch has found."""


@dataclass(frozen=True, slots=True, eq=False)
class BatchCheck(Record):
    """Largest differences between the incremental result and batch, in sigmas of batch."""

    unknown: Unknown
    """Unknown with the largest difference."""
    orientation: float
    """Largest difference of a coefficient or shift, in its sigma."""
    point: str
    """Point with the largest difference."""
    points: float
    """Largest difference of a coordinate, in its sigma."""
    adopted: bool
    """Whether batch's result is to be taken over: it converged, and something is farther off than `EXACT`."""
    converged: bool
    """Whether batch converged; else the comparison says nothing."""

    @property
    def worst(self) -> float:
        """Largest difference of all, in sigmas; infinite where one of the two has a place and the other has none."""
        return max(self.orientation, self.points)

    @property
    def close(self) -> bool:
        """Whether all differences are within `CLOSE`."""
        return self.worst <= CLOSE

    @property
    def sentence(self) -> str:
        """The result in one sentence."""
        if not self.converged:
            return "Check against batch: batch did not converge; the incremental result was kept."
        verdict = "the same" if self.close else f"farther apart than {CLOSE:g} sigmas"
        outcome = "batch's result was taken over" if self.adopted else "the incremental result was kept"
        return (
            f"Check against batch: {verdict}; largest difference {self.orientation:.2g} sigmas for the "
            f"{self.unknown}, {self.points:.2g} sigmas for point {self.point}; {outcome}."
        )


def differences_from_batch(solution: "Solution", values: ByUnknown, places: Array) -> BatchCheck:
    """Compare values of the unknowns and places (n, 3) of the points with a batch solution of the same network."""
    worst, key = 0.0, next(iter(values), Unknown("image", "-"))
    for unknown, batch in shared_of(solution).items():
        off = float(np.max(np.abs(values[unknown] - batch.value) / batch.sigmas))
        if off > worst:
            worst, key = off, unknown
    k, off = _farthest(solution, places)
    converged = solution.converged
    return BatchCheck(key, worst, solution.network.points.ids[k], off, converged and max(worst, off) > EXACT, converged)


def _farthest(solution: "Solution", places: Array) -> tuple[int, float]:
    """The point that lies farthest off, and its largest difference of a coordinate in its sigma."""
    placed = np.isfinite(places[:, 0])
    with np.errstate(invalid="ignore", divide="ignore"):
        off = np.max(np.abs(places - solution.places) / solution.sigmas, axis=1)
    off[~placed & ~solution.determined] = 0.0
    off[placed != solution.determined] = np.inf
    off[placed & solution.determined & np.isnan(off)] = 0.0  # a fixed point has no sigma, and stays where it is
    k = int(np.argmax(off))
    return k, float(off[k])

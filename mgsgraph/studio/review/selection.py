"""Tie points as a person reviews them: which ones are looked at, their chips, and what tells a wrong match."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from mgsgraph.adjustment.solution import Solution
from mgsgraph.case.reading import Case
from mgsgraph.errors import InputError
from mgsgraph.files.rasters.pictures import read_picture
from mgsgraph.files.tie_points import TiePoints
from mgsgraph.geometry.image import PushbroomImage
from mgsgraph.geometry.records import Array, Index, Mask
from mgsgraph.matching.chips import (
    SIDE,
    Likeness,
    Pictures,
    chip_frames,
    chips,
    likeness,
    misfit_beside_neighbours,
    stretched,
)
from mgsgraph.matching.scene import Pixels
from mgsgraph.studio.review.verdicts import Verdicts, network_digest, require_verdicts_of
from mgsgraph.text import listed, many, some
from mgsgraph.workers import Count, no_progress

WORST = 300
"""Points that are shown unless another number is asked for."""
_SAME_MEASURE = 1e-6
"""pixels, within which a measure of a solution is the network's."""
_LEVELS = 64
"""Grey values of a chip on the page: its picture is a third smaller than with 256, and no eye sees the difference."""
_AT_ONCE = 256
"""Chips that are resampled at a time."""
_KEPT = 8
"""Images whose pixels are kept in memory."""


@dataclass(frozen=True, slots=True, eq=False)
class MatchReview:
    """Tie points to be reviewed, and what tells whether they are right."""

    name: str
    """What the case is called."""
    digest: str
    """`network_digest` of the whole network, of which these may be a part."""
    choice: str
    """How many of how many there are here, and how they were chosen."""
    ties: TiePoints
    """n points with k measures; the first one of each point is its reference."""
    spacing: Array
    """(n,) m, size of a chip pixel."""
    skew: Array
    """(n,) m, rms distance of the rays, nominal orientation, from the position nearest to them; NaN for one ray."""
    oddness: Array
    """(n,) chip pixels, `misfit_beside_neighbours`."""
    step: Array
    """(k, 2, 2) d(line, sample) / d(row, column) of the chips."""
    alike: Likeness
    """Chips against those of the reference measures."""
    residuals: Array
    """(k, 2) pixels, line and sample, after the adjustment; NaN without a solution, and of undetermined points."""
    rejected: Mask
    """(k,) True for measures that the adjustment rejected as blunders."""
    chips: NDArray[np.uint8]
    """(k, SIDE, SIDE) contrast-stretched patches around the measures."""

    @property
    def correlations(self) -> Array:
        """(n,) the lowest of each point; NaN where it has none."""
        return -_largest(self.ties, -self.alike.correlation)

    @property
    def offsets(self) -> Array:
        """(n,) chip pixels, the longest way from a measure to where it would be most alike; NaN where none is known."""
        return _largest(self.ties, np.hypot(*self.alike.shift.T))

    @property
    def sigmas(self) -> Array:
        """(n,) pixels, the largest stated sigma of each point's measures; NaN where none is stated."""
        return _largest(self.ties, np.fmax(*self.ties.measure_sigmas.T))

    @property
    def largest_residuals(self) -> Array:
        """(n,) pixels, the longest residual of each point; NaN where there is none."""
        return _largest(self.ties, np.hypot(*self.residuals.T))

    @property
    def misfits(self) -> Array:
        """(n,) chip pixels, of the rays: by how much it differs from the neighbours', or itself where there are few."""
        return np.where(np.isfinite(self.oddness), np.abs(self.oddness), self.skew / self.spacing)

    def __repr__(self) -> str:
        return f"MatchReview({self.name!r}: {self.choice})"


def _largest(ties: TiePoints, values: Array) -> Array:
    """(n,) the largest value (k,) of each point's measures; NaN where none has one."""
    found = np.full(len(ties.ids), np.nan)
    np.fmax.at(found, ties.measure_point, values)
    return found


# --- what is to be reviewed


def case_pictures(case: Case, ties: TiePoints) -> Pictures:
    """Pixels of a case's images by number, read when asked for; InputError where one with measures has none."""
    measured = set(ties.measure_image)
    for image, path in zip(case.network.images, case.pictures, strict=True):
        if image.name in measured and path is None:
            raise InputError(
                f"{case.path}, image {image.name}", "no file of its pixels", "pixels of every image with tie points",
                "name it in the case (pixels = ...), or review a network without this image",
            )

    @lru_cache(_KEPT)
    def read(number: int) -> Pixels:
        path, image = case.pictures[number], case.network.images[number]
        assert path is not None
        return _of_its_image(read_picture(path), image, str(path))

    return read


def _of_its_image(pixels: Pixels, image: PushbroomImage, where: str) -> Pixels:
    if pixels.shape != (image.lines, image.samples):
        expected = f"{(image.lines, image.samples)}, as image {image.name} has"
        raise InputError(where, f"pixels of shape {pixels.shape}", expected)
    return pixels


def review_case(
    case: Case,
    solution: Solution | None = None,
    *,
    worst: int = WORST,
    points: Sequence[str] = (),
    verdicts: Verdicts | None = None,
    progress: Count = no_progress,
) -> MatchReview:
    """Look at the tie points of a case; see `review_matches`.

    Raises
    ------
    InputError
        Without tie points, or with those of several networks; for an image with tie points and without pixels; when
        `verdicts` are about other points; and as `review_matches`.
    """
    ties = case.ties
    if ties is None:
        raise InputError(str(case.path), "no network of tie points", "one to review", "name one by --ties")
    if verdicts is not None:
        require_verdicts_of(ties, verdicts)
    pictures = case_pictures(case, ties)
    return review_matches(
        case.network.images, ties, pictures, solution, worst=worst, points=points, name=case.name, progress=progress
    )


def review_matches(
    images: Sequence[PushbroomImage],
    ties: TiePoints,
    pictures: Pictures,
    solution: Solution | None = None,
    *,
    worst: int = WORST,
    points: Sequence[str] = (),
    name: str = "",
    progress: Count = no_progress,
) -> MatchReview:
    """Look at tie points, and choose those that a person should look at.

    Parameters
    ----------
    images : sequence of PushbroomImage
        With their nominal orientation.
    ties : TiePoints
        Matched by a program or measured by hand; the first measure of each point is the one that the others are
        compared with.
    pictures : callable
        Pixels (lines, samples) of an image by its number.
    solution : Solution, optional
        An adjustment of these points: its residuals are shown, too.
    worst : int
        How many points to choose: in turn the next one by correlation (lowest first; none at all comes before), by
        misfit of the rays, by how far off the best correlation lies, and by residual.
    points : sequence of str
        Ids of those that are wanted in place of the worst.
    name : str
        What to call it all.
    progress : callable
        Called with the number of measures compared, and of all.

    Raises
    ------
    InputError
        Without points, for an id that isn't there, for a measure outside its image, when the solution is that of other
        measures.
    """
    if not len(ties.ids):
        raise InputError(ties.source, "no tie point", "at least one")
    wanted = _by_name(ties, points) if points else np.arange(len(ties.ids))
    frames = chip_frames(images, ties)
    oddness = misfit_beside_neighbours(frames, ties)
    residuals, rejected = _residuals(ties, solution)
    alike = likeness(pictures, ties, frames, wanted, progress)

    def some_of(which: Index) -> MatchReview:
        rows, mine = np.flatnonzero(np.isin(ties.measure_point, which)), ties.chosen(which)
        patches = _patches(pictures, frames.image[rows], mine.measures, frames.step[rows])
        return MatchReview(
            name, network_digest(ties), _choice(ties, which, bool(points), solution is not None), mine,
            frames.spacing[which], frames.skew[which], oddness[which], frames.step[rows], alike.chosen(rows),
            residuals[rows], rejected[rows], patches,
        )  # fmt: skip

    if points or worst >= len(ties.ids):
        return some_of(wanted)
    correlation = -_largest(ties, -alike.correlation)
    misfit = np.where(np.isfinite(oddness), np.abs(oddness), frames.skew_pixels)
    unlike = np.where(np.isnan(correlation), np.inf, -correlation)
    badness = [unlike, misfit, *(_largest(ties, np.hypot(*way.T)) for way in (alike.shift, residuals))]
    return some_of(_worst(badness, worst))


def _by_name(ties: TiePoints, names: Sequence[str]) -> Index:
    """(m,) numbers of points, in the network's order."""
    unknown = sorted(set(names) - set(ties.ids))
    if unknown:
        raise InputError(ties.source, f"no point {some(unknown, len(unknown))}", "ids of points of this network")
    return np.flatnonzero(np.isin(np.array(ties.ids, dtype=object), names))


def _worst(badness: Sequence[Array], most: int) -> Index:
    """(m,) the worst points in the network's order: in turn the next one by each kind of badness (n,), NaN being none
    that is known.
    """
    orders = [np.argsort(np.where(np.isnan(bad), np.inf, -bad), kind="stable") for bad in badness]
    orders = [order[: int(np.sum(~np.isnan(bad)))] for order, bad in zip(orders, badness, strict=True)]
    turn = np.concatenate([len(orders) * np.arange(order.size) + k for k, order in enumerate(orders)])
    points = np.concatenate(orders)[np.argsort(turn)]
    first = np.unique(points, return_index=True)[1]
    return np.sort(points[np.sort(first)[:most]])


def _choice(ties: TiePoints, which: Index, by_name: bool, solved: bool) -> str:
    total = len(ties.ids)
    if by_name:
        return f"{which.size} of {many(total, 'tie point')}, as asked for"
    if which.size == total:
        return f"{which.size} of {many(total, 'tie point')}: all of them"
    kinds = ["lowest correlation", "largest misfit of the rays", "furthest better match"]
    kinds += ["largest residual"] if solved else []
    return f"{which.size} of {many(total, 'tie point')}: in turn the next by {listed(kinds)}"


def _residuals(ties: TiePoints, solution: Solution | None) -> tuple[Array, Mask]:
    """Residuals (k, 2) in pixels of the measures in a solution, and (k,) which of them it rejected."""
    k = ties.measure_point.size
    if solution is None:
        return np.full((k, 2), np.nan), np.zeros(k, dtype=np.bool_)
    rays, ids = solution.network.rays, solution.network.points.ids
    names = [image.name for image in solution.network.images]
    theirs = zip((ids[i] for i in rays.point.tolist()), (names[j] for j in rays.image.tolist()), strict=True)
    rows = {one: r for r, one in enumerate(theirs)}
    mine = zip((ties.ids[i] for i in ties.measure_point.tolist()), ties.measure_image, strict=True)
    found = np.array([rows.get(one, -1) for one in mine], dtype=np.int64)
    moved = np.any(np.abs(rays.places[found] - ties.measures) > _SAME_MEASURE, axis=1)
    for r in np.flatnonzero((found < 0) | moved)[:1]:
        which = f"point {ties.ids[int(ties.measure_point[r])]}, image {ties.measure_image[r]}"
        state = "no such measure" if found[r] < 0 else "measured at another place"
        expected, remedy = f"the measures of {ties.source}", "adjust these, or leave the solution out"
        raise InputError(f"solution {solution.name!r}, {which}", state, expected, remedy)
    rejected = solution.rays_rejected
    return solution.residuals[found], np.zeros(k, dtype=np.bool_) if rejected is None else rejected[found]


def _patches(pictures: Pictures, image: Index, measures: Array, step: Array) -> NDArray[np.uint8]:
    """(k, SIDE, SIDE) contrast-stretched patches around measures, each image's at a time."""
    found = np.empty((image.size, SIDE, SIDE), dtype=np.uint8)
    for j in np.unique(image):
        mine = np.flatnonzero(image == j)
        for some_of_them in np.split(mine, range(_AT_ONCE, mine.size, _AT_ONCE)):
            patches = chips(pictures(int(j)), measures[some_of_them], step[some_of_them])
            found[some_of_them] = stretched(patches, _LEVELS)
    return found

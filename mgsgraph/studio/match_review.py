"""Review of tie points: which points are shown, their chips, and the figures that reveal a wrong match."""

import base64
import io
import zlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mgsgraph.adjustment.solution import Solution
from mgsgraph.case.reading import Case
from mgsgraph.errors import InputError
from mgsgraph.files.networks.tie_points import PointKind, TiePoints
from mgsgraph.files.rasters.pictures import read_picture
from mgsgraph.files.writing import page_of, require_free, write_page
from mgsgraph.geometry.image import PushbroomImage
from mgsgraph.geometry.records import Array, Index, Mask
from mgsgraph.matching.chips import (
    REACH,
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
from mgsgraph.record import Record
from mgsgraph.studio.verdicts import Verdict, Verdicts, network_digest, require_verdicts_of
from mgsgraph.text import listed, many, some
from mgsgraph.units import ISIS_OFFSET
from mgsgraph.workers import Count, no_progress

WORST = 300
"""Default number of points that are shown."""
_SAME_MEASURE = 1e-6
"""pixels, tolerance of the same measure in a solution and in the network."""
_LEVELS = 64
"""Grey values of a chip on the page: its picture is a third smaller than with 256, and no eye sees the difference."""
_AT_ONCE = 256
"""Chips that are resampled at a time."""
_KEPT = 8
"""Images whose pixels are kept in memory."""


@dataclass(frozen=True, slots=True, eq=False)
class MatchReview(Record):
    """Tie points to review, with figures of their quality."""

    name: str
    """Name of the case."""
    digest: str
    """`network_digest` of the whole network; these points may be a part of it."""
    choice: str
    """How many points of how many are shown, and how they were chosen."""
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
    comparison: Likeness
    """Chips against those of the reference measures."""
    residuals: Array
    """(k, 2) pixels, line and sample, after the adjustment; NaN without a solution, and of undetermined points."""
    rejected: Mask
    """(k,) True for measures that the adjustment rejected as blunders."""
    figures: Mapping[str, Array]
    """(n,) by the keys of `_ORDERS`: how bad each point is; NaN where unknown."""
    chips: NDArray[np.uint8]
    """(k, SIDE, SIDE) contrast-stretched patches around the measures."""


def _largest(ties: TiePoints, values: Array) -> Array:
    """(n,) the largest value (k,) of each point's measures; NaN where none has one."""
    largest = np.full(len(ties.ids), np.nan)
    np.fmax.at(largest, ties.measure_point, values)
    return largest


# --- choice of points


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
        return _require_size(read_picture(path), image, str(path))

    return read


def _require_size(pixels: Pixels, image: PushbroomImage, where: str) -> Pixels:
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
    """Review the tie points of a case; see `review_matches`.

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
    """Compare the chips of tie points, and choose the points to review.

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
        Ids of points to review in place of the worst.
    name : str
        Name of the review.
    progress : callable
        Called with the number of measures compared, and of all.

    Raises
    ------
    InputError
        Without points, for an id that isn't there, for a measure outside its image, when the solution is that of other
        measures.

    Examples
    --------
    >>> noise = np.random.default_rng(0).integers(0, 256, (2, 5000, 1024), dtype=np.uint8)  # in place of pixels
    >>> review = mgsgraph.review_matches(pair.images, pair.ties, lambda number: noise[number], worst=5)
    >>> review.choice.split(":")[0]
    '5 of 20 tie points'
    """
    if not len(ties.ids):
        raise InputError(ties.source, "no tie point", "at least one")
    numbers = _by_name(ties, points) if points else np.arange(len(ties.ids))
    frames = chip_frames(images, ties)
    oddness = misfit_beside_neighbours(frames, ties)
    residuals, rejected = _residuals(ties, solution)
    comparison = likeness(pictures, ties, frames, numbers, progress)
    figures = {
        "correlation": -_largest(ties, -comparison.correlation),
        "misfit": np.where(np.isfinite(oddness), np.abs(oddness), frames.skew_pixels),
        "offset": _largest(ties, np.hypot(*comparison.shift.T)),
        "residual": _largest(ties, np.hypot(*residuals.T)),
        "sigma": _largest(ties, np.fmax(*ties.measure_sigmas.T)),
    }

    def review_of(chosen: Index) -> MatchReview:
        rows, chosen_ties = np.flatnonzero(np.isin(ties.measure_point, chosen)), ties.chosen(chosen)
        patches = _patches(pictures, frames.image[rows], chosen_ties.measures, frames.step[rows])
        return MatchReview(
            name, network_digest(ties), _choice(ties, chosen, bool(points), solution is not None), chosen_ties,
            frames.spacing[chosen], frames.skew[chosen], oddness[chosen], frames.step[rows], comparison.chosen(rows),
            residuals[rows], rejected[rows], {key: values[chosen] for key, values in figures.items()}, patches,
        )  # fmt: skip

    if points or worst >= len(ties.ids):
        return review_of(numbers)
    unlike = np.where(np.isnan(figures["correlation"]), np.inf, -figures["correlation"])
    return review_of(_worst([unlike, *(figures[key] for key in ("misfit", "offset", "residual"))], worst))


def _by_name(ties: TiePoints, names: Sequence[str]) -> Index:
    """(m,) numbers of points, in the network's order."""
    unknown = sorted(set(names) - set(ties.ids))
    if unknown:
        raise InputError(ties.source, f"no point {some(unknown, len(unknown))}", "ids of points of this network")
    return np.flatnonzero(np.isin(np.array(ties.ids, dtype=object), names))


def _worst(badness: Sequence[Array], most: int) -> Index:
    """(m,) the worst points in the network's order: in turn the next one by each kind of badness (n,), NaN where
    unknown.
    """
    orders = [np.argsort(np.where(np.isnan(values), np.inf, -values), kind="stable") for values in badness]
    orders = [order[: int(np.sum(~np.isnan(values)))] for order, values in zip(orders, badness, strict=True)]
    turn = np.concatenate([len(orders) * np.arange(order.size) + k for k, order in enumerate(orders)])
    points = np.concatenate(orders)[np.argsort(turn)]
    firsts = np.unique(points, return_index=True)[1]
    return np.sort(points[np.sort(firsts)[:most]])


def _choice(ties: TiePoints, chosen: Index, by_name: bool, solved: bool) -> str:
    total = len(ties.ids)
    if by_name:
        return f"{chosen.size} of {many(total, 'tie point')}, as asked for"
    if chosen.size == total:
        return f"{chosen.size} of {many(total, 'tie point')}: all of them"
    kinds = ["lowest correlation", "largest misfit of the rays", "furthest better match"]
    kinds += ["largest residual"] if solved else []
    return f"{chosen.size} of {many(total, 'tie point')}: in turn the next by {listed(kinds)}"


def _residuals(ties: TiePoints, solution: Solution | None) -> tuple[Array, Mask]:
    """Residuals (k, 2) in pixels of the measures in a solution, and (k,) which of them it rejected."""
    count = ties.measure_point.size
    if solution is None:
        return np.full((count, 2), np.nan), np.zeros(count, dtype=np.bool_)
    rays, ids = solution.network.rays, solution.network.points.ids
    names = [image.name for image in solution.network.images]
    solved = zip((ids[i] for i in rays.point.tolist()), (names[j] for j in rays.image.tolist()), strict=True)
    row_of = {measure: row for row, measure in enumerate(solved)}
    reviewed = zip((ties.ids[i] for i in ties.measure_point.tolist()), ties.measure_image, strict=True)
    rows = np.array([row_of.get(measure, -1) for measure in reviewed], dtype=np.int64)
    moved = np.any(np.abs(rays.places[rows] - ties.measures) > _SAME_MEASURE, axis=1)
    for row in np.flatnonzero((rows < 0) | moved)[:1]:
        label = f"point {ties.ids[int(ties.measure_point[row])]}, image {ties.measure_image[row]}"
        state = "no such measure" if rows[row] < 0 else "measured at another place"
        expected, remedy = f"the measures of {ties.source}", "adjust these, or leave the solution out"
        raise InputError(f"solution {solution.name!r}, {label}", state, expected, remedy)
    rejected = solution.rays_rejected
    return solution.residuals[rows], np.zeros(count, dtype=np.bool_) if rejected is None else rejected[rows]


def _patches(pictures: Pictures, image: Index, measures: Array, step: Array) -> NDArray[np.uint8]:
    """(k, SIDE, SIDE) contrast-stretched patches around measures, each image's at a time."""
    patches = np.empty((image.size, SIDE, SIDE), dtype=np.uint8)
    for j in np.unique(image):
        of_image = np.flatnonzero(image == j)
        for batch in np.split(of_image, range(_AT_ONCE, of_image.size, _AT_ONCE)):
            grey = chips(pictures(int(j)), measures[batch], step[batch])
            patches[batch] = stretched(grey, _LEVELS)
    return patches



_MARKED = 0.75
"""Chip pixels, shift from which on the best match is marked."""
_ORDERS = {
    "correlation": ("correlation, lowest first", 1.0), "misfit": ("misfit of rays, largest first", -1.0),
    "offset": ("better match, furthest first", -1.0), "residual": ("residual, largest first", -1.0),
    "sigma": ("sigma, largest first", -1.0),
}  # fmt: skip
"""Figures of points by which they may be shown, and whether the lowest comes first."""
_TEMPLATE = "studio/templates/review.html"


def require_page(path: Path) -> None:
    """Raise InputError unless a review may be written there: nothing is there, or an earlier one."""
    require_free(path, page_of(_TEMPLATE), remedy="choose another --out")


def write_review(review: MatchReview, path: Path, verdicts: Verdicts | None = None) -> None:
    """Write the page to an HTML file; an earlier review is replaced.

    Parameters
    ----------
    review : MatchReview
        Of `review_matches`.
    path : Path
        The file.
    verdicts : Verdicts, optional
        Initial verdicts of the page; it also saves those of points that it doesn't show.

    Raises
    ------
    InputError
        If it can't be written.

    Examples
    --------
    >>> noise = np.random.default_rng(0).integers(0, 256, (2, 5000, 1024), dtype=np.uint8)  # in place of pixels
    >>> review = mgsgraph.review_matches(pair.images, pair.ties, lambda number: noise[number], worst=5)
    >>> mgsgraph.write_review(review, Path("review.html"))
    >>> Path("review.html").exists()
    True
    """
    by_point = {} if verdicts is None else verdicts.of
    notes = {} if verdicts is None else verdicts.notes
    shown = set(review.ties.ids)
    write_page(_TEMPLATE, {
        "review": review,
        "store": _store(review, verdicts),
        "points": _points(review, by_point, notes),
        "others": [(point, by_point[point].value, notes.get(point, "")) for point in by_point if point not in shown],
        "sorts": [order[:2] for order in _orders(review)],
        "side": SIDE,
        "reach": REACH,
    }, path)  # fmt: skip


def _store(review: MatchReview, verdicts: Verdicts | None) -> str:
    """Key under which a browser stores verdicts: another one for other initial verdicts, so that these count."""
    if verdicts is None:
        return review.digest
    initial = repr((sorted(verdicts.of.items()), sorted(verdicts.notes.items())))
    return f"{review.digest} {zlib.crc32(initial.encode()):08x}"


def _orders(review: MatchReview) -> list[tuple[str, str, Array]]:
    """Key and name of each order in which points may be shown, and numbers (n,), the lowest of which comes first."""
    orders = [(key, title, sign * review.figures[key]) for key, (title, sign) in _ORDERS.items()]
    return [order for order in orders if np.any(np.isfinite(order[2]))]


def _points(review: MatchReview, of: Mapping[str, Verdict], notes: Mapping[str, str]) -> Iterator[dict[str, Any]]:
    """Record of each point for the page, one at a time: pictures of thousands need much memory."""
    ties = review.ties
    order = np.argsort(ties.measure_point, kind="stable")
    rows = np.split(order, np.cumsum(np.bincount(ties.measure_point, minlength=len(ties.ids)))[:-1])
    orders, correlations = _orders(review), review.figures["correlation"]
    for i, name in enumerate(ties.ids):
        yield {
            "id": name,
            "kind": PointKind(ties.kinds[i]).name.lower(),
            "verdict": of.get(name, Verdict.UNDECIDED).value,
            "note": notes.get(name, ""),
            "sorts": {key: float(values[i]) for key, _, values in orders if np.isfinite(values[i])},
            "facts": _facts(review, i, float(correlations[i])),
            "measures": [_measure(review, k, is_reference=k == rows[i][0]) for k in rows[i].tolist()],
        }


def _facts(review: MatchReview, i: int, correlation: float) -> list[tuple[str, str]]:
    """Figures of a point, as text."""
    skew, spacing, odd = review.skew[i], review.spacing[i], review.oddness[i]
    misfit = f"{skew:.3g} m = {skew / spacing:.2f} px" if np.isfinite(skew) else "none: one ray"
    return [
        ("correlation", f"{correlation:.3f}" if np.isfinite(correlation) else "none"),
        ("misfit of rays", misfit),
        *([("beside neighbours", f"{odd:+.2f} px")] if np.isfinite(odd) else []),
        ("chip pixel", f"{spacing:.3g} m" if np.isfinite(spacing) else "unknown"),
    ]


def _measure(review: MatchReview, k: int, is_reference: bool) -> dict[str, Any]:
    """Record of a measure for the page: `rows` are figures of line and sample."""
    ties, comparison, residual = review.ties, review.comparison, review.residuals[k]
    line, sample = ties.measures[k].tolist()
    rows = [
        ("ISIS", f"{line + ISIS_OFFSET:.2f}", f"{sample + ISIS_OFFSET:.2f}"),
        ("ours", f"{line:.2f}", f"{sample:.2f}"),
        ("sigma", *(f"{value:.2f}" if np.isfinite(value) else "none" for value in ties.measure_sigmas[k])),
    ]
    if np.all(np.isfinite(residual)):
        rows.append(("residual", f"{residual[0]:+.2f}", f"{residual[1]:+.2f}"))
    shift = comparison.shift[k]
    compared = bool(np.isfinite(shift[0]))
    if compared:
        offset = review.step[k] @ shift
        rows.append(("best at", f"{offset[0]:+.2f}", f"{offset[1]:+.2f}"))
    return {
        "image": ties.measure_image[k],
        "png": base64.b64encode(png(review.chips[k])).decode() if np.isfinite(review.step[k, 0, 0]) else "",
        "rows": rows,
        "remark": _remark(review, k, is_reference),
        "ring": (0.5 * SIDE + shift[1], 0.5 * SIDE + shift[0]) if compared and np.hypot(*shift) > _MARKED else None,
    }


def _remark(review: MatchReview, k: int, is_reference: bool) -> str:
    comparison = review.comparison
    blunder = "; rejected by the adjustment" if review.rejected[k] else ""
    if is_reference:
        return f"reference{blunder}"
    if not np.isfinite(comparison.correlation[k]):
        elsewhere = f"; {comparison.best[k]:.3f} elsewhere" if np.isfinite(comparison.best[k]) else ""
        return f"no correlation{elsewhere}{blunder}"
    edge = f", or further than {REACH} px" if comparison.at_edge[k] else ""
    return f"correlation {comparison.correlation[k]:.3f}, best {comparison.best[k]:.3f}{edge}{blunder}"


def png(grey: NDArray[np.uint8]) -> bytes:
    """An 8-bit grey picture (rows, columns) as PNG."""
    from PIL import Image  # takes 0.1 s

    file = io.BytesIO()
    Image.fromarray(grey).save(file, "PNG", optimize=True)
    return file.getvalue()

"""Matching of a scene's images, from nominal orientations to tie points with a covariance for every match, and the
count of what was lost on the way.
"""

import os
import zlib
from collections.abc import Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from mgsgraph.errors import InputError
from mgsgraph.files.networks.tie_points import PointKind, TiePoints
from mgsgraph.geometry.records import Array, Index, Mask, all_pairs, assign, frozen, no_rows, place_of, sigmas_of
from mgsgraph.matching.checks import cell_numbers, checked_measures, pair_signs, spread
from mgsgraph.matching.coarse import Agreement, Aligned, aligned_pictures, window
from mgsgraph.matching.least_squares import MatchStatus
from mgsgraph.matching.measuring import Measured, SharpPictures, joined_measures, measured
from mgsgraph.matching.patches import (
    Links,
    Tile,
    Window,
    concatenated,
    features_on,
    links_on,
    opencv,
    tiling,
)
from mgsgraph.matching.scene import Pair, Scene, boxes, joined, pairs_of, require_unblocked
from mgsgraph.matching.settings import MatchSettings
from mgsgraph.names import Names, RepeatedNames, grouped
from mgsgraph.record import Record
from mgsgraph.text import listed
from mgsgraph.workers import Progress, no_progress

SOURCE = "matches"
"""What messages call them."""


class Losses(NamedTuple):
    """Matches after each step."""

    linked: int
    """Pairs of features that chose each other."""
    tried: int
    """Of these, the surest in each cell."""
    measured: int
    """Places by least-squares matching that converged."""
    similar: int
    """Of these, with enough correlation and a small enough sigma."""
    returned: int
    """Of these, whose way back ended where it began."""
    coplanar: int
    """Of these, whose rays meet."""
    steady: int
    """Of these, with heights like their neighbours'."""
    kept: int
    """Of these, the best of each cell."""


@dataclass(frozen=True, slots=True, eq=False)
class Matches(Record):
    """Tie points from images.

    Examples
    --------
    >>> print(matches)
    Matches(58 points in 24 of 24 cells)
    >>> float(np.median(matches.ties.measure_sigmas[~matches.reference]).round(2))
    0.05
    """

    ties: TiePoints
    """Free points; of each, the first measure is the reference, a pixel's centre. Sigmas: half of each match's variance
    is the reference's, half the other's, since both pictures' noise is in it (so measures are independent)."""
    covariances: Array
    """(k, 2, 2) pixels^2, of each measure given its point's reference (zero for the reference itself)."""
    correlation: Array
    """(k,) of the two windows; NaN for a reference."""
    misfit: Array
    """(k,) m on the ground, coplanarity residual with the reference under the orientation's freedom; NaN for a
    reference."""
    agreements: tuple[Agreement, ...]
    """How the pictures joined."""
    refused: tuple[str, ...]
    """Why pairs that share ground by their nominal orientations were not aligned."""
    losses: Losses
    """What was lost on the way."""
    step: float
    """m, pixel of the ground grid."""
    cell: float
    """m, side of a cell."""
    cells: tuple[int, int]
    """Cells of shared ground with a match, and all of them."""
    cautions: tuple[str, ...] = ()
    """What speaks against pictures or pairs without refusing them, in sentences."""

    def __post_init__(self) -> None:
        k = len(self.ties.measure_image)
        assign(self, covariances=frozen(self.covariances, f"{SOURCE}, covariances", (k, 2, 2)))

    @property
    def reference(self) -> Mask:
        """(k,) which measures are their point's reference."""
        return np.asarray(np.isnan(self.correlation))

    def __repr__(self) -> str:
        filled, whole = self.cells
        return f"Matches({len(self.ties.ids)} points in {filled} of {whole} cells)"


def _ids(names: tuple[str, ...], pixels: Array, count: int) -> Names:
    """Names of points that differ from those of other runs, which may be in the same case."""
    run = zlib.crc32("\n".join(names).encode() + pixels.tobytes())
    return Names.of(f"M{run:08x}_{i + 1:06d}" for i in range(count))


def matches_of(
    measures: Measured, misfit: Array, names: tuple[str, ...], order: Index
) -> tuple[TiePoints, Array, Array, Array]:
    """Tie points, covariances, correlations and misfits of finished measures, which are sorted by track.

    `misfit` (k,) is in m, `names` are those of the pictures; `order` (n,) has the tracks, by their positions among the
    distinct ones, in the order in which points are numbered.
    """
    tracks, begin, inverse = np.unique(measures.track, return_index=True, return_inverse=True)
    rank = place_of(order, tracks.size)
    back = np.linalg.inv(measures.affine)
    shared = 0.5 * back @ measures.covariances @ back.mT
    count = np.bincount(inverse, minlength=tracks.size)
    of_anchor = np.zeros((tracks.size, 2, 2))
    np.add.at(of_anchor, inverse, shared)
    of_anchor /= count[:, None, None]
    point = np.concatenate([rank, rank[inverse]])
    pixels = np.concatenate([measures.anchors[begin], measures.pixels])
    picture = np.concatenate([measures.first[begin], measures.other])
    variances = np.concatenate([of_anchor, 0.5 * measures.covariances])
    first = np.concatenate([np.zeros(tracks.size, dtype=np.int64), np.ones(inverse.size, dtype=np.int64)])
    rows = np.lexsort([picture, first, point])
    nothing = np.full(tracks.size, np.nan)
    n = tracks.size
    ties = TiePoints(
        source=SOURCE,
        ids=_ids(names, pixels[rows], n),
        kinds=np.full(n, PointKind.FREE, dtype=np.int64),
        places=np.full((n, 3), np.nan),
        covariances=np.zeros((n, 3, 3)),
        measure_point=point[rows],
        measure_image=RepeatedNames(tuple(names), picture[rows]),
        measures=pixels[rows],
        measure_sigmas=sigmas_of(variances)[rows],
    )
    covariances = np.concatenate([np.zeros((n, 2, 2)), measures.covariances])[rows]
    correlation = np.concatenate([nothing, measures.correlation])[rows]
    return ties, covariances, correlation, np.concatenate([nothing, misfit])[rows]



_MARGIN = 64
"""pixels of the ground grid that tiles share with their neighbours."""
_SLACK = 6.0
"""pixels of the ground grid within which a counterpart lies once the orientations agree, height apart."""
_LEAST_CELL = 4.0
"""pixels of the ground grid, side of a cell."""
_FINER = 2.0
"""How much smaller a pixel's area has to be to count as finer."""
_TRIED = 4
"""How many times more matches are measured in each cell than are kept."""


def match_scene(
    scene: Scene,
    settings: MatchSettings | None = None,
    workers: int | None = None,
    progress: Progress = no_progress,
) -> Matches:
    """Find tie points in all pairs of images that share ground.

    Parameters
    ----------
    scene : Scene
        Pictures with nominal orientations and priors over one ground.
    settings : MatchSettings, optional
        Choices.
    workers : int, optional
        Tiles at a time; as many as there are processors when absent.
    progress : callable, optional
        Called with the stage, and how much of it is done.

    Raises
    ------
    InputError
        Where images are blank or saturated, don't overlap, don't agree on an orientation, or no match remains.
    """
    settings = settings or MatchSettings()
    scene.require_contrast()
    cautions = require_unblocked(scene)
    pairs = pairs_of(scene)
    step = settings.step or scene.step
    aligned = aligned_pictures(scene, pairs, settings, step, progress)
    pairs = [pair for pair in pairs if aligned.group[pair.first] == aligned.group[pair.second]]
    links = _links(aligned, pairs, settings, step, workers, progress)
    matches = _measured_matches(aligned, pairs, links, settings, step, progress)
    return replace(matches, cautions=cautions + matches.cautions)


def _links(
    aligned: Aligned, pairs: Sequence[Pair], settings: MatchSettings, step: float, workers: int | None,
    progress: Progress,
) -> Links:
    """Links on all tiles."""
    scene = aligned.scene
    extents = boxes(scene)
    tiles = tiling(extents, step, _MARGIN * step)
    windows = _windows(scene, pairs, aligned.agreements, step)

    def work(tile: Tile) -> Links:
        return _on_tile(scene, tile, extents, windows, settings)

    parts = list[Links]()
    progress("matching", 0, len(tiles))
    with _one_thread_each(), ThreadPoolExecutor(workers or os.cpu_count()) as pool:
        try:
            for links in pool.map(work, tiles):
                parts.append(links)
                progress("matching", len(parts), len(tiles))
        except BaseException:
            pool.shutdown(cancel_futures=True)
            raise
    return concatenated(parts)


@contextmanager
def _one_thread_each() -> Iterator[None]:
    """OpenCV leaves the other processors to the other tiles."""
    cv2 = opencv()
    before = cv2.getNumThreads()
    cv2.setNumThreads(1)
    try:
        yield
    finally:
        cv2.setNumThreads(before)


def _windows(
    scene: Scene, pairs: Sequence[Pair], agreements: Sequence[Agreement], step: float
) -> dict[tuple[int, int], Window]:
    """Window of each pair, by the differences of the ground from its model."""
    sigmas = [agreement.height_sigma for agreement in agreements if np.isfinite(agreement.height_sigma)]
    height = max(sigmas, default=scene.ground.height_sigma)
    return {
        (pair.first, pair.second): window(
            scene.pictures[pair.first], scene.pictures[pair.second], scene, height, _SLACK * step
        )
        for pair in pairs
    }


def _on_tile(
    scene: Scene, tile: Tile, extents: Sequence[Array], windows: dict[tuple[int, int], Window], settings: MatchSettings
) -> Links:
    low = np.array([tile.west, tile.south])
    high = low + tile.step * np.array([tile.columns, tile.rows])
    near = [j for j, (least, largest) in enumerate(extents) if np.all(least <= high) and np.all(largest >= low)]
    features = features_on(scene, tile, near, settings.features)
    return links_on(features, tile, windows, settings.ratio)


# --- measures


class _Cells(NamedTuple):
    """The ground that pairs share, in cells."""

    side: float
    """m."""
    whole: set[int]
    """Cells of whose middle two images, at least, have a picture."""


def ground_cells(scene: Scene, pairs: Sequence[Pair], count: int, least: float = 0.0) -> _Cells:
    """Square cells of at least `least` m, of which about `count` fall on the ground that the largest pair shares."""
    side = max(float(np.sqrt(max(pair.area for pair in pairs) / count)), least)
    cells = [no_rows()]
    for picture, ((west, south), (east, north)) in zip(scene.pictures, boxes(scene), strict=True):
        columns, rows = np.arange(west // side, east // side + 1), np.arange(south // side, north // side + 1)
        middle = (all_pairs(columns, rows) + 0.5) * side
        pixels = picture.project(scene.ground.points(middle))
        inside = np.all((pixels > 0.0) & (pixels < [picture.image.lines, picture.image.samples]), axis=1)
        cells.append(cell_numbers(middle[inside], side))
    numbers, counts = np.unique(np.concatenate(cells), return_counts=True)
    return _Cells(side, set(numbers[counts > 1].tolist()))


def _numbered(names: Iterable[tuple[int, ...]]) -> Index:
    """(n,) one number for each distinct name."""
    number = dict[tuple[int, ...], int]()
    return np.array([number.setdefault(name, len(number)) for name in names], dtype=np.int64)


def _measured_matches(
    aligned: Aligned, pairs: Sequence[Pair], links: Links, settings: MatchSettings, step: float, progress: Progress
) -> Matches:
    scene = aligned.scene
    cells = ground_cells(scene, pairs, settings.cells, _LEAST_CELL * step)
    tracks = _surest(links, joined(links.links, links.likeness, links.picture), cells, settings)
    tracks = finest_first(scene, links, tracks)
    likeness = _likeness(links, tracks)
    progress("measuring", 0, 2)
    sharp = SharpPictures(scene.pictures)
    first = measured(scene, links, tracks, sharp, settings, step)
    progress("measuring", 1, 2)
    whole = joined_measures([first, _second_look(scene, links, first, sharp, settings, step, len(tracks))])
    progress("measuring", 2, 2)
    passed, losses, misfit = checked_matches(scene, whole, likeness, settings, step, cells, len(links.links))
    if passed.track.size == 0:
        raise InputError(
            "matching", f"no match is left of {losses.linked} ({losses.measured} measured, {losses.coplanar} coplanar)",
            "images that look alike", "the pictures may be too different, or the ground bare",
        )
    returned = _acceptable(whole, settings) & whole.returns
    signs = pair_signs(scene, aligned.agreements, pairs, cells.side, whole, returned, passed, misfit)
    refused = [pair for pair in signs if pair.refused]
    if len(refused) == len(signs):
        raise InputError(
            f"images {refused[0].first} and {refused[0].other}",
            f"{len(np.unique(passed.track))} matches that belong to no common ground: {listed(list(refused[0].signs))}",
            "matches that bear each other out",
            "the images may hardly overlap, show other ground, or be too noisy: check their orientations and pixels; a "
            "wider search finds more false matches, not more ground",
        )
    out = {(pair.first, pair.other) for pair in refused}
    names = [picture.image.name for picture in scene.pictures]
    stay = np.array([(names[i], names[j]) not in out for i, j in zip(passed.first, passed.other, strict=True)])
    aligned = aligned._replace(refused=[*aligned.refused, *(f"{pair.words}: no common ground" for pair in refused)])
    losses = losses._replace(kept=int(np.count_nonzero(stay)))
    cautions = tuple(f"Doubtful are the matches of {pair.words}." for pair in signs if pair.signs and not pair.refused)
    return replace(_matches(aligned, passed.some(stay), misfit[stay], losses, step, cells), cautions=cautions)


def _surest(links: Links, tracks: list[list[int]], cells: _Cells, settings: MatchSettings) -> list[list[int]]:
    """Some tracks of each cell, the surest first; longer ones before shorter."""
    if not tracks:
        return tracks
    plane = links.plane[[track[0] for track in tracks]]
    quality = -_likeness(links, tracks) - np.array([len(track) for track in tracks])
    group = _numbered(tuple(links.picture[track].tolist()) for track in tracks)
    chosen = spread(cell_numbers(plane, cells.side), group, quality, _TRIED * settings.per_cell)
    return [tracks[k] for k in np.flatnonzero(chosen)]


def finest_first(scene: Scene, links: Links, tracks: list[list[int]]) -> list[list[int]]:
    """Features of each track, that of the finest picture first: its window is what the others are compared with, and a
    coarse one would be compared with what finer pixels alias. Pictures about as fine stay in their order.
    """
    areas = 2.0 * np.log(scene.pixel_sizes)
    rank = np.rint((areas - areas.min()) / np.log(_FINER)).astype(int)
    return [sorted(track, key=lambda feature: int(rank[links.picture[feature]])) for track in tracks]


def _likeness(links: Links, tracks: Sequence[list[int]]) -> Array:
    """(t,) mean of how sure each track's features are of one another."""
    best = np.zeros(len(links.plane))
    np.maximum.at(best, links.links.ravel(), np.repeat(links.likeness, 2))
    return np.array([best[track].mean() for track in tracks])


def _second_look(
    scene: Scene, links: Links, first: Measured, sharp: SharpPictures, settings: MatchSettings, step: float, offset: int
) -> Measured:
    """Features that did not fit a track's reference may fit each other: such tracks are split and measured again."""
    unfit = np.flatnonzero(~_acceptable(first, settings) | ~first.returns)
    tracks = grouped(zip(first.track[unfit].tolist(), first.feature[unfit].tolist(), strict=True))
    remeasured = measured(scene, links, [track for track in tracks.values() if len(track) > 1], sharp, settings, step)
    return remeasured._replace(track=remeasured.track + offset)


def _acceptable(measures: Measured, settings: MatchSettings) -> Mask:
    good = measures.status == MatchStatus.CONVERGED
    sigmas = np.full(good.size, np.inf)
    sigmas[good] = measures.some(good).sigmas
    return np.asarray(good & (measures.correlation >= settings.least_correlation) & (sigmas <= settings.largest_sigma))


def checked_matches(
    scene: Scene, measures: Measured, likeness: Array, settings: MatchSettings, step: float, cells: _Cells, linked: int
) -> tuple[Measured, Losses, Array]:
    """Measures that pass all checks, best of each cell, and the coplanarity residuals."""
    acceptable = _acceptable(measures, settings)
    sound = measures.some(acceptable & measures.returns)
    checked = checked_measures(scene, sound, step, settings.seed)
    good = checked.coplanar & checked.steady
    good[good] = one_per_window(scene, sound.some(good), likeness, settings, step)
    remaining = sound.some(good)
    best = _best_of_cells(scene, remaining, likeness, cells, settings)
    losses = Losses(
        linked=linked,
        tried=measures.track.size,
        measured=int(np.count_nonzero(measures.status == MatchStatus.CONVERGED)),
        similar=int(np.count_nonzero(acceptable)),
        returned=sound.track.size,
        coplanar=int(np.count_nonzero(checked.coplanar)),
        steady=int(np.count_nonzero(checked.coplanar & checked.steady)),
        kept=int(np.count_nonzero(best)),
    )
    return remaining.some(best), losses, checked.misfit[good][best]


def _best_of_cells(
    scene: Scene, measures: Measured, likeness: Array, cells: _Cells, settings: MatchSettings
) -> Mask:
    """(k,) measures of the surest tracks of each cell, whole tracks; those split off from others come last.

    Not those of the smallest sigmas: which of several sigmas is the smallest is chance, too, and what is chosen for it
    is worse than it says.
    """
    tracks, begin, inverse = np.unique(measures.track, return_index=True, return_inverse=True)
    unsure = _unsure(tracks, likeness)
    other_pictures = np.split(measures.other, begin[1:]) if begin.size else []
    group = _numbered((int(j), *other.tolist()) for j, other in zip(measures.first[begin], other_pictures, strict=True))
    cell = cell_numbers(_anchor_plane(scene, measures.some(begin)), cells.side)
    return np.asarray(spread(cell, group, unsure, settings.per_cell)[inverse])


def one_per_window(
    scene: Scene, measures: Measured, likeness: Array, settings: MatchSettings, step: float
) -> Mask:
    """(k,) measures of which no other of the same pair lies in the same half window, nearly: of longer tracks first,
    then of surer ones.

    Features near each other share the sharpest pixel beside them, and would give one measure twice.
    """
    rays = np.unique(measures.track, return_inverse=True, return_counts=True)[1:]
    cells = cell_numbers(_anchor_plane(scene, measures), settings.half_window * step)
    pairs = _numbered(zip(measures.first.tolist(), measures.other.tolist(), strict=True))
    return spread(cells, pairs, _unsure(measures.track, likeness) - rays[1][rays[0]], 1)


def _unsure(tracks: Index, likeness: Array) -> Array:
    """(n,) how sure tracks are, negative; zero of those split off from others."""
    quality = np.append(-likeness, 0.0)
    return quality[np.minimum(tracks, likeness.size)]


def _anchor_plane(scene: Scene, measures: Measured) -> Array:
    """(k, 2) m, positions of the anchors on the chart."""
    plane = np.empty((measures.track.size, 2))
    for j, picture in enumerate(scene.pictures):
        of_picture = measures.first == j
        plane[of_picture] = picture.on_chart(scene.ground, measures.anchors[of_picture])
    return plane


def _matches(
    aligned: Aligned, measures: Measured, misfit: Array, losses: Losses, step: float, cells: _Cells
) -> Matches:
    scene = aligned.scene
    _, begin = np.unique(measures.track, return_index=True)
    plane = _anchor_plane(scene, measures.some(begin))
    order: Index = np.lexsort([plane[:, 0], plane[:, 1]])
    names = tuple(picture.image.name for picture in scene.pictures)
    ties, covariances, correlation, misfit = matches_of(measures, misfit, names, order)
    filled = len(cells.whole & set(cell_numbers(plane, cells.side).tolist()))
    return Matches(
        ties, covariances, correlation, misfit, tuple(aligned.agreements), tuple(aligned.refused), losses,
        step, cells.side, (filled, len(cells.whole)),
    )  # fmt: skip

"""First step, on a coarse ground grid: differences of the nominal orientations.

By how much the orientations of two pictures contradict each other at their matches, and which matches do not fit.

Both rays of a match meet the ground, at two positions of the chart. What lies between them (the displacement) has two
parts. Across the plane of the rays it is the coplanarity residual: height has no share in it, orientation alone. Along
it, it is height times the difference of the rays' height parallaxes, besides. A correction of the second picture's
orientation, a polynomial of low degree with its prior, is fitted to both, the second with the sigma of the height. That
is the freedom which the true orientation has; a homography would be another one, which no pushbroom image has.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from mgsgraph.errors import InputError, require
from mgsgraph.geometry.orientation import OrientationCorrection
from mgsgraph.geometry.records import Array, Index, Mask
from mgsgraph.matching.patches import Links, Window, concatenated, features_on, links_on, tiling
from mgsgraph.matching.scene import Ground, Pair, Picture, Scene, boxes, first_picture, next_pair
from mgsgraph.matching.settings import MatchSettings
from mgsgraph.text import root_mean_square
from mgsgraph.workers import Progress

SAMPLE = 5
"""Matches of a trial: ten equations, and the prior."""
_SAMPLES = 400
_UNKNOWN_ANGLE = 1e-2
"""rad, unit of a rotation without a prior."""
_MAD = 1.4826
"""Standard deviation of normal errors over their median absolute deviation."""
_ROUNDS = 8
"""Least-squares fits, each to what fits the last one."""


@dataclass(frozen=True, slots=True, eq=False)
class Displacements:
    """Two pictures at n matches: offsets of their rays on the ground, and derivatives by the orientation."""

    offsets: Array
    """(n, 2) m, second minus first, across and along the direction of a displacement by height."""
    design: Array
    """(n, 2, 6 d) m per sigma of a coefficient of the second picture's correction."""
    parallax: Array
    """(n,) m of displacement along, per m of height."""

    def residuals(self, coefficients: Array) -> Array:
        """(n, 2) m, offsets after a correction in units of its sigmas."""
        return np.asarray(self.offsets + self.design @ coefficients)

    def of(self, some: Mask | Index) -> "Displacements":
        """The displacements of some of the matches (a mask or indices)."""
        return Displacements(self.offsets[some], self.design[some], self.parallax[some])


def sigmas_between(first: Picture, second: Picture, degree: int) -> Array:
    """(degree + 1, 6) m and rad, a-priori sigmas of the orientation of one picture relative to the other's."""
    both = [picture.prior.sigmas for picture in (first, second)]
    rows = [[sigmas[k] if k < len(sigmas) else 1e-3 * sigmas[-1] for k in range(degree + 1)] for sigmas in both]
    return np.asarray(np.hypot(*np.array(rows)))


def units_between(first: Picture, second: Picture, degree: int, unknown: float) -> Array:
    """(degree + 1, 6) m and rad, the same as units of a correction: `unknown` m and a hundredth of a rad where the
    sigmas are infinite.
    """
    sigmas = sigmas_between(first, second, degree)
    return np.where(np.isfinite(sigmas), sigmas, [[unknown] * 3 + [_UNKNOWN_ANGLE] * 3])


def robust_sigma(values: Array) -> float:
    """Standard deviation of normal errors with the same median absolute deviation; zero of no values."""
    return _MAD * float(np.median(np.abs(values - np.median(values)))) if values.size else 0.0


def displacements(
    first: Picture, second: Picture, pixels: tuple[Array, Array], ground: Ground, sigmas: Array
) -> Displacements:
    """Displacements at n matches.

    `pixels` are lines and samples (n, 2) in each picture, `sigmas` (d, 6) the units of the coefficients, m and rad.
    """
    base = second.on_chart(ground, pixels[1])
    frame, size = _frame(first, second, pixels, ground)
    offsets = np.einsum("nij,nj->ni", frame, base - first.on_chart(ground, pixels[0]))
    columns = []
    for power, row in enumerate(sigmas):
        for component, sigma in enumerate(row):
            step = np.zeros_like(sigmas)
            step[power, component] = 1e-2 * sigma
            moved = second.on_chart(ground, pixels[1], increased(second.correction, step))
            columns.append(np.einsum("nij,nj->ni", frame, moved - base) / 1e-2)
    return Displacements(offsets, np.stack(columns, axis=2), size)


def match_offsets(first: Picture, second: Picture, pixels: tuple[Array, Array], ground: Ground) -> Array:
    """(n, 2) m, displacements alone: second minus first, across and along the direction of a displacement by height."""
    away = second.on_chart(ground, pixels[1]) - first.on_chart(ground, pixels[0])
    return np.asarray(np.einsum("nij,nj->ni", _frame(first, second, pixels, ground)[0], away))


def _frame(first: Picture, second: Picture, pixels: tuple[Array, Array], ground: Ground) -> tuple[Array, Array]:
    """(n, 2, 2) directions across and along a displacement by height on the chart, and (n,) its m per m."""
    parallaxes = second.height_parallax(ground, pixels[1]) - first.height_parallax(ground, pixels[0])
    size = np.linalg.norm(parallaxes, axis=1)
    along = np.where(size[:, None] > 1e-9, parallaxes / np.maximum(size, 1e-9)[:, None], [0.0, 1.0])
    return np.stack([np.column_stack([-along[:, 1], along[:, 0]]), along], axis=1), size


def increased(correction: OrientationCorrection | None, step: Array) -> OrientationCorrection:
    """A correction plus coefficients (d, 6) in m and rad: rotations are small, so they add."""
    before = np.zeros((0, 6)) if correction is None else correction.coefficients
    total = np.zeros((max(len(before), len(step)), 6))
    total[: len(before)] += before
    total[: len(step)] += step
    return OrientationCorrection(total)


def consensus(
    displaced: Displacements, tolerance: float, height_sigma: float, rng: np.random.Generator
) -> tuple[Array, Mask]:
    """The correction that most of n matches agree on (Fischler & Bolles 1981), in units of its sigmas (6 d,), and
    whether each match fits it (n,).

    `tolerance` (m) is the sigma of a match's displacement but for height, `height_sigma` (m) that of the ground; within
    three sigmas a match fits. `rng` draws the trials.
    """
    n = len(displaced.offsets)
    sigmas = np.column_stack([np.full(n, tolerance), np.hypot(tolerance, height_sigma * displaced.parallax)])
    best, most = np.zeros(displaced.design.shape[2]), _fits(displaced, np.zeros(displaced.design.shape[2]), sigmas)
    for _ in range(_SAMPLES if n > SAMPLE else 0):
        some = rng.choice(n, SAMPLE, replace=False)
        trial = _solved(displaced.of(some), sigmas[some])
        fits = _fits(displaced, trial, sigmas)
        if np.count_nonzero(fits) > np.count_nonzero(most):
            best, most = trial, fits
    for _ in range(_ROUNDS):
        best = _solved(displaced.of(most), sigmas[most])
        refit = _fits(displaced, best, sigmas)
        if np.array_equal(refit, most):
            break
        most = refit
    return best, most


def _fits(displaced: Displacements, coefficients: Array, sigmas: Array) -> Mask:
    return np.asarray(np.all(np.abs(displaced.residuals(coefficients)) <= 3.0 * sigmas, axis=1))


def _solved(displaced: Displacements, sigmas: Array) -> Array:
    """Least squares with the prior: unit sigmas about zero."""
    unknowns = displaced.design.shape[2]
    rows = (displaced.design / sigmas[:, :, None]).reshape(-1, unknowns)
    right = (-displaced.offsets / sigmas).reshape(-1)
    full = np.concatenate([rows, np.eye(unknowns)])
    return np.asarray(np.linalg.lstsq(full, np.concatenate([right, np.zeros(unknowns)]), rcond=None)[0])


# --- alignment of pictures


_COARSER = 4.0
"""How much coarser than the ground grid."""
_DEGREE = 1
"""Of the correction that aligns two pictures."""
_SIGMAS = 3.0
"""A-priori sigmas within which nominal orientations contradict each other."""
_TOLERANCE = 1.0
"""coarse pixels, sigma of a match."""
_LEAST_SEARCH = 10.0
"""coarse pixels: within less, matches would agree by chance."""
_WIDEST_SEARCH = 2048
"""coarse pixels: farther, a tile with its margins would not fit into memory."""
_LEAST = 12
"""Matches that have to agree on a correction."""
_CHANCE = 4.0
"""How many times more likely than by chance matches have to agree (the ratio of the odds)."""
_FALSE = 1.0
"""Agreements of false matches that may be expected; far fewer are met, for few of all the orientations are tried."""
_SMOOTHEST = 5.0
"""m, least sigma of the ground's height about the model that is reckoned with."""


class NoAgreement(InputError):
    """Two pictures whose matches agree on no orientation: of several pictures, others may."""


class Agreement(NamedTuple):
    """Agreement of two pictures."""

    first: int
    second: int
    candidates: int
    """Matches on the coarse grid."""
    agreed: int
    """Of these, those which fit one correction."""
    moved: float
    """m rms, by which the correction moves the second picture on the ground at them."""
    expected: float
    """m, a-priori sigma of this; NaN without a prior."""
    height_sigma: float
    """m, by how much the ground is higher or lower than its model, at them; NaN where the rays are nearly parallel."""


def search_radius(first: Picture, second: Picture, scene: Scene) -> float:
    """Three sigmas, in m on the ground, of what two nominal orientations and the height may contradict each other by.

    Raises
    ------
    InputError
        Where the orientation has no prior.
    """
    variance = 0.0
    for picture in (first, second):
        sigmas = np.linalg.norm(picture.prior.sigmas, axis=0)
        found = "an infinite a-priori sigma of its orientation"
        remedy = "or say how far to search: --search METRES"
        require(np.all(np.isfinite(sigmas)), f"image {picture.image.name}", found, "a finite one", remedy)
        middle = 0.5 * np.array([picture.image.lines]), 0.5 * np.array([picture.image.samples])
        origin, ray = picture.image.sightlines(*middle)
        away = float(np.linalg.norm(scene.ground.meet(origin, ray) - origin))
        turn = np.array([sigmas[3], sigmas[4], sigmas[5] * 0.5 * picture.image.samples * picture.image.pixel_angle])
        variance += float(sigmas[:3] @ sigmas[:3]) / 1.5 + float(turn @ turn) * away**2
    parallax = np.linalg.norm(_parallax_between(first, second, scene))
    return _SIGMAS * float(np.sqrt(variance + (parallax * scene.ground.height_sigma) ** 2))


def _expected(first: Picture, second: Picture, scene: Scene) -> float:
    try:
        return search_radius(first, second, scene) / _SIGMAS
    except InputError:
        return np.nan


def _parallax_between(first: Picture, second: Picture, scene: Scene) -> Array:
    """(2,) m per m, displacement by height in the middle of the second picture."""
    middle = 0.5 * np.array([[second.image.lines, second.image.samples]])
    pixel = first.project(scene.ground.points(second.on_chart(scene.ground, middle)))
    pixel = np.where(np.isfinite(pixel), pixel, 0.5 * np.array([[first.image.lines, first.image.samples]]))
    return np.asarray(second.height_parallax(scene.ground, middle)[0] - first.height_parallax(scene.ground, pixel)[0])


def window(first: Picture, second: Picture, scene: Scene, height_sigma: float, slack: float) -> Window:
    """Where a counterpart may lie: within `slack` (m), and farther by three sigmas of the height (m)."""
    parallax = _parallax_between(first, second, scene)
    size = float(np.linalg.norm(parallax))
    direction = parallax / size if size > 1e-6 else np.array([0.0, 1.0])
    return Window(direction, slack + _SIGMAS * size * height_sigma, slack)


class Aligned(NamedTuple):
    """Pictures whose orientations were made to agree."""

    scene: Scene
    """With corrections that make pictures agree; they mean nothing by themselves."""
    agreements: list[Agreement]
    """How each picture joined those before."""
    group: Index
    """(n,) of each picture: pictures of one group agree, those of two groups were never compared."""
    refused: list[str]
    """Why pairs were not aligned; their pictures may be by other pairs."""


def aligned_pictures(
    scene: Scene,
    pairs: Sequence[Pair],
    settings: MatchSettings,
    step: float,
    progress: Progress,
) -> Aligned:
    """Correct pictures that share ground, one after the other, until they agree with those before.

    `scene` has nominal orientations, `step` is the pixel of the fine ground grid in m. InputError where no two pictures
    agree.
    """
    count = len(scene.pictures)
    left, placed, group = set(range(count)), set[int](), np.full(count, -1)
    done, tried, refused = list[Agreement](), set[Pair](), list[NoAgreement]()
    while left:
        progress("coarse grid", count - len(left), count)
        pair = next_pair(pairs, placed, left, tried)
        if pair is None:
            placed = {new := first_picture(pairs, left)}
            group[new] = group.max() + 1
            left.discard(new)
            continue
        try:
            scene, agreement = _joined(scene, pair, settings, _COARSER * step)
        except NoAgreement as error:
            tried.add(pair)
            refused.append(error)
            continue
        done.append(agreement)
        group[pair.second] = group[pair.first]
        placed.add(pair.second)
        left.discard(pair.second)
    progress("coarse grid", count, count)
    if not done:
        raise refused[0]
    return Aligned(scene, done, group, [str(error) for error in refused])


def _joined(
    scene: Scene, pair: Pair, settings: MatchSettings, step: float
) -> tuple[Scene, Agreement]:
    """The scene with the second picture corrected, by links on the coarse grid."""
    first, second = (scene.pictures[j] for j in pair[:2])
    radius = max(settings.search or search_radius(first, second, scene), _LEAST_SEARCH * step)
    require(
        radius <= _WIDEST_SEARCH * step, f"images {first.image.name} and {second.image.name}",
        f"{radius:.4g} m of ground to search either way, {radius / step:.0f} pixels of the coarse grid",
        f"at most {_WIDEST_SEARCH}", "give smaller a-priori sigmas, --search METRES, or a coarser grid (--step METRES)",
    )  # fmt: skip
    links = _coarse_links(scene, pair, settings, step, radius)
    return corrected_scene(scene, pair, links, step, radius, np.random.default_rng([settings.seed, *pair[:2]]))


def _coarse_links(scene: Scene, pair: Pair, settings: MatchSettings, step: float, radius: float) -> Links:
    extents = boxes(scene)
    area = extents[pair.first], extents[pair.second] + radius * np.array([[-1.0], [1.0]])
    near = Window(np.array([0.0, 1.0]), radius, radius)
    return concatenated([
        links_on(features_on(scene, tile, pair[:2], settings.features), tile, {pair[:2]: near}, settings.ratio)
        for tile in tiling(area, step, radius)
    ])


def _chance(displaced: Displacements, tolerance: float, height_sigma: float, radius: float) -> float:
    """Chance of a false match to agree with an orientation: the tolerances' share of the searched ground."""
    along = np.hypot(tolerance, height_sigma * displaced.parallax)
    reach = np.minimum(3.0 * np.column_stack([np.full(along.size, tolerance), along]) / radius, 1.0)
    return float(reach.prod(axis=1).mean()) if along.size else 0.0


def _share_needed(chance: float) -> float:
    """Share of the matches that must agree, by the chance of each."""
    return _CHANCE * chance / (1.0 + (_CHANCE - 1.0) * chance)


def chance_agreements(count: int, agreed: int, chance: float) -> float:
    """Expected number of orientations on which so many of `count` false matches agree, each with this chance (a
    contrario; Moisan & Stival 2004): of the orientations that any five of them give, those with which so many of the
    others agree, by the binomial law.
    """
    from scipy.special import betainc  # slow to import

    more = agreed - SAMPLE
    if more <= 0:
        return float("inf")
    return float(math.comb(count, SAMPLE) * betainc(more, count - SAMPLE - more + 1, chance))


def corrected_scene(
    scene: Scene, pair: Pair, links: Links, step: float, radius: float, rng: np.random.Generator
) -> tuple[Scene, Agreement]:
    """The scene with the second picture of the pair corrected to agree with the first, and how far the links agree."""
    first, second = (scene.pictures[j] for j in pair[:2])
    points = [scene.ground.points(links.plane[links.links[:, k]]) for k in (0, 1)]
    pixels = first.project(points[0]), second.project(points[1])
    sigmas = units_between(first, second, _DEGREE, radius)
    displaced = displacements(first, second, pixels, scene.ground, sigmas)
    tolerance = _TOLERANCE * step
    step_taken, fits = consensus(displaced, tolerance, scene.ground.height_sigma, rng)
    agreed, count = int(np.count_nonzero(fits)), len(fits)
    chance = _chance(displaced, tolerance, scene.ground.height_sigma, radius)
    few = agreed < max(_LEAST, count * _share_needed(chance))
    if few or chance_agreements(count, agreed, chance) > _FALSE:
        raise NoAgreement(
            f"images {first.image.name} and {second.image.name}",
            f"of {count} matches on a coarse grid {agreed} agree on one orientation",
            f"at least {_LEAST}, and more than by chance",
            "widen the search (--search METRES) or refine the grid (--step), or give better orientation or heights",
        )
    moved = root_mean_square(np.linalg.norm(displaced.design[fits] @ step_taken, axis=1))
    correction = increased(second.correction, step_taken.reshape(sigmas.shape) * sigmas)
    pictures = list(scene.pictures)
    pictures[pair.second] = replace(second, correction=correction)
    heights = displaced.of(fits).residuals(step_taken)[:, 1] / np.maximum(displaced.parallax[fits], 1e-6)
    spread = robust_sigma(heights)
    flat = bool(np.median(displaced.parallax[fits]) * scene.ground.height_sigma < tolerance)
    height = np.nan if flat else max(spread, _SMOOTHEST)
    agreement = Agreement(pair.first, pair.second, count, agreed, moved, _expected(first, second, scene), height)
    return replace(scene, pictures=tuple(pictures)), agreement

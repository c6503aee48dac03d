"""First, on a coarse ground grid: by how much the nominal orientations contradict each other."""

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from mgsgraph.errors import InputError
from mgsgraph.geometry.records import Array, Index
from mgsgraph.matching.features import Window
from mgsgraph.matching.pairs import Pair, boxes, first_picture, next_pair
from mgsgraph.matching.relative import (
    SAMPLE,
    Displacements,
    consensus,
    displacements,
    increased,
    robust_sigma,
    units_between,
)
from mgsgraph.matching.scene import Picture, Scene
from mgsgraph.matching.settings import MatchSettings
from mgsgraph.matching.tiles import Links, TileStore, features_on, kept_links, links_on, tiling, together
from mgsgraph.progress import Progress
from mgsgraph.text import root_mean_square

_COARSER = 4.0
"""How much coarser than the ground grid."""
_DEGREE = 1
"""Of the correction that brings two pictures together."""
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
    """What two pictures agreed on."""

    first: int
    second: int
    candidates: int
    """Matches on the coarse grid."""
    agreed: int
    """Of these, those which fit one correction."""
    moved: float
    """m rms, by which the correction moves the second picture on the ground at them."""
    expected: float
    """m, sigma of this by what is known beforehand; NaN where nothing is."""
    height_sigma: float
    """m, by how much the ground is higher or lower than its model, at them; NaN where the rays are nearly parallel."""


def search_radius(first: Picture, second: Picture, scene: Scene) -> float:
    """Three sigmas, in m on the ground, of what two nominal orientations and the height may contradict each other by.

    Raises
    ------
    InputError
        Where nothing is known of the orientation beforehand.
    """
    variance = 0.0
    for picture in (first, second):
        sigmas = np.linalg.norm(picture.prior.sigmas, axis=0)
        if not np.all(np.isfinite(sigmas)):
            found = "an infinite a-priori sigma of its orientation"
            remedy = "or say how far to search: --search METRES"
            raise InputError(f"image {picture.image.name}", found, "a finite one", remedy)
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
    there = first.project(scene.ground.points(second.on_chart(scene.ground, middle)))
    there = np.where(np.isfinite(there), there, 0.5 * np.array([[first.image.lines, first.image.samples]]))
    return np.asarray(second.height_parallax(scene.ground, middle)[0] - first.height_parallax(scene.ground, there)[0])


def window(first: Picture, second: Picture, scene: Scene, height_sigma: float, slack: float) -> Window:
    """Where a counterpart may lie: within `slack` (m), and farther by three sigmas of the height (m)."""
    parallax = _parallax_between(first, second, scene)
    size = float(np.linalg.norm(parallax))
    direction = parallax / size if size > 1e-6 else np.array([0.0, 1.0])
    return Window(direction, slack + _SIGMAS * size * height_sigma, slack)


class Together(NamedTuple):
    """Pictures whose orientations were brought together."""

    scene: Scene
    """With corrections that make pictures agree; they mean nothing by themselves."""
    agreements: list[Agreement]
    """How each picture joined those before."""
    group: Index
    """(n,) of each picture: pictures of one group agree, those of two were never brought together."""
    refused: list[str]
    """Why pairs were not brought together; their pictures may be by way of others."""


def brought_together(
    scene: Scene,
    pairs: Sequence[Pair],
    settings: MatchSettings,
    step: float,
    store: TileStore | None,
    progress: Progress,
) -> Together:
    """Correct pictures that share ground, one after the other, until they agree with those before.

    `scene` has nominal orientations, `step` is the pixel of the fine ground grid in m; links that are found are kept in
    the store. InputError where no two pictures agree.
    """
    count = len(scene.pictures)
    left, there, group = set(range(count)), set[int](), np.full(count, -1)
    done, tried, refused = list[Agreement](), set[Pair](), list[NoAgreement]()
    while left:
        progress("coarse grid", count - len(left), count)
        pair = next_pair(pairs, there, left, tried)
        if pair is None:
            there = {new := first_picture(pairs, left)}
            group[new] = group.max() + 1
            left.discard(new)
            continue
        try:
            scene, agreement = _joined(scene, pair, settings, _COARSER * step, store)
        except NoAgreement as error:
            tried.add(pair)
            refused.append(error)
            continue
        done.append(agreement)
        group[pair.second] = group[pair.first]
        there.add(pair.second)
        left.discard(pair.second)
    progress("coarse grid", count, count)
    if not done:
        raise refused[0]
    return Together(scene, done, group, [str(error) for error in refused])


def _joined(
    scene: Scene, pair: Pair, settings: MatchSettings, step: float, store: TileStore | None
) -> tuple[Scene, Agreement]:
    """The scene with the second picture corrected, by links that were kept or are found."""
    first, second = (scene.pictures[j] for j in pair[:2])
    radius = max(settings.search or search_radius(first, second, scene), _LEAST_SEARCH * step)
    if radius > _WIDEST_SEARCH * step:
        raise InputError(
            f"images {first.image.name} and {second.image.name}",
            f"{radius:.4g} m of ground to search either way, {radius / step:.0f} pixels of the coarse grid",
            f"at most {_WIDEST_SEARCH}",
            "give smaller a-priori sigmas, --search METRES, or a coarser grid (--step METRES)",
        )
    name = f"coarse_{pair.first:05d}_{pair.second:05d}"
    links = kept_links(store, name, lambda: _coarse_links(scene, pair, settings, step, radius))
    return corrected_scene(scene, pair, links, step, radius, np.random.default_rng([settings.seed, *pair[:2]]))


def _coarse_links(scene: Scene, pair: Pair, settings: MatchSettings, step: float, radius: float) -> Links:
    shown = boxes(scene)
    wanted = shown[pair.first], shown[pair.second] + radius * np.array([[-1.0], [1.0]])
    near = Window(np.array([0.0, 1.0]), radius, radius)
    return together([
        links_on(features_on(scene, tile, pair[:2], settings.features), tile, {pair[:2]: near}, settings.ratio)
        for tile in tiling(wanted, step, radius)
    ])


def _chance(found: Displacements, tolerance: float, height_sigma: float, radius: float) -> float:
    """Chance of a match to agree with an orientation: what tolerances take of the ground searched."""
    along = np.hypot(tolerance, height_sigma * found.parallax)
    reach = np.minimum(3.0 * np.column_stack([np.full(along.size, tolerance), along]) / radius, 1.0)
    return float(reach.prod(axis=1).mean()) if along.size else 0.0


def _share_needed(chance: float) -> float:
    """Share of the matches that has to agree, by the chance of each."""
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
    found = displacements(first, second, pixels, scene.ground, sigmas)
    tolerance = _TOLERANCE * step
    step_taken, fits = consensus(found, tolerance, scene.ground.height_sigma, rng)
    agreed, count = int(np.count_nonzero(fits)), len(fits)
    chance = _chance(found, tolerance, scene.ground.height_sigma, radius)
    few = agreed < max(_LEAST, count * _share_needed(chance))
    if few or chance_agreements(count, agreed, chance) > _FALSE:
        raise NoAgreement(
            f"images {first.image.name} and {second.image.name}",
            f"of {count} matches on a coarse grid {agreed} agree on one orientation",
            f"at least {_LEAST}, and more than by chance",
            "widen the search (--search METRES) or refine the grid (--step), or give better orientation or heights",
        )
    moved = root_mean_square(np.linalg.norm(found.design[fits] @ step_taken, axis=1))
    correction = increased(second.correction, step_taken.reshape(sigmas.shape) * sigmas)
    pictures = list(scene.pictures)
    pictures[pair.second] = replace(second, correction=correction)
    heights = found.of(fits).residuals(step_taken)[:, 1] / np.maximum(found.parallax[fits], 1e-6)
    spread = robust_sigma(heights)
    flat = bool(np.median(found.parallax[fits]) * scene.ground.height_sigma < tolerance)
    height = np.nan if flat else max(spread, _SMOOTHEST)
    agreement = Agreement(pair.first, pair.second, count, agreed, moved, _expected(first, second, scene), height)
    return replace(scene, pictures=tuple(pictures)), agreement

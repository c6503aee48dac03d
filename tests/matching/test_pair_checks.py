"""False matches betray themselves together: by chance, by signs of a pair, by blocks of a lossy compression."""

import math
from dataclasses import replace

import matched
import numpy as np
import pytest
from scipy.stats import binom

from mgsgraph.errors import InputError
from mgsgraph.matching import match as module
from mgsgraph.matching.checks import PairSigns, _from_neighbours
from mgsgraph.matching.coarse import NoAgreement, chance_agreements, corrected_scene
from mgsgraph.matching.match import match_scene
from mgsgraph.matching.patches import Links, opencv
from mgsgraph.matching.scene import STEEP, STEPPED, Pair, Pixels, Scene, block_steps, require_unblocked

NAN = math.nan
FALSE = [  # agreed, found again, cells filled, scatter: measured (docs/matching.md)
    (9 / 134, 32 / 2341, 15 / 296, 7.4), (10 / 59, 18 / 1457, 9 / 2490, 9.1), (11 / 178, 65 / 2556, 24 / 274, 12.7),
    (7 / 48, 16 / 1760, 3 / 949, 4.6), (5 / 53, 13 / 1056, 8 / 353, 6.3), (155 / 166, 93 / 1041, 39 / 269, 4.1),
]  # fmt: skip
GOOD = [
    (300 / 309, 1781 / 1900, 236 / 237, 0.54), (102 / 110, 16 / 731, 11 / 222, 1.5),
    (24 / 54, 1202 / 1568, 402 / 650, 1.4), (42 / 52, 197 / 850, 108 / 251, 0.93),
    (14 / 27, 208 / 223, 29 / 30, 0.78), (NAN, 1156 / 1374, 448 / 985, 6.7),
]  # fmt: skip


def test_agreement_by_chance_is_the_binomial_law() -> None:
    for count, agreed, chance in ((40, 15, 0.1), (164, 16, 0.01), (30, 25, 0.3)):
        expected = math.comb(count, 5) * binom.sf(agreed - 6, count - 5, chance)
        assert chance_agreements(count, agreed, chance) == pytest.approx(expected, rel=1e-9)
    assert chance_agreements(164, 16, 0.008) > 1.0  # what an overlap of 25 pixels was matched on
    assert chance_agreements(27, 14, 0.01) < 1e-3
    assert chance_agreements(20, 5, 0.01) == math.inf


def test_links_from_anywhere_to_anywhere_in_a_strip_agree_on_nothing() -> None:
    """Fifteen of these 164 fit one orientation: it was taken for theirs."""
    scene, radius = matched.scene(), 400.0
    rng, plane = np.random.default_rng(1), scene.ground.chart.plane(matched.inner(800))
    begin = plane[rng.integers(0, len(plane), 164 * 400)]
    begin = begin[np.abs(begin[:, 0] - np.median(plane[:, 0])) < 60.0][:164]
    end, numbers = begin + rng.uniform(-radius, radius, begin.shape), np.arange(164)
    sides = np.column_stack([numbers, 164 + numbers])
    links = Links(np.concatenate([begin, end]), np.repeat([0, 1], 164), sides, np.ones(164))
    with pytest.raises(NoAgreement, match="of 164 matches on a coarse grid 15 agree"):
        corrected_scene(scene, Pair(0, 1, 1.0), links, 10.0, radius, np.random.default_rng(1))


@pytest.mark.parametrize("signs", FALSE)
def test_false_pairs_show_two_signs_or_more(signs: tuple[float, ...]) -> None:
    assert PairSigns("A", "B", *signs).refused


@pytest.mark.parametrize("signs", GOOD)
def test_good_pairs_show_one_at_most(signs: tuple[float, ...]) -> None:
    assert not PairSigns("A", "B", *signs).refused


def test_jitter_is_no_scatter() -> None:
    """What neighbours have in common is taken off, noise stays."""
    rng, lines = np.random.default_rng(4), np.sort(np.random.default_rng(3).uniform(0.0, 4000.0, 800))
    noise, jitter = rng.normal(0.0, 0.5, 800), 4.0 * np.sin(2.0 * np.pi * lines / 320.0)
    order = rng.permutation(800)
    assert np.std(_from_neighbours(lines[order], (noise + jitter)[order])) < 0.75
    assert 0.45 < np.std(_from_neighbours(lines, noise)) < 0.65
    assert np.std(_from_neighbours(lines, rng.uniform(-4.0, 4.0, 800))) > 2.0
    few = np.array([1.0, 2.0])
    assert np.array_equal(_from_neighbours(few, few), few)


def blocked(pixels: Pixels, quality: int) -> Pixels:
    cv2 = opencv()
    _, packed = cv2.imencode(".jpg", pixels, [cv2.IMWRITE_JPEG_QUALITY, quality])
    return np.asarray(cv2.imdecode(packed, cv2.IMREAD_GRAYSCALE))


def with_second(pixels: Pixels) -> Scene:
    scene = matched.scene()
    return replace(scene, pictures=(scene.pictures[0], replace(scene.pictures[1], pixels=pixels)))


def test_blocks_are_seen_wherever_they_begin() -> None:
    for picture in matched.scene().pictures:
        clean = block_steps(picture.pixels)
        assert clean < 1.05
        strong, weak = (block_steps(blocked(picture.pixels, quality)[3:, 5:]) for quality in (12, 40))
        assert strong > STEEP > weak > STEPPED > block_steps(blocked(picture.pixels, 90)) > clean


def test_detectors_that_differ_are_no_blocks() -> None:
    """Columns read out in turns step along samples alone, and at more than one phase."""
    pixels = matched.scene().pictures[0].pixels.astype(np.float32)
    columns = np.arange(pixels.shape[1])
    assert block_steps(pixels + 20.0 * (columns % 2)) < 1.1
    assert block_steps(pixels + 40.0 * (columns % 8 == 3)) < 1.1
    holes = pixels.copy()
    holes[100:200] = np.nan
    assert block_steps(holes) < 1.1
    assert block_steps(pixels[:10]) == 1.0
    assert block_steps(np.full_like(pixels, np.nan)) == 1.0


def test_a_picture_of_blocks_is_refused_and_a_little_is_said() -> None:
    pixels = matched.scene().pictures[1].pixels
    with pytest.raises(InputError, match=r"picture of E02-01453: blocks of 8 x 8 pixels"):
        match_scene(with_second(blocked(pixels, 10)), matched.SETTINGS, workers=1)
    (caution,) = require_unblocked(with_second(blocked(pixels, 40)))
    assert "E02-01453" in caution
    assert not require_unblocked(matched.scene())


def test_a_pair_that_shows_two_signs_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    settings = replace(matched.SETTINGS, cells=20, features=800)
    monkeypatch.setattr(module, "pair_signs", lambda *_: [PairSigns("A", "B", *FALSE[0])])
    with pytest.raises(InputError, match=r"images A and B: \d+ matches that belong to no common ground: 7% of the"):
        match_scene(matched.scene(), settings, workers=1)

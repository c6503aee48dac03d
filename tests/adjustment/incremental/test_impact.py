"""What is said of a change is what has changed: moves, sigmas, neighbours, and nothing noticeable left out; what a
coefficient moves at most.
"""

from collections import Counter
from dataclasses import replace
from typing import get_args

import numpy as np
import pytest
from increments import (
    NOISE,
    Places,
    State,
    fan,
    grown,
    largest_difference,
    places_of,
    state_of,
    strip,
    take,
    take_alone,
)
from strategies import differences

from mgsgraph.adjustment.incremental.impact import Impact
from mgsgraph.adjustment.incremental.incremental import IncrementalAdjustment
from mgsgraph.adjustment.incremental.state import NOTICEABLE, ground_motion, image_motion
from mgsgraph.adjustment.settings import SolverSettings
from mgsgraph.geometry.image import PushbroomImage
from mgsgraph.geometry.orientation import Angles, OrientationCorrection
from mgsgraph.network import Network
from mgsgraph.network.parts import KnownImage

_DRIFT = 0.2 * NOTICEABLE
"""Sigmas by which a place may have changed unnoticed since it was stated."""


def require_points(impact: Impact, before: Places, after: Places) -> None:
    """Every point stated has moved so, and every one that has moved is stated."""
    said = {name: k for k, name in enumerate(impact.points.ids)}
    assert len(said) == len(impact.points.ids)
    for name, (place, sigmas) in after.items():
        was, were = before.get(name, (np.full(3, np.nan), np.full(3, np.nan)))
        k = said.get(name)
        if np.isnan(place[0]):
            assert k is None
            continue
        if np.isnan(was[0]):
            assert k is not None, f"{name} is new"
            assert impact.points.new[k]
            assert np.all(np.isnan(impact.points.moves[k]))
        elif k is None:
            assert np.max(np.abs(place - was) / were) < 1.01 * NOTICEABLE, f"{name} has moved"
        else:
            assert not impact.points.new[k]
            assert np.max(np.abs(impact.points.moves[k] - (place - was)) / were) < _DRIFT
            assert impact.points.in_sigmas[k] > NOTICEABLE
            real = np.max(np.abs(place - was) / were)
            assert impact.points.in_sigmas[k] == pytest.approx(real, rel=NOTICEABLE, abs=_DRIFT)
            np.testing.assert_allclose(impact.points.sigmas_before[k], were, rtol=NOTICEABLE)
        if k is not None:
            np.testing.assert_allclose(impact.points.sigmas_after[k], sigmas, rtol=NOTICEABLE)
    assert set(impact.removed) == set(before) - set(after)
    there = {name for name, (place, _) in before.items() if np.isfinite(place[0])}
    assert set(impact.undetermined) == {name for name in there if name in after and np.isnan(after[name][0][0])}


def require_images(impact: Impact, before: State, after: State) -> None:
    """The same of images: those that aren't named haven't moved."""
    named = impact.images.names
    assert set(named) <= set(after)
    for name, (value, covariance) in after.items():
        sigmas = np.sqrt(np.diag(covariance))
        if name not in named:
            assert np.max(np.abs(value - before[name][0]) / sigmas) < NOTICEABLE
            continue
        k = named.index(name)
        assert impact.images.new[k] == (name not in before)
        np.testing.assert_allclose(impact.images.sigmas_after[k], sigmas[:6], rtol=1e-6)
        if name in before:
            was, were = before[name][0], np.sqrt(np.diag(before[name][1]))
            np.testing.assert_allclose(impact.images.sigmas_before[k], were[:6], rtol=NOTICEABLE)
            assert np.max(np.abs(impact.images.moves[k] - (value - was)[:6]) / were[:6]) < _DRIFT
            stated, real = impact.images.in_sigmas[k], np.max(np.abs(value - was) / were)
            assert stated == pytest.approx(real, rel=NOTICEABLE, abs=_DRIFT)


def shared_points(network: Network, name: str, places: Places) -> dict[str, int]:
    """How many points with a place each other image shares with one."""
    names, rays = network.image_names, network.rays
    seen = Counter[str]()
    sees = {(i, names[j]) for i, j in zip(rays.point.tolist(), rays.image.tolist(), strict=True)}
    for i, point in enumerate(network.points.ids):
        if (i, name) in sees and np.isfinite(places[point][0][0]):
            seen.update(other for other in names if other != name and (i, other) in sees)
    return dict(seen)


def test_additions() -> None:
    made = fan(7, 10, 4)
    adjustment = grown(made, 3)
    for k in range(3, 7):
        before, state = places_of(adjustment), state_of(adjustment)
        impact = take(adjustment, made, k)
        after = places_of(adjustment)
        assert (impact.verb, impact.subjects) == ("add", (made.images[k].name,))
        require_points(impact, before, after)
        require_images(impact, state, state_of(adjustment))
        assert impact.neighbours == shared_points(adjustment.network, made.images[k].name, after)
        assert impact.unconnected == ()
        assert impact.seconds > 0.0


def test_removals() -> None:
    made, adjustment = fan(), IncrementalAdjustment()
    for k in range(5):
        take_alone(adjustment, made, k)
    for names in (["FAN/2"], ["FAN/0", "FAN/3"]):
        before, state = places_of(adjustment), state_of(adjustment)
        impact = adjustment.remove(*names)
        assert (impact.verb, impact.subjects) == ("remove", tuple(names))
        require_points(impact, before, places_of(adjustment))
        require_images(impact, state, state_of(adjustment))
        assert impact.neighbours == {}
        assert impact.unconnected == ()
    assert impact.removed
    assert impact.undetermined
    assert any(f"{len(impact.removed)} points that no other image saw" in said for said in impact.sentences)


@pytest.mark.parametrize("angles", ["camera", "opk-paper"])
def test_what_moves_the_ground_is_the_image(angles: Angles) -> None:
    """The move on the ground: where the image's middle pixel meets the ellipsoid, before and after; and its sigma is
    the spread of that place over the orientation's covariance, drawn.
    """
    made = fan()
    adjustment = grown(made, 3, SolverSettings(angles=angles))
    before = {name: adjustment.correction(name) for name in adjustment.images}
    impact = take(adjustment, made, 3)
    rng = np.random.default_rng(4)
    for k, name in enumerate(impact.images.names[:2]):
        image = adjustment.store.image(name).image
        middle = np.array([0.5 * image.lines]), np.array([0.5 * image.samples])
        was, _ = image.image_to_ground(*middle, 0.0, before[name])
        now, _ = image.image_to_ground(*middle, 0.0, adjustment.correction(name))
        assert impact.images.on_ground[k] == pytest.approx(np.linalg.norm(now - was), rel=0.01, abs=0.01)
        correction, covariance = adjustment.correction(name), adjustment.covariance(name)
        drawn = rng.multivariate_normal(correction.coefficients.ravel(), covariance, 400, method="cholesky")
        corrections = [OrientationCorrection(one.reshape(-1, 6), angles) for one in drawn]
        places = [image.image_to_ground(*middle, 0.0, one)[0][0] for one in corrections]
        spread = float(np.sqrt(np.trace(np.cov(np.array(places).T))))
        assert impact.images.ground_after[k] == pytest.approx(spread, rel=0.15)  # four sigmas of 400 draws


def test_a_name_that_looks_like_markup_stays_text() -> None:
    odd = IncrementalAdjustment()
    image = replace(fan().images[0], name="<b>&")
    odd.add(KnownImage(image, NOISE.prior), ())
    html = odd.remove("<b>&")._repr_html_() + odd._repr_html_()
    assert "<b>&<" not in html


def test_saying_it_changes_nothing() -> None:
    """Asking for points or covariances moves nothing."""
    adjustment = grown(strip(), 5)
    before = state_of(adjustment), places_of(adjustment)
    adjustment.points([strip().ties.ids[0]])
    adjustment.covariance("STRIP/000N", "STRIP/003X")
    assert largest_difference(adjustment, before) == 0.0


# --- what a coefficient does to image places, against central differences

IMAGES = [*strip().images[:2], fan().images[1]]
STEPS = np.tile(np.repeat([1.0, 1e-5], 3), 3)


@pytest.mark.parametrize("angles", get_args(Angles))
@pytest.mark.parametrize("image", IMAGES, ids=lambda image: image.name)
def test_no_image_place_moves_faster_than_stated(image: PushbroomImage, angles: Angles) -> None:
    """At the corners and within, and the fastest moves about as fast as stated."""
    lines, samples = np.meshgrid(np.linspace(1.0, image.lines - 1.0, 5), np.linspace(1.0, image.samples - 1.0, 3))
    points, _ = image.image_to_ground(lines.ravel(), samples.ravel())
    stated = image_motion(KnownImage(image, NOISE.prior))

    def places(coefficients: np.ndarray) -> np.ndarray:
        return image.ground_to_image(points, OrientationCorrection(coefficients.reshape(-1, 6), angles))[0]

    speed = np.linalg.norm(differences(places, np.zeros(18), STEPS), axis=1)
    assert stated.shape == (18,)
    # the pixel's size on the ground along the track is its width to a tenth; ground nearer than the middle moves faster
    assert np.all(speed < 1.15 * stated)
    for kind in (slice(0, 3), slice(3, 6)):
        assert speed[:, kind].max() > 0.8 * stated[kind].max()


def test_an_image_that_looks_past_the_body_has_a_motion_and_no_ground() -> None:
    """Turned round: as fast as if the ground were where it would be below."""
    trajectory = IMAGES[0].trajectory
    away = replace(trajectory.camera, constant=np.diag([1.0, -1.0, -1.0]) @ trajectory.camera.constant)
    known = KnownImage(replace(IMAGES[0], trajectory=replace(trajectory, camera=away)), NOISE.prior)
    near = image_motion(KnownImage(IMAGES[0], NOISE.prior))
    assert np.all(np.isfinite(image_motion(known)))
    np.testing.assert_allclose(image_motion(known), near, rtol=0.1)
    assert not np.any(ground_motion(known, "camera"))

"""What jitter that is left does to heights: dense true correspondences, intersected with adjusted orientations.

Points of a regular grid of the first image are where its true rays meet the ground; the second image shows them at
their true places. So nothing but the orientations moves the intersections, and heights that ripple along the track
tell what is left of a vibration. A constant shift of the whole model is not counted: heights are compared at the same
ground points, as after coregistration.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mgsgraph.geometry.image import PushbroomImage
from mgsgraph.geometry.intersection import intersect_rays
from mgsgraph.geometry.orientation import OrientationCorrection
from mgsgraph.geometry.records import Array
from mgsgraph.simulation.ctx import SimulatedCtxPair, image_times
from mgsgraph.simulation.observations import well_inside
from mgsgraph.simulation.strip_truth import correction_at

_BAND = 0.25
"""Of the frequency, to either side, that counts as the ripple."""
_DEGREE = 3
"""Of the polynomial of time, of which the ripple is free."""


@dataclass(frozen=True, slots=True, eq=False)
class DenseTruth:
    """Correspondences of a pair without noise: r lines by c samples of the first image."""

    times: Array
    """(r,) s past the first image's epoch, of its lines."""
    first: Array
    """(n, 2) px, line and sample in the first image, of those that the second one shows, too."""
    second: Array
    """(n, 2) px in the second image."""
    points: Array
    """(n, 3) m, body-fixed, true."""
    row: Array
    """(n,) which of the lines."""


def dense_truth(pair: SimulatedCtxPair, line_step: int = 16, columns: int = 9) -> DenseTruth:
    """Correspondences every `line_step` lines, at so many samples (columns) of the first image."""
    first, second = pair.network.images
    lines = np.arange(0.5 * line_step, first.lines, line_step)
    samples = np.linspace(0.1, 0.9, columns) * first.samples
    grid = np.stack([one.ravel() for one in np.meshgrid(lines, samples, indexing="ij")], axis=1)
    points = pair.terrain.intersect(*first.sightlines(grid[:, 0], grid[:, 1], pair.corrections[0]))
    places = second.ground_to_image(points, pair.corrections[1])[0]
    seen = well_inside(second, places)
    row = np.repeat(np.arange(float(lines.size)), columns)
    return DenseTruth(first.timing.at(lines)[0], grid[seen], places[seen], points[seen], row[seen])


def height_errors(
    truth: DenseTruth, images: Sequence[PushbroomImage], corrections: Sequence[OrientationCorrection]
) -> Array:
    """(n,) m, intersections with some orientations less the true points, upwards."""
    sight = [
        image.sightlines(places[:, 0], places[:, 1], correction)
        for image, places, correction in zip(images, (truth.first, truth.second), corrections, strict=True)
    ]
    n = truth.points.shape[0]
    origins, directions = (np.concatenate([each[k] for each in sight]) for k in range(2))
    places, _, _ = intersect_rays(origins, directions, np.tile(np.arange(n), 2), n)
    up = truth.points / np.linalg.norm(truth.points, axis=1, keepdims=True)
    return np.asarray(np.einsum("ni,ni->n", places - truth.points, up))


def ripple(truth: DenseTruth, heights: Array, frequency: float) -> float:
    """Amplitude (m) of the ripple that height errors (n,) in m have along the track in a band about a frequency (Hz).

    Means over each line's samples, less a cubic polynomial of time; the root of twice the power in the band, so that a
    sine gives its amplitude.
    """
    row = truth.row.astype(np.int64)
    count = np.bincount(row, minlength=truth.times.size)
    there = count > 0
    times = truth.times[there]
    mean = np.bincount(row, heights, truth.times.size)[there] / count[there]
    u = 2.0 * (times - times[0]) / (times[-1] - times[0]) - 1.0
    slow = np.polynomial.legendre.legvander(u, _DEGREE)
    mean = mean - slow @ np.linalg.lstsq(slow, mean, rcond=None)[0]
    once = 1.0 / (times[-1] - times[0])
    band = np.arange(np.ceil((1.0 - _BAND) * frequency / once), np.floor((1.0 + _BAND) * frequency / once) + 1.0) * once
    phase = 2.0 * np.pi * band[:, None] * times
    amounts = 2.0 / times.size * np.stack([np.cos(phase) @ mean, np.sin(phase) @ mean])
    return float(np.sqrt(np.sum(amounts**2)))


def attitude_errors(
    pair: SimulatedCtxPair, corrections: Sequence[OrientationCorrection], number: int, count: int = 2000
) -> tuple[Array, Array]:
    """Times (n,) in s past the epoch, and by how much pitch and roll (n, 2) in rad of one image's adjusted orientation
    exceed the true ones.
    """
    image = pair.network.images[number]
    times = np.linspace(*image_times(image), count)
    found, true = (
        correction_at(one, times, image.trajectory.epoch) for one in (corrections[number], pair.corrections[number])
    )
    return times, (found - true)[:, [4, 3]]

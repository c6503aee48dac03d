"""Dense matches of two simulated images as the true ground has them."""

import numpy as np

from mgsgraph.geometry.image import PushbroomImage
from mgsgraph.matching.dense import DenseMatches
from mgsgraph.simulation.ground import SiteTerrain

_EDGE = 12.0
"""pixels from the edges of the first image, half a window, from which matches begin."""


def true_matches(
    terrain: SiteTerrain,
    first: PushbroomImage,
    second: PushbroomImage,
    step: float,
    noise: float,
    rng: np.random.Generator,
) -> DenseMatches:
    """Matches of two images as they were taken, `step` pixels apart in the first, with `noise` (pixels) in the second;
    the images are the first and second of their network.
    """
    lines, samples = np.meshgrid(
        np.arange(_EDGE, first.lines, step), np.arange(_EDGE, first.samples, step), indexing="ij"
    )
    anchors = np.column_stack([lines.ravel(), samples.ravel()]) + 0.5
    points = terrain.intersect(*first.sightlines(*anchors.T))
    pixels = second.ground_to_image(points)[0]
    visible = np.all((pixels > 0.5) & (pixels < np.array([second.lines, second.samples]) - 0.5), axis=1)
    count = int(visible.sum())
    spacing = float(np.linalg.norm(points[1] - points[0]))
    covariances = np.broadcast_to(noise**2 * np.eye(2), (count, 2, 2))
    drawn = pixels[visible] + rng.normal(0.0, noise, (count, 2))
    return DenseMatches(0, 1, spacing, anchors.shape[0], anchors[visible], drawn, covariances, np.full(count, 0.9))

"""
Questions to the covariance
===========================

The covariance of all unknowns is kept, so that anything may be asked afterwards: :doc:`/analysis`.
"""

from mgsgraph import Adjustment, KnownImage, Pixel, Posterior
from mgsgraph.network.observations import observed
from mgsgraph.simulation.pair import simulate_pair

pair = simulate_pair(seed=1)
images = {one.name: KnownImage(one, pair.settings.noise.prior) for one in pair.images}
network = observed(images, [pair.ties, pair.laser], shot_sigma=pair.settings.noise.shot_image)
solution = Adjustment.batch(network)
posterior = Posterior.of(solution)

# %%
# A point that was not in the adjustment, measured to half a pixel in both images; and whether the height between two
# tie points is a real difference.
first, second = (image.name for image in pair.images)
ground = pair.true_ties[0]
places = [
    image.ground_to_image(ground[None], correction)[0][0]
    for image, correction in zip(pair.images, pair.true_corrections, strict=True)
]
new = [Pixel(name, *place, 0.5) for name, place in zip((first, second), places, strict=True)]
print(posterior.intersection(new, "a new point"))
print(posterior.difference(*solution.network.points.ids[:2]).sentence)

# %%
# How well position and pointing of one image are known along its lines.
import numpy as np

from mgsgraph.results.figures.sigmas import curve_sheet, raster_sheet

curve = curve_sheet(posterior.poses(first, np.linspace(0.0, pair.images[0].lines, 41)), "curve")

# %%
# And the sigmas that points measured to half a pixel would have anywhere on the ground that both images show.
from mgsgraph.analysis.overlap_sigmas import sigma_grid

raster = raster_sheet(sigma_grid(posterior, cell=300.0, sigma=0.5), "sigmas")

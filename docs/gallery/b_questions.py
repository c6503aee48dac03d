"""
Questions to the covariance
===========================

The covariance of all unknowns is kept, so that anything may be asked afterwards: :doc:`/analysis`.
"""

from mgsgraph import KnownImage, Pixel, Posterior, adjust_network, build_network
from mgsgraph.simulation import simulate_pair

pair = simulate_pair(seed=1)
images = {one.name: KnownImage(one, pair.settings.noise.prior) for one in pair.images}
network = build_network(images, [pair.ties, pair.laser], shot_sigma=pair.settings.noise.shot_image)
solution = adjust_network(network)
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
# The sigmas that points measured to half a pixel would have anywhere on the ground that both images show.
from mgsgraph import sigma_grid
from mgsgraph.results.figures.analysis import raster_sheet

raster = raster_sheet(sigma_grid(posterior, cell=300.0, sigma=0.5), "sigmas")

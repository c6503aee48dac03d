"""
A stereo pair
=============

Two images of the same ground, one looking down, one 20 degrees aside, with 150 tie points and 60 laser ranges. Their
true orientation differs from the nominal one by what the prior says; everything observed carries the noise that is
stated.
"""

from mgsgraph import KnownImage, adjust_network, build_network
from mgsgraph.simulation import simulate_pair

pair = simulate_pair(seed=1)
images = {one.name: KnownImage(one, pair.settings.noise.prior) for one in pair.images}
network = build_network(images, [pair.ties, pair.laser], shot_sigma=pair.settings.noise.shot_image)
solution = adjust_network(network)
print(solution)

# %%
# Where everything lies, and how well the tie points are known.
from mgsgraph.results.figures.map import map_sheets

ground_map = next(map_sheets(solution))

# %%
# What is left of every measure after the adjustment, magnified. No pattern, no image that differs from the other: that
# is how it should look.
from mgsgraph.results.figures.residuals import residual_sheets

residuals = list(residual_sheets(solution))

# %%
# By what the orientation had to be corrected along the images, with the sigma of the correction.
from mgsgraph.results.figures.orientation import orientation_sheets

orientation = list(orientation_sheets(solution))

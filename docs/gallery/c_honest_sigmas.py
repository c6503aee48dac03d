"""
Are the sigmas honest?
======================

The tie points of this pair scatter by one pixel, but we state two. Do the residuals tell?
"""

from dataclasses import replace

from mgsgraph import KnownImage, adjust_network, build_network, components
from mgsgraph.simulation import simulate_pair

pair = simulate_pair(seed=3)
images = {one.name: KnownImage(one, pair.settings.noise.prior) for one in pair.images}
stated = replace(pair.ties, measure_sigmas=2.0 * pair.ties.measure_sigmas)
network = build_network(images, [stated, pair.laser], shot_sigma=pair.settings.noise.shot_image)
solution = adjust_network(network)
print(components(solution))

# %%
# The same in one picture for each group: normalised residuals against the law that they should follow. Where sigmas are
# too large they lie flatter than the line.
from mgsgraph.analysis.residual_tests import residual_statistics
from mgsgraph.results.figures.analysis import quantile_sheet

quantiles = quantile_sheet(residual_statistics(solution), solution.name)

"""
An analysis
===========

What :doc:`/analysis` asks of a result, in Python: what the adjustment cannot explain, whether the sigmas are honest,
what may be a blunder, what is weak. One measure of this pair is off by eight pixels, which nobody knows beforehand.
"""

from dataclasses import replace

from mgsgraph import KnownImage, Posterior, adjust_network, build_network
from mgsgraph.simulation import simulate_pair

pair = simulate_pair(seed=5)
measures = pair.ties.measures.copy()
measures[40, 0] += 8.0
ties = replace(pair.ties, measures=measures)
images = {one.name: KnownImage(one, pair.settings.noise.prior) for one in pair.images}
solution = adjust_network(build_network(images, [ties, pair.laser], shot_sigma=pair.settings.noise.shot_image))
linearised = Posterior.of(solution).linearised
print(solution)

# %%
# What may be a blunder: w-tests and minimal detectable errors of every measure, the most suspicious first.
from mgsgraph import reliability
from mgsgraph.results.analysis import reliability_section

found = reliability(linearised)
print(reliability_section(found, 3).text())

# %%
# Are the sigmas of each group honest?
from mgsgraph import components

print(components(linearised))

# %%
# The same as a picture: on the line the sigmas are honest, steeper they are too small.
from mgsgraph.analysis.residual_tests import residual_statistics
from mgsgraph.results.figures.analysis import quantile_sheet

quantiles = quantile_sheet(residual_statistics(solution), solution.name)

# %%
# Least-constrained directions: the posterior sigma is nearly the prior sigma.
from mgsgraph import weak_directions

print(*(one.sentence for one in weak_directions(solution, 3)), sep="\n")

# %%
# Is there anything that the adjustment cannot explain, with its size and the key of the case file that takes it in?
from mgsgraph.analysis.unexplained import unexplained

print(*unexplained(linearised).sentences, sep="\n")

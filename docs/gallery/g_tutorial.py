"""
The tutorial in Python
======================

Gusev Crater as in :doc:`/tutorial`, without the registration by relief: files as an archive would give them, the
adjustment, the figures, the first questions. It can be downloaded as a notebook below.
"""

from pathlib import Path
from tempfile import mkdtemp

import mgsgraph
from mgsgraph.simulation import SimulationOptions, simulate_site, write_site

folder = Path(mkdtemp())
case_file = write_site(simulate_site("gusev", 1, SimulationOptions(pictures=False)), folder)
print(*sorted(path.name for path in folder.iterdir()))

# %%
# Read the case and adjust it. What is printed says first whether it converged, then how well everything fits.
from mgsgraph.results.results import statements, summary_table

case = mgsgraph.read_case(case_file)
solution = mgsgraph.adjust(case)
print(summary_table(solution))

# %%
# The same sentences as the command prints.
print(*statements(solution), sep="\n")

# %%
# Where everything lies: outlines, tie points by their sigma, laser points. Look for holes.
from mgsgraph.results.figures.map import map_sheets

ground_map = next(map_sheets(solution))

# %%
# What is left of every measure. A pattern would mean that the model lacks something.
from mgsgraph.results.figures.residuals import residual_sheets

residuals = list(residual_sheets(solution))

# %%
# Questions to the covariance: a point, and whether the height between two points is real.
posterior = mgsgraph.Posterior.of(solution)
first, second = solution.network.points.ids[:2]
print(posterior.point(first))
print(posterior.difference(first, second).sentence)

"""
Laser profile and images
========================

Gusev Crater with kernels as wrong as the papers found them, MOLA profiles, MOC labels. At the MOLA footprints the two
images contradict each other by 230 m along the flight before the adjustment.
"""

from pathlib import Path
from tempfile import mkdtemp

import mgsgraph
from mgsgraph.simulation import SimulationOptions, simulate_site, write_site

site = simulate_site("gusev", 1, SimulationOptions("published", pictures=False))
case = mgsgraph.read_case(write_site(site, Path(mkdtemp())))
solution = mgsgraph.adjust(case)
print(solution)

# %%
# Each footprint projected into the second image, minus where the first one and the tie points have it.
from mgsgraph.registration.case import register_case
from mgsgraph.results.figures.registration import discrepancy_sheets

discrepancies = list(discrepancy_sheets(register_case(case, solution)))

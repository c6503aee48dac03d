"""
Strips of HRSC
==============

Two strips of 100 km, five lines of the camera each; orientation is unknown at nodes every 10 s and follows in between:
:doc:`/strips`.
"""

from mgsgraph import SolverSettings, adjust_network, pass_reports
from mgsgraph.results.figures.orientation import orientation_sheets
from mgsgraph.simulation import BlockSettings, simulate_hrsc_block

block = simulate_hrsc_block(BlockSettings(strips=2, length=100e3, points=300, terrain=None), seed=1)
solution = adjust_network(block.network, SolverSettings(), "two strips")
for one in pass_reports(solution):
    print(f"{one.name}: {one.nodes} nodes, {one.ground / 1e3:.0f} km apart")

# %%
# Corrections of the nominal trajectory over time, with their sigmas; marks are the nodes.
sheets = list(orientation_sheets(solution))

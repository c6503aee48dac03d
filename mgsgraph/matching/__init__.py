"""Tie points from the images themselves: from orientation and terrain to measured pixels with covariances.

scene has the common ground grid, a plane about the scene's middle, along the flight, and the images with pixels and
orientation over a ground; patches are pictures resampled onto tiles of the grid. tiles finds what belongs together
within a window, at features (SIFT) or at the nodes of a regular grid (correlation), tile by tile, and keeps it. coarse
brings the nominal orientations together before; pairs are joined to tracks over images; measuring and least_squares
(window, equations and influences are its kernel) find sub-pixel positions with covariances; checks are what these must
stand; match is all of it. dense matches every post of a regular grid once the orientations are adjusted.
"""

from pathlib import Path

from mgsgraph.compiled import find_a_place_for_compiled_kernels

find_a_place_for_compiled_kernels(Path(__file__).parent)

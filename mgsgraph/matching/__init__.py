"""Tie points from the images themselves: from orientation and terrain to measured pixels with covariances.

scene has the common ground grid, a plane about the scene's middle, along the flight, and the images with pixels and
orientation over a ground; patches are pictures resampled onto tiles of the grid. features (SIFT) or correlation (a
regular grid) find what belongs together within a window, tiles is that work on one tile, and where it is kept. coarse
and relative bring the nominal orientations together before; pairs are joined to tracks over images; measuring and
least_squares (window, equations and influences are its kernel) find sub-pixel positions with covariances; checks are
what these must stand; match is all of it.
"""

from pathlib import Path

from mgsgraph.compiled import find_a_place_for_compiled_kernels

find_a_place_for_compiled_kernels(Path(__file__).parent)

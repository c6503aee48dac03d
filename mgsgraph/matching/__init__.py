"""Tie points from the images themselves: from orientation and terrain to measured pixels with covariances.

scene has the images with pixels and orientation over a ground, the common ground grid (a plane about the scene's
middle, along the flight), and the pairs of images that share ground, joined to tracks over images. patches resamples
pictures onto tiles of the grid and finds features that belong together within a window, tile by tile. coarse brings the
nominal orientations together before; measuring and least_squares (window and equations are its kernel) find sub-pixel
positions with covariances; checks are what these must stand; match is all of it. dense matches every post of a regular
grid once the orientations are adjusted.
"""

from pathlib import Path

from mgsgraph.compiled import find_a_place_for_compiled_kernels

find_a_place_for_compiled_kernels(Path(__file__).parent)

"""Terrain models from dense matches: a grid of heights with sigmas, an ortho image, and laser shots to check them by.

points are the matches' rays intersected, with what matching and what orientation makes of their covariance; map is the
plane that is north up, and its posts; gridding (surface is its kernel) fits the posts; ortho lays the first image on
them; checking compares heights with shots that took no part; model is these together, rasters and record its files;
production is the whole way, from a solution and its case.
"""

from pathlib import Path

from mgsgraph.compiled import find_a_place_for_compiled_kernels

find_a_place_for_compiled_kernels(Path(__file__).parent)

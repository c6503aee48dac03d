"""
Tie points from the images
==========================

The first 640 lines of both images of the Gusev pair, with pixels, over a terrain model that lies 140 m beside the
ground; :doc:`/matching`.
"""

from dataclasses import replace

import numpy as np

from mgsgraph import MatchSettings, OrientationPrior
from mgsgraph.matching.match import match_scene
from mgsgraph.matching.scene import Ground, GroundChart, Picture, Scene
from mgsgraph.simulation import SimulationOptions, simulate_site
from mgsgraph.simulation.imagery import render
from mgsgraph.units import ARCMIN

LINES, HEIGHT = 640, -2580.0
site = simulate_site("gusev", 1, SimulationOptions(pictures=False))
pictures, corners = [], []
for seed, image in enumerate(site.images):
    true = replace(image.true, lines=LINES)
    pixels = render(true, site.terrain, None, image.sun, np.random.default_rng(seed))
    metres = 100.0 * (seed + 1)
    sigmas = np.outer([1.0, 0.1, 0.01], [metres] * 3 + [metres / 100.0 * ARCMIN] * 3)
    pictures.append(Picture(replace(image.nominal, lines=LINES), pixels, OrientationPrior(sigmas)))
    lines, samples = np.meshgrid([0.0, LINES], [0.0, float(true.samples)])
    corners.append(true.image_to_ground(lines.ravel(), samples.ravel(), HEIGHT)[0])
places = np.concatenate(corners)
first = pictures[0].image
chart = GroundChart.about(places, first.pose(np.array([0.5 * LINES])).velocity[0])
scene = Scene(tuple(pictures), Ground(chart, first.body, HEIGHT, 100.0, site.grid.around(places)))

matches = match_scene(scene, MatchSettings(cells=60, features=2500))
print(matches)
print(matches.losses)

# %%
# Where they are, how far the nominal orientations were apart, and what sigmas they have.
from mgsgraph.results.figures.matches import matches_sheet

sheet = matches_sheet(matches, scene, "Gusev, 640 lines")

# %%
# Some of them as chips: the same ground in the one image and in the other, both turned and stretched to the ground's
# directions.
from mgsgraph.matching.chips import chip_frames, chips, stretched
from mgsgraph.results.figures.sheet import new_sheet

ties = matches.ties
frames = chip_frames([picture.image for picture in pictures], ties)
chosen = np.linspace(0, len(ties.ids) - 1, 8).astype(int)[1:-1]
caption = "Upper row: the image that looks down; lower row: the one that looks aside."
pairs = new_sheet("chips", 9.0, 3.4, "Six matches", caption, band=0.0)
grid = pairs.panels(2, 6)
for row, picture in enumerate(pictures):
    of_image = np.array(ties.measure_image) == picture.image.name
    for column, point in enumerate(chosen):
        (measure,) = np.flatnonzero(of_image & (ties.measure_point == point))
        patch = chips(picture.pixels, ties.measures[[measure]], frames.step[[measure]])
        panel = grid[row, column]
        panel.imshow(stretched(patch)[0], cmap="gray")
        panel.set_axis_off()
        if row == 0:
            panel.set_title(ties.ids[point][-6:])

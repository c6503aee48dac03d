"""Made-up observations with known truth, written through the formats of real ones: the demo's default input.

What is simulated, from small to large: a stereo `pair`, a `strip` of overlapping pairs (image by image in
`strip_steps`), a study `site` (published numbers in `sites`), all `three_sites` in one campaign, and blocks of HRSC
strips (`hrsc_block`, from passes in `hrsc_flight`, points in `hrsc_points`, true orientation in `strip_truth`); and an
`archive` of up to a hundred thousand images (ties in `archive_ties`, files in `archive_files` and `archive_network`).

What all of them are made of:

* `mars`: size, gravity, rotation; `orbit`: position and attitude of the spacecraft; `camera`: interior orientation,
  line times, errors of the instruments;
* `ground`: height and brightness of the true ground, with its `relief`; `terrain`: grids of it as MOLA's are;
  `imagery`: pictures of it;
* `observations`: sigmas, tie points, laser shots; `true_image`: fast projection into an image as it was truly taken;
* `files`: all of it written. The formats are in `isis_files`, `mgs_files`, `mola_files`, `spice_files`, `case_files`.

Networks drawn anew and archives to fetch from serve tests and scripts alone: `tests/redraw.py`,
`tests/simulated_archive.py`.
"""

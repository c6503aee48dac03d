"""Made-up observations with known truth, written through the formats of real ones: the demo's default input.

What is simulated, from small to large: a stereo `pair`, a `strip` of overlapping pairs, a study `site` (published
numbers in `sites` and ``data/sites.toml``) and three of them in one campaign; two cameras on one spacecraft (`rig`),
a `ctx` pair with jitter, blocks of HRSC strips (`hrsc_block`, from passes in `hrsc_flight`); and an `archive` of up to
a hundred thousand images (ties in `archive_ties`, files in `archive_files`).

What all of them are made of:

* `orbit`: Mars, the Moon, position and attitude of the spacecraft; `camera`: interior orientation, line times, errors
  of the instruments;
* `ground`: height and brightness of the true ground, with its `relief`, and grids of it as MOLA's are; `imagery`:
  pictures of it;
* `observations`: sigmas, tie points, laser shots, terrain models; projection into images as they were truly taken;
* `files`: all of it written. The formats are in `mgs_files`, `mola_files`, `spice_files`, `case_files`; labels and text
  kernels lie in ``data``, with places for values.

Networks drawn anew and archives to fetch from serve tests and scripts alone: `tests/redraw.py`,
`tests/flaky_archive.py`.
"""

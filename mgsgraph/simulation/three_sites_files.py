"""Old address of `files.write_three_sites`; goes when `products/` imports it from there."""

from mgsgraph.simulation.files import write_three_sites as write_three_sites

"""Old address of `files.write_strip`; goes when `products/` imports it from there."""

from mgsgraph.simulation.files import write_strip as write_strip

"""Old address of `files.write_site` and `mgs_files.shot_names`; goes when `products/` imports them from there."""

from mgsgraph.simulation.files import write_site as write_site
from mgsgraph.simulation.mgs_files import shot_names as shot_names

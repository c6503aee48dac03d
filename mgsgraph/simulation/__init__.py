"""Simulated observations with known truth, written through the formats of real ones: the demo's default input.

What is simulated, from small to large: a stereo `pair`, a `strip` of overlapping pairs, a study `site` (published
numbers in `sites` and ``data/sites.toml``) and three of them in one campaign; and an `archive` of up to a hundred
thousand images (ties in `archive_ties`, files in `archive_files`).

What all of them are made of:

* `orbit`: Mars, the Moon, position and attitude of the spacecraft; `camera`: interior orientation, line times, errors
  of the instruments;
* `ground`: height and brightness of the true ground, with its `relief`, and grids of it as MOLA's are; `imagery`:
  pictures of it;
* `observations`: sigmas, tie points, laser shots, terrain models; projection into images as they were truly taken;
* `files`: all of it written. The formats are in `mgs_files`, `mola_files`, `spice_files`, `case_files`; labels and text
  kernels lie in ``data``, with places for values.

Names of the package itself, imported on first use: the settings and functions in `__all__`.

Networks drawn anew, archives to fetch from, a CTX pair with jitter, passes of LROC's two cameras and blocks of HRSC
passes serve tests and scripts alone: `tests/redraw.py`, `tests/flaky_archive.py`, `tests/ctx_pair.py`,
`tests/nac_pair.py`, `tests/mex_block.py`.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from mgsgraph import modules_of_names

if TYPE_CHECKING:
    from mgsgraph.simulation.files import write_pair as write_pair
    from mgsgraph.simulation.files import write_site as write_site
    from mgsgraph.simulation.pair import PairSettings as PairSettings
    from mgsgraph.simulation.pair import simulate_pair as simulate_pair
    from mgsgraph.simulation.site import SimulationOptions as SimulationOptions
    from mgsgraph.simulation.site import simulate_site as simulate_site
    from mgsgraph.simulation.strip import StripSettings as StripSettings
    from mgsgraph.simulation.strip import simulate_strip as simulate_strip

_HOME = modules_of_names(__file__)
__all__ = sorted(_HOME)


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}; it has {', '.join(__all__)}")
    return getattr(import_module(_HOME[name]), name)

"""What `mgsgraph simulate` offers: study sites and campaigns, in a folder that is there whole or not at all."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TypeVar

from mgsgraph.demo.demo import PAIR, site_options
from mgsgraph.errors import InputError
from mgsgraph.output.folders import fresh_folder
from mgsgraph.simulation.files import write_pair, write_site, write_strip, write_three_sites
from mgsgraph.simulation.pair import simulate_pair
from mgsgraph.simulation.site import SimulationOptions, simulate_site
from mgsgraph.simulation.sites import SITE_NAMES
from mgsgraph.simulation.strip import StripSettings, simulate_strip
from mgsgraph.simulation.three_sites import simulate_three_sites
from mgsgraph.stages import Stages

STRIP = "strip"
"""A strip of overlapping pairs."""
THREE_SITES = "three-sites"
"""The study sites together, held by a bridge image."""

_CAMPAIGNS = (STRIP, THREE_SITES)
"""What is simulated but not demonstrated."""
_T = TypeVar("_T")


@dataclass(frozen=True, slots=True)
class StripOptions:
    """What of a strip may be said on the command line."""

    settings: StripSettings
    """The strip."""
    steps: bool = False
    """Write what each image adds, too."""


def simulation_options(site: str, attitude_time_bias: float | None = None, pictures: bool = True) -> SimulationOptions:
    """Options of a simulation that is only written; InputError unless there is such a site, and it can have them."""
    if site not in (*SITE_NAMES, PAIR, *_CAMPAIGNS):
        raise InputError("site", repr(site), f"{', '.join((*SITE_NAMES, PAIR, STRIP))} or {THREE_SITES}")
    if site not in _CAMPAIGNS:
        return site_options(site, attitude_time_bias, pictures)
    if attitude_time_bias is not None:
        raise InputError("attitude time bias", f"given for {site}", "a study site", f"take {' or '.join(SITE_NAMES)}")
    return SimulationOptions(pictures=pictures)


def strip_options(site: str, images: int | None, ties: int | None, steps: bool) -> StripOptions | None:
    """Options of a strip, None for any other site; InputError where another site is given any."""
    if site == STRIP:
        usual = StripSettings()
        settings = StripSettings(usual.images if images is None else images, usual.ties if ties is None else ties)
        return StripOptions(settings, steps)
    for name, given in (("images", images is not None), ("ties", ties is not None), ("steps", steps)):
        if given:
            raise InputError(name, f"given for {site}", f"the site {STRIP}", "leave it out")
    return None


def write_simulation(
    site: str,
    folder: Path,
    seed: int = 1,
    options: SimulationOptions | None = None,
    stages: Stages | None = None,
    strip: StripOptions | None = None,
) -> Path:
    """Simulate a study site or a campaign, and write its files to a folder that is absent or empty; where the case is.

    Raises
    ------
    InputError
        If there is no such site, or the folder holds anything.
    """
    chosen = strip or StripOptions(StripSettings())
    with fresh_folder(folder, "truth.json") as aside:
        write = partial(_written, folder=aside, stages=stages or Stages())
        if site == PAIR:
            path = write(partial(simulate_pair, seed=seed), write_pair)
        elif site == STRIP:
            path = write(partial(simulate_strip, chosen.settings, seed), partial(write_strip, steps=chosen.steps))
        elif site == THREE_SITES:
            path = write(partial(simulate_three_sites, seed, options), write_three_sites)
        else:
            path = write(partial(simulate_site, site, seed, options), write_site)
        return folder / path.name


def _written(simulate: Callable[[], _T], write: Callable[[_T, Path], Path], folder: Path, stages: Stages) -> Path:
    """Simulate and write, each booked as a stage; where the case is."""
    with stages.stage("simulating"):
        simulated = simulate()
    with stages.stage("writing"):
        return write(simulated, folder)

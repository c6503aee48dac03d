"""What `mgsgraph simulate` offers: study sites and campaigns, in a folder that is there whole or not at all."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

from mgsgraph.errors import InputError
from mgsgraph.files.output.folders import fresh_folder
from mgsgraph.progress import Stages
from mgsgraph.simulation.archive import ARCHIVE_KINDS, ArchiveSettings, archive_settings, lay_out
from mgsgraph.simulation.archive_files import write_archive
from mgsgraph.simulation.files import write_pair, write_site, write_strip, write_three_sites
from mgsgraph.simulation.pair import simulate_pair
from mgsgraph.simulation.site import SimulationOptions, simulate_site
from mgsgraph.simulation.sites import SITE_NAMES
from mgsgraph.simulation.strip import StripSettings, simulate_strip
from mgsgraph.simulation.three_sites import simulate_three_sites
from mgsgraph.simulation.world import EFFECTS, STRIP_EFFECTS, World

PAIR = "pair"
"""The small pair of synthetic images, beside the study sites."""
STRIP = "strip"
"""A strip of overlapping pairs."""
ARCHIVE = "archive"
"""As many images as are adjusted as a whole."""
THREE_SITES = "three-sites"
"""The study sites together, held by a bridge image."""
DEMONSTRATED = (*SITE_NAMES, PAIR)
"""What `mgsgraph demo` knows."""
SIMULATED = (*DEMONSTRATED, STRIP, THREE_SITES, ARCHIVE)
"""What `mgsgraph simulate` knows."""

_T = TypeVar("_T")


def simulation_options(
    site: str,
    attitude_time_bias: float | None = None,
    pictures: bool = True,
    known: Sequence[str] = SIMULATED,
    effects: str | None = None,
) -> SimulationOptions:
    """Options of a simulation; InputError unless the site is among the `known` ones, and can have them. `effects` are
    those of `World`, with commas between, or "all".
    """
    if site not in known:
        raise InputError("site", repr(site), f"{', '.join(known[:-1])} or {known[-1]}")
    if site not in SITE_NAMES and attitude_time_bias is not None:
        raise InputError("attitude time bias", f"given for {site}", "a study site", f"take {' or '.join(SITE_NAMES)}")
    able = STRIP_EFFECTS if site == STRIP else EFFECTS if site in SITE_NAMES else ()
    expected = f"one of {', '.join(able)}" if able else "a site or a strip"
    world = World.of(able if effects == "all" else effects.split(",") if effects is not None else ())
    for name in world.effects:
        if name not in able:
            raise InputError("world", f"{name!r} for {site}", expected, "leave it out")
    return SimulationOptions(attitude_time_bias=attitude_time_bias, pictures=pictures, world=world)


def strip_settings(site: str, images: int | None, ties: int | None, steps: bool, world: World) -> StripSettings:
    """Settings of a strip, the default ones of what isn't given; InputError where another site is given any."""
    given: dict[str, Any] = {name: value for name, value in (("images", images), ("ties", ties)) if value is not None}
    for name in (*(given if site != ARCHIVE else ()), *(["steps"] if steps else [])) if site != STRIP else ():
        raise InputError(name, f"given for {site}", f"the site {STRIP}", "leave it out")
    return replace(StripSettings(), world=world, **given) if site == STRIP else StripSettings()


def chosen_archive(site: str, kind: str | None, images: int | None, ties: int | None) -> ArchiveSettings | None:
    """Settings of an archive of a kind, the default ones of what isn't given; None for another site, and InputError
    where that is given a kind.
    """
    if site == ARCHIVE:
        return archive_settings(kind or ARCHIVE_KINDS[0], images, ties)
    if kind is not None:
        raise InputError("kind", f"given for {site}", f"the site {ARCHIVE}", "leave it out")
    return None


def write_simulation(
    site: str,
    folder: Path,
    seed: int,
    options: SimulationOptions,
    strip: StripSettings,
    steps: bool,
    stages: Stages,
    archive: ArchiveSettings | None = None,
) -> Path:
    """Simulate a study site or a campaign, and write its files to a folder that is absent or empty; the case's path.

    Of a strip, `steps` says whether what each image adds is written, too; `archive` are the settings of one. InputError
    if the folder holds anything.
    """
    with fresh_folder(folder, "truth.json") as aside:
        write = partial(simulated_files, folder=aside, stages=stages)
        if site == PAIR:
            _, path = write(partial(simulate_pair, seed=seed), write_pair)
        elif site == STRIP:
            _, path = write(partial(simulate_strip, strip, seed), partial(write_strip, steps=steps))
        elif archive is not None:
            _, path = write(partial(lay_out, archive, seed), partial(write_archive, progress=stages.detail))
        elif site == THREE_SITES:
            _, path = write(partial(simulate_three_sites, seed, options), write_three_sites)
        else:
            _, path = write(partial(simulate_site, site, seed, options), write_site)
        return folder / path.name


def simulated_files(
    simulate: Callable[[], _T], write: Callable[[_T, Path], Path], folder: Path, stages: Stages
) -> tuple[_T, Path]:
    """Simulate and write, each booked as a stage; what was simulated, and the path of its case."""
    with stages.stage("simulating"):
        simulated = simulate()
    with stages.stage("writing"):
        return simulated, write(simulated, folder)

"""The main job on a simulated study site: simulate, adjust with ties and ranges, register by relief, and compare with
the truth.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

from mgsgraph.adjustment.solution import Solution
from mgsgraph.case.reading import Case, adjust, read_case
from mgsgraph.errors import InputError
from mgsgraph.geometry.records import Array
from mgsgraph.matching.patches import has_opencv
from mgsgraph.registration.case import CaseRegistration, register_case
from mgsgraph.registration.minima import ReliefRegistration
from mgsgraph.registration.relief import register_by_relief
from mgsgraph.simulation.archive import ARCHIVE_KINDS, archive_settings, lay_out
from mgsgraph.simulation.archive_files import write_archive
from mgsgraph.simulation.demo.truth import (
    BY_RELIEF,
    KERNELS,
    TIES,
    Disagreement,
    disagreements,
    true_shots,
)
from mgsgraph.simulation.files import write_pair, write_site, write_strip, write_three_sites
from mgsgraph.simulation.pair import SimulatedPair, simulate_pair
from mgsgraph.simulation.site import SimulatedSite, SimulationOptions, simulate_site, simulate_three_sites
from mgsgraph.simulation.sites import SITE_NAMES
from mgsgraph.simulation.strip import StripSettings, simulate_strip
from mgsgraph.workers import Progress, Stages, no_progress

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

_OPTIONS = {STRIP: ("images", "ties", "steps"), ARCHIVE: ("kind", "images", "ties")}
"""What campaigns can be asked for."""
_T = TypeVar("_T")


def simulation(
    site: str,
    seed: int,
    attitude_time_bias: float | None = None,
    pictures: bool = True,
    kind: str | None = None,
    images: int | None = None,
    ties: int | None = None,
    steps: bool = False,
    progress: Progress = no_progress,
) -> tuple[Callable[[], Any], Callable[[Any, Path], Path]]:
    """How a study site or a campaign is simulated, and how it is written to a folder; `steps` says whether what each
    image of a strip adds is written, too. InputError where there is no such site, or it can't have an option.
    """
    options = simulation_options(site, attitude_time_bias, pictures)
    given = {"kind": kind, "images": images, "ties": ties, "steps": steps or None}
    for name, value in given.items():
        if value is not None and name not in _OPTIONS.get(site, ()):
            owner = next(one for one, names in _OPTIONS.items() if name in names)
            raise InputError(name, f"given for {site}", f"the site {owner}", "leave it out")
    if site == STRIP:
        numbers: dict[str, Any] = {name: n for name, n in (("images", images), ("ties", ties)) if n is not None}
        return partial(simulate_strip, StripSettings(**numbers), seed), partial(write_strip, steps=steps)
    if site == ARCHIVE:
        settings = archive_settings(kind or ARCHIVE_KINDS[0], images, ties)
        return partial(lay_out, settings, seed), partial(write_archive, progress=progress)
    if site == PAIR:
        return partial(simulate_pair, seed=seed), write_pair
    if site == THREE_SITES:
        return partial(simulate_three_sites, seed, options), write_three_sites
    return partial(simulate_site, site, seed, options), write_site


def simulation_options(
    site: str, attitude_time_bias: float | None = None, pictures: bool = True, known: Sequence[str] = SIMULATED
) -> SimulationOptions:
    """Options of a study site's simulation; InputError unless the site is among the `known` ones, and can have them."""
    if site not in known:
        raise InputError("site", repr(site), f"{', '.join(known[:-1])} or {known[-1]}")
    if site not in SITE_NAMES and attitude_time_bias is not None:
        raise InputError("attitude time bias", f"given for {site}", "a study site", f"take {' or '.join(SITE_NAMES)}")
    return SimulationOptions(attitude_time_bias=attitude_time_bias, pictures=pictures)


def simulated_files(
    simulate: Callable[[], _T], write: Callable[[_T, Path], Path], folder: Path, stages: Stages
) -> tuple[_T, Path]:
    """Simulate and write, each booked as a stage; what was simulated, and the path of its case."""
    with stages.stage("simulating"):
        simulated = simulate()
    with stages.stage("writing"):
        return simulated, write(simulated, folder)



INPUTS = "inputs"
"""Folder of the simulated files in the demo's results."""
DRAWING = "tables and figures"
"""Name of the last stage."""
RELIEF = "registering by relief"
"""Name of the stage that may be left out."""
STAGES = ("simulating", "writing", "reading", "adjusting", RELIEF, "comparing", DRAWING)
"""Stages of a demo, in their order."""


@dataclass(frozen=True, slots=True, eq=False)
class Demonstration:
    """A simulated site, adjusted, and how it compares with the truth."""

    simulated: SimulatedSite
    """Inputs and truth."""
    case: Case
    """The inputs as read from their files."""
    adjusted: Solution
    """What the adjustment of ties and ranges made of them."""
    relief: ReliefRegistration | str
    """What registration by relief made of that; or why it was left out."""
    registration: CaseRegistration
    """Footprints in images before and after."""
    disagreements: tuple[Disagreement, ...]
    """Between footprints and images, against the truth, after each step."""
    stages: Stages
    """Seconds that it took."""

    @property
    def solution(self) -> Solution:
        """What the last step made of it."""
        return self.adjusted if isinstance(self.relief, str) else self.relief.solution

    def __repr__(self) -> str:
        return f"Demonstration({self.simulated!r}; {self.solution!r})"


def demonstrate_pair(
    folder: Path, seed: int = 1, adjusting: Callable[[Case], Solution] = adjust, stages: Stages | None = None
) -> tuple[SimulatedPair, Solution]:
    """Simulate the pair, write its files to `folder`, read them back and adjust them."""
    stages = stages or Stages()
    pair, path = simulated_files(partial(simulate_pair, seed=seed), write_pair, folder, stages)
    with stages.stage("reading"):
        case = read_case(path)
    with stages.stage("adjusting"):
        return pair, adjusting(case)


def demonstrate(
    site: str,
    folder: Path,
    seed: int = 1,
    options: SimulationOptions | None = None,
    adjusting: Callable[[Case], Solution] = adjust,
    stages: Stages | None = None,
    relief: bool = True,
) -> Demonstration:
    """Simulate a study site, write its files to `folder`, read them back, adjust, register by relief, and compare.

    Parameters
    ----------
    site : str
        ``eos``, ``gusev`` or ``isidis``.
    folder : Path
        For the simulated files.
    seed : int
        Of the simulation.
    options : SimulationOptions, optional
        What differs from the published site.
    adjusting : callable
        Solution of a case; shows its progress, where wanted.
    stages : Stages, optional
        Books the seconds.
    relief : bool
        False leaves the registration by relief out, as does an installation without OpenCV.
    """
    stages = stages or Stages()
    simulated, path = simulated_files(partial(simulate_site, site, seed, options), write_site, folder, stages)
    with stages.stage("reading"):
        case = _named_from(read_case(path), folder)
    with stages.stage("adjusting"):
        adjusted = adjusting(case)
    found = _registered_by_relief(case, adjusted, stages) if relief else "not asked for (--no-relief)"
    steps: list[tuple[str, Solution | None]] = [(KERNELS, None), (TIES, adjusted)]
    steps += [] if isinstance(found, str) else [(BY_RELIEF, found.solution)]
    solution = steps[-1][1] or adjusted
    with stages.stage("comparing"):
        registration = register_case(case, solution)
        apart = disagreements(simulated, case, steps)
    return Demonstration(simulated, case, adjusted, found, registration, apart, stages)


def _registered_by_relief(case: Case, before: Solution, stages: Stages) -> ReliefRegistration | str:
    """The case registered by relief, or why it can't be."""
    if not has_opencv():
        return 'OpenCV is not installed (pip install "mgsgraph[match]")'
    with stages.stage(RELIEF):
        try:
            return register_by_relief(case, before=before, progress=stages.detail)
        except InputError as error:  # the images may share too little ground with a profile, as their errors were drawn
            return str(error)


def _named_from(case: Case, folder: Path) -> Case:
    """The case with its sources named from the folder that holds `folder`, which may not have its name for good yet."""

    def short(source: str) -> str:
        return source.replace(str(folder / "x")[:-1], str(Path(folder.name) / "x")[:-1])

    network = case.network
    surface = network.surface and replace(
        network.surface, grid=replace(network.surface.grid, source=short(network.surface.grid.source))
    )
    areoid = network.areoid and replace(network.areoid, source=short(network.areoid.source))
    profiles = tuple(replace(shots, source=short(shots.source)) for shots in case.profiles)
    models = tuple(replace(one, lattice=replace(one.lattice, source=short(one.lattice.source))) for one in case.terrain)
    return replace(
        case, network=replace(network, surface=surface, areoid=areoid), profiles=profiles, terrain=models
    )


def true_points(demo: Demonstration) -> dict[str, Array]:
    """True position (3,) in m, body-fixed, of each ground point of the network by its id."""
    simulated = demo.simulated
    ties = dict(zip(simulated.ties.ids, simulated.true_ties, strict=True))
    known = true_shots(simulated)
    shots = {
        f"{registered.name}:{name}": known[name][0]
        for registered, profile in zip(demo.registration.before, demo.case.profiles, strict=True)
        for name in profile.ids
    }
    return ties | shots

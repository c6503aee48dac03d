"""The main job on a simulated study site: simulate, adjust with ties and ranges, register by relief, and compare with
the truth.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

from mgsgraph.adjustment.solution import Solution
from mgsgraph.case.reading import Case, adjust, read_case
from mgsgraph.errors import InputError
from mgsgraph.geometry.records import Array
from mgsgraph.matching.patches import has_opencv
from mgsgraph.progress import Stages
from mgsgraph.registration.case import CaseRegistration, register_case
from mgsgraph.registration.relief import register_by_relief
from mgsgraph.registration.relief_records import ReliefRegistration
from mgsgraph.simulation.demo.disagreement import BY_RELIEF, KERNELS, TIES, Disagreement, disagreements
from mgsgraph.simulation.demo.simulate import simulated_files
from mgsgraph.simulation.demo.truth import AgainstTruth, BeforeAfter, against_truth, true_shots
from mgsgraph.simulation.files import write_pair, write_site
from mgsgraph.simulation.pair import SimulatedPair, simulate_pair
from mgsgraph.simulation.site import SimulatedSite, SimulationOptions, simulate_site

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
    truth: AgainstTruth
    """What is left of the errors of the images."""
    stages: Stages
    """Seconds that it took."""

    @property
    def solution(self) -> Solution:
        """What the last step made of it."""
        return self.adjusted if isinstance(self.relief, str) else self.relief.solution

    @property
    def discrepancies(self) -> tuple[BeforeAfter, ...]:
        """By how much the images contradict each other about footprints, as their tie points tell, for each profile."""
        return tuple(
            BeforeAfter(before.name, one, two)
            for before, after in zip(self.registration.before, self.registration.after, strict=True)
            for one, two in zip(before.discrepancies, after.discrepancies, strict=True)
        )

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
        truth = against_truth(simulated, case, solution, registration)
    return Demonstration(simulated, case, adjusted, found, registration, apart, truth, stages)


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

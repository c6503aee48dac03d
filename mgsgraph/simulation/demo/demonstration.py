"""The main job on a simulated study site: simulate, adjust with ties and ranges, register by relief, and compare with
the truth.
"""

from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

import numpy as np

from mgsgraph.adjustment.solution import Solution
from mgsgraph.analysis.estimates import PixelEstimate
from mgsgraph.analysis.posterior import Posterior
from mgsgraph.case.reading import Case, adjust, read_case
from mgsgraph.errors import InputError, require
from mgsgraph.files.output.table import Table
from mgsgraph.geometry.altimetry import AltimeterShots
from mgsgraph.geometry.records import Array, thinned
from mgsgraph.matching.patches import has_opencv
from mgsgraph.network import PointClass
from mgsgraph.network.footprints import Misregistration, misregistration, on_ground
from mgsgraph.registration.case import CaseRegistration, register_case
from mgsgraph.registration.minima import ReliefRegistration
from mgsgraph.registration.relief import register_by_relief
from mgsgraph.results.section import table_of
from mgsgraph.simulation.archive import ARCHIVE_KINDS, archive_settings, lay_out
from mgsgraph.simulation.archive_files import write_archive
from mgsgraph.simulation.files import write_pair, write_site, write_strip, write_three_sites
from mgsgraph.simulation.mgs_files import shot_names
from mgsgraph.simulation.pair import SimulatedPair, simulate_pair
from mgsgraph.simulation.site import SimulatedSite, SimulationOptions, simulate_site, simulate_three_sites
from mgsgraph.simulation.sites import SITE_NAMES
from mgsgraph.simulation.strip import StripSettings, simulate_strip
from mgsgraph.text import length, listed, root_mean_square, two
from mgsgraph.workers import Progress, Stages, no_progress


def nees(errors: Array, covariances: Array) -> Array:
    """Normalised estimation error squared e' C^-1 e of errors (n, d) with covariances (n, d, d); expectation d."""
    return np.asarray(np.einsum("ni,ni->n", errors, np.linalg.solve(covariances, errors[:, :, None])[:, :, 0]))


class PointErrors(NamedTuple):
    """Errors of a class of points against the truth."""

    rms_before: float
    """m, of the a-priori positions."""
    rms_after: float
    """m, of the adjusted ones."""
    predicted: float
    """m, the same by the stated sigmas."""
    nees: float
    """Mean normalised estimation error squared per degree of freedom; 1 where the stated sigmas are consistent."""


def point_errors(solution: Solution, truth: Mapping[str, Array], point_class: PointClass) -> PointErrors | None:
    """Errors of the points of a class, by their true positions (3,) in m; None where there are none."""
    members = solution.members(point_class)
    if members.size == 0:
        return None
    true = np.array([truth[solution.network.points.ids[i]] for i in members])
    before, after = solution.places_before[members] - true, solution.places[members] - true
    covariances = solution.covariances[members]
    predicted = float(np.sqrt(np.trace(covariances, axis1=1, axis2=2).mean()))
    return PointErrors(rms_length(before), rms_length(after), predicted, float(nees(after, covariances).mean() / 3.0))


def point_statements(solution: Solution, truth: Mapping[str, Array]) -> list[str]:
    """A sentence with the errors of tie points and laser points, and one with their stated sigmas against these."""
    classes = (PointClass.TIE, PointClass.LASER)
    by_class = [(kind.name.lower(), errors) for kind in classes if (errors := point_errors(solution, truth, kind))]
    sizes = [f"{name} points {length(error.rms_before)} before, {length(error.rms_after)} after (predicted "
             f"{two(error.predicted)})" for name, error in by_class]  # fmt: skip
    ratios = [f"{error.nees:.2f} of {name} points" for name, error in by_class]
    return [
        f"Absolute error: {'; '.join(sizes)}.",
        f"Stated sigmas: NEES per degree of freedom {listed(ratios)} (1: consistent; one draw scatters).",
    ]


def pair_statements(solution: Solution, pair: SimulatedPair) -> list[str]:
    """Sentences with the true errors of points before and after the adjustment."""
    truth = dict(zip(pair.ties.ids, pair.true_ties, strict=True)) | dict(
        zip(pair.laser.ids, pair.true_footprints, strict=True)
    )
    return point_statements(solution, truth)


def rms_length(errors: Array) -> float:
    """Root mean square length, m."""
    return root_mean_square(np.linalg.norm(errors, axis=1))


# --- footprints in images


def true_shots(simulated: SimulatedSite) -> dict[str, tuple[Array, Array]]:
    """True ground point (3,) and pixels (2, 2) in both images, of each shot by its name."""
    return {
        name: (point, pixels)
        for image in simulated.images
        for name, point, pixels in zip(
            shot_names(image), image.profile.true_footprints, image.profile.true_pixels, strict=True
        )
    }


KERNELS, TIES, BY_RELIEF = "kernels", "ties and ranges", "relief"
"""Steps after which footprints and images are compared."""
_MOST = 8
"""Footprints of a profile in an image whose sigmas are predicted; between them these change little."""


@dataclass(frozen=True, slots=True, eq=False)
class Disagreement:
    """Disagreement of one laser profile and one image."""

    state: str
    """The step after which it is."""
    profile: str
    """Its file's name without ending."""
    found: Misregistration
    """Projected minus true pixels of its footprints, as archived by the kernels, or as adjusted."""
    sigmas: Array
    """(2,) m, predicted along and across the flight; NaN of kernels."""

    @property
    def rms(self) -> float:
        """m, of the distances on the ground."""
        return rms_length(self.found.metres)


def disagreements(
    simulated: SimulatedSite, case: Case, steps: Sequence[tuple[str, Solution | None]]
) -> tuple[Disagreement, ...]:
    """One for each profile in each image that sees it, by the kernels (no solution) and by solutions of the case."""
    true, result = true_shots(simulated), list[Disagreement]()
    for state, solution in steps:
        adjusted = None if solution is None else _Adjusted(solution)
        for shots in case.profiles:
            profile, truth = Path(shots.source).stem, np.array([true[name][1] for name in shots.ids])
            for j, image in enumerate(case.network.images):
                visible = np.all((truth[:, j] >= 0.0) & (truth[:, j] <= [image.lines, image.samples]), axis=1)
                if not np.any(visible):
                    continue
                pixels = np.where(visible[:, None], truth[:, j], np.nan)
                off, sigmas = misregistration(image, shots, pixels), np.full(2, np.nan)
                if adjusted is not None:
                    off, sigmas = adjusted.misregistration(j, profile, shots, pixels)
                result.append(Disagreement(state, profile, off, sigmas))
    return tuple(result)


class _Adjusted:
    """Footprints and images by an adjustment."""

    def __init__(self, solution: Solution) -> None:
        self._posterior = Posterior.of(solution)
        self._positions = dict(zip(solution.network.points.ids, solution.places, strict=True))

    def misregistration(
        self, j: int, profile: str, shots: AltimeterShots, pixels: Array
    ) -> tuple[Misregistration, Array]:
        """Of a profile in one image, by true pixels (n, 2), NaN where unseen; and its predicted sigmas (2,) in m."""
        names = [f"{profile}:{name}" for name in shots.ids]
        points = np.array([self._positions[name] for name in names])
        measured = misregistration(
            self._posterior.image(j), shots, pixels, self._posterior.correction(j), points
        )
        return measured, self._predicted(j, [names[k] for k in measured.shots.tolist()])

    def _predicted(self, j: int, names: Sequence[str]) -> Array:
        """(2,) m along and across the flight: root of the mean variance of some points' projections; NaN for none."""
        image, estimates = self._posterior.image(j), list[PixelEstimate]()
        for k in thinned(len(names), _MOST).tolist():
            with suppress(InputError):  # it falls beside the image, whose orientation is unknown there
                estimates.append(self._posterior.projection(names[k], image.name))
        if not estimates:
            return np.full(2, np.nan)
        pixels, covariances = (np.array([getattr(e, what) for e in estimates]) for what in ("pixel", "covariance"))
        points = np.array([self._positions[estimate.point] for estimate in estimates])
        metres = on_ground(image, pixels, points, self._posterior.correction(j))
        return np.asarray(np.sqrt(np.einsum("nij,njk,nik->ni", metres, covariances, metres).mean(axis=0)))


def overall(disagreements: Sequence[Disagreement], state: str) -> tuple[float, float]:
    """Rms distance on the ground over all footprints and images in one state, and its predicted size, m."""
    of_state = [item for item in disagreements if item.state == state]
    metres = np.concatenate([item.found.metres for item in of_state])
    counts = np.array([item.found.shots.size for item in of_state])
    squares = np.array([np.sum(item.sigmas**2) for item in of_state])
    return rms_length(metres), float(np.sqrt(np.average(squares, weights=counts)))


def disagreement_table(rows: Sequence[Disagreement]) -> Table:
    """One row per state, profile and image."""
    means = np.array([row.found.metres.mean(axis=0) for row in rows]).reshape(-1, 2)
    sigmas = np.array([row.sigmas for row in rows]).reshape(-1, 2)
    return table_of("disagreement", {"mean_{}": means, "sigma_{}": sigmas}, rows)



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
            owner = next(option for option, names in _OPTIONS.items() if name in names)
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
    require(site in known, "site", repr(site), f"{', '.join(known[:-1])} or {known[-1]}")
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
        """Solution of the last step."""
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
    relief_result = _registered_by_relief(case, adjusted, stages) if relief else "not asked for (--no-relief)"
    steps: list[tuple[str, Solution | None]] = [(KERNELS, None), (TIES, adjusted)]
    steps += [] if isinstance(relief_result, str) else [(BY_RELIEF, relief_result.solution)]
    solution = steps[-1][1] or adjusted
    with stages.stage("comparing"):
        registration = register_case(case, solution)
        compared = disagreements(simulated, case, steps)
    return Demonstration(simulated, case, adjusted, relief_result, registration, compared, stages)


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
    """The case with its sources named from the folder that holds `folder`, which may still have a temporary name."""

    def short(source: str) -> str:
        return source.replace(str(folder / "x")[:-1], str(Path(folder.name) / "x")[:-1])

    network = case.network
    surface = network.surface and replace(
        network.surface, grid=replace(network.surface.grid, source=short(network.surface.grid.source))
    )
    areoid = network.areoid and replace(network.areoid, source=short(network.areoid.source))
    profiles = tuple(replace(shots, source=short(shots.source)) for shots in case.profiles)
    models = tuple(replace(m, lattice=replace(m.lattice, source=short(m.lattice.source))) for m in case.terrain)
    return replace(case, network=replace(network, surface=surface, areoid=areoid), profiles=profiles, terrain=models)


def true_points(demo: Demonstration) -> dict[str, Array]:
    """True position (3,) in m, body-fixed, of each ground point of the network by its id."""
    simulated = demo.simulated
    ties = dict(zip(simulated.ties.ids, simulated.true_ties, strict=True))
    by_name = true_shots(simulated)
    shots = {
        f"{registered.name}:{name}": by_name[name][0]
        for registered, profile in zip(demo.registration.before, demo.case.profiles, strict=True)
        for name in profile.ids
    }
    return ties | shots

"""The main job on a simulated study site: simulate, register, adjust, register again, and compare with the truth."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from mgsgraph.adjustment.solution import Solution
from mgsgraph.case.reading import Case, adjust, read_case
from mgsgraph.errors import InputError
from mgsgraph.geometry.altimetry import AltimeterShots
from mgsgraph.geometry.body import geodetic
from mgsgraph.geometry.image import PushbroomImage
from mgsgraph.geometry.orientation import OrientationCorrection
from mgsgraph.geometry.records import Array, Index, Mask
from mgsgraph.registration.case import CaseRegistration, register_case
from mgsgraph.registration.footprints import Misregistration, misregistration, on_ground
from mgsgraph.registration.place_sigmas import place_jacobian, propagated
from mgsgraph.simulation.files import write_pair
from mgsgraph.simulation.pair import SimulatedPair, simulate_pair
from mgsgraph.simulation.site import SimulatedSite, SimulationOptions, simulate_site
from mgsgraph.simulation.site_files import shot_names, write_site
from mgsgraph.simulation.sites import SITE_NAMES
from mgsgraph.stages import Stages

PAIR = "pair"
"""The small pair of synthetic images, beside the study sites."""
INPUTS = "inputs"
"""Folder of the simulated files in the demo's results."""


def site_options(site: str, attitude_time_bias: float | None = None, pictures: bool = True) -> SimulationOptions:
    """Options of a simulation; raise InputError unless there is such a site, and it can have them."""
    if site not in (*SITE_NAMES, PAIR):
        raise InputError("site", repr(site), f"{', '.join(SITE_NAMES)} or {PAIR}")
    if site == PAIR and attitude_time_bias is not None:
        raise InputError("attitude time bias", f"given for {PAIR}", "a study site", f"take {' or '.join(SITE_NAMES)}")
    return SimulationOptions(attitude_time_bias=attitude_time_bias, pictures=pictures)


DRAWING = "tables and figures"
"""The last stage."""
STAGES = ("simulating", "writing", "reading", "adjusting", "registering", DRAWING)
"""Of a demo, in their order."""


@dataclass(frozen=True, slots=True, eq=False)
class BeforeAfter:
    """A misregistration about the footprints of one profile, with the nominal and with the adjusted orientation."""

    profile: str
    """Its file's name without ending."""
    before: Misregistration
    """Nominal orientation."""
    after: Misregistration
    """Adjusted orientation; its sigmas are the predicted ones, zero where nothing is predicted."""

    @property
    def sigmas_off(self) -> Array:
        """(k, 2) what is left along and across the flight, in units of the predicted sigmas."""
        return self.after.pixels / self.after.pixel_sigmas


@dataclass(frozen=True, slots=True, eq=False)
class AgainstTruth:
    """Misregistrations as only a simulation knows them."""

    between: tuple[BeforeAfter, ...]
    """Of the true ground under each profile that both images see: error of its place in the second image minus that in
    the first, carried over level ground. What both images share cancels. Sigmas from the joint covariance."""
    orientation: tuple[BeforeAfter, ...]
    """Of the true ground under each profile in each image; it is the orientation alone that is off."""
    footprints: tuple[BeforeAfter, ...]
    """Of the footprints themselves in each image, archived and adjusted: with their own errors, above all the
    horizontal one which the shots of a profile share. Nothing is predicted."""


@dataclass(frozen=True, slots=True, eq=False)
class Demonstration:
    """A simulated site, adjusted, and how it compares with the truth."""

    simulated: SimulatedSite
    """Inputs and truth."""
    case: Case
    """The inputs as read from their files."""
    solution: Solution
    """What the adjustment made of them."""
    registration: CaseRegistration
    """Footprints in images before and after."""
    truth: AgainstTruth
    """What is left of the errors."""
    stages: Stages
    """Seconds that it took."""

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


def _write_pair(folder: Path, seed: int, stages: Stages) -> tuple[SimulatedPair, Path]:
    with stages.stage("simulating"):
        pair = simulate_pair(seed=seed)
    with stages.stage("writing"):
        return pair, write_pair(pair, folder)


def _write_site(
    site: str, folder: Path, seed: int, options: SimulationOptions | None, stages: Stages
) -> tuple[SimulatedSite, Path]:
    with stages.stage("simulating"):
        simulated = simulate_site(site, seed, options)
    with stages.stage("writing"):
        return simulated, write_site(simulated, folder)


def demonstrate_pair(
    folder: Path, seed: int = 1, adjusting: Callable[[Case], Solution] = adjust, stages: Stages | None = None
) -> tuple[SimulatedPair, Solution]:
    """Simulate the pair, write its files to `folder`, read them back and adjust them."""
    stages = stages or Stages()
    pair, path = _write_pair(folder, seed, stages)
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
) -> Demonstration:
    """Simulate a study site, write its files to `folder`, read them back, register, adjust and register again.

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
    """
    stages = stages or Stages()
    simulated, path = _write_site(site, folder, seed, options, stages)
    with stages.stage("reading"):
        case = _named_from(read_case(path), folder)
    with stages.stage("adjusting"):
        solution = adjusting(case)
    with stages.stage("registering"):
        registration = register_case(case, solution)
        truth = against_truth(simulated, case, solution, registration)
    return Demonstration(simulated, case, solution, registration, truth, stages)


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
    return replace(case, network=replace(network, surface=surface, areoid=areoid), profiles=profiles)


def against_truth(
    simulated: SimulatedSite, case: Case, solution: Solution, registration: CaseRegistration
) -> AgainstTruth:
    """Compare places of footprints, and of the true ground under them, with their true places in the images."""
    between, orientation, footprints = list[BeforeAfter](), list[BeforeAfter](), list[BeforeAfter]()
    known, images = _truth(simulated), solution.network.images
    for shots, registered in zip(case.profiles, registration.after, strict=True):
        rows = [known[name] for name in shots.ids]
        points, places = np.array([row[0] for row in rows]), np.array([row[1] for row in rows])
        seen = np.stack([_inside(image, places[:, j]) for j, image in enumerate(images)])
        for j, image in enumerate(images):
            if not np.any(seen[j]):
                continue
            adjusted, correction = solution.image(j), solution.correction(j)
            inside = np.where(seen[j, :, None], places[:, j], np.nan)
            orientation.append(BeforeAfter(
                registered.name,
                misregistration(image, shots, inside, None, points),
                _predicted(misregistration(adjusted, shots, inside, correction, points), points, solution, j),
            ))
            footprints.append(BeforeAfter(
                registered.name,
                misregistration(image, shots, inside),
                misregistration(adjusted, shots, inside, correction, registered.points),
            ))
        both = np.flatnonzero(np.all(seen, axis=0))
        if both.size:
            between.append(_between(registered.name, shots, both, points[both], places[both], solution))
    return AgainstTruth(tuple(between), tuple(orientation), tuple(footprints))


def true_points(demo: Demonstration) -> dict[str, Array]:
    """True place (3,) in m, body-fixed, of each ground point of the network by its id."""
    simulated = demo.simulated
    ties = dict(zip(simulated.ties.ids, simulated.true_ties, strict=True))
    known = _truth(simulated)
    shots = {
        f"{registered.name}:{name}": known[name][0]
        for registered, profile in zip(demo.registration.before, demo.case.profiles, strict=True)
        for name in profile.ids
    }
    return ties | shots


def _truth(simulated: SimulatedSite) -> dict[str, tuple[Array, Array]]:
    """True ground point (3,) and places (2, 2) in both images, of each shot by its name."""
    return {
        name: (point, places)
        for image in simulated.images
        for name, point, places in zip(
            shot_names(image), image.profile.true_footprints, image.profile.true_places, strict=True
        )
    }


def _inside(image: PushbroomImage, places: Array) -> Mask:
    with np.errstate(invalid="ignore"):
        return np.asarray(np.all((places >= 0.0) & (places <= [image.lines, image.samples]), axis=1))


def _predicted(found: Misregistration, points: Array, solution: Solution, image: int) -> Misregistration:
    """The same with the sigmas that the orientation's covariance predicts for the places of the points (n, 3)."""
    picture, correction = solution.image(image), solution.correction(image)
    places, jacobian = place_jacobian(picture, points[found.shots], correction)
    return _with_sigmas(found, jacobian, solution.correction_covariance(image), on_ground(
        picture, places, points[found.shots], correction
    ))


def _between(
    profile: str, shots: AltimeterShots, which: Index, points: Array, places: Array, solution: Solution
) -> BeforeAfter:
    """Of the true points (k, 3) and places (k, 2, 2) under the shots `which` (k,), which both images see."""
    first, second = solution.network.images
    corrections = (solution.correction(0), solution.correction(1))
    unseen = np.zeros((which.size, 2))

    def contradiction(pair: tuple[OrientationCorrection, ...]) -> tuple[Misregistration, Array, Array]:
        off, jacobian, metres = _contradiction((first, second), pair, points, places)
        return Misregistration(
            second.name, first.name, which, places[:, 1, 0], off, unseen,
            np.einsum("nij,nj->ni", metres, off), unseen, shots.spacing,
        ), jacobian, metres

    nominal = OrientationCorrection(np.zeros((1, 6)))
    before, _, _ = contradiction((nominal, nominal))
    after, jacobian, metres = contradiction(corrections)
    return BeforeAfter(profile, before, _with_sigmas(after, jacobian, solution.correction_covariance(0, 1), metres))


def _contradiction(
    pair: tuple[PushbroomImage, PushbroomImage],
    corrections: tuple[OrientationCorrection, ...],
    points: Array,
    places: Array,
) -> tuple[Array, Array, Array]:
    """Error of the points' places in the second image minus that in the first, carried over ground of the points'
    heights (n, 2), in pixels of the second; how that follows the coefficients of both; and metres per pixel (n, 2, 2).
    """
    (first, second), height = pair, geodetic(points, pair[0].body)[:, 2]
    here, by_first = place_jacobian(first, points, corrections[0])
    there, by_second = place_jacobian(second, points, corrections[1])
    _, to_ground = first.image_to_ground(here[:, 0], here[:, 1], height, corrections[0])
    _, to_image = second.ground_to_image(points, corrections[1])
    carried = to_image @ to_ground
    off = there - places[:, 1] - np.einsum("nij,nj->ni", carried, here - places[:, 0])
    jacobian = np.concatenate([-carried @ by_first, by_second], axis=2)
    return off, jacobian, on_ground(second, there, points, corrections[1])


def _with_sigmas(found: Misregistration, jacobian: Array, covariance: Array, metres: Array) -> Misregistration:
    """The same with sigmas by the law of error propagation, in pixels and, by metres per pixel (n, 2, 2), in metres."""
    return replace(
        found, pixel_sigmas=propagated(jacobian, covariance), metre_sigmas=propagated(metres @ jacobian, covariance)
    )

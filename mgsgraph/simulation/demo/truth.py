"""How a solution compares with the truth of a simulation: errors before and after, their NEES, and misregistrations
that only a simulation knows, with the sigmas that the law of error propagation predicts for them.
"""

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np

from mgsgraph.adjustment.solution import Solution
from mgsgraph.analysis.estimates import PixelEstimate
from mgsgraph.analysis.posterior import Posterior
from mgsgraph.case.reading import Case
from mgsgraph.errors import InputError
from mgsgraph.files.output.table import Column, Table
from mgsgraph.geometry.altimetry import AltimeterShots
from mgsgraph.geometry.records import Array, thinned
from mgsgraph.network import PointClass
from mgsgraph.network.footprints import Misregistration, misregistration, on_ground
from mgsgraph.simulation.mgs_files import shot_names
from mgsgraph.simulation.pair import SimulatedPair
from mgsgraph.simulation.site import SimulatedSite
from mgsgraph.text import root_mean_square


def nees(errors: Array, covariances: Array) -> Array:
    """Normalised estimation error squared e' C^-1 e of errors (n, d) with covariances (n, d, d); expectation d."""
    return np.asarray(np.einsum("ni,ni->n", errors, np.linalg.solve(covariances, errors[:, :, None])[:, :, 0]))


class PointErrors(NamedTuple):
    """Errors of a class of points against the truth."""

    rms_before: float
    """m, of the a-priori positions."""
    rms_after: float
    """m, of the adjusted ones."""
    nees: float
    """Mean normalised estimation error squared per degree of freedom; 1 where the stated sigmas are honest."""


def point_errors(solution: Solution, truth: Mapping[str, Array], point_class: PointClass) -> PointErrors | None:
    """Errors of the points of a class, by their true positions (3,) in m; None where there are none."""
    members = solution.members(point_class)
    if members.size == 0:
        return None
    true = np.array([truth[solution.network.points.ids[i]] for i in members])
    before, after = solution.places_before[members] - true, solution.places[members] - true
    mean = float(nees(after, solution.covariances[members]).mean() / 3.0)
    return PointErrors(rms_length(before), rms_length(after), mean)


def point_statements(solution: Solution, truth: Mapping[str, Array]) -> list[str]:
    """A sentence with the errors of tie points, and one with those of laser points."""
    classes = (PointClass.TIE, PointClass.LASER)
    found = [(one.name.lower(), errors) for one in classes if (errors := point_errors(solution, truth, one))]
    return [
        f"Truth, {name} points: error {errors.rms_before:.1f} m rms before, {errors.rms_after:.1f} m after; mean NEES "
        f"per degree of freedom {errors.nees:.2f} (1 if the stated sigmas are honest; all points share one "
        "orientation, so one draw scatters)."
        for name, errors in found
    ]


def pair_statements(solution: Solution, pair: SimulatedPair) -> list[str]:
    """Sentences with the true errors of points and orientation before and after the adjustment."""
    truth = dict(zip(pair.ties.ids, pair.true_ties, strict=True)) | dict(
        zip(pair.laser.ids, pair.true_footprints, strict=True)
    )
    estimates = zip(solution.coefficients, pair.true_corrections, strict=True)
    errors = np.concatenate([(estimate - true.coefficients).ravel() for estimate, true in estimates])
    whitened = nees(errors[None], solution.joint_covariance.of(range(len(solution.coefficients)))[None])[0]
    return [
        *point_statements(solution, truth),
        f"Truth, orientation: NEES {whitened:.1f} for {errors.size} coefficients (expected {errors.size}).",
    ]


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
    """Of one laser profile in one image."""

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
        return root_mean_square(np.linalg.norm(self.found.metres, axis=1))


def disagreements(
    simulated: SimulatedSite, case: Case, steps: Sequence[tuple[str, Solution | None]]
) -> tuple[Disagreement, ...]:
    """Of each profile in each image that sees it, by the kernels (no solution) and by solutions of the case."""
    known, found = true_shots(simulated), list[Disagreement]()
    for state, solution in steps:
        adjusted = None if solution is None else _Adjusted(solution)
        for shots in case.profiles:
            profile, truth = Path(shots.source).stem, np.array([known[name][1] for name in shots.ids])
            for j, image in enumerate(case.network.images):
                seen = np.all((truth[:, j] >= 0.0) & (truth[:, j] <= [image.lines, image.samples]), axis=1)
                if not np.any(seen):
                    continue
                pixels = np.where(seen[:, None], truth[:, j], np.nan)
                off, sigmas = misregistration(image, shots, pixels), np.full(2, np.nan)
                if adjusted is not None:
                    off, sigmas = adjusted.misregistration(j, profile, shots, pixels)
                found.append(Disagreement(state, profile, off, sigmas))
    return tuple(found)


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
        found = misregistration(
            self._posterior.image(j), shots, pixels, self._posterior.correction(j), points
        )
        return found, self._predicted(j, [names[k] for k in found.shots.tolist()])

    def _predicted(self, j: int, names: Sequence[str]) -> Array:
        """(2,) m along and across the flight: root of the mean variance of some points' projections; NaN for none."""
        image, estimates = self._posterior.image(j), list[PixelEstimate]()
        for k in thinned(len(names), _MOST).tolist():
            with suppress(InputError):  # it falls beside the image, whose orientation nobody knows there
                estimates.append(self._posterior.projection(names[k], image.name))
        if not estimates:
            return np.full(2, np.nan)
        pixels, covariances = (np.array([getattr(one, what) for one in estimates]) for what in ("pixel", "covariance"))
        points = np.array([self._positions[one.point] for one in estimates])
        metres = on_ground(image, pixels, points, self._posterior.correction(j))
        return np.asarray(np.sqrt(np.einsum("nij,njk,nik->ni", metres, covariances, metres).mean(axis=0)))


def overall(found: Sequence[Disagreement], state: str) -> tuple[float, float]:
    """Rms distance on the ground over all footprints and images in one state, and its predicted size, m."""
    mine = [one for one in found if one.state == state]
    metres = np.concatenate([one.found.metres for one in mine])
    counts = np.array([one.found.shots.size for one in mine])
    squares = np.array([np.sum(one.sigmas**2) for one in mine])
    return root_mean_square(np.linalg.norm(metres, axis=1)), float(np.sqrt(np.average(squares, weights=counts)))


def disagreement_table(found: Sequence[Disagreement]) -> Table:
    """One row per state, profile and image."""
    means = np.array([one.found.metres.mean(axis=0) for one in found]).reshape(-1, 2)
    sigmas = np.array([one.sigmas for one in found]).reshape(-1, 2)
    return Table("disagreement", "MOLA's footprints in MOC's images, beside their true pixels", (
        Column("state", [one.state for one in found], meaning="orientation and footprints after which step", head="by",
               text="<16"),
        Column("profile", [one.profile for one in found], text="<10"),
        Column("image", [one.found.image for one in found], text="<10"),
        Column("footprints", np.array([one.found.shots.size for one in found]), label="shots", text=">6d"),
        Column("mean_{}", means, "m", "of the flight, on the ground", ("along", "across"), label="mean (m)",
               text=">+8.1f", gap=2),
        Column("rms", np.array([one.rms for one in found]), "m", "of the distances", label="rms (m)", text=">8.1f",
               gap=2),
        Column("sigma_{}", sigmas, "m", "predicted", ("along", "across"), label="predicted sigma (m)", text=">8.1f",
               gap=2),
    ))  # fmt: skip

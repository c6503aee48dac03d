"""A registration by relief as sentences and files: the adjusted solution with all that `adjust` writes, and beside it
coregistration.json, one row per profile and one per shot.
"""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from mgsgraph.adjustment.graph.variables import crossover_differences
from mgsgraph.adjustment.solution import Solution
from mgsgraph.files.output.folders import COREGISTRATION, fresh_folder
from mgsgraph.files.output.table import Table, numbers
from mgsgraph.geometry.body import east_north_up, ellipsoidal_heights, planetocentric
from mgsgraph.geometry.records import Array, sigmas_of
from mgsgraph.registration.minima import ProfileState, ReliefProfile, ReliefRegistration
from mgsgraph.results.results import write_into
from mgsgraph.results.section import Section, record_of, sheets_by, table_of, write_sections_into
from mgsgraph.results.verdict import headline
from mgsgraph.text import many, root_mean_square, some
from mgsgraph.units import DEG

FORMAT = 1
"""Version of coregistration.json's layout."""
_MOST_MINIMA = 10
"""Minima of a cost surface that are written, best first."""


def write_coregistration(
    registration: ReliefRegistration, folder: str | Path, figures: bool = True, case: str | Path | None = None,
    networks: Sequence[Path] = (),
) -> list[str]:  # fmt: skip
    """Write the adjusted solution as `write_results` does, and tables and figures of the registration beside it.

    Parameters
    ----------
    registration : ReliefRegistration
        As `register_by_relief` made it, converged or not.
    folder : path
        Absent, empty, or an earlier result, which is replaced, atomically.
    figures : bool
        False leaves the figures out.
    case : path, optional
        Case file, for later commands.
    networks : sequence of Path
        Files of the tie points.

    Returns
    -------
    list of str
        Names of the files in the folder.

    Raises
    ------
    InputError
        If the folder holds anything else, or can't be written.

    Examples
    --------
    >>> files = mgsgraph.write_coregistration(registration, "coregistered", figures=False)
    >>> [name for name in files if name.endswith(".csv")]
    ['points.csv', 'orientation.csv', 'residuals.csv', 'connectivity.csv', 'profiles.csv', 'shots.csv']
    """
    with fresh_folder(folder) as temporary:
        return write_coregistration_into(registration, temporary, figures, case, networks)


def write_coregistration_into(
    registration: ReliefRegistration, folder: Path, figures: bool = True, case: str | Path | None = None,
    networks: Sequence[Path] = (),
) -> list[str]:  # fmt: skip
    """Write solution, tables and figures into a folder that exists, file by file."""
    names = write_into(registration.solution, folder, figures, case, networks)
    section = coregistration_section(registration)
    return names + write_sections_into([section], section.numbers, folder, COREGISTRATION, figures)


def coregistration_section(registration: ReliefRegistration) -> Section:
    """How far profiles and terrain models lay from the stereo surface, and lie now."""
    network, settings, profiles = registration.solution.network, registration.settings, profiles_table(registration)
    assert network.stereo is not None
    pairs = [[network.images[j].name for j in pair] for pair in network.stereo.images.tolist()]

    sentences = relief_statements(registration)
    record = {
        "format": FORMAT,
        "name": registration.name,
        "status": "converged" if registration.solution.converged else "not converged",
        "sigma0_before": registration.before.sigma0,
        "sigma0_after": registration.solution.sigma0,
        "settings": record_of("relief_settings", settings),
        "pairs": pairs,
        "profiles": [
            row | {
                "shift_covariance_m2": profile.covariance,
                "minima_before": _minima_json(profile.before),
                "minima_after": _minima_json(profile.after),
            }
            for row, profile in zip(profiles.records(), registration.profiles, strict=True)
        ],
        "crossovers": _crossovers_json(registration.solution),
        "statements": sentences,
    }  # fmt: skip
    csv = [profiles, relief_shots_table(registration)]
    return Section("coregistration", headline(registration.solution), sentences, [profiles], record, csv,
                   sheets=sheets_by("mgsgraph.results.figures.relief.relief_sheets", registration))  # fmt: skip


def _crossovers_json(solution: Solution) -> dict[str, Any]:
    """How far the heights of laser profiles differ where they cross, after."""
    network = solution.network
    crossing, differences = network.crossovers, crossover_differences(network, solution.shifts, solution.shared)
    if crossing is None:
        return {"count": 0, "rms_m": None, "rms_sigmas": None}
    return {
        "count": differences.size, "rms_m": root_mean_square(differences),
        "rms_sigmas": root_mean_square(differences / crossing.sigmas)
    }  # fmt: skip


def _minima_json(state: ProfileState) -> list[dict[str, Any]]:
    return [record_of("relief_minimum", minimum) for minimum in state.cost.minima[:_MOST_MINIMA]]


# --- tables


def profiles_table(registration: ReliefRegistration) -> Table:
    """One row per laser profile and terrain model: how far it lay from the stereo surface before, and lies after."""
    profiles = registration.profiles
    shifts = registration.solution.network.shifts
    assert shifts is not None

    def of(get: Callable[[ReliefProfile], Any], width: int = 0) -> Array:
        return np.array([get(profile) for profile in profiles], dtype=np.float64).reshape((-1, width) if width else -1)

    def misplacement(when: str) -> dict[str, Array]:
        states = [getattr(profile, when) for profile in profiles]
        sigma = [sigmas_of(state.misplacement_covariance) for state in states]
        key = f"misplacement_{when}_{{}}"
        return {key: numbers(states, "misplacement").reshape(-1, 2), f"sigma_{key}": np.array(sigma).reshape(-1, 2)}

    def minimum(k: int, name: str) -> Array:  # of the k-th best minimum after; NaN where there is none
        return of(lambda profile: getattr(profile.after.cost.minima[k], name) if len(profile.after.cost.minima) > k
                  else np.nan)

    return table_of("profiles", {
        "on_surface": np.array([int(profile.on_surface.sum()) for profile in profiles]),
        "tied": np.array([profile.after.cost.tied for profile in profiles]),
        "clear": np.array([profile.after.cost.clear for profile in profiles]),
        **misplacement("before"), **misplacement("after"), "misfit": minimum(0, "misfit"),
        "runner_up_misfit": minimum(1, "misfit"), "runner_up_weight": minimum(1, "weight"),
        "shift_{}": of(lambda profile: profile.shift, 2),
        "sigma_shift_{}": of(lambda profile: sigmas_of(profile.covariance), 2),
        "apriori_sigma_shift": shifts.sigmas,
    }, profiles)  # fmt: skip


def relief_shots_table(registration: ReliefRegistration) -> Table:
    """One row per laser shot and post: its height above the stereo surface before and after."""
    profiles, network = registration.profiles, registration.solution.network
    points = network.points.places[np.concatenate([profile.points for profile in profiles])]
    longitude, latitude, _ = planetocentric(points).T
    on_surface = np.concatenate([profile.on_surface for profile in profiles])
    slopes = [np.where(profile.on_surface[:, None], slopes_of(profile.after), np.nan) for profile in profiles]
    return table_of("relief_shots", {
        "profile": [profile.name for profile in profiles for _ in profile.points],
        "shot": [network.points.ids[i] for profile in profiles for i in profile.points.tolist()],
        "on_surface": on_surface,
        "east_longitude": np.mod(longitude / DEG, 360.0), "planetocentric_latitude": latitude,
        "height": ellipsoidal_heights(points, network.body),
        "above_surface_before": np.concatenate([_covered_heights(profile.before) for profile in profiles]),
        "above_surface_after": np.concatenate([_covered_heights(profile.after) for profile in profiles]),
        "sigma": np.where(on_surface, np.concatenate([profile.sigmas for profile in profiles]), np.nan),
        "slope_{}": np.concatenate(slopes),
    })  # fmt: skip


def _covered_heights(state: ProfileState) -> Array:
    """(n,) m, heights above the surface; NaN beside it."""
    return np.where(state.heights.covered, state.heights.heights, np.nan)


def slopes_of(state: ProfileState) -> Array:
    """(n, 2) slopes of the surface at the shots, eastward and northward, metres upward per metre."""
    east, north, up = np.einsum("nkj,nj->kn", east_north_up(state.points), state.heights.normals)
    return np.stack([-east / up, -north / up], axis=1)


# --- words


def relief_statements(registration: ReliefRegistration) -> list[str]:
    """Results in sentences with numbers and units; the table of profiles has each by itself."""
    profiles, solution, reach = registration.profiles, registration.solution, registration.settings.reach
    used = [profile for profile in profiles if np.any(profile.on_surface)]
    tied, sentences = [profile for profile in used if profile.after.cost.tied], list[str]()
    if known_before := [profile for profile in tied if profile.before.cost.tied]:
        before, after = (
            root_mean_square(np.array([np.linalg.norm(getattr(profile, state).misplacement)
                                       for profile in known_before]))
            for state in ("before", "after")
        )
        sigma = np.nanmedian([np.sqrt(np.trace(profile.after.misplacement_covariance)) for profile in known_before])
        sentences.append(f"Before, {many(len(known_before), 'profile')} and the images disagreed by {before:.0f} m "
                         f"(rms); after, by {after:.1f} m (median sigma {sigma:.1f} m).")  # fmt: skip
    for members, condition in (
        ([profile for profile in tied if profile.after.cost.clear], f"have one clear minimum within {reach:.0f} m"),
        ([profile for profile in tied if not profile.after.cost.clear and profile.after.cost.reached],
         "have several possible minima, and heights that count as those of level ground"),
        ([profile for profile in tied if not profile.after.cost.reached],
         "keep off their best shift in adjustments, and have heights that count as those of level ground"),
        ([profile for profile in used if not profile.after.cost.tied], "are not tied by relief"),
        ([profile for profile in profiles if not np.any(profile.on_surface)],
         "have too few shots on the surface to take part"),
    ):
        if members:
            names = some([profile.name for profile in members])
            sentences.append(f"{len(members)} of {len(profiles)} profiles {condition} ({names}).")
    if solution.network.considered:
        named = some(solution.network.considered)
        sentences.append(f"Considered, not estimated: {named}; their a-priori sigmas are part of all sigmas.")
    sentences.append(f"Sigma0 is {registration.before.sigma0:.3g} without stereo rows, "
                     f"{solution.sigma0:.3g} with them.")
    if (crossing := _crossovers_json(solution))["count"]:
        sentences.append(f"{many(crossing['count'], 'crossover')} of laser profiles: heights differ by "
                         f"{crossing['rms_m']:.2g} m rms, {crossing['rms_sigmas']:.2g} of their sigmas.")  # fmt: skip
    if not solution.converged:
        sentences.append(f"The adjustment has NOT CONVERGED. {solution.message}")
    return sentences

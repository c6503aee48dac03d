"""Summary of a demo: sentences and tables; the same as summary.json. Sigmas are predicted ones, for sigma0 = 1."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from mgsgraph.adjustment.solution import Solution, orientation_profile
from mgsgraph.analysis.statistics import PLACES
from mgsgraph.case.reading import Case
from mgsgraph.files.output.folders import DEMO, PROGRAM
from mgsgraph.files.output.table import Table, plain, write_json
from mgsgraph.geometry import rotation
from mgsgraph.geometry.records import Array, sigmas_of
from mgsgraph.geometry.trajectory import Pose
from mgsgraph.network import PointClass
from mgsgraph.registration.minima import ReliefRegistration
from mgsgraph.results.registration import discrepancy_json, write_registration_into
from mgsgraph.results.relief import write_coregistration_into
from mgsgraph.results.results import write_into
from mgsgraph.results.section import table_of
from mgsgraph.simulation.demo.demonstration import (
    BY_RELIEF,
    DRAWING,
    INPUTS,
    KERNELS,
    PAIR,
    TIES,
    Demonstration,
    demonstrate,
    demonstrate_pair,
    disagreement_table,
    overall,
    pair_statements,
    point_errors,
    point_statements,
    rms_length,
    true_points,
)
from mgsgraph.simulation.ground import grid_shift
from mgsgraph.simulation.mgs_files import grid_file
from mgsgraph.simulation.site import SimulatedSite, SimulationOptions
from mgsgraph.text import two
from mgsgraph.units import ARCSEC
from mgsgraph.workers import Stages

SUMMARY = "summary.json"
"""File of the demo's figures."""
FORMAT = 2
"""Version of its layout."""
_ERRORS = "rms_before_m", "rms_after_m", "predicted_m", "nees_per_freedom"
"""Members of `PointErrors` there."""


def write_demo(
    site: str,
    folder: Path,
    seed: int,
    options: SimulationOptions,
    adjusting: Callable[[Case], Solution],
    stages: Stages,
    figures: bool = True,
    relief: bool = True,
) -> tuple[Solution, list[str], list[str]]:
    """Run the demo of a study site, or of the pair, with all products in a folder that exists: inputs in a folder of
    their own, tables, figures and summary.json. Returns the solution, the tables' lines and the sentences.
    """
    inputs = folder / INPUTS
    if site == PAIR:
        pair, solution = demonstrate_pair(inputs, seed, adjusting, stages)
        with stages.stage(DRAWING):
            write_into(solution, folder, figures)
        _write_record(folder)
        return solution, [], pair_statements(solution, pair)
    demo = demonstrate(site, inputs, seed, options, adjusting, stages, relief)
    with stages.stage(DRAWING):
        if isinstance(demo.relief, ReliefRegistration):
            write_coregistration_into(demo.relief, folder, figures)
        else:
            write_into(demo.solution, folder, figures)
        write_registration_into(demo.registration, folder, figures)
        disagreement_table(demo.disagreements).write_csv(folder / "disagreement.csv")
    write_json(folder / SUMMARY, summary_json(demo))
    _write_record(folder)
    lines = [line for table in tables(demo) for line in (table.title, *table.text(indent=2), "")]
    return demo.solution, lines, demo_statements(demo)


def _write_record(folder: Path) -> None:
    """Name the files of the case, so that no other file among them is lost when the demonstration is made anew."""
    files = sorted(path.relative_to(folder).as_posix() for path in (folder / INPUTS).rglob("*") if path.is_file())
    write_json(folder / DEMO, {"program": PROGRAM, "format": FORMAT, "files": files})


# --- tables


def tables(demo: Demonstration) -> tuple[Table, ...]:
    """Injected errors; disagreements of MOLA and MOC; and of all shifts, true and found."""
    return injected_table(demo.simulated), disagreement_table(demo.disagreements), shifts_table(demo)


def injected_table(simulated: SimulatedSite) -> Table:
    """The errors of the kernels of each image (in its middle), and of the profile along with it."""
    errors = [image.errors for image in simulated.images]
    return table_of("injected", {
        "position_{}": np.array([error.position[0] for error in errors]),
        "{}": np.array([error.rotation[0] / ARCSEC for error in errors]),
    }, simulated.images)  # fmt: skip


def shifts_table(demo: Demonstration) -> Table:
    """True and found shift of profiles and terrain model: what is to be added to archived positions."""
    solution = demo.solution
    true = {image.settings.profile: -np.asarray(image.profile.shift) for image in demo.simulated.images}
    moved = -np.asarray(grid_shift(demo.simulated.terrain))  # known by its file's name where it takes part by cells
    true |= dict.fromkeys(("terrain model", grid_file(demo.simulated, "r")), moved)
    names = solution.network.shift_names
    sigmas = np.array([sigmas_of(solution.shift_covariance(p)) for p in range(len(names))])
    return table_of("true_shifts", {
        "name": list(names), "true_{}": np.array([true[name] for name in names]), "found_{}": np.array(solution.shifts),
        "sigma_{}": sigmas,
    }, name="shifts")  # fmt: skip


# --- words


def headline(demo: Demonstration) -> str:
    """By how much MOLA and MOC disagree before and after, with the predictions."""
    compared = demo.disagreements
    (before, _), (ties, of_ties) = overall(compared, KERNELS), overall(compared, TIES)
    text = (
        f"MOLA against MOC: {before:.0f} m by the kernels, {ties:.0f} m (predicted {of_ties:.0f}) with tie points and "
        "ranges"
    )
    if isinstance(demo.relief, str):
        return f"{text}; registration by relief, which would remove it, was left out: {demo.relief}."
    now, predicted = overall(compared, BY_RELIEF)
    return f"{text}, {now:.1f} m (predicted {predicted:.1f}) with registration by relief."


def demo_statements(demo: Demonstration) -> list[str]:
    """Four sentences: MOLA against MOC, image against image, absolute errors, and stated sigmas against these."""
    before, after = (
        rms_length(np.concatenate([pair.metres for profile in profiles for pair in profile.discrepancies]))
        for _, profiles in demo.registration.states()
    )
    between = f"Image against image at the laser footprints: {two(before)} m by the kernels, {two(after)} m adjusted."
    return [headline(demo), between, *point_statements(demo.solution, true_points(demo))]


# --- summary.json


def summary_json(demo: Demonstration) -> dict[str, Any]:
    """All figures of a demo, as plain values for strict JSON."""
    solution = demo.solution
    record: dict[str, Any] = plain({
        "program": PROGRAM,
        "format": FORMAT,
        "site": demo.simulated.settings.name,
        "seed": demo.simulated.seed,
        "converged": solution.converged,
        "sigma0": solution.sigma0,
        "truth": {
            "counting": "projected minus true places; along and across the flight; sigmas are predicted ones",
            "footprints": [
                {"state": row.state, "profile": row.profile, **discrepancy_json(row.found)}
                for row in demo.disagreements
            ],
        },
        "orientation": [_orientation(demo, j) for j in range(len(solution.network.images))],
        "terrain_shift_east_north_m": grid_shift(demo.simulated.terrain),
        **{table.name: table.records() for table in tables(demo)},
        "points": {
            kind.name.lower(): dict(zip(_ERRORS, errors, strict=True))
            for kind in (PointClass.TIE, PointClass.LASER)
            if (errors := point_errors(solution, true_points(demo), kind))
        },
        "seconds": demo.stages.seconds,
        "statements": demo_statements(demo),
    })
    return record


def _orientation(demo: Demonstration, j: int) -> dict[str, Any]:
    """Errors of one image over the papers' 31 places before and after, and what is left of them in predicted sigmas."""
    solution = demo.solution
    image, profile = solution.network.images[j], orientation_profile(solution, j, PLACES)
    true = demo.simulated.images[j].true.pose(profile.lines)
    before, after = image.pose(profile.lines), image.pose(profile.lines, solution.correction(j))
    left, turned = after.position - true.position, _turn(after, true)
    return {
        "image": image.name,
        "error_before_mean_m": (before.position - true.position).mean(axis=0),
        "error_before_mean_arcsec": _turn(before, true).mean(axis=0) / ARCSEC,
        "error_after_mean_m": left.mean(axis=0),
        "error_after_mean_arcsec": turned.mean(axis=0) / ARCSEC,
        "largest_sigmas_position": np.abs(left / profile.position_sigma).max(axis=0),
        "largest_sigmas_rotation": np.abs(turned / profile.rotation_sigma).max(axis=0),
    }


def _turn(pose: Pose, true: Pose) -> Array:
    """(n, 3) rad about the camera's axes, by which the camera is turned from its true attitude."""
    return -rotation.logarithm(pose.matrix @ true.matrix.mT)

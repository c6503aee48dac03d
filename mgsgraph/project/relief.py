"""Laser profiles and images of a project onto each other by relief: from then on the project has the stereo surfaces,
and which shots lie on them, and every adjustment of it has their rows.
"""

from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

from mgsgraph.adjustment.incremental.incremental import IncrementalAdjustment
from mgsgraph.case.reading import Case, read_case
from mgsgraph.errors import InputError
from mgsgraph.project.project import Project
from mgsgraph.registration.minima import ReliefRegistration, ReliefSettings
from mgsgraph.registration.relief import profile_names, register_by_relief
from mgsgraph.results.relief import write_coregistration
from mgsgraph.workers import Progress, no_progress


class RegisteredProject(NamedTuple):
    """Result of `align`."""

    registration: ReliefRegistration
    """Its solution is the project's from now on."""
    folder: Path
    """Folder of the products."""


def align(
    project: Project,
    settings: ReliefSettings,
    workers: int | None = None,
    figures: bool = True,
    progress: Progress = no_progress,
) -> RegisteredProject:
    """Register the laser profiles of a project with the surface that its images show, and take the result over.

    Everything in the project is adjusted; the pictures are those of the images that its case names. Tie points stay on
    a terrain model, whose posts a project doesn't hold, nor crossovers of profiles.

    Raises
    ------
    InputError
        As `register_by_relief`; a project without a case, or without a measure.
    """
    case, shown = _case(project, settings)
    settings = replace(settings, images=settings.images or shown, crossovers=False)
    found = register_by_relief(case, settings, workers=workers, progress=progress)
    IncrementalAdjustment(case.settings, project.store).adopt(found.solution)
    shots = int(found.solution.stereo_used.sum())
    what = f"{len(found.profiles)} laser profiles"
    summary = {"cost": found.solution.cost_final, "converged": found.solution.converged, "shots": shots}
    project.record("align", what, summary)
    progress("tables and figures" if figures else "tables", 0, 1)
    folder = project.keep_solution(
        found.solution, write=lambda to: write_coregistration(found, to, figures, case.path, project.networks)
    )
    return RegisteredProject(found, folder)


def _case(project: Project, settings: ReliefSettings) -> tuple[Case, tuple[str, ...]]:
    """The case of a project, all that is in the project in the place of its network; and which images both have."""
    if project.case is None or not project.store.members():
        found = "no case that names its images' pixels" if project.case is None else "nothing to adjust"
        remedy = f"mgsgraph project init {project.folder} --case CASE, where CASE has pixels, ties and laser profiles"
        raise InputError(str(project.folder), found, "a project made with a case, and measures", remedy)
    network = replace(project.store.network(), stereo=None)
    case = read_case(project.case, ties=_ties(project))
    for name in profile_names(network):
        if settings.footprint is None and name not in case.footprints:
            where = f"{project.folder}, laser profile {name}"
            raise InputError(where, "a footprint that its case doesn't say", "its diameter", "give --footprint M")
    there = set(project.store.image_names())
    shown = tuple(image.name for image in case.network.images if image.name in there)
    solver, name = project.settings.solver.settings, project.name
    return replace(case, network=network, terrain=(), settings=solver, name=name), shown


def _ties(project: Project) -> Path | None:
    """Tie points that `mgsgraph match` has found for the project; None where the case has its own."""
    found = project.matches / "network.pvl"
    return found if found.is_file() else None

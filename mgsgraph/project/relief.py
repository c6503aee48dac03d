"""Registration of the laser profiles of a project with its images by relief. The project keeps the stereo surfaces and
the shots on them, so that every later adjustment uses them.
"""

from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

from mgsgraph.adjustment.incremental.incremental import IncrementalAdjustment
from mgsgraph.case.reading import Case, read_case
from mgsgraph.errors import InputError, command_line
from mgsgraph.network import PointClass
from mgsgraph.project.former import former_content
from mgsgraph.project.project import Project
from mgsgraph.registration.minima import ReliefRegistration, ReliefSettings
from mgsgraph.registration.relief import profile_names, register_by_relief
from mgsgraph.results.relief import write_coregistration
from mgsgraph.workers import Progress, no_progress


class RegisteredProject(NamedTuple):
    """Result of `align`."""

    registration: ReliefRegistration
    """Its solution becomes the state of the project."""
    folder: Path
    """Folder of the products."""


def align(
    project: Project,
    settings: ReliefSettings,
    workers: int | None = None,
    figures: bool = True,
    progress: Progress = no_progress,
) -> RegisteredProject:
    """Register the laser profiles of a project with the surface in its images, and store the result.

    The whole project is adjusted. The pixels come from the images of its case. Tie points stay on the terrain model.
    Posts of a terrain model and crossovers of profiles take no part: a project does not store them.

    Raises
    ------
    InputError
        As `register_by_relief`; a project without a case or without measurements.
    """
    case, shown_images = _case_of_project(project, settings)
    settings = replace(settings, images=settings.images or shown_images, crossovers=False)
    result = register_by_relief(case, settings, workers=workers, progress=progress)
    points = case.network.points
    former = former_content(project, points.ids[points.classes == PointClass.LASER])
    IncrementalAdjustment(case.settings, project.store).adopt(result.solution)
    shots = int(result.solution.stereo_used.sum())
    what = f"{len(result.profiles)} laser profiles"
    summary = {"cost": result.solution.cost_final, "converged": result.solution.converged, "shots": shots}
    project.record("align", what, summary, former=former)
    progress("tables and figures" if figures else "tables", 0, 1)
    folder = project.keep_solution(
        result.solution, write=lambda to: write_coregistration(result, to, figures, case.path, project.networks)
    )
    return RegisteredProject(result, folder)


def _case_of_project(project: Project, settings: ReliefSettings) -> tuple[Case, tuple[str, ...]]:
    """The case of a project with the project's network in it, and the names of images that both have."""
    if project.case is None or not project.store.members():
        reason = "no case that names its images' pixels" if project.case is None else "nothing to adjust"
        remedy = f"{command_line('project', 'init', project.folder)} --case CASE (with pixels, ties and profiles)"
        raise InputError(str(project.folder), reason, "a project made with a case, and measures", remedy)
    network = replace(project.store.network(), stereo=None)
    case = read_case(project.case, ties=project.matched_ties)
    for name in profile_names(network):
        if settings.footprint is None and name not in case.footprints:
            where = f"{project.folder}, laser profile {name}"
            raise InputError(where, "a footprint that its case doesn't say", "its diameter", "give --footprint M")
    stored_names = set(project.store.image_names())
    shown_images = tuple(image.name for image in case.network.images if image.name in stored_names)
    solver, name = project.settings.solver.settings, project.name
    return replace(case, network=network, terrain=(), settings=solver, name=name), shown_images

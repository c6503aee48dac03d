"""The changes of a project, from its creation on: each is one transaction of its file and recorded in its history."""

from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from mgsgraph.adjustment.incremental.impact import BatchCheck, Impact
from mgsgraph.adjustment.incremental.incremental import IncrementalAdjustment
from mgsgraph.adjustment.incremental.state import Bundle, require_one_body, with_addition, with_points, without
from mgsgraph.adjustment.incremental.trajectories import extended, shortened, turned_bundles, unknowns_of
from mgsgraph.adjustment.settings import Device, SolverSettings
from mgsgraph.case.case_file import decode
from mgsgraph.errors import InputError, command_line, errors_from, require
from mgsgraph.files.output.folders import PROJECT
from mgsgraph.network import Network
from mgsgraph.network.duplicates import duplicates
from mgsgraph.network.joining import Definitions, definitions
from mgsgraph.network.parts import KnownImage, Members, Unknown
from mgsgraph.project.addition import (
    Addition,
    ImageArgument,
    NewImage,
    images_of_case,
    images_without_ties,
    read_addition,
)
from mgsgraph.project.decisions import decided
from mgsgraph.project.former import former_content
from mgsgraph.project.project import Project, open_project
from mgsgraph.project.settings import ProjectSettings, read_settings, settings_of_case
from mgsgraph.project.store import ProjectStore
from mgsgraph.record import Record
from mgsgraph.workers import no_progress

if TYPE_CHECKING:
    from mgsgraph.adjustment.settings import Progress
    from mgsgraph.adjustment.solution import Solution
    from mgsgraph.results.tables import TableForm

Stages = Callable[[str], AbstractContextManager[None]]


def is_solved(project: Project) -> bool:
    """Whether all images have an adjusted orientation, so that an incremental adjustment can start from it."""
    store = project.store
    adjusted_unknowns = store.shared()
    needed_unknowns = {unknown for members in store.members() for unknown in members}
    pass_images = {name for pass_ in store.definitions().passes.values() for name in pass_.images}
    single_images = [name for name in store.image_names() if name not in pass_images]
    is_adjusted = all(Unknown("image", name) in adjusted_unknowns or store.image(name).held for name in single_images)
    is_adjusted &= adjusted_unknowns.keys() >= set(unknowns_of(store.definitions()))
    return is_adjusted and needed_unknowns.issubset(adjusted_unknowns)


def incremental(project: Project, settings: SolverSettings | None = None) -> IncrementalAdjustment:
    """Incremental adjustment that starts from the state of the project, with its settings or the given ones."""
    chosen_settings = settings or project.settings.solver.settings
    if project.cache is None:
        return IncrementalAdjustment(chosen_settings, project.store)
    return project.cache.resumed(next(iter(project.changes(1)), None), chosen_settings, project.store)


@dataclass(frozen=True, slots=True)
class Changed:
    """Result of a change of a point, or of undo or redo."""

    kind: str
    """measure, move, reject, accept, hold, release, remove, undo or redo."""
    point: str
    """Name of the point; empty for undo and redo of another change than that of a point."""
    sentence: str
    """Description of the change."""
    impact: Impact | None
    """Effect on other unknowns and points; None in a project that was never solved."""
    change: int
    """Number of the change in the project's history."""


def add(project: Project, addition: Addition, why: str = "") -> Impact | None:
    """Add images and measurements, and adjust; a project that was never solved only stores them and returns None."""
    store, network = project.store, addition.network
    former = former_content(project, () if network is None else network.points.ids, absent=addition.names)
    impact: Impact | None = None
    if not is_solved(project):
        store_unadjusted(store, addition)
    elif network is None:
        impact = incremental(project).add([new.known for new in addition.images], brought=addition.definitions)
    else:
        impact = incremental(project).add(network, brought=addition.definitions)
    _record_files(project, addition.images, addition.networks)
    rays = 0 if network is None else network.rays.point.size
    ranges = 0 if network is None else network.ranges.point.size
    what = ", ".join(addition.names) or "measures"
    files = [str(file) for file in addition.files]
    summary = {"images": list(addition.names), "rays": rays, "ranges": ranges, "files": files}
    record_change(project, "add", what, summary, impact, why, former)
    return impact


def remove_images(project: Project, images: Sequence[str], why: str = "") -> Impact | None:
    """Remove images with their measurements, and adjust (not in a project that was never solved: None).

    Parameters
    ----------
    project : Project
        Opened with `write=True`.
    images : sequence of str
        Names, or parts of names that no other has.
    why : str
        Reason, for the history.

    Raises
    ------
    InputError
        If the project has no image of such a name.

    Examples
    --------
    >>> _ = mgsgraph.create_project("fewer", case="pair/case.toml")
    >>> with mgsgraph.open_project("fewer", write=True) as project:
    ...     print(mgsgraph.remove_images(project, ["SIM/B"]), [change.what for change in project.changes()])
    None ['pair/case.toml', 'SIM/B']
    """
    store, images = project.store, project.images_named(images)
    bundles = dict.fromkeys(members for image in images for members in store.seen_by(image))
    points = (point for members in bundles for point in store.bundle(members).network.points.ids)
    former = former_content(project, points, removed=images)
    impact: Impact | None = None
    if is_solved(project):
        impact = incremental(project).remove(*images)
    else:
        _remove_unadjusted(store, images)
    record_change(project, "remove", ", ".join(images), {"images": list(images)}, impact, why, former)
    return impact


@dataclass(frozen=True, slots=True, eq=False)
class SolvedProject(Record):
    """Result of `solve_project`."""

    solution: "Solution"
    """Batch solution of all images."""
    check: BatchCheck | None
    """Differences of the incremental result from the batch solution; None where there was none."""
    folder: Path
    """Folder of the products."""


def solve_project(
    project: Project, figures: bool = True, tables: "TableForm | None" = None,
    progress: "Progress" = no_progress, device: Device | None = None,
) -> SolvedProject:  # fmt: skip
    """Adjust the whole project in one batch, compare with the incremental result, and write the products.

    Parameters
    ----------
    project : Project
        Opened with `write=True`.
    figures, tables
        As of `write_results`.
    progress : callable
        Called with every iteration.
    device : Device, optional
        Device that eliminates the points; that of the settings when absent.

    Raises
    ------
    InputError
        If no image of the project has a measurement.
    WeakNetwork
        If the measurements leave some direction of the orientation undetermined.

    Examples
    --------
    >>> _ = mgsgraph.create_project("solved", case="pair/case.toml")
    >>> with mgsgraph.open_project("solved", write=True) as project:
    ...     print(mgsgraph.solve_project(project, figures=False).folder)
    solved/solutions/0001
    """
    from mgsgraph.adjustment.adjust import adjust_network
    from mgsgraph.results.results import write_results

    name, settings, store = project.name, project.settings.solver.settings, project.store
    settings = settings if device is None else replace(settings, device=device)
    if not store.members():
        found = "nothing to adjust: no measure in any image"
        remedy = command_line("project", "add", project.folder, "IMAGE")
        if project.case is not None:
            remedy = f"find tie points in them: {command_line('match', project.folder)}"
        raise InputError(str(project.folder), found, "tie points or laser shots", remedy)
    check: BatchCheck | None = None
    with errors_from(str(project.folder)):
        if is_solved(project):
            check, solution = incremental(project, settings).verify(name, progress)
        else:
            solution = adjust_network(store.network(), replace(settings, starts=0), name, progress)
            incremental(project, settings).adopt(solution)
    summary = {"cost": solution.cost_final, "converged": solution.converged}
    if check is not None and np.isfinite(check.worst):
        summary["largest_difference_sigmas"] = check.worst
    project.record("solve", f"{len(solution.network.images)} images", summary)
    folder = project.keep_solution(
        solution, lambda to: write_results(solution, to, figures, networks=project.networks, tables=tables)
    )
    return SolvedProject(solution, check, folder)


def solve_case(
    case: Path, folder: Path, figures: bool, tables: "TableForm | None", device: Device | None
) -> "Solution":
    """Solution of the project of a case, which is made where there is none. Images that the case has and an earlier
    project does not are added with their points. Each step is complete or absent: the call may be killed and repeated.
    """
    exists = (folder / PROJECT).is_file()
    if not exists:
        create_project(folder, case=case)
    with open_project(folder, write=True) as project:
        if exists:
            _add_what_has_come(case, project)
        return solve_project(project, figures, tables, device=device).solution


def _add_what_has_come(case: Path, project: Project) -> None:
    """Add the images that a case has and its project has not, with their points."""
    found, remedy = "other settings than its project has", f"move {project.folder} away to have a new project"
    require(settings_of_case(case) == project.settings, str(case), found, remedy=remedy)
    addition = read_addition(project, [ImageArgument(case)], (), (), grown=True)
    if addition.images:
        add(project, addition, "the case has grown")


def store_unadjusted(store: ProjectStore, addition: Addition) -> None:
    """Store images and measurements without an adjustment: their bundles wait for one."""
    require_one_body(store, [new.known for new in addition.images])
    for new in addition.images:
        store.add_image(new.known)
    network = None if addition.network is None else store.with_known_grids(addition.network)
    old_definitions = store.definitions()
    new_definitions = extended(store, old_definitions, addition.definitions, [new.known for new in addition.images])
    turned_members = turned_bundles(store, old_definitions, new_definitions)
    replace_unadjusted(store, new_definitions, *with_addition(store, network, new_definitions, turned_members))


def _remove_unadjusted(store: ProjectStore, images: Sequence[str]) -> None:
    old_definitions = store.definitions()
    new_definitions = shortened(store, old_definitions, images)
    changed_bundles = without(store, images, new_definitions, turned_bundles(store, old_definitions, new_definitions))
    replace_unadjusted(store, new_definitions, *changed_bundles, images)


def replace_unadjusted(
    store: ProjectStore, definitions: Definitions, replaced: Sequence[Members], networks: Mapping[Members, Network],
    removed: Sequence[str] = (),
) -> None:  # fmt: skip
    """Replace bundles (`replaced`) by others that are not adjusted yet, and definitions by those that they are of.
    Images that are `removed` go.
    """
    store.set_definitions(definitions)
    unadjusted = dict[Members, Bundle]()
    for members, network in networks.items():
        size = len(network.points)
        unadjusted[members] = Bundle(network, None, np.full((size, 3), np.nan), np.full((size, 3, 3), np.nan))
    store.replace(replaced, unadjusted)
    for name in removed:
        store.drop_image(name)


def apply_content(
    project: Project, verb: str, points: Sequence[str], network: Network | None, new: Sequence[KnownImage],
    removed: Sequence[str], definitions: Definitions,
) -> Impact | None:  # fmt: skip
    """Replace points by those of a network, with images that come and go, and adjust (not in a project that was never
    solved: None).
    """
    store = project.store
    if is_solved(project):
        return incremental(project).replace_points(points, network, verb, new, removed, definitions)
    for known in new:
        store.add_image(known)
    turned = turned_bundles(store, store.definitions(), definitions)
    bundles = with_points(store, points, network, definitions, turned)
    replace_unadjusted(store, definitions, *bundles, removed)
    return None


def _record_files(project: Project, images: Sequence[NewImage], networks: Sequence[Path]) -> None:
    for new_image in images:
        if new_image.picture is not None:
            project.take_picture(new_image.known.image.name, new_image.picture)
    project.add_networks(networks)


def record_change(
    project: Project, verb: str, what: str, summary: Mapping[str, Any], impact: Impact | None, why: str = "",
    former: bytes | None = None, undoes: int | None = None,
) -> int:  # fmt: skip
    """Record a change in the history, with its effect on images and points; its number."""
    if impact is None:
        return project.record(verb, what, summary, why, former, undoes)
    moved_points = int(np.count_nonzero(~impact.points.new))
    counts = {"images_reached": len(impact.images.names), "points_moved": moved_points, "updates": impact.updates,
              "seconds": round(impact.seconds, 3)}  # fmt: skip
    number = project.record(verb, what, {**summary, **counts}, why, former, undoes)
    message = "All unknowns converged." if impact.converged else "It did not converge; solve the project."
    project.record_incremental(impact.converged, message)
    if project.cache is not None:
        project.cache.noted(*project.changes(1))
    return number


class NewProject(NamedTuple):
    """Result of `create_project`."""

    words: str
    """Contents of the project, in words."""
    waits: bool
    """Whether its images wait for tie points."""
    notes: tuple[str, ...] = ()
    """Sentences about measurements of its case that were left out or are given twice."""


def create_project(
    folder: str | Path, name: str = "", case: str | Path | None = None, settings: Path | None = None,
    stages: Stages = lambda _: nullcontext(),
) -> NewProject:  # fmt: skip
    """Create a project. A case without image measurements gives only its images, which then wait for tie points.

    Parameters
    ----------
    folder : path
        Absent or empty.
    name : str
        Name of the project; when empty that of the case, the settings or the folder.
    case : path, optional
        A case file: the project takes its images, measurements, terrain model and settings.
    settings : Path, optional
        A file of settings, for a project without a case.
    stages : callable
        Called with a description of each stage; returns a context manager.

    Raises
    ------
    InputError
        If the folder holds anything, or the case or the settings can't be read.

    Examples
    --------
    >>> print(mgsgraph.create_project("kept", case="pair/case.toml").words)
    2 images, 28 points, 56 image measures, 8 laser ranges
    """
    folder, case = Path(folder), None if case is None else Path(case)
    if case is None:
        name_in_file, chosen_settings = read_settings(settings) if settings is not None else ("", ProjectSettings())
        with Project.create(folder, name or name_in_file, chosen_settings) as project:
            project.record("init", "empty", {})
        return NewProject("empty", False)
    with stages("reading the case"):
        network: Network | None = None
        files, notes = tuple[Path, ...](), tuple[str, ...]()
        if decode(case).measured:
            images, contents = images_of_case(case)
            network, name_in_file, files = contents.network, contents.name, contents.networks
            notes = (*contents.notes, *(f"{duplicate.sentence}." for duplicate in duplicates(network)))
        else:
            images, name_in_file = images_without_ties(case)
        chosen_settings = settings_of_case(case)
    with stages("writing the project"), Project.create(folder, name or name_in_file, chosen_settings, case) as project:
        description = _store_contents(project, "init", str(case), images, network, files)
    return NewProject(description, network is None, notes)


def waiting_case(project: Project) -> Path:
    """The case of a project whose images wait for tie points.

    Raises
    ------
    InputError
        A project with measurements or without a case; a case with other images than the project.
    """
    if project.store.members():
        raise InputError(
            str(project.folder), "it has measures already", "a project whose images wait for tie points",
            "find others: mgsgraph match CASE --out MATCHES, "
            + command_line("project", "add", project.folder, "--ties", "NETWORK"),
        )
    if project.case is None:
        raise InputError(
            str(project.folder), "a project that was made without a case", "one made with mgsgraph project init --case",
            "give the case file itself: mgsgraph match CASE --out MATCHES",
        )
    stated, stored = [image.name for image in decode(project.case).images], project.store.image_names()
    if set(stated) != set(stored):
        raise InputError(
            str(project.case), f"the images {', '.join(stated)}", f"those of {project.folder}, {', '.join(stored)}",
            f"begin another project with it: {command_line('project', 'init', 'PROJECT', '--case', project.case)}",
        )
    return project.case


def take_ties(project: Project, network: Path) -> str:
    """Store tie points in a project that waits for them, with all else of its case as it is now; a description."""
    case = waiting_case(project)
    images, contents = images_of_case(case, network)
    former = former_content(project, contents.network.points.ids)
    project.take_settings(settings_of_case(case))
    kept = decided(contents.network, project.standing_decisions())
    return _store_contents(project, "match", str(network), images, kept, contents.networks, former)


def _store_contents(
    project: Project, verb: str, what: str, images: list[NewImage], network: Network | None, files: Sequence[Path],
    former: bytes | None = None,
) -> str:  # fmt: skip
    """Store images and measurements, and record the change; a description of them."""
    case_definitions = Definitions() if network is None else definitions(network)
    store_unadjusted(project.store, Addition(tuple(images), network, definitions=case_definitions))
    _record_files(project, images, files)
    points, rays, ranges = (
        (0, 0, 0) if network is None else (len(network.points), network.rays.point.size, network.ranges.point.size)
    )
    names = [new_image.known.image.name for new_image in images]
    summary = {"images": names, "points": points, "rays": rays, "ranges": ranges}
    project.record(verb, what, summary, former=former)
    if network is None:
        return f"{len(images)} images, no tie points yet"
    return f"{len(images)} images, {points} points, {rays} image measures, {ranges} laser ranges"

"""The changes of a project, from its beginning on: each is one transaction of its file, noted in its history."""

from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from mgsgraph.adjustment.incremental.impact import Closing, Impact
from mgsgraph.adjustment.incremental.incremental import IncrementalAdjustment
from mgsgraph.adjustment.incremental.state import Bundle, require_one_body, with_addition, without
from mgsgraph.adjustment.incremental.trajectories import extended, shortened, turned_bundles, unknowns_of
from mgsgraph.adjustment.settings import Device, SolverSettings
from mgsgraph.case.case_file import decode
from mgsgraph.errors import InputError, errors_from
from mgsgraph.network import Network
from mgsgraph.network.duplicates import duplicates
from mgsgraph.network.joining import Definitions, definitions
from mgsgraph.network.parts import Members, Unknown
from mgsgraph.project.addition import Addition, NewImage, images_alone, images_of_case
from mgsgraph.project.project import Project
from mgsgraph.project.settings import ProjectSettings, read_settings, settings_of_case
from mgsgraph.project.store import ProjectStore
from mgsgraph.record import Record
from mgsgraph.workers import no_progress

if TYPE_CHECKING:
    from mgsgraph.adjustment.rounds import Progress
    from mgsgraph.adjustment.solution import Solution
    from mgsgraph.results.tables import TableForm

Stages = Callable[[str], AbstractContextManager[None]]


def is_solved(project: Project) -> bool:
    """Whether all images have an adjusted orientation, from which an incremental adjustment can go on."""
    store = project.store
    known = store.shared()
    needed = {unknown for members in store.members() for unknown in members}
    of_passes = {name for one in store.definitions().passes.values() for name in one.images}
    own = [name for name in store.image_names() if name not in of_passes]
    adjusted = all(Unknown("image", name) in known or store.image(name).held for name in own)
    adjusted &= known.keys() >= set(unknowns_of(store.definitions()))
    return adjusted and needed.issubset(known)


def incremental(project: Project, settings: SolverSettings | None = None) -> IncrementalAdjustment:
    """From the state that the project holds, with its settings or others."""
    wanted = settings or project.settings.solver.settings
    if project.kept is None:
        return IncrementalAdjustment(wanted, project.store)
    return project.kept.resumed(next(iter(project.changes(1)), None), wanted, project.store)


def add(project: Project, addition: Addition) -> Impact | None:
    """Add images and measures, and adjust; None in a project that has never been solved: they are only put in."""
    store, network = project.store, addition.network
    impact: Impact | None = None
    if not is_solved(project):
        put_in(store, addition)
    elif network is None:
        impact = incremental(project).add([one.known for one in addition.images], brought=addition.definitions)
    else:
        impact = incremental(project).add(network, brought=addition.definitions)
    _note_files(project, addition.images, addition.networks)
    rays = 0 if network is None else network.rays.point.size
    ranges = 0 if network is None else network.ranges.point.size
    what = ", ".join(addition.names) or "measures"
    files = [str(file) for file in addition.files]
    summary = {"images": list(addition.names), "rays": rays, "ranges": ranges, "files": files}
    note(project, "add", what, summary, impact)
    return impact


def remove_images(project: Project, images: Sequence[str]) -> Impact | None:
    """Take images out with their measures, and adjust; None in a project that has never been solved.

    Parameters
    ----------
    project : Project
        Opened with `write=True`.
    images : sequence of str
        Names, or parts of names that no other has.

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
    impact: Impact | None = None
    if is_solved(project):
        impact = incremental(project).remove(*images)
    else:
        _take_out(store, images)
    note(project, "remove", ", ".join(images), {"images": list(images)}, impact)
    return impact


def _closing_facts(closing: Closing | None) -> dict[str, Any]:
    if closing is None or not np.isfinite(closing.worst):
        return {}
    return {"largest_difference_sigmas": closing.worst}


@dataclass(frozen=True, slots=True, eq=False)
class SolvedProject(Record):
    """Result of `solve_project`."""

    solution: "Solution"
    """Batch solution of all images."""
    closing: Closing | None
    """How far the incremental result was off; None where there was none."""
    folder: Path
    """Folder of the products."""


def solve_project(
    project: Project, figures: bool = True, tables: "TableForm | None" = None,
    progress: "Progress" = no_progress, device: Device | None = None,
) -> SolvedProject:  # fmt: skip
    """Adjust everything by batch, compare it with the incremental result, and keep its products.

    Parameters
    ----------
    project : Project
        Opened with `write=True`.
    figures, tables
        As of `write_results`.
    progress : callable
        Called with every iteration.
    device : Device, optional
        That goes over the points; that of the settings when absent.

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
        found, remedy = "nothing to adjust: no measure in any image", f"mgsgraph project add {project.folder} IMAGE"
        if project.case is not None:
            remedy = f"find tie points in them: mgsgraph match {project.folder}"
        raise InputError(str(project.folder), found, "tie points or laser shots", remedy)
    closing: Closing | None = None
    with errors_from(str(project.folder)):
        if is_solved(project):
            closing, solution = incremental(project, settings).close(name, progress)
        else:
            solution = adjust_network(store.network(), replace(settings, starts=0), name, progress)
            incremental(project, settings).adopt(solution)
    summary = {"cost": solution.cost_final, "converged": solution.converged} | _closing_facts(closing)
    project.record("solve", f"{len(solution.network.images)} images", summary)
    folder = project.keep_solution(
        solution, lambda to: write_results(solution, to, figures, networks=project.networks, tables=tables)
    )
    return SolvedProject(solution, closing, folder)


def put_in(store: ProjectStore, addition: Addition) -> None:
    """Images and measures without an adjustment: their bundles wait for one."""
    require_one_body(store, [one.known for one in addition.images])
    for one in addition.images:
        store.add_image(one.known)
    network = None if addition.network is None else store.with_known_grids(addition.network)
    before = store.definitions()
    after = extended(store, before, addition.definitions, [one.known for one in addition.images])
    turned = turned_bundles(store, before, after)
    store.set_definitions(after)
    put_waiting(store, *with_addition(store, network, after, turned))


def _take_out(store: ProjectStore, images: Sequence[str]) -> None:
    before = store.definitions()
    after = shortened(store, before, images)
    changed = without(store, images, after, turned_bundles(store, before, after))
    store.set_definitions(after)
    put_waiting(store, *changed)
    for name in images:
        store.drop_image(name)


def put_waiting(store: ProjectStore, gone: Sequence[Members], networks: Mapping[Members, Network]) -> None:
    """Put bundles in the place of others, not adjusted yet."""
    waiting = dict[Members, Bundle]()
    for members, network in networks.items():
        n = len(network.points)
        waiting[members] = Bundle(network, None, np.full((n, 3), np.nan), np.full((n, 3, 3), np.nan))
    store.replace(gone, waiting)


def _note_files(project: Project, images: Sequence[NewImage], networks: Sequence[Path]) -> None:
    for one in images:
        if one.picture is not None:
            project.take_picture(one.known.image.name, one.picture)
    project.add_networks(networks)


def note(project: Project, verb: str, what: str, summary: dict[str, Any], impact: Impact | None) -> int:
    """Note a change in the history, with what it did to the rest; its number."""
    if impact is None:
        return project.record(verb, what, summary)
    moved = int(np.count_nonzero(~impact.points.new))
    counts = {"images_reached": len(impact.images.names), "points_moved": moved, "updates": impact.updates}
    number = project.record(verb, what, summary | counts | {"seconds": round(impact.seconds, 3)})
    message = "All unknowns converged." if impact.converged else "It did not converge; solve the project."
    project.record_incremental(impact.converged, message)
    if project.kept is not None:
        project.kept.noted(*project.changes(1))
    return number


class NewProject(NamedTuple):
    """A project that has been made."""

    words: str
    """Contents of the project, in words."""
    waits: bool
    """Whether its images wait for tie points."""
    notes: tuple[str, ...] = ()
    """What of its case's files was left out, or is given twice, in sentences."""


def create_project(
    folder: str | Path, name: str = "", case: str | Path | None = None, settings: Path | None = None,
    stages: Stages = lambda _: nullcontext(),
) -> NewProject:  # fmt: skip
    """Make a project; of a case without any measure in an image the images alone, which then wait for tie points.

    Parameters
    ----------
    folder : path
        Absent or empty.
    name : str
        What to call it; the case's or the folder's name when empty.
    case : path, optional
        A case file: its images, measurements, terrain and settings go in.
    settings : Path, optional
        A file of settings alone, where there is no case.
    stages : callable
        Called with what is being done; gives a context.

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
        called, chosen = read_settings(settings) if settings is not None else ("", ProjectSettings())
        with Project.create(folder, name or called, chosen) as project:
            project.record("init", "empty", {})
        return NewProject("empty", False)
    with stages("reading the case"):
        network: Network | None = None
        files, notes = tuple[Path, ...](), tuple[str, ...]()
        if decode(case).measured:
            images, read = images_of_case(case)
            network, called, files = read.network, read.name, read.networks
            notes = (*read.notes, *(f"{one.sentence}." for one in duplicates(network)))
        else:
            images, called = images_alone(case)
        chosen = settings_of_case(case)
    with stages("writing the project"), Project.create(folder, name or called, chosen, case) as project:
        words = _put(project, "init", str(case), images, network, files)
    return NewProject(words, network is None, notes)


def waiting_case(project: Project) -> Path:
    """The case of a project whose images wait for tie points.

    Raises
    ------
    InputError
        Any other project; a case that has other images by now.
    """
    if project.store.members():
        raise InputError(
            str(project.folder), "it has measures already", "a project whose images wait for tie points",
            f"find others: mgsgraph match CASE --out MATCHES, mgsgraph project add {project.folder} --ties NETWORK",
        )
    if project.case is None:
        raise InputError(
            str(project.folder), "a project that was made without a case", "one made with mgsgraph project init --case",
            "give the case file itself: mgsgraph match CASE --out MATCHES",
        )
    names, there = [image.name for image in decode(project.case).images], project.store.image_names()
    if set(names) != set(there):
        raise InputError(
            str(project.case), f"the images {', '.join(names)}", f"those of {project.folder}, {', '.join(there)}",
            f"begin another project with it: mgsgraph project init PROJECT --case {project.case}",
        )
    return project.case


def take_ties(project: Project, network: Path) -> str:
    """Put tie points into a project that waits for them, with everything else that its case says by now; in words."""
    case = waiting_case(project)
    images, read = images_of_case(case, network)
    project.take_settings(settings_of_case(case))
    return _put(project, "match", str(network), images, read.network, read.networks)


def _put(
    project: Project, verb: str, what: str, images: list[NewImage], network: Network | None, files: Sequence[Path]
) -> str:
    """Put images and measures in, and note it; what they are."""
    brought = Definitions() if network is None else definitions(network)
    put_in(project.store, Addition(tuple(images), network, definitions=brought))
    _note_files(project, images, files)
    points, rays, ranges = (
        (0, 0, 0) if network is None else (len(network.points), network.rays.point.size, network.ranges.point.size)
    )
    names = [one.known.image.name for one in images]
    project.record(verb, what, {"images": names, "points": points, "rays": rays, "ranges": ranges})
    if network is None:
        return f"{len(images)} images, no tie points yet"
    return f"{len(images)} images, {points} points, {rays} image measures, {ranges} laser ranges"

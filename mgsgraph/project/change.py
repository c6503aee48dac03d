"""The changes of a project: each is one transaction of its file, noted in its history."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from mgsgraph.adjustment.adjust import adjust_network
from mgsgraph.adjustment.incremental.closing import Closing
from mgsgraph.adjustment.incremental.impact import Impact
from mgsgraph.adjustment.incremental.incremental import IncrementalAdjustment
from mgsgraph.adjustment.incremental.state import Bundle
from mgsgraph.adjustment.passes import Progress
from mgsgraph.adjustment.solution import Solution
from mgsgraph.errors import InputError
from mgsgraph.network import Network
from mgsgraph.network.parts import Unknown, bundles, joined, without_images
from mgsgraph.project.addition import Addition, NewImage
from mgsgraph.project.project import Project
from mgsgraph.project.store import ProjectStore


def is_solved(project: Project) -> bool:
    """Whether all images have an adjusted orientation, from which an incremental adjustment can go on."""
    store = project.store
    known = store.shared()
    return all(Unknown("image", name) in known or store.image(name).held for name in store.image_names())


def _incremental(project: Project) -> IncrementalAdjustment:
    """From the state that the project holds; points are always eliminated there, to the same result."""
    return IncrementalAdjustment(replace(project.settings.solver_settings, form="bundle"), project.store)


def add(project: Project, addition: Addition) -> Impact | None:
    """Add images and measures, and adjust; None in a project that has never been solved: they are only put in."""
    store, network = project.store, addition.network
    impact: Impact | None = None
    if not is_solved(project):
        put_in(store, addition)
    elif network is None:
        impact = _incremental(project).add([one.known for one in addition.images])
    else:
        impact = _incremental(project).add(network)
    _note_sources(project, addition.images)
    rays = 0 if network is None else network.rays.point.size
    ranges = 0 if network is None else network.ranges.point.size
    what = ", ".join(addition.names) or "measures"
    files = [str(file) for file in addition.files]
    summary = {"images": list(addition.names), "rays": rays, "ranges": ranges, "files": files}
    _note(project, "add", what, summary, impact)
    return impact


def remove(project: Project, images: Sequence[str]) -> Impact | None:
    """Take images out with their measures, and adjust; None in a project that has never been solved."""
    store, there = project.store, set(project.store.image_names())
    for name in images:
        if name not in there:
            known = ", ".join(sorted(there)[:4]) or "it has none"
            raise InputError(str(project.folder), f"no image {name!r}", f"one of the project's ({known})")
    impact: Impact | None = None
    if is_solved(project):
        impact = _incremental(project).remove(*images)
    else:
        _take_out(store, images)
    _note(project, "remove", ", ".join(images), {"images": list(images)}, impact)
    return impact


@dataclass(frozen=True, slots=True, eq=False)
class Solved:
    """What `solve` has done."""

    solution: Solution
    """Of batch over everything."""
    closing: Closing | None
    """How far the incremental result was off; None where there was none."""
    folder: Path
    """Of the products."""


def solve(project: Project, figures: bool = True, progress: Progress = lambda _: None) -> Solved:
    """Adjust everything by batch, compare it with the incremental result, and keep its products."""
    name, settings, store = project.name, project.settings.solver_settings, project.store
    closing: Closing | None = None
    if is_solved(project) and store.members():
        closing, solution = _incremental(project).close(name, progress)
    else:
        solution = adjust_network(store.network(), settings, name, progress)
        _incremental(project).adopt(solution)
    summary: dict[str, Any] = {"cost": solution.cost_final, "converged": solution.converged}
    if closing is not None and np.isfinite(closing.worst):
        summary["largest_difference_sigmas"] = closing.worst
    project.record("solve", f"{len(solution.network.images)} images", summary)
    return Solved(solution, closing, project.keep_solution(solution, figures))


def put_in(store: ProjectStore, addition: Addition) -> None:
    """Images and measures without an adjustment: their bundles wait for one."""
    for one in addition.images:
        store.put_image(one.known)
    if addition.network is None:
        return
    network = store.own(addition.network)
    there = set(store.members())
    gone = sorted(set(store.homes(network.points.ids).values()))
    parts = [*(store.bundle(members).network for members in gone), network]
    found = bundles(joined(parts))
    others = [members for members in found if members in there and members not in gone]
    if others:
        found = bundles(joined([*parts, *(store.bundle(members).network for members in others)]))
    store.replace([*gone, *others], {members: _waiting(part) for members, part in found.items()})


def _take_out(store: ProjectStore, images: Sequence[str]) -> None:
    gone = list(dict.fromkeys(members for image in images for members in store.seen_by(image)))
    left = [rest for members in gone if (rest := without_images(store.bundle(members).network, images)) is not None]
    found = bundles(joined(left)) if left else {}
    others = [members for members in found if members in set(store.members()) and members not in gone]
    if others:
        found = bundles(joined([*left, *(store.bundle(members).network for members in others)]))
    store.replace([*gone, *others], {members: _waiting(part) for members, part in found.items()})
    for name in images:
        store.drop_image(name)


def _waiting(network: Network) -> Bundle:
    n = len(network.points)
    return Bundle(network, None, np.full((n, 3), np.nan), np.full((n, 3, 3), np.nan))


def _note_sources(project: Project, images: Sequence[NewImage]) -> None:
    for one in images:
        project.add_sources(one.known.image.name, one.files, one.picture)


def _note(project: Project, verb: str, what: str, summary: dict[str, Any], impact: Impact | None) -> None:
    if impact is None:
        project.record(verb, what, summary)
        return
    moved = int(np.count_nonzero(~impact.points.new))
    counts = {"images_reached": len(impact.images.names), "points_moved": moved, "updates": impact.updates}
    project.record(verb, what, summary | counts | {"seconds": round(impact.seconds, 3)})
    message = "All unknowns came to rest." if impact.converged else "It did not come to rest; solve the project anew."
    project.record_incremental(impact.converged, message)

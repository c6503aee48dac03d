"""What a project holds, as text for the terminal; read from the file's counts, without its points."""

from collections import Counter, defaultdict
from itertools import pairwise

import numpy as np

from mgsgraph.files.opening import understood
from mgsgraph.network import PointClass
from mgsgraph.network.connectivity import groups
from mgsgraph.project.connection import A_PROJECT, ELSEWHERE
from mgsgraph.project.project import CHANGING, Change, Project, SolutionRow, all_set_aside
from mgsgraph.text import many, some

_NAMED = 6
_HISTORY = 10


def status(project: Project) -> str:
    """The last solution, images, points and measurements, how they are connected, and the changes, the newest first."""
    with understood(str(project.folder), A_PROJECT, ELSEWHERE):
        return "\n".join(_lines(project))


def _lines(project: Project) -> list[str]:
    names = project.store.image_names()
    said = [*_solutions(project, bool(names)), *_contents(project), *_connections(project, names)]
    changes = project.changes(_HISTORY)[::-1]
    return [
        f"{project.name}: a project of {many(len(names), 'image')}, made {project.created[:16].replace('T', ' ')} UTC",
        *(f"- {one}" for one in said),
        f"Changes (UTC), the newest first{', the last 10' if len(changes) == _HISTORY else ''}:",
        *(_change(change) for change in changes),
    ]


def _contents(project: Project) -> list[str]:
    classes = project.store.point_classes()
    points = ", ".join(f"{count} {PointClass(number).name.lower()}" for number, count in classes.items())
    rays, ranges = project.store.measures()
    rejected, terrain = sum(map(len, all_set_aside(project).values())), project.store.terrain
    parts = [
        f"{many(sum(classes.values()), 'point')}{f' ({points})' if points else ''}", f"{rays} image measurements",
        f"{ranges} laser ranges", f"{rejected} rejected by the user" if rejected else "",
        f"{many(project.held_images, 'image')} held" if project.held_images else "",
    ]  # fmt: skip
    model = terrain and f"Terrain model: {terrain[0].source}, {' x '.join(map(str, terrain[0].radii.shape))} posts."
    return [f"{', '.join(filter(None, parts))}.", *([model] if model else []), *_passes(project)]


def _passes(project: Project) -> list[str]:
    """A line for each pass and each unknown that images share."""
    known = project.store.definitions()
    return [
        f"Pass {one.name}: {many(len(one.images), 'image')}, {many(len(one.nodes), 'orientation image')} "
        f"{one.nodes.spacing:.4g} s apart."
        for one in known.passes.values()
    ] + [f"Shared unknown {one.name} ({one.kind}): {many(len(one.images), 'image')}." for one in known.shared.values()]


def islands(names: list[str], bundles: list[tuple[str, int, int]]) -> list[list[str]]:
    """Images that are connected by common points, largest island first; `bundles` as `Project.bundle_images`."""
    number, of_bundle = {name: j for j, name in enumerate(names)}, defaultdict[int, list[int]](list)
    for name, bundle, _ in bundles:
        of_bundle[bundle].append(number[name])
    pairs = [pair for images in of_bundle.values() for pair in pairwise(images)]
    found = groups(len(names), np.array(pairs, dtype=np.int64).reshape(-1, 2))
    return [[names[j] for j in island] for island in found]


def _connections(project: Project, names: list[str]) -> list[str]:
    bundles = project.bundle_images()
    size = Counter(bundle for _, bundle, _ in bundles)
    linked = {name for name, bundle, _ in bundles if size[bundle] > 1}
    alone = [name for name in names if name not in linked]
    several = [island for island in islands(names, bundles) if len(island) > 1]
    said = []
    if len(several) == 1 and not alone:
        said.append("All images are connected by common points.")
    elif several:
        sizes = ", ".join(str(len(island)) for island in several)
        said.append(f"Images connected by common points: {many(len(several), 'group')} ({sizes} images).")
    said += [f"Apart from the largest group: {some(island, len(island), _NAMED)}." for island in several[1:]]
    return [*said, *([f"Unconnected images: {some(alone, len(alone), _NAMED)}."] if alone else [])]


def _solutions(project: Project, images: bool) -> list[str]:
    last, batch = project.last_solution(), project.last_solution("batch")
    if last is None:
        verb = "project solve" if project.store.members() or project.case is None else "match"
        return [f"Nothing is adjusted yet{f'; next: mgsgraph {verb} {project.folder}' if images else ''}."]
    said = [_solution(last)]
    if last.kind != "batch" and batch is not None:
        said.append(_solution(batch))
    since = [change for change in project.changes() if change.number > last.change and change.verb != "solve"]
    if since:
        said.append(f"Changes since then: {', '.join(f'{change.verb} {change.what}' for change in since[-_NAMED:])}.")
    unchecked = [
        change for change in project.changes()
        if change.verb in CHANGING and (batch is None or change.number > batch.change)
    ]  # fmt: skip
    changes = many(len(unchecked), "change") if unchecked else "No change"
    todo = f"; next: mgsgraph project solve {project.folder}" if unchecked else ""
    return [*said, f"{changes} since the last batch adjustment{todo}."]


def _solution(row: SolutionRow) -> str:
    state = "converged" if row.converged else "NOT converged"
    fit = ""
    if row.cost is not None:
        sigma0 = "no sigma0" if row.sigma0 is None else f"sigma0 {row.sigma0:.3g}"
        fit = f", {sigma0} ({row.degrees_of_freedom} degrees of freedom)"
    where = f", in {row.folder}" if row.folder else ""
    return (
        f"Solution {row.number} ({row.kind}, {row.at[:16].replace('T', ' ')}): {state}, {many(row.images, 'image')}, "
        f"{many(row.points, 'point')}{fit}{where}."
    )


def _change(change: Change) -> str:
    found = dict(change.summary)
    facts = [
        f"{found[key]} {word}"
        for key, word in (("rays", "image measurements"), ("ranges", "ranges"), ("points_moved", "points moved"))
        if found.get(key)
    ]
    if "largest_difference_sigmas" in found:
        facts.append(f"{found['largest_difference_sigmas']:.2g} sigmas from batch at most")
    noted = f" ({', '.join(facts)})" if facts else ""
    return f"  {change.number:4d}  {change.at[:19]}  {change.verb:<6} {change.what}{noted}"

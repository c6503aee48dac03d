"""Contents of a project as text for the terminal, from the counts in its file, without its points."""

from collections import Counter, defaultdict
from itertools import pairwise

import numpy as np

from mgsgraph.errors import command_line
from mgsgraph.files.opening import understood
from mgsgraph.names import numbered
from mgsgraph.network import PointClass
from mgsgraph.network.connectivity import groups
from mgsgraph.project.connection import EXPECTED_PROJECT, RESTORE_COPY
from mgsgraph.project.decisions import Decision
from mgsgraph.project.project import CHANGING, Change, Project, SolutionRow, rejected_measurements
from mgsgraph.text import many, some

_NAMED = 6
_HISTORY = 10


def status(project: Project) -> str:
    """Text with the last solution, images, points, measurements, their connections, and the changes, newest first."""
    with understood(str(project.folder), EXPECTED_PROJECT, RESTORE_COPY):
        return "\n".join(_lines(project))


def _lines(project: Project) -> list[str]:
    names = project.store.image_names()
    sentences = [*_solutions(project, bool(names)), *_contents(project), *_connections(project, names)]
    changes, decisions = project.changes(_HISTORY)[::-1], project.decisions()[::-1]
    return [
        f"{project.name}: a project of {many(len(names), 'image')}, made {project.created[:16].replace('T', ' ')} UTC",
        *(f"- {sentence}" for sentence in sentences),
        f"Changes (UTC), the newest first{', the last 10' if len(changes) == _HISTORY else ''}:",
        *(_change(change) for change in changes),
        *(["Decisions of users that stand, the newest first:"] if decisions else []),
        *(_decision(decision) for decision in decisions),
    ]


def _contents(project: Project) -> list[str]:
    classes = project.store.point_classes()
    points = ", ".join(f"{count} {PointClass(number).name.lower()}" for number, count in classes.items())
    rays, ranges = project.store.measures()
    rejected, terrain = len(rejected_measurements(project)), project.store.terrain
    parts = [
        f"{many(sum(classes.values()), 'point')}{f' ({points})' if points else ''}", f"{rays} image measurements",
        f"{ranges} laser ranges", f"{rejected} rejected by the user" if rejected else "",
        f"{many(project.held_images, 'image')} held" if project.held_images else "",
    ]  # fmt: skip
    model = terrain and f"Terrain model: {terrain[0].source}, {' x '.join(map(str, terrain[0].radii.shape))} posts."
    return [f"{', '.join(filter(None, parts))}.", *([model] if model else []), *_passes(project)]


def _passes(project: Project) -> list[str]:
    """A sentence for each pass and each unknown that images share."""
    stored = project.store.definitions()
    return [
        f"Pass {pass_.name}: {many(len(pass_.images), 'image')}, {many(len(pass_.nodes), 'orientation image')} "
        f"{pass_.nodes.spacing:.4g} s apart."
        for pass_ in stored.passes.values()
    ] + [
        f"Shared unknown {shared.name} ({shared.kind}): {many(len(shared.images), 'image')}."
        for shared in stored.shared.values()
    ]


def islands(names: list[str], bundles: list[tuple[str, int, int]]) -> list[list[str]]:
    """Images that are connected by common points, largest island first; `bundles` as `Project.bundle_images`."""
    index_of_name, of_bundle = numbered(names), defaultdict[int, list[int]](list)
    for name, bundle, _ in bundles:
        of_bundle[bundle].append(index_of_name[name])
    pairs = [pair for images in of_bundle.values() for pair in pairwise(images)]
    parts = groups(len(names), np.array(pairs, dtype=np.int64).reshape(-1, 2))
    return [[names[j] for j in part] for part in parts]


def _connections(project: Project, names: list[str]) -> list[str]:
    bundles = project.bundle_images()
    size = Counter(bundle for _, bundle, _ in bundles)
    linked = {name for name, bundle, _ in bundles if size[bundle] > 1}
    alone = [name for name in names if name not in linked]
    connected_groups = [island for island in islands(names, bundles) if len(island) > 1]
    lines = []
    if len(connected_groups) == 1 and not alone:
        lines.append("All images are connected by common points.")
    elif connected_groups:
        sizes = ", ".join(str(len(island)) for island in connected_groups)
        lines.append(f"Images connected by common points: {many(len(connected_groups), 'group')} ({sizes} images).")
    lines += [f"Apart from the largest group: {some(island, most=_NAMED)}." for island in connected_groups[1:]]
    return [*lines, *([f"Unconnected images: {some(alone, most=_NAMED)}."] if alone else [])]


def _solutions(project: Project, images: bool) -> list[str]:
    last, batch = project.last_solution(), project.last_solution("batch")
    if last is None:
        verb = "project solve" if project.store.members() or project.case is None else "match"
        return [f"Nothing is adjusted yet{f'; next: {command_line(*verb.split(), project.folder)}' if images else ''}."]
    lines = [_solution(last)]
    if last.kind != "batch" and batch is not None:
        lines.append(_solution(batch))
    later = [change for change in project.changes() if change.number > last.change and change.verb != "solve"]
    if later:
        lines.append(f"Changes since then: {', '.join(f'{change.verb} {change.what}' for change in later[-_NAMED:])}.")
    unchecked = [
        change for change in project.changes()
        if change.verb in CHANGING and (batch is None or change.number > batch.change)
    ]  # fmt: skip
    changes = many(len(unchecked), "change") if unchecked else "No change"
    next_step = f"; next: {command_line('project', 'solve', project.folder)}" if unchecked else ""
    return [*lines, f"{changes} since the last batch adjustment{next_step}."]


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
    summary = dict(change.summary)
    facts = [
        f"{summary[key]} {word}"
        for key, word in (("rays", "image measurements"), ("ranges", "ranges"), ("points_moved", "points moved"))
        if summary.get(key)
    ]
    if "largest_difference_sigmas" in summary:
        facts.append(f"{summary['largest_difference_sigmas']:.2g} sigmas from batch at most")
    facts += [f"reason: {change.why}"] if change.why else []
    appendix = f" ({', '.join(facts)})" if facts else ""
    undone = "" if change.stands else ", undone"
    return f"  {change.number:4d}  {change.at[:19]}  {change.verb:<6} {change.what}{appendix}{undone}"


def _decision(decision: Decision) -> str:
    where = f" in {decision.image}" if decision.image else ""
    why = f" (reason: {decision.why})" if decision.why else ""
    return f"  {decision.change:4d}  {decision.at[:19]}  {decision.who}: {decision.kind} {decision.point}{where}{why}"

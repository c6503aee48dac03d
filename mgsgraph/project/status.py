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
    """Images, points, measures, how they are connected, the last solution and the last changes; several lines."""
    with understood(str(project.folder), A_PROJECT, ELSEWHERE):
        return "\n".join(_lines(project))


def _lines(project: Project) -> list[str]:
    names = project.store.image_names()
    lines = [f"{project.name}: a project of {many(len(names), 'image')}, made {project.created}"]
    lines += ["", *_contents(project)]
    lines += ["", *_connections(project, names)]
    lines += ["", *_solutions(project, bool(names))]
    return [*lines, "", "History (UTC)", *(_change(change) for change in project.changes(_HISTORY))]


def _contents(project: Project) -> list[str]:
    classes = project.store.point_classes()
    points = ", ".join(f"{count} {PointClass(number).name.lower()}" for number, count in classes.items())
    rays, ranges = project.store.measures()
    terrain = project.store.terrain
    model = "none" if terrain is None else f"{terrain[0].source}, {' x '.join(map(str, terrain[0].radii.shape))} posts"
    return [
        "Contents",
        f"  images held as they are: {project.held_images}",
        f"  points: {sum(classes.values())}{f' ({points})' if points else ''}",
        f"  image measures: {rays} (line and sample each), laser ranges: {ranges}",
        f"  terrain model as control: {model}",
        f"  measurements rejected by the user: {sum(map(len, all_set_aside(project).values())) or 'none'}",
        *_passes(project),
    ]


def _passes(project: Project) -> list[str]:
    """A line for each pass and each unknown that images share."""
    known = project.store.definitions()
    return [
        f"  pass {one.name}: {many(len(one.images), 'image')}, {many(len(one.nodes), 'orientation image')} "
        f"{one.nodes.spacing:.4g} s apart"
        for one in known.passes.values()
    ] + [
        f"  shared unknown {one.name} ({one.kind}): {many(len(one.images), 'image')}" for one in known.shared.values()
    ]


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
    lines = ["Connections"]
    if several:
        sizes = ", ".join(str(len(island)) for island in several)
        word = "all connected" if len(several) == 1 and not alone else f"{many(len(several), 'island')}"
        lines.append(f"  images by common points: {word} ({sizes} images)")
    for island in several[1:]:
        lines.append(f"    apart from the largest: {some(island, len(island), _NAMED)}")
    lines.append(f"  unconnected images: {some(alone, len(alone), _NAMED) if alone else 'none'}")
    return lines


def _solutions(project: Project, images: bool) -> list[str]:
    last, batch = project.last_solution(), project.last_solution("batch")
    if last is None:
        verb = "solve" if project.store.members() or project.case is None else "match"
        return ["Solution", f"  none yet{f'; next: mgsgraph {verb} {project.folder}' if images else ''}"]
    lines = ["Solution", *_solution(last)]
    if last.kind != "batch" and batch is not None:
        lines += _solution(batch)
    since = [change for change in project.changes() if change.number > last.change and change.verb != "solve"]
    if since:
        lines.append(f"  changes since then: {', '.join(f'{change.verb} {change.what}' for change in since[-_NAMED:])}")
    unchecked = [
        change for change in project.changes()
        if change.verb in CHANGING and (batch is None or change.number > batch.change)
    ]  # fmt: skip
    if unchecked:
        lines.append(
            f"  {many(len(unchecked), 'change')} since the last closing check against batch; "
            f"next: mgsgraph project solve {project.folder}"
        )
    else:
        lines.append("  checked against batch since the last change")
    return lines


def _solution(row: SolutionRow) -> list[str]:
    state = "converged" if row.converged else "NOT converged"
    size = f"{many(row.images, 'image')}, {many(row.points, 'point')}"
    lines = [f"  {row.kind} {row.number}, {row.at}: {state}, {size}"]
    if row.cost is not None:
        sigma0 = "not defined" if row.sigma0 is None else f"{row.sigma0:.4g}"
        lines.append(
            f"    cost {row.cost:.6g} (half the weighted sum of squares, no unit), sigma0 {sigma0} (no unit), "
            f"{row.degrees_of_freedom} degrees of freedom; "
            f"{f'results in {row.folder}' if row.folder else 'a closing check, without results'}"
        )
    return lines


def _change(change: Change) -> str:
    found = dict(change.summary)
    facts = [
        f"{found[key]} {word}"
        for key, word in (("rays", "image measures"), ("ranges", "ranges"), ("points_moved", "points moved"))
        if found.get(key)
    ]
    if "largest_difference_sigmas" in found:
        facts.append(f"largest difference to batch {found['largest_difference_sigmas']:.2g} sigmas")
    noted = f" ({', '.join(facts)})" if facts else ""
    return f"  {change.number:4d}  {change.at[:19]}  {change.verb:<6} {change.what}{noted}"

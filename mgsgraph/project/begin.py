"""A project's beginning: empty, or with all that a case file names."""

from collections.abc import Callable
from contextlib import AbstractContextManager
from pathlib import Path

from mgsgraph.project.addition import Addition, images_of_case
from mgsgraph.project.change import put_in
from mgsgraph.project.project import Project
from mgsgraph.project.settings import ProjectSettings, read_settings, settings_of_case

Stages = Callable[[str], AbstractContextManager[None]]


def begin(folder: Path, name: str, case: Path | None, settings: Path | None, stages: Stages) -> str:
    """Make a project; what is in it, in words."""
    if case is None:
        called, chosen = read_settings(settings) if settings is not None else ("", ProjectSettings())
        with Project.create(folder, name or called, chosen) as project:
            project.record("init", "empty", {})
        return "empty"
    with stages("reading the case"):
        images, network, called = images_of_case(case)
        chosen = settings_of_case(case)
    with stages("writing the project"), Project.create(folder, name or called, chosen) as project:
        put_in(project.store, Addition(tuple(images), network))
        for one in images:
            project.add_sources(one.known.image.name, one.files, one.picture)
        rays, ranges = network.rays.point.size, network.ranges.point.size
        summary = {"images": [one.known.image.name for one in images], "points": len(network.points)}
        project.record("init", str(case), summary | {"rays": rays, "ranges": ranges})
    return f"{len(images)} images, {len(network.points)} points, {rays} image measures, {ranges} laser ranges"

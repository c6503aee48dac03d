"""A project's beginning: empty, or with all that a case file names; its tie points may be found later."""

from collections.abc import Callable
from contextlib import AbstractContextManager
from pathlib import Path
from typing import NamedTuple

from mgsgraph.case.schema import decode
from mgsgraph.errors import InputError
from mgsgraph.network import Network
from mgsgraph.project.addition import Addition, NewImage, images_alone, images_of_case
from mgsgraph.project.change import put_in
from mgsgraph.project.project import Project
from mgsgraph.project.settings import ProjectSettings, read_settings, settings_of_case

Stages = Callable[[str], AbstractContextManager[None]]


class Begun(NamedTuple):
    """A project that has been made."""

    words: str
    """What is in it."""
    waits: bool
    """Whether its images wait for tie points."""


def begin(folder: Path, name: str, case: Path | None, settings: Path | None, stages: Stages) -> Begun:
    """Make a project; of a case without any measure in an image the images alone, which then wait for tie points."""
    if case is None:
        called, chosen = read_settings(settings) if settings is not None else ("", ProjectSettings())
        with Project.create(folder, name or called, chosen) as project:
            project.record("init", "empty", {})
        return Begun("empty", False)
    with stages("reading the case"):
        network: Network | None = None
        if decode(case).measured:
            images, network, called = images_of_case(case)
        else:
            images, called = images_alone(case)
        chosen = settings_of_case(case)
    with stages("writing the project"), Project.create(folder, name or called, chosen, case) as project:
        words = _put(project, "init", str(case), images, network)
    return Begun(words, network is None)


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
            f"find others with mgsgraph match CASE --out MATCHES, then mgsgraph add {project.folder} --ties NETWORK",
        )
    if project.case is None:
        raise InputError(
            str(project.folder), "a project that was made without a case", "one made with mgsgraph init --case",
            "give the case file itself: mgsgraph match CASE --out MATCHES",
        )
    names, there = [image.name for image in decode(project.case).images], project.store.image_names()
    if set(names) != set(there):
        raise InputError(
            str(project.case), f"the images {', '.join(names)}", f"those of {project.folder}, {', '.join(there)}",
            f"begin another project with it: mgsgraph init PROJECT --case {project.case}",
        )
    return project.case


def take_ties(project: Project, network: Path) -> str:
    """Put tie points into a project that waits for them, with everything else that its case says by now; in words."""
    case = waiting_case(project)
    images, measured, _ = images_of_case(case, network)
    project.take_settings(settings_of_case(case))
    return _put(project, "match", str(network), images, measured)


def _put(project: Project, verb: str, what: str, images: list[NewImage], network: Network | None) -> str:
    """Put images and measures in, and note it; what they are."""
    put_in(project.store, Addition(tuple(images), network))
    for one in images:
        project.add_sources(one.known.image.name, one.files, one.picture)
    points, rays, ranges = (
        (0, 0, 0) if network is None else (len(network.points), network.rays.point.size, network.ranges.point.size)
    )
    names = [one.known.image.name for one in images]
    project.record(verb, what, {"images": names, "points": points, "rays": rays, "ranges": ranges})
    if network is None:
        return f"{len(images)} images, no tie points yet"
    return f"{len(images)} images, {points} points, {rays} image measures, {ranges} laser ranges"

"""What a command reads from a folder of results, a demonstration or a project: files, network state, posterior."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from mgsgraph.adjustment.incremental.incremental import IncrementalAdjustment
from mgsgraph.adjustment.rounds import unmarked
from mgsgraph.adjustment.solution import Solution
from mgsgraph.analysis.linearised import at_values
from mgsgraph.analysis.places import View
from mgsgraph.analysis.posterior import Posterior, is_self_contained, posterior_of
from mgsgraph.case.case_file import decode, read_image, read_images
from mgsgraph.case.passes import members
from mgsgraph.case.schema import CaseInput, TerrainInput
from mgsgraph.case.terrain import as_grid, read_terrain_model
from mgsgraph.errors import InputError, errors_from, require
from mgsgraph.files.altimetry.shots import read_shots
from mgsgraph.files.opening import understood
from mgsgraph.files.output.folders import PROJECT
from mgsgraph.files.writing import read_record
from mgsgraph.geometry.altimetry import AltimeterShots, joined_shots, require_on_body
from mgsgraph.geometry.image import PushbroomImage
from mgsgraph.geometry.records import Mask
from mgsgraph.geometry.terrain import TerrainGrid
from mgsgraph.geometry.trajectory import tdb_of_utc
from mgsgraph.names import image_names
from mgsgraph.network.footprints import Corrections, Registration, footprints_in_images
from mgsgraph.network.parts import unknowns
from mgsgraph.planning.state import NetworkState, network_state, state_of_solution
from mgsgraph.project.changes import incremental, is_solved
from mgsgraph.project.project import CHANGING, Project, open_project
from mgsgraph.results.archive import ARCHIVE, read_solution
from mgsgraph.results.results import case_of
from mgsgraph.units import DEG

_OWN_CASE = Path("inputs", "case.toml")
"""Where a demonstration's results hold their case."""
_SUMMARY = "summary.json"
"""Where they hold how they compare with the truth."""
_NETWORK = "network.pvl"


class Results(NamedTuple):
    """Results, and where they come from."""

    folder: Path
    """Folder of the results (or their archive)."""
    case: Path | None = None
    """The case, where it is known and still there."""
    ties: Path | None = None
    """Tie points that take the place of the case's own."""
    warning: str = ""
    """What of the project is not in them; empty where all is."""


def comparison_with_truth(folder: Path) -> str:
    """The sentence that says how a demonstration compares with its truth; empty for other results."""
    path = folder / _SUMMARY
    if not path.is_file():
        return ""
    with understood(f"{path}, statements", "what mgsgraph demo writes"):
        return str(next(iter(read_record(path).get("statements", [])), ""))


def results_of(path: Path) -> Results:
    """What a command means by a path: results as they are, or the last batch solution of a project.

    Raises
    ------
    InputError
        A project that has not been solved.
    """
    if not (path / PROJECT).is_file():
        own = path / _OWN_CASE
        return Results(path, own if own.is_file() else None)
    with open_project(path) as project:
        last = project.last_results()
        if last is None or last.folder is None:
            found, remedy = "a project without a batch solution", f"make one: mgsgraph project solve {path}"
            raise InputError(str(path), found, "results of an adjustment", remedy)
        network = project.matches / _NETWORK
        ties = network if network.is_file() else None
        return Results(path / last.folder, _case_of_all(project), ties, _since(project, last.change))


class CaseResults(NamedTuple):
    """A case, and results of it."""

    case: Path
    """The case file."""
    folder: Path | None = None
    """Folder of the results (or their archive); None for a case alone."""
    ties: Path | None = None
    """Tie points that take the place of the case's own."""


def case_with_results(path: Path, case: Path | None = None) -> CaseResults:
    """The case that a command works on, by its file, or by results or a project, which know theirs unless `case` does.

    Raises
    ------
    InputError
        A case given beside a case file; results that don't know theirs.
    """
    if not path.is_dir() and path.suffix != ".npz":
        require(case is None, "--case", f"{case} beside the case {path}", "results as the other")
        return CaseResults(path)
    found = results_of(path)
    return CaseResults(case or found.case or case_of(found.folder), found.folder, found.ties)


def _since(project: Project, number: int) -> str:
    """What images and measures the project has taken in or out after a change of its."""
    later = [change for change in project.changes() if change.number > number and change.verb in CHANGING]
    if not later:
        return ""
    said = ", ".join(f"{change.verb} {change.what}" for change in later)
    remedy = f"for one of everything: mgsgraph project solve {project.folder}"
    return f"The project has changed since this solution ({said}); {remedy}"


def _case_of_all(project: Project) -> Path | None:
    """The project's case, if it is still there and has all images that the project has, and no others."""
    case = project.case
    if case is None or not case.is_file():
        return None
    names = {image.name for image in decode(case).images}
    return case if names == set(project.store.image_names()) else None


def read_adjusted(path: Path) -> tuple[Solution, str]:
    """The last batch solution of a folder of results or a project, and a warning where that has changed since, else an
    empty text. InputError where there is none.
    """
    _is_project(path)
    found = results_of(path)
    return read_solution(found.folder), found.warning


def read_state(path: Path) -> tuple[str, NetworkState, str]:
    """Name and state of what was adjusted: a folder of results (or the archive in it), or a project's folder; and a
    warning where the adjustment has not converged, else an empty one.

    Raises
    ------
    InputError
        Neither of them; a project that has never been solved; a solution without covariance.
    """
    if _is_project(path):
        with open_project(path) as opened:
            adjustment = _adjusted(opened, str(path))
            with errors_from(str(path)):
                (network, places), values = adjustment.as_network(), adjustment.values
            there, kept = np.isfinite(places[:, 0]), unmarked(network)
            rays, ranges = kept.rays & there[network.rays.point], kept.ranges & there[network.ranges.point]
            settings = opened.settings.solver.settings
            return opened.name, network_state(network, settings, values, places, rays, ranges), ""
    solution = read_solution(path)
    return solution.name, state_of_solution(solution), _warning(solution)


def read_posterior(path: Path) -> tuple[str, Posterior, str]:
    """Name, posterior and warning of the same."""
    if _is_project(path):
        with open_project(path) as opened:
            values, settings = _adjusted(opened, str(path)).values, opened.settings.solver.settings
            name, (network, near) = opened.name, opened.store.as_network()
        every = [values.get(unknown, np.zeros(0)) for unknown in unknowns(network)]  # the file is free meanwhile
        with errors_from(str(path)):
            return name, Posterior(at_values(network, settings, every, near, near=True)), ""
    solution = read_solution(path)
    return solution.name, Posterior.of(solution), _warning(solution)


def posterior_near(path: Path, point: str) -> Posterior | None:
    """Posterior of a project's points that depend on the same unknowns as a point: their rows, and the covariance of
    these unknowns from iSAM2, so that no other point is read. None without such a point or an adjustment, and where
    they don't stand alone (`is_self_contained`).
    """
    with open_project(path) as opened:
        members = opened.store.bundles_of([point]).get(point)
        if members is None or not is_solved(opened):
            return None
        bundle, adjustment = opened.store.bundle(members), _adjusted(opened, str(path))
        if opened.store.considered or not is_self_contained(bundle.network):
            return None
        with errors_from(str(path)):
            return posterior_of(
                bundle.network, adjustment.settings, adjustment.values, bundle.places, adjustment.joint
            )  # fmt: skip


def _warning(solution: Solution) -> str:
    if solution.converged:
        return ""
    return f"The adjustment has NOT converged, so sigmas mean little: {solution.message}"


def _is_project(path: Path) -> bool:
    """Whether it is a project's folder; InputError for a folder that holds nothing of ours."""
    if not path.is_dir():
        return False
    if not (path / PROJECT).exists() and not (path / ARCHIVE).exists():
        found = f"a folder with neither {ARCHIVE} nor {PROJECT}"
        raise InputError(str(path), found, "results of `mgsgraph adjust`, or a project")
    return (path / PROJECT).exists()


def _adjusted(project: Project, where: str) -> IncrementalAdjustment:
    """The adjustment that a project holds; InputError for one that has never been solved."""
    if not project.store.image_names() or not is_solved(project):
        raise InputError(where, "a project without a solution", "an adjusted one", f"mgsgraph project solve {where}")
    return incremental(project)




class OrientedImages(NamedTuple):
    """Images with the orientation that is believed."""

    views: tuple[View, ...]
    """(m)."""
    warning: str = ""
    """What is to be said of them."""
    case: CaseInput | None = None
    """The case that they are of; None of results."""

    @property
    def images(self) -> tuple[PushbroomImage, ...]:
        """(m) their geometry."""
        return tuple(view.image for view in self.views)

    @property
    def corrections(self) -> Corrections:
        """(m) of their nominal orientation."""
        return [view.correction for view in self.views]


def oriented_images(path: Path, names: Sequence[str] = ()) -> OrientedImages:
    """Images of a case file, a folder of results (or their archive) or a project; all, or some by their names or parts
    of names that no other has: of a case only these are read then.

    Raises
    ------
    InputError
        A name that no image has, or several; what `decode` and `read_solution` refuse.
    """
    if (path / PROJECT).is_file() or (path / ARCHIVE).is_file() or path.suffix == ".npz":
        results = results_of(path)
        solution = read_solution(results.folder)
        chosen = _chosen([image.name for image in solution.network.images], names, path)
        warning = results.warning if solution.converged else f"The adjustment has NOT converged: {solution.message}"
        return OrientedImages(tuple(View.adjusted(solution, j) for j in chosen), warning)
    wanted = decode(path)
    known = [image.name for image in wanted.images]
    if names:
        images = [_alone(wanted, j, path) for j in _chosen(known, names, path)]
    else:
        images = [*read_images(wanted, wanted.orientations, members(wanted.passes, known, str(path)), path)]
    return OrientedImages(tuple(map(View, images)), case=wanted)


def _alone(wanted: CaseInput, number: int, path: Path) -> PushbroomImage:
    image = read_image(wanted.images[number], wanted.spice, path.parent, f"{path}, images[{number}]")
    return wanted.orientations[number].nominal_of(image)


def _chosen(known: Sequence[str], names: Sequence[str], path: Path) -> list[int]:
    """Numbers of the images of these names, each once; of all where there are none."""
    number = {name: k for k, name in enumerate(known)}
    with errors_from(str(path)):
        return [number[name] for name in image_names(names, known)] if names else list(number.values())


def open_view(
    path: Path, image: str, terrain: Path | bool = True, reference_radius: float | None = None
) -> tuple[View, TerrainGrid | None, str]:
    """An image by its name, or by a part of its name that no other has, the ground that it is to be projected onto
    (None for the ellipsoid), and what is to be said of it.

    Parameters
    ----------
    path : Path
        Case file, folder of results (or their archive), or project.
    image : str
        Its name.
    terrain : Path or bool
        A terrain model's file; True: that of the case or the results, if they have one; False: none.
    reference_radius : float, optional
        m, above which the heights of that file are.

    Raises
    ------
    InputError
        An image that isn't there; what `read_case` and `read_solution` refuse.
    """
    seen = oriented_images(path, (image,))
    (view,) = seen.views
    entries = seen.case.terrain_models[:1] if terrain is True and seen.case is not None else ()
    if isinstance(terrain, Path):
        entries = (TerrainInput(radius=str(Path.cwd() / terrain), reference_radius_m=reference_radius),)
        path = terrain
    for entry in entries:
        return view, as_grid(read_terrain_model(entry, path, seen.images)[0]), seen.warning
    surface = view.solution.network.surface if terrain is True and view.solution is not None else None
    return view, None if surface is None else surface.grid, seen.warning


_DAY = 86400.0 - 1e-3
"""s to the last millisecond of a day."""
_DATE = len("2010-05-10")


@dataclass(frozen=True, slots=True)
class ShotChoice:
    """Which shots may be chosen, apart from where they fall."""

    dates: tuple[str, str] | None = None
    """UTC, both included: days, or times."""
    ground: bool = True
    """Returns from the ground alone."""
    off_nadir: float | None = None
    """deg, at the most."""
    margin: float = 0.0
    """pixels by which they may lie beside an image."""
    along: bool = False
    """Those alone that were fired while an image was taken in which they fall."""
    version: str | None = None
    """Letter of PEDR products whose names don't say it."""

    def of(self, shots: AltimeterShots) -> Mask:
        """(n,) True for shots that may be chosen."""
        found = shots.ground.copy() if self.ground else np.ones(shots.times.size, dtype=bool)
        if self.off_nadir is not None:
            found &= shots.off_nadir <= self.off_nadir * DEG
        if self.dates is not None:
            first, last = _interval(self.dates)
            found &= (shots.times >= first) & (shots.times <= last)
        return found


def _interval(dates: tuple[str, str]) -> tuple[float, float]:
    """S TDB past J2000 from the beginning of the first to the end of the last."""
    texts = [text.strip() + "T00:00:00"[len(text.strip()) - _DATE :] for text in dates]
    first, last = tdb_of_utc(texts, "dates").tolist()
    last += _DAY if len(dates[1].strip()) == _DATE else 0.0
    if first > last:
        raise InputError("dates", f"{dates[0]} after {dates[1]}", "FROM before TO")
    return first, last


def search_shots(files: Sequence[Path], seen: OrientedImages, choice: ShotChoice) -> Registration:
    """Shots of all files over images.

    Raises
    ------
    InputError
        What `read_shots` refuses; files of several altimeters; shots on another body than the images'.
    """
    parts = [read_shots(path, version=choice.version) for path in files]
    for part in parts:
        require_on_body(part.footprints, seen.images[0].body, part.source)
    shots = joined_shots(parts)
    over = footprints_in_images(seen.images, shots.chosen(choice.of(shots)), seen.corrections, margin=choice.margin)
    return replace(over, inside=over.inside & over.simultaneous) if choice.along else over

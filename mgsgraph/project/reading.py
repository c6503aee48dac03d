"""Reading of results, demonstrations and projects for commands: state of the network, posterior, images, shots."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from mgsgraph.analysis.places import View
from mgsgraph.case.case_file import decode, image_of, read_images
from mgsgraph.case.passes import members
from mgsgraph.case.schema import CaseInput, TerrainInput
from mgsgraph.case.terrain import as_grid, read_terrain_model
from mgsgraph.errors import InputError, command_line, errors_from, require
from mgsgraph.files.altimetry.shots import read_shots
from mgsgraph.files.opening import understood
from mgsgraph.files.output.folders import PROJECT
from mgsgraph.files.writing import read_record
from mgsgraph.geometry.altimetry import AltimeterShots, joined_shots, require_on_body
from mgsgraph.geometry.image import PushbroomImage
from mgsgraph.geometry.records import Mask
from mgsgraph.geometry.terrain import TerrainGrid
from mgsgraph.geometry.trajectory import tdb_of_utc
from mgsgraph.names import image_names, numbered
from mgsgraph.network.footprints import Corrections, Registration, footprints_in_images
from mgsgraph.network.parts import unknowns
from mgsgraph.project.project import CHANGING, Project, open_project
from mgsgraph.results.archive import ARCHIVE, read_solution
from mgsgraph.units import DEG

if TYPE_CHECKING:
    from mgsgraph.adjustment.incremental.incremental import IncrementalAdjustment
    from mgsgraph.adjustment.solution import Solution
    from mgsgraph.analysis.posterior import Posterior
    from mgsgraph.planning.state import NetworkState

_OWN_CASE = Path("inputs", "case.toml")
"""Path of the case in the results of a demonstration."""
_SUMMARY = "summary.json"
"""File with the comparison of a demonstration with its truth."""


class Results(NamedTuple):
    """A folder of results, and the files that it comes from."""

    folder: Path
    """Folder of the results (or their archive)."""
    case: Path | None = None
    """The case file, if known and existing."""
    ties: Path | None = None
    """Tie points that take the place of the case's own."""
    warning: str = ""
    """Sentence about later changes of the project; empty without any."""


def comparison_with_truth(folder: Path) -> str:
    """Sentence that compares a demonstration with its truth; empty for other results."""
    path = folder / _SUMMARY
    if not path.is_file():
        return ""
    with understood(f"{path}, statements", "what mgsgraph demo writes"):
        return str(next(iter(read_record(path).get("statements", [])), ""))


def results_of(path: Path) -> Results:
    """The results at a path: a folder of results, or the last batch solution of a project.

    Raises
    ------
    InputError
        A project without a batch solution.
    """
    if not (path / PROJECT).is_file():
        own = path / _OWN_CASE
        return Results(path, own if own.is_file() else None)
    with open_project(path) as project:
        last = project.last_results()
        if last is None or last.folder is None:
            found, remedy = "a project without a batch solution", f"make one: {command_line('project', 'solve', path)}"
            raise InputError(str(path), found, "results of an adjustment", remedy)
        warning = _changes_since(project, last.change)
        return Results(path / last.folder, _case_of_all(project), project.matched_ties, warning)


class CaseResults(NamedTuple):
    """A case file and, if given, results of it."""

    case: Path
    """The case file."""
    folder: Path | None = None
    """Folder of the results (or their archive); None for a case alone."""
    ties: Path | None = None
    """Tie points that take the place of the case's own."""


def case_with_results(path: Path, case: Path | None = None) -> CaseResults:
    """The case at a path: a case file, or results or a project, which know their case unless `case` is given.

    Raises
    ------
    InputError
        `case` beside a case file; results without a known case.
    """
    if not path.is_dir() and path.suffix != ".npz":
        require(case is None, "--case", f"{case} beside the case {path}", "results as the other")
        return CaseResults(path)
    from mgsgraph.results.results import case_of

    results = results_of(path)
    return CaseResults(case or results.case or case_of(results.folder), results.folder, results.ties)


def _changes_since(project: Project, number: int) -> str:
    """Sentence about images and measurements that the project added or removed after a change; empty without any."""
    later_changes = [change for change in project.changes() if change.number > number and change.verb in CHANGING]
    if not later_changes:
        return ""
    descriptions = ", ".join(f"{change.verb} {change.what}" for change in later_changes)
    remedy = f"for one of everything: {command_line('project', 'solve', project.folder)}"
    return f"The project has changed since this solution ({descriptions}); {remedy}"


def _case_of_all(project: Project) -> Path | None:
    """The project's case file, if it exists and has exactly the images of the project; else None."""
    case = project.case
    if case is None or not case.is_file():
        return None
    names = {image.name for image in decode(case).images}
    return case if names == set(project.store.image_names()) else None


def read_adjusted(path: Path) -> tuple["Solution", str]:
    """The last batch solution of a folder of results or a project, and a warning if the project has changed since (else
    an empty text). InputError without one.
    """
    _is_project(path)
    results = results_of(path)
    return read_solution(results.folder), results.warning


def read_state(path: Path) -> tuple[str, "NetworkState", str]:
    """Name and state of an adjusted network, from a folder of results (or their archive) or a project; and a warning
    if the adjustment has not converged, else an empty text.

    Raises
    ------
    InputError
        Neither of them; a project that was never solved; a solution without covariance.
    """
    from mgsgraph.adjustment.rounds import unmarked
    from mgsgraph.planning.state import network_state, state_of_solution

    if _is_project(path):
        with open_project(path) as project:
            adjustment = _adjusted(project, str(path))
            with errors_from(str(path)):
                (network, places), values = adjustment.as_network(), adjustment.values
            known, used = np.isfinite(places[:, 0]), unmarked(network)
            rays, ranges = used.rays & known[network.rays.point], used.ranges & known[network.ranges.point]
            settings = project.settings.solver.settings
            return project.name, network_state(network, settings, values, places, rays, ranges), ""
    solution = read_solution(path)
    return solution.name, state_of_solution(solution), _warning(solution)


def read_posterior(path: Path) -> tuple[str, "Posterior", str]:
    """Name and posterior of an adjusted network, and a warning; paths and errors as for `read_state`."""
    from mgsgraph.analysis.linearised import at_values
    from mgsgraph.analysis.posterior import Posterior

    if _is_project(path):
        with open_project(path) as project:
            values, settings = _adjusted(project, str(path)).values, project.settings.solver.settings
            name, (network, positions) = project.name, project.store.as_network()
        all_values = [values.get(unknown, np.zeros(0)) for unknown in unknowns(network)]
        with errors_from(str(path)):
            return name, Posterior(at_values(network, settings, all_values, positions, near=True)), ""
    solution = read_solution(path)
    return solution.name, Posterior.of(solution), _warning(solution)


def posterior_near(path: Path, point: str) -> "Posterior | None":
    """Posterior of the points of a project that depend on the same unknowns as `point`: from their measurements and the
    covariance of these unknowns in iSAM2, without reading other points. None without such a point or an adjustment,
    and for a bundle that is not self-contained (`is_self_contained`).
    """
    from mgsgraph.analysis.posterior import is_self_contained, posterior_of
    from mgsgraph.project.changes import is_solved

    with open_project(path) as project:
        members = project.store.bundles_of([point]).get(point)
        if members is None or not is_solved(project):
            return None
        bundle, adjustment = project.store.bundle(members), _adjusted(project, str(path))
        if project.store.considered or not is_self_contained(bundle.network):
            return None
        with errors_from(str(path)):
            return posterior_of(
                bundle.network, adjustment.settings, adjustment.values, bundle.places, adjustment.joint
            )  # fmt: skip


def _warning(solution: "Solution") -> str:
    if solution.converged:
        return ""
    return f"The adjustment has NOT converged, so sigmas mean little: {solution.message}"


def _is_project(path: Path) -> bool:
    """Whether it is the folder of a project; InputError for a folder with neither a project nor results."""
    if not path.is_dir():
        return False
    found, expected = f"a folder with neither {ARCHIVE} nor {PROJECT}", "results of `mgsgraph adjust`, or a project"
    require((path / PROJECT).exists() or (path / ARCHIVE).exists(), str(path), found, expected)
    return (path / PROJECT).exists()


def _adjusted(project: Project, where: str) -> "IncrementalAdjustment":
    """The incremental adjustment of a project; InputError for a project that was never solved."""
    from mgsgraph.project.changes import incremental, is_solved

    found, solve = "a project without a solution", command_line("project", "solve", where)
    require(project.store.image_names() and is_solved(project), where, found, "an adjusted one", solve)
    return incremental(project)




class OrientedImages(NamedTuple):
    """Images with their best known orientation."""

    views: tuple[View, ...]
    """(m) images with their corrections."""
    warning: str = ""
    """Sentence for the user; empty without one."""
    case: CaseInput | None = None
    """The case of the images; None for results."""

    @property
    def images(self) -> tuple[PushbroomImage, ...]:
        """(m) geometry of the images."""
        return tuple(view.image for view in self.views)

    @property
    def corrections(self) -> Corrections:
        """(m) corrections of the nominal orientation."""
        return [view.correction for view in self.views]


def oriented_images(path: Path, names: Sequence[str] = ()) -> OrientedImages:
    """Images of a case file, a folder of results (or their archive) or a project: all, or some by names or unique parts
    of names. Of a case only the named images are read.

    Raises
    ------
    InputError
        A name that no image has, or several; what `decode` and `read_solution` refuse.
    """
    if (path / PROJECT).is_file() or (path / ARCHIVE).is_file() or path.suffix == ".npz":
        results = results_of(path)
        solution = read_solution(results.folder)
        chosen = _numbers_of(solution.network.image_names, names, path)
        warning = results.warning if solution.converged else f"The adjustment has NOT converged: {solution.message}"
        return OrientedImages(tuple(View.adjusted(solution, j) for j in chosen), warning)
    case_input = decode(path)
    known = [image.name for image in case_input.images]
    if names:
        images = [case_input.orientations[j].nominal_of(image_of(case_input, j, path))
                  for j in _numbers_of(known, names, path)]  # fmt: skip
    else:
        images = [*read_images(case_input, case_input.orientations, members(case_input.passes, known, str(path)), path)]
    return OrientedImages(tuple(map(View, images)), case=case_input)


def _numbers_of(known_names: Sequence[str], names: Sequence[str], path: Path) -> list[int]:
    """Indices of the images of these names, each once; of all without names."""
    numbers = numbered(known_names)
    with errors_from(str(path)):
        return [numbers[name] for name in image_names(names, known_names)] if names else list(numbers.values())


def open_view(
    path: Path, image: str, terrain: Path | bool = True, reference_radius: float | None = None
) -> tuple[View, TerrainGrid | None, str]:
    """An image by its name or a unique part of it, the terrain to project it onto (None for the ellipsoid), and a
    sentence for the user.

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
    oriented = oriented_images(path, (image,))
    (view,) = oriented.views
    entries = oriented.case.terrain_models[:1] if terrain is True and oriented.case is not None else ()
    if isinstance(terrain, Path):
        entries = (TerrainInput(radius=str(Path.cwd() / terrain), reference_radius_m=reference_radius),)
        path = terrain
    for entry in entries:
        return view, as_grid(read_terrain_model(entry, path, oriented.images)[0]), oriented.warning
    surface = view.solution.network.surface if terrain is True and view.solution is not None else None
    return view, None if surface is None else surface.grid, oriented.warning


_DAY = 86400.0 - 1e-3
"""s to the last millisecond of a day."""
_DATE = len("2010-05-10")


@dataclass(frozen=True, slots=True)
class ShotChoice:
    """Conditions for shots, without those on position."""

    dates: tuple[str, str] | None = None
    """UTC, both included: days, or times."""
    ground: bool = True
    """Only returns from the ground."""
    off_nadir: float | None = None
    """deg, maximum."""
    margin: float = 0.0
    """pixels that a shot may lie outside an image."""
    along: bool = False
    """Only shots fired during the exposure of an image that contains them."""
    version: str | None = None
    """Version letter of PEDR products whose names lack it."""

    def of(self, shots: AltimeterShots) -> Mask:
        """(n,) True for shots that fulfill all conditions."""
        chosen = shots.ground.copy() if self.ground else np.ones(shots.times.size, dtype=bool)
        if self.off_nadir is not None:
            chosen &= shots.off_nadir <= self.off_nadir * DEG
        if self.dates is not None:
            first, last = _interval(self.dates)
            chosen &= (shots.times >= first) & (shots.times <= last)
        return chosen


def _interval(dates: tuple[str, str]) -> tuple[float, float]:
    """S TDB past J2000: beginning of the first date, end of the last."""
    texts = [text.strip() + "T00:00:00"[len(text.strip()) - _DATE :] for text in dates]
    first, last = tdb_of_utc(texts, "dates").tolist()
    last += _DAY if len(dates[1].strip()) == _DATE else 0.0
    require(first <= last, "dates", f"{dates[0]} after {dates[1]}", "FROM before TO")
    return first, last


def search_shots(files: Sequence[Path], oriented: OrientedImages, choice: ShotChoice) -> Registration:
    """Shots of all files in the images.

    Raises
    ------
    InputError
        What `read_shots` refuses; files of several altimeters; shots on another body than the images'.
    """
    parts = [read_shots(path, version=choice.version) for path in files]
    for part in parts:
        require_on_body(part.footprints, oriented.images[0].body, part.source)
    shots = joined_shots(parts)
    shots = shots.chosen(choice.of(shots))
    selection = footprints_in_images(oriented.images, shots, oriented.corrections, margin=choice.margin)
    return replace(selection, inside=selection.inside & selection.simultaneous) if choice.along else selection

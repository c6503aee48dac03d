"""What is open in the studio: a project, results or a case, in its present state; a change makes a new state."""

import threading
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Literal, NamedTuple, TypeVar

import numpy as np

from mgsgraph.adjustment.covariances import prior_covariance
from mgsgraph.adjustment.graph import lay_out
from mgsgraph.adjustment.marginals import JointCovariance
from mgsgraph.adjustment.rounds import unmarked
from mgsgraph.adjustment.settings import SolverSettings
from mgsgraph.adjustment.solution import Solution
from mgsgraph.analysis.posterior import Posterior, posterior_of_points
from mgsgraph.analysis.statistics import solution_connectivity
from mgsgraph.case.case_file import decode
from mgsgraph.case.reading import picture_of, read_case
from mgsgraph.errors import InputError, MgsgraphError, command_line, require
from mgsgraph.files.networks.tie_points import TiePoints
from mgsgraph.files.output.folders import PROJECT
from mgsgraph.geometry.body import centre_of, ellipsoidal_heights, plane_coordinates
from mgsgraph.geometry.image import PushbroomImage
from mgsgraph.geometry.orientation import OrientationCorrection
from mgsgraph.geometry.records import Array, Index, Mask, finite_rows, thinned
from mgsgraph.geometry.rotation import unit_vectors
from mgsgraph.geometry.terrain import TerrainGrid
from mgsgraph.network import Network
from mgsgraph.network.connectivity import network_footprints
from mgsgraph.project.changes import incremental, is_solved
from mgsgraph.project.project import AdjustmentCache, Project, open_project
from mgsgraph.project.reading import case_with_results, posterior_near, read_posterior, results_of
from mgsgraph.results.archive import ARCHIVE, read_solution
from mgsgraph.studio.judging import Judging

_NEAR, _LEAST = 0.5, 5e3
"""Margin around an image's ground, as a share of its reach, and at least in m: for heights, and for the orientation
before the adjustment."""


@dataclass(frozen=True, eq=False)
class Block:
    """Images, points and their covariances, in one state."""

    network: Network
    """Images, points and measurements."""
    settings: SolverSettings
    """Of the adjustment."""
    values: Sequence[Array] | None
    """Of all variables, as `Solution.values`; None before any adjustment."""
    images: tuple[PushbroomImage, ...]
    """With adjusted interior orientation, where that is adjusted."""
    corrections: tuple[OrientationCorrection | None, ...]
    """Of their nominal orientation; None for none."""
    places: Array
    """(n, 3) m, of the points, as adjusted, else a-priori; NaN where unknown."""
    covariances_of: Callable[[], Array | None]
    """Computes the points' covariances, on request."""
    used: Mask
    """(k,) rays that are used."""
    joint_of: Callable[[], JointCovariance | None]
    """Computes the covariance of the shared unknowns; None where some have none."""
    terrain: TerrainGrid | None = None
    """Radii of the ground; None without a terrain model."""

    @classmethod
    def of_solution(cls, solution: Solution) -> "Block":
        """An adjusted block."""
        network, numbers = solution.network, range(len(solution.network.images))
        return cls(
            network, solution.settings, solution.values, tuple(map(solution.image, numbers)),
            tuple(map(solution.correction, numbers)), solution.places, lambda: solution.covariances,
            solution.rays_used, lambda: solution.joint_covariance, _terrain(network),
        )  # fmt: skip

    @classmethod
    def of_posterior(cls, posterior: Posterior) -> "Block":
        """A block at its linearisation point: a project after its last change."""
        state, network = posterior.linearised, posterior.network
        numbers, places = range(len(network.images)), state.places
        is_used = unmarked(network).rays & np.isfinite(places[network.rays.point, 0])
        return cls(
            network, state.settings, state.values, tuple(map(posterior.image, numbers)),
            tuple(map(posterior.correction, numbers)), places, state.point_covariances, is_used, lambda: state.joint,
            _terrain(network),
        )  # fmt: skip

    @classmethod
    def of_network(cls, network: Network, settings: SolverSettings) -> "Block":
        """A block that has not been adjusted: nominal orientation, a-priori places and sigmas."""

        def prior() -> JointCovariance | None:
            with suppress(MgsgraphError):  # what can't be laid out has no covariance; its adjustment will say why
                return prior_covariance(lay_out(network, settings))
            return None

        return cls(
            network, settings, None, network.images, (None,) * len(network.images), network.points.places,
            lambda: None, unmarked(network).rays, prior, _terrain(network),
        )  # fmt: skip

    @property
    def adjusted(self) -> bool:
        """Whether it has been adjusted."""
        return self.values is not None

    @cached_property
    def covariances(self) -> Array | None:
        """(n, 3, 3) m^2, of the points' places, for sigma0 = 1; NaN for points without one; None
        before any adjustment.
        """
        return self.covariances_of()

    @cached_property
    def joint(self) -> JointCovariance | None:
        """Covariance of the shared unknowns, a-priori before any adjustment; None where some have none."""
        return self.joint_of()

    @cached_property
    def located(self) -> Index:
        """(m,) points with a place."""
        return np.flatnonzero(finite_rows(self.places) & np.any(self.places, axis=1))

    @cached_property
    def median_height(self) -> float:
        """Height (m) above the ellipsoid, of some of the points; 0 where none has a place."""
        some = self.places[self.located[thinned(self.located.size, 10_000)]]
        return float(np.median(ellipsoidal_heights(some, self.images[0].body))) if len(some) else 0.0

    @cached_property
    def rays_by_image(self) -> list[Index]:
        """Rays of each image."""
        order = np.argsort(self.network.rays.image, kind="stable")
        counts = np.bincount(self.network.rays.image, minlength=len(self.images))
        return np.split(order, np.cumsum(counts)[:-1])

    @cached_property
    def grounds(self) -> list[Array]:
        """27 places (27, 3) in m on the ellipsoid for each image, over its lines and samples."""
        return [
            picture.image_to_ground(np.tile(np.linspace(0.0, picture.lines, 9), 3),
                                    np.repeat(np.linspace(0.0, picture.samples, 3), 9), 0.0, correction)[0]
            for picture, correction in zip(self.images, self.corrections, strict=True)
        ]  # fmt: skip

    @cached_property
    def caps(self) -> tuple[Array, Array]:
        """Middle direction (m, 3) of each image's ground, and angle (m,) in rad from there within which that lies."""
        middles, reaches = np.zeros((len(self.images), 3)), np.full(len(self.images), np.pi)
        for j, points in enumerate(self.grounds):
            if not np.all(np.isfinite(points)):
                continue  # a part of it misses the body: never excluded
            directions = unit_vectors(points)
            middle = directions.mean(axis=0)
            middles[j] = middle / np.linalg.norm(middle)
            reach = float(np.arccos(np.clip(directions @ middles[j], -1.0, 1.0)).max())
            reaches[j] = reach + max(_NEAR * reach, _LEAST / self.images[j].body.equatorial)
        return middles, reaches

    def terrain_motion(self, places: Array) -> Array:
        """(n, 3) m by which the adjustment has moved the terrain model at places (n, 3) in m."""
        surface, network = self.network.surface, self.network
        if surface is None or self.values is None or not network.terrain_moves or self.terrain is not surface.grid:
            return np.zeros_like(places)
        return surface.moved(places, self.values[len(network.images) + len(network.shift_names) - 1])



def _terrain(network: Network) -> TerrainGrid | None:
    return None if network.surface is None else network.surface.grid


Kind = Literal["project", "result", "case"]
_Result = TypeVar("_Result")
_MOST_PREPARED = 100_000
"""Most image measurements of a project whose adjustment is read before a change wants it."""
_MOST_NEAR = 2000
"""Most points around one of a solution whose posterior is computed jointly."""
_CHANGED = "only a project can be changed; make one of the case: mgsgraph project init PROJECT --case CASE"


class State(NamedTuple):
    """The block in one state, and the sources of its answers."""

    name: str
    block: Block
    before: Array | None
    """(n, 3) m, places of the points before the adjustment; None where there was none."""
    posterior: Callable[[], Posterior] | None
    """None before any adjustment."""
    solution: Solution | None
    """The batch solution; None of a case, and of a project that has changed since."""
    pictures: Mapping[str, Path | None]
    warning: str
    ties: TiePoints | None = None
    """Tie points of a case, as its files have them."""


About = tuple[Block, Posterior | None]
"""A point, others and the images that show them; no posterior before any adjustment."""


class Opened:
    """A project, a folder of results or a case file, opened for the studio; may be used by several threads.

    Parameters
    ----------
    path : Path
        What to open.
    case : Path, optional
        Case of the results, for its images' pixels; known already of a demonstration and a project.
    ties : Path, optional
        Network in place of those that a case names.
    verdicts : Path, optional
        File of verdicts about the tie points of the case.

    Attributes
    ----------
    path : Path
    kind : str
        project, result or case.
    revision : int
        Changes since it was opened.

    Raises
    ------
    InputError
        None of them, or one that can't be read.
    """

    def __init__(
        self, path: Path, case: Path | None = None, ties: Path | None = None, verdicts: Path | None = None
    ) -> None:
        self.path, self._case, self._ties = path, case, ties
        self.kind: Kind = _kind(path)
        self.revision = 0
        self._lock, self._near_lock, self._changing = threading.RLock(), threading.Lock(), threading.Lock()
        self._cache, self._prepared = AdjustmentCache(), -1
        self._state: tuple[int, State] | None = None
        self._made: dict[str, object] = {}
        self._making: dict[str, threading.RLock] = {}
        self._near: tuple[int, str, About | None] | None = None
        self._seen = _mark(path)
        state = self.now
        self._pictures: Mapping[str, Path | None] | None = state.pictures
        self.warning = state.warning
        """For the user; empty where there is none."""
        self.centre = _centre(state.block)
        """(3,) m, body-fixed, origin of the map."""
        self.judging = self._judging(verdicts)
        """Verdicts about the tie points of the case; None of a project, and where no case is known."""

    # --- the state

    @property
    def now(self) -> State:
        """The state; read again after a change. No change waits for a state that is being read."""
        with self._lock:
            if self._state is None or self._state[0] != self.revision:
                revision = self.revision
                read_state = {"project": _project, "result": _result, "case": _of_case}[self.kind]
                self._state = revision, read_state(self.path, self._ties if self.kind == "case" else self._case)
                self._made = {}
            return self._state[1]

    @property
    def is_read(self) -> bool:
        """Whether all of it has been read since the last change."""
        return self._state is not None and self._state[0] == self.revision

    def once(self, name: str, make: Callable[[], _Result]) -> _Result:
        """A result of the present state, made at the first request and kept until a change."""
        with self._lock:
            _ = self.now  # drops results of an older state
            results, lock = self._made, self._making.setdefault(name, threading.RLock())
        with lock:  # a slow result does not block others
            if name not in results:
                results[name] = make()
            result: _Result = results[name]  # type: ignore[assignment]  # one type for a name
            return result

    @property
    def pictures(self) -> Mapping[str, Path | None]:
        """File of each image's pixels, by its name."""
        if self._pictures is None:
            self._pictures = self.now.pictures
        return self._pictures  # no change of a point changes them

    def block(self) -> Block:
        """Images and points as they are now."""
        return self.now.block

    def posterior(self) -> Posterior:
        """The posterior; InputError before any adjustment."""
        make = self.now.posterior
        if make is None:
            remedy = "adjust it: mgsgraph project solve PROJECT, or mgsgraph adjust CASE --out RESULT"
            raise InputError(str(self.path), "nothing has been adjusted: there is no posterior", remedy=remedy)
        return self.once("posterior", make)

    def posterior_of(self, points: Index) -> Posterior:
        """The posterior of some points (m,), by their numbers; of the whole block where these can't be read alone."""
        solution = self.now.solution
        alone = None if solution is None else posterior_of_points(solution, np.unique(points))
        return alone or self.posterior()

    def about(self, point: str) -> About:
        """A point and others that depend on the same unknowns, where these can be read alone; the whole block
        otherwise, which takes longer.
        """
        with self._near_lock:
            if self._near is None or self._near[:2] != (self.revision, point):
                self._near = self.revision, point, self._read_near(point)
            if (near := self._near[2]) is not None:
                return near
        return self.block(), None if self.now.posterior is None else self.posterior()

    def _read_near(self, point: str) -> About | None:
        if self.kind == "project" and not (self.is_read and self.now.solution is not None):
            posterior = posterior_near(self.path, point)
            return None if posterior is None else (Block.of_posterior(posterior), posterior)
        solution = self.now.solution
        members = None if solution is None else near_points(solution.network, solution.places, point)
        posterior = None if members is None or solution is None else posterior_of_points(solution, members)
        return None if posterior is None else (Block.of_posterior(posterior), posterior)

    def _judging(self, verdicts: Path | None) -> Judging | None:
        """Verdicts in a file, or in the one beside the case."""
        source = None
        with suppress(MgsgraphError):
            source = None if self.kind == "project" else case_with_results(self.path, self._case)
        if source is None:
            found = "verdicts about a project, whose points can be rejected" if self.kind == "project" else "no case"
            require(verdicts is None, f"--verdicts {verdicts}", found, "a case, or results with --case CASE")
            return None

        def read_ties() -> TiePoints:
            ties = self.now.ties
            if ties is None and self.kind == "result":
                ties = self.once("ties", lambda: read_case(source.case, ties=self._ties or source.ties).ties)
            if ties is None:
                raise InputError(str(source.case), "no network of tie points", "one to judge", "name one by --ties")
            return ties

        judging = Judging(verdicts or source.case.with_name(f"{source.case.stem}-verdicts.csv"), read_ties)
        if verdicts is not None:
            _ = judging.verdicts
        return judging

    # --- the map

    def map_places(self, points: Array) -> Array:
        """(n, 2) m on the map, of points (n, 3) in m, body-fixed; NaN where there is none."""
        return plane_coordinates(points, self.centre)

    def footprints(self) -> list[Array]:
        """Of each image its outline (k, 2) in m on the map."""

        def make() -> list[Array]:
            block = self.block()
            if self.now.solution is not None:
                outlines = solution_connectivity(self.now.solution).footprints
            else:
                outlines = network_footprints(block.network, block.places, block.corrections.__getitem__)
            return [self.map_places(area.outline) if len(area.outline) else np.zeros((0, 2)) for area in outlines]

        return self.once("footprints", make)

    # --- changes

    def change(self, act: Callable[[Project], _Result]) -> _Result:
        """Change the project, in one transaction.

        Raises
        ------
        InputError
            Results or a case; another process is changing it; `act` refuses. Nothing has changed then.
        """
        require(self.kind == "project", str(self.path), f"a {self.kind}", "a project", _CHANGED)
        with self._changing:
            self._prepared = -1  # a refused change leaves nothing in memory
            with open_project(self.path, write=True, cache=self._cache) as project:
                result = act(project)
                warning = _warning(project)
            self.revision, self.warning, self._seen = self.revision + 1, warning, _mark(self.path)
            self._prepared = self.revision
        return result

    def prepare_change(self) -> None:
        """Read what the next change begins with, so that the first is as quick as those after it; where that is not
        in memory, and the block is no large one. The project's folder stays as it is, and no change or look waits.
        """
        if self.kind != "project" or self._prepared == self.revision:
            return
        is_small = self.block().network.rays.point.size <= _MOST_PREPARED
        if not self._changing.acquire(blocking=False):
            return
        try:
            self._prepared, adjustment = self.revision, None
            with open_project(self.path, cache=self._cache) as project:
                if is_small and is_solved(project):
                    adjustment = incremental(project)
                    self._cache.noted(*project.changes(1))
            if adjustment is not None and (unknowns := list(adjustment.values)):
                adjustment.joint(unknowns[:1])  # which makes the tree
        finally:
            self._changing.release()

    def notice(self) -> None:
        """Read the project again, if another process has changed it."""
        if self.kind != "project" or not self._changing.acquire(blocking=False):
            return
        try:
            mark = _mark(self.path)
            if mark != self._seen:
                with suppress(MgsgraphError), open_project(self.path) as project:  # it may be changing just now
                    self.revision, self.warning, self._seen = self.revision + 1, _warning(project), mark
                    self._pictures = None
        finally:
            self._changing.release()


def near_points(network: Network, places: Array, point: str) -> Index | None:
    """(m,) points that share an image with a point, the nearest of them, ascending; None where it has no place."""
    (number,) = network.points.ids.find([point]).tolist()
    if number < 0 or not np.all(np.isfinite(places[number])):
        return None
    rays, ranges = network.rays, network.ranges
    images = np.union1d(rays.image[rays.point == number], ranges.image[ranges.point == number])
    is_near = np.zeros(len(network.points), dtype=bool)
    is_near[rays.point[np.isin(rays.image, images)]] = is_near[ranges.point[np.isin(ranges.image, images)]] = True
    members = np.flatnonzero(is_near & finite_rows(places))
    distances = np.linalg.norm(places[members] - places[number], axis=1)
    return np.sort(members[np.argsort(distances, kind="stable")[:_MOST_NEAR]])


def _mark(path: Path) -> tuple[int, int] | None:
    """Time and size of a project's file. It is not opened: closing it would release all locks of the process."""
    with suppress(OSError):
        status = (path / PROJECT).stat()
        return status.st_mtime_ns, status.st_size
    return None


def _kind(path: Path) -> Kind:
    if path.is_dir() and (path / PROJECT).is_file():
        return "project"
    if (path.is_dir() and (path / ARCHIVE).is_file()) or path.suffix == ".npz":
        return "result"
    if path.is_file():
        return "case"
    found = "no such file or folder" if not path.exists() else f"a folder with neither {ARCHIVE} nor {PROJECT}"
    raise InputError(str(path), found, "a project, results of `mgsgraph adjust`, or a case file")


def _centre(block: Block) -> Array:
    """Middle (3,) in m of the points, or of what the images see where no point has a place."""
    if np.any(finite_rows(block.places)):
        return centre_of(block.places)
    outlines = [area.outline for area in network_footprints(block.network, block.places) if len(area.outline)]
    require(outlines, "studio", "no point with a place, and no image that sees the ground", "one of them")
    return centre_of(np.concatenate(outlines))


def _pictures(case: Path | None) -> dict[str, Path | None]:
    if case is None or not case.is_file():
        return {}
    return {entry.name: picture_of(entry, case.parent) for entry in decode(case).images}


def _result(path: Path, case: Path | None) -> State:
    results = results_of(path)
    solution = read_solution(results.folder)
    return _of_solution(solution, _pictures(case or results.case))


def _of_solution(solution: Solution, pictures: Mapping[str, Path | None]) -> State:
    warning = f"The adjustment has NOT converged, so that sigmas mean little: {solution.message}"
    return State(solution.name, Block.of_solution(solution), solution.places_before, lambda: Posterior.of(solution),
                solution, pictures, "" if solution.converged else warning)  # fmt: skip


def _of_case(path: Path, ties: Path | None) -> State:
    case = read_case(path, ties=ties)
    warning = "Nothing has been adjusted yet: nominal orientation, a-priori places."
    return State(case.name, Block.of_network(case.network, case.settings), None, None, None,
                _pictures(path), warning, case.ties)  # fmt: skip


def _project(path: Path, case: Path | None) -> State:
    with open_project(path) as project:
        pictures = {name: Path(file) if file else None for name, file in project.pictures().items()}
        pictures |= _pictures(case)
        last, changes = project.last_results(), project.changes(1)
        solved, name, warning = is_solved(project), project.name, _warning(project)
        current = last is not None and bool(changes) and last.change >= changes[-1].number
        unsolved = None if solved else Block.of_network(project.store.network(), project.settings.solver.settings)
    if current and last is not None and last.folder is not None and (path / last.folder / ARCHIVE).is_file():
        return _of_solution(read_solution(path / last.folder), pictures)
    if unsolved is not None:
        return State(name, unsolved, None, None, None, pictures, warning)
    posterior = read_posterior(path)[1]
    return State(name, Block.of_posterior(posterior), None, lambda: posterior, None, pictures, warning)


def _warning(project: Project) -> str:
    """Warning about a project that differs from its last batch solution."""
    command = command_line("project", "solve", project.folder)
    if not is_solved(project):
        return f"Nothing has been adjusted yet: {command}"
    last, changes = project.last_results(), project.changes(1)
    if last is None or last.change >= changes[-1].number:
        return ""
    return f"Changed since its last batch solution, by iSAM2; for a new one: {command}"

"""Terrain models by cells or under single tie points: are the sigmas of their shift, the ties and the laser honest?

Each draw is a simulated site, whose errors have the sigmas that its case states (MEGDR's posts are means over their
cells of the true ground), in the mission's formats, with dense matches of the true ground in place of pictures. It is
adjusted with tie points on the B-spline of the model's posts, then with its posts on the surface that the images
show (`registration.relief`), and both are held against the truth.

    python scripts/cells.py [--cases eos ...] [--seeds 200] [--first 1] [--processes N] [--keep FILE] [--out FILE]
"""

import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from study import (
    Blocks,
    Draw,
    cases,
    degrees_of_points,
    joint_degrees,
    names_of,
    nees_cell,
    number,
    refusals,
    run,
    seeds_of,
    table,
)  # fmt: skip

from mgsgraph.adjustment.adjust import adjust_network
from mgsgraph.adjustment.solution import Solution
from mgsgraph.analysis.posterior import Posterior
from mgsgraph.case.reading import Case, read_case
from mgsgraph.errors import InputError
from mgsgraph.geometry.body import east_north_up
from mgsgraph.geometry.records import Array
from mgsgraph.network import PointClass, SharedKind
from mgsgraph.registration.minima import ReliefSettings
from mgsgraph.registration.relief import profile_names, registered
from mgsgraph.registration.relief_surfaces import AveragedPair, Cells, averaged_pair, cells_of
from mgsgraph.simulation.demo.demonstration import nees
from mgsgraph.simulation.files import write_site
from mgsgraph.simulation.ground import grid_shift
from mgsgraph.simulation.mgs_files import shot_names
from mgsgraph.simulation.site import SimulatedSite, SimulationOptions, simulate_site
from mgsgraph.simulation.sites import SITE_NAMES

sys.path.append(str(Path(__file__).resolve().parents[1] / "tests"))
from true_matches import true_matches

HEIGHT_SIGMA = 5.0
"""m, a-priori sigma of the model's height offset, which is drawn."""
STEP, NOISE, WINDOW = 14.0, 0.1, 42.0
"""pixels between matches and of their noise; m, width of a matching window."""
REACH = 1000.0
"""m, largest shift that is searched."""
KINDS = {"terrain": 3, "ties": 3, "profiles": 2, "laser": 3}
"""Degrees of freedom of each normalised error."""
METHODS = ("ties", "cells")
HEAD = (
    "site", "by", "draws", "not converged", *KINDS, "95 %", "model, m", "ties, m", "laser, m", "seconds",
)  # fmt: skip


def one_draw(name: str, seed: int) -> Draw:
    """Draw, adjust by tie points and by cells, judge."""
    begin = time.perf_counter()
    try:
        with tempfile.TemporaryDirectory() as folder:
            case, truth, site, rng = drawn_case(name, seed, Path(folder))
    except InputError as error:
        return {"refused": str(error)}
    ties = adjust_network(case.network, case.settings, case.name)
    cells = by_cells(case, ties, site, rng)
    judged = {"ties": truth.judge(ties), "cells": truth.judge(cells)}
    return judged | {"seconds": time.perf_counter() - begin}


def drawn_case(name: str, seed: int, folder: Path) -> tuple[Case, "Truth", SimulatedSite, np.random.Generator]:
    """A case in the mission's formats, its truth, the site, and the generator for its matches.

    Raises InputError where a profile misses its image.
    """
    site = simulate_site(name, seed, SimulationOptions(pictures=False))
    rng = np.random.default_rng([seed, SITE_NAMES.index(name), 7])
    lift = float(rng.normal(0.0, HEIGHT_SIGMA))
    site = replace(site, grid=replace(site.grid, radii=site.grid.radii + lift))
    path = write_site(site, folder)
    path.write_text(f"{path.read_text(encoding='utf-8')}height_sigma_m = {HEIGHT_SIGMA}\n", encoding="utf-8")
    return read_case(path), Truth(site, lift), site, rng


def by_cells(case: Case, before: Solution, site: SimulatedSite, rng: np.random.Generator) -> Solution:
    """Adjusted with posts and shots on the surface of dense matches."""
    settings, posterior = ReliefSettings(reach=REACH), Posterior.of(before)
    models = cells_of(case.terrain, posterior, settings)
    footprints, surfaces = shown(case, site, posterior, models, rng)
    return registered(before, footprints, models, surfaces, settings, case.settings).solution


def shown(
    case: Case, site: SimulatedSite, posterior: Posterior, models: Sequence[Cells], rng: np.random.Generator
) -> tuple[list[float], list[AveragedPair]]:
    """m, footprint of each profile; and the surfaces of dense matches of the true ground."""
    matches = true_matches(site.terrain, *(image.true for image in site.images), STEP, NOISE, rng)
    footprints = [case.footprints[name] for name in profile_names(posterior.network)]
    sizes = [*((size, False) for size in set(footprints)), *((model.footprint, True) for _, model in models)]
    return footprints, [
        averaged_pair(posterior, matches, (0, 1), size, matches.spacing, WINDOW, cells) for size, cells in sizes
    ]


class Truth:
    """The true values that an adjustment estimates."""

    def __init__(self, site: SimulatedSite, lift: float) -> None:
        self._points = dict(zip(site.ties.ids, site.true_ties, strict=True))
        self._shifts = dict[str, Array]()
        for image in site.images:
            profile = image.settings.profile
            self._shifts[profile] = -image.profile.shift
            names = [f"{profile}:{shot}" for shot in shot_names(image)]
            self._points |= dict(zip(names, image.profile.true_footprints, strict=True))
        self._model = -np.append(grid_shift(site.terrain), lift)

    def judge(self, solution: Solution) -> Draw:
        """Errors of a solution, and the same by their covariances, per degree of freedom."""
        network = solution.network
        model, of_model = model_shift(solution)
        members = [solution.members(kind) for kind in (PointClass.TIE, PointClass.LASER)]
        (ties, of_ties), (laser, of_laser) = (self.errors(solution, group) for group in members)
        assert network.shifts is not None
        chosen = [(p, name) for p, name in enumerate(network.shifts.names) if name in self._shifts]
        shifts = np.array([solution.shifts[p] - self._shifts[name] for p, name in chosen])
        of_shifts = np.array([solution.shift_covariance(p) for p, _ in chosen])
        of_each_tie = nees(ties, of_ties)
        squares = {
            "terrain": nees((model - self._model[: model.size])[None], of_model[None]) * KINDS["terrain"] / model.size,
            "ties": of_each_tie, "profiles": nees(shifts, of_shifts), "laser": nees(laser, of_laser),
        }  # fmt: skip
        first = len(network.images)
        profiles = solution.joint_covariance.of([first + p for p, _ in chosen])
        return {
            "converged": solution.converged,
            "degrees": {
                "terrain": model.size, "ties": degrees_of_points(solution, members[0]),
                "profiles": joint_degrees(profiles, 2), "laser": degrees_of_points(solution, members[1]),
            },
            "nees": {kind: float(values.mean()) / KINDS[kind] for kind, values in squares.items()},
            "inside": float(np.mean(of_each_tie < INSIDE)),
            "model": float(np.linalg.norm(model[:2] - self._model[:2])),
            "ties": float(np.sqrt(np.mean(np.sum(ties**2, axis=1)))),
            "laser": float(np.sqrt(np.mean(np.sum(laser**2, axis=1)))),
        }

    def errors(self, solution: Solution, points: Array) -> tuple[Array, Array]:
        """(n, 3) m east, north and up, errors of points; their covariances."""
        truth = np.array([self._points[solution.network.points.ids[i]] for i in points.tolist()])
        axes = east_north_up(truth)
        covariances = axes @ solution.covariances[points] @ axes.mT
        return np.einsum("nij,nj->ni", axes, solution.places[points] - truth), covariances


INSIDE = 7.815
"""Chi-square of three degrees of freedom that 95 % stay below."""


def model_shift(solution: Solution) -> tuple[Array, Array]:
    """(3,) m east, north and up, shift of the terrain model, and its covariance."""
    network = solution.network
    if network.terrain_moves:
        last = len(network.shift_names) - 1
        return solution.shift_values[last], solution.shift_spread(last)
    (k,) = (k for k, shared in enumerate(network.shared) if shared.kind is SharedKind.PROFILE_HEIGHT)
    assert network.shifts is not None
    p = network.shifts.names.index(network.shared[k].profile)
    first, second = len(network.images) + p, solution.shared_variable(k)
    joint = solution.joint_covariance
    spread = np.zeros((3, 3))
    spread[:2, :2], spread[2, 2] = joint.block(first, first), joint.block(second, second)[0, 0]
    spread[:2, 2] = spread[2, :2] = joint.block(first, second)[:, 0]
    return np.append(solution.shifts[p], solution.shared[k][0]), spread


def row(site: str, method: str, draws: list[Draw]) -> list[str]:
    """Of one site, by tie points or by cells."""
    results = [draw[method] for draw in draws]
    cells = [nees_cell(*([result[key][kind] for result in results] for key in ("nees", "degrees"))) for kind in KINDS]
    errors = [float(np.sqrt(np.mean([result[name] ** 2 for result in results]))) for name in ("model", "ties", "laser")]
    return [
        site, method, str(len(results)), str(sum(not result["converged"] for result in results)), *cells,
        f"{100.0 * np.mean([result['inside'] for result in results]):.1f}", *(number(error) for error in errors),
        number(float(np.mean([draw["seconds"] for draw in draws]))),
    ]  # fmt: skip


def judge(draws: list[Draw]) -> Blocks:
    """The table."""
    rows = [row(site, method, cases(draws, site)) for site in names_of(draws) for method in METHODS]
    return {"cells": [*table(HEAD, rows), "", refusals(draws)]}


if __name__ == "__main__":
    sys.exit(run(seeds_of(__doc__, SITE_NAMES, 200, "evidence_terrain.md#cells"), one_draw, judge))

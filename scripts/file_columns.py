"""What is in each column of the files of results, as the tables say: for docs/files.md (scripts/pages.py)."""

import tempfile
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np

from mgsgraph.adjustment.solution import Solution
from mgsgraph.analysis.components import components_of
from mgsgraph.analysis.posterior import Posterior
from mgsgraph.analysis.reliability import reliability
from mgsgraph.analysis.residual_spectrum import ResidualVibrations
from mgsgraph.analysis.statistics import solution_connectivity
from mgsgraph.analysis.unexplained import unexplained
from mgsgraph.case.reading import adjust, read_case
from mgsgraph.files.output.table import Column, Table
from mgsgraph.geometry.stereo_surface import SurfaceHeights
from mgsgraph.network import PointClass
from mgsgraph.registration.case import CaseRegistration, register_case
from mgsgraph.registration.dem.checking import HeightChecks
from mgsgraph.registration.minima import CostSurface, ProfileState, ReliefProfile
from mgsgraph.results.analysis import (
    components_table,
    likelihood_table,
    reliability_table,
    unexplained_table,
    vibrations_table,
)
from mgsgraph.results.matching import matches_table
from mgsgraph.results.passes import nodes_table, shared_table
from mgsgraph.results.places import selection_table
from mgsgraph.results.plan import judged_table
from mgsgraph.results.registration import discrepancy_table, registration_table
from mgsgraph.results.relief import costs_table, profiles_table, relief_shots_table
from mgsgraph.results.soundness import drivers_table
from mgsgraph.results.tables import connectivity_table, orientation_table, points_table, residuals_table
from mgsgraph.results.terrain_model import shots_table
from mgsgraph.simulation.demo.truth import disagreement_table
from mgsgraph.simulation.files import write_pair, write_site
from mgsgraph.simulation.orbit import MARS
from mgsgraph.simulation.pair import PairSettings, simulate_pair
from mgsgraph.simulation.site import SimulationOptions, simulate_site

_MORE = """
[[shared]]
kind = "range bias"
sigma_m = 5.0

[[passes]]
name = "A"
images = ["SIM/A"]
prior = {}

[solver]
reject = 4.0
"""
"""What a small simulated case gets, so that every table has something in it."""


def columns_markdown() -> str:
    """A section for each file."""
    return "\n".join(line for file, table in _tables() for line in _section(file, table)) + "\n"


def _solution() -> Solution:
    with tempfile.TemporaryDirectory() as folder:
        case = write_pair(simulate_pair(PairSettings(ties=20, shots=8), seed=1), Path(folder))
        case.write_text(case.read_text(encoding="utf-8") + _MORE, encoding="utf-8")
        return adjust(read_case(case))


def _tables() -> Iterator[tuple[str, Table]]:
    solution = _solution()
    linearised = Posterior.of(solution).linearised
    yield "points.csv", points_table(solution)
    yield "orientation.csv", orientation_table(solution)
    yield "residuals.csv", residuals_table(solution)
    yield "connectivity.csv", connectivity_table(solution_connectivity(solution))
    yield "shared.csv", shared_table(solution)
    yield "passes.csv", nodes_table(solution)
    yield "drivers.csv", drivers_table(solution)
    yield "reliability.csv", reliability_table(reliability(linearised))
    yield "unexplained.csv", unexplained_table(unexplained(linearised))
    yield "vibrations.csv", vibrations_table(ResidualVibrations((), ()))
    yield "components.csv", components_table(components_of(linearised))
    yield "likelihood.csv", likelihood_table(())
    registration = _registration()
    yield "registration.csv", registration_table(registration)
    yield "discrepancy.csv", discrepancy_table(registration)
    yield "what mgsgraph shots writes", selection_table(registration.before[0].found)
    yield from _without_rows()


def _registration() -> CaseRegistration:
    with tempfile.TemporaryDirectory() as folder:
        site = simulate_site("gusev", 1, SimulationOptions(pictures=False))
        return register_case(read_case(write_site(site, Path(folder))))


def _without_rows() -> Iterator[tuple[str, Table]]:
    """Tables whose columns are the same without a plan, a match or a laser shot."""
    none, pairs, index = np.zeros(0), np.zeros((0, 2)), np.zeros(0, dtype=np.int64)
    ties = SimpleNamespace(ids=(), measure_point=index, measure_image=(), measures=pairs, measure_sigmas=pairs)
    covariances, reference = np.zeros((0, 2, 2)), np.zeros(0, dtype=np.bool_)
    matches: Any = SimpleNamespace(
        ties=ties, covariances=covariances, reference=reference, correlation=none, misfit=none
    )
    checks = HeightChecks((), index, (), np.zeros((0, 3)), pairs, none, none, none, none)
    dem: Any = SimpleNamespace(checks=checks, model=SimpleNamespace(map=SimpleNamespace(radius=0.0)))
    yield "plan.csv", judged_table({})
    yield "matches.csv", matches_table(matches)
    yield "shots.csv", shots_table(dem)
    relief = _relief_without_shots()
    yield "profiles.csv", profiles_table(relief)
    yield "shots.csv of coregister", relief_shots_table(relief)
    yield "costs.csv", costs_table(relief)
    yield "disagreement.csv", disagreement_table(())


def _relief_without_shots() -> Any:
    """A registration by relief of one profile without shots."""
    none, index, mask = np.zeros(0), np.zeros(0, dtype=np.int64), np.zeros(0, dtype=np.bool_)
    vectors, pairs = np.zeros((0, 3)), np.zeros((0, 2))
    heights = SurfaceHeights(none, vectors, np.zeros((0, 2, 9)), pairs, pairs, mask, none, none, none)
    state = ProfileState(vectors, heights, CostSurface("", np.zeros(1), np.zeros((1, 1)), 0, ()))
    profile = ReliefProfile("", PointClass.LASER, index, mask, none, state, state, np.zeros(2), np.zeros((2, 2)))
    points, image = SimpleNamespace(ids=(), places=vectors), SimpleNamespace(body=MARS)
    network = SimpleNamespace(points=points, images=(image,), shifts=SimpleNamespace(sigmas=np.zeros(1)))
    return SimpleNamespace(profiles=(profile,), solution=SimpleNamespace(network=network))


def _section(file: str, table: Table) -> list[str]:
    lines = ["", f"## {file}", "", f"{table.title}. {table.note}".rstrip(), "", "| column | unit | meaning |"]
    return [*lines, "|---|---|---|", *(_row(column) for column in table.columns if column.files)]


def _row(column: Column) -> str:
    names = ", ".join(f"`{one.name()}`" for one in column.split)
    unit = column.unit if isinstance(column.unit, str) else "in `unit`"
    return f"| {names} | {unit} | {column.meaning} |".replace("|  |", "| |")

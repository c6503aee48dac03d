"""A solution: its findings, from which sentences, tables and solution.json are made."""

import math
from collections.abc import Sequence

from mgsgraph.adjustment.solution import Solution
from mgsgraph.analysis.statistics import solution_connectivity
from mgsgraph.network.connectivity import Connectivity
from mgsgraph.network.connectivity_words import connectivity_json, connectivity_statements
from mgsgraph.results.ground import control_section, laser_section, minima_section, points_section, ranges_section
from mgsgraph.results.images import images_section
from mgsgraph.results.passes import passes_section, shared_section
from mgsgraph.results.section import Section
from mgsgraph.results.soundness import (
    drivers_section,
    fits_section,
    implausible_section,
    linearity_section,
    reading_statements,
    soundness_section,
    state_of,
)
from mgsgraph.text import many, short


def solution_sections(solution: Solution, connected: Connectivity | None = None) -> list[Section]:
    """Findings in the order in which they are read; `connected` saves finding it anew. Those with a name are in
    solution.json.
    """
    connected = connected or solution_connectivity(solution)
    return [
        Section("", sentences=_ending(solution)),
        soundness_section(solution),
        drivers_section(solution),
        fits_section(solution),
        implausible_section(solution),
        linearity_section(solution.linearity),
        minima_section(solution.minima),
        images_section(solution),
        ranges_section(solution),
        laser_section(solution),
        control_section(solution),
        shared_section(solution),
        passes_section(solution),
        points_section(solution),
        Section("", sentences=reading_statements(solution.network.images)),
        Section("connectivity", sentences=connectivity_statements(connected), numbers=connectivity_json(connected)),
    ]


def statements(solution: Solution, connected: Connectivity | None = None) -> list[str]:
    """Sentences with figures and units; `connected` saves finding it anew."""
    return sentences_of(solution_sections(solution, connected))


def sentences_of(sections: Sequence[Section]) -> list[str]:
    """Sentences of several sections."""
    return [sentence for section in sections for sentence in section.sentences]


def summary_table(solution: Solution, sections: Sequence[Section] | None = None) -> str:
    """Figures of merit and tables as aligned text of at most 110 columns; `sections` saves finding them anew."""
    tables = [Section("", tables=one.tables).text() for one in sections or solution_sections(solution)]
    seconds = ", ".join(f"{stage} {time:.2f}" for stage, time in solution.seconds.items())
    return "\n\n".join([_head(solution), *filter(None, tables), f"Seconds: {seconds}"])


def _ending(solution: Solution) -> list[str]:
    steps = many(solution.iterations, "iteration")
    cost = f"the cost went from {solution.cost_initial:.4g} to {solution.cost_final:.4g}"
    if solution.converged:
        return [f"{solution.message} It took {steps}; {cost}."]
    return [
        f"NOT CONVERGED after {steps}; {cost}. {solution.message}",
        "Nothing below is a result. Look at the largest residuals for blunders, and at the a-priori sigmas.",
    ]


def figures_of_merit(solution: Solution) -> list[tuple[str, float]]:
    """What one looks at first: names and numbers."""
    fit, network = solution.fit, solution.network
    return [
        ("cost with the nominal orientation", solution.cost_initial), ("cost at the solution", solution.cost_final),
        ("sigma0", fit.sigma0), ("degrees of freedom", fit.degrees_of_freedom), ("observations", fit.observations),
        ("unknowns", fit.unknowns), ("images", len(network.images)), ("ground points", len(network.points)),
        ("image measurements", network.rays.point.size), ("laser ranges", network.ranges.point.size),
    ]  # fmt: skip


def figure(value: float) -> str:
    """A figure of merit in words."""
    if isinstance(value, int):
        return str(value)
    return f"{value:.6g}" if math.isfinite(value) else "not defined"


def _head(solution: Solution) -> str:
    words = [f"{name} {figure(value)}" for name, value in figures_of_merit(solution)]
    head = f"{short(solution.name, 60)}: {state_of(solution)}, {many(solution.iterations, 'iteration')}"
    return "\n".join([head, *(f"  {', '.join(words[first:last])}" for first, last in ((0, 3), (3, 7), (7, 10)))])

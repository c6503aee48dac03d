"""Linearity and profiles of the likelihood: in words, as JSON, sections of an analysis."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from mgsgraph.adjustment.linearity import Linearity
from mgsgraph.analysis.likelihood import LEVELS, Profile, linearity_of
from mgsgraph.analysis.posterior import Posterior
from mgsgraph.files.output.table import Column, Table
from mgsgraph.results.sigmas import Section
from mgsgraph.units import MRAD


def linearity_statements(found: Linearity | None) -> list[str]:
    """What a solution's linearity means, in a sentence."""
    if found is None:
        return []
    drawn = (
        f"over {found.draws} draws from the joint error ellipsoid of the {found.unknowns} unknowns that points share, "
        f"the squares rise {found.ratio:.3g} times as much as it says"
    )
    if found.linear:
        return [f"Linear enough for statements by covariances: {drawn}."]
    return [
        f"NOT LINEAR: {drawn}. Single sigmas may hold; joint statements on orientation and shifts by their covariance "
        "don't. Use likelihood ratios and profiles: `mgsgraph analyze RESULT --likelihood IMAGE` (docs/analysis.md)."
    ]


def linearity_json(found: Linearity | None) -> dict[str, Any] | None:
    """The same for solution.json."""
    if found is None:
        return None
    return {
        "linear": found.linear, "ratio_of_squares": found.ratio, "scatter": found.scatter,
        "unknowns": found.unknowns, "draws": found.draws,
    }  # fmt: skip


def linearity_figure(found: Linearity | None) -> list[tuple[str, str]]:
    """The same for the head of the page."""
    return [] if found is None else [("linear", f"{'yes' if found.linear else 'NO'} ({found.ratio:.3g})")]


def linearity_section(posterior: Posterior) -> Section:
    """The same of an analysis."""
    found = linearity_of(posterior.linearised)
    return Section("linearity", "\n".join(linearity_statements(found)) or "Nothing is shared.", linearity_json(found))


def likelihood_section(posterior: Posterior, names: Sequence[str]) -> Section:
    """Intervals of the numbers of images, shifts and shared unknowns by the likelihood."""
    table = likelihood_table([one for name in dict.fromkeys(names) for one in posterior.likelihood.profiles(name)])
    title = f"{table.title} (68, 95 and 99 %)"
    if posterior.linearised.mixed:
        title += ", within the lowest of several minima: the others are not in them"
    text = "\n".join([title, *table.text()])
    return Section("likelihood", text, table.records(), {"likelihood.csv": table.write_csv})


def likelihood_table(profiles: Sequence[Profile]) -> Table:
    """One row per unknown."""
    units = ["mrad" if one.unit == "rad" else one.unit for one in profiles]
    scale = np.array([1.0 / MRAD if one.unit == "rad" else 1.0 for one in profiles])
    intervals = np.array([one.intervals for one in profiles]).reshape(-1, len(LEVELS), 2) * scale[:, None, None]
    ends = [
        Column(f"{end}_{100.0 * level:.0f}", intervals[:, k, side], meaning=f"{end}er end of the {level:.0%} interval",
               label=f"{end} {level:.0%}", text=">10.4g")
        for k, level in enumerate(LEVELS) for side, end in enumerate(("low", "high"))
    ]  # fmt: skip
    return Table("likelihood", "Intervals by the likelihood", (
        Column("of", [one.owner for one in profiles], meaning="image, shift or shared unknown", text="<20"),
        Column("axis", [one.axis for one in profiles], meaning="which of its unknowns", text="<31"),
        Column("unit", units, meaning="of all numbers of the row", text="<5"),
        Column("value", np.array([one.value for one in profiles]) * scale, meaning="estimate", text=">10.4g"),
        Column("sigma", np.array([one.sigma for one in profiles]) * scale, meaning="by the covariance", text=">9.4g"),
        *ends,
        Column("ratio", np.array([one.ratio for one in profiles]), label="ratio", text=">6.3f",
               meaning="width of the 95 % interval over that by the covariance"),
    ))  # fmt: skip

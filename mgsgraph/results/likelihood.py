"""Linearity and profiles of the likelihood: sections of a solution and of an analysis."""

from collections.abc import Sequence

import numpy as np

from mgsgraph.adjustment.linearity import Linearity
from mgsgraph.analysis.likelihood import LEVELS, Profile
from mgsgraph.analysis.posterior import Posterior
from mgsgraph.files.output.table import Column, Table
from mgsgraph.results.section import Section
from mgsgraph.units import MRAD


def linearity_section(found: Linearity | None) -> Section:
    """What a solution's linearity means."""
    if found is None:
        return Section("linearity")
    record = {
        "linear": found.linear, "ratio_of_squares": found.ratio, "scatter": found.scatter,
        "unknowns": found.unknowns, "draws": found.draws,
    }  # fmt: skip
    drawn = f"(cost ratio {found.ratio:.3g} over {found.draws} samples of {found.unknowns} unknowns)"
    said = f"Linearity check passed {drawn}." if found.linear else (
        f"NOT LINEAR {drawn}. Single sigmas may hold; joint statements on orientation and shifts by their covariance "
        "don't. Use likelihood ratios and profiles: `mgsgraph analyze RESULT --likelihood IMAGE` (docs/analysis.md)."
    )
    return Section("linearity", sentences=[said], numbers=record)


def likelihood_section(posterior: Posterior, names: Sequence[str]) -> Section:
    """Intervals of the numbers of images, shifts and shared unknowns by the likelihood."""
    table = likelihood_table([one for name in dict.fromkeys(names) for one in posterior.likelihood.profiles(name)])
    mixed = ["Only within the lowest of several minima."] if posterior.linearised.mixed else []
    return Section("likelihood", sentences=mixed, tables=[table], numbers=table.records(), csv=[table])


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
    return Table("likelihood", "Intervals by the likelihood (68, 95 and 99 %)", (
        Column("of", [one.owner for one in profiles], meaning="image, shift or shared unknown", text="<20"),
        Column("axis", [one.axis for one in profiles], meaning="which of its unknowns", text="<31"),
        Column("unit", units, meaning="of all numbers of the row", text="<5"),
        Column("value", np.array([one.value for one in profiles]) * scale, meaning="estimate", text=">10.4g"),
        Column("sigma", np.array([one.sigma for one in profiles]) * scale, meaning="by the covariance", text=">9.4g"),
        *ends,
        Column("ratio", np.array([one.ratio for one in profiles]), label="ratio", text=">6.3f",
               meaning="width of the 95 % interval over that by the covariance"),
    ))  # fmt: skip

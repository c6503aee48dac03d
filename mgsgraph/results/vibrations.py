"""Vibrations that residuals show: sentences, table, and their record in analysis.json."""

from typing import TYPE_CHECKING

import numpy as np

from mgsgraph.analysis.posterior import Posterior
from mgsgraph.analysis.spacing.vibrations import ResidualVibrations, residual_vibrations
from mgsgraph.errors import InputError
from mgsgraph.files.output.table import Column, Table, numbers
from mgsgraph.results.sigmas import Section

if TYPE_CHECKING:
    from mgsgraph.results.figures.sheet import Sheet


def vibrations_section(posterior: Posterior, name: str) -> Section:
    """What residuals of all images show; a sentence where there are too few rays."""
    try:
        found = residual_vibrations(posterior.linearised)
    except InputError as error:
        return Section("vibrations", f"No spectrum of residuals over time: {error}.", {"words": [str(error)]})

    def sheet() -> "Sheet":
        from mgsgraph.results.figures.vibrations import vibrations_sheet

        return vibrations_sheet(found, name)

    table = vibrations_table(found)
    seen = [
        {
            "image": one.image, "turn": one.turn, "share_shown": one.share, "named_from_px": None if one.blind else
            one.limit, "highest_frequency_hz": one.spectrum.nyquist,
        }
        for one in found.spectra
    ]  # fmt: skip
    record = {"words": found.sentences, "vibrations": table.records(), "spectra": seen}
    return Section("vibrations", "\n".join(found.sentences), record, {"vibrations.csv": table.write_csv}, sheet)


def vibrations_table(found: ResidualVibrations) -> Table:
    """One row per vibration, clearest first."""
    every = found.vibrations
    return Table("vibrations", "Vibrations in residuals", (
        Column("image", [one.image for one in every], meaning="whose residuals show it best"),
        Column("turn", [one.turn for one in every],
               meaning="pitch: along lines; roll: along samples; yaw: along lines, by the sample"),
        Column("frequency", numbers(every, "frequency"), "hz"),
        Column("frequency_sigma", numbers(every, "frequency_sigma"), "hz"),
        Column("amplitude", numbers(every, "amplitude"), "px", meaning="were it of this image alone"),
        Column("sigma", numbers(every, "sigma"), "px", meaning="of the amplitude"),
        Column("p", np.array([one.probability for one in every], dtype=np.float64),
               meaning="chance of one as clear in noise, at any frequency of this image and turn"),
        Column("or", ["; ".join(one.alternatives) for one in every],
               meaning="images of which it may be as well, or in part"),
    ))  # fmt: skip

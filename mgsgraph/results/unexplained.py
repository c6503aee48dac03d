"""What an adjustment cannot explain, and vibrations that its residuals show: sections of an analysis."""

from typing import TYPE_CHECKING

from mgsgraph.analysis.posterior import Posterior
from mgsgraph.analysis.unexplained import Unexplained, unexplained
from mgsgraph.analysis.vibrations import ResidualVibrations, residual_vibrations
from mgsgraph.errors import InputError
from mgsgraph.files.output.table import Column, Table, numbers
from mgsgraph.results.section import Section

if TYPE_CHECKING:
    from mgsgraph.results.figures.sheet import Sheet


def unexplained_section(posterior: Posterior, name: str) -> Section:
    """The tests of the residuals."""
    found = unexplained(posterior.linearised)

    def sheets() -> "list[Sheet]":
        from mgsgraph.results.figures.unexplained import unexplained_sheet

        return [unexplained_sheet(found, name)]

    table, said = unexplained_table(found), found.sentences
    record = {"level": found.level, "tests": found.tests, "words": said, "effects": table.records()}
    return Section("unexplained", sentences=said, numbers=record, csv=[table], sheets=sheets)


def unexplained_table(found: Unexplained) -> Table:
    """One row per named effect, then one for the clearest test of each place and kind of rows."""
    every = [*found.effects, *found.others]
    named = len(found.effects)
    return Table("unexplained", "What the adjustment cannot explain", (
        Column("kind", [str(one.kind) for one in every], meaning="what it is"),
        Column("where", [one.where for one in every], meaning="image, profile, model, kind of rows"),
        Column("named", ["yes" if k < named else "" for k in range(len(every))], meaning="yes: p below the level"),
        Column("p", numbers(every, "p_value"), meaning="chance of anything as clear in a whole run on good data"),
        Column("quantity", [one.quantity for one in every], meaning="what varies: line, sample; up, east and north"),
        Column("amplitude", numbers(every, "amplitude"),
               meaning="in `unit`; of a correlation the coefficient, whose `unit` is that of the length"),
        Column("sigma", numbers(every, "sigma"), meaning="of the amplitude"),
        Column("unit", [one.unit for one in every], meaning="of amplitude and sigma"),
        Column("period_or_length", numbers(every, "period"), meaning="s, of jitter; correlation length, in `unit`"),
        Column("statistic", numbers(every, "statistic"),
               meaning="chi-square; of a correlation its standardised score"),
        Column("degrees_of_freedom", numbers(every, "degrees").astype(int), meaning="of the statistic"),
        Column("or", ["; ".join(one.alternatives) for one in every], meaning="where else it would explain as much"),
        Column("term", [one.term for one in every], meaning="what to add to the case file"),
    ))  # fmt: skip


def vibrations_section(posterior: Posterior, name: str) -> Section:
    """What residuals of all images show; a sentence where there are too few rays."""
    try:
        found = residual_vibrations(posterior.linearised)
    except InputError as error:
        said = f"No spectrum of residuals over time: {error}."
        return Section("vibrations", sentences=[said], numbers={"words": [str(error)]})

    def sheets() -> "list[Sheet]":
        from mgsgraph.results.figures.vibrations import vibrations_sheet

        return [vibrations_sheet(found, name)]

    table = vibrations_table(found)
    seen = [
        {
            "image": one.image, "turn": one.turn, "share_shown": one.share, "named_from_px": None if one.blind else
            one.limit, "highest_frequency_hz": float(one.frequencies[-1]),
        }
        for one in found.spectra
    ]  # fmt: skip
    record = {"words": found.sentences, "vibrations": table.records(), "spectra": seen}
    return Section("vibrations", sentences=found.sentences, numbers=record, csv=[table], sheets=sheets)


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
        Column("p", numbers(every, "probability"),
               meaning="chance of one as clear in noise, at any frequency of this image and turn"),
        Column("or", ["; ".join(one.alternatives) for one in every],
               meaning="images of which it may be as well, or in part"),
    ))  # fmt: skip

"""What an adjustment cannot explain: sentences, the table of all tests, and their record in analysis.json."""

from typing import TYPE_CHECKING

from mgsgraph.analysis.posterior import Posterior
from mgsgraph.analysis.unexplained import Unexplained, unexplained
from mgsgraph.files.output.table import Column, Table, numbers
from mgsgraph.results.sigmas import Section

if TYPE_CHECKING:
    from mgsgraph.results.figures.sheet import Sheet


def unexplained_section(posterior: Posterior, name: str) -> Section:
    """The tests of the residuals."""
    found = unexplained(posterior.linearised)

    def sheet() -> "Sheet":
        from mgsgraph.results.figures.unexplained import unexplained_sheet

        return unexplained_sheet(found, name)

    table, said = unexplained_table(found), found.sentences
    record = {"level": found.level, "tests": found.tests, "words": said, "effects": table.records()}
    return Section("unexplained", "\n".join(said), record, {"unexplained.csv": table.write_csv}, sheet)


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

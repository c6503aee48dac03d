"""What `add` and `remove` say of the impact of a change."""

from pathlib import Path
from typing import TYPE_CHECKING

import click

if TYPE_CHECKING:
    from mgsgraph.incremental.closing import Closing
    from mgsgraph.incremental.impact import Impact


def tell(impact: "Impact", closing: "Closing | None", table: Path | None) -> None:
    """Sentences, the images reached, the points that moved most (all of them in a CSV file), the closing check."""
    for sentence in impact.sentences():
        click.echo(f"- {sentence}")
    click.echo("\n".join(impact.tables_text()))
    if table is not None:
        from mgsgraph.reports.impact import write_impact

        write_impact(impact, table)
        click.echo(f"All points that moved are in {table}")
    if closing is not None:
        click.echo(f"- {closing.sentence()}")

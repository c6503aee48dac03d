"""`mgsgraph check`: what a case holds, before anything is solved."""

from pathlib import Path

import click


@click.command(short_help="Validate a case.")
@click.argument("case", type=click.Path(path_type=Path))
@click.option("--no-laser", is_flag=True, help="Leave the laser rows out.")
@click.option(
    "--ties", type=click.Path(path_type=Path), metavar="NETWORK", help="Tie points in place of those that CASE names."
)
def check(case: Path, no_laser: bool, ties: Path | None) -> None:
    """Read and validate CASE and everything that it names; print what is there and where it is weak. Solves nothing."""
    from mgsgraph.case.reading import read_case
    from mgsgraph.reports.inventory import inventory

    click.echo(inventory(read_case(case, not no_laser, ties)))

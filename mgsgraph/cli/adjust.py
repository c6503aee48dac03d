"""`mgsgraph adjust`: from a case file to a folder of results."""

from contextlib import nullcontext
from pathlib import Path
from typing import TYPE_CHECKING

import click

from mgsgraph.cli.overruling import overruling

if TYPE_CHECKING:
    from mgsgraph.campaign import Wishes


@click.command(short_help="Adjust a case.")
@click.argument("case", type=click.Path(path_type=Path))
@click.option("--out", type=click.Path(path_type=Path), required=True, help="Folder for the results; made anew.")
@click.option("--cluster", metavar="PLACE", help="local, local:N (worker processes), tcp://host:port, tls://host:port.")
@overruling
@click.option("-v", "--verbose", is_flag=True, help="One line per iteration.")
@click.pass_context
def adjust(ctx: click.Context, case: Path, out: Path, cluster: str | None, wishes: "Wishes", verbose: bool) -> None:
    """Adjust CASE (a TOML file, see scripts/cases) and write the results to a folder.

    Options overrule the case file. With --cluster the points lie with the workers, in partitions.

    Exit status: 0 converged, 1 not converged (results are written), 2 bad input.
    """
    from mgsgraph.adjustment.adjust import adjust_network
    from mgsgraph.adjustment.cluster import open_cluster, parse_cluster
    from mgsgraph.case import read_case
    from mgsgraph.cli.progress import iteration_bar
    from mgsgraph.products.atomic import require_replaceable
    from mgsgraph.products.results import write_results
    from mgsgraph.products.summary import statements, summary_table

    require_replaceable(out)
    if cluster is not None:
        parse_cluster(cluster)
    read = read_case(case, laser=wishes.laser)
    settings = wishes.over(read.settings)
    hands = open_cluster(cluster) if cluster is not None else nullcontext()
    with hands as workers, iteration_bar(verbose, settings.max_iterations) as bar:
        solution = adjust_network(read.network, settings, read.name, bar, workers)
    write_results(solution, out, figures=wishes.figures)
    click.echo(summary_table(solution))
    for sentence in statements(solution):
        click.echo(f"- {sentence}")
    click.echo(f"Results are in {out}")
    ctx.exit(0 if solution.converged else 1)

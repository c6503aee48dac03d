"""`mgsgraph adjust`: from a case file to a folder of results."""

from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from pathlib import Path
from typing import TYPE_CHECKING

import click

from mgsgraph.cli.overruling import overruling

if TYPE_CHECKING:
    from mgsgraph.adjustment.cluster import Connection
    from mgsgraph.adjustment.settings import SolverSettings
    from mgsgraph.campaign import Overrides
    from mgsgraph.case.reading import Case


@click.command(short_help="Adjust a case.")
@click.argument("case", type=click.Path(path_type=Path))
@click.option("--out", type=click.Path(path_type=Path), required=True, help="Folder for the results; made anew.")
@click.option("--cluster", metavar="PLACE", help="local, local:N (worker processes), tcp://host:port, tls://host:port.")
@click.option(
    "--ties", type=click.Path(path_type=Path), metavar="NETWORK", help="Tie points in place of those that CASE names."
)
@click.option("--two-steps", is_flag=True, help="First without the terrain model, then with it; figures of both.")
@overruling
@click.option("-v", "--verbose", is_flag=True, help="One line per iteration.")
@click.pass_context
def adjust(
    ctx: click.Context,
    case: Path,
    out: Path,
    cluster: str | None,
    two_steps: bool,
    ties: Path | None,
    overrides: "Overrides",
    verbose: bool,
) -> None:
    """Adjust CASE (a TOML file, see scripts/cases) and write the results to a folder.

    Options overrule the case file. With --cluster the points lie with the workers, in partitions. With --two-steps
    blunders are sought without the terrain model, and then the block is fitted to it: see docs/two_steps.md.

    Exit status: 0 converged, 1 not converged (results are written), 2 bad input.
    """
    from mgsgraph.adjustment.adjust import adjust_network
    from mgsgraph.adjustment.cluster import open_cluster, parse_cluster
    from mgsgraph.case.reading import read_case
    from mgsgraph.cli.progress import iteration_bar
    from mgsgraph.output.folders import require_replaceable
    from mgsgraph.reports.results import write_results
    from mgsgraph.reports.summary import statements, summary_table

    require_replaceable(out)
    if cluster is not None:
        parse_cluster(cluster)
    read = read_case(case, overrides.laser, ties)
    settings = overrides.over(read.settings)
    hands: AbstractContextManager[Connection | None] = open_cluster(cluster) if cluster is not None else nullcontext()
    if two_steps:
        ctx.exit(0 if _in_two_steps(read, settings, out, hands, overrides, verbose) else 1)
    with hands as workers, iteration_bar(verbose, settings.max_iterations) as bar:
        solution = adjust_network(read.network, settings, read.name, bar, workers)
    write_results(solution, out, figures=overrides.figures)
    click.echo(summary_table(solution))
    for sentence in statements(solution):
        click.echo(f"- {sentence}")
    click.echo(f"Results are in {out}")
    ctx.exit(0 if solution.converged else 1)


def _in_two_steps(
    read: "Case",
    settings: "SolverSettings",
    out: Path,
    hands: AbstractContextManager["Connection | None"],
    overrides: "Overrides",
    verbose: bool,
) -> bool:
    """Whether both steps converged."""
    from mgsgraph.adjustment.two_steps import adjust_in_two_steps, require_terrain
    from mgsgraph.analysis.two_step_statistics import two_step_statistics
    from mgsgraph.cli.progress import iteration_bar
    from mgsgraph.cli.stages import stage_bar
    from mgsgraph.reports.results import write_results
    from mgsgraph.reports.two_steps import two_steps_page, write_two_steps

    require_terrain(read.network, str(read.path))
    with hands as workers, iteration_bar(verbose, settings.max_iterations) as bar:
        steps = adjust_in_two_steps(read.network, settings, read.name, bar, bar.begin, workers)
    write_results(steps.fitted, out, figures=False)  # what took longest is safe, whatever becomes of the rest
    with _solution_kept(out), stage_bar(2) as stages:
        with stages.stage("figures of merit"):
            merit = two_step_statistics(steps)
        with stages.stage("tables and figures"):
            write_two_steps(merit, out, figures=overrides.figures)
    click.echo(two_steps_page(merit))
    click.echo(f"Results are in {out}")
    return steps.converged


@contextmanager
def _solution_kept(out: Path) -> Iterator[None]:
    """Say where the solution is, should what follows it fail or be interrupted."""
    said = f"the solution of step 2 is in {out}, without figures of merit"
    try:
        yield
    except KeyboardInterrupt:
        click.echo(f"mgsgraph: interrupted; {said}", err=True)
        raise click.exceptions.Exit(130) from None
    except Exception:
        click.echo(f"mgsgraph: {said}", err=True)
        raise

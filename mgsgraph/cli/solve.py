"""`mgsgraph solve`: everything in a project by batch, and how far the incremental result was from it."""

from pathlib import Path

import click


@click.command(short_help="Adjust a project by batch.")
@click.argument("project", type=click.Path(path_type=Path))
@click.option("--no-figures", is_flag=True, help="Write tables only.")
@click.option("-v", "--verbose", is_flag=True, help="One line per iteration.")
@click.pass_context
def solve(ctx: click.Context, project: Path, no_figures: bool, verbose: bool) -> None:
    """Adjust everything in PROJECT by batch, compare it with the incremental result, and write PROJECT/solutions/NNNN.

    Exit status: 0 converged, 1 not converged (results are written), 2 bad input (nothing has changed).
    """
    from mgsgraph.cli.progress import iteration_bar
    from mgsgraph.project.changes import solve as solve_all
    from mgsgraph.project.project import open_project
    from mgsgraph.reports.summary import statements, summary_table

    with (
        open_project(project, write=True, thorough=True) as opened,
        iteration_bar(verbose, opened.settings.solver.settings.max_iterations) as bar,
    ):
        solved = solve_all(opened, figures=not no_figures, progress=bar)
    click.echo(summary_table(solved.solution))
    for sentence in statements(solved.solution):
        click.echo(f"- {sentence}")
    if solved.closing is not None:
        click.echo(f"- {solved.closing.sentence()}")
    click.echo(f"Results are in {solved.folder}")
    ctx.exit(0 if solved.solution.converged else 1)

"""`mgsgraph demo`: the main job on a simulated site whose truth is known."""

from pathlib import Path

import click


@click.command(short_help="Simulate a study site, adjust it, and compare with the truth.")
@click.argument("site", default="gusev")
@click.option(
    "--out",
    type=click.Path(path_type=Path),
    default=Path("mgsgraph-demo"),
    show_default=True,
    help="Folder for inputs and results; made anew.",
)
@click.option("--seed", type=click.IntRange(min=0), default=1, show_default=True, help="Seed of everything drawn.")
@click.option("--attitude-time-bias", type=float, help="Seconds by which the nadir image's CK is off, instead of 0.7.")
@click.option("--no-figures", is_flag=True, help="Write tables only.")
@click.pass_context
def demo(
    ctx: click.Context, site: str, out: Path, seed: int, attitude_time_bias: float | None, no_figures: bool
) -> None:
    """Simulate SITE (eos, gusev, isidis; or pair: small and synthetic), write it in the formats of the mission's
    archive, read it back, register its laser profiles, adjust it, and register them again.

    Its kernels are wrong as the papers found them; the closing words say what was wrong before and what is right now,
    against the truth. Exit status: 0 converged, 1 not converged (results are written), 2 bad input.
    """
    from mgsgraph.adjustment.solution import Solution
    from mgsgraph.case.reading import Case
    from mgsgraph.case.reading import adjust as run
    from mgsgraph.cli.progress import iteration_bar
    from mgsgraph.cli.stages import stage_bar
    from mgsgraph.demo.demonstration import STAGES
    from mgsgraph.demo.simulate import DEMONSTRATED, simulation_options
    from mgsgraph.demo.summary import write_demo
    from mgsgraph.output.folders import fresh_folder
    from mgsgraph.reports.summary import statements, summary_table

    def adjusting(case: Case) -> Solution:
        with iteration_bar(False, case.settings.max_iterations) as bar:
            return run(case, bar)

    options = simulation_options(site, attitude_time_bias, known=DEMONSTRATED)
    with fresh_folder(out) as folder, stage_bar(len(STAGES)) as stages:
        solution, closing = write_demo(site, folder, seed, options, adjusting, stages, figures=not no_figures)
    click.echo(summary_table(solution))
    for sentence in statements(solution):
        click.echo(f"- {sentence}")
    click.echo("\nWhat was wrong, and what is right now")
    for sentence in closing:
        click.echo(f"- {sentence}")
    click.echo(f"Inputs and results are in {out}")
    ctx.exit(0 if solution.converged else 1)

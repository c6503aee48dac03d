"""`mgsgraph plan`: what to observe next."""

from pathlib import Path

import click

_PATH = click.Path(path_type=Path)


@click.command(short_help="Rank what might be observed next by what it would do to the sigmas.")
@click.argument("adjusted", type=_PATH, metavar="SOLUTION_OR_PROJECT")
@click.argument("candidates", type=_PATH)
@click.option("--choose", type=click.IntRange(1), default=3, show_default=True, help="How many to choose at the most.")
@click.option(
    "--target", "targets", multiple=True, default=("ties",), show_default=True, metavar="ties|all|NAME",
    help="Whose sigmas count: tie points, all points, or points and images by name; may be repeated.",
)  # fmt: skip
@click.option(
    "--criterion", type=click.Choice(["mean", "worst"]), default="mean", show_default=True,
    help="Whether the targets' mean sigma counts, or the largest one.",
)  # fmt: skip
@click.option("--out", type=_PATH, help="Folder for plan.csv, plan.json and a figure; made anew.")
def plan(
    adjusted: Path, candidates: Path, choose: int, targets: tuple[str, ...], criterion: str, out: Path | None
) -> None:
    """Rank the images, laser profiles and control points of CANDIDATES (a TOML file, see docs/plan.md) by what they
    would do to the sigmas of SOLUTION_OR_PROJECT (results of `mgsgraph adjust`, or a project), before anything is
    measured; and choose some, each in sight of those before it.

    Exit status: 0, also where nothing is worth anything; 2 bad input.
    """
    from mgsgraph.case.candidates import read_candidates
    from mgsgraph.cli.progress import counting_bar
    from mgsgraph.output.folders import PLAN, require_replaceable
    from mgsgraph.planning.plan import plan as make
    from mgsgraph.project.reading import read_state
    from mgsgraph.reports.plan import plan_table, statements, write_plan

    if out is not None:
        require_replaceable(out, PLAN)
    name, state, warning = read_state(adjusted)
    if warning:
        click.echo(f"- {warning}")
    with counting_bar("planning measures", "candidate") as bar:
        wanted = read_candidates(candidates, state, bar)
    with counting_bar("judging", "candidate") as bar:
        made = make(state, wanted, choose, targets, "mean" if criterion == "mean" else "worst", name, bar)
    if out is not None:
        write_plan(made, out)
    click.echo(plan_table(made))
    for sentence in statements(made):
        click.echo(f"- {sentence}")
    if out is not None:
        click.echo(f"The plan is in {out}")

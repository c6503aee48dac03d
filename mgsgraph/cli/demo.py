"""`mgsgraph demo`: the main job on a simulated pair whose truth is known."""

from pathlib import Path

import click


@click.command(short_help="Simulate a pair and adjust it.")
@click.option(
    "--out",
    type=click.Path(path_type=Path),
    default=Path("mgsgraph-demo"),
    show_default=True,
    help="Folder for inputs and results; made anew.",
)
@click.option("--seed", type=click.IntRange(min=0), default=1, show_default=True, help="Seed of the simulated errors.")
@click.option("--no-figures", is_flag=True, help="Write tables only.")
def demo(out: Path, seed: int, no_figures: bool) -> None:
    """Simulate a Mars pushbroom pair with laser ranges, write it in the real formats, read it back and adjust it.

    The trajectory in its files is wrong by some 30 m and 20 arcsec, as SPICE may be; the summary says what the
    adjustment made of it, against the truth.
    """
    from mgsgraph.case import adjust as run
    from mgsgraph.case import read_case
    from mgsgraph.cli.progress import iteration_bar
    from mgsgraph.products.atomic import fresh_folder
    from mgsgraph.products.results import write_into
    from mgsgraph.products.summary import statements, summary_table
    from mgsgraph.products.truth import against_truth
    from mgsgraph.simulation.files import write_pair
    from mgsgraph.simulation.pair import simulate_pair

    pair = simulate_pair(seed=seed)
    with fresh_folder(out) as folder:
        inputs = folder / "inputs"
        inputs.mkdir()
        case = read_case(write_pair(pair, inputs))
        with iteration_bar(False, case.settings.max_iterations) as bar:
            solution = run(case, bar)
        write_into(solution, folder, figures=not no_figures)
    click.echo(summary_table(solution))
    for sentence in [*statements(solution), *against_truth(solution, pair)]:
        click.echo(f"- {sentence}")
    click.echo(f"Inputs and results are in {out}")

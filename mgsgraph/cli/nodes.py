"""`mgsgraph nodes`: how close a case's orientation images should stand, and what vibrates."""

from pathlib import Path

import click

_PATH = click.Path(path_type=Path)


@click.command(short_help="Choose the spacing of orientation images from the data, and look for vibrations.")
@click.argument("case", type=_PATH)
@click.option(
    "--spacings", default="4,8,16,32", show_default=True, metavar="S,S,...", help="Candidates, seconds between nodes."
)
@click.option(
    "--hold-out", type=float, default=0.2, show_default=True,
    help="Share of the points with three rays or more of which one ray is held out.",
)  # fmt: skip
@click.option("--seed", type=click.IntRange(0), default=0, show_default=True, help="Of the draw of these rays.")
@click.option("--densify", is_flag=True, help="Give nodes to the widest spacing where residuals ask for them.")
@click.option("--out", type=_PATH, help="Folder for nodes.json, tables and figures; made anew.")
@click.option(
    "--ties", type=click.Path(path_type=Path), metavar="NETWORK", help="Tie points in place of those that CASE names."
)
@click.option("--no-figures", is_flag=True, help="Write tables only.")
def nodes(
    case: Path, spacings: str, hold_out: float, seed: int, densify: bool, out: Path | None,
    ties: Path | None, no_figures: bool,
) -> None:
    """Adjust CASE (a TOML file with [[strips]]) with orientation images at several spacings, without some of its rays,
    and choose the coarsest that predicts these no worse than the best one; with that, look for vibrations.

    Exit status: 0, whatever is found; 2 bad input.
    """
    from mgsgraph.case.reading import read_case
    from mgsgraph.cli.progress import counting_bar
    from mgsgraph.output.folders import NODES, require_replaceable
    from mgsgraph.reports.analysis import require_used
    from mgsgraph.reports.spacing import node_statements, seconds_of, spacing_table, write_nodes
    from mgsgraph.spacing.study import study_nodes

    require_used("--no-figures", no_figures, out is not None, "--out FOLDER")
    wanted = seconds_of(spacings)
    if out is not None:
        require_replaceable(out, NODES)
    read = read_case(case, ties=ties)
    with counting_bar("adjusting", "step") as bar:
        study = study_nodes(read.network, read.settings, read.name, wanted, hold_out, seed, densify, progress=bar)
    if out is not None:
        write_nodes(study, out, figures=not no_figures)
    click.echo(spacing_table(study.choice))
    for sentence in node_statements(study):
        click.echo(f"- {sentence}")
    if out is not None:
        click.echo(f"The study is in {out}")

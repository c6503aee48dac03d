"""Verbs for a case: check it, adjust it, adjust many, choose the spacing of its orientation images; register it, by
projection or by relief.
"""

import time
from contextlib import AbstractContextManager, nullcontext
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import click

from mgsgraph.cli.options import (
    DETAILS,
    NO_FIGURES,
    PAIR,
    PATH,
    TIES,
    WORKERS,
    image_pair,
    overruling,
    print_sentences,
    print_solution,
)

if TYPE_CHECKING:
    from mgsgraph.adjustment.cluster.connection import Connection
    from mgsgraph.adjustment.settings import SolverSettings
    from mgsgraph.adjustment.solution import Solution
    from mgsgraph.case.reading import Case
    from mgsgraph.registration.minima import ReliefRegistration, ReliefSettings
    from mgsgraph.results.results import Overrides


@click.command()
@click.argument("case", type=PATH)
@click.option("--no-laser", is_flag=True, help="Leave the laser rows out.")
@TIES
@DETAILS
def check(case: Path, no_laser: bool, ties: Path | None, details: bool) -> None:
    """Read and validate CASE and everything that it names; print where it is weak and what is there. Solves nothing.

    Of a CASE without measures, the images, which of them overlap, and whether `match` can find tie points.
    """
    from mgsgraph.case.reading import read_case
    from mgsgraph.cli.progress import word_of_compiling
    from mgsgraph.errors import Unmeasured
    from mgsgraph.results.inventory import images_inventory, inventory

    with word_of_compiling():
        said = images_inventory(case) if ties is None else None
        try:
            said = said or inventory(read_case(case, not no_laser, ties), details)
        except Unmeasured as error:
            said = images_inventory(case, error) if ties is None else None
            if said is None:
                raise
    click.echo(said)


@click.command()
@click.argument("case", type=PATH)
@click.option("--out", type=PATH, required=True, help="Folder for the results; made anew.")
@click.option("--cluster", metavar="PLACE", help="local, local:N (worker processes), tcp://host:port, tls://host:port.")
@TIES
@click.option("--two-steps", is_flag=True, help="First without the terrain model, then with it; figures of both.")
@overruling
@DETAILS
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
    details: bool,
    verbose: bool,
) -> None:
    """Adjust CASE (a TOML file, see scripts/cases) and write the results to a folder.

    Options overrule the case file. With --cluster the points lie with the workers, in partitions. With --two-steps
    blunders are sought without the terrain model, and then the block is fitted to it: see docs/two_steps.md.

    The first line says whether the result is valid, SUSPECT (a test found what the stated sigmas don't explain) or
    INVALID. Exit status: 0 valid or suspect; 1 invalid: not converged, most of a kind of observations left out, an
    absurd sigma0, orientations beyond 100 prior sigmas (results are written); 2 bad input.
    """
    from mgsgraph.adjustment.cluster.connection import open_cluster
    from mgsgraph.adjustment.cluster.workers import parse_cluster
    from mgsgraph.analysis.verdict import is_valid
    from mgsgraph.analysis.vibrations import adjusted
    from mgsgraph.case.reading import read_case
    from mgsgraph.cli.progress import iteration_bar
    from mgsgraph.files.output.folders import require_replaceable
    from mgsgraph.results.results import write_results

    if overrides.tables is not None and two_steps:
        raise click.UsageError("--tables doesn't go with --two-steps")
    require_replaceable(out)
    if cluster is not None:
        parse_cluster(cluster)
    begin = time.perf_counter()
    read = read_case(case, overrides.laser, ties)
    reading = {"reading": time.perf_counter() - begin}
    print_sentences(read.notes)
    settings = overrides.over(read.settings)
    estimating = read.vibrating or any(one.asks_for_strengths for one in read.network.passes)
    if estimating and (two_steps or cluster is not None):
        raise click.UsageError("estimated strengths and vibrations go with neither --two-steps nor --cluster")
    connection: AbstractContextManager[Connection | None]
    connection = open_cluster(cluster) if cluster is not None else nullcontext()
    if two_steps:
        ctx.exit(0 if _in_two_steps(read, settings, out, connection, overrides, verbose) else 1)
    with connection as workers, iteration_bar(verbose, settings.max_iterations) as bar:
        solution, said = adjusted(read.network, settings, read.name, bar, read.vibrating, workers)
    solution = replace(solution, seconds=reading | dict(solution.seconds))
    write_results(solution, out, overrides.figures, case, read.networks, overrides.tables)
    print_solution(solution, details)
    for sentence in said:
        click.echo(sentence)
    click.echo(f"Results are in {out}")
    ctx.exit(0 if is_valid(solution) else 1)


def _in_two_steps(
    read: "Case",
    settings: "SolverSettings",
    out: Path,
    connection: AbstractContextManager["Connection | None"],
    overrides: "Overrides",
    verbose: bool,
) -> bool:
    """Whether both steps converged."""
    from mgsgraph.adjustment.two_steps import adjust_in_two_steps, require_terrain
    from mgsgraph.analysis.two_step_statistics import two_step_statistics
    from mgsgraph.analysis.verdict import is_valid
    from mgsgraph.cli.progress import iteration_bar, stage_bar
    from mgsgraph.results.results import write_results
    from mgsgraph.results.two_steps import two_steps_section, write_two_steps

    require_terrain(read.network, str(read.path))
    with connection as workers, iteration_bar(verbose, settings.max_iterations) as bar:
        steps = adjust_in_two_steps(read.network, settings, read.name, bar, bar.begin, workers)
    # what took longest is safe, whatever becomes of the rest
    write_results(steps.fitted, out, figures=False, networks=read.networks)
    with stage_bar(2) as stages:
        with stages.stage("figures of merit"):
            statistics = two_step_statistics(steps)
        with stages.stage("tables and figures"):
            write_two_steps(statistics, out, figures=overrides.figures, networks=read.networks)
    click.echo(two_steps_section(statistics).text(None))
    click.echo(f"Results are in {out}")
    return steps.converged and is_valid(steps.fitted)


@click.command()
@click.argument("cases", type=PATH, nargs=-1, required=True, metavar="CASE|FOLDER...")
@click.option("--out", type=PATH, required=True, help="Folder for all results and the record.")
@click.option("--cluster", metavar="PLACE", help="local, local:N (worker processes), tcp://host:port, tls://host:port.")
@click.option("--retry", is_flag=True, help="Do those again that have failed or not converged, though nothing changed.")
@overruling
@click.option("-v", "--verbose", is_flag=True, help="One line per case.")
@click.pass_context
def campaign(
    ctx: click.Context,
    cases: tuple[Path, ...],
    out: Path,
    cluster: str | None,
    retry: bool,
    overrides: "Overrides",
    verbose: bool,
) -> None:
    """Adjust each CASE (a TOML file; of a FOLDER, every *.toml at any depth) into a folder of its own in OUT.

    Options overrule all case files. OUT/campaign.jsonl records each case that is over. The same command again does
    what is new, what has changed and what was interrupted, and leaves the rest. Exit status: 0 all done, 1 some failed
    or did not converge, 2 bad input.
    """
    from tqdm import tqdm

    from mgsgraph.cli.progress import counting_bar
    from mgsgraph.project.campaign import CampaignEntry, line, run_campaign, summary

    state = "nothing was begun"
    try:
        with counting_bar("adjusting", "case") as bar:

            def show(over: int, due: int, entry: CampaignEntry | None) -> None:
                nonlocal state
                state = f"{over} of {due} cases are over and recorded"
                bar(over, due)
                if entry is not None and verbose:
                    tqdm.write(line(entry))

            done = run_campaign(cases, out, overrides, cluster, retry, show)
    except KeyboardInterrupt:
        click.echo(f"mgsgraph: interrupted; {state}; the same command goes on", err=True)
        ctx.exit(130)
    click.echo(summary(done))
    click.echo(f"Results are in {out}")
    ctx.exit(0 if done.count("done") == len(done.entries) else 1)


@click.command()
@click.argument("case", type=PATH)
@click.option(
    "--spacings", default="4,8,16,32", show_default=True, metavar="S,S,...", help="Candidates, seconds between nodes."
)
@click.option(
    "--hold-out", type=float, default=0.2, show_default=True,
    help="Share of the points with three rays or more of which one ray is held out.",
)  # fmt: skip
@click.option("--seed", type=click.IntRange(0), default=0, show_default=True, help="Of the draw of these rays.")
@click.option("--out", type=PATH, help="Folder for nodes.json and its table; made anew.")
@TIES
def nodes(
    case: Path, spacings: str, hold_out: float, seed: int, out: Path | None,
    ties: Path | None,
) -> None:
    """Adjust CASE (a TOML file with [[passes]]) with orientation images at several spacings, without some of its rays,
    and choose the coarsest that predicts these no worse than the best one. (Vibrations: `mgsgraph analyze`.)

    Exit status: 0, whatever is found; 2 bad input.
    """
    from mgsgraph.analysis.spacing import choose_spacing
    from mgsgraph.case.reading import read_case
    from mgsgraph.cli.progress import counting_bar
    from mgsgraph.files.output.folders import NODES, require_replaceable
    from mgsgraph.results.spacing import nodes_section, seconds_of

    wanted = seconds_of(spacings)
    if out is not None:
        require_replaceable(out, NODES)
    read = read_case(case, ties=ties)
    with counting_bar("adjusting", "step") as bar:
        choice = choose_spacing(read.network, read.settings, wanted, hold_out, seed, progress=bar)
    section = nodes_section(choice, read.name)
    if out is not None:
        section.write_folder(out, NODES)
    click.echo(section.text())
    if out is not None:
        click.echo(f"The study is in {out}")


@click.command()
@click.argument("case", type=PATH)
@click.option("--out", type=PATH, required=True, help="Folder for the results; made anew.")
@click.option(
    "--solution", type=PATH, help="Results of `mgsgraph adjust` CASE: register after it as well."
)
@TIES
@NO_FIGURES
def register(case: Path, out: Path, solution: Path | None, ties: Path | None, no_figures: bool) -> None:
    """Project the footprints of CASE's laser profiles into its images, and compare the images at them.

    Writes registration.json, registration.csv (each shot in each image), discrepancy.csv (by how much two images
    contradict each other about each footprint) and figures with numbered footprints.
    """
    from mgsgraph.case.reading import read_case
    from mgsgraph.files.output.folders import REGISTRATION, require_replaceable
    from mgsgraph.registration.case import register_case
    from mgsgraph.results.archive import read_solution
    from mgsgraph.results.registration import registration_section, write_registration

    require_replaceable(out, REGISTRATION)
    adjusted = None if solution is None else read_solution(solution)
    registration = register_case(read_case(case, ties=ties), adjusted)
    write_registration(registration, out, figures=not no_figures)
    click.echo(registration_section(registration).text())
    click.echo(f"Results are in {out}")


@click.command()
@click.argument("case", type=PATH, metavar="CASE|RESULT|PROJECT")
@click.option("--out", type=PATH, help="Folder for the results; made anew. A project has its own.")
@click.option("--solution", type=PATH, help="Results of `mgsgraph adjust` CASE, to begin with.")
@click.option(
    "--footprint", type=float, metavar="M",
    help="Diameter of a laser spot on the ground; that of each profile's altimeter when absent.",
)  # fmt: skip
@click.option(
    "--reach", type=float, default=1500.0, show_default=True, metavar="M", help="Up to which shifts are searched."
)
@click.option("--spacing", type=float, metavar="M", help="Between dense matches; a quarter of the footprint at most.")
@click.option(
    "--no-cells", is_flag=True,
    help="Leave tie points on the surface of [terrain], in place of its posts on what the images show.",
)
@click.option("--no-crossovers", is_flag=True, help="No rows where two laser profiles cross.")
@PAIR
@WORKERS
@TIES
@NO_FIGURES
@click.pass_context
def coregister(
    ctx: click.Context, case: Path, out: Path | None, solution: Path | None, footprint: float | None, reach: float,
    spacing: float | None, no_cells: bool, no_crossovers: bool, pair: str | None, workers: int | None,
    ties: Path | None, no_figures: bool,
) -> None:
    """Move laser profiles and terrain models of CASE and its images onto each other by relief, and adjust all together.

    RESULT, what `mgsgraph adjust` wrote, stands for its case and for --solution. In PROJECT everything is adjusted with
    the new rows, which it has from then on.

    The images are matched densely; each profile and terrain model with an unknown shift is searched for on the surface
    that they show; the case is adjusted again with one row more per shot and post, its height above that surface. OUT
    holds what `mgsgraph adjust` writes, and coregistration.json, profiles.csv, shots.csv
    and figures: see docs/coregister.md.

    Exit status: 0 converged, 1 not converged (results are written), 2 bad input.
    """
    from mgsgraph.case.reading import read_case
    from mgsgraph.files.output.folders import require_replaceable
    from mgsgraph.project.connection import FILE
    from mgsgraph.registration.minima import ReliefSettings
    from mgsgraph.results.archive import read_solution
    from mgsgraph.results.results import case_of

    chosen = footprint, reach, spacing, image_pair(pair)
    settings = ReliefSettings(*chosen, "spline" if no_cells else "cells", not no_crossovers)
    if (case / FILE).is_file():
        if out is not None or solution is not None or ties is not None:
            raise click.UsageError("--out, --solution and --ties are for a case: a project has its own")
        ctx.exit(0 if _coregistered_project(case, settings, workers, not no_figures) else 1)
    if out is None:
        raise click.UsageError("Missing option '--out'.")
    if case.is_dir():
        if solution is not None:
            raise click.UsageError(f"{case} is a folder of results itself: give it, or CASE --solution")
        case, solution = case_of(case), case
    require_replaceable(out)
    if solution is not None and out.resolve() in (solution.resolve(), solution.resolve().parent):
        raise click.UsageError("--out would replace --solution: give another folder")
    before = None if solution is None else read_solution(solution)
    read = read_case(case, ties=ties)
    print_sentences(read.notes)
    ctx.exit(0 if _coregistered(read, out, not no_figures, settings, before, workers) else 1)


def _coregistered(
    read: "Case", out: Path, figures: bool, settings: "ReliefSettings", before: "Solution | None", workers: int | None
) -> bool:
    """Register a case by relief, write and print what came out; whether it converged."""
    from mgsgraph.cli.progress import counting_bars
    from mgsgraph.registration.relief import register_by_relief
    from mgsgraph.results.relief import write_coregistration

    with counting_bars() as show:
        registration = register_by_relief(read, settings, before=before, workers=workers, progress=show)
        show("tables and figures" if figures else "tables", 0, 1)
        write_coregistration(registration, out, figures, read.path, read.networks)
    return _print_registration(registration, out)


def _coregistered_project(folder: Path, settings: "ReliefSettings", workers: int | None, figures: bool) -> bool:
    """The same for a project, which has the rows from then on."""
    from mgsgraph.cli.progress import counting_bars
    from mgsgraph.project.project import open_project
    from mgsgraph.project.relief import coregister as register

    with counting_bars() as show, open_project(folder, write=True) as opened:
        found = register(opened, settings, workers, figures, show)
    return _print_registration(found.registration, found.folder)


def _print_registration(registration: "ReliefRegistration", out: Path) -> bool:
    """Print what a registration by relief has found; whether it converged."""
    from mgsgraph.analysis.verdict import is_valid
    from mgsgraph.results.relief import coregistration_section

    click.echo(coregistration_section(registration).text())
    click.echo(f"Results are in {out}")
    return is_valid(registration.solution)

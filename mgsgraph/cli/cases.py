"""Verbs for a case: check it, adjust it, adjust many, align laser and images by relief."""

from contextlib import AbstractContextManager, nullcontext
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import click

from mgsgraph.cli.options import (
    CASE,
    CLUSTER,
    DETAILS,
    INSECURE,
    NO_FIGURES,
    PATH,
    TIES,
    TWO_IMAGES,
    WORKERS,
    details,
    elapsed,
    folder_for,
    out_option,
    overruling,
    print_brief,
    print_ended,
    print_sentences,
    print_solution,
    require_two,
)
from mgsgraph.errors import command_line

if TYPE_CHECKING:
    from mgsgraph.adjustment.cluster.connection import Connection
    from mgsgraph.project.reading import CaseResults
    from mgsgraph.registration.minima import ReliefRegistration, ReliefSettings
    from mgsgraph.results.results import Overrides


@click.command()
@click.argument("case", type=PATH)
@click.option("--no-laser", is_flag=True, help="Leave the laser rows out.")
@TIES
@DETAILS
def check(case: Path, no_laser: bool, ties: Path | None) -> None:
    """Read and validate CASE and everything that it names; print warnings and what is in it. Solves nothing.

    Of a CASE without measures, the images, which of them overlap, and whether `match` can find tie points.
    """
    from mgsgraph.case.reading import read_case
    from mgsgraph.cli.progress import stage, word_of_compiling
    from mgsgraph.errors import Unmeasured
    from mgsgraph.results.inventory import images_inventory, inventory

    with stage("reading"), word_of_compiling():
        text = images_inventory(case) if ties is None else None
        try:
            text = text or inventory(read_case(case, not no_laser, ties), details())
        except Unmeasured as error:
            text = images_inventory(case, error) if ties is None else None
            if text is None:
                raise
    print_brief(text, more=0)


@click.command()
@click.argument("case", type=PATH)
@click.option("--out", type=PATH, required=True, help="Folder for the cases; an earlier one is brought up to date.")
@DETAILS
def split(case: Path, out: Path) -> None:
    """Divide CASE into groups of connected images, and write a case for each: OUT/IMAGE/case.toml, called after the
    first image of the group.

    Images are connected by tie points or a laser profile in common; in a CASE without tie points by footprints that
    overlap. Groups have the networks, profiles and other tables of CASE as far as these are theirs.
    """
    from mgsgraph.cli.progress import stage
    from mgsgraph.project.regions import split_case
    from mgsgraph.text import many, some

    with stage("dividing"):
        division = split_case(case, out)
    sizes = sorted(len(images) for images in division.groups.values()) or [0]
    click.echo(f"{many(sum(sizes), 'image')} in {many(len(division.groups), 'group')} of {sizes[0]} to {sizes[-1]}")
    for what, names in (("Alone, in no group", division.alone), ("Now part of other groups", division.merged)):
        print_sentences(f"{what}: {some(names)}" if names else "")
    match = command_line("match", out / "NAME" / "case.toml", "--out", out / "NAME" / "matches")
    steps = [*([] if division.measured else [match]), command_line("batch", out, "--projects")]
    click.echo(f"The cases are in {out}; next: {'; then '.join(steps)}")


@click.command()
@click.argument("case", type=PATH)
@out_option("adjust")
@CLUSTER
@INSECURE
@TIES
@overruling
@DETAILS
@click.pass_context
def adjust(
    ctx: click.Context, case: Path, out: Path | None, cluster: str | None, insecure: bool, ties: Path | None,
    overrides: "Overrides",
) -> None:  # fmt: skip
    """Adjust CASE (a TOML file, see scripts/cases) and write the results to a folder.

    Options overrule the case file. With --cluster the points lie with the workers, in partitions.

    The first line says whether the result is valid, SUSPECT (a test found what the stated sigmas don't explain) or
    INVALID. Exit status: 0 valid or suspect; 1 invalid: not converged, most of a kind of observations left out, an
    absurd sigma0, orientations beyond 100 prior sigmas (results are written); 2 bad input.
    """
    from mgsgraph.adjustment.adjust import compile_sweep_beside
    from mgsgraph.adjustment.cluster.connection import open_cluster
    from mgsgraph.adjustment.cluster.workers import parse_cluster
    from mgsgraph.analysis.verdict import is_valid
    from mgsgraph.analysis.vibrations import adjusted
    from mgsgraph.case.reading import read_case
    from mgsgraph.cli.progress import iteration_bar, stage
    from mgsgraph.files.output.folders import require_replaceable
    from mgsgraph.results.results import write_results

    require_replaceable(out := folder_for(out, case, "adjust"))
    if cluster is not None:
        parse_cluster(cluster, insecure)
    compile_sweep_beside()
    begin = elapsed()
    with stage("reading"):
        read = read_case(case, overrides.laser, ties)
    reading = {"reading": elapsed() - begin}
    print_sentences(*read.notes)
    settings = overrides.over(read.settings)
    estimating = read.vibrating or any(pass_.asks_for_strengths for pass_ in read.network.passes)
    if estimating and cluster is not None:
        raise click.UsageError("estimated strengths and vibrations don't go with --cluster")
    connection: AbstractContextManager[Connection | None]
    connection = open_cluster(cluster, insecure=insecure) if cluster is not None else nullcontext()
    with connection as workers, iteration_bar() as bar:
        solution, sentences = adjusted(read.network, settings, read.name, bar, read.vibrating, workers)
    solution = replace(solution, seconds=reading | dict(solution.seconds))
    with stage("tables and figures"):
        write_results(solution, out, overrides.figures, case, read.networks, overrides.tables)
    print_solution(solution, 1 + len(read.notes) + len(sentences))
    print_sentences(*sentences)
    print_ended(f"Results are in {out}")
    ctx.exit(0 if is_valid(solution) else 1)


@click.command()
@click.argument("cases", type=PATH, nargs=-1, required=True, metavar="CASE|FOLDER...")
@click.option(
    "--out", type=PATH, default=Path("mgsgraph-batch"), show_default=True, help="Folder for all results and the record."
)
@CLUSTER
@INSECURE
@click.option("--projects", is_flag=True, help="Keep each case in OUT as a project, which grows with its case.")
@click.option("--retry", is_flag=True, help="Do those again that have failed or not converged, though nothing changed.")
@overruling
@DETAILS
@click.pass_context
def batch(
    ctx: click.Context, cases: tuple[Path, ...], out: Path, cluster: str | None, insecure: bool, projects: bool,
    retry: bool, overrides: "Overrides",
) -> None:  # fmt: skip
    """Adjust each CASE (a TOML file; of a FOLDER, every *.toml at any depth) into a folder of its own in OUT.

    Options overrule all case files. OUT/campaign.jsonl records each case that is over. The same command again does
    what is new, what has changed and what was interrupted, and leaves the rest. Exit status: 0 all done, 1 some failed
    or did not converge, 2 bad input.
    """
    from tqdm import tqdm

    from mgsgraph.cli.progress import counting_bar
    from mgsgraph.project.campaign import CampaignEntry, line, run_campaign, summary

    if projects and (overrides.loss, overrides.reject, overrides.starts, overrides.laser) != (None, None, None, True):
        raise click.UsageError("--projects: a project has the settings of its case, without options over them")
    overrides, state = replace(overrides, projects=projects), "nothing was begun"
    try:
        with counting_bar("adjusting", "case") as bar:

            def show(ended: int, due: int, entry: CampaignEntry | None) -> None:
                nonlocal state
                state = f"{ended} of {due} cases are over and recorded"
                bar(ended, due)
                if entry is not None and details():
                    tqdm.write(line(entry))

            done = run_campaign(cases, out, overrides, cluster, retry, show, insecure)
    except KeyboardInterrupt:
        click.echo(f"mgsgraph: interrupted; {state}; the same command goes on", err=True)
        ctx.exit(130)
    print_brief(summary(done))
    print_ended(f"Results are in {out}")
    ctx.exit(0 if done.count("done") == len(done.entries) else 1)


@click.command()
@click.argument("case", type=PATH, metavar="CASE|RESULT|PROJECT")
@CASE
@out_option("align", " A project has its own.")
@click.option(
    "--footprint", type=float, metavar="M",
    help="Diameter of a laser spot on the ground; that of each profile's altimeter when absent.",
)  # fmt: skip
@click.option(
    "--search", type=float, default=1500.0, show_default=True, metavar="M", help="Up to which shifts are searched."
)
@click.option("--spacing", type=float, metavar="M", help="Between dense matches; a quarter of the footprint at most.")
@click.option(
    "--no-cells", is_flag=True,
    help="Leave tie points on the surface of [terrain], in place of its posts on what the images show.",
)
@click.option("--no-crossovers", is_flag=True, help="No rows where two laser profiles cross.")
@TWO_IMAGES
@WORKERS
@TIES
@NO_FIGURES
@DETAILS
@click.pass_context
def align(
    ctx: click.Context, case: Path, of_case: Path | None, out: Path | None, footprint: float | None, search: float,
    spacing: float | None, no_cells: bool, no_crossovers: bool, images: tuple[str, ...], workers: int | None,
    ties: Path | None, no_figures: bool,
) -> None:  # fmt: skip
    """Align laser profiles and terrain models of CASE and its images by relief, and adjust all together.

    RESULT, what `mgsgraph adjust` wrote, is begun with, in place of the nominal orientation. In PROJECT everything is
    adjusted with the new rows, which it has from then on.

    The images are matched densely; each profile and terrain model with an unknown shift is searched for on the surface
    that they show; the case is adjusted again with one row more per shot and post, its height above that surface. OUT
    holds what `mgsgraph adjust` writes, and coregistration.json, profiles.csv, shots.csv
    and figures: see docs/align.md.

    Exit status: 0 valid or suspect, 1 invalid (results are written), 2 bad input.
    """
    from mgsgraph.analysis.verdict import is_valid
    from mgsgraph.cli.progress import counting_bars
    from mgsgraph.files.output.folders import PROJECT
    from mgsgraph.project.project import open_project
    from mgsgraph.project.reading import case_with_results
    from mgsgraph.project.relief import align as align_project
    from mgsgraph.registration.minima import ReliefSettings
    from mgsgraph.results.relief import coregistration_section

    terrain: Literal["cells", "spline"] = "spline" if no_cells else "cells"
    settings = ReliefSettings(footprint, search, spacing, require_two(images), terrain, not no_crossovers)
    if (case / PROJECT).is_file():
        if out is not None or of_case is not None or ties is not None:
            raise click.UsageError("--out, --case and --ties are for a case: a project has its own")
        with counting_bars() as show, open_project(case, write=True) as opened:
            registration, out = align_project(opened, settings, workers, not no_figures, show)
    else:
        out = folder_for(out, case, "align")
        registration = _align_case(case_with_results(case, of_case), out, not no_figures, settings, ties, workers)
    print_brief(coregistration_section(registration).text(None))
    print_ended(f"Results are in {out}")
    ctx.exit(0 if is_valid(registration.solution) else 1)


def _align_case(
    source: "CaseResults", out: Path, figures: bool, settings: "ReliefSettings", ties: Path | None, workers: int | None
) -> "ReliefRegistration":
    """Register a case by relief and write the results."""
    from mgsgraph.case.reading import read_case
    from mgsgraph.cli.progress import counting_bars
    from mgsgraph.files.output.folders import require_replaceable
    from mgsgraph.registration.relief import register_by_relief
    from mgsgraph.results.archive import read_solution
    from mgsgraph.results.relief import write_coregistration

    require_replaceable(out)
    if source.folder is not None and out.resolve() in (source.folder.resolve(), source.folder.resolve().parent):
        raise click.UsageError(f"--out would replace {source.folder}: give another folder")
    earlier = None if source.folder is None else read_solution(source.folder)
    read = read_case(source.case, ties=ties)
    print_sentences(*read.notes)
    with counting_bars() as show:
        registration = register_by_relief(read, settings, before=earlier, workers=workers, progress=show)
        show("tables and figures" if figures else "tables", 0, 1)
        write_coregistration(registration, out, figures, read.path, read.networks)
    return registration

"""Verbs for a project, a folder to which images come one after the other."""

from collections.abc import Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING

import click

from mgsgraph.cli.options import (
    DETAILS,
    DEVICE,
    NO_FIGURES,
    PATH,
    TABLES,
    print_sentences,
    print_solution,
)

if TYPE_CHECKING:
    from mgsgraph.adjustment.incremental.impact import Impact
    from mgsgraph.adjustment.settings import Device
    from mgsgraph.project.addition import Addition
    from mgsgraph.project.edits import Edited
    from mgsgraph.results.tables import TableForm

_IMPACT = click.option(
    "--impact", "table", type=PATH, metavar="FILE", help="Write every point that moved to a CSV file."
)


@click.command()
@click.argument("project", type=PATH)
@click.option("--case", type=PATH, help="A case file: its images, measures, terrain and settings go in.")
@click.option("--settings", type=PATH, help="A TOML file with [orientation], [spice], [measures], [solver] alone.")
@click.option("--name", default="", help="What to call it; the case's or the folder's name when absent.")
def init(project: Path, case: Path | None, settings: Path | None, name: str) -> None:
    """Make PROJECT, a folder to which images are added one after the other.

    Its settings hold for all that comes: a-priori sigmas of the orientation, SPICE kernels, the solver's choices.

    A case without tie points, as `mgsgraph fetch` writes it, gives its images; `mgsgraph match PROJECT` finds the ties.
    """
    from mgsgraph.cli.progress import stage_bar
    from mgsgraph.errors import InputError
    from mgsgraph.project.changes import create_project

    if case is not None and settings is not None:
        raise InputError("--settings", "a case is given, too, which has settings", "one of the two")
    with stage_bar(2) as stages:
        begun = create_project(project, name, case, settings, stages.stage)
    click.echo(f"{project}: a new project, {begun.words}")
    print_sentences(begun.notes)
    if begun.waits:
        click.echo(f"Its images wait for tie points; next: mgsgraph match {project}")
    elif case is not None:
        click.echo(f"Nothing is adjusted yet; next: mgsgraph solve {project}")
    else:
        click.echo(f"Next: mgsgraph add {project} IMAGE...")


@click.command()
@click.argument("project", type=PATH)
@click.argument("images", nargs=-1, metavar="[NAME=]IMAGE...")
@click.option("--ties", type=PATH, multiple=True, help="Control network with their measures; may be repeated.")
@click.option("--shots", type=PATH, multiple=True, help="Laser shots: ISIS lidar (.json) or PEDR; may be repeated.")
@click.option("--pass", "of_pass", default="", metavar="NAME", help="Pass of PROJECT that they are images of.")
@click.option("--share", "shares", multiple=True, metavar="NAME", help="Shared unknown that they share; repeatable.")
@_IMPACT
@click.option("--dry-run", is_flag=True, help="Read everything and say what would be added; change nothing.")
@click.pass_context
def add(
    ctx: click.Context,
    project: Path,
    images: tuple[str, ...],
    ties: tuple[Path, ...],
    shots: tuple[Path, ...],
    of_pass: str,
    shares: tuple[str, ...],
    table: Path | None,
    dry_run: bool,
) -> None:
    """Add each IMAGE to PROJECT, with the measures of --ties and --shots, and adjust what it touches.

    IMAGE is support data (.json, .isd), a MOC label (.img, .lbl, .cub; with the project's kernels) or a case file
    (.toml), which brings everything that it names, passes among it. NAME is what control networks call it. The
    trajectory of a pass that is there goes on over the lines of its new images.

    What is printed is the impact: which images and points moved, in metres and in their sigmas.

    Exit status: 0 added, 1 added and not converged, 2 bad input (nothing has changed).
    """
    from mgsgraph.cli.progress import stage_bar
    from mgsgraph.errors import InputError
    from mgsgraph.project.addition import parse_image, read_addition
    from mgsgraph.project.project import open_project

    if not (images or ties or shots):
        raise InputError("add", "no image, no --ties and no --shots", "at least one of them")
    if table is not None:
        from mgsgraph.results.impact import require_writable

        require_writable(table, project)
    wanted = [parse_image(text) for text in images]
    with stage_bar(2) as stages, open_project(project, write=not dry_run) as opened:
        with stages.stage("reading"):
            addition = read_addition(opened, wanted, ties, shots, of_pass, shares)
        if not dry_run:
            from mgsgraph.project.changes import add as put

            with stages.stage("adjusting"):
                impact = put(opened, addition)
    if dry_run:
        click.echo(f"{project}: would add {_words(addition)}; nothing was changed")
        print_sentences(addition.notes)
        _warn(addition)
        return
    click.echo(f"{project}: added {_words(addition)}")
    print_sentences(addition.notes)
    if impact is None:
        _warn(addition)
    _print_impact(ctx, project, impact, table)


def _words(addition: "Addition") -> str:
    from mgsgraph.text import many

    network = addition.network
    rays, ranges = (0, 0) if network is None else (network.rays.point.size, network.ranges.point.size)
    named = ", ".join(addition.names)
    images = many(len(addition.names), "image")
    return f"{images}{f' ({named})' if named else ''}, {rays} image measures, {ranges} laser ranges"


def _warn(addition: "Addition") -> None:
    if addition.unconnected:
        names = ", ".join(addition.unconnected)
        click.echo(f"- Unconnected: {names}. No point is shared with another image; tie points would join it.")


@click.command()
@click.argument("project", type=PATH)
@click.argument("images", nargs=-1, required=True, metavar="IMAGE...")
@_IMPACT
@click.pass_context
def remove(ctx: click.Context, project: Path, images: tuple[str, ...], table: Path | None) -> None:
    """Take each IMAGE (by its name) out of PROJECT with its measures, and adjust what it touched.

    Exit status: 0 removed, 1 removed and not converged, 2 bad input (nothing has changed).
    """
    from mgsgraph.cli.progress import stage_bar
    from mgsgraph.project.changes import remove_images
    from mgsgraph.project.project import open_project
    from mgsgraph.results.impact import require_writable

    if table is not None:
        require_writable(table, project)
    with stage_bar(1) as stages, stages.stage("adjusting"), open_project(project, write=True) as opened:
        impact = remove_images(opened, images)
    click.echo(f"{project}: removed {', '.join(images)}")
    _print_impact(ctx, project, impact, table)


@click.command()
@click.argument("project", type=PATH)
@click.argument("point")
@click.option("--new", is_flag=True, help="POINT is a new tie point, of one or more --pixel.")
@click.option(
    "--pixel", "pixels", multiple=True, type=(str, float, float), metavar="IMAGE LINE SAMPLE",
    help="Where an image shows it: a measure more, or another place of the one there. The first pixel's centre is at "
    "0.5 (ISIS: 1). May be repeated.",
)  # fmt: skip
@click.option("--sigma-px", type=float, help="Of line and sample; when absent the project's, or that which is there.")
@click.option("--reject", "rejected", multiple=True, metavar="IMAGE", help="Set its measure in IMAGE aside.")
@click.option("--accept", "accepted", multiple=True, metavar="IMAGE", help="Take a rejected measure in again.")
@click.option("--remove", "gone", is_flag=True, help="Take POINT out.")
@_IMPACT
@click.pass_context
def measure(
    ctx: click.Context, project: Path, point: str, new: bool, pixels: tuple[tuple[str, float, float], ...],
    sigma_px: float | None, rejected: tuple[str, ...], accepted: tuple[str, ...], gone: bool, table: Path | None,
) -> None:  # fmt: skip
    """Measure POINT in images of PROJECT, or reject what is measured, and adjust what it touches.

    All of it is done or nothing; each step is a change of the history, which `mgsgraph undo` takes back. A rejected
    measure stays out of `mgsgraph solve`, too, until it is accepted again.

    Exit status: 0 done, 1 done and not converged, 2 bad input (nothing has changed).
    """
    from mgsgraph.errors import InputError
    from mgsgraph.project import edits
    from mgsgraph.project.project import Measure, open_project
    from mgsgraph.results.impact import require_writable

    if not (pixels or rejected or accepted or gone):
        raise click.UsageError("one of --pixel, --reject, --accept and --remove")
    if (new and (not pixels or rejected or accepted or gone)) or (gone and (pixels or rejected or accepted)):
        raise click.UsageError("--new goes with --pixel alone, --remove with nothing else")
    if sigma_px is not None and not pixels:
        raise click.UsageError("--sigma-px is of --pixel")
    if sigma_px is not None and not 0.0 < sigma_px < float("inf"):
        raise InputError("--sigma-px", f"{sigma_px}", "a positive number of pixels")
    if table is not None:
        require_writable(table, project)
    sigma = sigma_px or 0.0
    wanted = [Measure(image, line, sample, sigma, sigma) for image, line, sample in pixels]
    with open_project(project, write=True) as opened:
        if new and edits.point_state(opened, point) is not None:
            raise InputError(f"{project}, point {point}", "it is there already", "a new name", "leave --new out")
        done = [edits.measure(opened, point, wanted)] if new else []
        done += [] if new else [edits.put_measure(opened, point, one) for one in wanted]
        done += [edits.reject(opened, point, image) for image in rejected]
        done += [edits.accept(opened, point, image) for image in accepted]
        done += [edits.remove_point(opened, point)] if gone else []
    _print_edits(ctx, project, done, table)


@click.command()
@click.argument("project", type=PATH)
@click.argument("change", type=int, required=False)
@_IMPACT
@click.pass_context
def undo(ctx: click.Context, project: Path, change: int | None, table: Path | None) -> None:
    """Take the last edit of a point of PROJECT back, or that with the number CHANGE, and adjust what it touches.

    Edits are the changes that `mgsgraph measure` makes; `mgsgraph status` shows their numbers.

    Exit status: 0 undone, 1 undone and not converged, 2 bad input (nothing has changed).
    """
    from mgsgraph.project.edits import undo as take_back
    from mgsgraph.project.project import open_project
    from mgsgraph.results.impact import require_writable

    if table is not None:
        require_writable(table, project)
    with open_project(project, write=True) as opened:
        done = take_back(opened, change)
    _print_edits(ctx, project, [done], table)


def _print_edits(ctx: click.Context, project: Path, done: "Sequence[Edited]", table: Path | None) -> None:
    """Each in a sentence; what the last one did to the rest in full."""
    for one in done:
        click.echo(f"{project}: change {one.change}. {one.sentence}")
        if one.impact is not None and one is not done[-1]:
            print_sentences(one.impact.sentences)
    _print_impact(ctx, project, done[-1].impact, table)


@click.command()
@click.argument("project", type=PATH)
@NO_FIGURES
@TABLES
@DEVICE
@DETAILS
@click.option("-v", "--verbose", is_flag=True, help="One line per iteration.")
@click.pass_context
def solve(
    ctx: click.Context, project: Path, no_figures: bool, tables: "TableForm | None", device: "Device | None",
    details: bool, verbose: bool,
) -> None:  # fmt: skip
    """Adjust everything in PROJECT by batch, compare it with the incremental result, and write PROJECT/solutions/NNNN.

    Exit status: 0 converged, 1 invalid (results are written), 2 bad input (nothing has
    changed).
    """
    from mgsgraph.analysis.verdict import is_valid
    from mgsgraph.cli.progress import iteration_bar
    from mgsgraph.project.changes import solve_project
    from mgsgraph.project.project import open_project

    with (
        open_project(project, write=True) as opened,
        iteration_bar(verbose, opened.settings.solver.settings.max_iterations) as bar,
    ):
        solved = solve_project(opened, not no_figures, tables, bar, device)
    print_solution(solved.solution, details)
    if solved.closing is not None:
        click.echo(f"- {solved.closing.sentence}")
    click.echo(f"Results are in {solved.folder}")
    ctx.exit(0 if is_valid(solved.solution) else 1)


@click.command()
@click.argument("project", type=PATH)
def status(project: Path) -> None:
    """Say what is in PROJECT, how it is connected, what the last solution was, and what has changed since."""
    from mgsgraph.project.project import open_project
    from mgsgraph.project.status import status as describe

    with open_project(project) as opened:
        text = describe(opened)
    click.echo(text)


def _print_impact(ctx: click.Context, project: Path, impact: "Impact | None", table: Path | None) -> None:
    """Sentences, the images reached, the points that moved most (all in a CSV file); exit 1 if not converged."""
    if impact is None:
        click.echo(f"Nothing is adjusted yet; next: mgsgraph solve {project}")
        return
    print_sentences(impact.sentences)
    click.echo("\n".join(impact.tables_text()))
    if table is not None:
        from mgsgraph.results.impact import write_impact

        write_impact(impact, table)
        click.echo(f"All points that moved are in {table}")
    ctx.exit(0 if impact.converged else 1)


@click.command()
@click.argument("path", type=PATH, metavar="PROJECT|RESULT|CASE")
@click.option("--case", type=PATH, help="Case of RESULT, for its images' pixels; that of a demonstration is found.")
@click.option("--port", type=click.IntRange(1, 65535), help="Port of this machine; any free one when absent.")
@click.option("--no-browser", is_flag=True, help="Print the address, open no browser.")
def studio(path: Path, case: Path | None, port: int | None, no_browser: bool) -> None:
    """Look at PROJECT, RESULT or CASE in the browser, measure, and ask: map, images, points, questions.

    The page is for this machine alone; its address holds a token that lasts as long as the command. Changes of a
    project are stored one by one: the command may be ended at any time (Ctrl+C).

    Exit status: 0, 2 bad input.
    """
    from mgsgraph.cli.progress import stage_bar
    from mgsgraph.errors import InputError

    if find_spec("starlette") is None or find_spec("uvicorn") is None:
        found = "its libraries are not installed"
        raise InputError("studio", found, remedy="pip install 'mgsgraph[studio]'")
    from mgsgraph.studio.opened import Opened
    from mgsgraph.studio.server import serve

    with stage_bar(1) as stages, stages.stage("reading"):
        opened = Opened(path, case)
        opened.footprints()

    def ready(address: str) -> None:
        click.echo(f"The studio is at {address}\nCtrl+C ends it; changes of a project are stored when they are made.")
        if not no_browser:
            import webbrowser

            webbrowser.open_new_tab(address)

    serve(opened, port, ready)

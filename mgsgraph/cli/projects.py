"""Verbs for a project (a folder to which images are added one after the other), and the studio."""

from collections.abc import Callable, Sequence
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING

import click

from mgsgraph.cli.options import (
    CASE,
    DETAILS,
    DEVICE,
    NO_FIGURES,
    PATH,
    TABLES,
    TIES,
    items,
    print_brief,
    print_ended,
    print_sentences,
    print_solution,
)
from mgsgraph.errors import command_line

if TYPE_CHECKING:
    from mgsgraph.adjustment.incremental.impact import Impact
    from mgsgraph.adjustment.settings import Device
    from mgsgraph.project.addition import Addition
    from mgsgraph.project.changes import Changed
    from mgsgraph.project.project import Project
    from mgsgraph.results.tables import TableForm

_WHY = click.option("--why", default="", metavar="TEXT", help="Reason, for the history.")
_IMPACT = click.option(
    "--impact", "table", type=PATH, metavar="FILE", help="Write every point that moved to a CSV file."
)


def _changing(verb: Callable[..., None]) -> Callable[..., None]:
    """Decorator: adds the options of a verb that changes a project and says what moved; it takes the context first."""
    return _WHY(_IMPACT(DETAILS(click.pass_context(verb))))


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
    print_sentences(*begun.notes)
    if begun.waits:
        click.echo(f"Its images wait for tie points; next: {command_line('match', project)}")
    elif case is not None:
        click.echo(f"Nothing is adjusted yet; next: {command_line('project', 'solve', project)}")
    else:
        click.echo(f"Next: {command_line('project', 'add', project)} IMAGE...")


@click.command()
@click.argument("project", type=PATH)
@click.argument("images", nargs=-1, metavar="[NAME=]IMAGE...")
@click.option("--ties", type=PATH, multiple=True, metavar="NETWORK", help="Tie points of theirs; may be repeated.")
@click.option("--shots", type=PATH, multiple=True, metavar="FILE", help="ISIS lidar (.json) or PEDR; may be repeated.")
@click.option("--pass", "of_pass", default="", metavar="NAME", help="Pass of PROJECT that they are images of.")
@click.option("--share", "shares", multiple=True, metavar="NAME", help="Shared unknown that they share; repeatable.")
@_changing
@click.option("--dry-run", is_flag=True, help="Add and adjust, say what would move, and change nothing.")
def add(
    ctx: click.Context, project: Path, images: tuple[str, ...], ties: tuple[Path, ...], shots: tuple[Path, ...],
    of_pass: str, shares: tuple[str, ...], why: str, table: Path | None, dry_run: bool,
) -> None:  # fmt: skip
    """Add each IMAGE to PROJECT, with the measures of --ties and --shots, and adjust what it touches.

    IMAGE is support data (.json, .isd), a MOC label (.img, .lbl, .cub; with the project's kernels) or a case file
    (.toml), which brings everything that it names, passes among it. NAME is what control networks call it. The
    trajectory of a pass that is there goes on over the lines of its new images.

    What is printed is the impact: which images and points moved, in metres and in their sigmas.

    Exit status: 0 added, 1 added and not converged, 2 bad input (nothing has changed).
    """
    from mgsgraph.cli.progress import stage_bar
    from mgsgraph.errors import require
    from mgsgraph.project.addition import parse_image, read_addition
    from mgsgraph.project.changes import add as add_to
    from mgsgraph.project.project import open_project

    require(images or ties or shots, "add", "no image, no --ties and no --shots", "at least one of them")
    _require_writable(table, project)
    arguments = [parse_image(text) for text in images]
    with stage_bar(2) as stages, open_project(project, write=True, discard=dry_run) as opened:
        with stages.stage("reading"):
            addition = read_addition(opened, arguments, ties, shots, of_pass, shares)
        with stages.stage("adjusting"):
            impact = add_to(opened, addition, why)
    alone = ", ".join(addition.unconnected) if impact is None else ""
    warning = alone and f"Unconnected: {alone}. No point is shared with another image; tie points would join it."
    notes = items((*addition.notes, warning))
    done, end = ("would add", "; nothing was changed") if dry_run else ("added", "")
    first = f"{project}: {done} {_description_of(addition)}{end}"
    _print_impact(ctx, project, impact, table, [first, *notes])


def _description_of(addition: "Addition") -> str:
    from mgsgraph.text import many

    network = addition.network
    rays, ranges = (0, 0) if network is None else (network.rays.point.size, network.ranges.point.size)
    named = ", ".join(addition.names)
    images = many(len(addition.names), "image")
    return f"{images}{f' ({named})' if named else ''}, {rays} image measures, {ranges} laser ranges"


@click.command()
@click.argument("project", type=PATH)
@click.argument("images", nargs=-1, required=True, metavar="IMAGE...")
@_changing
def remove(ctx: click.Context, project: Path, images: tuple[str, ...], why: str, table: Path | None) -> None:
    """Take each IMAGE (by its name or a unique part of it) out of PROJECT with its measures, and adjust the rest.

    Exit status: 0 removed, 1 removed and not converged, 2 bad input (nothing has changed).
    """
    from mgsgraph.cli.progress import stage
    from mgsgraph.project.changes import remove_images
    from mgsgraph.project.project import open_project

    _require_writable(table, project)
    with stage("adjusting"), open_project(project, write=True) as opened:
        names = opened.images_named(images)
        impact = remove_images(opened, names, why)
    _print_impact(ctx, project, impact, table, [f"{project}: removed {', '.join(names)}"])


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
@click.option("--remove", "gone", is_flag=True, help="Remove POINT.")
@_changing
def measure(
    ctx: click.Context, project: Path, point: str, new: bool, pixels: tuple[tuple[str, float, float], ...],
    sigma_px: float | None, rejected: tuple[str, ...], accepted: tuple[str, ...], gone: bool, why: str,
    table: Path | None,
) -> None:  # fmt: skip
    """Measure POINT in images of PROJECT, or reject what is measured, and adjust what it touches.

    All of it is done or nothing; each step is a change of the history, which `mgsgraph project undo` takes back. They
    are decisions: a rejected measurement and a removed point stay out, a moved measurement keeps its position, also
    when a network is given again or an image comes back.

    Exit status: 0 done, 1 done and not converged, 2 bad input (nothing has changed).
    """
    from mgsgraph.errors import InputError
    from mgsgraph.project import edits
    from mgsgraph.project.decisions import Measure
    from mgsgraph.project.project import open_project

    if not (pixels or rejected or accepted or gone):
        raise click.UsageError("one of --pixel, --reject, --accept and --remove")
    if (new and (not pixels or rejected or accepted or gone)) or (gone and (pixels or rejected or accepted)):
        raise click.UsageError("--new goes with --pixel alone, --remove with nothing else")
    if sigma_px is not None and not pixels:
        raise click.UsageError("--sigma-px is of --pixel")
    if sigma_px is not None and not 0.0 < sigma_px < float("inf"):
        raise InputError("--sigma-px", f"{sigma_px}", "a positive number of pixels")
    _require_writable(table, project)
    sigma = sigma_px or 0.0
    with open_project(project, write=True) as opened:
        names = [opened.images_named([image])[0] for image, _, _ in pixels]
        measurements = [Measure(name, *pixel[1:], sigma, sigma) for name, pixel in zip(names, pixels, strict=True)]
        if new and edits.point_state(opened, point) is not None:
            raise InputError(f"{project}, point {point}", "it is there already", "a new name", "leave --new out")
        changes = [edits.measure(opened, point, measurements, why)] if new else []
        changes += [] if new else [edits.set_measure(opened, point, measurement, why) for measurement in measurements]
        changes += [edits.reject(opened, point, image, why) for image in opened.images_named(rejected)]
        changes += [edits.accept(opened, point, image, why) for image in opened.images_named(accepted)]
        changes += [edits.remove_point(opened, point, why)] if gone else []
    _print_edits(ctx, project, changes, table)


@click.command()
@click.argument("project", type=PATH)
@click.argument("change", type=int, required=False)
@_changing
def undo(ctx: click.Context, project: Path, change: int | None, why: str, table: Path | None) -> None:
    """Undo the last change of PROJECT (add, remove, measure, match, align), and adjust; once more for the one before.

    With CHANGE, a number that `mgsgraph project status` shows, a change of a point that no later change has touched.
    What the change had decided about points no longer holds. `mgsgraph project redo` carries it out again.

    Exit status: 0 undone, 1 undone and not converged, 2 bad input (nothing has changed).
    """
    from mgsgraph.project import history

    _print_reversal(ctx, project, table, partial(history.undo, number=change, why=why))


@click.command()
@click.argument("project", type=PATH)
@_changing
def redo(ctx: click.Context, project: Path, why: str, table: Path | None) -> None:
    """Carry out again the last change of PROJECT that `mgsgraph project undo` took back, and adjust; once more for the
    next one. A new change of PROJECT ends what can be redone.

    Exit status: 0 redone, 1 redone and not converged, 2 bad input, or nothing to redo (nothing has changed).
    """
    from mgsgraph.project import history

    _print_reversal(ctx, project, table, partial(history.redo, why=why))


def _print_reversal(ctx: click.Context, project: Path, table: Path | None, act: "Callable[[Project], Changed]") -> None:
    from mgsgraph.project.project import open_project

    _require_writable(table, project)
    with open_project(project, write=True) as opened:
        change = act(opened)
    _print_edits(ctx, project, [change], table)


def _require_writable(table: Path | None, project: Path) -> None:
    if table is not None:
        from mgsgraph.results.impact import require_writable

        require_writable(table, project)


def _print_edits(ctx: click.Context, project: Path, changes: "Sequence[Changed]", table: Path | None) -> None:
    """Print a sentence for each change, and the impact of the last one in full."""
    sentences = list[str]()
    for change in changes:
        sentences.append(f"{project}: change {change.change}. {change.sentence}")
        if change.impact is not None and change is not changes[-1]:
            sentences += items(change.impact.sentences)
    _print_impact(ctx, project, changes[-1].impact, table, sentences)


@click.command()
@click.argument("project", type=PATH)
@NO_FIGURES
@TABLES
@DEVICE
@DETAILS
@click.pass_context
def solve(
    ctx: click.Context, project: Path, no_figures: bool, tables: "TableForm | None", device: "Device | None"
) -> None:  # fmt: skip
    """Adjust everything in PROJECT by batch, compare it with the incremental result, and write PROJECT/solutions/NNNN.

    Exit status: 0 valid or suspect, 1 invalid (results are written), 2 bad input (nothing has
    changed).
    """
    from mgsgraph.analysis.verdict import is_valid
    from mgsgraph.cli.progress import iteration_bar
    from mgsgraph.project.changes import solve_project
    from mgsgraph.project.project import open_project

    with open_project(project, write=True) as opened, iteration_bar() as bar:
        solved = solve_project(opened, not no_figures, tables, bar, device)
    print_solution(solved.solution, 2)
    print_sentences("" if solved.check is None else solved.check.sentence)
    print_ended(f"Results are in {solved.folder}")
    ctx.exit(0 if is_valid(solved.solution) else 1)


@click.command()
@click.argument("project", type=PATH)
@DETAILS
def status(project: Path) -> None:
    """Say what is in PROJECT, how it is connected, what the last solution was, and what has changed since."""
    from mgsgraph.project.project import open_project
    from mgsgraph.project.status import status as describe

    with open_project(project) as opened:
        text = describe(opened)
    print_brief(text, more=0)


def _print_impact(
    ctx: click.Context, project: Path, impact: "Impact | None", table: Path | None, sentences: "Sequence[str]"
) -> None:
    """Print sentences and an impact: reached images, points that moved most (all of them in a CSV file). Exit with 1 if
    the adjustment has not converged.
    """
    if impact is None:
        print_brief(*sentences, f"Nothing is adjusted yet; next: {command_line('project', 'solve', project)}", more=0)
        return
    print_brief(*sentences, *items(impact.sentences), "", *impact.tables_text())
    if table is not None:
        from mgsgraph.results.impact import write_impact

        write_impact(impact, table)
        click.echo(f"All points that moved are in {table}")
    ctx.exit(0 if impact.converged else 1)


@click.command()
@click.argument("path", type=PATH, metavar="CASE|RESULT|PROJECT")
@CASE
@click.option("--port", type=click.IntRange(1, 65535), help="Port of this machine; any free one when absent.")
@click.option("--no-browser", is_flag=True, help="Open no browser; the address is printed anyway.")
@click.option("--from", "folder", type=PATH, metavar="FOLDER", help="Images and networks that may be added to PROJECT.")
@TIES
@click.option(
    "--verdicts", type=PATH, metavar="CSV",
    help="Verdicts about the tie points of CASE: read at the start, written at each verdict.  [default: "
    "CASE-verdicts.csv, from the first verdict on]",
)  # fmt: skip
def studio(
    path: Path, of_case: Path | None, port: int | None, no_browser: bool, folder: Path | None, ties: Path | None,
    verdicts: Path | None,
) -> None:  # fmt: skip
    """Look at CASE, RESULT or PROJECT in the browser, measure, ask, solve: map, images, lists, points, questions.

    The page is for this machine and your account alone; the printed address works once. Changes of a project are
    stored one by one: the command may be ended at any time (Ctrl+C), and ends after 12 hours without a request.

    Tie points of CASE, or of the case of RESULT, are accepted or rejected in the lists; the verdicts are kept as CSV.
    `mgsgraph convert NETWORK OUT --verdicts CSV` writes the network with Ignore = True at the rejected points.

    Exit status: 0, 2 bad input.
    """
    import webbrowser

    from mgsgraph.cli.progress import stage_bar
    from mgsgraph.errors import InputError

    if find_spec("starlette") is None or find_spec("uvicorn") is None:
        reason = "its libraries are not installed"
        raise InputError("studio", reason, remedy="pip install 'mgsgraph[studio]'")
    from mgsgraph.studio.opened import Opened
    from mgsgraph.studio.server import serve

    if folder is not None and not folder.is_dir():
        raise InputError("--from", f"{folder}: no such folder", "a folder of images and control networks")
    with stage_bar(1) as stages, stages.stage("reading"):
        opened = Opened(path, of_case, ties, verdicts)
        opened.footprints()

    click.echo("Ctrl+C ends the studio; changes of a project are stored when they are made.")
    serve(
        opened, port, lambda address: click.echo(f"An address for one browser, which works once: {address}"),
        None if no_browser else webbrowser.open_new_tab, folder,
    )  # fmt: skip

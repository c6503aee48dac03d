"""`mgsgraph init`: a folder for images that come one after the other."""

from pathlib import Path

import click

_PATH = click.Path(path_type=Path)


@click.command(short_help="Make a project.")
@click.argument("project", type=_PATH)
@click.option("--case", type=_PATH, help="A case file: its images, measures, terrain and settings go in.")
@click.option("--settings", type=_PATH, help="A TOML file with [orientation], [spice], [measures], [solver] alone.")
@click.option("--name", default="", help="What to call it; the case's or the folder's name when absent.")
def init(project: Path, case: Path | None, settings: Path | None, name: str) -> None:
    """Make PROJECT, a folder to which images are added one after the other.

    Its settings hold for all that comes: a-priori sigmas of the orientation, SPICE kernels, the solver's choices.

    A case without tie points, as `mgsgraph fetch` writes it, gives its images; `mgsgraph match PROJECT` finds the ties.
    """
    from mgsgraph.cli.stages import stage_bar
    from mgsgraph.errors import InputError
    from mgsgraph.project.changes import begin

    if case is not None and settings is not None:
        raise InputError("--settings", "a case is given, too, which has settings", "one of the two")
    with stage_bar(2) as stages:
        begun = begin(project, name, case, settings, stages.stage)
    click.echo(f"{project}: a new project, {begun.words}")
    if begun.waits:
        click.echo(f"Its images wait for tie points; next: mgsgraph match {project}")
    elif case is not None:
        click.echo(f"Nothing is adjusted yet; next: mgsgraph solve {project}")
    else:
        click.echo(f"Next: mgsgraph add {project} IMAGE...")

"""`mgsgraph status`: what a project holds."""

from pathlib import Path

import click


@click.command(short_help="Say what is in a project.")
@click.argument("project", type=click.Path(path_type=Path))
def status(project: Path) -> None:
    """Say what is in PROJECT, how it hangs together, what the last solution was, and what has changed since."""
    from mgsgraph.project.project import open_project
    from mgsgraph.project.status import status as describe

    with open_project(project, thorough=True) as opened:
        text = describe(opened)
    click.echo(text)

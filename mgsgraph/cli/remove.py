"""`mgsgraph remove`: images leave a project, and everything that they touched is adjusted anew."""

from pathlib import Path

import click


@click.command(short_help="Take images out of a project.")
@click.argument("project", type=click.Path(path_type=Path))
@click.argument("images", nargs=-1, required=True, metavar="IMAGE...")
@click.pass_context
def remove(ctx: click.Context, project: Path, images: tuple[str, ...]) -> None:
    """Take each IMAGE (by its name) out of PROJECT with its measures, and adjust what it touched.

    Exit status: 0 removed, 1 removed and not come to rest, 2 bad input (nothing has changed).
    """
    from mgsgraph.cli.stages import stage_bar
    from mgsgraph.project.change import remove as take_out
    from mgsgraph.project.project import open_project

    with stage_bar(1) as stages, stages.stage("adjusting"), open_project(project, write=True) as opened:
        impact = take_out(opened, images)
    click.echo(f"{project}: removed {', '.join(images)}")
    if impact is None:
        click.echo(f"Nothing is adjusted yet; next: mgsgraph solve {project}")
        return
    for sentence in impact.sentences():
        click.echo(f"- {sentence}")
    click.echo(impact.table())
    ctx.exit(0 if impact.converged else 1)

"""`mgsgraph remove`: images leave a project, and everything that they touched is adjusted anew."""

from pathlib import Path

import click


@click.command(short_help="Take images out of a project.")
@click.argument("project", type=click.Path(path_type=Path))
@click.argument("images", nargs=-1, required=True, metavar="IMAGE...")
@click.option("--check", is_flag=True, help="Compare with batch over everything afterwards; see `mgsgraph solve`.")
@click.pass_context
def remove(ctx: click.Context, project: Path, images: tuple[str, ...], check: bool) -> None:
    """Take each IMAGE (by its name) out of PROJECT with its measures, and adjust what it touched.

    Exit status: 0 removed, 1 removed and not come to rest, 2 bad input (nothing has changed).
    """
    from mgsgraph.cli.stages import stage_bar
    from mgsgraph.project.change import check as compare
    from mgsgraph.project.change import remove as take_out
    from mgsgraph.project.project import open_project

    closing = None
    with stage_bar(2 if check else 1) as stages, open_project(project, write=True) as opened:
        with stages.stage("adjusting"):
            impact = take_out(opened, images)
        if check and impact is not None:
            with stages.stage("closing check"):
                closing = compare(opened)
    click.echo(f"{project}: removed {', '.join(images)}")
    if impact is None:
        click.echo(f"Nothing is adjusted yet; next: mgsgraph solve {project}")
        return
    for sentence in impact.sentences():
        click.echo(f"- {sentence}")
    click.echo(impact.table())
    if closing is not None:
        click.echo(f"- {closing.sentence()}")
    ctx.exit(0 if impact.converged else 1)

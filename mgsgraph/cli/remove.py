"""`mgsgraph remove`: images leave a project, and everything that they touched is adjusted anew."""

from pathlib import Path

import click

_PATH = click.Path(path_type=Path)


@click.command(short_help="Take images out of a project.")
@click.argument("project", type=click.Path(path_type=Path))
@click.argument("images", nargs=-1, required=True, metavar="IMAGE...")
@click.option("--impact", "table", type=_PATH, metavar="FILE", help="Write every point that moved to a CSV file.")
@click.option("--check", is_flag=True, help="Compare with batch over everything afterwards; see `mgsgraph solve`.")
@click.pass_context
def remove(ctx: click.Context, project: Path, images: tuple[str, ...], table: Path | None, check: bool) -> None:
    """Take each IMAGE (by its name) out of PROJECT with its measures, and adjust what it touched.

    Exit status: 0 removed, 1 removed and not come to rest, 2 bad input (nothing has changed).
    """
    from mgsgraph.cli.stages import stage_bar
    from mgsgraph.cli.tell import tell
    from mgsgraph.project.changes import check as compare
    from mgsgraph.project.changes import remove as take_out
    from mgsgraph.project.project import open_project
    from mgsgraph.reports.impact import require_writable

    if table is not None:
        require_writable(table, project)
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
    tell(impact, closing, table)
    ctx.exit(0 if impact.converged else 1)

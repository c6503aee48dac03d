"""Verbs to begin with: help, and a case file for the files that one has."""

from pathlib import Path

import click

from mgsgraph.cli.options import PATH

_CASE = "case"


@click.command()
@click.argument("words", nargs=-1, metavar="[VERB | case [TABLE]]")
@click.pass_context
def help(ctx: click.Context, words: tuple[str, ...]) -> None:
    """Say what a VERB does and takes, or what a case file may say: all tables and keys, or those of one TABLE (images,
    ties, solver ...; head for the keys before the first table).
    """
    group = ctx.find_root().command
    assert isinstance(group, click.Group)
    if words[:1] == (_CASE,) and len(words) <= 2:
        from mgsgraph.case.case_file import keys_text

        click.echo(keys_text(words[1] if len(words) > 1 else None))
        return
    if len(words) > 1:
        raise click.UsageError(f"{' '.join(words)}: a verb, or case and one of its tables")
    if not words:
        click.echo(ctx.find_root().get_help())
        return
    name, command, _ = group.resolve_command(ctx.find_root(), list(words))
    assert command is not None
    with click.Context(command, info_name=name, parent=ctx.find_root()) as inner:
        click.echo(command.get_help(inner))


@click.command()
@click.argument("files", type=PATH, nargs=-1, required=True, metavar="FILE|FOLDER...")
@click.option("--out", type=PATH, default=Path("case.toml"), show_default=True, help="Case file; an earlier one stays.")
@click.option("--name", default="", help="What to call it; OUT's name, or the data's folder's, when absent.")
@click.option("--replace", is_flag=True, help="Overwrite a case file that is there.")
def new(files: tuple[Path, ...], out: Path, name: str, replace: bool) -> None:
    """Look at FILEs (those directly in a FOLDER, those of an ISIS list) and write a case file of them, with comments.

    Taken are images (ISIS cubes, image support data, labels with SPICE kernels, model states), control networks and
    tables of tie points, ground control, laser shots and terrain models; what each is, its content says. What can't be
    known from the files is left to you in a comment. What next: the last line that is printed.
    """
    from mgsgraph.case.draft import draft_case

    made = draft_case(files, out, name, replace)
    for line in made.said:
        click.echo(line)
    click.echo(f"The case is {out}")
    click.echo(f"Next: {made.command}")

"""The verb `new`: a case file for the user's files."""

from pathlib import Path

import click

from mgsgraph.cli.options import PATH


@click.command()
@click.argument("files", type=PATH, nargs=-1, metavar="FILE|FOLDER...")
@click.option("--out", type=PATH, default=Path("case.toml"), show_default=True, help="Case file; an earlier one stays.")
@click.option("--name", default="", help="What to call it; OUT's name, or the data's folder's, when absent.")
@click.option("--replace", is_flag=True, help="Overwrite a case file that is there.")
@click.option(
    "--keys", is_flag=False, flag_value="", metavar="[TABLE]",
    help="Print all tables and keys of a case file, or those of TABLE (images, ties ...; head: before any table).",
)  # fmt: skip
def new(files: tuple[Path, ...], out: Path, name: str, replace: bool, keys: str | None) -> None:
    """Look at FILEs (those directly in a FOLDER, those of an ISIS list) and write a case file of them, with comments.

    Taken are images (ISIS cubes, image support data, labels with SPICE kernels, model states), control networks and
    tables of tie points, ground control, laser shots and terrain models; what each is, its content says. What can't be
    known from the files is left to you in a comment. What next: the last line that is printed.
    """
    if keys is not None:
        from mgsgraph.case.case_file import keys_text

        click.echo(keys_text(keys or None))
        return
    if not files:
        raise click.UsageError("Missing argument 'FILE|FOLDER...'")
    from mgsgraph.case.draft import draft_case

    draft = draft_case(files, out, name, replace)
    for line in draft.said:
        click.echo(line)
    click.echo(f"The case is {out}")
    click.echo(f"Next: {draft.command}")

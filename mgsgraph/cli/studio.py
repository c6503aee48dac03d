"""The verb that opens the studio."""

from importlib.util import find_spec
from pathlib import Path

import click

from mgsgraph.cli.options import PATH


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

"""Write what pages say of the program itself, as plain text that reads everywhere: every verb with its options
(docs/commands.md), every table and key of a case file (docs/case_file.md), every column of the results (docs/files.md).

`python scripts/pages.py` writes them; a test (tests/test_docs.py) holds them true.
"""

import inspect
import re
from pathlib import Path

import click
from file_columns import columns_markdown

from mgsgraph.case.case_file import keys_markdown
from mgsgraph.cli import group

DOCS = Path(__file__).resolve().parents[1] / "docs"
_COMMANDS = """<!-- written by scripts/pages.py -->
# Commands

Every verb with its options, as `mgsgraph VERB --help` says it: this page is made from the commands themselves. Bad
input is one line on standard error and exit status 2; 0 is done, 1 not converged (results are written), 130 interrupted
(nothing is half-written). Results appear whole or not at all: an earlier result is replaced only when the new one is
there, a folder that holds anything else is refused.
"""
_KEYS = "<!-- keys: written by scripts/pages.py -->\n"
_COLUMNS = "<!-- columns: written by scripts/pages.py -->\n"


def pages() -> dict[Path, str]:
    """What should stand in each page."""
    return {
        DOCS / "commands.md": _COMMANDS + commands_markdown(),
        DOCS / "case_file.md": f"{_by_hand('case_file.md', _KEYS)}\n{keys_markdown()}",
        DOCS / "files.md": _by_hand("files.md", _COLUMNS) + columns_markdown(),
    }


def _by_hand(page: str, mark: str) -> str:
    """What stands in a page down to the mark."""
    return "".join((DOCS / page).read_text(encoding="utf-8").partition(mark)[:2])


def commands_markdown() -> str:
    """A section for each verb."""
    lines: list[str] = []
    with click.Context(group, info_name="mgsgraph") as whole:
        for name in group.list_commands(whole):
            command = group.get_command(whole, name)
            assert command is not None
            lines += _verb(name, command, whole)
    return "\n".join(lines) + "\n"


def _verb(name: str, command: click.Command, whole: click.Context) -> list[str]:
    with click.Context(command, info_name=name, parent=whole) as ctx:
        usage = command.collect_usage_pieces(ctx)
        options = [record for one in command.params if (record := one.get_help_record(ctx)) and record[1]]
    lines = ["", f"## `mgsgraph {name}`", "", f"`mgsgraph {name} {' '.join(usage)}`"]
    lines += ["", *_marked(inspect.cleandoc(command.help or "")).splitlines(), ""]
    if options:
        lines += ["| option | what it does |", "|---|---|"]
    return lines + [f"| `{_cell(option)}` | {_cell(_marked(said))} |" for option, said in options]


def _marked(text: str) -> str:
    """Options as code, pages as links."""
    text = re.sub(r"(?<![`\w-])(--[a-z][a-z-]*)", r"`\1`", text.replace("\b\n", ""))
    return re.sub(r"\bdocs/(\w+)\.md\b", r"[\1](\1.md)", text)


def _cell(text: str) -> str:
    return " ".join(text.split()).replace("|", r"\|")


if __name__ == "__main__":
    for path, text in pages().items():
        path.write_text(text, encoding="utf-8", newline="\n")

"""The directive `commands`: every verb of the command line, its arguments and options, as click itself has them."""

import inspect
import re
from typing import Any

import click
from docutils import nodes
from docutils.statemachine import StringList
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxDirective

from mgsgraph.cli import group


class Commands(SphinxDirective):
    """A section for each verb."""

    def run(self) -> list[nodes.Node]:
        """Sections, made of Markdown as the page around them is."""
        lines: list[str] = []
        with click.Context(group, info_name="mgsgraph") as whole:
            for name in group.list_commands(whole):
                command = group.get_command(whole, name)
                assert command is not None
                lines += _verb(name, command, whole)
        holder = nodes.container()
        self.state.nested_parse(StringList(lines, source="mgsgraph.cli"), 0, holder, match_titles=True)
        return holder.children


def _verb(name: str, command: click.Command, whole: click.Context) -> list[str]:
    with click.Context(command, info_name=name, parent=whole) as ctx:
        usage = command.collect_usage_pieces(ctx)
        options = [record for one in command.params if (record := one.get_help_record(ctx)) and record[1]]
    lines = ["", f"(mgsgraph-{name})=", f"## `mgsgraph {name}`", "", "```text", f"mgsgraph {name} {' '.join(usage)}"]
    lines += ["```", "", *_marked(inspect.cleandoc(command.help or "")).splitlines(), ""]
    if options:
        lines += ["| option | what it does |", "|---|---|"]
    return lines + [f"| `{_cell(option)}` | {_cell(_marked(said))} |" for option, said in options]


def _marked(text: str) -> str:
    """Options as code, pages as links."""
    text = re.sub(r"(?<![`\w-])(--[a-z][a-z-]*)", r"`\1`", text.replace("\b\n", ""))
    return re.sub(r"\bdocs/(\w+)\.md\b", r"[](\1.md)", text)


def _cell(text: str) -> str:
    return " ".join(text.split()).replace("|", r"\|")


def setup(app: Sphinx) -> dict[str, Any]:
    """Offer the directive."""
    app.add_directive("commands", Commands)
    return {"parallel_read_safe": True, "parallel_write_safe": True}

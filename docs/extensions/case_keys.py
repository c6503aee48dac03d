"""The directive `case-keys`: tables and keys of a case file, defaults and meanings, as the schema has them."""

import typing
from collections.abc import Iterator
from typing import Any

import msgspec
from docutils import nodes
from docutils.statemachine import StringList
from sphinx.application import Sphinx
from sphinx.pycode import ModuleAnalyzer
from sphinx.util.docutils import SphinxDirective

from mgsgraph.adjustment.settings import SolverSettings
from mgsgraph.case.schema import CaseInput, SolverInput

_Kind = type[msgspec.Struct]


class CaseKeys(SphinxDirective):
    """A section for each table."""

    def run(self) -> list[nodes.Node]:
        """Sections, made of Markdown as the page around them is."""
        lines = [line for head, kind in _tables("", CaseInput, False) for line in _section(head, kind)]
        holder = nodes.container()
        self.state.nested_parse(StringList(lines, source="mgsgraph.case.schema"), 0, holder, match_titles=True)
        return holder.children


def _tables(path: str, kind: _Kind, several: bool) -> Iterator[tuple[str, _Kind]]:
    """Headings and records, a table's own tables after it."""
    yield (f"`[[{path}]]`" if several else f"`[{path}]`") if path else "At the head", kind
    for field in msgspec.structs.fields(kind):
        below = _record(field.type)
        if below is not None and not (path and field.name == "orientation"):  # an image's is as that of all
            yield from _tables(f"{path}.{field.name}".lstrip("."), below, "tuple" in str(field.type))


def _record(hint: Any) -> _Kind | None:
    """The record within a type, if there is one."""
    if isinstance(hint, type) and issubclass(hint, msgspec.Struct):
        return hint
    return next((found for part in typing.get_args(hint) if (found := _record(part)) is not None), None)


def _section(head: str, kind: _Kind) -> list[str]:
    meanings = ModuleAnalyzer.for_module(kind.__module__).find_attr_docs()
    if kind is SolverInput:  # the same names, said there
        settings = ModuleAnalyzer.for_module(SolverSettings.__module__).find_attr_docs()
        meanings = {(kind.__name__, name): lines for (_, name), lines in settings.items()}
    lines = ["", f"## {head}", "", " ".join((kind.__doc__ or "").split()), ""]
    lines += ["| key | when left out | what it says |", "|---|---|---|"]
    for field in msgspec.structs.fields(kind):
        said = " ".join(meanings[kind.__name__, field.name]).strip()
        choices = ", ".join(f"`{word}`" for word in _words(field.type))
        lines.append(f"| `{field.name}` | {_default(field)} | {said} {choices} |".replace(" |  |", " | |"))
    return lines


def _words(hint: Any) -> tuple[Any, ...]:
    """What a Literal may be."""
    if typing.get_origin(hint) is typing.Literal:
        return typing.get_args(hint)
    return tuple(word for part in typing.get_args(hint) for word in _words(part))


def _default(field: msgspec.structs.FieldInfo) -> str:
    if field.required:
        return "**must be there**"
    value = field.default
    if value is msgspec.NODEFAULT or value in (None, "", ()) or isinstance(value, msgspec.Struct):
        return ""
    return f"`{str(value).lower() if isinstance(value, bool) else list(value) if isinstance(value, tuple) else value}`"


def setup(app: Sphinx) -> dict[str, Any]:
    """Offer the directive."""
    app.add_directive("case-keys", CaseKeys)
    return {"parallel_read_safe": True, "parallel_write_safe": True}

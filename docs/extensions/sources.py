"""Names in the text become links: of classes and functions to the API page, of modules to their source.

Sources that pages name stand in the site as pages of their own, so that an equation leads to the lines that compute it.
"""

import ast
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from docutils import nodes
from pygments import highlight
from pygments.formatters import HtmlFormatter
from pygments.lexers import PythonLexer
from sphinx.application import Sphinx

ROOT = Path(__file__).resolve().parents[2]
_MODULE = re.compile(r"[a-z]\w*(?:[/.]\w+)+")
_OBJECT = re.compile(r"(?:mgsgraph\.)?(?:\w+\.)*\w+")


def source_of(text: str) -> Path | None:
    """The file of a module named as `factors/pose`, `analysis.verdict` or `mgsgraph.results.figures.sheet`."""
    if not _MODULE.fullmatch(text):
        return None
    parts = text.replace(".", "/").removeprefix("mgsgraph/")
    path = (ROOT if parts.startswith("factors/") else ROOT / "mgsgraph") / f"{parts}.py"
    return path if path.is_file() else None


def link_names(app: Sphinx, page: nodes.document, name: str) -> None:
    """Link the names that stand as code in a page, but for those that are links already."""
    objects = _objects(app)
    for literal in list(page.findall(nodes.literal)):
        if isinstance(literal.parent, nodes.reference) or any(isinstance(one, nodes.title) for one in _above(literal)):
            continue
        text = literal.astext()
        if path := source_of(text):
            _named(app).add(path)
            _link(app, literal, name, _page_of(path), "")
        elif path := _module_beside(literal):
            if line := _definitions(path).get(text):
                _link(app, literal, name, _page_of(path), f"line-{line}")
        elif found := objects.get(text.removesuffix("()").partition("(")[0]):
            document, anchor = found
            if document != name:
                _link(app, literal, name, document, anchor)


def _above(node: nodes.Node) -> Iterator[nodes.Node]:
    while (node := node.parent) is not None:
        yield node


def _module_beside(literal: nodes.literal) -> Path | None:
    """The module that the same row of a table names before."""
    row = next((one for one in _above(literal) if isinstance(one, nodes.row)), None)
    named = (source_of(one.astext()) for one in row.findall(nodes.literal)) if row else ()
    return next((path for path in named if path), None)


def _definitions(path: Path) -> dict[str, int]:
    """Lines of functions and classes, and of what these define."""
    lines = {}
    for node in ast.parse(path.read_text(encoding="utf-8")).body:
        if isinstance(node, ast.FunctionDef | ast.ClassDef):
            lines[node.name] = node.lineno
        if isinstance(node, ast.ClassDef):
            parts = (one for one in node.body if isinstance(one, ast.FunctionDef))
            lines |= {f"{node.name}.{one.name}": one.lineno for one in parts}
    return lines


def _objects(app: Sphinx) -> dict[str, tuple[str, str]]:
    """Page and anchor of each documented name: whole, and of classes and their members alone."""
    found: dict[str, tuple[str, str]] = {}
    for full, entry in app.env.get_domain("py").objects.items():
        place = entry.docname, entry.node_id
        found[full] = found[full.removeprefix("mgsgraph.")] = place
        parts = full.split(".")
        first = next((k for k, part in enumerate(parts) if part[:1].isupper()), None)
        if first is not None:
            found.setdefault(".".join(parts[first:]), place)
    return {name: place for name, place in found.items() if "." in name or name[0].isupper() or name in _FUNCTIONS}


_FUNCTIONS = {
    "read_case",
    "read_solution",
    "write_results",
    "orientation_profile",
    "make_dem",
    "match_into",
    "read_scene",
}
"""Functions that are linked by their bare names; `adjust` and others are commands as well."""


def _named(app: Sphinx) -> set[Path]:
    if not hasattr(app, "named_sources"):
        app.named_sources = set()  # type: ignore[attr-defined]
    named: set[Path] = app.named_sources  # type: ignore[attr-defined]
    return named


def _page_of(path: Path) -> str:
    return "source/" + path.relative_to(ROOT).with_suffix("").as_posix().removeprefix("mgsgraph/")


def _link(app: Sphinx, literal: nodes.literal, name: str, document: str, anchor: str) -> None:
    address = app.builder.get_relative_uri(name, document) + (f"#{anchor}" if anchor else "")
    link = nodes.reference("", "", internal=True, refuri=address)
    literal.replace_self(link)
    link += literal


def source_pages(app: Sphinx) -> Iterator[tuple[str, dict[str, Any], str]]:
    """A page for each module that is named."""
    drawn = HtmlFormatter(linenos="inline", lineanchors="line", cssclass="highlight source")
    for path in sorted(_named(app)):
        title = path.relative_to(ROOT).as_posix()
        body = highlight(path.read_text(encoding="utf-8"), PythonLexer(), drawn)
        yield _page_of(path), {"title": title, "body": f"<h1>{title}</h1>{body}"}, "page.html"


def setup(app: Sphinx) -> dict[str, Any]:
    """Listen."""
    app.connect("doctree-resolved", link_names)
    app.connect("html-collect-pages", source_pages)
    return {"parallel_read_safe": True, "parallel_write_safe": False}

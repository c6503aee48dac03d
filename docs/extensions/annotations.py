"""Types and fields of the API page in the words of the sources: `Array` for what NumPy spells out in forty letters."""

import re
from typing import Any

from docutils import nodes
from sphinx import addnodes
from sphinx.application import Sphinx

_SPELT = re.compile(r"ndarray\[tuple\[Any, \.\.\.\], dtype\[([^\[\]]+)\]\]")
_NAMES = {"float64": "Array", "int64": "Index", "bool": "Mask"}
"""As `mgsgraph.geometry.records` has them."""
_NODES = (addnodes.desc_annotation, addnodes.desc_returns, addnodes.desc_sig_name)


def name_arrays(app: Sphinx, page: nodes.document, name: str) -> None:
    """Replace the spelt-out types of all signatures."""
    for node in list(page.findall(lambda one: isinstance(one, _NODES))):
        if _SPELT.search(text := node.astext()):
            node.children = []
            node += nodes.Text(_SPELT.sub(lambda found: _NAMES.get(found[1], f"NDArray[{found[1]}]"), text))


def keep_whole(app: Sphinx, what: str, name: str, of: object, options: Any, lines: list[str]) -> None:
    """Say what a field is as it stands: napoleon takes all before a colon, "(n, 3) m: ...", for a type."""
    if what in {"attribute", "data", "property"}:
        lines[:0] = ["..", ""]  # a comment: the first line that is not empty is looked at


def setup(app: Sphinx) -> dict[str, Any]:
    """Listen."""
    app.connect("doctree-resolved", name_arrays)
    app.connect("autodoc-process-docstring", keep_whole, priority=400)  # before napoleon
    return {"parallel_read_safe": True, "parallel_write_safe": True}

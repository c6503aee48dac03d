"""Pages for a browser: one HTML file each, with no outside address, all with the head of `templates/page.html`."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from mgsgraph.files.writing import Output, begins, fresh_file


def page_of(template: str) -> Output:
    """The kind of page that a template makes: an earlier one is known by the generator in its head."""
    verb = Path(template).stem
    return begins(f"a page of mgsgraph {verb}", rf'(?s).{{,2000}}<meta name="generator" content="mgsgraph {verb}">')


def write_page(template: str, content: Mapping[str, Any], path: Path) -> None:
    """Fill in a template, named by its path within the package, and write it; an earlier page of it is replaced.

    Raises
    ------
    InputError
        If the file can't be written, or is another's.
    """
    import jinja2  # takes 0.1 s

    pages = jinja2.Environment(
        loader=jinja2.PackageLoader("mgsgraph", ""), autoescape=True, trim_blocks=True, lstrip_blocks=True,
        undefined=jinja2.StrictUndefined,
    )  # fmt: skip
    with fresh_file(path, "a file that may be written", "choose another --out", page_of(template)) as aside:
        pages.get_template(template).stream(content).dump(str(aside), encoding="utf-8")

"""Pages for a browser: one HTML file each, with no outside address, all with the head of `templates/page.html`."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from mgsgraph.io.files import fresh_file


def write_page(template: str, content: Mapping[str, Any], path: Path) -> None:
    """Fill in a template, named by its path within the package, and write it; an earlier file is replaced.

    Raises
    ------
    InputError
        If the file can't be written.
    """
    import jinja2  # takes 0.1 s

    pages = jinja2.Environment(
        loader=jinja2.PackageLoader("mgsgraph", ""), autoescape=True, trim_blocks=True, lstrip_blocks=True,
        undefined=jinja2.StrictUndefined,
    )  # fmt: skip
    with fresh_file(path, "a file that may be written", "choose another --out") as aside:
        pages.get_template(template).stream(content).dump(str(aside), encoding="utf-8")

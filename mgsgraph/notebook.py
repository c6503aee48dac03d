"""How records show themselves in a notebook: a title, sentences, a table. Plain HTML, everything escaped."""

from collections.abc import Sequence
from html import escape


def card(title: str, sentences: Sequence[str] = (), rows: Sequence[Sequence[str]] = (), head: int = 0) -> str:
    """HTML of a record; the first `head` rows are headings."""
    said = "".join(f"<li>{escape(sentence)}</li>" for sentence in sentences)
    lines = "".join(
        "<tr>" + "".join(f"<{tag}>{escape(cell)}</{tag}>" for cell in row) + "</tr>"
        for k, row in enumerate(rows)
        for tag in ("th" if k < head else "td",)
    )
    table = f"<table>{lines}</table>" if lines else ""
    return f"<b>{escape(title)}</b>" + (f"<ul>{said}</ul>" if said else "") + table

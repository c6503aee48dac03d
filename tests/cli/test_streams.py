"""What goes to a terminal: names out of files can't move its cursor, and our own bars can."""

import io

from tqdm import tqdm

from mgsgraph.cli.options import PrintableStream


def test_one_bar_in_another_moves_up() -> None:
    stream = io.StringIO()
    said = PrintableStream(stream, "standard error")
    for _ in tqdm(range(2), file=said, mininterval=0.0):
        for _ in tqdm(range(2), file=said, mininterval=0.0, leave=False):
            pass
    assert "\\x1b" not in stream.getvalue()
    assert "\n\r" in stream.getvalue()
    assert "\x1b[A" in stream.getvalue()


def test_names_move_nothing() -> None:
    stream = io.StringIO()
    said = PrintableStream(stream, "standard error")
    for text in ("a\x1b[A", "\x1b[Ab", "\x1b[2A", "\x1b[A\r", "\x1b[B", "\x1b[A\x1b[2J"):
        said.write(text)
    assert "\x1b" not in stream.getvalue()

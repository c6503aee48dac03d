"""Standard output and error: what goes to a terminal can't move its cursor, and what can't be written is said."""

import re
import sys
from typing import Any, TextIO

from mgsgraph.errors import MgsgraphError, printable

_KEPT = "\n\r\t"
"""What our own tables and bars are made of."""


_BETWEEN_BARS = re.compile(r"\n*(?:\x1b\[A)+")
"""What tqdm writes, and nothing else with it, to go from one bar to that above."""


class OutputError(MgsgraphError):
    """A standard stream that can't be written."""


class PrintableStream:
    """A stream on which names out of files are harmless: control characters are escaped, also bytes that are no text.

    All else is the stream's own.
    """

    def __init__(self, stream: TextIO, name: str) -> None:
        self._stream, self._name = stream, name

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)

    def write(self, text: str) -> int:
        """Write it, as far as it is printable; OutputError where that can't be done."""
        try:
            return self._stream.write(text if _BETWEEN_BARS.fullmatch(text) else printable(text, _KEPT))
        except OSError as error:
            raise self._refusal(error) from None

    def flush(self) -> None:
        """Write what waits; OutputError where that can't be done."""
        try:
            self._stream.flush()
        except OSError as error:
            raise self._refusal(error) from None

    def _refusal(self, error: OSError) -> Exception:
        if isinstance(error, BrokenPipeError):
            return error
        return OutputError(f"{self._name} can't be written ({error.strerror or error})")


def guard_streams() -> None:
    """Put `PrintableStream` in the place of standard output and error, where the caller has not closed them."""
    for name, words in (("stdout", "standard output"), ("stderr", "standard error")):
        stream = getattr(sys, name)
        if stream is not None:
            stream.reconfigure(errors="backslashreplace")
            setattr(sys, name, PrintableStream(stream, words))

"""What the campaigns' command lines have in common: errors in one line, whole numbers, progress, exit status."""

import argparse
import sys
from collections.abc import Callable
from typing import NoReturn

from mgsgraph.errors import MgsgraphError


class OneLine(argparse.ArgumentParser):
    """Says what is wrong in one line."""

    def error(self, message: str) -> NoReturn:
        self.exit(2, f"{self.prog}: error: {message}\n")


def at_least(least: int) -> Callable[[str], int]:
    """A reader of whole numbers for the command line, `least` or more."""

    def number(text: str) -> int:
        value = int(text) if text.isascii() and text.isdigit() else least - 1
        if value < least:
            raise argparse.ArgumentTypeError(f"{text!r} is no whole number of at least {least}")
        return value

    return number


def show(text: str) -> None:
    """One line on the terminal that the next one replaces."""
    if sys.stderr.isatty():
        print(f"\r{text:60}", end="\r" if not text else "", file=sys.stderr, flush=True)


def status(name: str, job: Callable[[], int | None]) -> int:
    """Exit status of a job: its own (0 for none); 2 after bad input and 130 when interrupted, which one line says."""
    try:
        return job() or 0
    except MgsgraphError as error:
        print(f"{name}: error: {error}", file=sys.stderr)
    except MemoryError:
        print(f"{name}: error: out of memory; choose a smaller size", file=sys.stderr)
    except KeyboardInterrupt:
        print(f"{name}: interrupted", file=sys.stderr)
        return 130
    return 2

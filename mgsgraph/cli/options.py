"""Options of several verbs and options that overrule case files; printing; standard output and error without control
characters, and with an error message if they can't be written.
"""

import re
import sys
import time
from collections.abc import Callable, Iterable
from dataclasses import replace
from functools import wraps
from pathlib import Path
from typing import TYPE_CHECKING, Any, TextIO

import click

from mgsgraph.errors import MgsgraphError, printable

if TYPE_CHECKING:
    from mgsgraph.adjustment.solution import Solution

_BEGAN = time.perf_counter()
_DETAILS = "mgsgraph.details"
_LINES = 15
"""Number of lines that a verb prints without --details."""
_HEAD = 6
"""Lines of a table with heading and two rows; a shorter beginning of a table is not printed."""
PATH = click.Path(path_type=Path)
TIES = click.option("--ties", type=PATH, metavar="NETWORK", help="Tie points in place of those that CASE names.")
DETAILS = click.option(
    "-v", "--details", is_flag=True, expose_value=False, help="Print all tables and sentences, and each step.",
    callback=lambda context, _, given: context.meta.update({_DETAILS: given}),
)  # fmt: skip
CASE = click.option("--case", "of_case", type=PATH, help="Case that was adjusted, where RESULT doesn't know it.")
NO_FIGURES = click.option("--no-figures", is_flag=True, help="Write no figures.")
TABLES = click.option(
    "--tables", type=click.Choice(["csv", "parquet"]),
    help="Form of points and residuals; when absent CSV up to 200,000 rows, else Parquet.",
)  # fmt: skip
TWO_IMAGES = click.option(
    "--image", "images", multiple=True, metavar="IMAGE", help="Images to take, twice; all that overlap when absent."
)
DEVICE = click.option(
    "--device", type=click.Choice(["cpu", "cuda", "auto"]), help="Who goes over the points: the CPU or a GPU."
)
CLUSTER = click.option("--cluster", metavar="PLACE", help="local, local:N (worker processes), or tls://host:port.")
INSECURE = click.option(
    "--insecure", is_flag=True, help="Let --cluster take tcp://host:port: anyone who reaches it runs code as its user."
)
WORKERS = click.option("--workers", type=click.IntRange(1), help="Threads; one per processor when absent.")
_OPTIONS = (
    click.option(
        "--loss", type=click.Choice(["none", "huber", "cauchy", "tukey"]),
        help="Robust loss on image coordinates and ranges.",
    ),
    click.option("--reject", type=float, help="Reject what good rays exceed as rarely as so many sigmas; 0: none."),
    click.option("--starts", type=click.IntRange(0), help="Starts over the terrain's shift; 0: none; 16 if small."),
    click.option("--no-laser", is_flag=True, help="Leave the laser rows out."),
    NO_FIGURES,
    TABLES,
    DEVICE,
)


def overruling(verb: Callable[..., None]) -> Callable[..., None]:
    """Decorator: adds the options that overrule case files; the verb receives them together as `overrides`."""

    @wraps(verb)
    def with_overrides(**options: Any) -> None:
        from mgsgraph.results.results import Overrides

        chosen = {name: options.pop(name) for name in ("loss", "reject", "starts", "tables", "device")}
        chosen |= {name: not options.pop(f"no_{name}") for name in ("laser", "figures")}
        verb(overrides=Overrides(**chosen), **options)

    for option in reversed(_OPTIONS):
        option(with_overrides)
    return with_overrides


def require_two(images: tuple[str, ...]) -> tuple[str, ...]:
    """The names of --image: two or none, else a UsageError."""
    if images and len(set(images)) != 2:
        raise click.UsageError(f"--image {', '.join(images)}: two different images, or none of them for all")
    return images


def out_option(verb: str, more: str = "") -> Callable[[Callable[..., None]], Callable[..., None]]:
    """The option --out of a verb that always writes a folder (`folder_for`)."""
    return click.option("--out", type=PATH, help=f"Folder for the results; made anew.{more}  [default: NAME-{verb}]")


def folder_for(out: Path | None, source: Path, verb: str) -> Path:
    """OUT, or a folder NAME-VERB in the working directory. NAME is that of the case file or folder; for case.toml and
    solution.npz that of the folder above.
    """
    whole = source.resolve()
    name = whole.stem if whole.suffix in (".toml", ".npz") else whole.name
    return out or Path(f"{whole.parent.name if name in ('case', 'solution') else name}-{verb}")


def items(sentences: Iterable[str]) -> list[str]:
    """Sentences as items of a list, without empty ones."""
    return [f"- {sentence}" for sentence in sentences if sentence]


def print_sentences(*sentences: str) -> None:
    """Print sentences, each as an item of a list."""
    for sentence in items(sentences):
        click.echo(sentence)


def details() -> bool:
    """Whether --details was given."""
    context = click.get_current_context(silent=True)
    return context is not None and bool(context.meta.get(_DETAILS))


def print_brief(*texts: str, more: int = 1) -> None:
    """Print texts. Without --details only as many lines as, with `more` others, make 15; the last line then says how
    many are left out.
    """
    lines = "\n".join(texts).split("\n")
    if not details() and len(lines) + more > _LINES:
        shortened = lines[: _LINES - more - 1]
        if "" in shortened[-_HEAD:]:
            shortened = shortened[: len(shortened) - 1 - shortened[::-1].index("")]
        lines = [*shortened, f"{len(lines) - len(shortened)} more lines: --details (-v)"]
    click.echo("\n".join(lines))


def print_ended(sentence: str) -> None:
    """Print the last sentence of a run (where the results are) with the seconds of the whole run."""
    click.echo(f"{sentence} ({elapsed():.0f} s)")


def elapsed() -> float:
    """Seconds since the start of the program, with loading of libraries and drawing."""
    return time.perf_counter() - _BEGAN


def print_solution(solution: "Solution", more: int = 1) -> None:
    """Print the result of an adjustment: a summary of few lines (`more` other lines are printed elsewhere), or with
    --details all tables, sentences and seconds.
    """
    from mgsgraph.results.results import sentences_of, solution_sections, summary_table
    from mgsgraph.results.summary import summary

    if not details():
        print_brief(*summary(solution), more=more)
        return
    sections = solution_sections(solution)
    seconds = {**solution.seconds, "start-up, tables and figures": elapsed() - sum(solution.seconds.values())}
    click.echo(summary_table(replace(solution, seconds=seconds), sections))
    print_sentences(*sentences_of(sections))


_UNESCAPED = "\n\r\t"
"""Control characters that are printed unchanged: tables and bars need them."""
_BETWEEN_BARS = re.compile(r"\n*(?:\x1b\[A)+")
"""Text with which tqdm moves from one bar to the bar above."""


class OutputError(MgsgraphError):
    """A standard stream that can't be written."""


class PrintableStream:
    """A stream that escapes control characters and bytes that are no text, as names in untrusted files may have them.

    All other attributes are those of the stream.
    """

    def __init__(self, stream: TextIO, name: str) -> None:
        self._stream, self._name = stream, name

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)

    def write(self, text: str) -> int:
        """Write a text with its control characters escaped; OutputError where this fails."""
        try:
            return self._stream.write(text if _BETWEEN_BARS.fullmatch(text) else printable(text, _UNESCAPED))
        except OSError as error:
            raise self._refusal(error) from None

    def flush(self) -> None:
        """Flush the stream; OutputError where this fails."""
        try:
            self._stream.flush()
        except OSError as error:
            raise self._refusal(error) from None

    def _refusal(self, error: OSError) -> Exception:
        if isinstance(error, BrokenPipeError):
            return error
        return OutputError(f"{self._name} can't be written ({error.strerror or error})")


def guard_streams() -> None:
    """Replace standard output and error by `PrintableStream`, unless the caller has closed them."""
    for name, label in (("stdout", "standard output"), ("stderr", "standard error")):
        stream = getattr(sys, name)
        if stream is not None:
            stream.reconfigure(errors="backslashreplace")
            setattr(sys, name, PrintableStream(stream, label))

"""The command line: one function for each verb, without computations. Verbs are imported when they are called."""

import gc
import os
import signal
import sys
from collections.abc import Iterable
from difflib import get_close_matches
from importlib import import_module
from types import FrameType
from typing import Any, NoReturn

import click

from mgsgraph.cli.options import guard_streams
from mgsgraph.cli.verbs import GROUPS, REMOVED, RENAMED, VERBS
from mgsgraph.errors import MgsgraphError, is_interrupt, one_line

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # before NumPy: its waiting threads take a fifth of a short command
_SIGNALS = signal.SIGINT, signal.SIGTERM, signal.SIGALRM
"""Signals that end the program; files are then unchanged or complete."""
_RETRY_IN_IMPORT = 0.01
"""s until the next attempt of an interrupt during an import."""
_RETRY = 0.2
"""s until the next attempt of an interrupt that a library or its callback may have swallowed."""
_INTERRUPTED = "interrupted; results are as they were before, or whole"
_OUT_OF_MEMORY = "error: out of memory; give the machine more or leave images out"
_PROJECT = """Keep a block in a folder, PROJECT, to which images come one after another."""
_LONGEST_MESSAGE = 700
"""Maximum number of characters of an error message of click."""
_OPENCV_OUT_OF_MEMORY = -4
"""Code of OpenCV's error for exhausted memory."""
_FEWEST_FILES = 64
_LEAST = 2_000_000_000
"""Bytes of address space that loading the libraries needs; with less some of them hang and ignore signals."""


class _Verbs(click.Group):
    """Verbs by name, with a one-line help that needs no import of their modules: all verbs, or those whose names begin
    with `prefix`.
    """

    def __init__(self, *args: Any, prefix: str = "", **options: Any) -> None:
        super().__init__(*args, **options)
        names = (verb.removeprefix(prefix).split()[0] for verb in VERBS if verb.startswith(prefix))
        self._prefix, self._names = prefix, list(dict.fromkeys(names))

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        return super().parse_args(ctx, args or ["--help"])

    def list_commands(self, ctx: click.Context) -> list[str]:
        return self._names

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        if cmd_name not in self._names:
            return None
        if self._prefix + cmd_name not in VERBS:
            return _Verbs(cmd_name, prefix=f"{cmd_name} ", help=_PROJECT)
        module, _ = VERBS[self._prefix + cmd_name]
        command = getattr(import_module(f"mgsgraph.cli.{module}"), cmd_name)
        return command if isinstance(command, click.Command) else None

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        for title, verbs in GROUPS.items():
            if lines := [(verb, help) for verb, (_, help) in verbs.items() if verb.startswith(self._prefix)]:
                with formatter.section(title):
                    formatter.write_dl(lines)

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        if args and not args[0].startswith("-") and args[0] not in self._names:
            raise click.UsageError(f"no command {self._prefix + args[0]!r}; {self._instead(args)}", ctx)
        return super().resolve_command(ctx, args)

    def _instead(self, args: list[str]) -> str:
        """Advice for an unknown verb."""
        if not self._prefix and args[0] in RENAMED:
            return f"it is now: {RENAMED[args[0]]}"
        similar = get_close_matches(args[0], self._names, n=1)
        suggestion = f"did you mean {similar[0]!r}?" if similar else f"there are {', '.join(self._names)}"
        return f"{suggestion} (ground <-> image is now: mgsgraph locate)" if self._prefix else suggestion


@click.group(cls=_Verbs, context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 110})
@click.version_option(package_name="mgsgraph")
def group() -> None:
    """Bundle adjustment of planetary pushbroom images and laser altimetry."""


def main() -> None:
    """Entry point: bad input is one line on standard error and exit status 2."""
    gc.set_threshold(100_000, 50)  # of what imports make, 100,000 objects and more, nothing is garbage
    interrupted = False

    def interrupt(number: int, frame: FrameType | None) -> None:
        nonlocal interrupted
        interrupted = True
        importing = _importing(frame)  # an interrupt there would print a library's traceback: try again later
        signal.setitimer(signal.ITIMER_REAL, _RETRY_IN_IMPORT if importing else _RETRY)
        if not importing and not is_interrupt(sys.exception()):  # none is being handled already
            raise KeyboardInterrupt

    for number in _SIGNALS:  # so that nothing half-written stays behind
        signal.signal(number, interrupt)
    sys.unraisablehook = _unraisable
    guard_streams()
    try:
        _require_limits()
        _require_threads()
        _require_utf8((os.getcwd(), *sys.argv[1:]))
        status = group(standalone_mode=False)
        _end_of_signals()  # all is written, only the interpreter's end is left
        if sys.stdout is not None:  # closed by the caller
            sys.stdout.flush()
    except click.ClickException as error:
        _exit_with(f"error: {_usage_message(error)}", 2)
    except MgsgraphError as error:
        _exit_with(f"error: {error}", 2)
    except MemoryError:
        _exit_with(_OUT_OF_MEMORY, 2)
    except BrokenPipeError:
        os._exit(1)  # whoever read our output has gone; a second attempt to flush it would complain
    except (KeyboardInterrupt, click.exceptions.Abort):
        _exit_with(_INTERRUPTED, 130)
    except OSError as error:
        where = f"{one_line(os.fsdecode(error.filename))}: " if isinstance(error.filename, str | bytes) else ""
        _exit_with(f"error: {where}can't be read or written ({error.strerror or error})", 2)
    except Exception as error:
        if getattr(error, "code", None) == _OPENCV_OUT_OF_MEMORY:
            _exit_with(_OUT_OF_MEMORY, 2)
        if not interrupted:
            raise
        _exit_with(_INTERRUPTED, 130)  # a library that was being imported makes its own error of it
    sys.exit(status or 0)


def _importing(frame: FrameType | None) -> bool:
    """Whether the frame belongs to an import."""
    while frame is not None and not frame.f_code.co_filename.startswith("<frozen importlib"):
        frame = frame.f_back
    return frame is not None


def _require_limits() -> None:
    """Raise MgsgraphError if the address space of the process is too small for the libraries, or where the process may
    open fewer files than kernels and libraries need.
    """
    if sys.platform == "win32":
        return
    import resource

    memory, files = (resource.getrlimit(kind)[0] for kind in (resource.RLIMIT_AS, resource.RLIMIT_NOFILE))
    if memory != resource.RLIM_INFINITY and memory < _LEAST:
        raise MgsgraphError(f"{memory / 1e6:.0f} MB of memory for a process (ulimit -v); expected "
                            f"{_LEAST / 1e6:.0f} MB at least; raise the limit")  # fmt: skip
    if files < _FEWEST_FILES:
        raise MgsgraphError(f"{files} open files for a process (ulimit -n); expected {_FEWEST_FILES}; raise the limit")


def _require_threads() -> None:
    """Raise MgsgraphError for a number of threads that numba does not accept."""
    if (threads := os.environ.get("NUMBA_NUM_THREADS", "1")).lstrip("-").isdecimal() and int(threads) < 1:
        raise MgsgraphError(f"NUMBA_NUM_THREADS: {threads}; expected 1 or more; set another, or none")


def _require_utf8(words: Iterable[str]) -> None:
    """Raise MgsgraphError for a word that is not UTF-8: records, projects and pages can't store such a name."""
    for word in words:
        try:
            word.encode()
        except UnicodeEncodeError:
            found = f"{one_line(word)}: bytes that are no UTF-8"
            raise MgsgraphError(f"{found}; expected a name that is text; rename it") from None


def _end_of_signals() -> None:
    for number in _SIGNALS:
        signal.signal(number, signal.SIG_IGN)


def _unraisable(ignored: "sys.UnraisableHookArgs") -> None:
    """Report an error in a callback of a weak reference or a finalizer, unless it is an interrupt, which is repeated
    anyway.
    """
    if ignored.exc_type is not KeyboardInterrupt:
        sys.__unraisablehook__(ignored)


def _usage_message(error: click.ClickException) -> str:
    """An error of click as one line, with the help command to call."""
    message = one_line(" ".join(error.format_message().split()).rstrip("."), _LONGEST_MESSAGE)
    context = error.ctx if isinstance(error, click.UsageError) else None
    if context is None:
        return message
    if isinstance(error, click.NoSuchOption) and (hint := REMOVED.get(f"{context.info_name} {error.option_name}")):
        return f"No such option {error.option_name!r}; {hint}"
    return f"{message}; see {context.command_path} --help"


def _exit_with(message: str, status: int) -> NoReturn:
    """Print one line on standard error and exit at once, without flushing standard output."""
    _end_of_signals()
    click.echo(f"mgsgraph: {message}", err=True)
    sys.stderr.flush()
    os._exit(status)

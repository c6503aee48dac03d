"""The command line: one thin verb each; nothing here computes. Verbs are imported when they are called."""

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
from mgsgraph.errors import MgsgraphError, one_line

_SIGNALS = signal.SIGINT, signal.SIGTERM, signal.SIGALRM
"""Those that end the program: what it writes is then there as before, or whole."""
_LATER = 0.01
"""s after which an interrupt tries again that came during an import."""
_AGAIN = 0.2
"""s after which one tries again that a library's code, or a callback of it, may have swallowed."""
_INTERRUPTED = "interrupted; results are as they were before, or whole"
_OUT_OF_MEMORY = "error: out of memory; give the machine more or leave images out"
_PROJECT = """Keep a block in a folder, PROJECT, to which images come one after another."""
_LONGEST = 700
"""Characters of what click has against an argument."""
_NO_MEMORY = -4
"""OpenCV's code of it."""
_FEWEST_FILES = 64
_LEAST = 2_000_000_000
"""bytes of address space that the libraries need to be loaded; with less some of them spin, and heed no signal."""


class _Verbs(click.Group):
    """Verbs by name, with their one-line help known before their modules are imported; all, or those of a group of
    verbs whose names begin with `prefix`.
    """

    def __init__(self, *args: Any, prefix: str = "", **given: Any) -> None:
        super().__init__(*args, **given)
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
        """What to give in the place of a verb that isn't there."""
        if not self._prefix and args[0] in RENAMED:
            return f"it is now: {RENAMED[args[0]]}"
        near = get_close_matches(args[0], self._names, n=1)
        others = f"did you mean {near[0]!r}?" if near else f"there are {', '.join(self._names)}"
        return f"{others} (ground <-> image is now: mgsgraph locate)" if self._prefix else others


@click.group(cls=_Verbs, context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 110})
@click.version_option(package_name="mgsgraph")
def group() -> None:
    """Bundle adjustment of planetary pushbroom images and laser altimetry."""


def main() -> None:
    """Entry point: bad input is one line on standard error and exit status 2."""
    interrupted = False

    def interrupt(number: int, frame: FrameType | None) -> None:
        nonlocal interrupted
        interrupted = True
        importing = _importing(frame)  # broken off there, a library's own code prints a traceback: a little later
        signal.setitimer(signal.ITIMER_REAL, _LATER if importing else _AGAIN)
        if not importing and not _ending():
            raise KeyboardInterrupt

    for number in _SIGNALS:  # so that nothing half-written stays behind
        signal.signal(number, interrupt)
    sys.unraisablehook = _unraisable
    guard_streams()
    try:
        _require_memory()
        _require_files()
        _require_threads()
        _require_text((os.getcwd(), *sys.argv[1:]))
        status = group(standalone_mode=False)
        _end_of_signals()  # all is written, only the interpreter's end is left
        if sys.stdout is not None:  # closed by the caller
            sys.stdout.flush()
    except click.ClickException as error:
        _leave(f"error: {_said(error)}", 2)
    except MgsgraphError as error:
        _leave(f"error: {error}", 2)
    except MemoryError:
        _leave(_OUT_OF_MEMORY, 2)
    except BrokenPipeError:
        os._exit(1)  # whoever read our output has gone; a second attempt to flush it would complain
    except (KeyboardInterrupt, click.exceptions.Abort):
        _leave(_INTERRUPTED, 130)
    except OSError as error:
        where = f"{one_line(os.fsdecode(error.filename))}: " if isinstance(error.filename, str | bytes) else ""
        _leave(f"error: {where}can't be read or written ({error.strerror or error})", 2)
    except Exception as error:
        if getattr(error, "code", None) == _NO_MEMORY:
            _leave(_OUT_OF_MEMORY, 2)
        if not interrupted:
            raise
        _leave(_INTERRUPTED, 130)  # a library that was being imported makes its own error of it
    sys.exit(status or 0)


def _importing(frame: FrameType | None) -> bool:
    """Whether an import is going on where the program stands."""
    while frame is not None and not frame.f_code.co_filename.startswith("<frozen importlib"):
        frame = frame.f_back
    return frame is not None


def _ending() -> bool:
    """Whether an interrupt is on its way out, through what cleans up behind it."""
    error = sys.exception()
    while error is not None and not isinstance(error, KeyboardInterrupt):
        error = error.__context__
    return error is not None


def _require_memory() -> None:
    """Raise MgsgraphError where the process may have less address space than the libraries need."""
    if sys.platform == "win32":
        return
    import resource

    limit = resource.getrlimit(resource.RLIMIT_AS)[0]
    if limit != resource.RLIM_INFINITY and limit < _LEAST:
        raise MgsgraphError(f"{limit / 1e6:.0f} MB of memory for a process (ulimit -v); expected {_LEAST / 1e6:.0f} MB "
                            "at least; raise the limit")  # fmt: skip


def _require_files() -> None:
    """Raise MgsgraphError where the process may open fewer files than kernels and libraries need."""
    if sys.platform == "win32":
        return
    import resource

    limit = resource.getrlimit(resource.RLIMIT_NOFILE)[0]
    if limit < _FEWEST_FILES:
        raise MgsgraphError(f"{limit} open files for a process (ulimit -n); expected {_FEWEST_FILES}; raise the limit")


def _require_threads() -> None:
    """Raise MgsgraphError for a number of threads that numba can't take."""
    if (wanted := os.environ.get("NUMBA_NUM_THREADS", "1")).lstrip("-").isdecimal() and int(wanted) < 1:
        raise MgsgraphError(f"NUMBA_NUM_THREADS: {wanted}; expected 1 or more; set another, or none")


def _require_text(words: Iterable[str]) -> None:
    """Raise MgsgraphError for a word whose bytes are no UTF-8: no record, project or page could hold such a name."""
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
    """An error Python could raise nowhere (in a weak reference's callback, a finalizer): an interrupt tries again by
    itself.
    """
    if ignored.exc_type is not KeyboardInterrupt:
        sys.__unraisablehook__(ignored)


def _said(error: click.ClickException) -> str:
    """One line of what click has against an option or an argument, and where to look."""
    message = one_line(" ".join(error.format_message().split()).rstrip("."), _LONGEST)
    context = error.ctx if isinstance(error, click.UsageError) else None
    if context is None:
        return message
    if isinstance(error, click.NoSuchOption) and (new := REMOVED.get(f"{context.info_name} {error.option_name}")):
        return f"No such option {error.option_name!r}; {new}"
    return f"{message}; see {context.command_path} --help"


def _leave(message: str, status: int) -> NoReturn:
    """One line on standard error, and out, without another look at standard output."""
    _end_of_signals()
    click.echo(f"mgsgraph: {message}", err=True)
    sys.stderr.flush()
    os._exit(status)

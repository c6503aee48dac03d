"""Damage files of every kind that the program reads, and command lines; read each in a process of its own.

    python scripts/fuzz.py --minutes 25
    python scripts/fuzz.py "match file" PEDR --minutes 1 --kept /tmp/findings

Hypothesis draws the damage, makes what ends badly as small as it goes, and tries it first the next time: --kept is the
folder of its examples. A file may take 2 GB of memory beyond what the process has, and 10 s (60 s for commands). Prints
a table of how the readings ended, and what ended badly as an entry for tests/fuzz/findings.json; then exit status 1.
"""

import dataclasses
import faulthandler
import json
import math
import os
import pickle
import re
import resource
import shutil
import signal
import sys
import tempfile
import time
import traceback
import warnings
from collections import Counter
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from contextlib import suppress
from enum import Enum, StrEnum
from functools import cache, partial
from multiprocessing import get_context
from pathlib import Path, PurePath
from typing import Any, NamedTuple

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # a fork has no other threads
os.environ.setdefault("NUMBA_NUM_THREADS", "1")
os.environ.setdefault("PROJ_DEBUG", "0")  # as the program has it where it imports rasterio
sys.path.append(str(Path(__file__).resolve().parents[1] / "tests"))  # their writers of files

import msgspec
import numpy as np
from command_server import load
from fuzz_edits import edited
from fuzz_readers import every
from fuzz_seeds import Reader, Seed, obeyed
from hypothesis import HealthCheck, Verbosity, given, settings
from hypothesis.database import DirectoryBasedExampleDatabase
from study import at_least, command, positive, status, table

from mgsgraph.errors import InputError, MgsgraphError

MEMORY = 2 << 30
"""bytes of address space beyond what the process has when it begins."""
LONGEST = 2000
"""Characters of a message."""
_ROOM = tempfile.TemporaryDirectory(prefix="fuzz.", dir="/dev/shm" if Path("/dev/shm").is_dir() else None)
EXAMPLES = 100
"""Files of a round, after which the clock is looked at."""


class End(StrEnum):
    """How reading a file ended."""

    READ = "read"
    REFUSED = "clear error"
    UNCLEAR = "unclear error"
    RAISED = "traceback"
    PRINTED = "printed"
    WRONG = "wrong"
    WRITTEN = "half-written"
    MEMORY = "memory"
    HANG = "hang"
    SIGNAL = "signal"


GOOD = (End.READ, End.REFUSED)


class Outcome(NamedTuple):
    """An end, its message, and what was read, as paths and plain values."""

    end: End
    words: str = ""
    read: dict[str, Any] | None = None


# --- what was read


def flat(value: Any, where: str = "", depth: int = 0) -> Iterator[tuple[str, Any]]:
    """All values in a record by their paths in it."""
    if isinstance(value, np.ndarray):
        yield f"{where}#", (value.shape, value.dtype.str, value.tobytes() if value.dtype != object else repr(value))
        if value.dtype.kind in "fc" and not np.all(np.isfinite(value)):
            yield where, "nan"
    elif isinstance(value, (float, np.floating)):
        yield where, value.hex() if math.isfinite(value) else "nan"
    elif value is None or depth > 12 or isinstance(value, (str, bytes, int, Enum, PurePath, np.generic)):
        yield where, repr(value) if depth <= 12 else type(value).__name__
    elif isinstance(value, dict):
        for key, item in value.items():
            yield from flat(item, f"{where}.{key}", depth + 1)
    elif isinstance(value, (list, tuple, set, frozenset)) and not hasattr(value, "_fields"):
        for k, item in enumerate(sorted(value, key=repr) if isinstance(value, (set, frozenset)) else value):
            yield from flat(item, f"{where}[{k}]", depth + 1)
        yield where, len(value)
    elif not callable(value) or dataclasses.is_dataclass(value):
        yield where, type(value).__name__
        for name in _names(value):
            yield from flat(getattr(value, name, None), f"{where}.{name}", depth + 1)


def _names(value: Any) -> tuple[str, ...]:
    if isinstance(value, msgspec.Struct):
        return value.__struct_fields__
    if dataclasses.is_dataclass(value):
        return tuple(field.name for field in dataclasses.fields(value))
    return getattr(value, "_fields", ()) or tuple(getattr(value, "__dict__", ()))


def _not_finite(read: dict[str, Any]) -> set[str]:
    """Paths of numbers that are not finite, without indices."""
    return {re.sub(r"\[\d+\]", "[]", where) for where, value in read.items() if value == "nan"}


# --- one file, in a process of its own


def outcome(reader: Reader, data: bytes) -> Outcome:
    """How reading ends when a file has this content."""
    folder = Path(_ROOM.name) / str(os.getpid()) / re.sub(r"\W", "_", reader.name)
    seed = _seed(reader)
    _write_files(folder, {**seed.files, seed.main: data})
    before, end, streams = _listing(folder), os.memfd_create("told"), [os.memfd_create(name) for name in ("out", "err")]
    child = os.fork()
    if child == 0:
        try:
            _isolate(reader, streams)
            _report(reader, folder / seed.main, end)
        finally:
            os._exit(0)
    ended = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
    with suppress(ProcessLookupError):
        os.killpg(child, signal.SIGKILL)  # its own child processes
    answer, out, err = (_text(file) for file in (end, *streams))
    errors = err.decode(errors="replace")
    if ended < 0:
        name = signal.Signals(-ended).name
        return Outcome(End.HANG if name == "SIGALRM" else End.SIGNAL, f"{name} {errors[-300:]}")
    by_itself = Outcome(End.READ if reader.read is obeyed else End.SIGNAL, str(ended))
    result: Outcome = pickle.loads(answer) if answer else by_itself
    if reader.read is obeyed:
        result = _of_command(result, errors)
    elif result.end in GOOD and (out or err):
        result = Outcome(End.PRINTED, (out + err).decode(errors="replace")[:300])
    if result.end is End.REFUSED and (changed := sorted(set(before.items()) ^ set(_listing(folder).items()))):
        return Outcome(End.WRITTEN, f"{changed[:3]}; {result.words}")
    return result


@cache
def _seed(reader: Reader) -> Seed:
    return reader.seed()


def _write_files(folder: Path, files: dict[str, bytes]) -> None:
    """Write the files into a folder; for commands also pipes, links and broken files."""
    shutil.rmtree(folder, ignore_errors=True)
    for name, content in files.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(content)
    if "words.json" in files:
        (folder / "folder").mkdir()
        os.mkfifo(folder / "pipe")
        for name, target in (("zero", "/dev/zero"), ("full", "/dev/full"), ("loop", "loop"), ("dangling", "nowhere/x")):
            (folder / name).symlink_to(target)
        for name, content in (("empty", b""), ("broken.isd", b'{"a": '), ("broken.toml", b"[" * 3000)):
            (folder / name).write_bytes(content)


def _listing(folder: Path) -> dict[str, int]:
    """Files by name with their sizes; SQLite's journals are left out."""
    return {
        str(path.relative_to(folder)): path.lstat().st_size if path.is_file() and not path.is_symlink() else -1
        for path in folder.rglob("*") if not path.name.endswith(("-wal", "-shm", "-journal"))
    }  # fmt: skip


def _text(memory: int) -> bytes:
    size = os.fstat(memory).st_size
    text = os.pread(memory, size, 0)
    os.close(memory)
    return text


def _isolate(reader: Reader, streams: list[int]) -> None:
    """No input, output into memory, limits of time and memory; child processes end with this one."""
    os.setpgid(0, 0)
    for number, stream in enumerate((os.open(os.devnull, os.O_RDONLY), *streams)):
        os.dup2(stream, number)
    sys.stdout = os.fdopen(1, "w", closefd=False, errors="backslashreplace")
    sys.stderr = os.fdopen(2, "w", closefd=False, buffering=1, errors="backslashreplace")
    faulthandler.enable(2)
    warnings.simplefilter("always")
    warnings.showwarning = lambda text, kind, *more: print(f"{kind.__name__}: {text}", file=sys.stderr)
    pages = int(Path("/proc/self/statm").read_text().split()[0])
    most = pages * resource.getpagesize() + MEMORY
    resource.setrlimit(resource.RLIMIT_AS, (most, most))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    signal.signal(signal.SIGALRM, signal.SIG_DFL)
    signal.setitimer(signal.ITIMER_REAL, reader.patience)


def _report(reader: Reader, path: Path, end: int) -> None:
    try:
        result = Outcome(End.READ, "", dict(flat(reader.read(path))))
    except SystemExit as ended:
        result = Outcome(End.READ, str(ended.code or 0))
    except BaseException as error:
        result = _of_error(error, str(path.parents[1]))
    sys.stdout.flush()
    os.write(end, pickle.dumps(result))


def _of_error(error: BaseException, folder: str) -> Outcome:
    """How an error ends for a user."""
    text, causes = str(error), [error]
    while (cause := causes[-1].__cause__ or causes[-1].__context__) and len(causes) < 20:
        causes.append(cause)
    frames = [frame for frame in traceback.extract_tb(error.__traceback__) if "/mgsgraph/" in frame.filename]
    place = f"{frames[-1].filename.split('/mgsgraph/')[-1]}:{frames[-1].name}:{frames[-1].lineno}" if frames else "?"
    message = f"{type(error).__name__} at {place}: {ascii(text)[:300]}"
    if any(isinstance(c, MemoryError) for c in causes):
        return Outcome(End.MEMORY, message)
    if not isinstance(error, MgsgraphError):
        return Outcome(End.RAISED, message)
    complete = not isinstance(error, InputError) or (error.where and error.found)
    clear = text.isprintable() and len(text) < LONGEST and folder in text and complete
    return Outcome(End.REFUSED if clear else End.UNCLEAR, message)


def _of_command(result: Outcome, err: str) -> Outcome:
    """How a command ends for a user, by its exit status and messages."""
    lines = [line for line in err.splitlines() if line.strip()]
    if result.end is not End.READ:
        return result
    if "Traceback" in err:
        return Outcome(End.RAISED, err[-300:])
    if result.words == "2":
        clear = len(lines) == 1 and len(err) < 2 * LONGEST and lines[0].expandtabs().isprintable()
        return Outcome(End.REFUSED if clear else End.UNCLEAR, ascii(err)[:300])
    if result.words not in ("0", "1"):  # 130: stopped by the alarm
        return Outcome(End.HANG if result.words == "130" else End.UNCLEAR, f"exit status {result.words}")
    return Outcome(End.PRINTED, err[:300]) if "Warning" in err else result


@cache
def sound(reader: Reader) -> dict[str, Any]:
    """Content of the undamaged file; empty where it is refused."""
    return outcome(reader, _seed(reader).files[_seed(reader).main]).read or {}


def judged(reader: Reader, data: bytes) -> Outcome:
    """As `outcome`; it also judges whether a result is possible."""
    result, right = outcome(reader, data), sound(reader)
    if result.end is not End.READ or reader.read is obeyed:
        return result
    if new := sorted(p for p in _not_finite(result.read or {}) - _not_finite(right) if not p.endswith(reader.gaps)):
        return Outcome(End.WRONG, f"{new[:5]} are not finite")
    return Outcome(End.WRONG, "another result") if reader.same and result.read != right else result


# --- many

Found = tuple[Counter[str], dict[str, Any] | None]
_HUNTS: list[Callable[[], Found]] = []


def hunt(reader: Reader, seconds: float, examples: Path | None = None) -> Found:
    """Try damaged files of a reader for some seconds; how they ended, and the smallest that ended badly."""
    seed, ends, until = _seed(reader), Counter[str](), time.monotonic() + seconds
    original, bad = seed.files[seed.main], list[tuple[bytes, Outcome]]()
    database = None if examples is None else DirectoryBasedExampleDatabase(examples / re.sub(r"\W", "_", reader.name))

    @settings(
        max_examples=EXAMPLES, deadline=None, database=database, derandomize=False, report_multiple_bugs=False,
        suppress_health_check=list(HealthCheck), verbosity=Verbosity.quiet,
    )  # fmt: skip
    @given(edited(original, reader.form))
    def trial(data: bytes) -> None:
        if time.monotonic() > until and not bad:
            return
        result = judged(reader, data)
        ends[result.end] += 1
        if result.end not in GOOD:
            bad.append((data, result))
            raise AssertionError(result.end)

    try:
        while time.monotonic() < until:
            trial()
    except AssertionError:
        data, result = bad[-1]  # Hypothesis runs the smallest once more
        head, tail = _common_start(original, data), _common_start(original[::-1], data[::-1])
        tail = min(tail, min(len(original), len(data)) - head)
        edit = [head, len(original) - tail, [[data[head : len(data) - tail].hex(), 1]]]
        return ends, {"reader": reader.name, "end": str(result.end), "key": result.words, "edits": [edit]}
    return ends, None


def _common_start(left: bytes, right: bytes) -> int:
    """Number of first bytes that are the same."""
    return next((k for k, (a, b) in enumerate(zip(left, right, strict=False)) if a != b), min(len(left), len(right)))


def _hunted(number: int) -> Found:
    return _HUNTS[number]()  # from before the fork: readers hold functions, which can't be sent


def main() -> None:
    """Command line."""
    parser = command(__doc__)
    parser.add_argument("reader", nargs="*", help="readers whose names hold this; all, if none is named")
    parser.add_argument("--minutes", type=positive, default=10.0)
    parser.add_argument("--jobs", type=at_least(1), default=os.cpu_count() or 1)
    parser.add_argument("--kept", type=Path, default=Path(".hypothesis/fuzz"), help="folder of Hypothesis' examples")
    options = parser.parse_args()

    def job() -> int:
        readers = every(options.reader)
        seconds = 60.0 * options.minutes * options.jobs / max(len(readers), 1)
        if any(reader.read is obeyed for reader in readers):
            load()
        for reader in readers:
            _seed(reader)  # once, for all processes
        _HUNTS.extend(partial(hunt, reader, seconds, options.kept) for reader in readers)
        with ProcessPoolExecutor(options.jobs, get_context("fork")) as pool:
            hunts = list(pool.map(_hunted, range(len(readers))))
        rows = [[r.name, *(f"{ends[end]:,}" for end in End)] for r, (ends, _) in zip(readers, hunts, strict=True)]
        print("\n".join(table(("reader", *End), rows)))
        findings = [finding for _, finding in hunts if finding is not None]
        print("\n".join(json.dumps(finding) for finding in findings))
        return int(bool(findings))

    sys.exit(status(parser.prog, job))


if __name__ == "__main__":
    main()

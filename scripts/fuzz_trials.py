"""One damaged file given to one reader: what becomes of it, in the process that reads it.

A worker is a fork with everything imported, which reads one file after the other in a folder in memory; it says in a
page of shared memory which one it is at, so that who watches it knows what killed it.
"""

import faulthandler
import gc
import mmap
import os
import random
import re
import resource
import signal
import struct
import sys
import time
import traceback
import unicodedata
import warnings
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from pathlib import Path
from typing import Any, NamedTuple

from fuzz_mutations import Change, mutated
from fuzz_records import flat, odd_places

from mgsgraph.errors import MgsgraphError

MEMORY = 2 << 30
"""bytes of address space beyond what the process has when it begins."""
PATIENCE = 10.0
"""s that a file may take."""
LONGEST = 2000
"""Characters of a message."""
MOST = 10_000
"""Files that a worker tries before it says what it has found."""
_STATE = struct.Struct("<qd")


class End(StrEnum):
    """What became of a file."""

    SAME = "as undamaged"
    RIGHT = "as an independent reading"
    SOUND = "accepted, not judged"
    REFUSED = "clear error"
    UNCLEAR = "unclear error"
    RAISED = "traceback"
    PRINTED = "printed"
    WRONG = "wrong"
    MEMORY = "memory"
    HANG = "hang"
    SIGNAL = "signal"


GOOD = (End.SAME, End.RIGHT, End.SOUND, End.REFUSED)


class Seed(NamedTuple):
    """Files by their names, and which of them is damaged."""

    files: Mapping[str, bytes]
    main: str


Judge = Callable[[bytes, Any], Iterable[tuple[str, Any, Any]] | None]
"""Of a content and what was read: names, what was read and what an independent reading finds; None for no verdict."""


@dataclass(frozen=True)
class Reader:
    """A way into the program for files from outside."""

    name: str
    read: Callable[[Path], Any]
    seed: Seed
    changes: Sequence[Change]
    owner: str = ""
    """Letter of who mends it."""
    judge: Judge | None = None
    patience: float = PATIENCE
    """s that it may take."""
    share: float = 1.0
    """Of the time that others get."""
    gaps: tuple[str, ...] = ()
    """Ends of the places where what is read may have gaps (NaN)."""


class Outcome(NamedTuple):
    """An end, and for those that are not good what they have in common with others, and the words."""

    end: End
    key: str = ""
    words: str = ""


class Ended(Exception):
    """An end that a reader itself knows: that of a command in a process of its own."""

    def __init__(self, outcome: Outcome) -> None:
        super().__init__(outcome.words)
        self.outcome = outcome


@dataclass
class Tally:
    """What came of some files of one reader."""

    ends: Counter[str] = field(default_factory=Counter)
    unjudged: Counter[str] = field(default_factory=Counter)
    """By kind of damage."""
    found: list[tuple[int, Outcome]] = field(default_factory=list)
    """Numbers of files, and what happened; the first few of each key."""
    seconds: float = 0.0
    slowest: float = 0.0
    next: int = 0

    def add(self, other: "Tally") -> None:
        self.ends += other.ends
        self.unjudged += other.unjudged
        self.seconds += other.seconds
        self.slowest = max(self.slowest, other.slowest)
        keys = Counter(outcome.key for _, outcome in self.found)
        self.found += [one for one in other.found if keys[one[1].key] < 3]
        self.next = other.next


def content_of(reader: Reader, seed: int, number: int) -> tuple[bytes, str]:
    """The damaged file of a number, and the kind of damage; number 0 is the undamaged one."""
    data = reader.seed.files[reader.seed.main]
    return mutated(data, reader.changes, random.Random(f"{seed} {reader.name} {number}")) if number else (data, "none")


# --- judging


def skeleton(text: str) -> str:
    """A message without paths, quotations and numbers."""
    text = re.sub(r"/[\w./~-]*", "/", text.strip())
    return re.sub(r"[-+]?\d[\d.e+-]*|'[^']*'|\"[^\"]*\"", "#", text)[:110]


def _place(error: BaseException) -> str:
    """The innermost line of this program that an error went through."""
    frames = [frame for frame in traceback.extract_tb(error.__traceback__) if "/mgsgraph/" in frame.filename]
    return f"{frames[-1].filename.split('/mgsgraph/')[-1]}:{frames[-1].name}:{frames[-1].lineno}" if frames else "?"


def _causes(error: BaseException | None) -> Iterable[BaseException]:
    while error is not None:
        yield error
        error = error.__cause__ or error.__context__


def of_error(error: BaseException, folder: str) -> Outcome:
    """What an error is to a user."""
    text = str(error)
    if starved := next((one for one in _causes(error) if isinstance(one, MemoryError)), None):
        return Outcome(End.MEMORY, f"MemoryError at {_place(starved)}", text[:300])
    if not isinstance(error, MgsgraphError):
        return Outcome(
            End.RAISED, f"{type(error).__name__} at {_place(error)}", f"{type(error).__name__}: {text}"[:300]
        )
    odd = [mark for mark in text if unicodedata.category(mark) in ("Cc", "Cf", "Cs", "Zl", "Zp")]
    wrong = (
        "many lines" if "\n" in text else f"the character {odd[0]!a}" if odd
        else f"{len(text) // 1000},000 characters" if len(text) >= LONGEST
        else "" if folder in text else "no file named"
    )  # fmt: skip
    if not wrong:
        return Outcome(End.REFUSED)
    return Outcome(End.UNCLEAR, f"{wrong} at {_place(error)}", ascii(text)[:300])


def _agree(found: Any, wanted: Any) -> bool:
    import numpy as np

    if isinstance(wanted, (float, np.ndarray)) or isinstance(found, (float, np.ndarray)):
        found, wanted = np.asarray(found), np.asarray(wanted)
        if found.shape != wanted.shape:
            return False
        if found.dtype.kind in "fiub" and wanted.dtype.kind in "fiub":
            with np.errstate(all="ignore"):
                return bool(np.allclose(found, wanted, rtol=1e-9, atol=1e-9, equal_nan=True))
        return found.tolist() == wanted.tolist()
    return bool(found == wanted)


class Trials:
    """One reader in a folder of its own, and what it makes of the undamaged file."""

    def __init__(self, reader: Reader, folder: Path) -> None:
        self.reader, self.folder = reader, folder / reader.name.replace(" ", "_").replace("/", "_")
        for name, content in reader.seed.files.items():
            path = self.folder / name
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(content)
        self.path = self.folder / reader.seed.main
        try:
            self.sound = flat(self.reader.read(self.path))
        except Ended as ended:
            if ended.outcome.end is not End.REFUSED:
                raise
            self.sound = {}  # a command for which these files are too few
        self.odd = odd_places(self.sound)

    def outcome(self, data: bytes) -> Outcome:
        """What becomes of a content."""
        self.path.unlink(missing_ok=True)
        self.path.write_bytes(data)
        said = list[str]()
        with warnings.catch_warnings():
            warnings.simplefilter("always")
            warnings.showwarning = lambda message, kind, *more: said.append(f"{kind.__name__}: {message}")
            try:
                result = self.reader.read(self.path)
            except Ended as ended:
                outcome = ended.outcome
            except Exception as error:
                outcome = of_error(error, str(self.folder))
            else:
                outcome = self._of_result(data, result)
        if outcome.end in GOOD and said:
            return Outcome(End.PRINTED, f"warning {skeleton(said[0])}", said[0][:300])
        return outcome

    def _of_result(self, data: bytes, result: Any) -> Outcome:
        found = flat(result)
        if found == self.sound:
            return Outcome(End.SAME)
        if new := sorted(one for one in odd_places(found) - self.odd if not one.endswith(self.reader.gaps)):
            return Outcome(End.WRONG, f"not finite: {new[0]}", f"{new[:5]} are not finite")
        if self.reader.judge is None:
            return Outcome(End.SOUND)
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                verdict = self.reader.judge(data, result)
                pairs = None if verdict is None else list(verdict)
        except Exception:  # whatever else reads it, and can't
            return Outcome(End.SOUND)
        if pairs is None:
            return Outcome(End.SOUND)
        for name, read, wanted in pairs:
            if not _agree(read, wanted):
                return Outcome(End.WRONG, f"other {name}", f"{name}: read {read!r:.120}, independently {wanted!r:.120}")
        return Outcome(End.RIGHT)


# --- a worker


class Watch:
    """Which file a worker is at, since when, and what it prints."""

    def __init__(self) -> None:
        self._page = mmap.mmap(-1, mmap.PAGESIZE)
        self.printed = os.memfd_create("fuzz")
        self.say(-1)

    def say(self, number: int) -> None:
        _STATE.pack_into(self._page, 0, number, time.monotonic())

    def now(self) -> tuple[int, float]:
        """Number of the file, and s for which it has been read."""
        number, since = _STATE.unpack_from(self._page)
        return number, time.monotonic() - since

    def text(self) -> str:
        """All that was printed since the last time."""
        size = os.fstat(self.printed).st_size
        text = os.pread(self.printed, min(size, 20_000), 0).decode(errors="replace")
        if size:
            os.ftruncate(self.printed, 0)
            os.lseek(self.printed, 0, os.SEEK_SET)
        return text


def limit_memory() -> None:
    """Allow this process so much more address space."""
    pages = int(Path("/proc/self/statm").read_text().split()[0])
    most = pages * resource.getpagesize() + MEMORY
    resource.setrlimit(resource.RLIMIT_AS, (most, most))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))


def settle_down(watch: Watch) -> None:
    """Make this fork a worker: nothing to read, printing into memory, dumps on signals, little memory."""
    null = os.open(os.devnull, os.O_RDONLY)
    os.dup2(null, 0)
    os.dup2(watch.printed, 1)
    os.dup2(watch.printed, 2)
    sys.stdout = sys.stderr = os.fdopen(watch.printed, "w", closefd=False, buffering=1, errors="replace")
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    faulthandler.enable(2)
    faulthandler.register(signal.SIGUSR1, file=2)
    limit_memory()
    gc.freeze()


def batch(trials: Trials, seed: int, first: int, seconds: float, watch: Watch, keys: Counter[str]) -> Tally:
    """Files from a number on, for some seconds, `MOST` at the most."""
    tally, began = Tally(), time.monotonic()
    now = began
    for number in range(first, first + MOST):
        watch.say(number)
        data, kind = content_of(trials.reader, seed, number)
        before = time.monotonic()
        outcome = trials.outcome(data)
        if printed := watch.text():
            outcome = Outcome(End.PRINTED, f"printed {skeleton(printed)}", printed[:300])
        now = time.monotonic()
        tally.slowest = max(tally.slowest, now - before)
        tally.ends[outcome.end] += 1
        if outcome.end is End.SOUND:
            tally.unjudged[kind] += 1
        if outcome.end not in GOOD:
            keys[outcome.key] += 1
            if keys[outcome.key] <= 2:
                tally.found.append((number, outcome))
        tally.next = number + 1
        if now - began > seconds:
            break
    watch.say(-1)
    tally.seconds = now - began
    return tally

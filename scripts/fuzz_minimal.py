"""The smallest damage that ends as a given one did: the difference to the sound file is taken back piece by piece."""

import difflib
import os
import pickle
import shutil
import signal
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

from fuzz_trials import End, Outcome, Reader, Trials, Watch, settle_down

_LONGEST = 200_000
"""bytes up to which differences are looked for; of larger files the damaged stretch alone."""


class Edit(NamedTuple):
    """Bytes in place of others."""

    start: int
    stop: int
    new: bytes


def _alike(one: bytes, other: bytes) -> int:
    """Number of first bytes that are the same."""
    return next((k for k, (a, b) in enumerate(zip(one, other, strict=False)) if a != b), min(len(one), len(other)))


def edits(sound: bytes, damaged: bytes) -> list[Edit]:
    """What was done to a content."""
    head = _alike(sound, damaged)
    tail = _alike(sound[head:][::-1], damaged[head:][::-1])
    one, other = sound[head : len(sound) - tail], damaged[head : len(damaged) - tail]
    if len(one) * len(other) > 4_000_000 or len(one) + len(other) > _LONGEST:
        return [Edit(head, head + len(one), other)]
    found = difflib.SequenceMatcher(None, one, other, autojunk=False).get_opcodes()
    return [Edit(head + a, head + b, other[c:d]) for tag, a, b, c, d in found if tag != "equal"]


def edited(sound: bytes, changes: list[Edit]) -> bytes:
    """The content with edits, which don't overlap."""
    for change in sorted(changes, reverse=True):
        sound = sound[: change.start] + change.new + sound[change.stop :]
    return sound


def outcome_apart(reader: Reader, data: bytes) -> Outcome:
    """What becomes of one content, in a process of its own that ends afterwards."""
    watch, folder = Watch(), Path(tempfile.mkdtemp(prefix="fuzz_one."))
    answer, told = os.pipe()
    child = os.fork()
    if child == 0:
        try:
            os.chdir(folder)
            settle_down(watch)
            trials = Trials(reader, folder)
            watch.text()
            found = trials.outcome(data)
            if printed := watch.text():
                found = Outcome(End.PRINTED, "printed", printed[:300])
            os.write(told, pickle.dumps(found)[:60_000])
        finally:
            os._exit(0)
    os.close(told)
    until, status = time.monotonic() + reader.patience + 2.0, None
    while time.monotonic() < until and status is None:
        done, state = os.waitpid(child, os.WNOHANG)
        status = os.waitstatus_to_exitcode(state) if done else None
        time.sleep(0.002)
    if status is None:
        os.kill(child, signal.SIGKILL)
        os.waitpid(child, 0)
    content = os.read(answer, 1 << 16)
    os.close(answer)
    shutil.rmtree(folder, ignore_errors=True)
    if status is None:
        return Outcome(End.HANG, "too long")
    if status < 0:
        return Outcome(End.SIGNAL, signal.Signals(-status).name)
    found = pickle.loads(content) if content else Outcome(End.SIGNAL, "ended")
    assert isinstance(found, Outcome)
    return found


def minimal(reader: Reader, data: bytes, wanted: Outcome, seconds: float = 20.0) -> tuple[list[Edit], bool]:
    """Edits of the sound file that end alike, as few and small as can be found in that time; and whether the whole
    damage ended alike in a process of its own.
    """
    sound = reader.seed.files[reader.seed.main]
    until = time.monotonic() + seconds

    def alike(changes: list[Edit]) -> bool:
        found = outcome_apart(reader, edited(sound, changes))
        return found.end is wanted.end and (found.end in (End.HANG, End.SIGNAL, End.PRINTED) or found.key == wanted.key)

    changes = edits(sound, data)
    if not alike(changes):
        return changes, False
    changes = _fewer(changes, alike, until)
    for k in range(len(changes)):
        changes = _shorter(changes, k, alike, until)
    return changes, True


def _fewer(changes: list[Edit], alike: Callable[[list[Edit]], bool], until: float) -> list[Edit]:
    """Halves, quarters ... of the edits left out as long as it ends alike (Zeller & Hildebrandt, 2002)."""
    pieces = 2
    while len(changes) > 1 and time.monotonic() < until:
        size = max(len(changes) // pieces, 1)
        for start in range(0, len(changes), size):
            rest = changes[:start] + changes[start + size :]
            if rest and time.monotonic() < until and alike(rest):
                changes, pieces = rest, max(pieces - 1, 2)
                break
        else:
            if size == 1:
                break
            pieces = min(2 * pieces, len(changes))
    return changes


def _shorter(changes: list[Edit], k: int, alike: Callable[[list[Edit]], bool], until: float) -> list[Edit]:
    """Half of an edit's new bytes left out as long as it ends alike."""
    size = len(changes[k].new) // 2
    while size and time.monotonic() < until:
        new = changes[k].new
        for start in range(0, len(new), size):
            less = [*changes[:k], changes[k]._replace(new=new[:start] + new[start + size :]), *changes[k + 1 :]]
            if time.monotonic() < until and alike(less):
                changes = less
                break
        else:
            size //= 2
            continue
        size = min(size, len(changes[k].new) // 2)
    return changes

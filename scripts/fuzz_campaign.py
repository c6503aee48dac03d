"""Workers, and who watches them: every reader gets the same time, and a worker that dies or hangs is replaced."""

import os
import pickle
import selectors
import shutil
import signal
import struct
import sys
import tempfile
import time
import traceback
from collections import Counter
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path

from fuzz_trials import MOST, End, Outcome, Reader, Tally, Trials, Watch, batch, settle_down, skeleton

_LENGTH = struct.Struct("<q")
_RENEWED = 25
"""Batches after which a worker is replaced, so that what libraries leave behind doesn't count against a file."""

_BEGINNING = 120.0
"""s that a worker may take to read a sound file."""


def _send(channel: int, value: object) -> None:
    data = pickle.dumps(value)
    data = _LENGTH.pack(len(data)) + data
    while data:
        data = data[os.write(channel, data) :]


def _receive(channel: int) -> object:
    """What was sent; None when the other side is gone."""
    data = b""
    while len(data) < 8 or len(data) < 8 + _LENGTH.unpack(data[:8])[0]:
        more = os.read(channel, 1 << 16)
        if not more:
            return None
        data += more
    return pickle.loads(data[8:])


class Worker:
    """A fork that tries files; it works in a folder of its own."""

    def __init__(self, readers: Sequence[Reader], folder: Path, seed: int) -> None:
        self.folder = folder
        self.task: tuple[int, int] | None = None
        self.batches = 0
        self.watch = Watch()
        asked, self._orders = os.pipe()
        self.answers, told = os.pipe()
        sys.stdout.flush()
        self.process = os.fork()
        if self.process == 0:
            os.close(self._orders)
            os.close(self.answers)
            try:
                self._serve(readers, seed, asked, told)
            except BaseException:  # a seed that can't be read: the campaign's own fault, which it says
                traceback.print_exc()
            finally:
                os._exit(1)
        os.close(asked)
        os.close(told)

    def _serve(self, readers: Sequence[Reader], seed: int, asked: int, told: int) -> None:
        shutil.rmtree(self.folder, ignore_errors=True)
        self.folder.mkdir(parents=True)
        os.chdir(self.folder)
        settle_down(self.watch)
        known = dict[int, Trials]()
        keys = dict[int, Counter[str]]()
        while (order := _receive(asked)) is not None:
            which, first, seconds = order  # type: ignore[misc]
            if which not in known:
                known[which] = Trials(readers[which], self.folder)
                self.watch.text()
            _send(told, batch(known[which], seed, first, seconds, self.watch, keys.setdefault(which, Counter())))
        os._exit(0)

    def order(self, which: int, first: int, seconds: float) -> None:
        self.task, self.batches = (which, first), self.batches + 1
        self.watch.say(-1)
        _send(self._orders, (which, first, seconds))

    def answer(self) -> Tally | None:
        """What the batch gave; None when the worker has died."""
        found = _receive(self.answers)
        self.task = None
        return found if isinstance(found, Tally) else None

    def kill(self) -> None:
        """With a look at where it is."""
        os.kill(self.process, signal.SIGUSR1)
        time.sleep(0.2)
        os.kill(self.process, signal.SIGKILL)

    def end(self) -> None:
        """At once: it is waiting for an order, or hangs, or is gone."""
        with suppress(OSError):
            os.kill(self.process, signal.SIGKILL)
            self.status()

    def status(self) -> int:
        """Exit status (below zero for a signal) of one that has died."""
        os.close(self._orders)
        os.close(self.answers)
        return os.waitstatus_to_exitcode(os.waitpid(self.process, 0)[1])


def _stack(text: str) -> str:
    """The innermost line of this program in what faulthandler printed."""
    lines = [line.strip() for line in text.splitlines() if "/mgsgraph/" in line and line.strip().startswith("File")]
    return lines[0].split("/mgsgraph/")[-1].replace('"', "") if lines else skeleton(text)


def require_sound(readers: Sequence[Reader]) -> None:
    """End the program unless every reader can read its seed."""
    sys.stdout.flush()
    child = os.fork()
    if child == 0:
        status = 0
        with tempfile.TemporaryDirectory() as folder:
            for reader in readers:
                try:
                    Trials(reader, Path(folder))
                except Exception as error:
                    print(f"the seed of {reader.name}: {type(error).__name__}: {error}", file=sys.stderr)
                    status = 1
        os._exit(status)
    if os.waitpid(child, 0)[1]:
        raise SystemExit("a reader can't read its own seed")


class Campaign:
    """Files for all readers, each getting the same time, until there are enough of them or the time is over."""

    def __init__(self, readers: Sequence[Reader], seed: int, jobs: int) -> None:
        self.readers, self.seed, self.jobs = readers, seed, jobs
        self.tallies = [Tally(next=0) for _ in readers]
        self.folder = Path(tempfile.mkdtemp(prefix="fuzz.", dir="/dev/shm" if Path("/dev/shm").is_dir() else None))
        self._busy = Counter[int]()
        self._length = 0.3
        self._dealt = Counter[int]()

    @property
    def inputs(self) -> int:
        """Files that were read so far."""
        return sum(tally.ends.total() for tally in self.tallies)

    def run(self, inputs: int, seconds: float, show: Callable[[str], None]) -> None:
        workers = [Worker(self.readers, self.folder / str(k), self.seed) for k in range(self.jobs)]
        until = time.monotonic() + seconds
        self._length = min(max(seconds * self.jobs / len(self.readers) / 5.0, 0.3), 3.0)
        look = selectors.DefaultSelector()
        try:
            for worker in workers:
                self._give(worker, look)
            while look.get_map():
                for key, _ in look.select(0.5):
                    worker = key.data
                    look.unregister(worker.answers)
                    which = self._took(worker)
                    self._busy[which] -= 1
                    if worker.task is not None or worker.batches >= _RENEWED:
                        worker = self._renewed(worker, workers)
                    if time.monotonic() < until and self.inputs < inputs:
                        self._give(worker, look)
                for worker in workers:
                    number, since = worker.watch.now()
                    if worker.task is not None and since > max(
                        self.readers[worker.task[0]].patience, _BEGINNING * (number < 0)
                    ):
                        worker.kill()
                show(f"{self.inputs} files, {sum(len(tally.found) for tally in self.tallies)} findings")
        finally:
            for worker in workers:
                worker.end()
            shutil.rmtree(self.folder, ignore_errors=True)

    def _give(self, worker: Worker, look: selectors.BaseSelector) -> None:
        """The reader that had the least time, and nobody's at work on it if that can be."""
        which = min(range(len(self.readers)),
        key=lambda k: ((self.tallies[k].seconds + self._length * self._busy[k]) / self.readers[k].share, k))
        self._busy[which] += 1
        first = self._dealt[which]
        self._dealt[which] += MOST
        worker.order(which, first, self._length)
        look.register(worker.answers, selectors.EVENT_READ, worker)

    def _took(self, worker: Worker) -> int:
        """Take a worker's answer, or what it died of; its `task` stays where it is gone."""
        assert worker.task is not None
        which, first = worker.task
        tally = worker.answer()
        if tally is not None:
            if self._dealt[which] == first + MOST:
                self._dealt[which] = tally.next
            self.tallies[which].add(tally)
            return which
        worker.task = (which, first)
        number, since = worker.watch.now()
        text = worker.watch.text()
        hung = since > self.readers[which].patience
        status = worker.status()
        if status == 1 and not hung:
            raise SystemExit(f"{self.readers[which].name}, file {number}: a fault of this script:\n{text}")
        end = End.HANG if hung else End.SIGNAL
        how = "too long" if hung else signal.Signals(-status).name if status < 0 else f"exit {status}"
        words = f"{how} in {_stack(text)}"
        lost = Tally(
            Counter({str(end): 1}),
            found=[(max(number, 0), Outcome(end, words, text[:300]))],
            seconds=max(since, 0.1),
            next=number + 1,
        )
        lost.slowest = since
        if self._dealt[which] == first + MOST and number >= 0:
            self._dealt[which] = number + 1
        self.tallies[which].add(lost)
        return which

    def _renewed(self, worker: Worker, workers: list[Worker]) -> Worker:
        if worker.task is None:
            worker.end()
        new = Worker(self.readers, worker.folder, self.seed)
        workers[workers.index(worker)] = new
        return new

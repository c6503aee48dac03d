"""A cluster for the time of some work: started or reached, checked, given tasks, and left as it was."""

import logging
import os
import signal
import sys
import threading
import time
import warnings
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import CancelledError
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass, replace
from importlib.util import find_spec
from pathlib import Path
from queue import Empty, SimpleQueue
from typing import Any, TypeVar

from mgsgraph.adjustment.cluster.workers import (
    GIGA,
    OPTION,
    ClusterAddress,
    Worker,
    known_workers,
    parse_cluster,
    require_memory,
    require_same_versions,
    require_visible_file,
    threads_of_each,
)
from mgsgraph.atomic_write import scratch
from mgsgraph.errors import InputError, SolverError
from mgsgraph.record import Record

TIMEOUT = 10.0
"""s after which a scheduler that doesn't answer, or has no worker, is given up."""
LEAST_MEMORY = 0.4 * GIGA
"""bytes: a worker with Python, GTSAM, numba and the kernel takes 0.17 GB, drawing figures as much again."""
_BEAT = 1.0
"""s between two looks at whether the cluster is still there."""
_RETURN = 60.0
"""s in which workers may come back when none is left."""
_GRACE = 2.0
"""s after which a connection that should have been given up is."""

_Item = TypeVar("_Item")
_Result = TypeVar("_Result")
_alone = threading.Lock()
"""Lock of the task that runs in this process: SPICE's kernel pool and the partitions serve one task at a time, and a
sweep's own threads already take every core."""


@dataclass(frozen=True, slots=True)
class Lost:
    """A task without a result."""

    message: str
    """Why, in words."""


class Connection(Record):
    """An open cluster; made by `open_cluster`."""

    def __init__(self, client: Any, where: str, timeout: float) -> None:
        self.client = client
        self.where = where
        self._timeout = timeout
        self._limit = min((worker.memory_limit for worker in self.workers), default=0)

    def __repr__(self) -> str:
        return f"Connection({self.where!r})"

    @property
    def workers(self) -> tuple[Worker, ...]:
        """Workers that are there now."""
        return known_workers(self.client)

    def require_memory(self, needed: float, what: str, remedy: str) -> None:
        """Raise InputError where a worker's memory limit lies below `needed` bytes for `what`."""
        require_memory(self.workers, needed, what, self.where, remedy)

    def require_visible_file(self, path: Path) -> None:
        """Raise InputError where a worker does not see a file as it is here."""
        require_visible_file(self.client, path, self.where, self._timeout)

    def each(
        self, function: Callable[[_Item], _Result], items: Sequence[_Item]
    ) -> Iterator[tuple[int, _Result | Lost]]:
        """Give each item to a worker, no more at a time than there are workers; results as they come.

        A task whose worker dies is begun again on another; one that has brought down several is lost.

        Parameters
        ----------
        function : callable
            A function of this package, known to the workers by its name; its own errors are its result.
        items : sequence
            What pickle can carry.

        Yields
        ------
        (int, result)
            Place of the item, and what the function returned or why there is nothing.

        Raises
        ------
        SolverError
            When the scheduler or the last worker has gone.
        """
        import distributed

        waiting, running = deque(enumerate(items)), dict[Any, int]()
        last_seen = time.monotonic()
        try:
            while waiting or running:
                count = len(self.addresses())
                now = time.monotonic()
                last_seen = now if count else last_seen
                if now - last_seen > _RETURN:
                    raise SolverError(f"{self.where}: no worker is left; start workers, and run this again")
                while waiting and len(running) < max(count, 1):
                    place, item = waiting.popleft()
                    running[self.client.submit(_by_itself, function, item, pure=False)] = place
                try:
                    with self.client.as_current():
                        done = distributed.wait(list(running), timeout=_BEAT, return_when="FIRST_COMPLETED").done
                except distributed.TimeoutError:
                    continue
                except distributed.CancelledError as error:
                    raise self._no_scheduler() from error
                for future in done:
                    yield running.pop(future), self._outcome(future)
        finally:
            if self.client.status == "running":
                self.client.cancel(list(running), force=True)

    def at_workers(
        self, function: Callable[[_Item], _Result], orders: Mapping[int, tuple[str, _Item]]
    ) -> Iterator[tuple[int, _Result | Lost | None]]:
        """Give items to the workers that are named with them, all at once; results as they come.

        Parameters
        ----------
        function : callable
            As in `each`.
        orders : mapping
            Address of the worker, and the item, by any number.

        Yields
        ------
        (int, result)
            Number of the order, and what the function returned, why it failed, or None where the worker has gone.

        Raises
        ------
        SolverError
            When the scheduler has gone.
        """
        answers: SimpleQueue[tuple[int, _Result | Lost | None]] = SimpleQueue()

        def ask(number: int, address: str, item: _Item) -> None:
            answers.put((number, self._asked(function, address, item)))

        for number, (address, item) in orders.items():
            threading.Thread(target=ask, args=(number, address, item), daemon=True).start()
        waiting = set(orders)
        while waiting:
            try:
                come = [answers.get(timeout=_BEAT)]
            except Empty:  # of a worker that has gone there may be no word for long
                present = self.addresses()
                come = [(number, None) for number in sorted(waiting) if orders[number][0] not in present]
            for number, answer in come:
                if number in waiting:
                    waiting.remove(number)
                    yield number, answer

    def _asked(self, function: Callable[[_Item], _Result], address: str, item: _Item) -> _Result | Lost | None:
        """Call a function on a worker: by dask's direct calls, which take 3 ms where a task takes 15."""
        try:
            answer = self.client.run(_aside, function, item, workers=[address], on_error="return").get(address)
        except (OSError, ValueError, RuntimeError, CancelledError):  # no client, no scheduler, or neither any more
            return None
        if isinstance(answer, OSError):  # dask's CommClosedError, too
            return None
        return _lost(answer) if isinstance(answer, Exception) else answer

    def call_all(self, function: Callable[[_Item], None], item: _Item) -> None:
        """Call a function on every worker that is there; one that isn't need not know."""
        if self.client.status == "running":
            with suppress(OSError, ValueError, RuntimeError):
                self.client.run(function, item, on_error="ignore")

    def addresses(self) -> frozenset[str]:
        """Addresses of the workers that are there now."""
        try:
            return frozenset(self.client.nthreads())
        except (OSError, ValueError, RuntimeError) as error:  # dask's CommClosedError, or a client that has given up
            raise self._no_scheduler() from error

    def _outcome(self, future: Any) -> Any:
        """Result of a task that is over."""
        import distributed

        if future.status == "finished":
            return future.result()
        if future.status != "error":
            raise self._no_scheduler()
        error = future.exception()
        if isinstance(error, distributed.KilledWorker):
            limit = f" (memory limit {self._limit / GIGA:.2f} GB)" if self._limit else ""
            return Lost(f"each of the {error.allowed_failures + 1} workers that tried it died{limit}")
        return _lost(error)

    def _no_scheduler(self) -> SolverError:
        return SolverError(f"{self.where}: the scheduler has gone; start it, and run this again")


async def _aside(function: Callable[[_Item], _Result], item: _Item) -> _Result | Lost:
    """On a worker: in a thread, so that it goes on answering the scheduler."""
    import asyncio

    try:
        return await asyncio.to_thread(_by_itself, function, item)
    except Exception as error:  # any error of the function: else it would look like a lost connection
        return _lost(error)


def _lost(error: Exception) -> Lost:
    return Lost(f"{type(error).__name__}: {' '.join(str(error).split())}")


def _by_itself(function: Callable[[_Item], _Result], item: _Item) -> _Result:
    """On a worker: one task at a time, whatever number of threads it offers."""
    with _alone:
        return function(item)


@contextmanager
def open_cluster(
    text: str, timeout: float = TIMEOUT, most: int | None = None, insecure: bool = False
) -> Iterator[Connection]:
    """A cluster whose workers are fit for the work.

    Parameters
    ----------
    text : str
        ``local``, ``local:N`` or ``tls://host:port``; ``tcp://host:port`` where `insecure`.
    timeout : float
        s to wait for a scheduler and its workers.
    most : int, optional
        Workers of our own beyond this number would have nothing to do, and are not started.
    insecure : bool
        Allow ``tcp://``, without certificates: anyone who reaches such a scheduler or worker runs code as its user.

    Yields
    ------
    Connection

    Raises
    ------
    InputError
        A place that can't be understood or reached, dask not installed, or a worker without what the work needs.

    Examples
    --------
    >>> with mgsgraph.open_cluster("local:1") as cluster:
    ...     print(mgsgraph.adjust_network(network, mgsgraph.SolverSettings(), cluster=cluster).converged)
    True
    """
    place = parse_cluster(text, insecure)
    if place.local and most is not None:
        place = replace(place, workers=min(place.workers, most))
    where = f"{OPTION} {place.text}"
    for package in ("distributed", "cryptography") if place.local else ("distributed",):
        if find_spec(package) is None:
            remedy = 'pip install "mgsgraph[cluster]", or leave it out'
            raise InputError(where, f"{package} is not installed", remedy=remedy)
    with ExitStack() as stack:
        stack.enter_context(_quiet_log())
        reach = _start if place.local else _reach
        client = stack.enter_context(reach(place, where, timeout))
        require_same_versions(client, where)
        connection = Connection(client, where, timeout)
        connection.require_memory(LEAST_MEMORY, "the program alone", "give the workers more memory (--memory-limit)")
        yield connection


@contextmanager
def _start(place: ClusterAddress, where: str, timeout: float) -> Iterator[Any]:
    """Worker processes of this one, which end with it."""
    import distributed

    from mgsgraph.adjustment.cluster.own import own_cluster

    memory = int(distributed.system.MEMORY_LIMIT // place.workers)
    if memory < LEAST_MEMORY:
        raise InputError(
            where,
            f"{memory / GIGA:.2f} GB of memory for each of {place.workers} workers",
            f"at least {LEAST_MEMORY / GIGA:.2f} GB",
            f"ask for fewer: local:{max(1, int(distributed.system.MEMORY_LIMIT // LEAST_MEMORY))}",
        )
    before, changed = dict(os.environ), dict[str, str | None]()
    with ExitStack() as stack:
        stack.callback(_restored, changed)
        folder = stack.enter_context(scratch())
        try:
            with interrupts_deferred(), children_without_interrupts():
                threads = threads_of_each(place.workers)
                cluster = own_cluster(place.workers, memory, threads, logging.CRITICAL, folder)
                stack.callback(_close, cluster)
                changed |= {name: before.get(name) for name in os.environ if os.environ[name] != before.get(name)}
        except (OSError, RuntimeError) as error:
            message = " ".join(str(error).split())
            raise InputError(where, f"the workers can't be started ({message})", remedy="ask for fewer") from None
        client = distributed.Client(cluster, set_as_default=False)
        stack.callback(_close, client)
        yield client


@contextmanager
def _reach(place: ClusterAddress, where: str, timeout: float) -> Iterator[Any]:
    """A client of a scheduler that somebody else has started and will stop."""
    import distributed

    if place.address.startswith("tls://"):
        try:
            missing = "" if distributed.Security().get_connection_args("client")["ssl_context"] else "none is named"
        except OSError as error:  # ssl's errors, too
            missing = str(error)
        if missing:
            found, expected = f"no certificates for tls ({missing})", "ca-file, client.cert and client.key, PEM files"
            raise InputError(where, found, expected, "name them in dask's configuration, distributed.comm.tls")
    client = _client(place.address, where, timeout)
    with ExitStack() as stack:
        stack.callback(_close, client)
        try:
            client.wait_for_workers(1, timeout=timeout)
        except distributed.TimeoutError:
            remedy = f"start some (dask worker {place.address})"
            raise InputError(where, "a scheduler without workers", remedy=remedy) from None
        yield client


def _close(what: Any) -> None:
    """Close a cluster or a client completely, even if signals arrive."""
    with interrupts_deferred():
        what.close()


def _client(address: str, where: str, timeout: float) -> Any:
    """A client, made in a thread: where another program than a scheduler answers, dask waits forever."""
    import distributed

    clients: list[Any] = []
    failures: list[Exception] = []

    def ask() -> None:
        try:
            clients.append(distributed.Client(address, timeout=timeout, set_as_default=False))
        except Exception as error:  # raised below, in the caller's thread
            failures.append(error)

    asking = threading.Thread(target=ask, daemon=True)
    asking.start()
    asking.join(timeout + _GRACE)
    if clients:
        return clients[0]
    for error in failures:
        if not isinstance(error, OSError):  # which dask's time-out is, too
            message = " ".join(str(error).split())
            remedy = "compare the versions of dask on both machines"
            raise InputError(where, f"the scheduler can't be talked to ({message})", remedy=remedy)
    remedy = "start one (dask scheduler), correct the address, or compare the certificates of both"
    raise InputError(where, f"no scheduler answers there within {timeout:g} s", remedy=remedy)


@contextmanager
def _quiet_log() -> Iterator[None]:
    """Without dask's log on standard error: problems reach the user as errors of mgsgraph."""
    import distributed  # sets the log up

    handlers = logging.getLogger("distributed").handlers
    levels = [handler.level for handler in handlers]
    try:
        for handler in handlers:
            handler.setLevel(logging.CRITICAL + 1)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", distributed.versions.VersionMismatchWarning)  # versions are looked at below
            yield
    finally:
        for handler, level in zip(handlers, levels, strict=True):
            handler.setLevel(level)


def _restored(variables: dict[str, str | None]) -> None:
    """Give environment variables their earlier values; dask sets some for its workers in this process."""
    for name, value in variables.items():
        if value is None:
            os.environ.pop(name, None)
        else:
            os.environ[name] = value


@contextmanager
def interrupts_deferred() -> Iterator[None]:
    """Ctrl-C and the request to end wait until this is over."""
    if threading.current_thread() is not threading.main_thread():  # signals don't reach other threads
        yield
        return
    arrived: list[int] = []
    numbers = (signal.SIGINT, signal.SIGTERM)
    before = {number: signal.signal(number, lambda came, frame: arrived.append(came)) for number in numbers}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, signal.SIG_DFL if handler is None else handler)
        for came in arrived[:1]:
            signal.raise_signal(came)


@contextmanager
def children_without_interrupts() -> Iterator[None]:
    """Ctrl-C in the terminal reaches this program, which then ends its workers, and not the workers themselves.

    A signal that is blocked stays blocked in all threads and processes that begin from here.
    """
    if sys.platform == "win32":
        yield
        return
    from multiprocessing import resource_tracker

    resource_tracker.ensure_running()  # multiprocessing's, which unblocks it when the first process begins
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)

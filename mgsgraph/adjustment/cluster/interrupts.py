"""Signals while a cluster begins and ends: an interrupt in the middle would leave processes behind."""

import signal
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from multiprocessing import resource_tracker


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
    resource_tracker.ensure_running()  # multiprocessing's, which unblocks it when the first process begins
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)

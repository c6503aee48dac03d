"""Progress while a command runs: bars for iterations and stages, and a message while kernels are compiled."""

import math
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from typing import TYPE_CHECKING, Any

import click
from tqdm import tqdm

from mgsgraph.cli.options import details
from mgsgraph.compiled import is_compiling
from mgsgraph.workers import Stages

if TYPE_CHECKING:
    from mgsgraph.adjustment.settings import Iteration

_EXPLAIN_AFTER = 4.0
"""s of compiling until the message appears."""
_DELAY = 2.0
"""s until a bar appears; shorter work shows none."""
_INTERVAL = 0.5
"""s between two updates."""
_SMALL_STEP = 1e-6
"""Posterior sigmas: upper limit of the last step, for the estimate of the time left."""


@contextmanager
def _watched_by(watch: Callable[[threading.Event], None]) -> Iterator[None]:
    """Run a function in another thread during the work; it receives an event that is set when the work ends."""
    finished = threading.Event()
    watching = threading.Thread(target=watch, args=(finished,), daemon=True)
    watching.start()
    try:
        yield
    finally:
        finished.set()
        watching.join()


@contextmanager
def _refreshed(bar: Callable[[], "tqdm[None]"]) -> Iterator[None]:
    """Show a bar after two seconds and refresh its clock, also during long parts of the work."""

    def tick(finished: threading.Event) -> None:
        wait = _DELAY
        while not finished.wait(wait):
            bar().refresh()
            wait = _INTERVAL

    try:
        with _watched_by(tick):
            yield
    finally:
        bar().close()


@contextmanager
def iteration_bar() -> Iterator["IterationBar"]:
    """Bar of iterations on standard error (if it is a terminal); with --details one line for each iteration."""
    bar = IterationBar(details())
    with _refreshed(lambda: bar.bar), word_of_compiling():
        yield bar


@contextmanager
def counting_bar(label: str, unit: str) -> Iterator[Callable[[int, int], None]]:
    """Bar over a known number of items, on standard error (if it is a terminal) after two seconds; for bytes (unit B)
    with the rate. The number of items may grow.
    """
    bar = _bar(desc=label, unit=unit, unit_scale=unit == "B")
    with _refreshed(lambda: bar):
        yield partial(_count, bar)


@contextmanager
def counting_bars() -> Iterator[Callable[[str, int, int], None]]:
    """Bars for several stages, each with a known number of items: one bar after the other."""
    bar, shown = _bar(), ""

    def show(label: str, done: int, most: int) -> None:
        nonlocal bar, shown
        if shown != label:
            bar.close()
            bar, shown = _bar(desc=label), label
        _count(bar, done, most)

    with _refreshed(lambda: bar):
        yield show


def _count(bar: "tqdm[None]", done: int, most: int) -> None:
    bar.total = most
    bar.update(done - bar.n)


def _bar(**options: Any) -> "tqdm[None]":
    return tqdm(leave=False, disable=None, delay=_DELAY, **options)


@contextmanager
def word_of_compiling() -> Iterator[None]:
    """Print once that numeric kernels are being compiled, if that takes several seconds."""

    def watch(finished: threading.Event) -> None:
        compiling = 0.0
        while compiling < _EXPLAIN_AFTER:
            if finished.wait(_INTERVAL):
                return
            compiling += _INTERVAL * is_compiling()
        click.echo("compiling the numeric kernels, once after an installation: about a minute", err=True)

    with _watched_by(watch):
        yield


@contextmanager
def stage(label: str) -> Iterator[None]:
    """Bar of a single stage."""
    with stage_bar(1) as stages, stages.stage(label):
        yield


def passing_word(sentence: str) -> None:
    """Print a sentence above the present bar, on standard error if it is a terminal."""
    if sys.stderr.isatty():
        tqdm.write(sentence, file=sys.stderr)


class IterationBar:
    """Bar of iterations; called with every iteration."""

    def __init__(self, verbose: bool) -> None:
        self._verbose, self._count, self._step, self._began = verbose, 0, math.inf, time.monotonic()
        self.bar = _bar(desc="adjusting", bar_format="{desc}: iteration {n_fmt}, {elapsed}{postfix}")

    def __call__(self, now: "Iteration") -> None:
        """Show one step, accepted or rejected."""
        self._count += 1
        if self._verbose:
            if self._count == 1:
                tqdm.write("iteration           cost       decrease   step [sigma]   damping")
            rejection = "" if now.accepted else "   rejected"
            tqdm.write(
                f"{self._count:9d} {now.cost:14.6f} {now.decrease:14.4e} {now.step:14.4e} {now.damping:9.1e}{rejection}"
            )
        time_left = ""
        if _SMALL_STEP < now.step < self._step < math.inf:  # if steps shrink at the same rate
            steps = math.log(now.step / _SMALL_STEP) / math.log(self._step / now.step)
            time_left = f", about {steps * (time.monotonic() - self._began) / self._count:.0f} s left"
        self._step = now.step
        self.bar.set_postfix_str(f"cost {now.cost:.6g}{time_left}", refresh=False)
        self.bar.update()


@contextmanager
def stage_bar(count: int) -> Iterator[Stages]:
    """Bar of `count` stages: the present stage, the time since the first, and the time left of a stage that counts its
    parts.
    """
    bar = _bar(total=count, bar_format=("{n_fmt}/{total_fmt} " if count > 1 else "") + "{desc} {elapsed}")
    begun = list[tuple[str, float]]()

    def announce(stage: str) -> None:
        bar.update(bool(begun))
        begun.append((stage, time.monotonic()))
        bar.set_description_str(stage, refresh=False)

    def detail(label: str, done: int, most: int) -> None:
        stage, since = begun[-1]
        seconds_left = (time.monotonic() - since) * (most - done) / max(done, 1)
        bar.set_description_str(f"{stage}, {label} {done / most:.0%}, {seconds_left:.0f} s left", refresh=False)

    with _refreshed(lambda: bar):
        yield Stages(announce, detail)

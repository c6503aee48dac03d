"""Progress while a command runs: bars over iterations and stages, and a word when the kernel is being compiled."""

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
    from mgsgraph.adjustment.optimize import Iteration

_EXPLAIN_AFTER = 4.0
"""s of compiling after which it is said."""
_SHORTLY = 2.0
"""s before a bar appears: what is done sooner needs none."""
_BEAT = 0.5
"""s between two looks at the clock."""
_SMALL = 1e-6
"""Posterior sigmas that the last step is shorter than."""


@contextmanager
def _beside(watch: Callable[[threading.Event], None]) -> Iterator[None]:
    """Call a function in a thread of its own, with an event that is set when the work is over."""
    over = threading.Event()
    watching = threading.Thread(target=watch, args=(over,), daemon=True)
    watching.start()
    try:
        yield
    finally:
        over.set()
        watching.join()


@contextmanager
def _ticking(bar: Callable[[], "tqdm[None]"]) -> Iterator[None]:
    """Show a bar from two seconds on, and its clock running, however long the part takes that is under way."""

    def tick(over: threading.Event) -> None:
        wait = _SHORTLY
        while not over.wait(wait):
            bar().refresh()
            wait = _BEAT

    try:
        with _beside(tick):
            yield
    finally:
        bar().close()


@contextmanager
def iteration_bar() -> Iterator["IterationBar"]:
    """Progress over iterations on standard error (where that is a terminal); one line each with --details."""
    bar = IterationBar(details())
    with _ticking(lambda: bar.bar), word_of_compiling():
        yield bar


@contextmanager
def counting_bar(what: str, unit: str) -> Iterator[Callable[[int, int], None]]:
    """Progress over a known number of things, on standard error (where that is a terminal) after two seconds; of bytes,
    unit B, with their rate. The number may grow as more becomes known.
    """
    bar = _bar(desc=what, unit=unit, unit_scale=unit == "B")
    with _ticking(lambda: bar):
        yield partial(_count, bar)


@contextmanager
def counting_bars() -> Iterator[Callable[[str, int, int], None]]:
    """The same for work in several stages, each of a known number of parts: one bar after the other."""
    bar, shown = _bar(), ""

    def show(what: str, done: int, most: int) -> None:
        nonlocal bar, shown
        if shown != what:
            bar.close()
            bar, shown = _bar(desc=what), what
        _count(bar, done, most)

    with _ticking(lambda: bar):
        yield show


def _count(bar: "tqdm[None]", done: int, most: int) -> None:
    bar.total = most
    bar.update(done - bar.n)


def _bar(**given: Any) -> "tqdm[None]":
    return tqdm(leave=False, disable=None, delay=_SHORTLY, **given)


@contextmanager
def word_of_compiling() -> Iterator[None]:
    """Say what takes long where nothing shows it, once: that numeric kernels are being compiled, where they are."""

    def watch(over: threading.Event) -> None:
        compiling = 0.0
        while compiling < _EXPLAIN_AFTER:
            if over.wait(_BEAT):
                return
            compiling += _BEAT * is_compiling()
        click.echo("compiling the numeric kernel, once after an installation: one to two minutes", err=True)

    with _beside(watch):
        yield


@contextmanager
def stage(what: str) -> Iterator[None]:
    """A single stage that shows itself."""
    with stage_bar(1) as stages, stages.stage(what):
        yield


def passing_word(sentence: str) -> None:
    """A sentence while something is under way, above its bar; on standard error, where that is a terminal."""
    if sys.stderr.isatty():
        tqdm.write(sentence, file=sys.stderr)


class IterationBar:
    """Called with every iteration."""

    def __init__(self, verbose: bool) -> None:
        self._verbose, self._count, self._step, self._began = verbose, 0, math.inf, time.monotonic()
        self.bar = _bar(desc="adjusting", bar_format="{desc}: iteration {n_fmt}, {elapsed}{postfix}")

    def __call__(self, now: "Iteration") -> None:
        """Show one step that was tried."""
        self._count += 1
        if self._verbose:
            if self._count == 1:
                tqdm.write("iteration           cost       decrease   step [sigma]   damping")
            taken = "" if now.accepted else "   rejected"
            tqdm.write(
                f"{self._count:9d} {now.cost:14.6f} {now.decrease:14.4e} {now.step:14.4e} {now.damping:9.1e}{taken}"
            )
        left = ""
        if _SMALL < now.step < self._step < math.inf:  # steps go on shrinking as they do
            steps = math.log(now.step / _SMALL) / math.log(self._step / now.step)
            left = f", about {steps * (time.monotonic() - self._began) / self._count:.0f} s left"
        self._step = now.step
        self.bar.set_postfix_str(f"cost {now.cost:.6g}{left}", refresh=False)
        self.bar.update()

    def begin(self, what: str) -> None:
        """Count anew, under another name: one of several adjustments."""
        if self._verbose:
            tqdm.write(what)
        self._count, self._step, self._began = 0, math.inf, time.monotonic()
        self.bar.reset()
        self.bar.set_description_str(what)


@contextmanager
def stage_bar(count: int) -> Iterator[Stages]:
    """Stages that show themselves: which of `count` is running, for how long all of them have, and the time left of one
    that counts its parts.
    """
    bar = _bar(total=count, bar_format=("{n_fmt}/{total_fmt} " if count > 1 else "") + "{desc} {elapsed}")
    begun = list[tuple[str, float]]()

    def announce(stage: str) -> None:
        bar.update(bool(begun))
        begun.append((stage, time.monotonic()))
        bar.set_description_str(stage, refresh=False)

    def detail(what: str, done: int, most: int) -> None:
        stage, since = begun[-1]
        left = (time.monotonic() - since) * (most - done) / max(done, 1)
        bar.set_description_str(f"{stage}, {what} {done / most:.0%}, {left:.0f} s left", refresh=False)

    with _ticking(lambda: bar):
        yield Stages(announce, detail)

"""Progress while a command runs: bars over iterations and stages, and a word when the kernel is being compiled."""

import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from typing import TYPE_CHECKING

import click
from tqdm import tqdm

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


@contextmanager
def iteration_bar(verbose: bool, most: int) -> Iterator["IterationBar"]:
    """Progress over iterations on standard error (where that is a terminal); one line each when verbose."""
    with closing(IterationBar(verbose, most)) as bar, word_of_compiling():
        yield bar


@contextmanager
def counting_bar(what: str, unit: str) -> Iterator[Callable[[int, int], None]]:
    """Progress over a known number of things, on standard error (where that is a terminal) after two seconds; of bytes,
    unit B, with their rate. The number may grow as more becomes known.
    """
    with tqdm(desc=what, unit=unit, unit_scale=unit == "B", leave=False, disable=None, delay=_SHORTLY) as bar:

        def show(done: int, most: int) -> None:
            bar.total = most
            bar.update(done - bar.n)

        yield show


@contextmanager
def counting_bars() -> Iterator[Callable[[str, int, int], None]]:
    """The same for work in several stages, each of a known number of parts: one bar after the other, or, where standard
    error is no terminal, one line when a stage begins.
    """
    bar: tqdm[None] = tqdm(disable=True)
    shown = ""

    def show(what: str, done: int, most: int) -> None:
        nonlocal bar, shown
        if shown != what:
            bar.close()
            if not sys.stderr.isatty():
                click.echo(f"{what} ...", err=True)
            bar, shown = tqdm(desc=what, total=most, leave=False, disable=None), what
        bar.total = most
        bar.update(done - bar.n)

    try:
        yield show
    finally:
        bar.close()


@contextmanager
def word_of_compiling() -> Iterator[None]:
    """Say what takes long where nothing shows it, once: that numeric kernels are being compiled, where they are."""
    over = threading.Event()

    def watch() -> None:
        compiling = 0.0
        while compiling < _EXPLAIN_AFTER:
            if over.wait(_BEAT):
                return
            compiling += _BEAT * is_compiling()
        click.echo("compiling the numeric kernel, once after an installation: one to two minutes", err=True)

    watching = threading.Thread(target=watch, daemon=True)
    watching.start()
    try:
        yield
    finally:
        over.set()
        watching.join()


def passing_word(sentence: str) -> None:
    """A sentence while something is under way, above its bar; on standard error, where that is a terminal."""
    if sys.stderr.isatty():
        tqdm.write(sentence, file=sys.stderr)


class IterationBar:
    """Called with every iteration."""

    def __init__(self, verbose: bool, most: int) -> None:
        self._verbose, self._count = verbose, 0
        self._bar = tqdm(total=most, desc="adjusting", unit="iteration", leave=False, disable=None)

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
        self._bar.set_postfix_str(f"cost {now.cost:.6g}")
        self._bar.update()

    def begin(self, what: str) -> None:
        """Count anew, under another name: one of several adjustments."""
        if self._verbose:
            tqdm.write(what)
        self._count = 0
        self._bar.reset()
        self._bar.set_description_str(what)

    def close(self) -> None:
        """Take the bar away."""
        self._bar.close()


@contextmanager
def stage_bar(count: int) -> Iterator[Stages]:
    """Stages that show themselves: which of `count` is running, for how long all of them have, and the time left of one
    that counts its parts.
    """
    bar = tqdm(total=count, unit="stage", leave=False, disable=None, bar_format="{n_fmt}/{total_fmt} {desc} {elapsed}")
    over, begun = threading.Event(), list[tuple[str, float]]()

    def tick() -> None:
        while not over.wait(_BEAT):
            bar.refresh()

    def announce(stage: str) -> None:
        bar.update(bool(begun))
        begun.append((stage, time.monotonic()))
        bar.set_description_str(stage)

    def detail(what: str, done: int, most: int) -> None:
        stage, since = begun[-1]
        left = (time.monotonic() - since) * (most - done) / max(done, 1)
        bar.set_description_str(f"{stage}, {what} {done / most:.0%}, {left:.0f} s left", refresh=False)

    ticking = threading.Thread(target=tick, daemon=True)
    ticking.start()
    try:
        yield Stages(announce, detail)
    finally:
        over.set()
        ticking.join()
        bar.close()

"""A bar over the stages of a longer job, on standard error where that is a terminal."""

import threading
from collections.abc import Iterator
from contextlib import contextmanager

from tqdm import tqdm

from mgsgraph.stages import Stages

_BEAT = 0.5
"""s between two looks at the clock."""


@contextmanager
def stage_bar(count: int) -> Iterator[Stages]:
    """Stages that show themselves: which of `count` is running, and for how long all of them have."""
    bar = tqdm(total=count, unit="stage", leave=False, disable=None, bar_format="{n_fmt}/{total_fmt} {desc} {elapsed}")
    over, begun = threading.Event(), list[str]()

    def tick() -> None:
        while not over.wait(_BEAT):
            bar.refresh()

    def announce(stage: str) -> None:
        bar.update(1 if begun else 0)
        begun.append(stage)
        bar.set_description_str(stage)

    ticking = threading.Thread(target=tick, daemon=True)
    ticking.start()
    try:
        yield Stages(announce)
    finally:
        over.set()
        ticking.join()
        bar.close()

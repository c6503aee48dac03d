"""What a longer job is doing: progress callbacks, and wall time by stages."""

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field

Progress = Callable[[str, int, int], None]
"""Called with the name of a stage, how many of its parts are done, and how many there are."""
Count = Callable[[int, int], None]
"""Called with how many parts are done, and how many there are."""


def no_progress(*_: object) -> None:
    """Show nothing: the default of both kinds of callback."""


@dataclass(slots=True)
class Stages:
    """Wall time by stage; a stage is announced when it begins."""

    announce: Callable[[str], None] = lambda _: None
    """Called with what is being done, "simulating" and the like."""
    detail: Progress = no_progress
    """Called with what the stage that is running does, how many of its parts are done, and how many there are."""
    seconds: dict[str, float] = field(default_factory=dict)
    """By stage, in their order."""

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Announce a stage, and book its time at its end."""
        self.announce(name)
        begin = time.perf_counter()
        yield
        self.seconds[name] = self.seconds.get(name, 0.0) + time.perf_counter() - begin

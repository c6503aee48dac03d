"""Wall time of a longer job, by its stages."""

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field


@dataclass(slots=True)
class Stages:
    """Wall time by stage; a stage is announced when it begins."""

    announce: Callable[[str], None] = lambda _: None
    """Called with what is being done, "simulating" and the like."""
    seconds: dict[str, float] = field(default_factory=dict)
    """By stage, in their order."""

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Announce a stage, and book its time at its end."""
        self.announce(name)
        begin = time.perf_counter()
        yield
        self.seconds[name] = self.seconds.get(name, 0.0) + time.perf_counter() - begin

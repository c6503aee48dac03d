"""Where work that is done is kept, so that an interrupted run goes on."""

from typing import Any, Protocol

from numpy.typing import NDArray

from mgsgraph.matching.tiles import Links


class Store(Protocol):
    """Arrays by name, of one run's inputs and choices."""

    def load(self, name: str) -> dict[str, NDArray[Any]] | None:
        """What was kept under a name; None where nothing was."""
        ...

    def keep(self, name: str, arrays: dict[str, NDArray[Any]]) -> None:
        """Keep arrays under a name."""
        ...


class Nowhere:
    """Keeps nothing."""

    def load(self, name: str) -> None:
        """Nothing."""
        return

    def keep(self, name: str, arrays: dict[str, NDArray[Any]]) -> None:
        """Not at all."""
        return


def load_links(store: Store, name: str) -> Links | None:
    """Links that were kept under a name; None where none were."""
    kept = store.load(name)
    return Links(**kept) if kept is not None and kept.keys() == set(Links._fields) else None

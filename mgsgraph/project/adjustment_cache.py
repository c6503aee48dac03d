"""The adjustment of a project between two changes by one process, which need not begin anew each time."""

from typing import TYPE_CHECKING

from mgsgraph.adjustment.incremental.state import StateStore
from mgsgraph.adjustment.settings import SolverSettings

if TYPE_CHECKING:
    from mgsgraph.adjustment.incremental.incremental import IncrementalAdjustment


class KeptAdjustment:
    """An adjustment with its tree, for as long as no other process changes the project."""

    def __init__(self) -> None:
        self._adjustment: IncrementalAdjustment | None = None
        self._after: object = None

    def resumed(self, after: object, settings: SolverSettings, store: StateStore) -> "IncrementalAdjustment":
        """The adjustment of a project whose last change, as its history has it, is `after`: the one that is kept, if it
        has made that change itself and has the same settings, else one that begins with what the store holds.
        """
        from mgsgraph.adjustment.incremental.incremental import IncrementalAdjustment

        kept = self._adjustment
        if kept is not None and after is not None and after == self._after and kept.settings == settings:
            kept.resume(store)
        else:
            kept = self._adjustment = IncrementalAdjustment(settings, store)
        self._after = None  # until the change that comes is noted
        return kept

    def noted(self, change: object) -> None:
        """What the adjustment holds is what the project is after a change, as its history has it."""
        self._after = change

    def forget(self) -> None:
        """Begin anew the next time: a change was not carried out."""
        self._adjustment = self._after = None

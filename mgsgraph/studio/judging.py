"""Verdicts about the tie points of a case, given in the browser and kept in a CSV file, which each verdict renews."""

from collections.abc import Callable, Sequence
from functools import cached_property
from pathlib import Path
from threading import RLock

from mgsgraph.errors import require
from mgsgraph.export.verdicts import (
    Verdict,
    Verdicts,
    network_digest,
    read_verdicts,
    require_verdicts_of,
    verdicts_text,
)
from mgsgraph.files.networks.tie_points import TiePoints
from mgsgraph.files.writing import write_file


class Judging:
    """Verdicts and their file; may be used by several threads.

    Parameters
    ----------
    path : Path
        The file; absent before the first verdict.
    ties : callable
        Tie points of the case, as its files have them.
    """

    def __init__(self, path: Path, ties: Callable[[], TiePoints]) -> None:
        self.path, self._ties, self._lock = path, ties, RLock()
        self._verdicts: Verdicts | None = None

    @property
    def verdicts(self) -> Verdicts:
        """All verdicts; InputError where the file holds something else, or those of another network."""
        with self._lock:
            if self._verdicts is None and not self.path.exists():
                self._verdicts = Verdicts(str(self.path), {})
            elif self._verdicts is None:
                verdicts = read_verdicts(self.path)
                require_verdicts_of(self._ties(), verdicts)
                self._verdicts = verdicts
            return self._verdicts

    @cached_property
    def _digest(self) -> str:
        return network_digest(self._ties())

    def judge(self, points: Sequence[str], verdict: str, note: str | None) -> None:
        """Give points a verdict, and a note unless it is None; the file has them on return.

        Raises
        ------
        InputError
            No verdict, no tie point of the case, or a file that can't be written. Nothing has changed then.
        """
        require(verdict in list(Verdict), "request, verdict", repr(verdict)[:60], f"one of {', '.join(Verdict)}")
        for name, number in zip(points, self._ties().ids.find(list(points)).tolist(), strict=True):
            require(number >= 0, f"point {name}", "no tie point of the case", "one of its tie points")
        with self._lock:
            verdicts = self.verdicts
            of = {**verdicts.of, **dict.fromkeys(points, Verdict(verdict))}
            notes = {**verdicts.notes, **({} if note is None else dict.fromkeys(points, note.strip()))}
            given = Verdicts(str(self.path), of, {name: text for name, text in notes.items() if text}, self._digest)
            write_file(self.path, verdicts_text(given))
            self._verdicts = given

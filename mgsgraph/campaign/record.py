"""The record of a campaign: JSON Lines, one for each case that is over, appended whole and never changed.

A case that is done again gets another line; its last one counts. A line that a crash or a full disk has cut short is
taken off. One campaign at a time may write.
"""

import dataclasses
import json
import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, Self

import msgspec

from mgsgraph.adjustment.settings import Form, Loss, SolverSettings
from mgsgraph.errors import InputError
from mgsgraph.io.files import claim

Status = Literal["done", "not converged", "failed"]
RECORD = "campaign.jsonl"
"""Name of the file in the folder of the results."""
_HEAD = {"program": "mgsgraph", "record": "campaign", "format": 1}


@dataclass(frozen=True, slots=True)
class Overrides:
    """Options that overrule all case files alike."""

    form: Form | None = None
    """Form of the factors."""
    loss: Loss | None = None
    """Robust loss."""
    reject: float | None = None
    """Blunder limit in standard deviations, as `SolverSettings.reject`."""
    laser: bool = True
    """False leaves the laser rows out."""
    figures: bool = True
    """False leaves the figures out."""
    starts: int | None = None
    """Starts over a terrain model's unknown shift, as `SolverSettings.starts`."""

    def over(self, settings: SolverSettings) -> SolverSettings:
        """A case file's settings with these over them."""
        chosen: dict[str, Any] = {"form": self.form, "loss": self.loss, "reject": self.reject, "starts": self.starts}
        return dataclasses.replace(settings, **{name: value for name, value in chosen.items() if value is not None})


AS_WRITTEN = Overrides()
"""Nothing overrules the case files."""


class CampaignEntry(msgspec.Struct, frozen=True):
    """How one case ended."""

    case: str
    """Path of the case file, relative to the record's folder."""
    folder: str
    """Name of the folder with its results."""
    status: Status
    """not converged: results are written; failed: there are none of this run."""
    message: str
    """Reason why the adjustment ended."""
    seconds: float
    """s, wall time on the worker."""
    converged: bool
    sigma0: float | None
    """A-posteriori standard deviation of unit weight; None where there is none."""
    cost: float | None
    """Half the weighted sum of squares at the end."""
    iterations: int | None
    """Number of steps tried."""
    checksums: dict[str, str | None]
    """SHA-256 of the case file and of its inputs, by path as the case writes it."""
    overrides: Overrides = msgspec.field(name="wishes")
    """Options that overruled the case file."""
    version: str
    """Version of this program."""
    machine: str
    """Host name of the worker."""
    finished: str
    """UTC, ISO 8601."""


class Record:
    """An open record; made by `open_record`.

    Attributes
    ----------
    path : Path
    entries : dict of str to CampaignEntry
        The last one of each case, by `CampaignEntry.case`.
    """

    def __init__(self, path: Path, descriptor: int) -> None:
        self.path = path
        self._descriptor = descriptor
        self._new = False
        self.entries: dict[str, CampaignEntry] = {}

    def append(self, entry: CampaignEntry) -> None:
        """Add a line: all of it or nothing, and on the disk before this returns."""
        _append(self._descriptor, msgspec.json.encode(entry) + b"\n", self.path)
        self.entries[entry.case] = entry

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        os.close(self._descriptor)
        if self._new and not self.entries and os.listdir(self.path.parent) == [self.path.name]:  # nothing came of it
            self.path.unlink()
            self.path.parent.rmdir()


def open_record(folder: Path) -> Record:
    """The record of the campaign in a folder, which is made where there is none.

    Raises
    ------
    InputError
        A folder that holds something else, a record that isn't one or is damaged, one that another campaign is writing,
        or a place where nothing can be written.
    """
    path = folder / RECORD
    try:
        _require_ours(folder, path)
        folder.mkdir(parents=True, exist_ok=True)
        descriptor = os.open(path, os.O_RDWR | os.O_CREAT | os.O_APPEND, 0o666)
    except OSError as error:
        raise _refusal(path, error) from None
    record = Record(path, descriptor)
    try:
        claim(descriptor, path, "another campaign is writing here")
        text = path.read_bytes()
        whole = text.rfind(b"\n") + 1
        os.ftruncate(descriptor, whole)
        lines = text[:whole].split(b"\n")[:-1]
        record._new = not lines
        if not lines:
            _append(descriptor, json.dumps(_HEAD).encode() + b"\n", path)
        elif not _is_head(lines[0]):
            where, expected = f"{path}, line 1", json.dumps(_HEAD)
            raise InputError(where, "no head of a campaign's record", expected, "choose another --out")
        record.entries.update((entry.case, entry) for entry in _entries(lines[1:], path))
    except OSError as error:
        os.close(descriptor)
        raise _refusal(path, error) from None
    except BaseException:
        os.close(descriptor)
        raise
    return record


def _require_ours(folder: Path, path: Path) -> None:
    if folder.exists() and not folder.is_dir():
        raise InputError(str(folder), "exists and is a file", "a folder for the results", "choose another --out")
    if folder.is_dir() and not path.exists() and any(folder.iterdir()):
        found, expected = f"exists, and has no {RECORD}", "an absent or empty folder, or an earlier campaign"
        raise InputError(str(folder), found, expected, "choose another --out")


def _append(descriptor: int, line: bytes, path: Path) -> None:
    size = os.fstat(descriptor).st_size
    try:
        written = os.write(descriptor, line)
        os.fsync(descriptor)
    except OSError as error:
        os.ftruncate(descriptor, size)
        raise _refusal(path, error) from None
    if written < len(line):
        os.ftruncate(descriptor, size)
        raise InputError(str(path), "can't be written (the disk is full)", remedy="free some space, and run this again")


def _entries(lines: list[bytes], path: Path) -> list[CampaignEntry]:
    found = []
    for number, line in enumerate(lines, start=2):
        try:
            found.append(msgspec.json.decode(line, type=CampaignEntry))
        except msgspec.MsgspecError as error:
            remedy = "take that line out: its case will be done again"
            raise InputError(f"{path}, line {number}", f"no entry of a campaign ({error})", remedy=remedy) from None
    return found


def _is_head(line: bytes) -> bool:
    try:
        return bool(json.loads(line) == _HEAD)
    except (ValueError, RecursionError):
        return False


def _refusal(path: Path, error: OSError) -> InputError:
    reason = error.strerror or str(error)
    return InputError(str(path), f"can't be written ({reason})", remedy="choose another --out, where you may write")

"""The record of a campaign: JSON Lines, one for each case that is over, appended whole and never changed.

A case that is done again gets another line; its last one counts. A line that a crash or a full disk has cut short is
taken off. Each ends with its checksum. One campaign at a time may write.
"""

import dataclasses
import json
import os
import re
import stat
import zlib
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, Self

import msgspec

from mgsgraph.adjustment.settings import Device, Loss, SolverSettings
from mgsgraph.errors import InputError
from mgsgraph.files.writing import claim
from mgsgraph.results.large_tables import TableForm

Status = Literal["done", "no result", "not converged", "failed"]
RECORD = "campaign.jsonl"
"""Name of the file in the folder of the results."""
FORMAT = 2
"""Version of the layout."""
_HEAD = json.dumps({"program": "mgsgraph", "record": "campaign", "format": FORMAT}).encode()
_SIGNED = re.compile(rb'(.*),"crc32":"([0-9a-f]{8})"\}', re.DOTALL)
"""A line, and the CRC-32 of what stands before it."""
_PIECE = 1 << 20
"""bytes read at a time."""


@dataclass(frozen=True, slots=True)
class Overrides:
    """Options that overrule all case files alike."""

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
    tables: TableForm | None = None
    """Form of the tables of points and residuals, as `write_results`."""
    device: Device | None = None
    """Who goes over the points, as `SolverSettings.device`."""

    def over(self, settings: SolverSettings) -> SolverSettings:
        """A case file's settings with these over them."""
        chosen = {name: getattr(self, name) for name in ("loss", "reject", "starts", "device")}
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
    """no result: it came to rest on what proves nothing (`analysis.soundness`); not converged: results are written in
    both; failed: there are none of this run."""
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
        text = msgspec.json.encode(entry).removesuffix(b"}")
        _append(self._descriptor, text + b',"crc32":"%08x"}\n' % zlib.crc32(text), self.path)
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
        if not stat.S_ISREG(os.fstat(descriptor).st_mode):
            raise InputError(str(path), "is no file", "the record of a campaign", "choose another --out")
        claim(descriptor, path, "another campaign is writing here")
        text = b"".join(iter(lambda: os.read(descriptor, _PIECE), b""))
        whole = text.rfind(b"\n") + 1
        os.ftruncate(descriptor, whole)
        lines = text[:whole].split(b"\n")[:-1]
        record._new = not lines
        if not lines:
            _append(descriptor, _HEAD + b"\n", path)
        record.entries.update((entry.case, entry) for entry in _entries(lines, path))
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
    """Entries of the lines of a record after its head."""
    where = f"{path}, line 1"
    if lines and lines[0] != _HEAD:
        raise InputError(where, "no head of a campaign's record", _HEAD.decode(), "choose another --out")
    return [_entry(line, f"{path}, line {number}") for number, line in enumerate(lines[1:], start=2)]


def _entry(line: bytes, where: str) -> CampaignEntry:
    signed = _SIGNED.fullmatch(line)
    remedy = "take that line out: its case will be done again"
    if signed is None or zlib.crc32(signed[1]) != int(signed[2], 16):
        raise InputError(where, "a damaged entry (its checksum is another one, or gone)", remedy=remedy)
    try:
        return msgspec.json.decode(line, type=CampaignEntry)
    except (msgspec.MsgspecError, UnicodeError) as error:
        raise InputError(where, f"no entry of a campaign ({error})", remedy=remedy) from None


def _refusal(path: Path, error: OSError) -> InputError:
    reason = error.strerror or str(error)
    return InputError(str(path), f"can't be written ({reason})", remedy="choose another --out, where you may write")

"""Verdicts about the tie points of a network: accept, reject or undecided; written, read and applied.

CSV, RFC 4180: a header `id,verdict` or `id,verdict,note`, one row for each point. Lines before it that begin with # are
comments; one of them, `# network DIGEST`, says which network the verdicts are about, and is compared with the one that
they are applied to.
"""

import csv
import hashlib
import io
import re
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from pathlib import Path

import msgspec
import numpy as np

from mgsgraph.case.assembly import in_images
from mgsgraph.errors import InputError, require
from mgsgraph.files.networks.record import ControlNetwork
from mgsgraph.files.networks.tie_points import TiePoints, tie_points
from mgsgraph.files.opening import read_text
from mgsgraph.files.output.table import quoted
from mgsgraph.record import Record
from mgsgraph.text import some

COLUMNS = ("id", "verdict", "note")
"""Of a file of verdicts; the last one may be left out."""
_NETWORK = re.compile(r"#\s*network\s+([0-9a-f]{16})[\s,;]*$")
_DIGITS = 16


class Verdict(StrEnum):
    """Decision about a tie point."""

    ACCEPT = "accept"
    REJECT = "reject"
    UNDECIDED = "undecided"
    """It stays as it was, as an accepted one does."""


@dataclass(frozen=True, slots=True, eq=False)
class Verdicts(Record):
    """Verdicts about some points of a network."""

    source: str
    """File they come from, for messages."""
    of: Mapping[str, Verdict]
    """By the point's id."""
    notes: Mapping[str, str] = field(default_factory=dict)
    """By the point's id, where there is one."""
    network: str = ""
    """`network_digest` of the network that was reviewed; empty where the file doesn't say."""

    @property
    def rejected(self) -> frozenset[str]:
        """Ids of the rejected points."""
        return frozenset(name for name, verdict in self.of.items() if verdict is Verdict.REJECT)


def network_digest(ties: TiePoints) -> str:
    """Sixteen hexadecimal digits that tell a network by its points' ids, its measures' images and pixels."""
    digest = hashlib.sha256()
    digest.update("\0".join((*ties.ids, "", *ties.measure_image)).encode())
    for values in (ties.measure_point, ties.measures):
        digest.update(values.astype(values.dtype.newbyteorder("<")).tobytes())
    return digest.hexdigest()[:_DIGITS]


# --- writing and reading


def verdicts_text(verdicts: Verdicts) -> str:
    """Verdicts as a file that `read_verdicts` reads."""
    head = f"# network {verdicts.network}\n" if verdicts.network else ""
    rows = [(name, verdict.value, verdicts.notes.get(name, "")) for name, verdict in verdicts.of.items()]
    return head + "".join(",".join(map(quoted, row)) + "\n" for row in (COLUMNS, *rows))


def read_verdicts(path: str | Path) -> Verdicts:
    r"""Read verdicts that the studio (or a person) has written.

    Parameters
    ----------
    path : path
        CSV file with columns id, verdict (accept, reject, undecided or nothing) and perhaps note.

    Raises
    ------
    InputError
        With the line: no such file or no CSV, another header, another verdict, an id twice or none, a row of another
        length.

    Examples
    --------
    >>> _ = Path("verdicts.csv").write_text("id,verdict\nTIE00001,reject\n")
    >>> mgsgraph.read_verdicts("verdicts.csv").rejected
    frozenset({'TIE00001'})
    """
    path = Path(path)
    head, body, first_line = _split(read_text(path))
    networks = {match[1] for line in head if (match := _NETWORK.match(line))}
    require(len(networks) <= 1, str(path), "verdicts about two networks", "about one", "give each a file of its own")
    of, notes = dict[str, Verdict](), dict[str, str]()
    (where, header), *rows = _rows(body, first_line, path) or [(str(path), [])]
    _require_header(header, where)
    for where, row in rows:
        if len(row) != len(header):
            raise InputError(where, f"{len(row)} fields", f"{len(header)} as in the header", "quote commas in notes")
        name, verdict = row[0], row[1].strip().lower() or Verdict.UNDECIDED.value
        require(name, where, "no id", "the point's id in the first column")
        if verdict not in list(Verdict):
            raise InputError(where, f"the verdict {row[1].strip()[:40]!r}", "accept, reject, undecided or nothing")
        require(name not in of, where, f"the id {name!r} a second time", "each id once", "remove one of the two rows")
        of[name] = Verdict(verdict)
        if note := "".join(row[2:]).strip():
            notes[name] = note
    return Verdicts(str(path), of, notes, networks.pop() if networks else "")


def _split(text: str) -> tuple[list[str], str, int]:
    """Comments before the header, all from the header on, and the number of its line. Further down, # begins an id."""
    lines = text.split("\n")
    count = next((k for k, line in enumerate(lines) if line.strip(" ,") and line[0] != "#"), len(lines))
    return lines[:count], "\n".join(lines[count:]), count + 1


def _rows(body: str, first_line: int, path: Path) -> list[tuple[str, list[str]]]:
    """File and line of each row that isn't blank, and its fields."""
    reader = csv.reader(io.StringIO(body, newline=""), strict=True)

    def where() -> str:
        return f"{path}, line {first_line + reader.line_num - 1}"

    try:
        return [(where(), row) for row in reader if any(field.strip() for field in row)]
    except csv.Error as error:
        raise InputError(where(), f"no CSV ({error})", "fields with commas between them") from None


def _require_header(header: list[str], where: str) -> None:
    names = tuple(name.strip().lower() for name in header)
    if names not in (COLUMNS, COLUMNS[:2]):
        found = repr(",".join(header)[:60]) if header else "nothing"
        remedy = "write commas between the fields" if len(header) == 1 and ";" in header[0] else ""
        raise InputError(where, found, "the header id,verdict or id,verdict,note", remedy)


# --- application


def apply_verdicts(ties: TiePoints, verdicts: Verdicts) -> TiePoints:
    r"""The points without the rejected ones.

    Raises
    ------
    InputError
        If the verdicts are about another network, or reject all of this one.

    Examples
    --------
    >>> _ = Path("verdicts.csv").write_text("id,verdict\nTIE00001,reject\n")
    >>> len(pair.ties.ids), len(mgsgraph.apply_verdicts(pair.ties, mgsgraph.read_verdicts("verdicts.csv")).ids)
    (20, 19)
    """
    rejected = _rejected(ties, verdicts)
    return ties.chosen(np.array([i for i, name in enumerate(ties.ids) if name not in rejected], dtype=np.int64))


def ignore_rejected(network: ControlNetwork, verdicts: Verdicts, images: Collection[str] = ()) -> ControlNetwork:
    """The whole network with Ignore = True at the rejected points, all else as it was.

    Parameters
    ----------
    network : ControlNetwork
        The one that was reviewed.
    verdicts : Verdicts
        About it.
    images : collection of str
        Those of the case, which may have left out measures in others.

    Raises
    ------
    InputError
        As `apply_verdicts`.
    """
    ties = tie_points(network)
    if images and verdicts.network not in ("", network_digest(ties)):
        ties, _ = in_images(ties, list(images))
    rejected = _rejected(ties, verdicts)
    points = tuple(
        msgspec.structs.replace(point, ignore=True) if point.id in rejected else point for point in network.points
    )
    return msgspec.structs.replace(network, points=points)


def require_verdicts_of(ties: TiePoints, verdicts: Verdicts) -> None:
    """Raise InputError unless the verdicts are about these points, all of the network that was reviewed."""
    remedy = "give the network that was reviewed"
    unknown = sorted(set(verdicts.of) - set(ties.ids))
    found = f"verdicts about {some([repr(name) for name in unknown])}"
    require(not unknown, verdicts.source, found, f"points of {ties.source}", remedy)
    if verdicts.network and verdicts.network != (digest := network_digest(ties)):
        found = f"verdicts about network {verdicts.network}"
        raise InputError(verdicts.source, found, f"{digest}, which {ties.source} is", remedy)


def _rejected(ties: TiePoints, verdicts: Verdicts) -> frozenset[str]:
    """Ids of the rejected points: these may not be all."""
    require_verdicts_of(ties, verdicts)
    if verdicts.rejected.issuperset(ties.ids):
        raise InputError(verdicts.source, f"every point of {ties.source} rejected", "one at least that stays")
    return verdicts.rejected

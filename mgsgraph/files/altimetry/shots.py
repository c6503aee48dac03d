"""Laser shots of any altimeter's archive, known by their content: MOLA PEDR, LOLA RDR, MLA, LALT, our own selections.

What is read: MOLA PEDR (`pedr`) and LOLA RDR (`lola`), binary; tables of PEDR2TAB, of the Orbital Data Explorer (MOLA,
LOLA, MLA) and selections of `mgsgraph shots` (`tables`); any PDS3 table by its label (`pds_table`). All but PEDR files
may be packed by gzip.
"""

from pathlib import Path

from mgsgraph.errors import InputError
from mgsgraph.files.altimetry.lola import is_lola_rdr, lola_shots
from mgsgraph.files.altimetry.pds_table import is_label, read_labelled_shots, require_whole
from mgsgraph.files.altimetry.pedr import FRAME, pedr_shots
from mgsgraph.files.altimetry.shot_values import require_possible_shots
from mgsgraph.files.altimetry.tables import TextTable, is_archive_table, shots_of_table, table_of
from mgsgraph.files.opening import read_bytes, unpacked_gzip
from mgsgraph.geometry.altimetry import AltimeterShots

_SMALL, _MOST_TIMES = 1 << 24, 30
"""bytes that any packed file may unpack to, and times its own: gzip packs tables of numbers to a fifth or so."""


def read_shots(
    path: Path, clock_bias: float = 0.0, version: str | None = None
) -> AltimeterShots:
    """Shots of an altimeter, ground or not, in the file's order.

    Parameters
    ----------
    path : Path
        File of any of the formats above; of a table with a label, the label.
    clock_bias : float
        s, added to the times of the shots (the footprints stay where the archive has them).
    version : str, optional
        Version letter of a PEDR product, where the file's name doesn't say it.

    Raises
    ------
    InputError
        With file and line or record: a file that is missing, empty, cut short or of an unknown format; a column that is
        missing; a value that is no number or can't be; radii in no unit in which they are the body's, ranges in another
        than the way from the spacecraft, where the file has that.

    Examples
    --------
    >>> from mgsgraph.files.altimetry.shots import read_shots
    >>> shots = read_shots(Path("gusev/ap18933l.b"))
    >>> print(shots)
    AltimeterShots(MOLA: 280 shots, 272 on the ground, 1 orbits)
    """
    return shots_of(*unpacked(read_bytes(path), path), path, clock_bias, version)


def shots_of(
    content: bytes, packed: bool, path: Path, clock_bias: float = 0.0, version: str | None = None,
    table: TextTable | None = None,
) -> AltimeterShots:  # fmt: skip
    """As `read_shots`, of the content of a file, unpacked if it was packed; as a table, where it is one already."""
    shots = _as_read(content, packed, path, clock_bias, version, table)
    require_possible_shots(shots)
    return shots


def _as_read(
    content: bytes, packed: bool, path: Path, clock_bias: float, version: str | None, table: TextTable | None
) -> AltimeterShots:  # fmt: skip
    if not content or content.isspace():
        raise InputError(str(path), "an empty file", "laser shots")
    if b"\0" in content:
        if is_lola_rdr(content):
            require_whole(path, content)
            return lola_shots(content, path, clock_bias)
        if path.suffix.lower() != ".b" and len(content) % FRAME.itemsize:
            raise InputError(
                str(path), f"{len(content)} bytes of an unknown format",
                f"LOLA RDR (records of 256 bytes), PEDR (frames of {FRAME.itemsize} bytes) or text",
            )
        _require_unpacked(packed, path)
        return pedr_shots(content, path, clock_bias, version)
    if content.lstrip().startswith(b"{"):
        raise InputError(str(path), "JSON", "a file of an altimeter's archive", "ISIS lidar data go into [laser]")
    if is_label(content):
        return read_labelled_shots(path, clock_bias)
    table = table_of(content, path) if table is None else table
    if not is_archive_table(table):
        _require_unpacked(packed, path)
    return shots_of_table(table, clock_bias, version)


def unpacked(content: bytes, path: Path) -> tuple[bytes, bool]:
    """The content of a file that may be packed by gzip, and whether it was."""
    if not content.startswith(b"\x1f\x8b"):
        return content, False
    return unpacked_gzip(content, str(path), max(_SMALL, _MOST_TIMES * len(content))), True


def _require_unpacked(packed: bool, path: Path) -> None:
    if packed:
        raise InputError(str(path), "a packed PEDR file", "one that is not packed", "unpack it with gunzip")

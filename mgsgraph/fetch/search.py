"""What an image needs, found out from the archives: volume, label, kernels of its time, laser profile.

A PEDR file holds about a day and is called after its first orbit, MGS's mapping orbit + 10000: from the image's orbit
one goes downward to the first file that there is, and its label says whether it is the one.

Volumes are in the order of time, and so are ids: of the volumes that the archive's listing names some ten indices
(ASCII tables that PDS3 labels describe), each of a few hundred kilobytes, tell which one an image is in. They stay in
the folder, for the next image.
"""

import math
import re
from bisect import bisect_left
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from functools import cache
from pathlib import Path
from typing import NamedTuple

from mgsgraph.errors import InputError, require
from mgsgraph.fetch.camera_search import Box, CameraSearch, stated_interval
from mgsgraph.fetch.download import NotInArchive, Remote
from mgsgraph.fetch.kernel_phases import Interval, find_kernels
from mgsgraph.fetch.needs import (
    ArchivedCamera,
    Archives,
    CameraProduct,
    ImageNeeds,
    Product,
    ProductId,
    WantedFile,
    kernel_path,
)
from mgsgraph.fetch.store import DownloadFolder
from mgsgraph.files.altimetry.binary import FRAME, HEADER_RECORDS
from mgsgraph.files.opening import read_bytes
from mgsgraph.files.pvl import Block, Document, flat_label, whole_label
from mgsgraph.text import some

RANGING_ENDED = datetime(2001, 6, 30, 23, 59, 59, tzinfo=UTC)
"""MOLA's last range was on this day."""
FIRST = 10_000
"""What MOLA adds to MGS's mapping orbit."""
_KNOWN_ORBIT, _KNOWN_TIME = 717, datetime(1999, 5, 6, 15, 33, 58, tzinfo=UTC)
"""M01/00115, by its label."""
_PERIOD = timedelta(seconds=7057.27)
"""Of MGS's mapping orbit: M04/02852 is of orbit 2063."""
_ABOVE, _BELOW = 15, 30
"""Orbits after and before an image's with which its file may begin: a day has 12, and its orbit may be reckoned."""


def orbit_at(when: datetime) -> int:
    """MGS's mapping orbit at a time, within some: its period changed."""
    return _KNOWN_ORBIT + round((when - _KNOWN_TIME) / _PERIOD)


def find_profile(orbit: int, exposure: Interval, archives: Archives, remote: Remote, where: str) -> tuple[str, str]:
    """Path of the PEDR file below its archive, and a sentence: why there is none, or what is not confirmed.

    Parameters
    ----------
    orbit : int
        Mapping orbit of the image.
    exposure : Interval
        When it was taken.
    archives, remote
        Where, and how.
    where : str
        The image, for the sentences.
    """
    if exposure.start > RANGING_ENDED:
        return "", f"{where}: no laser profile, MOLA's ranging ended on {RANGING_ENDED:%Y-%m-%d}"
    for path in _candidates(orbit + FIRST, archives, remote):
        try:
            head = remote.head(archives.pedr + path, HEADER_RECORDS * FRAME.itemsize)
        except NotInArchive:
            continue
        covered = Interval.stated_by(flat_label(_label_text(head, archives.pedr + path), archives.pedr + path))
        if covered is None:
            return path, f"{where}: the label of {path} says no times; it is taken by its orbit"
        if covered.holds(exposure.middle):
            return path, ""
        if covered.stop < exposure.middle:
            return "", f"{where}: no laser profile, {path} ends at {covered.stop:%Y-%m-%dT%H:%M:%S} before it"
    return "", f"{where}: no laser profile, the archive has no file of its day"


def _candidates(orbit: int, archives: Archives, remote: Remote) -> Iterator[str]:
    """Paths downward from an orbit, only those that the archive lists where it does."""
    listed: dict[str, frozenset[str]] = {}
    for number in range(orbit + _ABOVE, max(FIRST, orbit - _BELOW) - 1, -1):
        folder, name = f"ap{number // 1000:02d}xxx", f"ap{number:05d}l.b"
        if folder not in listed:
            page = remote.listing(f"{archives.pedr}{folder}/").lower()
            listed[folder] = frozenset(re.findall(r"ap\d{5}l\.b(?=\")", page))
        if not listed[folder] or name in listed[folder]:
            yield f"{folder}/{name}"


def _label_text(head: bytes, where: str) -> str:
    require(b"PDS_VERSION_ID" in head, where, f"it begins with {head[:16]!r}", "a PDS3 label", "try another mirror")
    return head.decode("latin-1")


_COLUMNS = ("PRODUCT_ID", "FILE_SPECIFICATION_NAME", "INSTRUMENT_NAME")
_PLACE = ("CENTER_LONGITUDE", "CENTER_LATITUDE")


@dataclass(frozen=True, slots=True)
class IndexRow:
    """One image of a volume."""

    product: ProductId
    file: str
    """Path below the volume, in small letters: m08060/m0806047.imq."""
    instrument: str
    """MOC-NA or MOC-WA."""
    longitude: float = math.nan
    latitude: float = math.nan
    """Of its middle, deg, east; NaN where the index has none."""

    @property
    def narrow(self) -> bool:
        """Whether the narrow angle took it."""
        return not self.instrument.upper().endswith("WA")


def read_index(table: Path, label: Path) -> tuple[IndexRow, ...]:
    """Images of a volume in the table's order; those with ids of no mapping phase are left out. Longitudes are positive
    west, as Malin Space Science Systems publishes them, unless the label says east.

    Raises
    ------
    InputError
        A label without one of the columns that are needed, or a row that is too short.
    """
    text = read_bytes(label).decode("latin-1").replace("\r\n", "\n")
    columns = {block.text("NAME").upper(): block for block in _columns(whole_label(Document(str(label), text)))}
    for name in _COLUMNS:
        require(name in columns, str(label), f"no column {name}", "the label of an image index")
    names = _COLUMNS + (_PLACE if columns.keys() >= {*_PLACE} else ())
    east = 1.0 if _PLACE[0] in columns and "EAST" in str(columns[_PLACE[0]].words("DESCRIPTION")).upper() else -1.0
    return tuple(_rows(table, [_bytes(columns[name]) for name in names], east))


def _columns(block: Block) -> Iterator[Block]:
    for inner in block.blocks:
        if inner.name == "column":
            yield inner
        yield from _columns(inner)


def _bytes(column: Block) -> slice:
    start = column.count("START_BYTE") - 1
    return slice(start, start + column.count("BYTES"))


def _rows(table: Path, places: list[slice], east: float) -> Iterator[IndexRow]:
    needed = max(place.stop for place in places)
    for number, line in enumerate(read_bytes(table).decode("latin-1").split("\n"), 1):
        if not line.strip("\0\x1a\r "):
            continue
        if len(line) < needed:
            expected, remedy = f"at least {needed} by its label", "--update, or another mirror"
            raise InputError(f"{table}, row {number}", f"{len(line)} bytes", expected, remedy)
        product, file, instrument, *place = (line[place].strip(' "') for place in places)
        degrees = [sense * _degrees(text) for sense, text in zip((east, 1.0), place, strict=False)]
        with suppress(InputError):  # calibration and the like
            yield IndexRow(ProductId.read(product), file.lower(), instrument, *degrees)


def _degrees(text: str) -> float:
    """A number of an index; NaN for what is none, as N/A."""
    try:
        return float(text)
    except ValueError:
        return math.nan


NAMES = ("imgindx", "imgindex")
"""What the index of a volume is called, more often the first."""
_NAME = re.compile(r"mgsc_1\d{3}")
_BESIDE = 2
"""Volumes on either side in which an image is looked for that is not where its id says."""
_AFTER_ALL = (9, 0, 0)
"""Later than any id."""
_TAIL = 10
"""Of a volume's ids the last tenth doesn't tell where it stands: some image may have come late."""

Rows = Callable[[str], Sequence[IndexRow]]
"""Index of a volume by its name; empty where there is no such volume."""


class LocatedImage(NamedTuple):
    """An image, and where it is."""

    volume: str
    row: IndexRow


def volumes_listed(page: str) -> tuple[str, ...]:
    """Volumes to which the archive's listing has links."""
    named = {f"mgsc_{number}" for number in re.findall(r'href="[^"]*?mgsc_(1\d{3})/?"', page, re.IGNORECASE)}
    return tuple(sorted(named))


def volumes_of(texts: Sequence[str]) -> tuple[str, ...]:
    """Volumes by their names, in capitals or not; InputError for any other."""
    named = tuple(text.strip().lower() for text in texts)
    for name in named:
        require(_NAME.fullmatch(name), f"volume {name!r}"[:80], "not the name of a volume", "one such as mgsc_1068")
    return named


def find_image(product: ProductId, volumes: Sequence[str], rows: Rows) -> LocatedImage:
    """Look an image up.

    Parameters
    ----------
    product : ProductId
        Which.
    volumes : sequence of str
        In the order of time.
    rows : callable
        Reads the index of a volume; asked for the same again and again.

    Raises
    ------
    InputError
        No volumes at all; an id that none has; or an image of the wide angle.
    """

    def last(number: int) -> tuple[int, int, int]:
        """Latest id of a volume, or of the next that has an index, but for few that are out of order."""
        for volume in volumes[number:]:
            looked.append(volume)
            if sample := rows(volume):
                return sorted(row.product.order for row in sample)[-1 - len(sample) // _TAIL]
        return _AFTER_ALL

    looked = list[str]()
    place = bisect_left(range(len(volumes)), product.order, key=last)
    looked += volumes[max(0, place - _BESIDE) : place + _BESIDE + 1]
    for volume in dict.fromkeys(looked):
        for row in rows(volume):
            if row.product == product:
                found = f"of the wide angle ({row.instrument})"
                require(row.narrow, f"image {product}", found, "a narrow-angle image, whose geometry is modelled")
                return LocatedImage(volume, row)
    through = sorted(volume for volume in {*looked} if rows(volume))
    found = f"in no volume that was looked through ({some(through, len(through))})" if through else "no volume there"
    raise InputError(f"image {product}", found, "a narrow-angle image", "check the id, the mirror, or --volume")


_LABEL = 8192
"""bytes in which the label of an image lies: that of a compressed one takes 2048."""


_FILE = re.compile(r"\w+(/\w+)*\.(imq|img)")
"""Below a volume."""


class Search:
    """Looks images up; what it reads on the way stays in the store: index/ and the kernels' labels."""

    def __init__(self, archives: Archives, store: DownloadFolder, volumes: Sequence[str] = ()) -> None:
        """`volumes`: where to look, as mgsc_1068; everywhere when empty."""
        self._archives, self._store = archives, store
        self._other = CameraSearch(archives, store)
        self._volumes = tuple(volumes)
        self._index = cache(self._read_index)

    def needs(self, product: Product) -> ImageNeeds:
        """All that one image needs.

        Raises
        ------
        InputError
            No such image, one of the wide angle, no kernels of its time, or an archive that can't be reached.
        """
        if isinstance(product, CameraProduct):
            return self._other.needs(product)
        volume, row = find_image(product, self._all_volumes(), self._index)
        if not _FILE.fullmatch(row.file):
            raise InputError(f"index of {volume}, {product}", repr(row.file), "a path such as m08060/m0806047.imq")
        file = f"{volume}/{row.file}"
        label = self._image_label(product, self._archives.images + file)
        exposure, where = Interval.of(label), str(product)
        orbit = label.count("ORBIT_NUMBER") if "ORBIT_NUMBER" in label else orbit_at(exposure.middle)
        kernels, unconfirmed = find_kernels(exposure, self._cover, where)
        pedr, why = find_profile(orbit, exposure, self._archives, self._store.remote, where)
        return ImageNeeds(
            product, file, label.text("START_TIME"), label.text("STOP_TIME"), orbit, kernels, pedr,
            (*unconfirmed, *([why] if why else [])),
        )

    def images_in(self, box: Box, camera: ArchivedCamera | None) -> list[str]:
        """Ids of a camera's images in a box, those of MOC's narrow angle (None) by their middles in all volumes."""
        if camera is not None:
            return self._other.images_in(box, camera)
        rows = [row for volume in self._all_volumes() for row in self._index(volume) if row.narrow]
        if rows and all(math.isnan(row.longitude) for row in rows):
            raise InputError(f"indices in {self._archives.images}", f"no columns {' and '.join(_PLACE)}", "places")
        return [str(row.product) for row in rows if box.holds(row.longitude, row.latitude)]

    def _all_volumes(self) -> Sequence[str]:
        self._volumes = self._volumes or volumes_listed(self._store.remote.listing(self._archives.images))
        return self._volumes

    def _read_index(self, volume: str) -> Sequence[IndexRow]:
        """Of a volume; empty where the archive has none."""
        for name in NAMES:
            address, path = f"{self._archives.images}{volume}/index/{name}", f"index/{volume}"
            with suppress(NotInArchive):
                label = self._store.get(WantedFile(f"{address}.lbl", f"{path}.lbl"))
                return read_index(self._store.get(WantedFile(f"{address}.tab", f"{path}.tab")), label)
        return ()

    def _image_label(self, product: ProductId, url: str) -> Block:
        head = self._store.remote.head(url, _LABEL)
        if not head.lstrip().startswith(b"PDS_VERSION_ID"):
            raise InputError(url, f"it begins with {head[:16]!r}", "an image with its PDS3 label", "try another mirror")
        label = flat_label(head.decode("latin-1"), url)
        if (found := label.text("PRODUCT_ID").strip()) != str(product):
            raise InputError(f"{url}, PRODUCT_ID", repr(found), str(product), "the index and the image disagree")
        if (instrument := label.text("INSTRUMENT_ID").upper()) != "MOC-NA":
            raise InputError(url, f"an image of {instrument}", "one of the narrow angle, MOC-NA")
        return label

    def _cover(self, label: str) -> Interval | None:
        return stated_interval(self._store, WantedFile(self._archives.kernels + label, kernel_path(label)))

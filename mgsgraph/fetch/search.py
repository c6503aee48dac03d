"""What an image needs, found out from the archives: volume, label, kernels of its time, laser profile."""

import re
from collections.abc import Sequence

from mgsgraph.errors import InputError
from mgsgraph.fetch.archives import Archives
from mgsgraph.fetch.camera_search import CameraSearch
from mgsgraph.fetch.cameras import CameraProduct
from mgsgraph.fetch.download import NotInArchive
from mgsgraph.fetch.kernel_phases import Interval, find_kernels
from mgsgraph.fetch.needs import ImageNeeds, Product, ProductId, WantedFile, kernel_path
from mgsgraph.fetch.profiles import find_profile, orbit_at
from mgsgraph.fetch.store import DownloadFolder
from mgsgraph.fetch.volumes import NAMES, IndexRow, find_image, read_index, volumes_listed
from mgsgraph.files.opening import read_text
from mgsgraph.files.pvl import Block, flat_label

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
        self._rows: dict[str, Sequence[IndexRow]] = {}

    def needs(self, product: Product) -> ImageNeeds:
        """All that one image needs.

        Raises
        ------
        InputError
            No such image, one of the wide angle, no kernels of its time, or an archive that can't be reached.
        """
        if isinstance(product, CameraProduct):
            return self._other.needs(product)
        if not self._volumes:
            self._volumes = volumes_listed(self._store.remote.listing(self._archives.images))
        volume, row = find_image(product, self._volumes, self._index)
        if not _FILE.fullmatch(row.file):
            raise InputError(f"index of {volume}, {product}", repr(row.file), "a path such as m08060/m0806047.imq")
        file = f"{volume}/{row.file}"
        label = self._image_label(product, self._archives.images + file)
        taken, where = Interval.of(label), str(product)
        orbit = label.count("ORBIT_NUMBER") if "ORBIT_NUMBER" in label else orbit_at(taken.middle)
        kernels, unconfirmed = find_kernels(taken, self._cover, where)
        pedr, why = find_profile(orbit, taken, self._archives, self._store.remote, where)
        return ImageNeeds(
            product, file, label.text("START_TIME"), label.text("STOP_TIME"), orbit, kernels, pedr,
            (*unconfirmed, *([why] if why else [])),
        )

    def _index(self, volume: str) -> Sequence[IndexRow]:
        """Of a volume; empty where the archive has none."""
        if volume not in self._rows:
            self._rows[volume] = self._read_index(volume)
        return self._rows[volume]

    def _read_index(self, volume: str) -> Sequence[IndexRow]:
        for name in NAMES:
            address, path = f"{self._archives.images}{volume}/index/{name}", f"index/{volume}"
            try:
                label = self._store.get(WantedFile(f"{address}.lbl", f"{path}.lbl"))
                return read_index(self._store.get(WantedFile(f"{address}.tab", f"{path}.tab")), label)
            except NotInArchive:
                continue
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
        """What a kernel's label says that it covers; None without a label, or in one without times."""
        try:
            path = self._store.get(WantedFile(self._archives.kernels + label, kernel_path(label)))
        except NotInArchive:
            return None
        return Interval.said_by(flat_label(read_text(path, encoding="latin-1"), str(path)))

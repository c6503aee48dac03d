"""Ids of MOC images; what an image needs, by paths in the archives' layout; where each file goes in a folder."""

import math
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, fields
from pathlib import PurePosixPath
from typing import Any, NamedTuple

from mgsgraph.errors import InputError
from mgsgraph.fetch.archives import Archives
from mgsgraph.fetch.cameras import CAMERAS, ArchivedCamera, CameraProduct
from mgsgraph.record import Record

_ID = re.compile(r"([a-z][a-z0-9]{2})[/_-]?(\d{5})(\.(imq|img|cub|lbl))?", re.IGNORECASE)
_MAPPING = re.compile(r"M[01]\d|M2[0-3]|[ERS](0[1-9]|1\d|2[0-3])")
"""Phases of the mapping mission: M00 .. M23, then E01 .. E23, R01 .. R23, S01 .. S23."""
_LETTERS = "MERS"
"""In the order of time."""


class ProductId(NamedTuple):
    """One image's id; of two the earlier one is that with the smaller `order`."""

    phase: str
    """Such as E02."""
    number: str
    """Five digits."""

    def __str__(self) -> str:
        return f"{self.phase}/{self.number}"

    @property
    def name(self) -> str:
        """As cases and networks call the image."""
        return f"{self.phase}-{self.number}"

    @property
    def order(self) -> tuple[int, int, int]:
        """What sorts ids by time."""
        return _LETTERS.index(self.phase[0]), int(self.phase[1:]), int(self.number)

    @classmethod
    def read(cls, text: str) -> "ProductId":
        """From E02/00665, E02-00665, e0200665 or E0200665.imq.

        Raises
        ------
        InputError
            Anything else, and images from before the mapping mission, which another data set holds.
        """
        match = _ID.fullmatch(text.strip())
        if match is None:
            known = ", ".join(camera.example for camera in CAMERAS)
            raise InputError(
                f"image {text!r}"[:80], "not the id of an image of MOC, CTX, LROC NAC or HRSC",
                f"one such as E02/00665, e0200665, {known}",
            )
        product = cls(match[1].upper(), match[2])
        if not _MAPPING.fullmatch(product.phase):
            raise InputError(
                f"image {product}", f"of the phase {product.phase}, which is not in the archive's mapping volumes",
                "phases M00 .. M23, E01 .. E23, R01 .. R23, S01 .. S23",
            )
        return product


Product = ProductId | CameraProduct
"""An image's id."""


def read_product(text: str) -> Product:
    """An id of CTX, LROC NAC or HRSC, or else of MOC; InputError for any other."""
    return CameraProduct.read(text) or ProductId.read(text)


def products_of(texts: Sequence[str]) -> tuple[Product, ...]:
    """Ids in their order, each once, of one mission."""
    if not texts:
        raise InputError("images", "none", "at least one id, such as E02/00665")
    products = tuple(dict.fromkeys(map(read_product, texts)))
    require_one_mission(products)
    return products


def require_one_mission(products: Iterable[Product]) -> None:
    """Raise InputError for images of several missions: a folder has the kernels of one."""
    missions = {one.camera.kernels if isinstance(one, CameraProduct) else "mgs_kernels" for one in products}
    if len(missions) > 1:
        names = ", ".join(sorted(name.partition("_")[0].upper() for name in missions))
        raise InputError("images", f"of several missions ({names})", "images of one", "fetch them into a folder each")


LEAP_SECONDS = "naif0012.tls"
FIXED = (
    "sclk/mgs_sclkscet_00061.tsc", "pck/pck00009.tpc", "fk/mgs_v10.tf", "ik/mgs_moc_v20.ti", "spk/de405.bsp",
)  # fmt: skip
"""Kernels that every image needs, after the leap seconds, in the order of loading: clock, constants, frames, instrument
and planets."""


_TEXTS = ("image", "start", "stop", "pedr", "shots", "addendum")
"""Of an image's entry in a lock."""


class WantedFile(NamedTuple):
    """A file: where from, and where to in the folder."""

    url: str
    path: str


@dataclass(frozen=True, slots=True)
class ImageNeeds(Record):
    """What one image needs of the archives, as found."""

    product: Product
    image: str
    """Path of its file below the images' archive: mgsc_1068/m08060/m0806047.imq."""
    start: str
    stop: str
    """UTC, as its label has them."""
    orbit: int
    """Mapping orbit."""
    kernels: tuple[str, ...]
    """Of its time, below the kernels' archive: spk/mgs_map2.bsp, ck/mgs_sc_map2.bc; SPK first, each kind by time."""
    pedr: str = ""
    """Below the PEDR's archive: ap10xxx/ap10717l.b; empty for none."""
    notes: tuple[str, ...] = ()
    """Sentences about what could not be found or confirmed."""
    shots: str = ""
    """Laser shots over its ground, below ODE; empty for none."""
    addendum: str = ""
    """To its instrument kernel, below ISIS's data; empty for none."""
    box: tuple[float, ...] = ()
    """deg, of its ground: least and largest planetocentric latitude, then east longitude; empty where unknown."""

    @classmethod
    def of(cls, entry: Mapping[str, Any]) -> "ImageNeeds":
        """From its entry in a lock."""
        values = dict(entry)
        values |= {key: tuple(map(str, values[key])) for key in ("kernels", "notes")}
        values["box"] = tuple(map(float, values.get("box", ())))
        texts = all(isinstance(values.get(key, ""), str) for key in _TEXTS)
        if not texts or not all(map(math.isfinite, values["box"])):
            raise ValueError("an image's entry")
        return cls(**(values | {"product": read_product(str(values["product"]))}))

    def entry(self) -> dict[str, Any]:
        """For a lock."""
        entry = {one.name: getattr(self, one.name) for one in fields(self)}
        return entry | {"product": str(self.product)}

    @property
    def camera(self) -> ArchivedCamera | None:
        """Its camera; None for MOC."""
        return self.product.camera if isinstance(self.product, CameraProduct) else None

    @property
    def shots_path(self) -> str:
        """Of the laser shots in the folder; empty for none."""
        return f"shots/{self.product.name.lower()}_pts_csv.csv" if self.shots else ""

    @property
    def image_path(self) -> str:
        """Of the image in the folder."""
        return f"images/{PurePosixPath(self.image).name}"

    @property
    def pedr_path(self) -> str:
        """Of the profile in the folder; empty for none."""
        return f"pedr/{PurePosixPath(self.pedr).name}" if self.pedr else ""


def kernel_path(kernel: str) -> str:
    """In the folder, of a kernel of the archive."""
    return f"kernels/{PurePosixPath(kernel).name}"


def kernels_of(needs: Iterable[ImageNeeds]) -> tuple[str, ...]:
    """Of all images, each once, SPK before CK and each kind by time, for what is loaded later wins."""
    mine = dict.fromkeys(kernel for image in sorted(needs, key=lambda one: one.start) for kernel in image.kernels)
    return tuple(sorted(mine, key=lambda kernel: kernel.startswith("ck/")))


def wanted_files(needs: Iterable[ImageNeeds], archives: Archives) -> tuple[WantedFile, ...]:
    """All files but those of the terrain, each once."""
    needs = tuple(needs)
    found = list[WantedFile]()
    for image in needs:
        root = archives.images if image.camera is None else getattr(archives, image.camera.images)
        found.append(WantedFile(root + image.image, image.image_path))
    if any(image.camera is None for image in needs):
        found.append(WantedFile(archives.leap_seconds + LEAP_SECONDS, f"kernels/{LEAP_SECONDS}"))
        found += [WantedFile(archives.kernels + kernel, kernel_path(kernel)) for kernel in (*FIXED, *kernels_of(needs))]
    for image in needs:
        if image.camera is not None:
            root = getattr(archives, image.camera.kernels)
            found += [WantedFile(root + kernel, kernel_path(kernel)) for kernel in image.kernels]
            found += [WantedFile(archives.isis + one, kernel_path(one)) for one in [image.addendum] if one]
    found += [WantedFile(archives.pedr + image.pedr, image.pedr_path) for image in needs if image.pedr]
    found += [WantedFile(archives.ode + image.shots, image.shots_path) for image in needs if image.shots]
    return tuple(dict.fromkeys(found))

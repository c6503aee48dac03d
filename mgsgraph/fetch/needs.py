"""What an image needs, by its paths in the archives' layout, and where each file goes in a folder of ours."""

from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass
from pathlib import PurePosixPath
from typing import Any, NamedTuple

from mgsgraph.fetch.archives import Archives
from mgsgraph.fetch.product import ProductId

LEAP_SECONDS = "naif0012.tls"
FIXED = (
    "sclk/mgs_sclkscet_00061.tsc", "pck/pck00009.tpc", "fk/mgs_v10.tf", "ik/mgs_moc_v20.ti", "spk/de405.bsp",
)  # fmt: skip
"""Kernels that every image needs, after the leap seconds, in the order of loading: clock, constants, frames, instrument
and planets."""


class Wanted(NamedTuple):
    """A file: where from, and where to in the folder."""

    url: str
    path: str


@dataclass(frozen=True, slots=True)
class ImageNeeds:
    """What one image needs of the archives, as found."""

    product: ProductId
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

    @classmethod
    def of(cls, entry: Mapping[str, Any]) -> "ImageNeeds":
        """From its entry in a lock."""
        values = dict(entry)
        values |= {key: tuple(map(str, values[key])) for key in ("kernels", "notes")}
        return cls(**(values | {"product": ProductId.read(str(values["product"]))}))

    def entry(self) -> dict[str, Any]:
        """For a lock."""
        return asdict(self) | {"product": str(self.product)}

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


def wanted_files(needs: Iterable[ImageNeeds], archives: Archives) -> tuple[Wanted, ...]:
    """All files but those of the terrain, each once."""
    needs = tuple(needs)
    found = [Wanted(archives.images + image.image, image.image_path) for image in needs]
    found.append(Wanted(archives.leap_seconds + LEAP_SECONDS, f"kernels/{LEAP_SECONDS}"))
    found += [Wanted(archives.kernels + kernel, kernel_path(kernel)) for kernel in (*FIXED, *kernels_of(needs))]
    found += [Wanted(archives.pedr + image.pedr, image.pedr_path) for image in needs if image.pedr]
    return tuple(dict.fromkeys(found))

"""Cameras other than MOC whose images are fetched: what their ids look like, and where archives have image and kernels.

Sources: volumes and file names of the PDS archives as ISIS, Ames Stereo Pipeline and USGS list them (mrox_NNNN,
LROLRC_NNNN, mexhrs_NNNN); product types of the Orbital Data Explorer (ODE) REST service as its query `iipt` names them
(MRO CTX EDR; LRO LROC EDRNAC4, by the id nac.PRODUCT); NAIF's PDS archives, whose meta-kernels for a year
(mro_2009_v14.tm, lro_2024_v02.tm) list all kernels below data/.
"""

import re
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class ArchivedCamera:
    """One camera's archive."""

    name: str
    """In messages."""
    pattern: re.Pattern[str]
    """Ids, whole and in capitals."""
    example: str
    """An id."""
    instrument: str
    """INSTRUMENT_ID of its labels."""
    images: str
    """Field of `Archives` below which its files are."""
    file: str
    """Regular expression of a file's path there; `{}` stands for the id."""
    query: str
    """Of ODE, for one product, after the address; `{}` stands for the id. Empty: volumes are looked through."""
    kernels: str
    """Field of `Archives` with its kernels."""
    meta_kernel: str
    """Regular expression of the names of meta-kernels; `{}` stands for the year."""
    attitude: re.Pattern[str]
    """Names of the CKs that its pointing needs, among those of antennas, arrays and other instruments."""
    altimetry: str
    """Query of ODE for shots over a box: that altimeter's data set on the body."""
    addendum: str = ""
    """ISIS's addendum to the instrument kernel, below its data, where that kernel lacks what the camera needs."""
    moon: bool = False
    """Whether it flies about the Moon, of which no terrain is fetched."""


CTX = ArchivedCamera(
    "CTX", re.compile(r"[A-Z]\d{2}_\d{6}_\d{4}_X[A-Z]_\d{2}[NS]\d{3}W"), "B10_013341_1010_XN_79S172W", "CTX", "ctx",
    r"mrox_\d{{4}}/data/{}\.IMG",
    "live2/?query=product&results=m&output=JSON&target=mars&ihid=MRO&iid=CTX&pt=EDR&pdsid={}",
    "mro_kernels", r"mro_{}_v\d\d\.tm", re.compile(r"mro_sc_"), "molapedr",
    "mro/kernels/iak/mroctxAddendum005.ti",
)  # fmt: skip
LROC_NAC = ArchivedCamera(
    "LROC NAC", re.compile(r"M\d{9,10}[LR]E"), "M103595705LE", "LROC", "lroc",
    r"LROLRC_\d{{4}}[A-Z]?/DATA/\w+/\d{{7}}/NAC/{}\.IMG",
    "live2/?query=product&results=m&output=JSON&target=moon&ihid=LRO&iid=LROC&pt=EDRNAC4&pdsid=nac.{}",
    "lro_kernels", r"lro_{}_v\d\d\.tm", re.compile(r"(lrosc|lrolc|moc42)"), "lolardr",
    "lro/kernels/iak/lro_instrumentAddendum_v04.ti", True,
)  # fmt: skip
HRSC = ArchivedCamera(
    "HRSC", re.compile(r"H[0-9A-Z]\d{3}_\d{4}_([A-Z]{2}\d?|[A-Z]\d\d)"), "h5270_0000_ir2", "HRSC", "hrsc",
    r"mexhrs_\d{{4}}/data/\w+/{}\.img", "", "mex_kernels", r"mex_(?:{}_)?v\d\d\.tm",
    re.compile(r"atnm_measured", re.IGNORECASE), "molapedr", "mex/kernels/iak/hrscAddendum004.ti",
)  # fmt: skip
CAMERAS = (CTX, LROC_NAC, HRSC)
"""All of them."""


@dataclass(frozen=True, slots=True)
class CameraProduct:
    """One image's id, and whose it is."""

    camera: ArchivedCamera
    """Its camera."""
    name: str
    """In capitals; also what cases call the image."""

    def __str__(self) -> str:
        return self.name

    @classmethod
    def read(cls, text: str) -> "CameraProduct | None":
        """From an id in capitals or not, with or without ending; None where it is none of these cameras'."""
        name = re.sub(r"\.(img|imq|lbl|xml|cub)$", "", text.strip(), flags=re.IGNORECASE).upper()
        return next((cls(camera, name) for camera in CAMERAS if camera.pattern.fullmatch(name)), None)

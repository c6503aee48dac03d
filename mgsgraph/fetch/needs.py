"""Ids of images; what an image needs, by paths in the archives' layout; where each file goes in a folder; MOLA's grids.

Cameras other than MOC: volumes and file names of the PDS archives as ISIS, Ames Stereo Pipeline and USGS list them
(mrox_NNNN, LROLRC_NNNN, mexhrs_NNNN); product types of the Orbital Data Explorer (ODE) REST service as its query `iipt`
names them (MRO CTX EDR; LRO LROC EDRNAC4, by the id nac.PRODUCT); NAIF's PDS archives, whose meta-kernels for a year
(mro_2009_v14.tm, lro_2024_v02.tm) list all kernels below data/.
"""

import math
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, fields
from pathlib import Path, PurePosixPath
from typing import Any, NamedTuple, cast, get_args
from urllib.parse import urlsplit

from mgsgraph.case.terrain import MEGDR_SIGMAS, MegdrResolution
from mgsgraph.errors import InputError, require
from mgsgraph.files.decoding import LARGEST_TOML, toml_table
from mgsgraph.files.opening import read_text
from mgsgraph.record import Record

_SCHEMES = ("https", "http")


@dataclass(frozen=True, slots=True)
class Archives(Record):
    """Addresses (http or https) under which the archives' own layout begins; each ends in a slash.

    Examples
    --------
    >>> archives = mgsgraph.Archives(kernels="https://mirror.example.org/naif/")
    >>> archives.kernels
    'https://mirror.example.org/naif/'
    >>> mgsgraph.Archives.under("http://localhost:8000").pedr
    'http://localhost:8000/pedr/'
    """

    images: str = "https://planetarydata.jpl.nasa.gov/img/data/mgs-m-moc-na_wa-2-sdp-l0-v1.0/"
    """MOC standard data products: volumes mgsc_NNNN/ (PDS Imaging node)."""
    kernels: str = "https://naif.jpl.nasa.gov/pub/naif/pds/data/mgs-m-spice-6-v1.0/mgsp_1000/data/"
    """SPICE kernels of MGS: spk/, ck/, sclk/, ik/, fk/, pck/ (NAIF)."""
    leap_seconds: str = "https://naif.jpl.nasa.gov/pub/naif/generic_kernels/lsk/"
    """NAIF's generic leap seconds kernels."""
    pedr: str = "https://pds-geosciences.wustl.edu/mgs/mgs-m-mola-3-pedr-l1a-v1/mgsl_21xx/data/"
    """MOLA's profiles: apNNxxx/apNNNNNl.b (PDS Geosciences node)."""
    megdr: str = "https://pds-geosciences.wustl.edu/mgs/mgs-m-mola-5-megdr-l3-v1/mgsl_300x/"
    """MOLA's grids: meg004/, meg016/, meg128/ (PDS Geosciences node)."""
    ctx: str = "https://planetarydata.jpl.nasa.gov/img/data/mro/ctx/"
    """CTX: volumes mrox_NNNN/data/ (PDS Imaging node)."""
    lroc: str = "https://pds.lroc.im-ldi.com/data/LRO-L-LROC-2-EDR-V1.0/"
    """LROC: volumes LROLRC_NNNN/DATA/ (LROC node)."""
    hrsc: str = "https://pds-geosciences.wustl.edu/mex/mex-m-hrsc-3-rdr-v4/"
    """HRSC: volumes mexhrs_NNNN/data/ORBIT/ (PDS Geosciences node)."""
    mro_kernels: str = "https://naif.jpl.nasa.gov/pub/naif/pds/data/mro-m-spice-6-v1.0/mrosp_1000/"
    """SPICE kernels of MRO: extras/mk/, data/ (NAIF)."""
    lro_kernels: str = "https://naif.jpl.nasa.gov/pub/naif/pds/data/lro-l-spice-6-v1.0/lrosp_1000/"
    """SPICE kernels of LRO."""
    mex_kernels: str = "https://naif.jpl.nasa.gov/pub/naif/pds/data/mex-e_m-spice-6-v2.0/mexsp_2000/"
    """SPICE kernels of Mars Express."""
    isis: str = "https://asc-isisdata.s3.us-west-2.amazonaws.com/usgs_data/"
    """ISIS's own data: addenda of instrument kernels, MISSION/kernels/iak/ (USGS)."""
    ode: str = "https://oderest.rsl.wustl.edu/"
    """REST services of the Orbital Data Explorer: live2 (products), livegds (laser shots over a box)."""

    def __post_init__(self) -> None:
        for field in fields(self):
            address = getattr(self, field.name)
            require_address(address, f"archives, {field.name}")
            if not address.endswith("/"):
                object.__setattr__(self, field.name, f"{address}/")

    @classmethod
    def under(cls, address: str) -> "Archives":
        """All of them below one address, in folders called as the fields are: images/, kernels/ ..."""
        require_address(address, "mirror")
        return cls(*(f"{address.rstrip('/')}/{field.name}/" for field in fields(cls)))

    @classmethod
    def read(cls, path: Path) -> "Archives":
        """From a TOML file, ``kernels = "https://..."`` and so on; the public ones for keys that it lacks.

        Raises
        ------
        InputError
            A file that can't be read or is no TOML, a key that is no archive, or no address of http or https.
        """
        table = toml_table(read_text(path, limit=LARGEST_TOML), str(path))
        names = [field.name for field in fields(cls)]
        for key, value in table.items():
            require(key in names, f"{path}, {key}", "no archive of that name", ", ".join(names))
            if not isinstance(value, str):
                raise InputError(f"{path}, {key}", repr(value)[:60], "an address in quotation marks")
            require_address(value, f"{path}, {key}")
        return cls(**table)

    @classmethod
    def chosen(cls, mirror: str | None = None) -> "Archives":
        """Those below an address, or of a TOML file's path; the public ones for None."""
        if mirror is None:
            return cls()
        return cls.under(mirror) if "://" in mirror else cls.read(Path(mirror))


def require_address(address: str, where: str) -> None:
    """Raise InputError unless it is an address of http or https with a host."""
    try:
        parts = urlsplit(address)
        sound = parts.scheme in _SCHEMES and bool(parts.hostname) and (parts.port is None or parts.port > 0)
    except ValueError:  # a port that is no number, brackets that don't close
        sound = False
    if not sound or parts.query or parts.fragment:
        raise InputError(where, repr(address), "an address such as https://example.org/data/")
    if parts.username is not None or parts.password is not None:  # they would stand in the lock file
        raise InputError(where, "an address with a name or password", "one without", "put them into ~/.netrc")




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
    """Of ODE, for its products, after the address. Empty: volumes are looked through."""
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
    "live2/?query=product&results=m&output=JSON&target=mars&ihid=MRO&iid=CTX&pt=EDR",
    "mro_kernels", r"mro_{}_v\d\d\.tm", re.compile(r"mro_sc_"), "molapedr",
    "mro/kernels/iak/mroctxAddendum005.ti",
)  # fmt: skip
LROC_NAC = ArchivedCamera(
    "LROC NAC", re.compile(r"M\d{9,10}[LR]E"), "M103595705LE", "LROC", "lroc",
    r"LROLRC_\d{{4}}[A-Z]?/DATA/\w+/\d{{7}}/NAC/{}\.IMG",
    "live2/?query=product&results=m&output=JSON&target=moon&ihid=LRO&iid=LROC&pt=EDRNAC4",
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
            examples = ", ".join(camera.example for camera in CAMERAS)
            raise InputError(
                f"image {text!r}"[:80], "not the id of an image of MOC, CTX, LROC NAC or HRSC",
                f"one such as E02/00665, e0200665, {examples}",
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
    require(texts, "images", "none", "at least one id, such as E02/00665")
    products = tuple(dict.fromkeys(map(read_product, texts)))
    require_one_mission(products)
    return products


def require_one_mission(products: Iterable[Product]) -> None:
    """Raise InputError for images of several missions: a folder has the kernels of one."""
    missions = {product.camera.kernels if isinstance(product, CameraProduct) else "mgs_kernels" for product in products}
    found = f"of several missions ({', '.join(sorted(name.partition('_')[0].upper() for name in missions))})"
    require(len(missions) <= 1, "images", found, "images of one", "fetch them into a folder each")


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
        entry = {field.name: getattr(self, field.name) for field in fields(self)}
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
    kernels = dict.fromkeys(kernel for image in sorted(needs, key=lambda need: need.start) for kernel in image.kernels)
    return tuple(sorted(kernels, key=lambda kernel: kernel.startswith("ck/")))


def wanted_files(needs: Iterable[ImageNeeds], archives: Archives) -> tuple[WantedFile, ...]:
    """All files but those of the terrain, each once."""
    needs = tuple(needs)
    files = list[WantedFile]()
    for image in needs:
        root = archives.images if image.camera is None else getattr(archives, image.camera.images)
        files.append(WantedFile(root + image.image, image.image_path))
    if any(image.camera is None for image in needs):
        files.append(WantedFile(archives.leap_seconds + LEAP_SECONDS, f"kernels/{LEAP_SECONDS}"))
        files += [WantedFile(archives.kernels + kernel, kernel_path(kernel)) for kernel in (*FIXED, *kernels_of(needs))]
    for image in needs:
        if image.camera is not None:
            root = getattr(archives, image.camera.kernels)
            files += [WantedFile(root + kernel, kernel_path(kernel)) for kernel in image.kernels]
            files += [WantedFile(archives.isis + path, kernel_path(path)) for path in [image.addendum] if path]
    files += [WantedFile(archives.pedr + image.pedr, image.pedr_path) for image in needs if image.pedr]
    files += [WantedFile(archives.ode + image.shots, image.shots_path) for image in needs if image.shots]
    return tuple(dict.fromkeys(files))


class Grid(NamedTuple):
    """How a grid lies in the archive, and how well it knows the ground between its posts."""

    stems: tuple[str, ...]
    """Paths below the archive of the radii, without ending; the topography has a t in place of the r."""
    sigma: float
    """m, of its heights as a surface."""


_WHOLE = {"4": "meg004/megr90n000cb", "16": "meg016/megr90n000eb"}
_TILE = 44, 90
"""deg of latitude and longitude of a tile of 128 pixels per degree; none reach beyond 88 deg."""
_EDGE = 0.1
"""deg around an image's ground that has to be on the tiles, too."""


def terrain_of(text: str) -> MegdrResolution:
    """A choice by its name; InputError for any other."""
    require(text in get_args(MegdrResolution), "terrain", repr(text), "4, 16 or 128 pixels per degree, or none")
    return cast(MegdrResolution, text)


def grid_of(terrain: MegdrResolution, places: Iterable[tuple[float, float]] = ()) -> Grid:
    """The grid of a resolution.

    Parameters
    ----------
    terrain : str
        Not "none".
    places : iterable of (float, float)
        deg, longitude east and planetocentric latitude of the images' ground, for tiles.

    Raises
    ------
    InputError
        Ground beyond 88 deg of latitude, which no tile has.
    """
    if terrain in _WHOLE:
        return Grid((_WHOLE[terrain],), MEGDR_SIGMAS[terrain])
    around = [(lon + a, lat + b) for lon, lat in places for a in (-_EDGE, _EDGE) for b in (-_EDGE, _EDGE)]
    return Grid(tuple(sorted({_tile(*place) for place in around})), MEGDR_SIGMAS[terrain])


def _tile(longitude: float, latitude: float) -> str:
    """Radii of the tile that a place (deg) is on."""
    rows, columns = _TILE
    if abs(latitude) >= 2 * rows:
        raise InputError("terrain", f"ground at latitude {latitude:.1f} deg", "tiles end at 88 deg", "--terrain 16")
    top = rows * int(latitude // rows + 1)
    return f"meg128/megr{abs(top):02d}{'n' if top >= 0 else 's'}{int(longitude % 360.0 // columns) * columns:03d}hb"


def topography(stem: str) -> str:
    """Heights above the areoid that belong to a file of radii."""
    return stem.replace("megr", "megt")


def wanted_grids(grid: Grid, archives: Archives) -> tuple[WantedFile, ...]:
    """Files of a grid with their labels."""
    return tuple(
        WantedFile(f"{archives.megdr}{name}{suffix}", f"megdr/{name.partition('/')[2]}{suffix}")
        for stem in grid.stems
        for name in (stem, topography(stem))
        for suffix in (".lbl", ".img")
    )

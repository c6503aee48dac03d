"""Files for an image of CTX, LROC NAC or HRSC: its own by ODE or its volumes, kernels of its time by meta-kernel and
labels, laser shots over its ground by ODE.
"""

import re
from collections.abc import Iterator
from contextlib import suppress
from datetime import UTC, datetime, timedelta
from typing import NamedTuple

from mgsgraph.errors import InputError
from mgsgraph.fetch.download import NotInArchive, Remote
from mgsgraph.fetch.kernel_phases import MARGIN, Interval
from mgsgraph.fetch.needs import ArchivedCamera, Archives, CameraProduct, ImageNeeds, WantedFile, kernel_path
from mgsgraph.fetch.store import DownloadFolder
from mgsgraph.files.opening import read_text
from mgsgraph.files.pvl import Block, flat_label

_LABEL = 1 << 16
"""bytes in which the label of an image lies."""
_KERNEL = re.compile(r"[\"']?\$?\w{0,40}/?((?:lsk|pck|sclk|fk|ik|spk|ck)/[\w.-]+\.\w{2,4})", re.IGNORECASE)
"""A kernel in a meta-kernel, below data/; its path may be cut by '+' before a line's end."""
_DATES = re.compile(r"_(\d{6}|\d{7})_(\d{6}|\d{7})(?=[_.])")
_URL = re.compile(r"https?://[^\s<>\"']{1,300}?/(output/[\w.-]+/[\w.-]+_pts_csv\.csv)")
_EDGE = 0.02
"""deg around an image's box in which shots are asked for."""
_PAGE = 100
"""Products that ODE is asked for at a time."""


class Box(NamedTuple):
    """deg, longitudes east and planetocentric latitudes."""

    south: float
    north: float
    west: float
    east: float

    def holds(self, longitude: float, latitude: float) -> bool:
        """Whether a place lies in it, deg; never for NaN."""
        return (longitude - self.west) % 360.0 <= self.east - self.west and self.south <= latitude <= self.north

    @property
    def query(self) -> str:
        """The box as ODE's queries have it, longitudes in 0 .. 360: over the prime meridian the western one is the
        larger.
        """
        south, north, west, east = self
        west, east = (0.0, 360.0) if east - west >= 360.0 else (west % 360.0, east % 360.0 or 360.0)
        limits = max(south, -90.0), min(north, 90.0), west, east
        sides = zip(("minlat", "maxlat", "westernlon", "easternlon"), limits, strict=True)
        return "".join(f"&{name}={side:.4f}" for name, side in sides)


def stated_interval(store: DownloadFolder, label: WantedFile) -> Interval | None:
    """What a kernel's label says that it covers; None without a label, or in one without times."""
    try:
        path = store.get(label)
    except NotInArchive:
        return None
    return Interval.stated_by(flat_label(read_text(path, encoding="latin-1"), str(path)))


class CameraSearch:
    """Looks images up; meta-kernels and kernels' labels that it reads on the way stay in the store."""

    def __init__(self, archives: Archives, store: DownloadFolder) -> None:
        self._archives, self._store = archives, store

    def needs(self, product: CameraProduct) -> ImageNeeds:
        """All that one image needs.

        Raises
        ------
        InputError
            No such image, no meta-kernel of its year, no kernels of its time, or an archive that can't be reached.
        """
        camera, answer = product.camera, self._asked(product)
        file = self._file(product, answer)
        root = getattr(self._archives, camera.images)
        label = self._label(product, root + file)
        exposure = Interval.of(label)
        box = box_of(answer, label)
        kernels = self._kernels(camera, exposure, str(product))
        shots, why = self._shots(camera, box, str(product))
        addendum, lacking = self._addendum(camera, str(product))
        orbit = label.count("ORBIT_NUMBER") if "ORBIT_NUMBER" in label and label.text("ORBIT_NUMBER").isdigit() else 0
        return ImageNeeds(
            product, file, label.text("START_TIME"), label.text("STOP_TIME"), orbit, kernels, "", (*why, *lacking),
            shots, addendum, tuple(box) if box else (),
        )  # fmt: skip

    def _asked(self, product: CameraProduct) -> str:
        """ODE's answer about a product; empty for a camera without a query."""
        camera = product.camera
        if not camera.query:
            return ""
        name = f"nac.{product.name.lower()}" if camera.moon else product.name
        return self._store.remote.listing(f"{self._archives.ode}{camera.query}&pdsid={name}")

    def images_in(self, box: Box, camera: ArchivedCamera) -> list[str]:
        """Ids of a camera's images whose footprints meet a box, by ODE, in its order."""
        found, known = dict[str, None](), -1
        while len(found) > known:
            known = len(found)
            page = f"{camera.query}{box.query}&limit={_PAGE}&offset={known}"
            answer = self._store.remote.listing(self._archives.ode + page).upper()
            found |= dict.fromkeys(re.findall(rf"\b{camera.pattern.pattern}\b", answer))
        return list(found)

    def _file(self, product: CameraProduct, answer: str) -> str:
        """Path of the image below its archive."""
        camera = product.camera
        where, expected = f"image {product}", f"one of {camera.name}, such as {camera.example}"
        pattern = camera.file.format(product.name)
        stem, _, suffix = pattern.rpartition(r"\.")
        if camera.query:
            match = re.search(f"({stem})" + r"\.\w+", answer, re.IGNORECASE)
            if match is None:
                unknown = "not known to the Orbital Data Explorer"
                raise InputError(where, unknown, expected, "check the id, or the mirror")
            return f"{match[1]}.{suffix}"
        root = getattr(self._archives, camera.images)
        listed = set(re.findall(r"mexhrs_\d{4}", self._store.remote.listing(root))) or {"mexhrs_4000", "mexhrs_1001"}
        for volume in sorted(listed, reverse=True):
            file = f"{volume}/data/{product.name[1:5].lower()}/{product.name.lower()}.{suffix}"
            with suppress(NotInArchive):
                self._store.remote.head(root + file, 1)
                return file
        nowhere = f"in none of {', '.join(sorted(listed))}"
        raise InputError(where, nowhere, expected, "check the id, and the digit of its level")

    def _label(self, product: CameraProduct, url: str) -> Block:
        head = self._store.remote.head(url, _LABEL)
        if b"PDS_VERSION_ID" not in head[:200]:
            raise InputError(url, f"it begins with {head[:16]!r}", "an image with its PDS3 label", "try another mirror")
        label = flat_label(head.split(b"\0", 1)[0].decode("latin-1"), url)
        name = label.text("PRODUCT_ID").strip().upper().removesuffix(".IMG")
        if name != product.name:
            raise InputError(f"{url}, PRODUCT_ID", repr(name), str(product), "the archive has another image there")
        if (instrument := label.text("INSTRUMENT_ID").upper()) != product.camera.instrument:
            raise InputError(url, f"an image of {instrument}", f"one of {product.camera.instrument}")
        return label

    # --- kernels

    def _kernels(self, camera: ArchivedCamera, exposure: Interval, where: str) -> tuple[str, ...]:
        """Paths below the kernels' archive, in the meta-kernel's order: of its time, and those of all times."""
        root = getattr(self._archives, camera.kernels)
        folder, name = self._meta_kernel(camera, root, exposure.middle.year, where)
        text = read_text(self._store.get(WantedFile(f"{root}{folder}{name}", kernel_path(name))), encoding="latin-1")
        data = "DATA/" if folder.isupper() else "data/"
        listed = [match[1] for match in _KERNEL.finditer(re.sub(r"\+'\s*'", "", text))]
        chosen = [data + path for path in dict.fromkeys(listed) if self._holds(camera, root + data, path, exposure)]
        for kind in ("spk", "ck"):
            if not any(f"/{kind}/" in path.lower() for path in chosen):
                raise InputError(f"{where}, {name}", f"no {kind.upper()} that holds {exposure}", "kernels of its time")
        return tuple(chosen)

    def _meta_kernel(self, camera: ArchivedCamera, root: str, year: int, where: str) -> tuple[str, str]:
        """Folder and name of the newest meta-kernel of a year."""
        for folder in ("extras/mk/", "EXTRAS/MK/"):
            page = self._store.remote.listing(root + folder)
            pattern = camera.meta_kernel.format(year)
            names = sorted(set(re.findall(rf"(?<=[\"/>])({pattern})(?=[\"<])", page, re.IGNORECASE)))
            if names:
                return folder, names[-1]
        expected = camera.meta_kernel.format(year)
        raise InputError(f"{where}, kernels of {year}", f"no meta-kernel in {root}extras/mk/", expected)

    def _holds(self, camera: ArchivedCamera, data: str, path: str, exposure: Interval) -> bool:
        """Whether a kernel is wanted: text of any time; an orbit or attitude by the dates in its name, or its label."""
        kind, _, name = path.rpartition("/")
        kind = kind.lower()
        if kind not in ("spk", "ck"):
            return True
        if kind == "ck" and not camera.attitude.match(name):
            return False
        interval = exposure.wider(MARGIN)
        if (covered := dates_in(name)) is not None and not covered.meets(interval):
            return False
        if covered is not None:
            return True
        label = path.rpartition(".")[0] + (".LBL" if name.isupper() else ".lbl")
        stated = stated_interval(self._store, WantedFile(data + label, kernel_path(label.lower())))
        return stated is None or stated.meets(interval)

    def _addendum(self, camera: ArchivedCamera, where: str) -> tuple[str, tuple[str, ...]]:
        """Path of ISIS's addendum below its data, and a sentence where there is none."""
        if not camera.addendum:
            return "", ()
        try:
            self._store.remote.head(self._archives.isis + camera.addendum, 1)
        except NotInArchive:
            name = camera.addendum.rpartition("/")[2]
            return "", (f"{where}: {name} is not among ISIS's data; put it into the meta-kernel by hand",)
        return camera.addendum, ()

    # --- shots

    def _shots(self, camera: ArchivedCamera, box: Box | None, where: str) -> tuple[str, tuple[str, ...]]:
        """Path below ODE of the altimeter's shots over a box, and sentences: why there are none."""
        if box is None:
            return "", (f"{where}: no laser shots, its place is not known before its kernels are here",)
        wider = Box(*(side + more for side, more in zip(box, (-_EDGE, _EDGE, -_EDGE, _EDGE), strict=True)))
        path = shots_in(wider, camera.altimetry, self._archives, self._store.remote)
        return path, () if path else (f"{where}: no laser shots, ODE has none over its ground",)


def shots_in(box: Box, data_set: str, archives: Archives, remote: Remote) -> str:
    """Path below ODE of the table that it makes of an altimeter's shots in a box; empty for none."""
    query = f"livegds/?query={data_set}&results=v&output=JSON{box.query}"
    match = _URL.search(remote.listing(archives.ode + query))
    return match[1] if match else ""


def box_of(answer: str, label: Block) -> Box | None:
    """Where an image lies, by ODE's answer or its label's footprint; None where neither says."""
    names = ("Minimum_latitude", "Maximum_latitude", "Westernmost_longitude", "Easternmost_longitude")
    matches = [re.search(rf"{name}\W+?([-+]?\d+(?:\.\d+)?)", answer) for name in names]
    if all(matches):
        return Box(*(float(match[1]) for match in matches if match))
    corners = ("FOOTPRINT_POINT_LATITUDE", "FOOTPRINT_POINT_LONGITUDE")
    if not all(name in label for name in corners):
        return None
    latitudes, longitudes = (
        [float(text) for text in label.entries[name.lower()].value if isinstance(text, str)] for name in corners
    )
    if not 3 <= len(longitudes) == len(latitudes):
        return None
    import numpy as np  # these take their time to load

    from mgsgraph.geometry.body import from_planetocentric
    from mgsgraph.geometry.footprint import eastward_bounds

    ring = from_planetocentric(np.radians([[*place, 1.0] for place in zip(longitudes, latitudes, strict=True)]))
    west, south, east, north = eastward_bounds(np.concatenate([ring, ring[:1]]))
    return Box(south, north, west, east) if np.isfinite(west) else None


def dates_in(name: str) -> Interval | None:
    """From the first of the dates in a kernel's name (YYMMDD or YYYYDDD) to the end of the second; None without two."""
    match = _DATES.search(name)
    days = list(_days(match.groups())) if match else []
    return Interval(days[0], days[1] + timedelta(days=1)) if len(days) == 2 and days[0] <= days[1] else None


def _days(texts: tuple[str, ...]) -> Iterator[datetime]:
    with suppress(ValueError):
        for text in texts:
            yield datetime.strptime(text, "%y%m%d" if len(text) == 6 else "%Y%j").replace(tzinfo=UTC)

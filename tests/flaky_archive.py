"""Archives on localhost, which serve ranges and commit the faults they are told to: a few images made up in memory, or
a simulated site laid out as the public archives are, which `mgsgraph fetch` finds and fetches.
"""

import hashlib
import re
import shutil
import socket
import threading
from collections import defaultdict, deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from datetime import datetime, timedelta
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from mgsgraph.files.rasters.megdr import REFERENCE_RADIUS
from mgsgraph.geometry.records import Array
from mgsgraph.simulation.camera import BORESIGHT_SAMPLE
from mgsgraph.simulation.ground import areoid_under, terrain_grid
from mgsgraph.simulation.mgs_files import kernel_segment, label_time, pedr_file, product_id, write_moc_image
from mgsgraph.simulation.mola_files import MegdrLayout, write_megdr, write_pedr
from mgsgraph.simulation.site import SimulatedImage, SimulatedSite
from mgsgraph.simulation.spice_files import CAMERA, CAMERA_FRAME_TEXT, ephemeris_time, write_kernels
from mgsgraph.units import DEG

Fault = Callable[["Handler", bytes], None]
"""Answers a request for some content in its own way."""


@dataclass
class Flaky:
    """Files by path, faults to come by path (each for one request, but for one that `stays`), and what was asked."""

    files: dict[str, bytes] = field(default_factory=dict)
    faults: defaultdict[str, deque[Fault]] = field(default_factory=lambda: defaultdict(deque))
    stays: dict[str, Fault] = field(default_factory=dict)
    asked: list[tuple[str, str | None]] = field(default_factory=list)
    """Path and Range of every request, in order."""
    conditions: list[str] = field(default_factory=list)
    """If-Range of every request that had one."""
    sent: defaultdict[str, int] = field(default_factory=lambda: defaultdict(int))
    """bytes of content that were sent, by path."""
    ranges: bool = True
    """Whether it knows Range."""
    validators: bool = True
    """Whether it says ETag and Last-Modified."""
    address: str = ""

    def reset(self, files: dict[str, bytes]) -> "Flaky":
        """Without faults and memory, holding other files."""
        self.files, self.ranges, self.validators = files, True, True
        for memory in (self.faults, self.stays, self.asked, self.sent, self.conditions):
            memory.clear()
        return self

    def url(self, path: str) -> str:
        return f"{self.address}/{path}"

    def listing(self, path: str) -> str | None:
        """Links to what lies in a folder, as servers make them."""
        inside = {name[len(path) :].split("/")[0] + "/" * ("/" in name[len(path) :]) for name in self.files
                  if name.startswith(path)}  # fmt: skip
        return "".join(f'<a href="{name}">{name}</a>\n' for name in sorted(inside)) if inside else None

    def requests(self, path: str) -> list[str | None]:
        return [asked for name, asked in self.asked if name == path]


class Handler(BaseHTTPRequestHandler):
    protocol_version, disable_nagle_algorithm = "HTTP/1.1", True
    archive: Flaky

    def log_message(self, format: str, *args: object) -> None:
        pass

    def do_GET(self) -> None:
        path, asked = self.path.lstrip("/"), self.headers.get("Range")
        archive = self.archive
        archive.asked.append((path, asked))
        archive.conditions += [self.headers["If-Range"]] if "If-Range" in self.headers else []
        if archive.faults[path]:
            archive.faults[path].popleft()(self, archive.files.get(path, b""))
        elif path in archive.stays:
            archive.stays[path](self, archive.files.get(path, b""))
        elif path in archive.files:
            self.serve(archive.files[path])
        elif path.endswith("/") and (page := archive.listing(path)):
            self.plain(200, page.encode())
        else:
            self.plain(404, b"<html>no such file</html>")

    def plain(self, status: int, body: bytes, headers: dict[str, str] | None = None) -> None:
        self.send_response(status)
        for name, value in ({"Content-Length": str(len(body))} | (headers or {})).items():
            self.send_header(name, value)
        self.end_headers()
        self.body(body)

    def serve(self, content: bytes, cut: int | None = None, longer: int = 0, shifted: int = 0) -> None:
        """The content or the range that is asked for; cut after some bytes, announced as longer than it is, or a range
        that begins elsewhere.
        """
        tag = f'"{hashlib.sha256(content).hexdigest()[:16]}"' if self.archive.validators else None
        if tag and self.headers.get("If-None-Match") == tag:
            self.plain(304, b"")
            return
        asked = re.fullmatch(r"bytes=(\d+)-(\d*)", self.headers.get("Range", ""))
        same = self.headers.get("If-Range") in (None, tag)
        first, status, total = 0, 200, len(content) + longer
        if asked and self.archive.ranges and same:
            first, status = int(asked[1]) + shifted, 206
            if first >= len(content):
                self.plain(416, b"", {"Content-Range": f"bytes */{len(content)}"})
                return
            content = content[: int(asked[2]) + 1] if asked[2] else content
        self.send_response(status)
        self.send_header("Content-Length", str(len(content) - first + longer))
        if status == 206:
            self.send_header("Content-Range", f"bytes {first}-{len(content) - 1}/{total}")
        if tag:
            self.send_header("ETag", tag)
        self.end_headers()
        self.archive.sent[self.path.lstrip("/")] += len(content[first:][:cut])  # before anybody can ask
        self.body(content[first:][:cut])
        if cut is not None or longer:
            self.hang_up()

    def body(self, content: bytes) -> bool:
        """Whether the other side has taken it."""
        try:
            self.wfile.write(content)
            self.wfile.flush()
        except OSError:  # it has had enough
            self.close_connection = True
            return False
        return True

    def hang_up(self) -> None:
        self.close_connection = True
        self.connection.shutdown(socket.SHUT_RDWR)


# --- faults


def cut(after: int) -> Fault:
    """The connection ends after some bytes."""
    return lambda handler, content: handler.serve(content, cut=after)


def status(code: int, **headers: str) -> Fault:
    named = {name.replace("_", "-"): value for name, value in headers.items()}
    return lambda handler, content: handler.plain(code, b"<html>sorry</html>", named)


def longer(by: int) -> Fault:
    """More bytes are announced than come."""
    return lambda handler, content: handler.serve(content, longer=by)


def elsewhere(by: int) -> Fault:
    """The range that comes is not the one that was asked for."""
    return lambda handler, content: handler.serve(content, shifted=by)


def some_at_a_time(count: int) -> Fault:
    """No range is longer than so many bytes, which RFC 9110 allows."""

    def fault(handler: Handler, content: bytes) -> None:
        if asked := re.fullmatch(r"bytes=(\d+)-", handler.headers.get("Range", "")):
            first = int(asked[1])
            piece = content[first : first + count]
            where = f"bytes {first}-{first + len(piece) - 1}/{len(content)}"
            handler.plain(206, piece, {"Content-Range": where})
        else:
            handler.serve(content, cut=count)

    return fault


def web_page(handler: Handler, content: bytes) -> None:
    handler.plain(200, b"<!DOCTYPE html><html>Service notice</html>", {"Content-Type": "text/html"})


def redirect(to: str) -> Fault:
    return lambda handler, content: handler.plain(302, b"", {"Location": to})


def endless(piece: bytes, code: int = 200, **headers: str) -> Fault:
    """Content that goes on until the other side has had enough, of no announced length."""

    def fault(handler: Handler, content: bytes) -> None:
        handler.send_response(code)
        for name, value in headers.items():
            handler.send_header(name.replace("_", "-"), value)
        handler.end_headers()
        handler.close_connection = True
        for _ in range(10_000):
            if not handler.body(piece):
                return

    return fault


def said_length(text: str) -> Fault:
    """The whole content, which is said to be so long."""

    def fault(handler: Handler, content: bytes) -> None:
        handler.plain(200, content, {"Content-Length": text.encode().decode("latin-1")})
        handler.hang_up()

    return fault


def stall(after: int, over: threading.Event) -> Fault:
    """Nothing more comes after some bytes."""

    def fault(handler: Handler, content: bytes) -> None:
        handler.send_response(200)
        handler.send_header("Content-Length", str(len(content)))
        handler.send_header("ETag", f'"{hashlib.sha256(content).hexdigest()[:16]}"')
        handler.end_headers()
        handler.body(content[:after])
        over.wait(120.0)
        handler.close_connection = True

    return fault


class Server(ThreadingHTTPServer):
    daemon_threads = True

    def handle_error(self, request: object, client_address: object) -> None:
        """The other side hangs up when it has seen enough."""


@contextmanager
def served() -> Iterator[Flaky]:
    """The archive at some port of localhost."""
    archive = Flaky()
    server = Server(("127.0.0.1", 0), type("Bound", (Handler,), {"archive": archive}))
    archive.address = f"http://127.0.0.1:{server.server_address[1]}"
    thread = threading.Thread(target=server.serve_forever, args=(0.02,), daemon=True)
    thread.start()
    try:
        yield archive
    finally:
        server.shutdown()
        server.server_close()
        thread.join()


@contextmanager
def serving(folder: Path) -> Iterator[str]:
    """The files of a folder; the address, for ``mgsgraph fetch --mirror``."""
    with served() as archive:
        archive.files = {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*.*")}
        yield archive.address


# --- an archive with a few images

SPICE_TEXT = b"KPL/FK\n\\begindata\nSOMETHING = 1\n\\begintext\n"
INSTRUMENT_TEXT = b"KPL/IK\n\\begindata\nINS-94031_PIXEL_SIZE     = ( 0.000013    )\n\\begintext\n"


def daf(kind: str, filling: bytes = b"") -> bytes:
    """What begins as a binary kernel does."""
    return (f"DAF/{kind:4}".encode() + filling).ljust(2048, b"\0")


def label(**values: str) -> bytes:
    lines = ["PDS_VERSION_ID = PDS3", *(f"{key} = {value}" for key, value in values.items()), "END"]
    return "\r\n".join([*lines, ""]).encode()


def image(
    product: str, start: str, stop: str, orbit: int | None = None, instrument: str = "MOC-NA", **more: str
) -> bytes:
    """An .imq: a record of 2048 bytes for the label, and one of pixels."""
    more |= {} if orbit is None else {"ORBIT_NUMBER": str(orbit)}
    head = label(
        RECORD_TYPE="FIXED_LENGTH", RECORD_BYTES="2048", FILE_RECORDS="2", LABEL_RECORDS="1",
        INSTRUMENT_ID=f'"{instrument}"', PRODUCT_ID=f'"{product}"', START_TIME=start, STOP_TIME=stop, **more,
    )  # fmt: skip
    return head.ljust(2048) + bytes(range(256)) * 8


def index(rows: list[tuple[str, str]], places: str = "", sense: str = "west") -> tuple[bytes, bytes]:
    """Table and label of products and instruments, and of their places, as "184.7 -5.1" each, where these are given;
    the columns stand elsewhere than in the archive's.
    """
    columns = [("INSTRUMENT_NAME", 2, 6), ("PRODUCT_ID", 11, 12), ("FILE_SPECIFICATION_NAME", 26, 19)]
    columns += [("CENTER_LONGITUDE", 47, 7), ("CENTER_LATITUDE", 55, 7)] if places else []
    text = "PDS_VERSION_ID = PDS3\r\nOBJECT = INDEX_TABLE\r\n" + "".join(
        f"OBJECT = COLUMN\r\nNAME = {name}\r\nSTART_BYTE = {start}\r\nBYTES = {size}\r\n"
        f'DESCRIPTION = "{name.lower()}, {sense}"\r\nEND_OBJECT = COLUMN\r\n'
        for name, start, size in columns
    )
    table = ""
    for k, (product, instrument) in enumerate(rows):
        stem = product.replace("/", "")
        place = "".join(f",{one:>7}" for one in places.split()[2 * k : 2 * k + 2])
        table += f'"{instrument:6}","{product:12}","{f"{stem[:6]}/{stem}.IMQ":19}"{place}\r\n'
    return table.encode(), f"{text}END_OBJECT = INDEX_TABLE\r\nEND\r\n".encode()


def pedr(start: str, stop: str) -> bytes:
    return label(RECORD_BYTES="776", START_TIME=start, STOP_TIME=stop).ljust(7760) + bytes(776)


def archive_files() -> dict[str, bytes]:
    """M04/02852 (its PEDR begins 5 orbits earlier), M04/02856 of the same day, and R10/00002 of 2003, in 3 volumes of
    which one is missing; M04/02853 is of the wide angle.
    """
    files = {
        "images/mgsc_1030/m04028/m0402852.imq": image("M04/02852", "1999-08-24T14:12:13.64", "1999-08-24T14:12:19.56"),
        "images/mgsc_1030/m04028/m0402856.imq": image(
            "M04/02856", "1999-08-24T20:12:13.64", "1999-08-24T20:12:19.56", 2066
        ),
        "images/mgsc_1280/r10000/r1000002.imq": image("R10/00002", "2003-10-02T00:00:00", "2003-10-02T00:00:09", 20383),
        "kernels/sclk/mgs_sclkscet_00061.tsc": SPICE_TEXT, "kernels/fk/mgs_v10.tf": SPICE_TEXT,
        "kernels/pck/pck00009.tpc": SPICE_TEXT, "kernels/ik/mgs_moc_v20.ti": INSTRUMENT_TEXT,
        "kernels/spk/de405.bsp": daf("SPK", b"planets"), "leap_seconds/naif0012.tls": SPICE_TEXT,
        "pedr/ap12xxx/ap12058l.b": pedr("1999-08-24T04:23:10", "1999-08-25T04:01:12"),
        "pedr/ap12xxx/ap12046l.b": pedr("1999-08-23T04:23:10", "1999-08-24T04:23:08"),
    }  # fmt: skip
    volumes = {
        "mgsc_1029": [(f"M04/{k:05d}", "MOC-NA") for k in range(2700, 2750)],
        "mgsc_1030": [(f"M04/{k:05d}", "MOC-WA" if k == 2853 else "MOC-NA") for k in range(2750, 2860)],
        "mgsc_1280": [("SP2/46804", "MOC-NA"), ("R10/00002", "MOC-NA"), ("R10/00003", "MOC-WA")],
    }
    for volume, rows in volumes.items():
        table, described = index(rows)
        files |= {f"images/{volume}/index/imgindx.tab": table, f"images/{volume}/index/imgindx.lbl": described}
    for phase, start, stop in (
        ("map1", "1999-03-10T00:00:02", "1999-06-01T23:59:53"), ("map2", "1999-06-02T00:00:02", "1999-08-24T23:59:53"),
        ("map3", "1999-08-25T00:00:02", "1999-11-16T23:59:53"), ("ext12", "2003-07-23T00:00:02", "2003-10-15T23:59:53"),
    ):  # fmt: skip
        for stem, suffix, kind in (("spk/mgs_", "bsp", "SPK"), ("ck/mgs_sc_", "bc", "CK")):
            files[f"kernels/{stem}{phase}.{suffix}"] = daf(kind, phase.encode())
            files[f"kernels/{stem}{phase}.lbl"] = label(START_TIME=start, STOP_TIME=stop)
    rng = np.random.default_rng(4)
    for name in ("meg004/megr90n000cb", "meg004/megt90n000cb", "meg016/megr90n000eb", "meg016/megt90n000eb"):
        files[f"megdr/{name}.img"] = rng.bytes(5000)
        files[f"megdr/{name}.lbl"] = label(RECORD_BYTES="100")
    return files


# --- a simulated site

_FIXED = {
    "mgs.tls": "leap_seconds/naif0012.tls",
    "mgs.tsc": "kernels/sclk/mgs_sclkscet_00061.tsc",
    "mars.tpc": "kernels/pck/pck00009.tpc",
    "mgs.tf": "kernels/fk/mgs_v10.tf",
    "mars.bsp": "kernels/spk/de405.bsp",
}
"""Kernels that don't go by mission phase: as the simulation calls them, and where the archive has them."""
_NOMINAL_FOCAL_LENGTH, _NOMINAL_PITCH = 3.5, 0.000013
"""m, of the instrument kernel."""
_PHASES = {
    "ext1": ("2001-02-01T00:00:04", "2001-04-03T23:59:55"),
    "ext2": ("2001-04-04T00:00:04", "2001-06-26T23:59:55"),
}
"""UTC from and to which the kernels of a mission phase go, by their labels."""
_OTHERS = {1006: "M00/02320", 1015: "M01/03072", 1068: "M08/06047", 1242: "E23/00003"}
"""Images of other volumes, so that there is something to search through; there are no such files."""
_ANCHORS = ((1068, datetime(1999, 10, 26)), (1242, datetime(2003, 1, 1)))
"""Volumes between which the others are spread evenly in time."""
_LETTERS = {4: "c", 16: "e"}
"""Of MEGDR's resolutions, posts per degree, in one file for all of Mars."""
_REACH = (100e3, 100e3)
"""m east and west, north and south of the site's centre, of its ground in the grids."""


def write_archive(simulated: SimulatedSite, folder: Path, resolutions: Sequence[int] = (16,)) -> Path:
    """Write a simulated site as archives; returns the folder, for `serving`.

    images/ (PDS imaging node, MOC), kernels/ and leap_seconds/ (NAIF), pedr/ and megdr/ (PDS geosciences node, MOLA)
    have the archives' own folders and names below. What differs: images are not compressed, kernels and profiles hold
    the site's passes alone, and away from the site the grids, of 4 or 16 (66 MB) posts per degree, have a plain.
    """
    folder.mkdir(exist_ok=True)
    _write_images(simulated, folder / "images")
    _write_kernels(simulated, folder)
    for image in simulated.images:
        _write_profile(image, folder / "pedr")
    for ppd in resolutions:
        _write_grids(simulated, folder / "megdr", ppd)
    return folder


def _placed(path: Path) -> Path:
    """The path, in a folder that is there."""
    path.parent.mkdir(parents=True, exist_ok=True)
    return path


def _write_images(simulated: SimulatedSite, folder: Path) -> None:
    volumes = {number: [(product, "MOC-NA")] for number, product in _OTHERS.items()}
    (first, begin), (last, end) = _ANCHORS
    for image in simulated.images:
        product = product_id(image.settings)
        start, stem = datetime.fromisoformat(image.settings.start), product.replace("/", "").lower()
        number = first + int((last - first) * ((start - begin) / (end - begin)))
        beside = f"{product[:4]}{int(product[4:]) + 1:05d}"  # the wide-angle one of the surroundings
        volumes.setdefault(number, []).extend([(product, "MOC-NA"), (beside, "MOC-WA")])
        path = _placed(folder / f"mgsc_{number}/{stem[:6]}/{stem}.imq")
        write_moc_image(path, image.settings, image.clock_start, "Simulated", image.pixels)
    for number, rows in volumes.items():
        for suffix, content in zip(("tab", "lbl"), index(rows), strict=True):
            _placed(folder / f"mgsc_{number}/index/imgindx.{suffix}").write_bytes(content)


def _write_kernels(simulated: SimulatedSite, folder: Path) -> None:
    phases = sorted({image.settings.phase for image in simulated.images})
    with TemporaryDirectory(dir=folder) as temporary:
        write_kernels([kernel_segment(image) for image in simulated.images], Path(temporary))
        places = _FIXED | {f"mgs_{phase}.bsp": f"kernels/spk/mgs_{phase}.bsp" for phase in phases}
        places |= {f"mgs_sc_{phase}.bc": f"kernels/ck/mgs_sc_{phase}.bc" for phase in phases}
        for name, place in places.items():
            shutil.move(Path(temporary) / name, _placed(folder / place))
    _placed(folder / "kernels/ik/mgs_moc_v20.ti").write_text(_instrument_text(), encoding="ascii", newline="\n")
    for phase in phases:
        start, stop = _PHASES[phase]
        for stem in (f"spk/mgs_{phase}", f"ck/mgs_sc_{phase}"):
            (folder / f"kernels/{stem}.lbl").write_bytes(label(START_TIME=start, STOP_TIME=stop))


def _instrument_text() -> str:
    """The camera in the words of NAIF's instrument kernel (moc20.ti): metres, first pixel 0.

    Its numbers are the nominal ones, as in the archive: 1 percent off the true scale, FOCAL_LENGTH_MM / PITCH_MM pixels
    per radian, to which a focal length of 3.4669 m belongs.
    """
    return f"""KPL/IK

MOC narrow angle camera. Focal length and pixel size in m, angles in radians; keywords as in NAIF's kernel.

\\begindata
INS{CAMERA}_FOCAL_LENGTH  = ( {_NOMINAL_FOCAL_LENGTH} )
INS{CAMERA}_PIXEL_SAMPLES = ( 2048 )
INS{CAMERA}_PIXEL_LINES   = ( 1 )
INS{CAMERA}_CENTER        = ( {BORESIGHT_SAMPLE - 1.0!r} 0.5 )
INS{CAMERA}_PIXEL_SIZE    = ( {_NOMINAL_PITCH} )

{CAMERA_FRAME_TEXT}\\begintext
"""


def _write_profile(image: SimulatedImage, folder: Path) -> None:
    name = pedr_file(image)
    start, frames = datetime.fromisoformat(image.settings.start), image.profile
    first, last = (
        label_time(start + timedelta(seconds=float(time) - ephemeris_time(image.settings.start)))
        for time in frames.times[[0, -1]]
    )
    path = _placed(folder / f"{name[:4]}xxx" / name)
    write_pedr(path, frames, {"START_TIME": first, "STOP_TIME": last})


def _write_grids(simulated: SimulatedSite, folder: Path, ppd: int) -> None:
    """Radius and topography of all of Mars: the site as a grid of that resolution has it, and a plain about it."""
    terrain, step, letter = simulated.terrain, DEG / ppd, _LETTERS[ppd]
    site = terrain_grid(terrain, ppd, _REACH)
    radii = np.asarray(site.radii, dtype=np.float64)
    latitudes = np.asarray(0.5 * np.pi - (np.arange(180 * ppd) + 0.5) * step, dtype=np.float64)
    areoid = terrain.areoid_radius(np.full(latitudes.size, terrain.centre_lon), latitudes)
    height = terrain.ground.level - terrain.ground.areoid
    corner = round((latitudes[0] - site.first_latitude) / step), round(site.first_longitude / step - 0.5)
    place = _placed(folder / f"meg{ppd:03d}" / "any").parent
    for kind, offset, plain, own in (
        ("r", REFERENCE_RADIUS, areoid + height, radii),
        ("t", 0.0, np.full(latitudes.size, height), radii - areoid_under(terrain, site)),
    ):
        layout = MegdrLayout((180 * ppd, 360 * ppd), 0.5 * step, float(latitudes[0]), step, offset)
        write_megdr(place, f"meg{kind}90n000{letter}b", layout, _pasted(plain, own, corner, 360 * ppd))


def _pasted(plain: Array, own: Array, corner: tuple[int, int], wide: int) -> Iterator[Array]:
    """Rows (wide,) that are plain (rows,) but for own (high, columns) with its upper left post at `corner`."""
    top, left = corner
    for number, height in enumerate(plain):
        row = np.full(wide, height)
        if 0 <= number - top < own.shape[0]:
            row[left : left + own.shape[1]] = own[number - top]
        yield row

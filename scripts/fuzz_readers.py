"""Every way into the program for files from outside, for what it keeps itself and for command lines, each with a sound
file and the form of its damage.
"""

import gzip
import json
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import cubes
import flaky_archive
import fuzz_seeds as seeds
import mex
import mgs
import numpy as np
import rasters
from fuzz_seeds import Reader, Seed, made, of_pair, of_tests, text

from mgsgraph.geometry.body import Ellipsoid

MARS = Ellipsoid(3396190.0, 3376200.0)
_IMAGE = "E0202855.img"
_SHOTS = (".ranges", ".spacecraft", ".areoid_radii", ".off_nadir", ".pulses", ".times")
"""Where tables of shots may have gaps."""


def every(only: Sequence[str] = ()) -> list[Reader]:
    """All readers, or those whose names hold one of some words."""
    rows = (
        *_cases(), *_images(), *_kernels(), *_pictures(), *_terrain(), *_networks(), *_altimetry(), *_with_checksums(),
        *_archives(), *_real_files(), *_commands(),
    )  # fmt: skip
    return [row for row in rows if not only or any(word in row.name for word in only)]


def _cases() -> Iterator[Reader]:
    from mgsgraph.case.case_file import decode, stated
    from mgsgraph.case.draft import draft_case
    from mgsgraph.case.reading import read_case
    from mgsgraph.files.kinds import kind_of

    def drafted(path: Path) -> object:
        (path.parent / "out.toml").unlink(missing_ok=True)
        return draft_case([path.parent], path.parent / "out.toml").text

    yield Reader("case file", lambda path: (stated(path), decode(path)), seeds.case_seed, "pvl", gaps=(".trend[]",
    ".position_sigma_m", ".angle_sigma_mrad"))
    yield Reader("whole case", read_case, seeds.case_seed, "pvl")
    yield Reader("mgsgraph new, support data", drafted, partial(seeds.case_seed, "image_A.isd"), "json")
    yield Reader("mgsgraph new, network", drafted, partial(seeds.case_seed, "network.pvl"), "pvl")
    yield Reader("kind of a table", kind_of, lambda: text("a.csv", seeds.ode_table()), "csv")
    yield Reader("kind of a label", kind_of, lambda: text("a.img", mgs.image_bytes()), "pvl")
    yield Reader("kind of JSON", kind_of, partial(of_pair, "lidar.json"), "json")
    yield Reader("kind of gzip", kind_of, lambda: text("a.gz", seeds.packed(seeds.mla_table())), "bytes")


def _images() -> Iterator[Reader]:
    from mgsgraph.files.cameras.label import read_line_scan_label, read_line_times
    from mgsgraph.files.labels.isis_cube import read_isis_cube
    from mgsgraph.files.pvl import read_label
    from mgsgraph.files.support_data.isd import read_isd
    from mgsgraph.files.support_data.model_state import read_model_state

    def times(seconds: float, path: Path) -> object:
        label = read_line_scan_label(path)
        return read_line_times(label.times, label.lines, mex.START, mex.START + seconds, str(path))

    def times_of_text(path: Path) -> object:
        return read_line_times(path, 15088, mex.START, mex.START + 196.7, str(path))

    def isis_label(folder: Path) -> None:
        (folder / "a.pvl").write_text(cubes.LABEL + "End\n")

    hrsc = mex.image_bytes([mex.START + 0.01 * k for k in range(20)], [10.0] * 20)
    support = lambda: text("image.isd", seeds.support_data())  # noqa: E731
    yield Reader("support data", lambda path: read_isd(path, "M00/00001"), support, "json")
    yield Reader("support data of ISIS", lambda path: read_isd(path, "SIM/A"), partial(of_pair, "image_A.isd"), "json")
    state = lambda: text("a.json", seeds.model_state())  # noqa: E731
    yield Reader("model state of CSM", lambda path: read_model_state(path, "A/1"), state, "json")
    yield Reader("ISIS cube with tables", read_isis_cube, lambda: made("image.cub", cubes.written), "labelled")
    yield Reader("label of a cube", read_label, lambda: made("a.pvl", isis_label), "pvl", gaps=(".value",))
    yield Reader("line-scan label, PDS3", read_line_scan_label, lambda: text("M0402852.IMG", mgs.image_bytes()), "pvl")
    yield Reader("line times, cube", partial(times, 196.7), lambda: text("a.cub", mex.cube_bytes()), "labelled")
    yield Reader("line times, PDS3", partial(times, 0.19), lambda: text("a.img", hrsc), "labelled")
    yield Reader("line times, text", times_of_text, lambda: made("line_times.csv", mex.times_file), "csv")


def _kernels() -> Iterator[Reader]:
    from mgsgraph.files.labels.kernels import loaded
    from mgsgraph.files.labels.labelled_image import read_labelled_image

    def furnished(path: Path) -> None:
        with loaded([path]):
            pass

    def image_of(path: Path) -> object:
        return read_labelled_image(path.with_name(_IMAGE), [path.with_name("mgs.tm")])

    yield Reader("image with its kernels", image_of, partial(seeds.kernels_seed, _IMAGE), "pvl")
    for name in ("mgs.tls", "mgs.tsc", "mars.tpc", "mgs.tf", "moc.ti"):
        yield Reader(f"text kernel {name}", image_of, partial(seeds.kernels_seed, name), "pvl")
    yield Reader("text kernel alone", furnished, partial(seeds.of_site, "mgs.tls"), "pvl")
    yield Reader("meta-kernel", image_of, partial(seeds.kernels_seed, "mgs.tm"), "pvl")
    yield Reader("binary kernel, SPK", image_of, partial(seeds.kernels_seed, "mgs_ext1.bsp"), "bytes")
    yield Reader("binary kernel, CK", image_of, partial(seeds.kernels_seed, "mgs_sc_ext1.bc"), "bytes")


def _pictures() -> Iterator[Reader]:
    from mgsgraph.files.pvl import read_label
    from mgsgraph.files.rasters.pictures import is_moc, pixel_area, read_moc_pixels, read_picture

    tests = of_tests("files/rasters/test_pictures.py")
    grey = np.arange(300).reshape(15, 20)

    def moc(path: Path) -> object:
        return is_moc(path), pixel_area(path, read_label(path)), read_moc_pixels(path)

    def tiff(kind: str, **more: Any) -> Callable[[], Seed]:
        return lambda: made("a.tif", lambda folder: tests.tif(folder / "a.tif", grey.astype(kind), **more))

    def encoded(name: str, form: str) -> Callable[[], Seed]:
        from PIL import Image

        return lambda: made(name, lambda folder: Image.fromarray(grey.astype(np.uint8)).save(folder / name, form))

    def cube(folder: Path) -> None:
        tests.cube(folder / "a.cub", np.arange(30).reshape(5, 6).astype("uint8"), "UnsignedByte")

    yield Reader("picture, TIFF", read_picture, tiff("uint8"), "bytes", gaps=("",))
    deflated = tiff("uint16", compress="deflate", predictor=2)
    yield Reader("picture, packed TIFF", read_picture, deflated, "bytes", gaps=("",))
    yield Reader("picture, PNG", read_picture, encoded("a.png", "PNG"), "bytes")
    yield Reader("picture, JPEG", read_picture, encoded("a.jpg", "JPEG"), "bytes")
    yield Reader("picture, ISIS cube", read_picture, lambda: made("a.cub", cube), "pvl")
    yield Reader("pixels of MOC", moc, lambda: text("M0402852.img", mgs.image_bytes()), "pvl")


def _terrain() -> Iterator[Reader]:
    from mgsgraph.files.rasters.megdr import read_megdr
    from mgsgraph.files.rasters.terrain_file import read_terrain

    def raster(name: str, folder: Path) -> None:
        crs, places = rasters.PROJECTIONS[name]
        shape = (12, 14)
        transform, x, y = rasters.pixels(crs, shape=shape)
        radii = (rasters.RADIUS + rasters.ground(*places(x, y))).reshape(shape)
        rasters.raster(folder / "dem.tif", radii, crs, transform)

    def terrain(path: Path) -> object:
        return read_terrain(path, body=MARS)

    gaps = (".values", ".posts", ".radii")
    for name in ("equirectangular", "polar stereographic"):
        seed = partial(made, "dem.tif", partial(raster, name))
        yield Reader(f"terrain, {name}", terrain, seed, "bytes", gaps=gaps)
    yield Reader("terrain, MEGDR's label", read_megdr, partial(seeds.grid_seed, "megr_x.lbl"), "pvl")
    yield Reader("terrain, MEGDR's posts", read_megdr, partial(seeds.grid_seed, "megr_x.img"), "bytes")


def _networks() -> Iterator[Reader]:
    from mgsgraph.export.verdicts import read_verdicts
    from mgsgraph.files.networks.asp_match import read_match, read_match_text
    from mgsgraph.files.networks.asp_text import read_ground_control_network, read_nvm
    from mgsgraph.files.networks.binary import read_control_network, read_network
    from mgsgraph.files.networks.table import read_tie_points, read_whole
    from mgsgraph.files.place_table import read_places

    asp = of_tests("files/networks/test_asp.py")
    pair, written = ("one", "two"), seeds.written_network
    ground = asp.DOCUMENTED + "\n" + asp.DOCUMENTED.replace("5 23.7", "6 23.8") + "\n"
    rows = "".join(f"p{k},{10 + k},{20 - k},33900{k}0.5\n" for k in range(6))
    decisions = "".join(f'p{k},accept,"good, {k}"\n' for k in range(6))

    def of_pvl(path: Path) -> object:
        return read_network(path), read_control_network(path)

    def nvm_beside(path: Path) -> object:
        return read_nvm(path.with_name("a.nvm"))

    yield Reader("network, PVL", of_pvl, partial(of_pair, "network.pvl"), "pvl", gaps=(".measure_sigmas",))
    yield Reader("network, PVL, version 1", read_network, partial(seeds.old_network, 1), "pvl")
    yield Reader("network, PVL, version 3", read_network, partial(seeds.old_network, 3), "pvl")
    yield Reader("network, binary", read_network, partial(written, "network.net", "net"), "bytes")
    yield Reader("network, binary, version 1", read_network, partial(seeds.old_network, 0), "bytes")
    table = partial(written, "network.csv", "csv")
    yield Reader("network, table", lambda path: read_whole(path, MARS), table, "csv")
    ties, gaps = (lambda path: read_tie_points(path, MARS)), (".places", ".measure_sigmas")
    yield Reader("tie points, table", ties, table, "csv", gaps=gaps)
    yield Reader("tie points, Parquet", ties, partial(written, "network.parquet", "parquet"), "bytes", gaps=gaps)
    binary = partial(text, "run-one__two.match", asp.SOUND)
    yield Reader("match file", lambda path: read_match(path, pair), binary, "bytes", gaps=(".sigmas",))
    of_text = partial(written, "run", "match-text")
    yield Reader("match file, text", lambda path: read_match_text(path, pair), of_text, "csv")
    control = partial(text, "a.gcp", ground)
    yield Reader("ground control", lambda path: read_ground_control_network(path, MARS), control, "csv")
    yield Reader("NVM", read_nvm, lambda: text("a.nvm", asp.NVM, **{"a_offsets.txt": asp.OFFSETS}), "csv")
    yield Reader("NVM's offsets", nvm_beside, lambda: text("a_offsets.txt", asp.OFFSETS, **{"a.nvm": asp.NVM}), "csv")
    places = partial(text, "places.csv", "id,longitude_deg,latitude_deg,radius_m\n" + rows)
    yield Reader("table of places", lambda path: read_places(path, MARS, "ground"), places, "csv")
    verdicts = partial(text, "verdicts.csv", "# network 0123456789abcdef\nid,verdict,note\n" + decisions)
    yield Reader("verdicts", read_verdicts, verdicts, "csv")


def _altimetry() -> Iterator[Reader]:
    from mgsgraph.files.altimetry.lidar import read_lidar
    from mgsgraph.files.altimetry.shots import read_altimetry_cloud, read_shots

    tests = of_tests("files/altimetry/test_pedr.py")
    lola = "LOLARDR_092490702.DAT"
    rows = "".join(f"12.{k},-45.{k},339000{k}.25,{100 + k}.5,a\n" for k in range(6))

    def pedr_text(folder: Path) -> None:
        tests.table(folder, *(tests.shot(175.4789 - 5e-5 * k, 379000.0 + k) for k in range(4)))

    yield Reader("lidar JSON", read_lidar, partial(of_pair, "lidar.json"), "json")
    yield Reader("PEDR", read_shots, partial(seeds.of_site, "ap19215l.b"), "bytes", gaps=_SHOTS)
    yield Reader("PEDR's label", read_shots, partial(seeds.of_site, "ap19215l.b"), "pvl", gaps=_SHOTS)
    yield Reader("PEDR as text", read_shots, lambda: made("ap18933l.tab", pedr_text), "csv", gaps=_SHOTS)
    yield Reader("shots of ODE", read_shots, lambda: text("shots.csv", seeds.ode_table()), "csv", gaps=_SHOTS)
    yield Reader("shots, CSV", read_shots, lambda: text("shots.csv", seeds.profile_csv()), "csv", gaps=_SHOTS)
    yield Reader("shots of MLA", read_shots, lambda: text("shots.csv", seeds.mla_table()), "csv", gaps=_SHOTS)
    packed = lambda: text("shots.csv.gz", seeds.packed(seeds.mla_table()))  # noqa: E731
    yield Reader("shots, packed", read_shots, packed, "gzip", gaps=_SHOTS)
    yield Reader("LOLA's records", read_shots, lambda: text(lola, seeds.lola_records()), "bytes", gaps=_SHOTS)
    labelled = lambda: text("a.LBL", seeds.lola_label(lola), **{lola: seeds.lola_records()})  # noqa: E731
    yield Reader("LOLA's label", read_shots, labelled, "pvl", gaps=_SHOTS)
    cloud = partial(text, "cloud.csv", "longitude_deg,latitude_deg,radius_m,time_s,profile\n" + rows)
    yield Reader("altimetry cloud", lambda path: read_altimetry_cloud(path, MARS), cloud, "csv", gaps=_SHOTS)
    binary = lambda: text(lola, seeds.lola_records())  # noqa: E731
    yield Reader("altimetry cloud, LOLA", lambda path: read_altimetry_cloud(path), binary, "bytes", gaps=_SHOTS)


def _with_checksums() -> Iterator[Reader]:
    """Formats with checksums: a flipped bit is refused, or not read."""
    from mgsgraph.case.reading import window_beside
    from mgsgraph.errors import require
    from mgsgraph.export.network_content import source_networks
    from mgsgraph.fetch.store import LOCK, Lock, LockedFile
    from mgsgraph.files.networks.table import read_tie_points
    from mgsgraph.files.opening import sha256_of
    from mgsgraph.files.output.folders import EXPORT
    from mgsgraph.files.output.table import write_json
    from mgsgraph.files.writing import FILES, MATCH, read_record
    from mgsgraph.project.campaign import open_record
    from mgsgraph.project.project import open_project
    from mgsgraph.project.reading import read_state
    from mgsgraph.results.archive import read_solution
    from mgsgraph.results.results import case_of

    def record(path: Path) -> object:
        with open_record(path.parent) as opened:
            require(opened.entries, str(path), "its last case is done again")
            return dict(opened.entries)

    def project(path: Path) -> object:
        with open_project(path.parent) as opened:
            state = opened.name, opened.settings, opened.networks, opened.changes(), opened.last_solution()
        return state, read_state(path.parent)

    def campaign(folder: Path) -> None:
        case = seeds.pair_folder() / "case.toml"
        seeds.commanded("batch", case, "--out", folder, "--no-figures")

    def locked(folder: Path) -> None:
        file = LockedFile("https://example.org/a.img", 12, "0f" * 32, "2026-11-23T00:00:00Z")
        Lock(folder, {f"images/{name}.img": file for name in "abc"}, {}, {"case.toml": "1e" * 32}).write()

    def exported(folder: Path) -> None:
        seeds.commanded("export", seeds.worked_folder() / "result", "--to", "csm", "--out", folder / "out")
        (folder / "out" / EXPORT).rename(folder / EXPORT)

    def matched(folder: Path) -> None:
        content = (seeds.pair_folder() / "network.pvl").read_bytes()
        (folder / "network.pvl").write_bytes(content)
        sums = {"network.pvl": sha256_of(folder / "network.pvl")}
        write_json(folder / MATCH, {"program": "mgsgraph", "settings": {"half_window": 12}, FILES: sums})

    def matches(path: Path) -> object:
        return read_tie_points(path.with_name("network.pvl")), window_beside(path.with_name("network.pvl"))

    sources = lambda path: source_networks(path.parent, [], MARS)  # noqa: E731
    result, lines = partial(of_pair, "result/solution.json"), lambda: made("campaign.jsonl", campaign)
    rows = (
        Reader("result", read_solution, partial(of_pair, "result/solution.npz"), "npz", gaps=(".sigmas",)),
        Reader("result's record", lambda path: case_of(path.parent), result, "json"),
        Reader("project", project, partial(of_pair, "project/project.sqlite"), "sqlite"),
        Reader("campaign's record", record, lines, "json"),
        Reader("record of matches", matches, lambda: made(MATCH, matched), "json"),
        Reader("ties of matches", matches, lambda: made("network.pvl", matched), "pvl", gaps=(".measure_sigmas",)),
        Reader("record of an export", read_record, lambda: made(EXPORT, exported), "json"),
        Reader("lock of fetch", lambda path: Lock.read(path.parent), lambda: made(LOCK, locked), "json"),
    )
    yield Reader("result's networks", sources, partial(of_pair, "result/solution.json", "network.pvl"), "json")
    for row in rows:
        yield row
        yield row._replace(name=f"{row.name}, a bit", form="bit", same=True)


def _archives() -> Iterator[Reader]:
    from mgsgraph.fetch.case_file import _INSTRUMENT, camera_focal_length
    from mgsgraph.fetch.download import PartialFile
    from mgsgraph.fetch.needs import Archives
    from mgsgraph.fetch.search import read_index

    addresses = "".join(f'{name} = "https://example.org/{name}/"\n' for name in ("images", "kernels", "pedr"))
    state = json.dumps({"url": "http://x.org/a", "total": 9, "etag": '"1"', "modified": ""})

    def index(folder: Path) -> None:
        images = [(f"E02/0{k}", "MOC-NA") for k in range(1001, 1004)]
        for suffix, content in zip(("tab", "lbl"), flaky_archive.index(images), strict=True):
            (folder / f"imgindx.{suffix}").write_bytes(content)

    def rows(path: Path) -> object:
        return read_index(path.with_name("imgindx.tab"), path.with_name("imgindx.lbl"))

    def part(path: Path) -> object:
        return PartialFile(path.with_name("a.img"), "http://x.org/a").source

    def focal(path: Path) -> object:
        return camera_focal_length(path.parents[len(Path(_INSTRUMENT).parts) - 1])

    yield Reader("mirrors", Archives.read, partial(text, "mirrors.toml", addresses), "pvl")
    yield Reader("part of fetch", part, lambda: text("a.img.part.json", state, **{"a.img.part": b"abc"}), "json")
    yield Reader("index of a volume", rows, lambda: made("imgindx.tab", index), "csv")
    yield Reader("index's label", rows, lambda: made("imgindx.lbl", index), "pvl")
    kernel = "KPL/IK\n\\begindata\nINS-94031_PIXEL_SIZE = ( 0.000013 )\n\\begintext\n"
    yield Reader("instrument kernel of fetch", focal, partial(text, str(_INSTRUMENT), kernel), "pvl")


# --- real files, where ../shared/data is there; nothing of them is kept

DATA = Path(__file__).resolve().parents[2] / "shared" / "data"
_LABEL = "m0402852_isis.lbl"


def _beside(folder: str, main: str, *names: str) -> Seed:
    return Seed({name: (DATA / folder / name).read_bytes() for name in (main, *names)}, main)


def _begin(folder: str, name: str, lines: int) -> Seed:
    """The first lines of a long table."""
    with (DATA / folder / name).open("rb") as file:
        return Seed({name: b"".join(file.readline() for _ in range(lines))}, name)


def _packed(folder: str, name: str, lines: int) -> Seed:
    with gzip.open(DATA / folder / name) as file:
        return Seed({name: seeds.packed(b"".join(file.readline() for _ in range(lines)))}, name)


def _real_files() -> Iterator[Reader]:
    """No reader where the files are missing."""
    if not DATA.is_dir():
        return
    import mgs

    from mgsgraph.files.altimetry.lidar import read_lidar
    from mgsgraph.files.altimetry.shots import read_shots
    from mgsgraph.files.labels.isis_cube import read_isis_cube
    from mgsgraph.files.labels.labelled_image import read_labelled_image
    from mgsgraph.files.networks.binary import read_network
    from mgsgraph.files.support_data.isd import read_isd

    kernels = [path.name for path in mgs.kernels(DATA)]
    moc, lola, hadley, m04 = "mgs_moc_wa_three", "lro_nac_lola", "lro_nac_hadley", "mgs_moc_m0402852"

    def image(path: Path) -> object:
        return read_labelled_image(path.with_name(_LABEL), [path.with_name(name) for name in kernels])

    yield Reader("real network of MOC", read_network, partial(_beside, moc, "controlnetwork.net"), "pvl")
    yield Reader("real network of LROC", read_network, partial(_beside, hadley, "observationPair.net"), "pvl")
    yield Reader("real tables of a cube", read_isis_cube, partial(_beside, moc, "cube1.isd", "cube1.pvl"), "json")
    label = partial(_beside, moc, "cube1.pvl", "cube1.isd")
    yield Reader("real label of a cube", read_isis_cube, label, "pvl")
    isd = partial(_beside, lola, "lidarObservationImage2.isd")
    yield Reader("real support data", lambda path: read_isd(path, "LRO/1"), isd, "json")
    yield Reader("real lidar JSON", read_lidar, partial(_beside, lola, "lidarData.json"), "json")
    ode = partial(_begin, "mola_pedr_ode", "curiosity_topography.csv", 12)
    yield Reader("real shots of ODE", read_shots, ode, "csv", gaps=_SHOTS)
    yield Reader("real shots of LOLA", read_shots, partial(_begin, lola, "lidarPoints.csv", 12), "csv", gaps=_SHOTS)
    shots = partial(_packed, hadley, "RDR_hadley_LOLA.csv.gz", 12)
    yield Reader("real shots, packed", read_shots, shots, "gzip", gaps=_SHOTS)
    for name in ("m0402852.ale_1.bsp", "mgs_sc_map2_1_sliced_-94000.bc", _LABEL):
        names = [file for file in (_LABEL, *kernels) if file != name]
        kind = "label of MOC" if name == _LABEL else f"binary kernel, {Path(name).suffix}"
        yield Reader(f"real {kind}", image, partial(_beside, m04, name, *names), "pvl" if name == _LABEL else "bytes")


# --- command lines

_RESULT = ("result/solution.npz", "result/solution.json")
_PROJECT = ("project/project.sqlite",)
_LINES: dict[str, tuple[str, tuple[str, ...]]] = {
    "project add": ("half SIM/B=image_B.isd --ties network.pvl --shots lidar.json --dry-run", ("half/project.sqlite",)),
    "adjust": ("case.toml --out out --no-figures", ()),
    "analyze": ("result --weak 2 --components --out out", _RESULT),
    "batch": ("case.toml --out out --no-figures", ()),
    "check": ("case.toml", ()),
    "export": ("result --to isis --out out --scaled", _RESULT),
    "project init": ("out --case case.toml --name x", ()),
    "new": ("image_A.isd image_B.isd network.pvl lidar.json --out out.toml --name x", ()),
    "plan": ("result candidates.toml --out out", (*_RESULT, "candidates.toml")),
    "locate": ("case.toml SIM/A --points places.csv --into image --height 10 --out out.csv", ("places.csv",)),
    "project remove": ("project SIM/B", _PROJECT),
    "report": ("result --out out.html", _RESULT),
    "convert": ("network.pvl out.net --to net --case case.toml --verdicts verdicts.csv", ("verdicts.csv",)),
    "footprints": ("case.toml shots.csv --margin 5 --out out.csv", ("shots.csv",)),
    "project solve": ("project --no-figures", _PROJECT),
    "project status": ("project", _PROJECT),
    "align": ("case.toml --out out", ()),
    "dem": ("result --out out --post 50", _RESULT),
    "match": ("case.toml --out out --no-figures", ()),
}
"""A line for each verb but fetch, which would ask archives, and the files that it needs besides those of the pair. The
last three are refused: the pair has no pixels.
"""


def _commands() -> Iterator[Reader]:
    """Every verb with odd words, and some with damaged files."""
    for verb, (line, more) in _LINES.items():
        seed = partial(_command_seed, verb, line, more, seeds.WORDS)
        yield Reader(f"mgsgraph {verb}", seeds.obeyed, seed, "words", patience=60.0)
    damaged = (
        ("check", "case.toml", "pvl"), ("adjust", "network.pvl", "pvl"), ("adjust", "lidar.json", "json"),
        ("check", "image_A.isd", "json"), ("project status", *_PROJECT, "sqlite"),
        ("project solve", *_PROJECT, "sqlite"), ("project solve", *_PROJECT, "bit"),
        ("report", "result/solution.npz", "npz"), ("analyze", "result/solution.npz", "bit"),
        ("export", "result/solution.json", "json"), ("footprints", "shots.csv", "csv"), ("locate", "places.csv", "csv"),
        ("convert", "verdicts.csv", "csv"), ("new", "network.pvl", "pvl"),
    )  # fmt: skip
    for verb, name, form in damaged:
        seed = partial(_command_seed, verb, *_LINES[verb], name)
        kind = ", a bit" if form == "bit" else ""
        yield Reader(f"mgsgraph {verb}, damaged {Path(name).name}{kind}", seeds.obeyed, seed, form, patience=60.0)


def _command_seed(verb: str, line: str, more: tuple[str, ...], main: str) -> Seed:
    places = "".join(f"p{k},{k},{k},3390000.5\n" for k in range(4))
    texts = {
        "places.csv": "id,longitude_deg,latitude_deg,radius_m\n" + places,
        "candidates.toml": 'format = 1\n[[control]]\nname = "far"\nlongitude_deg = 0.0\nlatitude_deg = 0.0\n'
        "radius_m = 3.39e6\n",
        "verdicts.csv": "id,verdict,note\nTIE00001,reject,bad\n", "shots.csv": seeds.profile_csv(),
    }  # fmt: skip
    folder = seeds.worked_folder() if more else seeds.pair_folder()
    files = {k: texts[k].encode() if k in texts else (folder / k).read_bytes() for k in (*seeds.PAIR, *more)}
    return Seed({seeds.WORDS: json.dumps([*verb.split(), *line.split()]).encode()} | files, main)

"""Readers of networks, altimetry, of what the program itself keeps, and of what comes from the archives."""

import json
from collections.abc import Iterator
from functools import partial
from pathlib import Path

import archive_index
import fuzz_seeds as seeds
from fuzz_kinds import BYTES, CSV, GZIP, JSON, NPZ, PVL, SQLITE, TEXT, TOML, WIRE, Row
from fuzz_seeds import made, of_pair, of_tests, text
from fuzz_structures import records

from mgsgraph.geometry.body import Ellipsoid

_MARS = Ellipsoid(3396190.0, 3376200.0)
_POINT = [
    ("x", "<f4"), ("y", "<f4"), ("column", "<i4"), ("row", "<i4"), ("orientation", "<f4"), ("scale", "<f4"),
    ("interest", "<f4"),
    ("polarity", "u1"), ("octave", "<i4"), ("level", "<i4"), ("size", "<u8"),
]  # fmt: skip
"""An interest point of VisionWorkbench."""


def of_networks() -> Iterator[Row]:
    from mgsgraph.files.networks.asp_match import read_match, read_match_text
    from mgsgraph.files.networks.asp_text import read_ground_control_network, read_nvm
    from mgsgraph.files.networks.binary import read_control_network, read_network
    from mgsgraph.files.networks.table import read_tie_points, read_whole
    from mgsgraph.files.place_table import read_places
    from mgsgraph.studio.verdicts import read_verdicts

    match, gcp, nvm = (of_tests(f"files/networks/test_{name}.py") for name in ("asp_match", "gcp", "asp_nvm"))
    pair, written = ("one", "two"), seeds.written_network
    ground = gcp.DOCUMENTED + "\n" + gcp.DOCUMENTED.replace("5 23.7", "6 23.8") + "\n"
    rows = "".join(f"p{k},{10 + k},{20 - k},33900{k}0.5\n" for k in range(6))
    said = "".join(f'p{k},accept,"good, {k}"\n' for k in range(6))

    def of_pvl(path: Path) -> object:
        return read_network(path), read_control_network(path)

    def nvm_beside(path: Path) -> object:
        return read_nvm(path.with_name("a.nvm"))

    yield Row("network, PVL", "E", of_pvl, partial(of_pair, "network.pvl"), PVL, gaps=(".measure_sigmas",))
    yield Row("network, PVL, version 1", "E", read_network, partial(seeds.old_network, 1), PVL)
    yield Row("network, PVL, version 3", "E", read_network, partial(seeds.old_network, 3), PVL)
    yield Row("network, binary", "E", read_network, partial(written, "network.net", "net"), WIRE)
    yield Row("network, binary, version 1", "E", read_network, partial(seeds.old_network, 0), WIRE)
    table = partial(written, "network.csv", "csv")
    yield Row("network, table", "E", lambda path: read_whole(path, _MARS), table, CSV)
    ties, gaps = (lambda path: read_tie_points(path, _MARS)), (".places", ".measure_sigmas")
    yield Row("tie points, table", "E", ties, table, CSV, gaps=gaps)
    yield Row("tie points, Parquet", "E", ties, partial(written, "network.parquet", "parquet"), BYTES, gaps=gaps)
    binary = partial(text, "run-one__two.match", match.SOUND)
    fields = (*BYTES, *[records(_POINT, 16)] * 10)
    yield Row("match file", "E", lambda path: read_match(path, pair), binary, fields, gaps=(".sigmas",))
    of_text = partial(written, "run", "match-text")
    yield Row("match file, text", "E", lambda path: read_match_text(path, pair), of_text, CSV)
    control = partial(text, "a.gcp", ground)
    yield Row("ground control", "E", lambda path: read_ground_control_network(path, _MARS), control, CSV)
    yield Row("NVM", "E", read_nvm, lambda: text("a.nvm", nvm.TEXT, **{"a_offsets.txt": nvm.OFFSETS}), CSV)
    yield Row("NVM's offsets", "E", nvm_beside, lambda: text("a_offsets.txt", nvm.OFFSETS, **{"a.nvm": nvm.TEXT}), CSV)
    places = partial(text, "places.csv", "id,longitude_deg,latitude_deg,radius_m\n" + rows)
    yield Row("table of places", "E", lambda path: read_places(path, _MARS, "ground"), places, CSV)
    verdicts = partial(text, "verdicts.csv", "# network 0123456789abcdef\nid,verdict,note\n" + said)
    yield Row("verdicts", "D", read_verdicts, verdicts, CSV)


def of_altimetry() -> Iterator[Row]:
    from mgsgraph.files.altimetry.binary import FRAME, RECORD
    from mgsgraph.files.altimetry.lidar import read_lidar
    from mgsgraph.files.altimetry.shots import read_altimetry_cloud, read_shots

    tests = of_tests("files/altimetry/test_pedr_text.py")
    lola = "LOLARDR_092490702.DAT"
    rows = "".join(f"12.{k},-45.{k},339000{k}.25,{100 + k}.5,a\n" for k in range(6))

    def pedr_text(folder: Path) -> None:
        tests.table(folder, *(tests.shot(175.4789 - 5e-5 * k, 379000.0 + k) for k in range(4)))

    frames, spots = (*BYTES, *[records(FRAME, 7760)] * 20), (*BYTES, *[records(RECORD, 0)] * 20)
    yield Row("lidar JSON", "E", read_lidar, partial(of_pair, "lidar.json"), JSON)
    gaps = (".ranges", ".spacecraft", ".areoid_radii", ".off_nadir", ".pulses", ".times")
    yield Row("PEDR", "E", read_shots, partial(seeds.of_site, "ap19215l.b"), frames, gaps=gaps)
    yield Row("PEDR's label", "E", read_shots, partial(seeds.of_site, "ap19215l.b"), PVL, gaps=gaps)
    yield Row("PEDR as text", "E", read_shots, lambda: made("ap18933l.tab", pedr_text), CSV, gaps=gaps)
    yield Row("shots of ODE", "E", read_shots, lambda: text("shots.csv", seeds.ode_table()), CSV, gaps=gaps)
    yield Row("shots, CSV", "E", read_shots, lambda: text("shots.csv", seeds.profile_csv()), CSV, gaps=gaps)
    yield Row("shots of MLA", "E", read_shots, lambda: text("shots.csv", seeds.mla_table()), CSV, gaps=gaps)
    packed = lambda: text("shots.csv.gz", seeds.packed(seeds.mla_table()))  # noqa: E731
    yield Row("shots, packed", "E", read_shots, packed, GZIP, gaps=gaps)
    yield Row("LOLA's records", "E", read_shots, lambda: text(lola, seeds.lola_records()), spots, gaps=gaps)
    labelled = lambda: text("a.LBL", seeds.lola_label(lola), **{lola: seeds.lola_records()})  # noqa: E731
    yield Row("LOLA's label", "E", read_shots, labelled, PVL, gaps=gaps)
    cloud = partial(text, "cloud.csv", "longitude_deg,latitude_deg,radius_m,time_s,profile\n" + rows)
    yield Row("altimetry cloud", "E", lambda path: read_altimetry_cloud(path, _MARS), cloud, CSV, gaps=gaps)
    binary = lambda: text(lola, seeds.lola_records())  # noqa: E731
    yield Row("altimetry cloud, LOLA", "E", lambda path: read_altimetry_cloud(path), binary, spots, gaps=gaps)


def of_what_is_kept() -> Iterator[Row]:
    from mgsgraph.export.network_content import source_networks
    from mgsgraph.project.campaign import open_record
    from mgsgraph.project.project import open_project
    from mgsgraph.project.reading import read_state
    from mgsgraph.results.archive import read_solution
    from mgsgraph.results.results import case_of

    def record(path: Path) -> object:
        with open_record(path.parent) as opened:
            return dict(opened.entries)

    def project(path: Path) -> object:
        with open_project(path.parent) as opened:
            state = opened.name, opened.settings, opened.networks, opened.changes(), opened.last_solution()
        return state, read_state(path.parent)

    def campaign(folder: Path) -> None:
        case = seeds.pair_folder() / "case.toml"
        seeds.commanded("campaign", case, "--out", folder, "--no-figures")

    yield Row("result", "C", read_solution, partial(of_pair, "result/solution.npz"), NPZ, gaps=(".sigmas",))
    yield Row("result's record", "C", lambda path: case_of(path.parent), partial(of_pair, "result/solution.json"), JSON)
    sources = lambda path: source_networks(path.parent, [], _MARS)  # noqa: E731
    yield Row("result's networks", "C", sources, partial(of_pair, "result/solution.json", "network.pvl"), JSON)
    yield Row("project", "C", project, partial(of_pair, "project/project.sqlite"), SQLITE)
    yield Row("campaign's record", "C", record, lambda: made("campaign.jsonl", campaign), (*JSON, *TEXT))


def of_archives() -> Iterator[Row]:
    from mgsgraph.fetch.case_file import _INSTRUMENT, camera_focal_length
    from mgsgraph.fetch.download import PartialFile
    from mgsgraph.fetch.needs import Archives
    from mgsgraph.fetch.search import read_index
    from mgsgraph.fetch.store import LOCK, Lock

    addresses = "".join(f'{name} = "https://example.org/{name}/"\n' for name in ("images", "kernels", "pedr"))
    entry = {"url": "http://x.org/a", "size": 3, "sha256": "0" * 64, "fetched": "2026-11-23T12:00:00"}
    lock = {"format": 1, "files": {"images/a.img": entry}, "images": {}, "written": {"case.toml": "1" * 64}}
    said = json.dumps({"url": "http://x.org/a", "total": 9, "etag": '"1"', "modified": ""})

    def index(folder: Path) -> None:
        images = [archive_index.IndexEntry(1141, f"E02/0{k}", "2000-03-01T10:00:00.00", {}) for k in range(1001, 1004)]
        archive_index.write_indexes(folder, images)

    def rows(path: Path) -> object:
        return read_index(path.with_name("imgindx.tab"), path.with_name("imgindx.lbl"))

    def part(path: Path) -> object:
        return PartialFile(path.with_name("a.img"), "http://x.org/a").source

    def focal(path: Path) -> object:
        return camera_focal_length(path.parents[len(Path(_INSTRUMENT).parts) - 1])

    at = "mgsc_1141/index/imgindx"
    yield Row("mirrors", "D", Archives.read, partial(text, "mirrors.toml", addresses), TOML)
    yield Row("lock of fetch", "D", lambda path: Lock.read(path.parent), partial(text, LOCK, json.dumps(lock)), JSON)
    yield Row("part of fetch", "D", part, lambda: text("a.img.part.json", said, **{"a.img.part": b"abc"}), JSON)
    yield Row("index of a volume", "D", rows, lambda: made(f"{at}.tab", index), CSV)
    yield Row("index's label", "D", rows, lambda: made(f"{at}.lbl", index), PVL)
    kernel = "KPL/IK\n\\begindata\nINS-94031_PIXEL_SIZE = ( 0.000013 )\n\\begintext\n"
    yield Row("instrument kernel of fetch", "D", focal, partial(text, str(_INSTRUMENT), kernel), PVL)

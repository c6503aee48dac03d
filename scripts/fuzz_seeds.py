"""Small sound files of every kind, written by the program's own simulator and by the tests' writers.

A seed is a folder's worth of files; they are made once, in a folder in memory, and kept as bytes.
"""

import atexit
import gzip
import io
import json
import os
import runpy
import shutil
import struct
import subprocess
import sys
import tempfile
from collections.abc import Callable, Mapping
from functools import cache
from pathlib import Path
from types import SimpleNamespace
from typing import Any, NamedTuple

import numpy as np
from fuzz_edits import bomb


class Seed(NamedTuple):
    """Files by their names, and which of them is damaged."""

    files: Mapping[str, bytes]
    main: str


class Reader(NamedTuple):
    """A function that reads a file, or a command."""

    name: str
    read: Callable[[Path], Any]
    seed: Callable[[], Seed]
    """Its valid files, written on request."""
    form: str
    """Kind of edits, of `fuzz_edits.FORMS`."""
    gaps: tuple[str, ...] = ()
    """Ends of the paths where the result may have gaps (NaN), such as missing posts."""
    same: bool = False
    """Whether each file that is not refused must give the valid file's result."""
    patience: float = 10.0
    """s, time limit."""


TESTS = Path(__file__).resolve().parents[1] / "tests"


def of_tests(path: str) -> SimpleNamespace:
    """A module of the tests, for the files that it can write."""
    return SimpleNamespace(**runpy.run_path(str(TESTS / path)))


def made(main: str, write: Callable[[Path], Any]) -> Seed:
    """Files that a function writes into a folder."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        write(folder)
        return folder_seed(folder, main)


def folder_seed(folder: Path, main: str) -> Seed:
    """All files of a folder."""
    files = {str(path.relative_to(folder)): path.read_bytes() for path in sorted(folder.rglob("*")) if path.is_file()}
    return Seed({main: files[main]} | files, main)


def text(name: str, content: str | bytes, **beside: str | bytes) -> Seed:
    """One file, and files beside it."""
    files = {name: content} | beside
    return Seed({key: data.encode() if isinstance(data, str) else data for key, data in files.items()}, name)


def commanded(*arguments: object) -> None:
    """`mgsgraph` with these arguments; exit status 1 means a doubtful result."""
    words = [sys.executable, "-m", "mgsgraph", *map(str, arguments)]
    done = subprocess.run(words, stdout=subprocess.DEVNULL, check=False)
    if done.returncode not in (0, 1):
        raise RuntimeError(f"{' '.join(words)}: exit {done.returncode}")


PAIR = ("case.toml", "image_A.isd", "image_B.isd", "network.pvl", "lidar.json")
WORDS = "words.json"
"""File with a command line, in the folder that it is given in."""


def obeyed(path: Path) -> None:
    """Run the command line beside or above a file; this ends the process."""
    from mgsgraph.cli import main

    os.chdir(next(folder for folder in path.parents if (folder / WORDS).exists()))
    os.environ["HOME"] = str(Path.cwd())
    sys.argv = ["mgsgraph", *json.loads(Path(WORDS).read_bytes())]
    main()


# --- the simulated pair and what becomes of it


@cache
def pair_folder() -> Path:
    """A pair with its case; it stays until the process ends."""
    from mgsgraph.simulation.files import write_pair
    from mgsgraph.simulation.pair import PairSettings, simulate_pair

    folder = Path(tempfile.mkdtemp(prefix="fuzz_pair.", dir="/dev/shm" if Path("/dev/shm").is_dir() else None))
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    write_pair(simulate_pair(PairSettings(ties=12, shots=6), seed=1), folder)
    return folder


@cache
def worked_folder() -> Path:
    """The same with its result, and its projects."""
    folder = pair_folder()
    case = folder / "case.toml"
    commanded("adjust", case, "--out", folder / "result", "--no-figures")
    commanded("project", "init", folder / "project", "--case", case)
    commanded("project", "solve", folder / "project", "--no-figures")
    commanded("project", "init", folder / "half", "--case", case)
    commanded("project", "remove", folder / "half", "SIM/B")
    return folder


def of_pair(main: str, *beside: str) -> Seed:
    """Files of the pair: one that is damaged, and those that it needs."""
    worked = any("/" in name for name in (main, *beside))
    folder = worked_folder() if worked else pair_folder()
    return Seed({name: (folder / name).read_bytes() for name in (main, *beside)}, main)


def case_seed(main: str = "case.toml") -> Seed:
    return of_pair(main, *(name for name in PAIR if name != main))


# --- a simulated site: kernels, image, profile, grids


@cache
def site_seed() -> dict[str, bytes]:
    """Files of a site by name, pixels left out, the profile short."""
    from mgsgraph.simulation.files import write_site
    from mgsgraph.simulation.site import SimulationOptions, simulate_site

    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        write_site(simulate_site("eos", 1, SimulationOptions(pictures=False)), folder)
        files = {path.name: path.read_bytes() for path in folder.iterdir() if path.suffix not in (".json", ".pvl")}
    short = {".img": lambda content: content[: 1 << 13], ".b": short_profile}
    names = {name for name in files if not name.endswith(".img") or name.startswith("E")}
    return {name: short.get(Path(name).suffix, bytes)(files[name]) for name in names}


def short_profile(content: bytes, frames: int = 4) -> bytes:
    """The first frames of a PEDR file, and its label to match."""
    from mgsgraph.files.altimetry.binary import FRAME

    records = 10 + frames
    rows = len(content) // FRAME.itemsize - 10
    label = content[: 10 * FRAME.itemsize]
    for key, old, new in ((b"FILE_RECORDS", rows + 10, records), (b"ROWS", rows, frames)):
        entry = key + b" = " + str(old).encode()
        assert entry in label
        label = label.replace(entry, (key + b" = " + str(new).encode()).ljust(len(entry)))
    return label + content[10 * FRAME.itemsize : records * FRAME.itemsize]


def of_site(main: str, *beside: str) -> Seed:
    files = site_seed()
    return Seed({name: files[name] for name in (main, *beside)}, main)


def kernels_seed(main: str) -> Seed:
    """All kernels of the site, and an image."""
    suffixes = {".tls", ".tsc", ".tpc", ".tf", ".ti", ".bsp", ".bc", ".tm", ".img"}
    return of_site(main, *(name for name in site_seed() if Path(name).suffix in suffixes - {main}))


def grid_seed(main: str) -> Seed:
    """A MEGDR of 6 x 8 posts with its label."""
    from mgsgraph.simulation.mola_files import MegdrLayout, write_megdr
    from mgsgraph.units import DEG

    def write(folder: Path) -> None:
        layout = MegdrLayout((6, 8), 87.0 * DEG, 4.1 * DEG, DEG / 16.0, 3_396_000.0)
        write_megdr(folder, "megr_x", layout, [3_396_000.0 - 2000.0 + np.arange(48.0).reshape(6, 8)])

    return made(main, write)


# --- altimetry


def lola_records(count: int = 3) -> bytes:
    """Records of LOLARDR.FMT, as `tests/files/altimetry/test_shots.py` lays them out."""
    content = b""
    for k in range(count):
        record = bytearray(256)
        struct.pack_into("<2I", record, 8, 305495504 + k, 1 << 30)
        struct.pack_into("<2i2I", record, 24, 25_000_000, -250_000_000, 1_785_000_000, 1_737_373_000)
        for spot in range(5):
            place = (25_000_000 + 100 * spot, -250_000_000 + 1000 * k, 1_735_000_000, 50_000_000)
            struct.pack_into("<3iI", record, 40 + 40 * spot, *place)
            struct.pack_into("<I", record, 76 + 40 * spot, 0 if spot < 4 else 0x41)
        struct.pack_into("<H", record, 240, 92)
        content += bytes(record)
    return content


def lola_label(name: str = "LOLARDR_092490702.DAT", rows: int = 3) -> str:
    table = f'OBJECT = TABLE\nROWS = {rows}\n^STRUCTURE = "LOLARDR.FMT"\nEND_OBJECT = TABLE\nEND\n'
    data_set = 'DATA_SET_ID = "LRO-L-LOLA-3-RDR-V1.0"\n'
    head = f'PDS_VERSION_ID = PDS3\nRECORD_TYPE = FIXED_LENGTH\n^TABLE = "{name}"\n'
    return (head + data_set + table).replace("\n", "\r\n")


def mla_table() -> str:
    tests = of_tests("files/altimetry/test_shots.py")
    rows = [tests.mla_row(channel, 354699676.684 + k) for k, channel in enumerate((0, 4, 5, 0))]
    return "\n".join((tests.MLA_HEADER, *rows)) + "\n"


def ode_table() -> str:
    tests = of_tests("files/altimetry/test_pedr.py")
    rows = [tests.ODE_SHOT.replace("-23162931.18358", f"-{23162931.18358 - k}") for k in range(5)]
    return "\n".join((tests.ODE, *rows)) + "\n"


def profile_csv() -> str:
    """Shots as ODE serves them, in degrees and m."""
    rows = ["LONG_EAST,LAT_NORTH,PLANET_RAD,MOLA_RANGE,EPHEMERIS_TIME,ORBIT"]
    rows += [
        f"{87 + 1e-3 * k:.6f},{4 + 1e-3 * k:.6f},{3393000 + k}.25,{400000 - k}.5,{5000 + 0.1 * k:.3f},18933"
        for k in range(5)
    ]
    return "\n".join(rows) + "\n"


def packed(content: str | bytes) -> bytes:
    """By gzip; the bomb that its damage may be is made now, before workers wait for it."""
    bomb()
    return gzip.compress(content.encode() if isinstance(content, str) else content, mtime=0)


# --- networks


def written_network(name: str, form: str) -> Seed:
    """The pair's network in one of `convert`'s formats."""

    def write(folder: Path) -> None:
        output = folder / name
        more = ["--case", pair_folder() / "case.toml"] if form in ("nvm", "gcp", "match", "match-text") else []
        commanded("convert", pair_folder() / "network.pvl", output, "--to", form, *more)

    with tempfile.TemporaryDirectory() as place:
        write(Path(place))
        names = sorted(path.name for path in Path(place).iterdir())
        return folder_seed(Path(place), name if name in names else names[0])


def old_network(version: int) -> Seed:
    import control_networks

    grid = control_networks.grid(3, 2)
    if version == 0:
        return text("old.net", control_networks.first_binary(grid))
    return text("old.pvl", control_networks.pvl_text(grid, version))


def support_data() -> str:
    import support_data as tests

    return json.dumps(tests.ISD, indent=1)


def model_state() -> str:
    tests = of_tests("files/support_data/test_model_state.py")
    return f"{tests.HEAD}\n{json.dumps(tests.state(), indent=1)}"


def small_npz() -> bytes:
    """An archive of three arrays, as a kept tile is one."""
    content = io.BytesIO()
    np.savez(content, a=np.arange(6.0).reshape(2, 3), b=np.arange(4), c=np.array(["one", "two"]))
    return content.getvalue()

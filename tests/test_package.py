"""The house: what is declared is what is on disk, and every import goes down."""

import ast
import re
import subprocess
import sys
import tomllib
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
TABLE = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
FOLDERS = {"mgsgraph": ROOT / "mgsgraph", "mgsgraph.factors": ROOT / "factors"}
STOREYS = [
    ("mgsgraph.cli",),
    ("mgsgraph.studio",),
    ("mgsgraph.campaign", "mgsgraph.project"),
    ("mgsgraph.demo",),
    ("mgsgraph.export", "mgsgraph.review"),
    (
        "mgsgraph.reports", "mgsgraph.registration.relief", "mgsgraph.registration.relief_surfaces",
        "mgsgraph.dem.production",
        "mgsgraph.dem.files", "mgsgraph.matching.files",
        "mgsgraph.registration.tables", "mgsgraph.registration.relief_files", "mgsgraph.registration.crossing_tables",
    ),
    ("mgsgraph.figures",),
    (
        "mgsgraph.dem", "mgsgraph.registration.case", "mgsgraph.registration.measured",
        "mgsgraph.registration.relief_records",
    ),
    ("mgsgraph.case",),
    (
        "mgsgraph.analysis", "mgsgraph.incremental", "mgsgraph.planning",
        "mgsgraph.spacing", "mgsgraph.adjustment.two_steps",
    ),
    ("mgsgraph.adjustment",),
    ("mgsgraph.simulation",),
    ("mgsgraph.matching", "mgsgraph.output"),
    (
        "mgsgraph.network", "mgsgraph.registration", "mgsgraph.altimetry", "mgsgraph.control", "mgsgraph.io",
        "mgsgraph.fetch",
    ),
    ("mgsgraph.ties",),
    ("mgsgraph.geometry", "mgsgraph.kernel"),
    ("mgsgraph.factors", "mgsgraph.names"),
    (
        "mgsgraph.units", "mgsgraph.errors", "mgsgraph.notebook", "mgsgraph.wording", "mgsgraph.compiled",
        "mgsgraph.apart", "mgsgraph.libraries", "mgsgraph.workers", "mgsgraph.aside", "mgsgraph.stages",
    ),
]
"""Rooms from above to below; of a room whose writers draw, these stand above the figures, and the rest below them."""
ONLY_IN = {
    "gtsam": ("mgsgraph.factors", "mgsgraph.adjustment", "mgsgraph.incremental"),
    "matplotlib": ("mgsgraph.figures",),
    "numba": (
        "mgsgraph.compiled", "mgsgraph.kernel", "mgsgraph.adjustment.graph.rows",
    ),
    "llvmlite": ("mgsgraph.kernel.lanes",),
    "cv2": ("mgsgraph.matching",),
    "jinja2": ("mgsgraph.output.page",),
    "google": ("mgsgraph.control",),
    "click": ("mgsgraph.cli",),
    "starlette": ("mgsgraph.studio",),
    "tqdm": ("mgsgraph.cli",),
    "scipy": (
        "mgsgraph.analysis", "mgsgraph.adjustment.blunders", "mgsgraph.adjustment.datum", "mgsgraph.adjustment.gpu",
        "mgsgraph.adjustment.graph.prior",
        "mgsgraph.adjustment.marginals",
        "mgsgraph.adjustment.sparse_cholesky", "mgsgraph.geometry.common_errors", "mgsgraph.geometry.footprint",
        "mgsgraph.geometry.stereo_surface", "mgsgraph.geometry.terrain",
        "mgsgraph.geometry.track_terrain",
        "mgsgraph.matching", "mgsgraph.dem", "mgsgraph.spacing", "mgsgraph.studio.ground",
    ),
    "shapely": ("mgsgraph.geometry", "mgsgraph.export"),
    "pyogrio": ("mgsgraph.export",),
    "spiceypy": ("mgsgraph.io", "mgsgraph.simulation", "mgsgraph.export"),
    "msgspec": (
        "mgsgraph.campaign", "mgsgraph.case", "mgsgraph.control", "mgsgraph.export", "mgsgraph.fetch", "mgsgraph.io",
        "mgsgraph.output", "mgsgraph.project", "mgsgraph.review", "mgsgraph.simulation.archive_files",
    ),
    "requests": ("mgsgraph.fetch",),
    "urllib3": ("mgsgraph.fetch",),
    "sqlite3": ("mgsgraph.project",),
    "cupy": ("mgsgraph.adjustment.gpu",),
    "cupyx": ("mgsgraph.adjustment.gpu",),
    "dask": ("mgsgraph.adjustment.cluster",),
    "distributed": ("mgsgraph.adjustment.cluster",),
}


def modules(folders: dict[str, Path] = FOLDERS) -> dict[str, Path]:
    """Every module below some packages: its dotted name, its file."""
    found = {}
    for package, folder in folders.items():
        for path in folder.rglob("*.py"):
            parts = path.relative_to(folder).with_suffix("").parts
            found[".".join((package, *(part for part in parts if part != "__init__")))] = path
    return found


@cache
def imports(path: Path) -> set[str]:
    """Dotted names that a file imports, in functions and for types, too; of `from a import b` both a and a.b."""
    names: set[str] = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: relative import"
            names.add(node.module or "")
            names |= {f"{node.module}.{alias.name}" for alias in node.names}
    return names


def storey(name: str) -> int | None:
    """Number of the storey, counted from above, of the longest entry of STOREYS that the name begins with."""
    rooms = [(len(room), height) for height, rooms in enumerate(STOREYS) for room in rooms if within(name, room)]
    return max(rooms)[1] if rooms else None


def within(name: str, room: str) -> bool:
    return name == room or name.startswith(room + ".")


def upward(found: dict[str, Path]) -> list[str]:
    """Imports of a room that stands higher; the package itself, a list of public names, may import all."""
    return [
        f"{name} imports {target}"
        for name, path in found.items()
        if name != "mgsgraph"
        for target in sorted(imports(path))
        if (here := storey(name)) is not None and (there := storey(target)) is not None and there < here
    ]


def circles(found: dict[str, Path]) -> list[set[str]]:
    """Files of which each imports, by way of others of them, all of the others."""
    below = {
        name: {target for target in imports(path) if target in found and target != name}
        for name, path in found.items()
        if name != "mgsgraph"
    }
    reached: dict[str, set[str]] = {}
    for name in below:
        seen, open_ones = set[str](), [name]
        while open_ones:
            new = below.get(open_ones.pop(), set()) - seen
            seen |= new
            open_ones += new
        reached[name] = seen
    rings = {frozenset(other for other in reached[name] if name in reached.get(other, ())) for name in below}
    return sorted((set(ring) for ring in rings if ring), key=sorted)


DOOR = {
    "mgsgraph.io.files": {"os.fdopen", "json.loads", "open"},  # os.open
    "mgsgraph.io.decoding": {"tomllib.loads"},
    "mgsgraph.io.toml_lines": {"tomllib.loads"},  # keys of what was read
    "mgsgraph.io.raster_file": {"DatasetReader"},
    "mgsgraph.io.kernels": {"spiceypy.furnsh"},
    "mgsgraph.io.megdr": {"np.memmap"},  # of an open file whose size fits its label
    "mgsgraph.io.cameras.hrsc_lines": {"np.memmap"},  # the same
    "mgsgraph.io.pictures": {"np.fromfile"},  # the same
    "mgsgraph.altimetry.csv_lines": {"np.loadtxt"},  # of lines that were read
    "mgsgraph.reports.archive_arrays": {"zipfile.ZipFile"},
    "mgsgraph.project.checksum": {"open"},  # POSIX drops locks where any reader closes
    "mgsgraph.project.store": {"json.loads"},  # cells of rows whose checksum is right
    "mgsgraph.project.project": {"json.loads"},
    # our own files, not a user's
    "mgsgraph.adjustment.graph.scratch": {"read_text"},  # the system's: how much memory a container may take
    "mgsgraph.export.spice_back": {"spiceypy.furnsh"},
    "mgsgraph.output.geotiff": {"rasterio.open"},
    "mgsgraph.adjustment.cluster.workers": {"open", "read_bytes"},
    "mgsgraph.compiled": {"read_bytes"},
    "mgsgraph.io.writing": {"open"}, "mgsgraph.fetch.part": {"open"}, "mgsgraph.campaign.record": {"open"},
    "mgsgraph.aside": {"open"}, "mgsgraph.apart": {"open"}, "mgsgraph.workers": {"open"},
}  # fmt: skip
"""Where files from outside are opened and parsed: all else takes them from these (docs/hostile_files.md)."""
METHODS = {"open", "read_bytes", "read_text"}
"""Of paths; the functions of the same name are the door."""
READING = {
    "open", "os.fdopen", "np.load", "np.loadtxt", "np.genfromtxt", "np.fromfile", "np.memmap", "json.load",
    "json.loads", "tomllib.load", "tomllib.loads", "gzip.open", "gzip.decompress", "zipfile.ZipFile", "rasterio.open",
    "DatasetReader", "spiceypy.furnsh", "pdr.read",
}
"""Functions that read a file, or parse what was read."""


def readings(path: Path) -> set[str]:
    """Names of READING and METHODS that a module calls, but to write."""
    found = set[str]()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if not isinstance(node, ast.Call) or any(
            isinstance(one, ast.Constant) and one.value in ("w", "wb", "a", "ab", "x", "xb") for one in node.args
        ):
            continue
        if isinstance(node.func, ast.Name):
            found |= {node.func.id} & READING
        elif isinstance(node.func, ast.Attribute):
            owner = node.func.value.id if isinstance(node.func.value, ast.Name) else ""
            found |= {f"{owner}.{node.func.attr}"} & READING or {node.func.attr} & METHODS
    return found


def test_files_from_outside_come_in_by_the_door() -> None:
    """Regular, of a bearable size, understood in one place."""
    assert {name: found - DOOR.get(name, set()) for name, path in modules().items()
            if (found := readings(path)) - DOOR.get(name, set())} == {}  # fmt: skip
    assert set(DOOR) <= modules().keys()


def test_a_reading_past_the_door_is_seen(tmp_path: Path) -> None:
    for k, code in enumerate(("json.loads(x)", "x.y.read_text()", "path.open()", "open(x)", "np.load(x)")):
        (tmp_path / f"{k}.py").write_text(code, encoding="utf-8")
        assert readings(tmp_path / f"{k}.py")
    (tmp_path / "door.py").write_text("read_text(path)\npath.open('w')\nopened(x)", encoding="utf-8")
    assert not readings(tmp_path / "door.py")


def test_every_package_on_disk_is_declared() -> None:
    on_disk = {name for name, path in modules().items() if path.name == "__init__.py"}
    assert on_disk == set(TABLE["tool"]["setuptools"]["packages"])


def test_no_top_level_factors(tmp_path: Path) -> None:
    code = "import importlib.util; print(importlib.util.find_spec('factors'))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=tmp_path)
    assert done.stdout.strip() == "None"


def test_every_import_goes_down() -> None:
    found = modules()
    assert not [name for name in found if name not in ("mgsgraph", "mgsgraph.__main__") and storey(name) is None]
    assert not upward(found)


def test_no_files_import_one_another_in_a_circle() -> None:
    assert not circles(modules())


@pytest.mark.parametrize(
    ("files", "up", "ring"),
    [
        ({"dem/model.py": "import mgsgraph.figures.dem"}, "mgsgraph.dem.model imports mgsgraph.figures.dem", 0),
        ({"io/text.py": "def f():\n    import mgsgraph.cli.demo"}, "mgsgraph.io.text imports mgsgraph.cli.demo", 0),
        ({"dem/files.py": "import mgsgraph.figures.dem", "figures/dem.py": "import mgsgraph.dem.model"}, "", 0),
        ({"dem/a.py": "from mgsgraph.dem import b", "dem/b.py": "def f():\n    from mgsgraph.dem.a import f"}, "", 2),
        ({f"dem/{one}.py": f"from mgsgraph.dem.{two} import f" for one, two in ("ab", "bc", "ca")}, "", 3),
    ],
)
def test_planted_imports_are_found(files: dict[str, str], up: str, ring: int, tmp_path: Path) -> None:
    for name, text in files.items():
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text(text + "\n", encoding="utf-8")
    found = modules({"mgsgraph": tmp_path})
    assert upward(found)[:1] == ([up] if up else [])
    assert [len(one) for one in circles(found)] == ([ring] if ring else [])


@pytest.mark.parametrize("library", ONLY_IN)
def test_libraries_stay_in_their_rooms(library: str) -> None:
    wrong = [
        name
        for name, path in modules().items()
        if any(target.split(".")[0] == library for target in imports(path))
        and not any(within(name, room) for room in ONLY_IN[library])
    ]
    assert not wrong


def test_equations_and_kernel_stay_below_the_adjustment() -> None:
    """Equations serve geometry, kernel and adjustment; the kernel the adjustment and what questions it."""
    adjusting = tuple(f"mgsgraph.{room}" for room in ("adjustment", "analysis", "incremental", "planning", "spacing"))
    users = {
        "mgsgraph.factors": ("mgsgraph.factors", "mgsgraph.geometry", "mgsgraph.kernel", *adjusting),
        "mgsgraph.kernel": ("mgsgraph.kernel", *adjusting),
    }
    wrong = [
        f"{name} imports {package}"
        for name, path in modules().items()
        for package, rooms in users.items()
        if not name.startswith(rooms) and any(target.startswith(package) for target in imports(path))
    ]
    assert not wrong


def test_no_file_outgrows_its_room() -> None:
    assert not {n: k for n, p in modules().items() if (k := len(p.read_text(encoding="utf-8").splitlines())) > 520}


def test_no_room_holds_more_than_an_eighth_of_the_house() -> None:
    lines: dict[str, int] = {}
    for name, path in modules().items():
        room = ".".join(name.split(".")[:2])
        lines[room] = lines.get(room, 0) + len(path.read_text(encoding="utf-8").splitlines())
    assert not {room: count for room, count in lines.items() if count > 0.125 * sum(lines.values())}


def test_help_imports_nothing_heavy() -> None:
    code = "import sys, mgsgraph.cli; print([m for m in ('numpy', 'numba', 'gtsam', 'matplotlib') if m in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_dask_is_imported_only_when_it_is_asked_for() -> None:
    code = (
        "import sys, mgsgraph.campaign, mgsgraph.campaign.run, mgsgraph.adjustment.cluster;"
        "print([m for m in ('dask', 'distributed') if m in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_public_names_resolve() -> None:
    import mgsgraph

    assert all(getattr(mgsgraph, name) is not None for name in mgsgraph.__all__)
    with pytest.raises(AttributeError, match="read_case"):
        _ = mgsgraph.nothing_like_that


def test_readme_holds_two_one_line_set_up_commands() -> None:
    commands = re.findall(r"```sh setup\n(.+?)\n```", (ROOT / "README.md").read_text(encoding="utf-8"))
    assert len(commands) == 2
    assert not any("\n" in command for command in commands)

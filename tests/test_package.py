"""The house: what is declared is what is on disk, every import goes down, and files for others say the same."""

import ast
import json
import os
import re
import shutil
import subprocess
import sys
import sysconfig
import tomllib
from collections.abc import Iterable
from datetime import date
from functools import cache
from importlib.metadata import version
from pathlib import Path
from typing import Any

import pytest
from packaging.requirements import Requirement
from packaging.version import Version

ROOT = Path(__file__).resolve().parents[1]
TABLE = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
FOLDERS = {"mgsgraph": ROOT / "mgsgraph", "mgsgraph.factors": ROOT / "factors"}
FLOORS = (
    ("cli",),
    ("studio", "fetch"),
    ("project",),
    ("export", "simulation"),
    ("results",),
    ("registration", "planning"),
    ("case",),
    ("analysis",),
    ("adjustment", "matching"),
    ("network",),
    ("files",),
    ("kernel", "geometry"),
    ("factors",),
    (
        "atomic_write", "compiled", "errors", "names", "record", "text", "units",
        "workers",
    ),
)  # fmt: skip
"""Rooms from the highest floor to the lowest: an import goes down, or stays in its room. The single files of the lowest
floor are one room. CONTRIBUTING.md has the same list, with what each room is for."""
ONLY_IN = {
    "gtsam": ("mgsgraph.factors", "mgsgraph.adjustment"),
    "matplotlib": ("mgsgraph.results.figures",),
    "numba": ("mgsgraph.compiled", "mgsgraph.kernel", "mgsgraph.adjustment.graph.rows"),
    "llvmlite": ("mgsgraph.kernel.lanes",),
    "cv2": ("mgsgraph.matching",),
    "jinja2": ("mgsgraph.files.writing",),
    "google": ("mgsgraph.files.networks",),
    "click": ("mgsgraph.cli",),
    "starlette": ("mgsgraph.studio",),
    "tqdm": ("mgsgraph.cli",),
    "scipy": (
        "mgsgraph.analysis", "mgsgraph.adjustment", "mgsgraph.files.networks", "mgsgraph.geometry", "mgsgraph.matching",
        "mgsgraph.network.common", "mgsgraph.network.connectivity", "mgsgraph.network.duplicates",
        "mgsgraph.registration.dem", "mgsgraph.results.catalog", "mgsgraph.simulation.archive_ties",
        "mgsgraph.studio.linked", "mgsgraph.studio.marks",
    ),
    "shapely": ("mgsgraph.geometry", "mgsgraph.export"),
    "pyogrio": ("mgsgraph.export",),
    "spiceypy": ("mgsgraph.files", "mgsgraph.simulation", "mgsgraph.export"),
    "msgspec": (
        "mgsgraph.case", "mgsgraph.export", "mgsgraph.fetch", "mgsgraph.files", "mgsgraph.planning.candidates_file",
        "mgsgraph.project", "mgsgraph.simulation.archive_files",
    ),
    "requests": ("mgsgraph.fetch",),
    "urllib3": ("mgsgraph.fetch",),
    "sqlite3": ("mgsgraph.project",),
    "cupy": ("mgsgraph.adjustment.gpu",),
    "cupyx": ("mgsgraph.adjustment.gpu",),
    "dask": ("mgsgraph.adjustment.cluster",),
    "distributed": ("mgsgraph.adjustment.cluster",),
}  # fmt: skip


def modules(folders: dict[str, Path] = FOLDERS) -> dict[str, Path]:
    """Every module below some packages: its dotted name, its file; the link to `factors` is not followed."""
    found = {}
    for package, folder in folders.items():
        for path in folder.rglob("*.py"):
            parts = path.relative_to(folder).with_suffix("").parts
            if not any(parent.is_symlink() for parent in path.parents if parent != folder):
                found[".".join((package, *(part for part in parts if part != "__init__")))] = path
    return found


@cache
def imports(path: Path) -> set[str]:
    """Dotted names that a file imports, in functions and for types, too; of `from a import b` both a and a.b. A dotted
    name in a string, or the beginning of one, counts as an import: `import_module` takes such.
    """
    names: set[str] = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: relative import"
            names.add(node.module or "")
            names |= {f"{node.module}.{alias.name}" for alias in node.names}
        elif isinstance(node, ast.Constant) and isinstance(node.value, str):
            names |= {node.value.rstrip(".")} if _DOTTED.fullmatch(node.value) else set()
    return names


_DOTTED = re.compile(r"mgsgraph(\.\w+)+\.?")
HEIGHTS = {room: len(FLOORS) - k for k, rooms in enumerate(FLOORS) for room in rooms}


def room(name: str) -> str:
    """The room of a module; empty of the package itself, whose public names may come from everywhere."""
    return name.split(".")[1] if "." in name else ""


def within(name: str, package: str) -> bool:
    return name == package or name.startswith(package + ".")


def wrong_ways(found: dict[str, Path]) -> list[str]:
    """Imports of a higher room, or of another room of the same floor."""
    return [
        f"{name} imports {target}"
        for name, path in found.items()
        if room(name) in HEIGHTS
        for target in sorted(imports(path))
        if within(target, "mgsgraph") and (there := room(target)) in HEIGHTS and there != room(name)
        if HEIGHTS[there] > HEIGHTS[room(name)] or HEIGHTS[there] == HEIGHTS[room(name)] > 1
    ]


def circles(found: dict[str, Path]) -> list[set[str]]:
    """Files of which each imports, by way of others of them, all of the others."""
    known = {name: reached(found, [name]) for name in found if name != "mgsgraph"}
    rings = {frozenset(other for other in known[name] if name in known.get(other, ())) for name in known}
    return sorted((set(ring) for ring in rings if ring), key=sorted)


def reached(found: dict[str, Path], start: Iterable[str]) -> set[str]:
    """Modules that some import, by way of others; not by way of the package's list of public names."""
    seen, open_ones = set[str](), [name for name in start if name in found]
    while open_ones:
        name = open_ones.pop()
        new = {one for one in imports(found[name]) if one in found and one not in {name, "mgsgraph"}} - seen
        seen |= new
        open_ones += new
    return seen


DOOR = {
    "mgsgraph.files.opening": {"os.fdopen", "json.loads", "open"},  # os.open
    "mgsgraph.files.decoding": {"tomllib.loads"},
    "mgsgraph.files.rasters.raster_file": {"DatasetReader", "rasterio.open"},
    "mgsgraph.files.labels.kernels": {"spiceypy.furnsh"},
    "mgsgraph.files.rasters.megdr": {"np.memmap"},  # of an open file whose size fits its label
    "mgsgraph.files.cameras.label": {"np.memmap"},  # the same
    "mgsgraph.files.rasters.pictures": {"np.fromfile"},  # the same
    "mgsgraph.results.archive": {"zipfile.ZipFile"},
    "mgsgraph.project.store": {"json.loads"},  # cells of rows whose checksum is right
    "mgsgraph.project.project": {"json.loads"}, "mgsgraph.project.settings": {"json.loads"},
    # our own files, not a user's
    "mgsgraph": {"read_text"}, "mgsgraph.project.schema": {"read_text"},
    "mgsgraph.files.geometric_keys": {"read_text", "tomllib.loads"},
    "mgsgraph.adjustment.graph.rows": {"read_text"},  # the system's: how much memory a container may take
    "mgsgraph.adjustment.cluster.workers": {"open", "read_bytes"}, "mgsgraph.adjustment.cluster.own": {"open"},
    "mgsgraph.compiled": {"open", "read_bytes"}, "mgsgraph.results.section": {"read_text", "tomllib.loads"},
    "mgsgraph.files.writing": {"open"}, "mgsgraph.fetch.download": {"open"},
    "mgsgraph.project.campaign": {"open"}, "mgsgraph.atomic_write": {"open"}, "mgsgraph.workers": {"open"},
}  # fmt: skip
"""Where files from outside are opened and parsed: all else takes them from these (docs/evidence_robustness.md)."""
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


def test_every_room_has_its_floor_and_every_import_goes_down() -> None:
    found = modules()
    assert {room(name) for name in found} - {"", "__main__"} == set(HEIGHTS)
    assert not wrong_ways(found)


def test_no_files_import_one_another_in_a_circle() -> None:
    assert not circles(modules())


def test_the_list_of_floors_is_that_of_the_page() -> None:
    page = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8").partition("## The house")[2].partition("\n## ")[0]
    assert [tuple(re.findall(r"`(\w+)`", row.split("|")[1])) for row in page.splitlines() if row.startswith("| `")] == [
        *FLOORS
    ]


@pytest.mark.parametrize(
    ("files", "wrong", "ring"),
    [
        ({"geometry/a.py": "import mgsgraph.case.b"}, "mgsgraph.geometry.a imports mgsgraph.case.b", 0),
        ({"files/a.py": "def f():\n    import mgsgraph.cli.b"}, "mgsgraph.files.a imports mgsgraph.cli.b", 0),
        ({"kernel/a.py": "from mgsgraph.geometry import b"}, "mgsgraph.kernel.a imports mgsgraph.geometry", 0),
        ({"files/a.py": "import_module('mgsgraph.case.b')"}, "mgsgraph.files.a imports mgsgraph.case.b", 0),
        ({"files/a.py": "import_module(f'mgsgraph.case.{b}')"}, "mgsgraph.files.a imports mgsgraph.case", 0),
        ({"case/a.py": "from mgsgraph.case import b", "case/b.py": "def f():\n    import mgsgraph.case.a"}, "", 2),
        ({"case/a.py": "from mgsgraph.case import b", "case/b.py": "f = import_module('mgsgraph.case.a')"}, "", 2),
        ({f"case/{one}.py": f"from mgsgraph.case.{two} import f" for one, two in ("ab", "bc", "ca")}, "", 3),
    ],
)  # fmt: skip
def test_planted_imports_are_found(files: dict[str, str], wrong: str, ring: int, tmp_path: Path) -> None:
    for name, text in files.items():
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text(text + "\n", encoding="utf-8")
    found = modules({"mgsgraph": tmp_path})
    assert wrong_ways(found)[:1] == ([wrong] if wrong else [])
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
    adjusting = tuple(f"mgsgraph.{room}" for room in ("adjustment", "analysis", "planning"))
    users = {
        "mgsgraph.factors": ("mgsgraph.factors", "mgsgraph.geometry", "mgsgraph.kernel", *adjusting),
        "mgsgraph.kernel": ("mgsgraph.kernel", *adjusting),
    }
    wrong = [
        f"{name} imports {package}"
        for name, path in modules().items()
        for package, rooms in users.items()
        if name != "mgsgraph" and not name.startswith(rooms)
        and any(target.startswith(package) for target in imports(path))
    ]
    assert not wrong


def test_the_factor_graph_shares_no_line_with_the_kernel() -> None:
    """But `factors` and `geometry`: so that each is a reference for the other."""
    found = modules()
    files = reached(found, {"mgsgraph.adjustment.factor_graph", "mgsgraph.adjustment.optimize", "mgsgraph.factors"})
    assert not [name for name in files if name.startswith(("mgsgraph.kernel", "mgsgraph.adjustment.graph"))]


REACH = 189
"""Files that adjusting a case may reach; whoever reads how an adjustment works has to know no others."""


def test_adjusting_a_case_reaches_few_files() -> None:
    """By every import of the verb's function, of what that imports, and so on."""
    found = modules()
    verb = next(
        node for node in ast.walk(ast.parse(found["mgsgraph.cli.cases"].read_text(encoding="utf-8")))
        if isinstance(node, ast.FunctionDef) and node.name == "adjust"
    )  # fmt: skip
    start = {node.module for node in ast.walk(verb) if isinstance(node, ast.ImportFrom) and node.module}
    files = {"mgsgraph.cli.cases", "mgsgraph.cli.options"} | start | reached(found, {*start, "mgsgraph.cli.options"})
    assert len(files) <= REACH, sorted(files)


def test_no_file_outgrows_its_room() -> None:
    assert not {n: k for n, p in modules().items() if (k := len(p.read_text(encoding="utf-8").splitlines())) > 520}


def test_help_imports_nothing_heavy() -> None:
    code = "import sys, mgsgraph.cli; print([m for m in ('numpy', 'numba', 'gtsam', 'matplotlib') if m in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_dask_is_imported_only_when_it_is_asked_for() -> None:
    code = (
        "import sys, mgsgraph.project.campaign, mgsgraph.adjustment.cluster.connection;"
        "print([m for m in ('dask', 'distributed') if m in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


# --- what the project says of itself in files for others (versions, citation, workflows, recipe) is one an


PROJECT: dict[str, Any] = TABLE["project"]
EXTRAS = PROJECT["optional-dependencies"]


def text_of(name: str) -> str:
    return (ROOT / name).read_text(encoding="utf-8")


def lowest(texts: list[str]) -> dict[str, str]:
    """Lower bound of each package."""
    return {one.name: clause.version for one in map(Requirement, texts) for clause in one.specifier}


def test_every_package_has_a_lower_bound_and_no_other() -> None:
    for text in [*PROJECT["dependencies"], *(one for extra in EXTRAS.values() for one in extra)]:
        one = Requirement(text)
        assert one.name == "mgsgraph" or [clause.operator for clause in one.specifier] == [">="], text


def test_the_page_of_versions_has_every_lower_bound() -> None:
    row = r"^\| ([\w-]+) \| ([\w-]+) \| ([\d.]+) \| ([\d.]+|-) \|$"
    rows = re.findall(row, text_of("docs/about.md"), re.MULTILINE)
    declared = lowest([*PROJECT["dependencies"], *(one for extra in EXTRAS.values() for one in extra)])
    declared.pop("mgsgraph", None)
    assert {name: bound for name, _, bound, _ in rows} == declared, "write it anew: python scripts/versions.py --page"
    for name, _, bound, newest in rows:
        assert newest == "-" or Version(newest) >= Version(bound), name


def test_all_is_what_programs_need() -> None:
    (one,) = map(Requirement, EXTRAS["all"])
    assert one.name == "mgsgraph"
    assert one.extras == set(EXTRAS) - {"all", "cuda", "test", "docs", "dev"}
    for extra in ("test", "dev"):
        named = {name for text in EXTRAS[extra] for name in Requirement(text).extras}
        assert named <= {"all", "test", "docs"}


def test_versions_and_dates_agree() -> None:
    yaml = pytest.importorskip("yaml")  # dask has it
    headings = re.findall(r"^## (\S+) – (\d{4}-\d\d-\d\d)$", text_of("CHANGELOG.md"), re.MULTILINE)
    cited = yaml.safe_load(text_of("CITATION.cff"))
    assert headings[0] == (PROJECT["version"], str(cited["date-released"]))
    assert [day for _, day in headings] == sorted((str(date.fromisoformat(day)) for _, day in headings), reverse=True)
    assert cited["version"] == PROJECT["version"]
    assert cited["license"] == PROJECT["license"]
    assert [one["name"] for one in cited["authors"]] == [one["name"] for one in PROJECT["authors"]]
    recipe = text_of("recipe/recipe.yaml")
    assert f'version: "{PROJECT["version"]}"' in recipe


def test_the_recipe_needs_what_the_package_needs() -> None:
    run = re.search(r"^  run:\n((?:    .*\n)+)", text_of("recipe/recipe.yaml"), re.MULTILINE)
    assert run is not None
    names = {"matplotlib": "matplotlib-base"}
    needed = re.findall(r"^    - ([\w-]+) >=([\d.]+)$", run[1], re.MULTILINE)
    declared = {names.get(name, name): bound for name, bound in lowest(PROJECT["dependencies"]).items()}
    assert {name: bound for name, bound in needed if name != "python"} == declared


def test_the_container_runs_the_demo_of_the_readme() -> None:
    container, readme = text_of("recipe/Containerfile"), text_of("README.md")
    verb = re.search(r"^CMD (\[.+\])$", container, re.MULTILINE)
    installed = re.search(r"FROM python:([\d.]+)-.*\nCOPY \. \S+\nRUN pip install .*\[(\w+)\]", container)
    assert verb is not None
    assert installed is not None
    assert f"/mgsgraph {' '.join(json.loads(verb[1]))}\n" in readme
    assert f"Programming Language :: Python :: {installed[1]}" in PROJECT["classifiers"]
    assert installed[2] in EXTRAS


def test_workflows_call_parts_that_there_are() -> None:
    yaml = pytest.importorskip("yaml")  # dask has it
    parts = set(re.findall(r"^#   (\w+) ", text_of(".ci/run"), re.MULTILINE))
    jobs = yaml.safe_load(text_of(".github/workflows/checks.yml"))["jobs"]
    called = set(jobs["parts"]["strategy"]["matrix"]["part"])
    for job in jobs.values():
        called |= set(re.findall(r"\.ci/run (\w+)", " ".join(step.get("run", "") for step in job["steps"])))
    assert called <= parts
    assert {"tests", "wheel", "lowest"} <= called
    offered = {one.rpartition(" ")[2] for one in PROJECT["classifiers"] if re.search(r":: 3\.\d+$", one)}
    assert set(jobs["tests"]["strategy"]["matrix"]["python"]) == offered


def test_the_core_of_the_tests_is_there() -> None:
    files = text_of(".ci/core_tests").split()
    assert files == sorted(set(files), key=lambda name: (name.count("/"), name))
    assert not [name for name in files if not (ROOT / name.partition("::")[0]).is_file()]


def test_versions_that_are_not_the_lowest_are_named() -> None:
    done = subprocess.run(
        [sys.executable, ROOT / "scripts" / "versions.py", "--lowest"], capture_output=True, text=True, check=False
    )
    bounds = lowest(PROJECT["dependencies"])
    above = [name for name, bound in bounds.items() if Version(version(name)) != Version(bound)]
    assert bool(above) == (done.returncode != 0)
    assert all(f"{name}: {version(name)} is installed" in done.stderr for name in above)


# --- the package imports where it is installed: inside a checkout, too, where the folder `mgsgraph` comes


NEEDED = "mgsgraph", "factors", "pyproject.toml", "README.md", "LICENSE"


@pytest.fixture(scope="module")
def checkout(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A copy of what is installed, with the link `mgsgraph/factors`."""
    folder = tmp_path_factory.mktemp("install") / "checkout"
    folder.mkdir()
    for name in NEEDED:
        if (ROOT / name).is_dir():
            shutil.copytree(ROOT / name, folder / name, symlinks=True, ignore=shutil.ignore_patterns("__pycache__"))
        else:
            shutil.copy2(ROOT / name, folder)
    return folder


@pytest.mark.slow
@pytest.mark.parametrize("how", [(), ("-e",)], ids=["wheel", "editable"])
def test_the_package_imports_inside_the_checkout(how: tuple[str, ...], checkout: Path, tmp_path: Path) -> None:
    environment = tmp_path / "environment"
    subprocess.run([sys.executable, "-m", "venv", environment], check=True)
    python = environment / "bin" / "python"
    install = [python, "-m", "pip", "install", "--quiet", "--no-deps", *how, checkout]
    subprocess.run(install, check=True)
    # libraries are those of this environment; its own installation of the package is not seen there
    libraries = os.environ | {"PYTHONPATH": sysconfig.get_path("purelib")}
    for cwd in (checkout, tmp_path):
        for arguments in (
            ["-c", "import mgsgraph.factors.collinearity as one; print(one.__file__)"], ["-m", "mgsgraph", "--version"],
            ["-c", "import mgsgraph; print(mgsgraph.Posterior, mgsgraph.write_results)"],
        ):  # fmt: skip
            done = subprocess.run([python, *arguments], capture_output=True, text=True, cwd=cwd, env=libraries)
            assert done.returncode == 0, done.stderr
    assert (checkout / "mgsgraph" / "factors").is_symlink()

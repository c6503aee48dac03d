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
    ("mgsgraph.campaign", "mgsgraph.project"),
    ("mgsgraph.products",),
    ("mgsgraph.case",),
    (
        "mgsgraph.adjustment.analysis", "mgsgraph.adjustment.incremental", "mgsgraph.adjustment.planning",
        "mgsgraph.adjustment.spacing", "mgsgraph.adjustment.two_steps",
    ),
    ("mgsgraph.adjustment",),
    ("mgsgraph.simulation",),
    ("mgsgraph.matching",),
    ("mgsgraph.network", "mgsgraph.registration", "mgsgraph.io", "mgsgraph.fetch"),
    ("mgsgraph.ties",),
    ("mgsgraph.geometry", "mgsgraph.kernel"),
    ("mgsgraph.factors",),
    ("mgsgraph.units", "mgsgraph.errors", "mgsgraph.notebook", "mgsgraph.wording", "mgsgraph.compiled"),
]
ONLY_IN = {
    "gtsam": ("mgsgraph.factors", "mgsgraph.adjustment"),
    "matplotlib": ("mgsgraph.products",),
    "numba": (
        "mgsgraph.compiled", "mgsgraph.kernel", "mgsgraph.geometry", "mgsgraph.adjustment.graph",
        "mgsgraph.adjustment.sparse_cholesky", "mgsgraph.matching", "mgsgraph.products.dem",
    ),
    "llvmlite": ("mgsgraph.kernel.lanes",),
    "cv2": ("mgsgraph.matching",),
    "jinja2": ("mgsgraph.products",),
    "google": ("mgsgraph.io.control",),
    "click": ("mgsgraph.cli",),
    "tqdm": ("mgsgraph.cli",),
    "scipy": (
        "mgsgraph.adjustment.analysis", "mgsgraph.adjustment.datum", "mgsgraph.adjustment.graph.prior",
        "mgsgraph.adjustment.sparse_cholesky", "mgsgraph.geometry.track_terrain", "mgsgraph.matching",
    ),
    "shapely": ("mgsgraph.geometry", "mgsgraph.products.export"),
    "pyogrio": ("mgsgraph.products.export",),
    "spiceypy": ("mgsgraph.io", "mgsgraph.simulation", "mgsgraph.products"),
    "msgspec": ("mgsgraph.campaign", "mgsgraph.case", "mgsgraph.io.control", "mgsgraph.products", "mgsgraph.project"),
    "requests": ("mgsgraph.fetch",),
    "urllib3": ("mgsgraph.fetch",),
    "sqlite3": ("mgsgraph.project",),
    "dask": ("mgsgraph.adjustment.cluster",),
    "distributed": ("mgsgraph.adjustment.cluster",),
}


def modules() -> dict[str, Path]:
    found = {}
    for package, folder in FOLDERS.items():
        for path in folder.rglob("*.py"):
            parts = path.relative_to(folder).with_suffix("").parts
            found[".".join((package, *(part for part in parts if part != "__init__")))] = path
    return found


@cache
def imports(path: Path) -> set[str]:
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
    for height, rooms in enumerate(STOREYS):
        if any(name == room or name.startswith(room + ".") for room in rooms):
            return height
    return None


def test_every_package_on_disk_is_declared() -> None:
    on_disk = {name for name, path in modules().items() if path.name == "__init__.py"}
    assert on_disk == set(TABLE["tool"]["setuptools"]["packages"])


def test_no_top_level_factors(tmp_path: Path) -> None:
    code = "import importlib.util; print(importlib.util.find_spec('factors'))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=tmp_path)
    assert done.stdout.strip() == "None"


def test_every_import_goes_down() -> None:
    wrong = [
        f"{name} imports {target}"
        for name, path in modules().items()
        if name != "mgsgraph"
        for target in imports(path)
        if (here := storey(name)) is not None and (there := storey(target)) is not None and there < here
    ]
    assert not wrong


@pytest.mark.parametrize("library", ONLY_IN)
def test_libraries_stay_in_their_rooms(library: str) -> None:
    wrong = [
        name
        for name, path in modules().items()
        if any(target.split(".")[0] == library for target in imports(path))
        and not any(name == room or name.startswith(room + ".") for room in ONLY_IN[library])
    ]
    assert not wrong


def test_equations_and_kernel_stay_below_the_adjustment() -> None:
    """Equations serve geometry, kernel and adjustment; the kernel serves the adjustment alone, and factors know
    neither.
    """
    users = {
        "mgsgraph.factors": ("mgsgraph.factors", "mgsgraph.geometry", "mgsgraph.kernel", "mgsgraph.adjustment"),
        "mgsgraph.kernel": ("mgsgraph.kernel", "mgsgraph.adjustment"),
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


def test_help_imports_nothing_heavy() -> None:
    code = "import sys, mgsgraph.cli; print([m for m in ('numpy', 'numba', 'gtsam', 'matplotlib') if m in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_dask_is_imported_only_when_it_is_asked_for() -> None:
    code = (
        "import sys, mgsgraph.campaign, mgsgraph.campaign.report, mgsgraph.adjustment.cluster;"
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

"""Test the installed package: drop the checkout from sys.path (python -m pytest puts it there)."""

import gc
import os
import shutil
import sys
from collections.abc import Iterator
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import once
import pytest
from hypothesis import HealthCheck, settings
from outside import require, require_program

ROOT = Path(__file__).resolve().parents[1]
FLAGS = [
    "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run", "--disable-background-networking",
    "--disable-component-update", "--disable-sync", "--disable-dev-shm-usage",
]  # fmt: skip
PLAIN = (
    "simulation/test_site", "files/", "geometry/", "fetch/", "simulation/test_imagery", "simulation/test_terrain",
    "simulation/test_hrsc", "registration/test_relief", "test_package", "network/", "simulation/test_pair",
)  # fmt: skip
"""Tests that need no large kernel: they begin while the kernels are compiled."""
LONG = (
    "adjustment/", "matching/", "test_docs", "cli/", "results/", "scripts/", "registration/", "export/", "simulation/",
    "project/",
)  # fmt: skip
"""Those that take long, next, so that short files fill up what is left at the end."""
if ROOT not in [Path(one).resolve() for one in os.environ.get("PYTHONPATH", "").split(os.pathsep) if one]:
    sys.path[:] = [p for p in sys.path if Path(p or ".").resolve() != ROOT]  # the installed package is tested
if (PACKAGE := find_spec("mgsgraph")) is None or PACKAGE.origin is None:
    pytest.exit(f"mgsgraph is not installed: pip install -e {ROOT}", 2)
CHECKOUT = Path(PACKAGE.origin).resolve().parents[1]
if CHECKOUT != ROOT and (CHECKOUT / "pyproject.toml").exists():
    pytest.exit(f"mgsgraph is that of {CHECKOUT}, not of {ROOT}: pip install -e . here, or PYTHONPATH={ROOT}", 2)

gc.set_threshold(20_000, 20, 100)  # a twentieth of the run, else
# no clock, for machines are shared; the same examples each time (600 random ones passed)
settings.register_profile(
    "mgsgraph", deadline=None, suppress_health_check=[HealthCheck.too_slow], derandomize=True, max_examples=40
)
settings.load_profile("mgsgraph")


@pytest.hookimpl(tryfirst=True)
def pytest_cmdline_main(config: pytest.Config) -> None:
    """The whole suite is shared by a process per processor, file by file; not so a part of it, or with `-n 0`."""
    whole = config.args_source is pytest.Config.ArgsSource.TESTPATHS and not hasattr(config, "workerinput")
    shared = config.pluginmanager.hasplugin("xdist") and config.option.numprocesses is None
    if whole and shared and not config.option.collectonly:
        config.option.numprocesses, config.option.dist = "logical", "loadfile"
        config.option.loadscopereorder = False
        os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # else its threads wait for one another's processor
        os.environ.pop("PYTHONDONTWRITEBYTECODE", None)  # else each of many processes compiles all sources again
        once.share()
        once.compile_in_background()


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Tests in a browser are slow, and need it; `PLAIN` ones come first, then `LONG` ones, the rest as it is."""
    order = [f"tests/{start}" for start in (*PLAIN, *LONG)]

    def rank(item: pytest.Item) -> int:
        return next((k for k, start in enumerate(order) if item.nodeid.startswith(start)), len(order))

    for item in items:
        if "browser" in getattr(item, "fixturenames", ()):
            item.add_marker(pytest.mark.slow)
            item.add_marker(pytest.mark.program("chromium"))
    items.sort(key=rank)
    gc.freeze()  # items and libraries stay: no collection need look at them again


def pytest_runtest_setup(item: pytest.Item) -> None:
    """The programs are there that a test is marked with; all but the `PLAIN` tests wait for the kernels."""
    for marker in item.iter_markers("program"):
        require_program(*marker.args, **marker.kwargs)
    if not item.nodeid.startswith(tuple(f"tests/{start}" for start in PLAIN)):
        once.wait_for_kernels()


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """Folder of the real data sets."""
    return require(ROOT.parent / "shared" / "data", "the folder of real data")


@pytest.fixture(scope="session")
def shared_field() -> Path:
    """Folder of small inputs that failed, with their right values."""
    return require(ROOT.parent / "shared" / "field", "the folder of inputs from the field")


@pytest.fixture(scope="session")
def pair_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    from mgsgraph.simulation.files import write_pair
    from mgsgraph.simulation.pair import PairSettings, simulate_pair

    folder = tmp_path_factory.mktemp("pair")
    write_pair(simulate_pair(PairSettings(ties=20, shots=8), seed=1), folder)
    return folder


@pytest.fixture(scope="session")
def pair_case(pair_folder: Path) -> Any:
    """That case, read."""
    import mgsgraph

    return mgsgraph.read_case(pair_folder / "case.toml")


@pytest.fixture(scope="session")
def pair_solution(pair_case: Any) -> Any:
    """That case, adjusted."""
    import mgsgraph

    return mgsgraph.adjust(pair_case)


@pytest.fixture(scope="session")
def solved(pair_folder: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A solved project of that case; whoever changes it copies it."""
    from mgsgraph.cli import group

    project = str(tmp_path_factory.mktemp("solved") / "project")
    for words in (["init", project, "--case", str(pair_folder / "case.toml")], ["solve", project, "--no-figures"]):
        assert not group(["project", *words], standalone_mode=False)
    return Path(project)


@pytest.fixture
def case_file(pair_folder: Path, tmp_path: Path) -> Path:
    """A case of a small simulated pair, in a folder of the test's own."""
    folder = tmp_path / "case"
    shutil.copytree(pair_folder, folder)
    return folder / "case.toml"


@pytest.fixture
def pictured_case(case_file: Path) -> Path:
    """The same with pixels of noise."""
    import profiles

    return profiles.with_pixels(case_file)


@pytest.fixture
def light_figures(monkeypatch: pytest.MonkeyPatch) -> None:
    """Figures' PNG files stay empty: to draw them takes as long again as the SVG files, which show the same; pages have
    blank ones.
    """
    from mgsgraph.results.figures import page, sheet

    drawn = sheet.encoded
    monkeypatch.setattr(sheet, "encoded", lambda one, kind, **how: drawn(one, kind, **how) if kind != "png" else b"")
    monkeypatch.setattr(page, "encoded", lambda *_, **how: b"")


@pytest.fixture(scope="session")
def browser() -> Iterator[Any]:
    """Debian's Chromium, driven by Playwright; the tests are skipped where either is missing."""
    program = require_program("chromium")
    found = find_spec("playwright")
    require(Path((found and found.origin) or "playwright"), "the package playwright")
    from playwright.sync_api import sync_playwright

    with sync_playwright() as started:
        running = started.chromium.launch(executable_path=str(program), args=FLAGS)
        yield running
        running.close()


@pytest.fixture(scope="session")
def archive_server() -> Iterator[Any]:
    """Archives on localhost, which whoever asks resets."""
    import flaky_archive

    with flaky_archive.served() as server:
        yield server


@pytest.fixture
def archive(archive_server: Any) -> Any:
    """A few images made up in memory."""
    import flaky_archive

    return archive_server.reset(flaky_archive.archive_files())

"""Test the installed package: drop the checkout from sys.path (python -m pytest puts it there)."""

import shutil
import sys
from collections.abc import Iterator
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import pytest
from outside import require

ROOT = Path(__file__).resolve().parents[1]
CHROMIUM = Path("/usr/bin/chromium")
FLAGS = [
    "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run", "--disable-background-networking",
    "--disable-component-update", "--disable-sync", "--disable-dev-shm-usage",
]  # fmt: skip
sys.path[:] = [p for p in sys.path if Path(p or ".").resolve() != ROOT]


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """Folder of the real data sets."""
    return require(ROOT.parent / "shared" / "data", "the folder of real data")


@pytest.fixture(scope="session")
def _written_pair(tmp_path_factory: pytest.TempPathFactory) -> Path:
    from mgsgraph.simulation.files import write_pair
    from mgsgraph.simulation.pair import PairSettings, simulate_pair

    folder = tmp_path_factory.mktemp("pair")
    write_pair(simulate_pair(PairSettings(ties=20, shots=8), seed=1), folder)
    return folder


@pytest.fixture
def case_file(_written_pair: Path, tmp_path: Path) -> Path:
    """A case of a small simulated pair, in a folder of the test's own."""
    folder = tmp_path / "case"
    shutil.copytree(_written_pair, folder)
    return folder / "case.toml"


@pytest.fixture(scope="session")
def browser() -> Iterator[Any]:
    """Debian's Chromium, driven by Playwright; the tests are skipped where either is missing."""
    require(CHROMIUM, "Debian's chromium (apt-get install chromium)")
    found = find_spec("playwright")
    require(Path((found and found.origin) or "playwright"), "the package playwright")
    from playwright.sync_api import sync_playwright

    with sync_playwright() as started:
        running = started.chromium.launch(executable_path=str(CHROMIUM), args=FLAGS)
        yield running
        running.close()

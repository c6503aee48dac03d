"""Test the installed package: drop the checkout from sys.path (python -m pytest puts it there)."""

import shutil
import sys
from pathlib import Path

import pytest
from outside import require

ROOT = Path(__file__).resolve().parents[1]
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

"""The package imports where it is installed: inside a checkout, too, where the folder `mgsgraph` comes first."""

import os
import shutil
import subprocess
import sys
import sysconfig
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
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

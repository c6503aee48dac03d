"""What is compiled: equations that compiled code may call, and where compiled kernels are kept."""

import hashlib
import os
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

Equation = TypeVar("Equation", bound=Callable[..., Any])


def find_a_place_for_compiled_kernels(package: Path) -> None:
    """Let numba cache beside a checkout's sources, else in the user's cache, else in the temporary folder.

    Not in site-packages: there its files would outlive the package, and a folder `mgsgraph` without a package in it
    hides an editable installation's.

    Parameters
    ----------
    package : Path
        Folder of the package whose kernels are compiled. Called before numba is imported.
    """
    if "NUMBA_CACHE_DIR" in os.environ:
        return
    if "site-packages" not in package.parts and os.access(package, os.W_OK):
        return
    place = Path(tempfile.gettempdir()) / f"mgsgraph-kernels-{os.getuid()}"
    try:
        caches = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
        caches.mkdir(parents=True, exist_ok=True)
        if os.access(caches, os.W_OK):
            place = caches / "mgsgraph"
    except (OSError, RuntimeError):
        pass
    os.environ["NUMBA_CACHE_DIR"] = str(place)


_equations: list[Callable[..., Any]] = []
"""Those that compiled code doesn't know yet."""


def equation(function: Equation) -> Equation:
    """A measurement equation: a pure function of floats and tuples, which stays what it is for Python and NumPy arrays.

    Compiled code may call it once `make_equations_compilable` has been called; importing it does not import numba.
    """
    _equations.append(function)
    return function


def make_equations_compilable() -> None:
    """Let compiled code take all equations imported so far in as its own, without a call, so that loops over lanes
    become SIMD. Division by zero gives inf there, as in NumPy; products and sums may be fused.
    """
    from numba.extending import register_jitable

    compilable = register_jitable(forceinline=True, fastmath={"contract", "nsz"}, error_model="numpy")
    while _equations:
        compilable(_equations.pop())


def digest_of(*folders: Path) -> str:
    """Digest of the sources in folders.

    Numba's cache looks at one file alone: a kept function that holds the digest of all that it is compiled from, as a
    variable of an enclosing function, is forgotten when any of that changes.
    """
    digest = hashlib.sha256()
    for folder in folders:
        for path in sorted(folder.glob("*.py")):
            digest.update(path.read_bytes())
    return digest.hexdigest()


find_a_place_for_compiled_kernels(Path(__file__).parent)  # before whoever compiles imports numba

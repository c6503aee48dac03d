"""Where compiled kernels are kept: one place for all packages that have some."""

import os
import tempfile
from pathlib import Path


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

"""The measurement equations as GTSAM factors: one numeric kernel, explicit factors, bundle factors.

Installed as `mgsgraph.factors`; nothing named `factors` is ever installed at the top level.
"""

import os
import tempfile
from pathlib import Path


def _find_a_place_for_compiled_kernels() -> None:
    """Let numba cache in the temporary folder where neither the package nor the user's cache can be written."""
    if "NUMBA_CACHE_DIR" in os.environ or os.access(Path(__file__).parent, os.W_OK):
        return
    try:
        caches = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
        caches.mkdir(parents=True, exist_ok=True)
        usable = os.access(caches, os.W_OK)
    except (OSError, RuntimeError):
        usable = False
    if not usable:
        os.environ["NUMBA_CACHE_DIR"] = str(Path(tempfile.gettempdir()) / f"mgsgraph-kernels-{os.getuid()}")


_find_a_place_for_compiled_kernels()

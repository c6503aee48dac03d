"""The measurement equations as GTSAM factors: one numeric kernel, explicit factors, bundle factors.

Installed as `mgsgraph.factors`; nothing named `factors` is ever installed at the top level.
"""

from pathlib import Path

from mgsgraph.compiled import find_a_place_for_compiled_kernels as _find_a_place_for_compiled_kernels

_find_a_place_for_compiled_kernels(Path(__file__).parent)

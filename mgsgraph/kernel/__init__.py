"""The equations of `mgsgraph.factors` over all points at once: lanes on the CPU, points solved and eliminated."""

from pathlib import Path

from mgsgraph.compiled import find_a_place_for_compiled_kernels as _find_a_place_for_compiled_kernels

_find_a_place_for_compiled_kernels(Path(__file__).parent)

"""The equations of `mgsgraph.factors` over all points at once: lanes on the CPU, points solved and eliminated."""

"""The measurement equations: one measurement, one file; pure functions, and the GTSAM factor made of them.

Installed as `mgsgraph.factors`; nothing named `factors` is ever installed at the top level. What runs them over all
points of a network is `mgsgraph.kernel`.
"""

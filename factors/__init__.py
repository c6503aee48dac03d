"""The measurement equations as GTSAM factors: one numeric kernel, explicit factors, bundle factors.

Installed as `mgsgraph.factors`; nothing named `factors` is ever installed at the top level.
"""

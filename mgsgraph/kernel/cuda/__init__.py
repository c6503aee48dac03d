"""The kernel on a GPU: the equations of `factors`, one thread a point or an observation; float64 throughout.

A sweep is a chain of launches over a partition's points: `solving` (a thread a point: the inner solve), `coupling`
(a thread an observation: its rows by the unknowns, and what couples them to the point; then a block of threads a pair
of observations of a piece: products summed over points), and `covariance` with reliability. `tables` lays a
partition out, `device` says how functions are compiled, `partition` holds arrays and launches.
"""

"""Numerics of bodies, trajectories, cameras and images: arrays in, arrays and Jacobians out.

SI units and body-fixed metres throughout; no files, no SPICE, no GTSAM.
Lines and samples are continuous with the centre of the first pixel at (0.5, 0.5) and its corner at (0, 0), as in CSM;
ISIS counts the same centre (1, 1): `mgsgraph.files` subtracts the half pixel, nothing else does.
"""

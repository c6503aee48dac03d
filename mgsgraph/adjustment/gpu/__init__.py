"""Sweeps, and the elimination of the reduced equations, on a GPU: which device, what it holds, and who uses it."""

"""Incremental adjustment: images are added to, and taken from, what has been adjusted before."""

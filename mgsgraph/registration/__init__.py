"""Laser footprints in images: where they fall, how much images contradict each other at them, and the result files."""

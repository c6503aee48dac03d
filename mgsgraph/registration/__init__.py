"""Laser footprints in images: where they fall, how much images contradict one another there, and the files about it."""

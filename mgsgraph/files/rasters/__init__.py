"""Raster files: pixels of images, terrain models, map projections and coordinate systems."""

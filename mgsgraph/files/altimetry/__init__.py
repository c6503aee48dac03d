"""Laser altimetry: shots of altimeters' archives by whatever file they come in, and clouds of their ground returns."""

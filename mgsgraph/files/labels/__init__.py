"""Images by their labels: PDS3, ISIS cubes with their tables, and SPICE kernels."""

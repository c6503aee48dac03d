"""SPICE kernels: what they hold, and records read from them."""

"""Spacing of orientation images: what the rays support, what rays held out say, and what vibrates."""

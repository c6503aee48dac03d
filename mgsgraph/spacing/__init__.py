"""How close orientation images should stand: what the rays support, what rays held out say, and what vibrates."""

"""Made-up observations with known truth, written through the formats of real ones: the demo's default input."""

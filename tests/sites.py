"""Simulated study sites without pictures, each made once in a run."""

from typing import Literal

from once import once

from mgsgraph.simulation.site import SimulatedSite, SimulationOptions, simulate_site

PLAIN = SimulationOptions(pictures=False)


@once
def plain_site(
    name: str = "gusev", seed: int = 1, errors: Literal["drawn", "published"] = PLAIN.errors
) -> SimulatedSite:
    """Geometry alone: its pictures are of one grey."""
    return simulate_site(name, seed, SimulationOptions(errors, pictures=False))

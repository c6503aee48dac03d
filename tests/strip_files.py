"""A small simulated block of HRSC as files: support data, a control network, and a case with [[passes]]."""

from functools import cache
from pathlib import Path

import numpy as np

from mgsgraph.files.networks.tie_points import TiePoints
from mgsgraph.simulation.case_files import json_text, support_data, tie_network_text
from mgsgraph.simulation.hrsc_block import BlockSettings, SimulatedBlock, simulate_hrsc_block
from mgsgraph.simulation.hrsc_flight import Readout

STRIPS = """
[[passes]]
name = "HRSC/00"
images = ["HRSC/00/S1", "HRSC/00/P1", "HRSC/00/ND", "HRSC/00/P2", "HRSC/00/S2"]
prior = {}

[[passes]]
name = "HRSC/01"
nodes = { spacing_s = 10.0 }
prior = { correlation_time_s = 60.0 }
"""
"""Five images by name, the others as what is left; all that is said or left out is what the block was drawn with."""


@cache
def block() -> SimulatedBlock:
    """Two strips of 60 km, three line rates, 150 points."""
    settings = BlockSettings(strips=2, length=60e3, points=150, readout=Readout(rates=3), terrain=None)
    return simulate_hrsc_block(settings, seed=4)


def write_block(folder: Path, strips: str = STRIPS, more: str = "") -> Path:
    """The case file of the block; `more` stands before its tables."""
    network = block().network
    names = [image.name for image in network.images]
    rays, points = network.rays, network.points
    ties = TiePoints(
        "block", points.ids, points.kinds, points.places, points.covariances, rays.point,
        tuple(names[j] for j in rays.image.tolist()), rays.places, np.asarray(rays.sigmas),
    )  # fmt: skip
    (folder / "network.pvl").write_text(tie_network_text(ties))
    text = ["format = 1", 'name = "block"', more, "[ties]", 'network = "network.pvl"']
    for image in network.images:
        file = f"{image.name.replace('/', '_')}.isd"
        (folder / file).write_text(json_text(support_data(image)))
        text += ["[[images]]", f'name = "{image.name}"', f'isd = "{file}"']
    path = folder / "case.toml"
    path.write_text("\n".join([*text, strips]), encoding="utf-8")
    return path

"""Networks with [[passes]] as files, support data, a control network and a case; a small simulated block of HRSC."""

from collections.abc import Sequence
from functools import cache
from pathlib import Path

import numpy as np
from mex_block import BlockSettings, SimulatedBlock, simulate_hrsc_block
from mex_flight import Readout

from mgsgraph.files.networks.tie_points import TiePoints
from mgsgraph.geometry.image import PushbroomImage
from mgsgraph.network import Network
from mgsgraph.simulation.case_files import json_text, support_data, tie_network_text

PASSES = """
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
    """Two passes of 60 km, three line rates, 150 points."""
    settings = BlockSettings(passes=2, length=60e3, points=150, readout=Readout(rates=3), terrain=None)
    return simulate_hrsc_block(settings, seed=4)


def write_block(folder: Path, passes: str = PASSES) -> Path:
    """The case file of the block."""
    return write_network(folder, block().network, passes)


def write_network(folder: Path, network: Network, tables: str, images: Sequence[PushbroomImage] = ()) -> Path:
    """The case file of a network with some tables, and what it names; `images` are in place of its own."""
    images = images or network.images
    rays, points = network.rays, network.points
    names = network.image_names
    sizes = np.array([[image.lines, image.samples] for image in network.images])[rays.image]
    inside = np.all((rays.places > 0.0) & (rays.places < sizes), axis=1)  # the noise of others put them outside
    ties = TiePoints(
        "ties", points.ids, points.kinds, points.places, points.covariances, rays.point[inside],
        tuple(names[j] for j in rays.image[inside].tolist()), rays.places[inside], np.asarray(rays.sigmas)[inside],
    )  # fmt: skip
    (folder / "network.pvl").write_text(tie_network_text(ties))
    text = ["format = 1", 'name = "passes"', "", "[ties]", 'network = "network.pvl"']
    for image in images:
        file = f"{image.name.replace('/', '_')}.isd"
        (folder / file).write_text(json_text(support_data(image)))
        text += ["[[images]]", f'name = "{image.name}"', f'isd = "{file}"']
    path = folder / "case.toml"
    path.write_text("\n".join([*text, tables]), encoding="utf-8")
    return path

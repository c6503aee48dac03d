"""A rig as files: support data of L, R and another image, a control network, and a case with [[passes]]."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from rigs import rig

from mgsgraph.files.networks.tie_points import TiePoints
from mgsgraph.geometry.image import PushbroomImage
from mgsgraph.simulation.case_files import json_text, support_data, tie_network_text

PASS = """
[[passes]]
name = "one"
images = ["L", "R"]
"""


def write_rig(folder: Path, tables: str = PASS, more: str = "", images: Sequence[PushbroomImage] = ()) -> Path:
    """The case file of the rig with some tables; `more` stands before them, `images` are in place of its own."""
    network = rig()
    images = images or network.images
    rays, points = network.rays, network.points
    names = [image.name for image in network.images]
    sizes = np.array([[image.lines, image.samples] for image in network.images])[rays.image]
    inside = np.all((rays.places > 0.0) & (rays.places < sizes), axis=1)  # the noise of others put them outside
    ties = TiePoints(
        "rig", points.ids, points.kinds, points.places, points.covariances, rays.point[inside],
        tuple(names[j] for j in rays.image[inside].tolist()), rays.places[inside], rays.sigmas[inside],
    )  # fmt: skip
    (folder / "network.pvl").write_text(tie_network_text(ties))
    text = ["format = 1", 'name = "rig"', more, "[ties]", 'network = "network.pvl"']
    for image in images:
        (folder / f"{image.name}.isd").write_text(json_text(support_data(image)))
        text += ["[[images]]", f'name = "{image.name}"', f'isd = "{image.name}.isd"']
    path = folder / "case.toml"
    path.write_text("\n".join([*text, tables]), encoding="utf-8")
    return path


def later(image: PushbroomImage, name: str, seconds: float) -> PushbroomImage:
    """The same image taken from the same places as many seconds later."""
    return replace(image, name=name, trajectory=replace(image.trajectory, epoch=image.trajectory.epoch + seconds))

"""A rig: two cameras of one spacecraft, turned against each other as NAC-L and NAC-R are, and a third image."""

from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
from networks import network, pair
from pass_files import write_network

from mgsgraph.adjustment.adjust import adjust_network
from mgsgraph.adjustment.settings import SolverSettings
from mgsgraph.adjustment.solution import Solution
from mgsgraph.geometry import rotation
from mgsgraph.geometry.image import PushbroomImage
from mgsgraph.geometry.orientation import OrientationCorrection, evenly_spaced
from mgsgraph.geometry.records import Array
from mgsgraph.geometry.trajectory import Trajectory
from mgsgraph.network import ImageRays, Network, NodePrior, Pass, SharedKind, SharedUnknown
from mgsgraph.network.joining import mountings

PRIOR = NodePrior(np.array([20.0] * 3 + [1e-4] * 3), np.array([200.0] * 3 + [4e-4] * 3), np.zeros(6), 4.0)
TURN = rotation.exponential(np.array([[5e-4, 1e-3, 0.0]]))[0] @ rotation.exponential(np.array([[0.0, 0.0, 3.1]]))[0]
"""From the axes of the one camera to those of the other."""
PASS = """
[[passes]]
name = "one"
images = ["L", "R"]
"""
BORESIGHT = SharedUnknown("boresight of R", SharedKind.CAMERA_BORESIGHT, np.array([1]), np.full(3, 3e-4))


def mounted(image: PushbroomImage, name: str, axes: Array) -> PushbroomImage:
    """The image that a camera takes at the same time whose axes are turned by `axes` (3, 3)."""
    trajectory = image.trajectory
    assert isinstance(trajectory, Trajectory)
    camera = replace(trajectory.camera, constant=axes @ trajectory.camera.constant)
    return replace(image, name=name, trajectory=replace(trajectory, camera=camera))


@cache
def rig(ties: int = 60, shots: int = 12, boresight: bool = True, seed: int = 1) -> Network:
    """L and R are one pass; R sees the points of L where the same trajectory has them, with its noise."""
    drawn = pair(ties=ties, shots=shots, seed=seed)
    net, true = network(drawn), drawn.true_corrections[0]
    left, other = replace(net.images[0], name="L"), replace(net.images[1], name="other")
    right = mounted(left, "R", TURN)
    turned = true.coefficients.copy()
    turned[:, 3:] = turned[:, 3:] @ TURN.T
    places = np.concatenate([drawn.true_ties, drawn.true_footprints])
    seen, _ = right.ground_to_image(places, OrientationCorrection(turned))
    inside = np.flatnonzero(np.all((seen > 0.0) & (seen < [right.lines, right.samples]), axis=1))
    measured = seen[inside] + drawn.settings.noise.tie * np.random.default_rng(seed).standard_normal((inside.size, 2))
    rays = ImageRays(
        np.concatenate([net.rays.point, inside]),
        np.concatenate([2 * net.rays.image, np.ones(inside.size, dtype=int)]),
        np.concatenate([net.rays.places, measured]),
        np.concatenate([net.rays.sigmas, np.full((inside.size, 2), drawn.settings.noise.tie)]),
    )
    epoch, (start, stop) = left.trajectory.epoch, left.timing.at(np.array([0.0, float(left.lines)]))[0]
    nodes = evenly_spaced("lagrange", epoch, (start, stop), (stop - start) / 5)
    both = Pass("one pass", np.array([0, 1]), nodes, PRIOR, mountings([left, right], "rig"))
    return replace(
        net, images=(left, right, other), priors=(net.priors[0], net.priors[0], net.priors[1]),
        held=np.zeros(3, dtype=bool), rays=rays, passes=(both,), shared=(BORESIGHT,) if boresight else (),
    )  # fmt: skip


@cache
def adjusted_rig(seed: int = 1) -> Solution:
    """The rig, adjusted."""
    return adjust_network(rig(seed=seed), SolverSettings())


def write_rig(folder: Path, tables: str = PASS, images: Sequence[PushbroomImage] = ()) -> Path:
    """The case file of the rig with some tables; `images` are in place of its own."""
    return write_network(folder, rig(), tables, images)


def later(image: PushbroomImage, name: str, seconds: float) -> PushbroomImage:
    """The same image taken from the same places as many seconds later."""
    return replace(image, name=name, trajectory=replace(image.trajectory, epoch=image.trajectory.epoch + seconds))

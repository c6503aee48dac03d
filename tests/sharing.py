"""Networks whose images share unknowns, of instruments that truly are so."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cache

import numpy as np

from mgsgraph.geometry.orientation import Sine
from mgsgraph.network import Network, PointClass, ProfileShifts, SharedKind, SharedUnknown
from mgsgraph.simulation.camera import InstrumentErrors
from mgsgraph.simulation.observations import NoiseSettings
from mgsgraph.simulation.pair import PairSettings, SimulatedPair, simulate_pair
from mgsgraph.units import ARCMIN, DEG

LOOSE = NoiseSettings(position=100.0, angle=ARCMIN)
"""What is known of MGS: its attitude times 380 km is as uncertain as its place."""
SIGMAS: Mapping[SharedKind, float] = {
    SharedKind.ATTITUDE_TIME: 0.05,
    SharedKind.POSITION_TIME: 0.01,
    SharedKind.CAMERA_BORESIGHT: 1e-4,
    SharedKind.ALTIMETER_BORESIGHT: 1e-4,
    SharedKind.RANGE_BIAS: 5.0,
    SharedKind.FOCAL_LENGTH: 0.01,
    SharedKind.PRINCIPAL_POINT: 2e-4,
    SharedKind.RADIAL_DISTORTION_1: 2e-5,
    SharedKind.RADIAL_DISTORTION_2: 2e-5,
    SharedKind.RADIAL_DISTORTION_3: 2e-5,
    SharedKind.ORBIT_POSITION: 30.0,
    SharedKind.LINE_RATE: 1e-4,
    SharedKind.CAMERA_LEVER_ARM: 5.0,
    SharedKind.ALTIMETER_LEVER_ARM: 5.0,
    SharedKind.PROFILE_HEIGHT: 10.0,
    SharedKind.PROFILE_DRIFT: 20.0,
    SharedKind.VIBRATION: 1e-5,
}
"""s, rad, m and 1."""
SINE = Sine(0.5, -11_000_000.0, 4.0)
"""Of a vibration of the first image of `pair`, whose time it is."""


def shared(kind: SharedKind, images: Sequence[int], sigma: float | None = None) -> SharedUnknown:
    """An unknown called by its kind; a profile's height is that of `with_all_kinds`."""
    of_profile = kind.of_profile
    vibrates = kind is SharedKind.VIBRATION
    members = np.array([] if of_profile else images[:1] if vibrates else images, dtype=int)
    sigmas = np.full(kind.width, sigma or SIGMAS[kind])
    return SharedUnknown(str(kind), kind, members, sigmas, "profile" if of_profile else "", SINE if vibrates else None)


def with_all_kinds(net: Network) -> Network:
    """The same with an unknown of each kind, shared by all images that have rows of it."""
    owners = np.unique(net.ranges.image).tolist()
    every = list(range(len(net.images)))
    if net.shifts is None:
        laser = net.points.classes == PointClass.LASER
        net = replace(net, shifts=ProfileShifts(("profile",), np.where(laser, 0, -1), np.array([100.0])))
    return replace(net, shared=tuple(shared(kind, owners if kind.of_laser else every) for kind in SharedKind))


@cache
def drawn(seed: int, bias: float = 0.5, off_nadir: float = 20.0 * DEG) -> SimulatedPair:
    """A nadir image and a held one with loose priors, their camera's attitude `bias` s late."""
    settings = PairSettings(lines=8000, ties=40, shots=20, off_nadir=off_nadir, noise=LOOSE)
    return simulate_pair(settings, seed, InstrumentErrors(attitude_time=bias))


def camera_clock(net: Network, sigma: float = 1.0) -> Network:
    """The same with an attitude-time bias of all images."""
    return replace(net, shared=(shared(SharedKind.ATTITUDE_TIME, range(len(net.images)), sigma),))

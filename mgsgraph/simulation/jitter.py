"""True orientation of cameras that jitter: a vibration, a slow drift and a constant error, of which no table knows.

Each image has a vibration of one frequency in pitch and in roll, whose phases are drawn, and a slow drift of half a
wave over the image, whose phase is drawn, too. Amplitudes are in pixels: what the image of a point moves along lines
(pitch) or samples (roll). To these come a constant error of the attitude and of the position.
"""

from dataclasses import dataclass

import numpy as np

from mgsgraph.geometry.orientation import OrientationCorrection
from mgsgraph.geometry.orientation_images import evenly_spaced
from mgsgraph.geometry.records import Array
from mgsgraph.simulation.strip_truth import strip_correction

_NODES_PER_WAVE = 24
"""True nodes in a period; Lagrange's polynomials then follow a sine to 0.02 % of its amplitude."""


@dataclass(frozen=True, slots=True)
class JitterSettings:
    """What a camera's attitude does that its tables don't have; amplitudes in pixels."""

    pitch: float = 0.5
    """px, amplitude of the vibration about the camera's y: along lines."""
    roll: float = 0.5
    """px, amplitude of the vibration about the camera's x: along samples."""
    frequency: float = 2.0
    """Hz, of both."""
    drift: float = 3.0
    """px, amplitude of the slow drift of pitch and of roll."""
    angle: float = 1e-4
    """rad, sigma of the constant error about each axis."""
    position: float = 10.0
    """m, sigma of the constant error of the position, along X, Y, Z."""


@dataclass(frozen=True, slots=True, eq=False)
class TrueJitter:
    """True orientation of one image = nominal (+) `correction`."""

    correction: OrientationCorrection
    """Of all: constant, drift and vibration; nodes over the image's time, about the camera's axes."""
    phasors: Array
    """(2, 2) rad, of pitch and of roll the vibration's cosine and sine amounts, t from the nodes' epoch."""
    frequency: float
    """Hz."""


def drawn_jitter(
    settings: JitterSettings, epoch: float, coverage: tuple[float, float], pixel: float, rng: np.random.Generator
) -> TrueJitter:
    """The truth of one image.

    Parameters
    ----------
    settings : JitterSettings
        Sizes.
    epoch, coverage : float, (float, float)
        s TDB past J2000, and first and last time, s past it, of the image's lines.
    pixel : float
        rad, by which the view of one pixel differs from that of the next, along and across.
    rng : numpy.random.Generator
        Of phases and constant errors.
    """
    nodes = evenly_spaced("lagrange", epoch, coverage, 1.0 / (_NODES_PER_WAVE * settings.frequency))
    duration = coverage[1] - coverage[0]
    phases, slow = rng.uniform(0.0, 2.0 * np.pi, (2, 2))
    wave = 2.0 * np.pi * settings.frequency * nodes.times
    along = np.pi * (nodes.times - coverage[0]) / duration
    values = np.zeros((len(nodes), 6))
    values[:, :3] = settings.position * rng.standard_normal(3)
    values[:, 3:] = settings.angle * rng.standard_normal(3)
    phasors = np.zeros((2, 2))
    for k, (axis, amplitude) in enumerate(((4, settings.pitch), (3, settings.roll))):
        phasors[k] = pixel * amplitude * np.array([np.sin(phases[k]), np.cos(phases[k])])
        values[:, axis] += pixel * settings.drift * np.cos(along + slow[k])
        values[:, axis] += phasors[k, 0] * np.cos(wave) + phasors[k, 1] * np.sin(wave)
    return TrueJitter(strip_correction(nodes, values), phasors, settings.frequency)

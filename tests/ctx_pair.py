"""A stereo pair as MRO's Context Camera takes it, with jitter that no table knows: for jitter studies.

CTX: focal length 352.9 mm and pixels of 7 um (mro_ctx_v11.ti), lines of 1.877 ms, 6 m on the ground from 300 km. One
image looks to the nadir, the other one, from another orbit, aside by a roll (`across`, as CTX takes stereo) or ahead
along the track (`along`, as MOC did); both turn with the orbit. The TRUE orientation is the nominal one (+)
`TrueJitter`; ties are true image points plus noise. A coarse terrain model, off in the plane as a whole and with noise
of each post, may serve as control.

What an adjustment can see of jitter is a matter of this geometry: along the epipolar line (across the track where the
other image looks aside, along it where it looks ahead) jitter of either image is a height; only at right angles to it
do the two images contradict each other. And there they show the difference of the two, never either by itself.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from block_ground import TerrainErrors, terrain_model, tie_network
from mex_flight import pass_correction
from nac_pair import MountedCamera

from mgsgraph.errors import InputError
from mgsgraph.geometry.image import PushbroomImage
from mgsgraph.geometry.orientation import OrientationCorrection, evenly_spaced
from mgsgraph.geometry.records import Array
from mgsgraph.network import ImageRays, Network, Pass, Process, ProcessPrior
from mgsgraph.simulation.camera import interior_orientation
from mgsgraph.simulation.ground import SiteTerrain, make_terrain
from mgsgraph.simulation.observations import MARGIN, project
from mgsgraph.simulation.orbit import GRAVITY, HEADING, MARS, CentralBody, CircularPass, body_matrix
from mgsgraph.units import DEG, MM

Look = Literal["across", "along"]
"""Where the second image looks from nadir: aside by a roll, or ahead along the track."""
CONTROL = TerrainErrors(posts_per_degree=128, planimetric=100.0)
"""A coarse terrain model: posts 463 m apart, as MOLA's grid."""
_FOCAL_LENGTH, _PITCH, _PERIOD = 352.9271664 * MM, 7e-6, 1.877e-3
"""m, m, and s per line (mro_ctx_v11.ti)."""
PIXEL = _PITCH / _FOCAL_LENGTH
"""rad, of a pixel: 19.8 microradian."""
_ALTITUDE, _ANGLE = 300e3, 22.0 * DEG
"""m, of the orbit above the site; rad, by how much the second image looks aside or ahead, at the spacecraft."""
_NOISE = 0.2
"""px, line and sample of a measure."""
_SPACING = 2.0
"""s between the network's nodes, at most: through nine Lagrange's polynomials follow half a cosine to a thousandth."""
_SMOOTH = float(np.sqrt(5.0 / 3.0) / np.pi)
"""Of the images' duration, the correlation time of a Matern process that begins as the cosine's covariance does."""
_NODES_PER_WAVE = 24
"""True nodes in a period: Lagrange's polynomials then follow a sine to 0.02 % of its size."""
_EPOCHS = (300_000_000.0, 302_400_000.0)
"""s TDB past J2000 of the images' middles; whole numbers, so that table times are exact in files."""
_MARS = CentralBody(MARS, GRAVITY, body_matrix)
_ROUNDS = 8
"""Of drawing ties, before images count as sharing too little ground."""


@dataclass(frozen=True, slots=True)
class JitterSettings:
    """Motion of a camera's attitude that its tables lack; amplitudes in pixels."""

    pitch: float = 0.5
    """px, amplitude of the vibration about the camera's y: along lines."""
    roll: float = 0.5
    """px, amplitude of the vibration about the camera's x: along samples."""
    frequency: float = 2.0
    """Hz, of both."""
    same_motion: bool = False
    """Whether both images vibrate with the same phases, counted from their middles."""
    drift: float = 3.0
    """px, amplitude of the slow drift of pitch and of roll."""
    angle: float = 1e-4
    """rad, sigma of the constant error about each axis."""
    position: float = 10.0
    """m, sigma of the constant error of the position, along X, Y, Z."""

    def prior(self, duration: float) -> ProcessPrior:
        """What is known of the slow part alone, over a duration in s: sigmas of the constant errors, and a process as
        strong and, at short times, as smooth as the drift, half a cosine of any phase.
        """
        slow = np.array([max(self.drift * PIXEL / np.sqrt(2.0), 1e-9)] * 2 + [1e-8])
        process = Process("matern-5/2", slow, _SMOOTH * duration)
        return ProcessPrior((), (process,), np.array([self.position] * 3 + [self.angle] * 3), np.zeros(6))


@dataclass(frozen=True, slots=True, eq=False)
class TrueJitter:
    """True orientation of one image = nominal (+) `correction`."""

    correction: OrientationCorrection
    """Of all: constant, drift and vibration; nodes over the image's time, about the camera's axes."""
    phasors: Array
    """(2, 2) rad, of pitch and of roll the vibration's cosine and sine amounts, t from the nodes' epoch."""


def _drawn_jitter(
    settings: JitterSettings, image: PushbroomImage, rng: np.random.Generator, common: np.random.Generator
) -> TrueJitter:
    """The truth of one image; `rng` draws phases and constant errors, `common` phases of images that move the same."""
    coverage = image_times(image)
    nodes = evenly_spaced("lagrange", image.trajectory.epoch, coverage, 1.0 / (_NODES_PER_WAVE * settings.frequency))
    phases, slow = rng.uniform(0.0, 2.0 * np.pi, (2, 2))
    if settings.same_motion:
        phases = common.uniform(0.0, 2.0 * np.pi, 2)
    wave = 2.0 * np.pi * settings.frequency * nodes.times
    along = np.pi * (nodes.times - coverage[0]) / (coverage[1] - coverage[0])
    values = np.zeros((len(nodes), 6))
    values[:, :3] = settings.position * rng.standard_normal(3)
    values[:, 3:] = settings.angle * rng.standard_normal(3)
    phasors = np.zeros((2, 2))
    for k, (axis, amplitude) in enumerate(((4, settings.pitch), (3, settings.roll))):
        phasors[k] = PIXEL * amplitude * np.array([np.sin(phases[k]), np.cos(phases[k])])
        values[:, axis] += PIXEL * settings.drift * np.cos(along + slow[k])
        values[:, axis] += phasors[k, 0] * np.cos(wave) + phasors[k, 1] * np.sin(wave)
    return TrueJitter(pass_correction(nodes, values), phasors)


@dataclass(frozen=True, slots=True, kw_only=True)
class CtxSettings:
    """What pair to simulate."""

    look: Look = "across"
    """Where the second image looks."""
    ties: int = 2500
    """Number of tie points."""
    lines: int = 8500
    """Of each image: 16 s."""
    samples: int = 1200
    """Of each image: a part of CTX's 5000."""
    jitter: JitterSettings = field(default_factory=JitterSettings)
    """What the tables lack."""
    control: TerrainErrors | None = CONTROL
    """The terrain model; None for none."""


@dataclass(frozen=True, slots=True, eq=False)
class SimulatedCtxPair:
    """A simulated pair: what an adjustment is given, and the truth it should find."""

    network: Network
    """Two passes of one image each, whose nodes have a prior of a constant and a linear error."""
    truth: tuple[TrueJitter, ...]
    """Of each image."""
    shifts: Array
    """(1, 2) m east and north, by which the terrain model lies off the truth; (0, 2) without one."""
    true_points: Array
    """(n, 3) m, body-fixed, of the network's points."""
    terrain: SiteTerrain
    """True ground."""


def simulate_ctx_pair(
    settings: CtxSettings | None = None, seed: int = 1, truth: Sequence[TrueJitter] | None = None
) -> SimulatedCtxPair:
    """Simulate a pair; the same settings and seed give the same pair.

    Parameters
    ----------
    settings : CtxSettings, optional
        The default pair when absent.
    seed : int
        zero or positive; jitter, ties and terrain model are drawn from streams of their own.
    truth : sequence of 2, optional
        What the attitudes of both images do; drawn as `settings.jitter` has it when absent.

    Raises
    ------
    InputError
        Where the images do not share enough ground for the ties asked for.
    """
    settings = settings or CtxSettings()
    of_jitter, of_ties, of_terrain = np.random.default_rng([seed, 17]).spawn(3)
    terrain = make_terrain("gusev", 1)
    images = _ctx_images(settings, terrain)
    drawn = zip(images, of_jitter.spawn(2), strict=True)
    truth = tuple(
        truth
        or (_drawn_jitter(settings.jitter, image, rng, np.random.default_rng([seed, 18])) for image, rng in drawn)
    )
    points, pixels = _drawn_ties(settings, images, [jitter.correction for jitter in truth], terrain, of_ties)
    exact, image = pixels.reshape(-1, 2), np.tile(np.arange(2), len(points))
    measures = exact + _NOISE * of_ties.standard_normal(exact.shape)
    rays = ImageRays(np.repeat(np.arange(len(points)), 2), image, measures, np.full(exact.shape, _NOISE))
    surface, common, shifts = terrain_model(settings.control, terrain, points, of_terrain)
    passes = [
        Pass(image.name, np.array([k]), evenly_spaced("lagrange", image.trajectory.epoch, image_times(image), _SPACING),
             settings.jitter.prior(float(np.ptp(image_times(image)))))
        for k, image in enumerate(images)
    ]  # fmt: skip
    network = tie_network(images, passes, rays, len(points), surface, common)
    return SimulatedCtxPair(network, truth, shifts, points, terrain)


def image_times(image: PushbroomImage) -> tuple[float, float]:
    """First and last time of an image's lines, s past its trajectory's epoch."""
    first, last = image.timing.at(np.array([0.0, float(image.lines)]))[0]
    return float(first), float(last)


def _ctx_images(settings: CtxSettings, terrain: SiteTerrain) -> tuple[PushbroomImage, ...]:
    """The nominal images, nadir one first; the middles of both see the middle of the site."""
    site = terrain.on_ground(np.array([terrain.centre_lon]), np.array([terrain.centre_lat]))[0]
    interior = interior_orientation(_FOCAL_LENGTH, _PITCH, 0.5 * settings.samples)
    camera = MountedCamera("CTX", interior, settings.samples, np.eye(3))
    return tuple(
        camera.image(
            name, CircularPass(epoch, site, HEADING, _ALTITUDE, angle, _MARS, settings.look == "along", turning=True),
            settings.lines, _PERIOD,
        )
        for name, epoch, angle in (("CTX/A", _EPOCHS[0], 0.0), ("CTX/B", _EPOCHS[1], _ANGLE))
    )  # fmt: skip


def _drawn_ties(
    settings: CtxSettings, images: Sequence[PushbroomImage], true: Sequence[OrientationCorrection],
    terrain: SiteTerrain, rng: np.random.Generator,
) -> tuple[Array, Array]:  # fmt: skip
    """Points (n, 3) in m of the ground that both images show, and their true pixels (n, 2, 2)."""
    ground, places, count, wanted = list[Array](), list[Array](), 0, settings.ties
    for _ in range(_ROUNDS):
        drawn = rng.uniform(MARGIN, np.array([settings.lines, settings.samples]) - MARGIN, (wanted, 2))
        points = terrain.intersect(*images[0].sightlines(drawn[:, 0], drawn[:, 1], true[0]))
        pixels, visible = project(images, true, points)
        ground.append(points[visible])
        places.append(pixels[visible])
        count += int(visible.sum())
        if count >= wanted:
            return np.concatenate(ground)[:wanted], np.concatenate(places)[:wanted]
    raise InputError("simulated CTX pair", f"images that share ground for {count} of {wanted} tie points")

"""A stereo pair as MRO's Context Camera takes it, with jitter that no table knows: for jitter studies.

CTX: focal length 352.9 mm and pixels of 7 um (mro_ctx_v11.ti), lines of 1.877 ms, 6 m on the ground from 300 km. One
image looks to the nadir, the other one, from another orbit, aside by a roll (`across`, as CTX takes stereo) or ahead
along the track (`along`, as MOC did); both turn with the orbit. The TRUE orientation is the nominal one (+)
`simulation.ctx`; ties are true image points plus noise that neighbours have partly in common. A coarse terrain
model, off in the plane as a whole and with noise of each post, may serve as control.

What an adjustment can see of jitter is a matter of this geometry: along the epipolar line (across the track where the
other image looks aside, along it where it looks ahead) jitter of either image is a height; only at right angles to it
do the two images contradict each other. And there they show the difference of the two, never either by itself.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from mgsgraph.errors import InputError
from mgsgraph.geometry.image import PushbroomImage
from mgsgraph.geometry.orientation import Basis, OrientationCorrection, evenly_spaced
from mgsgraph.geometry.records import Array, Index
from mgsgraph.network import ImageRays, Network, NodePrior, Pass
from mgsgraph.simulation.camera import interior_orientation
from mgsgraph.simulation.ground import SiteTerrain, make_terrain
from mgsgraph.simulation.hrsc_flight import strip_correction
from mgsgraph.simulation.observations import MARGIN, TerrainErrors, project, terrain_model, tie_network
from mgsgraph.simulation.orbit import GRAVITY, HEADING, MARS, CentralBody, CircularPass, body_matrix
from mgsgraph.simulation.rig import MountedCamera
from mgsgraph.units import DEG, MM

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



Look = Literal["across", "along"]
"""Where the second image looks from nadir: aside by a roll, or ahead along the track."""

FOCAL_LENGTH, PITCH = 352.9271664 * MM, 7e-6
"""m, of CTX (mro_ctx_v11.ti)."""
PIXEL = PITCH / FOCAL_LENGTH
"""rad, of a pixel: 19.8 microradian."""
PERIOD = 1.877e-3
"""s per line."""
SOURCE = "simulated CTX pair"
"""What messages call observations that were not read from a file."""

_EPOCHS = (300_000_000.0, 302_400_000.0)
"""s TDB past J2000 of the images' middles; whole numbers, so that table times are exact in files."""
_MARS = CentralBody(MARS, GRAVITY, body_matrix)
_WAVES = 200
"""Of which a random function consists."""
_ROUNDS = 8
"""Of drawing ties, before images count as sharing too little ground."""


CONTROL = TerrainErrors(posts_per_degree=128, planimetric=100.0)
"""A coarse terrain model: posts 463 m apart, as MOLA's grid."""


@dataclass(frozen=True, slots=True, kw_only=True)
class CtxSettings:
    """What pair to simulate."""

    lines: int = 8500
    """Lines of each image: 16 s."""
    samples: int = 1200
    """Samples of each image, of CTX's 5000."""
    altitude: float = 300e3
    """m, of the orbit above the site."""
    look: Look = "across"
    """Where the second image looks."""
    angle: float = 22.0 * DEG
    """rad, by how much, at the spacecraft."""
    ties: int = 2500
    """Number of tie points."""
    tie_noise: float = 0.2
    """px, line and sample of a measure."""
    matching: float = 0.3
    """Share of its variance that measures within `window` have in common."""
    window: float = 60.0
    """px, distance at which errors of measures are correlated by 1/e."""
    jitter: JitterSettings = field(default_factory=JitterSettings)
    """What the tables lack."""
    control: TerrainErrors | None = CONTROL
    """The terrain model; None for none."""
    site: str = "gusev"
    """Whose ground is shown (`ground.SITES`)."""
    ground: int = 1
    """Seed of the ground, which pairs of several seeds share."""
    basis: Basis = "lagrange"
    """Of the network's nodes."""
    spacing: float = 8.0
    """s between the network's nodes, at most; the default gives the four of a polynomial of degree 3."""


@dataclass(frozen=True, slots=True, eq=False)
class SimulatedCtxPair:
    """A simulated pair: what an adjustment is given, and the truth it should find."""

    settings: CtxSettings
    """What was asked for."""
    seed: int
    """Of everything drawn but the ground."""
    network: Network
    """Two passes of one image each, whose nodes have a prior of a constant and a linear error (`smooth_prior`)."""
    truth: tuple[TrueJitter, ...]
    """Of each image."""
    shifts: Array
    """(1, 2) m east and north, by which the terrain model lies off the truth; (0, 2) without one."""
    true_points: Array
    """(n, 3) m, body-fixed, of the network's points."""
    terrain: SiteTerrain
    """True ground."""

    @property
    def corrections(self) -> tuple[OrientationCorrection, ...]:
        """True orientation of each image = nominal (+) correction."""
        return tuple(one.correction for one in self.truth)

    def __repr__(self) -> str:
        return f"SimulatedCtxPair({self.settings.look}; {self.network!r}; seed {self.seed})"


def smooth_prior(settings: JitterSettings) -> NodePrior:
    """What is known of the slow part alone: sigmas of the constant errors, and the drift as linear and more."""
    drift = settings.drift * PIXEL
    attitude = [max(drift, 1e-9)] * 2 + [1e-7]
    return NodePrior(
        sigmas=np.array([1e-3] * 3 + attitude),
        bias=np.array([settings.position] * 3 + [settings.angle] * 3),
        drift=np.array([1e-3] * 3 + attitude),
    )


def simulate_ctx_pair(settings: CtxSettings | None = None, seed: int = 1) -> SimulatedCtxPair:
    """Simulate a pair; the same settings and seed give the same pair.

    Parameters
    ----------
    settings : CtxSettings, optional
        The default pair when absent.
    seed : int
        zero or positive; jitter, ties and terrain model are drawn from streams of their own.

    Raises
    ------
    InputError
        Where the images do not share enough ground for the ties asked for.
    """
    settings = settings or CtxSettings()
    of_jitter, of_ties, of_terrain = np.random.default_rng([seed, 17]).spawn(3)
    terrain = make_terrain(settings.site, settings.ground)
    images = ctx_images(settings, terrain)
    truth = tuple(
        drawn_jitter(settings.jitter, image.trajectory.epoch, image_times(image), PIXEL, rng)
        for image, rng in zip(images, of_jitter.spawn(2), strict=True)
    )
    true = tuple(one.correction for one in truth)
    points, pixels = _drawn_ties(settings, images, true, terrain, of_ties)
    rays = _measured(settings, pixels, seed, of_ties)
    surface, shifts = terrain_model(settings.control, terrain, points, of_terrain)
    prior = smooth_prior(settings.jitter)
    passes = [
        Pass(image.name, np.array([k]), evenly_spaced(
            settings.basis, image.trajectory.epoch, image_times(image), settings.spacing
        ), prior)
        for k, image in enumerate(images)
    ]  # fmt: skip
    network = tie_network(images, passes, rays, len(points), surface)
    return SimulatedCtxPair(settings, seed, network, truth, shifts, points, terrain)


def image_times(image: PushbroomImage) -> tuple[float, float]:
    """First and last time of an image's lines, s past its trajectory's epoch."""
    first, last = image.timing.at(np.array([0.0, float(image.lines)]))[0]
    return float(first), float(last)


# --- flights and images


def ctx_images(settings: CtxSettings, terrain: SiteTerrain) -> tuple[PushbroomImage, PushbroomImage]:
    """The nominal images, nadir one first; the middles of both see the middle of the site."""
    site = terrain.on_ground(np.array([terrain.centre_lon]), np.array([terrain.centre_lat]))[0]
    interior = interior_orientation(FOCAL_LENGTH, PITCH, 0.5 * settings.samples)
    camera, ahead = MountedCamera("CTX", interior, settings.samples, np.eye(3)), settings.look == "along"
    first, second = (
        camera.image(
            name, CircularPass(epoch, site, HEADING, settings.altitude, angle, _MARS, ahead, turning=True),
            settings.lines, PERIOD,
        )
        for name, epoch, angle in (("CTX/A", _EPOCHS[0], 0.0), ("CTX/B", _EPOCHS[1], settings.angle))
    )  # fmt: skip
    return first, second


# --- observations


def _drawn_ties(
    settings: CtxSettings,
    images: Sequence[PushbroomImage],
    true: Sequence[OrientationCorrection],
    terrain: SiteTerrain,
    rng: np.random.Generator,
) -> tuple[Array, Array]:
    """Points (n, 3) in m of the ground that both images show, and their true pixels (n, 2, 2)."""
    found, places, count = list[Array](), list[Array](), 0
    size = np.array([settings.lines, settings.samples])
    for _ in range(_ROUNDS):
        drawn = rng.uniform(MARGIN, size - MARGIN, (settings.ties, 2))
        points = terrain.intersect(*images[0].sightlines(drawn[:, 0], drawn[:, 1], true[0]))
        pixels, seen = project(images, true, points)
        found.append(points[seen])
        places.append(pixels[seen])
        count += int(seen.sum())
        if count >= settings.ties:
            return np.concatenate(found)[: settings.ties], np.concatenate(places)[: settings.ties]
    raise InputError(SOURCE, f"images that share ground for {count} of {settings.ties} tie points")


def _measured(settings: CtxSettings, pixels: Array, seed: int, rng: np.random.Generator) -> ImageRays:
    """Rays as measured, of true pixels (n, 2 images, 2)."""
    exact, image = pixels.reshape(-1, 2), np.tile(np.arange(2), pixels.shape[0])
    errors = settings.tie_noise * rng.standard_normal(exact.shape)
    if settings.matching:
        errors = _common_errors(settings, errors, image, exact, np.random.default_rng([seed, 17, 71, 6]))
    sigmas = np.full(exact.shape, settings.tie_noise)
    return ImageRays(np.repeat(np.arange(pixels.shape[0]), 2), image, exact + errors, sigmas)


def _common_errors(
    settings: CtxSettings, errors: Array, image: Index, places: Array, rng: np.random.Generator
) -> Array:
    """Errors (k, 2) of measures of which a share of the variance (`matching`) is common to those within the window.

    Parameters
    ----------
    errors : (k, 2)
        Pixels, independent, of the measures' sigmas.
    image : (k,)
        In which they are.
    places : (k, 2)
        Lines and samples there.
    """
    scale = np.sqrt(np.mean(errors**2))
    common = np.empty_like(errors)
    for j in np.unique(image):
        mine = image == j
        common[mine] = scale * _smooth(places[mine], settings.window, rng)
    return np.asarray(np.sqrt(1.0 - settings.matching) * errors + np.sqrt(settings.matching) * common)


def _smooth(places: Array, window: float, rng: np.random.Generator) -> Array:
    """(n, 2) values at places (n, 2) of two random functions of unit variance, whose correlation falls as a Gaussian
    to 1/e at a window's distance: sums of waves (Rahimi & Recht 2007).
    """
    values = np.empty_like(places)
    for column in range(2):
        waves = rng.standard_normal((_WAVES, 2)) * np.sqrt(2.0) / window
        phases = rng.uniform(0.0, 2.0 * np.pi, _WAVES)
        values[:, column] = np.sqrt(2.0 / _WAVES) * np.cos(places @ waves.T + phases).sum(axis=1)
    return values


"""A stereo pair as MRO's Context Camera takes it, with jitter that no table knows: for jitter studies.

CTX: focal length 352.9 mm and pixels of 7 um (mro_ctx_v11.ti), lines of 1.877 ms, 6 m on the ground from 300 km. One
image looks to the nadir, the other one, from another orbit, aside by a roll (`across`, as CTX takes stereo) or ahead
along the track (`along`, as MOC did); both turn with the orbit. The TRUE orientation is the nominal one (+)
`simulation.jitter`; ties are true image points plus noise that neighbours have partly in common. A coarse terrain
model, off in the plane as a whole and with noise of each post, may serve as control.

What an adjustment can see of jitter is a matter of this geometry: along the epipolar line (across the track where the
other image looks aside, along it where it looks ahead) jitter of either image is a height; only at right angles to it
do the two images contradict each other. And there they show the difference of the two, never either by itself.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Literal, get_args

import numpy as np

from mgsgraph.errors import InputError, require
from mgsgraph.files.tie_points import PointKind
from mgsgraph.geometry import rotation
from mgsgraph.geometry.image import PushbroomImage
from mgsgraph.geometry.orientation import OrientationCorrection, OrientationPrior
from mgsgraph.geometry.orientation_images import Basis, evenly_spaced
from mgsgraph.geometry.records import Array, assign, frozen
from mgsgraph.geometry.trajectory import Trajectory
from mgsgraph.names import Names
from mgsgraph.network import GroundPoints, ImageRays, Network, NodePrior, Pass, PointClass, Ranges, Surface
from mgsgraph.simulation.camera import interior_orientation, line_image, one_rate
from mgsgraph.simulation.ground import SiteTerrain, make_terrain
from mgsgraph.simulation.jitter import JitterSettings, TrueJitter, drawn_jitter
from mgsgraph.simulation.mars import GRAVITY, body_matrix
from mgsgraph.simulation.observations import MARGIN, project, require_count, require_positive, require_seed
from mgsgraph.simulation.orbit import HEADING, Orbit, sampled_trajectory
from mgsgraph.simulation.terrain import block_grid
from mgsgraph.simulation.world import World, common_errors
from mgsgraph.units import DEG, MM

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
_STEP, _BEYOND = 0.5, 2.0
"""s between the records of the tables, and by which these reach beyond the image."""
_ROUNDS = 8
"""Of drawing ties, before images count as sharing too little ground."""


@dataclass(frozen=True, slots=True)
class ControlSettings:
    """A coarse terrain model, and what is wrong with it."""

    posts_per_degree: int = 128
    """463 m apart, as MOLA's grid."""
    vertical: float = 10.0
    """m rms, noise of each post."""
    planimetric: float = 100.0
    """m, sigma eastward and northward of its common shift, an unknown of the network."""

    def __post_init__(self) -> None:
        require_count("control settings, posts per degree", self.posts_per_degree, 1)
        for name in ("vertical", "planimetric"):
            require_positive(f"control settings, {name}", getattr(self, name))


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
    control: ControlSettings | None = field(default_factory=ControlSettings)
    """The terrain model; None for none."""
    site: str = "gusev"
    """Whose ground is shown (`ground.SITES`)."""
    ground: int = 1
    """Seed of the ground, which pairs of several seeds share."""
    basis: Basis = "lagrange"
    """Of the network's nodes."""
    spacing: float = 8.0
    """s between the network's nodes, at most; the default gives the four of a polynomial of degree 3."""

    def __post_init__(self) -> None:
        for name, least in (("lines", 16 * MARGIN), ("samples", 8 * MARGIN), ("ties", 1)):
            require_count(f"CTX settings, {name}", getattr(self, name), least)
        for name in ("altitude", "angle", "tie_noise", "window", "spacing"):
            require_positive(f"CTX settings, {name}", getattr(self, name))
        require(self.angle < 60.0 * DEG, "CTX settings, angle", f"{self.angle / DEG:.1f} deg", "less than 60 deg")
        looks = get_args(Look)
        require(self.look in looks, "CTX settings, look", repr(self.look), f"one of {', '.join(looks)}")
        require(0.0 <= self.matching < 1.0, "CTX settings, matching", f"{self.matching}", "a share below 1")


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
    shift: Array
    """(2,) m east and north, by which the terrain model lies off the truth; zero without one."""
    true_points: Array
    """(n, 3) m, body-fixed, of the network's points."""
    terrain: SiteTerrain
    """True ground."""

    def __post_init__(self) -> None:
        n = len(self.network.points)
        assign(self, true_points=frozen(self.true_points, "CTX pair, true points", (n, 3)))

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
    require_seed(SOURCE, seed)
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
    surface, shift = _surface(settings.control, terrain, points, of_terrain)
    network = _network(settings, images, rays, surface, len(points))
    return SimulatedCtxPair(settings, seed, network, truth, shift, points, terrain)


def image_times(image: PushbroomImage) -> tuple[float, float]:
    """First and last time of an image's lines, s past its trajectory's epoch."""
    first, last = image.timing.at(np.array([0.0, float(image.lines)]))[0]
    return float(first), float(last)


# --- flights and images


def ctx_images(settings: CtxSettings, terrain: SiteTerrain) -> tuple[PushbroomImage, PushbroomImage]:
    """The nominal images, nadir one first; the middles of both see the middle of the site."""
    site = terrain.on_ground(np.array([terrain.centre_lon]), np.array([terrain.centre_lat]))[0]
    first, second = (
        _image(settings, name, _trajectory(settings, epoch, site, angle))
        for name, epoch, angle in (("CTX/A", _EPOCHS[0], 0.0), ("CTX/B", _EPOCHS[1], settings.angle))
    )
    return first, second


def _image(settings: CtxSettings, name: str, trajectory: Trajectory) -> PushbroomImage:
    interior = interior_orientation(FOCAL_LENGTH, PITCH, 0.5 * settings.samples)
    timing = one_rate(-0.5 * settings.lines * PERIOD, PERIOD)
    return line_image(name, (settings.lines, settings.samples), interior, timing, trajectory)


def _trajectory(settings: CtxSettings, epoch: float, site: Array, angle: float) -> Trajectory:
    """A circle from which a camera that turns with the orbit meets the site (3,) at the epoch, `angle` off nadir."""
    to_inertial = body_matrix(np.array([epoch]))[0].T
    zenith = to_inertial @ (site / np.linalg.norm(site))
    east = np.cross(to_inertial[:, 2], zenith)
    east /= np.linalg.norm(east)
    flight = np.cos(HEADING) * np.cross(zenith, east) + np.sin(HEADING) * east
    distance = float(np.linalg.norm(site))
    radius = distance + settings.altitude
    apart = np.arcsin(radius / distance * np.sin(angle)) - angle  # at the body's centre, site to spacecraft
    # aside: the spacecraft is beside the site; ahead: it has not reached it
    towards = np.cross(flight, zenith) if settings.look == "across" else -flight
    outward = np.cos(apart) * zenith + np.sin(apart) * towards
    flight = flight - (flight @ outward) * outward
    orbit = Orbit(epoch, outward, flight / np.linalg.norm(flight), radius, 0.0)
    axis = to_inertial @ site - radius * outward
    axis /= np.linalg.norm(axis)
    side = np.cross(axis, orbit.flight)
    side /= np.linalg.norm(side)
    reach = np.ceil((0.5 * settings.lines * PERIOD + _BEYOND) / _STEP)
    times: Array = _STEP * np.arange(-reach, reach + 0.5)
    turned = np.sqrt(GRAVITY / radius**3) * times[:, None] * np.cross(orbit.outward, orbit.flight)
    camera = np.stack([np.cross(side, axis), side, axis]) @ rotation.exponential(-turned)
    return sampled_trajectory(epoch, times, orbit.state(times), camera, body_matrix(epoch + times))


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
        world = World(matching=settings.matching, window=settings.window)
        errors = common_errors(world, errors, image, exact, world.stream("matching", seed, 17))
    sigmas = np.full(exact.shape, settings.tie_noise)
    return ImageRays(np.repeat(np.arange(pixels.shape[0]), 2), image, exact + errors, sigmas)


def _surface(
    control: ControlSettings | None, terrain: SiteTerrain, points: Array, rng: np.random.Generator
) -> tuple[Surface | None, Array]:
    """The terrain model as control of points (n, 3) in m, and its shift (2,) in m east and north."""
    if control is None:
        return None, np.zeros(2)
    shift = control.planimetric * rng.standard_normal(2)
    grid = block_grid(terrain, points, control.posts_per_degree, control.vertical, -shift, 0.0, rng)
    return Surface(grid, grid.control_sigmas(points), control.planimetric), shift


def _network(
    settings: CtxSettings,
    images: tuple[PushbroomImage, ...],
    rays: ImageRays,
    surface: Surface | None,
    points: int,
) -> Network:
    prior, none = smooth_prior(settings.jitter), np.zeros(0)
    passes = tuple(
        Pass(image.name, np.array([k]), evenly_spaced(
            settings.basis, image.trajectory.epoch, image_times(image), settings.spacing
        ), prior)
        for k, image in enumerate(images)
    )  # fmt: skip
    return Network(
        images=images,
        priors=(OrientationPrior(prior.node_sigmas(np.zeros(1))),) * 2,  # of no effect: passes have their own
        held=np.zeros(2, dtype=bool),
        points=GroundPoints(
            ids=Names.of(f"TIE{i + 1:05d}" for i in range(points)),
            classes=np.full(points, int(PointClass.TIE)),
            kinds=np.full(points, int(PointKind.FREE)),
            places=np.full((points, 3), np.nan),
            covariances=np.zeros((points, 3, 3)),
        ),
        rays=rays,
        ranges=Ranges(none.astype(np.int64), none.astype(np.int64), none, none, none),
        surface=surface,
        passes=passes,
    )

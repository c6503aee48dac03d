"""A block of HRSC passes as Mars Express takes them: five stereo lines a pass, matched points, a terrain model.

What Spiegel et al. (papers/003) had: passes of 300 to 4000 km from heights of 265 to 500 km, overlapping across track,
points matched automatically in three to five lines (and, where passes overlap, in lines of both), attitude known to
28 mgon, and MOLA's grid, 200 m off in the plane and 10 m in height. The TRUE orientation of a pass is its nominal
trajectory (+) nodes drawn from the prior that the network states (bias, drift, Gauss-Markov departures), plus jitter,
where asked for, of which the network knows nothing. Image rays are true ones plus noise of the stated sigma.

With the truth on the adjustment's own nodes and without jitter and blunders an adjustment with these sigmas has
consistent statistics: neighbouring points share posts of the terrain model and so their error, which
their sigmas count with.
"""

from dataclasses import dataclass, field, replace

import numpy as np
from block_ground import TerrainErrors, block_terrain, terrain_model, tie_network
from mex_flight import (
    HRSC_PIXELS,
    STEREO,
    FlownPass,
    Jitter,
    PericentrePass,
    PointMatching,
    Readout,
    matched_points,
    pass_images,
    true_correction,
)

from mgsgraph.errors import InputError
from mgsgraph.geometry.orientation import OrientationCorrection, OrientationImages, evenly_spaced
from mgsgraph.geometry.records import Array, Mask
from mgsgraph.network import ImageRays, Network, NodePrior, Pass
from mgsgraph.record import Record
from mgsgraph.simulation.ground import SiteTerrain
from mgsgraph.simulation.observations import Visible
from mgsgraph.simulation.orbit import MARS
from mgsgraph.units import DEG, MGON

_SHORTEST, _LONGEST = 50e3, 4500e3
"""m, of passes: the orbit leaves the heights of the survey beyond."""
_FIRST, _REVOLUTION = 130_000_000.0, 24_000.0
"""s TDB past J2000 of the first pericentre, in February 2004, and from one to the next: 6.7 hours."""
_INCLINATION = 86.6 * DEG
"""Of Mars Express' orbit, about; with the eccentricity it only shapes the passes."""
_PIXEL = 0.007 / 175.0
"""rad, of a detector's pixel."""
_WIDTH = HRSC_PIXELS * _PIXEL
"""Swath over altitude."""
_BLUNDER = (5.0, 100.0)
"""px, least and largest size of a blunder."""


@dataclass(frozen=True, slots=True)
class TrajectoryErrors(Record):
    """Sigmas of errors of the observed trajectory; the same for all three axes.

    28 mgon are the paper's, for all angles: it improves pitch and yaw from them without terrain, roll only with it. For
    the position it has nothing; 50 m make the point heights' sigma of a free adjustment that of the paper, 30 to 50 m.
    """

    attitude: float = 28.0 * MGON
    """rad, bias of pitch, roll and yaw."""
    attitude_drift: float = 5.0 * MGON
    """rad, linear, at the ends of a pass."""
    attitude_wander: float = 3.0 * MGON
    """rad, of the departures from both."""
    position: float = 50.0
    """m, bias along X, Y, Z."""
    position_drift: float = 10.0
    """m, linear, at the ends of a pass."""
    position_wander: float = 1.0
    """m, of the departures from both."""
    correlation_time: float = 60.0
    """s after which departures are correlated by 1/e; 0 for independent ones."""

    @property
    def prior(self) -> NodePrior:
        """These sigmas as the network's prior of orientation images (nodes)."""
        wander, bias, drift = (
            np.array([position] * 3 + [angle] * 3)
            for position, angle in (
                (self.position_wander, self.attitude_wander),
                (self.position, self.attitude),
                (self.position_drift, self.attitude_drift),
            )
        )
        return NodePrior(wander, bias, drift, self.correlation_time)


@dataclass(frozen=True, slots=True)
class BlockSettings(Record):
    """What block to simulate."""

    passes: int = 4
    """Number of passes."""
    crossing: int = 0
    """How many of them, the last ones, fly southward across the middle of the others, which fly northward."""
    length: float = 600e3
    """m of ground that a pass is long."""
    altitudes: tuple[float, float] = (265e3, 400e3)
    """m above the ellipsoid of the first and the last pass's pericentre; evenly spread between."""
    eccentricity: float = 0.6
    """Eccentricity of the orbits; 0 for circles."""
    pericentre: float = 0.4
    """Share of a pass that is flown before the pericentre."""
    overlap: float = 0.3
    """Share of the narrower swath that neighbours have in common, at the pericentres."""
    centre: tuple[float, float] = (175.0 * DEG, -10.0 * DEG)
    """rad, longitude and planetocentric latitude of the middle of the pericentres."""
    readout: Readout = field(default_factory=Readout)
    """How the five lines are read out."""
    points: int = 10_000
    """Number of matched points."""
    matches: PointMatching = field(default_factory=PointMatching)
    """In how many lines, and how well."""
    spacing: float = 10.0
    """s between nodes, at most."""
    true_spacing: float | None = None
    """s between the nodes of the truth, at most; None for a truth on the adjustment's own."""
    errors: TrajectoryErrors = field(default_factory=TrajectoryErrors)
    """Sigmas of the errors of the trajectories."""
    wander: tuple[float, ...] = ()
    """Of each pass, over the errors' departures from bias and drift; these alone when empty."""
    jitter: Jitter | None = None
    """Of all passes, on top; no prior knows it."""
    terrain: TerrainErrors | None = field(default_factory=TerrainErrors)
    """Of the terrain model; None for a network without."""
    ground: int = 1
    """Seed of the true ground, which blocks of several seeds share."""


@dataclass(frozen=True, slots=True, eq=False)
class SimulatedBlock(Record):
    """A simulated block: what an adjustment is given, and the truth it should find."""

    settings: BlockSettings
    """What was asked for."""
    seed: int
    """Seed of the random generator."""
    network: Network
    """What an adjustment is given."""
    corrections: tuple[OrientationCorrection, ...]
    """True orientation of each image: nominal (+) correction; images of one pass share theirs."""
    shifts: Array
    """(1, 2) m east and north, what the terrain model lacks of the truth; (0, 2) where it has no shift."""
    true_points: Array
    """(n, 3) m, body-fixed, of the network's points."""
    blunders: Mask
    """(k,) True for rays that belong to no point: gross errors."""
    relief: SiteTerrain
    """True ground."""

    def true_nodes(self, number: int) -> Array:
        """(k, 6) true coefficients, m and rad, of a pass's nodes; InputError where the truth isn't on these nodes."""
        pass_ = self.network.passes[number]
        correction = self.corrections[pass_.images[0]]
        if correction.nodes is not pass_.nodes:
            raise InputError(f"pass {pass_.name!r}", "a truth on other nodes", "one without true spacing or jitter")
        return np.asarray(correction.coefficients[correction.polynomial_terms :])

    def __repr__(self) -> str:
        nodes = sum(len(pass_.nodes) for pass_ in self.network.passes)
        return f"SimulatedBlock({len(self.network.passes)} passes, {nodes} nodes; {self.network!r}; seed {self.seed})"


def simulate_hrsc_block(settings: BlockSettings | None = None, seed: int = 1) -> SimulatedBlock:
    """Simulate a block; the same settings and seed give the same block.

    Parameters
    ----------
    settings : BlockSettings, optional
        The default block when absent.
    seed : int
        zero or positive; of orientation, points and terrain model, each with a stream of its own. Orbits and the true
        ground are the settings'.

    Raises
    ------
    InputError
        Where passes are too narrow or short for the points asked for.
    """
    settings = settings or BlockSettings()
    of_orientation, of_points, of_terrain = np.random.default_rng(seed).spawn(3)
    relief, prior = block_terrain(*settings.centre, settings.ground), settings.errors.prior
    priors = [replace(prior, sigmas=one * prior.sigmas) for one in settings.wander or (1.0,) * settings.passes]
    flown, nodes = list[FlownPass](), list[OrientationImages]()
    passes = _passes(settings)
    for k, (orbit, rng) in enumerate(zip(passes, of_orientation.spawn(len(passes)), strict=True)):
        images = pass_images(
            f"HRSC/{k:02d}", orbit, orbit.interval(settings.length, settings.pericentre), settings.readout
        )
        edges = [image.timing.at(np.array([0.0, float(image.lines)]))[0] for image in images]
        coverage = min(float(edge[0]) for edge in edges), max(float(edge[1]) for edge in edges)
        nodes.append(evenly_spaced("lagrange", orbit.epoch, coverage, settings.spacing))
        true = true_correction(priors[k], nodes[k], settings.true_spacing, settings.jitter, rng)
        flown.append(FlownPass(orbit.axes, images, true, relief.ground.level))
    points, visible = matched_points(flown, relief, settings.points, settings.matches, of_points)
    rays, blunders = _rays(visible, settings.matches, of_points)
    surface, common, shifts = terrain_model(settings.terrain, relief, points, of_terrain)
    trajectories = [
        Pass(f"HRSC/{k:02d}", len(STEREO) * k + np.arange(len(STEREO)), at, priors[k]) for k, at in enumerate(nodes)
    ]
    pictures = [image for pass_ in flown for image in pass_.images]
    network = tie_network(pictures, trajectories, rays, len(points), surface, common)
    corrections = tuple(pass_.true for pass_ in flown for _ in STEREO)
    return SimulatedBlock(settings, seed, network, corrections, shifts, points, blunders, relief)


def _passes(settings: BlockSettings) -> list[PericentrePass]:
    """One for each pass: northward ones side by side from west to east, then southward ones the same way."""
    longitude, latitude = settings.centre
    east = np.array([-np.sin(longitude), np.cos(longitude), 0.0])
    up = np.array([np.cos(latitude) * np.cos(longitude), np.cos(latitude) * np.sin(longitude), np.sin(latitude)])
    north = np.cross(up, east)
    heading = float(np.arcsin(np.cos(_INCLINATION) / np.cos(latitude)))
    altitudes = np.linspace(*settings.altitudes, settings.passes)
    northward = settings.passes - settings.crossing
    passes = list[PericentrePass]()
    for of_kind, sign in ((altitudes[:northward], 1.0), (altitudes[northward:], -1.0)):
        direction = np.sin(heading) * east + sign * np.cos(heading) * north
        eastward = sign * np.cross(direction, up)
        for altitude, tilt in zip(of_kind, _abreast(of_kind, settings.overlap), strict=True):
            turned = np.cos(tilt) * up + np.sin(tilt) * eastward
            epoch = _FIRST + _REVOLUTION * len(passes)
            passes.append(PericentrePass(epoch, turned, direction, float(altitude), settings.eccentricity))
    return passes


def _abreast(altitudes: Array, overlap: float) -> Array:
    """Angles (n,) in rad at Mars' centre by which swaths from these altitudes lie aside of the middle of all."""
    width = _WIDTH * altitudes / MARS.equatorial
    steps = 0.5 * (width[1:] + width[:-1]) - overlap * np.minimum(width[1:], width[:-1])
    angles = np.concatenate([np.zeros(min(altitudes.size, 1)), np.cumsum(steps)])
    return np.asarray(angles - 0.5 * (angles[:1] + angles[-1:]))


def _rays(visible: Visible, matches: PointMatching, rng: np.random.Generator) -> tuple[ImageRays, Mask]:
    """Image rays as measured, by point and image, and which of them are blunders."""
    point, image, exact = visible.ordered()
    noisy = exact + matches.sigma * rng.standard_normal(exact.shape)
    blunders = rng.random(point.size) < matches.blunders
    size, direction = rng.uniform(*_BLUNDER, point.size), rng.uniform(0.0, 2.0 * np.pi, point.size)
    off = np.where(blunders, size, 0.0)[:, None] * np.column_stack([np.cos(direction), np.sin(direction)])
    return ImageRays(point, image, noisy + off, np.full(noisy.shape, matches.sigma)), blunders


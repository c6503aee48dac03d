"""A study site simulated: true images over true ground, what the instruments and kernels say of them, and the truth.

The two images see the same middle from two flights (`orbit.site_pass`); the altimeter shoots beside the camera, so that
it is rolled with the spacecraft, and a range is the mean over its spot (`laser_spot`). What an adjustment is given
differs from truth by `sites.KernelErrors` (kernels), one horizontal shift of each profile and small noise (footprints),
and noise (tie points, ranges, pictures). Each is drawn from the sigma that the case states (`case_files`).
"""

from dataclasses import dataclass, field, replace
from typing import Literal, get_args

import numpy as np

from mgsgraph.errors import InputError
from mgsgraph.files.tie_points import TiePoints
from mgsgraph.geometry.altimetry import MOLA, SPOT_WIDTHS
from mgsgraph.geometry.body import east_north, from_planetocentric, planetocentric
from mgsgraph.geometry.image import PushbroomImage
from mgsgraph.geometry.records import Array, Mask
from mgsgraph.geometry.terrain import TerrainGrid
from mgsgraph.record import Record
from mgsgraph.simulation.camera import InstrumentErrors, displaced_footprints, moc_image
from mgsgraph.simulation.ground import SiteTerrain, make_terrain, terrain_grid
from mgsgraph.simulation.imagery import Picture, render
from mgsgraph.simulation.mars import sun_direction
from mgsgraph.simulation.mola_files import PedrFrames
from mgsgraph.simulation.observations import MARGIN, project, require_positive, require_seed, shared_ties
from mgsgraph.simulation.orbit import SitePass, nominal_trajectory, site_pass, true_trajectory
from mgsgraph.simulation.sites import (
    SHIFT_SIGMA,
    SITE_NAMES,
    ImageSettings,
    KernelErrors,
    SiteSettings,
    drawn_errors,
    site_settings,
)
from mgsgraph.simulation.spice_files import clock_count, ephemeris_time
from mgsgraph.simulation.world import Vibration, World, common_errors, drawn_vibration, of_tracks, vibrating

_NODES = 91
"""Rays of equal energy in a spot: 15 m apart on the ground."""
_GOLDEN = np.pi * (3.0 - np.sqrt(5.0))
"""rad between one ray and the next about the beam's axis."""


def ranges_over_spots(terrain: SiteTerrain, origins: Array, beams: Array) -> tuple[Array, Array]:
    """Mean range (n,) in m over MOLA's spot, and standard deviation (n,) of the ranges in it.

    Parameters
    ----------
    terrain : SiteTerrain
        Met by all rays.
    origins, beams : (n, 3)
        m, body-fixed, of the spacecraft, and unit vectors along the axes of the beams. The energy falls off as a
        Gaussian about the axis, whose standard deviation is a quarter of the spot's diameter.
    """
    met = np.linalg.norm(terrain.intersect(origins, beams) - origins, axis=1)
    beside = east_north(-beams)  # any two directions across the beam
    offsets = _nodes() * (MOLA.footprint / SPOT_WIDTHS)
    rays = met[:, None, None] * beams[:, None] + np.einsum("kc,ncj->nkj", offsets, beside)
    starts = np.broadcast_to(origins[:, None], rays.shape).reshape(-1, 3)
    points = terrain.intersect(starts, rays.reshape(-1, 3))
    ranges = np.linalg.norm(points - starts, axis=1).reshape(len(beams), -1)
    return ranges.mean(axis=1), ranges.std(axis=1)


def _nodes() -> Array:
    """(k, 2) places of equal weight in a standard normal distribution: a sunflower's, with its mean and covariance."""
    order = np.arange(_NODES)
    radius = np.sqrt(-2.0 * np.log1p(-(order + 0.5) / _NODES))
    places = radius[:, None] * np.stack([np.cos(_GOLDEN * order), np.sin(_GOLDEN * order)], axis=1)
    places -= places.mean(axis=0)
    return np.asarray(np.linalg.solve(np.linalg.cholesky(np.cov(places.T, bias=True)), places.T).T)



SOURCE = "simulated site"
"""What messages call observations that were not read from a file."""
Errors = Literal["drawn", "published"]
"""Errors of the kernels: drawn from the priors that the case states, or as large as the papers found them."""
SHOTS_PER_FRAME = 20
"""Of a PEDR; profiles are whole frames."""

_MOLA_ORBIT = 10_000
"""What MOLA adds to MGS's mapping orbit."""
_SHOT_INTERVAL = 0.1
"""s between two shots."""
_SHOT_SPACING = 300.0
"""m between two shots on the ground, about."""
_BEYOND = 6.0
"""s, at least, by which a profile is longer than its image at either end."""
_ALTIMETER_AXIS = np.array([4e-4, -6e-4, 1.0])
"""Boresight of MOLA in camera axes: 150 m behind the camera's on the ground and 230 m to its right."""
_EDGE_SHOTS = 2
"""Shots on either side of an image's edges that are no ground returns, so that the count inside is not in doubt."""
_GRID_REACH = (25e3, 55e3)
"""m east and west, north and south, to which the terrain grid reaches: all shots and images."""
_CLOUD = (300.0, 3000.0)
"""m above the ground, of returns that are not from it."""


@dataclass(frozen=True, slots=True)
class SimulationOptions(Record):
    """What may differ from the published site."""

    errors: Errors = "drawn"
    """Of the kernels; published ones are for the reproduction of the papers' tables, and the same for each seed."""
    attitude_time_bias: float | None = None
    """s, error of the nadir image's CK tags beside the errors drawn, or in place of the published one: 0.95 gives the
    325 m of the papers' text."""
    emission: float | None = None
    """rad, of the held image, in place of Table 1's; 22.0 deg at Eos gives Shan's orientation."""
    tie_noise: float = 1.0
    """pixels, of a tie point's line and sample."""
    range_noise: float = 1.0
    """m, of a laser range."""
    footprint_noise: float = 3.0
    """m, of each footprint east and north, beside the profile's common shift: a jitter of the beam, since a PEDR says
    where the track is, not where each of its shots is."""
    height_noise: float = 1.0
    """m, of each footprint's height."""
    resolution: int = 128
    """posts per degree of the terrain grid."""
    pictures: bool = True
    """Render the images; otherwise they are of one grey, which is enough for geometry."""
    world: World = field(default_factory=World)
    """What the world does besides."""

    def __post_init__(self) -> None:
        if self.errors not in get_args(Errors):
            raise InputError("simulation options, errors", repr(self.errors), " or ".join(get_args(Errors)))
        for name in ("tie_noise", "range_noise", "footprint_noise", "height_noise"):
            require_positive(f"simulation options, {name}", getattr(self, name))
        for name in ("attitude_time_bias", "emission"):
            value = getattr(self, name)
            if value is not None and not np.isfinite(value):
                raise InputError(f"simulation options, {name}", f"{value}", "a number")
        if self.resolution < 1:
            raise InputError("simulation options, resolution", f"{self.resolution}", "a whole number above zero")


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class SimulatedProfile(PedrFrames):
    """The shots along with one image, as given, in whole frames of 20; the spacecraft's positions are true."""

    true_footprints: Array
    """(n, 3) m, body-fixed, on the beams' axes where the mean of the ground over the spot is."""
    true_pixels: Array
    """(n, 2, 2) line and sample of these in each of the two images; NaN where unseen."""
    shift: Array
    """(2,) m east and north, by which all given footprints lie off."""
    drift: Array
    """(2,) m east and north, by how much more they do at the profile's end than in its middle."""
    beam: Array
    """(2,) rad about the axes x and y of the camera beside it, by which the beam is turned from where its attitude has
    it."""


@dataclass(frozen=True, slots=True, eq=False)
class SimulatedImage(Record):
    """One image: as it was taken, as the kernels have it, and what was taken along with it."""

    settings: ImageSettings
    """The published settings."""
    errors: KernelErrors
    """What is wrong with its kernels."""
    clock_start: str
    """Spacecraft clock count of its upper edge."""
    true: PushbroomImage
    """The image as it was taken."""
    nominal: PushbroomImage
    """The image as the kernels have it."""
    sun: Array
    """(3,) unit, body-fixed, to the Sun."""
    pixels: Picture
    """(lines, samples) grey values."""
    profile: SimulatedProfile
    """Shots of the simultaneous profile."""
    vibration: Vibration | None = None
    """Of the camera; None for none."""


@dataclass(frozen=True, slots=True, eq=False)
class SimulatedSite(Record):
    """A simulated site: what an adjustment is given, and the truth it should find."""

    settings: SiteSettings
    """The published settings."""
    options: SimulationOptions
    """What was asked for."""
    seed: int
    """Seed of everything drawn."""
    terrain: SiteTerrain
    """True ground."""
    grid: TerrainGrid
    """The ground as a grid of radii has it, shifted and with noise."""
    counts: Array | None
    """(rows, columns) shots in each of the grid's cells; None where all were measured."""
    images: tuple[SimulatedImage, SimulatedImage]
    """Left and right as in PE&RS."""
    ties: TiePoints
    """Tie points, all free, each measured in both images."""
    true_ties: Array
    """(n, 3) m, body-fixed, in the order of `ties.ids`."""

    def __repr__(self) -> str:
        names = ", ".join(image.true.name for image in self.images)
        shots = " and ".join(str(int(image.profile.ground.sum())) for image in self.images)
        return f"SimulatedSite({self.settings.title}: {names}; {self.ties!r}; {shots} ground shots; seed {self.seed})"


def simulate_site(
    site: str | SiteSettings,
    seed: int = 1,
    options: SimulationOptions | None = None,
    terrain: SiteTerrain | None = None,
) -> SimulatedSite:
    """Simulate a study site; the same site, seed and options give the same bytes when written.

    Parameters
    ----------
    site : str or SiteSettings
        ``eos``, ``gusev`` or ``isidis``; or its settings, changed (other errors of the kernels).
    seed : int
        zero or positive; ground, kernels, ties, profiles and pictures are drawn from streams of their own.
    options : SimulationOptions, optional
        What differs from the published site.
    terrain : SiteTerrain, optional
        True ground; drawn with the seed when absent.

    Raises
    ------
    InputError
        If there is no such site, or the images do not share enough ground.

    Examples
    --------
    >>> from mgsgraph.simulation.site import SimulationOptions, simulate_site
    >>> simulated = simulate_site("gusev", seed=2, options=SimulationOptions(pictures=False))
    >>> print(simulated)
    SimulatedSite(Gusev Crater: E02-00665, E02-01453; TiePoints(154 points (154 free), 308 measures, from simulated
    site); 272 and 250 ground shots; seed 2)
    """
    settings = site if isinstance(site, SiteSettings) else site_settings(site)
    options = options or SimulationOptions()
    require_seed("simulated site", seed)
    terrain = terrain or make_terrain(settings.name, seed)
    streams = np.random.default_rng([seed, 3, SITE_NAMES.index(settings.name)]).spawn(9)
    world, mine = options.world, (seed, SITE_NAMES.index(settings.name))
    orbit = world.orbit * world.stream("orbit", *mine).standard_normal(3)
    flights = [
        _flight(settings, image, options, terrain, orbit, rng)
        for image, rng in zip(settings.images, streams[7:], strict=True)
    ]
    pairs = [_images(*given) for given in zip(settings.images, flights, streams[:2], strict=True)]
    shaken = world.stream("jitter", *mine)
    vibrations = [drawn_vibration(world, one, shaken) if world.jitter else None for one, _ in pairs]
    first, second = (
        vibrating(one, vibration) if vibration else one for (one, _), vibration in zip(pairs, vibrations, strict=True)
    )
    true = (first, second)
    drawn = streams[2].uniform(MARGIN, np.array([true[0].lines, true[0].samples]) - MARGIN, (8 * settings.ties, 2))
    ground = terrain.intersect(*true[0].rays(drawn[:, 0], drawn[:, 1])[:2])
    ties, points = shared_ties(SOURCE, true, (None, None), ground, settings.ties, options.tie_noise, streams[2])
    ties = _matched_together(ties, true, points, world, world.stream("matching", *mine))
    images = []
    for k, (image, (_, errors, _, count)) in enumerate(zip(settings.images, flights, strict=True)):
        sun = sun_direction(true[k].trajectory.epoch)
        pixels = np.full((image.lines, image.samples), 120, dtype=np.uint8)
        if options.pictures:
            pixels = render(true[k], terrain, None, sun, streams[3 + k])
        profile = _profile(k, true, image, terrain, options, (*mine, k), streams[5 + k])
        images.append(SimulatedImage(image, errors, count, true[k], pairs[k][1], sun, pixels, profile, vibrations[k]))
    grid = terrain_grid(terrain, options.resolution, _GRID_REACH)
    grid, counts = _between_tracks(grid, terrain, world, world.stream("tracks", *mine))
    return SimulatedSite(settings, options, seed, terrain, grid, counts, (images[0], images[1]), ties, points)


def _matched_together(
    ties: TiePoints,
    images: tuple[PushbroomImage, PushbroomImage],
    points: Array,
    world: World,
    rng: np.random.Generator,
) -> TiePoints:
    """Tie points at true places (n, 3) in m, each measured in both images, with errors in common as the world has
    them.
    """
    if not world.matching:
        return ties
    exact = project(images, (None, None), points)[0].reshape(-1, 2)
    errors = common_errors(world, ties.measures - exact, np.arange(len(exact)) % 2, exact, rng)
    return replace(ties, measures=exact + errors)


def _between_tracks(
    grid: TerrainGrid, terrain: SiteTerrain, world: World, rng: np.random.Generator
) -> tuple[TerrainGrid, Array | None]:
    """A grid that is interpolated between the world's tracks, and its shots in each cell; as it is without tracks."""
    if not world.tracks:
        return grid, None
    sides = grid.latitude_step * terrain.metres_per_radian[1], grid.longitude_step * terrain.metres_per_radian[0]
    radii, measured = of_tracks(np.asarray(grid.radii, dtype=np.float64), sides, world.tracks, rng)
    return replace(grid, radii=radii), np.where(measured, float(max(1, round(sides[0] / _SHOT_SPACING))), 0.0)


def _flight(
    site: SiteSettings,
    image: ImageSettings,
    options: SimulationOptions,
    terrain: SiteTerrain,
    orbit: Array,
    rng: np.random.Generator,
) -> tuple[SitePass, KernelErrors, float, str]:
    """The flight, what is wrong with its kernels, the time of the image's upper edge, and its clock count; `orbit` (3,)
    m is wrong with both images' positions, radial, along and across the flight.
    """
    count, start = clock_count(ephemeris_time(image.start))
    middle = terrain.on_ground(np.array([site.longitude]), np.array([site.latitude]))[0]
    emission = options.emission if image.held else None
    flown = site_pass(image, start + 0.5 * image.duration, middle, site.altitude, emission)
    errors = image.errors
    if options.errors == "drawn":
        errors = drawn_errors(site.prior(image), errors.noise, rng)
    if np.any(orbit):
        errors = replace(errors, position=errors.position + np.eye(len(errors.position), 1) * orbit)
    if options.attitude_time_bias is not None and not image.held:
        errors = replace(errors, attitude_time_bias=options.attitude_time_bias)
    return flown, errors, start, count


def _images(
    image: ImageSettings, flight: tuple[SitePass, KernelErrors, float, str], rng: np.random.Generator
) -> tuple[PushbroomImage, PushbroomImage]:
    """The image as it was taken, and as the kernels have it."""
    flown, errors, start, _ = flight
    true = true_trajectory(flown, image.duration)
    nominal = nominal_trajectory(flown, image.duration, errors, rng)
    first, second = (moc_image(image, trajectory, start - flown.epoch) for trajectory in (true, nominal))
    return first, second


def _profile(
    number: int,
    images: tuple[PushbroomImage, PushbroomImage],
    settings: ImageSettings,
    terrain: SiteTerrain,
    options: SimulationOptions,
    seed: tuple[int, ...],
    rng: np.random.Generator,
) -> SimulatedProfile:
    """Shots along with one of the images, by its number, at ten a second in whole frames; `seed` is of the world's.

    Where the file says that a footprint is, lacks its jitter and the beam's pointing error, and has the profile's shift
    and a height of its own.
    """
    image, world = images[number], options.world
    epoch, edges = image.trajectory.epoch, image.timing.at(np.array([0.0, float(image.lines)]))[0]
    frames = int(np.ceil((edges[1] - edges[0] + 2.0 * _BEYOND) / (_SHOT_INTERVAL * SHOTS_PER_FRAME)))
    count = frames * SHOTS_PER_FRAME
    first = 0.5 * (edges[0] + edges[1] - count * _SHOT_INTERVAL) + rng.uniform(0.0, _SHOT_INTERVAL)
    times = epoch + first + _SHOT_INTERVAL * np.arange(count)
    pose = image.trajectory.pose(times - epoch)
    axes = np.einsum("nji,j->ni", pose.matrix, _ALTIMETER_AXIS / np.linalg.norm(_ALTIMETER_AXIS))
    jitter = options.footprint_noise * rng.standard_normal((count, 2))
    aimed = terrain.intersect(pose.position, axes)
    beams = aimed + np.einsum("nk,nkj->nj", jitter, east_north(aimed)) - pose.position
    beams /= np.linalg.norm(beams, axis=1, keepdims=True)
    ranges, spread = ranges_over_spots(terrain, pose.position, beams)
    broad = world.pulse * spread * world.stream("pulse", *seed).standard_normal(count)
    points = pose.position + ranges[:, None] * beams
    pixels = np.stack([each.ground_to_image(points)[0] for each in images], axis=1)
    ground = _ground_returns(pixels[:, number], image, settings, rng)
    cloud = np.where(ground, 0.0, rng.uniform(*_CLOUD, count)) / np.einsum("ni,ni->n", beams, -pose.position)
    cloud *= np.linalg.norm(pose.position, axis=1)
    met = points - cloud[:, None] * beams  # where the pulse came back from
    common = SHIFT_SIGMA * rng.standard_normal(2)
    beam = world.beam * world.stream("beam", *seed).standard_normal(2)
    drift = world.drift * world.stream("drift", *seed).standard_normal(2)
    rays = met - pose.position
    farther = met + (broad / np.linalg.norm(rays, axis=1))[:, None] * rays
    turned = InstrumentErrors(altimeter_boresight=np.append(beam, 0.0))
    believed = displaced_footprints(image, times - epoch, farther, turned)
    off = common + np.linspace(-1.0, 1.0, count)[:, None] * drift - jitter
    given = _displaced(believed, np.column_stack([off, options.height_noise * rng.standard_normal(count)]))
    longitude, latitude, _ = planetocentric(given).T
    nadir = -pose.position / np.linalg.norm(pose.position, axis=1, keepdims=True)
    return SimulatedProfile(
        orbit=settings.orbit + _MOLA_ORBIT,
        times=times,
        ground=ground,
        true_footprints=points,
        true_pixels=pixels,
        spacecraft=pose.position,
        off_nadir=np.arccos(np.einsum("ni,ni->n", beams, nadir)),
        shift=common,
        drift=drift,
        beam=beam,
        spread=spread,
        footprints=given,
        ranges=np.linalg.norm(met - pose.position, axis=1) + broad + options.range_noise * rng.standard_normal(count),
        areoid_radii=terrain.areoid_radius(longitude, latitude),
    )


def _ground_returns(pixels: Array, image: PushbroomImage, settings: ImageSettings, rng: np.random.Generator) -> Mask:
    """Which shots come from the ground: the published number inside the image, none close to its ends.

    The missing ones lie at the image's ends, so that errors of some hundred metres do not change how many are inside,
    and the rest anywhere.
    """
    size = np.array([image.lines, image.samples])
    inside = np.flatnonzero(np.all((pixels >= 0.0) & (pixels <= size), axis=1))
    lost = inside.size - settings.shots
    if lost < 0:
        found = f"{inside.size} shots inside {settings.name}"
        raise InputError(SOURCE, found, f"at least the published {settings.shots}")
    ends = min(_EDGE_SHOTS, lost // 2)
    ground = np.ones(pixels.shape[0], dtype=np.bool_)
    ground[max(inside[0] - _EDGE_SHOTS, 0) : inside[0] + ends] = False
    ground[inside[-1] + 1 - ends : inside[-1] + 1 + _EDGE_SHOTS] = False
    ground[rng.choice(inside[ends : inside.size - ends], lost - 2 * ends, replace=False)] = False
    return ground


def _displaced(points: Array, by: Array) -> Array:
    """Points (n, 3) moved along the sphere and upward by (n, 3) m east, north, up."""
    longitude, latitude, radius = planetocentric(points).T
    longitude = longitude + by[:, 0] / (radius * np.cos(latitude))
    return from_planetocentric(np.column_stack([longitude, latitude + by[:, 1] / radius, radius + by[:, 2]]))

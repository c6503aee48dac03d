"""Simulates a study site: true images over true ground, data of instruments and kernels, and the truth.

The two images see the same middle from two flights (`orbit.site_pass`); the altimeter shoots beside the camera, so that
it is rolled with the spacecraft, and a range is the mean over its spot (`laser_spot`). What an adjustment is given
differs from truth by `sites.KernelErrors` (kernels), one horizontal shift of each profile and small noise (footprints),
and noise (tie points, ranges, pictures). Each is drawn from the sigma that the case states (`case_files`).
"""

from dataclasses import dataclass, replace
from typing import Literal, get_args

import numpy as np

from mgsgraph.errors import InputError, require
from mgsgraph.files.networks.tie_points import TiePoints
from mgsgraph.geometry.altimetry import MOLA, SPOT_WIDTHS
from mgsgraph.geometry.body import east_north, from_planetocentric, planetocentric
from mgsgraph.geometry.image import PushbroomImage
from mgsgraph.geometry.orientation import OrientationCorrection
from mgsgraph.geometry.records import Array, Index, Mask
from mgsgraph.geometry.rotation import unit_vectors
from mgsgraph.geometry.terrain import TerrainGrid
from mgsgraph.record import Record
from mgsgraph.simulation.camera import interior_orientation, line_image, moc_image, one_rate
from mgsgraph.simulation.ground import SiteTerrain, make_terrain, terrain_grid
from mgsgraph.simulation.imagery import Picture, render
from mgsgraph.simulation.mola_files import PedrFrames
from mgsgraph.simulation.observations import (
    MARGIN,
    NoiseSettings,
    free_points,
    require_positive,
    require_seed,
    shared_ties,
    well_inside,
)
from mgsgraph.simulation.orbit import (
    HEADING,
    CircularPass,
    SitePass,
    nominal_trajectory,
    site_at,
    site_pass,
    sun_direction,
    tilted_trajectory,
    true_trajectory,
)
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
from mgsgraph.units import ARCMIN, DEG

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
    """Settings that may differ from the published site.

    Examples
    --------
    >>> from mgsgraph.simulation import SimulationOptions
    >>> SimulationOptions(pictures=False).tie_noise  # px
    1.0
    """

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

    def __post_init__(self) -> None:
        if self.errors not in get_args(Errors):
            raise InputError("simulation options, errors", repr(self.errors), " or ".join(get_args(Errors)))
        for name in ("tie_noise", "range_noise", "footprint_noise", "height_noise"):
            require_positive(f"simulation options, {name}", getattr(self, name))
        for name in ("attitude_time_bias", "emission"):
            value = getattr(self, name)
            require(value is None or np.isfinite(value), f"simulation options, {name}", f"{value}", "a number")
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
    >>> from mgsgraph.simulation import SimulationOptions, simulate_site
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
    flights = [
        _flight(settings, image, options, terrain, rng)
        for image, rng in zip(settings.images, streams[7:], strict=True)
    ]
    pairs = [_images(*given) for given in zip(settings.images, flights, streams[:2], strict=True)]
    true = (pairs[0][0], pairs[1][0])
    drawn = streams[2].uniform(MARGIN, np.array([true[0].lines, true[0].samples]) - MARGIN, (8 * settings.ties, 2))
    ground = terrain.intersect(*true[0].rays(*drawn.T)[:2])
    ties, points = shared_ties(SOURCE, true, (None, None), ground, settings.ties, options.tie_noise, streams[2])
    images = []
    for k, (image, (_, errors, _, count)) in enumerate(zip(settings.images, flights, strict=True)):
        sun = sun_direction(true[k].trajectory.epoch)
        pixels = np.full((image.lines, image.samples), 120, dtype=np.uint8)
        if options.pictures:
            pixels = render(true[k], terrain, None, sun, streams[3 + k])
        profile = _profile(k, true, image, terrain, options, streams[5 + k])
        images.append(SimulatedImage(image, errors, count, true[k], pairs[k][1], sun, pixels, profile))
    grid = terrain_grid(terrain, options.resolution, _GRID_REACH)
    return SimulatedSite(settings, options, seed, terrain, grid, (images[0], images[1]), ties, points)


def _flight(
    site: SiteSettings,
    image: ImageSettings,
    options: SimulationOptions,
    terrain: SiteTerrain,
    rng: np.random.Generator,
) -> tuple[SitePass, KernelErrors, float, str]:
    """The flight, the errors of its kernels, the time of the image's upper edge, and its clock count."""
    count, start = clock_count(ephemeris_time(image.start))
    middle = terrain.on_ground(np.array([site.longitude]), np.array([site.latitude]))[0]
    emission = options.emission if image.held else None
    flown = site_pass(image, start + 0.5 * image.duration, middle, site.altitude, emission)
    errors = image.errors
    if options.errors == "drawn":
        errors = drawn_errors(site.prior(image), errors.noise, rng)
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
    rng: np.random.Generator,
) -> SimulatedProfile:
    """Shots along with one of the images, by its number, at ten a second in whole frames.

    Where the file says that a footprint is, lacks its jitter, and has the profile's shift and a height of its own.
    """
    image = images[number]
    epoch, edges = image.trajectory.epoch, image.timing.at(np.array([0.0, float(image.lines)]))[0]
    frames = int(np.ceil((edges[1] - edges[0] + 2.0 * _BEYOND) / (_SHOT_INTERVAL * SHOTS_PER_FRAME)))
    count = frames * SHOTS_PER_FRAME
    first = 0.5 * (edges[0] + edges[1] - count * _SHOT_INTERVAL) + rng.uniform(0.0, _SHOT_INTERVAL)
    times = epoch + first + _SHOT_INTERVAL * np.arange(count)
    pose = image.trajectory.pose(times - epoch)
    axes = np.einsum("nji,j->ni", pose.matrix, _ALTIMETER_AXIS / np.linalg.norm(_ALTIMETER_AXIS))
    jitter = options.footprint_noise * rng.standard_normal((count, 2))
    aimed = terrain.intersect(pose.position, axes)
    beams = unit_vectors(aimed + np.einsum("nk,nkj->nj", jitter, east_north(aimed)) - pose.position)
    ranges, spread = ranges_over_spots(terrain, pose.position, beams)
    points = pose.position + ranges[:, None] * beams
    pixels = np.stack([each.ground_to_image(points)[0] for each in images], axis=1)
    ground = _ground_returns(pixels[:, number], image, settings, rng)
    cloud = np.where(ground, 0.0, rng.uniform(*_CLOUD, count)) / np.einsum("ni,ni->n", beams, -pose.position)
    cloud *= np.linalg.norm(pose.position, axis=1)
    met = points - cloud[:, None] * beams  # where the pulse came back from
    common = SHIFT_SIGMA * rng.standard_normal(2)
    given = _displaced(met, np.column_stack([common - jitter, options.height_noise * rng.standard_normal(count)]))
    longitude, latitude, _ = planetocentric(given).T
    nadir = -unit_vectors(pose.position)
    return SimulatedProfile(
        orbit=settings.orbit + _MOLA_ORBIT,
        times=times,
        ground=ground,
        true_footprints=points,
        true_pixels=pixels,
        spacecraft=pose.position,
        off_nadir=np.arccos(np.einsum("ni,ni->n", beams, nadir)),
        shift=common,
        spread=spread,
        footprints=given,
        ranges=np.linalg.norm(met - pose.position, axis=1) + options.range_noise * rng.standard_normal(count),
        areoid_radii=terrain.areoid_radius(longitude, latitude),
    )


def _ground_returns(pixels: Array, image: PushbroomImage, settings: ImageSettings, rng: np.random.Generator) -> Mask:
    """Which shots come from the ground: the published number inside the image, none close to its ends.

    The missing ones lie at the image's ends, so that errors of some hundred metres do not change how many are inside,
    and the rest anywhere.
    """
    size = np.array([image.lines, image.samples])
    inside = np.flatnonzero(np.all((pixels >= 0.0) & (pixels <= size), axis=1))
    without = inside.size - settings.shots
    found = f"{inside.size} shots inside {settings.name}"
    require(without >= 0, SOURCE, found, f"at least the published {settings.shots}")
    ends = min(_EDGE_SHOTS, without // 2)
    ground = np.ones(pixels.shape[0], dtype=np.bool_)
    ground[max(inside[0] - _EDGE_SHOTS, 0) : inside[0] + ends] = False
    ground[inside[-1] + 1 - ends : inside[-1] + 1 + _EDGE_SHOTS] = False
    ground[rng.choice(inside[ends : inside.size - ends], without - 2 * ends, replace=False)] = False
    return ground


def _displaced(points: Array, by: Array) -> Array:
    """Points (n, 3) moved along the sphere and upward by (n, 3) m east, north, up."""
    longitude, latitude, radius = planetocentric(points).T
    longitude = longitude + by[:, 0] / (radius * np.cos(latitude))
    return from_planetocentric(np.column_stack([longitude, latitude + by[:, 1] / radius, radius + by[:, 2]]))



_CAMPAIGN = "simulated three-site campaign"
BRIDGE = "BRIDGE"
"""Name of the bridge image."""
BRIDGE_PRIOR = NoiseSettings(tie=0.3, position=100.0, angle=ARCMIN)
"""Sigma of a tie's measure in the bridge image, pixels, and a-priori sigmas of its orientation: a nadir image's."""

_EPOCH = 41_000_000.0
"""s TDB past J2000, in April 2001, when none of the sites' images was taken."""
_CROSSING = 202.45 * DEG
"""rad, longitude where the orbit crosses the equator northward at the epoch: it then passes within 0.5 deg of all."""
_SPAN = (-28_500.0, 28_330.0)
"""s past the epoch, of the first line and the last: a minute before Eos and a minute after Isidis."""
_ALTITUDE = 380e3
"""m above the ellipsoid at the equator."""
_FOCAL_LENGTH, _PITCH, _SAMPLES = 11.08e-3, 7e-6, 1024
"""m, m, and the samples used, about the axis: MOC-WA's red camera has 11.1 mm and 3456 (Malin et al. 1992)."""
_PERIOD = 0.08
"""s per line: 240 m at 3.0 km/s, as much as a sample."""
_TABLE_STEP = 10.0
"""s between samples of the orientation; what lies between is the nominal orientation, for truth too."""


@dataclass(frozen=True, slots=True, eq=False)
class SimulatedThreeSites:
    """Three simulated sites and their bridge: what an adjustment is given, and the truth it should find."""

    seed: int
    """Of the random generator; each site has it, too."""
    sites: tuple[SimulatedSite, ...]
    """Eos, Gusev, Isidis, with their images, kernels' errors and profiles."""
    bridge: PushbroomImage
    """Nominal."""
    true_bridge: OrientationCorrection
    """True orientation of the bridge = nominal (+) this."""
    ties: TiePoints
    """Tie points of all sites, named after them, each measured in both of its site's images and in the bridge."""
    true_ties: Array
    """(n, 3) m, body-fixed, in the order of `ties.ids`."""

    def __repr__(self) -> str:
        names = ", ".join(site.settings.name for site in self.sites)
        return f"SimulatedThreeSites({names}; {self.ties!r}; seed {self.seed})"


def simulate_three_sites(seed: int = 1, options: SimulationOptions | None = None) -> SimulatedThreeSites:
    """Simulate the three-site campaign; the same seed and options give the same campaign.

    Parameters
    ----------
    seed : int
        zero or positive.
    options : SimulationOptions, optional
        What differs from the published sites, the same for all three.

    Raises
    ------
    InputError
        As `simulate_site` does, or if the bridge does not show all tie points.
    """
    sites = tuple(simulate_site(name, seed, options) for name in SITE_NAMES)
    rng = np.random.default_rng([seed, 33])
    bridge, true = bridge_image(), BRIDGE_PRIOR.correction(rng)
    ties = _all_ties(sites, bridge, true, rng)
    return SimulatedThreeSites(seed, sites, bridge, true, ties, np.concatenate([site.true_ties for site in sites]))


def bridge_image() -> PushbroomImage:
    """The bridge image, nominal: a nadir swath of eight revolutions."""
    first, last = _SPAN
    flown = CircularPass(_EPOCH, site_at(_CROSSING, 0.0), HEADING, _ALTITUDE)
    interior = interior_orientation(_FOCAL_LENGTH, _PITCH, 0.5 * _SAMPLES)
    trajectory = tilted_trajectory(flown, max(-first, last), _TABLE_STEP)
    size = round((last - first) / _PERIOD), _SAMPLES
    return line_image(BRIDGE, size, interior, one_rate(first, _PERIOD), trajectory)


def _all_ties(
    sites: tuple[SimulatedSite, ...], bridge: PushbroomImage, true: OrientationCorrection, rng: np.random.Generator
) -> TiePoints:
    """Tie points of the sites with a measure in the bridge image after those in the sites' own."""
    noise, count = BRIDGE_PRIOR.tie, 0
    point, names, measures, sigmas = list[Index](), list[str](), list[Array](), list[Array]()
    for site in sites:
        n = len(site.ties.ids)
        pixels, _ = bridge.ground_to_image(site.true_ties, true)
        if not np.all(well_inside(bridge, pixels)):
            raise InputError(_CAMPAIGN, f"a tie point of {site.settings.title} that the bridge does not show")
        point += [count + site.ties.measure_point, count + np.arange(n)]
        names += [*site.ties.measure_image, *(bridge.name,) * n]
        measures += [site.ties.measures, pixels + noise * rng.standard_normal((n, 2))]
        sigmas += [site.ties.measure_sigmas, np.full((n, 2), noise)]
        count += n
    order = np.argsort(np.concatenate(point), kind="stable")
    return free_points(
        _CAMPAIGN,
        tuple(f"{site.settings.name}-{name}" for site in sites for name in site.ties.ids),
        np.concatenate(point)[order],
        tuple(names[k] for k in order.tolist()),
        np.concatenate(measures)[order],
        np.concatenate(sigmas)[order],
    )

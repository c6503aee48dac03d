"""Two passes of LRO's narrow angle cameras over one place: NAC-L and NAC-R side by side, the second pass rolled aside.

Optics and mounting are those of the ISIS support data of 2009-07-13 near Hadley rille (shared/data, `lro_nac_hadley`):
focal lengths 0.69962 and 0.70157 m, 5064 pixels of 7 um each, radial distortion, lines of 0.34 ms from 50 km; R turned
by half a turn about its axis against L, and their axes 2.75 degrees apart across track, so that some 130 of 5064
samples show the same ground. The second pass lies half of one camera's swath aside: its L shows ground of both L and R.

A pass has one trajectory, whose error all its images share. R's boresight is another than stated by an error that the
campaign shares: 80 m on the ground, in a direction that is drawn. Neither is told to an adjustment but by sigmas.
"""

from dataclasses import dataclass, field, replace

import numpy as np

from mgsgraph.geometry import rotation
from mgsgraph.geometry.camera import LrocNacDistortion
from mgsgraph.geometry.image import PushbroomImage
from mgsgraph.geometry.orientation import OrientationPrior
from mgsgraph.geometry.records import Array, Index, Mask
from mgsgraph.network import GroundPoints, ImageRays, Network, PointClass, ProfileShifts, Ranges
from mgsgraph.network.shared import SharedKind, SharedUnknown
from mgsgraph.simulation.camera import interior_orientation
from mgsgraph.simulation.moon import MOON, MOON_BODY
from mgsgraph.simulation.orbit import CircularPass, site_at
from mgsgraph.simulation.rig import (
    MountedCamera,
    PassErrors,
    SimulatedRig,
    TrueRig,
    given_points,
    joined,
    measured,
    seen_twice,
)
from mgsgraph.units import DEG

BORESIGHT = "boresight of NAC-R"
SAMPLES = 5064

_LEFT_TO_RIGHT = rotation.exponential(np.array([-2.15767e-3, -7.52083e-2, -3.13420543]))
"""From the axes of NAC-L to those of NAC-R, by the tables of `lro_nac_hadley`."""
_PITCH = 1.0 / 142857.0
"""m."""
_EPOCHS = (300_000_000.0, 302_360_000.0)
"""s TDB past J2000 of the passes' middles, 27 days apart."""
_SITE = (3.6 * DEG, 26.1 * DEG)
"""rad, longitude and latitude: Hadley rille."""
_RELIEF = 300.0
"""m, sigma of the ground's heights."""
_LOOSE = (1000.0, 1000.0, 30.0)
"""m, east, north and up: sigmas of the place of a tie point that one pass alone shows, by a terrain model's height."""
_TRIES = 60
"""Points drawn for one in the overlap of L and R."""


@dataclass(frozen=True, slots=True)
class NacSettings:
    """What to simulate."""

    altitude: float = 50e3
    """m."""
    roll: float = 20.0 * DEG
    """rad, by which the second pass looks aside."""
    aside: float = 1250.0
    """m on the ground by which its middle lies east of the first one's: half of one camera's swath."""
    lines: int = 52_224
    """Of each image."""
    period: float = 3.4e-4
    """s per line."""
    ties: int = 400
    """Tie points drawn over the images of the first pass; those count that a second image shows."""
    beside: int = 40
    """Tie points in the overlap of L and R, of each pass; fewer where a boresight error leaves it too narrow."""
    shots: int = 40
    """Laser shots of each pass, along the spacecraft's +Z; 0 for none."""
    control: int = 0
    """Ground control points, of the ties."""
    tie_sigma: float = 0.3
    """px."""
    shot_sigma: float = 3.0
    """px, of a footprint's place in an image."""
    range_sigma: float = 0.2
    """m."""
    footprint_sigmas: tuple[float, float] = (3.0, 1.0)
    """m, horizontal and vertical, of a footprint's own place."""
    track_sigma: float = 20.0
    """m, east and north alike: of the shift that all footprints of a pass share."""
    control_sigma: float = 2.0
    """m, of a control point in each direction."""
    boresight: float = 80.0
    """m on the ground below, by which the axis of R is off."""
    boresight_sigmas: tuple[float, float, float] = (1.6e-3, 1.6e-3, 5e-4)
    """rad, what is known of it beforehand, about R's axes x, y, z."""
    errors: PassErrors = field(default_factory=PassErrors)
    """Of each pass's trajectory."""


def nac_cameras() -> tuple[MountedCamera, MountedCamera]:
    """NAC-L and NAC-R, their optical axes as far to the left of the spacecraft's +Z as to its right."""
    ahead = np.array([-1.0, 0.0, 0.0])  # the flight in L's axes, about
    middle = np.array([0.0, 0.0, 1.0]) + _LEFT_TO_RIGHT.T @ [0.0, 0.0, 1.0]
    middle /= np.linalg.norm(middle)
    ahead -= (ahead @ middle) * middle
    ahead /= np.linalg.norm(ahead)
    left = np.stack([ahead, np.cross(middle, ahead), middle], axis=1)
    cameras = []
    for name, focal, centre, k, sign, mount in (
        ("L", 0.69962, 2547.5, 18.1, 1.0, left),
        ("R", 0.70157, 2495.5, 18.3, -1.0, _LEFT_TO_RIGHT @ left),
    ):
        interior = replace(interior_orientation(focal, sign * _PITCH, centre), distortion=LrocNacDistortion(k))
        cameras.append(MountedCamera(name, interior, SAMPLES, mount))
    return cameras[0], cameras[1]


def nac_images(settings: NacSettings) -> tuple[PushbroomImage, ...]:
    """Nominal images: L and R of the first pass at nadir, then of the second one."""
    east, images = settings.aside / (MOON.equatorial * np.cos(_SITE[1])), []
    for k, (epoch, roll) in enumerate(zip(_EPOCHS, (0.0, settings.roll), strict=True), start=1):
        site = site_at(_SITE[0] + (k - 1) * east, _SITE[1], MOON)
        flown = CircularPass(epoch, site, 0.0, settings.altitude, roll, MOON_BODY, turning=True)
        images += [
            camera.image(f"{camera.name}{k}", flown, settings.lines, settings.period) for camera in nac_cameras()
        ]
    return tuple(images)


def simulate_nac_pair(settings: NacSettings | None = None, seed: int = 1) -> SimulatedRig:
    """Simulate two passes; the same settings and seed give the same."""
    settings = settings or NacSettings()
    of_truth, of_points, of_shots, of_noise = np.random.default_rng([seed, 24]).spawn(4)
    images = nac_images(settings)
    passes = tuple(joined(f"pass {k + 1}", images[2 * k : 2 * k + 2], 2 * k, settings.errors) for k in (0, 1))
    boresight = _drawn_boresight(settings, of_truth)
    truth = TrueRig.drawn(images, passes, settings.errors, np.array([0.0, 1.0] * 2)[:, None] * boresight, of_truth)
    ties = _tie_places(truth, settings, of_points)
    shots, ranges, carrier = _shots(truth, settings, of_shots)
    points = np.concatenate([ties, shots])
    rays = _rays(truth, points, len(ties), settings, of_noise)
    given, shifts = _given(ties, shots, carrier, _of_one_pass(rays, len(points)), settings, of_noise)
    n = np.arange(len(shots))
    shared = SharedUnknown(
        BORESIGHT, SharedKind.CAMERA_BORESIGHT, np.array([1, 3]), np.array(settings.boresight_sigmas)
    )
    network = Network(
        images=images,
        priors=own_priors(settings),
        held=np.zeros(4, dtype=bool),
        points=given,
        rays=rays,
        ranges=Ranges(
            len(ties) + n, carrier, ranges[:, 0],
            ranges[:, 1] + settings.range_sigma * of_noise.standard_normal(n.size),
            np.full(n.size, settings.range_sigma),
        ),
        shifts=shifts,
        shared=(shared,),
        passes=passes,
    )  # fmt: skip
    return SimulatedRig(network, truth, points, (boresight,))


def own_priors(settings: NacSettings) -> tuple[OrientationPrior, ...]:
    """What is known of each image by itself: the pass's error, and of R that of its boresight besides."""
    sigmas, mounted = settings.errors.sigmas, settings.errors.sigmas.copy()
    mounted[0, 3:] = np.hypot(mounted[0, 3:], settings.boresight_sigmas)
    return tuple(OrientationPrior(one) for one in (sigmas, mounted) * 2)


def _drawn_boresight(settings: NacSettings, rng: np.random.Generator) -> Array:
    """(3,) rad: of the stated size about x and y in a direction that is drawn, and drawn about z."""
    direction, size = rng.uniform(0.0, 2.0 * np.pi), settings.boresight / settings.altitude
    about_z = settings.boresight_sigmas[2] * rng.standard_normal()
    return np.array([size * np.cos(direction), size * np.sin(direction), about_z])


def _tie_places(truth: TrueRig, settings: NacSettings, rng: np.random.Generator) -> Array:
    """(n, 3) m: over both images of the first pass, and in the overlaps of L and R of each pass."""
    size = np.array([truth.images[0].lines, SAMPLES])
    drawn = [
        truth.ground(j, size * rng.random((settings.ties // 2, 2)), _RELIEF * rng.standard_normal(settings.ties // 2))
        for j in (0, 1)
    ]
    everywhere = np.concatenate(drawn)
    places = [everywhere[seen_twice(truth.seen(everywhere), len(everywhere))]]
    for left in (0, 2):
        count = _TRIES * settings.beside
        tried = truth.ground(left, size * rng.random((count, 2)), _RELIEF * rng.standard_normal(count))
        point, image, _ = truth.seen(tried).ordered()
        both = np.intersect1d(point[image == left], point[image == left + 1])[: settings.beside]
        places.append(tried[both])
    return np.concatenate(places)


def _shots(
    truth: TrueRig, settings: NacSettings, rng: np.random.Generator
) -> tuple[Array, Array, Index]:
    """True footprints (n, 3) in m, times and ranges (n, 2) in s and m, and the image (n,) that carries each range."""
    beam = nac_cameras()[0].mount @ [0.0, 0.0, 1.0]
    shares = np.linspace(0.02, 0.98, settings.shots)
    found = [truth.shots(left, shares, beam, _RELIEF * rng.standard_normal(shares.size)) for left in (0, 2)]
    places, times, ranges = (np.concatenate(each) for each in zip(*found, strict=True))
    return places, np.column_stack([times, ranges]), np.repeat([0, 2], shares.size)


def _rays(
    truth: TrueRig, points: Array, ties: int, settings: NacSettings, rng: np.random.Generator
) -> ImageRays:
    """As measured: ties in all images that show them, footprints less well."""
    sigmas = np.where(np.arange(len(points)) < ties, settings.tie_sigma, settings.shot_sigma)
    return measured(truth.seen(points), np.repeat(sigmas[:, None], len(truth.images), axis=1), rng)


def _of_one_pass(rays: ImageRays, count: int) -> Mask:
    """(count,) True for points that one pass alone shows: their rays are nearly parallel."""
    seen = np.zeros((count, 2), dtype=bool)
    seen[rays.point, rays.image // 2] = True
    return np.asarray(~seen.all(axis=1))


def _given(
    ties: Array, shots: Array, carrier: Index, alone: Mask, settings: NacSettings, rng: np.random.Generator
) -> tuple[GroundPoints, ProfileShifts | None]:
    """Points as an adjustment is given them. What footprints of a pass have in common is one error, an unknown; tie
    points that are `alone` (n,) on rays of one pass have a height to start from: their rays are so nearly parallel that
    the boresight's error makes them meet behind the cameras.
    """
    n, m = len(ties), len(shots)
    flat, height = settings.footprint_sigmas
    known = alone | (np.arange(n + m) >= n)
    control = rng.permutation(n)[: settings.control]
    sigmas = np.concatenate([np.tile(_LOOSE, (n, 1)), np.tile([flat, flat, height], (m, 1))])
    sigmas[control] = settings.control_sigma
    errors = sigmas * rng.standard_normal((n + m, 3))
    profile = carrier // 2
    shifts = settings.track_sigma * rng.standard_normal((2, 2))
    errors[n:, :2] -= shifts[profile]
    classes = np.full(n + m, int(PointClass.TIE))
    known[control], classes[control], classes[n:] = True, int(PointClass.CONTROL), int(PointClass.LASER)
    names = [f"T{i:04d}" for i in range(n)] + [f"S{i:04d}" for i in range(m)]
    points = given_points(names, classes, known, np.concatenate([ties, shots]), sigmas, errors)
    if not m:
        return points, None
    of_point = np.concatenate([np.full(n, -1), profile])
    return points, ProfileShifts(("LOLA 1", "LOLA 2"), of_point, np.full(2, settings.track_sigma))

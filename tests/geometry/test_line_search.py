"""Ground to image against an oracle that knows nothing of its search: w at thousands of lines, then bisection."""

from dataclasses import dataclass

import numpy as np
import pytest

from mgsgraph.geometry import rotation
from mgsgraph.geometry.body import Ellipsoid
from mgsgraph.geometry.camera import InteriorOrientation, NoDistortion, RadialDistortion
from mgsgraph.geometry.image import LineTiming, PushbroomImage
from mgsgraph.geometry.line_search import Sightings
from mgsgraph.geometry.orientation import OrientationCorrection
from mgsgraph.geometry.records import Array, Index, Mask
from mgsgraph.geometry.trajectory import AttitudeTable, PositionTable, Trajectory

MARS, MOON = Ellipsoid(3_396_190.0, 3_376_200.0), Ellipsoid(1_737_400.0, 1_737_400.0)
GRAVITY = {MARS: 4.282837e13, MOON: 4.9028e12}
SPIN = {MARS: 7.088e-5, MOON: 2.66e-6}
"""rad/s."""
DENSE = 3001
"""Lines of the oracle's scan."""


@dataclass(frozen=True)
class Strip:
    """A made-up image and what was drawn in it."""

    image: PushbroomImage
    correction: OrientationCorrection | None
    points: Array
    """(n, 3) m."""
    truth: Array
    """(n, 2) line and sample by which they were made; NaN of those that were not."""


def strip(seed: int, count: int) -> Strip:
    """100 to 5,000 km from 20 to 1,000 km height, up to 60 degrees off nadir, any inclination, one to ten line rates,
    pauses, cameras that nod against the flight, straight and bent detectors.
    """
    rng = np.random.default_rng([47, seed])
    body = (MARS, MOON)[seed % 2]
    height, length = np.exp(rng.uniform(np.log([20e3, 100e3]), np.log([1e6, 5e6])))
    radius = body.equatorial + height
    motion = np.sqrt(GRAVITY[body] / radius**3)
    limb = np.arcsin(body.polar / radius)
    aside = rng.uniform(-1.0, 1.0) * min(np.radians(60.0), 0.9 * limb)
    duration, lines = length / body.equatorial / motion, int(np.exp(rng.uniform(np.log(500), np.log(60_000))))
    nod = rng.choice([0.0, 1.0], p=[0.6, 0.4]) * rng.uniform(0.02, 0.25)  # rad
    timing = _timing(rng, duration, lines)
    step = duration / np.exp(rng.uniform(np.log(40), np.log(500)))
    trajectory = _flown(rng, body, (radius, motion), aside, nod, duration * (1.0 + rng.uniform(0.01, 0.6)), step)
    samples = int(rng.integers(64, 4000))
    pixel = np.clip(duration * motion * body.equatorial / lines / height, 0.02 / samples, 0.3 / samples)
    distortion = RadialDistortion(0.0, rng.uniform(-0.3, 0.3), 0.0) if rng.random() < 0.5 else NoDistortion()
    turned, ahead = np.radians(rng.uniform([-20.0, -19.0], [20.0, 19.0]))
    axes = np.array([[np.cos(turned), np.sin(turned)], [-np.sin(turned), np.cos(turned)]]) / pixel
    centre = np.array([-np.tan(ahead) / pixel, 0.5 * samples])  # focal length 1 m
    interior = InteriorOrientation(1.0, np.hstack([np.zeros((2, 1)), axes]), centre, np.zeros(2), 1.0, distortion)
    image = PushbroomImage(f"strip {seed}", lines, samples, interior, timing, trajectory, body)
    sigmas = np.array([1e3, 1e3, 1e3, 3e-3, 3e-3, 3e-3])
    correction = OrientationCorrection(rng.standard_normal((3, 6)) * sigmas) if rng.random() < 0.3 else None
    return Strip(image, correction, *_drawn(rng, image, correction, count))


def _timing(rng: np.random.Generator, duration: float, lines: int) -> LineTiming:
    """One to ten rates, pauses between some."""
    parts = int(rng.integers(1, 11)) if rng.random() < 0.7 else 1
    first = np.concatenate([[0.0], np.sort(rng.choice(np.arange(20, lines - 20), parts - 1, replace=False))])
    periods = np.exp(rng.uniform(-1.2, 1.2, parts))
    counts = np.diff(first, append=lines)
    pauses = np.append(rng.choice([0.0, 0.0, 0.3, 30.0], parts - 1), 0.0) * periods
    scale = duration / np.sum(counts * periods + pauses)
    starts = np.concatenate([[0.0], np.cumsum(counts * periods + pauses)[:-1]]) * scale - 0.5 * duration
    return LineTiming(first, starts, periods * scale)


def _flown(
    rng: np.random.Generator, body: Ellipsoid, circle: tuple[float, float], aside: float, nod: float, span: float,
    step: float,
) -> Trajectory:  # fmt: skip
    """Tables of a circle, camera +x ahead, +z down and aside, nodding."""
    radius, motion = circle
    times = np.arange(-0.5 * span, 0.5 * span + step, step)
    pole = rng.standard_normal(3) if rng.random() < 0.5 else np.append(rng.standard_normal(2), 0.0)
    node = np.linalg.qr(np.column_stack([pole, rng.standard_normal((3, 2))]))[0]
    angle = (motion * times + rng.uniform(0.0, 6.3))[:, None]
    out, ahead = (np.cos(angle) * node[:, 1] + np.sin(angle) * node[:, 2],
                  np.cos(angle) * node[:, 2] - np.sin(angle) * node[:, 1])  # fmt: skip
    level = np.stack([ahead, np.cross(-out, ahead), -out], axis=1)
    zero, waves = np.zeros(times.size), rng.uniform(1.0, 6.0) * 2.0 * np.pi / span
    pitch = nod * np.sin(waves * times + rng.uniform(0.0, 6.3)) + rng.uniform(-0.2, 0.2)
    camera = (
        rotation.exponential(np.column_stack([zero, pitch, zero]))
        @ rotation.exponential(np.array([aside, 0.0, 0.0]))
        @ level
    )
    ends = times[[0, -1]]
    turned = rotation.exponential(-np.column_stack([0.0 * ends, 0.0 * ends, SPIN[body] * ends]))
    quaternions = rotation.continuous(rotation.from_matrix(camera))
    return Trajectory(
        0.0, PositionTable(times, radius * out, radius * motion * ahead), AttitudeTable(times, quaternions, np.eye(3)),
        AttitudeTable(ends, rotation.from_matrix(turned), np.eye(3)),
    )  # fmt: skip


def _drawn(
    rng: np.random.Generator, image: PushbroomImage, correction: OrientationCorrection | None, count: int
) -> tuple[Array, Array]:
    """Ground under places in the image and within its bounds, and anywhere on the body."""
    size = np.array([image.lines, image.samples])
    bounds = np.where(rng.random((count, 1)) < 0.7, 0.0, np.array([[0.5, 2.0]])) - 1e-3
    truth = rng.uniform(-bounds * size, (1.0 + bounds) * size)
    points, _ = image.image_to_ground(truth[:, 0], truth[:, 1], rng.uniform(-5e3, 9e3, count), correction)
    truth[np.isnan(points[:, 0])] = np.nan
    anywhere = np.flatnonzero(np.isnan(truth[:, 0]) | (rng.random(count) < 0.1))
    direction = rotation.unit_vectors(rng.standard_normal((anywhere.size, 3)))
    points[anywhere], truth[anywhere] = direction * image.body.equatorial, np.nan
    return points, truth


# --- the oracle


def scanned(drawn: Strip) -> tuple[Index, Array, Mask]:
    """Every place, as far as thousands of lines resolve them: number of the point, line and sample; and whether between
    it and another place of the point the camera stares at it, off by less than a hundredth of a pixel.
    """
    image, points = drawn.image, drawn.points
    table = np.linspace(-2.0 * image.samples, 3.0 * image.samples, 20001)
    curve, _ = image.interior.focal_plane(table)
    along = curve[-1] - curve[0]
    axes = np.array([[-along[1], along[0]], along]) / np.linalg.norm(along)
    across, way = axes @ curve.T

    def seen(lines: Array, which: Array | None = None) -> tuple[Array, Array, Array]:
        """w, how far along the detector, and depth, of all points at all lines or of one point at each line."""
        pose = image.pose(lines, drawn.correction)
        off = points[None] - pose.position[:, None] if which is None else points[which, None] - pose.position[:, None]
        ray = off @ pose.matrix.mT
        x, y = np.moveaxis(ray[..., :2] @ axes.T / ray[..., 2:], -1, 0)
        return x - np.interp(y, way, across), y, ray[..., 2]

    breaks = image.timing.first_lines[1:]
    lines = np.linspace(-0.5 * image.lines, 1.5 * image.lines, DENSE)
    lines = np.unique(np.concatenate([lines, breaks, np.nextafter(breaks, -np.inf)]))
    parts = [seen(part) for part in np.array_split(lines, 10)]
    w, _, depth = (np.concatenate(part) for part in zip(*parts, strict=True))
    changed = ((w[1:] > 0.0) != (w[:-1] > 0.0)) & (depth[1:] > 0.0) & (depth[:-1] > 0.0)
    changed[np.diff(lines) < 1e-6] = False
    k, which = np.nonzero(changed)
    low, high, above = lines[k], lines[k + 1], w[k, which] > 0.0
    for _ in range(52):
        middle = 0.5 * (low + high)
        same = (seen(middle, which)[0][:, 0] > 0.0) == above
        low, high = np.where(same, middle, low), np.where(same, high, middle)
    y = seen(low, which)[1][:, 0]
    order = np.lexsort([low, which])
    order = order[(y[order] > way[0]) & (y[order] < way[-1])]
    which, low, y = which[order], low[order], y[order]
    apart = np.abs(seen(0.5 * (low[1:] + low[:-1]), which[1:])[0][:, 0]) if low.size > 1 else np.zeros(0)
    stares = (np.diff(which) == 0) & (apart < 1e-2 * image.pixel_angle * image.interior.focal_length)
    stared = np.append(False, stares) | np.append(stares, False)
    return which, np.column_stack([low, np.interp(y, way, table)]), stared


def nearest(which: Index, lines: Array, others: Index, other_lines: Array) -> Array:
    """Lines from each place to the nearest of other ones of the same point; both by point and line."""
    far = 1e9
    keys, wanted = others * far + other_lines, which * far + lines
    at = np.searchsorted(keys, wanted)
    padded = np.concatenate([[-np.inf], keys, [np.inf]])
    return np.asarray(np.minimum(np.abs(padded[at] - wanted), np.abs(padded[at + 1] - wanted)))


def _twice_at_once(which: Index, lines: Array, length: int) -> Mask:
    """Places of a point, by point and line, less than a hundredth of the image from another one: outside the image a
    camera that hardly turns back may count as not seeing it.
    """
    gap = np.where(np.diff(which) == 0, np.diff(lines), np.inf)
    return np.minimum(np.append(np.inf, gap), np.append(gap, np.inf)) < 0.01 * length


def judge(drawn: Strip) -> tuple[int, int]:
    """Hold an image's sightings against the oracle; places, and points with several."""
    image, points = drawn.image, drawn.points
    found = image.sightings(points, drawn.correction)
    size, bounds = np.array([image.lines, image.samples]), np.array([0.5, 2.0])
    assert np.all((found.places >= -bounds * size) & (found.places <= (1.0 + bounds) * size))
    # they are places of the points: rays through them
    origins, directions = image.sightlines(found.places[:, 0], found.places[:, 1], drawn.correction)
    rays = points[found.point] - origins
    unit = rotation.unit_vectors(directions)
    depth = np.einsum("ni,ni->n", rays, unit)
    off = np.linalg.norm(rays - depth[:, None] * unit, axis=1) / depth / image.pixel_angle
    assert np.all(depth > 0.0)
    start, stop = image.trajectory.coverage
    times = image.timing.at(found.places[:, 0])[0]
    known = (times > start) & (times < stop)  # far beyond its table an attitude is no rotation to the last digit
    assert np.all(off < np.where(known, 1e-8 + 1e-9 / depth / image.pixel_angle, 0.1))
    np.testing.assert_array_equal(found.hidden, np.einsum("ni,ni->n", rays, points[found.point]) >= 0.0)
    # none is missing
    which, places, stared = scanned(drawn)
    clear = np.all((places > (-bounds + 1e-6) * size) & (places < (1.0 + bounds - 1e-6) * size), axis=1)
    missed = clear & (nearest(which, places[:, 0], found.point, found.places[:, 0]) > 1e-2)
    excused = _twice_at_once(which, places[:, 0], image.lines) & np.any((places < 0.0) | (places > size), axis=1)
    taken = image.timing.at(places[:, 0])[0]
    excused |= stared | (taken < image.trajectory.coverage[0]) | (taken > image.trajectory.coverage[1])
    missed &= ~excused
    assert not np.any(missed), f"{image.name}: {np.flatnonzero(missed)[:5]}"
    made = np.setdiff1d(np.flatnonzero(np.isfinite(drawn.truth[:, 0])), which[excused])
    assert np.all(nearest(made, drawn.truth[made, 0], found.point, found.places[:, 0]) < 1e-2)
    # none is too many, but pairs that the oracle's scan stepped over
    more = (nearest(found.point, found.places[:, 0], which, places[:, 0]) > 1e-2) & ~np.isin(found.point, which[stared])
    same = np.diff(found.point, prepend=-1, append=-1) == 0
    gap = np.diff(found.places[:, 0], prepend=-np.inf, append=np.inf)
    close = np.minimum(np.where(same[:-1], gap[:-1], np.inf), np.where(same[1:], gap[1:], np.inf))
    inner = np.all((found.places > (-bounds + 1e-6) * size) & (found.places < (1.0 + bounds - 1e-6) * size), axis=1)
    assert np.all(close[more & inner & known] < 2.0 * 2.0 * image.lines / DENSE), image.name
    chosen(drawn, found)
    return len(points), int(np.count_nonzero(np.bincount(found.point) > 1))


def chosen(drawn: Strip, found: Sightings) -> None:
    """`ground_to_image` follows its rule, with and without a start."""
    image, points = drawn.image, drawn.points
    start = np.random.default_rng(5).uniform(0.0, image.lines, len(points))
    start[::7] = np.nan
    several = np.flatnonzero(np.bincount(found.point, minlength=len(points)) > 1)[:200]
    alone = np.flatnonzero(np.bincount(found.point, minlength=len(points)) == 1)
    for given in (None, start):
        places, jacobian = image.ground_to_image(points, drawn.correction, given)
        np.testing.assert_array_equal(np.isnan(places[:, 0]), ~np.isin(np.arange(len(points)), found.point))
        mine = np.isin(found.point, alone)
        np.testing.assert_array_equal(places[alone], found.places[mine])
        np.testing.assert_array_equal(jacobian[alone], found.jacobian[mine])
        for i in several.tolist():
            mine = np.flatnonzero(found.point == i)
            keys = []
            for k in mine.tolist():
                line, sample = found.places[k].tolist()
                beside = max(0.0, -line / image.lines, line / image.lines - 1.0, -sample / image.samples,
                             sample / image.samples - 1.0)  # fmt: skip
                far = beside if given is None else 0.0 if np.isnan(given[i]) else abs(line - given[i])
                keys.append((bool(found.hidden[k]), round(far, 12), line, k))
            np.testing.assert_array_equal(places[i], found.places[min(keys)[-1]])


@pytest.mark.parametrize("seed", range(24))
def test_every_place_is_found_and_no_other(seed: int) -> None:
    judge(strip(seed, 60))


@pytest.mark.slow
def test_a_million_places() -> None:
    """Seeds that nothing was developed on."""
    judged = np.array([judge(strip(seed, 1000)) for seed in range(50_000, 51_000)])
    assert judged[:, 0].sum() == 1_000_000
    assert judged[:, 1].sum() > 10_000

"""Problems to measure with, all in the peer's model and file, so that the peer can run the same: its own sizes S, M, L
and XL by its generator, a chain of any size like them, and a block of the size of a Kaguya network.

Every coefficient and row is drawn from its stated sigma. Flat frame, X along the flight, Z up, metres (peer_problem).
"""

import importlib.util
import types
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from peer_problem import PeerProblem, Truth, line_motion, poses, project

from mgsgraph.errors import InputError
from mgsgraph.geometry.records import Array, Index
from mgsgraph.units import ARCMIN, DEG

PEER_SIZES = ("S", "M", "L", "XL")
SIZES = (*PEER_SIZES, "Kaguya")
SHARED = Path(__file__).resolve().parents[2] / "shared" / "peer"
"""Folder of the peer's generator."""
TREND = np.array([1.0, 0.1, 0.01])
"""A-priori sigmas of the terms 1, u, u^2, in those of the constant one."""
SHOTS, SHOT_PIXELS, SHOT_SIGMA = 125, 30.0, 10.0
"""Laser shots of an image of a chain; their image sigma in pixels; sigma of ranges and footprints in m."""
GUESS = 100.0
"""m, error of a tie point's first guess in each direction."""
KAGUYA = (375, 26_296, 127_782)
"""Images, points, measures of the Kaguya TC network that ISIS ships as its jigsaw example (bundleout of 2020)."""

_STEPS = 8
"""Newton's method on the line; quadratic from some hundred lines on."""
_MARGIN = 0.97
"""of the half length and width of an image, within which points may lie."""


@dataclass(frozen=True, slots=True)
class Camera:
    """A line camera over the plane."""

    focal_mm: float
    """mm."""
    pixel_mm: float
    """mm."""
    altitude: float
    """m."""
    half_length: float
    """m on the ground, half of an image along the flight."""
    position_sigma: float
    """m, a-priori, of the constant term at nadir."""
    angle_sigma: float
    """rad, the same."""

    @property
    def focal(self) -> float:
        """Pixels."""
        return self.focal_mm / self.pixel_mm


MOC = Camera(3437.4, 0.039, 380e3, 22e3, 100.0, 1.0 * ARCMIN)
"""As the peer's problems have it: MOC-NA, summing 3."""
TERRAIN_CAMERA = Camera(72.5, 0.007, 100e3, 48.28e3, 100.0, 3.0 * ARCMIN)
"""Kaguya's Terrain Camera (Haruyama et al. 2008): 7 micron pixels, 9.66 m on the ground, 10000 lines in an image."""


def made(size: str, shared: Path, seed: int | None = None) -> tuple[PeerProblem, Truth]:
    """The problem of a size, and its truth; InputError where the peer's generator is needed and missing."""
    if size == "Kaguya":
        return kaguya(0 if seed is None else seed)
    return peer_size(size, shared, seed)


# --- the peer's own sizes


def peer_size(size: str, shared: Path, seed: int | None = None) -> tuple[PeerProblem, Truth]:
    """A problem by the peer's generator; its own seed when None."""
    drawn, _ = peer_generator(shared).generate(size, seed)
    m = drawn["n_img"]
    fields = {
        "orientation": drawn["eo_prior"].reshape(m, 6, 3), "orientation_sigmas": drawn["eo_sigma"].reshape(m, 6, 3),
        "places": drawn["pt_init"], "ray_image": drawn["obs_img"], "ray_point": drawn["obs_pt"],
        "u": drawn["obs_u"], "y": drawn["obs_y"], "sigmas": drawn["obs_sigma"],
        "shot_point": drawn["mola_pt"], "shot_image": drawn["mola_img"], "shot_u": drawn["mola_u"],
        "ranges": drawn["mola_range"], "range_sigmas": drawn["mola_sr"],
        "footprints": drawn["mola_xyz"], "footprint_sigmas": drawn["mola_sxyz"],
    }  # fmt: skip
    problem = PeerProblem(f"peer's {size}", drawn["n_tie"], drawn["f_mm"], drawn["pix_mm"], **fields)
    return problem, Truth(drawn["eo_true"].reshape(m, 6, 3), drawn["pt_true"])


def peer_generator(shared: Path) -> types.ModuleType:
    """The module gen.py in the folder of the peer."""
    path = shared / "gen.py"
    spec = importlib.util.spec_from_file_location("peer_generator", path) if path.is_file() else None
    if spec is None or spec.loader is None:
        raise InputError(
            str(path), "no such file", "the peer's generator, which makes S, M, L and XL",
            "name its folder with --shared, or choose the size Kaguya",
        )  # fmt: skip
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    if not callable(getattr(module, "generate", None)):
        raise InputError(str(path), "no function 'generate'", "the peer's gen.py")
    return module


# --- our own


def relief(x: Array, y: Array) -> Array:
    """m, heights of the ground at places (n,) in m: hills of 200 m over 9 km, rough ones of 40 m over 1 km."""
    broad = 200.0 * np.sin(2.0 * np.pi * x / 9e3 + 1.0) * np.cos(2.0 * np.pi * y / 11e3)
    return np.asarray(broad + 40.0 * np.sin(2.0 * np.pi * (x + y) / 1.3e3) + 15.0 * np.cos(2.0 * np.pi * y / 700.0))


def flown(
    camera: Camera, centres: Array, roll: Array, pitch: Array, rng: np.random.Generator
) -> tuple[Array, Array, Array]:
    """True and a-priori orientation of images and its sigmas, all (m, 6, 3).

    `centres` (m, 2) in m is where the middle of each image looks, `roll` and `pitch` (m,) in rad how it is meant to;
    sigmas grow with the tilt, twice at 20 degrees.
    """
    m = roll.size
    truth = np.zeros((m, 6, 3))
    truth[:, 3:, 0] = np.column_stack([roll, pitch, np.zeros(m)]) + rng.normal(0.0, 2.0 * ARCMIN, (m, 3))
    truth[:, 3:, 1] = rng.normal(0.0, 0.3 * ARCMIN, (m, 3))
    truth[:, 3:, 2] = rng.normal(0.0, 0.03 * ARCMIN, (m, 3))
    height = camera.altitude * (1.0 + rng.normal(0.0, 1e-3, m))
    up = poses(truth, np.arange(m), np.zeros(m))[1][:, 2]
    truth[:, :2, 0] = centres + up[:, :2] * (height / up[:, 2])[:, None]
    truth[:, 2, 0] = height
    truth[:, 0, 1] = camera.half_length * (1.0 + rng.normal(0.0, 5e-4, m))
    truth[:, 1:3, 1] = rng.normal(0.0, 2.5e-3 * camera.half_length, (m, 2))
    truth[:, :3, 2] = rng.normal(0.0, 2e-4 * camera.half_length, (m, 3))
    sigmas = np.empty((m, 6, 3))
    sigmas[:, :3], sigmas[:, 3:] = camera.position_sigma * TREND, camera.angle_sigma * TREND
    sigmas *= (1.0 + np.hypot(roll, pitch) / (20.0 * DEG))[:, None, None]
    return truth, truth + sigmas * rng.standard_normal(sigmas.shape), sigmas


def measured(
    camera: Camera, truth: Truth, image: Index, point: Index, sigmas: Array, rng: np.random.Generator
) -> tuple[Array, Array]:
    """Measured line u (k,) and sample y (k,) of rays; the line's noise moves the point's image by sigma pixels."""
    places = truth.places[point]
    u = np.zeros(image.size)
    for _ in range(_STEPS):
        along = project(truth.orientation, image, u, places, camera.focal)[0][:, 0]
        u -= along / line_motion(truth.orientation, image, u, places, camera.focal)
    u += sigmas / np.abs(line_motion(truth.orientation, image, u, places, camera.focal)) * rng.standard_normal(u.size)
    across = project(truth.orientation, image, u, places, camera.focal)[0][:, 1]
    return u, -across + sigmas * rng.standard_normal(u.size)


def chain(images: int, ties: int, seed: int = 0, shots: int = SHOTS) -> tuple[PeerProblem, Truth]:
    """A chain like the peer's, of any size.

    Pairs of a nadir and an off-nadir image (18 .. 22 degrees, to alternate sides), strips 44 km long, pairs half a
    strip apart; a tie point is seen by an image and the next, every third one by the one after it, too; laser shots
    along the middle of each image, measured in it and in the other image of its pair, where it has one.
    """
    if images < 2 or ties < 2 or shots < 0:
        raise InputError("chain", f"{images} images, {ties} ties, {shots} shots", "at least 2, 2 and 0")
    rng = np.random.default_rng([seed, images, ties, shots])
    pair = np.arange(images) // 2
    x = MOC.half_length * pair
    tilt = rng.uniform(18.0, 22.0, images) * DEG * np.where(pair % 2 == 0, 1.0, -1.0)
    roll = np.where(np.arange(images) % 2 == 1, tilt, 0.0)
    orientation, prior, sigmas = flown(MOC, np.column_stack([x, np.zeros(images)]), roll, np.zeros(images), rng)
    first = rng.integers(0, images - 1, ties)
    views = 2 + ((rng.random(ties) < 1.0 / 3.0) & (first < images - 2)).astype(np.int64)
    reach = _MARGIN * MOC.half_length
    low, high = x[first + views - 1] - reach, x[first] + reach
    owner = np.repeat(np.arange(images), shots)
    spread = np.linspace(-0.93, 0.93, shots) * MOC.half_length
    along = np.concatenate([low + (high - low) * rng.random(ties), (x[:, None] + spread).ravel()])
    across = np.concatenate([rng.uniform(-1700.0, 1700.0, ties), rng.uniform(-150.0, 150.0, owner.size)])
    truth = Truth(orientation, np.column_stack([along, across, relief(along, across)]))
    image = np.concatenate([np.repeat(first, views) + _within(views), np.column_stack([owner, owner ^ 1]).ravel()])
    point = np.concatenate([np.repeat(np.arange(ties), views), np.repeat(ties + np.arange(owner.size), 2)])
    exists = image < images  # the last image of an odd number has no partner
    return drawn(f"chain of {images} images", MOC, truth, prior, sigmas, ties, image[exists], point[exists], owner, rng)


def _within(counts: Index) -> Index:
    """0, 1, .. within each run of `counts` rays."""
    return np.asarray(np.arange(counts.sum()) - np.repeat(np.cumsum(counts) - counts, counts))


def kaguya(seed: int = 0) -> tuple[PeerProblem, Truth]:
    """A block of the size of the Kaguya TC network in `KAGUYA`: 375 images, 26,296 points, 127,782 measures.

    25 orbits side by side, 12 km apart, swaths 34 km wide: a place is seen from two or three orbits. On each 15 images
    of 96.6 km along the flight: eight by the camera that looks 15 degrees ahead, 90 km apart, so that they overlap by
    some km, and seven by the one that looks 15 degrees back, half a step further on. A place well inside is seen five
    times, at most nine; ties lie anywhere, and lose a ray in ten or so by chance, as a matcher would, but each keeps
    two from different orbits or cameras. The sets of images that see a point are therefore many: about five thousand.
    No laser: the a-priori orientation alone holds the datum.
    """
    rng = np.random.default_rng([seed, *KAGUYA])
    images, points, measures = KAGUYA
    orbit, number = np.divmod(np.arange(images), 15)
    x, y = 45e3 * number, 12e3 * orbit.astype(np.float64)
    pitch = np.where(number % 2 == 0, 15.0, -15.0) * DEG
    camera = TERRAIN_CAMERA
    orientation, prior, sigmas = flown(camera, np.column_stack([x, y]), np.zeros(images), pitch, rng)
    half = np.array([_MARGIN * camera.half_length, 17e3])
    low, high = np.array([x.min(), y.min()]) - half, np.array([x.max(), y.max()]) + half
    candidates = low + (high - low) * rng.random((2 * points, 2))
    inside = (np.abs(candidates[:, None, 0] - x) < half[0]) & (np.abs(candidates[:, None, 1] - y) < half[1])
    views = 2 * orbit + number % 2  # two images of one view see a place along the same ray
    seen_from = np.array([inside[:, views == view].any(axis=1) for view in range(50)])
    chosen = np.flatnonzero(seen_from.sum(axis=0) >= 2)[:points]
    point, image = np.nonzero(inside[chosen])
    rays = _thinned(point, views[image], measures, rng)
    ground = candidates[chosen]
    truth = Truth(orientation, np.column_stack([ground, relief(*ground.T)]))
    none = np.zeros(0, dtype=np.int64)
    return drawn("Kaguya-sized block", camera, truth, prior, sigmas, points, image[rays], point[rays], none, rng)


def _thinned(point: Index, view: Index, count: int, rng: np.random.Generator) -> Index:
    """`count` of the rays of points (k,) in views (k,), in order; each point keeps two, of two views if it has them."""
    chance = rng.random(point.size)
    by_view = np.lexsort((chance, view, point))
    repeat = np.empty_like(point)  # first, second .. ray of its point in this view
    repeat[by_view] = _within(np.unique(np.stack([point, view], axis=1)[by_view], axis=0, return_counts=True)[1])
    order = np.lexsort((chance, repeat, point))
    spare = order[_within(np.bincount(point)) >= 2]
    dropped = point.size - count
    if not 0 <= dropped <= spare.size:
        raise InputError("Kaguya-sized block", f"{point.size} rays, {spare.size} to spare", f"{count} measures")
    return np.setdiff1d(np.arange(point.size), rng.choice(spare, dropped, replace=False))


def drawn(
    name: str, camera: Camera, truth: Truth, prior: Array, sigmas: Array, ties: int, image: Index, point: Index,
    owner: Index, rng: np.random.Generator,
) -> tuple[PeerProblem, Truth]:  # fmt: skip
    """Observations of a truth: rays sorted by point, ties first; a shot's ray in its own image comes first."""
    pixels = np.where(point < ties, 1.0, SHOT_PIXELS)
    u, y = measured(camera, truth, image, point, pixels, rng)
    shot = ties + np.arange(owner.size)
    at = np.searchsorted(point, shot)
    distance = project(truth.orientation, owner, u[at], truth.places[shot], camera.focal)[1]
    footprints = truth.places[shot] + rng.normal(0.0, SHOT_SIGMA, (owner.size, 3))
    guess = truth.places[:ties] + rng.normal(0.0, GUESS, (ties, 3))
    fields: dict[str, Any] = {
        "orientation": prior, "orientation_sigmas": sigmas, "places": np.concatenate([guess, footprints]),
        "ray_image": image, "ray_point": point, "u": u, "y": y, "sigmas": pixels,
        "shot_point": shot, "shot_image": owner, "shot_u": u[at],
        "ranges": distance + rng.normal(0.0, SHOT_SIGMA, owner.size), "range_sigmas": np.full(owner.size, SHOT_SIGMA),
        "footprints": footprints, "footprint_sigmas": np.full((owner.size, 3), SHOT_SIGMA),
    }  # fmt: skip
    return PeerProblem(name, ties, camera.focal_mm, camera.pixel_mm, **fields), truth

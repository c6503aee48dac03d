"""Problems of the C++ peer (bundle adjustment by polynomials, README of shared/peer): its files, residuals, networks.

The peer works in a flat local frame: X along the flight, Z up, metres. Orientation of an image: X, Y, Z, omega, phi,
kappa as polynomials of order 2 of the normalised line u; M = R3(kappa) R2(phi) R1(omega) takes the frame to the camera,
whose Z axis points UP, away from the ground: with (a, b, c) = M (P - C), c is negative for all that is seen. Its
residuals, in pixels over sigma: line f a / c, sample y + f b / c, f in pixels, y the measured sample.

Here camera +Z comes out of the lens, so the camera is the peer's turned by half a turn about x: diag(1, -1, -1) M,
which is R3(-kappa) R2(-phi) R1(omega + pi). Then (a, b, c) becomes (a, -b, -c): line f a / c changes its sign, f b / c
stays, and samples count against camera y. What is added to (omega, phi, kappa) here is added to (omega, -phi, -kappa)
there (FROM_PEER). Residuals are the peer's, but for the sign of the lines.
"""

import struct
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mgsgraph.adjustment.settings import Line, SolverSettings
from mgsgraph.errors import InputError
from mgsgraph.files.networks.tie_points import PointKind
from mgsgraph.files.writing import fresh_file
from mgsgraph.geometry import rotation
from mgsgraph.geometry.body import Ellipsoid
from mgsgraph.geometry.camera import InteriorOrientation, NoDistortion
from mgsgraph.geometry.image import LineTiming, PolynomialTrajectory, PushbroomImage
from mgsgraph.geometry.orientation import OrientationPrior
from mgsgraph.geometry.records import Array, Index, assign, frozen, frozen_index
from mgsgraph.network import GroundPoints, ImageRays, Network, PointClass, Ranges
from mgsgraph.units import MM

LINES, SAMPLES = 10000, 1024
"""Of every image: the peer's strips have so many lines; samples only say where the principal point is."""
FROM_PEER = np.array([1.0, 1.0, 1.0, 1.0, -1.0, -1.0])
"""Signs of X, Y, Z, omega, phi, kappa: a correction of the peer's orientation times these is one of ours."""
PLANE = Ellipsoid(equatorial=1e9, polar=1.0)
"""m: body of the flat frame, a disc as good as a plane; it only says where a ray without a partner ends."""
FARTHEST = 1.5
"""Normalised lines beyond this lie half an image away from it: not a measure, but a damaged file."""

_MAGIC = b"PEERBA01"
_HEADER = struct.Struct("<8s5q2d")
_STEP = 1e-4
"""of u, for the derivative of the line residual: central differences, exact to 1e-8 of it."""


@dataclass(frozen=True, slots=True, eq=False)
class PeerProblem:
    """One problem, as the peer's file holds it: m images, n points, k rays, r laser shots."""

    source: str
    """File it comes from, for messages."""
    ties: int
    """Number of tie points; they come first."""
    focal_mm: float
    """mm, focal length."""
    pixel_mm: float
    """mm."""
    orientation: Array
    """(m, 6, 3) a-priori X, Y, Z (m), omega, phi, kappa (rad): coefficients of 1, u, u^2."""
    orientation_sigmas: Array
    """(m, 6, 3) of them, m and rad."""
    places: Array
    """(n, 3) m, first guess of the points."""
    ray_image: Index
    """(k,)"""
    ray_point: Index
    """(k,)"""
    u: Array
    """(k,) measured normalised line."""
    y: Array
    """(k,) pixels, measured sample from the principal point."""
    sigmas: Array
    """(k,) pixels, of both line and sample."""
    shot_point: Index
    """(r,) point of each shot, no point twice."""
    shot_image: Index
    """(r,) image taken along with it."""
    shot_u: Array
    """(r,) its normalised line."""
    ranges: Array
    """(r,) m."""
    range_sigmas: Array
    """(r,) m."""
    footprints: Array
    """(r, 3) m."""
    footprint_sigmas: Array
    """(r, 3) m."""

    def __post_init__(self) -> None:
        m, n, k, r = (np.shape(array)[0] for array in (self.orientation, self.places, self.ray_image, self.shot_point))
        for quantity, value, unit in (("focal length", self.focal_mm, "mm"), ("pixel", self.pixel_mm, "mm")):
            if not (np.isfinite(value) and value > 0.0):
                raise InputError(f"{self.source}, {quantity}", f"{value} {unit}", "a positive number")
        if not (m > 0 and n > 0 and 0 <= self.ties <= n):
            raise InputError(self.source, f"{m} images, {n} points, {self.ties} of them ties", "some of each")
        shapes = {
            "orientation": (m, 6, 3), "orientation_sigmas": (m, 6, 3), "places": (n, 3), "u": (k,), "y": (k,),
            "sigmas": (k,), "shot_u": (r,), "ranges": (r,), "range_sigmas": (r,), "footprints": (r, 3),
            "footprint_sigmas": (r, 3),
        }  # fmt: skip
        checked = {name: frozen(getattr(self, name), f"{self.source}, {name}", shape) for name, shape in shapes.items()}
        indices = {"ray_image": (k, m), "ray_point": (k, n), "shot_image": (r, m), "shot_point": (r, n)}
        assign(self, **checked)
        for name, (size, upper) in indices.items():
            assign(self, **{name: frozen_index(getattr(self, name), f"{self.source}, {name}", size, upper)})
        for name in ("orientation_sigmas", "sigmas", "ranges", "range_sigmas", "footprint_sigmas"):
            if checked[name].size and checked[name].min() <= 0.0:
                raise InputError(f"{self.source}, {name}", f"{checked[name].min()}", "positive numbers")
        for name in ("u", "shot_u"):
            if np.abs(checked[name]).max(initial=0.0) > FARTHEST:
                found = f"normalised line {checked[name][np.argmax(np.abs(checked[name]))]}"
                raise InputError(f"{self.source}, {name}", found, f"-{FARTHEST} .. {FARTHEST}")
        for i in np.flatnonzero(np.bincount(self.shot_point, minlength=n) > 1)[:1]:
            raise InputError(f"{self.source}, point {i}", "two laser shots", "one at most")

    @property
    def focal(self) -> float:
        """Pixels, focal length."""
        return self.focal_mm / self.pixel_mm

    def __repr__(self) -> str:
        return (
            f"PeerProblem({self.orientation.shape[0]} images, {self.places.shape[0]} points ({self.ties} ties), "
            f"{self.u.size} rays, {self.ranges.size} shots, from {self.source})"
        )


@dataclass(frozen=True, slots=True, eq=False)
class Truth:
    """What a generated problem was drawn from."""

    orientation: Array
    """(m, 6, 3) m and rad."""
    places: Array
    """(n, 3) m."""


# --- the file


def _sections(images: int, points: int, rays: int, shots: int) -> Iterator[tuple[str, str, tuple[int, ...]]]:
    """Field, number format and shape of each array of a file, in its order."""
    yield "orientation", "<f8", (images, 6, 3)
    yield "orientation_sigmas", "<f8", (images, 6, 3)
    yield "places", "<f8", (points, 3)
    yield "ray_image", "<i4", (rays,)
    yield "ray_point", "<i4", (rays,)
    for name in ("u", "y", "sigmas"):
        yield name, "<f8", (rays,)
    yield "shot_point", "<i4", (shots,)
    yield "shot_image", "<i4", (shots,)
    for name in ("shot_u", "ranges", "range_sigmas"):
        yield name, "<f8", (shots,)
    yield "footprints", "<f8", (shots, 3)
    yield "footprint_sigmas", "<f8", (shots, 3)


def read_problem(path: str | Path) -> PeerProblem:
    """Read a file of the peer's format; InputError for another format, a truncated file or impossible values."""
    path = Path(path)
    try:
        data = path.read_bytes()
    except OSError as error:
        raise InputError(str(path), f"can't be read ({error.strerror or error})") from None
    if len(data) < _HEADER.size or not data.startswith(_MAGIC):
        raise InputError(str(path), f"{data[:8]!r} at its head", f"{_MAGIC!r}", "give a problem file of the peer")
    _, images, points, rays, shots, ties, focal_mm, pixel_mm = _HEADER.unpack_from(data)
    if min(images, points, rays, shots, ties) < 0:
        raise InputError(str(path), "a negative number of images, points, rays, shots or ties")
    sections = list(_sections(images, points, rays, shots))
    size = _HEADER.size + sum(int(kind[2]) * _count(shape) for _, kind, shape in sections)
    if size != len(data):
        found = f"{images} images, {points} points, {rays} rays, {shots} shots in {len(data)} bytes"
        raise InputError(str(path), found, f"{size} bytes", "the file is cut short or damaged; make it anew")
    arrays, place = {}, _HEADER.size
    for name, kind, shape in sections:
        arrays[name] = np.frombuffer(data, kind, _count(shape), place).reshape(shape)
        place += arrays[name].nbytes
    return PeerProblem(str(path), ties, focal_mm, pixel_mm, **arrays)


def _count(shape: tuple[int, ...]) -> int:
    """Numbers in an array; Python's own integers, since a damaged header may promise any number."""
    product = 1
    for size in shape:
        product *= size
    return product


def write_problem(problem: PeerProblem, path: str | Path) -> None:
    """Write a problem in the peer's format, atomically."""
    path = Path(path)
    images, points, rays, shots = (
        array.shape[0] for array in (problem.orientation, problem.places, problem.u, problem.ranges)
    )
    head = (_MAGIC, images, points, rays, shots, problem.ties, problem.focal_mm, problem.pixel_mm)
    with fresh_file(path) as temporary, temporary.open("wb") as file:
        file.write(_HEADER.pack(*head))
        for name, kind, _ in _sections(images, points, rays, shots):
            file.write(np.ascontiguousarray(getattr(problem, name), kind).tobytes())


# --- the peer's equations


def poses(orientation: Array, image: Index, u: Array) -> tuple[Array, Array]:
    """Perspective centres (k, 3) in m and M (k, 3, 3) of images (k,) at u (k,), from orientations (m, 6, 3)."""
    powers = np.stack([np.ones_like(u), u, u * u], axis=1)
    element = np.einsum("kij,kj->ki", orientation[image], powers)
    # from_omega_phi_kappa gives the papers' matrix, which is the transpose of the product R3 R2 R1
    return element[:, :3], rotation.from_omega_phi_kappa(element[:, 3:]).mT


def project(orientation: Array, image: Index, u: Array, places: Array, focal: float) -> tuple[Array, Array]:
    """Focal-plane places (k, 2) in pixels, f a / c and f b / c, and distances (k,) in m of points (k, 3) at u (k,)."""
    centre, matrix = poses(orientation, image, u)
    ray = np.einsum("kij,kj->ki", matrix, places - centre)
    return focal * ray[:, :2] / ray[:, 2:], np.linalg.norm(places - centre, axis=1)


def line_motion(orientation: Array, image: Index, u: Array, places: Array, focal: float) -> Array:
    """(k,) pixels: derivative of f a / c by u."""
    ahead, behind = (project(orientation, image, u + step, places, focal)[0][:, 0] for step in (_STEP, -_STEP))
    return np.asarray((ahead - behind) / (2.0 * _STEP))


def residuals(problem: PeerProblem, orientation: Array, places: Array) -> dict[str, Array]:
    """The peer's residuals over sigma: image (k, 2), range (r,), ground (r, 3), prior (m, 6, 3)."""
    image, _ = project(orientation, problem.ray_image, problem.u, places[problem.ray_point], problem.focal)
    image[:, 1] += problem.y
    shot = places[problem.shot_point]
    _, distance = project(orientation, problem.shot_image, problem.shot_u, shot, problem.focal)
    return {
        "image": image / problem.sigmas[:, None],
        "range": (problem.ranges - distance) / problem.range_sigmas,
        "ground": (shot - problem.footprints) / problem.footprint_sigmas,
        "prior": (orientation - problem.orientation) / problem.orientation_sigmas,
    }


def cost(problem: PeerProblem, orientation: Array, places: Array) -> float:
    """Half the sum of squares of all residuals."""
    return 0.5 * sum(float(np.vdot(values, values)) for values in residuals(problem, orientation, places).values())


# --- the same as a network


class PeerTrajectory(PolynomialTrajectory):
    """Polynomials of omega, phi, kappa in the peer's product: M = R3 R2 R1 takes body-fixed to camera, not back."""

    __slots__ = ()
    paper = False


def network(problem: PeerProblem, line: Line) -> tuple[Network, SolverSettings]:
    """The problem as this program adjusts it.

    Parameters
    ----------
    problem : PeerProblem
    line : str
        "measured" is the peer's own form: sigmas in pixels for line and sample. "predicted" is the strict one: sigma of
        the line in lines, so many that its image moves by sigma pixels (as `gen.py` draws them).

    Returns
    -------
    network : Network
        Points with a laser shot are constrained by its footprint, the others free.
    settings : SolverSettings
        Angles as the peer has them, and its tolerance.
    """
    m, n = problem.orientation.shape[0], problem.places.shape[0]
    time = LineTiming(np.zeros(1), np.array([-1.0]), np.array([2.0 / LINES]))
    images = tuple(
        PushbroomImage(f"image {j}", LINES, SAMPLES, interior(problem), time, trajectory(problem, j), PLANE)
        for j in range(m)
    )
    priors = tuple(OrientationPrior(sigmas.T) for sigmas in problem.orientation_sigmas)
    held = np.zeros(m, dtype=bool)
    rays = image_rays(problem, line)
    ranges = Ranges(problem.shot_point, problem.shot_image, problem.shot_u, problem.ranges, problem.range_sigmas)
    block = Network(images, priors, held, ground_points(problem, n), rays, ranges)
    return block, SolverSettings(line=line, angles="opk-peer", cost_tolerance=1e-10)


def interior(problem: PeerProblem) -> InteriorOrientation:
    """An ideal camera; its lines count along camera x, its samples against camera y."""
    per_metre = 1.0 / (problem.pixel_mm * MM)
    to_pixel = np.array([[0.0, per_metre, 0.0], [0.0, 0.0, -per_metre]])
    centre = np.array([0.0, 0.5 * SAMPLES])
    return InteriorOrientation(problem.focal_mm * MM, to_pixel, centre, np.zeros(2), 1.0, NoDistortion())


def trajectory(problem: PeerProblem, image: int) -> PeerTrajectory:
    """A-priori orientation of one image; its time is u, in seconds."""
    coefficients = (FROM_PEER[:, None] * problem.orientation[image]).T
    coefficients[0, 3] += np.pi
    return PeerTrajectory(0.0, -1.0, 1.0, coefficients[:, :3], coefficients[:, 3:])


def image_rays(problem: PeerProblem, line: Line) -> ImageRays:
    """Measured lines and samples with their sigmas."""
    places = np.column_stack([0.5 * LINES * (problem.u + 1.0), problem.y + 0.5 * SAMPLES])
    sigmas = np.column_stack([problem.sigmas, problem.sigmas])
    if line == "predicted":
        guess = problem.places[problem.ray_point]
        motion = line_motion(problem.orientation, problem.ray_image, problem.u, guess, problem.focal) * 2.0 / LINES
        for k in np.flatnonzero(~(np.abs(motion) > 0.0))[:1]:
            where = f"{problem.source}, point {problem.ray_point[k]}, image {problem.ray_image[k]}"
            raise InputError(where, "an image that stands still from line to line", "a flight")
        sigmas[:, 0] /= np.abs(motion)
    return ImageRays(problem.ray_point, problem.ray_image, places, sigmas)


def ground_points(problem: PeerProblem, count: int) -> GroundPoints:
    """Ties with a first guess, and footprints with their sigmas."""
    classes = np.full(count, PointClass.TIE, dtype=np.int64)
    kinds = np.full(count, PointKind.FREE, dtype=np.int64)
    places, covariances = problem.places.copy(), np.zeros((count, 3, 3))
    classes[problem.shot_point], kinds[problem.shot_point] = PointClass.LASER, PointKind.CONSTRAINED
    places[problem.shot_point] = problem.footprints
    covariances[problem.shot_point] = problem.footprint_sigmas[:, :, None] ** 2 * np.eye(3)
    return GroundPoints(tuple(map(str, range(count))), classes, kinds, places, covariances)


def peer_orientation(problem: PeerProblem, coefficients: tuple[NDArray[np.float64], ...]) -> Array:
    """(m, 6, 3) orientation in the peer's terms, of corrections (3, 6) of each image as a solution holds them."""
    corrections = np.array(coefficients).mT * FROM_PEER[:, None]
    return np.asarray(problem.orientation + corrections)

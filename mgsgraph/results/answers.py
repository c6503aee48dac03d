"""Questions to the posterior as a person asks them, and its answers in words and as JSON; km and degrees only here."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from mgsgraph.adjustment.datum.frames import FLIGHT_NAMES
from mgsgraph.analysis.estimates import (
    Difference,
    ErrorEllipsoid,
    Estimate,
    PixelEstimate,
    PoseEstimate,
    PositionEstimate,
    Quantity,
)
from mgsgraph.analysis.posterior import Pixel, Posterior
from mgsgraph.errors import InputError
from mgsgraph.geometry.body import planetocentric
from mgsgraph.geometry.records import Array
from mgsgraph.units import DEG, MRAD

_UNITS = np.array([1.0, 1.0, 1.0, MRAD, MRAD, MRAD])
_MOST_SHOWN = 12
"""Rows of a correlation matrix that are printed; the file has all."""


@dataclass(frozen=True, slots=True)
class Questions:
    """What is asked; names as in the solution, lines and samples in pixels."""

    points: tuple[str, ...] = ()
    """Ground points."""
    pairs: tuple[tuple[str, str], ...] = ()
    """Pairs of ground points: is the height difference real?"""
    poses: tuple[tuple[str, float], ...] = ()
    """Image and line."""
    pose_pairs: tuple[tuple[str, float, str, float], ...] = ()
    """Image and line, other image and line: how well is the one known against the other?"""
    projections: tuple[tuple[str, str], ...] = ()
    """Ground point and image."""
    pixels: tuple[Pixel, ...] = ()
    """Measures of one new point, to be intersected."""
    correlations: bool = False
    """Whether to state the correlations between everything that was asked."""
    probability: float = 0.95
    """Of error ellipsoids."""

    def __post_init__(self) -> None:
        if not 0.0 < self.probability < 1.0:
            raise InputError("--probability", f"{self.probability}", "a number between 0 and 1")

    def __bool__(self) -> bool:
        return bool(self.points or self.pairs or self.poses or self.pose_pairs or self.projections or self.pixels)


@dataclass(frozen=True, slots=True)
class Answer:
    """What is said of one question to the covariance."""

    text: str
    """Lines for a person."""
    record: dict[str, Any]
    """The answer as JSON, with the unit in each key."""


def answered(posterior: Posterior, asked: Questions) -> Iterator[Answer]:
    """Answers in the order of the questions' kinds; InputError where something asked about isn't in the solution."""
    for name in asked.points:
        yield _place(posterior.point(name), asked.probability, "point")
    for first, second in asked.pairs:
        yield _difference(posterior.difference(first, second))
    for image, line in asked.poses:
        yield _pose(posterior.pose(image, line))
    for pair in asked.pose_pairs:
        yield _pose_pair(posterior, *pair)
    for point, image in asked.projections:
        yield _pixel(posterior.projection(point, image))
    if asked.pixels:
        yield _place(posterior.intersection(asked.pixels), asked.probability, "intersection")
    if asked.correlations:
        yield _correlations(posterior.joint(list(_quantities(posterior, asked))))


def _quantities(posterior: Posterior, asked: Questions) -> Iterator[Quantity]:
    """Everything that was asked about, once."""
    names = dict.fromkeys([*asked.points, *(name for pair in asked.pairs for name in pair)])
    poses = [*asked.poses, *(part for pair in asked.pose_pairs for part in (pair[:2], pair[2:]))]
    yield from (posterior.of_point(name) for name in names)
    yield from (posterior.of_pose(image, line) for image, line in dict.fromkeys(poses))
    yield from (posterior.of_projection(point, image) for point, image in dict.fromkeys(asked.projections))
    if asked.pixels:
        yield posterior.of_intersection(asked.pixels)


def _place(found: PositionEstimate, probability: float, what: str) -> Answer:
    longitude, latitude, radius = planetocentric(found.position)
    ellipsoid, local = found.ellipsoid(probability), np.sqrt(np.diagonal(found.east_north_up))
    title = "Newly intersected place" if what == "intersection" else f"Point {found.name}"
    missed = "" if found.misfit is None else f"\n  the rays miss each other by {found.misfit:.2g} of their sigmas"
    text = (
        f"{title}: longitude {longitude / DEG % 360.0:.6f} deg E, latitude {latitude / DEG:.6f} deg (planetocentric), "
        f"radius {radius:.3f} m\n"
        f"  sigma east {local[0]:.4g} m, north {local[1]:.4g} m, up {local[2]:.4g} m; "
        f"X {found.sigmas[0]:.4g} m, Y {found.sigmas[1]:.4g} m, Z {found.sigmas[2]:.4g} m\n"
        f"  {100.0 * probability:g} % error ellipsoid: {_axes(ellipsoid)}{missed}"
    )
    return Answer(text, {
        "question": what, "point": found.name, "place_m": found.position.tolist(),
        "longitude_deg": longitude / DEG % 360.0, "latitude_deg": latitude / DEG, "radius_m": radius,
        "covariance_m2": found.covariance.tolist(), "covariance_east_north_up_m2": found.east_north_up.tolist(),
        "misfit_sigmas": found.misfit, "ellipsoid": {
            "probability": probability, "semi_axes_m": ellipsoid.semi_axes.tolist(),
            "azimuths_deg": (ellipsoid.azimuths / DEG).tolist(),
            "elevations_deg": (ellipsoid.elevations / DEG).tolist(),
        },
    })  # fmt: skip


def _axes(ellipsoid: ErrorEllipsoid) -> str:
    axes = zip(ellipsoid.semi_axes, ellipsoid.azimuths / DEG, ellipsoid.elevations / DEG, strict=True)
    return ", ".join(f"{size:.4g} m (azimuth {azimuth:.0f}, elevation {up:.0f} deg)" for size, azimuth, up in axes)


def _difference(found: Difference) -> Answer:
    text = (
        f"{found.sentence}\n"
        f"  distance {found.distance:.3f} m, sigma {found.distance_sigma:.4g} m; sigma of the vector east, north, up "
        f"{', '.join(f'{sigma:.4g}' for sigma in np.sqrt(np.diagonal(found.east_north_up)))} m"
    )
    return Answer(text, {
        "question": "pair", "points": [found.first, found.second], "height_difference_m": found.height,
        "height_sigma_m": found.height_sigma, "height_sigma_if_independent_m": found.height_sigma_if_independent,
        "chance": found.chance, "distance_m": found.distance, "distance_sigma_m": found.distance_sigma,
        "covariance_m2": found.joint.tolist(),
    })  # fmt: skip


def _flight(covariance: Array) -> str:
    sigmas = np.sqrt(np.maximum(np.diagonal(covariance), 0.0)) / _UNITS
    parts = [f"{name} {sigma:.4g}" for name, sigma in zip(FLIGHT_NAMES, sigmas, strict=True)]
    return f"sigma {', '.join(parts[:3])} m; {', '.join(parts[3:])} mrad"


def _pose(found: PoseEstimate) -> Answer:
    body = np.sqrt(np.maximum(np.diagonal(found.covariance)[:3], 0.0))
    text = (
        f"Image {found.image} at line {found.line:g}: {_flight(found.flight)}\n"
        f"  sigma X {body[0]:.4g}, Y {body[1]:.4g}, Z {body[2]:.4g} m (body-fixed)"
    )
    return Answer(text, {
        "question": "pose", "image": found.image, "line": found.line, "position_m": found.position.tolist(),
        "matrix_body_to_camera": found.matrix.tolist(), "covariance_m_rad": found.covariance.tolist(),
        "flight_axes": list(FLIGHT_NAMES), "flight_covariance_m_rad": found.flight.tolist(),
    })  # fmt: skip


def _pose_pair(posterior: Posterior, image: str, line: float, other: str, other_line: float) -> Answer:
    if (image, line) == (other, other_line):
        raise InputError(f"poses of image {image}", f"line {line:g} twice", "two images, or two lines of one")
    poses = posterior.pose(image, line), posterior.pose(other, other_line)
    turns = [pose.flight_turn for pose in poses]
    both = np.zeros((12, 12))
    both[:6, :6], both[6:, 6:] = turns
    joint = posterior.covariance([posterior.of_pose(image, line), posterior.of_pose(other, other_line)])
    joint = both @ joint @ both.T
    apart = np.hstack([-np.eye(6), np.eye(6)])
    difference = apart @ joint @ apart.T
    sigmas = np.sqrt(np.maximum(np.diagonal(joint), 1e-300))
    shared = np.diagonal(joint[:6, 6:]) / (sigmas[:6] * sigmas[6:])
    text = (
        f"Image {other} at line {other_line:g} against {image} at line {line:g}, each along its own flight axes:\n"
        f"  difference: {_flight(difference)}\n"
        f"  correlation {', '.join(f'{name} {value:.3f}' for name, value in zip(FLIGHT_NAMES, shared, strict=True))}"
    )
    return Answer(text, {
        "question": "poses", "images": [image, other], "lines": [line, other_line], "flight_axes": list(FLIGHT_NAMES),
        "joint_flight_covariance_m_rad": joint.tolist(), "correlation": shared.tolist(),
    })  # fmt: skip


def _pixel(found: PixelEstimate) -> Answer:
    line, sample = found.sigmas
    rho = found.covariance[0, 1] / (line * sample) if line * sample > 0.0 else 0.0
    text = (
        f"Point {found.point} in image {found.image}: line {found.pixel[0]:.2f}, sigma {line:.4g} px; sample "
        f"{found.pixel[1]:.2f}, sigma {sample:.4g} px; correlation {rho:.3f} (of the place itself, without the noise "
        "of a measure; the first pixel's centre is at 0.5)"
    )
    return Answer(text, {
        "question": "projection", "point": found.point, "image": found.image, "line_sample_px": found.pixel.tolist(),
        "covariance_px2": found.covariance.tolist(),
    })  # fmt: skip


def _correlations(found: Estimate) -> Answer:
    table = found.correlation
    shown = min(len(found.names), _MOST_SHOWN)
    rows = [
        f"  {k + 1:>3} " + " ".join(f"{value:6.3f}" for value in table[k, : k + 1]) + f"  {found.names[k]}"
        for k in range(shown)
    ]
    more = f"\n  ... and {len(found.names) - shown} more" if shown < len(found.names) else ""
    return Answer("Correlations:\n" + "\n".join(rows) + more, {
        "question": "correlations", "names": list(found.names), "units": list(found.units),
        "values": found.values.tolist(), "sigmas": found.sigmas.tolist(),
        "correlation": [[None if np.isnan(value) else float(value) for value in row] for row in table],
    })  # fmt: skip

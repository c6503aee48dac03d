"""Covariance queries as a user states them, and the answers as sentences and JSON; sigmas along an image's lines
and over an overlap: a table, a GeoTIFF. km and degrees only here.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from mgsgraph.adjustment.frames import FLIGHT_NAMES
from mgsgraph.analysis.estimates import Difference, Estimate, PixelEstimate, PoseEstimate, PositionEstimate, Quantity
from mgsgraph.analysis.places import BANDS, SigmaGrid, sigma_grid
from mgsgraph.analysis.posterior import Pixel, Posterior
from mgsgraph.errors import require
from mgsgraph.files.output.folders import PROGRAM
from mgsgraph.files.output.table import Column, Table
from mgsgraph.files.rasters.raster_file import geographic_crs, geotiff, wkt2
from mgsgraph.files.writing import file_stem, fresh_file
from mgsgraph.geometry.body import Ellipsoid, planetocentric
from mgsgraph.geometry.records import Array
from mgsgraph.results.section import Section, columns_of, record_of, sheets_by
from mgsgraph.units import ARCSEC, DEG

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
    projections: tuple[tuple[str, str], ...] = ()
    """Ground point and image."""
    pixels: tuple[Pixel, ...] = ()
    """Measures of one new point, to be intersected."""
    correlations: bool = False
    """Whether to state the correlations between everything that was asked."""
    probability: float = 0.95
    """Probability of the error ellipsoids."""

    def __post_init__(self) -> None:
        require(0.0 < self.probability < 1.0, "--probability", f"{self.probability}", "a number between 0 and 1")

    def __bool__(self) -> bool:
        return bool(self.points or self.pairs or self.poses or self.projections or self.pixels)


def replies(posterior: Posterior, questions: Questions) -> Iterator[Section]:
    """A finding for each question, in the order of their kinds; InputError where something asked about isn't in the
    solution.
    """
    for name in questions.points:
        yield _position_section(posterior.point(name), questions.probability, "point")
    for first, second in questions.pairs:
        yield _difference_section(posterior.difference(first, second))
    for image, line in questions.poses:
        yield _pose_section(posterior.pose(image, line))
    for point, image in questions.projections:
        yield _projection_section(posterior.projection(point, image))
    if questions.pixels:
        yield _position_section(posterior.intersection(questions.pixels), questions.probability, "intersection")
    if questions.correlations:
        yield _correlation_section(posterior.joint(list(_quantities(posterior, questions))))


def _quantities(posterior: Posterior, questions: Questions) -> Iterator[Quantity]:
    """Everything that was asked about, once."""
    names = dict.fromkeys([*questions.points, *(name for pair in questions.pairs for name in pair)])
    yield from (posterior.of_point(name) for name in names)
    yield from (posterior.of_pose(image, line) for image, line in dict.fromkeys(questions.poses))
    yield from (posterior.of_projection(point, image) for point, image in dict.fromkeys(questions.projections))
    if questions.pixels:
        yield posterior.of_intersection(questions.pixels)


def _sigmas_text(covariance: Array, axes: Sequence[str] = ("X", "Y", "Z"), unit: str = " m") -> str:
    """Standard deviations of axes as text."""
    sigmas = np.sqrt(np.maximum(np.diagonal(covariance), 0.0))
    return ", ".join(f"{axis} {sigma:.4g}{unit}" for axis, sigma in zip(axes, sigmas, strict=True))


def _flight_sigmas(covariance: Array) -> str:
    """Standard deviations of an orientation along the flight's axes (m, rad) as text."""
    position, rotation = covariance[:3, :3], covariance[3:, 3:] / ARCSEC**2
    return f"sigma {_sigmas_text(position, FLIGHT_NAMES[:3])}, {_sigmas_text(rotation, FLIGHT_NAMES[3:], ' arcsec')}"


def _position_section(estimate: PositionEstimate, probability: float, question: str) -> Section:
    longitude, latitude, radius = planetocentric(estimate.position)
    ellipsoid = estimate.ellipsoid(probability)
    title = "New point" if question == "intersection" else f"Point {estimate.name}"
    axes = zip(ellipsoid.semi_axes, ellipsoid.azimuths / DEG, ellipsoid.elevations / DEG, strict=True)
    axes_text = ", ".join(f"{semi_axis:.4g} m (azimuth {azimuth:.0f}, elevation {elevation:.0f} deg)"
                          for semi_axis, azimuth, elevation in axes)
    sentences = [
        f"{title}: longitude {longitude / DEG % 360.0:.6f} deg E, latitude {latitude / DEG:.6f} deg (planetocentric), "
        f"radius {radius:.3f} m; sigma {_sigmas_text(estimate.east_north_up, ('east', 'north', 'up'))}; "
        f"{_sigmas_text(estimate.covariance)}.", f"{100.0 * probability:g} % error ellipsoid: {axes_text}.",
    ]
    if estimate.misfit is not None:
        sentences.append(f"The rays miss each other by {estimate.misfit:.2g} of their sigmas.")
    return Section("answer", sentences=sentences, numbers={
        "question": question, "point": estimate.name, "place_m": estimate.position,
        "longitude_deg": longitude / DEG % 360.0, "latitude_deg": latitude / DEG, "radius_m": radius,
        "covariance_m2": estimate.covariance, "covariance_east_north_up_m2": estimate.east_north_up,
        "misfit_sigmas": estimate.misfit, "ellipsoid": {
            "probability": probability, "semi_axes_m": ellipsoid.semi_axes,
            "azimuths_deg": ellipsoid.azimuths / DEG,
            "elevations_deg": ellipsoid.elevations / DEG,
        },
    })  # fmt: skip


def _difference_section(difference: Difference) -> Section:
    distance_sentence = (
        f"Their distance is {difference.distance:.3f} m, sigma {difference.distance_sigma:.4g} m; sigma of the vector "
        f"{_sigmas_text(difference.east_north_up, ('east', 'north', 'up'))}."
    )
    return Section("answer", sentences=[difference.sentence, distance_sentence], numbers={
        "question": "pair", "points": [difference.first, difference.second], **record_of("difference", difference),
    })  # fmt: skip


def _pose_section(pose: PoseEstimate) -> Section:
    location = f"Image {pose.image} at line {pose.line:g}"
    sentence = f"{location}: {_flight_sigmas(pose.flight)}; body-fixed {_sigmas_text(pose.covariance[:3, :3])}."
    return Section("answer", sentences=[sentence], numbers={
        "question": "pose", **record_of("pose", pose),
        "flight_axes": list(FLIGHT_NAMES), "flight_covariance_m_rad": pose.flight,
    })  # fmt: skip


def _projection_section(projection: PixelEstimate) -> Section:
    line, sample = projection.sigmas
    correlation = projection.covariance[0, 1] / (line * sample) if line * sample > 0.0 else 0.0
    sentence = (
        f"Point {projection.point} in image {projection.image}: line {projection.pixel[0]:.2f}, sigma {line:.4g} px; "
        f"sample {projection.pixel[1]:.2f}, sigma {sample:.4g} px; correlation {correlation:.3f} (without the noise of "
        "a measurement; the first pixel's centre is at 0.5)."
    )
    return Section("answer", sentences=[sentence], numbers={"question": "projection", **record_of("pixel", projection)})


def _correlation_section(joint: Estimate) -> Section:
    shown = slice(_MOST_SHOWN)
    sentences = [
        f"Correlations of {name}: {', '.join(f'{value:.3f}' for value in row[: k + 1])}."
        for k, (name, row) in enumerate(zip(joint.names[shown], joint.correlation[shown], strict=True))
    ]
    return Section("answer", sentences=sentences, numbers={
        "question": "correlations", "names": list(joint.names), "units": list(joint.units),
        "values": joint.values, "sigmas": joint.sigmas, "correlation": joint.correlation,
    })  # fmt: skip




def curve_section(posterior: Posterior, image: str) -> Section:
    """Sigmas of the orientation along an image's lines."""
    image_index = posterior.network.image_number(image)
    pushbroom = posterior.network.images[image_index]
    image, poses = pushbroom.name, posterior.poses(image_index, np.linspace(0.0, float(pushbroom.lines), 61))
    lines, sigmas = np.array([pose.line for pose in poses]), np.array([pose.sigmas for pose in poses])
    units = (("m", sigmas[:, :3], FLIGHT_NAMES[:3]), ("arcsec", sigmas[:, 3:], FLIGHT_NAMES[3:]))
    columns = [
        Column(f"sigma_{axis}", values[:, k], unit, label=axis, text=">9.4g")
        for unit, values, axes in units for k, axis in enumerate(axes)
    ]  # fmt: skip
    stem = file_stem(image)
    stem += "" if stem == image else f"_{image_index + 1}"  # two safe names may be equal
    table = Table(f"sigmas_{stem}", f"Sigmas along image {image}", (
        *columns_of("curves", {"image": [image] * lines.size, "line": lines}), *columns,
    ))  # fmt: skip

    record = {"image": image, "lines": lines, **{column.name(): column.scaled for column in columns}}
    shown = table.take(np.arange(0, lines.size, 10))
    return Section("curves", tables=[shown], numbers=record, csv=[table])


def raster_section(posterior: Posterior, images: tuple[str, ...], cell: float | None, sigma: float) -> Section:
    """Sigmas of new points, measured to `sigma` px, over the overlap of images (all when empty); cells of `cell` m."""
    grid = sigma_grid(posterior, images, cell, sigma)
    body = posterior.network.body

    _, rows, columns = grid.values.shape
    record = {
        "images": list(grid.images), "measure_sigma_px": grid.sigma, "cell_m": grid.steps[1] * body.equatorial,
        "rows": rows, "columns": columns, "cells_seen_twice": int(np.count_nonzero(grid.rays >= 2)),
        "median_sigmas_m": np.nanmedian(grid.values[:3], axis=(1, 2)),
    }  # fmt: skip
    sentence = f"{grid.sentence[0].upper()}{grid.sentence[1:]}."
    files = {"sigmas.tif": partial(write_sigma_raster, grid, body)}
    return Section("raster", sentences=[sentence], numbers=record, files=files,
                   sheets=sheets_by("mgsgraph.results.figures.analysis.raster_sheet", grid, "sigma_map"))  # fmt: skip


def write_sigma_raster(grid: SigmaGrid, body: Ellipsoid, path: Path) -> None:
    """Write a sigma grid as a cloud-optimized GeoTIFF (float32, m, NaN where unknown), atomically.

    Raises
    ------
    InputError
        If it can't be written.
    """
    across, down = (step / DEG for step in grid.steps)
    tags = {"images": ", ".join(grid.images), "measure_sigma_px": f"{grid.sigma:g}", "program": PROGRAM}
    corner = grid.west / DEG, grid.north / DEG
    with (
        fresh_file(path) as temporary,
        geotiff(
            temporary, grid.values.shape, wkt2(geographic_crs(body)), corner, (across, down), dtype="float32",
            nodata=np.nan
        ) as file,
    ):
        file.write(grid.values.astype(np.float32))
        file.update_tags(**tags)
        for k, name in enumerate(BANDS, start=1):
            file.set_band_description(k, name)
            file.set_band_unit(k, "m")

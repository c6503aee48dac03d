"""Places that were projected, and laser shots over images, as tables."""

import math
from collections import Counter
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from mgsgraph.analysis.places import Places, State, View, on_surface, upward
from mgsgraph.errors import require
from mgsgraph.files.csv_columns import AXES, CARTESIAN, GEODETIC, ISIS, OURS, PLANETOCENTRIC, RADIAL
from mgsgraph.files.output.table import Column, Table, numbers
from mgsgraph.files.place_table import PlaceTable
from mgsgraph.files.writing import begins
from mgsgraph.geometry.body import Ellipsoid, geodetic, planetocentric, require_near
from mgsgraph.geometry.records import Array, Mask, sigmas_of
from mgsgraph.geometry.rotation import unit_vectors
from mgsgraph.geometry.terrain import TerrainGrid
from mgsgraph.geometry.trajectory import utc_of_tdb, utc_texts
from mgsgraph.names import RepeatedNames
from mgsgraph.network.footprints import Crossing, Registration
from mgsgraph.results.section import Section, record_of, table_of
from mgsgraph.text import many
from mgsgraph.units import DEG, ISIS_OFFSET, MILLISECOND


class Surface(NamedTuple):
    """Surface for the projection of image places, and for ground places without a height: the first field set."""

    terrain: TerrainGrid | None = None
    """A terrain model."""
    radius: float | None = None
    """m, of a sphere about the body's centre."""
    height: float | None = None
    """m, by which the ellipsoid's radii are larger."""

    @property
    def height_from(self) -> str:
        """Where heights come from; without any of these, from the adjusted points about a place."""
        if self.terrain is not None:
            return "terrain"
        return "neighbors" if self.radius is None and self.height is None else "given"


_DAY = 86400.0
_MINUTES = "%Y-%m-%dT%H:%M"
PLACES = begins(
    "a table of mgsgraph locate",
    r"([^\n]*,)?state,(height_from,)?(line,sample|isis_line,isis_sample|longitude_deg,latitude_deg,radius_m,geodetic_latitude_deg)[,\r\n]",
)
"""Tables that the verb writes, by the columns that it adds."""
_LEAST_SIGMA = 1e-3
"""m or px, least sigma of which two digits are written, and that of what has none."""
_SIGMA_OF = {
    **dict(zip((*PLANETOCENTRIC, *CARTESIAN), (*RADIAL, *AXES), strict=True)), "geodetic_latitude_deg": RADIAL[1],
    "height_m": "sigma_height_m", "line": "sigma_line_px", "sample": "sigma_sample_px",
    "isis_line": "sigma_line_px", "isis_sample": "sigma_sample_px",
}  # fmt: skip
"""Which sigma each number of a table has."""
_GIVEN = "given_"
"""Prefix of a given column that has the name of a computed one."""


def project_places(view: View, places: PlaceTable, surface: Surface, isis: bool) -> tuple[Table, str]:
    """Image places on the ground or ground places in the image, and a sentence about them.

    Lines and samples count from 1 where `isis` or the given table says so. A height or radius of an image place's own
    stands before the surface.
    """
    body, image = view.image.body, view.image.name
    height, height_source = surface.height or 0.0, surface.height_from
    levels = np.array([body.equatorial + height if surface.radius is None else surface.radius])
    require(np.all(np.isfinite(levels)), "the ground", f"{levels[0]}", "a finite number of metres")
    require_near(levels, body, lambda _: "the ground")
    if places.sort == "image":
        has_heights = places.heights is not None or places.radii is not None
        radii = None if surface.radius is None or has_heights else np.full(len(places.pixels), surface.radius)
        height_source = "given" if has_heights else height_source
        heights, sigmas = view.ground_heights(places.pixels) if height_source == "neighbors" else (height, 0.0)
        projected = view.on_ground(
            places.pixels, heights if places.heights is None else places.heights,
            places.radii if places.radii is not None else radii, None if has_heights else surface.terrain, sigmas,
        )  # fmt: skip
        sentence = _statement(projected, "image place", f"of {image} on the ground")
        return ground_places_table(projected, body, places.columns, height_source), sentence
    if len(places.directions):
        sphere = body if surface.radius is None else Ellipsoid(surface.radius, surface.radius)
        longitude, latitude = places.directions.T
        points = on_surface(longitude, latitude, sphere, height, surface.terrain)
        projected = _seen_at_neighbor_heights(view, points) if height_source == "neighbors" else view.seen(points,
                                                                                                           surface.terrain)
    else:
        height_source = "given"
        projected = _seen_over_terrain(view, places.points, surface.terrain)
    return image_places_table(projected, isis, places.columns, height_source), _statement(projected, "ground place",
                                                                                          f"in {image}")


def _seen_over_terrain(view: View, points: Array, terrain: TerrainGrid | None) -> Places:
    """Ground points (n, 3) in m in the image; a terrain model may hide them, but none because it lies beneath that."""
    seen = view.seen(points)
    if terrain is None:
        return seen
    raised = np.fmax(1.0, terrain.at(points) / np.linalg.norm(points, axis=1))[:, None]
    raised_states = view.seen(points * raised, terrain).states
    hidden = State.BEHIND_RELIEF
    return seen._replace(states=tuple(
        hidden if raised is hidden else state for state, raised in zip(seen.states, raised_states, strict=True)
    ))  # fmt: skip


def _seen_at_neighbor_heights(view: View, ground: Array) -> Places:
    """Ground places in the image, raised from the ellipsoid (n, 3) in m to the height of adjusted points about them."""
    heights, height_sigmas = view.heights_at(ground)
    vertical = unit_vectors(ground)
    projected, projected_higher = (view.seen(ground + (heights + rise)[:, None] * vertical) for rise in (0.0, 1.0))
    shifts = (projected_higher.pixels - projected.pixels) * height_sigmas[:, None]
    assert projected.covariances is not None
    return projected._replace(covariances=projected.covariances + shifts[:, :, None] * shifts[:, None])


def image_places_table(projected: Places, isis: bool, given: Mapping[str, list[str]], height_from: str) -> Table:
    """Ground places in an image: line and sample, counted from 1 as in ISIS or from the first pixel's corner."""
    names, offset = (ISIS, ISIS_OFFSET) if isis else (OURS, 0.0)
    values = dict(zip(names, (projected.pixels + offset).T, strict=True))
    if projected.covariances is not None:
        sigmas = sigmas_of(projected.covariances)
        values |= dict(zip(("sigma_line_px", "sigma_sample_px"), sigmas.T, strict=True))
    return _positions_table("Ground places in the image", projected, values, given, height_from)


def ground_places_table(projected: Places, body: Ellipsoid, given: Mapping[str, list[str]], height_from: str) -> Table:
    """Image places on the ground: planetocentric, geodetic and body-fixed; longitudes 0 .. 360 degrees east."""
    longitude, latitude, radius = planetocentric(projected.points).T
    _, geodetic_latitude, height = geodetic(projected.points, body).T
    values = dict(zip(PLANETOCENTRIC, (longitude % (2.0 * np.pi) / DEG, latitude / DEG, radius), strict=True))
    values |= dict(zip(GEODETIC[1:], (geodetic_latitude / DEG, height), strict=True))
    values |= dict(zip(CARTESIAN, projected.points.T, strict=True))
    if projected.covariances is not None:
        from mgsgraph.analysis.statistics import local_sigmas, sigmas_along  # only where there is a solution

        values |= dict(zip(RADIAL, local_sigmas(projected.covariances, projected.points).T, strict=True))
        values["sigma_height_m"] = sigmas_along(upward(projected.points, body)[:, None], projected.covariances)[:, 0]
        values |= dict(zip(AXES, sigmas_of(projected.covariances).T, strict=True))
    return _positions_table("Image places on the ground", projected, values, given, height_from)


def _positions_table(
    title: str, projected: Places, values: Mapping[str, Array], given: Mapping[str, list[str]], height_from: str
) -> Table:
    """Numbers to two digits of their sigmas; those of angles are lengths on the ground."""
    new_names, radius = {*values, "state", "height_from"}, np.linalg.norm(projected.points, axis=1)
    given_columns = [Column(_GIVEN + name if name in new_names else name, list(texts)) for name, texts in given.items()]
    added = []
    for name, column in values.items():
        sigma = np.fmax(values.get(_SIGMA_OF.get(name, name), np.full(len(column), np.nan)), _LEAST_SIGMA)
        if name.endswith("_deg"):
            sigma = sigma / (radius * DEG)
        if name == PLANETOCENTRIC[0]:
            sigma = sigma / np.maximum(np.cos(values[PLANETOCENTRIC[1]] * DEG), _LEAST_SIGMA)
        added.append(Column(name, [_two_digits(*pair) for pair in zip(column.tolist(), sigma.tolist(), strict=True)]))
    state = Column("state", [str(place_state) for place_state in projected.states])
    return Table("places", title,
                 (*given_columns, state, Column("height_from", [height_from] * len(projected.states)), *added))


def _two_digits(value: float, sigma: float) -> str:
    """To two digits of a sigma; empty where it is none."""
    if not (math.isfinite(value) and math.isfinite(sigma)):
        return ""
    decimals = 1 - math.floor(math.log10(sigma))
    return f"{round(value, decimals) + 0.0:.{max(decimals, 0)}f}"


def places_text(table: Table) -> list[str]:
    """Lines of a few places: a name and its value in each, with its sigma, which of angles is a length."""
    lines = []
    for row in table.records():
        for name, value in row.items():
            sigma, unit = row.get(_SIGMA_OF.get(name, "")), " m" if name.endswith("_deg") else ""
            sigma_text = f" +- {sigma}{unit}" if sigma is not None else ""
            if name not in _SIGMA_OF.values():
                lines.append(f"{name} = {'none' if value is None else value}{sigma_text}")
        lines.append("")
    return lines[:-1]


def _statement(projected: Places, noun: str, place: str) -> str:
    """How many places were projected, and how many of them the image does not show."""
    counts = Counter(projected.states)
    others = ", ".join(f"{count} {state}" for state, count in counts.items() if state is not State.SEEN)
    return f"{many(len(projected.states), noun)} {place}: {counts[State.SEEN]} seen" + (f", {others}" if others else "")


# --- laser shots over images


def crossings_table(crossings: tuple[Crossing, ...]) -> Table:
    """One row for each image and profile that crosses it or was taken along."""
    return table_of("crossings", {
        "utc": [f"{utc_of_tdb(crossing.start):{_MINUTES}}" for crossing in crossings],
        "from_image": numbers(crossings, "seconds") / _DAY,
    }, crossings)  # fmt: skip


SELECTION = begins("a selection of mgsgraph footprints", "altimeter,profile,utc,images,simultaneous,orbit,")
"""Tables of `selection_table`, by their columns."""


def selection_table(registration: Registration) -> Table:
    """Shots that fall in an image, with all that `altimetry.shots.read_shots` takes back; what is empty is unknown."""
    shots, rows = registration.shots.chosen(registration.chosen), registration.chosen
    longitude, latitude, radius = planetocentric(shots.footprints).T

    def names(mask: Mask) -> RepeatedNames:
        combinations, numbers = np.unique(mask[:, rows], axis=1, return_inverse=True)
        texts = RepeatedNames.of([";".join(registration.images[j].name for j in np.flatnonzero(in_images))
                                  for in_images in combinations.T])
        return texts[numbers.ravel()]

    return table_of("places_shots", {
        "altimeter": RepeatedNames((shots.altimeter.name,), np.zeros(rows.size, dtype=np.int64)),
        "profile": shots.profile_names(), "utc": utc_texts(shots.times + 0.5 * MILLISECOND),
        "images": names(registration.inside), "simultaneous": names(registration.inside & registration.simultaneous),
        "orbit": shots.orbits,
        "frame": shots.frames, "shot": shots.shots, "ground": shots.ground.astype(np.int64), "channel": shots.channels,
        "time": shots.times, "longitude": longitude / DEG % 360.0, "latitude": latitude, "radius": radius,
        **record_of("shots", shots),
    })  # fmt: skip


def crossings_section(registration: Registration, crossings: tuple[Crossing, ...]) -> Section:
    """How many shots of which profiles fall in each image, and which profiles were taken along with it."""
    sentences = list[str]()
    for image in registration.images:
        inside = [crossing for crossing in crossings if crossing.image == image.name and crossing.inside]
        simultaneous = [crossing.profile for crossing in crossings if crossing.image == image.name
                        and crossing.simultaneous]
        shots, profiles = many(sum(crossing.inside for crossing in inside), "shot"), many(len(inside), "profile")
        sentences.append(f"{image.name}: {shots} of {profiles} fall in it, "
                         f"{', '.join(simultaneous) or 'none'} taken along with it")
    return Section("crossings", "", sentences, [crossings_table(crossings)])

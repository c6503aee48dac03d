"""A terrain grid from altimeter tracks: shots triangulated, radii interpolated in the triangles, holes between tracks.

The shots' directions are laid out in a plane, longitude times the cosine of the middle latitude and latitude, and
triangulated there (Delaunay). Radii are linear over each triangle. A triangle with an edge longer than a limit bridges
no ground that anyone has seen, and is a hole; so is what lies outside the shots' convex hull.

The sigma of a post is sqrt(vertical^2 + (roughness x distance to the nearest shot)^2), and what interpolation adds is
common within that distance. The roughness of the region is
what linear interpolation along the tracks misses at a known distance: the rms of each shot's radius minus the one
between its two neighbours, over its distance to the nearer one. Relief grows slower than distance, so
that this errs to the safe side between tracks, where the distance is larger than along them. Of orbits left out of real
data errors are 0.4 (InSight) to 1.3 times (Gale) such sigmas, rms.
"""

from collections.abc import Sequence

import numpy as np
from scipy.interpolate import LinearNDInterpolator
from scipy.spatial import Delaunay, KDTree, QhullError

from mgsgraph.errors import InputError
from mgsgraph.geometry.altimetry import AltimeterShots
from mgsgraph.geometry.body import from_planetocentric, in_turn, planetocentric
from mgsgraph.geometry.records import Array, Index, Mask
from mgsgraph.geometry.terrain import Gaps, TerrainGrid
from mgsgraph.text import root_mean_square
from mgsgraph.units import DEG, KM

LONGEST_EDGE = 5.0 * KM
"""m, above which an edge of a triangle makes it a hole: about the spacing of MOLA's tracks at the equator."""
POST_STEP = DEG / 200.0
"""rad, between posts: 300 m, as far apart as MOLA's shots along a track."""
_NEIGHBOURS = 0.15
"""s, within which shots follow each other without a gap."""
_EDGE = 1e-9
"""Share by which a post may lie beside a triangle and still be on its edge."""
_MOST = 1 << 28
"""Posts of a grid."""


def track_terrain(
    tracks: Sequence[AltimeterShots],
    around: Array | None = None,
    longest_edge: float = LONGEST_EDGE,
    post_step: float = POST_STEP,
    vertical_sigma: float = 10.0,
    planimetric_sigma: float | None = None,
) -> TerrainGrid:
    """Triangulate altimeter tracks and lay them out as a grid of radii.

    Parameters
    ----------
    tracks : sequence of AltimeterShots
        Their returns from the ground are used.
    around : (n, 3), optional
        m, body-fixed: points that the grid is to lie under; all of the tracks when absent.
    longest_edge : float
        m, of a triangle's edges; larger triangles are holes.
    post_step : float
        rad, between posts in latitude; between columns it is as wide on the ground.
    vertical_sigma, planimetric_sigma : float
        m, of a shot's height, and of the tracks' common horizontal place.

    Raises
    ------
    InputError
        Where fewer than three shots lie there, all on a line, or nothing but holes would be left.
    """
    source = ", ".join(dict.fromkeys(shots.source for shots in tracks))
    places, roughness = _ground(tracks, source)
    if around is not None:
        places = places[_near(places, around, 2.0 * longest_edge)]
        if places.shape[0] < 3:
            raise InputError(source, f"{places.shape[0]} shots around the images", "tracks that cross their ground")
    longitudes, latitudes, radii = planetocentric(places).T
    middle = float(np.angle(np.mean(np.exp(1j * longitudes))))
    longitudes = in_turn(longitudes, middle)
    shrink = float(np.cos(0.5 * (latitudes.min() + latitudes.max())))
    steps = post_step / shrink, post_step
    west, north = np.floor(longitudes.min() / steps[0]), np.ceil(latitudes.max() / steps[1])
    columns = int(np.ceil(longitudes.max() / steps[0]) - west) + 1
    rows = int(north - np.floor(latitudes.min() / steps[1])) + 1
    if rows * columns > _MOST:
        raise InputError(source, f"{rows} x {columns} posts", f"{_MOST} at most", "give a wider post_step_deg")
    plane = np.column_stack([longitudes * shrink, latitudes])
    origin = plane.mean(axis=0)
    try:
        net = Delaunay(plane - origin)
    except QhullError:
        raise InputError(source, f"{places.shape[0]} shots on one line", "tracks that span an area") from None
    small = _small(places[net.simplices], longest_edge)
    lattice = west * steps[0], north * steps[1]
    linear = LinearNDInterpolator(net, radii)
    values, distances = np.full((rows, columns), np.nan), np.full((rows, columns), np.nan)
    eastward = (lattice[0] + np.arange(columns) * steps[0]) * shrink
    for row in range(rows):
        posts = np.column_stack([eastward, np.full(columns, lattice[1] - row * steps[1])]) - origin
        triangle = net.find_simplex(posts, tol=_EDGE)
        held = (triangle >= 0) & small[triangle]
        values[row, held] = linear(posts[held])
    level = float(radii.mean())
    nearest = KDTree(places * (level / radii)[:, None])
    for row in np.flatnonzero(np.any(np.isfinite(values), axis=1)).tolist():
        there = np.flatnonzero(np.isfinite(values[row]))
        latitude = lattice[1] - row * steps[1]
        posts = np.column_stack([lattice[0] + there * steps[0], np.full((there.size, 2), [latitude, level])])
        distances[row, there] = nearest.query(from_planetocentric(posts))[0]
    if not np.any(np.isfinite(values)):
        raise InputError(
            source, f"no triangle of shots with edges up to {longest_edge / KM:g} km",
            "tracks closer to each other", "give more tracks, or a larger longest_edge_m",
        )  # fmt: skip
    return TerrainGrid(
        source, values, *lattice, *steps, vertical_sigma=vertical_sigma, planimetric_sigma=planimetric_sigma,
        gaps=Gaps(roughness * distances, distances),
    )  # fmt: skip


def _ground(tracks: Sequence[AltimeterShots], source: str) -> tuple[Array, float]:
    """(n, 3) m, footprints of all returns from the ground, and the roughness of the region (m per m)."""
    orbits = np.concatenate([np.zeros(0, dtype=np.int64), *(shots.orbits[shots.ground] for shots in tracks)])
    if orbits.size < 3:
        raise InputError(source or "terrain tracks", f"{orbits.size} shots from the ground", "three at least")
    track = np.concatenate([np.full(np.count_nonzero(shots.ground), k) for k, shots in enumerate(tracks)])
    times = np.concatenate([shots.times[shots.ground] for shots in tracks])
    places = np.concatenate([shots.footprints[shots.ground] for shots in tracks])
    order = np.lexsort((times, orbits, track))
    return places, _roughness(places[order], times[order], (track * (int(orbits.max()) + 1) + orbits)[order])


def _roughness(places: Array, times: Array, track: Index) -> float:
    """Rms of what linear interpolation between a shot's neighbours misses, over the distance to the nearer one."""
    step = np.diff(times)
    follows = (step > 0.0) & (step < _NEIGHBOURS) & (np.diff(track) == 0)
    middle = np.flatnonzero(follows[1:] & follows[:-1]) + 1
    if middle.size == 0:
        return 0.0
    radii = np.linalg.norm(places, axis=1)
    on_sphere = places * (np.mean(radii) / radii)[:, None]
    before, after = (np.linalg.norm(on_sphere[middle] - on_sphere[middle + k], axis=1) for k in (-1, 1))
    between = (radii[middle - 1] * after + radii[middle + 1] * before) / (before + after)
    missed = (radii[middle] - between) / np.minimum(before, after)
    return root_mean_square(missed)


def _near(places: Array, around: Array, margin: float) -> Mask:
    """Which of places (n, 3) lie in the box of longitude and latitude of others, widened by a margin (m)."""
    around = around[np.all(np.isfinite(around), axis=1)]
    if around.shape[0] == 0:
        return np.ones(places.shape[0], dtype=bool)
    (longitudes, latitudes, radii), (own, height, _) = planetocentric(around).T, planetocentric(places).T
    middle = float(np.angle(np.mean(np.exp(1j * longitudes))))
    arc = margin / float(radii.min())
    wide = arc / max(float(np.cos(np.abs(latitudes).max())), 1e-3)
    east, own = (in_turn(x - middle) for x in (longitudes, own))
    inside = (own > east.min() - wide) & (own < east.max() + wide)
    return np.asarray(inside & (height > latitudes.min() - arc) & (height < latitudes.max() + arc))


def _small(corners: Array, longest: float) -> Mask:
    """(t,) which triangles with corners (t, 3, 3) in m have no edge longer than a limit (m), in space."""
    edges = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2)
    return np.asarray(edges.max(axis=1) <= longest)

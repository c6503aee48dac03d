"""The simulated ground: its height, slope and brightness anywhere, and where rays meet it.

`SiteTerrain` is the ground of the study sites (`make_terrain`). Its heights count along the radius, from the ellipsoid
at the same planetocentric latitude (MOLA's planetary radius minus the ellipsoid's). It is the regional level (three
waves of some 400 km) plus two periodic surfaces that are smooth: pictures show no facets, and there is no edge at which
the ground ends. Levels of the sites are those of the MOLA grids megr90n000cb and megt90n000cb at the sites' centres,
rounded to 10 m.

Pair and strip have a sum of three sines instead (`sine_height`), which is exact and fast for millions of points.
"""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from mgsgraph.errors import require
from mgsgraph.geometry.body import Ellipsoid, from_planetocentric, in_turn, intersect_ellipsoid, planetocentric
from mgsgraph.geometry.image import PushbroomImage
from mgsgraph.geometry.orientation import OrientationCorrection
from mgsgraph.geometry.records import Array
from mgsgraph.geometry.rotation import unit_vectors
from mgsgraph.geometry.terrain import TerrainGrid
from mgsgraph.record import Record
from mgsgraph.simulation.orbit import MARS, on_ellipsoid
from mgsgraph.simulation.relief import Float, PeriodicSurface, add_craters, canyon, fractal
from mgsgraph.units import DEG

CENTRE = (87.0 * DEG, 4.0 * DEG)
"""rad, longitude and planetocentric latitude from which the sines of pair and strip count: Isidis Planitia."""

_SINES = np.array([[1.0, 0.0, 9e3, 0.3], [0.6, 1.1, 4e3, 1.7], [0.3, 2.0, 2.3e3, 4.1]])
"""Of each: share of the amplitude, direction (rad from east), wavelength (m), phase (rad)."""
_DETAIL_ROTATION = 0.6
"""rad by which the fine surface is turned, so that its repetition doesn't follow the flight direction."""
_BLOCK = 1 << 14
"""Points evaluated at once, so that the arrays between stay in the processor's cache."""
_STEPS, _TOLERANCE = 40, 2e-5
"""Newton steps at most, and height (m) above the ground at which a ray has met it."""


@dataclass(frozen=True, slots=True)
class SiteGround(Record):
    """Relief and brightness of a site's ground."""

    longitude: float
    """rad, east, of the site's centre."""
    latitude: float
    """rad, planetocentric."""
    level: float
    """m above the ellipsoid, mean height about the centre."""
    areoid: float
    """m, areoid above the ellipsoid."""
    roughness: float
    """m rms, of the relief between craters."""
    hurst: float
    """Hurst exponent of the relief: small is rough, 1 is rolling."""
    craters: float
    """1/km^2, number of craters with diameters above 100 m."""
    largest: float
    """m, largest crater diameter."""
    canyon: float
    """m, height of the canyon's walls; zero for none."""
    contrast: float
    """rms of the soil's brightness, in units of its mean."""


SITES: dict[str, SiteGround] = {
    "eos": SiteGround(318.6 * DEG, -13.3 * DEG, -4460.0, -710.0, 45.0, 0.9, 0.5, 900.0, 2700.0, 0.05),
    "gusev": SiteGround(175.3 * DEG, -14.6 * DEG, -2580.0, -680.0, 14.0, 0.8, 1.2, 2500.0, 0.0, 0.06),
    "isidis": SiteGround(87.9 * DEG, 4.5 * DEG, -3750.0, 40.0, 10.0, 0.7, 2.0, 1400.0, 0.0, 0.05),
}
"""The study sites of Yoon & Shan (2005)."""


@dataclass(frozen=True, slots=True, eq=False)
class SiteTerrain(Record):
    """The true ground of a simulated site. Longitudes are east, latitudes planetocentric, both in rad."""

    site: str
    """Name of the site."""
    seed: int
    """Seed of everything drawn."""
    ellipsoid: Ellipsoid
    """Reference of heights."""
    centre_lon: float
    """rad east, longitude at which images of the site are aimed."""
    centre_lat: float
    """rad, planetocentric latitude of the same."""
    ground: SiteGround
    """What it is like."""
    waves: Array
    """(3, 4) regional level: amplitude (m), waves per radian of longitude and of latitude, phase (rad)."""
    relief: PeriodicSurface
    """m, hills, canyon, craters of more than 80 m."""
    detail: PeriodicSurface
    """m, small relief and craters of 15 to 80 m; turned."""
    brightness: PeriodicSurface
    """The soil's albedo in units of its mean; turned like the detail."""

    def height(self, lon: Array, lat: Array) -> Array:
        """Height (n,) in m above the ellipsoid, along the radius, at longitudes and latitudes (n,)."""
        height = np.empty(lon.size)
        for first in range(0, lon.size, _BLOCK):
            part = slice(first, first + _BLOCK)
            height[part] = self.level(lon[part], lat[part])[0] + self.local(*self.chart(lon[part], lat[part]))[0]
        return height

    def radius(self, points: Array) -> Array:
        """Radius (n,) in m of the ground under or above body-fixed points (n, 3)."""
        lon, lat, _ = planetocentric(points).T
        return self.ground_radius(lon, lat)

    def ground_radius(self, lon: Array, lat: Array) -> Array:
        """Radius (n,) in m of the ground at longitudes and latitudes (n,)."""
        return self._ellipsoid_radius(lat)[0] + self.height(lon, lat)

    def normal(self, points: Array) -> Array:
        """Outward unit normal (n, 3), body-fixed, of the ground under or above body-fixed points (n, 3)."""
        lon, lat, _ = planetocentric(points).T
        _, normal = self._clearance(self.on_ground(lon, lat))
        return unit_vectors(normal)

    def on_ground(self, lon: Array, lat: Array) -> Array:
        """Body-fixed points (n, 3) in m of the ground at longitudes and latitudes (n,)."""
        return from_planetocentric(np.column_stack([lon, lat, self.ground_radius(lon, lat)]))

    def areoid_radius(self, lon: Array, lat: Array) -> Array:
        """Radius (n,) in m of the areoid at longitudes and latitudes (n,): 20 m of swell beside the ellipsoid's."""
        swell = 20.0 * np.sin(9.0 * (lon - self.centre_lon)) * np.cos(7.0 * (lat - self.centre_lat))
        return np.asarray(self._ellipsoid_radius(lat)[0] + self.ground.areoid + swell)

    def intersect(self, origins: Array, directions: Array) -> Array:
        """Points (n, 3) in m, body-fixed, where rays meet the ground, to 1e-4 m.

        Newton's method on the distance along the ray. Looks within 25 degrees of nadir meet these sites' ground once.

        Parameters
        ----------
        origins, directions : (n, 3)
            m, body-fixed; directions of any length.

        Returns
        -------
        (n, 3)
            NaN where a ray misses the body.
        """
        points, _, _ = intersect_ellipsoid(origins, directions, self.ellipsoid, self.ground.level)
        open_rays = np.flatnonzero(np.isfinite(points[:, 0]))
        for step in range(_STEPS):
            clearance, normal = self._clearance(points[open_rays])
            late = np.abs(clearance) > _TOLERANCE
            open_rays, clearance, normal = open_rays[late], clearance[late], normal[late]
            if open_rays.size == 0:
                break
            along = directions[open_rays]
            move = clearance / np.einsum("ni,ni->n", normal, along)
            points[open_rays] -= (move if step < _STEPS // 4 else 0.5 * move)[:, None] * along
        points[open_rays] = np.nan
        return points

    def chart(self, lon: Array, lat: Array) -> tuple[Array, Array]:
        """Coordinates (n,) in m east and north of the centre in a plane chart."""
        scale = self.metres_per_radian
        turned = in_turn(lon - self.centre_lon)
        return scale[0] * turned, scale[1] * (lat - self.centre_lat)

    def level(self, lon: Array, lat: Array) -> tuple[Array, Array, Array]:
        """Regional height (n,) in m above the ellipsoid, and its derivatives per rad of longitude and of latitude."""
        height, by_lon, by_lat = np.full_like(lon, self.ground.level), np.zeros_like(lon), np.zeros_like(lon)
        for amplitude, east, north, phase in self.waves:
            angle = east * (lon - self.centre_lon) + north * (lat - self.centre_lat) + phase
            height += amplitude * (np.sin(angle) - np.sin(phase))
            by_lon += amplitude * east * np.cos(angle)
            by_lat += amplitude * north * np.cos(angle)
        return height, by_lon, by_lat

    def local(self, east: Float, north: Float) -> tuple[Float, Float, Float]:
        """Height (n,) in m above the regional level and its slopes east and north (n,) at chart coordinates (n,), in
        their dtype.
        """
        value, by_east, by_north = self.relief.at(east, north)
        sine, cosine = east.dtype.type(np.sin(_DETAIL_ROTATION)), east.dtype.type(np.cos(_DETAIL_ROTATION))
        fine, by_first, by_second = self.detail.at(cosine * east + sine * north, cosine * north - sine * east)
        by_east += cosine * by_first - sine * by_second
        by_north += sine * by_first + cosine * by_second
        return value + fine, by_east, by_north

    def albedo(self, east: Float, north: Float) -> Float:
        """Brightness (n,) of the soil at chart coordinates (n,), in units of its mean and in their dtype."""
        sine, cosine = east.dtype.type(np.sin(_DETAIL_ROTATION)), east.dtype.type(np.cos(_DETAIL_ROTATION))
        return self.brightness.value(cosine * east + sine * north, cosine * north - sine * east)

    @property
    def metres_per_radian(self) -> Array:
        """(2,) m per rad of longitude and of latitude in the chart."""
        return np.asarray(self._ellipsoid_radius(np.array([self.centre_lat]))[0] * [np.cos(self.centre_lat), 1.0])

    def _ellipsoid_radius(self, lat: Array) -> tuple[Array, Array]:
        """Radius (n,) in m of the ellipsoid at planetocentric latitudes (n,), and its derivative per rad."""
        a, b = self.ellipsoid.equatorial, self.ellipsoid.polar
        sine, cosine = np.sin(lat), np.cos(lat)
        square = (b * cosine) ** 2 + (a * sine) ** 2
        radius = a * b / np.sqrt(square)
        return radius, -radius * (a * a - b * b) * sine * cosine / square

    def _clearance(self, points: Array) -> tuple[Array, Array]:
        """Radius of points (n, 3) above the ground's (n,) in m, and its gradient (n, 3): an outward normal."""
        lon, lat, radius = planetocentric(points).T
        east, north = self.chart(lon, lat)
        height, by_east, by_north = self.local(east, north)
        level, by_lon, by_lat = self.level(lon, lat)
        body, body_by_lat = self._ellipsoid_radius(lat)
        scale = self.metres_per_radian
        along = (by_lon + scale[0] * by_east) / (radius * np.cos(lat))
        across = (by_lat + scale[1] * by_north + body_by_lat) / radius
        (sl, cl), (sb, cb) = (np.sin(lon), np.cos(lon)), (np.sin(lat), np.cos(lat))
        gradient = points / radius[:, None]
        gradient[:, 0] += along * sl + across * sb * cl
        gradient[:, 1] += -along * cl + across * sb * sl
        gradient[:, 2] -= across * cb
        return radius - body - level - height, gradient


@lru_cache(maxsize=2)
def make_terrain(site_name: str, seed: int) -> SiteTerrain:
    """Ground of a study site, ``eos``, ``gusev`` or ``isidis``; the same name and seed (zero or positive) give the same
    ground. InputError if there is no such site.
    """
    require(site_name in SITES, "simulated ground", f"site {site_name!r}", f"one of {', '.join(SITES)}")
    require(seed >= 0, "simulated ground, seed", f"{seed}", "zero or a positive whole number")
    ground = SITES[site_name]
    of_level, of_relief, of_craters, of_detail, of_soil = np.random.default_rng(
        [seed, list(SITES).index(site_name)]
    ).spawn(5)
    relief = ground.roughness * fractal((4096, 1024), ground.hurst, of_relief)
    if ground.canyon:
        relief += ground.canyon * canyon(relief.shape, 16.0, of_relief)
    add_craters(relief, 16.0, ground.craters, (80.0, ground.largest), of_craters)
    detail = 1.0 * fractal((1024, 1024), 0.35, of_detail)
    add_craters(detail, 5.0, ground.craters, (15.0, 80.0), of_craters)
    soil = 1.0 + ground.contrast * fractal((1024, 1024), 0.1, of_soil)
    return SiteTerrain(
        site=site_name,
        seed=seed,
        ellipsoid=MARS,
        centre_lon=ground.longitude,
        centre_lat=ground.latitude,
        ground=ground,
        waves=_waves(of_level),
        relief=PeriodicSurface(16.0, relief),
        detail=PeriodicSurface(5.0, detail),
        brightness=PeriodicSurface(5.0, soil),
    )


def _waves(rng: np.random.Generator) -> Array:
    """Regional level: three waves, whole numbers of them about the body, of 350 to 600 km and at most 60 m each."""
    direction = rng.uniform(0.0, np.pi, 3)
    number = rng.uniform(35.0, 60.0, 3)
    east, north = np.rint(number * np.cos(direction)), np.rint(number * np.sin(direction))
    return np.column_stack([rng.uniform(20.0, 60.0, 3), east, north, rng.uniform(0.0, 2.0 * np.pi, 3)])


# --- sines: the ground of pair and strip


def sine_height(points: Array, relief: float) -> Array:
    """True height (n,) in m above the ellipsoid at body-fixed points (n, 3) in m; `relief` in m is the amplitude of the
    largest sine.

    It is what `intersect_ellipsoid` calls height: the ground is where the ellipsoid with radii so much larger passes.
    """
    longitude, latitude, _ = planetocentric(points).T
    east = MARS.equatorial * np.cos(CENTRE[1]) * (longitude - CENTRE[0])
    north = MARS.equatorial * (latitude - CENTRE[1])
    share, direction, wavelength, phase = _SINES.T[:, :, None]
    along = east * np.cos(direction) + north * np.sin(direction)
    return np.asarray(relief * np.sum(share * np.sin(2.0 * np.pi * along / wavelength + phase), axis=0))


def on_sines(points: Array, relief: float) -> Array:
    """Points (n, 3) in m of the ground under or above body-fixed points (n, 3), along the radius."""
    return on_ellipsoid(unit_vectors(points), sine_height(points, relief))


def rays_to_sines(
    image: PushbroomImage, correction: OrientationCorrection, lines: Array, samples: Array, relief: float
) -> Array:
    """Points (n, 3) in m where the rays of a nadir image's lines and samples (n,) meet the ground."""
    height = np.zeros_like(lines)
    for _ in range(8):  # the rays are so steep that a step leaves a thousandth of the error
        points, _ = image.image_to_ground(lines, samples, height, correction)
        height = sine_height(points, relief)
    return points



GRID_PLANIMETRIC = 200.0
"""m, sigma by which a site's terrain grid lies off the true ground, east and north (design: MOLA grids)."""
GRID_VERTICAL = 10.0
"""m rms, noise of each post of a site's terrain grid."""

_PARTS = 5
"""Points along and across a grid's cell whose mean is its post."""


def grid_shift(terrain: SiteTerrain) -> Array:
    """By how many m (2,) east and north the terrain grid lies off the true ground: drawn from its sigma."""
    return GRID_PLANIMETRIC * _grid_stream(terrain).standard_normal(2)


def terrain_grid(terrain: SiteTerrain, ppd: int, reach: tuple[float, float] = (20e3, 40e3)) -> TerrainGrid:
    """The site as a MOLA grid has it: off in the plane as a whole, with 10 m of noise in each post.

    Posts lie at odd multiples of half a step, `ppd` per degree, as MEGDR's, and enclose at least `reach` (2,) in m:
    east and west, north and south of the centre.
    """
    require(ppd >= 1, "simulated terrain grid, posts per degree", f"{ppd}", "a positive whole number")
    shift, rng = grid_shift(terrain), _grid_stream(terrain)
    rng.standard_normal(2)  # taken by the shift
    centre, half = np.array([terrain.centre_lon, terrain.centre_lat]), np.array(reach) / terrain.metres_per_radian
    lon, lat = posts_between(centre - half, centre + half, DEG / ppd)
    radii = cell_means(terrain, lon, lat, DEG / ppd, shift, _PARTS)
    radii += GRID_VERTICAL * rng.standard_normal(radii.shape)
    return simulated_grid(f"simulated {terrain.site}", ppd, lon, lat, radii, GRID_VERTICAL, GRID_PLANIMETRIC)


def areoid_under(terrain: SiteTerrain, grid: TerrainGrid) -> Array:
    """Radius (rows, columns) in m of the areoid at a grid's posts."""
    rows, columns = grid.radii.shape
    longitudes = grid.first_longitude + grid.longitude_step * np.arange(columns)
    latitudes = grid.first_latitude - grid.latitude_step * np.arange(rows)
    lon, lat = (axis.ravel() for axis in np.meshgrid(longitudes, latitudes))
    return terrain.areoid_radius(lon, lat).reshape(rows, columns)


def cell_means(terrain: SiteTerrain, lon: Array, lat: Array, step: float, shift: Array, parts: int) -> Array:
    """Radius (rows, columns) in m of the ground, the mean over cells of `step` rad about longitudes and latitudes
    (rows, columns): `parts` by `parts` points of each, `shift` (2,) m east and north of where they truly are.
    """
    off_lon, off_lat = shift / terrain.metres_per_radian
    shape, lon, lat = lon.shape, lon.ravel(), lat.ravel()
    radii = np.zeros(lon.size)
    within = (np.arange(parts) + 0.5) / parts - 0.5
    for i in within:
        for j in within:
            radii += terrain.ground_radius(lon + i * step - off_lon, lat + j * step - off_lat) / parts**2
    return radii.reshape(shape)


def posts_between(low: Array, high: Array, step: float) -> tuple[Array, Array]:
    """Longitudes and latitudes (rows, columns) in rad of the posts that enclose `low` and `high` (2,); from the north,
    eastward.
    """
    west, south = np.floor(low / step - 0.5).astype(int)
    east, north = np.ceil(high / step - 0.5).astype(int)
    lon, lat = np.meshgrid((np.arange(west, east + 1) + 0.5) * step, (np.arange(north, south - 1, -1) + 0.5) * step)
    return lon, lat


def simulated_grid(
    source: str, ppd: int, lon: Array, lat: Array, radii: Array, vertical: float | None, planimetric: float | None
) -> TerrainGrid:
    """Radii (rows, columns) in m at such posts, with their sigmas in m."""
    return TerrainGrid(
        source=f"{source} at {ppd} posts per degree",
        radii=radii,
        first_longitude=float(lon[0, 0]),
        first_latitude=float(lat[0, 0]),
        longitude_step=DEG / ppd,
        latitude_step=DEG / ppd,
        vertical_sigma=vertical,
        planimetric_sigma=planimetric,
    )


def _grid_stream(terrain: SiteTerrain) -> np.random.Generator:
    return np.random.default_rng([terrain.seed, list(SITES).index(terrain.site), 1])

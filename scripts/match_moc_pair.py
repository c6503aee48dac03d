"""The real MOC pair E02/01461 and M01/00115 matched where pixels of both are at hand, and held against given ties.

Of E02/01461 there is a map-projected crop, with the SPICE tables of the whole image: its pixels are brought back into
the camera's geometry. Of M01/00115 there are all pixels but no SPICE: its orientation is resected from the given tie
points outside the crop, as `mgsgraph new` and `adjust` do it. Tie points inside the
crop are for comparison alone.

    python scripts/match_moc_pair.py [--data FOLDER] [--step METRES] [--cells N] [--out FILE]

Prints, and fills docs/evidence_real.md. Exit status: 0 done, 2 bad input.
"""

import csv
import sys
import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.ndimage import map_coordinates, spline_filter
from study import DOCS, Blocks, at_least, command, positive, show, table, write_page

from mgsgraph.adjustment.adjust import adjust_network
from mgsgraph.case.resection import ground_in_middle, nominal_image
from mgsgraph.case.schema import RESECTED, OrientationInput
from mgsgraph.errors import InputError
from mgsgraph.files.cameras.camera import LineScanLabel
from mgsgraph.files.cameras.label import read_line_scan_label
from mgsgraph.files.labels.isis_cube import read_isis_cube
from mgsgraph.files.networks.tie_points import PointKind
from mgsgraph.files.pvl import read_label
from mgsgraph.files.rasters.megdr import read_megdr
from mgsgraph.files.rasters.pictures import read_moc_pixels
from mgsgraph.geometry.body import from_planetocentric, geodetic, planetocentric
from mgsgraph.geometry.image import PushbroomImage
from mgsgraph.geometry.orientation import OrientationCorrection, OrientationPrior
from mgsgraph.geometry.records import Array, Mask
from mgsgraph.matching.match import Matches, match_scene
from mgsgraph.matching.scene import Ground, GroundChart, Picture, Scene
from mgsgraph.matching.settings import MatchSettings
from mgsgraph.network.observations import build_network
from mgsgraph.network.parts import KnownImage
from mgsgraph.simulation.observations import free_points
from mgsgraph.text import root_mean_square as rms
from mgsgraph.units import DEG

DATA = Path(__file__).resolve().parents[2] / "shared" / "data"
E02, M01 = "E0201461", "M0100115"
UNKNOWN = OrientationInput(**RESECTED).prior("resection")
"""A-priori sigmas of the resected orientation."""
RESECTED = np.array([[1.0], [0.1], [0.01]]) * np.array([20.0] * 3 + [5e-5] * 3)
"""m and rad, sigmas of both orientations after it, for matching."""
TIE_SIGMA, HEIGHT_SIGMA = 2.0, 100.0
"""px of the ties in the resection (ground off MOLA's grid of 15 km); m, of that ground."""
NEAR, FEWEST = 60.0, 8
"""px of E02, radius around a tie whose matches give its place in M01; least number of them."""


@dataclass(frozen=True, slots=True, eq=False)
class MapGrid:
    """A sinusoidal map as ISIS writes it, on a sphere; (0, 0) is the outer corner of its first pixel."""

    longitude: float
    """rad, centre."""
    radius: float
    """m."""
    corner: tuple[float, float]
    """m, x and y of the upper left corner."""
    step: float
    """m per pixel."""

    @classmethod
    def read(cls, cube: Path) -> "MapGrid":
        """Of a cube's Mapping group."""
        mapping, metres = read_label(cube).inner("IsisCube").inner("Mapping"), {"meters": 1.0, "meters/pixel": 1.0}
        if mapping.text("ProjectionName").lower() != "sinusoidal":
            raise InputError(mapping.where("ProjectionName"), mapping.text("ProjectionName"), "Sinusoidal")
        corner = mapping.number("UpperLeftCornerX", {"": 1.0}), mapping.number("UpperLeftCornerY", {"": 1.0})
        radius, step = mapping.number("EquatorialRadius", metres), mapping.number("PixelResolution", metres)
        return cls(mapping.number("CenterLongitude", {"": DEG}), radius, corner, step)

    def places(self, points: Array) -> Array:
        """(n, 2) line and sample of ground points (n, 3) in m."""
        longitude, latitude, _ = planetocentric(points).T
        x, y = self.radius * (longitude - self.longitude) * np.cos(latitude), self.radius * latitude
        return np.column_stack([(self.corner[1] - y) / self.step, (x - self.corner[0]) / self.step])

    def directions(self, places: Array) -> Array:
        """(n, 3) unit, body-fixed, of places (n, 2)."""
        latitude = (self.corner[1] - self.step * places[:, 0]) / self.radius
        x = self.corner[0] + self.step * places[:, 1]
        longitude = self.longitude + x / (self.radius * np.cos(latitude))
        return from_planetocentric(np.column_stack([longitude, latitude, np.ones_like(latitude)]))


class Ties(NamedTuple):
    """Given tie points that both images have."""

    names: list[str]
    e02: Array
    """(n, 2) line, sample; the first pixel's centre at (0.5, 0.5)."""
    m01: Array
    """(n, 2) the same."""


def read_ties(path: Path) -> Ties:
    """Those of the data folder, whose first pixel's centre is at (1, 1)."""
    places = dict[str, dict[str, tuple[float, float]]]()
    with path.open(newline="") as file:
        for row in csv.DictReader(file):
            places.setdefault(row["id"], {})[row["product"]] = float(row["line"]) - 0.5, float(row["sample"]) - 0.5
    common = {name: pixels for name, pixels in places.items() if {E02, M01} <= pixels.keys()}
    return Ties(list(common), *(np.array([pixels[image] for pixels in common.values()]) for image in (E02, M01)))


# --- M01/00115, of which nothing but the label is known


def resected(label: LineScanLabel, like: PushbroomImage, points: Array, places: Array) -> (
    tuple[PushbroomImage, OrientationCorrection]
):
    """The start of `mgsgraph new` for an image without kernels, and its adjustment to known ground points (n, 3)."""
    image = nominal_image(label, like, ground_in_middle(label, places, points), name=M01)
    ids = tuple(f"{k}" for k in range(len(points)))
    ties = free_points("ties", ids, np.arange(len(ids)), (M01,) * len(ids), places, TIE_SIGMA)
    known = replace(ties, kinds=np.full(len(ids), PointKind.FIXED), places=points)
    network = build_network({M01: KnownImage(image, UNKNOWN)}, [known])
    assert network is not None
    return image, adjust_network(network).correction(M01)


# --- E02/01461, of which there is a map


def read_map(cube: Path) -> Array:
    """Pixels (lines, samples) of a map-projected cube, NaN where it has none."""
    import warnings

    import rasterio
    from rasterio.errors import NotGeoreferencedWarning

    with warnings.catch_warnings():
        warnings.simplefilter("ignore", NotGeoreferencedWarning)
        with rasterio.open(cube) as file:
            pixels = file.read(1).astype(np.float64)
    return np.where(np.abs(pixels) < 1e30, pixels, np.nan)


class CameraWindow(NamedTuple):
    """The part of an image that a map of it shows, in the camera's geometry again."""

    image: PushbroomImage
    """That part alone."""
    corner: Array
    """(2,) line and sample of the whole image at which it begins."""
    pixels: Array
    """(lines, samples), NaN beyond the map."""


def into_camera(image: PushbroomImage, apparent: PushbroomImage, grid: MapGrid, pixels: Array, ground: Ground) -> (
    CameraWindow
):
    """Bring a map back; it was made with apparent positions, over another terrain model that is not at hand."""
    height, width = pixels.shape
    edges = np.array([[0.0, 0.0], [0.0, width], [height, 0.0], [height, width]])
    corners = apparent.ground_to_image(on_ground(ground, grid.directions(edges)))[0]
    low, high = np.floor(corners.min(axis=0)), np.ceil(corners.max(axis=0))
    lines, samples = (high - low).astype(int)
    rows, columns = (values.ravel() for values in np.mgrid[:lines, :samples] + 0.5)
    places = grid.places(ground.meet(*apparent.sightlines(low[0] + rows, low[1] + columns)))
    # cubic: the camera's pixels are smaller than the map's
    grey = map_coordinates(spline_filter(pixels, mode="mirror"), (places - 0.5).T, prefilter=False, mode="mirror")
    beyond = np.any((places < 0.5) | (places > np.array([height, width]) - 0.5), axis=1)
    start = image.timing.at(low[:1])[0]
    first = image.interior.first + np.array([0.0, low[1] * image.interior.sample_summing])
    part = replace(
        image, lines=int(lines), samples=int(samples), interior=replace(image.interior, first=first),
        timing=replace(image.timing, start_times=start),
    )  # fmt: skip
    return CameraWindow(part, low, np.where(beyond, np.nan, grey).reshape(lines, samples))


def on_ground(ground: Ground, directions: Array) -> Array:
    """(n, 3) m, the ground in directions from the body's centre."""
    return ground.points(ground.chart.plane(directions))


# --- the comparison


class Comparison(NamedTuple):
    """Place of a tie in M01 by the matches around it, against the given network."""

    name: str
    matches: int
    """Around it."""
    off: Array
    """(2,) px, line and sample: by the matches, minus given."""
    parted: Array
    """(2,) px, across and along the motion of the place with height."""
    scatter: float
    """px, of the matches about their surface, rms of a coordinate."""
    model: float
    """m above MOLA's grid, height of the map's terrain model that explains the difference along it."""


def compared(matches: Matches, window: CameraWindow, ties: Ties, inside: Mask, slope: Array) -> list[Comparison]:
    """At each tie a surface through the matches near it; `slope` (n, 2) px per m: how M01's places move with height."""
    reference = matches.reference
    e02, m01 = matches.ties.measures[reference] + window.corner, matches.ties.measures[~reference]
    rows = list[Comparison]()
    for k in np.flatnonzero(inside):
        near = np.linalg.norm(e02 - ties.e02[k], axis=1) < NEAR
        count = int(np.count_nonzero(near))
        if count < FEWEST:
            rows.append(Comparison(ties.names[k], count, np.full(2, np.nan), np.full(2, np.nan), np.nan, np.nan))
            continue
        away = e02[near] - ties.e02[k]
        design = np.column_stack([np.ones(count), away, away[:, 0] ** 2])  # jitter bends it along the lines
        fitted = np.linalg.lstsq(design, m01[near], rcond=None)[0]
        rest = m01[near] - design @ fitted
        off = fitted[0] - ties.m01[k]
        parted = by_parallax(off[None], slope[k : k + 1])[0]
        scatter, per_metre = float(np.sqrt(np.sum(rest**2) / (2 * count - 8))), float(np.linalg.norm(slope[k]))
        rows.append(Comparison(ties.names[k], count, off, parted, scatter, -float(parted[1]) / per_metre))
    return rows


def by_parallax(off: Array, slope: Array) -> Array:
    """(n, 2) px, differences (n, 2) across and along the motion (n, 2) of places with height."""
    along = slope / np.linalg.norm(slope, axis=1, keepdims=True)
    across = np.column_stack([-along[:, 1], along[:, 0]])
    return np.column_stack([np.einsum("ni,ni->n", off, across), np.einsum("ni,ni->n", off, along)])


def text(values: Array | float) -> str:
    """Numbers as text."""
    return " / ".join(f"{value:.2f}" for value in np.atleast_1d(values))


class Trial(NamedTuple):
    """Results of a run."""

    ties: Ties
    inside: Mask
    """(n,) which of them the crop shows."""
    off: Array
    """(n, 2) px, ties' places in M01 minus where the resected orientation sees them."""
    slope: Array
    """(n, 2) px per m, how these places move when the ground is higher on the ray of E02."""
    matches: Matches
    comparisons: list[Comparison]
    samples_per_metre: float
    """Motion of the crop's places in E02 with the height of its map's terrain model."""
    seconds: float
    """Of matching."""


def trial(data: Path, settings: MatchSettings) -> Trial:
    """The whole trial, from the files on."""
    pair = data / "mgs_moc_pair"
    cube, plain = pair / f"{E02}.tiny.cub", pair / f"{M01}.img"
    image, apparent = read_isis_cube(cube), read_isis_cube(cube, apparent=True)
    grid, ties, crop = MapGrid.read(cube), read_ties(pair / "tie_points.csv"), read_map(cube)
    ground = ground_about(image, grid, crop.shape, data)
    window = into_camera(image, apparent, grid, crop, ground)
    points = ground.meet(*image.sightlines(*ties.e02.T))
    local = ties.e02 - window.corner
    size = np.array(window.pixels.shape)
    inside = np.all((local > 0.0) & (local < size), axis=1)
    inside[inside] = np.isfinite(window.pixels[tuple(local[inside].astype(int).T)])
    m01, correction = resected(read_line_scan_label(plain), image, points[~inside], ties.m01[~inside])
    predicted = m01.ground_to_image(points, correction)[0]
    up = points / np.linalg.norm(points, axis=1, keepdims=True)
    rays = image.sightlines(*ties.e02.T)[1]
    higher = points + rays / np.einsum("ni,ni->n", rays, up)[:, None]  # by a metre, up the ray of E02
    slope = m01.ground_to_image(higher, correction)[0] - predicted
    prior = OrientationPrior(RESECTED)
    scene = Scene(
        (Picture(window.image, window.pixels, prior), Picture(m01, read_moc_pixels(plain), prior, correction)), ground
    )
    begin = time.perf_counter()
    matches = match_scene(scene, settings, progress=lambda what, done, most: show(f"{what} {done} of {most}"))
    seconds = time.perf_counter() - begin
    show("")
    lifted = np.abs(image.ground_to_image(points + up)[0] - ties.e02)[:, 1]
    return Trial(
        ties, inside, ties.m01 - predicted, slope, matches, compared(matches, window, ties, inside, slope),
        float(np.median(lifted)), seconds,
    )  # fmt: skip


def ground_about(image: PushbroomImage, grid: MapGrid, shape: tuple[int, ...], data: Path) -> Ground:
    """MOLA's grid about the middle of the crop."""
    terrain = read_megdr(data / "mola_megdr" / "megr90n000cb.img")
    middle = grid.directions(0.5 * np.array([shape], dtype=np.float64))
    middle = middle * terrain.at(middle)[:, None]
    flight = image.pose(np.array([0.5 * image.lines])).velocity[0]
    height = float(geodetic(middle, image.body)[0, 2])
    return Ground(GroundChart.about(middle, flight), image.body, height, HEIGHT_SIGMA, terrain)


HEAD = ("tie", "matches", "scatter", "line / sample", "across / along", "model / ground, m")


def tables(result: Trial) -> Blocks:
    """Figures, and a table of the ties."""
    matches, inside, in_m01 = result.matches, result.inside, ~result.matches.reference
    sigmas = np.median(np.sqrt(np.linalg.eigvalsh(matches.covariances[in_m01])), axis=0)
    before = by_parallax(result.off, result.slope)
    heights = (before[:, 1] / np.linalg.norm(result.slope, axis=1))[inside]
    parted = np.array([row.parted for row in result.comparisons if np.isfinite(row.scatter)]).reshape(-1, 2)
    rows = [
        [row.name, f"{row.matches}", text(row.scatter), text(row.off), text(row.parted), f"{row.model:.0f} / {up:.0f}"]
        for row, up in zip(result.comparisons, heights, strict=True)
    ]
    steps = ", ".join(f"{name} {count}" for name, count in matches.losses._asdict().items())
    return {"figures": [
        f"* Ties that both images have: {inside.size}; in the crop: {int(inside.sum())}.",
        "* Resection of M01 by those outside, rms across / along the parallax: "
        f"{text(rms(before[~inside], 0))} px; those in the crop, with it: {text(rms(before[inside], 0))} px.",
        f"* Matches: {len(matches.ties.ids)} in {matches.cells[0]} of {matches.cells[1]} cells of {matches.cell:.0f} m "
        f"({steps}); {result.seconds:.1f} s.",
        f"* Their stated sigmas (px of M01, axes of the ellipse, median): {text(sigmas)}; correlation, median: "
        f"{np.median(matches.correlation[in_m01]):.3f}; coplanarity, rms: {text(rms(matches.misfit[in_m01], 0))} m.",
        f"* Agreement with the ties, rms across / along the parallax: {text(rms(parted, 0))} px.",
        f"* 100 m of the map's terrain model are {100.0 * result.samples_per_metre:.1f} samples of E02.",
    ], "ties": table(HEAD, rows)}  # fmt: skip


def main() -> int:
    """Command line."""
    parser = command(__doc__)
    parser.add_argument("--data", type=Path, default=DATA, help="folder of the real data")
    parser.add_argument("--step", type=positive, default=None, help="m between pixels of the ground grid")
    parser.add_argument("--cells", type=at_least(1), default=1000, help="of the ground that both show")
    parser.add_argument("--out", type=Path, default=DOCS / "evidence_real.md", help="the page")
    chosen = parser.parse_args()
    settings = MatchSettings(step=chosen.step, cells=chosen.cells)
    return write_page(parser, chosen.out, "evidence_real.md#moc_pair", lambda: tables(trial(chosen.data, settings)))


if __name__ == "__main__":
    sys.exit(main())

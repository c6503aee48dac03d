"""The first real networks: two LROC narrow angles against ISIS jigsaw's own figures, and three MOC wide angles.

    python scripts/real_networks.py [--out FILE]

The data are looked for in ../shared/data from the project's root. Fills docs/evidence_real.md.

Exit status: 0 done, 2 bad input.
"""

import sys
import tempfile
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from jigsaw_cameras import PUBLISHED, determined, jigsaw_cameras, measures_of, meeting, read_rig, rig_residuals
from study import DOCS, Blocks, command, table, write_page

from mgsgraph.adjustment.solution import Solution
from mgsgraph.analysis.measures import MeasureKind, ScalarMeasures
from mgsgraph.analysis.reliability import reliability
from mgsgraph.case.reading import adjust, read_case
from mgsgraph.files.labels.isis_cube import read_isis_cube
from mgsgraph.files.networks.binary import read_control_network
from mgsgraph.files.networks.tie_points import TiePoints
from mgsgraph.files.rasters.raster_file import geotiff
from mgsgraph.geometry.body import east_north_up, geodetic
from mgsgraph.geometry.camera import InteriorOrientation, NoDistortion
from mgsgraph.geometry.image import LineTiming, PushbroomImage
from mgsgraph.geometry.records import Array
from mgsgraph.units import ISIS_OFFSET, KM

ROOT = Path(__file__).resolve().parents[1]
DATA, CASES = ROOT.parent / "shared" / "data", ROOT / "scripts" / "cases"
WIDE = ("cube1", "cube2", "cube3")
ON_SPHERE = """
[terrain]
radius = "sphere.tif"
reference_radius_m = 1736500.0
vertical_sigma_m = 300.0
shift = false
planimetric_sigma_m = 0.001
"""

# --- MOC wide angle


class Agreement(NamedTuple):
    """Agreement of ISIS's places in one image with those in the others."""

    meet: float
    """px, rms of all rays about the place where those of a point meet."""
    distance: float
    """m, largest distance of two rays of a point on the ellipsoid."""


@dataclass(frozen=True)
class InverseByIsis:
    """ISIS's projection from ground to image: for MOC's red wide angle it has another polynomial, which is not the
    inverse of that from image to ground (MocWideAngleDistortionMap::SetUndistortedFocalPlane); inverted exactly.
    """

    focal_length: float
    """m."""

    def undistort(self, place: Array) -> tuple[Array, Array]:
        """Ideal places (n, 2) in m of distorted places (n, 2) in m, and their Jacobians (n, 2, 2), without the change
        of the scale along the radius: good for directions of steps, not for their lengths.
        """
        odd = np.zeros(12)
        odd[1::2] = 0.9995458, -0.4237090, 0.2810857, -0.1697522, 0.068131536, -0.012665644
        polynomial = np.polynomial.Polynomial(odd)
        radius = np.linalg.norm(place, axis=1)
        angle = distorted = np.arctan2(radius, self.focal_length)
        for _ in range(20):
            angle = angle - (polynomial(angle) - distorted) / polynomial.deriv()(angle)
        scale = np.where(radius > 0.0, self.focal_length * np.tan(angle) / np.maximum(radius, 1e-12), 1.0 / odd[1])
        return place * scale[:, None], scale[:, None, None] * np.eye(2)


Fault = Callable[[PushbroomImage], PushbroomImage]
"""An image with something wrong in it."""


def _of_optics(**changes: Callable[[InteriorOrientation], Any]) -> Fault:
    return lambda image: replace(
        image, interior=replace(image.interior, **{key: change(image.interior) for key, change in changes.items()})
    )


def _of_times(lines: float, longer: float) -> Fault:
    def changed(image: PushbroomImage) -> PushbroomImage:
        first, starts, periods = (getattr(image.timing, key) for key in ("first_lines", "start_times", "periods"))
        return replace(image, timing=LineTiming(first, starts + lines * periods, periods * (1.0 + longer)))

    return changed


PLANTED: dict[str, Fault] = {
    "centre one sample off": _of_optics(centre=lambda interior: interior.centre + np.array([0.0, 1.0])),
    "focal length 0.1 % longer": _of_optics(focal_length=lambda interior: 1.001 * interior.focal_length),
    "no distortion": _of_optics(distortion=lambda _: NoDistortion()),
    "times one line off": _of_times(1.0, 0.0),
    "line period 0.1 % longer": _of_times(0.0, 1e-3),
}
"""Faults that the agreement would show."""
_by_isis = _of_optics(distortion=lambda interior: InverseByIsis(interior.focal_length))


def by_isis(planted: Fault = lambda image: image) -> Fault:
    """With ISIS's polynomial from ground to image, and a fault."""
    return lambda image: planted(_by_isis(image))


def wide_agreement(data: Path, apparent: bool, planted: Fault = lambda image: image) -> Agreement:
    """Of the network's places by the cubes' own cameras, positions apparent, as ISIS takes them, or geometric."""
    folder = data / "mgs_moc_wa_three"
    images = [planted(read_isis_cube(folder / f"{name}.isd", apparent=apparent)) for name in WIDE]
    ties = read_control_network(folder / "controlnetwork.net")
    places, on_ellipsoid, off = meeting(images, ties), np.empty((len(ties.measure_image), 3)), list[Array]()
    for image in images:
        its = measures_of(ties, image)
        pixels, _ = image.ground_to_image(places[ties.measure_point[its]], start=ties.measures[its, 0])
        off.append(pixels - ties.measures[its])
        on_ellipsoid[its] = image.image_to_ground(*ties.measures[its].T)[0]
    pairs = [
        np.linalg.norm(on_ellipsoid[k] - on_ellipsoid[m])
        for i in range(len(ties.ids))
        for k in np.flatnonzero(ties.measure_point == i)
        for m in np.flatnonzero(ties.measure_point == i)
    ]
    return Agreement(float(np.sqrt(np.mean(np.concatenate(off) ** 2))), float(max(pairs)))


def _round_trip(image: PushbroomImage, pixels: Array) -> float:
    """px, largest difference that ISIS's two polynomials make at pixels (n,) of the detector."""
    samples = pixels - image.interior.first[1]
    places = [camera.interior.focal_plane(samples)[0] for camera in (image, _by_isis(image))]
    return float(np.abs(places[0] - places[1]).max() * np.linalg.norm(image.interior.to_pixel[0, 1:]))


class Adjusted(NamedTuple):
    """An adjusted case."""

    solution: Solution
    residuals: Array
    """(2,) px, rms in lines and samples."""
    sigmas: Array
    """(3,) m, median of tie points eastward, northward, upward, for sigma0 = 1."""
    heights: Array
    """(2,) m, least and largest height of tie points above the ellipsoid."""


def adjusted(case: Path) -> Adjusted:
    """A case, adjusted."""
    solution = adjust(read_case(case))
    axes = east_north_up(solution.places)
    variances = np.einsum("nik,nkl,nil->ni", axes, solution.covariances, axes)[solution.determined]
    heights = geodetic(solution.places, solution.network.body)[:, 2]
    rms = np.sqrt(np.mean(solution.residuals[solution.rays_used] ** 2, axis=0))
    return Adjusted(solution, rms, np.sqrt(np.median(variances, axis=0)), np.array([heights.min(), heights.max()]))


# --- the page


def main() -> int:
    """Exit status."""
    parser = command(__doc__)
    parser.add_argument("--out", type=Path, default=DOCS / "evidence_real.md", help="the page")
    options = parser.parse_args()
    return write_page(parser, options.out, "evidence_real.md#networks", lambda: {**rig_page(DATA), **wide_page(DATA)})


def rig_page(data: Path) -> Blocks:
    """Tables on LROC."""
    images, ties = read_rig(data)
    newer, older = PUBLISHED.values()
    cameras, half = (jigsaw_cameras(images, ties, newer, off) for off in (0.0, 0.5))
    ours = adjusted(CASES / "jigsaw_nac.toml")
    residuals = rig_residuals(ours.solution, ties)
    size, across = np.linalg.norm(residuals, axis=1), float(np.sqrt(np.mean(residuals[:, 1] ** 2)))
    mean = newer.places[0]
    fixed = cameras.fixed | {f"{name}, half a sample off": part for name, part in half.fixed.items()}
    versions = [[f"mean {axis}, km", f"{new:.5f}", f"{old:.5f}", f"{(new - old) * KM:.0f} m"]
                for axis, new, old in zip("XYZ", mean, older.places[0], strict=True)]
    versions += [[f"first angle of L, s^{k}, deg", f"{new:.5f}", f"{old:.5f}", f"{new - old:.3f} deg"]
                 for k, (new, old) in enumerate(zip(newer.ascension[0], older.ascension[0], strict=True))]
    versions += [["mean residual, px", f"{newer.mean:.6f}", f"{older.mean:.6f}", f"{newer.mean - older.mean:.6f} px"]]
    compared = [
        [name, f"{a:.5f}", f"{b:.5f}", f"{a - b:+.5f}"] for name, a, b in (
            ("mean residual, radii free, px", size.mean(), cameras.mean),
            ("largest residual, radii free, px", size.max(), cameras.largest),
            ("residuals along y, rms, px", across, cameras.sample_rms),
        )
    ] + [["mean residual, radii held, px", "-", f"{newer.mean:.5f}", ""], ["adjusted places", "-", "as above", ""]]
    return {
        "fixed": table(("fixed point", "L x", "L y", "R x", "R y"), [
            [name, *(f"{value:.3f}" for value in part.ravel())] for name, part in fixed.items()
        ]),
        "agree": table(("", "px"), [
            ["L and R at the fixed points, largest difference",
             f"{max(np.abs(np.diff(part, axis=0)).max() for part in cameras.fixed.values()):.3f}"],
            ["residuals along y, rms", f"{cameras.sample_rms:.3f}"],
            ["their means times 1, s, s^2, s^3", ", ".join(f"{value:.4f}" for value in cameras.moments)],
        ]),
        "determined": determined_table(*determined(images, ties), float(np.linalg.norm(mean - older.places[0]))),
        "versions": table(("", "ISIS 8 and 9", "an older ISIS", "difference"), versions),
        "opened": table(("a-priori sigma, mrad", "along y, rms, px", "all, rms, px", "farthest, m"), opened(ties)),
        "compared": table(("", "here", "ISIS's cameras", "difference"), compared),
        "geodesy": geodesy_table(ours, int(np.sum(np.all((ties.measures + ISIS_OFFSET) % 1.0 == 0.0, axis=1)))),
    }  # fmt: skip


def determined_table(spectrum: Array, sigma: Array, moved: float) -> list[str]:
    """Determined and undetermined parameters."""
    return table(("", "value"), [
        ["singular values: first, twelfth", f"{spectrum[0]:.2f}, {spectrum[11]:.2f}"],
        ["thirteenth, last", f"{spectrum[12]:.1e}, {spectrum[15]:.1e}"],
        ["sigma of a free point for 1 px, median, east and north", f"{sigma[0] / KM:.0f} and {sigma[1] / KM:.0f} km"],
        ["two versions of ISIS put the points apart by", f"{moved * KM:.0f} m"],
    ])  # fmt: skip


def geodesy_table(ours: Adjusted, integers: int) -> list[str]:
    """The adjustment of the rig, for a geodesist."""
    of_rays = controlled(ours.solution)
    return table(("", "value"), [
        ["degrees of freedom, sigma0", f"{ours.solution.fit.degrees_of_freedom}, {ours.solution.sigma0:.2f}"],
        ["measures on whole pixels", str(integers)],
        ["sigma of a height, median", f"{ours.sigmas[2] / KM:.0f} km"],
        ["image coordinates controlled by nothing",
         f"{int(np.sum(np.isinf(of_rays.detectable)))} of {of_rays.detectable.size}"],
    ])  # fmt: skip


def controlled(solution: Solution) -> ScalarMeasures:
    """How image coordinates are controlled."""
    measures = reliability(solution).measures
    return measures.part(0, int(np.count_nonzero(measures.kind == MeasureKind.RAY)))


def opened(ties: TiePoints) -> list[list[str]]:
    """Rows of what wider a-priori sigmas do, with heights within 300 m of a sphere: residuals, and how far places go
    from those of the narrowest.
    """
    text, rows, first = (CASES / "jigsaw_nac.toml").read_text(encoding="utf-8"), list[list[str]](), None
    with tempfile.TemporaryDirectory() as folder:
        _write_sphere(Path(folder) / "sphere.tif")
        for sigma in ("0.29", "3", "30", "100"):
            case = text.replace("[0.29, 0.29, 1e-9]", f"[{sigma}, {sigma}, 1e-9]").replace("../../..", str(ROOT.parent))
            (Path(folder) / "case.toml").write_text(case + ON_SPHERE, encoding="utf-8")
            solution = adjusted(Path(folder) / "case.toml").solution
            first = solution.places if first is None else first
            rms = np.sqrt(np.mean(rig_residuals(solution, ties) ** 2, axis=0))
            moved = np.linalg.norm(solution.places - first, axis=1).max()
            rows.append([sigma, f"{rms[1]:.4f}", f"{np.linalg.norm(rms):.4f}", f"{moved:.0f}"])
    return rows


def _write_sphere(path: Path) -> None:
    """A terrain model of no relief around the images' ground."""
    sphere = "+proj=longlat +R=1737400 +no_defs"
    with geotiff(path, (1, 40, 20), sphere, (2.5, 28.0), (0.1, 0.1), dtype="float32") as file:
        file.write(np.zeros((1, 40, 20), dtype=np.float32))


def wide_page(data: Path) -> Blocks:
    """Tables on MOC."""
    rows = [[name, f"{agreement.meet:.5f}", f"{agreement.distance:.1f}"] for name, agreement in (
        ("apparent, as ISIS takes them", wide_agreement(data, True)), ("geometric", wide_agreement(data, False)),
        ("apparent, ISIS's way from ground to image", wide_agreement(data, True, by_isis())),
        *((f"the same, {name}", wide_agreement(data, True, by_isis(fault))) for name, fault in PLANTED.items()),
    )]  # fmt: skip
    image = read_isis_cube(data / "mgs_moc_wa_three" / "cube1.isd")
    near, far = (_round_trip(image, np.linspace(*ends, 200)) for ends in ((674.0, 2674.0), (0.0, 3349.0)))
    alone, mola = (adjusted(CASES / f"moc_wa_three{end}.toml") for end in ("", "_mola"))
    results = [
        [name, *(f"{value:.4f}" for value in result.residuals), f"{result.solution.sigma0:.4f}",
         str(result.solution.fit.degrees_of_freedom), f"{controlled(result.solution).redundancy.sum():.0f}",
         *(f"{value:.0f}" for value in (*result.sigmas, *result.heights))]
        for name, result in (("alone", alone), ("on MOLA's grid", mola))
    ]  # fmt: skip
    shift = float(np.abs(np.concatenate(mola.solution.shift_values)).max())
    head = ("", "lines, px", "samples, px", "sigma0", "degrees of freedom", "of them the rays'", "sigma east, m",
            "north", "up", "least height, m", "largest")  # fmt: skip
    polynomials = f"ISIS's polynomials differ by up to {near:.2f} px within 1000 px of the centre, {far:.1f} px in all."
    return {
        "places": [*table(("positions of the cameras", "meet, px", "apart, m"), rows), "", polynomials],
        "wide": [*table(head, results), "", f"MOLA's grid moved by {shift:.1f} m."],
    }


if __name__ == "__main__":
    sys.exit(main())

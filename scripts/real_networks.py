"""The first real networks: two LROC narrow angles against ISIS jigsaw's own figures, and three MOC wide angles.

    python scripts/real_networks.py [--page docs/real_networks.md]

The data are looked for in ../shared/data from the project's root.

Exit status: 0 done, 2 bad input.
"""

import sys
import tempfile
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from jigsaw_cameras import determined, jigsaw_cameras, measures_of, meeting, read_rig, rig_residuals
from jigsaw_published import PUBLISHED
from study import command, made_with, table, write_page

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
WORDS = """# The first real networks

Made by `scripts/real_networks.py`; cases: `scripts/cases/jigsaw_nac.toml`, `moc_wa_three.toml`,
`moc_wa_three_mola.toml`. {made}

## Two LROC narrow angles near Hadley rille, and ISIS's jigsaw

`lro_nac_hadley`: NAC-L and NAC-R of one moment, with some 130 samples in common; 46 points, two of them fixed, 92
measures. ISIS has a test of jigsaw on them (`FunctionalTestJigsawCamSolveAll`: camsolve=all, ckdegree=2,
cksolvedegree=3, twist=no, spsolve=none, radius=no, observations=yes, no a-priori sigmas). What it expects is an
authority from outside. What these settings do, by ISIS's source (SpiceRotation, IsisBundleObservation,
BundleControlPoint, ControlPoint):

* The camera's three angles about 3, 1, 3 get polynomials of degree 2 of time, scaled to -1 .. 1 over the attitude
  table (here `nominal = "attitude polynomial"`), and a cubic term of zero. 8 coefficients of the first two angles are
  unknown in each image.
* The two images are not one observation, whatever `observations=yes` says: the images of one observation get the
  coefficients of its first, and those expected differ (123.95 and 121.42 degrees).
* `radius=no` holds the radii of the 44 free points. The network has none. They come from where the nominal cameras'
  rays met the shape model of the labels, `ldem_128ppd_Mar2011_clon180_radius_pad.cub`: that is not in the data, and
  LOLA's shots (`RDR_hadley_LOLA`) end 5 km beside the points. ISIS's places lie {radius:.2f} km from the centre (rms)
  and the reference sphere has 1737.40 km: the test was run on a terrain model.
* Every coordinate counts 1.4 pixels. Residuals are measured minus computed in the focal plane, without distortion, at
  the measured line's time.

### ISIS's adjusted cameras here

The expected polynomials in this project's geometry (line times, optics, positions, rotation of the Moon; twist from
the fit above). Residuals in px along x and y of the focal planes, R's being turned by half a turn against L's:
"""
HALFWAY = """
Four directions that nothing else determines (below) carry both images over the fixed points until L and R miss each by
the same amount on opposite sides, that is with the same sign in focal planes turned against each other. So L and R must
agree to 0.02 px, the tolerance of the expected coefficients (1e-5 degrees), and stay below jigsaw's largest residual of
0.38 px. They agree to {agree:.3f} px. *Half a sample off* is the detector_center of these ISDs as it stands, which is
ISIS's BORESIGHT_SAMPLE: ISIS counts the centre of the first pixel as 1. Then they disagree by a pixel. That half is
taken off when such an ISD is read, and `check` says so.

At a least-squares solution the residuals along y, which radii hardly touch ({rms:.3f} px rms), have neither mean nor
trend: their means times 1, s, s^2 and s^3 are {moments} px.

### What is determined, and what is not

With radii held, and the points' horizontal places eliminated, the 16 coefficients (unit columns) have twelve singular
values from {first:.2f} to {twelfth:.2f}, and four of {thirteenth:.1e} to {last:.1e}. Both images see the same ground
140 lines apart, all along: a cubic of time that moves the ground alike in both moves no measure against another. Four
such coefficients of pitch and four of roll are common, and two fixed points hold four of the eight. For residuals of
1 px the free points' standard deviations are {east:.0f} km east and {north:.0f} km north (medians). `mgsgraph adjust`
refuses such a network by name (*nothing determines quadratic pitch of images ... alike*). jigsaw solves it, since
1e-5 is not zero; its answer for these four is residuals times 100,000. Two versions of ISIS put the points
{moved:.0f} m apart:
"""
BETWEEN = """
A comparison of adjusted places to 1 cm compares these. What the a-priori sigma of the coefficients does, here with
heights within 300 m of a sphere of 1736.5 km in place of the terrain model:
"""
COMPARED = """
### Ours and theirs

The case has jigsaw's settings but for two: a-priori sigmas of 0.29 mrad for every coefficient, which hold the four,
and free radii, since there is no model to hold them. Of ISIS's cameras, too, radii are then set free:
"""
RIG_READING = """
Tried, and not reached: places to 1 cm (nothing determines them), and jigsaw's mean residual of 0.123132 px with radii
held (the radii are not here; 100 m of radius are 0.1 px between L and R along track). The mean with free radii is the
same to 1e-4 px, but that the rms differs says that it is so by chance: ISIS's cameras fit better by what the four
free directions buy at the price of a kilometre, as in the table above. Ours turn about the camera's own axes with z
held, jigsaw's add to angles with the twist held.

For a geodesist: {degrees} degrees of freedom and sigma0 {sigma0:.2f} of 1.4 px, though {whole} of the 92 measures are
Candidates on whole pixels. The rays of a point converge by 0.1 degrees: heights have sigmas of {up:.0f} km and say
nothing, and free radii take whatever two lines disagree by: {blind} of the {rows} image coordinates are controlled by
nothing, all lines of free points among them (`analyze`). The rig ties two images to each other across the flight, not
to the Moon. For that it needs a terrain model (`[terrain]`) with a-priori sigmas of the pointing, or a second pass.

## Three MOC wide angles in Meridiani Planum

`mgs_moc_wa_three`: E09/02065, E10/04086 and E21/00288, 480 x 480 pixels of 250 m each, 16 points, 41 measures; by the
tables that spiceinit attached and the labels beside them. There are no kernels of 2001 and 2002 in the data to try
the road by kernels with.

Nobody has measured this network: all measures are Candidates at their a-priori places, where ISIS computed them by
its own cameras. That makes it an authority on the camera here:
"""
WIDE_WORDS = """
*meet*: rms of the measures about where the rays of each point meet. *apart*: largest distance of two rays of a point on
the ellipsoid, where ISIS placed the points: above it MOLA's ground is {low} to {high} m. With positions as ISIS takes
them (light time and aberration left in) and ISIS's polynomial for the way from ground to image, all places agree to
0.3 m, 1e-3 px; the faults planted on top show what that excludes. That polynomial is not the inverse of the one for the
way back, which measures are taken with, and which is the one here: the two differ by up to {near:.2f} px within 1000 px
of the centre and {far:.1f} px within 1675 px. Geometric positions, which are adjusted, agree to 0.01 px.

Adjusted with sigmas of 1 px and the default a-priori sigmas (100 m, 0.29 mrad, quadratic):
"""
WIDE_READING = """
* Alone, the images know no heights. They look from three orbits along the same directions, rays converge by 0.35 to 5
  degrees, and `check` says so of all 16 points. The horizontal sigmas follow from the heights'.
* On MOLA's grid (4 posts per degree; 50 m between them) heights are the grid's. Horizontal sigmas of {east:.0f} m are
  the prior's 100 m and 0.29 mrad and the grid's own 200 m; it moved by {shift:.1f} m. 2 km of height move the rays by
  0.01 px in samples: at 1 px the control fits, at the {noise:.3f} px that computed places are good for it doesn't,
  and shouldn't.
* Of the {alone} and {mola} degrees of freedom {rays:.0f} and {mola_rays:.0f} are the rays': a pixel is 0.62 mrad, twice
  the pointing's a-priori sigma, so that rays of 1 px correct the orientation hardly at all. A sigma0 far below 1 says
  that nothing was measured. The network tests cameras, files and roads; as an adjustment it says nothing of Mars.
"""

# --- MOC wide angle


class Agreement(NamedTuple):
    """How places that ISIS computed in one image agree with those in the others."""

    meet: float
    """px, rms of all rays about the place where those of a point meet."""
    apart: float
    """m, largest distance of two rays of a point on the ellipsoid."""


@dataclass(frozen=True)
class InverseByIsis:
    """What ISIS has for the way from ground to image: for MOC's red wide angle a polynomial of its own, which is not
    the inverse of that for the way back (MocWideAngleDistortionMap::SetUndistortedFocalPlane); turned round exactly.
    """

    focal_length: float
    """m."""

    def undistort(self, place: Array) -> tuple[Array, Array]:
        """Ideal places (n, 2) in m of distorted places (n, 2) in m, and their Jacobians (n, 2, 2), without the bending
        of the scale along the radius: for steps, not for steps' lengths.
        """
        odd = np.zeros(12)
        odd[1::2] = 0.9995458, -0.4237090, 0.2810857, -0.1697522, 0.068131536, -0.012665644
        polynomial = np.polynomial.Polynomial(odd)
        radius = np.linalg.norm(place, axis=1)
        angle = wanted = np.arctan2(radius, self.focal_length)
        for _ in range(20):
            angle = angle - (polynomial(angle) - wanted) / polynomial.deriv()(angle)
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
"""What the agreement would show."""
_by_isis = _of_optics(distortion=lambda interior: InverseByIsis(interior.focal_length))


def by_isis(planted: Fault = lambda image: image) -> Fault:
    """With ISIS's polynomial for the way from ground to image, and something wrong."""
    return lambda image: planted(_by_isis(image))


def wide_agreement(data: Path, apparent: bool, planted: Fault = lambda image: image) -> Agreement:
    """Of the network's places by the cubes' own cameras, positions apparent, as ISIS takes them, or geometric."""
    folder = data / "mgs_moc_wa_three"
    images = [planted(read_isis_cube(folder / f"{name}.isd", apparent=apparent)) for name in WIDE]
    ties = read_control_network(folder / "controlnetwork.net")
    places, on_ellipsoid, off = meeting(images, ties), np.empty((len(ties.measure_image), 3)), list[Array]()
    for image in images:
        its = measures_of(ties, image)
        seen, _ = image.ground_to_image(places[ties.measure_point[its]], start=ties.measures[its, 0])
        off.append(seen - ties.measures[its])
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
    places = [one.interior.focal_plane(samples)[0] for one in (image, _by_isis(image))]
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
    heights = geodetic(solution.places, solution.network.images[0].body)[:, 2]
    rms = np.sqrt(np.mean(solution.residuals[solution.rays_used] ** 2, axis=0))
    return Adjusted(solution, rms, np.sqrt(np.median(variances, axis=0)), np.array([heights.min(), heights.max()]))


# --- the page


def main(arguments: list[str] | None = None) -> int:
    """Exit status."""
    parser = command(__doc__)
    parser.add_argument("--page", type=Path, help="file to write the page to")
    given = parser.parse_args(arguments)
    return write_page(parser, given.page, lambda: "\n".join([*rig_page(DATA), *wide_page(DATA)]))


def rig_page(data: Path) -> list[str]:
    """Lines of the page on LROC."""
    images, ties = read_rig(data)
    told, older = PUBLISHED.values()
    seen, half = (jigsaw_cameras(images, ties, told, off) for off in (0.0, 0.5))
    spectrum, sigma = determined(images, ties)
    ours = adjusted(CASES / "jigsaw_nac.toml")
    own = np.linalg.norm(rig_residuals(ours.solution, ties), axis=1)
    across = float(np.sqrt(np.mean(rig_residuals(ours.solution, ties)[:, 1] ** 2)))
    mean, spread = told.places[:2]
    of_rays = controlled(ours.solution)
    fixed = seen.fixed | {f"{name}, half a sample off": part for name, part in half.fixed.items()}
    versions = [[f"mean {axis}, km", f"{new:.5f}", f"{old:.5f}", f"{(new - old) * KM:.0f} m"]
                for axis, new, old in zip("XYZ", mean, older.places[0], strict=True)]
    versions += [[f"first angle of L, s^{k}, deg", f"{new:.5f}", f"{old:.5f}", f"{new - old:.3f} deg"]
                 for k, (new, old) in enumerate(zip(told.ascension[0], older.ascension[0], strict=True))]
    versions += [["mean residual, px", f"{told.mean:.6f}", f"{older.mean:.6f}", f"{told.mean - older.mean:.6f} px"]]
    compared = [
        [name, f"{a:.5f}", f"{b:.5f}", f"{a - b:+.5f}"] for name, a, b in (
            ("mean residual, radii free, px", own.mean(), seen.mean),
            ("largest residual, radii free, px", own.max(), seen.largest),
            ("residuals along y, rms, px", across, seen.sample_rms),
        )
    ] + [["mean residual, radii held, px", "-", f"{told.mean:.5f}", ""], ["adjusted places", "-", "as above", ""]]
    whole = int(np.sum(np.all((ties.measures + ISIS_OFFSET) % 1.0 == 0.0, axis=1)))
    return [
        WORDS.format(made=made_with(), radius=np.sqrt(np.sum(mean**2 + spread**2 * 45 / 46))),
        *table(("fixed point", "L x", "L y", "R x", "R y"), [
            [name, *(f"{value:.3f}" for value in part.ravel())] for name, part in fixed.items()
        ]),
        HALFWAY.format(
            agree=max(np.abs(np.diff(part, axis=0)).max() for part in seen.fixed.values()), rms=seen.sample_rms,
            moments=", ".join(f"{value:.4f}" for value in seen.moments), first=spectrum[0], twelfth=spectrum[11],
            thirteenth=spectrum[12], last=spectrum[15], east=sigma[0] / KM, north=sigma[1] / KM,
            moved=np.linalg.norm(mean - older.places[0]) * KM,
        ),
        *table(("", "ISIS 8 and 9", "an older ISIS", "difference"), versions), BETWEEN,
        *table(("a-priori sigma, mrad", "along y, rms, px", "all, rms, px", "farthest place, m"), opened(ties)),
        COMPARED, *table(("", "here", "ISIS's cameras", "difference"), compared),
        RIG_READING.format(
            degrees=ours.solution.fit.degrees_of_freedom, sigma0=ours.solution.sigma0, whole=whole,
            up=ours.sigmas[2] / KM, blind=int(np.sum(np.isinf(of_rays.detectable))), rows=of_rays.detectable.size,
        ),
    ]  # fmt: skip


def controlled(solution: Solution) -> ScalarMeasures:
    """How image coordinates are controlled."""
    every = reliability(solution).measures
    return every.part(0, int(np.count_nonzero(every.kind == MeasureKind.RAY)))


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


def wide_page(data: Path) -> list[str]:
    """Lines of the page on MOC."""
    rows = [[name, f"{one.meet:.5f}", f"{one.apart:.1f}"] for name, one in (
        ("apparent, as ISIS takes them", wide_agreement(data, True)), ("geometric", wide_agreement(data, False)),
        ("apparent, ISIS's way from ground to image", wide_agreement(data, True, by_isis())),
        *((f"the same, {name}", wide_agreement(data, True, by_isis(fault))) for name, fault in PLANTED.items()),
    )]  # fmt: skip
    image = read_isis_cube(data / "mgs_moc_wa_three" / "cube1.isd")
    near, far = (_round_trip(image, np.linspace(*ends, 200)) for ends in ((674.0, 2674.0), (0.0, 3349.0)))
    alone, mola = (adjusted(CASES / f"moc_wa_three{end}.toml") for end in ("", "_mola"))
    results = [
        [name, *(f"{value:.4f}" for value in one.residuals), f"{one.solution.sigma0:.4f}",
         str(one.solution.fit.degrees_of_freedom), *(f"{value:.0f}" for value in (*one.sigmas, *one.heights))]
        for name, one in (("alone", alone), ("on MOLA's grid", mola))
    ]  # fmt: skip
    low, high = (f"{height:.0f}" for height in mola.heights)
    return [
        *table(("positions of the cameras", "meet, px", "apart, m"), rows),
        WIDE_WORDS.format(low=low, high=high, near=near, far=far),
        *table(("", "lines, px", "samples, px", "sigma0", "degrees of freedom", "sigma east, m", "north", "up",
                "least height, m", "largest"), results),
        WIDE_READING.format(
            east=mola.sigmas[0], shift=float(np.abs(np.concatenate(mola.solution.shift_values)).max()),
            noise=float(np.linalg.norm(alone.residuals)), alone=alone.solution.fit.degrees_of_freedom,
            mola=mola.solution.fit.degrees_of_freedom, rays=controlled(alone.solution).redundancy.sum(),
            mola_rays=controlled(mola.solution).redundancy.sum(),
        ),
    ]  # fmt: skip


if __name__ == "__main__":
    sys.exit(main())

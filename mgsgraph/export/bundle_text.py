"""bundleout.txt, in jigsaw's layout. Sources: `bundle_out`."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from mgsgraph.adjustment.solution import Solution
from mgsgraph.export.bundle_orientation import PARAMETERS, OrientationPolynomials
from mgsgraph.files.tie_points import PointKind
from mgsgraph.geometry.body import target_name
from mgsgraph.geometry.records import Array, Index
from mgsgraph.geometry.trajectory import Trajectory
from mgsgraph.network import Network, PointClass, PolynomialPrior
from mgsgraph.text import root_mean_square
from mgsgraph.units import DEG, KM

_COORDINATES = ("LATITUDE", "LONGITUDE", "RADIUS")
_LABELS = ("  X  ", "  Y  ", "  Z  ", " RA  ", "DEC  ", "TWI  ")
_SOLVED = ("", ", VELOCITIES", ", VELOCITIES, ACCELERATIONS")
_FEWEST = 100
"""Observations, above which jigsaw lists percentiles of residuals."""
_DETAIL = (
    "\n     Point         Initial               Total               Total              Final             Initial"
    "             Final\nCoordinate          Value             Correction          Correction            Value"
    "             Accuracy          Accuracy\n                 (dd/dd/km)           (dd/dd/km)           (Meters)"
    "           (dd/dd/km)          (Meters)          (Meters)"
)
_PARAMETERS = (
    f"Image           Initial                 Total                  Final{'':38}Accuracy\n"
    "Parameter       Value                   Correction             Value                      Initial           Final"
    f"           Units\n{'':90}***************************************"
)


@dataclass(frozen=True, slots=True, eq=False)
class Tables:
    """Figures of all points and images in jigsaw's units; of points the coordinates are latitude, longitude, radius."""

    status: list[str]
    """(n) FREE, CONSTRAINED or FIXED."""
    accepted: Index
    """(n,) measures that took part."""
    total: Index
    """(n,) measures."""
    rms: Array
    """(n,) pixels."""
    places: Array
    """(n, 3) degrees and km, adjusted."""
    corrections: Array
    """(n, 3) degrees and km."""
    corrections_m: Array
    """(n, 3) m."""
    prior: Array
    """(n, 3) m; NaN of points that are not constrained."""
    sigmas: Array
    """(n, 3) m."""
    image_accepted: Index
    image_total: Index
    image_rms: Array
    """(m, 3) pixels: samples, lines, both."""
    orientation: list[OrientationPolynomials]
    """(m)"""
    factor: float
    """By which adjusted sigmas are multiplied."""

    def parameters(self, image: int, solution: Solution) -> Iterator[tuple[float, float, float, str, str, str]]:
        """Initial value, correction and final value (km, degrees), a-priori and adjusted sigma (m, degrees), and the
        sigmas' unit, of each coefficient.
        """
        found, held = self.orientation[image], bool(solution.network.held[image])
        for c in range(len(PARAMETERS)):
            unit, size, spread = ("m", KM, 1.0) if c < 3 else ("dd", DEG, DEG)
            for k in range(found.before.shape[1]):
                before, correction = found.before[c, k] / size, found.correction[c, k] / size
                prior, sigma = found.prior[c, k] / spread, found.sigma[c, k] / spread * self.factor
                known = "N/A" if np.isnan(prior) else "FREE" if np.isinf(prior) else f"{prior:.8g}"
                adjusted = "N/A" if held and sigma == 0.0 else f"{sigma:.8f}" if sigma > 1e-4 else f"{sigma:.8g}"
                yield (
                    float(before), float(correction), float(before + correction), known, adjusted,
                    unit + ("" if k == 0 else "/s" if k == 1 else f"/s^{k}"),
                )  # fmt: skip


def bundle_text(solution: Solution, tables: Tables, scaled: bool) -> str:
    """The text, sections in jigsaw's order."""
    return "\n".join([
        *_head(solution, tables, scaled), *_options(solution), *_results(solution), *_percentiles(solution),
        *_image_measures(solution, tables), *_exterior(solution, tables), *_uncertainties(solution, tables),
        *_points(solution, tables), "",
    ])  # fmt: skip


def _title(text: str) -> list[str]:
    return ["", text, "=" * len(text), ""]


def _line(key: str, value: object) -> str:
    return f"{key:>31}: {value}"


def _head(solution: Solution, tables: Tables, scaled: bool) -> list[str]:
    network = solution.network
    inertial = [image.name for image, one in zip(network.images, tables.orientation, strict=True) if one.inertial]
    axes = "J2000" if len(inertial) == len(network.images) else "body-fixed"
    if 0 < len(inertial) < len(network.images):
        axes = f"J2000 for {', '.join(inertial)}, body-fixed for the others"
    sigma = "times sigma0, as jigsaw's" if scaled else "for sigma0 = 1 (jigsaw's are these times sigma0)"
    return [
        *_title("JIGSAW: BUNDLE ADJUSTMENT")[1:],
        f"Written by mgsgraph {solution.versions.get('mgsgraph', '')}, not by jigsaw, in the layout of jigsaw's file.",
        f"* Adjusted sigmas are {sigma}.",
        "* Residuals are measured minus predicted, in pixels of the image (jigsaw: of the detector, undistorted).",
        f"* X, Y, Z, RA, DEC, TWI: polynomials of the time past each image's middle, fitted to its lines, axes {axes}.",
        "  RA, DEC, TWI: angles about the axes 3, 1, 3, as jigsaw's. Initial values are the nominal orientation's,",
        "  with time biases applied; initial accuracies are those of image or pass (nothing of shared unknowns).",
        "* Laser footprints count among the points; what has no counterpart here is N/A.",
        f"* State: {'converged' if solution.converged else 'NOT converged'}. {solution.message}",
        "",
        *(_line(key, "N/A") for key in ("Run Time", "Network Filename", "Cube List")),
        _line("Output Network Filename", "network.net"),
        _line("Output File Prefix", ""),
        _line("Network Id", solution.name),
        _line("Network Description", "N/A"),
        _line("Target", target_name(network.images[0].body)),
        "",
        _line("Linear Units", "kilometers"),
        _line("Angular Units", "decimal degrees"),
    ]


def _options(solution: Solution) -> list[str]:
    network, settings = solution.network, solution.settings
    own = np.flatnonzero(network.with_polynomial).tolist()
    none = "N/A (orientation images)" if network.passes else "NONE"
    kinds, more = list[str](), list[list[str]]()
    for name, keys, degree in zip(("ANGLES", "POSITION"), (("CKDEGREE", "CKSOLVEDEGREE"), ("SPKDEGREE",
                                  "SPKSOLVEDEGREE")), _degrees(network, own), strict=True):  # fmt: skip
        solved = degree is not None and degree >= len(_SOLVED)
        kinds.append("ALL POLYNOMIAL COEFFICIENTS" if solved else none if degree is None else name + _SOLVED[degree])
        more.append([f"{key}: {degree}" for key in keys] if solved else [])
    over = "ON" if all(isinstance(image.trajectory, Trajectory) for image in network.images) else "OFF"
    reject, robust = settings.reject > 0.0, settings.loss != "none"
    return [
        *_title("INPUT: SOLVE OPTIONS"),
        _line("OBSERVATIONS", "ON" if network.passes or network.shared else "OFF"),
        _line("RADIUS", "ON"), _line("TARGET BODY", "OFF"), _line("UPDATE", "NO"), _line("ERROR PROPAGATION", "ON"),
        "  CONTROL POINT COORDINATE TYPE FOR REPORTS: LATITUDINAL",
        "  CONTROL POINT COORDINATE TYPE FOR BUNDLE: RECTANGULAR",
        _line("OUTLIER REJECTION", "ON" if reject else "OFF"),
        _line("REJECTION MULTIPLIER", f"{settings.reject:f}" if reject else "N/A"),
        *_title("MAXIMUM LIKELIHOOD ESTIMATION"),
        _line("Tier 0 Enabled", "TRUE" if robust else "FALSE"),
        *([_line("Maximum Likelihood Model", settings.loss.capitalize()),
           _line("Tweaking constant", f"{settings.width:f} sigmas")] if robust else []),
        _line("Tier 1 Enabled", "FALSE"), _line("Tier 2 Enabled", "FALSE"),
        *_title("INPUT: CONVERGENCE CRITERIA"),
        _line("SIGMA0", f"N/A (relative change of the cost below {settings.cost_tolerance:g})"),
        _line("MAXIMUM ITERATIONS", settings.max_iterations),
        *_title("INPUT: CAMERA POINTING OPTIONS"),
        _line("CAMSOLVE", kinds[0]), *(f"{text:>31}" for text in more[0]), _line("TWIST", "ON"),
        f"POLYNOMIAL OVER EXISTING POINTING : {over}",
        *_title("INPUT: SPACECRAFT OPTIONS"),
        _line("SPSOLVE", kinds[1]), *(f"{text:>31}" for text in more[1]), f"POLYNOMIAL OVER HERMITE SPLINE : {over}",
        *_title("INPUT: GLOBAL IMAGE PARAMETER UNCERTAINTIES"),
        *(f"{f'POINT {name} SIGMA':>33}: N/A" for name in _COORDINATES),
        *_prior_lines(solution, own),
    ]  # fmt: skip


def _degrees(network: Network, own: list[int]) -> tuple[int | None, int | None]:
    """Highest degree of the polynomials of attitude and of position, of images and passes; None where none has any."""
    of_passes = [one.prior for one in network.passes if isinstance(one.prior, PolynomialPrior)]
    both = [network.priors[j].degree for j in own]
    attitude = [*both, *(len(prior.attitude_sigmas) - 1 for prior in of_passes)]
    position = [*both, *(len(prior.position_sigmas) - 1 for prior in of_passes)]
    return max(attitude, default=None), max(position, default=None)


def _prior_lines(solution: Solution, own: list[int]) -> list[str]:
    """A-priori sigmas where all images and axes have the same; a term of u^k has the sigma at the image's ends."""
    lines = []
    names = (("SPACECRAFT POSITION", "SPACECRAFT VELOCITY", "SPACECRAFT ACCELERATION"),
             ("CAMERA ANGLES", "CAMERA ANGULAR VELOCITY", "CAMERA ANGULAR ACCELERATION"))  # fmt: skip
    for c, (group, units, size) in enumerate(zip(names, (("meters", "m"), ("dd", "dd")), (1.0, DEG), strict=True)):
        for k, name in enumerate(group):
            found = set[float]()
            for j in own:
                sigmas, image = solution.network.priors[j].sigmas, solution.network.images[j]
                half = 0.5 * float(np.diff(image.timing.at(np.array([0.0, float(image.lines)]))[0])[0])
                if k < sigmas.shape[0]:
                    found |= {float(f"{s:.9g}") for s in sigmas[k, 3 * c : 3 * c + 3] / half**k / size}
            one = found.pop() if len(found) == 1 else None
            text = "N/A" if one is None else f"{one:f} ({units[k > 0]}{'/s' * k})" if np.isfinite(one) else "FREE"
            lines.append(f"{f'{name} SIGMA':>33}: {text}")
    return lines


def _results(solution: Solution) -> list[str]:
    network, used, fit = solution.network, solution.rays_used, solution.fit
    laser = network.points.classes == PointClass.LASER
    rows = {
        "Images": len(network.images),
        "Points": int(np.sum(~laser & solution.determined)),
        "Lidar Points": int(np.sum(laser & solution.determined)),
        "Total Measures": used.size,
        "Total Observations": 2 * used.size,
        "Good Observations": 2 * int(used.sum()),
        "Rejected Observations": 2 * int((~used).sum()),
        "Constrained Point Parameters": 3 * int(np.sum(network.points.kinds == PointKind.CONSTRAINED)),
        "Constrained Image Parameters": sum(
            int(np.isfinite(network.priors[j].sigmas).sum()) for j in np.flatnonzero(network.with_polynomial).tolist()
        ),
        "Lidar Range Constraints": int(solution.ranges_used.sum()),
        "Unknowns": fit.unknowns,
        "Degrees of Freedom": fit.degrees_of_freedom,
    }
    return [
        *_title("JIGSAW: RESULTS"),
        *(f"{key:>31}: {value:6d}" for key, value in rows.items()),
        _line("Convergence Criteria", "N/A(Sigma0)"),
        _line("Iterations", f"{solution.iterations:6d}"),
        _line("Sigma0", f"{solution.sigma0:30.20f}"),
        _line("Error Propagation Elapsed Time", "N/A"),
        _line("Total Elapsed Time", f"{sum(solution.seconds.values()):6.4f} (seconds)"),
    ]


def _percentiles(solution: Solution) -> list[str]:
    values = solution.residuals[solution.rays_used].ravel()
    if values.size <= _FEWEST:
        return []
    at = np.percentile(values, np.arange(101))
    gap = " " * 17
    lines = [
        gap + gap.join(f"Percentile {p:3d}: {at[p]:+8.3f}" for p in (one, one + 33, one + 66)) for one in range(1, 34)
    ]
    box = zip(("minimum", "Quartile 1", "Median", "Quartile 3", "maximum"), at[::25], strict=True)
    return ["", f"{'Residual Percentiles:':>32}", *lines, "", f"{'Residual Box Plot:':>32}",
            *(f"{name:>31}: {value:+8.3f}" for name, value in box)]  # fmt: skip


def _image_measures(solution: Solution, tables: Tables) -> list[str]:
    names = [image.name for image in solution.network.images]
    width = max(map(len, names)) + 1
    heads = ("           Measures                            RMS(pixels)",
             "***************************   *******************************************",
             "|  Accepted  |   Total    |   |   Samples   |    Lines    |    Total    |")  # fmt: skip
    lines = [*_title("IMAGE MEASURES SUMMARY"), *(f"{'':{width}}{head}" for head in heads)]
    rows = zip(names, tables.image_accepted.tolist(), tables.image_total.tolist(), tables.image_rms, strict=True)
    lines += [f"{name:{width}} {used:12d} {total:12d}     {_three(rms)} " for name, used, total, rms in rows]
    # jigsaw's total: of the images' root mean squares, whatever the number of their measures
    every = root_mean_square(tables.image_rms, 0)
    return [*lines, "", f"{'Total RMS:':{width + 31}}{_three(every)}"]


def _three(values: Array) -> str:
    return " ".join(f"{value:13.4f}" for value in values)


def _exterior(solution: Solution, tables: Tables) -> list[str]:
    lines = _title("IMAGE EXTERIOR ORIENTATION")
    for j, image in enumerate(solution.network.images):
        terms = tables.orientation[j].before.shape[1]
        lines += [f"Image Full File Name: {image.name}", "", f"Image Serial Number: {image.name}", _PARAMETERS]
        for k, row in enumerate(tables.parameters(j, solution)):
            before, correction, after, prior, sigma, unit = row
            c, power = divmod(k, terms)
            of = ("km" if c < 3 else "dd") + unit.removeprefix("dd").removeprefix("m")
            label = f"{_LABELS[c]}({of})" if power == 0 else f"    ({of})"
            values = f"{before:18.8f}  {correction:20.8f}  {after:23.8f}"
            lines.append(f"{label:11}{values}  {'':12}{prior:>6}{'':12}{sigma}{'':8}{unit}")
        lines.append("")
    return lines


def _uncertainties(solution: Solution, tables: Tables) -> list[str]:
    mine = np.flatnonzero(solution.determined & (solution.network.points.kinds != PointKind.FIXED))
    lines = ["", *_title("POINTS UNCERTAINTY SUMMARY")]
    for c, name in enumerate(("Latitude", "Longitude", "Radius")):
        if not mine.size:
            lines += [f"{what} Sigma {name}(m)                 N/A" for what in ("RMS", "MIN", "MAX")]
            continue
        values = tables.sigmas[mine, c]
        lines.append(f"RMS Sigma {name}(m){root_mean_square(values):20.8f}")
        for what, k in (("MIN", values.argmin()), ("MAX", values.argmax())):
            lines.append(f"{what} Sigma {name}(m){values[k]:20.8f} at {solution.network.points.ids[mine[k]]}")
        lines.append("")
    return lines


def _points(solution: Solution, tables: Tables) -> list[str]:
    """Summary and details of all points, control points before laser footprints."""
    laser = solution.network.points.classes == PointClass.LASER
    order = np.argsort(laser, kind="stable").tolist()
    summary = [*_title("POINTS SUMMARY"), f"{'':103}Sigma          Sigma              Sigma",
               "           Label         Status     Rays    RMS        Latitude       Longitude          Radius"
               "        Latitude       Longitude          Radius"]  # fmt: skip
    detail = ["", *_title("POINTS DETAIL")]
    before, ids = tables.places - tables.corrections, solution.network.points.ids
    for i in order:
        used, total, status = int(tables.accepted[i]), int(tables.total[i]), tables.status[i]
        fixed = status == PointKind.FIXED.name
        sigmas = ["N/A"] * 3 if fixed else [_value(value) for value in tables.sigmas[i]]
        places = "".join(f"{_value(value):>16}" for value in tables.places[i])
        rays = f"{used:5d} of {total}{tables.rms[i]:6.2f}"
        summary.append(f"{ids[i]:>16}{status:>15}{rays}{places}" + "".join(f"{sigma:>16}" for sigma in sigmas))
        detail += [f" Label: {ids[i]}", f"Status: {status}", f"  Rays: {used} of {total}", _DETAIL]
        for c, name in enumerate(_COORDINATES):
            prior = status if np.isnan(tables.prior[i, c]) else _value(tables.prior[i, c])
            detail.append(
                f"{name:>10}{_value(before[i, c]):>17}{_value(tables.corrections[i, c]):>21}"
                f"{_value(tables.corrections_m[i, c]):>20}{_value(tables.places[i, c]):>20}{prior:>18}{sigmas[c]:>18}"
            )
        detail.append("")
    return [*summary, *detail]


def _value(value: float) -> str:
    return "Null" if np.isnan(value) else f"{value:.8f}"

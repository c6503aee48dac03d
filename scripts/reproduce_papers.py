"""Yoon & Shan's tables beside what this program makes of the simulated sites with the papers' weights.

Simulates the three sites, reads them back through their files, adjusts the case `papers` of each, and puts every table
beside the published numbers. Fills docs/evidence_papers.md.

    python scripts/reproduce_papers.py [--sites eos gusev isidis] [--seed 1] [--out FILE]
"""

import sys
import tempfile
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import papers_balance as balance
from papers_balance import PAPERS, PUBLISHED, Scatter, Sigmas, sigma0_of_measurements
from study import DOCS, Blocks, command, table, write_page

from mgsgraph.adjustment.adjust import adjust_network
from mgsgraph.adjustment.solution import Solution
from mgsgraph.analysis.statistics import point_statistics
from mgsgraph.case.reading import Case, adjust, read_case
from mgsgraph.geometry import rotation
from mgsgraph.geometry.image import PushbroomImage
from mgsgraph.geometry.orientation import OrientationPrior
from mgsgraph.geometry.records import Array
from mgsgraph.network import Network, PointClass
from mgsgraph.simulation.files import write_site
from mgsgraph.simulation.site import SimulatedSite, SimulationOptions, simulate_site
from mgsgraph.simulation.sites import SITE_NAMES
from mgsgraph.units import ARCMIN, ARCSEC

PLACES = 31


@dataclass(frozen=True, eq=False)
class Result:
    """One site, adjusted with the papers' observations and weights."""

    site: str
    simulated: SimulatedSite
    case: Case
    solution: Solution

    @property
    def nominal(self) -> tuple[PushbroomImage, ...]:
        """Images with the kernels' orientation, which the polynomials were fitted to."""
        return tuple(image.nominal for image in self.simulated.images)

    @property
    def true(self) -> tuple[PushbroomImage, ...]:
        return tuple(image.true for image in self.simulated.images)


def scatter(values: Array) -> Scatter:
    """Mean, and RMSE as the papers define it: the spread about the mean."""
    return Scatter(tuple(values.mean(axis=0).tolist()), tuple(values.std(axis=0).tolist()))


def cells(pairs: Scatter, digits: int = 2) -> tuple[str, ...]:
    """Mean / RMSE, as in the papers."""
    return tuple(f"{mean:.{digits}f} / {spread:.{digits}f}" for mean, spread in zip(*pairs, strict=True))


# --- Table 2


def orientation_differences(image: PushbroomImage, spice: PushbroomImage, result: Result | None = None) -> Array:
    """(31, 6) m and rad at the ends of 30 intervals: X, Y, Z, omega, phi, kappa of an image minus SPICE's; with a
    result, those of its refined orientation.
    """
    lines = np.linspace(0.0, float(image.lines), PLACES)
    correction = None
    if result is not None:
        names = result.solution.network.image_names
        correction = result.solution.correction(names.index(image.name))
    after, before = image.pose(lines, correction), spice.pose(lines)
    turned = rotation.omega_phi_kappa(after.matrix) - rotation.omega_phi_kappa(before.matrix)
    return np.hstack([after.position - before.position, (turned + np.pi) % (2.0 * np.pi) - np.pi])


def differences(result: Result) -> tuple[list[Array], list[Array]]:
    """Of each image: refined minus SPICE, and truth minus SPICE."""
    images = result.solution.network.images
    refined = [orientation_differences(*pair, result) for pair in zip(images, result.nominal, strict=True)]
    true = [orientation_differences(*pair) for pair in zip(result.true, result.nominal, strict=True)]
    return refined, true


def orientation_table(result: Result) -> list[str]:
    """Table 2, angles in minutes of arc."""
    rows = []
    refined, true = differences(result)
    for j, image in enumerate(result.true):
        stated = PUBLISHED[result.site].orientation[j]
        printed = Scatter(*(tuple(v if k < 3 else v * ARCSEC / ARCMIN for k, v in enumerate(part)) for part in stated))
        for name, values in (("papers' case", refined[j]), ("injected", true[j])):
            in_units = values / np.array([1.0, 1.0, 1.0, ARCMIN, ARCMIN, ARCMIN])
            rows.append((image.name if name == "papers' case" else "", name, *cells(scatter(in_units))))
        rows.append(("", "published", *cells(printed)))
    units = ("X (m)", "Y (m)", "Z (m)", "omega (')", "phi (')", "kappa (')")
    return table(("image", "mean / RMSE", *units), rows)


# --- Tables 3 to 5


def corrections_of(solution: Solution, kind: PointClass) -> Scatter:
    """m: adjusted minus before; ties before are the intersection with the polynomials fitted to SPICE."""
    members = solution.members(kind)
    return scatter((solution.places - solution.places_before)[members])


def tie_table(results: list[Result]) -> list[str]:
    """Table 3 (ties) and ISPRS Table 2 (footprints)."""
    rows = []
    for result in results:
        rows.append((result.site, "ties", "papers' case", *cells(corrections_of(result.solution, PointClass.TIE))))
        rows += [("", "", name, *cells(printed)) for name, printed in PUBLISHED[result.site].tie_corrections.items()]
        rows.append(("", "footprints", "papers' case", *cells(corrections_of(result.solution, PointClass.LASER), 3)))
        rows.append(("", "", "ISPRS", *cells(PUBLISHED[result.site].mola_corrections, 3)))
    return table(("site", "points", "mean / RMSE", "X (m)", "Y (m)", "Z (m)"), rows)


def sigmas_of(solution: Solution) -> Sigmas:
    """Table 4 of a solution, for sigma0 = 1, with sigma0 as the papers count it."""
    means = [point_statistics(solution, kind).mean_sigma.tolist() for kind in (PointClass.LASER, PointClass.TIE)]
    return Sigmas(tuple(means[0]), tuple(means[1]), sigma0_of_measurements(solution))


def scaled(sigmas: Sigmas) -> Sigmas:
    """Sigmas times sigma0, as published."""
    mola, tie = (tuple(sigmas.sigma0 * value for value in part) for part in (sigmas.mola, sigmas.tie))
    return Sigmas(mola, tie, sigmas.sigma0)


def sigma_table(solutions: list[tuple[str, str, Solution]]) -> list[str]:
    """Table 4: predicted sigmas (for sigma0 = 1), times sigma0, and published. `solutions`: site, weights, solution."""
    rows = []
    for n, (site, weights, solution) in enumerate(solutions):
        sigmas = sigmas_of(solution)
        for values, label in ((sigmas, "predicted"), (scaled(sigmas), "times sigma0")):
            three = [" ".join(f"{value:.2f}" for value in part) for part in values[:2]]
            rows.append((site, weights, label, *three, f"{sigmas.sigma0:.3f}", f"{solution.sigma0:.3f}"))
        if n + 1 == len(solutions) or solutions[n + 1][0] != site:
            for paper, printed in PUBLISHED[site].sigmas.items():
                three = [" ".join(f"{value:.2f}" for value in part) for part in printed[:2]]
                rows.append((site, paper, "published", *three, f"{printed.sigma0:.3f}", ""))
    return table(("site", "weights", "", "MOLA X Y Z (m)", "ties X Y Z (m)", "sigma0", "of all rows"), rows)


def image_scatter(solution: Solution, kind: PointClass, sign: float) -> Scatter:
    """pixels: left x, y, right x, y of residuals (sign 1) or corrections (sign -1) of one class of points."""
    rays, classes = solution.network.rays, solution.network.points.classes
    parts = [solution.residuals[(rays.image == j) & (classes[rays.point] == kind)] for j in (0, 1)]
    columns = [scatter(sign * part) for part in parts]
    return Scatter(columns[0].mean + columns[1].mean, columns[0].spread + columns[1].spread)


def residual_table(results: list[Result]) -> list[str]:
    """Table 5 (corrections of footprints) and ISPRS Table 3 (residuals of ties); x runs along the flight."""
    rows = []
    for result in results:
        for name, kind, sign, printed in (
            ("MOLA corrections", PointClass.LASER, -1.0, PUBLISHED[result.site].mola_pixels),
            ("tie residuals", PointClass.TIE, 1.0, PUBLISHED[result.site].tie_residuals),
        ):
            rows.append((result.site, name, "papers' case", *cells(image_scatter(result.solution, kind, sign), 3)))
            rows.append(("", "", "published", *cells(printed, 3)))
    return table(("site", "rows", "mean / RMSE", "left x (px)", "left y (px)", "right x (px)", "right y (px)"), rows)


def range_table(results: list[Result]) -> list[str]:
    """Residuals of the ranges, m."""
    rows = []
    for result in results:
        before, after = result.solution.range_residuals_before, result.solution.range_residuals
        rows.append((
            result.site, f"{before.mean():.2f} / {before.std():.2f}", f"{after.mean():.4f} / {after.std():.2f}",
            f"{np.abs(after).mean():.2f}, {np.abs(after).max():.2f}",
        ))  # fmt: skip
    head = ("site", "SPICE: mean / RMSE (m)", "adjusted: mean / RMSE (m)", "adjusted: mean modulus, largest (m)")
    low, high = PAPERS["range_residuals_m"]
    return [*table(head, rows), "", f"Published: about {low:.0f} m up to about {high:.0f} m, of what is left open."]


# --- the shift


def line_and_sample(image: PushbroomImage) -> Array:
    """(2,) m on the ground per line and per sample in the image's middle."""
    _, by_pixel = image.image_to_ground(np.array([0.5 * image.lines]), np.array([0.5 * image.samples]))
    return np.asarray(np.linalg.norm(by_pixel[0], axis=0))


def along_flight(result: Result) -> tuple[float, ...]:
    """m per image: how much farther along its own flight the nominal orientation sees the tie points than the truth."""
    shifts = []
    for true, nominal in zip(result.true, result.nominal, strict=True):
        places = [image.ground_to_image(result.simulated.true_ties)[0][:, 0] for image in (true, nominal)]
        shifts.append(float(np.mean(places[1] - places[0]) * line_and_sample(true)[0]))
    return tuple(shifts)


def opposite_shift(correction: Scatter, site: str) -> float:
    """m between the images that corrections of the footprints along the flight imply: pixels times Table 1's sizes."""
    left, right = PUBLISHED[site].images
    return abs(correction.mean[0] * left.pixel_m - correction.mean[2] * right.pixel_m)


def shift_table(results: list[tuple[str, Result]]) -> list[str]:
    """What Table 5 implies, what was injected and what the papers' case corrects. `results`: option, result."""
    rows = []
    for option, result in results:
        injected = along_flight(result)
        correction = image_scatter(result.solution, PointClass.LASER, -1.0)
        rows.append((
            result.site, option, f"{injected[0]:+.0f}, {injected[1]:+.0f}", f"{abs(injected[0] - injected[1]):.0f}",
            f"{correction.mean[0]:+.1f}, {correction.mean[2]:+.1f}", f"{opposite_shift(correction, result.site):.0f}",
            f"{opposite_shift(PUBLISHED[result.site].mola_pixels, result.site):.0f}", f"{PAPERS['stated_shift_m']:.0f}",
        ))  # fmt: skip
    head = (
        "site", "attitude-time bias", "injected left, right (m)", "between them (m)", "corrections x (px)",
        "these imply (m)", "Table 5 implies (m)", "stated (m)",
    )  # fmt: skip
    return table(head, rows)


# --- weights


def reweighted(network: Network, group: str, factor: float) -> Network:
    """The network with the weights (inverse variances) of one group of rows times `factor`."""
    size, rays = factor**-0.5, network.rays
    kinds = network.points.classes[rays.point]
    if group in ("ties", "MOLA image points"):
        chosen = kinds == (PointClass.TIE if group == "ties" else PointClass.LASER)
        return replace(network, rays=replace(rays, sigmas=np.where(chosen[:, None], size * rays.sigmas, rays.sigmas)))
    if group == "ranges":
        return replace(network, ranges=replace(network.ranges, sigmas=size * network.ranges.sigmas))
    if group == "MOLA ground points":
        return replace(network, points=replace(network.points, covariances=network.points.covariances / factor))
    columns = slice(0, 3) if group == "positions" else slice(3, 6)
    scale = np.ones(6)
    scale[columns] = size
    return replace(network, priors=tuple(OrientationPrior(prior.sigmas * scale) for prior in network.priors))


GROUPS = ("ties", "MOLA image points", "ranges", "MOLA ground points", "positions", "angles")


def sensitivity(result: Result) -> str:
    """Each weight halved and doubled: how far the tie points go, and by how much their sigmas change."""
    case, reference = result.case, result.solution
    ties = reference.members(PointClass.TIE)
    most, widest = (0.0, ""), (0.0, "")
    for group in GROUPS:
        for factor in (0.5, 2.0):
            changed = adjust_network(reweighted(case.network, group, factor), case.settings)
            moved = np.linalg.norm(changed.places[ties] - reference.places[ties], axis=1)
            most = max(most, (float(moved.max()), group))
            change = factors(sigmas_of(changed).tie, sigmas_of(reference).tie)
            widest = max(widest, (max(change), group))
    return (
        f"* {result.site}: tie points move by at most {most[0]:.1f} m ({most[1]}), their sigmas change by at most a "
        f"factor of {widest[0]:.2f} ({widest[1]})."
    )


# --- what is required


def requirements(results: list[Result]) -> list[str]:
    """Each requirement with its figures, and by how much it is missed where it is."""
    lines = []
    for result in results:
        sigmas, printed = scaled(sigmas_of(result.solution)), PUBLISHED[result.site].sigmas["PE&RS"]
        of_sigma0 = sigmas.sigma0 / printed.sigma0 - 1.0
        off = [ours / theirs - 1.0 for ours, theirs in zip(sigmas.mola, printed.mola, strict=True)]
        times = factors(sigmas.tie, printed.tie)
        shown, times_shown = ", ".join(f"{100.0 * value:+.1f}%" for value in off), ", ".join(f"{v:.2f}" for v in times)
        lines += [
            f"* {result.site}, sigma0 within 15%: {_verdict(abs(of_sigma0), 0.15)} ({sigmas.sigma0:.3f}, "
            f"{100.0 * of_sigma0:+.1f}%).",
            f"* {result.site}, MOLA sigmas within 10%: {_verdict(max(map(abs, off)), 0.1)} ({shown}).",
            f"* {result.site}, tie sigmas within a factor of 1.5: {_verdict(max(times), 1.5)} ({times_shown}).",
        ]
    for result in (result for result in results if result.site == "gusev"):
        x = image_scatter(result.solution, PointClass.LASER, -1.0).mean
        fits, (left, right) = -28.0 <= x[0] <= -20.0 and 20.0 <= x[2] <= 30.0, along_flight(result)
        lines.append(
            f"* gusev, MOLA image corrections along the flight -20..-28 and +20..+30 px: {'yes' if fits else 'NO'} "
            f"({x[0]:+.1f} and {x[2]:+.1f} px, with {abs(left - right):.0f} m between the images)."
        )
    return lines


def factors(values: tuple[float, ...], references: tuple[float, ...]) -> list[float]:
    """How many times larger or smaller; never below 1."""
    return [max(value / reference, reference / value) for value, reference in zip(values, references, strict=True)]


def _verdict(value: float, limit: float) -> str:
    return "yes" if value <= limit else f"**NO**, {value:.3g} in place of {limit:g}"


# --- the page

STATED_BIAS = 0.95
"""s, attitude-time bias of the nadir CK that gives the 325 m of the papers' text."""
AS_PUBLISHED = SimulationOptions(errors="published", tie_noise=balance.tie_noise(), pictures=False)
"""Errors of kernels and ties as the papers state them."""


def reproduced(site: str, seed: int, folder: Path, options: SimulationOptions) -> Result:
    """A site simulated, written, read back and adjusted with the weights that balance Table 5."""
    simulated = simulate_site(site, seed, options)
    case = read_case(write_site(simulated, folder, "papers"))
    sigmas = balance.implied_sigmas(site, balance.counts_in(case.network))
    case = replace(case, network=balance.weighed(case.network, sigmas))
    solution = adjust(case)
    if not solution.converged:
        raise SystemExit(f"{site}: the papers' case did not converge ({solution.message})")
    return Result(site, simulated, case, solution)


def page(results: list[Result], seed: int, work: Path) -> Blocks:
    """All parts of the page."""
    return {
        "required": requirements(results),
        "orientation": [line for result in results for line in (*orientation_table(result), "")],
        "points": tie_table(results),
        "sigmas": sigma_table([row for result in results for row in with_weights(result)]),
        "balance": balance.balance_table({result.site: result.case.network for result in results}),
        "residuals": residual_table(results),
        "ranges": range_table(results),
        "shift": shift_table([pair for result in results for pair in with_biases(result, seed, work)]),
        "weights": [sensitivity(result) for result in results],
    }


def with_weights(result: Result) -> list[tuple[str, str, Solution]]:
    """A site adjusted with the weights that balance Table 5, with those of x alone, and with those of the text."""
    network, settings = result.case.network, result.case.settings
    x_alone = np.repeat(balance.implied_sigmas(result.site, balance.counts_in(network))[:, :1], 2, axis=1)
    stated = np.full((2, 2), balance.STATED_SIGMA)
    by_x, text = (adjust_network(balance.weighed(network, sigmas), settings) for sigmas in (x_alone, stated))
    return [(result.site, "papers' case", result.solution), (result.site, "y as x", by_x), (result.site, "30 px", text)]


def with_biases(result: Result, seed: int, work: Path) -> list[tuple[str, Result]]:
    """A site with its own attitude-time bias and with that of the text."""
    if result.site == "eos":
        return [("the site's", result)]
    options = replace(AS_PUBLISHED, attitude_time_bias=STATED_BIAS)
    stated = reproduced(result.site, seed, work / f"{result.site}_stated", options)
    return [("the site's", result), (f"{STATED_BIAS:g} s", stated)]


def main() -> int:
    parser = command(__doc__)
    parser.add_argument("--sites", nargs="+", choices=SITE_NAMES, default=SITE_NAMES)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--out", type=Path, default=DOCS / "evidence_papers.md")
    options = parser.parse_args()

    def make() -> Blocks:
        with tempfile.TemporaryDirectory() as folder:
            results = [reproduced(site, options.seed, Path(folder) / site, AS_PUBLISHED) for site in options.sites]
            return page(results, options.seed, Path(folder))

    return write_page(parser, options.out, "evidence_papers.md#papers", make)


if __name__ == "__main__":
    sys.exit(main())

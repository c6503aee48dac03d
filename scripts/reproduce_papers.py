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


def cells(found: Scatter, digits: int = 2) -> tuple[str, ...]:
    """Mean / RMSE, as in the papers."""
    return tuple(f"{mean:.{digits}f} / {spread:.{digits}f}" for mean, spread in zip(*found, strict=True))


# --- Table 2


def orientation_differences(image: PushbroomImage, spice: PushbroomImage, result: Result | None = None) -> Array:
    """(31, 6) m and rad at the ends of 30 intervals: X, Y, Z, omega, phi, kappa of an image minus SPICE's; with a
    result, those of its refined orientation.
    """
    lines = np.linspace(0.0, float(image.lines), PLACES)
    correction = None
    if result is not None:
        names = [one.name for one in result.solution.network.images]
        correction = result.solution.correction(names.index(image.name))
    after, before = image.pose(lines, correction), spice.pose(lines)
    turned = rotation.omega_phi_kappa(after.matrix) - rotation.omega_phi_kappa(before.matrix)
    return np.hstack([after.position - before.position, (turned + np.pi) % (2.0 * np.pi) - np.pi])


def differences(result: Result) -> tuple[list[Array], list[Array]]:
    """Of each image: refined minus SPICE, and truth minus SPICE."""
    images = result.solution.network.images
    refined = [orientation_differences(*one, result) for one in zip(images, result.nominal, strict=True)]
    true = [orientation_differences(*one) for one in zip(result.true, result.nominal, strict=True)]
    return refined, true


def orientation_table(result: Result) -> list[str]:
    """Table 2, angles in minutes of arc."""
    rows = []
    refined, true = differences(result)
    for j, image in enumerate(result.true):
        wanted = PUBLISHED[result.site].orientation[j]
        printed = Scatter(*(tuple(v if k < 3 else v * ARCSEC / ARCMIN for k, v in enumerate(part)) for part in wanted))
        for name, values in (("papers' case", refined[j]), ("injected", true[j])):
            in_units = values / np.array([1.0, 1.0, 1.0, ARCMIN, ARCMIN, ARCMIN])
            rows.append((image.name if name == "papers' case" else "", name, *cells(scatter(in_units))))
        rows.append(("", "published", *cells(printed)))
    units = ("X (m)", "Y (m)", "Z (m)", "omega (')", "phi (')", "kappa (')")
    return table(("image", "mean / RMSE", *units), rows)


# --- Tables 3 to 5


def corrections_of(solution: Solution, kind: PointClass) -> Scatter:
    """m: adjusted minus before; ties before are the intersection with the polynomials fitted to SPICE."""
    mine = solution.members(kind)
    return scatter((solution.places - solution.places_before)[mine])


def tie_table(results: list[Result]) -> list[str]:
    """Table 3 (ties) and ISPRS Table 2 (footprints)."""
    rows = []
    for one in results:
        rows.append((one.site, "ties", "papers' case", *cells(corrections_of(one.solution, PointClass.TIE))))
        rows += [("", "", name, *cells(printed)) for name, printed in PUBLISHED[one.site].tie_corrections.items()]
        rows.append(("", "footprints", "papers' case", *cells(corrections_of(one.solution, PointClass.LASER), 3)))
        rows.append(("", "", "ISPRS", *cells(PUBLISHED[one.site].mola_corrections, 3)))
    return table(("site", "points", "mean / RMSE", "X (m)", "Y (m)", "Z (m)"), rows)


def sigmas_of(solution: Solution) -> Sigmas:
    """Table 4 of a solution, for sigma0 = 1, with sigma0 as the papers count it."""
    means = [point_statistics(solution, kind).mean_sigma.tolist() for kind in (PointClass.LASER, PointClass.TIE)]
    return Sigmas(tuple(means[0]), tuple(means[1]), sigma0_of_measurements(solution))


def scaled(found: Sigmas) -> Sigmas:
    """Sigmas times sigma0, as published."""
    mola, tie = (tuple(found.sigma0 * value for value in part) for part in (found.mola, found.tie))
    return Sigmas(mola, tie, found.sigma0)


def sigma_table(named: list[tuple[str, str, Solution]]) -> list[str]:
    """Table 4: predicted sigmas (for sigma0 = 1), times sigma0, and published. `named`: site, weights, solution."""
    rows = []
    for n, (site, weights, solution) in enumerate(named):
        found = sigmas_of(solution)
        for one, what in ((found, "predicted"), (scaled(found), "times sigma0")):
            three = [" ".join(f"{value:.2f}" for value in part) for part in one[:2]]
            rows.append((site, weights, what, *three, f"{found.sigma0:.3f}", f"{solution.sigma0:.3f}"))
        if n + 1 == len(named) or named[n + 1][0] != site:
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
    for one in results:
        for name, kind, sign, printed in (
            ("MOLA corrections", PointClass.LASER, -1.0, PUBLISHED[one.site].mola_pixels),
            ("tie residuals", PointClass.TIE, 1.0, PUBLISHED[one.site].tie_residuals),
        ):
            rows.append((one.site, name, "papers' case", *cells(image_scatter(one.solution, kind, sign), 3)))
            rows.append(("", "", "published", *cells(printed, 3)))
    return table(("site", "rows", "mean / RMSE", "left x (px)", "left y (px)", "right x (px)", "right y (px)"), rows)


def range_table(results: list[Result]) -> list[str]:
    """Residuals of the ranges, m."""
    rows = []
    for one in results:
        before, after = one.solution.range_residuals_before, one.solution.range_residuals
        rows.append((
            one.site, f"{before.mean():.2f} / {before.std():.2f}", f"{after.mean():.4f} / {after.std():.2f}",
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
    found = []
    for true, nominal in zip(result.true, result.nominal, strict=True):
        places = [image.ground_to_image(result.simulated.true_ties)[0][:, 0] for image in (true, nominal)]
        found.append(float(np.mean(places[1] - places[0]) * line_and_sample(true)[0]))
    return tuple(found)


def opposite_shift(correction: Scatter, site: str) -> float:
    """m between the images that corrections of the footprints along the flight imply: pixels times Table 1's sizes."""
    left, right = PUBLISHED[site].images
    return abs(correction.mean[0] * left.pixel_m - correction.mean[2] * right.pixel_m)


def shift_table(named: list[tuple[str, Result]]) -> list[str]:
    """What Table 5 implies, what was injected and what the papers' case corrects. `named`: option, result."""
    rows = []
    for option, one in named:
        injected = along_flight(one)
        found = image_scatter(one.solution, PointClass.LASER, -1.0)
        rows.append((
            one.site, option, f"{injected[0]:+.0f}, {injected[1]:+.0f}", f"{abs(injected[0] - injected[1]):.0f}",
            f"{found.mean[0]:+.1f}, {found.mean[2]:+.1f}", f"{opposite_shift(found, one.site):.0f}",
            f"{opposite_shift(PUBLISHED[one.site].mola_pixels, one.site):.0f}", f"{PAPERS['stated_shift_m']:.0f}",
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
        mine = kinds == (PointClass.TIE if group == "ties" else PointClass.LASER)
        return replace(network, rays=replace(rays, sigmas=np.where(mine[:, None], size * rays.sigmas, rays.sigmas)))
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
            other = adjust_network(reweighted(case.network, group, factor), case.settings)
            moved = np.linalg.norm(other.places[ties] - reference.places[ties], axis=1)
            most = max(most, (float(moved.max()), group))
            change = factors(sigmas_of(other).tie, sigmas_of(reference).tie)
            widest = max(widest, (max(change), group))
    return (
        f"* {result.site}: tie points move by at most {most[0]:.1f} m ({most[1]}), their sigmas change by at most a "
        f"factor of {widest[0]:.2f} ({widest[1]})."
    )


# --- what is required


def requirements(results: list[Result]) -> list[str]:
    """Each requirement with its figures, and by how much it is missed where it is."""
    said = []
    for one in results:
        found, printed = scaled(sigmas_of(one.solution)), PUBLISHED[one.site].sigmas["PE&RS"]
        of_sigma0 = found.sigma0 / printed.sigma0 - 1.0
        off = [mine / theirs - 1.0 for mine, theirs in zip(found.mola, printed.mola, strict=True)]
        times = factors(found.tie, printed.tie)
        shown, told = ", ".join(f"{100.0 * value:+.1f}%" for value in off), ", ".join(f"{v:.2f}" for v in times)
        said += [
            f"* {one.site}, sigma0 within 15%: {_verdict(abs(of_sigma0), 0.15)} ({found.sigma0:.3f}, "
            f"{100.0 * of_sigma0:+.1f}%).",
            f"* {one.site}, MOLA sigmas within 10%: {_verdict(max(map(abs, off)), 0.1)} ({shown}).",
            f"* {one.site}, tie sigmas within a factor of 1.5: {_verdict(max(times), 1.5)} ({told}).",
        ]
    for one in (one for one in results if one.site == "gusev"):
        x = image_scatter(one.solution, PointClass.LASER, -1.0).mean
        fits, (left, right) = -28.0 <= x[0] <= -20.0 and 20.0 <= x[2] <= 30.0, along_flight(one)
        said.append(
            f"* gusev, MOLA image corrections along the flight -20..-28 and +20..+30 px: {'yes' if fits else 'NO'} "
            f"({x[0]:+.1f} and {x[2]:+.1f} px, with {abs(left - right):.0f} m between the images)."
        )
    return said


def factors(found: tuple[float, ...], wanted: tuple[float, ...]) -> list[float]:
    """How many times larger or smaller; never below 1."""
    return [max(mine / theirs, theirs / mine) for mine, theirs in zip(found, wanted, strict=True)]


def _verdict(value: float, limit: float) -> str:
    return "yes" if value <= limit else f"**NO**, {value:.3g} in place of {limit:g}"


# --- the page

STATED_BIAS = 0.95
"""s, attitude-time bias of the nadir CK that gives the 325 m of the papers' text."""
AS_PUBLISHED = SimulationOptions(errors="published", tie_noise=balance.tie_noise(), pictures=False)
"""Kernels as wrong as the papers found them, and ties as good."""


def reproduced(site: str, seed: int, folder: Path, options: SimulationOptions) -> Result:
    """A site simulated, written, read back and adjusted with the weights that balance Table 5."""
    one = simulate_site(site, seed, options)
    case = read_case(write_site(one, folder, "papers"))
    sigmas = balance.implied_sigmas(site, balance.seen_in(case.network))
    case = replace(case, network=balance.weighed(case.network, sigmas))
    solution = adjust(case)
    if not solution.converged:
        raise SystemExit(f"{site}: the papers' case did not converge ({solution.message})")
    return Result(site, one, case, solution)


def page(results: list[Result], seed: int, work: Path) -> Blocks:
    """All """
    return {
        "required": requirements(results),
        "orientation": [line for one in results for line in (*orientation_table(one), "")],
        "points": tie_table(results),
        "sigmas": sigma_table([row for one in results for row in with_weights(one)]),
        "balance": balance.balance_table({one.site: one.case.network for one in results}),
        "residuals": residual_table(results),
        "ranges": range_table(results),
        "shift": shift_table([pair for one in results for pair in with_biases(one, seed, work)]),
        "weights": [sensitivity(one) for one in results],
    }


def with_weights(one: Result) -> list[tuple[str, str, Solution]]:
    """A site adjusted with the weights that balance Table 5, with those of x alone, and with those of the text."""
    network, settings = one.case.network, one.case.settings
    x_alone = np.repeat(balance.implied_sigmas(one.site, balance.seen_in(network))[:, :1], 2, axis=1)
    stated = np.full((2, 2), balance.STATED_SIGMA)
    alone, text = (adjust_network(balance.weighed(network, each), settings) for each in (x_alone, stated))
    return [(one.site, "papers' case", one.solution), (one.site, "y as x", alone), (one.site, "30 px", text)]


def with_biases(one: Result, seed: int, work: Path) -> list[tuple[str, Result]]:
    """A site with its own attitude-time bias and with that of the text."""
    if one.site == "eos":
        return [("the site's", one)]
    options = replace(AS_PUBLISHED, attitude_time_bias=STATED_BIAS)
    stated = reproduced(one.site, seed, work / f"{one.site}_stated", options)
    return [("the site's", one), (f"{STATED_BIAS:g} s", stated)]


def main() -> int:
    parser = command(__doc__)
    parser.add_argument("--sites", nargs="+", choices=SITE_NAMES, default=SITE_NAMES)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--out", type=Path, default=DOCS / "evidence_papers.md")
    wanted = parser.parse_args()

    def make() -> Blocks:
        with tempfile.TemporaryDirectory() as folder:
            results = [reproduced(site, wanted.seed, Path(folder) / site, AS_PUBLISHED) for site in wanted.sites]
            return page(results, wanted.seed, Path(folder))

    return write_page(parser, wanted.out, "evidence_papers.md#papers", make)


if __name__ == "__main__":
    sys.exit(main())

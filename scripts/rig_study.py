"""Are boresights of a rig found, and are their sigmas honest? Simulated passes of several sensors on one trajectory.

nac: two passes of LRO's NAC-L and NAC-R with a boresight error of 80 m on the ground that both passes share, adjusted
with passes and a mounting, and beside it without: each image by a polynomial of its own, or mounted as stated.
moc: MOC's narrow and wide angle and MOLA in one pass, by the kernels of M04/02852, with MOLA's 325 m.

    python scripts/rig_study.py [--seeds 40] [--first 1] [--moc-seeds 40] [--data FOLDER] [--out FILE]

Writes docs/rigs.md by default; --data is shared/data, without which the part of MOC is left out. Exit status: 0 done,
2 bad input.
"""

import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from study import (
    DOCS,
    at_least,
    chi_square_band,
    command,
    machine,
    made_with,
    number,
    show,
    student,
    table,
    within,
    write_page,
)

from mgsgraph.adjustment.adjust import adjust_network
from mgsgraph.adjustment.settings import SolverSettings
from mgsgraph.adjustment.solution import Solution
from mgsgraph.analysis.posterior import Posterior
from mgsgraph.files.labels.labelled_image import read_labelled_image
from mgsgraph.geometry import rotation
from mgsgraph.geometry.body import east_north
from mgsgraph.geometry.image import PushbroomImage
from mgsgraph.geometry.orientation import OrientationPrior
from mgsgraph.geometry.records import Array
from mgsgraph.network import Network, PointClass
from mgsgraph.simulation.demo.truth import nees
from mgsgraph.simulation.moc_rig import MocSettings, simulate_moc_rig, wide_angle_label
from mgsgraph.simulation.nac_pair import NacSettings, own_priors, simulate_nac_pair
from mgsgraph.simulation.rig import PassErrors, SimulatedRig, powers
from mgsgraph.text import root_mean_square
from mgsgraph.units import MRAD

ROOT = Path(__file__).resolve().parents[1]
PAGE = "rigs.md"
KERNELS = (
    "naif0012.tls", "MGS_SCLKSCET.00061.tsc", "pck00009.tpc", "moc20.ti", "mocAddendum004.ti", "m0402852.ale_0.bsp",
    "m0402852.ale_1.bsp", "mgs_sc_map2_0_sliced_-94000.bc", "mgs_sc_map2_1_sliced_-94000.bc",
)  # fmt: skip
"""Of M04/02852."""
MOMENTS = np.linspace(0.02, 0.98, 9)
"""Shares of an image's lines at which its pointing is compared."""
WORDS = """# Rigs: several sensors on one trajectory

Made by `scripts/rig_study.py`; the real rig near Hadley rille has [a page of its own](rig_hadley.md). Each seed draws
the error of each pass's trajectory, boresights, points and noise anew and adjusts; nothing is rejected, no weight is
set by hand. NEES is the square of the error normalised by the stated covariance, per degree of freedom: 1 where
sigmas are honest. Bands are 99 %, of a chi-square for boresights and trajectories; points of one seed err together,
so theirs is from the scatter over the seeds.
"""
NAC = """## NAC-L and NAC-R in two passes

{seeds} seeds. Two passes over one place, 27 days apart, from {altitude:.0f} km, the second one rolled {roll:.0f}
degrees aside; NAC-L and NAC-R by the optics and the mounting of `lro_nac_hadley` (R turned by 179.6 degrees against
L), {lines:,} lines of {period:.2f} ms. Each pass has a position error of {bias:g} m and {drift:g} m of drift, and an
attitude error of degree 3 ({attitude} mrad); the axis of R is {boresight:.0f} m on the ground ({size:.2f} mrad) off
in a direction that is drawn, alike in both passes. Ties of {tie} px: {ties} drawn over the first pass, {beside} in
the overlap of L and R of each pass; {shots} laser shots of each pass whose footprints share a shift of {track:.0f} m
(an unknown). The mounting's a-priori sigmas are 1.6, 1.6 and 0.5 mrad about R's x, y, z.
"""
NAC_TABLE = """
Errors are root mean squares over all seeds. *R against L*: by how much the adjusted camera R points elsewhere on the
ground, seen from L of its pass, than it truly did, over the lines of both passes. *common*: of a seed's points their
mean error, which is the datum's; *rest*: what remains. The stated sigmas of the points are beside.
"""
NAC_READING = """
* *rig*: one trajectory for each pass (position of degree 1, attitude of degree 3) and one boresight of R for both.
* *own polynomials*: each image has the same polynomials for itself, R with the boresight's sigma besides (so its prior
  knows what is wrong, but not that it is the same everywhere and always).
* *own polynomials, prior of the pass*: the same, R's prior as L's: nobody knew of the boresight.
* *mounting as stated*: the rig without unknown boresight.

Without laser the boresight's roll, the heights and the positions of the passes are one question (the second pass's L
lies on both sides of the seam): R is known to 27 m against L, and its sigmas say so. 14 of 40 adjustments with the
mounting as stated find no minimum there. Ties that one pass alone shows have a height of 30 m (a terrain model's):
the boresight's error of 160 px would else make their nearly parallel rays meet behind the cameras, which `adjust`
refuses.
"""
MOC = """## MOC's narrow and wide angle with MOLA, one pass

{seeds} seeds. M04/02852 by its label and kernels, and a red wide angle of 480 x 480 pixels (240 m) about the same
moment, by the same kernels, mounted as the addendum says (24 mrad from the narrow angle). The pass (38.4 s) errs by
{bias:g} m and {drift:g} m of drift, and by {attitude} mrad (degrees 0 to 3); the wide angle's boresight by 2 mrad
about each axis, MOLA's beam by {discrepancy:.0f} m along the track, forward or back, and 0.25 mrad across. {ties}
ties in both images ({tie_narrow} and {tie_wide} px), on heights of MOLA's grid (30 m); {control} points of its map in
the wide angle (150 m, {tie_wide} px); {shots} shots with a range (1 m), footprints (30 m) found in the wide angle to
1 px and, where it shows them, in the narrow one to 5 px.
"""
MOC_TABLE = """
What each sensor adds: sigmas of the pointing of the narrow angle at its middle line about its axes x (roll) and y
(pitch), and where its points lie on the ground; root mean squares over the seeds, with the errors in brackets.
"""
MOC_READING = """
The constant pitch and the position along the track move the image alike, so that the pointing's sigma keeps what
nothing tells apart from the orbit; what the points' places need is their sum, and that is what the wide angle brings:
it sees control over 115 km, and the ties hand it to the narrow angle, whose 2.8 km show none. A turn of the beam
about itself moves nothing.
"""


@dataclass(frozen=True)
class Judged:
    """One adjustment against the truth."""

    converged: bool
    squares: float
    """Weighted squares of all rows over the degrees of freedom."""
    freedom: float
    shared: tuple[tuple[Array, Array], ...]
    """Error (3,) and covariance (3, 3) of each shared unknown."""
    trajectory: float
    """Normalised squares of all passes' coefficients; NaN without passes."""
    coefficients: int
    points: float
    """NEES of the points, per degree of freedom."""
    places: Array
    """(n, 3) m, errors of the ties east, north, up."""
    sigmas: Array
    """(n, 3) m, their sigmas."""
    seam: Array
    """m on the ground, R against L (`_seam`)."""
    pointing: Array
    """(2, 2) rad: error and sigma of the first image's roll and pitch at its middle line."""


def judged(rig: SimulatedRig, network: Network, errors: PassErrors, away: float) -> Judged:
    """Adjust a network of a rig and compare; `away` in m is from camera to ground."""
    solution = adjust_network(network, SolverSettings(reject=0.0))
    every = np.flatnonzero(solution.determined & _seen_by_all_passes(rig))
    ties = every[network.points.classes[every] == PointClass.TIE]
    off = solution.places - rig.points
    up = rig.points / np.linalg.norm(rig.points, axis=1)[:, None]
    frames = np.concatenate([east_north(rig.points), up[:, None]], axis=1)
    local = np.einsum("nij,njk,nik->ni", frames[ties], solution.covariances[ties], frames[ties])
    first = network.first_shared
    shared = tuple(
        (solution.shared[k] - rig.shared[k], solution.joint_covariance.of([first + k]))
        for k in range(len(network.shared))
    )
    squares, count = _trajectory(rig, solution, errors)
    return Judged(
        solution.converged, solution.fit.squares / solution.fit.degrees_of_freedom, solution.fit.degrees_of_freedom,
        shared, squares, count,
        float(nees(off[every], solution.covariances[every]).mean()) / 3.0 if solution.converged else float("nan"),
        np.einsum("nij,nj->ni", frames[ties], off[ties]), np.sqrt(local), _seam(rig, solution, away),
        _pointing(rig, solution) if solution.converged else np.full((2, 2), np.nan),
    )  # fmt: skip


def _seen_by_all_passes(rig: SimulatedRig) -> Array:
    """(n,) True for points with rays from every pass: those of one pass alone are on nearly parallel rays."""
    seen = np.zeros((len(rig.points), len(rig.network.passes)), dtype=bool)
    seen[rig.network.rays.point, rig.network.pass_of[rig.network.rays.image]] = True
    return np.asarray(seen.all(axis=1) | (rig.network.points.classes == PointClass.LASER))


def _trajectory(rig: SimulatedRig, solution: Solution, errors: PassErrors) -> tuple[float, int]:
    """Normalised squares of the errors of all coefficients that are not held, and their number."""
    if not solution.network.passes:
        return float("nan"), 0
    off, parts, variables, free = [], [], list[int](), errors.free.ravel()
    for k, (one, first) in enumerate(solution.network.numbered_passes):
        to_powers = np.kron(np.linalg.inv(powers(one.nodes)), np.eye(6))[free]
        off.append(to_powers @ (solution.nodes[k] - rig.truth.nodes[k]).ravel())
        parts.append(to_powers)
        variables += range(first, first + len(one.nodes))
    whole = np.zeros((sum(len(one) for one in parts), sum(one.shape[1] for one in parts)))
    row = column = 0
    for one in parts:
        whole[row : row + len(one), column : column + one.shape[1]] = one
        row, column = row + len(one), column + one.shape[1]
    error, covariance = np.concatenate(off), whole @ solution.joint_covariance.of(variables) @ whole.T
    return float(error @ np.linalg.solve(covariance, error)), error.size


def _turns(rig: SimulatedRig, solution: Solution, image: int) -> Array:
    """(n, 3) rad about the camera's nominal axes: what its adjusted attitude is off the true one, at some lines."""
    one, lines = solution.network.images[image], MOMENTS * solution.network.images[image].lines
    found = one.pose(lines, solution.correction(image)).matrix
    true = rig.truth.images[image].pose(lines, rig.truth.corrections[image]).matrix
    return np.asarray(-rotation.logarithm(found @ np.swapaxes(true, 1, 2)))


def _seam(rig: SimulatedRig, solution: Solution, away: float) -> Array:
    """m on the ground by which the second image of each pass points elsewhere against the first one than it did."""
    off = []
    for one in rig.network.passes:
        left, right = one.images[:2].tolist()
        axes = one.axes_of(right)
        assert axes is not None
        beside = (
            _turns(rig, solution, right) - _turns(rig, solution, left) @ axes.T
            if left != right and _comparable(rig, left, right)
            else np.zeros((1, 3))
        )
        off.append(away * np.linalg.norm(beside[:, :2], axis=1))
    return np.concatenate(off)


def _comparable(rig: SimulatedRig, left: int, right: int) -> bool:
    """Whether two images of a pass have the same lines at the same times."""
    one, other = rig.network.images[left], rig.network.images[right]
    return one.lines == other.lines


def _pointing(rig: SimulatedRig, solution: Solution) -> Array:
    image = solution.network.images[0]
    middle = len(MOMENTS) // 2
    error = _turns(rig, solution, 0)[middle, :2]
    covariance = Posterior.of(solution).pose(image.name, float(MOMENTS[middle] * image.lines)).covariance
    return np.stack([error, np.sqrt(np.diagonal(covariance)[3:5])])


# --- NAC


def nac_seed(settings: NacSettings, seed: int) -> dict[str, Judged]:
    """Each way to adjust one simulated pair of passes."""
    rig = simulate_nac_pair(settings, seed)
    alike = tuple(OrientationPrior(settings.errors.sigmas) for _ in rig.network.images)
    alone = replace(rig.network, passes=(), shared=(), priors=own_priors(settings))
    ways = {
        "rig": rig.network,
        "own polynomials": alone,
        "own polynomials, prior of the pass": replace(alone, priors=alike),
        "mounting as stated": rig.without_mounting(),
    }
    return {way: judged(rig, network, settings.errors, settings.altitude) for way, network in ways.items()}


def nac_part(first: int, seeds: int) -> list[str]:
    """The part of the page about NAC."""
    lines, every = list[str](), {}
    for name, settings in (
        ("as above", NacSettings()),
        ("six control points (2 m) besides", NacSettings(control=6)),
        ("no laser", NacSettings(shots=0)),
        ("5 ties in the overlap of L and R", NacSettings(beside=5)),
    ):
        every[name] = _runs(f"NAC, {name}", first, seeds, lambda seed, chosen=settings: nac_seed(chosen, seed))
    usual = NacSettings()
    lines += [NAC.format(
        seeds=seeds, altitude=usual.altitude / 1e3, roll=np.degrees(usual.roll), lines=usual.lines,
        period=usual.period * 1e3, bias=usual.errors.position[0], drift=usual.errors.position[1],
        attitude=_milli(usual.errors.attitude), boresight=usual.boresight, size=usual.boresight / usual.altitude / MRAD,
        tie=usual.tie_sigma, ties=usual.ties, beside=usual.beside, shots=usual.shots, track=usual.track_sigma,
    )]  # fmt: skip
    lines += honesty({name: [run["rig"] for run in runs] for name, runs in every.items()})
    lines += ["", *_boresights(every["as above"], usual), NAC_TABLE]
    rows = []
    for name, runs in every.items():
        for way in runs[0]:
            rows.append([name if way == "rig" else "", way, *_errors([run[way] for run in runs])])
    head = ["", "adjusted as", "R against L, m", "common, m", "rest, horizontal, m", "rest, up, m",
            "sigma, horizontal, m", "sigma, up, m", "NEES of points", "squares", "converged"]  # fmt: skip
    return [*lines, *table(head, rows), NAC_READING]


def _boresights(runs: Sequence[dict[str, Judged]], settings: NacSettings) -> list[str]:
    """The boresight of R about each axis."""
    rows = []
    errors = np.array([run["rig"].shared[0][0] for run in runs])
    sigmas = np.sqrt([np.diagonal(run["rig"].shared[0][1]) for run in runs])
    arms = (settings.altitude, settings.altitude, 2532 * 1e-5 * settings.altitude)
    for k, axis in enumerate(("x (across the detector's roll)", "y (pitch)", "z (turn, at the image's edge)")):
        error, sigma = root_mean_square(errors[:, k], 0), root_mean_square(sigmas[:, k], 0)
        rows.append([axis, *(number(value / MRAD) for value in (settings.boresight_sigmas[k], error, sigma)),
                     *(number(value * arms[k]) for value in (error, sigma))])  # fmt: skip
    head = ["boresight of NAC-R about", "a-priori sigma, mrad", "error, mrad", "sigma, mrad", "error, m", "sigma, m"]
    return table(head, rows)


def _errors(every: Sequence[Judged]) -> list[str]:
    """Cells of errors over the seeds that converged."""
    runs = [one for one in every if one.converged]
    common = np.array([one.places.mean(axis=0) for one in runs])
    rest = np.concatenate([one.places - one.places.mean(axis=0) for one in runs])
    sigmas = np.concatenate([one.sigmas for one in runs])
    flat, stated = (np.sqrt(0.5 * np.mean(np.sum(one[:, :2] ** 2, axis=1))) for one in (rest, sigmas))
    cells = [
        np.sqrt(np.mean(np.concatenate([one.seam for one in runs]) ** 2)), np.sqrt(np.mean(np.sum(common**2, axis=1))),
        flat, root_mean_square(rest[:, 2], 0), stated, root_mean_square(sigmas[:, 2], 0),
        np.mean([one.points for one in runs]), np.mean([one.squares for one in runs]),
    ]  # fmt: skip
    return [*(number(float(cell)) for cell in cells), f"{len(runs)} of {len(every)}"]


# --- what both parts have


def _runs(
    what: str, first: int, seeds: int, one: Callable[[int], dict[str, Judged]]
) -> list[dict[str, Judged]]:
    runs = []
    for seed in range(first, first + seeds):
        show(f"{what}: seed {seed} of {first + seeds - 1}")
        runs.append(one(seed))
    return runs


def honesty(every: dict[str, list[Judged]]) -> list[str]:
    """NEES of shared unknowns jointly, of trajectories, points, and squares of all rows."""
    rows = []
    for name, runs in every.items():
        n = len(runs)
        shared = [sum(float(e @ np.linalg.solve(c, e)) for e, c in run.shared) for run in runs]
        width = 3 * len(runs[0].shared)
        points = np.array([run.points for run in runs])
        half = student(0.01, n - 1) * float(points.std(ddof=1)) / np.sqrt(n) if n > 1 else float("nan")
        freedom = sum(run.freedom for run in runs)
        squares = sum(run.squares * run.freedom for run in runs) / freedom
        cells = [
            within(sum(shared) / (n * width), chi_square_band(n * width)),
            within(sum(run.trajectory for run in runs) / (n * runs[0].coefficients),
                   chi_square_band(n * runs[0].coefficients)),
            within(float(points.mean()), (1.0 - half, 1.0 + half)),
            within(squares, chi_square_band(int(freedom))),
            f"{sum(run.converged for run in runs)} of {n}",
        ]  # fmt: skip
        rows.append([name, *cells])
    return table(["", "NEES of boresights", "NEES of trajectories", "NEES of points", "squares", "converged"], rows)


def _milli(values: Sequence[float]) -> str:
    return ", ".join(f"{value / MRAD:g}" for value in values)


# --- MOC


def moc_images(data: Path) -> tuple[PushbroomImage, PushbroomImage]:
    """M04/02852 and the wide angle of the same moment."""
    folder = data / "mgs_moc_m0402852"
    kernels = [folder / name for name in KERNELS]
    narrow = folder / "m0402852_isis.lbl"
    with tempfile.TemporaryDirectory() as place:
        wide = Path(place) / "wide.lbl"
        wide.write_text(wide_angle_label(narrow.read_text(encoding="utf-8")), encoding="utf-8")
        return read_labelled_image(narrow, kernels), read_labelled_image(wide, kernels)


def moc_part(data: Path, first: int, seeds: int) -> list[str]:
    """The part of the page about MOC."""
    images, usual = moc_images(data), MocSettings()
    ways = {
        "narrow angle, wide angle, MOLA": usual,
        "without the wide angle": replace(usual, wide=False),
        "without MOLA": replace(usual, shots=0),
        "without control in the wide angle": replace(usual, control=0),
    }

    def one(seed: int) -> dict[str, Judged]:
        rigs = {way: simulate_moc_rig(images, chosen, seed) for way, chosen in ways.items()}
        return {way: judged(rig, rig.network, usual.errors, 372e3) for way, rig in rigs.items()}

    runs = _runs("MOC", first, seeds, one)
    words = MOC.format(
        seeds=seeds, bias=usual.errors.position[0], drift=usual.errors.position[1],
        attitude=_milli(usual.errors.attitude), discrepancy=usual.discrepancy, ties=usual.ties, control=usual.control,
        shots=usual.shots, tie_narrow=usual.tie_sigmas[0], tie_wide=usual.tie_sigmas[1],
    )  # fmt: skip
    head = ["", "roll, mrad", "pitch, mrad", "points, horizontal, m", "WA boresight x, mrad", "y", "z", "beam x, mrad",
            "y", "beam y on the ground, m"]  # fmt: skip
    rows = [["a priori", *(number(v) for v in (0.3, 0.3, np.nan, 2.0, 2.0, 2.0, 0.25, 0.9, 0.9 * 372.0))]]
    rows += [[way, *_moc_cells([run[way] for run in runs], ways[way])] for way in ways]
    return [words, *honesty({way: [run[way] for run in runs] for way in ways}), MOC_TABLE, *table(head, rows),
            MOC_READING]  # fmt: skip


def _moc_cells(runs: Sequence[Judged], settings: MocSettings) -> list[str]:
    """Sigmas, with errors in brackets."""

    def cell(sigmas: Sequence[float] | Array, errors: Sequence[float] | Array, unit: float) -> str:
        stated, real = (float(np.sqrt(np.mean(np.square(values)))) / unit for values in (sigmas, errors))
        return f"{number(stated)} ({number(real)})"

    pointing = np.array([run.pointing for run in runs])
    cells = [cell(pointing[:, 1, k], pointing[:, 0, k], MRAD) for k in (0, 1)]
    cells.append(cell(np.concatenate([run.sigmas[:, :2].ravel() for run in runs]),
                      np.concatenate([run.places[:, :2].ravel() for run in runs]), 1.0))  # fmt: skip
    unknowns = {"wide": 0, "beam": int(settings.wide)}
    for name, there, axes in (("wide", settings.wide, (0, 1, 2)), ("beam", settings.shots > 0, (0, 1))):
        for k in axes:
            number_of = unknowns[name]
            cells.append("-" if not there else cell([np.sqrt(run.shared[number_of][1][k, k]) for run in runs],
                                                    [run.shared[number_of][0][k] for run in runs], MRAD))  # fmt: skip
    if settings.shots:
        number_of = unknowns["beam"]
        cells.append(cell([372e3 * np.sqrt(run.shared[number_of][1][1, 1]) for run in runs],
                          [372e3 * run.shared[number_of][0][1] for run in runs], 1.0))  # fmt: skip
    else:
        cells.append("-")
    return cells


def main() -> int:
    """Command line."""
    parser = command(__doc__)
    parser.add_argument("--seeds", type=at_least(2), default=40)
    parser.add_argument("--moc-seeds", type=at_least(2), default=40)
    parser.add_argument("--first", type=at_least(0), default=1)
    parser.add_argument("--data", type=Path, default=ROOT.parent / "shared" / "data")
    parser.add_argument("--out", type=Path, default=DOCS / PAGE)
    chosen = parser.parse_args()

    def text() -> str:
        begin = time.perf_counter()
        lines = [WORDS, *nac_part(chosen.first, chosen.seeds)]
        if chosen.data.is_dir():
            lines += moc_part(chosen.data, chosen.first, chosen.moc_seeds)
        spent = time.perf_counter() - begin
        return "\n".join([*lines, f"Seeds from {chosen.first} on. {made_with()} {machine()}, {spent:.0f} s.", ""])

    return write_page(parser, chosen.out, text)


if __name__ == "__main__":
    sys.exit(main())

"""Whether a solution is a result, and how it fits: what forbids to take it for one, what drives one that did not
converge, sigma0 of all observations and of each group, linearity; and what readers of images decided.
"""

import math
from collections.abc import Sequence
from itertools import chain
from statistics import NormalDist

import numpy as np

from mgsgraph.adjustment.covariances import Linearity
from mgsgraph.adjustment.drivers import Contributions, Kind, driver_sentences
from mgsgraph.adjustment.fit import ABSURD, IMPOSSIBLE
from mgsgraph.adjustment.solution import Solution
from mgsgraph.analysis import grouping as groups
from mgsgraph.analysis.residual_tests import ODDS, GroupFit, group_fits
from mgsgraph.analysis.soundness import MOST, Loss, soundness, unexplained_ranges, unexplained_residuals
from mgsgraph.files.output.table import Table
from mgsgraph.geometry.image import PushbroomImage
from mgsgraph.geometry.records import Array
from mgsgraph.network import Network
from mgsgraph.results.section import Section, record_of, table_of
from mgsgraph.text import listed, some, some_of

_KEYS = {
    "tie image points": "sigma_factor in [ties]",
    "laser image points": "image_sigma_px",
    "control image points": "those in the file of ground control",
    groups.RANGES: "range_sigma_m",
    groups.GROUND_PRIORS: "ground_sigma_m, or those of ground control",
    groups.HEIGHTS: "vertical_sigma_m in [terrain]",
    groups.STEREO_HEIGHTS: "sigma_m in [[altimetry]] or vertical_sigma_m in [terrain]",
    groups.POSITION: "position_sigma_m in [orientation]",
    groups.POINTING: "angle_sigma_mrad in [orientation]",
    groups.SHIFTS: "shift_sigma_m",
}
"""Where a case states the sigmas of a group."""


def state_of(solution: Solution) -> str:
    """converged, NOT CONVERGED, or converged without being a result."""
    if not solution.converged:
        return "NOT CONVERGED"
    return "converged" if soundness(solution).sound else "converged, but NO RESULT"


def soundness_section(solution: Solution) -> Section:
    """Why a solution is no result, and of what many observations are left out."""
    found, said, reasons = soundness(solution), list[str](), list[str]()
    moved = [(solution.network.images[one.image].name, one.most) for one in found.impossible]
    if found.fatal:
        reasons.append(f"{_losses(found.fatal)} did not take part, and beyond half of a kind the rest proves nothing")
    if found.absurd:
        reasons.append(f"residuals are {found.sigma0:.3g} times larger than stated")
    if moved:
        names = some([name for name, _ in moved], len(moved))
        reasons.append(f"orientations moved by up to {moved[0][1]:.0f} a-priori sigmas ({names})")
    if solution.converged and reasons:
        said.append(
            f"NO RESULT although it converged: {'; '.join(reasons)}. An input is wrong (images, columns, lines and "
            "samples interchanged; a unit, a camera), or there are gross blunders. Look at the largest residuals "
            "and at `mgsgraph check`; adjust with --reject 4, or without rejection where that left too little."
        )
    if lost := [one for one in found.losses if not one.fatal]:
        said.append(f"Left out are {_losses(lost)}: so many are no single blunders; look for what they have in common.")
    return Section("soundness", sentences=said, numbers={
        "sound": solution.converged and found.sound,
        "sigma0_absurd": found.absurd,
        "orientations_impossible": [{"image": name, "sigmas": most} for name, most in moved],
        "limits": {"share": MOST, "sigma0": ABSURD, "orientation_sigmas": IMPOSSIBLE},
        "left_out": [
            {"kind": str(one.kind), "image": one.image or None, "count": one.lost, "of": one.total, "fatal": one.fatal}
            for one in found.losses
        ],
    })  # fmt: skip


def _losses(losses: Sequence[Loss]) -> str:
    return some([
        f"{one.lost} of {one.total} {one.kind}{f' of {one.image}' if one.image else ''} ({one.share:.0%})"
        for one in losses
    ], len(losses))  # fmt: skip


def implausible_section(solution: Solution) -> Section:
    """Orientations that were moved too far, and ranges that no orbit within its sigmas explains."""
    net, found = solution.network, solution.strained
    said = [f"With the nominal orientation {one}." for one in range_statements(net, solution.range_residuals_before)]
    if found and not (solution.converged and found[0].impossible):  # else `soundness_section` speaks of it
        said.append(
            f"Moved by up to {found[0].most:.2g} of their a-priori sigmas are the orientations of "
            f"{some([net.images[one.image].name for one in found], len(found))}: an input is wrong, or these sigmas "
            "are too small, and none of the quoted sigmas holds. Look at the inputs with `mgsgraph check` first."
        )
    return Section("", sentences=said)


def linearity_section(found: Linearity | None) -> Section:
    """What a solution's linearity means."""
    if found is None:
        return Section("linearity")
    drawn = f"(cost ratio {found.ratio:.3g} over {found.draws} samples of {found.unknowns} unknowns)"
    said = f"Linearity check passed {drawn}." if found.linear else (
        f"NOT LINEAR {drawn}. Single sigmas may hold; joint statements on orientation and shifts by their covariance "
        "don't. Use likelihood ratios and profiles: `mgsgraph analyze RESULT --likelihood IMAGE` (docs/analysis.md)."
    )
    return Section("linearity", sentences=[said], numbers=record_of("linearity", found))  # fmt: skip


# --- what drives it


def drivers_section(solution: Solution) -> Section:
    """Which images and points drive an adjustment that did not converge; nothing of one that did."""
    found = solution.drivers
    if found is None:
        return Section("drivers")
    said = " ".join(driver_sentences(found, solution.network))
    if solution.settings.loss == "tukey":
        said += " With the loss tukey the end depends on the start: begin with huber, or give better orientations."
    table = drivers_table(solution)
    return Section("drivers", sentences=[said], tables=[table], csv=[table], numbers={
        **record_of("drivers", found),
        "outstanding": [
            {
                "quantity": str(one.quantity), "kind": str(one.kind), "count": one.outstanding, "of": one.of,
                "share": one.share, "names": _names(solution, one)[: min(one.outstanding, one.members.size)],
            }
            for one in found.outstanding
        ],
    })  # fmt: skip


def drivers_table(solution: Solution) -> Table:
    """One row per image or point and quantity, those that stand out and others with the largest shares."""
    every = () if solution.drivers is None else solution.drivers.contributions
    rows = [(one, rank) for one in every for rank in range(one.members.size)]
    return table_of("drivers", {
        "quantity": [str(one.quantity) for one, _ in rows], "kind": [str(one.kind) for one, _ in rows],
        "name": list(chain.from_iterable(_names(solution, one) for one in every)),
        "share": np.concatenate([np.zeros(0), *(one.shares for one in every)]),
        "stands_out": ["yes" if rank < one.outstanding else "" for one, rank in rows],
    })  # fmt: skip


def _names(solution: Solution, one: Contributions) -> list[str]:
    network = solution.network
    if one.kind == Kind.IMAGE:
        return [network.images[j].name for j in one.members.tolist()]
    return [network.points.ids[i] for i in one.members.tolist()]


# --- sigma0


def fits_section(solution: Solution) -> Section:
    """What sigma0 says, and each group's; numbers are None where nobody has looked."""
    fits = group_fits(solution)
    table = group_fits_table(fits)
    return Section("fits", sentences=weight_unit(solution), tables=[table],
                   numbers=None if fits is None else table.records())  # fmt: skip


def group_fits_table(fits: Sequence[GroupFit] | None) -> Table:
    """One row per group of observations: how it fits its stated sigmas; none where nobody has looked."""
    shown = fits or ()
    expected = np.array([(one.low, one.high) for one in shown]).reshape(-1, 2)
    state = {(True, False): "WORSE than stated", (False, True): "better than stated"}
    return table_of("fits", {
        "by_chance_{}": expected,
        "state": [state.get((one.worse, one.better), "") if one.judged else "not judged" for one in shown],
    }, shown)  # fmt: skip


def weight_unit(solution: Solution) -> list[str]:
    """What sigma0 says of the stated sigmas, and which groups of observations contradict it."""
    sigma0, freedom, fits = solution.sigma0, solution.fit.degrees_of_freedom, group_fits(solution) or ()
    if math.isnan(sigma0):
        why = "residuals are not finite" if freedom > 0 else "nothing checks the observations"
        return [f"sigma0 is not defined, with {freedom} degrees of freedom: {why}."]
    head = f"sigma0 is {sigma0:.3g} with {freedom} degrees of freedom"
    if solution.converged and solution.strained:
        return [f"{head}. No sigma holds while orientations are far beyond their a-priori sigmas: look at the inputs."]
    worse, better = [one for one in fits if one.worse], [one for one in fits if one.better]
    mixed = len({(one.worse, one.better) for one in fits if one.judged}) > 1  # groups that do not fit alike
    if mixed and worse and sigma0 <= ABSURD:
        return [
            f"{head}, but some observations fit WORSE than stated, and sigmas that rest on them are too small: "
            f"{listed([_factor(one) for one in sorted(worse, key=lambda one: -one.sigma0)])}. Look for blunders there "
            "(--reject 4); if there are none, multiply these stated sigmas by the factors and adjust again (`analyze "
            "--components --iterate` finds those of all groups)."
        ]
    if mixed and better:
        return [
            f"{head}, but some observations fit better than stated, and sigmas that rest on them are cautious: "
            f"{listed([_factor(one) for one in better])} (`analyze --components`)."
        ]
    # the chi-square law: sigma0 scatters by 1 / sqrt(2 f) about 1 when the stated sigmas are right
    if abs(sigma0 - 1.0) <= NormalDist().inv_cdf(1.0 - 0.5 * ODDS) / math.sqrt(2.0 * freedom):
        return [f"{head}: the observations fit as well as their stated sigmas say, and the quoted sigmas hold."]
    factor = sigma0 if sigma0 > 1.0 else 1.0 / sigma0 if sigma0 > 0.0 else math.inf
    means = (
        "and are too small by that factor, unless blunders are to blame: look at the largest residuals" if sigma0 > 1.0
        else f"and are cautious; multiply them by {sigma0:.3g} if you trust the fit"
    )
    return [
        f"{head}: the observations fit {_times(factor)} times {'worse' if sigma0 > 1.0 else 'better'} than their "
        f"stated sigmas. All sigmas are quoted for sigma0 = 1 {means}."
    ]


def _factor(one: GroupFit) -> str:
    """A group, by what factor its stated sigmas are wrong, and where a case states them."""
    key = _KEYS.get(one.name.split(",")[0])
    return f"{one.name} {_times(one.sigma0)}{f' ({key})' if key and one.worse else ''}"


def _times(factor: float) -> str:
    """A factor over one in two digits, near one in three: "1 times better" says nothing."""
    return f"{factor:.2g}" if factor >= 2.0 else f"{factor:.3g}"


# --- the input


def reading_statements(images: Sequence[PushbroomImage]) -> list[str]:
    """One sentence for each remark of the readers of images, with the images that it is of."""
    names = [image.name for image in images]
    of_remark = dict[str, list[int]]()
    for j, image in enumerate(images):
        for remark in image.remarks:
            of_remark.setdefault(remark, []).append(j)
    return [f"As read, {some_of(names, np.array(members))}: {remark}." for remark, members in of_remark.items()]


def beyond_priors_statements(network: Network, residuals: Array) -> list[str]:
    """Images whose residuals (k, 2) with the nominal orientation no error within the a-priori sigmas explains."""
    found = [
        f"{network.images[one.image].name} {one.size:.0f} px (expected {one.expected:.2g})"
        for one in unexplained_residuals(network, residuals)
    ]
    return found and [
        "residuals with the nominal orientation are larger than a-priori sigmas explain, median of "
        f"{some(found, len(found))}: images, lines and samples, or labels may be interchanged, or sigmas too small"
    ]


def range_statements(network: Network, residuals: Array) -> list[str]:
    """Images whose range residuals (r,) with the nominal orientation no error within the a-priori sigmas explains."""
    found = [
        f"{network.images[one.image].name} {one.size:+.4g} m (expected {one.expected:.2g})"
        for one in unexplained_ranges(network, residuals)
    ]
    return found and [
        "laser ranges minus the distances to their footprints have a mean that no a-priori sigma explains, "
        f"{some(found, len(found))}: look at the ranges, the footprints' radii and the orbit first"
    ]

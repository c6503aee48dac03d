"""The verdict in words: whether a solution may be used and why (not), what was not tested, what could still hide; what
drives an adjustment that did not converge, linearity, and what readers of images decided.
"""

import math
from collections.abc import Sequence
from itertools import chain
from statistics import NormalDist

import numpy as np

from mgsgraph.adjustment.covariances import Linearity
from mgsgraph.adjustment.drivers import Contributions, Kind, driver_sentences
from mgsgraph.adjustment.solution import Solution
from mgsgraph.analysis import grouping as groups
from mgsgraph.analysis.sanity import unexplained_ranges, unexplained_residuals
from mgsgraph.analysis.undetected import POWER, SHIFTS, Undetected
from mgsgraph.analysis.verdict import LEVEL, Cause, Reason, State, Verdict, level_of_groups, verdict
from mgsgraph.files.output.table import Table
from mgsgraph.geometry.image import PushbroomImage
from mgsgraph.geometry.records import Array
from mgsgraph.network import Network
from mgsgraph.results.section import Section, record_of, table_of
from mgsgraph.text import length, listed, many, short, some, some_of, two
from mgsgraph.units import ARCSEC, DEG

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


_LOOSE = 5.0
"""Factor from which on it is told that stated sigmas may be too small by it."""
_SHOWN = {State.VALID: "valid", State.SUSPECT: "SUSPECT", State.INVALID: "INVALID"}


def state_of(solution: Solution) -> str:
    """Valid, SUSPECT or INVALID, and whether it converged."""
    return f"{_SHOWN[verdict(solution).state]}, {'converged' if solution.converged else 'NOT CONVERGED'}"


def headline(solution: Solution) -> str:
    """The name of a solution and its state."""
    return f"{short(solution.name, 60)}: {state_of(solution)}"


def verdict_section(solution: Solution) -> Section:
    """Reasons, what was not tested, and what could still hide."""
    found = verdict(solution)
    table = group_tests_table(found)
    said = [*reason_sentences(found.reasons), *tested_sentences(found, solution, None)]
    return Section("verdict", sentences=said, tables=[table], numbers={
        **record_of("verdict", found),
        "level": LEVEL,
        "reasons": [record_of("reason", one) for one in found.reasons],
        "groups": [
            {**record_of("group_test", one),
             "may_be_too_small_by": one.hidden_factor(level_of_groups(found.groups), POWER)}
            for one in found.groups
        ],
        "corrections": [record_of("correction", one) for one in found.corrections],
        "undetected": [record_of("undetected", one) for one in found.undetected],
        "power": POWER,
    })  # fmt: skip


def group_tests_table(found: Verdict) -> Table:
    """One row per group of observations or priors: how it fits its stated sigmas."""
    marked = {one.what for one in found.of(Cause.GROUP)}
    return table_of("group_tests", {
        "state": ["WORSE than stated" if one.name in marked else "" if one.tested else "not tested"
                  for one in found.groups],
    }, found.groups)  # fmt: skip


def reason_sentences(reasons: Sequence[Reason]) -> list[str]:
    """One for each cause, of its gravest reason, with the number of others."""
    of_cause = dict[Cause, list[Reason]]()
    for one in reasons:
        of_cause.setdefault(one.cause, []).append(one)
    said = []
    for every in of_cause.values():
        more = f" ({many(len(every) - 1, 'similar result')}.)" if len(every) > 1 else ""
        said.append(_reason(every[0]) + more)
    return said


def _reason(one: Reason) -> str:
    chance = f" (p = {max(one.p_value, 1e-99):.0e})" if math.isfinite(one.p_value) else ""
    size, key = two(abs(one.size)), _KEYS.get(one.what.split(",")[0])
    return {
        Cause.NOT_CONVERGED: one.what,
        Cause.LEFT_OUT: f"{one.count} {one.what} ({one.size:.0%}) were left out or rejected: look for a common cause.",
        Cause.SIGMA0: f"Residuals are {size} times larger than stated: an input is wrong (images, columns, a unit, a "
        "camera), or there are gross blunders (--reject 4).",
        Cause.ORIENTATION: f"The orientation of {one.what} moved by {size} prior sigmas: an input is wrong, or these "
        "sigmas are too small.",
        Cause.CORRECTION: f"The {one.what} is corrected by {size} prior sigmas, {_deviate(one.p_value)} times what is "
        f"expected{chance}: check this input and its prior.",
        Cause.COMMON_ERROR: f"Residuals and corrections look like an error of {one.what}: {size} sigmas{chance}.",
        Cause.GROUP: f"{one.what[0].upper()}{one.what[1:]} fit {size} times worse than stated{chance}: look for "
        f"blunders (--reject 4), or enlarge {key or 'their sigmas'}.",
        Cause.OFFSET: f"The {one.what} have a mean residual of {one.size:+.2g} {one.unit}, expected 0{chance}.",
        Cause.OBSERVATION: f"{many(one.count, 'point')} with outliers, the largest {one.what} with "
        f"{size} sigmas{chance}: --reject 4 rejects blunders.",
        Cause.NOMINAL: f"Nominal residuals of {one.what} are {two(one.size)} {one.unit}, more than priors explain.",
        Cause.PROFILE: f"{many(one.count, 'laser shot')} of {one.what} lie {math.degrees(abs(one.size)):.1f} deg along "
        "the flight from where the camera looked: a wrong clock or a wrong profile.",
        Cause.HEIGHT: f"Point {one.what} lies {length(abs(one.size))} {'above' if one.size > 0.0 else 'below'} its "
        "neighbors: a false match, or a wrong measurement.",
        Cause.DUPLICATE: f"{one.what}.",
        Cause.UNTESTED: f"Nothing could be tested: {one.what}.",
    }[one.cause]  # fmt: skip


def _deviate(p_value: float) -> str:
    """The standard normal deviate of a two-sided p-value."""
    return two(-NormalDist().inv_cdf(0.5 * max(p_value, 1e-99)))


def tested_sentences(found: Verdict, solution: Solution, most: int | None) -> list[str]:
    """What was tested, what was not, and what errors of inputs could hide, `most` of either kind."""
    if not found.groups:
        freedom = solution.fit.degrees_of_freedom
        return [f"Nothing was tested ({many(freedom, 'degree')} of freedom): sigmas rest on the stated ones alone."]
    of = len(solution.network.points)
    sample = f" of {found.points:,} of {of:,} points" if found.points < 0.9 * of else ""
    untested = f" Not tested: {listed(list(found.untested))}." if found.untested else ""
    level = level_of_groups(found.groups)
    factors = [(one.hidden_factor(level, POWER), one.name) for one in found.groups if one.tested]
    factors = sorted((one for one in factors if one[0] > _LOOSE), reverse=True)[:most]
    hidden = [f"{name} (up to {two(factor)} times)" for factor, name in factors]
    said = [f"{found.tests:,} tests{sample} ({LEVEL:.1%} false alarms).{untested}"]
    said += [f"These sigmas could be too small, and no test would show it: {', '.join(hidden)}."] if hidden else []
    return said + hidden_sentences(found.undetected, most)


_OF_KIND = {
    "clock": ("clock", "attitude time", "position time"),
    "position": ("along position", "across position", "radial position"),
    "pointing": ("roll", "pitch", "yaw"),
    "camera": ("focal length",),
    "laser": ("range",),
    "control": SHIFTS,
}
"""Errors of inputs by kind: of each the one that moves points most is told."""


_LARGE = {"s": 10.0, "m": 1e3, "rad": DEG, "": 0.01}
"""Errors of inputs larger than which nobody makes; those that do no harm then are not told."""


def hidden_sentences(found: Sequence[Undetected], most: int | None) -> list[str]:
    """The errors of inputs that could move points most without being found; those that nothing tests."""
    worst, bare = list[Undetected](), list[Undetected]()
    for names in _OF_KIND.values():
        mine = [one for one in found if one.what in names and one.moves > 0.0]
        tested = [one for one in mine if one.tested]
        if tested:
            worst.append(max(tested, key=lambda one: one.effect_in_sigmas))
        harmful = [one for one in mine if not one.tested and one.in_sigmas * _LARGE[one.unit] > 1.0]
        bare += sorted(harmful, key=lambda one: -one.in_sigmas)[:1]
    worst.sort(key=lambda one: -one.effect_in_sigmas)
    could = [
        f"{one.what} of {one.of} by {_amount(one.size, one.unit)} (moves points by {length(one.effect)}, "
        f"{two(one.effect_in_sigmas)} sigmas)" for one in worst[:most]
    ]  # fmt: skip
    said = [f"Largest error{'s' * (len(could) > 1)} that no test shows: {'; '.join(could)}."] if could else []
    nothing = [f"{one.what} of {one.of} (moves points by {_per_unit(one)})" for one in bare[:most]]
    said += [f"No test shows an error of: {'; '.join(nothing)}."] if nothing else []
    loose = max(found, key=lambda one: np.nan_to_num(one.effect_without_terrain, posinf=1e99, nan=-1.0))
    if loose.size_without_terrain > 0.0:
        said.append(
            f"If the terrain fits at a wrong position: {loose.what} of {loose.of} by "
            f"{_amount(loose.size_without_terrain, loose.unit)} (moves points by "
            f"{length(loose.effect_without_terrain)}) stays undetected."
        )
    return said


def _amount(size: float, unit: str) -> str:
    if not math.isfinite(size):
        return "any size"
    if not unit:
        return f"{two(100.0 * size)} %"
    return f"{two(size / ARCSEC)} arcsec" if unit == "rad" else length(size) if unit == "m" else f"{two(size)} {unit}"


def _per_unit(one: Undetected) -> str:
    """By how much an error of one unit moves points."""
    factor, unit = {"rad": (ARCSEC, "arcsec"), "": (0.01, "%")}.get(one.unit, (1.0, one.unit))
    return f"{two(one.moves * factor)} m per {unit}"


def linearity_section(found: Linearity | None) -> Section:
    """What a solution's linearity means."""
    if found is None:
        return Section("linearity")
    drawn = f"(cost ratio {found.ratio:.3g} over {found.draws} samples of {found.unknowns} unknowns)"
    said = f"Linearity check passed {drawn}." if found.linear else (
        f"Linearity check failed {drawn}: single sigmas may hold, joint covariances of orientation and shifts don't. "
        "Use likelihood intervals: `mgsgraph analyze RESULT --likelihood IMAGE` (docs/analysis.md)."
    )
    return Section("linearity", sentences=[said], numbers=record_of("linearity", found))  # fmt: skip


# --- what drives it


def drivers_section(solution: Solution) -> Section:
    """Which images and points drive an adjustment that did not converge; nothing of one that did."""
    found = solution.drivers
    if found is None:
        return Section("drivers")
    said = " ".join(driver_sentences(found, solution.network))
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

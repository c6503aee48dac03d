"""The verdict in sentences: whether a solution may be used and why (not), what was not tested, undetected errors; what
drives an adjustment that did not converge, linearity, and remarks of the readers of images.
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
from mgsgraph.analysis.sanity import Unexplained, unexplained_ranges, unexplained_residuals
from mgsgraph.analysis.undetected import POWER, SHIFTS, Undetected
from mgsgraph.analysis.verdict import LEVEL, Cause, Reason, State, Verdict, level_of_groups, verdict
from mgsgraph.files.output.table import Table
from mgsgraph.geometry.image import PushbroomImage
from mgsgraph.geometry.records import Array
from mgsgraph.names import grouped
from mgsgraph.network import Network
from mgsgraph.results.section import Section, record_of, table_of
from mgsgraph.text import length, listed, many, short, some, two
from mgsgraph.units import ARCSEC, DEG

_SIGMA_KEYS = {
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


_NAMED_FACTOR = 5.0
"""Least factor by which the sigmas of a group could be too small unnoticed for the group to be named."""
_STATE_WORDS = {State.VALID: "valid", State.SUSPECT: "SUSPECT", State.INVALID: "INVALID"}


def state_of(solution: Solution) -> str:
    """Valid, SUSPECT or INVALID, and whether it converged."""
    return f"{_STATE_WORDS[verdict(solution).state]}, {'converged' if solution.converged else 'NOT CONVERGED'}"


def headline(solution: Solution) -> str:
    """The name of a solution and its state."""
    return f"{short(solution.name, 60)}: {state_of(solution)}"


def verdict_section(solution: Solution) -> Section:
    """Reasons, what was not tested, and what could still hide."""
    assessment = verdict(solution)
    table = group_tests_table(assessment)
    sentences = [*reason_sentences(assessment.reasons), *tested_sentences(assessment, solution, None)]
    return Section("verdict", sentences=sentences, tables=[table], numbers={
        **record_of("verdict", assessment),
        "level": LEVEL,
        "reasons": [record_of("reason", reason) for reason in assessment.reasons],
        "groups": [
            {**record_of("group_test", group),
             "may_be_too_small_by": group.hidden_factor(level_of_groups(assessment.groups), POWER)}
            for group in assessment.groups
        ],
        "corrections": [record_of("correction", correction) for correction in assessment.corrections],
        "undetected": [record_of("undetected", error) for error in assessment.undetected],
        "power": POWER,
    })  # fmt: skip


def group_tests_table(assessment: Verdict) -> Table:
    """One row per group of observations or priors: how it fits its stated sigmas."""
    worse_groups = {reason.what for reason in assessment.of(Cause.GROUP)}
    return table_of("group_tests", {
        "state": ["WORSE than stated" if group.name in worse_groups else "" if group.tested else "not tested"
                  for group in assessment.groups],
    }, assessment.groups)  # fmt: skip


def reason_sentences(reasons: Sequence[Reason]) -> list[str]:
    """One sentence for each cause: its gravest reason, and the number of similar ones."""
    sentences = []
    for same_cause in grouped((reason.cause, reason) for reason in reasons).values():
        similar = f" ({many(len(same_cause) - 1, 'similar result')}.)" if len(same_cause) > 1 else ""
        sentences.append(_reason_sentence(same_cause[0]) + similar)
    return sentences


def _reason_sentence(reason: Reason) -> str:
    chance = f" (p = {max(reason.p_value, 1e-99):.0e})" if math.isfinite(reason.p_value) else ""
    size, key = two(abs(reason.size)), _SIGMA_KEYS.get(reason.what.split(",")[0])
    return {
        Cause.NOT_CONVERGED: reason.what,
        Cause.LEFT_OUT: f"{reason.count} {reason.what} ({reason.size:.0%}) were left out or rejected: look for "
        "a common cause.",
        Cause.SIGMA0: f"Residuals are {size} times larger than stated: an input is wrong (images, columns, a unit, a "
        "camera), or there are gross blunders (--reject 4).",
        Cause.ORIENTATION: f"The orientation of {reason.what} moved by {size} prior sigmas: an input is wrong, or "
        "these sigmas are too small.",
        Cause.CORRECTION: f"The {reason.what} is corrected by {size} prior sigmas, {_deviate(reason.p_value)} times "
        f"what is expected{chance}: check this input and its prior.",
        Cause.COMMON_ERROR: f"Residuals and corrections look like an error of {reason.what}: {size} sigmas{chance}.",
        Cause.GROUP: f"{reason.what[0].upper()}{reason.what[1:]} fit {size} times worse than stated{chance}: look for "
        f"blunders (--reject 4), or enlarge {key or 'their sigmas'}.",
        Cause.CHECKPOINT: f"Checkpoints are {size} times farther from their known coordinates than stated{chance}: "
        "look for a wrong datum or unit, or enlarge the sigmas of control.",
        Cause.OFFSET: f"The {reason.what} have a mean residual of {reason.size:+.2g} {reason.unit}, "
        f"expected 0{chance}.",
        Cause.OBSERVATION: f"{many(reason.count, 'point')} with outliers, the largest {reason.what} with "
        f"{size} sigmas{chance}: --reject 4 rejects blunders.",
        Cause.NOMINAL: f"Nominal residuals of {reason.what} are {two(reason.size)} {reason.unit}, "
        "more than priors explain.",
        Cause.PROFILE: f"{many(reason.count, 'laser shot')} of {reason.what} lie {math.degrees(abs(reason.size)):.1f} "
        "deg along the flight from where the camera looked: a wrong clock or a wrong profile.",
        Cause.HEIGHT: f"Point {reason.what} lies {length(abs(reason.size))} "
        f"{'above' if reason.size > 0.0 else 'below'} its neighbors: a false match, or a wrong measurement.",
        Cause.DUPLICATE: f"{reason.what}.",
        Cause.UNTESTED: f"Nothing could be tested: {reason.what}.",
    }[reason.cause]  # fmt: skip


def _deviate(p_value: float) -> str:
    """The standard normal deviate of a two-sided p-value."""
    return two(-NormalDist().inv_cdf(0.5 * max(p_value, 1e-99)))


def tested_sentences(assessment: Verdict, solution: Solution, max_count: int | None) -> list[str]:
    """What was tested, what was not, and what errors of inputs could hide, `most` of either kind."""
    if not assessment.groups:
        freedom = solution.fit.degrees_of_freedom
        return [f"Nothing was tested ({many(freedom, 'degree')} of freedom): sigmas rest on the stated ones alone."]
    point_count = len(solution.network.points)
    sample = f" of {assessment.points:,} of {point_count:,} points" if assessment.points < 0.9 * point_count else ""
    untested = f" Not tested: {listed(list(assessment.untested))}." if assessment.untested else ""
    level = level_of_groups(assessment.groups)
    factors = [(group.hidden_factor(level, POWER), group.name) for group in assessment.groups if group.tested]
    factors = sorted((pair for pair in factors if pair[0] > _NAMED_FACTOR), reverse=True)[:max_count]
    hidden = [f"{name} (up to {two(factor)} times)" for factor, name in factors]
    sentences = [f"{assessment.tests:,} tests{sample} ({LEVEL:.1%} false alarms).{untested}"]
    sentences += [f"These sigmas could be too small, and no test would show it: {', '.join(hidden)}."] if hidden else []
    return sentences + hidden_sentences(assessment.undetected, max_count)


_ERROR_KINDS = {
    "clock": ("clock", "attitude time", "position time"),
    "position": ("along position", "across position", "radial position"),
    "pointing": ("roll", "pitch", "yaw"),
    "camera": ("focal length",),
    "laser": ("range",),
    "control": SHIFTS,
}
"""Errors of inputs by kind: of each the one that moves points most is named."""


_LARGEST_ERRORS = {"s": 10.0, "m": 1e3, "rad": DEG, "": 0.01}
"""Largest plausible errors of inputs, by unit; an untested error that is harmless at this size is not named."""


def hidden_sentences(errors: Sequence[Undetected], max_count: int | None) -> list[str]:
    """The errors of inputs that could move points most undetected, and those that no test covers."""
    largest, untested = list[Undetected](), list[Undetected]()
    for names in _ERROR_KINDS.values():
        of_kind = [error for error in errors if error.what in names and error.moves > 0.0]
        tested = [error for error in of_kind if error.tested]
        if tested:
            largest.append(max(tested, key=lambda error: error.effect_in_sigmas))
        harmful = [error for error in of_kind if not error.tested and error.in_sigmas
                   * _LARGEST_ERRORS[error.unit] > 1.0]
        untested += sorted(harmful, key=lambda error: -error.in_sigmas)[:1]
    largest.sort(key=lambda error: -error.effect_in_sigmas)
    hidden = [
        f"{error.what} of {error.of} by {_size_text(error.size, error.unit)} (moves points by {length(error.effect)}, "
        f"{two(error.effect_in_sigmas)} sigmas)" for error in largest[:max_count]
    ]  # fmt: skip
    sentences = [f"Largest error{'s' * (len(hidden) > 1)} that no test shows: {'; '.join(hidden)}."] if hidden else []
    texts = [f"{error.what} of {error.of} (moves points by {_effect_per_unit(error)})"
             for error in untested[:max_count]]
    sentences += [f"No test shows an error of: {'; '.join(texts)}."] if texts else []
    without_terrain = max(errors, key=lambda error: np.nan_to_num(error.effect_without_terrain, posinf=1e99, nan=-1.0))
    if without_terrain.size_without_terrain > 0.0:
        sentences.append(
            f"If the terrain fits at a wrong position: {without_terrain.what} of {without_terrain.of} by "
            f"{_size_text(without_terrain.size_without_terrain, without_terrain.unit)} (moves points "
            f"{_move_text(without_terrain.effect_without_terrain)}) stays undetected."
        )
    return sentences


def _move_text(effect: float) -> str:
    return f"by {length(effect)}" if math.isfinite(effect) else "without limit"


def _size_text(size: float, unit: str) -> str:
    if not math.isfinite(size):
        return "any size"
    if not unit:
        return f"{two(100.0 * size)} %"
    return f"{two(size / ARCSEC)} arcsec" if unit == "rad" else length(size) if unit == "m" else f"{two(size)} {unit}"


def _effect_per_unit(error: Undetected) -> str:
    """By how much an error of one unit moves points."""
    factor, unit = {"rad": (ARCSEC, "arcsec"), "": (0.01, "%")}.get(error.unit, (1.0, error.unit))
    return f"{two(error.moves * factor)} m per {unit}"


def linearity_section(linearity: Linearity | None) -> Section:
    """Whether joint covariances hold, by the linearity check."""
    if linearity is None:
        return Section("linearity")
    samples = f"(cost ratio {linearity.ratio:.3g} over {linearity.draws} samples of {linearity.unknowns} unknowns)"
    sentence = f"Linearity check passed {samples}." if linearity.linear else (
        f"Linearity check failed {samples}: single sigmas may hold, joint covariances of orientation and shifts don't. "
        "Use likelihood intervals: `mgsgraph analyze RESULT --likelihood IMAGE` (docs/analysis.md)."
    )
    return Section("linearity", sentences=[sentence], numbers=record_of("linearity", linearity))  # fmt: skip


# --- what drives an adjustment that did not converge


def drivers_section(solution: Solution) -> Section:
    """Which images and points drive an adjustment that did not converge; empty for one that did."""
    drivers = solution.drivers
    if drivers is None:
        return Section("drivers")
    sentence = " ".join(driver_sentences(drivers, solution.network))
    table = drivers_table(solution)
    return Section("drivers", sentences=[sentence], tables=[table], csv=[table], numbers={
        **record_of("drivers", drivers),
        "flagged": [
            {
                "quantity": str(group.quantity), "kind": str(group.kind), "count": group.flagged, "of": group.of,
                "share": group.share,
                "names": _member_names(solution, group)[: min(group.flagged, group.members.size)],
            }
            for group in drivers.flagged
        ],
    })  # fmt: skip


def drivers_table(solution: Solution) -> Table:
    """One row per image or point and quantity, those that stand out and others with the largest shares."""
    groups = () if solution.drivers is None else solution.drivers.contributions
    rows = [(group, rank) for group in groups for rank in range(group.members.size)]
    return table_of("drivers", {
        "quantity": [str(group.quantity) for group, _ in rows], "kind": [str(group.kind) for group, _ in rows],
        "name": list(chain.from_iterable(_member_names(solution, group) for group in groups)),
        "share": np.concatenate([np.zeros(0), *(group.shares for group in groups)]),
        "stands_out": ["yes" if rank < group.flagged else "" for group, rank in rows],
    })  # fmt: skip


def _member_names(solution: Solution, group: Contributions) -> list[str]:
    network = solution.network
    if group.kind == Kind.IMAGE:
        return [network.images[j].name for j in group.members.tolist()]
    return [network.points.ids[i] for i in group.members.tolist()]


# --- the input


def reading_statements(images: Sequence[PushbroomImage]) -> list[str]:
    """One sentence for each remark of the readers of images, with the images that it is of."""
    of_remark = grouped((remark, image.name) for image in images for remark in image.remarks)
    return [f"As read, {some(names)}: {remark}." for remark, names in of_remark.items()]


def beyond_priors_statements(network: Network, residuals: Array) -> list[str]:
    """Images whose residuals (k, 2) with the nominal orientation no error within the a-priori sigmas explains."""
    implausible = _implausible(network, unexplained_residuals(network, residuals), "{:.0f} px")
    return implausible and [
        "residuals with the nominal orientation are larger than a-priori sigmas explain, median of "
        f"{some(implausible)}: images, lines and samples, or labels may be interchanged, or sigmas too small"
    ]


def _implausible(network: Network, excesses: Sequence[Unexplained], size: str) -> list[str]:
    names = network.image_names
    return [f"{names[each.image]} {size.format(each.size)} (expected {each.expected:.2g})" for each in excesses]


def range_statements(network: Network, residuals: Array) -> list[str]:
    """Images whose range residuals (r,) with the nominal orientation no error within the a-priori sigmas explains."""
    implausible = _implausible(network, unexplained_ranges(network, residuals), "{:+.4g} m")
    return implausible and [
        "laser ranges minus the distances to their footprints have a mean that no a-priori sigma explains, "
        f"{some(implausible)}: look at the ranges, the footprints' radii and the orbit first"
    ]

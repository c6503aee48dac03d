"""Unknowns that images share, and whether they can be told apart from along-track pointing.

*Likeness* is the cosine of the angle between what two unknowns do to the measures, points free and priors left out: at
1 the measures cannot tell them apart, whatever the sigmas are. *Correlation* is the posterior's, priors included.
"""

from pathlib import Path
from typing import Any

import numpy as np

from mgsgraph.adjustment.analysis.shared_unknowns import SharedEstimate, shared_estimates
from mgsgraph.adjustment.solution import Solution
from mgsgraph.output.csv_json import quoted, write_csv
from mgsgraph.wording import some

_CORRELATED = 0.9
"""Correlation with a constant pitch, and share of the a-priori sigma that is left, above which something is said."""
_ALIKE = 0.99
"""Likeness from which the measures count as unable to tell two unknowns apart."""


# --- reports


def shared_json(solution: Solution) -> list[dict[str, Any]]:
    """For solution.json; units in the keys."""
    return [
        {
            "name": one.name, "kind": str(one.kind), "axis": one.axis or None,
            f"value_{one.unit}": one.value, f"sigma_{one.unit}": one.sigma, f"prior_sigma_{one.unit}": one.prior_sigma,
            "image": one.image or None, "correlation_with_pitch": one.correlation, "likeness_to_pitch": one.likeness,
            "likeness_to_pitches": one.together, f"ground_m_per_{one.unit}": one.ground,
        }
        for one in shared_estimates(solution)
    ]  # fmt: skip


def shared_csv(solution: Solution, path: Path) -> None:
    """Write one row per column of a shared unknown; values, sigmas and metres on the ground in or per `unit`."""
    found = shared_estimates(solution)
    text = {
        "name": [quoted(one.name) for one in found],
        "kind": [str(one.kind) for one in found],
        "axis": [one.axis for one in found],
        "unit": [one.unit for one in found],
        "image": [quoted(one.image) for one in found],
    }
    numbers = {
        "value": [one.value for one in found],
        "sigma": [one.sigma for one in found],
        "prior_sigma": [one.prior_sigma for one in found],
        "correlation_with_pitch": [one.correlation for one in found],
        "likeness_to_pitch": [one.likeness for one in found],
        "likeness_to_pitches": [one.together for one in found],
        "ground_m_per_unit": [one.ground for one in found],
    }
    write_csv(path, text, {name: np.array(values) for name, values in numbers.items()})


def shared_statements(solution: Solution) -> list[str]:
    """A sentence or two about each column."""
    return [" ".join([_value(one), *_warnings(one)]) for one in shared_estimates(solution)]


def _value(one: SharedEstimate) -> str:
    parts = (one.kind if one.name != one.kind else "", f"axis {one.axis}" if one.axis else "")
    what = f" ({', '.join(part for part in parts if part)})" if any(parts) else ""
    return (
        f"{one.name[0].upper()}{one.name[1:]}{what}: {one.value:+.3g} {one.unit}, sigma {one.sigma:.2g} {one.unit} "
        f"(beforehand {one.prior_sigma:.2g} {one.unit})."
    )


def _warnings(one: SharedEstimate) -> list[str]:
    found = []
    ground = "" if np.isnan(one.ground) else f" 1 {one.unit} of it is {one.ground:.0f} m on the ground there."
    figures = f"likeness {one.likeness:.2f}, correlation {one.correlation:.2f}"
    if one.likeness > _ALIKE:
        found.append(
            f"The measures cannot tell it apart from a constant pitch of image {one.image} ({figures}): only what is "
            f"known of the two beforehand does.{ground}"
        )
    elif abs(one.correlation) > _CORRELATED:
        found.append(f"It can hardly be told apart from a constant pitch of image {one.image} ({figures}).{ground}")
    elif one.together > _ALIKE:
        found.append(
            f"The measures cannot tell it apart from constant pitches of {some(one.mixture, len(one.mixture))} "
            f"together: only what is known of them beforehand does (most like: {one.image}, {figures}).{ground}"
        )
    if one.sigma > _CORRELATED * one.prior_sigma:
        found.append("The measures say hardly anything about it.")
    return found


def _share(value: float) -> str:
    """A dash where no image has a pitch of its own to compare with."""
    return "-" if np.isnan(value) else f"{value:.2f}"


def shared_table(solution: Solution) -> str:
    """Aligned text for the terminal; empty without shared unknowns."""
    found = shared_estimates(solution)
    if not found:
        return ""
    heads = f"{'value':>10} {'sigma':>9} {'before':>9} {'unit':<5} {'with pitch: corr.':>17} {'alike':>6}"
    lines = [f"{'Shared unknowns':<40} {heads}"]
    for one in found:
        name = f"{one.name[:34]} {one.axis}".strip()
        lines.append(
            f"  {name:<38} {one.value:>+10.4g} {one.sigma:>9.3g} {one.prior_sigma:>9.3g} {one.unit:<5} "
            f"{_share(one.correlation):>17} {_share(one.likeness):>6}"
        )
    return "\n".join(lines)

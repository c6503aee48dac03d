"""Unknowns that images share, and whether they can be told apart from along-track pointing.

*Likeness* is the cosine of the angle between what two unknowns do to the measures, points free and priors left out: at
1 the measures cannot tell them apart, whatever the sigmas are. *Correlation* is the posterior's, priors included.
"""

import numpy as np

from mgsgraph.adjustment.solution import Solution
from mgsgraph.analysis.separability import SharedEstimate, separations, shared_estimates
from mgsgraph.files.output.table import Column, Table, numbers
from mgsgraph.results.section import Section
from mgsgraph.text import some

_CORRELATED = 0.9
"""Correlation with a constant pitch, and share of the a-priori sigma that is left, above which something is said."""
_ALIKE = 0.99
"""Likeness from which the measures count as unable to tell two unknowns apart."""


def shared_table(solution: Solution) -> Table:
    """One row for each column of a shared unknown; values, sigmas and metres on the ground in or per `unit`."""
    found, apart = shared_estimates(solution), separations(solution)
    units = [one.unit for one in found]
    return Table("shared", "Unknowns that images share", (
        Column("text", [f"{one.name[:34]} {one.axis}".strip() for one in found], label="", text="<38", files=False),
        Column("name", [one.name for one in found], meaning="of the unknown", page="s"),
        Column("kind", [one.kind.value for one in found], meaning="as the case file names it", page="s"),
        Column("axis", [one.axis for one in found], meaning="of the camera, of a boresight or lever arm", page="s"),
        Column("unit", units, meaning="s, mrad, m or ppm", page="s", text="<5"),
        Column("image", [one.image for one in found], meaning="whose constant pitch it is most like",
               head="most like pitch of", page="s"),
        Column("value", numbers(found, "value"), units, "adjusted", page=".4g", text=">+10.4g"),
        Column("sigma", numbers(found, "sigma"), units, "for sigma0 = 1", head="σ", page=".4g", label="sigma",
               text=">9.3g"),
        Column("prior_sigma", numbers(found, "prior_sigma"), units, "the same beforehand", head="a-priori σ",
               page=".4g", label="before", text=">9.3g"),
        Column("correlation_with_pitch", numbers(found, "correlation"), meaning="of the posterior, with that pitch",
               head="correlation", page=".3f", label="with pitch: corr.", text=">17.2f"),
        Column("likeness_to_pitch", numbers(found, "likeness"), meaning="cosine of what both do to the measures",
               head="likeness", page=".3f", label="alike", text=">6.2f"),
        Column("likeness_to_pitches", numbers(found, "together"),
               meaning="with the best mixture of all images' pitches"),
        Column("ground_m_per_{unit}", numbers(found, "ground"), units, "m on the ground, in the middle of that image"),
        Column("gain", numbers(apart, "gain"), meaning="sigma over a-priori sigma"),
        Column("most_correlated_with", [one.other for one in apart], meaning="of all other unknowns"),
        Column("largest_correlation", numbers(apart, "correlation"), meaning="with that one, of the posterior"),
        Column("multiple_correlation", numbers(apart, "together"), meaning="with all other unknowns together"),
        Column("verdict", [one.verdict.value for one in apart], meaning="whether it can be told apart"),
    ))  # fmt: skip


def shared_section(solution: Solution) -> Section:
    """Verdict on each column."""
    table, both = shared_table(solution), zip(shared_estimates(solution), separations(solution), strict=True)
    said = [
        f"{one.name[0].upper()}{one.name[1:]}{f', axis {one.axis}' if one.axis else ''}: "
        + " ".join([apart.sentence, *_warnings(one)])
        for one, apart in both
    ]  # fmt: skip
    return Section("shared", sentences=said, tables=[table], csv=[table] if solution.network.shared else [],
                   numbers=table.drop("unit").records())  # fmt: skip


def _warnings(one: SharedEstimate) -> list[str]:
    """What the measurements do not tell."""
    found, several = [], one.likeness <= _ALIKE and abs(one.correlation) <= _CORRELATED
    if one.likeness > _ALIKE or abs(one.correlation) > _CORRELATED or one.together > _ALIKE:
        pitch = f"constant pitches of {some(one.mixture, len(one.mixture))} together (most like: {one.image}, "
        pitch = pitch if several else f"a constant pitch of image {one.image} ("
        alone = several or one.likeness > _ALIKE
        hardly = "The priors alone separate it from" if alone else "It is highly correlated with"
        ground = "" if np.isnan(one.ground) else f" 1 {one.unit} of it is {one.ground:.0f} m on the ground there."
        found.append(
            f"{hardly} {pitch}likeness {one.likeness:.2f}, correlation {one.correlation:.2f}).{ground}"
        )
    if one.sigma > _CORRELATED * one.prior_sigma:
        found.append("The measurements say hardly anything about it.")
    return found

"""What forbids to take a solution that converged for a result."""

from collections.abc import Sequence

from mgsgraph.adjustment.fit import ABSURD, IMPOSSIBLE
from mgsgraph.adjustment.solution import Solution
from mgsgraph.analysis.soundness import MOST, Loss, soundness
from mgsgraph.results.section import Section
from mgsgraph.text import some

_NAMED = 4
"""Losses that are named."""


def state_of(solution: Solution) -> str:
    """converged, NOT CONVERGED, or converged without being a result."""
    if not solution.converged:
        return "NOT CONVERGED"
    return "converged" if soundness(solution).sound else "converged, but NO RESULT"


def soundness_section(solution: Solution) -> Section:
    """Why a solution is no result, and of what many observations are left out."""
    found, said = soundness(solution), list[str]()
    if solution.converged and found.fatal:
        said.append(
            f"NO RESULT although it converged: {_named(found.fatal)} did not take part. Beyond half of a kind the rest "
            "of it proves nothing. Adjust without rejection (reject = 0), look at the residuals and at `mgsgraph "
            "check`: images or columns interchanged, orientations or heights far off, a-priori sigmas too small."
        )
    if solution.converged and found.absurd:
        said.append(
            f"NO RESULT: residuals are {found.sigma0:.3g} times larger than stated. An input is wrong (images, lines "
            "and samples, or columns interchanged; a unit; a camera), or there are gross blunders. Look at the largest "
            "residuals and at `mgsgraph check`, or reject blunders (--reject 4)."
        )
    if solution.converged and found.impossible:
        far = [solution.network.images[one.image].name for one in found.impossible]
        said.append(
            f"NO RESULT although it converged: orientations moved by up to {found.impossible[0].most:.0f} a-priori "
            f"sigmas ({some(far, len(far))}), and more than {IMPOSSIBLE:.0f} means that an input is wrong "
            "(measurements of another image, lines and samples interchanged, kernels, a camera, a unit). Look at these "
            "images with `mgsgraph check`, or leave them out."
        )
    if many := [one for one in found.losses if not one.fatal]:
        said.append(f"Left out are {_named(many)}: so many are no single blunders; look for what they have in common.")
    return Section("soundness", sentences=said, numbers={
        "sound": solution.converged and found.sound,
        "sigma0_absurd": found.absurd,
        "orientations_impossible": [
            {"image": solution.network.images[one.image].name, "sigmas": one.most} for one in found.impossible
        ],
        "limits": {"share": MOST, "sigma0": ABSURD, "orientation_sigmas": IMPOSSIBLE},
        "left_out": [
            {"kind": str(one.kind), "image": one.image or None, "count": one.lost, "of": one.total, "fatal": one.fatal}
            for one in found.losses
        ],
    })  # fmt: skip


def _named(losses: Sequence[Loss]) -> str:
    parts = [
        f"{one.lost} of {one.total} {one.kind}{f' of {one.image}' if one.image else ''} ({one.share:.0%})"
        for one in losses
    ]
    return some(parts, len(parts), _NAMED)

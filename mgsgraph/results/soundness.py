"""What forbids to take a solution that came to rest for a result, in sentences."""

from typing import Any

from mgsgraph.adjustment.fit import ABSURD
from mgsgraph.adjustment.implausible import IMPOSSIBLE
from mgsgraph.adjustment.solution import Solution
from mgsgraph.analysis.soundness import MOST, Loss, soundness
from mgsgraph.text import listed, some

_NAMED = 4
"""Losses that are named."""


def state_of(solution: Solution) -> str:
    """converged, NOT CONVERGED; or that it came to rest on what proves nothing."""
    if not solution.converged:
        return "NOT CONVERGED"
    return "converged" if soundness(solution).sound else "converged, but NO RESULT"


def soundness_statements(solution: Solution) -> list[str]:
    """Why a solution is no result, and of what many observations are left out."""
    found, said = soundness(solution), list[str]()
    if solution.converged and found.fatal:
        said.append(
            f"NO RESULT although it came to rest: {_named(found.fatal)} did not take part. Beyond half of a kind the "
            "rest of it proves nothing: what was left out may be right and what was left wrong. Adjust without "
            "rejection (reject = 0), look at the residuals and at `mgsgraph check`: images or columns interchanged, "
            "orientations or heights far off, a-priori sigmas too small."
        )
    if solution.converged and found.absurd:
        said.append(
            f"NO RESULT: residuals {found.sigma0:.3g} times larger than stated come from no stated sigma, but from a "
            "wrong input (images, lines and samples, or columns interchanged; a unit; a camera) or from gross "
            "blunders. Look at the largest ones in the table of residuals and at `mgsgraph check`, or reject blunders "
            "(--reject 4)."
        )
    if solution.converged and found.impossible:
        far = [solution.network.images[one.image].name for one in found.impossible]
        said.append(
            f"NO RESULT although it came to rest: orientations were moved by up to {found.impossible[0].most:.0f} "
            f"a-priori sigmas ({some(far, len(far))}). Beyond {IMPOSSIBLE:.0f} no stated sigma is to blame, but an "
            "input (measures of another image, lines and samples interchanged, kernels, a camera, a unit). Look at "
            "these images with `mgsgraph check`, or leave them out."
        )
    many = [one for one in found.losses if not one.fatal]
    if many:
        said.append(
            f"Left out are {_named(many)}: so many are no single blunders; look for what they have in common."
        )
    return said


def _named(losses: "tuple[Loss, ...] | list[Loss]") -> str:
    parts = [
        f"{one.lost} of {one.total} {one.kind}{f' of {one.image}' if one.image else ''} ({one.share:.0%})"
        for one in losses[:_NAMED]
    ]
    more = [f"{len(losses) - _NAMED} more kinds"] if len(losses) > _NAMED else []
    return listed([*parts, *more])


def soundness_json(solution: Solution) -> dict[str, Any]:
    """The same for strict JSON."""
    found = soundness(solution)
    return {
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
    }

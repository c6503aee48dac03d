"""What groups of rows have in common: whose factor may have taken what is another's."""

import math

import numpy as np

from mgsgraph.analysis.helmert import Redundancy
from mgsgraph.geometry.records import Index

TIGHT = 0.5
"""Correlation of two groups' squared factors from which on a verdict names the other group."""
_HALF = 0.75
"""By how much a variance factor changes when sigmas change by half."""


def nearest(found: Redundancy, group: int) -> tuple[str, float]:
    """The group whose residuals have most in common with those of a group that can't be judged, and minus the cosine
    between the two in Helmert's matrix: -1 where all redundancy of the one is the other's.
    """
    scale = 1.0 / np.sqrt(np.maximum(np.diag(found.helmert), 1e-300))
    alike = (found.helmert * scale[:, None] * scale)[group]
    alike[group] = -1.0
    k = int(np.argmax(alike))
    return found.names[k], -float(alike[k])


def entanglement(found: Redundancy, judged: Index, group: int) -> tuple[str, float]:
    """The judged group whose squared factor is most correlated with that of a group, were they estimated together."""
    others = judged[judged != group]
    if not others.size or found.helmert[group, group] <= 0.0:
        return "", math.nan
    own = np.concatenate([[group], others])
    scale = 1.0 / np.sqrt(np.diag(found.helmert)[own])
    inverse = np.linalg.pinv(found.helmert[np.ix_(own, own)] * scale[:, None] * scale, hermitian=True)
    shared = inverse[0, 1:] / np.sqrt(np.maximum(inverse[0, 0] * np.diag(inverse)[1:], np.finfo(np.float64).tiny))
    k = int(np.argmax(np.abs(shared)))
    return found.names[int(others[k])], float(shared[k])


def given(found: Redundancy, judged: Index, group: int, degrees: float) -> str:
    """The group that isn't judged on whose sigmas the factor of a judged one depends most, where that is much."""
    others = np.setdiff1d(np.arange(len(found.names)), judged)
    if group not in judged or not others.size:
        return ""
    for other in others:
        beside, shared = entanglement(found, judged, int(other))
        if beside == found.names[group] and abs(shared) > TIGHT:
            return found.names[int(other)]
    effects = np.linalg.solve(found.helmert[np.ix_(judged, judged)], found.helmert[np.ix_(judged, others)])
    mine = np.abs(effects[judged == group][0])
    worst = int(np.argmax(mine))
    return found.names[int(others[worst])] if _HALF * mine[worst] > 0.5 * math.sqrt(2.0 / degrees) else ""

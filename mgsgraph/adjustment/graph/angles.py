"""The kernel's codes for the three ways in which attitude is counted, and back."""

from mgsgraph.geometry.orientation import Angles
from mgsgraph.kernel.rows import CAMERA, OPK_PAPER, OPK_PEER, Model

ANGLE_CODES: dict[Angles, int] = {"camera": CAMERA, "opk-paper": OPK_PAPER, "opk-peer": OPK_PEER}
"""Code of each."""
_NAMES = {code: name for name, code in ANGLE_CODES.items()}


def angles_of(model: Model) -> Angles:
    """Name of the one that a model has."""
    return _NAMES[model.angles]

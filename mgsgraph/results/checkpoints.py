"""Checkpoints, and control points left out in turn: how far known ground coordinates are from an adjustment without
them.
"""

from collections.abc import Sequence

import numpy as np

from mgsgraph.adjustment.solution import Solution
from mgsgraph.analysis.checkpoints import Discrepancies, checkpoint_discrepancies, control_points, leave_out
from mgsgraph.analysis.posterior import Posterior
from mgsgraph.files.networks.tie_points import PointKind
from mgsgraph.names import Names
from mgsgraph.network import Network
from mgsgraph.results.section import Section, table_of
from mgsgraph.text import length, listed, many, some_of, two

_AXES = ("east", "north", "up")


def checkpoint_sections(solution: Solution) -> list[Section]:
    """The checkpoints of a solution; no section without any."""
    found = checkpoint_discrepancies(solution)
    return [] if found is None else [_section("checkpoints", found, solution.network)]


def leave_out_section(posterior: Posterior) -> Section:
    """Control points, each left out in turn."""
    fixed = control_points(posterior.network, PointKind.FIXED)
    ids = some_of(posterior.network.points.ids, fixed)
    remark = [f"Fixed points can't be left out, as their coordinates have no sigma: {ids}."] if fixed.size else []
    return _section("leave_out", leave_out(posterior), posterior.network, remark)


def _section(name: str, found: Discrepancies, network: Network, remarks: Sequence[str] = ()) -> Section:
    """The finding, whose name is that of its table, too."""
    ids, low_high = network.points.ids, found.band
    table = table_of(name, {
        "point": ids[found.points], "east_north_up": found.values, "sigma_east_north_up": found.sigmas,
        "normalized": found.normalized,
    })  # fmt: skip
    sentences = [_sentence(name, found, ids)]
    if found.undetermined.size:
        sentences.append(f"{many(found.undetermined.size, 'point')} have no discrepancy, as nothing else determines "
                         f"their position: {some_of(ids, found.undetermined)}.")  # fmt: skip
    return Section(name, sentences=[*sentences, *remarks], tables=[table], csv=[table], numbers={
        "rms_east_north_up_m": found.rms if found.points.size else None, "chi_square": found.chi_square,
        "degrees_of_freedom": found.degrees, "range_95_percent": low_high, "p_value": found.p_value,
        "points_in_chi_square": found.joint, "undetermined": ids[found.undetermined].tolist(),
        "points": table.records(),
    })  # fmt: skip


def _sentence(name: str, found: Discrepancies, ids: Names) -> str:
    """Rms, and whether chi-square is in its band."""
    what = "Checkpoints" if name == "checkpoints" else "Control points, each left out"
    if not found.points.size:
        return f"{what}: none has a discrepancy."
    (low, high), (point, axis) = found.band, np.divmod(int(np.argmax(np.abs(found.normalized))), 3)
    size = "smaller than" if found.chi_square < low else "larger than" if found.chi_square > high else "consistent with"
    rms = listed([f"{length(value)} {way}" for value, way in zip(found.rms.tolist(), _AXES, strict=True)])
    largest = f"{two(float(found.normalized[point, axis]))} sigmas ({ids[int(found.points[point])]}, {_AXES[axis]})"
    of_some = f" of {found.joint} of them" if found.joint < found.points.size else ""
    return (
        f"{what} ({found.points.size}): adjusted minus known has rms {rms}, largest {largest}; chi-square{of_some} "
        f"{found.chi_square:.3g} (95 % range {low:.3g} to {high:.3g}): {size} the stated sigmas."
    )

"""Heights of a terrain model against laser shots that took no part in the adjustment.

Both are compared in one datum: where the adjustment has moved the other shots of a profile by a common shift, a shot
that was kept out is moved by it too, and the shift's covariance counts. What is stated of a difference is

    sigma^2 = sigma of the model^2 + sigma of the shot^2 + g' (sigma of the shot^2 I + covariance of the shift) g

with the slope g of the model: a horizontal error is a height error on a slope. (The model's own sigma is that of its
height at a fixed position, and holds its horizontal part already. That the shift and the orientation were found
together, and are correlated, is left out: on slopes of a few degrees it is nothing beside the rest.)
"""

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from mgsgraph.analysis.posterior import Posterior
from mgsgraph.case.laser import MolaInput
from mgsgraph.case.reading import read_mola, read_shots
from mgsgraph.case.schema import CaseInput
from mgsgraph.dem.gridding import HeightGrid
from mgsgraph.dem.map import bilinear
from mgsgraph.errors import InputError
from mgsgraph.geometry.altimetry import AltimeterShots
from mgsgraph.geometry.body import east_north
from mgsgraph.geometry.records import Array, Index, Mask
from mgsgraph.wording import root_mean_square

OUTSIDE = 3.0
"""Sigmas beyond which a difference is counted by itself."""


@dataclass(frozen=True, slots=True, eq=False)
class CheckProfile:
    """Shots of one file that took no part, and what is known of them."""

    name: str
    """Name of the file."""
    shots: AltimeterShots
    """Ground returns that the adjustment has not used."""
    sigma: float
    """m, of each footprint east and north."""
    height_sigma: float
    """m, of its height."""
    shift: Array
    """(2,) m, east and north, to be added to all of them."""
    shift_covariance: Array
    """(2, 2) m^2, of that."""
    adjusted: bool
    """Whether the shift was an unknown of the adjustment; otherwise it is zero with its a-priori sigma."""


@dataclass(frozen=True, slots=True, eq=False)
class HeightChecks:
    """Differences between a terrain model and n shots that lie on it."""

    profiles: tuple[str, ...]
    """Names of the profiles."""
    profile: Index
    """(n,) which of them."""
    ids: tuple[str, ...]
    """(n) names of the shots."""
    positions: Array
    """(n, 3) m, body-fixed, of the footprints, shifted."""
    plane: Array
    """(n, 2) m, the same on the map."""
    heights: Array
    """(n,) m above the map's sphere, of the model."""
    differences: Array
    """(n,) m, model minus shot."""
    sigmas: Array
    """(n,) m, stated."""
    independent: Array
    """(n,) m, the part of it that is not the orientation's, and so not common to neighbouring shots."""

    def __len__(self) -> int:
        return len(self.ids)


def check_profiles(
    posterior: Posterior, case: CaseInput, path: Path, more: Sequence[Path] = ()
) -> tuple[CheckProfile, ...]:
    """Shots of a case's [[mola]] profiles, and of more PEDR files or tables, that took no part in the adjustment; shots
    are known by their names.

    `path` is the case's file; the sigmas of further files are the largest that the case states for a profile.
    InputError where a file can't be read.
    """
    used = set(posterior.network.points.ids)
    entries = [(entry, read_mola(entry, path.parent)) for entry in case.mola]
    shifts = [entry.shift_sigma_m for entry in case.mola if entry.shift_sigma_m is not None]
    common = MolaInput(
        pedr="", ground_sigma_m=max((entry.ground_sigma_m for entry in case.mola), default=10.0),
        height_sigma_m=max((_height_sigma(entry) for entry in case.mola), default=10.0),
        shift_sigma_m=max(shifts, default=None),
    )  # fmt: skip
    entries += [(common, read_shots(file)) for file in more]
    for file, (_, shots) in zip(more, entries[len(case.mola) :], strict=True):
        if not np.any(shots.ground):
            raise InputError(str(file), f"{shots.times.size} shots, none from the ground", "ground returns")
    found = (_unused(posterior, entry, shots, used) for entry, shots in entries)
    return tuple(one for one in found if one.shots.times.size)


def _unused(posterior: Posterior, entry: MolaInput, shots: AltimeterShots, used: Collection[str]) -> CheckProfile:
    name = Path(shots.source).stem
    taken = np.array([f"{name}:{one}" in used for one in shots.ids], dtype=bool)
    names = posterior.network.shift_names
    shift, covariance = np.zeros(2), np.eye(2) * (entry.shift_sigma_m or 0.0) ** 2
    if adjusted := name in names:
        variable = len(posterior.network.images) + names.index(name)
        shift = posterior.linearised.values[variable]
        covariance = posterior.linearised.joint.of([variable])
    left = shots.chosen(shots.ground & ~taken)
    return CheckProfile(name, left, entry.ground_sigma_m, _height_sigma(entry), shift, covariance, adjusted)


def _height_sigma(entry: MolaInput) -> float:
    return entry.height_sigma_m or entry.ground_sigma_m


def checked(model: HeightGrid, profiles: Sequence[CheckProfile]) -> HeightChecks:
    """Compare a terrain model with the shots that lie on it, between four posts with heights."""
    parts = [_differences(model, one, k) for k, one in enumerate(profiles)]
    ids = tuple(name for part, _ in parts for name in part)
    columns = [np.concatenate(column) for column in zip(*(arrays for _, arrays in parts), strict=True)] or [
        np.zeros(0, dtype=np.int64), np.zeros((0, 3)), np.zeros((0, 2)), *(np.zeros(0) for _ in range(4))
    ]  # fmt: skip
    profile, *others = columns
    return HeightChecks(tuple(one.name for one in profiles), profile, ids, *others)


def _differences(model: HeightGrid, one: CheckProfile, number: int) -> tuple[list[str], tuple[Array, ...]]:
    """Names of the shots on the model, and the columns of `HeightChecks` from `profile` on."""
    given = one.shots.footprints
    positions = given + np.einsum("k,nkj->nj", one.shift, east_north(given))
    plane = model.map.chart.plane(positions)
    pixels = model.map.pixels(plane)
    heights = bilinear(model.heights, pixels)
    on = np.isfinite(heights) & (np.einsum("ni,i->n", positions, model.map.chart.axes[2]) > 0.0)  # not the far side
    pixels, heights, positions, plane = pixels[on], heights[on], positions[on], plane[on]
    slopes = np.nan_to_num(bilinear(model.slopes, pixels))
    planimetric = np.einsum("ni,ij,nj->n", slopes, one.sigma**2 * np.eye(2) + one.shift_covariance, slopes)
    matching, orientation = (bilinear(band, pixels) for band in (model.matching, model.orientation))
    independent = matching**2 + one.height_sigma**2 + planimetric
    differences = heights - (np.linalg.norm(positions, axis=1) - model.map.radius)
    ids = np.array(one.shots.ids, dtype=object)[on].tolist()
    return ids, (
        np.full(len(ids), number), positions, plane, heights, differences, np.sqrt(independent + orientation**2),
        np.sqrt(independent),
    )  # fmt: skip


def check_figures(checks: HeightChecks, mine: Mask) -> dict[str, float]:
    """Number of some shots, and mean, rms (m), rms over stated sigma and share beyond three of their differences."""
    off, ratio = checks.differences[mine], checks.differences[mine] / checks.sigmas[mine]
    return {
        "shots": int(mine.sum()),
        "mean_m": float(off.mean()),
        "rms_m": root_mean_square(off),
        "scatter_m": float(off.std()),
        "rms_by_sigma": root_mean_square(ratio),
        "scatter_by_independent_sigma": root_mean_square((off - off.mean()) / checks.independent[mine]),
        "beyond_3_sigma": float(np.mean(np.abs(ratio) > OUTSIDE)),
    }

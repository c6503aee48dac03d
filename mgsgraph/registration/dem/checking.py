"""Heights of a terrain model against laser shots that took no part in the adjustment.

Both are compared in one datum: where the adjustment has moved the other shots of a profile in common (its shift, its
drift, its beam), a shot that was kept out is moved so too, and the covariance of that counts. What is stated of a
difference is

    sigma^2 = sigma of the model^2 + sigma of the shot^2 + g' (sigma of the shot^2 I) g + s' (covariance in common) s

with the slope g of the model: a horizontal error is a height error on a slope; s is what a common unknown does to the
difference, by that slope and upward. (The model's own sigma is that of its
height at a fixed position, and holds its horizontal part already. That the shift and the orientation were found
together, and are correlated, is left out: on slopes of a few degrees it is nothing beside the rest.)
"""

from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from mgsgraph.analysis.posterior import Posterior
from mgsgraph.case.reading import read_profile
from mgsgraph.case.schema import CaseInput, ShotsInput
from mgsgraph.errors import require
from mgsgraph.files.altimetry.shots import read_shots
from mgsgraph.geometry.altimetry import AltimeterShots
from mgsgraph.geometry.body import east_north, east_north_up
from mgsgraph.geometry.records import Array, Index, Mask, no_rows
from mgsgraph.network import Network, SharedKind, SharedUnknown
from mgsgraph.network.shared import beam_motion
from mgsgraph.record import Record
from mgsgraph.registration.dem.gridding import HeightGrid, bilinear
from mgsgraph.text import root_mean_square

OUTSIDE = 3.0
"""Sigmas beyond which a difference is counted by itself."""


@dataclass(frozen=True, slots=True, eq=False)
class CheckProfile(Record):
    """Shots of one file that took no part, and their sigmas."""

    name: str
    """Name of the file."""
    shots: AltimeterShots
    """Ground returns that the adjustment has not used."""
    sigma: float
    """m, of each footprint east and north."""
    height_sigma: float
    """m, of its height."""
    ways: Array
    """(n, w, 3) m per unit, how what the profile has in common moves each: first its shift east and north."""
    values: Array
    """(w,) of that, m and rad."""
    covariance: Array
    """(w, w) of these."""
    adjusted: bool
    """Whether the shift was an unknown of the adjustment; otherwise it is zero with its a-priori sigma."""

    @property
    def shift(self) -> Array:
        """(2,) m, east and north."""
        return self.values[:2]

    @property
    def shift_covariance(self) -> Array:
        """(2, 2) m^2, of that."""
        return self.covariance[:2, :2]


@dataclass(frozen=True, slots=True, eq=False)
class HeightChecks(Record):
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
    """Shots of a case's [[shots]] profiles, and of more files of shots, that took no part in the adjustment; shots are
    known by their names.

    `path` is the case's file; the sigmas of further files are the largest that the case states for a profile.
    InputError where a file can't be read.
    """
    used = set(posterior.network.points.ids)
    profiles = [read_profile(entry, path.parent) for entry in case.shots]
    stated = [entry.with_sigmas_of(p.altimeter, p.source) for entry, p in zip(case.shots, profiles, strict=True)]
    entries = list(zip(stated, profiles, strict=True))
    shifts = [entry.shift_sigma_m for entry in stated if entry.shift_sigma_m is not None]
    common = ShotsInput(
        file="", ground_sigma_m=max((entry.ground_sigma_m or 0.0 for entry in stated), default=10.0),
        height_sigma_m=max((_height_sigma(entry) for entry in stated), default=10.0),
        shift_sigma_m=max(shifts, default=None),
    )  # fmt: skip
    entries += [(common, read_shots(file)) for file in more]
    for file, (_, shots) in zip(more, entries[len(stated) :], strict=True):
        require(np.any(shots.ground), str(file), f"{shots.times.size} shots, none from the ground", "ground returns")
    checked = (
        _unused(posterior, entry, part, used, name)
        for entry, shots in entries for name, part in _by_shifts(shots, posterior.network.shift_names)
    )  # fmt: skip
    return tuple(check for check in checked if check.shots.times.size)


def _by_shifts(shots: AltimeterShots, shifts: Collection[str]) -> Iterator[tuple[str, AltimeterShots]]:
    """Shots of a file with the name of their shift: that of the file, or of each of its profiles."""
    stem, names = Path(shots.source).stem, shots.profile_names()
    parts = [profile for profile in names.used if f"{stem}:{profile}" in shifts]
    number = names.over(parts)
    for k, profile in enumerate(parts):
        yield f"{stem}:{profile}", shots.chosen(number == k)
    rest = number < 0
    if np.any(rest):
        yield stem, shots.chosen(rest)


def _unused(
    posterior: Posterior, entry: ShotsInput, shots: AltimeterShots, used: Collection[str], name: str
) -> CheckProfile:
    stem = Path(shots.source).stem
    in_solution = np.array([f"{stem}:{shot}" in used for shot in shots.ids], dtype=bool)
    left = shots.chosen(shots.ground & ~in_solution)
    values, covariance = np.zeros(2), np.eye(2) * (entry.shift_sigma_m or 0.0) ** 2
    ways = east_north(left.footprints)
    network, linearised = posterior.network, posterior.linearised
    if adjusted := name in network.shift_names:
        variables = [len(network.images) + network.shift_names.index(name)]
        for k, shared in enumerate(network.shared):
            if shared.kind.moves_footprints and _moves(network, shared, name):
                variables.append(network.first_shared + k)
                ways = np.concatenate([ways, _motion(network, shared, shots.chosen(in_solution), left)], axis=1)
        values = np.concatenate([linearised.values[variable] for variable in variables])
        covariance = linearised.joint.of(variables)
    assert entry.ground_sigma_m is not None
    return CheckProfile(name, left, entry.ground_sigma_m, _height_sigma(entry), ways, values, covariance, adjusted)


def _moves(network: Network, shared: SharedUnknown, name: str) -> bool:
    """Whether a shared unknown moves the shots of a profile."""
    assert network.shifts is not None
    return bool(np.any(network.shifts.profile[network.footprints_moved(shared)] == network.shifts.names.index(name)))


def _motion(network: Network, shared: SharedUnknown, used: AltimeterShots, left: AltimeterShots) -> Array:
    """(n, width, 3) m per unit, how a shared unknown of the used shots moves the others; nothing where no
    image was taken along with them.
    """
    motion = np.zeros((left.times.size, shared.kind.width, 3))
    if shared.kind is SharedKind.PROFILE_DRIFT:
        ends = used.times.min(), used.times.max()
        along = (2.0 * left.times - sum(ends)) / max(ends[1] - ends[0], 1e-9) * float(ends[1] > ends[0])
        return np.asarray(along[:, None, None] * east_north(left.footprints))
    for j in shared.images.tolist():
        trajectory = network.images[j].trajectory
        since, (start, stop) = left.times - trajectory.epoch, trajectory.coverage
        along_with = (since >= start) & (since <= stop)
        motion[along_with] = beam_motion(network.images[j], since[along_with], left.footprints[along_with])
    return motion


def _height_sigma(entry: ShotsInput) -> float:
    return entry.height_sigma_m or entry.ground_sigma_m or 0.0


def checked(model: HeightGrid, profiles: Sequence[CheckProfile]) -> HeightChecks:
    """Compare a terrain model with the shots that lie on it, between four posts with heights."""
    parts = [_differences(model, entry, k) for k, entry in enumerate(profiles)]
    ids = tuple(name for part, _ in parts for name in part)
    columns = [np.concatenate(column) for column in zip(*(arrays for _, arrays in parts), strict=True)] or [
        no_rows(), np.zeros((0, 3)), np.zeros((0, 2)), *(np.zeros(0) for _ in range(4))
    ]  # fmt: skip
    profile, *rest = columns
    return HeightChecks(tuple(entry.name for entry in profiles), profile, ids, *rest)


def _differences(model: HeightGrid, check: CheckProfile, number: int) -> tuple[list[str], tuple[Array, ...]]:
    """Names of the shots on the model, and the columns of `HeightChecks` from `profile` on."""
    given = check.shots.footprints
    positions = given + np.einsum("w,nwj->nj", check.values, check.ways)
    plane = model.map.chart.plane(positions)
    pixels = model.map.pixels(plane)
    heights = bilinear(model.heights, pixels)
    on = np.isfinite(heights) & (np.einsum("ni,i->n", positions, model.map.chart.axes[2]) > 0.0)  # not the far side
    pixels, heights, positions, plane = pixels[on], heights[on], positions[on], plane[on]
    slopes = np.nan_to_num(bilinear(model.slopes, pixels))
    ways = np.einsum("nij,nwj->nwi", east_north_up(given[on]), check.ways[on])
    common = np.einsum("nwi,ni->nw", ways, np.column_stack([slopes, -np.ones(len(slopes))]))
    horizontal = check.sigma**2 * np.sum(slopes**2, axis=1) + np.einsum("nv,vw,nw->n", common, check.covariance, common)
    matching, orientation = (bilinear(band, pixels) for band in (model.matching, model.orientation))
    independent = matching**2 + check.height_sigma**2 + horizontal
    differences = heights - (np.linalg.norm(positions, axis=1) - model.map.radius)
    ids = np.array(check.shots.ids, dtype=object)[on].tolist()
    return ids, (
        np.full(len(ids), number), positions, plane, heights, differences, np.sqrt(independent + orientation**2),
        np.sqrt(independent),
    )  # fmt: skip


def check_figures(checks: HeightChecks, chosen: Mask) -> dict[str, float]:
    """Number of some shots, and mean, rms (m), rms over stated sigma and share beyond three of their differences."""
    off, ratio = checks.differences[chosen], checks.differences[chosen] / checks.sigmas[chosen]
    return {
        "shots": int(chosen.sum()),
        "mean_m": float(off.mean()),
        "rms_m": root_mean_square(off),
        "scatter_m": float(off.std()),
        "rms_by_sigma": root_mean_square(ratio),
        "scatter_by_independent_sigma": root_mean_square((off - off.mean()) / checks.independent[chosen]),
        "beyond_3_sigma": float(np.mean(np.abs(ratio) > OUTSIDE)),
    }

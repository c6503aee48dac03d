"""Tables of the report page: what is in each column, in what unit, and what was cut."""

import dataclasses
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from mgsgraph.adjustment.analysis.merit import (
    PLACES,
    local_sigmas,
    orientation_statistics,
    point_statistics,
    range_statistics,
    ray_statistics,
    rejected_points,
    used_ray_counts,
)
from mgsgraph.adjustment.analysis.shared_unknowns import shared_estimates
from mgsgraph.adjustment.analysis.strip_corrections import strip_reports
from mgsgraph.adjustment.solution import Solution
from mgsgraph.geometry.body import east_north_up, geodetic, planetocentric
from mgsgraph.geometry.records import Index
from mgsgraph.network import PointClass
from mgsgraph.reports.strips import POSITION, ROTATION
from mgsgraph.ties import PointKind
from mgsgraph.units import ARCSEC, DEG, MGON

MOST_ROWS = 1000
"""Rows of one table; the CSV files have all."""
MOST_IMAGES = 300
"""Images of which the orientation is stated."""
_MOST_MEASURES = 300
"""Measures listed, those that fit worst."""
_ISIS = 0.5
"""pixels from our count of lines and samples to that of ISIS."""
NONE = "–"
"""What stands for a number that is not known."""


@dataclass(frozen=True, slots=True)
class Table:
    """One table of the page."""

    name: str
    """Its anchor."""
    title: str
    """What it lists."""
    columns: tuple[tuple[str, str], ...]
    """Heading and unit of each column; an empty unit for a pure number or a word."""
    rows: Sequence[Sequence[str]]
    """Text of each cell."""
    note: str = ""
    """What one has to know, and what was cut."""

    @property
    def numeric(self) -> tuple[bool, ...]:
        """Columns that hold nothing but numbers."""
        return tuple(all(_is_number(row[c]) for row in self.rows) for c in range(len(self.columns)))


def _is_number(text: str) -> bool:
    if text == NONE:
        return True
    try:
        float(text)
    except ValueError:
        return False
    return True


def fixed(value: float, decimals: int = 2) -> str:
    """A number with so many decimals; a dash for none."""
    if not math.isfinite(value):
        return NONE
    text = f"{value:.{decimals}f}" if abs(value) < 1e7 else f"{value:.4g}"
    return text.removeprefix("-") if not text.strip("-0.") else text


def cells(values: Iterable[float], decimals: int = 2) -> list[str]:
    """Several of them."""
    return [fixed(float(value), decimals) for value in values]


def cut(total: int, shown: int, which: str, file: str) -> str:
    """Words where a table doesn't hold all rows; empty where it does."""
    return "" if shown >= total else f"{shown} of {total} are listed, {which}; {file} in the results has all."


def tables(solution: Solution) -> list[Table]:
    """All tables of a solution that have rows."""
    found = [
        _images(solution), _points_by_class(solution), _ranges(solution), _shifts(solution), _shared(solution),
        _strips(solution), _measures(solution), _points(solution),
    ]  # fmt: skip
    return [table for table in found if table.rows]


def _images(solution: Solution) -> Table:
    network, rays = solution.network, ray_statistics(solution)
    shown = range(min(len(network.images), MOST_IMAGES))
    rows = []
    for j in shown:
        image, strip, found = network.images[j], int(network.strip_of[j]), orientation_statistics(solution, j)
        held = bool(network.held[j])
        blank = [NONE] * 3
        rows.append([
            image.name, network.strips[strip].name if strip >= 0 else NONE, str(image.lines), str(image.samples),
            str(rays.total[j]), str(rays.count[j].sum()), *cells(rays.rms_of_images[j]),
            *cells(found.mean[:3], 1), *(blank if held else cells(found.mean_sigma[:3], 1)),
            *cells(found.mean[6:] / ARCSEC, 1), *(blank if held else cells(found.mean_sigma[6:] / ARCSEC, 1)),
        ])  # fmt: skip
    note = (
        "Residuals: rms of the measures that were used, measured minus predicted. Corrections: adjusted minus nominal, "
        f"mean over {PLACES} lines; positions along the body-fixed axes, rotations about the camera's own axes. "
        "Sigmas are those of the adjusted orientation, mean over the same lines; a dash: held. "
    )
    return Table(
        "images", "Images",
        (("image", ""), ("strip", ""), ("lines", "px"), ("samples", "px"), ("measures", ""), ("used", ""),
         ("residual line", "px"), ("residual sample", "px"),
         *((f"Δ{axis}", "m") for axis in "XYZ"), *((f"σ {axis}", "m") for axis in "XYZ"),
         *((f"turn {axis}", "arcsec") for axis in "xyz"), *((f"σ turn {axis}", "arcsec") for axis in "xyz")),
        rows, note + cut(len(network.images), len(rows), "the first ones", "solution.json"),
    )  # fmt: skip


def _points_by_class(solution: Solution) -> Table:
    rows = []
    for point_class, _ in solution.network.of_class():
        found = point_statistics(solution, point_class)
        rows.append([
            point_class.name.lower(), str(found.count), str(found.rejected), *cells(found.mean_sigma),
            *cells(found.mean_sigma * solution.sigma0), *cells(found.rms_correction),
        ])  # fmt: skip
    return Table(
        "classes", "Ground points by kind",
        (("kind", ""), ("points", ""), ("rejected", ""), *((f"mean σ {axis}", "m") for axis in "XYZ"),
         *((f"σ {axis} × σ₀", "m") for axis in "XYZ"), *((f"rms Δ{axis}", "m") for axis in "XYZ")),
        rows, "Body-fixed axes. Sigmas for sigma0 = 1, and scaled by sigma0; corrections are adjusted minus before.",
    )  # fmt: skip


def _ranges(solution: Solution) -> Table:
    found = range_statistics(solution)
    states = (("before", found.mean_before, found.rms_before), ("after", found.mean, found.rms))
    rows = [[state, str(found.count), str(found.used), *cells((mean, rms))] for state, mean, rms in states]
    columns = (("orientation", ""), ("ranges", ""), ("used", ""), ("mean residual", "m"), ("rms residual", "m"))
    return Table("ranges", "Laser ranges", columns, rows if found.count else [], "Measured minus predicted.")


def _shifts(solution: Solution) -> Table:
    rows = [
        [name, *cells(solution.shifts[p], 1), *cells(np.sqrt(np.diag(solution.shift_covariance(p))), 1)]
        for p, name in enumerate(solution.network.shift_names)
    ]
    columns = (("what", ""), ("east", "m"), ("north", "m"), ("σ east", "m"), ("σ north", "m"))
    return Table("shifts", "Horizontal shifts of profiles and terrain model", columns, rows)


def _shared(solution: Solution) -> Table:
    rows = [
        [one.name, one.kind.value, one.axis or NONE, one.unit, *(f"{v:.4g}" for v in (one.value, one.sigma)),
         f"{one.prior_sigma:.4g}", one.image or NONE, fixed(one.correlation, 3), fixed(one.likeness, 3)]
        for one in shared_estimates(solution)
    ]  # fmt: skip
    columns = (("name", ""), ("kind", ""), ("axis", ""), ("unit", ""), ("value", ""), ("σ", ""), ("a-priori σ", ""),
               ("most like pitch of", ""), ("correlation", ""), ("likeness", ""))  # fmt: skip
    return Table("shared", "Unknowns that images share", columns, rows)


def _strips(solution: Solution) -> Table:
    scale = np.array([1.0] * 3 + [MGON] * 3)
    rows = [
        [one.name, one.basis, str(len(one.images)), str(one.nodes), fixed(one.spacing, 3),
         *cells(one.largest / scale), *cells(one.mean_sigmas / scale)]
        for one in strip_reports(solution)
    ]  # fmt: skip
    named = [(name, "m") for name in POSITION] + [(name, "mgon") for name in ROTATION]
    columns = (("strip", ""), ("basis", ""), ("images", ""), ("nodes", ""), ("spacing", "s"),
               *((f"largest Δ {name}", unit) for name, unit in named), *((f"σ {name}", unit) for name, unit in named))
    note = "Corrections at the orientation images: the largest, and the mean sigma."
    return Table("strips", "Strips", columns, rows, note)


def _measures(solution: Solution) -> Table:
    """Measures that fit worst, in units of their sigmas."""
    network, rays = solution.network, solution.network.rays
    size = np.max(np.abs(solution.residuals / rays.sigmas), axis=1) if rays.point.size else np.zeros(0)
    sound = np.flatnonzero(np.isfinite(size))
    chosen = sound[np.argsort(-size[sound], kind="stable")][:_MOST_MEASURES].tolist()
    rows = [
        [network.points.ids[rays.point[k]], _class_name(solution, int(rays.point[k])),
         network.images[rays.image[k]].name, *cells(rays.places[k] + _ISIS), *cells(solution.residuals_before[k]),
         *cells(solution.residuals[k]), *cells(rays.sigmas[k]), fixed(float(size[k])),
         "used" if solution.rays_used[k] else "rejected"]
        for k in chosen
    ]  # fmt: skip
    return Table(
        "measures", "Image measures that fit worst",
        (("point", ""), ("kind", ""), ("image", ""), ("line", "px"), ("sample", "px"), ("line before", "px"),
         ("sample before", "px"), ("line after", "px"), ("sample after", "px"), ("σ line", "px"), ("σ sample", "px"),
         ("largest over σ", ""), ("state", "")),
        rows,
        "Lines and samples as ISIS counts them, the first pixel's centre at (1, 1); residuals are measured minus "
        "predicted. " + cut(rays.point.size, len(rows), "those with the largest residual over its sigma",
                            "residuals.csv"),
    )  # fmt: skip


def _class_name(solution: Solution, i: int) -> str:
    return PointClass(solution.network.points.classes[i]).name.lower()


def _points(solution: Solution) -> Table:
    network, chosen = solution.network, _weakest(solution)
    places, moved = solution.places[chosen], solution.places[chosen] - solution.places_before[chosen]
    longitude, latitude, _ = planetocentric(places).T
    height = geodetic(places, network.images[0].body)[:, 2]
    corrections = np.einsum("nij,nj->ni", east_north_up(places), moved)
    sigmas, used, rejected = local_sigmas(solution)[chosen], used_ray_counts(solution), rejected_points(solution)
    rows = [
        [network.points.ids[i], _class_name(solution, i), PointKind(network.points.kinds[i]).name.lower(),
         fixed(float(longitude[n] / DEG) % 360.0, 5), fixed(float(latitude[n] / DEG), 5), fixed(float(height[n]), 2),
         *cells(sigmas[n]), *cells(corrections[n]), str(used[i]), "rejected" if rejected[i] else "used"]
        for n, i in enumerate(chosen.tolist())
    ]  # fmt: skip
    return Table(
        "points", "Ground points",
        (("point", ""), ("kind", ""), ("known", ""), ("east longitude", "deg"), ("latitude", "deg"), ("height", "m"),
         *((f"{sign} {way}", "m") for sign in "σΔ" for way in ("east", "north", "up")),
         ("rays used", ""), ("state", "")),
        rows,
        "Planetocentric latitudes, heights above the ellipsoid; sigmas for sigma0 = 1, corrections are adjusted minus "
        "before. " + cut(len(network.points), len(rows), "those that nothing determines and those of the largest "
                         "sigma", "points.csv"),
    )  # fmt: skip


def _weakest(solution: Solution) -> Index:
    """Points that are listed, in their own order: all, or those without a place and those of the largest sigma."""
    size = np.nan_to_num(np.linalg.norm(solution.sigmas, axis=1), nan=np.inf)
    return np.sort(np.argsort(-size, kind="stable")[:MOST_ROWS])


# --- how it was made


def settings_table(solution: Solution) -> Table:
    """Settings of the solver, by the names that a case file has for them."""
    found = dataclasses.asdict(solution.settings)
    rows = [[name, NONE if value is None else str(value)] for name, value in found.items()]
    return Table("settings", "Settings of the solver", (("setting", ""), ("value", "")), rows)


def versions_table(solution: Solution) -> Table:
    """Versions that computed, and the time that each stage took."""
    rows = [[name, version] for name, version in solution.versions.items()]
    rows += [[f"{stage} (s)", f"{seconds:.2f}"] for stage, seconds in solution.seconds.items()]
    return Table("versions", "Versions and wall time", (("what", ""), ("value", "")), rows)


def inputs_table(inputs: Mapping[str, str | None]) -> Table:
    """Files and their checksums."""
    rows = [[name, checksum or "could not be read"] for name, checksum in inputs.items()]
    return Table("inputs", "Files that this page was made from", (("file", ""), ("SHA-256", "")), rows)

"""A solution beside an earlier one: what moved, by how much, and whether that is more than was unknown."""

from dataclasses import dataclass

import numpy as np

from mgsgraph.adjustment.solution import Solution, orientation_profile
from mgsgraph.analysis.statistics import PLACES
from mgsgraph.errors import InputError
from mgsgraph.geometry import rotation
from mgsgraph.geometry.body import east_north_up
from mgsgraph.geometry.records import Array
from mgsgraph.output.table import Column, Table, cut
from mgsgraph.reports.page_tables import MOST_IMAGES
from mgsgraph.reports.soundness import state_of
from mgsgraph.wording import NAMED, many, root_mean_square, some

_MOST_POINTS = 200
"""Points listed, those that moved most."""
_TITLE = "Ground points, against the earlier solution"
_METHOD = (
    "A difference is this solution minus the earlier one. It is stated in units of the larger of both sigmas "
    "(sigma0 = 1): the solutions share observations and priors, so that the sigma of their difference isn't known "
    "from theirs."
)


@dataclass(frozen=True, slots=True)
class Comparison:
    """What the page says about an earlier solution."""

    name: str
    """What the earlier one is called."""
    sentences: list[str]
    """In words."""
    tables: list[Table]
    """Of the figures of merit, the images and the points."""


def compare(solution: Solution, earlier: Solution) -> Comparison:
    """Compare two solutions by the names of their images and points.

    Raises
    ------
    InputError
        If they have no image in common, or one of them with other pixels.
    """
    shared = _common_images(solution, earlier)
    sentences, images = _images(solution, earlier, shared)
    about_points, points = _points(solution, earlier)
    others = [sentence for sentence in (
        _only([image.name for image in solution.network.images], [image.name for image in earlier.network.images]),
        "" if earlier.converged else "The earlier solution had NOT CONVERGED.",
    ) if sentence]  # fmt: skip
    tables = [table for table in (_fit_figures(solution, earlier), images, points) if len(table)]
    return Comparison(earlier.name, [_METHOD, *sentences, *about_points, *others], tables)


def _common_images(solution: Solution, earlier: Solution) -> list[tuple[int, int]]:
    rows = {image.name: j for j, image in enumerate(earlier.network.images)}
    shared = [(j, rows[image.name]) for j, image in enumerate(solution.network.images) if image.name in rows]
    if not shared:
        names = [image.name for image in solution.network.images]
        raise InputError(
            f"solution {earlier.name!r}, to be compared with", "no image in common",
            f"some of {some(names, len(names))}", "compare solutions of the same images",
        )  # fmt: skip
    for j, i in shared:
        one, other = solution.network.images[j], earlier.network.images[i]
        if (one.lines, one.samples) != (other.lines, other.samples):
            raise InputError(
                f"solution {earlier.name!r}, image {other.name}", f"{other.lines} x {other.samples} pixels",
                f"{one.lines} x {one.samples}, as in {solution.name!r}",
            )  # fmt: skip
    return shared


def _only(here: list[str], there: list[str]) -> str:
    """Words about images that only one of both has."""
    new, gone = [name for name in here if name not in there], [name for name in there if name not in here]
    parts = [f"{word}: {some(names, len(names), NAMED)}" for word, names in (("new", new), ("gone", gone)) if names]
    return f"Images that only one of both has, {'; '.join(parts)}." if parts else ""


def _fit_figures(solution: Solution, earlier: Solution) -> Table:
    both = [
        ("cost with the nominal orientation", earlier.cost_initial, solution.cost_initial),
        ("cost at the solution", earlier.cost_final, solution.cost_final),
        ("sigma0", earlier.sigma0, solution.sigma0),
        ("degrees of freedom", earlier.fit.degrees_of_freedom, solution.fit.degrees_of_freedom),
        ("observations", earlier.fit.observations, solution.fit.observations),
        ("unknowns", earlier.fit.unknowns, solution.fit.unknowns),
        ("images", len(earlier.network.images), len(solution.network.images)),
        ("ground points", len(earlier.network.points), len(solution.network.points)),
    ]
    states = [state_of(one) for one in (earlier, solution)]
    numbers = np.array([(before, after, after - before) for _, before, after in both])
    texts = [[f"{value:.6g}" if np.isfinite(value) else "" for value in column] for column in numbers.T]
    note = "" if earlier.fit.observations == solution.fit.observations else (
        "The numbers of observations differ: costs can't be compared, sigma0 can."
    )
    losses = [(one.settings.loss, one.settings.loss_width) for one in (earlier, solution)]
    if losses[0] != losses[1]:  # another loss weighs the same residuals otherwise
        words = "; now ".join(_loss(*one) for one in losses)
        note = f"The losses differ ({words}): neither costs nor sigma0 can be compared."
    return Table("merit_compared", "Figures of merit", (
        Column("figure", ["state", *(name for name, _, _ in both)], page="s"),
        *(Column(name, [first, *text], page="s")
          for name, first, text in zip(("earlier", "this one", "difference"), (*states, ""), texts, strict=True)),
    ), note)  # fmt: skip


def _loss(name: str, width: float | None) -> str:
    return name if width is None else f"{name}, width {width:g}"


def orientation_difference(solution: Solution, j: int, earlier: Solution, i: int) -> tuple[Array, Array]:
    """Differences (n, 6) of an image's adjusted orientation over its lines, m (body-fixed) and rad (about the camera's
    axes), and the larger of both sigmas (n, 6).
    """
    lines = np.linspace(0.0, float(solution.network.images[j].lines), PLACES)
    poses = [one.network.images[k].pose(lines, one.correction(k)) for one, k in ((solution, j), (earlier, i))]
    turn = -rotation.logarithm(poses[0].matrix @ np.swapaxes(poses[1].matrix, 1, 2))
    profiles = [orientation_profile(one, k, PLACES) for one, k in ((solution, j), (earlier, i))]
    sigmas = [np.concatenate([one.position_sigma, one.rotation_sigma], axis=1) for one in profiles]
    moved = np.concatenate([poses[0].position - poses[1].position, turn], axis=1)
    return moved, np.maximum(*sigmas)


def _images(solution: Solution, earlier: Solution, shared: list[tuple[int, int]]) -> tuple[list[str], Table]:
    shown = shared[:MOST_IMAGES]
    names = [solution.network.images[j].name for j, _ in shown]
    found = [orientation_difference(solution, j, earlier, i) for j, i in shown]
    rms = np.array([root_mean_square(moved, 0) for moved, _ in found])
    with np.errstate(divide="ignore", invalid="ignore"):
        most = np.array([np.max(np.where(s > 0.0, np.abs(moved) / s, np.nan), axis=0) for moved, s in found])
    largest = np.nanmax(np.nan_to_num(most), axis=1)  # NaN of a held image
    worst, where = (largest.max(), names[int(np.argmax(largest))]) if largest.max(initial=0.0) > 0.0 else (0.0, "")
    sentences = [
        f"The orientation of {many(len(shown), 'common image')} differs by at most {worst:.2g} sigmas"
        + (f" ({where})." if where else ".")
    ]
    note = f"Over {PLACES} lines: rms of the differences, and the largest one in sigmas; a dash: held. "
    axes, turns = ("X", "Y", "Z"), ("x", "y", "z")
    table = Table("images_compared", "Orientation of the images, against the earlier solution", (
        Column("image", names, page="s"),
        Column("rms {}", rms[:, :3], "m", parts=axes, head="rms {}", page=".2f"),
        Column("rms turn {}", rms[:, 3:], "arcsec", parts=turns, head="rms turn {}", page=".2f"),
        Column("largest {}", most[:, :3], "σ", parts=axes, head="largest {}", page=".2f"),
        Column("largest turn {}", most[:, 3:], "σ", parts=turns, head="largest turn {}", page=".2f"),
    ), note + cut(len(shared), len(shown), "the first ones", "orientation.csv"))  # fmt: skip
    return sentences, table


def _points(solution: Solution, earlier: Solution) -> tuple[list[str], Table]:
    rows = {name: i for i, name in enumerate(earlier.network.points.ids)}
    pairs = [(i, rows[name]) for i, name in enumerate(solution.network.points.ids) if name in rows]
    here, there = np.array(pairs, dtype=np.int64).reshape(-1, 2).T
    sound = solution.determined[here] & earlier.determined[there]
    here, there = here[sound], there[sound]
    new, gone = len(solution.network.points) - len(pairs), len(earlier.network.points) - len(pairs)
    counts = f"{many(len(pairs), 'point')} of both, {new} new, {gone} gone"
    if not here.size:
        return [f"{counts}: no point has a place in both."], Table("points_compared", _TITLE, (Column("point", []),))
    moved = np.einsum("nij,nj->ni", east_north_up(solution.places[here]), solution.places[here] - earlier.places[there])
    length = np.linalg.norm(moved, axis=1)
    sigma = np.maximum(*(np.linalg.norm(one.sigmas[k], axis=1) for one, k in ((solution, here), (earlier, there))))
    with np.errstate(divide="ignore", invalid="ignore"):
        off = np.where(sigma > 0.0, length / sigma, np.nan)
    listed = np.argsort(-length, kind="stable")[:_MOST_POINTS]
    note = "The last column is the distance over the larger of both 3-D sigmas. "
    table = Table("points_compared", _TITLE, (
        Column("point", [solution.network.points.ids[k] for k in here[listed].tolist()], page="s"),
        Column("{}", moved[listed], "m", parts=("east", "north", "up"), head="{}", page=".2f"),
        Column("distance", length[listed], "m", page=".2f"),
        Column("over σ", off[listed], page=".2f"),
    ), note + cut(here.size, len(listed), "those that moved most", "the table of points"))  # fmt: skip
    largest = f", by {np.nanmax(off):.2g} sigmas at the most" if np.any(np.isfinite(off)) else ""
    rms = root_mean_square(length)
    return [f"{counts}; they moved by {rms:.3g} m (rms), {length.max():.3g} m at the most{largest}."], table

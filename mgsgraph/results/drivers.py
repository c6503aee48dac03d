"""What drives an adjustment that did not converge."""

from itertools import chain

import numpy as np

from mgsgraph.adjustment.drivers import Contributions, Kind, driver_sentences
from mgsgraph.adjustment.solution import Solution
from mgsgraph.files.output.table import Column, Table
from mgsgraph.results.section import Section


def drivers_section(solution: Solution) -> Section:
    """Which images and points drive it; nothing of an adjustment that converged."""
    found = solution.drivers
    if found is None:
        return Section("drivers")
    said = " ".join(driver_sentences(found, solution.network))
    if solution.settings.loss == "tukey":
        said += " With the loss tukey the end depends on the start: begin with huber, or give better orientations."
    table = drivers_table(solution)
    return Section("drivers", sentences=[said], tables=[table], csv=[table], numbers={
        "cost": found.cost,
        "cost_after_next_step": found.cost_after,
        "next_step_sigmas": found.step,
        "points_behind": found.behind,
        "points_parting": found.parting,
        "points_weak": found.weak,
        "outstanding": [
            {
                "quantity": str(one.quantity), "kind": str(one.kind), "count": one.outstanding, "of": one.of,
                "share": one.share, "names": _names(solution, one)[: min(one.outstanding, one.members.size)],
            }
            for one in found.outstanding
        ],
    })  # fmt: skip


def drivers_table(solution: Solution) -> Table:
    """One row per image or point and quantity, those that stand out and others with the largest shares."""
    every = () if solution.drivers is None else solution.drivers.contributions
    sizes = [one.members.size for one in every]
    ranks = [np.arange(size) for size in sizes]
    out = [rank < one.outstanding for rank, one in zip(ranks, every, strict=True)]
    return Table("drivers", "What drives the adjustment", (
        Column("quantity", _repeated([str(one.quantity) for one in every], sizes), page="s",
               meaning="cost; lost points: without a place where it stopped; blocking points: without one after the "
               "next step"),
        Column("kind", _repeated([str(one.kind) for one in every], sizes), page="s", meaning="image or point"),
        Column("name", list(chain.from_iterable(_names(solution, one) for one in every)), page="s",
               meaning="of the image, or id of the point"),
        Column("share", np.concatenate([np.zeros(0), *(one.shares for one in every)]), page=".3f",
               meaning="of the quantity; of points without a place the share that the image has measured"),
        Column("stands_out", [("", "yes")[yes] for part in out for yes in part.tolist()], head="stands out", page="s",
               meaning="yes: far beyond the median of all others"),
    ), "Shares of the cost where it stopped; up to 100 images and points of each. ",
    )  # fmt: skip


def _names(solution: Solution, one: Contributions) -> list[str]:
    network = solution.network
    if one.kind == Kind.IMAGE:
        return [network.images[j].name for j in one.members.tolist()]
    return [network.points.ids[i] for i in one.members.tolist()]


def _repeated(words: list[str], sizes: list[int]) -> list[str]:
    return [word for word, size in zip(words, sizes, strict=True) for _ in range(size)]

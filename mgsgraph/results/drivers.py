"""What drives an adjustment that did not come to rest: in words, as JSON, as a table."""

from itertools import chain
from typing import Any

import numpy as np

from mgsgraph.adjustment.drivers import Contributions, Kind, driver_sentences
from mgsgraph.adjustment.solution import Solution
from mgsgraph.files.output.table import Column, Table


def drivers_statements(solution: Solution) -> list[str]:
    """Which images and points drive it, in sentences; none of an adjustment that came to rest."""
    if solution.drivers is None:
        return []
    words = " ".join(driver_sentences(solution.drivers, solution.network))
    redescending = ""
    if solution.settings.loss == "tukey":
        redescending = (
            " With the loss tukey the end depends on where it begins: begin with huber, or give better orientations."
        )
    return [words + redescending]


def drivers_json(solution: Solution) -> dict[str, Any] | None:
    """The same for solution.json, with the largest shares of every quantity."""
    found = solution.drivers
    if found is None:
        return None
    return {
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
    }  # fmt: skip


def drivers_table(solution: Solution) -> Table:
    """One row per image or point and quantity, those that stand out and others with the largest shares."""
    every = () if solution.drivers is None else solution.drivers.contributions
    sizes = [one.members.size for one in every]
    ranks = [np.arange(size) for size in sizes]
    out = [rank < one.outstanding for rank, one in zip(ranks, every, strict=True)]
    return Table("drivers", "What drives the adjustment", (
        Column("quantity", _repeated([str(one.quantity) for one in every], sizes), page="s",
               meaning="cost; lost points: without a place where it stopped; blocking points: without one after the "
               "next step; rise: of the cost by that step; step: its square in sigmas"),
        Column("kind", _repeated([str(one.kind) for one in every], sizes), page="s", meaning="image or point"),
        Column("name", list(chain.from_iterable(_names(solution, one) for one in every)), page="s",
               meaning="of the image, or id of the point"),
        Column("share", np.concatenate([np.zeros(0), *(one.shares for one in every)]), page=".3f",
               meaning="of the quantity; of points without a place the share that the image has measured"),
        Column("stands_out", [("", "yes")[yes] for part in out for yes in part.tolist()], head="stands out", page="s",
               meaning="yes: far beyond the median of all others"),
    ), "Shares of the cost where it stopped, and of the step that would be next; up to 100 images and points of each. ",
    )  # fmt: skip


def _names(solution: Solution, one: Contributions) -> list[str]:
    network = solution.network
    if one.kind == Kind.IMAGE:
        return [network.images[j].name for j in one.members.tolist()]
    return [network.points.ids[i] for i in one.members.tolist()]


def _repeated(words: list[str], sizes: list[int]) -> list[str]:
    return [word for word, size in zip(words, sizes, strict=True) for _ in range(size)]

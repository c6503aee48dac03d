"""Several places at which a terrain model fits: in words, as JSON, as a table of the page."""

from typing import Any

import numpy as np

from mgsgraph.adjustment.multistart import Minima, Minimum
from mgsgraph.files.output.table import Column, Table
from mgsgraph.geometry.records import Array
from mgsgraph.text import listed, many


def minima_statements(found: Minima | None) -> list[str]:
    """What starts over the terrain model's shift have found, in a sentence."""
    if found is None:
        return []
    began = f"{many(found.starts, 'start')} over the terrain model's shift"
    lost = f" ({found.lost} came to no end)" if found.lost else ""
    if not found.several:
        return [f"{began[0].upper()}{began[1:]} found nothing better than this minimum{lost}."]
    places = listed([_place(one) for one in found.each if one.weight > 0.001])
    return [
        f"SEVERAL MINIMA: {began} ended in {len(found.each)} places{lost}, at which the model moved by {places}. The "
        "lowest one is the solution; all sigmas are those of the mixture about it."
    ]


def _place(one: Minimum) -> str:
    east, north = one.shift[:2]
    return f"{east:+.0f} m east and {north:+.0f} m north ({one.weight:.0%} probable, cost {one.cost:.4g})"


def minima_json(found: Minima | None) -> dict[str, Any] | None:
    """The same for solution.json; mean and sigma are the mixture's."""
    if found is None:
        return None
    return {
        "starts": found.starts, "lost": found.lost, "number": len(found.each),
        "shift_mean_east_north_m": found.mean[:2], "shift_sigma_east_north_m": _sigmas(found.covariance),
        "each": [
            {
                "weight": one.weight, "cost": one.cost, "starts": one.starts,
                "shift_east_north_m": one.shift[:2], "sigma_east_north_m": _sigmas(one.spread),
            }
            for one in found.each
        ],
    }  # fmt: skip


def _sigmas(covariance: Array) -> Array:
    return np.sqrt(np.diagonal(covariance)[:2])


def minima_table(found: Minima | None) -> Table:
    """One row per minimum, for the page."""
    each, ways = () if found is None else found.each, ("east", "north")
    shifts, sigmas = (np.array(part).reshape(-1, 2) for part in
                      ([one.shift[:2] for one in each], [_sigmas(one.spread) for one in each]))  # fmt: skip
    return Table("minima", "Places at which the terrain model fits", (
        Column("weight", np.array([one.weight for one in each]), page=".3f"),
        Column("cost", np.array([one.cost for one in each]), page=".2f"),
        Column("starts", [str(one.starts) for one in each], head="starts that ended here", page="s"),
        Column("{}", shifts, "m", parts=ways, head="{}", page=".1f"),
        Column("sigma_{}", sigmas, "m", parts=ways, head="σ {}", page=".1f"),
    ), "Local minima of the cost over the model's shift; the first is the solution.")  # fmt: skip

"""Several places at which a terrain model fits."""

import numpy as np

from mgsgraph.adjustment.multistart import Minima, Minimum
from mgsgraph.files.output.table import Column, Table
from mgsgraph.geometry.records import Array
from mgsgraph.results.section import Section
from mgsgraph.text import listed, many


def minima_section(found: Minima | None) -> Section:
    """What starts over the terrain model's shift have found; mean and sigma are the mixture's."""
    if found is None:
        return Section("minima")
    began = f"{many(found.starts, 'start')} over the terrain model's shift"
    lost = f" ({found.lost} did not converge)" if found.lost else ""
    said = f"{began[0].upper()}{began[1:]} found no better minimum than this one{lost}."
    if found.several:
        places = listed([_place(one) for one in found.each if one.weight > 0.001])
        said = (
            f"SEVERAL MINIMA: {began} ended in {len(found.each)} places{lost}, at which the model moved by {places}. "
            "The lowest one is the solution; all sigmas are those of the mixture about it."
        )
    table = _table(found)
    return Section("minima", sentences=[said], tables=[table], numbers={
        "starts": found.starts, "lost": found.lost, "number": len(found.each),
        "shift_mean_east_north_m": found.mean[:2], "shift_sigma_east_north_m": _sigmas(found.covariance),
        "each": table.records(),
    })  # fmt: skip


def _place(one: Minimum) -> str:
    east, north = one.shift[:2]
    return f"{east:+.0f} m east and {north:+.0f} m north ({one.weight:.0%} probable, cost {one.cost:.4g})"


def _sigmas(covariance: Array) -> Array:
    return np.sqrt(np.diagonal(covariance)[:2])


def _table(found: Minima) -> Table:
    """One row per minimum."""
    each, ways = found.each, ("east", "north")
    return Table("minima", "Places at which the terrain model fits", (
        Column("weight", np.array([one.weight for one in each]), page=".3f"),
        Column("cost", np.array([one.cost for one in each]), page=".2f"),
        Column("starts", np.array([one.starts for one in each]), head="starts that ended here", page="s"),
        Column("shift_east_north", np.array([one.shift[:2] for one in each]), "m", parts=ways, head="{}", page=".1f"),
        Column("sigma_east_north", np.array([_sigmas(one.spread) for one in each]), "m", parts=ways, head="σ {}",
               page=".1f"),
    ), "Local minima of the cost over the model's shift; the first is the solution.")  # fmt: skip

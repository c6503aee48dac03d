"""How laser and images were registered, for the studio: footprints before and after, the search by relief, and heights
above the terrain model, as JSON with the units in the keys.

Footprints come from the block itself; the search and the height maps from the tables that `mgsgraph coregister` and
`mgsgraph adjust --two-steps` leave in a folder of results.
"""

from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
from pyarrow import csv as arrow_csv

from mgsgraph.adjustment.multistart import Minima
from mgsgraph.analysis.two_step_statistics import STAGES
from mgsgraph.errors import require
from mgsgraph.files.opening import read_bytes, read_json, understood
from mgsgraph.files.output.csv_json import plain
from mgsgraph.files.output.folders import COREGISTRATION
from mgsgraph.geometry.body import from_planetocentric
from mgsgraph.studio.block import Block
from mgsgraph.studio.marks import shots_of
from mgsgraph.text import many
from mgsgraph.units import DEG

COSTS, SHOTS, CELLS, TWO_STEPS = "costs.csv", "shots.csv", "height_cells.csv", "two_steps.json"
"""Files of results that are read."""
_MOST_IMAGES = 60
"""Images whose footprints a page is sent: those with most of them."""
_STATES = ("before", "after")


def footprints_record(block: Block) -> dict[str, Any]:
    """Where shots fall in images before and after the adjustment, with a sentence of each image."""
    found = []
    for j, image in enumerate(block.images):
        shots = shots_of(block, j)
        if shots["profiles"]:
            found.append({
                "image": image.name, "lines": image.lines, "samples": image.samples, **shots,
                "sentence": _moved(block, image.name, shots["profiles"]),
            })  # fmt: skip
    count = len(found)
    found.sort(key=lambda one: -sum(len(profile["names"]) for profile in one["profiles"]))
    sentence = f"Shots fall in {many(count, 'image')}." if count else "No laser shot falls in an image."
    return {"adjusted": block.adjusted, "images": found[:_MOST_IMAGES], "sentence": sentence}


def _moved(block: Block, image: str, profiles: list[dict[str, Any]]) -> str:
    """By how much the shots of an image move in it by the adjustment."""
    count = sum(len(one["names"]) for one in profiles)
    fall = f"{many(count, 'shot')} of {many(len(profiles), 'profile')} {'falls' if count == 1 else 'fall'} in {image}"
    if not block.adjusted:
        return f"{fall} with the nominal orientation; the block has not been adjusted."
    pairs = [both for one in profiles for both in zip(one["before"], one["after"], strict=True) if None not in both]
    if not pairs:
        return f"{fall}."
    moved = np.diff(np.array(pairs, dtype=np.float64), axis=1)[:, 0]
    line, sample = moved.mean(axis=0)
    return f"{fall}; the adjustment moves them by {line:+.1f} lines and {sample:+.1f} samples on the average."


# --- tables of results


def _table(path: Path, columns: tuple[str, ...]) -> dict[str, Any] | None:
    """Columns of one of our CSV files, numbers as arrays, names as lists; None where there is no such file."""
    if not path.is_file():
        return None
    content = read_bytes(path)
    with understood(str(path), "a table of results", "make the results anew"):
        names = content.partition(b"\n")[0].decode().strip().split(",")
        table = arrow_csv.read_csv(BytesIO(content))
        missing = [name for name in columns if name not in names]
        require(not missing, str(path), f"no column {', '.join(missing)}", "a table of `mgsgraph`", "make it anew")
        return {name: _values(table[name]) for name in columns}


def _values(column: pa.ChunkedArray) -> Any:
    kind = column.type
    if pa.types.is_floating(kind) or pa.types.is_integer(kind) or pa.types.is_null(kind):
        return np.asarray(column.cast(pa.float64()).fill_null(np.nan).to_numpy(), dtype=np.float64)
    return column.to_pylist()


def relief_record(folder: Path, radius: float) -> dict[str, Any] | None:
    """Cost surfaces, profiles and sentences of a registration by relief; None where the folder has none. Distances
    along the tracks are those on a sphere of a radius (m).

    Raises
    ------
    InputError
        Tables that can't be read.
    """
    if not (folder / COREGISTRATION).is_file():
        return None
    record = read_json(folder / COREGISTRATION)
    costs = _table(folder / COSTS, ("profile", "state", "shift_east_m", "shift_north_m", "misfit"))
    shots = _table(folder / SHOTS, (
        "profile", "shot", "on_surface", "east_longitude_deg", "planetocentric_latitude_deg", "height_m",
        "above_surface_before_m", "above_surface_after_m", "sigma_m",
    ))  # fmt: skip
    with understood(str(folder / COREGISTRATION), "what `mgsgraph coregister` writes", "make it anew"):
        minima = {one["profile"]: one for one in record["profiles"]}
        return {
            "reach_m": record["settings"]["reach_m"], "sentences": record["statements"],
            "profiles": [
                {
                    "name": name, "tied": one["tied"], "clear": one["clear"],
                    "costs": {} if costs is None else {
                        state: _cost(costs, name, state) | {"minima": one[f"minima_{state}"]} for state in _STATES
                    },
                    "shots": None if shots is None else _shots(shots, name, radius),
                }
                for name, one in minima.items()
            ],
        }  # fmt: skip


def _cost(costs: dict[str, Any], name: str, state: str) -> dict[str, Any]:
    """A cost surface: root of the misfit above the best in sigmas, by shift east (rows) and north (columns)."""
    mine = [k for k, both in enumerate(zip(costs["profile"], costs["state"], strict=True)) if both == (name, state)]
    misfits = costs["misfit"][mine]
    shifts = np.unique(costs["shift_east_m"][mine])
    square = misfits.reshape(shifts.size, -1)
    best = np.nanmin(square) if np.any(np.isfinite(square)) else np.nan
    return {"shifts_m": shifts.tolist(), "misfit": plain(square), "best_misfit": plain(best)}


def _shots(shots: dict[str, Any], name: str, radius: float) -> dict[str, Any]:
    """A profile along its track: heights above the ellipsoid, and above the surface that the images show."""
    mine = [k for k, one in enumerate(shots["profile"]) if one == name]
    places = from_planetocentric(np.column_stack([
        shots["east_longitude_deg"][mine] * DEG, shots["planetocentric_latitude_deg"][mine] * DEG,
        np.full(len(mine), radius),
    ]))  # fmt: skip
    along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(places, axis=0), axis=1))])
    return {
        "names": [shots["shot"][k] for k in mine], "on_surface": [shots["on_surface"][k] for k in mine],
        "along_m": along.tolist(), "height_m": plain(shots["height_m"][mine]),
        **{f"above_surface_{state}_m": plain(shots[f"above_surface_{state}_m"][mine]) for state in _STATES},
        "sigma_m": plain(shots["sigma_m"][mine]),
    }  # fmt: skip


def heights_record(folder: Path) -> dict[str, Any] | None:
    """Heights of points above the terrain model by cell of the map, before and after both steps; None without them."""
    columns = [f"{what}_{stage}_m" for stage in STAGES for what in ("rms", "mean")]
    cells = _table(folder / CELLS, ("longitude_deg", "latitude_deg", "points", *columns))
    if cells is None:
        return None
    sentences = read_json(folder / TWO_STEPS).get("statements", []) if (folder / TWO_STEPS).is_file() else []
    return {
        "longitude_deg": cells["longitude_deg"].tolist(), "latitude_deg": cells["latitude_deg"].tolist(),
        "points": cells["points"].tolist(), "stages": list(STAGES), "sentences": sentences,
        "rms_m": [plain(cells[f"rms_{stage}_m"]) for stage in STAGES],
        "mean_m": [plain(cells[f"mean_{stage}_m"]) for stage in STAGES],
    }  # fmt: skip


def minima_record(found: Minima | None) -> dict[str, Any] | None:
    """Places at which the terrain model fits, by starts over its shift; None where there were no starts."""
    if found is None:
        return None
    return {
        "starts": found.starts,
        "each": [
            {"shift_m": one.shift[:2].tolist(), "covariance_m2": one.spread[:2, :2].tolist(), "weight": one.weight}
            for one in found.each
        ],
    }  # fmt: skip


def registration_record(block: Block, folder: Path | None, minima: Minima | None = None) -> dict[str, Any]:
    """All that the page shows of a registration; what there is none of is null, and says how to get it."""
    return {
        "footprints": footprints_record(block),
        "relief": None if folder is None else relief_record(folder, block.images[0].body.equatorial),
        "heights": None if folder is None else heights_record(folder),
        "minima": minima_record(minima),
        "missing": {
            "relief": "No registration by relief: mgsgraph coregister CASE --out FOLDER, then mgsgraph studio FOLDER.",
            "heights": "No adjustment in two steps: mgsgraph adjust CASE --two-steps --out FOLDER.",
        },
    }  # fmt: skip

"""What to measure next: tie points that might be measured where images overlap, ranked by what each would do."""

from typing import Any

import numpy as np

from mgsgraph.errors import InputError
from mgsgraph.figures.content import places_at
from mgsgraph.geometry.body import from_planetocentric, planetocentric
from mgsgraph.geometry.records import Array
from mgsgraph.planning.candidates import planned_tie
from mgsgraph.planning.coverage import ImageCoverage
from mgsgraph.planning.plan import plan
from mgsgraph.project.reading import read_state
from mgsgraph.studio.map_points import map_points
from mgsgraph.studio.opened import Opened

_MOST_IMAGES = 60
"""Images of a block up to which candidates are judged while somebody waits."""
_CELLS = 7
"""Candidates along the longer side of the block, about."""
_SIGMA = 1.0
"""px, of their measures."""


def next_measures(opened: Opened, choose: int = 5) -> dict[str, Any]:
    """Candidates on an even grid over the block, the best ones first, as JSON.

    Parameters
    ----------
    opened : Opened
        Adjusted.
    choose : int
        How many are chosen one after the other, each judged with those before it.

    Raises
    ------
    InputError
        A large block; one that has not been adjusted; one without ground that two images see.
    """
    block = opened.block()
    if len(block.images) > _MOST_IMAGES:
        remedy = "mgsgraph plan RESULT CANDIDATES.toml judges your own"
        raise InputError(str(opened.path), f"{len(block.images)} images", f"up to {_MOST_IMAGES} here", remedy)
    _, state, _ = read_state(opened.path if opened.kind == "project" else opened.folder or opened.path)
    coverage = ImageCoverage(state)
    places = _grid(opened)
    names = [f"next-{k + 1}" for k in range(len(places))]
    wanted = [planned_tie(coverage, name, place, _SIGMA) for name, place in zip(names, places, strict=True)]
    wanted = [one for one in wanted if one.addition is not None]
    if not wanted:
        raise InputError(str(opened.path), "no ground that two images see", "images that overlap")
    made = plan(state, wanted, choose, ("ties",), "mean", opened.name)
    at = dict(zip(names, opened.map_places(places).tolist(), strict=True))
    chosen = [
        {"name": one.name, "map_m": at[one.name], "drop_percent": 100.0 * one.drop, "bits": one.bits,
         "images": list(one.images),
         "text": f"in {', '.join(one.images)}: mean sigma of the tie points {one.after.total:.4g} m, "
                 f"{100.0 * one.drop:.2g} % less"}
        for one in made.chosen
    ]  # fmt: skip
    sentence = (
        f"Of {len(wanted)} places on a grid, measured to {_SIGMA:g} px in all images that show them, these would lower "
        f"the mean sigma of the tie points most, one after the other: from {made.now.total:.4g} m to "
        f"{made.after.total:.4g} m."
    )
    return {"sentence": sentence, "candidates": chosen}


def _grid(opened: Opened) -> Array:
    """(n, 3) m, places on the ground at the middle radius of the points, an even grid over the outlines."""
    outlines = np.concatenate([one for one in opened.footprints() if len(one)])
    low, high = outlines.min(axis=0), outlines.max(axis=0)
    step = float((high - low).max()) / _CELLS
    count = np.maximum(np.ceil((high - low) / step), 2).astype(int)
    x, y = (low[k] + (np.arange(count[k]) + 0.5) * (high[k] - low[k]) / count[k] for k in range(2))
    plane = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    points = map_points(opened)
    nearest = np.argmin(np.linalg.norm(plane[:, None] - points.plane[None, _thinned(points.plane)], axis=2), axis=1)
    radii = np.linalg.norm(opened.block().places[_thinned(points.plane)], axis=1)[nearest]
    places = planetocentric(places_at(plane, opened.centre))
    return from_planetocentric(np.column_stack([places[:, :2], radii]))


def _thinned(plane: Array) -> np.ndarray:
    known = np.flatnonzero(np.all(np.isfinite(plane), axis=1))
    return known[np.linspace(0, known.size - 1, min(known.size, 2000)).astype(np.int64)]

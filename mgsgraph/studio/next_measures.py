"""What to measure next: tie points that might be measured where images overlap, ranked by what each would do."""

from typing import Any

import numpy as np

from mgsgraph.errors import InputError
from mgsgraph.geometry.records import Array
from mgsgraph.planning.candidates import planned_point
from mgsgraph.planning.coverage import ImageCoverage
from mgsgraph.planning.plan import plan
from mgsgraph.project.reading import read_state
from mgsgraph.studio.linked import LinkedImages
from mgsgraph.studio.opened import Opened

_MOST_IMAGES = 60
"""Images of a block up to which candidates are judged while somebody waits."""
_LINES, _SAMPLES, _MOST_PLACES = 9, 3, 80
"""Candidates along and across an image, and in all, about."""
_SIGMA = 1.0
"""px, of their measures."""


def next_measures(opened: Opened, linked: LinkedImages, choose: int = 5) -> dict[str, Any]:
    """Candidates on an even grid over the images, the best ones first, as JSON.

    Parameters
    ----------
    opened : Opened
        Adjusted.
    linked : LinkedImages
        Its images.
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
    places = _grid(linked)
    names = [f"next-{k + 1}" for k in range(len(places))]
    wanted = [planned_point(coverage, name, place, None, _SIGMA) for name, place in zip(names, places, strict=True)]
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


def _grid(linked: LinkedImages) -> Array:
    """(n, 3) m, places on the ground, an even grid in each image, where another one shows them, too."""
    images = linked.block.images
    step = max(len(images) * _LINES * _SAMPLES // _MOST_PLACES, 1)
    asked = [
        (image.name, image.lines * (row + 0.5) / _LINES, image.samples * (column + 0.5) / _SAMPLES)
        for image in images for row in range(_LINES) for column in range(_SAMPLES)
    ]  # fmt: skip
    found = list[Array]()
    for name, line, sample in asked[::step]:
        try:
            ground, others = linked.under(name, line, sample)
        except InputError:  # beside the body
            continue
        if others:
            found.append(ground.point)
    return np.array(found).reshape(-1, 3)

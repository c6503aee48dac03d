"""Distances on the map: of two points with sigmas by their joint covariance, of free places of the ground without."""

from typing import Any

import numpy as np

from mgsgraph.errors import InputError
from mgsgraph.files.output.table import plain
from mgsgraph.geometry.records import Array
from mgsgraph.results.answers import Questions, replies
from mgsgraph.studio.map_images import ground_at
from mgsgraph.studio.opened import Opened


def distance(opened: Opened, names: tuple[str, str], plane: Array) -> dict[str, Any]:
    """Straight distance between two ends as JSON: points by their names, or, where a name is empty, places (2, 2) in m
    on the map. Of two adjusted points the answer is that of `mgsgraph analyze --pair`, with sigmas.

    Raises
    ------
    InputError
        No such point, or one without coordinates; the same point twice.
    """
    points = [_number(opened, name) for name in names if name]
    if len(points) == len(names) and opened.now.posterior is not None:
        (section,) = replies(opened.posterior_of(np.array(points)), Questions(pairs=(names,)))
        return {**plain(section.numbers), "sentence": ". ".join(section.sentences)}
    block = opened.block()
    places = ground_at(opened, plane)
    places[[bool(name) for name in names]] = block.places[points]
    ground = "the terrain model" if block.terrain is not None else "the ellipsoid at the median height of the points"
    reason = "nothing has been adjusted" if len(points) == len(names) else f"a free place on {ground} has none"
    length = float(np.linalg.norm(places[1] - places[0]))
    return {"distance_m": length, "sentence": f"Distance {length:.5g} m, without a sigma: {reason}."}


def _number(opened: Opened, name: str) -> int:
    """Of a point with coordinates."""
    block = opened.block()
    (number,) = block.network.points.ids.find([name]).tolist()
    if number < 0 or not np.all(np.isfinite(block.places[number])):
        raise InputError(f"point {name}", "no such point" if number < 0 else "it has no coordinates", "another one")
    return int(number)

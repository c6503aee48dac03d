"""How the images are connected, in words and as plain values: links, weakest ones, islands, overlaps without ties."""

from typing import Any

import numpy as np

from mgsgraph.geometry.records import Index
from mgsgraph.network.connectivity import Connectivity
from mgsgraph.text import NAMED, listed, many, some
from mgsgraph.units import KM

WEAKEST = 5
"""Joints named as the weakest."""
SLIVER = 0.02
"""Share of the smaller footprint below which an overlap is not worth ties."""


def connectivity_json(connected: Connectivity) -> dict[str, Any]:
    """What the block can't do without, and where it could be tied, as plain values; the pairs are in the table."""
    names = connected.names
    return {
        "links": int(connected.links.size),
        "weakest_joints": [_pair(connected, row) for row in connected.spine[:WEAKEST].tolist()],
        "bridges": [_pair(connected, row) for row in np.flatnonzero(connected.bridges).tolist()],
        "cut_images": [names[j] for j in connected.cut_images],
        "unconnected_images": [names[j] for j in connected.unconnected] if len(names) > 1 else [],
        "overlaps_without_common_points": [_pair(connected, row) for row in worth_tying(connected).tolist()],
        "common_points_without_overlap": [_pair(connected, row) for row in connected.apart.tolist()],
    }


def _pair(connected: Connectivity, row: int) -> dict[str, Any]:
    i, j = connected.pairs[row].tolist()
    return {
        "images": [connected.names[i], connected.names[j]],
        "common_points": int(connected.points[row]),
        "overlap_km2": float(connected.areas[row]) / KM**2,
        "overlap_share": float(connected.shares[row]),
        "gap_km": float(connected.gaps[row]) / KM,
    }


def worth_tying(connected: Connectivity) -> Index:
    """Rows of pairs that share no points but ground, slivers left out; largest area first."""
    return connected.untied[connected.shares[connected.untied] >= SLIVER]


def connectivity_statements(connected: Connectivity) -> list[str]:
    """Sentences: how many links, the weakest one, islands, overlaps without ties, ties without overlap."""
    if len(connected.names) < 2:
        return []
    return [*link_statement(connected), *connectivity_warnings(connected)]


def connectivity_warnings(connected: Connectivity) -> list[str]:
    """Sentences about islands, and pairs of images whose points and footprints disagree."""
    return [*_islands(connected), *_untied(connected), *_apart(connected)]


def link_statement(connected: Connectivity) -> list[str]:
    """A sentence about all links and the weakest joint; none without links."""
    points, links = connected.points, connected.links
    if links.size == 0:
        return []
    if links.size == 1:
        row = int(links[0])
        return [f"{_both(connected, row)} have {many(int(points[row]), 'point')} in common{_overlap(connected, row)}."]
    whole = "the block" if len(connected.islands) == 1 else "an island"
    row = int(connected.spine[0])
    return [
        f"{len(connected.names)} images are connected by {links.size} links of {points[links].min()} to "
        f"{points[links].max()} common points (median {np.median(points[links]):.0f}). Every split of {whole} is "
        f"bridged by at least {many(int(points[row]), 'point')}; weakest link: {_weak(connected, row)}."
    ]


def _weak(connected: Connectivity, row: int) -> str:
    text = f"{_both(connected, row)}, {many(int(connected.points[row]), 'point')}"
    lost = connected.cut_off(row)
    if not lost or len(connected.names) == 2:
        return text
    return f"{text}, the only link of {_those(connected, lost)} to the rest"


def _those(connected: Connectivity, images: tuple[int, ...]) -> str:
    return connected.names[images[0]] if len(images) == 1 else f"{len(images)} images"


def _both(connected: Connectivity, row: int) -> str:
    return " and ".join(connected.names[j] for j in connected.pairs[row])


def _overlap(connected: Connectivity, row: int) -> str:
    area, share = float(connected.areas[row]) / KM**2, float(connected.shares[row])
    return f" and overlap by {area:.4g} km^2, {100.0 * share:.0f} % of the smaller one" if area > 0.0 else ""


def _islands(connected: Connectivity) -> list[str]:
    if len(connected.islands) < 2:
        return []
    parts = [some([connected.names[j] for j in island[:NAMED]], len(island)) for island in connected.islands[:NAMED]]
    return [
        f"The block is split into {len(connected.islands)} parts without common points: "
        f"{some([f'({part})' for part in parts], len(connected.islands))}. Measure tie points between them."
    ]


def _untied(connected: Connectivity) -> list[str]:
    rows = worth_tying(connected)
    if rows.size == 0:
        return []
    named = [f"{_both(connected, row)}{_overlap(connected, row).replace(' and overlap', '')}" for row in rows[:NAMED]]
    verb = "overlaps" if rows.size == 1 else "overlap"
    return [
        f"{many(rows.size, 'pair')} of images {verb} without any common point: {_more('; '.join(named), rows.size)}. "
        "Measure ties there."
    ]


def _apart(connected: Connectivity) -> list[str]:
    rows = connected.apart
    if rows.size == 0:
        return []
    named = [
        f"{_both(connected, row)} ({many(int(connected.points[row]), 'point')}, "
        f"{connected.gaps[row] / KM:.3g} km apart)"
        for row in rows[:NAMED]
    ]
    verb = "has" if rows.size == 1 else "have"
    return [
        f"{many(rows.size, 'pair')} of images {verb} common points, but separate footprints: "
        f"{_more('; '.join(named), rows.size)}. Check these points and the orientation."
    ]


def _more(text: str, total: int) -> str:
    return text + (f" and {total - NAMED} more" if total > NAMED else "")


def cut_image_statement(connected: Connectivity) -> list[str]:
    """A sentence about images without which the block falls apart, where there are any."""
    cuts = connected.cut_images
    if cuts.size == 0:
        return []
    names = [connected.names[j] for j in cuts[:NAMED]]
    if cuts.size <= NAMED:
        return [f"the block falls apart without {listed(names) if len(names) < 3 else 'any of ' + ', '.join(names)}"]
    return [f"the block falls apart without any of {cuts.size} images: {some(names, cuts.size)}"]

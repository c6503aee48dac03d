"""Matches of pairs joined over images; no track has two places in one image."""

from collections.abc import Iterable

import numpy as np

from mgsgraph.geometry.records import Array, Index


def joined(links: Index, likeness: Array, picture_of: Index) -> list[list[int]]:
    """Features joined by links, the surest first; a link that would bring two features of one picture together, or
    contradicts a surer one, is left out: so a contradictory track falls apart at its weakest link.

    Parameters
    ----------
    links : (k, 2)
        Numbers of features.
    likeness : (k,)
        How sure each link is.
    picture_of : (n,)
        Picture of each feature.

    Returns
    -------
    list of list of int
        Features of each track, by picture, at least two.
    """
    track_of = dict[int, int]()
    tracks = dict[int, list[int]]()
    for k in np.argsort(-likeness, kind="stable").tolist():
        one, other = int(links[k, 0]), int(links[k, 1])
        ours, theirs = (_track(feature, track_of, tracks) for feature in (one, other))
        if ours == theirs:
            continue
        if {int(picture_of[f]) for f in tracks[ours]} & {int(picture_of[f]) for f in tracks[theirs]}:
            continue
        for feature in tracks[theirs]:
            track_of[feature] = ours
        tracks[ours] += tracks.pop(theirs)
    return [sorted(track, key=lambda f: int(picture_of[f])) for track in tracks.values() if len(track) > 1]


def _track(feature: int, track_of: dict[int, int], tracks: dict[int, list[int]]) -> int:
    if feature not in track_of:
        track_of[feature] = feature
        tracks[feature] = [feature]
    return track_of[feature]


def star(tracks: Iterable[list[int]]) -> tuple[Index, Index, Index]:
    """Tracks as links from a first feature to each other one: number of the track, first and other feature (k,)."""
    rows = [(t, track[0], other) for t, track in enumerate(tracks) for other in track[1:]]
    numbers = np.array(rows, dtype=np.int64).reshape(-1, 3)
    return numbers[:, 0], numbers[:, 1], numbers[:, 2]

"""Steps of a strip put together: each tie point and each shot once, measured in all images."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from mgsgraph.geometry.altimetry import LaserProfile
from mgsgraph.geometry.records import Index
from mgsgraph.ties import TiePoints


def merged_ties(parts: Sequence[TiePoints]) -> TiePoints:
    """Tie points of several steps as one: points in the order in which they come up, measures by point."""
    number = dict[str, int]()
    for part in parts:
        for name in part.ids:
            number.setdefault(name, len(number))
    of_part = [np.array([number[name] for name in part.ids], dtype=np.int64) for part in parts]
    point = np.concatenate([own[part.measure_point] for own, part in zip(of_part, parts, strict=True)])
    order = np.argsort(point, kind="stable")
    names = [name for part in parts for name in part.measure_image]
    first = np.full(len(number), -1)
    rows = np.concatenate(of_part)
    first[rows[::-1]] = np.arange(rows.size)[::-1]
    return TiePoints(
        source=parts[0].source,
        ids=tuple(number),
        kinds=np.concatenate([part.kinds for part in parts])[first],
        places=np.concatenate([part.places for part in parts])[first],
        covariances=np.concatenate([part.covariances for part in parts])[first],
        measure_point=point[order],
        measure_image=tuple(names[k] for k in order.tolist()),
        measures=np.concatenate([part.measures for part in parts])[order],
        measure_sigmas=np.concatenate([part.measure_sigmas for part in parts])[order],
    )


def merged_profiles(parts: Sequence[LaserProfile]) -> tuple[LaserProfile, ...]:
    """Shots of several steps by the profile that brought them: one for each step with shots that nobody knew before."""
    owner = dict[str, tuple[int, int]]()
    news = list[tuple[LaserProfile, Index]]()
    sights = list[list[tuple[int, str, int, int]]]()
    for step, part in enumerate(parts):
        new = np.array([i for i, name in enumerate(part.ids) if name not in owner], dtype=np.int64)
        if new.size:
            owner |= {part.ids[i]: (len(news), local) for local, i in enumerate(new.tolist())}
            news.append((part, new))
            sights.append([])
        for row, (shot, image) in enumerate(zip(part.measure_shot.tolist(), part.measure_image, strict=True)):
            profile, local = owner[part.ids[shot]]
            sights[profile].append((local, image, step, row))
    return tuple(_with_sights(*new, seen, parts) for new, seen in zip(news, sights, strict=True))


def _with_sights(
    part: LaserProfile, which: Index, sights: list[tuple[int, str, int, int]], parts: Sequence[LaserProfile]
) -> LaserProfile:
    """Some shots (n,) of a step with measures (shot, image, and the step and row where they stand) of any."""
    sights = sorted(sights, key=lambda sight: sight[0])
    return replace(
        part,
        ids=tuple(part.ids[i] for i in which.tolist()),
        times=part.times[which],
        ranges=part.ranges[which],
        range_sigmas=part.range_sigmas[which],
        footprints=part.footprints[which],
        covariances=part.covariances[which],
        simultaneous=tuple(part.simultaneous[i] for i in which.tolist()),
        measure_shot=np.array([sight[0] for sight in sights], dtype=np.int64),
        measure_image=tuple(sight[1] for sight in sights),
        measures=np.array([parts[step].measures[row] for _, _, step, row in sights]).reshape(-1, 2),
    )

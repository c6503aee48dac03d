"""Several control networks as one set of tie points: a point of several files has the measures of all of them."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mgsgraph.errors import InputError
from mgsgraph.files.opening import understood
from mgsgraph.files.output.folders import MATCH
from mgsgraph.files.records import read_record
from mgsgraph.files.tie_points import PointKind, TiePoints
from mgsgraph.geometry.records import Index, chosen_rows, concatenated
from mgsgraph.geometry.terrain import overlap_variances
from mgsgraph.names import Names, RepeatedNames
from mgsgraph.text import many, some

_SAME_PLACE = 1e-3
"""m, within which two a-priori places of one known point are the same."""


def with_sigmas(
    points: TiePoints, sigma: float, of_images: Mapping[str, float], window: float = 0.0, factor: float = 1.0
) -> TiePoints:
    """The same points with a sigma for every measure: the file's own, or else its image's, or else the group's (px).
    Measures of an image within one window (px, its side) have errors in common, by which their sigmas grow. All of them
    are multiplied by the `factor`.
    """
    images = points.measure_image
    default = np.array([*(of_images.get(name, sigma) for name in images.distinct), sigma])[images.numbers]
    sigmas = np.where(np.isnan(points.measure_sigmas), default[:, None], points.measure_sigmas)
    if window > 0.0:
        for number in np.unique(images.numbers).tolist():
            mine = images.numbers == number
            sigmas[mine] = np.sqrt(overlap_variances(points.measures[mine], sigmas[mine], window))
    return replace(points, measure_sigmas=factor * sigmas)


def window_beside(network: Path) -> float:
    """Pixels, side of the windows in which `mgsgraph match` compared what a network beside its record holds; 0 for a
    network that lies beside none.
    """
    record = network.with_name(MATCH)
    if not record.is_file():
        return 0.0
    with understood(f"{record}, settings.half_window", "what mgsgraph match writes", "state window_px in [ties]"):
        return 2.0 * float(read_record(record)["settings"]["half_window"]) + 1.0


def in_images(
    points: TiePoints, images: Sequence[str], holder: str = "the case", known: Collection[str] = ()
) -> tuple[TiePoints, str]:
    """Points as the images of a case (or another `holder`) measure them, and a sentence about what was left out; empty
    where nothing was.

    Points go with measures in other images where no other measure is left, or a single one of a free point that isn't
    `known` by its id. Raises InputError where nothing is left, which is so where images are called otherwise.
    """
    held = points.measure_image.over(images) >= 0
    if held.all():
        return points, ""
    strange = points.measure_image[~held].used
    called = some(strange, len(strange))
    before, after = (
        np.bincount(points.measure_point[mine], minlength=len(points.ids)) for mine in (slice(None), held)
    )
    alone = (points.kinds == PointKind.FREE) & (Names.of(known).find(points.ids) < 0)
    gone = (after < before) & (after < np.where(alone, 2, 1))
    if gone.all():
        found = f"points that are measured in {called}, and none that enough others see"
        expected = f"points measured in the images of {holder} ({some(images, len(images))})"
        raise InputError(points.source, found, expected, "call images as the network does")
    left = points.with_measures(held).chosen(np.flatnonzero(~gone))
    said = f"Left out of {points.source}: {many(int((~held).sum()), 'measure')} in "
    said += f"{many(len(strange), 'image')} that {holder} doesn't hold ({called})"
    if gone.any():
        single = int(held.sum()) - len(left.measure_image)
        said += f", and {many(int(gone.sum()), 'point')} of theirs that too few others see"
        said += f" ({many(single, 'more measure')})" if single else ""
    return left, f"{said}."


def merged(groups: Sequence[TiePoints]) -> TiePoints:
    """Points of several control networks, in the files' order, those of the same id made one.

    Raises
    ------
    InputError
        If a measure is in two files, or if two files know different a-priori places of one point.
    """
    if len(groups) == 1:
        return groups[0]
    ids, points = Names.united([group.ids for group in groups])
    file_of = np.repeat(np.arange(len(groups)), [len(group.ids) for group in groups])
    source = _best_sources(groups, np.concatenate(points), file_of, len(ids))
    point = np.concatenate([mine[group.measure_point] for mine, group in zip(points, groups, strict=True)])
    image = RepeatedNames.concatenated([group.measure_image for group in groups])
    _require_new_measures(groups, point, image, ids)

    def of_points(name: str) -> NDArray[Any]:
        return chosen_rows(concatenated([getattr(group, name) for group in groups]), source)

    return TiePoints(
        source=", ".join(dict.fromkeys(group.source for group in groups)),
        ids=ids,
        kinds=of_points("kinds"),
        places=of_points("places"),
        covariances=of_points("covariances"),
        measure_point=point,
        measure_image=image,
        measures=np.concatenate([group.measures for group in groups]),
        measure_sigmas=np.concatenate([group.measure_sigmas for group in groups]),
    )


def _best_sources(groups: Sequence[TiePoints], number: Index, file_of: Index, count: int) -> Index:
    """(count,) which of all files' points, in their order, says most of each point: the first that is not free, or else
    the first with a place. InputError where two that are not free contradict each other.

    `number` (p,) and `file_of` (p,) are the point and the file of each of them.
    """
    kinds, places, covariances = (
        concatenated([getattr(group, name) for group in groups]) for name in ("kinds", "places", "covariances")
    )
    rank = np.where(kinds != PointKind.FREE, 0, np.where(np.isnan(places[:, 0]), 2, 1))
    order = np.lexsort([np.arange(number.size), rank, number])
    source = order[np.searchsorted(number[order], np.arange(count))]
    other = np.flatnonzero((rank == 0) & (source[number] != np.arange(number.size)))
    first = source[number[other]]
    same = (kinds[other] == kinds[first]) & np.all(np.abs(places[other] - places[first]) < _SAME_PLACE, axis=1)
    same &= np.all(np.isclose(covariances[other], covariances[first]), axis=(1, 2))
    for k in np.flatnonzero(~same)[:1].tolist():
        i, group = int(other[k]), groups[int(file_of[other[k]])]
        where = f"{group.source}, point {Names.concatenated([one.ids for one in groups])[i]}"
        found = f"{PointKind(int(kinds[i])).name.lower()} at another a-priori place or with another covariance"
        source_of_first = groups[int(file_of[first[k]])].source
        raise InputError(where, found, f"what {source_of_first} says of it", "make it Free in one of the two")
    return np.asarray(source)


def _require_new_measures(groups: Sequence[TiePoints], point: Index, images: RepeatedNames, ids: Names) -> None:
    """Raise InputError for a measure that an earlier file holds; points (k,) by their numbers and images (k) of all."""
    file_of = np.repeat(np.arange(len(groups)), [group.measure_point.size for group in groups])
    code = point * len(images.distinct) + images.numbers
    order = np.argsort(code, kind="stable")
    again = np.flatnonzero(code[order][1:] == code[order][:-1])
    for k in again[np.argsort(order[again + 1])][:1].tolist():
        one, other = int(order[k]), int(order[k + 1])
        where = f"{groups[int(file_of[other])].source}, point {ids[int(point[other])]}, image {images[other]}"
        found = f"a measure that {groups[int(file_of[one])].source} has too"
        raise InputError(where, found, "each measure in one network", "take it out of one of the two")

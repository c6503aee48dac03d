"""Several control networks as one set of tie points: a point of several files has the measures of all of them."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from mgsgraph.errors import InputError
from mgsgraph.geometry.common_errors import overlap_variances
from mgsgraph.geometry.records import Array
from mgsgraph.io.files import understood
from mgsgraph.io.records import read_record
from mgsgraph.output.folders import MATCH
from mgsgraph.ties import PointKind, TiePoints
from mgsgraph.wording import many, some

_SAME_PLACE = 1e-3
"""m, within which two a-priori places of one known point are the same."""


def with_sigmas(
    points: TiePoints, sigma: float, of_images: Mapping[str, float], window: float = 0.0, factor: float = 1.0
) -> TiePoints:
    """The same points with a sigma for every measure: the file's own, or else its image's, or else the group's (px).
    Measures of an image within one window (px, its side) have errors in common, by which their sigmas grow. All of them
    are multiplied by the `factor`.
    """
    default = np.array([of_images.get(name, sigma) for name in points.measure_image], dtype=np.float64)
    sigmas = np.where(np.isnan(points.measure_sigmas), default[:, None], points.measure_sigmas)
    if window > 0.0:
        names = np.array(points.measure_image)
        for name in dict.fromkeys(points.measure_image):
            mine = names == name
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
    held = np.isin(points.measure_image, images)
    if held.all():
        return points, ""
    strange = list(dict.fromkeys(np.array(points.measure_image)[~held].tolist()))
    called = some(strange, len(strange))
    before, after = (
        np.bincount(points.measure_point[mine], minlength=len(points.ids)) for mine in (slice(None), held)
    )
    alone = (points.kinds == PointKind.FREE) & ~np.isin(points.ids, list(known))
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
    ids: dict[str, int] = {}
    places, covariances, kinds, sources = list[Array](), list[Array](), list[int](), list[str]()
    measured: dict[tuple[int, str], str] = {}
    member = []
    for group in groups:
        index = np.empty(len(group.ids), dtype=np.int64)
        for i, name in enumerate(group.ids):
            k = index[i] = ids.setdefault(name, len(ids))
            if k == len(kinds):
                places.append(group.places[i])
                covariances.append(group.covariances[i])
                kinds.append(int(group.kinds[i]))
                sources.append(group.source)
            elif _tells_more(group, i, kinds[k], places[k], covariances[k], sources[k]):
                places[k], covariances[k], kinds[k] = group.places[i], group.covariances[i], int(group.kinds[i])
                sources[k] = group.source
        member.append(index[group.measure_point])
        _require_new_measures(group, member[-1].tolist(), measured)
    return TiePoints(
        source=", ".join(dict.fromkeys(group.source for group in groups)),
        ids=tuple(ids),
        kinds=np.array(kinds, dtype=np.int64),
        places=np.array(places).reshape(-1, 3),
        covariances=np.array(covariances).reshape(-1, 3, 3),
        measure_point=np.concatenate(member),
        measure_image=tuple(name for group in groups for name in group.measure_image),
        measures=np.concatenate([group.measures for group in groups]),
        measure_sigmas=np.concatenate([group.measure_sigmas for group in groups]),
    )


def _tells_more(group: TiePoints, i: int, kind: int, place: Array, covariance: Array, source: str) -> bool:
    """Whether a file knows more of a point than an earlier one; InputError where the two contradict each other."""
    if group.kinds[i] == PointKind.FREE:
        return kind == PointKind.FREE and bool(np.isnan(place[0]))
    if kind == PointKind.FREE:
        return True
    same = np.all(np.abs(group.places[i] - place) < _SAME_PLACE) and np.allclose(group.covariances[i], covariance)
    if kind != group.kinds[i] or not same:
        where = f"{group.source}, point {group.ids[i]}"
        found = f"{PointKind(group.kinds[i]).name.lower()} at another a-priori place or with another covariance"
        raise InputError(where, found, f"what {source} says of it", "make it Free in one of the two")
    return False


def _require_new_measures(group: TiePoints, points: list[int], measured: dict[tuple[int, str], str]) -> None:
    """Enter the measures of a file; InputError for one that an earlier file holds."""
    mine = list(zip(points, group.measure_image, strict=True))
    for k, measure in enumerate(mine):
        if measure in measured:
            where = f"{group.source}, point {group.ids[int(group.measure_point[k])]}, image {measure[1]}"
            found = f"a measure that {measured[measure]} has too"
            raise InputError(where, found, "each measure in one network", "take it out of one of the two")
    measured.update(dict.fromkeys(mine, group.source))

"""Restores content of an adjustment's networks that the adjustment doesn't need in the exported network.

Types of measures, their a-priori places, figures of merit, dates and choosers, and ignored points and measures stand in
the files that were read. A solution remembers these files and their digests (`networks` in solution.json). What can't
be taken back is said.
"""

from collections import Counter
from collections.abc import Collection, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from msgspec import structs

from mgsgraph.errors import require
from mgsgraph.export.exchange_setting import leading
from mgsgraph.files.networks.editing import SAME_PLACE, separation, united, with_measures
from mgsgraph.files.networks.pvl import MEASURE_TYPES
from mgsgraph.files.networks.record import ControlMeasure, ControlNetwork, ControlPoint, Duplicates, PointType
from mgsgraph.files.networks.table import read_whole
from mgsgraph.files.opening import sha256_of, understood
from mgsgraph.files.output.folders import PROGRAM, RECORD
from mgsgraph.files.writing import read_record
from mgsgraph.geometry.body import Ellipsoid
from mgsgraph.text import listed, many, some

ADJUSTED_BY = f"Adjusted by {PROGRAM}"
"""What descriptions of exported networks say."""
_OF_A_PRIORI = ("apriori", "apriori_covariance", "apriori_source")
_CONSTRAINED = ("latitude_constrained", "longitude_constrained", "radius_constrained")
_MISSING = "types, a-priori places, figures of merit and dates of measures"
_NAME_IT = "name the network: --ties NETWORK"


class Sources(NamedTuple):
    """The networks that a solution's points were read from, as far as they still exist."""

    network: ControlNetwork | None
    """All of them as one, as `united` makes it; None where none is there."""
    notes: tuple[str, ...] = ()
    """About those that aren't."""


def source_networks(folder: Path, stated: Sequence[Path], body: Ellipsoid) -> Sources:
    """Read the networks of a solution.

    Parameters
    ----------
    folder : Path
        Of the solution, or its archive.
    stated : sequence of Path
        In place of those that the solution remembers.
    body : Ellipsoid
        To which heights in tables refer.

    Raises
    ------
    InputError
        As the readers do.
    """
    paths, notes = list(stated), list[str]()
    if not stated:
        for path, digest in _remembered(folder):
            if not path.is_file():
                notes.append(f"{path} isn't there any more: {_MISSING} aren't known; {_NAME_IT}")
            elif sha256_of(path) != digest:
                notes.append(f"{path} has changed since the adjustment: nothing is taken from it; {_NAME_IT}")
            else:
                paths.append(path)
    networks = [read_whole(path, body) for path in paths]
    if not networks:
        return Sources(None, tuple(notes) or (f"No network of the points is known, nor {_MISSING}; {_NAME_IT}",))
    points, _ = united(networks, Duplicates.FIRST)
    source = some([str(path) for path in paths])
    return Sources(structs.replace(leading(networks), points=points, source=source), tuple(notes))


def _remembered(folder: Path) -> list[tuple[Path, str]]:
    """Paths and digests of the networks in a solution's record."""
    file = (folder if folder.is_dir() else folder.parent) / RECORD
    if not file.exists():  # an archive alone
        return []
    with understood(f"{file}, networks", "what mgsgraph adjust writes"):
        return [(Path(entry["path"]), str(entry["sha256"])) for entry in read_record(file).get("networks", [])]


class Restored(NamedTuple):
    """A network with its original content, and sentences about the changes."""

    network: ControlNetwork
    notes: tuple[str, ...] = ()


def with_content(adjusted: ControlNetwork, source: ControlNetwork, images: Collection[str]) -> Restored:
    """An adjusted network with all content of its source.

    Parameters
    ----------
    adjusted : ControlNetwork
        Its adjusted places, covariances, residuals and rejections stay, its points and measures that the source
        doesn't have, and its sigmas where the source has none.
    source : ControlNetwork
        Its points come first, in its order; measures in other images are left out, with points that have no other.
    images : collection of str
        Of the adjustment.

    Raises
    ------
    InputError
        If the source has none of the points.
    """
    by_id = {point.id: point for point in adjusted.points}
    points, met = list[ControlPoint](), Counter[str]()
    for original in source.points:
        in_images = [k for k, measure in enumerate(original.measures) if measure.serial_number in images]
        met["elsewhere"] += len(original.measures) - len(in_images)
        own = by_id.pop(original.id, None)
        if not in_images and own is None:
            met["points elsewhere"] += 1
            continue
        original = with_measures(original, in_images)
        if own is None:
            met["unused"] += 1
            points.append(original)
        else:
            met["taken"] += 1
            points.append(_united(original, own, met))
    found = "none of the points that were adjusted"
    require(met["taken"], source.source, found, "the network that was adjusted", "name another one (--ties)")
    network = structs.replace(
        adjusted, points=(*points, *by_id.values()), network_id=source.network_id or adjusted.network_id,
        target_name=source.target_name or adjusted.target_name, created=source.created,
        target_radii=source.target_radii or adjusted.target_radii,
        description=_described(source.description, adjusted.description),
    )  # fmt: skip
    return Restored(network, _notes(met, source.source))


def _united(original: ControlPoint, own: ControlPoint, met: Counter[str]) -> ControlPoint:
    own_measures = {m.serial_number: m for m in own.measures}
    measures = list[ControlMeasure]()
    for measure in original.measures:
        adjusted = None if measure.ignore else own_measures.pop(measure.serial_number, None)
        met["unused measures"] += adjusted is None
        measures.append(measure if adjusted is None else _measure(measure, adjusted, met))
    changed: dict[str, Any] = {name: getattr(own, name) for name in ("jigsaw_rejected", "adjusted",
                                                                     "adjusted_covariance", "type")}  # fmt: skip
    if original.apriori is None or original.type != own.type:
        changed |= {name: getattr(own, name) for name in _OF_A_PRIORI}
    if original.type != own.type and own.type == PointType.CONSTRAINED:
        changed |= dict.fromkeys(_CONSTRAINED, True)
    reference = own.reference if original.reference is None else original.reference
    return structs.replace(original, measures=(*measures, *own_measures.values()), reference=reference, **changed)


def _measure(original: ControlMeasure, adjusted: ControlMeasure, met: Counter[str]) -> ControlMeasure:
    if separation(original, adjusted) > SAME_PLACE:
        met["moved"] += 1
        return adjusted
    met[MEASURE_TYPES[original.type]] += 1
    met["AprioriLine"] += original.apriori_line is not None
    met["GoodnessOfFit"] += any(kind == 2 for kind, _ in original.log)
    met["sigmas"] += original.line_sigma is None or original.sample_sigma is None
    return structs.replace(
        original, line_residual=adjusted.line_residual, sample_residual=adjusted.sample_residual,
        jigsaw_rejected=adjusted.jigsaw_rejected,
        line_sigma=adjusted.line_sigma if original.line_sigma is None else original.line_sigma,
        sample_sigma=adjusted.sample_sigma if original.sample_sigma is None else original.sample_sigma,
    )  # fmt: skip


def _described(before: str, now: str) -> str:
    """A network's description, without that of an earlier adjustment, and the description of this one."""
    own = before.partition(ADJUSTED_BY)[0].rstrip(". ")
    return f"{own}. {now}" if own else now


def _notes(met: Counter[str], source: str) -> tuple[str, ...]:
    types = [f"{met[word]} {word}" for word in MEASURE_TYPES.values() if met[word]]
    places = [f"AprioriLine and AprioriSample of {met['AprioriLine']}"] if met["AprioriLine"] else []
    places += [f"GoodnessOfFit of {met['GoodnessOfFit']}"] if met["GoodnessOfFit"] else []
    sentences = [f"Kept from {source}: {many(met['taken'], 'point')}" +
            (f" with measures ({listed([*types, *places])})" if types else "")]  # fmt: skip
    for word, sentence in (
        ("sigmas", "Not kept: {} without a sigma; the sigmas of the adjustment are written"),
        ("moved", "Not kept: {} with other coordinates than the adjusted ones"),
        ("elsewhere", "Left out: {} in images that were not adjusted"),
    ):
        sentences += [sentence.format(many(met[word], "measure"))] if met[word] else []
    if met["points elsewhere"]:
        sentences.append(f"Left out: {many(met['points elsewhere'], 'point')} that none of the adjusted images sees")
    if met["unused"] or met["unused measures"]:
        what = listed([many(met[word], noun) for word, noun in (("unused", "point"), ("unused measures", "measure"))
                       if met[word]])  # fmt: skip
        sentences.append(f"Without residuals, as the adjustment took nothing of them (ignored ones): {what}")
    return tuple(sentences)

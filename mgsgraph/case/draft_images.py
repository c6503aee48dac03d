"""Which images some files are of, each once, by what file it is best read, and what networks call it."""

import re
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from mgsgraph.case.case_file import plain_image, read_image
from mgsgraph.case.schema import ImageInput, SpiceInput
from mgsgraph.errors import InputError
from mgsgraph.files.cameras.label import read_line_scan_label
from mgsgraph.files.kinds import IMAGES, Kind, image_kind, image_name
from mgsgraph.geometry.body import target_name
from mgsgraph.geometry.image import PushbroomImage
from mgsgraph.geometry.plausibility import twins
from mgsgraph.units import KM

_ORDER = (Kind.CUBE, Kind.CUBE_TABLES, Kind.SUPPORT_DATA, Kind.MODEL_STATE, Kind.MAPPED_CUBE, Kind.PDS3,
          Kind.CUBE_LABEL)  # fmt: skip
"""By which an image is read, if there are several: what holds its geometry before what needs kernels."""
_ALONE = (Kind.CUBE_TABLES, Kind.SUPPORT_DATA, Kind.MODEL_STATE)
"""Kinds that know no serial number; a label whose name begins as theirs has it."""
_LINE_TIMES = "line_times"
"""Key that the reader of a label without times of its lines asks for."""
_PICTURES = (Kind.CUBE, Kind.PDS3, Kind.RASTER, Kind.PICTURE)


class DraftImage(NamedTuple):
    """An image that was read."""

    path: Path
    """Its file."""
    kind: Kind
    """What that is."""
    name: str
    """What to call it."""
    others: frozenset[str]
    """What else networks may call it: product, file."""
    image: PushbroomImage
    """Its geometry."""
    by_kernels: bool
    """Whether it needs those of [spice]."""
    pixels: Path | None = None
    """File of its pixels, where its own file has none and that is called alike."""
    line_times: str | None = None
    """What stands for the times of its lines, where its file doesn't have them."""


class DraftImages(NamedTuple):
    """Images, and what was left out."""

    images: tuple[DraftImage, ...]
    """In the order of their times."""
    left_out: tuple[str, ...]
    """Files and why, a line each."""


def draft_images(kinds: Mapping[Path, Kind], kernels: Sequence[Path]) -> DraftImages:
    """The images among files of some kinds, with kernels that any of them may need."""
    spice = SpiceInput(kernels=tuple(map(str, kernels))) if kernels else None
    files = sorted((path for path, kind in kinds.items() if kind in IMAGES), key=lambda path: (
        _ORDER.index(kinds[path]), len(path.name), path.name.lower()
    ))  # fmt: skip
    labels = [path for path in files if kinds[path] not in _ALONE]
    found, left_out = list[DraftImage](), dict[Path, str]()
    for path, line_times in [*((path, None) for path in files), *((path, "mean") for path in files if kernels)]:
        if line_times and _LINE_TIMES not in left_out.get(path, ""):
            continue
        try:
            made = _read(path, kinds[path], labels, spice, line_times)._replace(pixels=_pixels(path, kinds))
        except InputError as error:
            left_out[path] = str(error)
            continue
        left_out.pop(path, None)
        if (known := _duplicate_of(made, found)) is None:
            taken_names = {one.name for one in found}
            found.append(made._replace(name=f"{path.parent.name}/{made.name}") if made.name in taken_names else made)
            continue
        kept, other = found[known], made
        if made.image.lines * made.image.samples > kept.image.lines * kept.image.samples:  # a cube cut to a stub
            found[known], kept, other = made, made, kept
        left_out[other.path] = f"the same image as {kept.path.name}"
    found, others = _on_one_body(found)
    left_out |= others
    taken = tuple(sorted(found, key=lambda one: _start(one.image)))
    stems = [one.path.stem for one in taken]
    said = [
        f"{path.name}: {without_place(reason, path)}" for path, reason in left_out.items()
        if not any(path.stem.startswith(stem) for stem in stems)  # labels beside what was taken
    ]
    return DraftImages(taken, tuple(said))


def _on_one_body(found: Sequence[DraftImage]) -> tuple[list[DraftImage], dict[Path, str]]:
    """Images on the ellipsoid that most of them have, and why the others on the same body are left out."""
    counts = Counter(one.image.body for one in found)
    kept, left_out = list[DraftImage](), dict[Path, str]()
    for one in found:
        alike = [body for body in counts if target_name(body) == target_name(one.image.body)]
        usual = max(alike, key=counts.__getitem__)
        if one.image.body == usual:
            kept.append(one)
            continue
        radii = [f"{body.equatorial / KM:.3f} and {body.polar / KM:.3f} km" for body in (one.image.body, usual)]
        left_out[one.path] = f"an ellipsoid of {radii[0]}; that of the others has {radii[1]}"
    return kept, left_out


def without_place(reason: str, path: Path) -> str:
    """What is wrong with a file, without the file's place before it."""
    for place in (path, path.absolute(), path.name):
        reason = reason.removeprefix(f"{place}: ").removeprefix(f"{place}, ")
    return reason


def _read(
    path: Path, kind: Kind, labels: Sequence[Path], spice: SpiceInput | None, line_times: str | None = None
) -> DraftImage:
    stated = ImageInput(image=str(path.absolute()), line_times=line_times)
    entry = plain_image(stated, spice, Path(), path.name)
    image = read_image(entry, spice, Path(), path.name)
    names = [entry.name]
    if kind in _ALONE:
        beside = [label for label in labels if label.stem.startswith(path.stem) and label.parent == path.parent]
        names = [*_serials(beside), *names]
    others = frozenset({*names, path.stem, *_products([path, *(labels if kind in _ALONE else [])], path.stem)})
    return DraftImage(path, kind, names[0], others, image, entry.label is not None, None, line_times)


def _pixels(path: Path, kinds: Mapping[Path, Kind]) -> Path | None:
    """A picture that is called as a file without pixels is."""
    if kinds[path] not in _ALONE:
        return None
    return next((one for one, kind in kinds.items() if kind in _PICTURES and one.stem == path.stem), None)


def _serials(labels: Sequence[Path]) -> Iterator[str]:
    for label in labels:
        try:
            yield image_name(label, "label" if image_kind(label, True) == "label" else "cube")
        except InputError:
            continue


def _products(labels: Sequence[Path], stem: str) -> Iterator[str]:
    for label in labels:
        if label.stem.startswith(stem):
            try:
                yield read_line_scan_label(label).product
            except InputError:
                continue


def _duplicate_of(made: DraftImage, found: Sequence[DraftImage]) -> int | None:
    """The image that a new one is again, by its geometry or its name."""
    images = [*(one.image for one in found), made.image]
    same = [one for one, other in twins(images) if other == len(found)]
    if made.name != made.path.stem:  # a serial number
        same += [k for k, one in enumerate(found) if one.name == made.name]
    return next(iter(same), None)


def _start(image: PushbroomImage) -> float:
    """S TDB past J2000."""
    return float(image.trajectory.epoch + image.timing.at(np.zeros(1))[0][0])


def named_as(images: Sequence[DraftImage], names: Sequence[str]) -> tuple[tuple[DraftImage, ...], tuple[str, ...]]:
    """Images called as networks call them, and names of networks for which there is no image.

    By the serial number, the product or the file.
    """
    known, made = {_plain(name): name for name in reversed(names)}, list(images)
    for k, one in enumerate(images):
        if one.name not in names and (same := [known[other] for other in map(_plain, one.others) if other in known]):
            made[k] = one._replace(name=min(same))
    return tuple(made), tuple(name for name in names if name not in {one.name for one in made})


def _plain(name: str) -> str:
    """Letters and digits of a name: products are written with a slash, a hyphen or neither."""
    return re.sub(r"[^a-z0-9]", "", name.lower())

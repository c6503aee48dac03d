"""Finds the images of files, each once: the file that it is best read from, and its name in networks."""

import re
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from glob import escape
from pathlib import Path
from typing import NamedTuple

from mgsgraph.case.case_file import plain_image, read_image
from mgsgraph.case.resection import nominal_image
from mgsgraph.case.schema import ImageInput, SpiceInput
from mgsgraph.errors import InputError
from mgsgraph.files.cameras.label import read_line_scan_label
from mgsgraph.files.kinds import IMAGES, Kind, image_kind, image_name, kind_of
from mgsgraph.geometry.body import target_name
from mgsgraph.geometry.image import PushbroomImage
from mgsgraph.geometry.plausibility import duplicate_images
from mgsgraph.units import KM

_ORDER = (Kind.CUBE, Kind.CUBE_TABLES, Kind.SUPPORT_DATA, Kind.MODEL_STATE, Kind.MAPPED_CUBE, Kind.PDS3,
          Kind.CUBE_LABEL)  # fmt: skip
"""By which an image is read, if there are several: what holds its geometry before what needs kernels."""
_NO_SERIAL = (Kind.CUBE_TABLES, Kind.SUPPORT_DATA, Kind.MODEL_STATE)
"""Kinds that know no serial number; a label whose name begins as theirs has it."""
_LABELS = tuple(kind for kind in IMAGES if kind not in _NO_SERIAL)
_LINE_TIMES = "line_times"
"""Key that the reader of a label without times of its lines asks for."""
_SAME_START = 1.0
"""s; labels round the time of the first line."""
_PICTURES = (Kind.CUBE, Kind.PDS3, Kind.RASTER, Kind.PICTURE)


class DraftImage(NamedTuple):
    """An image that was read."""

    path: Path
    """Its file."""
    kind: Kind
    """What that is."""
    name: str
    """What to call it."""
    aliases: frozenset[str]
    """What else networks may call it: product, file."""
    image: PushbroomImage
    """Its geometry."""
    by_kernels: bool
    """Whether it needs those of [spice]."""
    pixels: Path | None = None
    """File of its pixels, where its own file has none and a picture has its name."""
    line_times: str | None = None
    """What stands for the times of its lines, where its file doesn't have them."""
    resected: bool = False
    """Whether nothing but its label says how it was taken (`case.resection`)."""


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
    labels = [path for path in files if kinds[path] not in _NO_SERIAL]
    labels += sorted({  # beside files that were given by name: they are asked for serial numbers alone
        path for file in files if kinds[file] in _NO_SERIAL for path in file.parent.glob(f"{escape(file.stem)}.*")
        if path not in kinds and kind_of(path) in _LABELS
    })  # fmt: skip
    drafts, left_out = list[DraftImage](), dict[Path, str]()
    for path, line_times in [*((path, None) for path in files), *((path, "mean") for path in files if kernels)]:
        if line_times and _LINE_TIMES not in left_out.get(path, ""):
            continue
        try:
            draft = _read(path, kinds[path], labels, spice, line_times)._replace(pixels=_pixels(path, kinds))
        except InputError as error:
            left_out[path] = str(error)
            continue
        left_out.pop(path, None)
        if (duplicate := _duplicate_of(draft, drafts)) is None:
            names = {d.name for d in drafts}
            drafts.append(draft._replace(name=f"{path.parent.name}/{draft.name}") if draft.name in names else draft)
            continue
        chosen, other = drafts[duplicate], draft
        if draft.image.lines * draft.image.samples > chosen.image.lines * chosen.image.samples:  # a cube cut to a stub
            drafts[duplicate], chosen, other = draft, draft, chosen
        left_out[other.path] = f"the same image as {chosen.path.name}"
    drafts, excluded = _on_one_body(drafts)
    left_out |= excluded
    if spice is None:
        drafts += _resected([path for path in files if path in left_out], kinds, drafts, left_out)
    ordered = tuple(sorted(drafts, key=lambda draft: float(draft.image.span[0])))
    stems = [draft.path.stem for draft in ordered]
    reasons = [
        f"{path.name}: {without_place(reason, path)}" for path, reason in left_out.items()
        if not any(path.stem.startswith(stem) for stem in stems)  # labels beside what was taken
    ]
    return DraftImages(ordered, tuple(reasons))


def _resected(
    files: Sequence[Path], kinds: Mapping[Path, Kind], drafts: Sequence[DraftImage], left_out: dict[Path, str]
) -> list[DraftImage]:
    """Images of labels without kernels, as if they showed what the first other image shows; taken out of those that are
    left out. Those at the time of another image are a second file of that.
    """
    resected = list[DraftImage]()
    for path in files if drafts else ():
        try:
            label, like = read_line_scan_label(path), drafts[0].image
            image = nominal_image(label, like, like.image_to_ground(*like.middle)[0][0])
        except InputError:  # why it is left out is said
            continue
        same = [d for d in (*drafts, *resected) if abs(d.image.span[0] - image.span[0]) < _SAME_START]
        if same:
            left_out[path] = f"the same image as {same[0].path.name}"
            continue
        del left_out[path]
        aliases = frozenset({label.serial, label.product, path.stem})
        resected.append(DraftImage(path, kinds[path], label.serial, aliases, image, False, resected=True))
    return resected


def _on_one_body(drafts: Sequence[DraftImage]) -> tuple[list[DraftImage], dict[Path, str]]:
    """Images on the ellipsoid that most of them have, and why the others on the same body are left out."""
    counts = Counter(draft.image.body for draft in drafts)
    chosen, left_out = list[DraftImage](), dict[Path, str]()
    for draft in drafts:
        bodies = [body for body in counts if target_name(body) == target_name(draft.image.body)]
        usual = max(bodies, key=counts.__getitem__)
        if draft.image.body == usual:
            chosen.append(draft)
            continue
        radii = [f"{body.equatorial / KM:.3f} and {body.polar / KM:.3f} km" for body in (draft.image.body, usual)]
        left_out[draft.path] = f"an ellipsoid of {radii[0]}; that of the others has {radii[1]}"
    return chosen, left_out


def without_place(reason: str, path: Path) -> str:
    """A message about a file, without the file's path before it."""
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
    if kind in _NO_SERIAL:
        beside = [label for label in labels if label.stem.startswith(path.stem) and label.parent == path.parent]
        names = [*_serials(beside), *names]
    aliases = frozenset({*names, path.stem, *_products([path, *(labels if kind in _NO_SERIAL else [])], path.stem)})
    return DraftImage(path, kind, names[0], aliases, image, entry.label is not None, None, line_times)


def _pixels(path: Path, kinds: Mapping[Path, Kind]) -> Path | None:
    """The picture that has the name of a file without pixels."""
    if kinds[path] not in _NO_SERIAL:
        return None
    return next((file for file, kind in kinds.items() if kind in _PICTURES and file.stem == path.stem), None)


def _serials(labels: Sequence[Path]) -> Iterator[str]:
    for label in labels:
        with suppress(InputError):
            yield image_name(label, "label" if image_kind(label, True) == "label" else "cube")


def _products(labels: Sequence[Path], stem: str) -> Iterator[str]:
    for label in labels:
        if label.stem.startswith(stem):
            with suppress(InputError):
                yield read_line_scan_label(label).product


def _duplicate_of(draft: DraftImage, drafts: Sequence[DraftImage]) -> int | None:
    """Number of the image that a new one duplicates, by geometry or name; None without one."""
    images = [*(other.image for other in drafts), draft.image]
    same = [first for first, other in duplicate_images(images) if other == len(drafts)]
    if draft.name != draft.path.stem:  # a serial number
        same += [k for k, other in enumerate(drafts) if other.name == draft.name]
    return next(iter(same), None)


def named_as(images: Sequence[DraftImage], names: Sequence[str]) -> tuple[tuple[DraftImage, ...], tuple[str, ...]]:
    """Images called as networks call them, and names of networks for which there is no image.

    By the serial number, the product or the file.
    """
    plain, renamed = {_plain(name): name for name in reversed(names)}, list(images)
    for k, draft in enumerate(images):
        if draft.name not in names and (same := [plain[a] for a in map(_plain, draft.aliases) if a in plain]):
            renamed[k] = draft._replace(name=min(same))
    return tuple(renamed), tuple(name for name in names if name not in {draft.name for draft in renamed})


def _plain(name: str) -> str:
    """Letters and digits of a name: products are written with a slash, a hyphen or neither."""
    return re.sub(r"[^a-z0-9]", "", name.lower())

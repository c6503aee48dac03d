"""A case file read: its tables, and each image by what its file is, one by one or in an ISIS list, and by what name."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import msgspec

from mgsgraph.case.schema import CaseInput, ImageInput, SpiceInput
from mgsgraph.errors import InputError, errors_from
from mgsgraph.files.decoding import CASE_FILE, read_toml, validated
from mgsgraph.files.kinds import Kind, kind_of, listed_names
from mgsgraph.files.labels.image_kinds import ImageKind, image_kind, image_name
from mgsgraph.files.opening import read_text

_FILES: tuple[ImageKind, ...] = ("isd", "state", "label", "cube")
_OF_KINDS: dict[str, tuple[ImageKind, ...]] = {
    "kernels": ("label",), "constants": ("label",), "focal_length_m": ("label",), "attitude_bias_s": ("label",),
    "position_bias_s": ("label",), "line_times": ("label",), "aberration": ("isd", "cube"), "observer": ("isd", "cube"),
}  # fmt: skip
"""Keys that say something of files of some kinds alone."""
_FORMER = {
    "strips": ("[[passes]] with a prior", "prior = {} has the defaults of strips; [strips.prior] is [passes.prior]"),
    "mola": ("[[shots]]", "its key pedr is file"),
    "pedr": ("file", ""),
    "leap_seconds": ("no such key: leap seconds are built in", "take it out"),
}
"""Words of earlier versions: those of today, and what else to change."""


def decode(path: Path) -> CaseInput:
    """A case file's tables, validated; `image` and `list` replaced by the key of each file's kind, all images named.

    Raises
    ------
    InputError
        With the place of what is wrong: an unknown key, a value out of range; an image given in two ways or none, a
        list without files, files that are no images, or one name for two.
    """
    wanted = stated(path)
    images = list[ImageInput]()
    for k, entry in enumerate(wanted.images):
        where = f"{path}, images[{k}]"
        with errors_from(where):
            images += [plain_image(one, wanted.spice, path.parent, where) for one in _listed(entry, path.parent, where)]
    first = dict[str, ImageInput]()
    for image in images:
        if (twin := first.setdefault(image.name, image)) is not image:
            found = f"the name {image.name!r} for {image_file(twin)} and for {image_file(image)}"
            raise InputError(f"{path}, images", found, "each image once", "rename one of the two, or take it out")
    return msgspec.structs.replace(wanted, images=tuple(images))


def stated(path: Path) -> CaseInput:
    """A case file's tables, validated, its images as it has them; InputError with the place of what is wrong."""
    try:
        toml = read_toml(path, CASE_FILE)
    except InputError:
        _refuse_other_kinds(path)
        raise
    _refuse_former(toml.tables, str(path))
    return validated(toml, CaseInput, path, "all keys: mgsgraph help case")


def _refuse_former(value: Any, where: str) -> None:
    """Raise InputError for a table or key of an earlier version, and name the word of today."""
    for one in value if isinstance(value, list) else [value]:
        for key, inner in one.items() if isinstance(one, dict) else ():
            expected, remedy = _FORMER.get(key, ("", ""))
            if key.endswith("_mgon"):
                expected, remedy = f"{key.removesuffix('mgon')}mrad", "1 mgon is 0.015708 mrad"
            if expected:
                raise InputError(f"{where}, {key}", "a word of earlier versions", expected, remedy)
            _refuse_former(inner, f"{where}, {key}")


def _refuse_other_kinds(path: Path) -> None:
    """Raise InputError for data, or a folder of them, in the place of a case file, and say how to come by one."""
    kind = "a folder" if path.is_dir() else kind_of(path)
    if kind not in (None, Kind.CASE):
        raise InputError(str(path), str(kind), "a case file (TOML)", f"make one: mgsgraph new {path}")


def plain_image(entry: ImageInput, spice: SpiceInput | None, folder: Path, where: str) -> ImageInput:
    """An image whose file stands under the key of its kind (`isd`, `state`, `label`, `cube`), with a name."""
    given = [key for key in ("image", *_FILES) if getattr(entry, key) is not None]
    if len(given) != 1:
        found = f"both {given[0]} and {given[1]}" if given else "no file of the image"
        raise InputError(where, found, "one of image, list, isd, state, label and cube")
    if entry.image is not None:
        kernels = entry.kernels or (spice.kernels if spice else ())
        kind = image_kind(folder / entry.image, bool(entry.kernels), bool(kernels))
        entry = msgspec.structs.replace(entry, image=None, **{kind: entry.image})
    kind = next(key for key in _FILES if getattr(entry, key) is not None)
    _require_heeded(entry, kind, where)
    return entry if entry.name else msgspec.structs.replace(entry, name=image_name(folder / image_file(entry), kind))


def _require_heeded(entry: ImageInput, kind: ImageKind, where: str) -> None:
    """Raise InputError for a key that has no meaning for this kind of file: it would change nothing, unsaid."""
    untold = ImageInput()
    for key, kinds in _OF_KINDS.items():
        if kind not in kinds and getattr(entry, key) != getattr(untold, key):
            found = f"{key} for {image_file(entry)}, which is read as {kind}"
            raise InputError(where, found, f"it for {' or '.join(kinds)}", "take it out")


def image_file(entry: ImageInput) -> str:
    """The file that says an image's geometry, as its plain entry has it."""
    return next(str(getattr(entry, key)) for key in _FILES if getattr(entry, key) is not None)


def _listed(entry: ImageInput, folder: Path, where: str) -> Iterator[ImageInput]:
    """An entry for each file of its ISIS list (one file in every line), or itself."""
    if entry.list is None:
        yield entry
        return
    if entry.name or any(getattr(entry, key) is not None for key in ("image", *_FILES, "pixels")):
        raise InputError(where, "a list beside the name or the file of one image", "the list alone")
    place = folder / entry.list
    names = listed_names(read_text(place))
    if not names:
        raise InputError(str(place), "no file", "the name of an image file in every line")
    for number, name in names:
        if not (place.parent / name).is_file():
            expected = "a file, relative to the list's folder"
            raise InputError(f"{place}, line {number}", f"{name!r}, which is not there", expected)
    for _, name in names:
        yield msgspec.structs.replace(entry, list=None, image=str(Path(entry.list).parent / name))

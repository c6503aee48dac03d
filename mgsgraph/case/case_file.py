"""Reads a case file: its tables, and each image by the kind of its file, one by one or in an ISIS list, and its name.

Tables and keys of a case file, as its schema has them: for `mgsgraph new --keys`, and for docs/case_file.md.
"""

import json
import textwrap
import types
import typing
from collections.abc import Collection, Iterator, Sequence
from dataclasses import replace
from difflib import get_close_matches
from functools import cache
from pathlib import Path
from typing import Any, Literal, NamedTuple

import msgspec

from mgsgraph.adjustment.settings import SolverSettings
from mgsgraph.case.passes import mounted_images
from mgsgraph.case.resection import resected_images
from mgsgraph.case.schema import CaseInput, ImageInput, OrientationInput, SolverInput, SpiceInput
from mgsgraph.errors import InputError, command_line, errors_from, require
from mgsgraph.files.decoding import CASE_FILE, read_toml, validated
from mgsgraph.files.kinds import ImageKind, Kind, image_kind, image_name, kind_of, listed_names, refuse_foreign_kinds
from mgsgraph.files.labels.aberration import Aberration
from mgsgraph.files.output.folders import PROJECT
from mgsgraph.files.pvl import instrument_of
from mgsgraph.files.support_data.isd import read_isd
from mgsgraph.geometry.image import PushbroomImage
from mgsgraph.geometry.plausibility import require_distinct, require_plausible
from mgsgraph.record import meanings

_FILES: tuple[ImageKind, ...] = ("isd", "state", "label", "cube")
_OF_KINDS: dict[str, tuple[ImageKind, ...]] = {
    "kernels": ("label",), "constants": ("label",), "focal_length_m": ("label",), "attitude_bias_s": ("label",),
    "position_bias_s": ("label",), "line_times": ("label",), "aberration": ("isd", "cube"), "observer": ("isd", "cube"),
    "resection": ("label", "cube"),
}  # fmt: skip
"""Keys that say something of files of some kinds alone."""
_FORMER = {
    "model = jitter": ("[[passes.vibrations]]", "frequency_hz and sigma_mrad of a sine, or vibrations = 'estimated'"),
    "strips": ("[[passes]] with a prior", "prior = {} has the defaults of strips; [strips.prior] is [passes.prior]"),
    "mola": ("[[shots]]", "its key pedr is file"),
    "pedr": ("file", ""),
    "form": ("no choice of the form: every adjustment eliminates its points", "take it out"),
    "method": ("no choice of the solver's method", "take it out"),
    "tracks": ("radius", "a grid made of them: MEGDR (mgsgraph fetch), or gdal_grid's GeoTIFF"),
    "longest_edge_m": ("no such key: tracks are not triangulated", "take it out"),
    "post_step_deg": ("no such key: tracks are not triangulated", "take it out"),
    "basis": ("no such key: third-order polynomials through the four nearest nodes", "take it out"),
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
    tables = stated(path)
    for file in _files(tables) if tables.files_from else ():
        require((path.parent / file).exists(), str(path.parent / file), "no such file", remedy=tables.files_from)
    images = list[ImageInput]()
    for k, entry in enumerate(tables.images):
        where = f"{path}, images[{k}]"
        with errors_from(where):
            images += [plain_image(f, tables.spice, path.parent, where) for f in _listed(entry, path.parent, where)]
    first = dict[str, ImageInput]()
    for image in images:
        if (twin := first.setdefault(image.name, image)) is not image:
            found = f"the name {image.name!r} for {image_file(twin)} and for {image_file(image)}"
            raise InputError(f"{path}, images", found, "each image once", "rename one of the two, or take it out")
    return msgspec.structs.replace(tables, images=tuple(images))


def _files(tables: CaseInput) -> Iterator[str]:
    """Files of images and lists of them, as the case has them."""
    for entry in tables.images:
        yield from filter(None, (getattr(entry, key) for key in ("list", "image", *_FILES)))


def stated(path: Path) -> CaseInput:
    """A case file's tables, validated, its images as it has them; InputError with the place of what is wrong."""
    try:
        toml = read_toml(path, CASE_FILE)
    except InputError:
        _refuse_other_kinds(path)
        raise
    _refuse_former(toml.tables, str(path))
    return validated(toml, CaseInput, path, "all keys: mgsgraph new --keys")


def _refuse_former(value: Any, where: str) -> None:
    """Raise InputError for a table or key of an earlier version, and name today's word."""
    for table in value if isinstance(value, list) else [value]:
        for key, inner in table.items() if isinstance(table, dict) else ():
            expected, remedy = _FORMER.get(key) or _FORMER.get(f"{key} = {inner}", ("", ""))
            if key.endswith("_mgon"):
                expected, remedy = f"{key.removesuffix('mgon')}mrad", "1 mgon is 0.015708 mrad"
            require(not expected, f"{where}, {key}", "a word of earlier versions", expected, remedy)
            _refuse_former(inner, f"{where}, {key}")


def _refuse_other_kinds(path: Path) -> None:
    """Raise InputError for data, or a folder of them, in the place of a case file, and say how to make one."""
    if (path / PROJECT).is_file():
        solve, status = (command_line("project", verb, path) for verb in ("solve", "status"))
        remedy = f"{solve} adjusts it, {status} says what is in it"
        raise InputError(str(path), "a project", "a case file (TOML)", remedy)
    kind = "a folder" if path.is_dir() else kind_of(path)
    remedy = f"make one: {command_line('new', path)}"
    require(kind in (None, Kind.CASE), str(path), str(kind), "a case file (TOML)", remedy)


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
    _require_supported(entry, kind, where)
    refuse_foreign_kinds(folder / image_file(entry))
    return entry if entry.name else msgspec.structs.replace(entry, name=image_name(folder / image_file(entry), kind))


def _require_supported(entry: ImageInput, kind: ImageKind, where: str) -> None:
    """Raise InputError for a key that this kind of file ignores."""
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
    for name in listed_names(folder / entry.list):
        yield msgspec.structs.replace(entry, list=None, image=str(Path(entry.list).parent / name))


def read_images(
    tables: CaseInput, orientations: Sequence[OrientationInput], of_passes: Sequence[Sequence[int]], path: Path
) -> tuple[PushbroomImage, ...]:
    """All images.

    Parameters
    ----------
    tables : CaseInput
        The case file.
    orientations : sequence of OrientationInput
        Of each image.
    of_passes : sequence
        Images of each pass.
    path : Path
        Where the case file is.
    """
    by_number = dict[int, PushbroomImage]()
    entries = tables.passes
    for k, (entry, of_pass) in enumerate(zip(entries, of_passes, strict=True)):
        _require_of_pass(tables, orientations, of_pass, f"{path}, passes[{k}]{entry.name and f' ({entry.name})'}")
        if not entry.sorted_by_time:  # else which of them are one pass isn't known yet
            by_number |= _hrsc_images(tables, of_pass, path)
    by_number |= _with_files(tables, by_number, path)
    by_number |= resected_images(tables, by_number, path)
    images = tuple(orientation.nominal_of(by_number[j]) for j, orientation in enumerate(orientations))
    images = mounted_images(tables.mountings, instruments(tables, path), images, str(path))
    require_distinct(images, f"{path}, images")
    return images


def image_of(tables: CaseInput, number: int, path: Path) -> PushbroomImage:
    """One image of the case file at a path, with those that it rests on (`case.resection`) where that is so."""
    if tables.images[number].resection is not None:
        return resected_images(tables, _with_files(tables, (), path), path)[number]
    return read_image(tables.images[number], tables.spice, path.parent, f"{path}, images[{number}]")


def _with_files(tables: CaseInput, done: Collection[int], path: Path) -> dict[int, PushbroomImage]:
    """Images whose orbit files say, by their numbers, but for those that are done."""
    numbers = [j for j, entry in enumerate(tables.images) if j not in done and entry.resection is None]
    return {j: image_of(tables, j, path) for j in numbers}


def instruments(tables: CaseInput, path: Path) -> list[str]:
    """What the file of each image calls its instrument, in capitals, if [[mountings]] ask for it; else empty."""
    needed = any(mounting.instrument for mounting in tables.mountings)
    files = [entry.label or entry.cube if needed else None for entry in tables.images]
    return [instrument_of(path.parent / file) if file is not None else "" for file in files]


def _require_of_pass(
    tables: CaseInput, orientations: Sequence[OrientationInput], of_pass: Sequence[int], where: str
) -> None:
    """Raise InputError where the table of an image contradicts its pass."""
    for j in of_pass:
        entry = tables.images[j]
        if entry.held:
            raise InputError(where, f"image {entry.name}, which is held", "adjusted images", "take one of the two out")
        if entry.orientation is not None or entry.resection is not None:
            table = "a resection" if entry.resection else "an orientation table"
            found = f"image {entry.name}, which has {table} of its own"
            raise InputError(where, found, "images that their pass says it for", "take one of the two out")
        if (nominal := orientations[j].nominal) != "trajectory":
            found = f"image {entry.name} with nominal = {nominal!r}"
            raise InputError(where, found, "the trajectory itself, which all images share", "nominal = 'trajectory'")


def _hrsc_images(tables: CaseInput, of_pass: Sequence[int], path: Path) -> dict[int, PushbroomImage]:
    """HRSC images of a pass that have the same kernels and settings, on one trajectory record, by their number."""
    groups, folder = dict[tuple[object, ...], list[int]](), path.parent
    for j in of_pass:
        entry = tables.images[j]
        if entry.isd is None and entry.label is not None and instrument_of(folder / entry.label) == "HRSC":
            key = (_kernels(entry, tables.spice), entry.constants, entry.attitude_bias_s, entry.position_bias_s)
            groups.setdefault(key, []).append(j)
    return {
        j: image
        for members in groups.values()
        if len(members) > 1
        for j, image in zip(members, _hrsc_pass([tables.images[j] for j in members], tables.spice, path), strict=True)
    }


def _hrsc_pass(entries: Sequence[ImageInput], spice: SpiceInput | None, path: Path) -> list[PushbroomImage]:
    from mgsgraph.files.labels.labelled_image import read_pass_images, with_focal_length

    folder, first = path.parent, entries[0]
    images = read_pass_images(
        [folder / entry.label for entry in entries if entry.label is not None],
        _required_kernels(first, spice, folder, f"{path}, image {first.name}"),
        [entry.name for entry in entries],
        constants=first.constants,
        attitude_bias=first.attitude_bias_s,
        position_bias=first.position_bias_s,
        interval=spice.sampling_s if spice else 0.1,
        line_times=[_line_times(entry, folder) for entry in entries],
    )
    return [
        _plausible(replace(image, interior=with_focal_length(image.interior, entry.focal_length_m)), entry, folder)
        for image, entry in zip(images, entries, strict=True)
    ]


def _kernels(entry: ImageInput, spice: SpiceInput | None) -> tuple[str, ...]:
    return entry.kernels or (spice.kernels if spice else ())


def _required_kernels(entry: ImageInput, spice: SpiceInput | None, folder: Path, where: str) -> list[Path]:
    kernels = _kernels(entry, spice)
    require(kernels, where, "a label without kernels", "kernels = [...] here or in [spice]")
    return [folder / kernel for kernel in kernels]


def read_image(entry: ImageInput, spice: SpiceInput | None, folder: Path, where: str) -> PushbroomImage:
    """By an image's plain entry (`case_file.plain_image`), if it can be; `where` names the table in errors."""
    if entry.resection is not None:
        raise InputError(where, "a resection", "an image of a case, whose ties others share", "name its kernels")
    return _plausible(_read(entry, spice, folder, where), entry, folder)


def _plausible(image: PushbroomImage, entry: ImageInput, folder: Path) -> PushbroomImage:
    require_plausible(image, str(folder / image_file(entry)))
    return image


def _read(entry: ImageInput, spice: SpiceInput | None, folder: Path, where: str) -> PushbroomImage:
    stated = Aberration(entry.aberration, entry.observer) if entry.aberration else None
    if entry.cube is not None:
        from mgsgraph.files.labels.isis_cube import read_isis_cube

        return read_isis_cube(folder / entry.cube, entry.name, stated)
    if entry.isd is not None:
        return read_isd(folder / entry.isd, entry.name, stated)
    if entry.state is not None:
        from mgsgraph.files.support_data.model_state import read_model_state

        return read_model_state(folder / entry.state, entry.name)
    from mgsgraph.files.labels.labelled_image import (
        read_labelled_image,  # SPICE takes its time to load: those who need it wait
    )

    assert entry.label is not None
    return read_labelled_image(
        folder / entry.label,
        _required_kernels(entry, spice, folder, where),
        entry.name,
        focal_length=entry.focal_length_m,
        constants=entry.constants,
        attitude_bias=entry.attitude_bias_s,
        position_bias=entry.position_bias_s,
        interval=spice.sampling_s if spice else 0.1,
        line_times=_line_times(entry, folder),
    )


def _line_times(entry: ImageInput, folder: Path) -> Path | Literal["mean"] | None:
    if entry.line_times is None:
        return None
    return "mean" if entry.line_times == "mean" else folder / entry.line_times


HEAD = "head"
"""What the keys before the first table go by."""
_WORDS = {str: "text", float: "number", int: "whole number", bool: "true or false", types.NoneType: ""}
_Kind = type[msgspec.Struct]


class Key(NamedTuple):
    """What a case file may say in one place."""

    name: str
    """The key; the unit of its value stands at its end."""
    kind: str
    """What its value is: text, number, list of them, one of some words."""
    default: str
    """What holds where it is left out; empty where nothing does."""
    required: bool
    """Whether it must be there."""
    meaning: str
    """In one or two sentences."""


class KeyTable(NamedTuple):
    """One table of a case file."""

    path: str
    """Its keys, with dots between them; empty at the head of the file."""
    head: str
    """As it stands in the file: ``[ties]``, ``[[images]]``."""
    meaning: str
    """What it says."""
    keys: tuple[Key, ...]
    """In the schema's order, without those that are tables of their own."""


@cache
def key_tables() -> tuple[KeyTable, ...]:
    """All tables, a table's own tables after it."""
    return tuple(_tables("", CaseInput, False))


def _tables(path: str, kind: _Kind, several: bool) -> Iterator[KeyTable]:
    fields = msgspec.structs.fields(kind)
    keys = tuple(_key(field, kind) for field in fields)
    head = (f"[[{path}]]" if several else f"[{path}]") if path else "At the head of the file"
    yield KeyTable(path, head, " ".join((kind.__doc__ or "").split()), keys)
    for field in fields:
        below = _record(field.type)
        if below is not None and not (path and field.name == "orientation"):  # an image's is as that of all
            yield from _tables(f"{path}.{field.name}".lstrip("."), below, "tuple" in str(field.type))


def _record(hint: Any) -> _Kind | None:
    """The record within a type, if there is one."""
    if isinstance(hint, type) and issubclass(hint, msgspec.Struct):
        return hint
    return next((record for part in typing.get_args(hint) if (record := _record(part)) is not None), None)


def _key(field: msgspec.structs.FieldInfo, kind: _Kind) -> Key:
    meaning = meanings(SolverSettings if kind is SolverInput else kind)[field.name]  # the same names, said there
    return Key(field.name, _words(field.type), _default(field), field.required, meaning)


def _words(hint: Any) -> str:
    """A type in words."""
    origin, parts = typing.get_origin(hint), typing.get_args(hint)
    if origin is typing.Annotated:
        return _words(parts[0])
    if origin is typing.Literal:
        return ", ".join(f'"{word}"' for word in parts)
    if origin in (typing.Union, types.UnionType):
        return " or ".join(dict.fromkeys(filter(None, map(_words, parts))))
    if origin in (tuple, list):
        if _record(parts[0]) is not None:
            return "tables"
        plural = {"text": "texts", "number": "numbers", "whole number": "whole numbers"}
        count = "list of" if origin is list or parts[-1] is Ellipsis else f"list of {len(parts)}"
        return f"{count} {plural.get(_words(parts[0]), _words(parts[0]))}"
    return "table" if _record(hint) is not None else _WORDS.get(hint, getattr(hint, "__name__", str(hint)))


def _default(field: msgspec.structs.FieldInfo) -> str:
    value = field.default
    if value is msgspec.NODEFAULT or value in (None, "", ()) or isinstance(value, msgspec.Struct):
        return ""
    if isinstance(value, str):
        return f'"{value}"'
    return f"{str(value).lower() if isinstance(value, bool) else list(value) if isinstance(value, tuple) else value}"


def keys_text(table: str | None = None, width: int = 110) -> str:
    """Tables and keys as text for the terminal: all, or one table by its name (as ``images``, ``[[images]]``,
    ``passes.nodes``, ``head``); InputError, with the nearest, for one that there isn't.
    """
    if table is None:
        text = "\n\n".join(_table_text(entry, width) for entry in key_tables())
        return f"{text}\n\nPaths are relative to the file. One table alone: mgsgraph new --keys TABLE"
    names = {entry.path or HEAD: entry for entry in key_tables()}
    header = table.strip("[]").lower()
    if header not in names:
        last = {name.split(".")[-1]: name for name in names}
        near = last.get(header) or next(iter(get_close_matches(header, names, n=1)), "")
        remedy = f"did you mean {near}?" if near else f"there are {', '.join(names)}"
        raise InputError(f"case file, {table}", "no such table", remedy=remedy)
    chosen = names[header]
    below = [entry for entry in key_tables() if chosen.path and entry.path.startswith(f"{chosen.path}.")]
    return "\n\n".join(_table_text(entry, width) for entry in (chosen, *below))


def _table_text(table: KeyTable, width: int) -> str:
    lines = [table.head, *textwrap.wrap(table.meaning, width - 2, initial_indent="  ", subsequent_indent="  ")]
    for key in table.keys:
        requirement = "must be there" if key.required else f"default {key.default}" if key.default else ""
        lines.append(f"  {key.name} ({'; '.join(filter(None, (key.kind, requirement)))})")
        lines += textwrap.wrap(key.meaning, width - 6, initial_indent=" " * 6, subsequent_indent=" " * 6)
    return "\n".join(lines)


# --- case files that are written

Value = str | float | Sequence["str | float"] | dict[str, "Value"]
"""Of a key in a case file."""
Tables = list[str]
"""Lines of a case file."""


def case_text(name: str, lines: Tables) -> str:
    """A case file of this name with these lines."""
    return "\n".join(["format = 1", f"name = {toml_value(name)}", *lines, ""])


def toml_lines(header: str, **values: Value) -> Tables:
    """A TOML table, after an empty line."""
    return ["", header, *(f"{key} = {toml_value(value)}" for key, value in values.items())]


def toml_value(value: Value) -> str:
    """A value as TOML writes it."""
    if isinstance(value, str | bool):
        return json.dumps(value, ensure_ascii=False)
    if isinstance(value, dict):
        return f"{{ {', '.join(f'{key} = {toml_value(inner)}' for key, inner in value.items())} }}"
    return repr(value) if isinstance(value, int | float) else f"[{', '.join(toml_value(item) for item in value)}]"

"""Images of a case, by support data or by labels and kernels; those of one pass on one trajectory."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Literal

from mgsgraph.case.case_file import image_file
from mgsgraph.case.mountings import mounted_images
from mgsgraph.case.passes import table_names
from mgsgraph.case.schema import CaseInput, ImageInput, OrientationInput, SpiceInput
from mgsgraph.errors import InputError
from mgsgraph.files.labels.aberration import Aberration
from mgsgraph.files.labels.image_label import instrument_of
from mgsgraph.files.support_data.isd import read_isd
from mgsgraph.geometry.duplicate_images import require_distinct
from mgsgraph.geometry.image import PushbroomImage
from mgsgraph.geometry.plausibility import require_plausible


def read_images(
    wanted: CaseInput, orientations: Sequence[OrientationInput], of_passes: Sequence[Sequence[int]], path: Path
) -> tuple[PushbroomImage, ...]:
    """All images.

    Parameters
    ----------
    wanted : CaseInput
        The case file.
    orientations : sequence of OrientationInput
        Of each image.
    of_passes : sequence
        Images of each pass.
    path : Path
        Where the case file is.
    """
    found = dict[int, PushbroomImage]()
    entries = wanted.passes
    for table, entry, mine in zip(table_names(entries), entries, of_passes, strict=True):
        _require_of_pass(wanted, orientations, mine, f"{path}, {table}{f' ({entry.name})' if entry.name else ''}")
        if not entry.sorted_by_time:  # else which of them are one pass isn't known yet
            found |= _together(wanted, mine, path)
    for j, (image, orientation) in enumerate(zip(wanted.images, orientations, strict=True)):
        if j not in found:
            found[j] = read_image(image, wanted.spice, path.parent, f"{path}, images[{j}]")
        found[j] = orientation.nominal_of(found[j])
    images = tuple(found[j] for j in range(len(wanted.images)))
    images = mounted_images(wanted.mountings, instruments(wanted, path), images, str(path))
    require_distinct(images, f"{path}, images")
    return images


def instruments(wanted: CaseInput, path: Path) -> list[str]:
    """What the file of each image calls its instrument, in capitals, if [[mountings]] ask for it; else empty."""
    asked = any(one.instrument for one in wanted.mountings)
    files = [entry.label or entry.cube if asked else None for entry in wanted.images]
    return [instrument_of(path.parent / file) if file is not None else "" for file in files]


def _require_of_pass(
    wanted: CaseInput, orientations: Sequence[OrientationInput], mine: Sequence[int], where: str
) -> None:
    """Raise InputError where what is said of an image contradicts its pass."""
    for j in mine:
        entry = wanted.images[j]
        if entry.held:
            raise InputError(where, f"image {entry.name}, which is held", "adjusted images", "take one of the two out")
        if entry.orientation is not None:
            found = f"image {entry.name}, which has an orientation table of its own"
            raise InputError(where, found, "images that their pass says it for", "take one of the two out")
        if (nominal := orientations[j].nominal) != "trajectory":
            found = f"image {entry.name} with nominal = {nominal!r}"
            raise InputError(where, found, "the trajectory itself, which all images share", "nominal = 'trajectory'")


def _together(wanted: CaseInput, mine: Sequence[int], path: Path) -> dict[int, PushbroomImage]:
    """HRSC images of a strip that are read alike, on one trajectory (the very record), by their number."""
    groups, folder = dict[tuple[object, ...], list[int]](), path.parent
    for j in mine:
        entry = wanted.images[j]
        if entry.isd is None and entry.label is not None and instrument_of(folder / entry.label) == "HRSC":
            alike = (_kernels(entry, wanted.spice), entry.constants, entry.attitude_bias_s, entry.position_bias_s)
            groups.setdefault(alike, []).append(j)
    return {
        j: image
        for members in groups.values()
        if len(members) > 1
        for j, image in zip(members, _hrsc_strip([wanted.images[j] for j in members], wanted.spice, path), strict=True)
    }


def _hrsc_strip(entries: Sequence[ImageInput], spice: SpiceInput | None, path: Path) -> list[PushbroomImage]:
    from mgsgraph.files.labels.labelled_image import read_strip, with_focal_length

    folder, first = path.parent, entries[0]
    images = read_strip(
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
    if not kernels:
        raise InputError(where, "a label without kernels", "kernels = [...] here or in [spice]")
    return [folder / kernel for kernel in kernels]


def read_image(entry: ImageInput, spice: SpiceInput | None, folder: Path, where: str) -> PushbroomImage:
    """By an image's plain entry (`case_file.plain_image`), if it can be; `where` names the table in errors."""
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

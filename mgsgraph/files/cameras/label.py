"""Labels of line-scan images, of ISIS cubes and of the archives, read by what their camera's record says."""

from pathlib import Path

from mgsgraph.errors import InputError
from mgsgraph.files.cameras.camera import Camera, LabelBlock, LabelKeys, LineScanLabel, keywords_of
from mgsgraph.files.cameras.hrsc import HRSC
from mgsgraph.files.cameras.mars import CTX, HIRISE, MOC, THEMIS
from mgsgraph.files.cameras.moon import MI, NAC, TC
from mgsgraph.files.labels.image_label import read_label
from mgsgraph.files.pvl import Block
from mgsgraph.units import MILLISECOND

CAMERAS: tuple[Camera, ...] = (*MOC, CTX, HIRISE, THEMIS, *HRSC, *NAC, *TC, *MI)
"""In the order in which they are looked for and listed."""
_PERIOD_UNITS = {
    "milliseconds": MILLISECOND, "ms": MILLISECOND, "msec": MILLISECOND, "seconds": 1.0, "s": 1.0, "": MILLISECOND,
}  # fmt: skip
"""Of line periods and exposures, s; milliseconds where none is stated."""


def read_line_scan_label(path: Path) -> LineScanLabel:
    """Read the label of an image of any camera that is known here.

    Parameters
    ----------
    path : Path
        PDS3 image or its label, ISIS cube, or the label of one.

    Raises
    ------
    InputError
        Missing file, no label, a camera that is not known here (with those that are), a keyword missing or out of
        range, a map, or an image that was reduced.
    """
    return label_of(path, read_label(path))


def label_of(path: Path, root: Block) -> LineScanLabel:
    """The same of a label that was read already; `path` is its file."""
    block = LabelBlock(root, "pds3" if "PDS_VERSION_ID" in root else "isis")
    camera, keys = _recognised(path, block)
    lines, samples, first_line, first_sample, whole = _extent(block)
    summing = block.number(keys.sample_summing) if keys.sample_summing else 1.0
    first = block.number(keys.first_sample) - keys.first_pixel if keys.first_sample else 0.0
    periods = block.number(keys.line_summing) if keys.line_summing else 1.0
    if periods <= 0.0:
        raise InputError(block.where(keys.line_summing), f"{periods:g}", "a summing of 1 or more")
    period = block.number(keys.period, _PERIOD_UNITS) * periods if keys.period else 0.0
    if keys.period and period <= 0.0:
        raise InputError(block.where(keys.period), f"{period} s", "a positive line period")
    said = LineScanLabel(
        path=path,
        camera=camera,
        product=block.text(keys.product) if keys.product in block else path.stem,
        serial=_serial_number(camera, keys, block),
        target=block.text(keys.target).upper(),
        lines=lines,
        samples=samples,
        start=block.text(keys.start),
        utc=block.text(keys.utc) if keys.utc in block else "",
        period=period,
        sample_summing=summing,
        first_sample=first + first_sample * summing,
        first_line=first_line,
        whole=whole if whole != lines else 0,
        padding=(_padding(block, "StartPadding"), _padding(block, "EndPadding")),
        stop=_stop(keys, block),
        keywords=next((keywords_of(one) for one in root.blocks if one.name == "naifkeywords"), None),
    )
    return camera.label_facts(block, said) if camera.label_facts else said


def instrument_name(root: Block) -> str:
    """What a label calls its instrument, for messages."""
    block = LabelBlock(root, "pds3" if "PDS_VERSION_ID" in root else "isis")
    key = "INSTRUMENT_ID" if block.kind == "pds3" else "InstrumentId"
    return block.text(key) if key in block else "no instrument"


def _recognised(path: Path, block: LabelBlock) -> tuple[Camera, LabelKeys]:
    for camera in CAMERAS:
        keys = camera.keys(block.kind)
        if keys is not None and all(_word(block, key) == wanted for key, wanted in keys.identity.items()):
            return camera, keys
    kind = "ISIS cubes" if block.kind == "isis" else "PDS3 labels"
    found, expected = f"the camera {instrument_name(block.root)!r}", f"one of those known by {kind}: {_known(block)}"
    raise InputError(str(path), found, expected, "give its image support data (ALE's isd_generate) instead")


def _known(block: LabelBlock) -> str:
    """Missions and instruments of all cameras; of those that share the label's instrument, what else tells them."""
    all_keys = [(camera.mission, keys.identity) for camera in CAMERAS if (keys := camera.keys(block.kind)) is not None]
    near = [one for one in all_keys if all(_word(block, key) == one[1][key] for key in list(one[1])[:1])]
    return ", ".join(dict.fromkeys(" ".join([mission, *values.values()]) for mission, values in near)) or ", ".join(
        dict.fromkeys(f"{mission} {next(iter(values.values()))}" for mission, values in all_keys)
    )


def _word(block: LabelBlock, key: str) -> str:
    return block.text(key).upper().replace(" ", "") if key in block else ""


def _serial_number(camera: Camera, keys: LabelKeys, block: LabelBlock) -> str:
    """Mission and some keywords' values, as ISIS makes serial numbers (appdata/serialnumbers)."""
    parts = [block.text(key) for key in keys.serial if key in block]
    return "/".join([camera.mission, *parts, *filter(None, [keys.serial_end])])


def _stop(keys: LabelKeys, block: LabelBlock) -> str:
    """Line times that the label doesn't have hang on it; others are held against it, where it is known."""
    if not keys.stop or (keys.period and (keys.stop not in block or not block.text(keys.stop)[:1].isdigit())):
        return ""
    return block.text(keys.stop)


def _padding(block: LabelBlock, key: str) -> float:
    """Of a cube's tables, s; see `LineScanLabel.padding`."""
    return block.number(key, {"seconds": 1.0, "s": 1.0, "": 1.0}) if block.kind == "isis" and key in block else 0.0


def _extent(block: LabelBlock) -> tuple[int, int, float, float, int]:
    """Lines and samples of the image in camera geometry, how many were cut off before its first ones, and the lines
    before that.

    A map-projected cube gives the image that it was made of (its AlphaCube), whole.
    """
    if block.kind == "pds3":
        image = block.root.inner("IMAGE")
        return image.count("LINES"), image.count("LINE_SAMPLES"), 0.0, 0.0, image.count("LINES")
    cube = block.root.inner("IsisCube")
    size = cube.inner("Core").inner("Dimensions")
    lines, samples = size.count("Lines"), size.count("Samples")
    alpha = next((one for one in cube.blocks if one.name == "alphacube"), None)
    if alpha is None:
        return lines, samples, 0.0, 0.0, lines
    if is_map_projected(block.root):
        return alpha.count("AlphaLines"), alpha.count("AlphaSamples"), 0.0, 0.0, alpha.count("AlphaLines")
    cut = _cut(alpha, "Line", lines), _cut(alpha, "Sample", samples)
    return lines, samples, *cut, alpha.count("AlphaLines")


def _cut(alpha: Block, axis: str, count: int) -> float:
    """Lines or samples before the first one of a cube that ISIS crop has cut out of a larger one."""
    if f"AlphaStarting{axis}" not in alpha:
        whole = alpha.count(f"Alpha{axis}s")
        if whole != count:
            found = f"{count} of {whole} {axis.lower()}s"
            raise InputError(alpha.where(), found, "the whole image, or where it begins")
        return 0.0
    start, end = alpha.number(f"AlphaStarting{axis}"), alpha.number(f"AlphaEnding{axis}")
    if abs(end - start - count) > 1e-6:
        raise InputError(
            alpha.where(f"AlphaEnding{axis}"), f"{count} {axis.lower()}s made of {end - start:g}", "as many",
            "take the image before it was reduced or enlarged",
        )  # fmt: skip
    return start - 0.5


def is_map_projected(root: Block) -> bool:
    """Whether a cube's pixels are those of a map, not of the camera. A part of a camera's image may have the group of a
    map beside it (from caminfo or camrange), to which its own size has no relation.
    """
    if "PDS_VERSION_ID" in root:
        return False
    cube = root.inner("IsisCube")
    mapped = any(one.name == "mapping" for one in cube.blocks)
    alpha = next((one for one in cube.blocks if one.name == "alphacube"), None)
    if not mapped or alpha is None or "AlphaEndingLine" not in alpha:
        return mapped
    size = cube.inner("Core").inner("Dimensions")
    return any(
        alpha.number(f"AlphaEnding{axis}") - alpha.number(f"AlphaStarting{axis}") != size.count(f"{axis}s")
        for axis in ("Line", "Sample")
    )

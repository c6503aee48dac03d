"""What there is to know of a line-scan camera, and what the label of one of its images says.

Formulas: ISIS CameraDetectorMap, LineScanCameraDetectorMap, CameraFocalPlaneMap.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

import numpy as np

from mgsgraph.errors import InputError
from mgsgraph.files.cameras.keywords import Keywords, NaifKeywords, number
from mgsgraph.files.cameras.line_times import LineTimes, LineTimesPlace, uniform
from mgsgraph.files.pvl import Block
from mgsgraph.geometry.camera import InteriorOrientation
from mgsgraph.geometry.distortion import Distortion
from mgsgraph.units import ISIS_OFFSET, MM

LabelKind = Literal["isis", "pds3"]


@dataclass(frozen=True, slots=True)
class LabelKeys:
    """Under which keywords a label has what the geometry needs; those of nested blocks are found, too."""

    identity: Mapping[str, str]
    """Values (in capitals, without blanks) of some keywords, by which the camera is known."""
    start: str
    """Spacecraft clock count, or UTC, of the first line's top edge."""
    utc: str
    """UTC of the same, rounded; the clock count is held against it."""
    period: str
    """Time from line to line, ms where the label states no unit; empty where labels have none."""
    product: str
    """Product id; the file's name where a label has none."""
    target: str
    """Body."""
    serial: tuple[str, ...]
    """Keywords whose values make up ISIS's serial number behind the mission's name, in their order; those that a label
    doesn't have are left out, as ISIS does."""
    line_summing: str = ""
    """Periods per image line; 1 where there is no such keyword."""
    sample_summing: str = ""
    """Detector pixels per image sample; 1 where there is no such keyword."""
    first_sample: str = ""
    """Detector pixel at which the image begins; the first one where there is no such keyword."""
    first_pixel: int = 0
    """The number by which that keyword calls the detector's first pixel."""
    serial_end: str = ""
    """The serial number's last part, where no keyword of the label has it."""
    stop: str = ""
    """UTC of the last line, of cameras whose line times are known to end with it."""


@dataclass(frozen=True, slots=True)
class LineScanLabel:
    """What the label of an image says of its geometry."""

    path: Path
    """File that was read."""
    camera: "Camera"
    """Which took it."""
    product: str
    """Product id."""
    serial: str
    """ISIS's serial number, by which control networks call the image."""
    target: str
    """Body, in capitals."""
    lines: int
    """Number of lines."""
    samples: int
    """Number of samples."""
    start: str
    """Spacecraft clock count, or UTC where the camera's labels have no exact one, of the first line's top edge."""
    utc: str
    """UTC of the same, rounded; empty where the label has none."""
    period: float
    """s from one image line to the next, as the label has it; 0 where it doesn't."""
    sample_summing: float
    """Detector pixels per image sample."""
    first_sample: float
    """Detector pixels before the image's first one."""
    first_line: float = 0.0
    """Lines that were cut off before the image's first one (ISIS crop)."""
    whole: int = 0
    """Number of lines before any were cut off; 0 where none were."""
    padding: tuple[float, float] = (0.0, 0.0)
    """s by which spiceinit was told to begin a cube's tables earlier and to end them later."""
    line_offset: float = 0.0
    """Detector lines by which the place of the exposure is off the detector's origin (time delay integration)."""
    late: float = 0.0
    """s by which the first line's top edge is later than `start` says, as ISIS has it."""
    detector: int = 0
    """NAIF id of the part of the detector that has constants of its own; 0 for the camera's."""
    band: int = 1
    """Filter, from 1 on, of cameras whose geometry hangs on it."""
    stop: str = ""
    """UTC of the last line; empty where the label has none."""
    times: LineTimesPlace = None
    """Where the times of single lines are, for cameras that change their line period."""
    keywords: NaifKeywords | None = None
    """Constants that spiceinit left in the label of a cube."""


Interior = Callable[[Keywords, LineScanLabel], InteriorOrientation]
LineTimesOf = Callable[[Keywords, LineScanLabel, float, float], LineTimes]


def times_of_label(keywords: Keywords, label: LineScanLabel, start: float, stop: float) -> LineTimes:
    """Line times of the label as they are; `start` and `stop` in s TDB past J2000 are those of its first and last line
    (NaN where nothing says when that is).
    """
    return uniform(start + label.late, label.period, label.lines, label.first_line)


@dataclass(frozen=True, slots=True)
class Camera:
    """One camera: its codes, where its labels say what, its constants."""

    name: str
    """By which messages call it."""
    mission: str
    """Before the serial number's other parts, as in ISIS: MGS, MRO, LRO."""
    spacecraft: int
    """NAIF id."""
    instrument: int
    """NAIF id by which kernels call its constants and its frame."""
    addendum: str
    """ISIS's kernel of its constants."""
    isis: LabelKeys
    """Labels of ISIS cubes."""
    pds3: LabelKeys | None
    """Labels of the archive; None where none is read here."""
    interior: Interior
    """Interior orientation of an image."""
    source: str
    """Where formulas come from."""
    line_times: LineTimesOf = times_of_label
    """Line times, where the label's are not the true ones."""
    instrument_kernel: Interior | None = None
    """Interior orientation by NAIF's instrument kernel alone; None where only the addendum's is known."""
    frame: int = 0
    """NAIF id of the camera's frame, the instrument's when 0; to what it is fixed, kernels say."""
    start_is_utc: bool = False
    """Whether `LabelKeys.start` is UTC, not a clock count."""
    clock: int = 0
    """NAIF id of the clock; the spacecraft's when 0."""
    tables_of_bands: bool = False
    """Whether tables of cubes reach over all bands, which see a line at other times."""
    attitude_bias: float = 0.0
    """s; attitude(t) := CK(t + bias). Tables of cubes have it in them."""
    constants: Mapping[str, tuple[float, ...]] = field(default_factory=dict)
    """Of the addendum, for cubes of older versions of ISIS, which hold no keywords."""
    constants_target: str = ""
    """The body whose radii are among these constants."""
    label_facts: Callable[["LabelBlock", LineScanLabel], LineScanLabel] | None = None
    """What else is in the label and no keyword alone says."""

    def keys(self, kind: LabelKind) -> LabelKeys | None:
        """Where a label of a kind has what."""
        return self.isis if kind == "isis" else self.pds3


@dataclass(frozen=True, slots=True)
class LabelBlock:
    """A label in which keywords are found whichever block they stand in."""

    root: Block
    """The whole label."""
    kind: LabelKind
    """Of an ISIS cube, or of the archive."""

    def holder(self, key: str) -> Block:
        """The block that has a keyword; the outermost one where none has."""
        for block in self._blocks():
            if key in block:
                return block
        return self._blocks()[0]

    def __contains__(self, key: str) -> bool:
        return key in self.holder(key)

    def text(self, key: str) -> str:
        """A word or string; InputError where there is none."""
        return self.holder(key).text(key)

    def words(self, key: str) -> tuple[str, ...]:
        """The items of a list; InputError where there is none."""
        return self.holder(key).words(key)

    def number(self, key: str, units: Mapping[str, float] | None = None) -> float:
        """A finite number, in the unit of the label times its factor; InputError where there is none."""
        return self.holder(key).number(key, units)

    def where(self, key: str) -> str:
        """File, line and keyword."""
        return self.holder(key).where(key)

    def _blocks(self) -> list[Block]:
        if self.kind == "pds3":
            return [self.root, *(block for block in self.root.blocks if block.name == "image")]
        cube = self.root.inner("IsisCube")
        names = ("instrument", "bandbin", "archive", "kernels")
        return [block for name in names for block in cube.blocks if block.name == name] or [cube]


def interior_by_addendum(
    keywords: Keywords,
    label: LineScanLabel,
    distortion: Distortion,
    centre: tuple[float, float] | None = None,
    focal_length: float | None = None,
) -> InteriorOrientation:
    """Interior orientation by ISIS's keywords ITRANSL, ITRANSS, FOCAL_LENGTH, BORESIGHT_LINE and BORESIGHT_SAMPLE.

    Parameters
    ----------
    keywords : Keywords
        mm, first detector pixel 1.
    label : LineScanLabel
        Of the image.
    distortion : Distortion
        Of the optics.
    centre : (float, float), optional
        ISIS's detector line and sample of the principal point, where its camera model has them by itself.
    focal_length : float, optional
        m, where ISIS's camera model has it by itself.
    """
    code = label.camera.instrument
    axes = [keywords.numbers(f"INS{label.detector or code}_ITRANS{axis}", 3) for axis in "LS"]
    to_pixel = np.stack(axes)
    to_pixel[:, 1:] /= MM
    line, sample = centre or (number(keywords, f"INS{code}_BORESIGHT_{axis}") for axis in ("LINE", "SAMPLE"))
    return InteriorOrientation(
        focal_length=number(keywords, f"INS{code}_FOCAL_LENGTH") * MM if focal_length is None else focal_length,
        to_pixel=to_pixel,
        # a line detector has no half pixel along track: ISIS takes the line's own place, not its edge
        centre=np.array([line - label.line_offset, sample - ISIS_OFFSET]),
        first=np.array([0.0, label.first_sample]),
        sample_summing=label.sample_summing,
        distortion=distortion,
    )


def require_summing(label: LineScanLabel, highest: int, pixels: int) -> None:
    """Raise InputError unless the summing is one that the camera has and the image lies on its detector."""
    summing = label.sample_summing
    if not (1.0 <= summing <= highest and summing % 1.0 == 0.0):
        raise InputError(str(label.path), f"crosstrack summing {summing:g}", f"1 .. {highest} for {label.camera.name}")
    last = label.first_sample + label.samples * summing
    if last > pixels:
        raise InputError(
            str(label.path),
            f"{label.samples} samples of {summing:g} pixels from {label.first_sample + 1.0:g} on end at {last:g}",
            f"an end on the detector of {pixels} pixels", "mend the summing, the samples or the first sample",
        )  # fmt: skip

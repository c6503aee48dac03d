"""What there is to know of a line-scan camera, what the label of one of its images says, and camera constants by their
SPICE names (``INS-74021_FOCAL_LENGTH``), wherever they come from: kernels, cubes, JSON.

A new camera is one more `Camera` in `line_scanners` or a file of its own, and in `label.CAMERAS`: all readers have it
there, that of cubes with their own SPICE tables (`labels.isis_cube`) and that of kernels (`labels.labelled_image`).
Formulas: ISIS CameraDetectorMap, LineScanCameraDetectorMap, CameraFocalPlaneMap.

When an image's lines were taken: one line period, or one for each stretch of lines between changes.
"""

import struct
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal, Protocol

import numpy as np

from mgsgraph.errors import InputError, require
from mgsgraph.files.opening import finite_number
from mgsgraph.files.pvl import Block
from mgsgraph.geometry.camera import Distortion, InteriorOrientation, RadialDistortion
from mgsgraph.geometry.image import LineTiming
from mgsgraph.geometry.records import Array, assign, frozen
from mgsgraph.units import ISIS_OFFSET, MM

LineTimesSource = Path | Literal["mean"] | None
"""A text file; "mean", equal steps between the label's first and last time; or None, the image's own."""
_INVERSE = 0.01
"""By which the product of two affine maps may differ from 1."""
JOINED = 0.5
"""lines; a change that comes later or earlier by less is an uneven clock, one that comes later by more a pause."""


@dataclass(frozen=True, slots=True)
class LineTimesLocation:
    """Where in a file the times of lines lie."""

    file: Path
    """Which holds them."""
    kind: Literal["prefixes", "table"]
    """Before each line's pixels (PDS3), or the table LineScanTimes that hrsc2isis made of these."""
    offset: int
    """bytes before the first."""
    count: int
    """Number of lines, or of records."""
    stride: int
    """bytes from one to the next."""


LineTimesPlace = LineTimesLocation | LineTimesSource


@dataclass(frozen=True, slots=True, eq=False)
class LineTimes:
    """Times of the lines of one image, by its changes of the line period."""

    first_lines: Array
    """(s,) lines read before each change, from 0.0 on, increasing."""
    starts: Array
    """(s,) s TDB past J2000, beginning of the line that comes next."""
    periods: Array
    """(s,) s per line from there on."""
    lines: int
    """Number of the image's lines."""

    def __post_init__(self) -> None:
        first = frozen(self.first_lines, "line times, first lines", (None,))
        if first.size == 0 or first[0] != 0.0 or np.any(np.diff(first) < 1.0) or first[-1] >= self.lines:
            shown = ", ".join(f"{line + 1.0:g}" for line in first[:4]) or "none"
            raise InputError("line times", f"changes at lines {shown}", f"lines from 1 up to {self.lines}, increasing")
        starts = frozen(self.starts, "line times, starts", (first.size,))
        periods = frozen(self.periods, "line times, periods", (first.size,))
        early = (starts[:-1] + np.diff(first) * periods[:-1] - starts[1:]) / periods[:-1]
        for k in np.flatnonzero(early > JOINED)[:1]:
            found = f"line {first[k + 1] + 1.0:g} begins {early[k]:.3g} lines before the one ahead of it is done"
            raise InputError("line times", found, "times and line rates that agree")
        assign(self, first_lines=first, starts=starts, periods=periods)

    @property
    def start(self) -> float:
        """Time in s TDB past J2000 of the first line's leading edge."""
        return float(self.starts[0])

    @property
    def last(self) -> float:
        """Time in s TDB past J2000 of the last line's leading edge."""
        return float(self.starts[-1] + (self.lines - 1.0 - self.first_lines[-1]) * self.periods[-1])

    @property
    def stop(self) -> float:
        """Time in s TDB past J2000 of the last line's trailing edge."""
        return float(self.starts[-1] + (self.lines - self.first_lines[-1]) * self.periods[-1])

    def timing(self, epoch: float) -> LineTiming:
        """The same in s past a trajectory's epoch, the recorded times joined without steps but for true pauses.

        Recorded times are those of an uneven clock: at the changes of h5270 they lie 0.03 and 0.16 ms (0.01 lines) off
        what the exposures add up to. Each segment's period is what leads from its recorded time to the next.
        """
        starts, periods = self.starts - epoch, self.periods.copy()
        between = np.diff(starts) / np.diff(self.first_lines)
        joined = np.abs(between / periods[:-1] - 1.0) * np.diff(self.first_lines) < JOINED
        periods[:-1] = np.where(joined, between, periods[:-1])
        return LineTiming(self.first_lines, starts, periods)


def uniform(start: float, period: float, lines: int, first_line: float = 0.0) -> LineTimes:
    """Lines of one period (s), the image's first one `first_line` lines after `start` (s TDB past J2000)."""
    return LineTimes(np.zeros(1), np.array([start + first_line * period]), np.array([period]), lines)


# --- cameras and their labels

LabelKind = Literal["isis", "pds3"]


class Keywords(Protocol):
    """Constants by name, in the units of SPICE's instrument kernels: km, mm, degrees, seconds."""

    def numbers(self, name: str, count: int) -> Array:
        """The first `count` numbers of a keyword (cubes hold as much of a list as ISIS asked for); InputError where it
        is missing, a text, or shorter.
        """
        ...

    def __contains__(self, name: str) -> bool:
        """Whether there is such a keyword."""
        ...


def number(keywords: Keywords, name: str) -> float:
    """The one number of a keyword; InputError as `Keywords.numbers`."""
    return float(keywords.numbers(name, 1)[0])


@dataclass(frozen=True, slots=True)
class NaifKeywords:
    """What spiceinit copied out of the kernels into a cube (object NaifKeywords) or into JSON ("naif_keywords")."""

    source: str
    """Where they stand, for messages."""
    values: Mapping[str, Any]
    """Words, numbers or lists of them, by name."""

    def __contains__(self, name: str) -> bool:
        return name in self.values

    def numbers(self, name: str, count: int) -> Array:
        """See `Keywords.numbers`."""
        where = f"{self.source}, {name}"
        if name not in self.values:
            remedy = "run spiceinit again with the camera's addendum kernel"
            raise InputError(f"{self.source}, NaifKeywords", f"no {name}", f"{name} = {count} number(s)", remedy)
        value = self.values[name]
        items = [value] if isinstance(value, str) or not isinstance(value, Sequence) else list(value)
        require(len(items) >= count, where, f"{len(items)} items", f"{count} number(s)")
        return np.array([_finite(item, where) for item in items[:count]])

    def time(self, name: str) -> float:
        """A time in s TDB past J2000, which ISIS writes as the number's 8 bytes in hexadecimal, the lowest first."""
        text = str(self.values.get(name, ""))
        try:
            (time,) = struct.unpack("<d", bytes.fromhex(text))
            return finite_number(repr(time))
        except (ValueError, struct.error):
            raise InputError(f"{self.source}, {name}", repr(text[:60]), "16 hexadecimal digits of a time") from None


def _finite(item: Any, where: str) -> float:
    try:
        return finite_number(str(item))
    except ValueError:
        raise InputError(where, repr(item)[:60], "a finite number") from None


def keywords_of(block: Block) -> NaifKeywords:
    """Keywords of a block of a label."""
    return NaifKeywords(block.document.source, _ByName({name: entry.value for name, entry in block.entries.items()}))


class _ByName(dict[str, Any]):
    """Values by name in any case: a label's blocks keep their keywords in lower case."""

    def __contains__(self, name: object) -> bool:
        return super().__contains__(str(name).lower())

    def __getitem__(self, name: str) -> Any:
        return super().__getitem__(name.lower())

    def get(self, name: str, default: Any = None) -> Any:
        return super().get(name.lower(), default)


@dataclass(frozen=True, slots=True)
class LabelKeys:
    """Keywords of a label for all that the geometry needs; nested blocks are searched, too."""

    identity: Mapping[str, str]
    """Values (in capitals, without blanks) of some keywords, by which the camera is known."""
    serial: tuple[str, ...]
    """Keywords whose values make up ISIS's serial number behind the mission's name, in their order; those that a label
    doesn't have are left out, as ISIS does."""
    start: str = "SpacecraftClockCount"
    """Spacecraft clock count, or UTC, of the first line's top edge."""
    utc: str = "StartTime"
    """UTC of the same, rounded; the clock count is held against it."""
    stop: str = ""
    """UTC of the last line, of cameras whose line times are known to end with it."""
    period: str = ""
    """Time from line to line, ms where the label states no unit; empty where labels have none."""
    product: str = "ProductId"
    """Product id; the file's name where a label has none."""
    target: str = "TargetName"
    """Body."""
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


def pds3_keys(identity: Mapping[str, str], serial: tuple[str, ...], **others: Any) -> LabelKeys:
    """Keywords of the archive's labels, as most of them are called, and `others`."""
    usual = {
        "start": "SPACECRAFT_CLOCK_START_COUNT", "utc": "START_TIME", "stop": "STOP_TIME", "product": "PRODUCT_ID",
        "target": "TARGET_NAME", "period": "LINE_EXPOSURE_DURATION",
    }  # fmt: skip
    return LabelKeys(identity, serial, **usual | others)


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
    """s by which spiceinit begins a cube's tables earlier and ends them later."""
    line_offset: float = 0.0
    """Detector lines by which the place of the exposure is off the detector's origin (time delay integration)."""
    late: float = 0.0
    """s by which the first line's top edge is later than `start` says, as ISIS has it."""
    detector: int = 0
    """NAIF id of the part of the detector that has constants of its own; 0 for the camera's."""
    band: int = 1
    """Filter, from 1 on, of cameras whose geometry depends on it."""
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
    """One camera: its codes, the keywords of its labels, its constants."""

    name: str
    """By which messages call it."""
    mission: str
    """Before the serial number's other parts, as in ISIS: MGS, MRO, LRO."""
    spacecraft: int
    """NAIF id."""
    instrument: int
    """NAIF id by which kernels call its constants and its frame."""
    isis: LabelKeys
    """Labels of ISIS cubes."""
    pds3: LabelKeys | None
    """Labels of the archive; None where none is read here."""
    interior: Interior
    """Interior orientation of an image."""
    source: str
    """Where formulas come from."""
    addendum: str
    """ISIS's kernel of its constants."""
    pixels: int
    """Of the detector line."""
    summing: int
    """Most pixels that are summed across track."""
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
        """Keywords of labels of a kind."""
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
    require_summing(label)
    code = label.camera.instrument
    axes = [keywords.numbers(f"INS{label.detector or code}_ITRANS{axis}", 3) for axis in "LS"]
    to_pixel = np.stack(axes)
    _require_inverse(keywords, label.detector or code, to_pixel)
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


def _require_inverse(keywords: Keywords, code: int, to_pixel: Array) -> None:
    """Raise InputError where TRANSX and TRANSY (mm by constant, sample, line) don't lead back from ITRANSL, ITRANSS."""
    names = [f"INS{code}_TRANS{axis}" for axis in "XY"]
    if all(name in keywords for name in names):
        back = np.stack([keywords.numbers(name, 3)[[2, 1]] for name in names])
        if np.abs(to_pixel[:, 1:] @ back - np.eye(2)).max() > _INVERSE:
            found = ", ".join(f"{element:.7g}" for element in to_pixel[:, 1:].ravel())
            raise InputError(f"INS{code}_ITRANSL, ITRANSS", found, f"the inverse of {' and '.join(names)}", "fix one")


def by_addendum(
    distortion: Callable[[Keywords, LineScanLabel], Distortion], centre: tuple[float, float] | None = None
) -> Interior:
    """Interior orientation of a camera by `interior_by_addendum`, with a distortion by its keywords."""
    return lambda keywords, label: interior_by_addendum(keywords, label, distortion(keywords, label), centre)


def radial(keywords: Keywords, label: LineScanLabel) -> RadialDistortion:
    """ISIS CameraDistortionMap: three coefficients OD_K of powers of mm."""
    k0, k1, k2 = keywords.numbers(f"INS{label.camera.instrument}_OD_K", 3)
    return RadialDistortion(k0, k1 / MM**2, k2 / MM**4)


def scaled_interior(
    label: LineScanLabel, focal_length: float, per_metre: float, centre: float, distortion: Distortion
) -> InteriorOrientation:
    """Interior orientation by an instrument kernel: pixels per m along both axes, the principal point's sample."""
    require_summing(label)
    return InteriorOrientation(
        focal_length=focal_length, to_pixel=np.array([[0.0, per_metre, 0.0], [0.0, 0.0, per_metre]]),
        centre=np.array([0.0, centre]), first=np.array([0.0, label.first_sample]),
        sample_summing=label.sample_summing, distortion=distortion,
    )  # fmt: skip


def require_summing(label: LineScanLabel) -> None:
    """Raise InputError unless the summing is one that the camera has and the image lies on its detector."""
    summing, highest, pixels = label.sample_summing, label.camera.summing, label.camera.pixels
    if not (1.0 <= summing <= highest and summing % 1.0 == 0.0):
        raise InputError(str(label.path), f"crosstrack summing {summing:g}", f"1 .. {highest} for {label.camera.name}")
    last = label.first_sample + label.samples * summing
    require(
        last <= pixels, str(label.path),
        f"{label.samples} samples of {summing:g} pixels from {label.first_sample + 1.0:g} on end at {last:g}",
        f"an end on the detector of {pixels} pixels", "fix the summing, the samples or the first sample",
    )  # fmt: skip

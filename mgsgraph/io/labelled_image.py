"""An image by its label and SPICE kernels, whichever of the cameras that are known here took it."""

from collections.abc import Sequence
from pathlib import Path

from mgsgraph.errors import InputError
from mgsgraph.geometry.image import PushbroomImage
from mgsgraph.io.hrsc import read_hrsc
from mgsgraph.io.hrsc_lines import LineTimesSource
from mgsgraph.io.image_label import instrument_of
from mgsgraph.io.kernels import INTERVAL, MGS_ATTITUDE_BIAS, Constants
from mgsgraph.io.moc import read_moc


def read_labelled_image(
    label: Path,
    kernels: Sequence[Path],
    name: str | None = None,
    *,
    focal_length: float | None = None,
    constants: Constants = "iak",
    attitude_bias: float | None = None,
    position_bias: float = 0.0,
    interval: float = INTERVAL,
    line_times: LineTimesSource = None,
) -> PushbroomImage:
    """Read an image's geometry by the reader of the instrument that its label names; see `read_moc`, `read_hrsc`.

    Parameters
    ----------
    attitude_bias : float, optional
        s; that of the instrument when absent: -1.15 for MOC, none for HRSC.
    line_times : Path, "mean" or None
        of HRSC; other labels have their line rate in them.

    Raises
    ------
    InputError
        As these readers; an instrument that is none of theirs; line times for one that needs none.
    """
    instrument = instrument_of(label)
    if instrument == "HRSC":
        bias = 0.0 if attitude_bias is None else attitude_bias
        return read_hrsc(
            label, kernels, name, focal_length, constants, bias, position_bias, interval, line_times=line_times
        )
    if not instrument.startswith("MOC"):
        raise InputError(str(label), f"the instrument {instrument!r}", "MOC-NA or HRSC")
    if line_times is not None:
        raise InputError(str(label), f"line times for {instrument}", "none: its label has the line rate")
    bias = MGS_ATTITUDE_BIAS if attitude_bias is None else attitude_bias
    return read_moc(label, kernels, name, focal_length, constants, bias, position_bias, interval)

"""[passes.position] and [passes.attitude] of a case file: what is known beforehand of a trajectory's correction."""

from typing import Any, Literal

import msgspec
import numpy as np

from mgsgraph.errors import InputError, require
from mgsgraph.geometry.records import Array
from mgsgraph.units import MGON, MRAD
from mgsgraph.wording import listed

Model = Literal["polynomial", "gauss-markov"]
"""What a correction is in time."""
Sigmas = float | list[float]
"""One number for all three axes, or three."""
HIGHEST = 3
"""Degree of polynomials through four orientation images."""
_SIZES = (1e-9, 1e9)
"""Sigmas that mean something, in the units of the keys."""
_FOLLOWING = 0.01
"""Of the constant term's sigma: that of powers for which neither the pass nor [orientation] says any."""


class PositionInput(msgspec.Struct, forbid_unknown_fields=True, frozen=True):
    """Correction of the position along the body-fixed axes X, Y, Z; each sigma is one number for all, or three.

    As [orientation] has it where nothing is said: a polynomial, of s = -1 .. 1 over the pass.
    """

    model: Model = "polynomial"
    """A polynomial of time, or bias and drift with departures about them that are a stationary Gaussian process."""
    degree: int | None = None
    """Of the polynomial, 0 to 3; as many as there are sigmas, or else that of [orientation]."""
    sigmas_m: list[Sigmas] | None = None
    """A-priori sigma of each of its terms 1, s, s^2, s^3, at s = 1; those of [orientation] when absent."""
    sigma_m: Sigmas | None = None
    """Of the process: of its departures at any one time."""
    bias_sigma_m: Sigmas | None = None
    """Constant over the pass, beside a process; 0 or absent: none."""
    drift_sigma_m: Sigmas | None = None
    """Linear in time, at the pass's ends, beside a process; 0 or absent: none."""
    correlation_time_s: float | None = None
    """In which departures forget themselves to 1/e."""

    units = {"m": 1.0}
    what = "position"


class AttitudeInput(msgspec.Struct, forbid_unknown_fields=True, frozen=True):
    """Correction of the attitude, rotations about the axes x, y, z of the pass's first camera, in mrad or mgon; each
    sigma is one number for all, or three. As [orientation] has it where nothing is said.
    """

    model: Model = "polynomial"
    """As of the position."""
    degree: int | None = None
    """As of the position."""
    sigmas_mrad: list[Sigmas] | None = None
    """A-priori sigma of each term 1, s, s^2, s^3 of the polynomial, at s = 1; those of [orientation] when absent."""
    sigmas_mgon: list[Sigmas] | None = None
    """The same in another unit."""
    sigma_mrad: Sigmas | None = None
    """Of the process: of its departures at any one time."""
    sigma_mgon: Sigmas | None = None
    """The same in another unit."""
    bias_sigma_mrad: Sigmas | None = None
    """Constant over the pass, beside a process; 0 or absent: none."""
    bias_sigma_mgon: Sigmas | None = None
    """The same in another unit."""
    drift_sigma_mrad: Sigmas | None = None
    """Linear in time, at the pass's ends, beside a process; 0 or absent: none."""
    drift_sigma_mgon: Sigmas | None = None
    """The same in another unit."""
    correlation_time_s: float | None = None
    """In which departures forget themselves to 1/e."""

    units = {"mrad": MRAD, "mgon": MGON}
    what = "attitude"


Motion = PositionInput | AttitudeInput
_OF_PROCESSES = ("sigma", "bias_sigma", "drift_sigma")


def polynomial_sigmas(motion: Motion, default: Array, where: str) -> Array:
    """(degree + 1, 3) m or rad, of a polynomial's terms; those that are not said by `default` (n, 3), of [orientation].

    Raises
    ------
    InputError
        A degree over 3; another number of sigmas than of terms; keys of a process.
    """
    _require_keys(motion, ("sigmas", "degree"), where)
    key, values = _said(motion, "sigmas", where)
    degree = motion.degree
    if degree is None:
        degree = len(values) - 1 if values is not None else len(default) - 1
    said = f"{where}, degree" if motion.degree is not None else f"{where}, {key}"
    of = "[orientation]" if motion.degree is None and values is None else said
    if not 0 <= degree <= HIGHEST:
        raise InputError(
            of, f"a polynomial of degree {degree}", f"0 to {HIGHEST} for a pass",
            'a lower degree, or a process that follows any course: model = "gauss-markov" with nodes',
        )  # fmt: skip
    if values is None:
        more = [_FOLLOWING * default[0]] * max(degree + 1 - len(default), 0)
        found = np.array([*default[: degree + 1], *more])
        require(np.all(np.isfinite(found)), where, "infinite sigmas, of [orientation]", "finite sigmas here")
        return found
    if len(values) != degree + 1:
        terms = ", ".join(("1", "s", "s^2", "s^3")[: degree + 1])
        expected = f"{degree + 1} for degree = {degree}: of {terms}"
        raise InputError(f"{where}, {key}", f"{len(values)} sigmas", expected)
    scale = motion.units[key.rsplit("_", 1)[1]]
    return np.array([three(value, f"{where}, {key}") for value in values]) * scale


def process_sigmas(motion: Motion, where: str) -> tuple[Array, Array, Array]:
    """(3,) m or rad each: departures of a process, bias and drift beside it (0 for none).

    Raises
    ------
    InputError
        No sigma of the process, a correlation time that is not positive, keys of a polynomial.
    """
    _require_keys(motion, (*_OF_PROCESSES, "correlation_time_s"), where)
    found = []
    for part in _OF_PROCESSES:
        key, value = _said(motion, part, where)
        if value is None:
            units = " or ".join(f"sigma_{unit}" for unit in motion.units)
            require(part != "sigma", where, f"{motion.model} without a sigma", units)
            found.append(np.zeros(3))
            continue
        found.append(three(value, f"{where}, {key}", zero=part != "sigma") * motion.units[key.rsplit("_", 1)[1]])
    time = motion.correlation_time_s
    if time is None or not 0.0 < time <= 1e9:
        said = f"{motion.model} without" if time is None else f"{time:g} s:"
        raise InputError(
            f"{where}, correlation_time_s", f"{said} a correlation time",
            "seconds in which departures forget themselves, above 0",
            "nodes that know nothing of each other are [[strips]] with prior = { correlation_time_s = 0 }",
        )  # fmt: skip
    return found[0], found[1], found[2]


def _require_keys(motion: Motion, allowed: tuple[str, ...], where: str) -> None:
    """Raise InputError for keys that the model does not heed: they would change nothing, unsaid."""
    for key, value in msgspec.structs.asdict(motion).items():
        if key != "model" and value is not None and key not in allowed and key.rsplit("_", 1)[0] not in allowed:
            raise InputError(where, f'{key} beside model = "{motion.model}"', "keys of that model alone", "take it out")


def _said(motion: Motion, part: str, where: str) -> tuple[str, Any]:
    """The key of a part that is said, in whichever unit, and its value; None where none is."""
    given = {key: value for unit in motion.units if (value := getattr(motion, key := f"{part}_{unit}")) is not None}
    if len(given) > 1:
        raise InputError(where, listed(list(given)), "one of them")
    return next(iter(given.items()), (f"{part}_{next(iter(motion.units))}", None))


def three(value: object, where: str, zero: bool = False) -> Array:
    """(3,) of one number or three; 0 is one where `zero`."""
    sigmas = np.atleast_1d(np.asarray(value, dtype=np.float64))
    sound = ((sigmas >= _SIZES[0]) & (sigmas <= _SIZES[1])) | (zero & (sigmas == 0.0))
    if sigmas.size not in (1, 3) or not np.all(sound):
        or_zero = ", 0 for none" if zero else ""
        raise InputError(where, f"{value}", f"one number from {_SIZES[0]:g} to {_SIZES[1]:g}{or_zero}, or three")
    return np.broadcast_to(sigmas, 3)

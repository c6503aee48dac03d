"""[passes.position] and [passes.attitude] of a case file: what is known beforehand of a trajectory's correction."""

from typing import Any, Literal

import msgspec
import numpy as np

from mgsgraph.errors import InputError, errors_from, require
from mgsgraph.geometry.records import Array
from mgsgraph.network import Process
from mgsgraph.text import listed
from mgsgraph.units import MGON, MRAD

Kind = Literal["gauss-markov", "matern-3/2", "matern-5/2", "integrated-wiener", "jitter", "white"]
"""Gaussian processes (`network.conditioning`)."""
Model = Literal["polynomial", "gauss-markov", "matern-3/2", "matern-5/2", "integrated-wiener", "jitter", "white"]
"""What a correction is in time."""
Sigmas = float | list[float]
"""One number for all three axes, or three."""
Strength = float | list[float] | Literal["estimated"]
"""The same, or found from the measures."""
HIGHEST = 3
"""Degree of polynomials through four orientation images."""
_SIZES = (1e-9, 1e9)
"""Sigmas that mean something, in the units of the keys."""
_BEGIN = {"m": 1.0, "mrad": 0.01, "mgon": 0.6}
"""In each unit, where the search for an estimated strength begins."""
_BANDWIDTH = 0.1
"""Of the frequency, of jitter whose bandwidth is not said."""
_NEGLIGIBLE = 1e-4
"""Of the constant's sigma, departures of what is a line in time beside the process of the other part."""
_FOLLOWING = 0.01
"""Of the constant term's sigma: that of powers for which neither the pass nor [orientation] says any."""


class ProcessInput(msgspec.Struct, forbid_unknown_fields=True, frozen=True):
    """A further process, which adds to that of the table that it stands in."""

    model: Kind
    """Which."""
    sigma_m: Strength | None = None
    """Its strength, of positions; "estimated": found from the measures."""
    sigma_mrad: Strength | None = None
    """The same of the attitude."""
    sigma_mgon: Strength | None = None
    """The same in another unit."""
    correlation_time_s: float | None = None
    """In which departures forget themselves, of gauss-markov and matern."""
    frequency_hz: float | None = None
    """Of jitter."""
    bandwidth_hz: float | None = None
    """Of jitter: full width of its spectral peak at half its height; a tenth of the frequency when absent."""


class PositionInput(msgspec.Struct, forbid_unknown_fields=True, frozen=True):
    """Correction of the position along the body-fixed axes X, Y, Z; each sigma is one number for all, or three.

    As [orientation] has it where nothing is said: a polynomial, of s = -1 .. 1 over the pass.
    """

    model: Model = "polynomial"
    """A polynomial of time; or bias and drift with departures about them that are a Gaussian process: stationary with
    a correlation time (the rougher first), an integrated Wiener process, or a vibration of one frequency (jitter)."""
    degree: int | None = None
    """Of the polynomial, 0 to 3; as many as there are sigmas, or else that of [orientation]."""
    sigmas_m: list[Sigmas] | None = None
    """A-priori sigma of each of its terms 1, s, s^2, s^3, at s = 1; those of [orientation] when absent."""
    sigma_m: Strength | None = None
    """Of the process: of its departures at any one time (of integrated-wiener in m/s^1.5); "estimated": found from the
    measures."""
    bias_sigma_m: Sigmas | None = None
    """Constant over the pass, beside a process; 0 or absent: none."""
    drift_sigma_m: Sigmas | None = None
    """Linear in time, at the pass's ends, beside a process; 0 or absent: none."""
    correlation_time_s: float | None = None
    """In which departures forget themselves (gauss-markov: to 1/e), of gauss-markov and matern."""
    frequency_hz: float | None = None
    """Of jitter."""
    bandwidth_hz: float | None = None
    """Of jitter: full width of its spectral peak at half its height; a tenth of the frequency when absent."""
    plus: tuple[ProcessInput, ...] = ()
    """Further processes, which add up with this one."""

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
    sigma_mrad: Strength | None = None
    """Of the process: of its departures at any one time (of integrated-wiener in mrad/s^1.5); "estimated": found from
    the measures."""
    sigma_mgon: Strength | None = None
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
    """In which departures forget themselves (gauss-markov: to 1/e), of gauss-markov and matern."""
    frequency_hz: float | None = None
    """Of jitter."""
    bandwidth_hz: float | None = None
    """Of jitter: full width of its spectral peak at half its height; a tenth of the frequency when absent."""
    plus: tuple[ProcessInput, ...] = ()
    """Further processes, which add up with this one."""

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
    if degree < 0:
        raise InputError(of, "no sigma" if motion.degree is None else f"{degree}", f"a degree of 0 to {HIGHEST}: one "
                         "sigma for each of its terms")  # fmt: skip
    if degree > HIGHEST:
        raise InputError(
            of, f"a polynomial of degree {degree}", f"0 to {HIGHEST} for a pass",
            'a lower degree, or a process, which follows any course: model = "matern-3/2" with nodes',
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


def processes(motion: Motion, where: str) -> tuple[Process, ...]:
    """The processes that departures from bias and drift are the sum of, in m or rad.

    Raises
    ------
    InputError
        No strength; no correlation time, or no frequency, where the kind has one; keys of another model.
    """
    _require_keys(motion, (*_OF_PROCESSES, "correlation_time_s", "frequency_hz", "bandwidth_hz", "plus"), where)
    others = [_process(one, motion, f"{where}.plus[{k}]") for k, one in enumerate(motion.plus)]
    return (_process(motion, motion, where), *others)


def _process(one: Motion | ProcessInput, motion: Motion, where: str) -> Process:
    """One of them; `motion` is the table that it stands in."""
    assert one.model != "polynomial"
    strange = [key for key in ("sigma_m", "sigma_mrad", "sigma_mgon") if key[6:] not in motion.units]
    for key in [key for key in strange if getattr(one, key, None) is not None]:
        raise InputError(where, f"{key}, of {motion.what}", " or ".join(f"sigma_{unit}" for unit in motion.units))
    key, value = _said(one, "sigma", where, motion)
    unit = key.removeprefix("sigma_")
    if value is None:
        units = " or ".join(f"sigma_{unit}" for unit in motion.units)
        raise InputError(where, f"{one.model} without a sigma", f'{units}: a number, three, or "estimated"')
    _require_times(one, where)
    estimated = value == "estimated"
    sigmas = np.full(3, _BEGIN[unit]) if estimated else three(value, f"{where}, {key}")
    width = one.bandwidth_hz if one.bandwidth_hz is not None else _BANDWIDTH * (one.frequency_hz or 0.0)
    sigmas, time, frequency = sigmas * motion.units[unit], one.correlation_time_s or 0.0, one.frequency_hz or 0.0
    with errors_from(where):
        return Process(one.model, sigmas, time, frequency, width, estimated)


def _require_times(one: Motion | ProcessInput, where: str) -> None:
    """Raise InputError unless a process has the times that its kind has, and no others."""
    timed = one.model in ("gauss-markov", "matern-3/2", "matern-5/2")
    for key, value, wanted, meaning in (
        ("correlation_time_s", one.correlation_time_s, timed, "seconds in which departures forget themselves, above 0"),
        ("frequency_hz", one.frequency_hz, one.model == "jitter", "cycles per second, above 0"),
    ):
        if wanted and (value is None or not 0.0 < value <= 1e9):
            found = f"{one.model} without it" if value is None else f"{value:g}"
            remedy = "nodes that know nothing of each other are a process model = \"white\"" if timed else ""
            raise InputError(f"{where}, {key}", found, meaning, remedy)
        if not wanted and value is not None:
            raise InputError(where, f'{key} beside model = "{one.model}"', "keys of that model alone", "take it out")
    if one.bandwidth_hz is not None and one.model != "jitter":
        raise InputError(where, f'bandwidth_hz beside model = "{one.model}"', "keys of that model alone", "take it out")


def trend_sigmas(motion: Motion, default: Array, where: str) -> tuple[Array, Array]:
    """(3,) m or rad, of bias and drift: beside a process as they are said, 0 for none; or a polynomial's two terms.

    Raises
    ------
    InputError
        For a polynomial of a higher degree than 1: beside a process only a line can stand.
    """
    if motion.model != "polynomial":
        parts = [_said(motion, part, where) for part in ("bias_sigma", "drift_sigma")]
        bias, drift = (
            np.zeros(3) if value is None
            else three(value, f"{where}, {key}", zero=True) * motion.units[key.rsplit("_", 1)[1]]
            for key, value in parts
        )  # fmt: skip
        return bias, drift
    said = motion.degree is not None or any(getattr(motion, f"sigmas_{unit}") is not None for unit in motion.units)
    sigmas = polynomial_sigmas(motion, default if said else default[:2], where)
    if len(sigmas) > 2:
        found = f"a polynomial of degree {len(sigmas) - 1} beside a process of the other part"
        raise InputError(where, found, "degree 0 or 1", "a process here, too")
    return sigmas[0], sigmas[1] if len(sigmas) > 1 else np.zeros(3)


def negligible_departures(bias: Array) -> tuple[Process, ...]:
    """Departures that are next to nothing: of a part that is a line in time, with the sigma (3,) of its constant."""
    return (Process("white", _NEGLIGIBLE * bias),)


def _require_keys(motion: Motion, allowed: tuple[str, ...], where: str) -> None:
    """Raise InputError for keys that the model does not heed: they would change nothing, unsaid."""
    for key, value in msgspec.structs.asdict(motion).items():
        if key != "model" and value not in (None, ()) and key not in allowed and key.rsplit("_", 1)[0] not in allowed:
            raise InputError(where, f'{key} beside model = "{motion.model}"', "keys of that model alone", "take it out")


def _said(table: Motion | ProcessInput, part: str, where: str, motion: Motion | None = None) -> tuple[str, Any]:
    """The key of a part that a table says, in whichever unit (of `motion`), and its value; None where none is."""
    units = (motion or table).units  # type: ignore[union-attr]
    given = {key: value for unit in units if (value := getattr(table, key := f"{part}_{unit}")) is not None}
    if len(given) > 1:
        raise InputError(where, listed(list(given)), "one of them")
    return next(iter(given.items()), (f"{part}_{next(iter(units))}", None))


def three(value: object, where: str, zero: bool = False) -> Array:
    """(3,) of one number or three; 0 is one where `zero`."""
    sigmas = np.atleast_1d(np.asarray(value, dtype=np.float64))
    sound = ((sigmas >= _SIZES[0]) & (sigmas <= _SIZES[1])) | (zero & (sigmas == 0.0))
    if sigmas.size not in (1, 3) or not np.all(sound):
        or_zero = ", 0 for none" if zero else ""
        raise InputError(where, f"{value}", f"one number from {_SIZES[0]:g} to {_SIZES[1]:g}{or_zero}, or three")
    return np.broadcast_to(sigmas, 3)

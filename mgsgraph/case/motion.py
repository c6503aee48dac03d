"""What a case file says of a trajectory's correction: where a pass's orientation images stand, and their priors,
by [passes.position] and [passes.attitude] or, of one camera (HRSC), by `prior`: a bias, a drift and
departures that forget themselves in time (`network.passes.NodePrior`); and the numbers that a case file may hold.
"""

import math
from collections.abc import Sequence
from typing import Annotated, ClassVar, Literal

import msgspec
import numpy as np

from mgsgraph.errors import InputError, errors_from, require
from mgsgraph.geometry.image import PushbroomImage
from mgsgraph.geometry.orientation import OrientationImages, evenly_spaced
from mgsgraph.geometry.records import Array
from mgsgraph.geometry.trajectory import tdb_of_utc
from mgsgraph.network import NodePrior, Process
from mgsgraph.network.joining import seconds, spans, straightest
from mgsgraph.text import listed
from mgsgraph.units import MGON, MRAD

Positive = Annotated[float, msgspec.Meta(gt=0.0)]
Sigma = Annotated[float, msgspec.Meta(ge=1e-6, le=1e9)]
"""Standard deviations that mean something: a micropixel or a micrometre to a million kilometres."""
Factor = Annotated[float, msgspec.Meta(ge=1e-3, le=1e3)]
"""Of sigmas that are stated elsewhere."""
Sigmas = float | list[float]
"""One number for all three axes, or three."""
SPACING = 10.0
"""s between nodes where nothing is said: 40 km on the ground for Mars Express."""
_MOST_NODES = 10_000
"""In a pass; more are a slip in the unit of their spacing."""
_SIZES = (1e-9, 1e9)
"""Sigmas that mean something, in the units of the keys."""


def three(value: object, where: str, zero: bool = False, infinite: bool = False) -> Array:
    """(3,) of one sigma or three; 0 is one where `zero`, inf where `infinite`. (A union of a number with a tuple of
    three crashes msgspec 0.22.)
    """
    sigmas = np.atleast_1d(np.asarray(value, dtype=np.float64))
    sound = ((sigmas >= _SIZES[0]) & (sigmas <= _SIZES[1])) | (zero & (sigmas == 0.0)) | (infinite & (sigmas == np.inf))
    other = " (0 for none)" * zero + " (inf for unknown)" * infinite
    require(sigmas.size in (1, 3) and np.all(sound), where, f"{value}", f"one number from 1e-9 to 1e9, or three{other}")
    return np.broadcast_to(sigmas, 3)


class NodesInput(msgspec.Struct, forbid_unknown_fields=True, frozen=True):
    """Where the orientation images of a pass stand: evenly spaced, or at times; at most one of the four is stated."""

    spacing_s: Positive | None = None
    """Largest spacing; 10 s when nothing is said."""
    spacing_lines: Positive | None = None
    """The same in lines of the pass's nadir image (`network.joining.straightest`), by its mean line period."""
    times_et_s: tuple[float, ...] = ()
    """Times, s TDB past J2000."""
    times_utc: tuple[str, ...] = ()
    """Times, UTC as in 2008-02-08T12:08:53.843."""

    def images(self, pictures: Sequence[PushbroomImage], where: str) -> OrientationImages:
        """The nodes of a pass of these images; `where` names this table."""
        keys = [key for key in ("spacing_s", "spacing_lines", "times_et_s", "times_utc") if getattr(self, key)]
        if len(keys) > 1:
            raise InputError(where, listed(keys), "one of them")
        edges, epoch = spans(pictures), pictures[0].trajectory.epoch
        start, stop = float(edges[:, 0].min()), float(edges[:, 1].max())
        if self.times_et_s or self.times_utc:
            times = tdb_of_utc(self.times_utc, f"{where}, times_utc") if self.times_utc else np.array(self.times_et_s)
            return OrientationImages("lagrange", epoch, times - epoch)
        spacing = self.spacing_s or SPACING
        if self.spacing_lines is not None:
            reference = pictures[straightest(pictures)]
            first, last = seconds(reference)
            spacing = self.spacing_lines * (last - first) / reference.lines
        key = keys[0] if keys else "spacing_s"
        if keys and spacing > stop - start:
            raise InputError(f"{where}, {key}", f"{spacing:.6g} s", f"less than the pass's {stop - start:.6g} s")
        if (stop - start) / spacing > _MOST_NODES:
            found = f"{spacing:.3g} s, {(stop - start) / spacing:.3g} nodes on {stop - start:.6g} s"
            raise InputError(f"{where}, {key}", found, f"at most {_MOST_NODES} nodes", "a larger spacing")
        return evenly_spaced("lagrange", epoch, (start - epoch, stop - epoch), spacing)


_DEFAULTS = {"": (1.0, 3.0 * MGON / MRAD), "bias_": (50.0, 28.0 * MGON / MRAD), "drift_": (10.0, 5.0 * MGON / MRAD)}
"""m and mrad, of a node's departures from the trend, of the trend's constant part, and of its linear part."""


class NodePriorInput(msgspec.Struct, forbid_unknown_fields=True, frozen=True):
    """A-priori errors of the observed trajectory: bias + drift s + departures, see `network.passes`.

    Sigmas are one number or three: along the body-fixed X, Y, Z and about the camera's axes x, y, z. The default bias
    of the attitude is what Spiegel et al. (papers/003) state of Mars Express; all others are those of simulated blocks.
    """

    position_sigma_m: Sigmas | None = None
    """Departures of a node from the trend; 1 m when absent, inf where nothing is known."""
    angle_sigma_mrad: Sigmas | None = None
    """The same of the attitude; 0.0471 mrad (3 mgon) when absent."""
    position_bias_sigma_m: Sigmas | None = None
    """Constant of the whole pass; 50 m when absent, 0 for none."""
    angle_bias_sigma_mrad: Sigmas | None = None
    """The same of the attitude; 0.440 mrad (28 mgon) when absent."""
    position_drift_sigma_m: Sigmas | None = None
    """Linear in time, at the ends of the pass; 10 m when absent, 0 for none."""
    angle_drift_sigma_mrad: Sigmas | None = None
    """The same of the attitude; 0.0785 mrad (5 mgon) when absent."""
    correlation_time_s: Annotated[float, msgspec.Meta(ge=0.0, le=1e9)] = 60.0
    """In which departures forget themselves to 1/e; 0: nodes know nothing of each other."""

    def prior(self, where: str) -> NodePrior:
        """The record, in m and rad; `where` names this table in errors."""
        parts = dict[str, Array]()
        for part, defaults in _DEFAULTS.items():
            keys = (f"position_{part}sigma_m", 1.0), (f"angle_{part}sigma_mrad", MRAD)
            values = list[Array]()
            for k, ((key, unit), default) in enumerate(zip(keys, defaults, strict=True)):
                value = getattr(self, key)
                stated = three(default if value is None else value, f"{where}, {key}", bool(part), not part) * unit
                if part and value is None:  # a default gives way where nodes know nothing
                    stated = np.where(np.isfinite(parts[""][3 * k : 3 * k + 3]), stated, 0.0)
                values.append(stated)
            parts[part] = np.concatenate(values)
        with errors_from(where):
            return NodePrior(parts[""], parts["bias_"], parts["drift_"], self.correlation_time_s)


Kind = Literal["gauss-markov", "matern-3/2", "matern-5/2", "integrated-wiener", "white"]
"""Gaussian processes (`network.conditioning`)."""
Model = Literal["polynomial", "gauss-markov", "matern-3/2", "matern-5/2", "integrated-wiener", "white"]
"""What a correction is in time."""
Strength = float | list[float] | Literal["estimated"]
"""The same, or found from the measures."""
HIGHEST = 3
"""Degree of polynomials through four orientation images."""
_BEGIN = {"m": 1.0, "mrad": 0.01}
"""In each unit, a-priori value of a strength that is "estimated"."""
_NEGLIGIBLE = 1e-4
"""Of the constant's sigma, departures of what is a line in time beside the process of the other part."""
_FOLLOWING = 0.01
"""Of the constant term's sigma: that of powers for which neither the pass nor [orientation] says any."""


class _OfProcess(msgspec.Struct, forbid_unknown_fields=True, frozen=True, kw_only=True):
    """What all processes have."""

    correlation_time_s: float | None = None
    """In which departures forget themselves (gauss-markov: to 1/e), of gauss-markov and matern."""
    sigma_factor: Annotated[float, msgspec.Meta(gt=1.0, le=1000.0)] | None = None
    """Its strength is found from the measures; its sigma is the a-priori value, within this factor (one standard
    deviation, common to the axes). Of "estimated" alone: e."""


class VibrationInput(msgspec.Struct, forbid_unknown_fields=True, frozen=True):
    """A vibration of a pass's attitude: a sine about each axis, with unknown amounts."""

    frequency_hz: float
    """Known, from one cycle over the pass to a half per line."""
    sigma_mrad: Sigmas
    """A-priori sigma of the amounts of its cosine and of its sine, one number for all axes or three."""
    drift: Annotated[float, msgspec.Meta(ge=0.0, le=10.0)] = 0.0
    """Of that sigma, how much these may change from the middle of the pass to its end, and by which a frequency is
    absorbed that is a little off; 0: not."""


class ProcessInput(_OfProcess, forbid_unknown_fields=True, frozen=True, kw_only=True):
    """A further process, which is added to that of its table."""

    model: Kind
    """Which."""
    sigma_m: Strength | None = None
    """Its strength, of positions; "estimated": found from the measures."""
    sigma_mrad: Strength | None = None
    """The same of the attitude."""


class _Motion(_OfProcess, forbid_unknown_fields=True, frozen=True, kw_only=True):
    """Keys that corrections of position and of attitude share."""

    model: Model = "polynomial"
    """A polynomial of time; or bias and drift with departures about them that are a Gaussian process: stationary with
    a correlation time (the rougher first), or an integrated Wiener process."""
    degree: int | None = None
    """Of the polynomial, 0 to 3; as many as there are sigmas, or else that of [orientation]."""
    plus: tuple[ProcessInput, ...] = ()
    """Further processes, which add up with this one."""


class PositionInput(_Motion, forbid_unknown_fields=True, frozen=True, kw_only=True):
    """Correction of the position along the body-fixed axes X, Y, Z; each sigma is one number for all, or three.

    As [orientation] has it where nothing is said: a polynomial, of s = -1 .. 1 over the pass.
    """

    sigmas_m: list[Sigmas] | None = None
    """A-priori sigma of each of its terms 1, s, s^2, s^3, at s = 1; those of [orientation] when absent."""
    sigma_m: Strength | None = None
    """Of the process: of its departures at any one time (of integrated-wiener in m/s^1.5); "estimated": found from the
    measures."""
    bias_sigma_m: Sigmas | None = None
    """Constant over the pass, beside a process; 0 or absent: none."""
    drift_sigma_m: Sigmas | None = None
    """Linear in time, at the pass's ends, beside a process; 0 or absent: none."""

    unit: ClassVar[str] = "m"
    scale: ClassVar[float] = 1.0
    what: ClassVar[str] = "position"


class AttitudeInput(_Motion, forbid_unknown_fields=True, frozen=True, kw_only=True):
    """Correction of the attitude, rotations about the axes x, y, z of the pass's first camera; each sigma is one number
    for all, or three. As [orientation] has it where nothing is said.
    """

    sigmas_mrad: list[Sigmas] | None = None
    """A-priori sigma of each term 1, s, s^2, s^3 of the polynomial, at s = 1; those of [orientation] when absent."""
    sigma_mrad: Strength | None = None
    """Of the process: of its departures at any one time (of integrated-wiener in mrad/s^1.5); "estimated": found from
    the measures."""
    bias_sigma_mrad: Sigmas | None = None
    """Constant over the pass, beside a process; 0 or absent: none."""
    drift_sigma_mrad: Sigmas | None = None
    """Linear in time, at the pass's ends, beside a process; 0 or absent: none."""

    unit: ClassVar[str] = "mrad"
    scale: ClassVar[float] = MRAD
    what: ClassVar[str] = "attitude"


Motion = PositionInput | AttitudeInput
_OF_PROCESSES = ("sigma", "bias_sigma", "drift_sigma")


def polynomial_sigmas(motion: Motion, default: Array, where: str) -> Array:
    """(degree + 1, 3) m or rad, of a polynomial's terms; unstated ones by `default` (n, 3), of [orientation].

    Raises
    ------
    InputError
        A degree over 3; another number of sigmas than of terms; keys of a process.
    """
    _require_keys(motion, ("sigmas", "degree"), where)
    key = f"sigmas_{motion.unit}"
    values, degree = getattr(motion, key), motion.degree
    if degree is None:
        degree = len(values) - 1 if values is not None else len(default) - 1
    place = f"{where}, degree" if motion.degree is not None else f"{where}, {key}"
    of = "[orientation]" if motion.degree is None and values is None else place
    if degree < 0:
        raise InputError(of, "no sigma" if motion.degree is None else f"{degree}", f"a degree of 0 to {HIGHEST}: one "
                         "sigma for each of its terms")  # fmt: skip
    require(
        degree <= HIGHEST, of, f"a polynomial of degree {degree}", f"0 to {HIGHEST} for a pass",
        'a lower degree, or a process, which follows any course: model = "matern-3/2" with nodes',
    )  # fmt: skip
    if values is None:
        more = [_FOLLOWING * default[0]] * max(degree + 1 - len(default), 0)
        sigmas = np.array([*default[: degree + 1], *more])
        require(np.all(np.isfinite(sigmas)), where, "infinite sigmas, of [orientation]", "finite sigmas here")
        return sigmas
    terms = ", ".join(("1", "s", "s^2", "s^3")[: degree + 1])
    expected = f"{degree + 1} for degree = {degree}: of {terms}"
    require(len(values) == degree + 1, f"{where}, {key}", f"{len(values)} sigmas", expected)
    return np.array([three(value, f"{where}, {key}") for value in values]) * motion.scale


def processes(motion: Motion, where: str) -> tuple[Process, ...]:
    """The processes that departures from bias and drift are the sum of, in m or rad.

    Raises
    ------
    InputError
        No strength; no correlation time where the kind has one; keys of another model.
    """
    _require_keys(motion, (*_OF_PROCESSES, "correlation_time_s", "plus"), where)
    added = [_process(entry, motion, f"{where}.plus[{k}]") for k, entry in enumerate(motion.plus)]
    return (_process(motion, motion, where), *added)


def _process(entry: Motion | ProcessInput, motion: Motion, where: str) -> Process:
    """One process; `motion` is the table that it stands in."""
    assert entry.model != "polynomial"
    key = f"sigma_{motion.unit}"
    for foreign in ("sigma_m", "sigma_mrad"):
        require(foreign == key or getattr(entry, foreign, None) is None, where, f"{foreign}, of {motion.what}", key)
    value = getattr(entry, key)
    if value is None:
        raise InputError(where, f"{entry.model} without a sigma", f'{key}: a number, three, or "estimated"')
    _require_time(entry, where)
    sigmas = np.full(3, _BEGIN[motion.unit]) if value == "estimated" else three(value, f"{where}, {key}")
    estimated = value == "estimated" or entry.sigma_factor is not None
    spread = math.log(entry.sigma_factor or math.e)
    with errors_from(where):
        return Process(entry.model, sigmas * motion.scale, entry.correlation_time_s or 0.0, estimated, spread)


def _require_time(entry: Motion | ProcessInput, where: str) -> None:
    """Raise InputError unless a process has a correlation time where its kind has one."""
    time, timed = entry.correlation_time_s, entry.model in ("gauss-markov", "matern-3/2", "matern-5/2")
    if timed and (time is None or not 0.0 < time <= 1e9):
        found = f"{entry.model} without it" if time is None else f"{time:g}"
        expected = "seconds in which departures forget themselves, above 0"
        remedy = 'nodes that know nothing of each other are a process model = "white"'
        raise InputError(f"{where}, correlation_time_s", found, expected, remedy)
    if not timed and time is not None:
        found = f'correlation_time_s beside model = "{entry.model}"'
        raise InputError(where, found, "keys of that model alone", "take it out")


def trend_sigmas(motion: Motion, default: Array, where: str) -> tuple[Array, Array]:
    """(3,) m or rad, of bias and drift: beside a process as stated, 0 for none; or a polynomial's two terms.

    Raises
    ------
    InputError
        For a polynomial of a higher degree than 1: beside a process only a line can stand.
    """
    if motion.model != "polynomial":
        keys = (f"{part}_sigma_{motion.unit}" for part in ("bias", "drift"))
        bias, drift = (
            three(getattr(motion, key) or 0.0, f"{where}, {key}", zero=True) * motion.scale for key in keys
        )
        return bias, drift
    stated = motion.degree is not None or getattr(motion, f"sigmas_{motion.unit}") is not None
    sigmas = polynomial_sigmas(motion, default if stated else default[:2], where)
    found = f"a polynomial of degree {len(sigmas) - 1} beside a process of the other part"
    require(len(sigmas) <= 2, where, found, "degree 0 or 1", "a process here, too")
    return sigmas[0], sigmas[1] if len(sigmas) > 1 else np.zeros(3)


def negligible_departures(bias: Array) -> tuple[Process, ...]:
    """Negligible departures: of a part that is a line in time, with the sigma (3,) of its constant."""
    return (Process("white", _NEGLIGIBLE * bias),)


def _require_keys(motion: Motion, allowed: tuple[str, ...], where: str) -> None:
    """Raise InputError for keys that the model ignores."""
    for key, value in msgspec.structs.asdict(motion).items():
        if key != "model" and value not in (None, ()) and key not in allowed and key.rsplit("_", 1)[0] not in allowed:
            raise InputError(where, f'{key} beside model = "{motion.model}"', "keys of that model alone", "take it out")

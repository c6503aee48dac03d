"""Gaussian processes in time: what is known of errors of a trajectory between its nodes.

A process has a kind and a strength (sigma) along each of three axes. Stationary kinds have covariance sigma^2 rho(dt):

    white            rho = 1 at dt = 0, else 0
    gauss-markov     exp(-r),                    r = |dt| / correlation time    (Rasmussen & Williams 2006, 4.18)
    matern-3/2       (1 + c) exp(-c),            c = sqrt(3) r                  (4.17)
    matern-5/2       (1 + c + c^2 / 3) exp(-c),  c = sqrt(5) r                  (4.17)
    jitter           exp(-d) (cos w + (d / w) sin w),  d = pi bandwidth |dt|,  w = 2 pi sqrt(f^2 - bandwidth^2 / 4) |dt|

Jitter is a damped oscillator driven by white noise (Foreman-Mackey et al. 2017, eq. 20-23, with Q = f / bandwidth): its
spectrum has a peak at the frequency f, of full width `bandwidth` at half its height. The integrated Wiener process is
an acceleration of white noise: x'' = sigma w(t), zero and at rest at its origin, from which it goes on both ways;
with t and t' counted from there,

    integrated-wiener   sigma^2 a^2 (3 b - a) / 6,   a = min(|t|, |t'|), b = max(|t|, |t'|)     (Wahba 1978)

on the same side of the origin, and 0 across it.
"""

import math
from dataclasses import dataclass, replace
from typing import Literal, get_args

import numpy as np

from mgsgraph.errors import InputError
from mgsgraph.geometry.records import Array, assign, frozen
from mgsgraph.record import Record

ProcessKind = Literal["white", "gauss-markov", "matern-3/2", "matern-5/2", "integrated-wiener", "jitter"]
"""The kinds of processes."""
_LONGEST = 1e9
"""s; a process that takes longer to forget itself can't be told from a constant."""


@dataclass(frozen=True, slots=True, eq=False)
class Process(Record):
    """A Gaussian process of three components that know nothing of each other."""

    kind: ProcessKind
    """Which."""
    sigmas: Array
    """(3,) strength: m or rad; of an integrated Wiener process m/s^1.5 or rad/s^1.5."""
    correlation_time: float = 0.0
    """s, of gauss-markov and Matern processes; of others 0."""
    frequency: float = 0.0
    """Hz, of jitter; of others 0."""
    bandwidth: float = 0.0
    """Hz, full width of jitter's spectral peak at half its height; of others 0."""
    estimated: bool = False
    """Whether its strength is found from the measures, `sigmas` being where the search begins."""

    def __post_init__(self) -> None:
        where = f"process {self.kind}"
        if self.kind not in get_args(ProcessKind):
            raise InputError("process, kind", repr(self.kind), f"one of {', '.join(get_args(ProcessKind))}")
        sigmas = frozen(self.sigmas, f"{where}, sigmas", (3,))
        if not np.all(np.isfinite(sigmas) & (sigmas > 0.0)):
            raise InputError(f"{where}, sigmas", f"{sigmas.tolist()}", "three positive finite numbers")
        assign(self, sigmas=sigmas)
        timed = self.kind in ("gauss-markov", "matern-3/2", "matern-5/2")
        _require(where, "correlation time", self.correlation_time, "s", timed, _LONGEST)
        _require(where, "frequency", self.frequency, "Hz", self.kind == "jitter", math.inf)
        _require(where, "bandwidth", self.bandwidth, "Hz", self.kind == "jitter", self.frequency)

    @property
    def stationary(self) -> bool:
        """Whether its covariance depends on the difference of times alone."""
        return self.kind != "integrated-wiener"

    def covariance(self, one: Array, other: Array, origin: float) -> Array:
        """Covariance, for sigma = 1, between times of two arrays that broadcast, in their precision; times in s.

        Parameters
        ----------
        origin : float
            s, when an integrated Wiener process is zero and at rest.
        """
        if self.kind == "integrated-wiener":
            t, u = one - origin, other - origin
            low, high = np.minimum(np.abs(t), np.abs(u)), np.maximum(np.abs(t), np.abs(u))
            return np.asarray(np.where(t * u > 0.0, low**2 * (3.0 * high - low) / 6.0, 0.0))
        return self._correlation(np.abs(one - other))

    def _correlation(self, apart: Array) -> Array:
        """Of times `apart` (s, not negative)."""
        if self.kind == "white":
            return np.asarray(np.where(apart == 0.0, 1.0, 0.0).astype(apart.dtype))
        if self.kind == "jitter":
            damping = np.pi * self.bandwidth * apart
            phase = 2.0 * np.pi * math.sqrt(self.frequency**2 - 0.25 * self.bandwidth**2) * apart
            # sin(phase) / phase, so that nothing is divided by zero
            return np.asarray(np.exp(-damping) * (np.cos(phase) + damping * np.sinc(phase / np.pi)))
        r = apart / self.correlation_time
        if self.kind == "matern-3/2":
            r = np.sqrt(apart.dtype.type(3.0)) * r
            return np.asarray((1.0 + r) * np.exp(-r))
        if self.kind == "matern-5/2":
            r = np.sqrt(apart.dtype.type(5.0)) * r
            return np.asarray((1.0 + r + r**2 / 3.0) * np.exp(-r))
        return np.asarray(np.exp(-r))

    def scaled(self, factors: Array) -> "Process":
        """With its sigmas times factors (3,)."""
        return replace(self, sigmas=self.sigmas * factors)


def _require(where: str, name: str, value: float, unit: str, wanted: bool, most: float) -> None:
    """A positive number up to `most` where it is wanted, else 0."""
    if wanted and not (0.0 < value <= most and math.isfinite(value)):
        limit = f" up to {most:g} {unit}" if math.isfinite(most) else f" of {unit}"
        raise InputError(f"{where}, {name}", f"{value} {unit}", f"a positive number{limit}")
    if not wanted and value != 0.0:
        raise InputError(f"{where}, {name}", f"{value} {unit}", f"none: a process {where.split()[1]} has no {name}")

"""Vibrations as unknowns of passes: frequencies found in residuals and refined by adjustments, amplitudes as far as
rays show them.

found = estimated_vibrations(network, settings)   # adjusts, looks at residuals, adds lines, until none is left
print(found.sentences)

Residuals don't tell which pass vibrates: each vibration is an unknown of all passes and axes, with an a-priori sigma
of a pixel at least (`SharedUnknown.of_vibration`). A frequency comes in where noise alone would show as clear a line at
any frequency once in a thousand times (`residual_spectrum`). A frequency that is off by df makes of amounts c, s of
cosine and sine the drifts (2 pi df h) (s, -c) over a half length h of the pass: least squares on the drifts found give
df, and a new adjustment, until it is less than a tenth of its sigma (Gauss-Newton). Then a drift stays an unknown where
2 log likelihood rises by more than log n for each of its amounts (BIC, n image coordinates); else it is held to what
the frequency's own sigma leaves open, so that the amplitude's sigma has that in it.

No stated sigma comes from the prior: only amounts whose variance is below a tenth of the a-priori one are stated. A
pair shows the *difference* of its passes at the same ground: of all amounts x with the covariance C and L = C^-1, the
combination x_j + sum_k L_jj^-1 L_jk x_k is the surest with x_j in it; its covariance is L_jj^-1.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from mgsgraph.adjustment.adjust import adjust_network
from mgsgraph.adjustment.cluster.connection import Connection
from mgsgraph.adjustment.settings import Progress, SolverSettings
from mgsgraph.adjustment.solution import Solution
from mgsgraph.analysis.process_strengths import estimated_strengths
from mgsgraph.analysis.residual_spectrum import residual_vibrations
from mgsgraph.geometry.records import Array, Index
from mgsgraph.names import grouped
from mgsgraph.network import Network, SharedUnknown
from mgsgraph.network.joining import seconds, sine_over
from mgsgraph.record import Record
from mgsgraph.units import ARCSEC, DEG
from mgsgraph.workers import no_progress

FALSE_ALARMS = 1e-3
"""Share of calm turns in which a line is added all the same."""
SEEN = 0.1
"""Of the a-priori variance, what rays leave at most of an amount that is stated."""
LEAST = 3.0
"""Sigmas of an amplitude that is stated; of a smaller one its upper limit is."""
_LIMIT = 1.645
"""Sigmas, to the limit that 95 % are below."""
_AXES = ("x (roll)", "y (pitch)", "z (yaw)")
_DRIFT = 0.3
"""Of the amplitude's a-priori sigma, that of its drift."""
_AMPLITUDES, _SMALLEST = 2.0, 1.0
"""That sigma, in amplitudes that residuals show; and in pixels, at least."""
_MOST_LINES, _MOST_ROUNDS = 8, 10
_RATES = 0.2, 3.0
"""By how much less a frequency's step may become as the frequency moves by it; 1 were all linear."""
_CONVERGED = 0.1
"""Sigmas of a frequency by which it may still change."""
_ROUGH = 1e-2
"""Posterior sigmas, last step of adjustments on the way."""
_SURER = 0.5
"""Of a pass's own sigma, that of a difference that is stated beside it."""


@dataclass(frozen=True, slots=True)
class Line(Record):
    """A frequency at which passes vibrate."""

    frequency: float
    """Hz."""
    sigma: float
    """Hz."""
    size: float
    """px, amplitude by residuals."""
    drift: float = _DRIFT
    """Of the amplitude's a-priori sigma, that of its drift."""
    drifts: bool = False
    """Whether the likelihood asks for a drift."""


@dataclass(frozen=True, slots=True)
class Amplitude(Record):
    """What rays show of a vibration about one axis of passes."""

    frequency: float
    """Hz."""
    axis: str
    """Of the passes."""
    unknowns: tuple[int, ...]
    """Shared unknowns of the network: that of the pass, then those that are taken off where one is not seen alone."""
    weights: tuple[tuple[float, float], ...]
    """Of each of the others, how much is taken off: real and imaginary part, of amounts cos - i sin."""
    value: float
    """rad, without what noise adds to the length of two amounts; NaN where nothing is seen."""
    sigma: float
    """rad, for sigma0 = 1."""
    phase: float
    """rad, of A cos(2 pi f t - phase), t from the middle of the pass."""
    pixel: float
    """rad, of a pixel of the first pass."""
    names: tuple[str, ...]
    """Of the passes, or of images without one."""

    @property
    def shown(self) -> bool:
        """Whether it is above noise; else all that is known is what it is below."""
        return self.value > LEAST * self.sigma

    @property
    def sentence(self) -> str:
        """In a sentence."""
        off = [
            f" minus {name} (times {abs(complex(*w)):.3g}, phase shifted by {np.angle(complex(*w)) / DEG:.0f} deg)"
            for w, name in zip(self.weights, self.names[1:], strict=True)
        ]
        what = f"Vibration of {self.frequency:.4f} Hz about {self.axis} of {self.names[0]}{''.join(off)}"
        if np.isnan(self.value):
            return f"{what}: not seen."
        if not self.shown:
            return f"{what}: below {(self.value + _LIMIT * self.sigma) / self.pixel:.2g} px (95 %)."
        degrees, spread = self.phase / DEG, self.sigma / self.value / DEG
        return (
            f"{what}: {self.value / self.pixel:.3f} +- {self.sigma / self.pixel:.2g} px "
            f"({self.value / ARCSEC:.3g} +- {self.sigma / ARCSEC:.2g} arcsec), phase {degrees:.0f} +- {spread:.2g} deg."
        )


@dataclass(frozen=True, slots=True, eq=False)
class EstimatedVibrations(Record):
    """Vibrations, and the adjustment with them."""

    network: Network
    """With unknowns for them."""
    solution: Solution
    """Of it."""
    lines: tuple[Line, ...]
    """Their frequencies, in the order in which they were found."""
    converged: bool
    """Whether frequencies converged, and no more lines are seen."""

    @property
    def sentences(self) -> list[str]:
        """One for each frequency, then one for each amplitude."""
        lines = [
            f"Vibration found: {line.frequency:.4f} +- {line.sigma:.2g} Hz{', drifting' if line.drifts else ''}."
            for line in self.lines
        ] or [f"No vibration found ({100.0 * FALSE_ALARMS:g} % false alarms)."]
        lines += [amplitude.sentence for amplitude in amplitudes(self.solution)]
        return lines if self.converged else [*lines, "The search for vibrations did NOT converge."]


def estimated_vibrations(
    network: Network,
    settings: SolverSettings,
    name: str = "adjustment",
    progress: Progress = no_progress,
    adjust: Callable[..., Solution] = adjust_network,
    passes: Sequence[str] = (),
) -> EstimatedVibrations:
    """Find the vibrations that rays show, and adjust with them.

    Parameters
    ----------
    network : Network
        Its passes vibrate, and images without one.
    settings : SolverSettings
    name : str
        What to call the adjustment in reports.
    progress : callable
        Called with every iteration of every adjustment.
    adjust : callable
        That adjusts a network, of the same four arguments: `adjust_network`, or one that finds strengths, too.
    passes : sequence of str
        Names of the passes that vibrate; all, and images without one, when empty.

    Raises
    ------
    InputError
        Where no image has rays enough; and what `adjust_network` raises.
    """
    lines, converged, owners = list[Line](), True, _owners(network, passes)
    solution = adjust(network, settings, name, progress)
    while new := _new_lines(solution, lines, owners):
        if len(lines) >= _MOST_LINES:
            return EstimatedVibrations(solution.network, solution, tuple(lines), False)
        lines, refined_converged = _refined(network, owners, [*lines, *new], settings, name, progress)
        converged &= refined_converged
        solution = adjust(with_lines(network, owners, lines), settings, name, progress)
    return EstimatedVibrations(solution.network, solution, tuple(lines), converged)


Owners = Sequence[tuple[str, Index]]
"""Names of passes, or of images without one, and their images."""


def _owners(network: Network, passes: Sequence[str]) -> Owners:
    """Those that vibrate."""
    alone = [(network.images[j].name, np.array([j])) for j in np.flatnonzero(network.pass_of < 0).tolist()]
    named = [(pass_.name, pass_.images) for pass_ in network.passes if pass_.name in passes or not passes]
    return named if passes else [*named, *alone]


def _new_lines(solution: Solution, lines: Sequence[Line], owners: Owners) -> list[Line]:
    """Lines that residuals show, the clearest of those that the passes' times do not resolve."""
    network, new = solution.network, list[Line]()
    resolution = max(1.0 / np.ptp([seconds(network.images[j]) for j in images.tolist()]) for _, images in owners)
    known = [*lines, *(Line(shared.sine.frequency, 0.0, 0.0) for shared in network.shared if shared.sine is not None)]
    for vibration in residual_vibrations(solution, FALSE_ALARMS).vibrations:
        if all(abs(vibration.frequency - line.frequency) > resolution for line in (*known, *new)):
            new.append(Line(vibration.frequency, vibration.frequency_sigma, vibration.amplitude))
    return new


def with_lines(network: Network, owners: Owners, lines: Sequence[Line]) -> Network:
    """With an unknown of each line and pass."""
    more = list[SharedUnknown]()
    for line in lines:
        for name, images in owners:
            sine = sine_over([network.images[j] for j in images.tolist()], line.frequency)
            sigma = max(_AMPLITUDES * line.size, _SMALLEST) * network.images[int(images[0])].pixel_angle
            called = f"vibration of {line.frequency:.4f} Hz, {name}"
            more.append(SharedUnknown.of_vibration(called, images, sine, np.full(3, sigma), line.drift))
    return replace(network, shared=(*network.shared, *more))


def _refined(
    network: Network, owners: Owners, lines: list[Line], settings: SolverSettings, name: str,
    progress: Progress,
) -> tuple[list[Line], bool]:
    """Lines with refined frequencies, and whether these converged; with what their drifts may be."""
    rough = replace(settings, step_tolerance=max(settings.step_tolerance, _ROUGH))
    lines, begin = [replace(line, drift=_DRIFT) for line in lines], None
    before = moved = np.ones(len(lines))
    for done in range(_MOST_ROUNDS):
        solution = adjust_network(with_lines(network, owners, lines), rough, name, progress, begin=begin)
        numbers = np.arange(len(network.shared), len(solution.shared)).reshape(len(lines), -1)
        begin, drifts = solution.values, [_drifts(solution, members) for members in numbers.tolist()]
        steps = np.array([drift.step for drift in drifts])
        # by secants: where amplitudes are hardly above noise, steps are too short or too long
        before, moved = steps, steps / (np.clip((before - steps) / moved, *_RATES) if done else 1.0)
        lines = [
            replace(line, frequency=line.frequency + step, sigma=at.sigma)
            for line, at, step in zip(lines, drifts, moved.tolist(), strict=True)
        ]
        if refined_converged := all(abs(drift.step) < _CONVERGED * drift.sigma for drift in drifts):
            break
    least = np.log(2.0 * network.rays.point.size)
    return [_chosen(line, at, at.gain > least) for line, at in zip(lines, drifts, strict=True)], refined_converged


class _Drifts(NamedTuple):
    """What an adjustment says of a line's drifts."""

    step: float
    """Hz, by which the frequency is off."""
    sigma: float
    """Hz, of it."""
    gain: float
    """Of 2 log likelihood, by the drifts, for each amount of them that rays show."""
    half: float
    """s, half length of the longest pass."""


def _drifts(solution: Solution, members: list[int]) -> _Drifts:
    """Of the shared unknowns of a line."""
    unknowns = [solution.network.shared[k] for k in members]
    drift = np.arange(12 * len(members)) % 4 > 1
    covariance = solution.joint_covariance.of([solution.shared_variable(k) for k in members])
    values, joint = np.concatenate([solution.shared[k] for k in members]), covariance[np.ix_(drift, drift)]
    prior, information = np.concatenate([unknown.sigmas for unknown in unknowns])[drift] ** -2.0, np.linalg.inv(joint)
    pushed, shown = information @ values[drift], max(float(np.sum(1.0 - np.diag(joint) * prior)), 1.0)
    # those that there are without a drift: beside one they are less certain, and noise in them would count as known
    amounts = (values[~drift] - covariance[np.ix_(~drift, drift)] @ pushed).reshape(-1, 2)
    halves = np.repeat([unknown.sine.half for unknown in unknowns if unknown.sine is not None], 3)
    slope = (2.0 * np.pi * halves[:, None] * amounts[:, ::-1] * [1.0, -1.0]).ravel()
    certainty = max(float(slope @ (information - np.diag(prior)) @ slope), 1e-12)
    gain = float(values[drift] @ pushed) / shown
    return _Drifts(float(slope @ pushed) / certainty, certainty**-0.5, gain, float(halves.max()))


def _chosen(line: Line, at: _Drifts, drifts: bool) -> Line:
    """A line that drifts, or one with no other drift than that of its frequency's sigma."""
    drift = 2.0 * np.pi * at.half * line.sigma * line.size / max(_AMPLITUDES * line.size, _SMALLEST)
    return replace(line, drift=_DRIFT if drifts else min(drift, _DRIFT), drifts=drifts)


def adjusted(
    network: Network, settings: SolverSettings, name: str, progress: Progress,
    vibrating: Sequence[str] = (), workers: Connection | None = None,
) -> tuple[Solution, list[str]]:
    """An adjustment with all that is to be found on the way, strengths of processes and vibrations of passes, and what
    was found of these in sentences.
    """
    sentences = list[str]()

    def once(
        network: Network, settings: SolverSettings, name: str, progress: Progress
    ) -> Solution:
        if not any(pass_.asks_for_strengths for pass_ in network.passes):
            return adjust_network(network, settings, name, progress, workers)
        strengths = estimated_strengths(network, settings, name=name, progress=progress)
        sentences[:] = strengths.sentences
        return strengths.solution

    if not vibrating:
        return once(network, settings, name, progress), sentences
    vibrations = estimated_vibrations(network, settings, name, progress, once, vibrating)
    return vibrations.solution, [*sentences, *vibrations.sentences]


def amplitudes(solution: Solution) -> tuple[Amplitude, ...]:
    """What rays show of all vibrations that are unknowns."""
    sines = [(unknown.sine, k) for k, unknown in enumerate(solution.network.shared)]
    of_frequency = grouped((sine.frequency, k) for sine, k in sines if sine is not None)
    records = list[Amplitude]()
    for members in of_frequency.values():
        joint = solution.joint_covariance.of([solution.shared_variable(k) for k in members])
        for axis in range(3):
            rows = (12 * np.arange(len(members))[:, None] + 4 * axis + np.arange(2)).ravel()
            records += _of_axis(solution, members, axis, joint[np.ix_(rows, rows)])
    return tuple(records)


def _of_axis(solution: Solution, members: list[int], axis: int, joint: Array) -> Iterator[Amplitude]:
    """Amplitudes of passes that are seen by themselves, and the surest difference where it is surer; or that nothing is
    seen. `joint` (2 m, 2 m) is the covariance of the amounts of m unknowns.
    """
    m, blocks = len(members), [slice(2 * j, 2 * j + 2) for j in range(len(members))]
    amounts = np.array([solution.shared[k][4 * axis : 4 * axis + 2] for k in members])
    prior = np.array([solution.network.shared[k].sigmas[4 * axis] ** 2 for k in members])
    information = np.linalg.inv(joint)
    surest = [np.linalg.inv(information[block, block]) for block in blocks]
    alone, least = (np.array([np.trace(variance) / 2.0 for variance in matrices]) for matrices in
                    ([joint[block, block] for block in blocks], surest))  # fmt: skip
    best, visible = int(np.argmin(least / prior)), np.flatnonzero(alone < SEEN * prior).tolist()
    for j in visible:
        yield _stated(solution, [members[j]], axis, [], amounts[j], joint[blocks[j], blocks[j]])
    if m > 1 and least[best] < min(SEEN * prior[best], _SURER**2 * alone[best]):
        partners = [k for k in range(m) if k != best]
        taken = [-surest[best] @ information[blocks[best], blocks[k]] for k in partners]
        difference = amounts[best] - sum(w @ amounts[k] for w, k in zip(taken, partners, strict=True))
        yield _stated(solution, [members[best], *(members[k] for k in partners)], axis, taken, difference, surest[best])
    elif not visible:
        yield _stated(solution, members[:1], axis, [], np.full(2, np.nan), np.eye(2))


def _stated(
    solution: Solution, members: list[int], axis: int, taken: list[Array], amounts: Array, covariance: Array
) -> Amplitude:
    """The record; `taken` (2, 2) are what is taken off of the others."""
    network = solution.network
    owners = [int(network.shared[k].images[0]) for k in members]
    names = (network.images[j].name if (of := int(network.pass_of[j])) < 0 else network.passes[of].name
             for j in owners)  # fmt: skip
    size = max(float(np.hypot(*amounts)), 1e-300)
    along = amounts / size
    across = np.array([-along[1], along[0]])
    value = np.sqrt(np.maximum(size**2 - across @ covariance @ across, 0.0))
    sine = network.shared[members[0]].sine
    assert sine is not None
    # on amounts cos - i sin a matrix ((a, b), (-b, a)) is a product by a + i b
    weights = tuple((0.5 * float(w[0, 0] + w[1, 1]), 0.5 * float(w[0, 1] - w[1, 0])) for w in taken)
    return Amplitude(
        sine.frequency, _AXES[axis], tuple(members), weights, float(value), float(np.sqrt(along @ covariance @ along)),
        float(np.arctan2(amounts[1], amounts[0])), network.images[owners[0]].pixel_angle, tuple(names),
    )  # fmt: skip

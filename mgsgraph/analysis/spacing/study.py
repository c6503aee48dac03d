"""All questions to the spacing of a network's orientation images at once: which one, where closer, what vibrates."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

from mgsgraph.adjustment.settings import SolverSettings
from mgsgraph.adjustment.solution import Solution
from mgsgraph.adjustment.two_steps import selection_of
from mgsgraph.analysis.spacing.choice import Choice, adjust_unmarked, choose_spacing, respaced
from mgsgraph.analysis.spacing.corrections import CorrectionSeries, correction_series
from mgsgraph.analysis.spacing.densify import Densified, densify
from mgsgraph.analysis.spacing.spectrum import Spectrum, spectra
from mgsgraph.network import Network

_FEWEST = 8
"""Values of a strip's corrections that a spectrum takes."""


@dataclass(frozen=True, slots=True, eq=False)
class StripSpectra:
    """What vibrates in one strip."""

    corrections: CorrectionSeries
    """Its corrections, at the closest nodes that all rays support."""
    spectra: tuple[Spectrum, ...]
    """Of the six axes."""


@dataclass(frozen=True, slots=True, eq=False)
class NodeStudy:
    """What was found."""

    name: str
    """Of the case."""
    choice: Choice
    """Of the spacing."""
    solution: Solution
    """With the spacing chosen, all rays taking part."""
    corrections: tuple[CorrectionSeries, ...]
    """Of each strip in it."""
    strips: tuple[StripSpectra, ...]
    """Of each strip that has enough closest nodes."""
    densified: Densified | None
    """Nodes where residuals ask for them, from the widest candidate on; None where that was not asked for."""


def study_nodes(
    network: Network,
    settings: SolverSettings,
    name: str,
    spacings: Sequence[float],
    share: float = 0.2,
    seed: int = 0,
    closer: bool = False,
    progress: Callable[[int, int], None] = lambda _done, _most: None,
) -> NodeStudy:
    """Choose a spacing, adjust with it, look for vibrations, and for places that ask for closer nodes.

    Parameters
    ----------
    network : Network
        With strips.
    settings : SolverSettings
        The blunder limit holds in the adjustments of all rays with the closest nodes and with those chosen; closer ones
        are looked for among the rays that the former leaves.
    name : str
        Of the case.
    spacings : sequence of float
        s, candidates.
    share, seed
        See `choose_spacing`.
    closer : bool
        Whether to give nodes to the widest candidate that the rays support, where residuals ask for them.
    progress : callable
        Called with the number of steps done, and of all.
    """
    steps = len(set(spacings)) + 2 + closer  # all rays with the closest nodes, and with those chosen
    choice = choose_spacing(network, settings, spacings, share, seed, progress=lambda done, _: progress(done, steps))
    good = [one.spacing for one in choice.candidates if not one.refused]
    closest = replace(choice.closest_solution, name=name)
    progress(steps - 1 - closer, steps)
    own = choice.chosen == choice.closest
    solution = closest if own else adjust_unmarked(choice.chosen_network, settings, name)
    strips, factor = range(len(network.passes)), choice.scatter.factor
    fine = [correction_series(closest, k, factor) for k in strips]
    found = tuple(StripSpectra(one, tuple(spectra(one))) for one in fine if one.times.size >= _FEWEST)
    corrections = tuple(fine) if own else tuple(correction_series(solution, k, factor) for k in strips)
    progress(steps - closer, steps)
    densified = _densified(respaced(network, good[-1]), closest) if closer else None
    progress(steps, steps)
    return NodeStudy(name, choice, solution, corrections, found, densified)


def _densified(network: Network, closest: Solution) -> Densified:
    """Nodes where residuals ask for them, of the rays that the closest nodes left: jitter that wide ones can't follow
    is no blunder.
    """
    plain = replace(closest.settings, reject=0.0)
    found = densify(network, plain, left_in=selection_of(network, closest))
    return replace(found, solution=replace(found.solution, name=closest.name))

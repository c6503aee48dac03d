"""Does the chosen spacing of orientation images predict rays held out better, and does planted jitter appear?

Simulated HRSC strips with and without jitter; every candidate spacing, closer nodes where residuals ask for them, and
the spectrum of the closest. Writes a table, docs/node_spacing.md by default.

    python scripts/node_spacing.py [--seeds 3] [--points 1500] [--out FILE]
"""

import sys
import time
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from study import DOCS, at_least, command, show, table, write_page

from mgsgraph.adjustment.adjust import adjust_network
from mgsgraph.adjustment.settings import SolverSettings
from mgsgraph.analysis.spacing.choice import Choice, choose_spacing, respaced
from mgsgraph.analysis.spacing.corrections import correction_series
from mgsgraph.analysis.spacing.densify import densify
from mgsgraph.analysis.spacing.rays import hold_out, misfits, whitening
from mgsgraph.analysis.spacing.spectrum import Peak, spectra
from mgsgraph.simulation.hrsc_block import BlockSettings, TrajectoryErrors, simulate_hrsc_block
from mgsgraph.simulation.strip_truth import Jitter
from mgsgraph.text import root_mean_square
from mgsgraph.units import MGON

SPACINGS = (2.0, 4.0, 8.0, 16.0, 32.0)
"""s."""
SHARE = 0.2
CALM = TrajectoryErrors(attitude_wander=0.3 * MGON, position_wander=0.3)
CASES: dict[str, tuple[TrajectoryErrors, Jitter | None, float]] = {
    "calm": (CALM, None, 1.0),
    "calm; sigmas stated half as large": (CALM, None, 0.5),
    "wandering": (TrajectoryErrors(), None, 1.0),
    "wandering; pitch 3 mgon at 0.03 Hz": (TrajectoryErrors(), Jitter(3.0 * MGON, 0.03, "pitch"), 1.0),
    "wandering; pitch 3 mgon at 0.06 Hz": (TrajectoryErrors(), Jitter(3.0 * MGON, 0.06, "pitch"), 1.0),
    "wandering; roll 2 mgon at 0.11 Hz": (TrajectoryErrors(), Jitter(2.0 * MGON, 0.11, "roll"), 1.0),
    "calm; pitch 3 mgon at 0.06 Hz": (CALM, Jitter(3.0 * MGON, 0.06, "pitch"), 1.0),
}
WORDS = """# How close orientation images should stand

Simulated HRSC strips of 200 km, flown over in 98 s, five lines, image noise 0.4 px (about 2 mgon) in macropixels.
Nominal trajectories are off by 28 mgon and 50 m with a drift and departures (Gauss-Markov, 60 s), which the prior
states: 0.3 mgon and 0.3 m *calm*, 3 mgon and 1 m *wandering*. True nodes stand every 2 s. Jitter is known to no prior.
Made by `scripts/node_spacing.py`.

* *2 s ... 32 s*: rms misfit of one ray each of a fifth of the points, held out of the adjustment, in sigmas that it has
  when orientation is known, as stated; mean over the seeds. 1 is noise of the stated size.
* *chosen*: the coarsest spacing no worse than the best by more than one standard error of the difference, ray by ray;
  its rms and its number of nodes (means).
* *densified*: nodes given, from 32 s on, to intervals whose residuals ask for them; the same rays held out.
* *vibrations named*: per seed, in the spectrum of nodes every 2 s; mgon (m of positions) and Hz.

TABLE

What it says. Where the flight is calm, nodes 16 s apart predict as well as those 2 s apart. Jitter takes nodes closer
than a quarter of its period, and held-out rays ask for them; the spectrum names its axis, frequency and amplitude, and
names none without. Sigmas of rays that are stated half as large as they are double all misfits, but ask for no nodes
and make no vibrations: patterns are held against how much rays of one line scatter within a moment. (At 0.03 Hz there
are three periods, and the wandering trajectory blurs them.) In the last row the prior allows departures of 0.3 mgon
where 3 are flown: close nodes are held back by it, no spacing predicts well, and residuals ask for nodes in vain. The
spectrum still tells what vibrates, and `mgsgraph nodes` says that the prior is too narrow.

Bumps in the noise floor are real: a vibration whose period is the time by which one line follows the next over the
ground (here about 7.6 s, 0.13 Hz) moves both alike, and the points with them.
"""


@dataclass(frozen=True, slots=True, eq=False)
class Run:
    """One strip."""

    choice: Choice
    closer_nodes: int
    closer_rms: float
    vibrations: list[tuple[str, Peak]]


def run(errors: TrajectoryErrors, jitter: Jitter | None, stated: float, seed: int, points: int) -> Run:
    """Choose a spacing, give nodes where residuals ask for them, and look for vibrations."""
    settings = BlockSettings(
        strips=1, length=200e3, points=points, terrain=None, spacing=32.0, true_spacing=2.0, jitter=jitter,
        errors=errors,
    )  # fmt: skip
    net, plain = simulate_hrsc_block(settings, seed).network, SolverSettings()
    net = replace(net, rays=replace(net.rays, sigmas=stated * net.rays.sigmas))
    choice = choose_spacing(net, plain, SPACINGS, SHARE, seed)
    held = hold_out(net, SHARE, np.random.default_rng(seed))
    closer = densify(respaced(net, SPACINGS[-1]), plain, left_in=held.left_in(net)).solution
    white = np.einsum("hij,hj->hi", whitening(net, held, closer.places), misfits(closer, held))
    fine = correction_series(adjust_network(respaced(net, SPACINGS[0]), plain), 0)
    found = [(spectrum.axis, peak) for spectrum in spectra(fine) for peak in spectrum.vibrations]
    nodes = sum(len(strip.nodes) for strip in closer.network.passes)
    return Run(choice, nodes, root_mean_square(white), found)


def row(name: str, runs: list[Run]) -> list[str]:
    """Of the table."""
    rms = np.array([[one.rms for one in run.choice.candidates] for run in runs]).mean(axis=0)
    chosen = [f"{run.choice.spacing:g}" for run in runs]
    at_chosen = float(np.mean([run.choice.candidates[run.choice.chosen].rms for run in runs]))
    nodes = float(np.mean([run.choice.candidates[run.choice.chosen].nodes for run in runs]))
    closer = float(np.mean([run.closer_rms for run in runs]))
    closer_nodes = float(np.mean([run.closer_nodes for run in runs]))
    peaks = "; ".join(
        ", ".join(
            f"{axis} {peak.amplitude / (MGON if 'position' not in axis else 1.0):.2f} at {peak.frequency:.3f}"
            for axis, peak in run.vibrations
        ) or "none"
        for run in runs
    )  # fmt: skip
    cells = [name, *(f"{one:.3f}" for one in rms), " ".join(chosen), f"{at_chosen:.3f} ({nodes:.0f})"]
    return [*cells, f"{closer:.3f} ({closer_nodes:.0f})", peaks]


def main() -> int:
    """Run all, and write the page."""
    parser = command(__doc__)
    parser.add_argument("--seeds", type=at_least(1), default=3)
    parser.add_argument("--points", type=at_least(1), default=1500)
    parser.add_argument("--out", type=Path, default=DOCS / "node_spacing.md")
    wanted = parser.parse_args()

    def page() -> str:
        began, rows = time.perf_counter(), []
        for name, case in CASES.items():
            show(name)
            rows.append(row(name, [run(*case, seed, wanted.points) for seed in range(1, wanted.seeds + 1)]))
        head = ["flight", *(f"{one:g} s" for one in SPACINGS), "chosen (s)", "there (nodes)", "densified (nodes)",
                "vibrations named (mgon, Hz)"]  # fmt: skip
        took = f"{wanted.seeds} seeds, {wanted.points} points a strip, {time.perf_counter() - began:.0f} s."
        return WORDS.replace("TABLE", "\n".join([*table(head, rows), "", took]))

    return write_page(parser, wanted.out, page)


if __name__ == "__main__":
    sys.exit(main())

"""Do Gaussian processes as priors give what today's strips, dense covariances and polynomials give? Whole adjustments.

    python scripts/process_priors.py [--seeds 1] [--out docs/process_priors.md]

The same simulated HRSC blocks adjusted twice, with one prior and with another that says the same in other rows. Largest
differences over all nodes and points: of values in sigmas of the second adjustment, of sigmas and of the cost as shares
(`tests/adjustment/test_process_priors.py` holds them, and polynomials of passes against those of images).
"""

import sys
from argparse import Namespace
from pathlib import Path

from study import DOCS, OneLine, at_least, command, made_with, show, table, write_page

from mgsgraph.adjustment.adjust import adjust_network
from mgsgraph.simulation.hrsc_block import BlockSettings, simulate_hrsc_block

sys.path[:0] = [str(Path(__file__).resolve().parents[1] / name) for name in ("tests", "tests/adjustment")]
from test_process_priors import TIGHT, as_process, dense, differences, with_prior  # noqa: E402

SMALL = BlockSettings(strips=2, points=120, length=200e3, terrain=None)
LARGE = BlockSettings(strips=4, points=1500, length=600e3, terrain=None)
ONE = BlockSettings(strips=1, points=300, length=800e3, spacing=12.0, terrain=None)
NAMES = ("cost", "nodes", "sigmas of nodes", "points", "sigmas of points")
HEAD = ("prior", "against", "block", "seed", "nodes", "neighbours", *NAMES)


def rows(seed: int) -> list[list[str]]:
    """Cells of all comparisons of one seed."""
    found = list[list[str]]()
    for name, block in (("2 strips of 200 km", SMALL), ("4 strips of 600 km", LARGE)):
        show(f"seed {seed}: {name}")
        net = simulate_hrsc_block(block, seed).network
        prior = as_process(net)
        pair = [adjust_network(one, TIGHT) for one in (with_prior(net, prior), net)]
        found.append(["process gauss-markov", "`NodePrior`", name, str(seed), *_shown(pair, prior)])
    for kind in ("gauss-markov", "matern-3/2", "matern-5/2"):
        show(f"seed {seed}: {kind}")
        net = simulate_hrsc_block(ONE, seed).network
        prior = as_process(net, kind)
        both = (prior, dense(prior, net.passes[0].nodes))
        pair = [adjust_network(with_prior(net, one), TIGHT) for one in both]
        what = (f"process {kind}", "dense covariance", "1 strip of 800 km")
        found.append([*what, str(seed), *_shown(pair, prior)])
    return found


def _shown(pair, prior) -> list[str]:
    nodes = [one.nodes for one in pair[0].network.passes]
    apart = differences(*pair)
    assert all(one.converged for one in pair)
    neighbours = max(one.memory for one in prior.conditionals(nodes[0]))
    return [str(sum(map(len, nodes))), str(neighbours), *(f"{apart[name]:.1e}" for name in NAMES)]


def page(chosen: Namespace) -> str:
    """The page."""
    words = (__doc__ or "").split("\n\n", 2)[2].strip()
    every = [row for seed in chosen.seeds for row in rows(seed)]
    note = (
        "Rows of Gauss-Markov processes are exact. Those of Matern processes state each node given few neighbours, "
        "such that less than 0.01 nat a node is lost (Kullback-Leibler divergence): that is what the last rows show."
    )
    lines = ["# Processes against what they replace", "", f"Made by `scripts/process_priors.py`. {words}", ""]
    return "\n".join([*lines, *table(HEAD, every), "", note, "", made_with(), ""])


def main(parser: OneLine, given: list[str]) -> int:
    """The whole command."""
    parser.add_argument("--seeds", type=at_least(1), nargs="+", default=(1,))
    parser.add_argument("--out", type=Path, default=DOCS / "process_priors.md")
    chosen = parser.parse_args(given)
    return write_page(parser, chosen.out, lambda: page(chosen))


if __name__ == "__main__":
    sys.exit(main(command(__doc__), sys.argv[1:]))

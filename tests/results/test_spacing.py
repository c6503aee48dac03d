"""A choice of the spacing of orientation images as words, files and a figure."""

import re
from dataclasses import replace
from functools import cache

from mgsgraph.adjustment.settings import SolverSettings
from mgsgraph.analysis.spacing import Choice, choose_spacing
from mgsgraph.results.spacing import node_statements, nodes_section
from mgsgraph.simulation.hrsc_block import BlockSettings, simulate_hrsc_block
from mgsgraph.simulation.hrsc_flight import Jitter, PointMatching
from mgsgraph.units import MGON


@cache
def choice() -> Choice:
    """One strip of 80 s with 3 mgon of jitter in pitch at 0.06 Hz."""
    settings = BlockSettings(
        strips=1, length=150e3, points=700, terrain=None, spacing=20.0, jitter=Jitter(3.0 * MGON, 0.06, "pitch")
    )
    steps = list[tuple[int, int]]()
    found = choose_spacing(
        simulate_hrsc_block(settings, 1).network, SolverSettings(), [3.0, 12.0, 24.0],
        progress=lambda done, most: steps.append((done, most)),
    )  # fmt: skip
    assert steps == [(done, 4) for done in range(5)]
    return found


def test_words_and_record() -> None:
    section, said = nodes_section(choice(), "block"), " ".join(node_statements(choice()))
    assert " chosen" in section.text()
    assert "Chosen: 3 s" in said
    assert "closest candidate" in said
    assert "blunders" not in said
    assert section.numbers["chosen_s"] == 3.0


def test_rays_put_aside_are_said() -> None:
    settings = BlockSettings(
        strips=1, length=150e3, points=500, terrain=None, spacing=20.0, matches=PointMatching(blunders=0.01),
        jitter=Jitter(4.0 * MGON, 0.06, "pitch"),
    )  # fmt: skip
    made = simulate_hrsc_block(settings, 1)
    net = replace(made.network, rays=replace(made.network.rays, sigmas=0.5 * made.network.rays.sigmas))
    found = choose_spacing(net, SolverSettings(reject=4.0), [4.0, 20.0])
    said = " ".join(node_statements(found))
    assert re.search(r"\d+ rays rejected as blunders, with nodes every 4 s, took part with no candidate", said)
    assert nodes_section(found, "block").numbers["rays_rejected"] == found.rejected > 0.8 * made.blunders.sum()
